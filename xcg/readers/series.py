"""Series of steps: their ends completed and measured, and what the scene says of its origin."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import floats
from xcg.common.messages import SceneError
from xcg.readers.arguments import Arguments
from xcg.readers.boxes import boxes_of
from xcg.readers.engine import StepRef
from xcg.readers.files.text import source_of
from xcg.readers.listing import Listing
from xcg.readers.pairs import origin_of
from xcg.readers.read_steps import Source, Step, read_step
from xcg.readers.report import check_plane
from xcg.scene.conform import ROW_NUMBERS
from xcg.scene.contacts import named_walls
from xcg.scene.frame import entries_of
from xcg.scene.lattice import Lattice
from xcg.scene.sanity import check_motion, check_scene
from xcg.scene.schema import VARIABLES, Frame, Setup, variable
from xcg.scene.sizes import measure_frames, measured_variables
from xcg.steps.faults import FAULTS

_MOST_GRAINS_OF_MOTION = (
    20_000  # particles of the second step, if it is read for a comparison alone
)


@dataclass(frozen=True, eq=False)
class Series:
    """The steps of a scene, and what their bodies hold.

    Attributes
    ----------
    boxes : mapping
        Variables of the domain, time first, in the scene's units.
    particle_types : mapping
        Type of each variable of the particles.
    contact_names : sequence of str
        Variables of the contacts; empty without contacts.
    times : array (t,) or None
        Time of each step (s); None if it is not known.
    """

    source: Source
    steps: Sequence[Step]
    boxes: Frame
    particle_types: Mapping[str, Any]
    contact_names: Sequence[str]
    times: NDArray | None = None

    def lengths(self) -> tuple[int, int]:
        """Largest numbers of particles and of contacts in a step."""
        contacts = max(sum(ref.rows for ref in step.contacts) for step in self.steps)
        return max(step.particles.rows for step in self.steps), contacts

    def arrays(self) -> dict[str, tuple[Any, tuple[int, ...]]]:
        """Type and shape of all variables."""
        particles, contacts = self.lengths()
        types = {name: (dtype, particles) for name, dtype in self.particle_types.items()}
        types |= {name: (variable(name).dtype, contacts) for name in self.contact_names}
        return {
            name: (dtype, (len(self.steps), *variable(name, dtype).shape(n)))
            for name, (dtype, n) in types.items()
        }

    def token(self) -> str:
        """Token of a series, from the files and options that it reads."""
        from dask.base import tokenize  # slow to import

        refs = [ref for step in self.steps for ref in (step.particles, *step.contacts)]
        paths = sorted({piece.path for ref in refs for piece in ref.parts})
        modified = [os.stat(path).st_mtime_ns for path in paths]
        # as text, which dask digests ten times as fast as thousands of objects
        steps = repr(self.steps)
        return tokenize(
            self.source, steps, modified, self.boxes, dict(self.particle_types), self.contact_names
        )


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
    boxes = boxes_of(arguments, listing, ends, setup, times)
    frozen = None
    if arguments.frozen is not None:
        frozen = _frozen_species(arguments.frozen, ends)
    source = Source(
        listing.reader, listing.options, setup, frozen, arguments.allow_unknown, listing.once
    )
    index_of = {step.particles: index for index, step in enumerate(steps)}
    types: dict[str, Any] = {}
    first: Frame | None = None  # of a small series, whose motion is compared with its times
    frames: list[Frame] = []
    for ref in list(ends):
        box = {name: values[index_of[ref]] for name, values in boxes.items()}
        frame = source.complete(ends.pop(ref), ref, box)
        if not frames:
            images = Lattice.of(box, setup.periodic, source_of(ref))
            check_scene(frame, setup, images, is_volume=True)
            names = [name for name in dict.fromkeys([*VARIABLES, *frame]) if name in frame]
            types = {name: frame[name].dtype for name in names}
            if ref.rows <= _MOST_GRAINS_OF_MOTION:
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
    if ref.rows > _MOST_GRAINS_OF_MOTION:
        return
    source = series.source
    try:
        raw = read_step(source.engine, source.options, ref)
        box = entries_of(series.boxes, 1)
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


def _frozen_species(frozen: int | Sequence[int], ends: Mapping[StepRef, Frame]) -> tuple[int, ...]:
    """Return the species that are fixed in place; raise SceneError unless the ends hold them."""
    numbers = np.atleast_1d(floats(frozen)).tolist()
    if not all(number.is_integer() for number in numbers):
        raise SceneError(f"frozen={frozen!r}: expected the number of a species, or several")
    frozen_species = tuple(int(number) for number in numbers)
    species = [frame.get("species", np.empty(0)) for frame in ends.values()]
    present = np.unique(np.concatenate(species))
    absent = sorted(set(frozen_species) - set(present.tolist()))
    if absent:
        listed = ", ".join(str(int(number)) for number in present) or "none"
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
