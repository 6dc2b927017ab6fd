"""Passes over the segments that carry what goes along branches, and the quadrature that keeps the promise rtol."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import smoothing as kinds
from xcg.compiled.lines import largest_error
from xcg.compiled.polynomials import RADIUS, closed_for
from xcg.compiled.reach import BlockNodes, batches_in_reach, no_bounds
from xcg.compiled.segments import (
    BRANCH,
    FORCE,
    GROUP,
    RULES,
    RUN,
    SEGMENT,
    ContactRows,
    SegmentChoice,
    Segments,
    bounds_of_segments,
    deposit_segments,
    list_segments,
)
from xcg.compiled.smoothing import PLAIN
from xcg.fields.sums.kernel_tables import Profile, table_of
from xcg.fields.sums.kernels import Kernel
from xcg.fields.sums.moments import Moment
from xcg.fields.sums.nodes import DIAMETER, Block, Smoothing, lists_of
from xcg.fields.sums.step import Fill, Layout, Pass, StepRows, alike
from xcg.scene.schema import Frame

# From this promise on, weights are computed in single precision, which rounds them to 1e-6 of the
# largest.
SINGLE = 1e-4


def _quicker(kind: int | None, table: NDArray | None, rtol: float) -> tuple[int, ...]:
    """Gauss-Legendre rules that take less time than the closed form, by the kernel as it is seen, and the precision."""
    if kind is kinds.LUCY_FULL:
        if rtol >= SINGLE:
            return RULES
        return RULES[:2]
    if table is not None:
        shells = np.count_nonzero(table[kinds.SHELLS, RADIUS])
        if kind == kinds.TABLE + 1 or shells == 0:
            return RULES
        # closed forms of one or two shells take less time than two points, of three less than four
        return RULES[: int(shells > 2)]
    return RULES[:1]  # marginals take more time a point than a polynomial


@lru_cache(maxsize=64)
def _limits(
    kind: int | None, profile: Profile | None, codimension: int, seen: int, rtol: float
) -> NDArray:
    """Longest branch (cutoffs) for which each rule keeps to `rtol`, measured against the closed form.

    The error of a rule depends on nothing but the branch length over the cutoff and the place of
    the node, so that a scan over both bounds it for every scene. A twentieth is kept in hand for
    places between those scanned.
    """
    table = PLAIN
    if profile is not None:
        table = table_of(profile, codimension)
    rows = 24
    if seen == 1:
        rows = 1

    def kept(length: float, order: int) -> bool:
        return largest_error(length, order, rows, kind, table) <= 0.95 * rtol

    limits = []
    limit = 0.0
    for order in _quicker(kind, table, rtol):
        for length in np.geomspace(1e-3, 8, 61):
            if length <= limit or kept(length, order):  # shorter ones are left to the order before
                limit = max(limit, length)
                continue
            for _ in range(4):  # and now between the last that keeps it and the first that does not
                middle = 0.5 * (limit + length)
                if kept(middle, order):
                    limit = middle
                else:
                    length = middle
            break
        limits.append(limit)
    return np.array(limits)


def gauss_limits(kernel: Kernel, seen: int, rtol: float) -> NDArray:
    """Longest branch (cutoffs) for which 2, 4, ... Gauss-Legendre points keep the promise `rtol`.

    The promise is ``|S_quadrature - S| <= rtol max S`` for every segment, the maximum taken over
    all places. Kernels that jump have no such bound and always take the closed form (an empty
    array), as does ``rtol=0``.
    """
    if rtol == 0 or kernel.smoothness < 0 or seen == 0:
        return np.zeros(0)
    codimension = (kernel.dimension or 3) - seen
    return _limits(kernel.weights(seen).kind, kernel.profile, codimension, seen, rtol)


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
            places = (RUN * some[:, None] + np.arange(RUN)).ravel()
            # the last run may be shorter
            contacts = self.contacts[places[places < len(self.contacts)]]
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


def along_branches(step: StepRows) -> list[Pass]:
    """Prepare a pass for each moment that is smeared along branches."""
    order = step.grains.order
    if step.lattice.vectors is not None:
        order = step.in_space(step.position)
    contacts = step.contacts.in_order_of(order)
    return [
        _branches(step, name, row, contacts)
        for name, row in step.spec.rows.items()
        if row.along_branches
    ]


def _branches(step: StepRows, name: str, row: Moment, contacts: NDArray) -> Pass:
    """Branches of the contacts, in an order in space, each with its force or what is in its place."""
    spec = step.spec
    others = 0
    if row.paired:
        others = spec.others
    carried = _carried(step, row, step.frame)
    fill: list[Fill] = []
    for cutoff in spec.distinct:
        smoothing = step.smoothings[cutoff]
        for second in (False, True):
            segments, longest, more = _segments(
                step, row, *carried, contacts, second, others, cutoff
            )
            reach = DIAMETER + longest[:3]
            smoothing.check_reach(reach, step.source)
            for rule in _rules(step, longest[3], cutoff):
                fill.append(partial(_fill_segments, segments, smoothing, reach.tolist(), rule))
            if not more:
                break
    groups = spec.phases * max(others, 1)
    return Pass(Layout(groups, 9, {name: (row.columns, 1.0)}), fill)


def _carried(step: StepRows, row: Moment, frame: Frame) -> tuple[NDArray, NDArray | None]:
    """Vectors (n, 3) that the sides of i and of j carry; None where the vectors of j are the opposite."""
    if row.column is None:
        return step.contacts.force, None
    on_i, on_j = row.column(frame, step.contacts)
    return on_i, on_j


def _segments(
    step: StepRows,
    moment: Moment,
    on_i: NDArray,
    on_j: NDArray | None,
    contacts: NDArray,
    second: bool,
    others: int,
    cutoff: float,
) -> tuple[Branches, NDArray, bool]:
    """Segments of the first or second particles of contacts, the longest, and whether there are second ones."""
    c = step.contacts
    smoothing = step.smoothings[cutoff]
    tilted = step.lattice.vectors is not None
    limits = step.spec.limits
    rows = ContactRows(
        c.i, c.j, c.point, on_i, on_j, step.position, step.phase, *c.lattice.for_loops
    )
    listing = SegmentChoice(rows, second, others, step.spec.by_phase, cutoff, step.spec.origin)
    if len(contacts) > MOST_LISTED_ONCE and not tilted:
        bounds = no_bounds(len(contacts), RUN)
        longest = np.empty(4)
        more = list_segments(listing, contacts, None, bounds, longest)
        if not smoothing.too_long(longest[:3]):
            smoothing.check_far(longest[:3], step.source)
            return ListedAnew(listing, contacts, bounds, limits), longest, more
    segments, longest, more = list_some(listing, contacts)
    smoothing.check_far(longest[:3], step.source)
    shift = np.zeros(3)
    if tilted:
        used = np.flatnonzero(segments[:, GROUP] >= 0.0)
        start = segments[used, :BRANCH] * cutoff + step.spec.origin
        image, shift, drifts = step.near_mesh(start, (1.0 + longest[3]) * cutoff)
        segments = segments[used[image]]
        contacts = contacts[used[image]]
        segments[:, :BRANCH] += shift / cutoff
        if "velocity" not in moment.variables:
            drifts = drifts[:0]
        for drift, here in alike(drifts):  # as seen in images that drift
            if not drift.any():
                continue
            moved = step.frame | {"velocity": step.frame["velocity"] + drift}
            on_i, on_j = _carried(step, moment, moved)
            moved_rows = rows._replace(on_i=on_i, on_j=on_j)
            moving, _, _ = list_some(listing._replace(contacts=moved_rows), contacts[here])
            segments[here, FORCE:GROUP] = moving[:, FORCE:GROUP]
    if smoothing.too_long(longest[:3]):
        partner = np.where(c.i >= 0, c.j, c.i)
        if second:
            partner = c.i
        ends = [c.point[contacts] + shift, step.position[partner[contacts]] + shift]
        longest = smoothing.cut(segments, np.array(ends), step.source)
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


def _rules(step: StepRows, longest: float, cutoff: float) -> list[_Rule]:
    """Return the ways to the weights of segments, one after the other."""
    spec = step.spec
    if not spec.coarse or not step.smoothings[cutoff].fits_single(spec.limits.max()):
        return [_Rule("float64", closed=True, rest=False)]
    rules = [_Rule("float32", closed=False, rest=False)]
    if longest > spec.limits.max():
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
