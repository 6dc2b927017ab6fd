"""Many files, one lazy scene: index, pair, check, and a dask graph that parses each file once."""

from __future__ import annotations

import difflib
import inspect
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.lazy import Source, Step, lazy_arrays, load_engine
from xcg.readers.paths import PathLike, expand_paths
from xcg.readers.text import where
from xcg.scene import BOX, COMPONENTS, Frame, SceneError, SceneWarning, Setup, box_array
from xcg.scene import measure_frames, periods, to_dataset

ENGINES = ("lammps", "liggghts", "mercury", "mfix")

# Factors to SI of the unit systems that headers name.
UNIT_SYSTEMS: dict[str, Mapping[str, float] | str | None] = {
    "si": None,
    "lj": "reduced",
    "cgs": {"length": 1e-2, "mass": 1e-3},
    "micro": {"length": 1e-6, "mass": 1e-15, "time": 1e-6},
    "nano": {"length": 1e-9, "mass": 1e-21, "time": 1e-9},
}

Paths = PathLike | Iterable[PathLike]


def open_scene(
    particles: Paths,
    *,
    contacts: Paths | None = None,
    walls: Paths | None = None,
    engine: str | None = None,
    names: Mapping[str, str | None] | None = None,
    times: ArrayLike | None = None,
    box: ArrayLike | Mapping[str, Sequence[float]] | None = None,
    periodic: str | None = None,
    gravity: Sequence[float] | None = None,
    density: float | None = None,
    frozen: int | Sequence[int] | None = None,
    units: Mapping[str, float] | str | None = None,
    dimension: int | None = None,
    plane: str | None = None,
    thickness: float | None = None,
    shape: str = "sphere",
    allow_unknown: bool = False,
    missing: str = "raise",
    chunks: int = 1,
    **engine_options: Any,
) -> xr.Dataset:
    """Open the output of a DEM code as a lazy scene.

    Headers are read at once; of the bodies only the first and the last step of the particles, to learn the
    variables, sizes and extent. The rest is read when it is computed, each file once for all its variables.

    Parameters
    ----------
    particles : path, glob or list of them
        Files with particles. Globs are sorted by the numbers in the names (9 before 10).
    contacts : path, glob or list of them, optional
        Files with contacts.
    walls : path, glob or list of them, optional
        Files with contacts with walls, for engines that keep them apart (LIGGGHTS ``wall/gran/local``).
    engine : {"lammps", "liggghts", "mercury", "mfix"}, optional
        What wrote the files; guessed from their first lines by default.
    names : mapping, optional
        From columns in the files to variables of the scene, beside and before what the engine knows by itself;
        None drops a column. Components are single names: ``position_x``, ``velocity_x``, ``contact_force_x``,
        ``contact_point_x``, ``contact_normal_x``, and so on for y and z. Further names are

        - ``particle_id``, ``species``, ``body_id``, ``frozen``, ``coordination_number``, ``diameter`` or
          ``radius``, ``density``, ``mass``, ``volume``; any other name is one more variable of particles,
        - ``scaled_x`` for positions in fractions of the box,
        - ``contact_i``, ``contact_j`` (the force acts on i), ``overlap``,
        - ``normal_force_x`` and ``tangential_force_x``, which add up to the contact force.
    times : array (t,), optional
        Time of each step in the particle files, in their order and in their unit of time.
    box : array (3, 2), array (t, 3, 2) or mapping, optional
        Edges of the domain in the files' unit of length, in place of the headers'.
    periodic : str, optional
        Periodic axes, for example "xy", in place of the headers'; "" for none.
    gravity : three floats, optional
        Acceleration of gravity (m s-2, or reduced).
    density : float, optional
        Density of the material (kg m-3, or reduced) for files that hold neither mass nor density.
    frozen : int or sequence of int, optional
        Species that are held in place and act as walls: they get ``frozen = 1``, all others 0.
    units : mapping, "SI" or "reduced", optional
        Factors from the files' units to SI, for example ``{"length": 1e-3}``. By default what the headers say
        (``si``, ``cgs``, ``micro``, ``nano``; ``lj`` is "reduced"), and SI where they say nothing.
    dimension : {2, 3}, optional
        By default 2 where all particles lie in one plane across an axis (and `plane` is that plane), else 3.
    plane, thickness, shape
        Of scenes with one layer of particles, see `xcg.scene.Setup`.
    allow_unknown : bool
        Take contacts with ids that are not among the particles as contacts with a wall.
    missing : {"raise", "skip"}
        What to do with steps of particles without a step of contacts: raise an error that lists them, or leave
        them out with a warning.
    chunks : int
        Steps in a chunk; -1 for all in one.
    **engine_options
        Of one engine only. LAMMPS and LIGGGHTS: ``timestep``, the time between two steps of the simulation, for
        files without ``ITEM: TIME``. MercuryDPM: ``restart``, the restart file with gravity, periodic boundaries
        and densities (by default the one beside the ``.data`` file).

    Returns
    -------
    xarray.Dataset
        The scene, with dask arrays: ``position`` and ``velocity`` (time, particle, component) in m and m s-1,
        ``diameter``, ``mass``, ... (time, particle), ``contact_force`` and ``contact_point`` (time, contact,
        component) in N and m, ... Rows fill a prefix, sorted by id; the rest is padding (``particle_id == -1``,
        ``contact_i == -1``, NaN). ``box`` (time, component, bound) is in memory.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a glob matches nothing.
    SceneError
        If the files are not what they should be; the message names file, step and row or column. Faults in
        bodies appear when they are read.

    Warns
    -----
    SceneWarning
        If a step occurs twice (the later one counts), or steps are left out.

    Notes
    -----
    Particles and contacts are paired by time where both kinds of file hold it, else by step number. Contacts of
    steps without particles are left out with a warning.

    Where neither files, `times` nor ``timestep`` tell the time, the coordinate ``time`` is the step number, and
    its ``long_name`` says so.

    Examples
    --------
    >>> ds = xcg.open_scene("particles.*.dump", contacts="contacts.*.dump")  # doctest: +SKIP
    >>> ds = xcg.open_scene(
    ...     "compress*.liggghts", contacts="pair*.txt", walls="wall_pair*.txt", density=2500, timestep=1e-5
    ... )  # doctest: +SKIP
    >>> ds = xcg.open_scene("run.data", contacts="run.fstat", engine="mercury")  # doctest: +SKIP
    >>> ds = xcg.open_scene(
    ...     "p.dump", contacts="c.dump", names={"c_1[1]": "contact_i", "c_1[2]": "contact_j", "c_nc": "coordination_number"}
    ... )  # doctest: +SKIP
    """
    if missing not in ("raise", "skip"):
        msg = f"missing={missing!r}: expected 'raise' or 'skip'"
        raise SceneError(msg)
    files = {
        argument: expand_paths(paths, argument)
        for argument, paths in (("particles", particles), ("contacts", contacts), ("walls", walls))
        if paths is not None
    }
    name = engine or _guess_engine(files)
    reader = _engine(name)
    options = ReadOptions(dict(names or {}), engine_options)
    _check_options(reader, name, options)
    indexed = _index(reader, name, files, options)
    _check_names(indexed, options)
    steps = _pair(indexed, times, missing)

    first, last = steps[0].particles, steps[-1].particles
    raw = {ref: Source(name, options).read(ref) for ref in dict.fromkeys((first, last))}
    flat = _flat_plane(list(raw.values()))
    if dimension is None:
        dimension = len(plane or flat or COMPONENTS)
    if dimension == 2:
        plane = plane or flat or "xy"
    setup = Setup.make(
        units=_units(indexed, units), gravity=gravity, dimension=dimension, plane=plane, thickness=thickness,
        shape=shape, density=density, periodic=_periodic(first, plane) if periodic is None else periodic,
    )  # fmt: skip
    if gravity is None and first.gravity is not None:
        x, y, z = (g * setup.factor((1, 0, -2)) for g in first.gravity)
        setup = replace(setup, gravity=(x, y, z))
    edges = _boxes(steps, box, setup)
    source = Source(name, options, setup, _species(frozen), allow_unknown)
    ends = [source.complete(frame, ref) for ref, frame in raw.items()]
    scene = to_dataset(
        lazy_arrays(
            source, steps, edges, {key: values.dtype for key, values in ends[0].items()},
            _contact_names(reader, source, steps[0]), _steps_per_chunk(chunks, len(steps)),
        ),
        time=[step.particles.step if step.time is None else step.time * setup.scales[2] for step in steps],
        step=[step.particles.step for step in steps],
        box=edges,
        setup=setup,
        measured=measure_frames(ends),
    )  # fmt: skip
    if steps[0].time is None:
        unknown = "number of the time step, as the files hold no time (give timestep= or times=)"
        scene["time"].attrs.update(units="1", long_name=unknown)
    return scene


