"""Which of scattered points a grain or a branch reaches: points lie in cells, and those of a row of cells together.

The twins of `nodes_in_ball` and `nodes_around_segment` for points that form no mesh. Lengths are in units of the
cutoff, as for a mesh. Cells are numbered ``(ix ny + iy) nz + iz``, and points are sorted by the cell that they are in,
so that the points of neighbouring cells along z are one run. The distances of a run are computed in a loop that the
compiler turns into vector instructions; then the numbers of those within reach are written, eight at a time, and last
comes what the lists hold of them.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import leaf
from xcg.compiled.reach import ALONG, LISTS, NODE, NUMBERS, PAD, Q2, ROW, ROW2, ROW_DOT, ROW_Y, Lists, X, Y, Z, padded
from xcg.compiled.simd import EIGHT, keep8

_EIGHT = np.uint64(EIGHT)


class Cells(NamedTuple):
    """Points of a block in cells.

    Attributes
    ----------
    x, y, z : (n + PAD,)
        The points, sorted by cell; 0 along axes that do not count, and beyond the last.
    start : (cells + 1,)
        The first point of each cell, unsigned.
    lower, size, per_size : tuple of float
        Lower corner of the cells, their size, and its inverse: 0 along axes with one cell.
    shape : tuple of int
        Number of cells along each axis.
    margin : float
        What rounding may move a point by, as seen from its cell.
    """

    x: NDArray
    y: NDArray
    z: NDArray
    start: NDArray
    lower: tuple[float, float, float]
    size: tuple[float, float, float]
    per_size: tuple[float, float, float]
    shape: tuple[int, int, int]
    margin: float


def lists_for_points(count: int, real: str = "float64") -> Lists:
    """Make lists for up to `count` points; the integers come with a table of their numbers."""
    room = padded(count) + PAD
    numbers = np.zeros((NUMBERS, room), "int32")
    numbers[ROW] = np.arange(room)
    return Lists(np.zeros((LISTS, room), real), numbers)


@leaf
def _cell_range(low, high, lower, per_size, count):
    """First and one past the last of the cells that meet an interval."""
    first = math.floor(min(max((low - lower) * per_size, 0.0), float(count)))
    last = math.floor(min(max((high - lower) * per_size, -1.0), float(count - 1)))
    return first, last + 1


@leaf
def _beyond(x, k, lower, size, per_size, margin):
    """How far a place is at least from cell k of an axis; nothing where there is one cell only."""
    if per_size == 0.0:
        return 0.0
    low = lower + k * size
    return max(0.0, max(low - x, x - low - size) - margin)


@leaf
def points_in_ball(x, y, z, cells, lists):
    """List the points of some cells that are closer than 1 to a place, as `nodes_in_ball` does."""
    values, numbers = lists.values, lists.numbers
    px, py, pz, start, margin = cells.x, cells.y, cells.z, cells.start, cells.margin
    lower, size, per_size, shape = cells.lower, cells.size, cells.per_size, cells.shape
    q2, reach, hits = values[ROW2], 1.0 + margin, np.uint64(0)
    x0, x1 = _cell_range(x - reach, x + reach, lower[0], per_size[0], shape[0])
    y0, y1 = _cell_range(y - reach, y + reach, lower[1], per_size[1], shape[1])
    for ix in range(x0, x1):
        dx = _beyond(x, ix, lower[0], size[0], per_size[0], margin)
        for iy in range(y0, y1):
            dy = _beyond(y, iy, lower[1], size[1], per_size[1], margin)
            rest = 1.0 - dx * dx - dy * dy
            if rest <= 0.0:
                continue
            half = math.sqrt(rest) + margin
            z0, z1 = _cell_range(z - half, z + half, lower[2], per_size[2], shape[2])
            if z0 >= z1:
                continue
            row = (ix * shape[1] + iy) * shape[2]
            first, many = start[row + z0], start[row + z1] - start[row + z0]
            for k in range(np.uint64(padded(many))):
                a, b, c = x - px[first + k], y - py[first + k], z - pz[first + k]
                q2[k] = a * a + b * b + c * c
            for k in range(np.uint64(0), many, _EIGHT):
                hits += keep8(numbers, NODE, hits, ROW, first + k, q2, k, many)
    for k in range(hits):
        n = np.uint64(numbers[NODE, k])
        a, b, c = x - px[n], y - py[n], z - pz[n]
        values[X, k], values[Y, k], values[Z, k] = a, b, c
        values[Q2, k] = a * a + b * b + c * c
    return np.int64(hits)


@leaf
def points_around_segment(x, y, z, bx, by, bz, per_length, cells, lists):
    """List the points closer than 1 to the segment from a place to that place plus b, as `nodes_around_segment` does.

    Differences of places are taken in double precision; the rest has the precision of the lists.
    """
    values, numbers = lists.values, lists.numbers
    px, py, pz, start, margin = cells.x, cells.y, cells.z, cells.start, cells.margin
    lower, size, per_size, shape = cells.lower, cells.size, cells.per_size, cells.shape
    q2, along, away, hits = values[ROW2], values[ROW_DOT], values[ROW_Y], np.uint64(0)
    real = values.dtype.type
    zero, length = real(0.0), real(math.sqrt(bx * bx + by * by + bz * bz))
    ex, ey, ez, reach = real(bx * per_length), real(by * per_length), real(bz * per_length), 1.0 + margin
    x0, x1 = _cell_range(x + min(0.0, bx) - reach, x + max(0.0, bx) + reach, lower[0], per_size[0], shape[0])
    y0, y1 = _cell_range(y + min(0.0, by) - reach, y + max(0.0, by) + reach, lower[1], per_size[1], shape[1])
    corner = 0.5 * math.sqrt(size[0] * size[0] + size[1] * size[1])
    # an axis with one cell tells nothing of distances
    across_x, across_y = bx if per_size[0] > 0.0 else 0.0, by if per_size[1] > 0.0 else 0.0
    across2 = across_x * across_x + across_y * across_y
    per_across2 = 1.0 / across2 if across2 > 0.0 else 0.0
    for ix in range(x0, x1):
        dx = lower[0] + (ix + 0.5) * size[0] - x if per_size[0] > 0.0 else 0.0
        for iy in range(y0, y1):
            dy = lower[1] + (iy + 0.5) * size[1] - y if per_size[1] > 0.0 else 0.0
            u = min(1.0, max(0.0, (dx * across_x + dy * across_y) * per_across2))
            away_x, away_y = dx - u * across_x, dy - u * across_y
            nearest = max(0.0, math.sqrt(away_x * away_x + away_y * away_y) - corner - margin)
            if nearest >= 1.0:
                continue
            half = math.sqrt(1.0 - nearest * nearest) + margin
            z0, z1 = _cell_range(z + min(0.0, bz) - half, z + max(0.0, bz) + half, lower[2], per_size[2], shape[2])
            if z0 >= z1:
                continue
            row = (ix * shape[1] + iy) * shape[2]
            first, many = start[row + z0], start[row + z1] - start[row + z0]
            for k in range(np.uint64(padded(many))):
                a, b, c = real(px[first + k] - x), real(py[first + k] - y), real(pz[first + k] - z)
                r2, foot = a * a + b * b + c * c, a * ex + b * ey + c * ez
                past = foot - min(length, max(zero, foot))
                q2[k], along[k], away[k] = r2, foot, r2 - foot * foot + past * past
            for k in range(np.uint64(0), many, _EIGHT):
                keep8(values, Q2, hits, ROW2, k, away, k, many)
                keep8(values, ALONG, hits, ROW_DOT, k, away, k, many)
                hits += keep8(numbers, NODE, hits, ROW, first + k, away, k, many)
    return np.int64(hits)
