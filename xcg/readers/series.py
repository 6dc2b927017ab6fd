"""Series of steps: listed, their ends read, and what holds for all of them found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import floats
from xcg.common.messages import Once, SceneError, warn_user
from xcg.readers.arguments import Arguments
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.readers.lazy import Series
from xcg.readers.names import CLOCK_SLOTS
from xcg.readers.order import cause_by_column, cause_by_files, warn_if_none_recurs
from xcg.readers.pairs import from_first_date, index_files, origin_of, pair_steps
from xcg.readers.paths import expand_paths, not_against_headers, units_of_headers
from xcg.readers.read_steps import Source, Step, read_step
from xcg.readers.report import check_plane, report_missing_ids
from xcg.scene.box import domain_of
from xcg.scene.complete import complete_particles
from xcg.scene.conform import ROW_NUMBERS
from xcg.scene.contacts import named_walls
from xcg.scene.lattice import Lattice
from xcg.scene.sanity import check_motion, check_scene
from xcg.scene.schema import COMPONENTS, VARIABLES, Frame, Setup, Shape, periodic_axes
from xcg.scene.sizes import measure_frames, measured_variables
from xcg.scene.times import times_given
from xcg.steps import faults as errors
from xcg.steps.faults import FAULTS

_MOST_ROWS_OF_MOTION = 20_000  # particles of the second step, if it is read for a comparison alone
_SAME_PERIOD = 1e-3  # relative difference of periods, of positions in single precision
_RECOVERY_STEPS = 10  # files of contacts that are read for a period, where files do not tell it


@dataclass(frozen=True)
class Listing:
    """Steps of all files, from their headers.

    Attributes
    ----------
    reader : Engine
        The engine.
    options : ReadOptions
        Its options.
    files : mapping
        Paths by kind of file.
    refs : mapping
        Steps by kind of file, before they were paired.
    steps : sequence of Step
        Steps of the scene, each with its contacts.
    left_out : dict
        Causes of faults that were tolerated, by their place.
    start : str or None
        Date from which times count (ISO 8601), where files or arguments hold dates.
    once : Once
        Warnings about steps, each given once.
    """

    reader: Engine
    options: ReadOptions
    files: Mapping[str, Sequence[str]]
    refs: Mapping[str, list[StepRef]]
    steps: Sequence[Step]
    left_out: dict[Any, str]
    start: str | None = None
    once: Once = field(default_factory=Once)

    @property
    def units_are_assumed(self) -> bool:
        """Return True if files that usually name their units do not."""
        named = any(refs[0].units is not None for refs in self.refs.values())
        return bool(self.reader.UNNAMED_UNITS) and not named

    @property
    def skipped(self) -> list[str]:
        """Causes of faults that were tolerated, each with its place."""
        causes = []
        for place, cause in self.left_out.items():
            # most causes name the file; of one with many steps, the place goes on " from byte ..."
            if place.partition(" from byte ")[0] not in cause:
                cause = f"{place}: {cause}"
            causes.append(cause)
        return causes


def list_series(arguments: Arguments) -> Listing:
    """List the steps of all files from their headers, and pair particles with contacts.

    Raises
    ------
    FileNotFoundError, SceneError
        If files are missing, damaged, or do not make one series, unless such faults are tolerated.
    """
    with arguments.tolerating() as left_out:
        files = {kind: expand_paths(paths, kind) for kind, paths in arguments.paths.items()}
        reader = arguments.load_engine(files)
        options = arguments.read_options(reader)
        may_differ = {
            "periodic": arguments.periodic,
            "units": arguments.units,
            "box": arguments.box,
            "time": arguments.times,
        }
        refs = index_files(
            reader, files, options, [what for what, given in may_differ.items() if given is None]
        )
        time_unit = 1.0
        if arguments.units is not None:
            time_unit = Setup.make(units=arguments.units).scales[2]
        refs, start = from_first_date(refs, time_unit)
        times = arguments.times
        if times is not None:
            times, start = times_given(times, "times=", time_unit)
        missing = arguments.missing
        if left_out and missing == "empty":
            _check_contacts_are_known(left_out, files)
        if left_out and missing == "raise":
            missing = "skip"
        named_alone = all([str(paths)] == files[kind] for kind, paths in arguments.paths.items())
        steps = pair_steps(reader, options, refs, times, missing, together=named_alone)
    if arguments.wall_columns:
        steps = [_with_wall_columns(step, reader, options) for step in steps]
    if max(step.particles.step for step in steps) < 0:  # neither files nor their names tell any
        steps = [
            replace(step, particles=replace(step.particles, step=k)) for k, step in enumerate(steps)
        ]
    return Listing(reader, options, files, refs, steps, left_out, start)


def _with_wall_columns(step: Step, reader: Engine, options: ReadOptions) -> Step:
    """Return a step with the contacts with walls that are columns of its particles."""
    options = options.of_kind("particles")
    walls = [reader.wall_step(part, options) for part in step.particles.parts]
    return replace(step, contacts=(*step.contacts, *walls))


def _check_contacts_are_known(
    left_out: Mapping[str, str], files: Mapping[str, Sequence[str]]
) -> None:
    """Raise SceneError if a damaged file of contacts could be taken for one without contacts."""
    contacts = [path for kind in ("contacts", "walls") for path in files.get(kind, ())]
    damaged = [place for place in left_out if any(place.startswith(path) for path in contacts)]
    if damaged:
        raise SceneError(
            f"{left_out[damaged[0]]} -- With missing='empty' its step would count as one without "
            "contacts: take missing='skip' to leave out steps without contacts, or repair or remove "
            "the file"
        )


# --- the ends of the series ------------------------------------------------------------------------


def read_ends(arguments: Arguments, listing: Listing) -> dict[StepRef, Frame]:
    """Read the particles of the first and the last step, in the files' units.

    Where faults are tolerated, these are the first and last steps that can be read; the others stay
    in the scene, and their faults appear when they are computed.
    """
    ends: dict[StepRef, Frame] = {}
    with arguments.tolerating(), listing.once.active():
        for order in (listing.steps, listing.steps[::-1]):
            for step in order:
                try:
                    _read_end(step.particles, ends, arguments, listing)
                except FAULTS as error:
                    ends.pop(step.particles, None)
                    if not errors.record_fault(source_of(step.particles), error):
                        raise
                else:
                    break
        if not ends:
            errors.raise_recorded()
    return ends


def _read_end(
    ref: StepRef, ends: dict[StepRef, Frame], arguments: Arguments, listing: Listing
) -> None:
    """Add the particles of a step to the ends; where faults are tolerated, check them whole."""
    if ref in ends:
        return
    ends[ref] = read_step(listing.reader, listing.options, ref)
    if arguments.on_error == "skip":
        shape, thickness = _shape_of(arguments, listing)
        setup = Setup.make(shape=shape, thickness=thickness, **arguments.alike)
        complete_particles(dict(ends[ref]), setup, source_of(ref))


def warn_of_missing_facts(
    arguments: Arguments, listing: Listing, ends: Mapping[StepRef, Frame]
) -> None:
    """Warn of files that are left out, and of units and ids that the files do not hold.

    Raises
    ------
    SceneError
        If contacts name particles by ids, and the files hold none.
    """
    for cause in listing.skipped:
        warn_user(f"left out: {cause}")
    if not any(len(frame["position"]) for frame in ends.values()):
        first = source_of(listing.steps[0].particles)
        warn_user(f"{first}: neither the first nor the last step holds particles")
    if arguments.units is None and listing.units_are_assumed:
        warn_user(
            f"{source_of(listing.refs['particles'][0])}: the header does not name the units, and SI is "
            "taken; say units='SI', 'reduced' (LAMMPS's lj) or factors such as {'length': 1e-3}, or "
            f"{listing.reader.UNNAMED_UNITS}"
        )
    if lacks_ids(listing, ends):
        by_id = any(step.contacts for step in listing.steps)
        report_missing_ids(listing.steps[0].particles, len(listing.steps), contacts=by_id)
    elif arguments.times is None:
        _warn_of_pieces(listing, ends)


def _warn_of_pieces(listing: Listing, ends: Mapping[StepRef, Frame]) -> None:
    """Warn if steps that names of files or a column tell apart share no particle: the first, last and second."""
    filled = [step.particles for step in listing.steps if step.particles.rows]
    cause = _cause_of_steps(listing)
    if len(filled) < 2 or not cause:
        return

    def draw() -> Iterator[tuple[str, Frame]]:
        for ref in dict.fromkeys((filled[0], filled[-1], filled[1])):
            frame = ends.get(ref)
            if frame is None:
                frame = read_step(listing.reader, listing.options, ref)
            yield source_of(ref), frame

    with suppress(*FAULTS), listing.once.active():  # faults appear when the step is computed
        warn_if_none_recurs(draw(), cause)


def _cause_of_steps(listing: Listing) -> str:
    """Return what the steps may be instead; "" where the files or the caller say that they are steps."""
    refs = listing.refs["particles"]
    options = listing.options.of_kind("particles")
    columns = listing.reader.columns_read(refs[0], options, contacts=False) or {}
    clock = [column for column, slot in columns.items() if slot in CLOCK_SLOTS]
    if clock:
        if clock[0] in options.names:
            return ""
        return cause_by_column(clock[0], in_order="particles" in options.listed)
    if len(listing.steps) == len(refs) and all(ref.named or ref.step < 0 for ref in refs):
        return cause_by_files(len(refs))
    return ""


def lacks_ids(listing: Listing, ends: Mapping[StepRef, Frame]) -> bool:
    """Return whether rows without ids may be other particles in every step."""
    lacking = any("particle_id" not in frame for frame in ends.values())
    return lacking and not listing.reader.ROWS_ARE_IDS


# --- what holds for all steps ----------------------------------------------------------------------


def setup_of(arguments: Arguments, listing: Listing, ends: Mapping[StepRef, Frame]) -> Setup:
    """Return what holds for all steps: from the arguments, else the headers, else the ends."""
    first = next(iter(ends))
    flat = _flat_plane(list(ends.values()))
    plane = arguments.plane
    dimension = arguments.dimension
    if dimension is None:
        dimension = listing.steps[0].particles.dimension or len(flat or COMPONENTS)
        if plane:
            dimension = len(plane)
    if dimension == 2:
        plane = plane or flat or "xy"
    periodic = _within(plane, first.periodic or "")
    if arguments.periodic is not None:
        given = periodic_axes(arguments.periodic, plane)
        if first.periodic is not None:
            _check_periodic(_within(plane, given), periodic, source_of(first))
        periodic = given
        if arguments.box is None and first.box is None:
            # no file tells the period across a layer, and nothing depends on it
            periodic = _within(flat, periodic)
    units: Any = arguments.units
    if units is None:
        units = units_of_headers(listing.refs)
    else:
        not_against_headers(units, listing.refs)
    shape, thickness = _shape_of(arguments, listing)
    setup = Setup.make(
        units=units,
        gravity=arguments.gravity,
        dimension=dimension,
        plane=plane,
        thickness=thickness,
        shape=shape,
        sides=arguments.sides,
        periodic=periodic,
        **arguments.alike,
    )
    if arguments.gravity is None and first.gravity is not None:
        x, y, z = (g * setup.factor((1, 0, -2)) for g in first.gravity)
        setup = replace(setup, gravity=(x, y, z))
    return setup


def _check_periodic(given: str, named: str, source: str) -> None:
    """Warn if axes are given as periodic that are not so in the header; others may be left out on purpose."""
    added = "".join(axis for axis in given if axis not in named)
    if added:
        names = "names no periodic axis"
        if named:
            names = f"names {named!r}"
        warn_user(
            f"periodic={given!r}, but the header of {source} {names}: grains at both edges of {added!r} become "
            "neighbours; leave periodic= out, unless the header is wrong"
        )


def _shape_of(arguments: Arguments, listing: Listing) -> tuple[Shape, float | None]:
    """Return the shape of grains, and the thickness of discs (m), which is 1 in the files' unit."""
    of_files = listing.steps[0].particles.shape
    thickness = arguments.thickness
    if arguments.shape is None and of_files == "disc" and thickness is None:
        units = arguments.units
        if units is None:
            units = units_of_headers(listing.refs)
        thickness = Setup.make(units=units).scales[0]
    return arguments.shape or of_files or "sphere", thickness