# --- the engine and its options --------------------------------------------------------------------------


def _engine(name: str) -> Engine:
    if name not in ENGINES:
        msg = f"engine={name!r}: expected one of {', '.join(ENGINES)}{_did_you_mean(name, ENGINES)}"
        raise SceneError(msg)
    return load_engine(name)


def _did_you_mean(word: str, words: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(words), 1)
    return f"; did you mean {close[0]!r}?" if close else ""


def _guess_engine(files: Mapping[str, Sequence[str]]) -> str:
    firsts = [paths[0] for paths in files.values()]
    for name in ENGINES:
        engine = load_engine(name)
        if all(engine.recognises(path) for path in firsts):
            return name
    msg = (
        f"no engine recognises {' together with '.join(map(repr, firsts))}; name one with engine=: {', '.join(ENGINES)}"
    )
    raise SceneError(msg)


def _check_options(reader: Engine, name: str, options: ReadOptions) -> None:
    known = getattr(reader, "OPTIONS", options.extra)
    unknown = [option for option in options.extra if option not in known]
    if unknown:
        words = [*inspect.signature(open_scene).parameters, *known]
        msg = (
            f"open_scene has no argument {unknown[0]!r}{_did_you_mean(unknown[0], words)} "
            f"(options of the engine '{name}': {', '.join(known) or 'none'})"
        )
        raise SceneError(msg)


