"""Integrals of kernels along lines, at one node and at many, and means over the cells of a mesh.

A segment at distance h from a point, running from t0 to t1 along its own line, contributes the
integral of the value at sqrt(h^2 + t^2) over t. Kinds and tables as in
`xcg.compiled.smoothing`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, leaf
from xcg.compiled.arrays import gauss_rules
from xcg.compiled.polynomials import (
    RADIUS,
    SCRATCH,
    TINY,
    along_marginal,
    along_shells,
    clipped,
    fill_lucy_lines,
    fill_lucy_planes,
    fill_shells,
    lucy_line,
    lucy_plane,
)
from xcg.compiled.reach import OF_Y, OF_Y2, OF_Z, OF_Z2, Rows, padded
from xcg.compiled.smoothing import (
    HEAVISIDE,
    LUCY,
    LUCY_FULL,
    PLAIN,
    SHELLS,
    TABLE,
    fill_gauss,
    interpolate,
    value,
)

# Below this length (in cutoffs) the closed form loses more digits in its difference than four
# points leave out.
SHORT = 1e-4
SHORT_ORDER = 4
# points of a line integral on one side of a node, for short branches and others
_FEW = 24
_MANY = 48
_LINE_POINTS, _LINE_WEIGHTS = gauss_rules(_FEW, _MANY)
AFTER, BEFORE = 1, 2  # sides of the foot of a node
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)


@inlined
def has_shells(table):
    """Return whether lines through the kernel of a table have the closed form of shells."""
    return table[SHELLS, RADIUS, 0] > 0.0


@inner
def _antiderivative(kind, h2, t):
    """Integral of the value over 0 < s < t along a line at distance h, for 0 <= t <= sqrt(1 - h^2)."""
    if kind is LUCY_FULL:
        return lucy_line(h2, t)
    if kind == LUCY + 1:
        return lucy_plane(h2, t)
    t2 = t * t
    if kind == LUCY + 2:  # seen in one dimension, where every line runs through the point: h = 0
        return (
            2.0 * math.pi * t * (0.1 + t2 * (-1.0 / 6.0 + t2 * (0.3 - 4.0 / 15.0 * t + t2 / 14.0)))
        )
    if kind == HEAVISIDE:
        return t
    if kind == HEAVISIDE + 1:
        half2 = 1.0 - h2
        rest = math.sqrt(max(0.0, half2 - t2))
        return t * rest + half2 * math.atan2(t, rest)
    return math.pi * t * (1.0 - t2 / 3.0)  # HEAVISIDE + 2, seen in one dimension


@inner
def _quadrature(kind, table, h2, t0, t1):
    """Gauss-Legendre over the angle along the chord, which takes the root at its end out of the integrand."""
    half = math.sqrt(1.0 - h2)
    a0, a1 = math.asin(max(-1.0, t0 / half)), math.asin(min(1.0, t1 / half))
    total = 0.0
    for lower, upper in ((a0, min(a1, 0.0)), (max(a0, 0.0), a1)):
        if upper > lower:
            mean, span = 0.5 * (upper + lower), 0.5 * (upper - lower)
            for g in range(_NODES.size):
                angle = mean + span * _NODES[g]
                t = half * math.sin(angle)
                q2 = min(h2 + t * t, 1.0)
                total += span * _WEIGHTS[g] * half * math.cos(angle) * value(kind, table, q2)
    return total


@inner
def _tabulated_segment(kind, table, h2, t0, t1):
    if table is PLAIN:
        return 0.0
    if not has_shells(table):
        return _quadrature(kind, table, h2, t0, t1)
    if kind == TABLE + 1:
        return along_marginal(table[SHELLS], h2, t0, t1)
    return along_shells(table[SHELLS], h2, t0, t1)


@leaf
def segment(kind, table, h2, t0, t1):
    """Integral of the value along a line at distance h from t0 to t1 (h^2 < 1, t0 < t1), exact to rounding."""
    half = math.sqrt(1.0 - h2)
    t0, t1 = max(t0, -half), min(t1, half)
    if t1 <= t0:
        return 0.0
    if kind is not LUCY_FULL and kind >= TABLE:
        return _tabulated_segment(kind, table, h2, t0, t1)
    lower = _antiderivative(kind, h2, abs(t0))
    upper = _antiderivative(kind, h2, abs(t1))
    return (upper if t1 >= 0.0 else -upper) - (lower if t0 >= 0.0 else -lower)


# --- many nodes at once ----------------------------------------------------------------------------------


@leaf
def fill_segments(kind, table, length, along, q2, count, out, ratio, bits, exponent, rows):
    """Write the mean of the value over segments, in closed form, seen from `count` nodes.

    `ratio` and `bits` are scratch, the same memory as floats and as integers, `exponent`
    (integers), and `rows`, see `xcg.compiled.polynomials`.
    """
    if kind is LUCY_FULL:
        fill_lucy_lines(1.0 / length, length, along, q2, count, out, ratio, bits, exponent)
    elif kind >= TABLE:
        _fill_tabulated(kind, table, length, along, q2, count, out, ratio, bits, exponent, rows)
    elif kind == LUCY + 1:
        fill_lucy_planes(1.0 / length, length, along, q2, count, out, ratio, bits, exponent, rows)
    elif kind == HEAVISIDE:
        _fill_chords(1.0, 0.0, 1.0 / length, length, along, q2, count, out)
    elif kind == HEAVISIDE + 2:
        _fill_chords(math.pi, -math.pi / 3.0, 1.0 / length, length, along, q2, count, out)
    else:
        _fill_one_by_one(kind, table, length, along, q2, count, out)


@inner
def _fill_tabulated(kind, table, length, along, q2, count, out, ratio, bits, exponent, rows):
    if table is PLAIN:
        return
    if not has_shells(table):
        _fill_quadrature(kind, table, 1.0 / length, length, along, q2, count, out, ratio)
    elif kind == TABLE + 1:
        _fill_one_by_one(kind, table, length, along, q2, count, out)
    else:
        fill_shells(
            table[SHELLS], 1.0 / length, length, along, q2, count, out, ratio, bits, exponent, rows
        )


@inner
def _fill_one_by_one(kind, table, length, along, q2, count, out):
    for k in range(count):
        h2 = max(0.0, q2[k] - along[k] * along[k])
        out[k] = 0.0
        if h2 < 1.0:
            out[k] = segment(kind, table, h2, -along[k], length - along[k]) / length


@inner
def _fill_chords(flat, cube, per_length, length, along, q2, count, out):
    """Write the mean of ``flat + 3 cube t^2`` over the clipped segment, t from the foot of the node."""
    for k in range(padded(count)):
        a, b, _ = clipped(q2[k], along[k], length)
        out[k] = per_length * (flat * (b - a) + cube * (b * b * b - a * a * a))


@inner
def _fill_quadrature(kind, table, per_length, length, along, q2, count, out, last):
    """As `_quadrature`, over t = h' 2 v / (1 + v^2) with h' half of the chord, node by node.

    `along` and `q2` are overwritten, and `last` is scratch. Points crowd about the foot of the
    node, where a kernel may have a cusp, on either side of it.
    """
    order = _FEW if length <= 0.7 else _MANY
    for k in range(padded(count)):
        a, b, h2 = clipped(q2[k], along[k], length)
        half2 = max(0.0, 1.0 - h2)
        half = math.sqrt(half2)
        a, b = min(a, half), min(b, half)
        along[k] = a / (half + math.sqrt(max(0.0, half2 - a * a)) + TINY)
        last[k] = b / (half + math.sqrt(max(0.0, half2 - b * b)) + TINY)
        q2[k], out[k] = h2, 0.0
    for side in (AFTER, BEFORE):
        for g in range(order):
            x = _LINE_POINTS[order, g] * _LINE_POINTS[order, g]
            weight = 4.0 * per_length * _LINE_WEIGHTS[order, g] * _LINE_POINTS[order, g]
            for k in range(count):
                r2, half, share = _crossing(along[k], last[k], q2[k], x, side)
                chord = half if kind == TABLE + 1 else 1.0
                out[k] += weight * share * chord * interpolate(table, 0, r2)


@inlined
def _crossing(first, last, h2, x, side):
    """Return the squared distance, half chord and weight of a line at the share x of its length.

    The way is that of what lies after or before the foot, away from the foot.
    """
    if side == AFTER:
        first, last = max(0.0, first), max(0.0, last)
    else:
        first, last = max(0.0, -last), max(0.0, -first)
    half, v = math.sqrt(max(0.0, 1.0 - h2)), first + x * (last - first)
    turn = 1.0 / (1.0 + v * v)
    t, across = 2.0 * half * v * turn, half * (1.0 - v * v) * turn
    return min(1.0, h2 + t * t), across, (last - first) * across * turn


# --- from Python ----------------------------------------------------------------------------------------


def closed_for(room: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Scratch of the closed form of this length: the same memory as floats and as integers, integers, and rows."""
    ratio = np.zeros(room)
    return ratio, ratio.view("int64"), np.zeros(room, "int64"), np.zeros((SCRATCH, room))


