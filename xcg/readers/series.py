"""Many files, one lazy scene: index, pair, check, and a dask graph that parses each file once."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import floats
from xcg.common.messages import Once, SceneError, did_you_mean, warn_user
from xcg.readers.columns import read_names, report_missing_ids, split_names
from xcg.readers.engine import Engine, ReadOptions, StepRef, load_engine
from xcg.readers.files.text import source_of
from xcg.readers.lazy import Chunks, Series, Source, Step, indexed_arrays, lazy_arrays, read_step
from xcg.readers.pairs import index_files, origin_of, pair_steps
from xcg.readers.paths import PathLike, expand_paths, not_against_headers, units_of_headers
from xcg.readers.recognise import guess_engine
from xcg.readers.saved import open_saved, saved_path
from xcg.scene.box import domain_of
from xcg.scene.build import to_dataset
from xcg.scene.complete import complete_particles
from xcg.scene.conform import ROW_NUMBERS
from xcg.scene.contacts import named_walls
from xcg.scene.frame import measure_frames
from xcg.scene.lattice import Lattice
from xcg.scene.sanity import check_sizes
from xcg.scene.schema import COMPONENTS, VARIABLES, Frame, Setup, Shape, Sides
from xcg.steps import faults as errors
from xcg.steps.faults import FAULTS, OnError, check_on_error, collecting

_RECOVERY_STEPS = 10  # files of contacts that are read for a period, where files do not tell it
_OF_SAVED = (
    "particles",
    "chunks",
    "on_error",
    "engine_options",
)  # what a scene that was saved takes

Paths = PathLike | Iterable[PathLike]


# what becomes of steps of particles without contacts
Missing: TypeAlias = Literal["raise", "skip", "empty"]


def open_scene(
    particles: Paths,
    *,
    contacts: Paths | None = None,
    walls: Paths | Mapping[str, str | Sequence[str]] | None = None,
    engine: str | Engine | type[Engine] | None = None,
    names: Mapping[str, Any] | Sequence[str | None] | str | None = None,
    times: ArrayLike | None = None,
    box: ArrayLike | Mapping[str, Sequence[float]] | None = None,
    periodic: str | None = None,
    lattice: ArrayLike | Mapping[str, ArrayLike] | None = None,
    shear_rate: Mapping[str, ArrayLike] | None = None,
    gravity: Sequence[float] | None = None,
    density: float | None = None,
    frozen: int | Sequence[int] | None = None,
    units: Mapping[str, float] | str | None = None,
    dimension: int | None = None,
    plane: str | None = None,
    thickness: float | None = None,
    shape: Shape | None = None,
    allow_unknown: bool = False,
    sides: Sides = "mean",
    missing: Missing = "raise",
    chunks: Chunks = "auto",
    on_error: OnError = "raise",
    **engine_options: Any,
) -> xr.Dataset:
    """Open the output of a DEM code as a lazy scene.

    Headers are read at once; of the bodies only the first and the last step of the particles, to learn the
    variables, sizes and extent. The rest is read when it is computed, each file once for all its variables.

    Parameters
    ----------
    particles : path, glob or list of them
        Files with particles. Globs are sorted by the numbers in them (9 before 10, 0.15 before
        0.2). Or one scene that xcg saved (``.zarr``, or ``.nc``, which may be called ``.nc4``,
        ``.h5`` or ``.hdf5``), beside which there are `chunks` and `on_error` only.
    contacts : path, glob or list of them, optional
        Files with contacts.
    walls : path, glob or list of them, or mapping, optional
        Files with contacts with walls, for engines that keep them apart (LIGGGHTS ``wall/gran/local``). For LAMMPS,
        whose ``fix wall/gran ... contacts`` puts them into columns of the particles, a mapping from names of walls to
        these columns: ``{"side": "f_side[*]"}``, or the names of six columns, force and point. The walls are partners
        -2, -3, ... in their order; see `xcg.select_walls`.
    engine : str or Engine, optional
        What wrote the files, one of {"lammps", "liggghts", "mercury", "mfix", "yade", "xyz",
        "table", "h5md", "hdf5", "vtk"}, guessed from their first bytes by default; the name of an
        engine that an installed package registers; or a class or object derived from
        `xcg.readers.Engine`.
    names : mapping, list or text, optional
        From columns in the files to variables of the scene, before what the engine knows by itself; None
        drops a column. Components are single names: ``position_x``, ``velocity_x``, ``contact_force_x``,
        ``contact_point_x``, ``contact_normal_x``, and so on for y and z. Further names are

        - ``particle_id``, ``species``, ``body_id``, ``frozen``, ``coordination_number``, ``diameter`` or
          ``radius``, ``density``, ``mass``, ``volume``; any other name is one more variable of particles,
        - ``scaled_x`` for positions in fractions of the box,
        - ``contact_i``, ``contact_j`` (the force acts on i), ``overlap``,
        - ``contact_branch_x`` for the vector from j to i as the code saw it: in periodic boxes of less than two
          diameters it is the side on which grains touch (LAMMPS: ``dx dy dz``, taken by themselves),
        - ``normal_force_x`` and ``tangential_force_x``, which add up to the contact force.

        For LIGGGHTS, the words of ``compute pair/gran/local`` and ``wall/gran/local`` in any order, such as
        ``"pos id force contactArea delta history"`` or a list of them; ``{"contacts": "pos id force delta", "walls":
        "pos id force"}`` where they differ.
        For tables without a line of names (CSV, or text with blanks) a list of the names of all columns in their
        order, ``["id", "x", "y", "z", None, "radius"]``, where None skips a column; with files of contacts
        ``{"particles": [...], "contacts": [...]}``.
    times : array (t,), optional
        Time of each step in the particle files, in their order and in their unit of time. Pieces of one step have the
        same time. Contacts whose steps are listed as those of the particles get these times, too.
    box : array (3, 2), array (t, 3, 2) or mapping, optional
        Edges of the domain in the files' unit of length, in place of the headers'.
    periodic : str, optional
        Periodic axes, for example "xy", in place of the headers'; "" for none.
    lattice : array (3, 3), array (t, 3, 3) or mapping, optional
        Vectors a, b, c to the next periodic images of a tilted box, or its tilts by name, ``{"xy": 0.01}``, in the
        files' unit of length, in place of the headers' (see `xcg.scene_from_arrays`). In boxes of Lees & Edwards the
        tilt is the offset of the images.
    shear_rate : mapping, optional
        Velocity gradients of the images: ``{"xy": 0.1}`` is dv_x/dy (s-1; a number, or one a step).
        By default the rate at which tilts change from step to step, which is right where particles that leave a sheared
        box change their velocity (LAMMPS: ``fix deform ... remap v``); ``{}`` for images of equal velocity (``remap
        x``).
    gravity : three floats, optional
        Acceleration of gravity (m s-2, or reduced).
    density : float, optional
        Density of the material (kg m-3, or reduced) for files that hold neither mass nor density.
    frozen : int or sequence of int, optional
        Species that are held in place and act as walls: they get ``frozen = 1``, all others 0.
    units : mapping or str, optional
        Factors from the files' units to SI, for example ``{"length": 1e-3}``; "SI", "reduced", or a unit system of
        LAMMPS by name ("lj", "si", "cgs", "micro", "nano"). By default what the headers say
        (``si``, ``cgs``, ``micro``, ``nano``; ``lj`` is "reduced"), and SI where they say nothing (LAMMPS: with a
        warning). What contradicts the headers is refused.
    dimension : {2, 3}, optional
        By default what the files say (2 in MercuryDPM's ``.data`` of 8 columns, and where its ``.restart`` states two
        dimensions of the system or of the particles), or 2 where all particles lie in one plane across an axis (and
        `plane` is that plane), else 3.
    plane : str, optional
        The two axes of a one-layer scene, for example "xz".
    thickness : float, optional
        Depth of a one-layer scene (m); by default 1 unit of length where files say that grains are discs, else that of
        the box where it is finite, else the largest diameter.
    shape : {"sphere", "disc"}, optional
        How volume follows from diameter. By default what the files say (``particleDimensions`` in the ``.restart`` of
        MercuryDPM), else spheres.
    allow_unknown : bool
        Take contacts with ids that are not among the particles as contacts with a wall.
    sides : {"mean", "first", "separate"}
        What becomes of contacts that are listed from both sides, (i, j, f) and (j, i, -f'), with f' up to a quarter
        from f and points up to 0.15 of the smaller radius apart: one contact with the mean of both sides
        (default), or as the first row has it, with a warning; or two. Rows whose forces and points agree to 1e-4 are
        always one; rows (i, j) in one order at different points always count each.
    missing : {"raise", "skip", "empty"}
        What to do about steps of particles without a step of contacts: raise an error that lists them, leave them out
        with a warning, or take them as steps in which nothing touches (MFiX writes no file of contacts then).
    chunks : int, "auto", mapping or None
        Steps in a chunk, as xarray takes it: a number; -1 for all in one; "auto" (default) for as many as make a task
        of a tenth of a second or more, by the rows and bytes in the headers, but no more than dask's
        ``array.chunk-size`` (128 MiB) of arrays: one of 100,000 grains, tens of 1000; a mapping such as
        ``{"time": 10}`` or ``{"time": (10, 5)}``. Rows of a step stay together. None gives arrays without dask,
        which are read when they are used and then kept.
    on_error : {"raise", "skip"}
        What to do about files that are missing from a list, empty, or garbled or cut off in a header: stop with an
        error that names the file (default), or leave out what cannot be indexed, with a warning and the attribute
        ``skipped_files``; the whole steps of a file of many steps stay. Faults in bodies appear when these are
        computed, see ``on_error`` of `xcg.coarse_grain`.
    **engine_options
        Of one engine only. LAMMPS, LIGGGHTS, XYZ, tables, HDF5 and VTK: ``timestep``, the time
        between two steps of the simulation, for files without times. HDF5: ``mapping``, from
        variables to datasets. H5MD: ``group``, the name of the group of particles, where there are
        several. MercuryDPM:
        ``restart``, the restart file with gravity, dimensions, boundaries and densities (by default the one beside the
        ``.data`` file).

    Returns
    -------
    xarray.Dataset
        The scene, with dask arrays: ``position`` and ``velocity`` (time, particle, component) in m and m s-1,
        ``diameter``, ``mass``, ... (time, particle), ``contact_force`` and ``contact_point`` (time, contact,
        component) in N and m, ... Rows fill a prefix, particles sorted by id; the rest is padding
        (``particle_id == -1``, ``contact_i == -1``, NaN). ``box`` (time, component, bound) is in memory.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a glob matches nothing.
    SceneError
        If the files are not what they should be; the message names file, step and row or column. Faults in
        bodies appear when they are read. Also if names of files do not tell which of their numbers is the step, if
        steps go back within a file, if steps of two runs would be mixed, or if a piece of a step is missing.

    Warns
    -----
    SceneWarning
        If a step occurs twice with the same particles (the later one counts), steps are left out, a
        LAMMPS file does not name its units, files of contacts are of another box, or columns look
        like forces or contacts with walls and are not read. If contacts contradict the positions
        and radii of spheres (no force across a gap, a false overlap, a point off both surfaces), or
        most particles are of one body; the message says what becomes of these.

    Notes
    -----
    A file of one step that states neither time nor number has them in its name: a decimal is a time, and of several
    numbers the one that varies from file to file counts. Files of one step that have no particle (or no pair of
    grains in contact) in common are its pieces, and are joined.

    Particles and contacts are paired by time where both kinds of file hold it, else by step number.
    One file of particles and one of contacts, given by name, are paired whatever the numbers in
    their names. Contacts of steps without particles are left out with a warning.

    Steps that share one text file are read from where they begin. In a gzipped file they are reached by
    decompressing all before them, going on from the last step that was read.

    What the headers of files said is remembered in the user's cache until the files change
    (``XCG_INDEX_CACHE=0`` turns this off).

    Without times in the files, `times` or ``timestep``, the coordinate ``time`` is the step number, its ``long_name``
    says so, and what takes differences of times is refused.

    Images of grains in files (``ix iy iz``) and unwrapped positions (``xu yu zu``) become ``image``, the periods that
    each grain went through; without it, grains are taken to move less than half a period from step to step.

    Values in the files come before `density`, and box, periodicity and gravity given here before those in the
    files.

    Examples
    --------
    >>> ds = xcg.open_scene("particles.*.dump", contacts="contacts.*.dump")  # doctest: +SKIP
    >>> ds = xcg.open_scene(
    ...     "compress*.liggghts", contacts="pair*.txt", walls="wall_pair*.txt", density=2500, timestep=1e-5
    ... )  # doctest: +SKIP
    >>> ds = xcg.open_scene("run.data", contacts="run.fstat", engine="mercury")  # doctest: +SKIP
    >>> ds = xcg.open_scene(
    ...     "particles.dump", contacts="contacts.dump",
    ...     names={"c_nc": "coordination_number", "c_1[1]": "contact_i", "c_1[2]": "contact_j"},
    ... )  # doctest: +SKIP
    """
    given = locals()
    tolerate = (
        collecting if check_on_error(on_error) == "skip" else lambda: nullcontext(dict[Any, str]())
    )
    if engine is None and "mapping" not in engine_options and (saved := saved_path(particles)):
        _refuse_beside(saved, given)
        return open_saved(saved, chunks)
    if missing not in get_args(Missing):
        raise SceneError(f"missing={missing!r}: expected 'raise', 'skip' or 'empty'")
    in_columns = dict(walls) if isinstance(walls, Mapping) else {}
    about_walls = named_walls(in_columns) if in_columns else {}
    kinds = {
        "particles": particles,
        "contacts": contacts,
        "walls": None if isinstance(walls, Mapping) else walls,
    }
    with tolerate() as left_out:
        files = {
            kind: expand_paths(paths, kind) for kind, paths in kinds.items() if paths is not None
        }
        if engine is None and "mapping" in engine_options:
            engine = "hdf5"
        engine = engine or _engine_of_names(names, files)
        reader = load_engine(engine or guess_engine(files))
        _check_options(reader, engine_options)
        words: dict[str, tuple[str, ...]] = {}
        in_order: dict[str, Sequence[str | None]] = {}
        if reader.name == "liggghts" or isinstance(names, str):
            mapped, words = split_names(names)
        else:
            mapped, in_order = read_names(names)
        if words and reader.name != "liggghts":
            raise SceneError(
                f"names={names!r}: expected a mapping from columns to variables; words of a compute are for the engine "
                f"'liggghts', not {reader.name!r}"
            )
        if in_order and not reader.NAMES_IN_ORDER:
            raise SceneError(
                f"names={names!r}: the engine '{reader.name}' reads the names of columns from the files; map them, "
                "names={'column': 'variable'}"
            )
        extra = {
            **engine_options,
            "missing": "raise" if missing != "skip" and on_error == "raise" else "skip",
        }
        answers = frozenset(
            name for name in ("periodic", "lattice", "shape") if given[name] is not None
        )
        options = ReadOptions(
            mapped, extra, in_columns, words, answers, columns=in_order, alone=True
        )
        said = {"periodic": periodic, "units": units, "box": box, "time": times}
        indexed = index_files(
            reader, files, options, [what for what, given in said.items() if given is None]
        )
        if left_out and missing == "empty":
            _refuse_guesses(left_out, files)
        together = all(
            [str(paths)] == files[kind] for kind, paths in kinds.items() if paths is not None
        )
        missing = "skip" if missing == "raise" and left_out else missing
        steps = pair_steps(reader, options, indexed, times, missing, together=together)
        if in_columns:
            beside = [
                [reader.wall_step(ref, options) for ref in step.particles.parts] for step in steps
            ]
            steps = [
                replace(step, contacts=(*step.contacts, *refs))
                for step, refs in zip(steps, beside, strict=True)
            ]
    if max(step.particles.step for step in steps) < 0:  # neither files nor their names tell any
        steps = [
            replace(step, particles=replace(step.particles, step=k)) for k, step in enumerate(steps)
        ]
    of_files = steps[0].particles
    if shape is None and of_files.shape == "disc" and thickness is None:
        unit_system = units_of_headers(indexed) if units is None else units
        thickness = Setup.make(units=unit_system).scales[0]
    shape = shape or of_files.shape or "sphere"
    once = Once()
    with (
        tolerate(),
        once.active(),
    ):  # steps that cannot be read stay in the scene; their faults are told when they are computed
        raw = _ends(
            reader,
            options,
            steps,
            partial(Setup.make, shape=shape, thickness=thickness, density=density),
        )
    # most messages name the file already; of one with many steps, the place goes on with " from byte ..."
    skipped = [
        c if p.partition(" from byte ")[0] in c else f"{p}: {c}" for p, c in left_out.items()
    ]
    for cause in skipped:
        warn_user(f"left out: {cause}")
    unnamed = (
        units is None
        and reader.UNNAMED_UNITS
        and all(refs[0].units is None for refs in indexed.values())
    )
    if unnamed:
        warn_user(
            f"{source_of(indexed['particles'][0])}: the header does not name the units, and SI is taken; say "
            f"units='SI', 'reduced' (LAMMPS's lj) or factors such as {{'length': 1e-3}}, or {reader.UNNAMED_UNITS}"
        )

    nameless = not reader.ROWS_ARE_IDS and any("particle_id" not in f for f in raw.values())
    if nameless:
        contacts_by_id = any(step.contacts for step in steps)
        report_missing_ids(steps[0].particles, len(steps), contacts=contacts_by_id)
    first = next(iter(raw))
    flat = _flat_plane(list(raw.values()))
    if dimension is None:
        dimension = len(plane) if plane else of_files.dimension or len(flat or COMPONENTS)
    if dimension == 2:
        plane = plane or flat or "xy"
    if periodic is not None and box is None and first.box is None:
        periodic = _within(
            flat, periodic
        )  # no file tells the period across a layer, and nothing depends on it
    setup = Setup.make(
        units=units_of_headers(indexed) if units is None else not_against_headers(units, indexed),
        gravity=gravity,
        dimension=dimension,
        plane=plane,
        thickness=thickness,
        shape=shape,
        density=density,
        sides=sides,
        periodic=_within(plane, first.periodic or "") if periodic is None else periodic,
    )
    if gravity is None and first.gravity is not None:
        x, y, z = (g * setup.factor((1, 0, -2)) for g in first.gravity)
        setup = replace(setup, gravity=(x, y, z))
    if box is None and first.box is None:
        box = _recovered_box(
            reader, options, steps, setup.periodic, raw, skipping=on_error == "skip"
        )
    clock = [step.time for step in steps if step.time is not None]
    time = np.array(clock) * setup.scales[2] if clock else None
    domain = _domain(steps, box, lattice, shear_rate, setup, time)
    source = Source(
        reader,
        options,
        setup,
        None if frozen is None else _frozen_species(frozen, raw),
        allow_unknown,
        once,
    )
    ends = []
    for ref in list(raw):
        t = next(t for t, step in enumerate(steps) if step.particles is ref)
        box_of_step = {name: values[t] for name, values in domain.items()}
        ends.append(source.complete(raw.pop(ref), ref, box_of_step))
        source.opened.keep(ref, ends[-1])
    check_sizes(ends[0], setup)
    types = {
        name: ends[0][name].dtype
        for name in dict.fromkeys([*VARIABLES, *ends[0]])
        if name in ends[0]
    }
    contact_names = _contact_names(
        source, next((step for step in steps if step.contacts), steps[0])
    )
    series = Series(source, steps, domain, types, contact_names)
    arrays = indexed_arrays(series) if chunks is None else lazy_arrays(series, chunks)
    numbers = [step.particles.step for step in steps]
    scene = to_dataset(
        arrays,
        time=time,
        step=numbers,
        box=domain,
        setup=setup,
        measured=measure_frames(ends),
    )
    if unnamed:
        scene.attrs["assumed_units"] = "SI"
    if nameless:
        scene["particle_id"].attrs |= ROW_NUMBERS
    scene.attrs |= origin_of(reader, files, options, steps) | about_walls
    if left_out:
        scene.attrs["skipped_files"] = "\n".join(skipped)
    return scene


def _engine_of_names(names: Any, files: Mapping[str, Sequence[str]]) -> str | None:
    """Return the engine that takes names in the order of the columns; None where names are a mapping or absent."""
    given = names.values() if isinstance(names, Mapping) else [names]
    if not any(isinstance(of_kind, list | tuple) for of_kind in given):
        return "liggghts" if split_names(names)[1] else None
    return "liggghts" if load_engine("liggghts").recognises(files["particles"][0]) else "table"


def _refuse_beside(saved: str, given: Mapping[str, Any]) -> None:
    """Raise SceneError for options of a code's files beside a saved scene, which needs none."""
    parameters = inspect.signature(open_scene).parameters.items()
    described = [*given["engine_options"]]
    described += [
        n for n, p in parameters if n not in _OF_SAVED and repr(given[n]) != repr(p.default)
    ]
    if described:
        raise SceneError(
            f"{saved} is a scene that xcg saved, which takes no {described[0]}=; give it where the files of the code "
            "are opened, before they are saved"
        )


def _refuse_guesses(left_out: Mapping[str, str], files: Mapping[str, Sequence[str]]) -> None:
    """Raise SceneError if a damaged file of contacts could be taken for one without contacts."""
    contacts = [path for kind in ("contacts", "walls") for path in files.get(kind, ())]
    damaged = [place for place in left_out if any(place.startswith(path) for path in contacts)]
    if damaged:
        raise SceneError(
            f"{left_out[damaged[0]]} -- With missing='empty' its step would count as one without contacts: take "
            "missing='skip' to leave out steps without contacts, or repair or remove the file"
        )


def _ends(
    engine: Engine, options: ReadOptions, steps: Sequence[Step], setup: Callable[[], Setup]
) -> dict[StepRef, Frame]:
    """Particles of the first and the last step, or of the first and last readable steps where faults are tolerated."""
    raw: dict[StepRef, Frame] = {}
    tolerant = errors.recorded() is not None
    for order in (steps, steps[::-1]):
        for step in order:
            ref = step.particles
            try:
                if ref not in raw:
                    raw[ref] = read_step(engine, options, ref)
                    if tolerant:
                        complete_particles(raw[ref], setup(), source_of(ref))
            except FAULTS as error:
                raw.pop(ref, None)
                if not errors.record_fault(source_of(ref), error):
                    raise
            else:
                break
    if not raw:
        errors.raise_recorded()
    return raw


_OF_TIME = ("dt", "delta_t", "step_size", "time_step")  # what others call timestep=


def _check_options(engine: Engine, engine_options: Mapping[str, Any]) -> None:
    for option in engine_options:
        if option not in engine.OPTIONS:
            likely = did_you_mean(
                option, [*inspect.signature(open_scene).parameters, *engine.OPTIONS]
            )
            if option.lower() in _OF_TIME:
                time = "timestep" if "timestep" in engine.OPTIONS else "times"
                likely = f"; did you mean {time}=?"
            raise SceneError(
                f"open_scene has no argument {option!r} for the engine '{engine.name}'{likely}"
            )


def _flat_plane(frames: Sequence[Frame]) -> str | None:
    """Axes of the plane that all particles lie in, None where they do not."""
    positions = [frame["position"] for frame in frames]
    if any(len(position) < 3 for position in positions):
        return None
    extended = [k for k in range(3) if any(np.ptp(position[:, k]) > 0 for position in positions)]
    return "".join(COMPONENTS[k] for k in extended) if len(extended) == 2 else None


def _within(plane: str | None, periodic: str) -> str:
    """Periodic axes without that across a plane, along which two-dimensional boxes may be called periodic, too."""
    return "".join(
        axis for axis in periodic if plane is None or axis in plane or axis not in COMPONENTS
    )


def _domain(
    steps: Sequence[Step],
    box: Any,
    lattice: Any,
    shear_rate: Mapping[str, ArrayLike] | None,
    setup: Setup,
    time: NDArray | None,
) -> dict[str, NDArray]:
    """Variables of the domain at each step, in the scene's units."""
    if (
        lattice is None
        and box is None
        and any(step.particles.lattice is not None for step in steps)
    ):
        straight = [
            np.diag(np.diff(step.particles.box)[:, 0])
            for step in steps
            if step.particles.box is not None
        ]
        lattice = [
            step.particles.lattice or cell.tolist()
            for step, cell in zip(steps, straight, strict=True)
        ]
        if shear_rate is None and steps[0].particles.shear_rates:
            rates = [dict(step.particles.shear_rates) for step in steps]
            shear_rate = {
                name: [step[name] / setup.scales[2] for step in rates] for name in rates[0]
            }
    if box is None and steps[0].particles.box is not None:
        box = [step.particles.box for step in steps]
    found = domain_of(box, lattice, shear_rate, setup.periodic, len(steps), time, setup.scales[0])
    for t, step in enumerate(steps):
        Lattice.of(
            {name: values[t] for name, values in found.items()},
            setup.periodic,
            source_of(step.particles),
        )
    return found


def _recovered_box(
    reader: Engine,
    options: ReadOptions,
    steps: Sequence[Step],
    periodic: str,
    raw: Mapping[StepRef, Frame],
    *,
    skipping: bool,
) -> dict[str, tuple[float, float]] | None:
    """Periods that files lack, from contacts on both sides of an edge; None if that fails.

    Edges are put about the middle of the grains: sums over images depend on the period alone.
    """
    found: dict[str, float] = {}
    refs = [part for step in steps for ref in step.contacts for part in ref.parts]
    for ref in refs[:_RECOVERY_STEPS]:
        if set(periodic) <= set(found):
            break
        try:
            found = {
                **reader.recover_periods(ref, options),
                **found,
            }  # the first that tells an axis counts
        except FAULTS:
            if not skipping:  # others may tell it
                raise
    if not periodic or set(periodic) - set(found):
        return None
    box = {}
    for axis in periodic:
        k = COMPONENTS.index(axis)
        middle = 0.5 * (
            min(f["position"][:, k].min() for f in raw.values() if len(f["position"]))
            + max(f["position"][:, k].max() for f in raw.values() if len(f["position"]))
        )
        box[axis] = (middle - 0.5 * found[axis], middle + 0.5 * found[axis])
    said = ", ".join(f"{axis}: {found[axis]:.7g}" for axis in periodic)
    warn_user(
        f"the files do not tell the period; recovered from contacts that stand on both sides of an edge ({said}, in "
        f"the files' unit). Give box={{'{periodic[0]}': (lower, upper)}} if it is another"
    )
    return box


def _frozen_species(frozen: int | Sequence[int], raw: Mapping[StepRef, Frame]) -> tuple[int, ...]:
    given = np.atleast_1d(floats(frozen)).tolist()
    if not all(number.is_integer() for number in given):
        raise SceneError(f"frozen={frozen!r}: expected the number of a species, or several")
    species = tuple(int(number) for number in given)
    there = np.unique(np.concatenate([frame.get("species", np.empty(0)) for frame in raw.values()]))
    absent = sorted(set(species) - set(there.tolist()))
    if absent:
        found = ", ".join(str(int(number)) for number in there) or "none"
        raise SceneError(
            f"frozen={frozen!r}: no particle is of species {absent[0]}; there are {found}"
        )
    return species


def _contact_names(source: Source, step: Step) -> list[str]:
    """Variables that the contacts of all files have."""
    common: list[str] = []
    for ref in step.contacts:
        found = {*source.engine.contact_variables(ref.parts[0], source.options), "contact_point"}
        common = [name for name in common or found if name in found]
    return [*(name for name in VARIABLES if name in common), *sorted(set(common) - set(VARIABLES))]