# --- the index: checks over a series ---------------------------------------------------------------------


def _index(
    reader: Engine, name: str, files: Mapping[str, Sequence[str]], options: ReadOptions
) -> dict[str, list[StepRef]]:
    """Index each kind of file, and check that nothing changes along the way."""
    if "walls" in files and not hasattr(reader, "index_walls"):
        msg = f"walls=: files of the engine '{name}' hold contacts with walls among the others; give contacts= only"
        raise SceneError(msg)
    indexed = {}
    for kind, paths in files.items():
        refs = getattr(reader, f"index_{kind}")(paths, options)
        if not refs:
            msg = f"{kind}: no step in {', '.join(paths[:3])}{', ...' if len(paths) > 3 else ''}"
            raise SceneError(msg)
        for ref in refs[1:]:
            _check_same(refs[0], ref)
        indexed[kind] = refs
    return indexed


def _check_same(first: StepRef, ref: StepRef) -> None:
    """Refuse a step that differs in kind from the first of its series; say all that differs."""
    problems = []
    if set(ref.columns) != set(first.columns):
        lacks, adds = set(first.columns) - set(ref.columns), set(ref.columns) - set(first.columns)
        problems += [f"column '{column}' is in the first only" for column in sorted(lacks)]
        problems += [f"column '{column}' is in the second only" for column in sorted(adds)]
    for what, one, other in (
        ("periodic axes", first.periodic, ref.periodic),
        ("unit system", first.units, ref.units),
    ):
        if one != other:
            problems.append(f"the {what}: {one!r} became {other!r}")
    for what, one, other in (("box", first.box, ref.box), ("time", first.time, ref.time)):
        if (one is None) != (other is None):
            problems.append(f"the {what} is in the {'second' if one is None else 'first'} only")
    if problems:
        msg = (
            f"{where(first)} and {where(ref)} differ: {'; '.join(problems)}. A series must be of one kind: open "
            "such files apart"
        )
        raise SceneError(msg)


