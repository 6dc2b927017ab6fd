"""Boxes of the steps: from the arguments, the headers of files, or contacts on both sides of an edge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_user
from xcg.readers.arguments import Arguments
from xcg.readers.engine import StepRef
from xcg.readers.files.text import source_of
from xcg.readers.listing import Listing
from xcg.readers.read_steps import Step
from xcg.scene.box import domain_of
from xcg.scene.frame import entries_of
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, Frame, Setup
from xcg.steps.faults import FAULTS

_SAME_PERIOD = 1e-3  # relative difference of periods, of positions in single precision
_RECOVERY_STEPS = 10  # files of contacts that are read for a period, where files do not tell it


def boxes_of(
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
    for index, ref in enumerate(refs):
        box_of_step = entries_of(boxes, index)
        Lattice.of(box_of_step, setup.periodic, source_of(ref))  # checks it
    if arguments.box is not None and refs[0].box is None:
        _compare_with_contacts(boxes["box"], arguments, listing, setup)
    return boxes


def _compare_with_contacts(
    box: NDArray, arguments: Arguments, listing: Listing, setup: Setup
) -> None:
    """Warn if edges (t, 3, 2) that the caller gave are not a period apart, as contacts across an edge show."""
    parts = [(index, part) for index, step in enumerate(listing.steps) for part in _parts_of(step)]
    index, ref = next(((index, part) for index, part in parts if part.rows), (0, None))
    if ref is None:
        return
    periods = _periods_from([ref], arguments, listing, setup.periodic)
    unit = setup.scales[0]
    for axis in setup.periodic:
        k = COMPONENTS.index(axis)
        length = float(box[index, k, 1] - box[index, k, 0]) / unit
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