def make_series(
    arguments: Arguments, listing: Listing, ends: dict[StepRef, Frame], setup: Setup
) -> tuple[Series, dict[str, Any]]:
    """Return the series, and the sizes and extent of the particles of its ends.

    The ends are completed one by one, kept for their first use, and taken out of `ends`.
    """
    steps = listing.steps
    clock = [step.time for step in steps if step.time is not None]
    times = None
    if clock:
        times = np.array(clock) * setup.scales[2]
    boxes = _boxes(arguments, listing, ends, setup, times)
    frozen = None
    if arguments.frozen is not None:
        frozen = _frozen_species(arguments.frozen, ends)
    source = Source(
        listing.reader, listing.options, setup, frozen, arguments.allow_unknown, listing.once
    )
    rows = {step.particles: row for row, step in enumerate(steps)}
    types: dict[str, Any] = {}
    first: Frame | None = None  # of a small series, whose motion is compared with its times
    frames: list[Frame] = []
    for ref in list(ends):
        box = {name: values[rows[ref]] for name, values in boxes.items()}
        frame = source.complete(ends.pop(ref), ref, box)
        if not frames:
            images = Lattice.of(box, setup.periodic, source_of(ref))
            check_scene(frame, setup, images, is_volume=True)
            names = [name for name in dict.fromkeys([*VARIABLES, *frame]) if name in frame]
            types = {name: frame[name].dtype for name in names}
            if ref.rows <= _MOST_ROWS_OF_MOTION:
                first = frame
        # of two large steps the last: dask begins with it
        source.opened.keep(ref, frame, beside=bool(ends))
        frames.append(measured_variables(frame))
        del frame
    with_contacts = next((step for step in steps if step.contacts), steps[0])
    series = Series(
        source,
        steps,
        boxes,
        types,
        _contact_names(source, with_contacts),
        times,
    )
    measured = measure_frames(frames)
    sets_times = arguments.times is not None or "timestep" in arguments.engine_options
    if first is not None and sets_times and arguments.on_error == "raise":
        _check_times_of_motion(series, first, images)
    return series, measured