def _check_names(indexed: Mapping[str, Sequence[StepRef]], options: ReadOptions) -> None:
    columns = {column for refs in indexed.values() for column in refs[0].columns}
    unknown = [column for column in options.names if column not in columns]
    if unknown and columns:
        msg = (
            f"names={{{unknown[0]!r}: ...}}: the files have no such column{_did_you_mean(unknown[0], columns)} "
            f"(they have {', '.join(sorted(columns))})"
        )
        raise SceneError(msg)


# --- particles with their contacts -----------------------------------------------------------------------


def _pair(indexed: Mapping[str, list[StepRef]], times: ArrayLike | None, missing: str) -> list[Step]:
    """Steps of particles in the order of time, each with its contacts."""
    refs = indexed["particles"]
    known: list[float | None] = [ref.time for ref in refs]
    if times is not None:
        given = np.asarray(times, float)
        if given.shape != (len(refs),) or not np.isfinite(given).all():
            msg = f"times has shape {given.shape}: expected {len(refs)} finite numbers, one for each step of the particles"
            raise SceneError(msg)
        known = given.tolist()
    steps = _in_order([Step(ref, (), time) for ref, time in zip(refs, known, strict=True)], "particles")
    for kind in ("contacts", "walls"):
        if kind in indexed:
            steps = _join(steps, kind, indexed[kind], missing)
    return steps


def _in_order(steps: list[Step], kind: str) -> list[Step]:
    """Sort by time (by number where there is none) and drop all but the last of equal ones."""
    unique: dict[float, Step] = {}
    for step in steps:
        key = step.particles.step if step.time is None else step.time
        if key in unique:
            old, new = unique[key].particles, step.particles
            msg = (
                f"{kind}: {where(old)} and {where(new)} are of the same time, and the second is taken; if they are "
                "not the same, give times="
            )
            warnings.warn(msg, SceneWarning, stacklevel=5)
        unique[key] = step
    return [unique[key] for key in sorted(unique)]


def _join(steps: list[Step], kind: str, refs: list[StepRef], missing: str) -> list[Step]:
    """Give each step its contacts: of the same time where both have one, else of the same number."""
    others = [step.particles for step in _in_order([Step(ref, (), ref.time) for ref in refs], kind)]
    timed = others[0].time is not None and steps[0].particles.time is not None
    partner = _same_time(steps, others) if timed else _same_number(steps, others)
    unused = set(range(len(others))) - set(partner)
    lacking = [step.particles for step, row in zip(steps, partner, strict=True) if row < 0]
    what = "time" if timed else "step number"
    if lacking and (missing == "raise" or len(lacking) == len(steps)):
        msg = (
            f"{kind}: none of the same {what} for {len(lacking)} of {len(steps)} steps of the particles "
            f"({_some(lacking)}); {kind} there are: {_some(others)}. Give the files that are missing, or leave such "
            "steps out with missing='skip'"
        )
        raise SceneError(msg)
    if lacking:
        _warn(f"{len(lacking)} of {len(steps)} steps have no {kind} and are left out: {_some(lacking)}")
    if unused:
        _warn(f"{len(unused)} steps of {kind} have no particles and are left out: {_some([others[k] for k in sorted(unused)])}")
    return [
        replace(step, contacts=(*step.contacts, others[row]))
        for step, row in zip(steps, partner, strict=True)
        if row >= 0
    ]


def _same_number(steps: Sequence[Step], others: Sequence[StepRef]) -> list[int]:
    rows = {ref.step: row for row, ref in enumerate(others)}
    return [rows.get(step.particles.step, -1) for step in steps]