def mean_along(
    points: NDArray,
    end: NDArray,
    order: int,
    kind: int | None,
    table: NDArray | None,
) -> NDArray:
    """Mean of the kernel over the segment from 0 to `end` (m,), seen from points (n, m), all in cutoffs."""
    length = math.sqrt((end * end).sum())
    along = points @ end / length if length > 0.0 else np.zeros(len(points))
    rule = SHORT_ORDER if length < SHORT and order == 0 else order
    return _means(length, rule, along, (points * points).sum(axis=1), kind, table)


def _means(
    length: float,
    order: int,
    along: NDArray,
    q2: NDArray,
    kind: int | None,
    table: NDArray | None,
) -> NDArray:
    """Mean of the kernel over one segment, seen from many nodes."""
    count, room = along.size, padded(along.size)
    lists = np.zeros((3, room))
    lists[0, :count], lists[1, :count] = along, q2
    if order:
        fill_gauss(kind, table, *gauss_rules(order), order, length, *lists[:2], count, lists[2])
    else:
        fill_segments(kind, table, length, *lists[:2], count, lists[2], *closed_for(room))
    return lists[2, :count]


def largest_error(
    length: float,
    order: int,
    rows: int,
    kind: int | None,
    table: NDArray | None,
) -> float:
    """Largest error of a rule over node positions about a segment, relative to the segment's largest value.

    Scans `rows` distances from the segment's line and 4 `rows` places along it (one row, h = 0,
    sees one dimension).
    """
    columns = 4 * max(rows, 32)
    along = np.tile(-1.0 + (length + 2.0) * np.arange(columns + 1) / columns, rows)
    q2 = along**2 + np.repeat((np.arange(rows) / rows) ** 2, columns + 1)
    exact = _means(length, 0, along, q2, kind, table)
    rule = _means(length, order, along, q2, kind, table)
    return float(np.abs(rule - exact).max() / exact.max())


