"""Integrals of kernels along lines, at one node and at many.

A segment at distance h from a point, running from t0 to t1 along its own line, contributes the
integral of the value at sqrt(h^2 + t^2) over t. Kinds and tables as in
`xcg.compiled.smoothing`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, leaf
from xcg.compiled.arrays import gauss_rules
from xcg.compiled.polynomials import (
    RADIUS,
    TINY,
    along_marginal,
    along_shells,
    clipped,
    closed_for,
    fill_lucy_lines,
    fill_lucy_planes,
    fill_shells,
    lucy_line,
    lucy_plane,
)
from xcg.compiled.reach import padded
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
# sides of the foot of a node
AFTER = 1
BEFORE = 2
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)


@inlined
def has_shells(table):
    """Return whether lines through the kernel of a table have the closed form of shells."""
    return table[SHELLS, RADIUS, 0] > 0.0


@inlined
def _lucy_profile(t, size):
    """Integral of the marginal of Lucy's kernel in one dimension over 0 < s < t; `size` is ``|t|``.

    There every line runs through the point: h = 0.
    """
    t2 = t * t
    return (
        2.0 * math.pi * t * (0.1 + t2 * (-1.0 / 6.0 + t2 * (0.3 - 4.0 / 15.0 * size + t2 / 14.0)))
    )


@inner
def _antiderivative(kind, h2, t):
    """Integral of the value over 0 < s < t along a line at distance h, for 0 <= t <= sqrt(1 - h^2)."""
    if kind is LUCY_FULL:
        return lucy_line(h2, t)
    if kind == LUCY + 1:
        return lucy_plane(h2, t)
    t2 = t * t
    if kind == LUCY + 2:
        return _lucy_profile(t, t)
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
    a0 = math.asin(max(-1.0, t0 / half))
    a1 = math.asin(min(1.0, t1 / half))
    total = 0.0
    for lower, upper in ((a0, min(a1, 0.0)), (max(a0, 0.0), a1)):
        if upper > lower:
            mean = 0.5 * (upper + lower)
            span = 0.5 * (upper - lower)
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
    # odd functions
    if t0 < 0.0:
        lower = -lower
    if t1 < 0.0:
        upper = -upper
    return upper - lower


# --- many nodes at once ----------------------------------------------------------------------------------


@leaf
def fill_segments(kind, table, length, along, q2, count, out, closed):
    """Write the mean of the value over segments, in closed form, seen from `count` nodes."""
    if kind is LUCY_FULL:
        fill_lucy_lines(length, along, q2, count, out)
    elif kind >= TABLE:
        _fill_tabulated(kind, table, length, along, q2, count, out, closed)
    elif kind == LUCY + 1:
        fill_lucy_planes(length, along, q2, count, out)
    elif kind == LUCY + 2:
        _fill_lucy_profiles(length, along, q2, count, out)
    elif kind == HEAVISIDE:
        _fill_chords(1.0, 0.0, length, along, q2, count, out)
    elif kind == HEAVISIDE + 2:
        _fill_chords(math.pi, -math.pi / 3.0, length, along, q2, count, out)
    else:
        _fill_one_by_one(kind, table, length, along, q2, count, out)


@inner
def _fill_tabulated(kind, table, length, along, q2, count, out, closed):
    if table is PLAIN:
        return
    if not has_shells(table):
        _fill_quadrature(kind, table, length, along, q2, count, out, closed[0])
    elif kind == TABLE + 1:
        _fill_one_by_one(kind, table, length, along, q2, count, out)
    else:
        fill_shells(table[SHELLS], length, along, q2, count, out, closed)


@inner
def _fill_one_by_one(kind, table, length, along, q2, count, out):
    for k in range(count):
        h2 = max(0.0, q2[k] - along[k] * along[k])
        out[k] = 0.0
        if h2 < 1.0:
            out[k] = segment(kind, table, h2, -along[k], length - along[k]) / length


@inner
def _fill_lucy_profiles(length, along, q2, count, out):
    """Write the mean over the clipped segment in one dimension, in a loop that vectorises."""
    per_length = 1.0 / length
    for k in range(padded(count)):
        a, b, _ = clipped(q2[k], along[k], length)
        out[k] = per_length * (_lucy_profile(b, abs(b)) - _lucy_profile(a, abs(a)))


@inner
def _fill_chords(flat, cube, length, along, q2, count, out):
    """Write the mean of ``flat + 3 cube t^2`` over the clipped segment, t from the foot of the node."""
    per_length = 1.0 / length
    for k in range(padded(count)):
        a, b, _ = clipped(q2[k], along[k], length)
        out[k] = per_length * (flat * (b - a) + cube * (b * b * b - a * a * a))


@inner
def _fill_quadrature(kind, table, length, along, q2, count, out, last):
    """As `_quadrature`, over t = h' 2 v / (1 + v^2) with h' half of the chord, node by node.

    `along` and `q2` are overwritten, and `last` is scratch. Points crowd about the foot of the
    node, where a kernel may have a cusp, on either side of it.
    """
    per_length = 1.0 / length
    order = _MANY
    if length <= 0.7:
        order = _FEW
    for k in range(padded(count)):
        a, b, h2 = clipped(q2[k], along[k], length)
        half2 = max(0.0, 1.0 - h2)
        half = math.sqrt(half2)
        a, b = min(a, half), min(b, half)
        along[k] = a / (half + math.sqrt(max(0.0, half2 - a * a)) + TINY)
        last[k] = b / (half + math.sqrt(max(0.0, half2 - b * b)) + TINY)
        q2[k] = h2
        out[k] = 0.0
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
    half = math.sqrt(max(0.0, 1.0 - h2))
    v = first + x * (last - first)
    turn = 1.0 / (1.0 + v * v)
    t = 2.0 * half * v * turn
    across = half * (1.0 - v * v) * turn
    return min(1.0, h2 + t * t), across, (last - first) * across * turn


# --- from Python ----------------------------------------------------------------------------------------


def mean_along(
    points: NDArray,
    end: NDArray,
    order: int,
    kind: int | None,
    table: NDArray | None,
) -> NDArray:
    """Mean of the kernel over the segment from 0 to `end` (m,), seen from points (n, m), all in cutoffs."""
    length = math.sqrt((end * end).sum())
    along = np.zeros(len(points))
    if length > 0.0:
        along = points @ end / length
    if order == 0 and length < SHORT:
        order = SHORT_ORDER
    return _means(length, order, along, (points * points).sum(axis=1), kind, table)


def _means(
    length: float,
    order: int,
    along: NDArray,
    q2: NDArray,
    kind: int | None,
    table: NDArray | None,
) -> NDArray:
    """Mean of the kernel over one segment, seen from many nodes."""
    count = along.size
    room = padded(along.size)
    feet, squares, means = np.zeros((3, room))
    feet[:count] = along
    squares[:count] = q2
    if order:
        points, weights = (rule[order] for rule in gauss_rules(order))
        fill_gauss(kind, table, points, weights, length, feet, squares, count, means)
    else:
        fill_segments(kind, table, length, feet, squares, count, means, closed_for(room))
    return means[:count]


def largest_error(
    length: float,
    order: int,
    rows: int,
    kind: int | None,
    table: NDArray | None,
) -> float:
    """Largest error of a rule over node positions about a segment, relative to the segment's largest value.

    Scans `rows` distances from the segment's line and 4 `rows` points along it (one row, h = 0,
    sees one dimension).
    """
    columns = 4 * max(rows, 32)
    along = np.tile(-1.0 + (length + 2.0) * np.arange(columns + 1) / columns, rows)
    q2 = along**2 + np.repeat((np.arange(rows) / rows) ** 2, columns + 1)
    exact = _means(length, 0, along, q2, kind, table)
    rule = _means(length, order, along, q2, kind, table)
    return float(np.abs(rule - exact).max() / exact.max())