def _check_times_of_motion(series: Series, first: Frame, images: Lattice) -> None:
    """Compare the motion in a short first step with times that the caller gave."""
    if series.times is None or len(series.steps) < 2:
        return
    ref = series.steps[1].particles
    if ref.rows > _MOST_ROWS_OF_MOTION:
        return
    source = series.source
    try:
        raw = read_step(source.engine, source.options, ref)
        box = {name: values[1] for name, values in series.boxes.items()}
        second = source.complete(raw, ref, box)
        source.opened.keep(ref, second, beside=True)
    except FAULTS:
        return  # appear when the step is computed
    check_motion(first, second, float(series.times[1] - series.times[0]), images)


def with_origin(
    scene: xr.Dataset, arguments: Arguments, listing: Listing, *, numbered: bool
) -> xr.Dataset:
    """Return the scene with attributes on where it is from, and what its files did not hold."""
    attrs = origin_of(listing.reader, listing.files, listing.options, listing.steps)
    if arguments.units is None and listing.units_are_assumed:
        attrs["assumed_units"] = "SI"
    if listing.start:
        attrs["start"] = listing.start
    if listing.left_out:
        attrs["skipped_files"] = "\n".join(listing.skipped)
    if arguments.wall_columns:
        attrs |= named_walls(arguments.wall_columns)
    if numbered:
        scene["particle_id"].attrs |= ROW_NUMBERS
    return scene.assign_attrs(attrs)


