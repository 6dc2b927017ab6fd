"""Means of the kernel over cells from tables, and the cells that a grain or a segment reaches.

The mean depends on the distance to the node along each axis alone, so where two or three axes have
an extent, loops take it from a table, by Lagrange's polynomials of degree 5 along each axis. A cell
is a whole number of intervals of the table, and the table is divided by its own sums over all
cells, so that the means of a point over all cells add up to one. Means close to zero, which would
lose their digits and their sign, are integrated (`xcg.compiled.lines`), and all are where the table
is not accurate, as of kernels that jump.

Lengths are in units of the cutoff and relative to the first node.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, jit
from xcg.compiled.arrays import gauss_rules
from xcg.compiled.lines import Volumes, integrate_row
from xcg.compiled.reach import LISTS, NO_BRANCH, NODE, ROW_Y, WEIGHT, Rows, X, Y, Z, node_range
from xcg.compiled.smoothing import CellKernel

_AXES = (X, Y, Z)
# Of integrals, in units of the norm: kernels may have negative parts, and those that have none are
# zero at their rim.
_ROUNDING = 1e-12
# places that a mean is interpolated from, and how many of them lie before it
TAPS = 6
BEFORE = 2
FINEST = 16  # places of a table for each cutoff, at least
MOST_PLACES = 1 << 19  # of a table; smaller cells are integrated
_PROBES = 1000  # places where the error of a table is measured
# What is smaller than this share of the largest mean, or times the error, is integrated, and all
# beyond this error.
_SMALL = 1e-6
_IN_HAND = 4.0
_WORST = 1e-4
_MOST_TABLES = 8
LONGEST_LINE = 256  # places of a table along an axis, and numbers of scratch
LINE = ROW_Y
# Seen from cells, which smooth it once more, a branch is this many Gauss-Legendre points for each
# cutoff of its length.
IN_CELL = 6
_POINTS, _WEIGHTS = gauss_rules(IN_CELL)


class CellMeans(NamedTuple):
    """Means of the kernel over a cell by the distance to its node along each axis, in the order of `Volumes`.

    Attributes
    ----------
    table : (na, nb, nc)
        Means in units of the norm, from `BEFORE` places before the first distance on.
    first, per_step : tuple of float
        Distance before which means do not change, and places for each cutoff.
    least : float
        What is smaller is integrated; infinite where all is, as without a table.
    """

    table: NDArray
    first: tuple[float, float, float]
    per_step: tuple[float, float, float]
    least: float


INTEGRATED = CellMeans(np.zeros((1, 1, 1)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), math.inf)
_tables: dict[Any, CellMeans] = {}


def cell_means(
    half: tuple[float, float, float], seen: int, kernel: CellKernel, integral: float
) -> CellMeans:
    """Tabulate the means of a kernel over a cell of half the extent `half`, in cutoffs.

    `seen` is the number of axes along which distance counts, and `integral` that of the kernel
    without its norm. `INTEGRATED` without a table: if one axis alone has an extent, an axis that is
    seen has none, cells are very small, or the table would not be accurate.
    """
    if not 2 <= sum(h > 0.0 for h in half) == seen:
        return INTEGRATED
    key: tuple[Any, ...] = (half, integral, kernel.rims.tobytes())
    for function in (kernel, kernel.once, kernel.twice):
        table = None if function.table is None else function.table.tobytes()
        key += (function.kind, table)
    if key not in _tables:
        if len(_tables) == _MOST_TABLES:
            _tables.clear()
        _tables[key] = _tabulated(half, kernel._replace(norm=1.0, means=INTEGRATED), integral)
    return _tables[key]


def _tabulated(half: tuple[float, float, float], kernel: CellKernel, integral: float) -> CellMeans:
    order = sorted(range(3), key=lambda k: half[k] > 0.0)
    axes = [_axis(half[k]) for k in order]
    shape = [len(axis.distances) for axis in axes]
    if math.prod(shape) > MOST_PLACES or max(shape) + TAPS > LONGEST_LINE:
        return INTEGRATED
    a, b, c = order
    rows = Rows((0, 0, 0), (1, 1, 1), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
    volumes = Volumes(rows, half, (a, b, c))
    values = np.zeros(shape)
    scratch = np.zeros((LISTS, LONGEST_LINE))
    _fill_means(volumes, kernel, *(axis.distances for axis in axes), scratch, values)
    # the means of a point over all cells, which their volume makes the integral
    total = np.einsum("abc,xa,yb,zc->xyz", values, *(axis.cells for axis in axes), optimize=True)
    volume = math.prod(2.0 * h for h in half if h > 0.0)
    values *= integral / volume / total[np.ix_(*(axis.group for axis in axes))]
    table = np.ascontiguousarray(values[np.ix_(*(axis.place for axis in axes))])
    first_a, first_b, first_c = (float(axis.distances[0]) for axis in axes)
    per_a, per_b, per_c = (axis.per_step for axis in axes)
    means = CellMeans(table, (first_a, first_b, first_c), (per_a, per_b, per_c), 0.0)
    ends = np.array([[axis.distances[0], axis.distances[-1]] for axis in axes])
    probes = ends[:, 0] + np.random.default_rng(0).random((_PROBES, 3)) * np.diff(ends)[:, 0]
    error = _largest_error(probes, volumes, kernel, means, scratch, np.zeros(2))
    largest = float(np.abs(values).max())
    if error > _WORST * largest:
        return INTEGRATED
    return means._replace(least=max(_SMALL * largest, _IN_HAND * error))


class _Axis(NamedTuple):
    """Places of a table along one axis.

    Attributes
    ----------
    per_step : float
        Distances for each cutoff.
    distances : (n,)
        From the node, rising.
    place : (m,)
        Which of them each place of the table has.
    cells : (groups, n)
        How many cells lie at each distance from a point; a row for each place of a point in its
        cell, of which mirror images are one.
    group : (n,)
        Which of these rows each distance belongs to.
    """

    per_step: float
    distances: NDArray
    place: NDArray
    cells: NDArray
    group: NDArray


def _axis(half: float) -> _Axis:
    if half == 0.0:
        return _Axis(1.0, np.zeros(1), np.zeros(TAPS, int), np.ones((1, 1)), np.zeros(1, int))
    if half > 1.0:
        return _axis_of_large_cells(half)
    within = math.ceil(half * max(2 * FINEST, 4.0 / half))  # intervals in a cell
    step = 2.0 * half / within
    many = math.ceil((half + 1.0) / step) + 1
    number = np.arange(many)
    cells = np.zeros((within // 2 + 1, many))
    for k in range(len(cells)):
        beside = np.abs(k + within * np.arange(-many, many + 1))
        np.add.at(cells[k], beside[beside < many], 1.0)
    turn = number % within
    place = np.abs(np.arange(many + TAPS - 1) - BEFORE).clip(max=many - 1)
    return _Axis(1.0 / step, step * number, place, cells, np.minimum(turn, within - turn))


def _axis_of_large_cells(half: float) -> _Axis:
    """Places along an axis where a cell holds the support from end to end before the first one."""
    first = half - 1.0
    within = 2 * FINEST  # intervals in the support
    step = 1.0 / FINEST
    many = math.ceil((half + 1.0 - first) / step) + 1
    number = np.arange(many)
    cells = np.zeros((within // 2 + 1, many))
    for k in range(len(cells)):
        beside = np.array([k, within - k])
        np.add.at(cells[k], beside[beside < many], 1.0)
    group = np.minimum(number, within - number).clip(0)
    place = (np.arange(many + TAPS - 1) - BEFORE).clip(0, many - 1)
    return _Axis(1.0 / step, first + step * number, place, cells, group)


@jit
def _fill_means(volumes, kernel, distances_a, distances_b, distances_c, values, out):
    """Write the integrals of the means at all distances."""
    for i in range(distances_a.size):
        for j in range(distances_b.size):
            for k in range(distances_c.size):
                place = (distances_a[i], distances_b[j], distances_c[k])
                integrate_row(place, 0, 1, 1.0, volumes, kernel, values, out[i, j], k)


@jit
def _largest_error(places, volumes, kernel, means, values, both):
    """Largest difference between means at some places and those from their table."""
    error = 0.0
    for i in range(places.shape[0]):
        both[:] = 0.0
        place = (places[i, 0], places[i, 1], places[i, 2])
        integrate_row(place, 0, 1, 1.0, volumes, kernel, values, both, 0)
        _interpolate_row(place, 0, 1, 1.0, volumes, means, values, both, 1)
        error = max(error, abs(both[0] - both[1]))
    return error


@inlined
def _taps(distance, first, per_step, last):
    """First of the places that a mean at a distance is interpolated from, and the weights of all."""
    x = max(0.0, abs(distance) - first) * per_step
    k = min(np.int64(x), last)
    f = x - k
    a, b = f + 2.0, f + 1.0
    c = f - 1.0
    d = f - 2.0
    e = f - 3.0
    ab = a * b
    de = d * e
    ce = c * e
    weights = (
        b * f * c * de / -120.0,
        a * f * c * de / 24.0,
        ab * c * de / -12.0,
        ab * f * de / 12.0,
        ab * f * ce / -24.0,
        ab * f * c * d / 120.0,
    )
    return k, weights


@inner
def _line_of_means(da, db, low, high, means, line):
    """Write the means at two distances, and all between two others along the last axis, to `line`."""
    table = means.table
    i, wa = _taps(da, means.first[0], means.per_step[0], table.shape[0] - TAPS)
    j, wb = _taps(db, means.first[1], means.per_step[1], table.shape[1] - TAPS)
    last = table.shape[2] - TAPS
    begin, _ = _taps(low, means.first[2], means.per_step[2], last)
    end, _ = _taps(high, means.first[2], means.per_step[2], last)
    for n in range(begin, end + TAPS):
        line[n] = 0.0
    for k in range(TAPS):
        w = wa[k]
        rows = table[i + k]
        w0, w1, w2 = w * wb[0], w * wb[1], w * wb[2]
        w3, w4, w5 = w * wb[3], w * wb[4], w * wb[5]
        for n in range(begin, end + TAPS):
            left = w0 * rows[j, n] + w1 * rows[j + 1, n] + w2 * rows[j + 2, n]
            line[n] += left + (w3 * rows[j + 3, n] + w4 * rows[j + 4, n] + w5 * rows[j + 5, n])


@inlined
def _mean_of_line(dc, means, line):
    k, w = _taps(dc, means.first[2], means.per_step[2], means.table.shape[2] - TAPS)
    left = w[0] * line[k] + w[1] * line[k + 1] + w[2] * line[k + 2]
    return left + (w[3] * line[k + 3] + w[4] * line[k + 4] + w[5] * line[k + 5])


@inner
def _interpolate_row(place, node, many, share, volumes, means, values, out, first):
    """As `integrate_row`, from the table of means; cells that the support does not reach are left out."""
    a, b, c = volumes.order
    da, db, dc = place
    half = volumes.half
    across2 = max(0.0, abs(da) - half[a]) ** 2 + max(0.0, abs(db) - half[b]) ** 2
    if across2 >= 1.0:
        return
    step = volumes.rows.steps[c]
    half_c = half[c]
    line = values[LINE]
    begin = dc - node * step
    end = dc - (node + many - 1) * step
    nearest = 0.0
    if begin * end >= 0.0:
        nearest = min(abs(begin), abs(end))
    _line_of_means(da, db, nearest, max(abs(begin), abs(end)), means, line)
    for k in range(many):
        distance = dc - (node + k) * step
        along = max(0.0, abs(distance) - half_c)
        if across2 + along * along < 1.0:
            out[first + k] += share * _mean_of_line(distance, means, line)


@inlined
def _add_row(place, node, many, volumes, kernel, values, out, first):
    """Add the mean of the kernel over the cells of a row, from the table where that holds enough digits."""
    means = kernel.means
    if means.least == math.inf:
        integrate_row(place, node, many, 1.0, volumes, kernel, values, out, first)
        return
    _interpolate_row(place, node, many, kernel.norm, volumes, means, values, out, first)
    least = means.least * kernel.norm
    for k in range(many):
        if out[first + k] != 0.0 and abs(out[first + k]) < least:
            out[first + k] = 0.0
            integrate_row(place, node + k, 1, 1.0, volumes, kernel, values, out, first + k)


@inner
def mean_over_cell(x, y, z, volumes, kernel, values, out, k):
    """Write the mean of the kernel over the cell of a node to place k, for a point minus the node."""
    offset = (x, y, z)
    a, b, c = volumes.order
    out[k] = 0.0
    _add_row((offset[a], offset[b], offset[c]), 0, 1, volumes, kernel, values, out, k)


@inner
def volumes_in_ball(x, y, z, volumes, kernel, lists):
    """List the nodes whose cells are closer than 1 to a point, and the mean of the kernel over each.

    Parameters
    ----------
    x, y, z : float
        The point.
    volumes : Volumes
        Indices are counted within this block.
    kernel : CellKernel
        The smoothing function.
    lists : Lists
        Written: numbers[NODE], the indices, values[X], values[Y] and values[Z], the point minus the
        node, and values[WEIGHT], the means.

    Returns
    -------
    int
        Number of nodes listed.
    """
    if volumes is None:
        return 0
    values = lists.values
    numbers = lists.numbers
    low, high, steps, _ = volumes.rows
    place = (x, y, z)
    a, b, c = volumes.order
    strides = ((high[1] - low[1]) * (high[2] - low[2]), high[2] - low[2], 1)
    first_a, end_a = _range_along(a, place, NO_BRANCH, volumes)
    first_b, end_b = _range_along(b, place, NO_BRANCH, volumes)
    first_c, end_c = _range_along(c, place, NO_BRANCH, volumes)
    many = end_c - first_c
    hits = 0
    weight = values[WEIGHT]
    least = -_ROUNDING * kernel.norm
    for ia in range(first_a, end_a):
        da = place[a] - ia * steps[a]
        for ib in range(first_b, end_b):
            db = place[b] - ib * steps[b]
            for k in range(many):
                weight[hits + k] = 0.0
            line = (da, db, place[c])
            _add_row(line, first_c, many, volumes, kernel, values, weight, hits)
            row = (ia - low[a]) * strides[a] + (ib - low[b]) * strides[b]
            begin = hits
            for k in range(many):
                if weight[begin + k] > 0.0 or weight[begin + k] < least:
                    weight[hits] = weight[begin + k]
                    values[_AXES[a], hits] = da
                    values[_AXES[b], hits] = db
                    values[_AXES[c], hits] = place[c] - (first_c + k) * steps[c]
                    numbers[NODE, hits] = row + (first_c + k - low[c]) * strides[c]
                    hits += 1
    return hits


@inner
def volumes_along_segment(place, branch, length, volumes, kernel, lists):
    """List the nodes whose cells a segment reaches, and the mean over the segment of the mean of the kernel over each.

    Parameters
    ----------
    place, branch : tuple of float
        The segment, from a point to that point plus the branch.
    length : float
        Its length.
    volumes, kernel, lists
        As of `volumes_in_ball`; values[X], values[Y] and values[Z] are not written.

    Returns
    -------
    int
        Number of nodes listed.
    """
    if volumes is None:
        return 0
    parts = max(1, math.ceil(length))
    values = lists.values
    numbers = lists.numbers
    low, high, steps, _ = volumes.rows
    a, b, c = volumes.order
    strides = ((high[1] - low[1]) * (high[2] - low[2]), high[2] - low[2], 1)
    first_a, end_a = _range_along(a, place, branch, volumes)
    first_b, end_b = _range_along(b, place, branch, volumes)
    first_c, end_c = _range_along(c, place, branch, volumes)
    many = end_c - first_c
    hits = 0
    weight = values[WEIGHT]
    means = kernel.means
    for ia in range(first_a, end_a):
        da = place[a] - ia * steps[a]
        for ib in range(first_b, end_b):
            db = place[b] - ib * steps[b]
            for k in range(many):
                weight[hits + k] = 0.0
            for part in range(parts):
                for g in range(IN_CELL):
                    u = (part + _POINTS[IN_CELL, g]) / parts
                    share = _WEIGHTS[IN_CELL, g] / parts
                    line = (da + u * branch[a], db + u * branch[b], place[c] + u * branch[c])
                    if means.least == math.inf:
                        integrate_row(
                            line, first_c, many, share, volumes, kernel, values, weight, hits
                        )
                    else:
                        share *= kernel.norm
                        _interpolate_row(
                            line, first_c, many, share, volumes, means, values, weight, hits
                        )
            row = (ia - low[a]) * strides[a] + (ib - low[b]) * strides[b]
            begin = hits
            for k in range(many):
                if weight[begin + k] != 0.0:
                    weight[hits] = weight[begin + k]
                    numbers[NODE, hits] = row + (first_c + k - low[c]) * strides[c]
                    hits += 1
    return hits


@inlined
def _range_along(k, place, branch, volumes):
    """First and one past the last of the nodes along axis k whose cells are closer than 1 to a segment's ends."""
    low, high, _, per_steps = volumes.rows
    reach = volumes.half[k] + 1.0
    lowest = min(0.0, branch[k]) + place[k] - reach
    highest = max(0.0, branch[k]) + place[k] + reach
    return node_range(lowest, highest, per_steps[k], low[k], high[k])
