"""Particles of one step: checks, order by id, and the variables that follow from others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common import memory
from xcg.common.messages import SceneError, warn_once
from xcg.compiled._jit import for_each
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, LONGEST, SHORTEST, Frame, Setup
from xcg.scene.typed import check_rows, typed_arrays


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
    typed = typed_arrays(frame, setup, source)
    if not np.ndim(typed.get("position", 0.0)):
        raise SceneError(
            f"{source}: no positions; expected a variable 'position' with three components"
        )
    count = len(typed["position"])
    ids = typed.setdefault("particle_id", np.arange(count, dtype="int64"))
    check_rows(typed, "particle", source)
    if (ids < 0).any():
        index = int(ids.argmin())
        raise SceneError(
            f"{source}: particle id {ids[index]} in row {index} is negative; negative ids are kept for "
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
        index = beyond[0]
        raise SceneError(
            f"{source}: 'diameter' of particle {ids[index]} is {diameter[index]:.3g} m, expected {SHORTEST:g} to "
            f"{LONGEST:g} m; check the units, and the volume or mass that it follows from"
        )


def _require(fits: NDArray, name: str, expected: str, frame: Frame, source: str) -> None:
    """Raise SceneError for the first particle whose variable is not as expected."""
    if fits.all():
        return
    index = int(np.argmin(fits))
    raise SceneError(
        f"{source}: '{name}' of particle {frame['particle_id'][index]} is {frame[name][index]}; "
        f"expected {expected}"
    )


def _order_of(ids: NDArray, source: str) -> NDArray | None:
    """Return the indices (n,) that sort ids, None if these are in order.

    Raises
    ------
    SceneError
        If an id occurs twice.
    """
    if (ids[1:] > ids[:-1]).all():
        return None
    lowest = int(ids.min())
    highest = int(ids.max())
    if highest - lowest + 1 == len(ids):  # without gaps, each id is its rank: nothing to sort
        ranks = ids - lowest
        taken = np.zeros(len(ids), bool)
        taken[ranks] = True
        if taken.all():
            order = np.empty(len(ids), np.intp)
            order[ranks] = np.arange(len(ids))
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


_DIGITS = 0.01  # part of a period by which positions in files may miss whole periods


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
    periods = lattice.periodic_vectors
    whole = np.rint(away @ np.linalg.pinv(periods))
    rest = np.abs(away - whole @ periods).max(axis=1)
    shortest = np.ptp(position)
    if len(periods):
        shortest = np.linalg.norm(periods, axis=1).min()
    off = np.flatnonzero(rest > _DIGITS * shortest)
    if off.size:
        index = off[0]
        raise SceneError(
            f"{source}: the unwrapped position of particle {ids[index]} is {away[index].tolist()} m from "
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