# --- the box ---------------------------------------------------------------------------------------


def _boxes(
    arguments: Arguments,
    listing: Listing,
    ends: Mapping[StepRef, Frame],
    setup: Setup,
    times: NDArray | None,
) -> dict[str, NDArray]:
    """Return the variables of the box at each step, in the scene's units."""
    refs = [step.particles for step in listing.steps]
    box: Any = arguments.box
    lattice: Any = arguments.lattice
    shear_rate = arguments.shear_rate
    if lattice is None and box is None and any(ref.lattice is not None for ref in refs):
        # a box without tilt has its edges alone
        lattice = [ref.lattice or np.diag(np.ptp(ref.box or (), axis=1)).tolist() for ref in refs]
        if shear_rate is None and refs[0].shear_rates:
            rates = [dict(ref.shear_rates) for ref in refs]
            shear_rate = {
                name: [rate[name] / setup.scales[2] for rate in rates] for name in rates[0]
            }
    if box is None and next(iter(ends)).box is None:
        box = _recovered_box(arguments, listing, ends, setup.periodic)
    if box is None and refs[0].box is not None:
        box = [ref.box for ref in refs]
    boxes = domain_of(box, lattice, shear_rate, setup.periodic, len(refs), times, setup.scales[0])
    for step, ref in enumerate(refs):
        of_step = {name: values[step] for name, values in boxes.items()}
        Lattice.of(of_step, setup.periodic, source_of(ref))  # checks it
    if arguments.box is not None and refs[0].box is None:
        _compare_with_contacts(boxes["box"], arguments, listing, setup)
    return boxes


def _compare_with_contacts(
    box: NDArray, arguments: Arguments, listing: Listing, setup: Setup
) -> None:
    """Warn if edges (t, 3, 2) that the caller gave are not a period apart, as contacts across an edge show."""
    parts = [(row, part) for row, step in enumerate(listing.steps) for part in _parts_of(step)]
    row, ref = next(((row, part) for row, part in parts if part.rows), (0, None))
    if ref is None:
        return
    periods = _periods_from([ref], arguments, listing, setup.periodic)
    unit = setup.scales[0]
    for axis in setup.periodic:
        k = COMPONENTS.index(axis)
        length = float(box[row, k, 1] - box[row, k, 0]) / unit
        if axis in periods and abs(length - periods[axis]) > _SAME_PERIOD * periods[axis]:
            warn_user(
                f"box=: the period along {axis!r} is {length:.7g}, and contacts on both sides of an edge in "
                f"{source_of(ref)} are {periods[axis]:.7g} apart (in the files' unit); correct box=, or leave "
                f"{axis!r} out of periodic= if these contacts are not across an edge"
            )


