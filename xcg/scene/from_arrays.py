"""Scenes from arrays in memory: checked, completed, measured."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.common.messages import Once, SceneError, did_you_mean
from xcg.scene.box import domain_of
from xcg.scene.build import to_dataset
from xcg.scene.complete import complete_particles
from xcg.scene.complete_contacts import complete_contacts
from xcg.scene.conform import ROW_NUMBERS
from xcg.scene.frame import entries_of, stack
from xcg.scene.lattice import Lattice
from xcg.scene.sanity import check_motion, check_scene
from xcg.scene.schema import PADDING, VARIABLES, Frame, Setup, Shape, Sides, variable
from xcg.scene.sizes import measure_frames
from xcg.scene.times import check_times, times_of_caller
from xcg.scene.typed import refuse_mask


def _split_steps(name: str, values: Any) -> list[NDArray]:
    """Arrays of one step each, from one step, a stack of steps, or a list of steps of different length."""
    dims = len(variable(name).dims)
    if isinstance(values, (list, tuple)) and len(values) and np.ndim(values[0]) == dims:
        return [np.asarray(v) for v in values]
    array = np.asarray(values)
    if array.ndim == dims:
        return [array]
    if array.ndim == dims + 1:
        return list(array)
    equal = ""
    if array.size in (1, 3) and array.ndim < dims:
        shape = {1: "(n,)", 2: "(n, 3)"}[dims]
        equal = f"; where all are equal, give numpy.full({shape}, {array.tolist()})"
    expected = {1: "1 dimension", 2: "2 dimensions"}[dims]
    raise SceneError(
        f"'{name}' has shape {array.shape}: expected {expected} for one step, or {dims + 1} with time first{equal}"
    )


def _split_own(name: str, values: Any, counts: Sequence[int]) -> list[NDArray]:
    """As `_split_steps`, for a scalar, vector or custom tensor; `counts` of each step decide which."""
    if _is_one_number(values):
        raise SceneError(
            f"{name!r} is one number, neither an argument nor an array: a variable of your own has a row for each "
            f"particle or contact, such as numpy.full(n, {values})"
        )
    if len(values) == len(counts) and all(
        np.shape(v)[:1] == (n,) for v, n in zip(values, counts, strict=True)
    ):
        return [np.asarray(v) for v in values]
    array = np.asarray(values)
    if (
        counts
        and set(counts) == {len(array)}
        and (len(counts) == 1 or not name.startswith("contact_"))
    ):
        return [array]
    if name.startswith("contact_") and not any(counts):
        raise SceneError(
            f"{name!r} is a variable of contacts, as its name begins with 'contact_', and there are none: give them as "
            "contact_i= and contact_j=, or give a variable of particles another name"
        )
    shown = ", ".join(map(str, counts[:3]))
    if len(counts) > 3:
        shown += ", ..."
    raise SceneError(
        f"{name!r} has shape {getattr(values, 'shape', (len(values), '...'))}: expected (n,), (n, 3) or (n, 3, 3) for "
        f"a step, with n = {shown}, and one such array for each of {len(counts)} steps"
    )


def scene_from_arrays(
    position: ArrayLike | Sequence[ArrayLike],
    *,
    time: ArrayLike | None = None,
    step: ArrayLike | None = None,
    box: ArrayLike | Mapping[str, Sequence[float]] | None = None,
    periodic: str | bool | Sequence[str] | Sequence[bool] = "",
    lattice: ArrayLike | Mapping[str, ArrayLike] | None = None,
    shear_rate: Mapping[str, ArrayLike] | None = None,
    gravity: Sequence[float] | None = None,
    dimension: int = 3,
    plane: str | None = None,
    thickness: float | None = None,
    shape: Shape = "sphere",
    density: ArrayLike | None = None,
    units: Mapping[str, float] | str | None = None,
    allow_unknown: bool = False,
    sides: Sides = "mean",
    **variables: Any,
) -> xr.Dataset:
    """Build a scene from arrays in memory.

    Every variable may be one step ``(n, ...)``, a stack of steps ``(t, n, ...)``, or a list of
    steps of different length. Variables of particles that do not change, such as diameters, may be
    given once for all steps where rows, or ids, are the same in all of them. Mass, volume, density,
    diameter and contact points that are missing are completed (`complete_particles`,
    `complete_contacts`).

    Parameters
    ----------
    position : array (n, 3), array (t, n, 3) or list of arrays
        Positions of the centres (m).
    time, step : array (t,), optional
        Times (s) and step numbers, rising; step numbers are 0, 1, 2, ... by default. Without times,
        the coordinate ``time`` is the step number, and whatever takes differences of times is
        refused.
    box : array (3, 2), array (t, 3, 2) or mapping, optional
        Edges of the domain (m), needed along periodic axes.
    periodic : str or bool
        Periodic axes, for example "xy"; True for all of the scene.
    lattice : array (3, 3), array (t, 3, 3) or mapping, optional
        Vectors a, b, c to the next periodic images (m) where they are not along x, y and z, in
        rows; `box` then holds the edges of the box without its tilt, whose lengths are the vectors'
        components along their own axes. Or tilts by name, ``{"xy": 0.01}`` (a number, or one a
        step): how far images along y are shifted along x, in boxes of Lees & Edwards the offset of
        the images.
    shear_rate : mapping, optional
        Velocity gradients of the images: ``{"xy": 0.1}`` is dv_x/dy (s-1; a number, or one a step),
        ``{"xx": -0.1}`` that of a box that is compressed along x. By default the rate at which
        tilts change from step to step; ``{}`` for images of equal velocity.
    gravity : three floats, optional
        Acceleration of gravity (m s-2).
    dimension : {2, 3}
        2 for one layer of particles in `plane`.
    plane : str, optional
        The two axes of a one-layer scene, "xy" by default.
    thickness : float, optional
        Depth of a one-layer scene (m); by default that of the box where it is finite, else the
        largest diameter.
    shape : {"sphere", "disc"}
        How volume follows from diameter.
    density : float or array
        Density of the material (kg m-3): one number, or one a particle.
    units : mapping or str, optional
        Factors to SI of arrays, time, box and lattice, for example ``{"length": 1e-3}``; gravity,
        thickness, shear_rate and a single density, diameter or mass are in SI. "reduced" for scaled data, or a unit
        system of LAMMPS by name, such as "cgs".
    allow_unknown : bool
        Take contacts with ids that are not among the particles as contacts with a wall.
    sides : {"mean", "first", "separate"}
        What becomes of contacts that are listed from both sides, (i, j, f) and (j, i, -f'), with f'
        up to a quarter from f and points up to 0.15 of the smaller radius apart: one contact with
        the mean of both sides (default), or as the first row has it, with a warning; or two. Rows
        whose forces and points agree to 1e-4 are always one; rows (i, j) in one order at different
        points always count each.
    **variables
        Other variables by their scene name: ``velocity``, ``diameter`` and ``mass`` (an array, or
        one number for all particles), ``volume``,
        ``particle_id``, ``species``, ``contact_i``, ``contact_j``, ``contact_force``,
        ``contact_point``, ... In a periodic box of less than two diameters ``contact_branch`` (from
        j to i) gives the side on which grains touch, where no point does. Any other name is a
        variable of your own, but for names that are almost one of these: of the contacts if it
        begins with ``contact_``, else of the particles; scalars ``(n,)``, vectors ``(n, 3)`` or
        tensors ``(n, 3, 3)`` a step. `coarse_grain` takes it by its name.

    Returns
    -------
    xarray.Dataset
        The scene, in memory.

    Raises
    ------
    SceneError
        If arrays disagree or do not make a scene; the message names the variable and row.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.scene_from_arrays([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], diameter=[1.0, 1.0], density=2500.0)
    >>> dict(ds.sizes)
    {'time': 1, 'particle': 2, 'component': 3}
    """
    _refuse_misspelt(variables)
    sizes: dict[str, Any] = {"density": density}
    sizes |= {name: variables.get(name) for name in ("diameter", "mass")}
    alike = {name: value for name, value in sizes.items() if _is_number(value)}
    setup = Setup.make(
        units=units,
        gravity=gravity,
        dimension=dimension,
        plane=plane,
        periodic=periodic,
        thickness=thickness,
        shape=shape,
        sides=sides,
        **alike,
    )
    values_by_name = {"position": position, **variables, "density": density}
    values_by_name = {
        name: values
        for name, values in values_by_name.items()
        if values is not None and name not in alike
    }
    for name, values in (*values_by_name.items(), ("time", time)):
        for part in values if isinstance(values, (list, tuple)) else [values]:
            refuse_mask(name, part)
    steps = {
        name: _split_steps(name, values)
        for name, values in values_by_name.items()
        if name in VARIABLES
    }
    keys = {"particle": "position", "contact": "contact_i"}
    for name in (name for name in values_by_name if name not in VARIABLES):
        key = keys[variable(name).dims[0]]
        counts = [len(values) for values in steps.get(key, [])]
        steps[name] = _split_own(name, values_by_name[name], counts)
    total = len(steps["position"])
    _repeat_what_stays(steps, total)
    numbers = np.arange(total)
    if step is not None:
        numbers = _one_for_each("step", np.atleast_1d(step), total)
    times = None
    start = None
    if time is not None:
        time, start = times_of_caller(time, "time=", setup.scales[2])
        seconds = np.atleast_1d(np.asarray(time, float)) * setup.scales[2]
        times = _one_for_each("time", seconds, total)
    rising = numbers if times is None else times
    check_times(rising, "a scene", "sort the steps, and leave out those that stand twice")
    domain = domain_of(box, lattice, shear_rate, setup.periodic, total, times, setup.scales[0])
    lattices = [
        Lattice.of(entries_of(domain, t), setup.periodic, source)
        for t, source in enumerate(_sources(total))
    ]
    particles, contacts = _completed(steps, lattices, setup, allow_unknown)
    if particles:
        check_scene(particles[0], setup, lattices[0])
        if times is not None and total > 1:
            check_motion(particles[0], particles[1], float(times[1] - times[0]), lattices[0])
    measured = measure_frames(particles)
    arrays = _stacked(particles, "particle_id") | _stacked(contacts, "contact_i")
    scene = to_dataset(arrays, time=times, step=numbers, box=domain, setup=setup, measured=measured)
    if start:
        scene = scene.assign_attrs(start=start)
    counts = [len(rows) for rows in steps["position"]]
    # rows are other particles where one was removed
    if "particle_id" not in steps and any(after < before for before, after in pairwise(counts)):
        scene["particle_id"].attrs |= ROW_NUMBERS
    return scene


def _sources(total: int) -> list[str]:
    """Names of the steps in messages."""
    return ["scene"] if total == 1 else [f"step {t}" for t in range(total)]


def _completed(
    steps: Mapping[str, list[NDArray]],
    lattices: Sequence[Lattice],
    setup: Setup,
    allow_unknown: bool,
) -> tuple[list[Frame], list[Frame]]:
    """Complete the particles and contacts of each step."""
    particle_names = [name for name in steps if variable(name).dims[0] == "particle"]
    contact_names = [name for name in steps if variable(name).dims[0] == "contact"]
    particles = []
    contacts = []
    with Once().active():
        for t, source in enumerate(_sources(len(lattices))):
            frame = _prefix(steps, particle_names, "particle_id", t, source)
            grains = complete_particles(frame, setup, source, lattices[t])
            particles.append(grains)
            if contact_names:
                frame = _prefix(steps, contact_names, "contact_i", t, source)
                contacts.append(
                    complete_contacts(
                        frame, grains, lattices[t], setup, source, allow_unknown=allow_unknown
                    )
                )
    return particles, contacts


def _stacked(frames: Sequence[Frame], key: str) -> Frame:
    """Stack the variables of frames, which are emptied, so that no more than one variable is there twice."""
    if not frames:
        return Frame()
    length = max(len(frame[key]) for frame in frames)
    arrays = Frame()
    for name in list(frames[0]):
        arrays |= stack([{name: frame.pop(name)} for frame in frames], [name], length)
    return arrays


def _one_for_each(name: str, values: NDArray, total: int) -> NDArray:
    """Return values of the steps. Raise SceneError unless there is one for each step."""
    if values.shape != (total,):
        raise SceneError(
            f"{name}= has shape {values.shape}: expected one value for each of the {total} steps"
        )
    return values


def _repeat_what_stays(steps: dict[str, list[NDArray]], total: int) -> None:
    """Repeat variables of particles that are given for one step in all steps, whose rows are the same particles.

    Raises
    ------
    SceneError
        If rows or ids differ from step to step, or variables have other numbers of steps.
    """
    for name in [name for name, values in steps.items() if len(values) != total]:
        counts = {other: len(values) for other, values in steps.items()}
        if len(steps[name]) != 1 or variable(name).dims[0] != "particle":
            raise SceneError(f"variables have different numbers of steps: {counts}")
        lengths = {len(values) for values in steps["position"]}
        if lengths != {len(steps[name][0])}:
            raise SceneError(
                f"{name!r} is given once for {total} steps, and the steps have {sorted(lengths)} particles: give a "
                "list of one array for each step"
            )
        ids = steps.get("particle_id", [])
        changed = [t for t, one in enumerate(ids) if not np.array_equal(one, ids[0])]
        if changed:
            raise SceneError(
                f"{name!r} is given once for {total} steps, and the ids of step {changed[0]} are not those of step 0: "
                "give a list of one array for each step, in the order of its ids"
            )
        steps[name] = steps[name] * total


def _is_number(value: Any) -> bool:
    """Return whether this is one number for all particles."""
    return value is not None and _is_one_number(value) and not isinstance(value, str)


def _is_one_number(values: Any) -> bool:
    """Return whether this is neither an array nor a list of steps, which may differ in length."""
    return not isinstance(values, (list, tuple)) and np.ndim(values) == 0


# Names that others use, with what to give in place of them.
_OTHER_NAMES = {
    "radius": "diameter = 2 radius",
    "radii": "diameter = 2 radii",
    "r": "diameter = 2 r",
    "d": "diameter=",
    "rho": "density=",
    "m": "mass=",
    "v": "velocity=",
    "vel": "velocity=",
    "omega": "angular_velocity=",
    "id": "particle_id=",
    "ids": "particle_id=",
    "type": "species=",
    "force": "contact_force=, with contact_i= and contact_j=",
    "dt": "time=, an array with the time of each step",
    "timestep": "time=, an array with the time of each step",
    "times": "time=",
    "t": "time=",
    "contacts": "contact_i=, contact_j=, contact_force= and contact_point=, an array for each",
    "g": "gravity=",
    "dim": "dimension=",
    "ndim": "dimension=",
}


def _refuse_misspelt(names: Iterable[str]) -> None:
    """Raise SceneError for names of variables close to a known one; ``diameter_2`` is a name of its own."""
    words = [*VARIABLES, *inspect.signature(scene_from_arrays).parameters]
    for name in names:
        suggestion = ""
        if name in _OTHER_NAMES:
            suggestion = f"; did you mean {_OTHER_NAMES[name]}?"
        elif not any(
            name.startswith(word) and not name[len(word) :][:1].isalpha() for word in words
        ):
            suggestion = _likely_name(name, words)
        if suggestion:
            raise SceneError(
                f"scene_from_arrays: {name!r} is neither an argument nor a variable of scenes{suggestion} Variables "
                "of your own need names that are less alike"
            )


def _likely_name(name: str, names: Sequence[str]) -> str:
    """Return the known name that was probably meant, as the end of a message; "" without one."""
    # all variables of contacts share this prefix, which would make them alike
    prefix = ""
    if name.startswith("contact_"):
        prefix = "contact_"
    alike = [word.removeprefix(prefix) for word in names if word.startswith(prefix)]
    likely = did_you_mean(name.removeprefix(prefix), alike, 0.77)
    return likely.replace("'", f"'{prefix}", 1)


def _prefix(
    steps: Mapping[str, list[NDArray]], names: Sequence[str], key: str, t: int, source: str
) -> Frame:
    """Drop the rows of step t that `key` marks as padding; raise SceneError for other rows with its mark."""
    frame = {name: steps[name][t] for name in names}
    if key not in frame:
        return frame
    valid = frame[key] != PADDING
    if valid.all():
        return frame
    other, what = _NOT_PADDING[key]
    values = frame.get(other, np.empty(0))
    held = values != PADDING
    if other == "position":
        held = np.isfinite(values).any(axis=1)
    if len(held) == len(valid) and (held & ~valid).any():
        index = int(np.flatnonzero(held & ~valid)[0])
        raise SceneError(
            f"{source}: row {index} has {key!r} {PADDING}, which marks a row without data, and has {other!r}: {what}"
        )
    # other lengths are refused where the frame is completed
    fitting = [name for name, values in frame.items() if len(values) == len(valid)]
    return frame | {name: frame[name][valid] for name in fitting}


# what rows of padding have not, and what to do where they have it
_NOT_PADDING = {
    "particle_id": ("position", "number particles from 0 on, or fill rows without data with NaN"),
    "contact_i": (
        "contact_j",
        "a wall must stand as 'contact_j', with the force on the particle as 'contact_force'",
    ),
}
