"""First and last step of a series as they are read, and warnings about what they lack."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import pairwise

from xcg.common.messages import warn_user
from xcg.readers.arguments import Arguments
from xcg.readers.engine import StepRef
from xcg.readers.files.text import source_of
from xcg.readers.listing import Listing
from xcg.readers.names import CLOCK_SLOTS
from xcg.readers.order import cause_by_column, cause_by_files, warn_if_none_recurs
from xcg.readers.read_steps import read_step
from xcg.readers.report import report_missing_ids
from xcg.readers.series_setup import shape_of
from xcg.scene.complete import complete_particles
from xcg.scene.schema import Frame, Setup
from xcg.steps import faults as errors
from xcg.steps.faults import FAULTS


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
        shape, thickness = shape_of(arguments, listing)
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
    moved = _moved_grains(listing)
    if listing.reader.ROWS_ARE_IDS and lacks_ids(listing, ends):
        warn_user(
            f"{moved}: the files hold no ids, and rows are other particles where one was removed: velocities from "
            "positions, displacements and diffusion are refused. Split the file where particles are removed, and "
            "open the parts one by one"
        )
    elif lacks_ids(listing, ends):
        by_id = any(step.contacts for step in listing.steps)
        report_missing_ids(listing.steps[0].particles, len(listing.steps), contacts=by_id)
    elif arguments.times is None:
        _warn_of_pieces(listing, ends)


def _warn_of_pieces(listing: Listing, ends: Mapping[StepRef, Frame]) -> None:
    """Warn if the first, last and second step, separated by names of files or a column, share no particle."""
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
    return lacking and (not listing.reader.ROWS_ARE_IDS or bool(_moved_grains(listing)))


def _moved_grains(listing: Listing) -> str:
    """Return the first steps between which the number of particles falls, in words; "" without such steps."""
    for before, after in pairwise(step.particles for step in listing.steps):
        if after.rows < before.rows:
            return (
                f"{source_of(after)} has {after.rows} particles, the step before it {before.rows}"
            )
    return ""
