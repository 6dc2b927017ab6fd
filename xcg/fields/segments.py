"""Passes over the segments that carry what goes along branches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from xcg.compiled.cells import lists_of
from xcg.compiled.polynomials import closed_for
from xcg.compiled.reach import BlockNodes, batches_in_reach, no_bounds
from xcg.compiled.segments import (
    BRANCH,
    FORCE,
    GROUP,
    RUN,
    SEGMENT,
    IndexedContacts,
    SegmentChoice,
    Segments,
    bounds_of_segments,
    deposit_segments,
    list_segments,
)
from xcg.fields.passes import Columns, Fill, Pass, StepArrays, alike
from xcg.fields.sums.moments import Moment
from xcg.fields.sums.nodes import DIAMETER, Block, Smoothing
from xcg.scene.schema import Frame

# Segments of more contacts than this are not kept, as each takes 80 bytes.
MOST_LISTED_ONCE = 1 << 22
# Runs that are listed at one time, so that their segments stay in cache.
_TOGETHER = 256


@dataclass(frozen=True, eq=False)
class ListedOnce:
    """Segments that stay in memory, some of which may be out of reach."""

    segments: Segments

    def near(self, nodes: BlockNodes) -> Iterator[Segments]:
        """Yield all segments at once."""
        yield self.segments


@dataclass(frozen=True, eq=False)
class ListedAnew:
    """Segments of which the bounds alone stay in memory."""

    listing: SegmentChoice
    contacts: NDArray
    bounds: NDArray
    limits: NDArray

    def near(self, nodes: BlockNodes) -> Iterator[Segments]:
        """Segments of the runs that reach a block of nodes, listed again."""
        reaches = np.empty(len(self.bounds), bool)
        batches_in_reach(self.bounds, nodes.begin, nodes.end, nodes.active, nodes.period, reaches)
        runs = np.flatnonzero(reaches)
        for first in range(0, len(runs), _TOGETHER):
            some = runs[first : first + _TOGETHER]
            indices = (RUN * some[:, None] + np.arange(RUN)).ravel()
            # the last run may be shorter
            contacts = self.contacts[indices[indices < len(self.contacts)]]
            records, _, _ = list_some(self.listing, contacts)
            yield Segments(records, self.limits, self.bounds[some])


# Segments of contacts, in an order that is the same for all blocks of nodes.
Branches: TypeAlias = ListedOnce | ListedAnew


def list_some(listing: SegmentChoice, contacts: NDArray) -> tuple[NDArray, NDArray, bool]:
    """List the segments of some contacts: records, the longest (4,), and whether any contact has a second segment."""
    records = np.empty((len(contacts), SEGMENT))
    longest = np.empty(4)
    more = list_segments(listing, contacts, records, None, longest)
    return records, longest, more


def along_branches(arrays: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Prepare a pass for each moment that is smeared along branches, with contacts in an order in space."""
    order = arrays.grains.order
    if arrays.lattice.vectors is not None:
        order = arrays.in_space(arrays.position)
    contacts = arrays.contacts.in_order_of(order)
    passes = []
    for name, moment in moments.items():
        others = 0
        if moment.paired:
            others = arrays.plan.other_count
        columns: dict[str, Columns] = {name: (moment.columns, 1.0)}
        run = Pass(arrays.plan.group_count * max(others, 1), 9, columns)
        carried = _carried(arrays, moment, arrays.frame)
        for cutoff in arrays.smoothings:
            run.fills.extend(_fills(arrays, moment, carried, contacts, others, cutoff))
        passes.append(run)
    return passes


def _fills(
    arrays: StepArrays,
    moment: Moment,
    carried: tuple[NDArray, NDArray | None],
    contacts: NDArray,
    others: int,
    cutoff: float,
) -> Iterator[Fill]:
    """Yield the loops over the segments of one cutoff: of first particles, and of second ones where there are any."""
    smoothing = arrays.smoothings[cutoff]
    for second in (False, True):
        segments, longest, more = _segments(
            arrays, moment, *carried, contacts, second, others, cutoff
        )
        reach = DIAMETER + longest[:3]
        smoothing.check_reach(reach, arrays.source)
        for rule in _rules(arrays, longest[3], cutoff):
            yield partial(_fill_segments, segments, smoothing, reach.tolist(), rule)
        if not more:
            return


