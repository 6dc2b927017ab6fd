"""Which nodes a grain or a branch reaches: periodic images, ranges of indices, spatial order, slabs.

Lengths are in units of the cutoff and relative to the first node. A node's flat index is ``(ix ny + iy) nz + iz``.
"""

import math

import numpy as np

from xcg.kernels._jit import jit

# Nodes of a row are listed this many at a time: a loop of fixed length has no remainder, and what it writes beyond
# the row's end is overwritten by the next row.
LANES = 4

# Cells of the spatial order, however far apart the grains are.
MOST_CELLS = 1 << 20


@jit
def images(x, low, high, first, last, period):
    """First and last periodic image of an interval [x + low, x + high] that meets the nodes in [first, last]."""
    if math.isinf(period):
        return 0, 0
    return math.ceil((first - x - high) / period), math.floor((last - x - low) / period)


@jit
def node_range(low, high, step, begin, end):
    """First and one past the last of the nodes begin, ... end - 1 that lie within [low, high]."""
    return max(begin, math.ceil(low / step)), min(end, math.floor(high / step) + 1)


@jit
def spatial_order(position, active):
    """Order of points (n, 3) by cells of one cutoff, x slowest; stable, so that sums have one order only."""
    count = position.shape[0]
    lower, cells = np.zeros(3), np.ones(3, np.int64)
    for k in range(3):
        if active[k] and count:
            low, high = position[0, k], position[0, k]
            for i in range(count):
                low, high = min(low, position[i, k]), max(high, position[i, k])
            lower[k] = low
            cells[k] = int(min(999.0, high - low)) + 1
    while cells[0] * cells[1] * cells[2] > max(MOST_CELLS, 4 * count):  # a few grains are far astray
        longest = np.argmax(cells)
        cells[longest] = (cells[longest] + 1) // 2
    cell = np.empty(count, np.int64)
    start = np.zeros(cells[0] * cells[1] * cells[2] + 1, np.int64)
    for i in range(count):
        index = 0
        for k in range(3):
            offset = min(cells[k] - 1, int(min(1000.0, position[i, k] - lower[k]))) if active[k] else 0
            index = index * cells[k] + offset
        cell[i] = index
        start[index + 1] += 1
    for c in range(start.size - 1):
        start[c + 1] += start[c]
    order = np.empty(count, np.int64)
    for i in range(count):
        order[start[cell[i]]] = i
        start[cell[i]] += 1
    return order