# --- means over cells ------------------------------------------------------------------------------------
#
# A cell is a box about its node. The mean of the kernel over it, ``(1 / V) int Psi(x - o) do``, is
# a kernel of its own, so that sums with it work as for any kernel, counts and squares of weights
# included.
#
# Along the last of the axes that have an extent the integral is the closed form of a line. Along
# the others it is by Gauss-Legendre points within the part of the cell that the support reaches:
# over the angle along the chord, which takes the root at its end out of the integrand, and on
# either side of the grain's centre, where the kernel may have a cusp. Kernels that are not smooth
# at radii within the support, their *rims*, take points between each two of them. Weights of these
# points are positive. Lengths are in units of the cutoff and relative to the first node.


# Gauss-Legendre points for a part of no length, and more for one from rim to rim: errors are in
# docs/evaluation.md
FEWEST, PER_RIM = 3, 5
_CELL_POINTS, _CELL_WEIGHTS = gauss_rules(*range(1, FEWEST + PER_RIM + 1))


class Volumes(NamedTuple):
    """Nodes of a mesh and the cells around them.

    Attributes
    ----------
    rows : Rows
        The nodes.
    half : tuple of float
        Half of the cell's extent along each axis; 0 along axes that are not resolved.
    order : tuple of int
        The axes, those without an extent first.
    """

    rows: Rows
    half: tuple[float, float, float]
    order: tuple[int, int, int]