def _same_time(steps: Sequence[Step], others: Sequence[StepRef]) -> list[int]:
    """Rows of the contacts nearest in time, -1 where they are further than a thousandth of the interval."""
    wanted = np.array([step.particles.time for step in steps], float)
    there = np.array([ref.time for ref in others], float)
    interval = np.diff(np.unique(wanted)).min() if len(wanted) > 1 else abs(wanted[0])
    nearest = [int(np.argmin(np.abs(there - time))) for time in wanted]
    return [row if abs(there[row] - time) <= 1e-3 * interval else -1 for row, time in zip(nearest, wanted, strict=True)]


def _some(refs: Sequence[StepRef]) -> str:
    names = [where(ref) for ref in refs[:3]]
    return ", ".join([*names, "..."] if len(refs) > 3 else names)


def _warn(msg: str) -> None:
    warnings.warn(msg, SceneWarning, stacklevel=5)


# --- what holds for the whole scene ----------------------------------------------------------------------


def _units(
    indexed: Mapping[str, Sequence[StepRef]], units: Mapping[str, float] | str | None
) -> Mapping[str, float] | str | None:
    """Units as the caller says, else as the headers do, else SI."""
    if units is not None:
        return units
    named = {refs[0].units: refs[0] for refs in indexed.values() if refs[0].units is not None}
    if len(named) > 1:
        msg = f"headers name different unit systems: {', '.join(f'{u!r} in {where(ref)}' for u, ref in named.items())}"
        raise SceneError(msg)
    for system, ref in named.items():
        if system not in UNIT_SYSTEMS:
            msg = (
                f"{where(ref)}: the header names the unit system {system!r}, known are {', '.join(UNIT_SYSTEMS)}; "
                "give the factors to SI, for example units={'length': 1e-10, 'mass': 1e-3, 'time': 1e-15}"
            )
            raise SceneError(msg)
        return UNIT_SYSTEMS[system]
    return None


def _flat_plane(frames: Sequence[Frame]) -> str | None:
    """Axes of the plane that all particles lie in, None where they do not."""
    positions = [frame["position"] for frame in frames]
    if any(len(position) < 3 for position in positions):
        return None
    extended = [k for k in range(3) if any((position[:, k] != position[0, k]).any() for position in positions)]
    return "".join(COMPONENTS[k] for k in extended) if len(extended) == 2 else None


def _periodic(ref: StepRef, plane: str | None) -> str:
    """Periodic axes of the header; LAMMPS calls a two-dimensional box periodic across its plane, too."""
    return "".join(axis for axis in ref.periodic or "" if axis in (plane or COMPONENTS))


def _boxes(steps: Sequence[Step], box: Any, setup: Setup) -> NDArray | None:
    """Edges of the domain at each step, in the scene's units."""
    if box is None:
        if steps[0].particles.box is None:
            edges = None
        else:
            edges = box_array([step.particles.box for step in steps], len(steps))
    else:
        edges = box_array(box, len(steps))
    if edges is not None:
        edges = edges * setup.factor(BOX.powers)
    for t, step in enumerate(steps):
        periods(None if edges is None else edges[t], setup.periodic, where(step.particles))
    return edges


def _species(frozen: int | Sequence[int] | None) -> tuple[int, ...] | None:
    return None if frozen is None else tuple(int(species) for species in np.atleast_1d(frozen))


def _contact_names(reader: Engine, source: Source, step: Step) -> list[str]:
    """Variables that the contacts of all files have, told from headers where the engine can."""
    told = getattr(reader, "contact_variables", None)
    names: list[str] = []
    for ref in step.contacts:
        found = told(ref, source.options) if told else source.read(ref, contacts=True)
        here = list(dict.fromkeys([*found, "contact_point"]))
        names = [name for name in names if name in here] if names else here
    return names


def _steps_per_chunk(chunks: int, steps: int) -> int:
    if chunks != int(chunks) or (chunks < 1 and chunks != -1):
        msg = f"chunks={chunks!r}: expected the number of steps in a chunk, or -1 for all"
        raise SceneError(msg)
    return steps if chunks == -1 else int(chunks)
