"""Sums over segments: every contact adds force times branch, smeared along the branch, to the nodes it reaches.

Lengths are in units of the cutoff and relative to the first node. The weight of a node is the mean of the kernel
over the segment, ``S = int_0^1 Psi(r - start + u a) du`` with the segment running from `start` to ``start - a``. It
comes from the closed form, or from the fewest Gauss-Legendre points that meet the asked accuracy for a branch of
that length.
"""

import math

import numpy as np

from xcg.kernels._jit import jit, leaf
from xcg.kernels.lanes import add_four
from xcg.kernels.nodes import (
    ALONG,
    LISTS,
    NODE,
    Q2,
    ROW2,
    RUN,
    WEIGHT,
    images,
    list_tube,
    numbers_for,
    padded,
    room_for,
    run_reaches,
)
from xcg.kernels.weights import fill_gauss, fill_segments

MAX_ORDER = 6
GAUSS_POINTS = np.zeros((MAX_ORDER + 1, MAX_ORDER))
GAUSS_WEIGHTS = np.zeros((MAX_ORDER + 1, MAX_ORDER))
for _order in range(1, MAX_ORDER + 1):
    _x, _w = np.polynomial.legendre.leggauss(_order)
    GAUSS_POINTS[_order, :_order], GAUSS_WEIGHTS[_order, :_order] = 0.5 + 0.5 * _x, 0.5 * _w

# Below this length (in cutoffs) the closed form loses more digits in its difference than four points leave out.
SHORT = 1e-4
SHORT_ORDER = 4
_LAST = np.uint64(8)


@leaf
def choose_order(length, limits):
    """Fewest points whose error bound holds up to this length; 0, the closed form, where none does."""
    if length < SHORT:
        return SHORT_ORDER
    for order in range(1, limits.size + 1):
        if length <= limits[order - 1]:
            return order
    return 0