def _carried(arrays: StepArrays, moment: Moment, frame: Frame) -> tuple[NDArray, NDArray | None]:
    """Vectors (n, 3) that the sides of i and of j carry; None where the vectors of j are the opposite."""
    if moment.column is None:
        return arrays.contacts.force, None
    on_i, on_j = moment.column(frame, arrays.contacts)
    return on_i, on_j


def _segments(
    arrays: StepArrays,
    moment: Moment,
    on_i: NDArray,
    on_j: NDArray | None,
    contacts: NDArray,
    second: bool,
    others: int,
    cutoff: float,
) -> tuple[Branches, NDArray, bool]:
    """Segments of the first or second particles of contacts, the longest, and whether there are second ones."""
    c = arrays.contacts
    smoothing = arrays.smoothings[cutoff]
    tilted = arrays.lattice.vectors is not None
    limits = arrays.plan.limits
    indexed = IndexedContacts(
        c.i, c.j, c.point, on_i, on_j, arrays.position, arrays.phase, *c.lattice.for_loops
    )
    listing = SegmentChoice(
        indexed, second, others, arrays.plan.cutoff_of_group, cutoff, arrays.origin
    )
    if len(contacts) > MOST_LISTED_ONCE and not tilted:
        bounds = no_bounds(len(contacts), RUN)
        longest = np.empty(4)
        more = list_segments(listing, contacts, None, bounds, longest)
        if not smoothing.too_long(longest[:3]):
            smoothing.check_far(longest[:3], arrays.source)
            return ListedAnew(listing, contacts, bounds, limits), longest, more
    segments, longest, more = list_some(listing, contacts)
    smoothing.check_far(longest[:3], arrays.source)
    shift = np.zeros(3)
    if tilted:
        used = np.flatnonzero(segments[:, GROUP] >= 0.0)
        start = segments[used, :BRANCH] * cutoff + arrays.origin
        image, shift, drifts = arrays.near_mesh(start, (1.0 + longest[3]) * cutoff)
        segments = segments[used[image]]
        contacts = contacts[used[image]]
        segments[:, :BRANCH] += shift / cutoff
        if "velocity" not in moment.variables:
            drifts = drifts[:0]
        for drift, here in alike(drifts):  # as seen in images that drift
            if not drift.any():
                continue
            moved = arrays.frame | {"velocity": arrays.frame["velocity"] + drift}
            on_i, on_j = _carried(arrays, moment, moved)
            moved_contacts = indexed._replace(on_i=on_i, on_j=on_j)
            moving, _, _ = list_some(listing._replace(contacts=moved_contacts), contacts[here])
            segments[here, FORCE:GROUP] = moving[:, FORCE:GROUP]
    if smoothing.too_long(longest[:3]):
        partner = np.where(c.i >= 0, c.j, c.i)
        if second:
            partner = c.i
        ends = [c.point[contacts] + shift, arrays.position[partner[contacts]] + shift]
        longest = smoothing.cut(segments, np.array(ends), arrays.source)
    return ListedOnce(Segments(segments, limits, bounds_of_segments(segments))), longest, more


class _Rule(NamedTuple):
    """Way to the weights of segments.

    Attributes
    ----------
    real : str
        Type of the numbers.
    closed : bool
        Whether closed forms are taken as well as quadratures.
    rest : bool
        Whether only segments that are too long for quadratures are taken.
    """

    real: str
    closed: bool
    rest: bool


def _rules(arrays: StepArrays, longest: float, cutoff: float) -> list[_Rule]:
    """Return the ways to the weights of segments, one after the other."""
    plan = arrays.plan
    if not plan.coarse or not arrays.smoothings[cutoff].fits_single(plan.limits.max()):
        return [_Rule("float64", closed=True, rest=False)]
    rules = [_Rule("float32", closed=False, rest=False)]
    if longest > plan.limits.max():
        rules.append(_Rule("float64", closed=True, rest=True))
    return rules


def _fill_segments(
    segments: Branches,
    smoothing: Smoothing,
    reach: Sequence[float],
    rule: _Rule,
    block: Block,
    sums: NDArray,
    _: NDArray,
) -> None:
    nodes = block.nodes(smoothing)
    lists = lists_of(nodes, reach, rule.real)
    scratch = None
    if rule.closed:
        scratch = closed_for(lists.values.shape[1])
    for some in segments.near(nodes):
        deposit_segments(some, nodes, smoothing.weights, lists, scratch, rule.rest, sums)
