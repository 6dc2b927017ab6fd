"""Contacts that are listed again, and warnings about implausible input: attractive contacts, discs read as spheres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_once, warn_user
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, Frame, Setup, Sides

# Rows of one pair are copies where their forces, and their points, differ by no more than this
# share of the force, and of the distance from the centre: rounding in files of six digits.
_ROUNDED = 1e-4
# Rows from both sides with the same force are an error up to this distance, over the distance from
# the centre.
_SAME_POINT = 0.05
_MOST_CONTACTS_A_PAIR = 64  # of equal force, that are compared with each other
# Rows from both sides are one contact where their forces differ from opposite ones by no more than
# this share of the larger, or of a hundredth of the mean force of such rows, and their points by
# this share of the smaller radius.
_OPPOSITE, _SMALL_FORCE, _ONE_PLACE = 0.25, 0.01, 0.15
# what turns its sign with the side
_OF_SIDE = ("contact_force", "contact_normal")


def without_repeats(
    contacts: Frame, number: NDArray, particles: Frame, lattice: Lattice, sides: Sides, source: str
) -> Frame:
    """Merge contacts that are listed more than once.

    Copies, (i, j, f) twice or from both sides as (j, i, -f), are one contact where forces agree to
    1e-4, and points to 1e-4 of the distance from the centre. Rows from both sides whose forces are
    opposite to a quarter of the larger, and whose points are no more than 0.15 of the smaller
    radius apart, are one contact unless `sides` is "separate": with the mean of both forces,
    points, normals and overlaps for "mean", or as the row that comes first for "first". Other
    variables come from the first row. A warning states how many, and how far they differ, where
    forces do by more than 1e-4. Other contacts of one pair, which differ in force or place, all
    stay.

    Parameters
    ----------
    contacts : Frame
        Contacts of one step, completed.
    number
        Rows of the file, for messages.

    Raises
    ------
    SceneError
        If a contact is listed from both sides with the same force.
    """
    rows, pair = repeated_pairs(contacts["contact_i"], contacts["contact_j"])
    if not rows.size:
        return contacts
    ids = particles["particle_id"]
    there, other = (rows_of(ids, contacts[name][rows]) for name in ("contact_i", "contact_j"))
    there, centre = np.where(there >= 0, there, other), contacts["contact_point"][rows]
    centre[there >= 0] = particles["position"][there[there >= 0]]
    order = np.lexsort((np.linalg.norm(contacts["contact_force"][rows], axis=1), pair))
    rows, pair, centre = rows[order], pair[order], centre[order]
    copy, has_both_sides = _copies(contacts, number, rows, pair, centre, lattice, source)
    dropped = rows[copy]
    if sides != "separate":
        kept = ~copy
        first, second, apart, unlike = _mirrored(
            contacts, rows[kept], pair[kept], centre[kept], ~has_both_sides[kept], lattice
        )
        if unlike.size:
            _warn_of_unlike(contacts, unlike, source)
        if first.size:
            if (apart > _ROUNDED).any():
                _warn_of_mirrored(apart, sides, source)
            contacts = (
                _with_means(contacts, first, second, lattice) if sides == "mean" else contacts
            )
            dropped = np.concatenate([dropped, second])
    return (
        {name: np.delete(values, dropped, axis=0) for name, values in contacts.items()}
        if dropped.size
        else contacts
    )


def rows_of(ids: NDArray, wanted: NDArray) -> NDArray:
    """Row of each wanted id among sorted ids, -1 where it is not there; `wanted` itself where that is the same."""
    if not len(ids):
        return np.full(len(wanted), -1)
    if ids[-1] - ids[0] + 1 == len(ids):  # no gaps: nothing to search for
        row = wanted - ids[0] if ids[0] else wanted
        known = (row >= 0) & (row < len(ids))
        return row if known.all() else np.where(known, row, -1)
    row = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
    return np.where(ids[row] == wanted, row, -1)


def unit_vectors(vector: NDArray) -> NDArray:
    """Vectors (n, 3) over their lengths; zero where these are zero."""
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.divide(vector, length, out=np.zeros_like(vector), where=length > 0)


def repeated_pairs(i: NDArray, j: NDArray) -> tuple[NDArray, NDArray]:
    """Rows of the contacts of all pairs that have more than one, pair after pair, and a number for the pair of each.

    Which of the two comes first makes no difference. Spheres touch once, and a sort shows that no
    pair repeats.
    """
    if not len(i):
        return np.empty(0, int), np.empty(0, int)
    low, high = np.minimum(i, j), np.maximum(i, j)
    lows, highs = (int(ids.max()) - int(ids.min()) + 1 for ids in (low, high))
    if lows * highs < 2**62:
        key = low
        key *= highs  # in place, as there may be many; may go round the range of whole numbers: no two pairs meet
        key += high
        del high
        sorted_keys = np.sort(key)  # far quicker than their order
        if (sorted_keys[1:] != sorted_keys[:-1]).all():
            return np.empty(0, int), np.empty(0, int)
        order = np.argsort(key, kind="stable")
        same = key[order[1:]] == key[order[:-1]]
    else:
        order = np.lexsort((high, low))
        same = (low[order[1:]] == low[order[:-1]]) & (high[order[1:]] == high[order[:-1]])
    inside = np.append(same, False) | np.insert(same, 0, False)
    return order[inside], np.insert(np.cumsum(~same), 0, 0)[inside]


def _copies(
    contacts: Frame,
    number: NDArray,
    rows: NDArray,
    pair: NDArray,
    centre: NDArray,
    lattice: Lattice,
    source: str,
) -> tuple[NDArray, NDArray]:
    """Return a mask of the rows that repeat a contact (n,): the same force, from either side, at the same point.

    A second mask (n,) marks the rows that are repeated from the other side.

    Parameters
    ----------
    number
        Rows of the file, for messages.
    rows, pair : array (n,)
        Contacts of pairs that have more than one, see `repeated_pairs`; contacts of a pair by the
        size of the force, so that rows of one contact are near each other.
    centre : array (n, 3)
        Centre of a particle of each (m), from which the distance of points is judged.
    """
    point = contacts["contact_point"][rows]
    mirrored = contacts["contact_i"][rows] > contacts["contact_j"][rows]
    force = contacts["contact_force"][rows]
    size = np.linalg.norm(force, axis=1)
    radius = np.linalg.norm(lattice.shortest(point - centre), axis=1)
    copy = np.zeros(len(rows), bool)
    has_both_sides = np.zeros(len(rows), bool)
    for distance in range(1, min(len(rows), _MOST_CONTACTS_A_PAIR)):
        near = (pair[distance:] == pair[:-distance]) & ~copy[distance:]
        near &= size[distance:] - size[:-distance] <= _ROUNDED * size[distance:]
        one = np.flatnonzero(near)
        if not one.size:
            break
        other = one + distance
        apart = np.linalg.norm(lattice.shortest(point[one] - point[other]), axis=1)
        near = apart <= _SAME_POINT * radius[other]
        one, other, apart = one[near], other[near], apart[near]
        together = apart <= _ROUNDED * radius[other]
        turned, least = mirrored[one] != mirrored[other], _ROUNDED * size[other]
        same = np.linalg.norm(force[one] - force[other], axis=1) <= least
        opposite = np.linalg.norm(force[one] + force[other], axis=1) <= least
        copy[other[together & np.where(turned, opposite, same)]] = True
        has_both_sides[one[together & turned & opposite]] = True
        wrong = turned & same & ~opposite
        if wrong.any():
            first, second = number[rows[one[wrong][0]]], number[rows[other[wrong][0]]]
            raise SceneError(
                f"{source}: contact rows {first} and {second} list one contact from both sides with the same force, "
                f"{force[one[wrong][0]]}, so that both sides cancel; contact_force is that on contact_i: turn "
                "the sign of one of them, or list each contact once"
            )
    return copy, has_both_sides


def _mirrored(
    contacts: Frame,
    rows: NDArray,
    pair: NDArray,
    centre: NDArray,
    free: NDArray,
    lattice: Lattice,
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Rows that list one contact from both sides, the first one first, and by how much their forces differ; (m,) each.

    Differences are shares of the larger force. Last come rows at one place whose forces differ by
    more, and that are no contact with a third one (k, 2). Arguments as in `_copies`, without
    copies; `free` (n,) marks the rows whose other side may be among them.
    """
    point, force = contacts["contact_point"][rows], contacts["contact_force"][rows]
    turned = contacts["contact_i"][rows] > contacts["contact_j"][rows]
    size, radius = (
        np.linalg.norm(force, axis=1),
        np.linalg.norm(lattice.shortest(point - centre), axis=1),
    )
    least = _SMALL_FORCE * size.mean() if size.size else 0.0
    free, found, apart, beside = free.copy(), [], [], []
    for distance in range(1, min(len(rows), _MOST_CONTACTS_A_PAIR)):
        of_pair = pair[distance:] == pair[:-distance]
        if not of_pair.any():
            break
        one = np.flatnonzero(of_pair & (turned[distance:] != turned[:-distance]))
        for step in (0, 1):  # rows that follow each other share one: every other of them at a time
            some = one[(one // distance) % 2 == step]
            some = some[free[some] & free[some + distance]]
            other = some + distance
            mismatch = np.linalg.norm(force[some] + force[other], axis=1)
            larger = np.maximum(np.maximum(size[some], size[other]), least)
            gap = np.linalg.norm(lattice.shortest(point[some] - point[other]), axis=1)
            near = gap <= _ONE_PLACE * np.minimum(radius[some], radius[other])
            same = near & (mismatch <= _OPPOSITE * larger)
            beside.append(np.stack([some, other], axis=1)[near & ~same])
            free[some[same]] = free[other[same]] = False
            found.append(np.sort([rows[some[same]], rows[other[same]]], axis=0))
            apart.append(
                np.divide(
                    mismatch[same], larger[same], out=np.zeros(same.sum()), where=larger[same] > 0
                )
            )
    first, second = np.concatenate(found, axis=1) if found else np.empty((2, 0), int)
    unlike = np.concatenate(beside) if beside else np.empty((0, 2), int)
    unlike = rows[unlike[free[unlike].all(axis=1)]]
    return first, second, np.concatenate(apart) if apart else np.empty(0), unlike


def _warn_of_mirrored(apart: NDArray, sides: Sides, source: str) -> None:
    taken = "with the mean of both sides" if sides == "mean" else "as the row that comes first"
    warn_once(
        "sides of contacts",
        f"{source}: {apart.size} contacts are listed from both sides with forces that differ by {apart.mean():.2g} of "
        f"the larger on average, {apart.max():.2g} at most: each is taken once, {taken}; sides='separate' takes both "
        "rows as contacts of their own" + (", sides='first' the first" if sides == "mean" else ""),
    )


def _warn_of_unlike(contacts: Frame, unlike: NDArray, source: str) -> None:
    row, other = unlike[0]
    i, j = contacts["contact_i"][row], contacts["contact_j"][row]
    warn_once(
        "unlike sides of contacts",
        f"{source}: {len(unlike)} contacts are listed from both sides with forces that differ by more than "
        f"{_OPPOSITE:g} of the larger, such as {contacts['contact_force'][row]} on particle {i} and "
        f"{contacts['contact_force'][other]} on particle {j}: both rows count, so that stress and coordination may be "
        "twice as large; list each contact once, or pass sides='separate' if these are contacts of their own",
    )


def _with_means(contacts: Frame, first: NDArray, second: NDArray, lattice: Lattice) -> Frame:
    """Return contacts whose `first` rows hold the means of both sides."""
    found = dict(contacts)
    for name in (*_OF_SIDE, "contact_point", "overlap"):
        if name in found:
            values = found[name] = found[name].copy()
            change = values[second] * (-1 if name in _OF_SIDE else 1) - values[first]
            values[first] += 0.5 * (lattice.shortest(change) if name == "contact_point" else change)
    if "contact_normal" in found:
        found["contact_normal"][first] = unit_vectors(found["contact_normal"][first])
    return found


SAMPLE = 4096  # rows looked at, spread over all
_FAR = 3.0  # diameters from a centre to a contact point; the ends of rods are as far that are 18 times as long as wide
_FEW = 20  # contacts that are too few to tell a wrong sign by
_MOST = 0.9  # share of contacts that pull
_CENTRAL = 1e-2  # sine of the angle between forces and branches, from positions of six digits
_OFF = 0.1  # largest distance of the ends in a file from the centres, in branches

_SAME = 2e-3  # scatter of masses over d^2, from sizes and masses of four digits
_MOST_FILLED = 100.0  # grains in the cube of a diameter, also of glued ones that overlap
_DIGITS = 5e-3  # error of products of masses, sizes and densities of three digits
_VARIED = 0.02  # scatter of diameters that tells d^2 from d^3


def check_sizes(frame: Frame, setup: Setup) -> None:
    """Warn when sizes, masses and densities contradict each other, the space that grains are in, or `density=`.

    Parameters
    ----------
    frame : Frame
        Particles of one step, completed.
    setup : Setup
        Arguments of the scene.
    """
    if "diameter" in frame and len(frame["diameter"]):
        mean, extent = frame["diameter"].mean(), np.array([np.ptp(x) for x in frame["position"].T])
        plane = [k for k, axis in enumerate(COMPONENTS) if axis in setup.plane]
        if len(frame["diameter"]) > _MOST_FILLED * (extent[plane] / mean + 1).prod():
            warn_user(
                f"{len(frame['diameter'])} grains with a mean diameter of {mean:.3g} have their centres within "
                f"{' x '.join(f'{length:.3g}' for length in extent)}, where they do not fit: are the units of radius "
                "and position the same?"
            )
    some = _sample(len(frame["position"]))
    _check_density(frame, some, setup)
    if not {"mass", "diameter", "volume"} <= set(frame):
        return
    if _is_contradicted(frame, some, setup) or setup.shape != "sphere":
        return
    d, mass, volume = (
        np.asarray(frame[name][some], float) for name in ("diameter", "mass", "volume")
    )
    if "half_axis_x" not in frame:
        _warn_of_large_volumes(d, volume)
    if (
        len(d) < _FEW
        or np.std(d) < _VARIED * np.mean(d)
        or not np.allclose(volume, np.pi / 6 * d**3, rtol=1e-6, atol=0)
    ):
        return
    if np.std(mass / d**2) < _SAME * np.mean(mass / d**2):
        warn_user(
            "masses go with the square of the diameter, as those of discs, and volumes and densities are taken to be "
            "those of spheres: give shape='disc' and thickness="
            + (" and dimension=2" if setup.dimension == 3 else "")
        )


def _warn_of_large_volumes(d: NDArray, volume: NDArray) -> None:
    """Warn if most volumes (n,) exceed the volumes of spheres with the diameters (n,)."""
    over_sphere = volume / (np.pi / 6 * d**3)
    ratio = np.median(over_sphere) if len(d) else 0.0
    if ratio > 1 + _DIGITS:
        warn_user(
            f"volumes are {ratio:.4g} times those of spheres with the diameters (the median; in the first row volume "
            f"{volume[0]:.6g} and diameter {d[0]:.6g}): a column holds radii in place of diameters or has another "
            "unit, or grains are discs (shape='disc', thickness=). Drop the wrong column, names={'column': None}"
        )


def _check_density(frame: Frame, some: slice, setup: Setup) -> None:
    """Warn where density= was given, and the data hold masses or densities, which count, and are others."""
    if setup.density is None:
        return
    if "density" not in frame:
        if "mass" in frame:
            warn_user(
                f"density={setup.density:g} is not used, as the data hold masses and no sizes: leave it out, or give "
                "sizes, a column or diameter= of scene_from_arrays"
            )
        return
    density = frame["density"][some]
    if len(density) and np.abs(density / setup.density - 1).max() > _DIGITS:
        warn_user(
            f"density={setup.density:g} is not used, as the data hold masses or densities (densities are "
            f"{density.min():.6g} to {density.max():.6g}): leave it out, or drop these columns, "
            "names={'mass': None, 'density': None}"
        )


def _is_contradicted(frame: Frame, some: slice, setup: Setup) -> bool:
    """Warn where masses, densities and volumes that the data hold contradict each other; return whether they do."""
    mass, volume, density, d = (
        np.asarray(frame[name][some], float) for name in ("mass", "volume", "density", "diameter")
    )
    expected = density * volume
    wrong = np.flatnonzero((np.abs(mass - expected) > _DIGITS * expected) & (mass > 0))
    if not wrong.size:
        return False
    row = wrong[0]
    numbers = (
        f"{wrong.size} of {len(mass)} particles looked at, such as id {frame['particle_id'][some][row]}: mass "
        f"{mass[row]:.6g}, density {density[row]:.6g}, diameter {d[row]:.6g}, volume {volume[row]:.6g}"
    )
    thickness = mass / (density * np.pi / 4 * d**2)
    depth = thickness.mean()
    varied = np.std(d) > _VARIED * np.mean(d)
    # of equal grains only the thickness of 1 tells discs, which two-dimensional simulations have
    is_one = abs(depth / setup.scales[0] - 1) < _SAME
    if np.std(thickness) < _SAME * depth and (varied or is_one):
        warn_user(
            f"masses fit discs of thickness {depth:.4g}, m = rho pi r^2 times that, and volumes do not ({numbers}): "
            f"give shape='disc' and thickness={depth:.4g}"
            + (" and dimension=2" if setup.dimension == 3 else "")
        )
    else:
        warn_user(
            f"masses are not density times volume ({numbers}): check the units of these columns, or drop one of them, "
            "such as names={'density': None}"
        )
    return True


def _sample(rows: int) -> slice:
    return slice(None, None, max(1, rows // SAMPLE))


def check_contacts(
    frame: Frame, row_i: NDArray, row_j: NDArray, lattice: Lattice, source: str
) -> None:
    """Warn of contact points far from the centres of their grains, and of contacts that pull nearly throughout.

    Parameters
    ----------
    frame : Frame
        Particles and contacts of one step.
    row_i, row_j : array (contacts,)
        Rows of the partners among the particles, negative where they are not there.
    lattice : Lattice
        Periodic images.
    source : str
        Names the step.
    """
    if not len(frame["position"]) or not len(row_i):
        return
    some = _sample(len(row_i))
    row_i, row_j, point = row_i[some], row_j[some], frame["contact_point"][some]
    side_i, side_j = (lattice.shortest(frame["position"][row] - point) for row in (row_i, row_j))
    side_i[row_i < 0] = side_j[row_j < 0] = 0.0
    far, pulling, pushing = np.empty(0, int), 0, 0
    if "diameter" in frame:
        larger = np.maximum(
            *(np.where(row < 0, 0.0, frame["diameter"][row]) for row in (row_i, row_j))
        )
        away = np.sqrt(
            np.maximum(*(np.einsum("nk,nk->n", side, side) for side in (side_i, side_j)))
        )
        distance = np.divide(away, larger, out=np.zeros_like(away), where=larger > 0.0)
        far = np.flatnonzero(distance > _FAR)
    if "contact_force" in frame:
        side_i[row_i < 0] = -side_j[row_i < 0]
        along = np.einsum("nk,nk->n", frame["contact_force"][some], side_i)
        pulling, pushing = int((along < 0.0).sum()), int((along > 0.0).sum())
    if far.size:
        i, j = (frame[name][some][far[0]] for name in ("contact_i", "contact_j"))
        warn_once(
            "far contacts",
            f"{source}: {far.size} of {len(point)} contacts looked at lie more than {_FAR:g} diameters from the "
            f"centre of a particle of theirs ({distance[far[0]]:.3g} diameters for contact_i={i}, contact_j={j}): "
            "they are of another step or box, ids are mixed up, positions were changed without contact_point, or "
            "periodic= lacks an axis",
        )
    elif pulling + pushing >= _FEW and pulling > _MOST * (pulling + pushing):
        warn_once(
            "tension",
            f"{source}: {pulling} of {pulling + pushing} contacts looked at pull their particles together, so that "
            "pressure is negative nearly everywhere: contact_force is the force on contact_i, and where the data have "
            "that on the other, exchange the two (names=), or change the sign",
        )


def is_central(contacts: Frame, particles: Frame, lattice: Lattice) -> bool:
    """Return whether all forces between particles lie along the line of their centres; False for few contacts."""
    some = _sample(len(contacts["contact_i"]))
    i, j = (
        rows_of(particles["particle_id"], contacts[name][some])
        for name in ("contact_i", "contact_j")
    )
    pairs = (i >= 0) & (j >= 0)
    branch = lattice.shortest(particles["position"][i[pairs]] - particles["position"][j[pairs]])
    force = contacts["contact_force"][some][pairs]
    across, along, pull = (
        np.linalg.norm(vectors, axis=1) for vectors in (np.cross(branch, force), branch, force)
    )
    return len(force) >= _FEW and bool((across <= _CENTRAL * along * pull).all())


def check_ends(raw: Frame, particles: Frame, lattice: Lattice, source: str) -> None:
    """Warn where the ends that a file of contacts holds are not the positions of the particles.

    Parameters
    ----------
    raw : Frame
        Contacts with ``wrapped_branch``, from j to i by the ends in the file (m), of any image.
    particles : Frame
        The particles of the same step.
    lattice : Lattice
        Periodic images.
    source : str
        Names the step.
    """
    some = _sample(len(raw["contact_i"]))
    row_i, row_j = (
        rows_of(particles["particle_id"], np.asarray(raw[name][some], "int64"))
        for name in ("contact_i", "contact_j")
    )
    pairs = np.flatnonzero((row_i >= 0) & (row_j >= 0))
    ends = lattice.shortest(raw["wrapped_branch"][some][pairs])
    centres = particles["position"][row_i[pairs]] - particles["position"][row_j[pairs]]
    away = np.linalg.norm(lattice.shortest(ends - centres), axis=1)
    off = np.flatnonzero(away > _OFF * np.linalg.norm(ends, axis=1))
    if off.size:
        first = off[0]
        i, j = (int(raw[name][some][pairs[first]]) for name in ("contact_i", "contact_j"))
        warn_once(
            "ends",
            f"{source}: the ends of {off.size} of {len(pairs)} contacts looked at are not the positions of their "
            f"particles (contact_i={i}, contact_j={j}: {ends[first]} from end to end, "
            f"{lattice.shortest(centres)[first]} from centre to centre): particles and contacts are of different "
            "steps or runs, columns are not in the order expected, or the box is another",
        )
