"""Search for the nodes that a grain or branch reaches: periodic images, rows of nodes, spatial order.

Lengths are in units of the cutoff and relative to the first node. A node's index is ``(ix ny + iy)
nz + iz`` within the box of nodes that is being filled.

Nodes are listed row by row along z, in loops that the compiler turns into vector instructions.
Tables hold what the rows of a plane and the nodes of a row have in common; then it is computed how
far each row is reached, for all rows at once, and last come the nodes of a row, eight at a time.
What a row writes beyond its end is overwritten by the next. Indices are unsigned, as signed ones
are looked at for counting from the end.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, leaf
from xcg.compiled.arrays import counting_sort, short_integers
from xcg.compiled.simd import EIGHT, add_scalar8, fill8, ramp8

PAD = 16  # loops over lists run to a multiple of this: what is left over would be done one by one
PENCIL = 8  # cells across: the nodes that a layer of a pencil adds to fit in a core's cache
BATCH = 256  # grains or branches, neighbours in space, that are passed over together

# What the lists hold: tables over the nodes of a row and the rows of a plane, in both kinds of
# lists,
OF_Y, OF_Z, OF_Y2, OF_Z2 = (np.uint64(k) for k in range(4))
# rows of nodes and nodes, as numbers,
ROW_X, ROW_DOT, ROW_Y, ROW2, X, ALONG, Y, Z, Q2, WEIGHT = (
    np.uint64(k) for k in (4, 4, 5, 6, 7, 7, 8, 9, 10, 11)
)
OTHER = ROW_X  # no longer needed once the nodes are listed
# and as integers. (Plain integers would be compiled for one by one.)
ROW, FIRST, MANY, NODE = (np.uint64(k) for k in range(2, 6))
LISTS = 12
NUMBERS = 6

# Cells of the spatial order, however far apart the grains are.
MOST_CELLS = 1 << 20


NO_BRANCH = (0.0, 0.0, 0.0)


class BlockNodes(NamedTuple):
    """Nodes of a block that is filled, and what surrounds it: tuples of one entry for each axis.

    Attributes
    ----------
    begin, end : tuple of float
        Positions of the lowest and the highest node.
    active : tuple of bool
        Whether distance along an axis counts.
    period : tuple of float
        Period, infinite without one.
    rows, cells : Rows or PointCells, one of them, and None
        The nodes themselves: of a mesh, or points anywhere. None leaves code out when a loop is
        compiled.
    """

    begin: tuple[float, float, float]
    end: tuple[float, float, float]
    active: tuple[bool, bool, bool]
    period: tuple[float, float, float]
    rows: Any = None
    cells: Any = None


class Rows(NamedTuple):
    """Nodes of a mesh: tuples of one entry for each axis.

    Attributes
    ----------
    low, high : tuple of int
        The block low <= (ix, iy, iz) < high, so that blocks can be filled one by one, or at the
        same time.
    spacings, per_spacings : tuple of float
        Spacing, and nodes per length.
    """

    low: tuple[int, int, int]
    high: tuple[int, int, int]
    spacings: tuple[float, float, float]
    per_spacings: tuple[float, float, float]


class Lists(NamedTuple):
    """Scratch for lists of nodes, see `lists_for`: numbers of one precision (LISTS, m), and integers (NUMBERS, m)."""

    values: NDArray
    numbers: NDArray


@inner
def periodic_images(x, low, high, first, last, period):
    """First and last periodic image of an interval [x + low, x + high] that meets the nodes in [first, last]."""
    # nearly all: no more than the interval itself
    if x + high - period < first and x + low + period > last:
        if x + high < first or x + low > last:
            return 0, -1
        return 0, 0
    return math.ceil((first - x - high) / period), math.floor((last - x - low) / period)


@inlined
def images_in_reach(k, start, branch, nodes):
    """First and last periodic image, along axis k, of a segment that is closer than 1 to a block of nodes.

    A point is a segment without a branch. Along axes that do not count both are zero.
    """
    reach = 1.0 * nodes.active[k]
    lowest = min(0.0, branch[k]) - reach
    highest = max(0.0, branch[k]) + reach
    return periodic_images(start[k], lowest, highest, nodes.begin[k], nodes.end[k], nodes.period[k])


@inner
def node_range(low, high, per_spacing, begin, end):
    """First and one past the last of the nodes begin, ... end - 1 that lie within [low, high]."""
    first = max(begin, math.ceil(low * per_spacing))
    return first, max(first, min(end, math.floor(high * per_spacing) + 1))


@leaf
def padded(count):
    """Return the next multiple of `PAD`; lists about up to n nodes are made as long as ``padded(n) + PAD``."""
    return (count + PAD - 1) // PAD * PAD


def lists_for(
    rows: Rows, active: Sequence[bool], reach: Sequence[float], real: str = "float64"
) -> Lists:
    """Make lists for anything that reaches this far, from end to end, along the active axes of a mesh.

    The integers come with tables of the indices of the nodes of a row and of the rows of a plane.
    """
    low, high, spacings, _ = rows
    most = 1
    for first, end, far, spacing, counts in zip(low, high, reach, spacings, active, strict=True):
        reached = 2
        if counts:
            reached += int(far / spacing)
        # no more than there are: along an axis with one node the spacing means nothing
        most *= min(end - first, reached)
    room = padded(most) + PAD
    numbers = np.zeros((NUMBERS, room), "int32")
    numbers[OF_Z] = np.arange(room)
    numbers[OF_Y] = np.arange(room) * (high[2] - low[2])
    return Lists(np.zeros((LISTS, room), real), numbers)


@inner
def nodes_in_ball(x, y, z, rows, lists):
    """List the nodes of a mesh closer than 1 to a point.

    Parameters
    ----------
    x, y, z : float
        The point.
    rows : Rows
        Indices are counted within this block.
    lists : Lists
        Written: numbers[NODE], the indices, and values[Q2], squared distances, and values[X],
        values[Y] and values[Z], the point minus the node.

    Returns
    -------
    int
        Number of nodes listed.
    """
    if rows is None:
        return 0
    low, high, spacings, per_spacings = rows
    values = lists.values
    numbers = lists.numbers
    x0, x1 = node_range(x - 1.0, x + 1.0, per_spacings[0], low[0], high[0])
    y0, y1 = node_range(y - 1.0, y + 1.0, per_spacings[1], low[1], high[1])
    z0, z1 = node_range(z - 1.0, z + 1.0, per_spacings[2], low[2], high[2])
    ny, nz = high[1] - low[1], high[2] - low[2]
    for j in range(0, y1 - y0, EIGHT):
        ramp8(values, OF_Y, OF_Y2, j, y0 + j, spacings[1], y, -1.0)
    for j in range(0, z1 - z0, EIGHT):
        ramp8(values, OF_Z, OF_Z2, j, z0 + j, spacings[2], z, -1.0)
    count = 0
    for ix in range(x0, x1):
        dx = x - ix * spacings[0]
        begin = ((ix - low[0]) * ny + y0 - low[1]) * nz + z0 - low[2]
        for j in range(0, y1 - y0, EIGHT):
            fill8(values, ROW_X, count + j, dx)
            add_scalar8(values, ROW_Y, count + j, 0.0, OF_Y, j)
            add_scalar8(numbers, ROW, count + j, begin, OF_Y, j)
        count += y1 - y0
    lowest = float(z0)
    highest = float(z1 - 1)
    per_spacing = per_spacings[2]
    for k in range(padded(count)):
        dx, dy = values[ROW_X, k], values[ROW_Y, k]
        row2 = dx * dx + dy * dy
        half = math.sqrt(max(0.0, 1.0 - row2))
        begin = max(lowest, np.ceil((z - half) * per_spacing))
        end = min(highest, np.floor((z + half) * per_spacing) if row2 < 1.0 else lowest - 1.0)
        values[ROW2, k] = row2
        numbers[FIRST, k] = np.int32(max(0.0, min(highest, begin) - lowest))  # within the tables
        numbers[MANY, k] = np.int32(max(0.0, end - begin + 1.0))
    hits = 0
    for k in range(count):
        first = numbers[FIRST, k]
        left = numbers[MANY, k]
        dx = values[ROW_X, k]
        dy = values[ROW_Y, k]
        row2 = values[ROW2, k]
        row = numbers[ROW, k]
        while True:
            add_scalar8(values, Q2, hits, row2, OF_Z2, first)
            fill8(values, X, hits, dx)
            fill8(values, Y, hits, dy)
            add_scalar8(values, Z, hits, 0.0, OF_Z, first)
            add_scalar8(numbers, NODE, hits, row, OF_Z, first)
            hits += min(EIGHT, left)
            left -= EIGHT
            if left <= 0:
                break
            first += EIGHT
    return hits


@inner
def nodes_around_segment(x, y, z, bx, by, bz, per_length, rows, lists):
    """List the nodes of a mesh closer than 1 to the segment from a point to that point plus b.

    Numbers are in the precision of the lists.

    Along the row of nodes at (dx, dy) from the start, the end u of the reach is where ``u bz +
    sqrt(1 - |d - u b|^2)``, seen along z, is largest for 0 <= u <= 1.

    Parameters
    ----------
    x, y, z, bx, by, bz : float
        Start of the segment, and its end relative to it.
    per_length : float
        1 / its length, or 0.
    rows : Rows
        As in `nodes_in_ball`.
    lists : Lists
        Written: numbers[NODE], the indices, values[Q2], squared distances to the start, and
        values[ALONG], the foot of the node on the segment's line, from the start.

    Returns
    -------
    int
        Number of nodes listed.
    """
    if rows is None:
        return 0
    low, high, spacings, per_spacings = rows
    values = lists.values
    numbers = lists.numbers
    x0, x1 = node_range(
        x + min(0.0, bx) - 1.0, x + max(0.0, bx) + 1.0, per_spacings[0], low[0], high[0]
    )
    y0, y1 = node_range(
        y + min(0.0, by) - 1.0, y + max(0.0, by) + 1.0, per_spacings[1], low[1], high[1]
    )
    z0, z1 = node_range(
        z + min(0.0, bz) - 1.0, z + max(0.0, bz) + 1.0, per_spacings[2], low[2], high[2]
    )
    across2 = bx * bx + by * by
    # how far u moves from the nearest point of the line for each unit of half chord
    tilt = 0.0
    if bz != 0.0:
        tilt = math.copysign(1e30, bz)
        if across2 > 1e-30:
            tilt = bz / math.sqrt(across2 * (across2 + bz * bz))
    real = values.dtype.type
    zero = real(0.0)
    one = real(1.0)
    two = real(2.0)
    # nodes are counted from the one below the start, so that few digits are enough, and the same
    # whatever the box
    base_y = math.floor(y * per_spacings[1])
    base_z = math.floor(z * per_spacings[2])
    y = real(y - base_y * spacings[1])
    spacing_y = real(spacings[1])
    by = real(by)
    z = real(z - base_z * spacings[2])
    spacing_z = real(spacings[2])
    per_spacing = real(per_spacings[2])
    ez = real(bz * per_length)
    per_length = real(per_length)
    ny, nz = high[1] - low[1], high[2] - low[2]
    for j in range(0, y1 - y0, EIGHT):
        ramp8(values, OF_Y, OF_Y2, j, y0 - base_y + j, spacing_y, y, by)
    for j in range(0, z1 - z0, EIGHT):
        ramp8(values, OF_Z, OF_Z2, j, z0 - base_z + j, spacing_z, z, ez)
    count = 0
    for ix in range(x0, x1):
        dx = ix * spacings[0] - x
        begin = ((ix - low[0]) * ny + y0 - low[1]) * nz + z0 - low[2]
        dx2 = real(dx * dx)
        dx_dot = real(dx * bx)
        for j in range(0, y1 - y0, EIGHT):
            add_scalar8(values, ROW2, count + j, dx2, OF_Y2, j)
            add_scalar8(values, ROW_DOT, count + j, dx_dot, OF_Y, j)
            add_scalar8(numbers, ROW, count + j, begin, OF_Y, j)
        count += y1 - y0
    lowest, highest = real(z0 - base_z), real(z1 - 1 - base_z)
    c2 = real(across2)
    per_c2 = zero
    if across2 > 0.0:
        per_c2 = real(1.0 / across2)
    tilt = real(tilt)
    rise = real(bz)
    for k in range(padded(count)):
        row2 = values[ROW2, k]
        dot = values[ROW_DOT, k]
        u = dot * per_c2
        move = np.sqrt(max(zero, one - (row2 - dot * u))) * tilt
        upper = min(one, max(zero, u + move))
        lower = min(one, max(zero, u - move))
        rest_upper = one - (row2 + upper * (upper * c2 - two * dot))
        rest_lower = one - (row2 + lower * (lower * c2 - two * dot))
        top = np.floor((z + upper * rise + np.sqrt(max(zero, rest_upper))) * per_spacing)
        bottom = np.ceil((z + lower * rise - np.sqrt(max(zero, rest_lower))) * per_spacing)
        begin = max(lowest, bottom)
        end = min(highest, top if rest_upper > zero else lowest - one)
        numbers[FIRST, k] = np.int32(max(zero, min(highest, begin) - lowest))  # within the tables
        numbers[MANY, k] = np.int32(max(zero, end - begin + one))
    hits = 0
    for k in range(count):
        first = numbers[FIRST, k]
        left = numbers[MANY, k]
        row2 = values[ROW2, k]
        foot = values[ROW_DOT, k] * per_length
        row = numbers[ROW, k]
        while True:
            add_scalar8(values, Q2, hits, row2, OF_Z2, first)
            add_scalar8(values, ALONG, hits, foot, OF_Z, first)
            add_scalar8(numbers, NODE, hits, row, OF_Z, first)
            hits += min(EIGHT, left)
            left -= EIGHT
            if left <= 0:
                break
            first += EIGHT
    return hits


@leaf
def _bounds_of_batches(position, indices, bounds):
    for n in range(indices.size):
        batch = bounds[n // BATCH]
        for k in range(3):
            x = position[indices[n], k]
            batch[0, k] = min(x, batch[0, k])
            batch[1, k] = max(x, batch[1, k])


def batches_of(position: NDArray, indices: NDArray) -> NDArray:
    """Lowest and highest position, (runs, 2, 3), of each run of `BATCH` indices of positions (n, 3)."""
    bounds = no_bounds(len(indices), BATCH)
    _bounds_of_batches(position, indices, bounds)
    return bounds


def no_bounds(count: int, run: int) -> NDArray:
    """Bounds (runs, 2, 3) of the runs of so many points before any is widened."""
    bounds = np.empty((-(-count // run), 2, 3))
    bounds[:, 0], bounds[:, 1] = np.inf, -np.inf
    return bounds


@inner
def batch_reaches(batches, batch, begin, end, active, period):
    """Return whether one of `batches_of`, or an image of it, is closer than 1 to nodes from `begin` to `end`."""
    reaches = True
    for k in range(3):
        if active[k]:
            first, last = periodic_images(
                0.0,
                batches[batch, 0, k] - 1.0,
                batches[batch, 1, k] + 1.0,
                begin[k],
                end[k],
                period[k],
            )
            reaches = reaches and first <= last
    return reaches


@leaf
def batches_in_reach(batches, begin, end, active, period, reaches):
    """Write for each of `batches_of` (r,) whether it reaches nodes, see `batch_reaches`."""
    for batch in range(batches.shape[0]):
        reaches[batch] = batch_reaches(batches, batch, begin, end, active, period)


@leaf
def _cells_in_pencils(position, lower, sizes, along_x, pencils_z, cell):
    """Write the number of the cell (n,) of each point: pencil by pencil, and there layer by layer along x."""
    for n in range(position.shape[0]):
        x = np.int64((position[n, 0] - lower[0]) / sizes[0])
        y = np.int64((position[n, 1] - lower[1]) / sizes[1])
        z = np.int64((position[n, 2] - lower[2]) / sizes[2])
        pencil = y // PENCIL * pencils_z + z // PENCIL
        cell[n] = ((pencil * along_x + x) * PENCIL + y % PENCIL) * PENCIL + z % PENCIL


def spatial_order(
    position: NDArray,
    size: float,
    lower: Sequence[float],
    upper: Sequence[float],
    active: Sequence[bool],
) -> NDArray:
    """Order points (n, 3) by cells of a size (larger where points are few), in pencils along x.

    `lower` and `upper` are their bounds. Points of one pencil add to few nodes at a time, which
    stay in cache. The order is stable, so that sums have one order only.
    """
    count = len(position)
    sizes = np.full(3, size)
    extent = np.where(active, np.subtract(upper, lower), 0.0)
    while np.prod(extent / sizes + PENCIL) > max(MOST_CELLS, 4.0 * count):
        sizes[np.argmax(extent / sizes)] *= 2.0  # a few grains are far astray
    along_x, along_y, along_z = ((extent / sizes).astype(int) + 1).tolist()
    pencils_y = (along_y - 1) // PENCIL + 1
    pencils_z = (along_z - 1) // PENCIL + 1
    keys = pencils_y * pencils_z * along_x * PENCIL * PENCIL
    cell = np.empty(count, short_integers(max(keys, count)))
    x, y, z = np.where(active, sizes, np.inf).tolist()
    _cells_in_pencils(position, tuple(lower), (x, y, z), along_x, pencils_z, cell)
    return counting_sort(cell, keys)
