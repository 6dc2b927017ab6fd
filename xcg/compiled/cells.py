"""Search for scattered points near a grain or branch: points are sorted into cells, and rows of cells are contiguous.

The twins of `nodes_in_ball` and `nodes_around_segment` for points that form no mesh. Lengths are in
units of the cutoff, as for a mesh. Cells are numbered ``(ix ny + iy) nz + iz``, and points are
sorted by the cell that they are in, so that the points of neighbouring cells along z are one run.
As for a mesh it is first computed how far each row of cells is reached, for all rows at once; then
the points of the runs are looked at, as many at a time as a vector holds.

What tests points against a place or a segment is written out as in `xcg.compiled.simd`: points are
tested once, and all that lists hold of near points moves to the front of the vectors by one mask,
so that nothing goes through memory in between.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from llvmlite import binding, ir
from numba import types
from numpy.typing import NDArray

from xcg.compiled._jit import cgutils, inner, leaf
from xcg.compiled.arrays import sort_by_key
from xcg.compiled.reach import (
    ALONG,
    FIRST,
    LISTS,
    MANY,
    NODE,
    NUMBERS,
    OF_Y,
    OF_Y2,
    PAD,
    Q2,
    ROW,
    ROW2,
    ROW_DOT,
    Lists,
    X,
    Y,
    Z,
    padded,
)
from xcg.compiled.simd import (
    EIGHT,
    add_scalar8,
    compiled_as,
    pointer_to,
    typed,
    vector_of,
)

VECTOR = 64  # bytes of the vectors, whatever their numbers are


def _dot(builder, a, b):
    x, y, z = (builder.fmul(p, q) for p, q in zip(a, b, strict=True))
    return builder.fadd(builder.fadd(x, y), z)


def _compresses() -> bool:
    """Return whether processor and LLVM move chosen numbers of a vector to its front in one instruction."""
    try:
        features = binding.get_host_cpu_features()
    except RuntimeError:  # unknown
        return False
    return binding.llvm_version_info >= (19,) and bool(features.get("avx512vl"))


_COMPRESSES = _compresses()


def _kept(context, builder, signature, args, tests, listed):
    """Write what `listed` says, rows and vectors, of the points whose tests are below 1; returns how many they are.

    Memory that follows is overwritten, up to as many numbers as the vectors have lanes.
    """
    lanes, short, whole = tests.type.count, ir.IntType(32), ir.IntType(64)
    place, _ = typed(context, builder, signature, args)
    first, left = (vector_of(builder, [builder.trunc(place(k), short)] * lanes) for k in (6, 7))
    ramp = ir.Constant(ir.VectorType(short, lanes), list(range(lanes)))
    near = builder.fcmp_ordered("<", tests, ir.Constant(tests.type, [1.0] * lanes))
    near = builder.and_(near, builder.icmp_signed("<", ramp, left))
    bits, found = ir.IntType(lanes), [ir.Constant(whole, 0)]
    for lane in range(0 if _COMPRESSES else lanes):
        found.append(
            builder.add(
                found[-1],
                builder.zext(builder.extract_element(near, ir.Constant(short, lane)), whole),
            )
        )
    kept = [(0, row, vector) for row, vector in listed.items()]
    for k, row, vector in (*kept, (1, NODE, builder.add(first, ramp))):
        to = [ir.Constant(whole, int(row)), place(2)]
        target, align = pointer_to(context, builder, signature.args[k], args[k], to, lanes)
        if _COMPRESSES:
            number = signature.args[k].dtype
            kind = f"{'i' if isinstance(number, types.Integer) else 'f'}{number.bitwidth}"
            of = ir.FunctionType(vector.type, [vector.type, near.type, vector.type])
            name = f"llvm.experimental.vector.compress.v{lanes}{kind}"
            compress = cgutils.get_or_insert_function(builder.module, of, name)
            zeros = ir.Constant(vector.type, None)
            builder.store(builder.call(compress, [vector, near, zeros]), target, align=align)
        else:
            start = builder.bitcast(target, vector.type.element.as_pointer())
            for lane in range(lanes):  # what is not kept is overwritten by the next
                value = builder.extract_element(vector, ir.Constant(short, lane))
                builder.store(value, builder.gep(start, [found[lane]]), align=align)
    if not _COMPRESSES:
        return found[-1]
    count = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(bits, [bits]), f"llvm.ctpop.i{lanes}"
    )
    return builder.zext(builder.call(count, [builder.bitcast(near, bits)]), whole)


def _list_near_place(typingctx, values, numbers, at, px, py, pz, first, left, x, y, z):
    def generate(context, builder, signature, args):
        place, value = typed(context, builder, signature, args)
        lanes, d = VECTOR // (values.dtype.bitwidth // 8), []
        for k in range(3):
            pointer, align = pointer_to(
                context, builder, signature.args[3 + k], args[3 + k], [place(6)], lanes
            )
            d.append(
                builder.fsub(
                    vector_of(builder, [value(8 + k)] * lanes), builder.load(pointer, align=align)
                )
            )
        q2 = _dot(builder, d, d)
        return _kept(context, builder, signature, args, q2, {X: d[0], Y: d[1], Z: d[2], Q2: q2})

    return types.uint64(values, numbers, at, px, py, pz, first, left, x, y, z), generate


@compiled_as(_list_near_place)
def list_near_place(values, numbers, at, px, py, pz, first, left, x, y, z):
    """List the points among eight, from `first` on, that are closer than 1 to a place.

    No more than `left` points are looked at. What `nodes_in_ball` writes of each is written from
    `at` on; returns how many there are. Memory that follows them is overwritten, up to eight
    numbers from `at` on.
    """
    n = np.arange(int(first), int(first) + min(int(left), VECTOR // values.itemsize))
    a, b, c = x - px[n], y - py[n], z - pz[n]
    q2 = a * a + b * b + c * c
    near = q2 < 1.0
    here = slice(int(at), int(at) + int(near.sum()))
    values[X, here], values[Y, here], values[Z, here], values[Q2, here] = (
        a[near],
        b[near],
        c[near],
        q2[near],
    )
    numbers[NODE, here] = n[near]
    return np.uint64(near.sum())


def _list_near_segment(
    typingctx, values, numbers, at, px, py, pz, first, left, x, y, z, ex, ey, ez, length
):
    def generate(context, builder, signature, args):
        place, value = typed(context, builder, signature, args)
        lanes = VECTOR // (values.dtype.bitwidth // 8)
        vector, d = ir.VectorType(context.get_data_type(values.dtype), lanes), []
        for k in range(3):
            pointer, align = pointer_to(
                context, builder, signature.args[3 + k], args[3 + k], [place(6)], lanes
            )
            start = context.cast(builder, args[8 + k], signature.args[8 + k], types.float64)
            apart = builder.fsub(
                builder.load(pointer, align=align), vector_of(builder, [start] * lanes)
            )
            d.append(builder.fptrunc(apart, vector) if values.dtype == types.float32 else apart)
        ex, ey, ez, end = (vector_of(builder, [value(k)] * lanes) for k in range(11, 15))
        r2, foot, zero = (
            _dot(builder, d, d),
            _dot(builder, d, (ex, ey, ez)),
            ir.Constant(vector, None),
        )
        within = builder.select(builder.fcmp_ordered(">", foot, zero), foot, zero)
        within = builder.select(builder.fcmp_ordered("<", within, end), within, end)
        past = builder.fsub(foot, within)
        away2 = builder.fadd(builder.fsub(r2, builder.fmul(foot, foot)), builder.fmul(past, past))
        return _kept(context, builder, signature, args, away2, {Q2: r2, ALONG: foot})

    return types.uint64(
        values, numbers, at, px, py, pz, first, left, x, y, z, ex, ey, ez, length
    ), generate


@compiled_as(_list_near_segment)
def list_near_segment(values, numbers, at, px, py, pz, first, left, x, y, z, ex, ey, ez, length):
    """List the points among eight, or sixteen in single precision, that are closer than 1 to a segment.

    The segment begins at a place and runs along a unit vector e. Differences of places are taken in
    double precision, the rest has the precision of the lists. Otherwise as `list_near_place`, with
    what `nodes_around_segment` writes.
    """
    real = values.dtype.type
    n = np.arange(int(first), int(first) + min(int(left), VECTOR // values.itemsize))
    a, b, c = (px[n] - x).astype(real), (py[n] - y).astype(real), (pz[n] - z).astype(real)
    r2, foot = a * a + b * b + c * c, a * real(ex) + b * real(ey) + c * real(ez)
    past = foot - np.minimum(real(length), np.maximum(real(0.0), foot))
    near = r2 - foot * foot + past * past < 1.0
    here = slice(int(at), int(at) + int(near.sum()))
    values[Q2, here], values[ALONG, here], numbers[NODE, here] = r2[near], foot[near], n[near]
    return np.uint64(near.sum())


_EIGHT = np.uint64(EIGHT)
END = MANY  # a row of cells has the first cell that is reached, and one past the last
# What rounding of single precision may move a distance by, relative to the largest squared one.
_ROUNDING = 2e-6


class PointCells(NamedTuple):
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


@leaf
def sort_by_cell(
    x, y, z, rows, lower, per_size, shape, start, cell, order, rank, position, sorted_rows
):
    """Sort points by the cell that they are in; points of one cell keep their order.

    Parameters
    ----------
    x, y, z, rows : (n,)
        The points, and a number that each has.
    lower, per_size, shape : tuple
        As in `PointCells`.
    start : (cells + 2,)
        Zeros; written: the first point of each cell; the number of points in the last two places.
    cell, order, rank : (n,)
        Written: the cell of each point, which point comes first, second, ..., and the place of each
        among all.
    position, sorted_rows : (3, n or more), (n,)
        Written: the points and their numbers, sorted.
    """
    last_x, last_y, last_z = shape[0] - 1, shape[1] - 1, shape[2] - 1
    for n in range(x.size):
        ix = min(last_x, np.int64((x[n] - lower[0]) * per_size[0]))
        iy = min(last_y, np.int64((y[n] - lower[1]) * per_size[1]))
        iz = min(last_z, np.int64((z[n] - lower[2]) * per_size[2]))
        cell[n] = (ix * shape[1] + iy) * shape[2] + iz
    sort_by_key(cell, start[1:], order)
    for to in range(x.size):
        n = order[to]
        position[0, to], position[1, to], position[2, to], sorted_rows[to], rank[n] = (
            x[n],
            y[n],
            z[n],
            rows[n],
            to,
        )


def lists_for_points(cells: PointCells, reach: Sequence[float], real: str = "float64") -> Lists:
    """Make lists of points for anything that reaches this far, from end to end: all points may be in one place.

    The integers come with a table of the numbers of the first cells of rows.
    """
    rows = 1
    for far, per_size, count in zip(reach[:2], cells.per_size[:2], cells.shape[:2], strict=True):
        rows *= min(count, int(far * per_size) + 3)
    room = padded(max(len(cells.x) - PAD, rows)) + PAD
    numbers = np.zeros((NUMBERS, room), "int32")
    numbers[OF_Y] = np.arange(room) * cells.shape[2]
    return Lists(np.zeros((LISTS, room), real), numbers)


@inner
def _cell_range(low, high, lower, per_size, count):
    """First and one past the last of the cells that meet an interval."""
    first = math.floor(min(max((low - lower) * per_size, 0.0), float(count)))
    last = math.floor(min(max((high - lower) * per_size, -1.0), float(count - 1)))
    return first, last + 1


@inner
def _beyond(x, k, lower, size, per_size, margin):
    """Return the least distance of a place from cell k of an axis; 0 where there is one cell only."""
    if per_size == 0.0:
        return 0.0
    low = lower + k * size
    return max(0.0, max(low - x, x - low - size) - margin)


@inner
def points_in_ball(x, y, z, cells, lists):
    """List the points of some cells that are closer than 1 to a place, as `nodes_in_ball` does."""
    if cells is None:
        return 0
    values, numbers = lists.values, lists.numbers
    px, py, pz, start, margin = cells.x, cells.y, cells.z, cells.start, cells.margin
    lower, size, per_size, (nx, ny, nz) = cells.lower, cells.size, cells.per_size, cells.shape
    reach, hits = 1.0 + margin, np.uint64(0)
    x0, x1 = _cell_range(x - reach, x + reach, lower[0], per_size[0], nx)
    y0, y1 = _cell_range(y - reach, y + reach, lower[1], per_size[1], ny)
    for j in range(y1 - y0):
        dy = _beyond(y, y0 + j, lower[1], size[1], per_size[1], margin)
        values[OF_Y2, j] = dy * dy
    count = 0
    for ix in range(x0, x1):
        dx = _beyond(x, ix, lower[0], size[0], per_size[0], margin)
        for j in range(0, y1 - y0, EIGHT):
            add_scalar8(values, ROW2, count + j, dx * dx, OF_Y2, j)
            add_scalar8(numbers, ROW, count + j, (ix * ny + y0) * nz, OF_Y, j)
        count += y1 - y0
    here, last = (z - lower[2]) * per_size[2], nz - 1.0
    for k in range(padded(count)):
        half = (math.sqrt(max(0.0, 1.0 - values[ROW2, k])) + margin) * per_size[2]
        begin, end = np.floor(here - half), np.floor(here + half)
        numbers[FIRST, k] = numbers[ROW, k] + np.int32(min(last + 1.0, max(0.0, begin)))
        numbers[END, k] = numbers[ROW, k] + np.int32(min(last, max(-1.0, end)) + 1.0)
    for k in range(count):
        if not values[ROW2, k] < 1.0:
            continue
        first, end = start[numbers[FIRST, k]], start[numbers[END, k]]
        left = np.int64(end - first)
        while True:
            hits += list_near_place(values, numbers, hits, px, py, pz, first, left, x, y, z)
            left -= EIGHT
            if left <= 0:
                break
            first += _EIGHT
    return np.int64(hits)


@inner
def points_around_segment(x, y, z, bx, by, bz, per_length, cells, lists):
    """List the points closer than 1 to the segment from a place to that place plus b, as `nodes_around_segment` does.

    Differences of places are taken in double precision; the rest has the precision of the lists.
    """
    if cells is None:
        return 0
    values, numbers = lists.values, lists.numbers
    px, py, pz, start, margin = cells.x, cells.y, cells.z, cells.start, cells.margin
    lower, size, per_size, (nx, ny, nz) = cells.lower, cells.size, cells.per_size, cells.shape
    reach, length, hits = 1.0 + margin, math.sqrt(bx * bx + by * by + bz * bz), np.uint64(0)
    x0, x1 = _cell_range(
        x + min(0.0, bx) - reach, x + max(0.0, bx) + reach, lower[0], per_size[0], nx
    )
    y0, y1 = _cell_range(
        y + min(0.0, by) - reach, y + max(0.0, by) + reach, lower[1], per_size[1], ny
    )
    # an axis with one cell tells nothing of distances
    across_x, across_y = bx if per_size[0] > 0.0 else 0.0, by if per_size[1] > 0.0 else 0.0
    across2 = across_x * across_x + across_y * across_y
    for j in range(y1 - y0):
        dy = lower[1] + (y0 + j + 0.5) * size[1] - y if per_size[1] > 0.0 else 0.0
        values[OF_Y, j], values[OF_Y2, j] = dy * across_y, dy * dy
    count = 0
    for ix in range(x0, x1):
        dx = lower[0] + (ix + 0.5) * size[0] - x if per_size[0] > 0.0 else 0.0
        for j in range(0, y1 - y0, EIGHT):
            add_scalar8(values, ROW2, count + j, dx * dx, OF_Y2, j)
            add_scalar8(values, ROW_DOT, count + j, dx * across_x, OF_Y, j)
            add_scalar8(numbers, ROW, count + j, (ix * ny + y0) * nz, OF_Y, j)
        count += y1 - y0
    real = values.dtype.type
    zero, one, two = real(0.0), real(1.0), real(2.0)
    far = 3.0 + 2.0 * length + size[0] + size[1]
    slack = margin + _ROUNDING * far * far
    corner = real(0.5 * math.sqrt(size[0] * size[0] + size[1] * size[1]) + slack)
    c2, per_c2 = real(across2), real(1.0 / across2 if across2 > 0.0 else 0.0)
    # cells are counted from that of the start, so that few digits are enough
    here = (z - lower[2]) * per_size[2]
    base = math.floor(here)
    low, high = (
        here - base + (min(0.0, bz) - slack) * per_size[2],
        here - base + (max(0.0, bz) + slack) * per_size[2],
    )
    low, high, lowest, highest, per = (
        real(low),
        real(high),
        real(-base),
        real(nz - 1 - base),
        real(per_size[2]),
    )
    for k in range(padded(count)):
        row2, dot = values[ROW2, k], values[ROW_DOT, k]
        u = min(one, max(zero, dot * per_c2))
        nearest = max(zero, np.sqrt(max(zero, row2 + u * (u * c2 - two * dot))) - corner)
        half = np.sqrt(max(zero, one - nearest * nearest)) * per
        begin, end = np.floor(low - half), np.floor(high + half)
        values[ROW2, k] = nearest
        numbers[FIRST, k] = (
            numbers[ROW, k] + base + np.int32(min(highest + one, max(lowest, begin)))
        )
        numbers[END, k] = (
            numbers[ROW, k] + base + np.int32(min(highest, max(lowest - one, end)) + one)
        )
    ex, ey, ez, length = (
        real(bx * per_length),
        real(by * per_length),
        real(bz * per_length),
        real(length),
    )
    lanes = np.uint64(VECTOR // values.itemsize)
    for k in range(count):
        if not values[ROW2, k] < 1.0:
            continue
        first, end = start[numbers[FIRST, k]], start[numbers[END, k]]
        left = np.int64(end - first)
        while True:
            hits += list_near_segment(
                values, numbers, hits, px, py, pz, first, left, x, y, z, ex, ey, ez, length
            )
            left -= np.int64(lanes)
            if left <= 0:
                break
            first += lanes
    return np.int64(hits)
