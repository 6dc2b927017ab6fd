"""Frames: scaling to the scene's units, checks, and derived variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common import memory
from xcg.common.messages import SceneError, warn_once
from xcg.compiled._jit import for_each
from xcg.compiled.contacts import share_of_i, touching_points
from xcg.scene.frame import rows_of
from xcg.scene.gaps import are_single_spheres, warn_of_gaps
from xcg.scene.lattice import Lattice, unit_vectors
from xcg.scene.normals import checked_normals
from xcg.scene.repeats import without_repeats
from xcg.scene.schema import COMPONENTS, LONGEST, SHORTEST, Frame, Setup, powers_of, variable
from xcg.scene.spheres import (
    SAME_BRANCH,
    SphereContacts,
    are_spheres,
    nearest_branches,
    warn_of_coincident,
)

# What readers say of contacts besides variables of the scene.
HINTS = ("wrapped_branch", "point_is_middle", "row_of_file")
_WHOLE = 2.0**53  # from here on floats of 64 bits leave whole numbers out
_HAIR = 1e-9  # rounding of positions, as a share of the distances between them
_BLOCK = 1 << 14  # contacts whose points are derived together, in the cache of the processor
REPEAT = "repeat the box once or more along that axis, or simulate a larger one"


def _check_rows(frame: Frame, dim: str, source: str) -> None:
    """Raise SceneError for arrays of the wrong shape or with values that are not finite; name every bad variable."""
    first = next(name for name in frame if variable(name).dims[0] == dim)
    rows = len(frame[first])
    if rows == 3 and frame[first].shape != (3, 3) and frame[first].ndim == 2:
        raise SceneError(
            f"{source}: '{first}' has shape {frame[first].shape}, expected (n, 3), a row for each {dim}: give its "
            f"transpose, {first}.T"
        )
    problems = []
    for name, values in frame.items():
        expected = variable(name, values.dtype, values.ndim).shape(rows)
        if values.shape != expected:
            hint = ""
            if values.shape == (rows, 2) and expected == (rows, 3):
                hint = " (of a layer, add a column of zeros for z and give dimension=2)"
            if values.shape == expected[::-1]:
                hint = f"; give its transpose, {name}.T"
            problems.append(f"'{name}' has shape {values.shape}, expected {expected}{hint}")
        elif values.dtype.kind == "f" and not _all_finite(values):
            bad = int(np.argwhere(~np.isfinite(values))[0][0])
            problems.append(f"'{name}' is not finite in row {bad}: {values[bad]}")
    if problems:
        message = f"{source}: {'; '.join(problems)}"
        if "not finite" in message:
            message += ". Every row must hold finite numbers: repair or drop it."
        raise SceneError(message)


def _all_finite(values: NDArray) -> bool:
    """Return whether all values are finite. Their sum, which takes no memory, shows it unless it overflows."""
    with np.errstate(invalid="ignore", over="ignore"):
        total = values.sum()
    return bool(np.isfinite(total)) or bool(np.isfinite(values).all())


def refuse_mask(name: str, values: Any, where: str = "") -> None:
    """Raise SceneError for masked values: the data below the mask would count."""
    if np.ma.is_masked(values):
        raise SceneError(
            f"{where}'{name}' is a masked array with {np.ma.count_masked(values)} masked values; leave out such rows "
            "of all variables (steps may differ in length), or fill them"
        )


def _typed(frame: dict[str, Any], setup: Setup, source: str) -> Frame:
    """Convert arrays to their types and the scene's units, and take them out of the frame.

    Views are copied, so that the table of a reader, of which they are columns, can go.
    """
    typed: Frame = {}
    for name in list(frame):
        values = frame.pop(name)
        refuse_mask(name, values, f"{source}: ")
        array = np.asarray(values)
        row = variable(name, array.dtype, array.ndim)
        if row.dtype == "int64" and array.dtype.kind == "f":
            bad = np.flatnonzero(~((array == np.rint(array)) & (np.abs(array) < _WHOLE)))
            if bad.size:
                value = array.flat[bad[0]]
                why = "; tables are read as floats, which hold no larger ones: number them anew"
                raise SceneError(
                    f"{source}: '{name}' must hold whole numbers below 2^53, but row {bad[0]} is {value}"
                    f"{why * bool(_WHOLE <= abs(value) < np.inf)}"
                )
        try:
            if array.dtype.kind in "cmM":  # NumPy would make numbers of them
                raise TypeError
            typed[name] = array.astype(row.dtype, order="C", copy=not memory.owns_memory(array))
        except (TypeError, ValueError, OverflowError):  # the last of whole numbers beyond 64 bits
            raise SceneError(
                f"{source}: '{name}' holds {array.dtype}, expected real numbers of 64 bits; give each text a number of "
                "its own"
            ) from None
        factor = setup.factor(powers_of(row.units))
        if factor != 1.0:
            typed[name] = typed[name] * factor
    return typed


def complete_particles(
    frame: dict[str, Any],
    setup: Setup,
    source: str,
    lattice: Lattice | None = None,
    threads: int = 1,
) -> Frame:
    """Check the particles of one frame, sort them by id, and derive what is missing.

    Mass, volume, density and diameter follow from each other: volume ``pi d^3/6`` (discs: ``pi
    d^2/4`` times the layer's thickness), ``mass = density * volume``. Moments of inertia of
    particles with an angular velocity are of solid spheres, ``m d^2/10``, or discs, ``m d^2/8``.
    What is given is taken as it is, but for a body of more than half of the particles: these become
    single ones (``body_id = -1``), with a warning. ``unwrapped_position`` becomes ``image``, the
    whole periods between it and the position.

    Parameters
    ----------
    frame : dict
        Arrays by scene name, at least ``position`` (n, 3). It is empty afterwards, so that no
        array is in memory twice while others are completed.
    setup : Setup
        What the data do not say.
    source : str
        File and step, for messages.
    lattice : Lattice, optional
        Periodic images, in the scene's units, which ``image`` is counted in; without them it is
        left out.
    threads : int
        Threads that share the variables while they are sorted.

    Raises
    ------
    SceneError
        If an array has the wrong shape or is not finite, an id is negative or occurs twice, a size
        is not positive, or a mass is negative.
    """
    typed = _typed(frame, setup, source)
    if not np.ndim(typed.get("position", 0.0)):
        raise SceneError(
            f"{source}: no positions; expected a variable 'position' with three components"
        )
    count = len(typed["position"])
    ids = typed.setdefault("particle_id", np.arange(count, dtype="int64"))
    _check_rows(typed, "particle", source)
    if (ids < 0).any():
        row = int(ids.argmin())
        raise SceneError(
            f"{source}: particle id {ids[row]} in row {row} is negative; negative ids are kept for "
            "walls and padding"
        )
    order = _order_of(ids, source)
    if order is not None:

        def sort(name: str) -> None:  # few at a time, as each is there twice for a while
            target = memory.empty(typed[name].shape, typed[name].dtype)
            typed[name] = np.take(typed[name], order, axis=0, out=target, mode="clip")

        for_each(list(typed), sort, threads)
        ids = typed["particle_id"]
        del order
    for name in ("diameter", "density", "volume"):
        if name in typed:
            _require(typed[name] > 0, name, "a positive number", typed, source)
    for name in ("mass", "moment_of_inertia"):
        if name in typed:
            _require(typed[name] >= 0, name, "0 or more", typed, source)
    unwrapped = typed.pop("unwrapped_position", None)
    if unwrapped is not None and lattice is not None:
        typed["image"] = _images(typed["position"], unwrapped, lattice, ids, source)
    _complete_size_and_mass(typed, setup)
    if "body_id" in typed:
        typed["body_id"] = _without_default_body(typed["body_id"], source)
    if "diameter" in typed:
        _check_diameters(typed["diameter"], ids, source)
    return typed


def _check_diameters(diameter: NDArray, ids: NDArray, source: str) -> None:
    """Raise SceneError for lengths that no particle has."""
    beyond = np.flatnonzero(~((diameter >= SHORTEST) & (diameter <= LONGEST)))
    if beyond.size:
        row = beyond[0]
        raise SceneError(
            f"{source}: 'diameter' of particle {ids[row]} is {diameter[row]:.3g} m, expected {SHORTEST:g} to "
            f"{LONGEST:g} m; check the units, and the volume or mass that it follows from"
        )


def _require(fits: NDArray, name: str, expected: str, frame: Frame, source: str) -> None:
    """Raise SceneError for the first particle whose variable is not as expected."""
    if fits.all():
        return
    row = int(np.argmin(fits))
    raise SceneError(
        f"{source}: '{name}' of particle {frame['particle_id'][row]} is {frame[name][row]}; "
        f"expected {expected}"
    )


def _order_of(ids: NDArray, source: str) -> NDArray | None:
    """Return the rows in the order of their ids (n,), None if they are in order.

    Raises
    ------
    SceneError
        If an id occurs twice.
    """
    if (ids[1:] > ids[:-1]).all():
        return None
    lowest = int(ids.min())
    highest = int(ids.max())
    if highest - lowest + 1 == len(ids):  # without gaps, each id has its place: nothing to sort
        places = ids - lowest
        taken = np.zeros(len(ids), bool)
        taken[places] = True
        if taken.all():
            order = np.empty(len(ids), np.intp)
            order[places] = np.arange(len(ids))
            return order
    order = np.argsort(ids)
    in_order = ids[order]
    twice = np.flatnonzero(in_order[1:] == in_order[:-1])
    if twice.size:
        repeated = in_order[twice[0]]
        first, second = np.flatnonzero(ids == repeated)[:2]
        raise SceneError(
            f"{source}: particle id {repeated} occurs twice (rows {first} and {second}); ids must be "
            "unique"
        )
    return order


def _without_default_body(body: NDArray, source: str) -> NDArray:
    """Return ids of bodies (n,), -1 where more than half of the grains are of one body, with a warning.

    Files name all grains 1 that are in no body, or leave a default. Pairs within a body would count
    as glued.
    """
    count = len(body)
    if count < 2:
        return body
    middle = np.partition(body, count // 2)[count // 2]  # what more than half of the grains have
    members = body == middle
    number = int(members.sum())
    if middle < 0 or 2 * number <= count or number < 2:
        return body
    warn_once(
        "bodies",
        f"{source}: {number} of {count} particles are of one body (body_id={middle}), as if it were a default: they "
        "count as single grains (body_id=-1), and contacts between them are found. If they are glued, read the column "
        "as names={'mol': 'my_body'}, and assign ds.assign(body_id=ds.my_body.fillna(-1).astype(int))",
    )
    return np.where(members, -1, body)


_DIGITS = 0.01  # part of a period by which places in files may miss whole periods


def _images(
    position: NDArray, unwrapped: NDArray, lattice: Lattice, ids: NDArray, source: str
) -> NDArray:
    """Return the whole periods (n, 3) between positions and unwrapped positions (n, 3).

    Raises
    ------
    SceneError
        If a difference is not a sum of whole periods.
    """
    images = np.zeros((len(ids), 3), "int64")
    away = unwrapped - position
    if not away.any():
        return images
    periods = lattice.given
    whole = np.rint(away @ np.linalg.pinv(periods))
    rest = np.abs(away - whole @ periods).max(axis=1)
    shortest = np.ptp(position)
    if len(periods):
        shortest = np.linalg.norm(periods, axis=1).min()
    off = np.flatnonzero(rest > _DIGITS * shortest)
    if off.size:
        row = off[0]
        raise SceneError(
            f"{source}: the unwrapped position of particle {ids[row]} is {away[row].tolist()} m from "
            f"its position, which is no sum of the periods {periods.tolist()}; give periodic= and box= "
            "as in the simulation, or drop the unwrapped positions (files: names={'xu': None, ...})"
        )
    images[:, lattice.axes] = whole
    return images


def _volume_of(diameter: NDArray, setup: Setup) -> NDArray:
    if setup.shape == "disc":
        return np.pi / 4 * (setup.thickness or 0.0) * diameter**2
    return np.pi / 6 * diameter**3


def _diameter_of(volume: NDArray, setup: Setup) -> NDArray:
    if setup.shape == "disc":
        return np.sqrt(volume / (np.pi / 4 * (setup.thickness or 0.0)))
    return np.cbrt(6 / np.pi * volume)


_SUPERQUADRIC = {"exponent_1", "exponent_2", *(f"half_axis_{axis}" for axis in COMPONENTS)}


def superquadric_integrals(n1: Any, n2: Any) -> tuple[Any, Any, Any]:
    """Return the volume over abc, and the integrals of x^2 over a^3bc and of z^2 over abc^3, of superquadrics."""
    from scipy.special import beta  # slow to import

    e1 = 2.0 / n1
    e2 = 2.0 / n2
    return (
        2 * e1 * e2 * beta(e1 / 2 + 1, e1) * beta(e2 / 2, e2 / 2),
        0.5 * e1 * e2 * beta(1.5 * e2, e2 / 2) * beta(e1 / 2, 2 * e1 + 1),
        2 * e1 * e2 * beta(e2 / 2, e2 / 2 + 1) * beta(1.5 * e1, e1 + 1),
    )


def _volume_from_shape(frame: Frame, setup: Setup) -> NDArray | None:
    """Return the volume of grains that follows from their axes, diameters, or masses; None if it does not."""
    if set(frame) >= _SUPERQUADRIC:  # the diameter is that of a sphere around it
        volume, _, _ = superquadric_integrals(frame["exponent_1"], frame["exponent_2"])
        for axis in COMPONENTS:
            volume = volume * frame[f"half_axis_{axis}"]
        return np.asarray(volume)
    if "diameter" in frame:
        return _volume_of(frame["diameter"], setup)
    if {"mass", "density"} <= set(frame):
        return frame["mass"] / frame["density"]
    return None


def _complete_size_and_mass(frame: Frame, setup: Setup) -> None:
    count = len(frame["position"])
    if setup.diameter is not None and not {"diameter", "volume"} & set(frame):
        frame["diameter"] = np.full(count, float(setup.diameter))
    if setup.mass is not None and "mass" not in frame:
        frame["mass"] = np.full(count, float(setup.mass))
    if "volume" not in frame:
        volume = _volume_from_shape(frame, setup)
        if volume is not None:
            frame["volume"] = volume
    if "diameter" not in frame and "volume" in frame:
        frame["diameter"] = _diameter_of(frame["volume"], setup)
    if "density" not in frame and "mass" not in frame and setup.density is not None:
        frame["density"] = np.full(count, float(setup.density))
    if "volume" in frame:
        if "density" not in frame and "mass" in frame:
            frame["density"] = frame["mass"] / frame["volume"]
        elif "mass" not in frame and "density" in frame:
            frame["mass"] = frame["density"] * frame["volume"]
    if {"angular_velocity", "mass", "diameter"} <= set(frame) and "moment_of_inertia" not in frame:
        share = {"disc": 8, "sphere": 10}[setup.shape]
        frame["moment_of_inertia"] = frame["mass"] * frame["diameter"] ** 2 / share


def complete_contacts(
    frame: Mapping[str, ArrayLike],
    particles: Frame,
    lattice: Lattice,
    setup: Setup,
    source: str,
    *,
    allow_unknown: bool = False,
    columns: Mapping[str, str] | None = None,
) -> Frame:
    """Check the contacts of one frame against its particles and derive contact points that are not given.

    For spheres the contact point lies on the branch at ``R_i - overlap/2`` from the centre of i,
    with ``overlap = R_i + R_j - |r_i - r_j|`` and ``r_i - r_j`` the image nearest to the branch
    that the data hold, or else the shortest one.

    Contacts that are listed again are taken once, see `xcg.scene.repeats.without_repeats`. Between
    spheres, pairs without a force and with a gap are dropped, overlaps that are another quantity
    are replaced, contact points midway between the centres are moved, and normals of another length
    or sign are scaled or turned, each with a warning, see `xcg.scene.spheres` and
    `xcg.scene.normals`. Forces across gaps are warned of, see `xcg.scene.gaps`.

    Parameters
    ----------
    frame : mapping
        Arrays by scene name, at least ``contact_i``, ``contact_j`` (n,) and ``contact_force`` (n,
        3). ``contact_branch`` (n, 3), from j to i as the code saw it, selects the images.
        ``wrapped_branch`` (n, 3), from j, or the wall, to i, but of any image, becomes the normal.
        Where ``point_is_middle`` (n,) is true, ``contact_point`` is the middle of the centres of
        two spheres, and becomes the point where they touch. Messages count rows by ``row_of_file``
        (n,), where rows were joined or reordered.
    particles : Frame
        The particles of the same step, completed.
    lattice : Lattice
        Periodic images, in the scene's units.
    allow_unknown : bool
        Take contacts with ids that are not among the particles as contacts with a wall.
    columns : mapping, optional
        Columns of the file by variable, for messages.

    Raises
    ------
    SceneError
        For unknown ids, a particle in contact with itself, values that are not finite, a contact
        point that is missing and cannot be derived, as in a box so small that grains touch on both
        sides, a contact that is listed from both sides with the same force, or normals across the
        lines of centres of spheres.
    """
    typed = _typed(
        {name: values for name, values in frame.items() if name not in HINTS}, setup, source
    )
    if "wrapped_branch" in frame and "contact_normal" not in typed:
        branch = np.asarray(frame["wrapped_branch"]) * setup.scales[0]
        typed["contact_normal"] = unit_vectors(lattice.shortest(branch))
    missing = [name for name in ("contact_i", "contact_j", "contact_force") if name not in typed]
    if missing:
        raise SceneError(
            f"{source}: contacts lack {', '.join(missing)}; pass {missing[0]}=, or map columns by names="
        )
    _check_rows(typed, "contact", source)
    seen = typed.pop("contact_branch", None)
    i, j = typed["contact_i"], typed["contact_j"]
    number = np.asarray(frame.get("row_of_file", np.arange(len(i))))
    ids = particles["particle_id"]
    row_i, row_j = rows_of(ids, i), rows_of(ids, j)
    self_contact = np.flatnonzero(i == j)
    if self_contact.size:
        row = self_contact[0]
        raise SceneError(
            f"{source}: contact row {number[row]} joins particle {i[row]} with itself; drop such rows. If it "
            f"touches its own image, {REPEAT}"
        )
    if (i < 0).any():
        row = int(np.flatnonzero(i < 0)[0])
        raise SceneError(
            f"{source}: contact row {number[row]} has id {i[row]} as 'contact_i'; a wall must stand as 'contact_j'"
        )
    unknown = row_j < 0
    unknown &= j >= 0
    unknown |= row_i < 0
    if unknown.any() and not allow_unknown:
        row = int(np.flatnonzero(unknown)[0])
        name = "contact_i" if row_i[row] < 0 else "contact_j"
        raise SceneError(
            f"{source}: contact row {number[row]} has {name}={typed[name][row]}, and no particle has this id "
            f"({int(unknown.sum())} such rows); check that particles and contacts are of the same step, or pass "
            "allow_unknown=True to treat unknown partners as walls"
        )
    derived = np.asarray(
        frame.get("point_is_middle", np.full(len(i), "contact_point" not in typed))
    )
    if are_spheres(particles):
        spheres = SphereContacts(typed, number, particles, row_i, row_j, seen, lattice, source)
        dropped = spheres.rows_without_contact()
        if dropped.size:  # all else depends on the rows
            kept = {
                name: np.delete(np.asarray(values), dropped, axis=0)
                for name, values in {**frame, "row_of_file": number}.items()
            }
            return complete_contacts(
                kept,
                particles,
                lattice,
                setup,
                source,
                allow_unknown=allow_unknown,
                columns=columns,
            )
        typed |= _checked_geometry(spheres, frame, columns or {}, setup.shape)
        if "contact_point" in typed and "point_is_middle" not in frame:
            spheres.warn_of_coincident_centres()
            if spheres.points_are_middles():
                derived = (row_i >= 0) & (row_j >= 0)
            else:
                spheres.warn_of_points_elsewhere()
    if derived.any() or "contact_point" not in typed:
        typed["contact_point"] = _derive_points(
            typed, number, derived, particles, row_i, row_j, seen, lattice, source
        )
    del row_i, row_j, unknown, derived
    return without_repeats(typed, number, particles, lattice, setup.sides, source)


def _checked_geometry(
    spheres: SphereContacts,
    frame: Mapping[str, ArrayLike],
    columns: Mapping[str, str],
    shape: str,
) -> Frame:
    """Return the normals and overlaps that the data hold, compared with positions and radii."""
    checked = Frame()
    if are_single_spheres(spheres.particles, shape):
        # points in another unit have a warning of their own, and lead to other images
        if "point_is_middle" in frame or spheres.unit_of_points is None:
            warn_of_gaps(spheres)
        if "contact_normal" in frame:
            checked["contact_normal"] = checked_normals(spheres)
    if "overlap" in frame:
        checked["overlap"] = spheres.checked_overlaps(columns.get("overlap", "overlap"))
    return checked


def _derive_points(
    contacts: Frame,
    number: NDArray,
    derived: NDArray,
    particles: Frame,
    row_i: NDArray,
    row_j: NDArray,
    seen: NDArray | None,
    lattice: Lattice,
    source: str,
) -> NDArray:
    """Contact points (n, 3), derived from the spheres for `derived` contacts (n,); by blocks that stay in the cache."""
    points = np.empty((len(row_i), 3))
    if "contact_point" in contacts:
        points[:] = contacts["contact_point"]
    wanted = np.flatnonzero(derived)
    for first in range(0, len(wanted), _BLOCK):
        some = wanted[first : first + _BLOCK]
        of_block = (
            particles,
            row_i[some],
            row_j[some],
            None if seen is None else seen[some],
            lattice,
        )
        block_points = _plain_points(*of_block)
        if block_points is None:
            block = {name: values[some] for name, values in contacts.items()} | {
                "row_of_file": number[some]
            }
            block_points = _contact_points(block, *of_block, source)
        if block_points is None:
            warn_once(
                "branches of contacts",
                f"{source}: branches of contacts are not the vectors from j to i between the positions, or cross an "
                "edge that is not periodic, and the shortest are taken; drop them with names={'dx': None, ...} if they "
                "are something else",
            )
            return _derive_points(
                contacts, number, derived, particles, row_i, row_j, None, lattice, source
            )
        points[some] = block_points
    return points


def _plain_points(
    particles: Frame, row_i: NDArray, row_j: NDArray, seen: NDArray | None, lattice: Lattice
) -> NDArray | None:
    """Points where spheres touch in a box with edges along the axes; None if a pair is left to `_contact_points`.

    A loop finds them in less than a tenth of the time. It knows neither tilted boxes nor partners
    that are not in the scene, and has no messages: `_contact_points` has all these.
    """
    if lattice.reduced is not None or "diameter" not in particles:
        return None
    points, (period, _) = np.empty((len(row_i), 3)), lattice.for_loops
    of_particles = particles["position"], particles["diameter"]
    plain = touching_points(row_i, row_j, *of_particles, seen, SAME_BRANCH, period, _HAIR, points)
    return points if plain == len(row_i) else None


def _contact_points(
    contacts: Frame,
    particles: Frame,
    row_i: NDArray,
    row_j: NDArray,
    seen: NDArray | None,
    lattice: Lattice,
    source: str,
) -> NDArray | None:
    """Points where spheres touch; for a partner that is not in the scene, from the given middle.

    None where branches that the data hold are not those between the positions.
    """
    alone = (row_i < 0) | (row_j < 0)
    if alone.any() and not {"contact_point", "overlap"} <= set(contacts):
        row = int(np.flatnonzero(alone)[0])
        raise SceneError(
            f"{source}: contact row {contacts['row_of_file'][row]} (i={contacts['contact_i'][row]}, "
            f"j={contacts['contact_j'][row]}) has no contact point, and none follows without both spheres; give "
            "'contact_point' for contacts with walls"
        )
    if "diameter" not in particles:
        raise SceneError(
            f"{source}: contact points follow from diameters, but the particles have none; give one of the two"
        )
    position = particles["position"]
    radius = particles["diameter"] / 2
    points = contacts.get("contact_point", np.empty((len(row_i), 3))).copy()
    both = np.flatnonzero(~alone)
    only = np.flatnonzero(alone & (np.maximum(row_i, row_j) >= 0))
    i, j, k = row_i[both], row_j[both], np.maximum(row_i, row_j)[only]
    seen = None if seen is None else seen[both]

    def refuse(wrong: NDArray, what: str) -> None:
        if wrong.size:
            row = both[wrong[0]]
            pair = f"i={contacts['contact_i'][row]}, j={contacts['contact_j'][row]}"
            raise SceneError(
                f"{source}: contact row {contacts['row_of_file'][row]} ({pair}) {what}"
            )

    centre = position[i]
    radius_i = radius[i]
    radius_j = radius[j]
    branch = _branches(centre - position[j], radius_i + radius_j, seen, lattice, refuse)
    if branch is None:
        return None
    same = both[(branch == 0.0).all(axis=1)]
    warn_of_coincident(contacts["contact_i"][same], contacts["contact_j"][same], source)
    between = contact_points(centre, branch, radius_i, radius_j)
    points[both] = between
    for side in (centre - between, centre - between - branch):
        refuse(
            np.flatnonzero(lattice.is_halfway(side, _HAIR)),
            f"is half a period away from a centre, where both of its sides are one place; {REPEAT}",
        )
    if only.size:
        branch = 2 * lattice.shortest(position[k] - points[only])
        other = np.linalg.norm(branch, axis=1) + contacts["overlap"][only] - radius[k]
        points[only] = contact_points(position[k], branch, radius[k], other)
    return points


def _branches(
    apart: NDArray,
    touching: NDArray,
    seen: NDArray | None,
    lattice: Lattice,
    refuse: Callable[[NDArray, str], None],
) -> NDArray | None:
    """Images of vectors (n, 3) from j to i that touch at `touching` (n,): nearest to what was `seen`, or shortest.

    None where these are not near to what was seen.
    """
    if seen is not None:
        return nearest_branches(apart, seen, lattice)
    branch = lattice.shortest(apart)
    rows, _ = lattice.within(
        branch, np.maximum(np.linalg.norm(branch, axis=1), touching) * (1 + _HAIR)
    )
    refuse(
        rows[1:][rows[1:] == rows[:-1]],
        "may be on either side, as the box is so small that the two touch twice; give 'contact_point', or the vector "
        "from j to i as 'contact_branch' (files: names={'dx': 'contact_branch_x', ...})",
    )
    return branch


def contact_points(
    position_i: NDArray, branch: NDArray, radius_i: NDArray, radius_j: NDArray
) -> NDArray:
    """Points on the branches r_i - r_j of spheres, ``R_i - overlap / 2`` from the centre of i."""
    length = np.linalg.norm(branch, axis=1)
    share = share_of_i(np.where(length > 0, length, 1.0), radius_i, radius_j)
    return position_i - share[:, None] * branch