def _parts_of(step: Step) -> list[StepRef]:
    """Return the files of contacts of a step."""
    return [part for ref in step.contacts for part in ref.parts]


def _periods_from(
    refs: Sequence[StepRef], arguments: Arguments, listing: Listing, periodic: str
) -> dict[str, float]:
    """Return periods in the files' unit, from the first contacts on both sides of each edge."""
    periods: dict[str, float] = {}
    for ref in refs:
        if set(periodic) <= set(periods):
            break
        try:
            options = listing.options.of_kind("contacts")
            recovered = listing.reader.recover_periods(ref, options)
        except FAULTS:
            if arguments.on_error == "raise":
                raise
            continue  # others may tell it
        periods = {**recovered, **periods}
    return periods


def _recovered_box(
    arguments: Arguments, listing: Listing, ends: Mapping[StepRef, Frame], periodic: str
) -> dict[str, tuple[float, float]] | None:
    """Return periods that files lack, from contacts on both sides of an edge; None if that fails.

    Edges are put about the middle of the grains: sums over images depend on the period alone.
    """
    refs = [part for step in listing.steps for part in _parts_of(step)]
    periods = _periods_from(refs[:_RECOVERY_STEPS], arguments, listing, periodic)
    if not periodic or set(periodic) - set(periods):
        return None
    positions = [frame["position"] for frame in ends.values() if len(frame["position"])]
    box = {}
    for axis in periodic:
        k = COMPONENTS.index(axis)
        lowest = min(position[:, k].min() for position in positions)
        highest = max(position[:, k].max() for position in positions)
        middle = 0.5 * (lowest + highest)
        box[axis] = (middle - 0.5 * periods[axis], middle + 0.5 * periods[axis])
    listed = ", ".join(f"{axis}: {periods[axis]:.7g}" for axis in periodic)
    warn_user(
        "the files do not tell the period; recovered from contacts that stand on both sides of an edge "
        f"({listed}, in the files' unit). Give box={{'{periodic[0]}': (lower, upper)}} if it is another"
    )
    return box


def _flat_plane(frames: Sequence[Frame]) -> str | None:
    """Return the axes of the plane that all particles lie in, None if they do not."""
    positions = [frame["position"] for frame in frames]
    if any(len(position) < 3 for position in positions):
        return None
    extended = [k for k in range(3) if any(np.ptp(position[:, k]) > 0 for position in positions)]
    if len(extended) != 2:
        return None
    return "".join(COMPONENTS[k] for k in extended)


def _within(plane: str | None, periodic: str) -> str:
    """Return periodic axes without the one across a plane, along which 2D boxes may be periodic."""
    return "".join(
        axis for axis in periodic if plane is None or axis in plane or axis not in COMPONENTS
    )


# --- the variables ---------------------------------------------------------------------------------


def _frozen_species(frozen: int | Sequence[int], ends: Mapping[StepRef, Frame]) -> tuple[int, ...]:
    """Return the species that are fixed in place; raise SceneError unless the ends hold them."""
    numbers = np.atleast_1d(floats(frozen)).tolist()
    if not all(number.is_integer() for number in numbers):
        raise SceneError(f"frozen={frozen!r}: expected the number of a species, or several")
    frozen_species = tuple(int(number) for number in numbers)
    species = [frame.get("species", np.empty(0)) for frame in ends.values()]
    known = np.unique(np.concatenate(species))
    absent = sorted(set(frozen_species) - set(known.tolist()))
    if absent:
        listed = ", ".join(str(int(number)) for number in known) or "none"
        raise SceneError(
            f"frozen={frozen!r}: no particle is of species {absent[0]}; there are {listed}"
        )
    return frozen_species


def _contact_names(source: Source, step: Step) -> list[str]:
    """Return the variables that the contacts of all files have."""
    common: list[str] = []
    if step.contacts:
        contacts = step.contacts[0].parts[0]
        particles = step.particles.parts[0]
        check_plane(source.engine, particles, contacts, source.options, source.setup.dimension)
    options = source.options.of_kind("contacts")
    for ref in step.contacts:
        names = {*source.engine.contact_variables(ref.parts[0], options), "contact_point"}
        common = [name for name in common or names if name in names]
    return [*(name for name in VARIABLES if name in common), *sorted(set(common) - set(VARIABLES))]