@inner
def _list_points(place, half, inner2, outer2, apart, values, at, weight):
    """Write points, and weights, of the integral over an interval about a place, between two squared distances from 0.

    The number of points rises with the length, over the root of how far apart two rims are, as
    there is less to follow between close ones. An interval without an extent is one point. Returns
    the number of points.
    """
    if half == 0.0:
        values[at, 0], values[weight, 0] = place, 1.0
        return 1 if inner2 <= place * place < outer2 else 0
    nearest, radius, count = math.sqrt(inner2), math.sqrt(outer2), 0
    lowest, highest = max(place - half, -radius), min(place + half, radius)
    for low, high in ((lowest, min(highest, -nearest)), (max(lowest, nearest), highest)):
        if low < high:
            many = FEWEST + math.ceil(PER_RIM * min(1.0, (high - low) / math.sqrt(apart)))
            first = math.asin(low / radius)
            turn = math.asin(high / radius) - first
            for k in range(many):
                angle = first + turn * _CELL_POINTS[many, k]
                values[at, count] = radius * math.sin(angle)
                values[weight, count] = _CELL_WEIGHTS[many, k] * turn * radius * math.cos(angle)
                count += 1
    return count


@inner
def _integrals_along(q2, place, half, step, node, many, kind, table, factor, out, first):
    """Add to `many` nodes along an axis, from one on, the integral of the kernel over the extent of each."""
    for k in range(many):
        middle = place - (node + k) * step  # the same bits whichever block the nodes are in
        if half > 0.0:
            out[first + k] += factor * segment(kind, table, q2, middle - half, middle + half)
        elif q2 + middle * middle < 1.0:
            out[first + k] += factor * value(kind, table, q2 + middle * middle)


@inner
def _add_columns(
    da,
    half_a,
    db,
    half_b,
    dc,
    half_c,
    step,
    node,
    many,
    kind,
    table,
    rims,
    norm,
    values,
    out,
    at,
):
    """Add the integral of the kernel over the cells of `many` nodes of a row along the last axis."""
    nearest = 0.0
    for farthest in rims:
        apart = farthest - nearest
        for i in range(
            _list_points(
                da, half_a, nearest * nearest, farthest * farthest, apart, values, OF_Y, OF_Y2
            )
        ):
            across2, inner, inner2 = values[OF_Y, i] * values[OF_Y, i], 0.0, 0.0
            for rim in rims:
                outer2 = rim * rim - across2
                if outer2 > 0.0:
                    for j in range(
                        _list_points(db, half_b, inner2, outer2, rim - inner, values, OF_Z, OF_Z2)
                    ):
                        q2 = across2 + values[OF_Z, j] * values[OF_Z, j]
                        here = norm * values[OF_Y2, i] * values[OF_Z2, j]
                        if q2 < 1.0:
                            _integrals_along(
                                q2, dc, half_c, step, node, many, kind, table, here, out, at
                            )
                    inner2 = outer2
                inner = rim
        nearest = farthest


@inner
def integrate_row(da, db, dc, node, many, share, volumes, kernel, values, out, first):
    """Add a share of the mean of the kernel over the cells of `many` nodes of a row along the last axis.

    A point minus the first of them, number `node` along that axis, is (da, db, dc - node x step),
    in the order of the axes. Where cells cover the whole support along an axis, the marginal takes
    the place of points there.
    """
    kind, table, norm, rims, once, twice, _ = kernel
    norm *= share
    (a, b, c), half = volumes.order, volumes.half
    half_a, half_b, half_c, step, covered = half[a], half[b], half[c], volumes.rows.steps[c], 0
    for k in range(3):
        if half[k] > 0.0:
            norm /= 2.0 * half[k]
    if abs(da) + 1.0 <= half_a:
        da, half_a, covered = 0.0, 0.0, 1
    if abs(db) + 1.0 <= half_b:
        db, half_b, covered = 0.0, 0.0, covered + 1
    cells = da, half_a, db, half_b, dc, half_c, step, node, many
    if covered == 0:
        _add_columns(*cells, kind, table, rims, norm, values, out, first)
    elif covered == 1:
        _add_columns(*cells, once.kind, once.table, rims, norm, values, out, first)
    else:
        _add_columns(*cells, twice.kind, twice.table, rims, norm, values, out, first)