@jit
def deposit_segments(
    start, branch, force, phase, limits, coarse, runs, longest, low, high, steps, active, period,
    kind, spread, table, norm, moments,
):  # fmt: skip
    """Add force x branch of each segment to the nodes that its tube of radius 1 reaches.

    Parameters
    ----------
    start : (n, 3)
        Centre of the particle, relative to the first node, in cutoffs.
    branch : (n, 3)
        From the end of the segment to its start, in cutoffs.
    force : (n, 3)
        Force on the particle, times the cutoff, so that force x branch is in the caller's units.
    phase : (n,)
        Which group each segment belongs to.
    limits : (k,)
        Longest branch (cutoffs) for which 1, 2, ... k points are accurate enough; empty for the closed form.
    coarse : True or None
        Whether single precision is enough for distances and weights, where points are taken; sums are in double.
        None leaves that code out when the kernel is compiled.
    longest : tuple
        Largest component of a branch along each axis, for the length of the lists.
    runs, low, high, steps, active, period, kind, spread, table, norm
        As in `deposit`.
    moments : (phases, nodes of the box, 9)
        Sums, added to: force component by branch component, row by row.
    """
    begin = (low[0] * steps[0], low[1] * steps[1], low[2] * steps[2])
    end = ((high[0] - 1) * steps[0], (high[1] - 1) * steps[1], (high[2] - 1) * steps[2])
    per_steps = (1.0 / steps[0], 1.0 / steps[1], 1.0 / steps[2])
    reach = (1.0 if active[0] else 0.0, 1.0 if active[1] else 0.0, 1.0 if active[2] else 0.0)
    most = (2.0 * reach[0] + longest[0], 2.0 * reach[1] + longest[1], 2.0 * reach[2] + longest[2])
    room = room_for(low, high, most, steps)
    # views of lists are made here, as their memory is counted
    lists, numbers, exponent = np.zeros((LISTS, room)), numbers_for(room, high[2] - low[2]), np.zeros(room, np.int64)
    q2, along, w, ratio = lists[Q2], lists[ALONG], lists[WEIGHT], lists[ROW2]
    bits = ratio.view(np.int64)
    if coarse is not None:
        singles = np.zeros((LISTS, room), np.float32)
        q2_single, along_single, w_single = singles[Q2], singles[ALONG], singles[WEIGHT]
    here = True
    for i in range(start.shape[0]):
        if i % RUN == 0:
            here = run_reaches(runs, i // RUN, begin, end, active, period)
        if not here:
            continue
        p = np.uint64(phase[i])
        x0 = start[i, 0] if active[0] else 0.0
        y0 = start[i, 1] if active[1] else 0.0
        z0 = start[i, 2] if active[2] else 0.0
        bx = -branch[i, 0] if active[0] else 0.0
        by = -branch[i, 1] if active[1] else 0.0
        bz = -branch[i, 2] if active[2] else 0.0
        low_x, high_x = min(0.0, bx) - reach[0], max(0.0, bx) + reach[0]
        low_y, high_y = min(0.0, by) - reach[1], max(0.0, by) + reach[1]
        low_z, high_z = min(0.0, bz) - reach[2], max(0.0, bz) + reach[2]
        first_x, last_x = images(x0, low_x, high_x, begin[0], end[0], period[0])
        first_y, last_y = images(y0, low_y, high_y, begin[1], end[1], period[1])
        first_z, last_z = images(z0, low_z, high_z, begin[2], end[2], period[2])
        if first_x > last_x or first_y > last_y or first_z > last_z:
            continue
        length = math.sqrt(bx * bx + by * by + bz * bz)
        order = choose_order(length, limits)
        per_length = 1.0 / length if length > 0.0 else 0.0
        for image_x in range(first_x, last_x + 1):
            x = x0 + image_x * period[0] if image_x else x0
            for image_y in range(first_y, last_y + 1):
                y = y0 + image_y * period[1] if image_y else y0
                for image_z in range(first_z, last_z + 1):
                    z = z0 + image_z * period[2] if image_z else z0
                    if coarse is not None and order:
                        hits = list_tube(x, y, z, bx, by, bz, per_length, steps, per_steps, low, high, singles, numbers)
                        fill_gauss(
                            kind, spread, table, 1.0, GAUSS_POINTS, GAUSS_WEIGHTS, order, length, along_single,
                            q2_single, hits, w_single,
                        )  # fmt: skip
                        _add_dyad(moments, p, numbers, hits, w_single, norm, force, branch, i)
                        continue
                    hits = list_tube(x, y, z, bx, by, bz, per_length, steps, per_steps, low, high, lists, numbers)
                    if order:
                        fill_gauss(
                            kind, spread, table, norm, GAUSS_POINTS, GAUSS_WEIGHTS, order, length, along, q2, hits, w
                        )
                    else:
                        fill_segments(kind, spread, table, norm, length, along, q2, hits, w, ratio, bits, exponent)
                    _add_dyad(moments, p, numbers, hits, w, 1.0, force, branch, i)


@leaf
def _add_dyad(moments, p, numbers, hits, w, factor, force, branch, i):
    """Add weight x factor x force x branch of segment i to the nine columns of each node."""
    f0, f1, f2 = factor * force[i, 0], factor * force[i, 1], factor * force[i, 2]
    a0, a1, a2 = branch[i, 0], branch[i, 1], branch[i, 2]
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = (
        f0 * a0, f0 * a1, f0 * a2, f1 * a0, f1 * a1, f1 * a2, f2 * a0, f2 * a1, f2 * a2,
    )  # fmt: skip
    for k in range(hits):
        n, v = np.uint64(numbers[NODE, k]), np.float64(w[k])
        add_four(moments, p, n, 0, v, c0, c1, c2, c3)
        add_four(moments, p, n, 4, v, c4, c5, c6, c7)
        moments[p, n, _LAST] += v * c8


@jit
def _means(length, order, along, q2, kind, spread, table):
    """Mean of the kernel over one segment, seen from many nodes."""
    count, room = along.size, padded(along.size)
    lists = np.zeros((4, room))
    lists[0, :count], lists[1, :count] = along, q2
    if order:
        fill_gauss(
            kind, spread, table, 1.0, GAUSS_POINTS, GAUSS_WEIGHTS, order, length, lists[0], lists[1], count, lists[2]
        )
    else:
        ratio, exponent = lists[3], np.empty(room, np.int64)
        fill_segments(
            kind, spread, table, 1.0, length, lists[0], lists[1], count, lists[2], ratio, ratio.view(np.int64), exponent
        )
    return lists[2, :count].copy()


@jit
def mean_along(points, end, order, kind, spread, table):
    """Mean of the kernel over the segment from 0 to `end` (m,), seen from points (n, m), all in cutoffs."""
    length = math.sqrt((end * end).sum())
    along, q2 = np.zeros(points.shape[0]), np.zeros(points.shape[0])
    for i in range(points.shape[0]):
        for k in range(end.size):
            q2[i] += points[i, k] ** 2
            along[i] += points[i, k] * end[k] / length if length > 0.0 else 0.0
    rule = SHORT_ORDER if length < SHORT and order == 0 else order
    return _means(length, rule, along, q2, kind, spread, table)


@jit
def largest_error(length, order, rows, kind, spread, table):
    """Largest error of a rule over node positions about a segment, relative to the segment's largest value.

    Scans `rows` distances from the segment's line and 4 `rows` places along it (one row, h = 0, sees one dimension).
    """
    columns = 4 * max(rows, 32)
    along, q2 = np.empty(rows * (columns + 1)), np.empty(rows * (columns + 1))
    for i in range(rows):
        for j in range(columns + 1):
            t = -1.0 + (length + 2.0) * j / columns
            along[i * (columns + 1) + j] = t
            q2[i * (columns + 1) + j] = t * t + (i / rows) ** 2
    exact = _means(length, 0, along, q2, kind, spread, table)
    rule = _means(length, order, along, q2, kind, spread, table)
    return np.abs(rule - exact).max() / exact.max()
