"""Search for scattered points near a grain or branch: points are sorted into cells, and rows of cells are contiguous.

The twins of `nodes_in_ball` and `nodes_around_segment` for points that form no mesh. Lengths are in
units of the cutoff, as for a mesh. Cells are numbered ``(ix ny + iy) nz + iz``, and points are
sorted by the cell that they are in, so that the points of neighbouring cells along z are one run.
As for a mesh it is first computed how far each row of cells is reached, for all rows at once; then
the points of the runs are looked at, as many at a time as a vector holds.

What tests points against a point or a segment is written out as in `xcg.compiled.simd`: points are
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

from xcg.compiled._jit import cgutils, inner
from xcg.compiled.arrays import along_active
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
    BlockNodes,
    Lists,
    X,
    Y,
    Z,
    lists_for,
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
    lanes = tests.type.count
    short = ir.IntType(32)
    whole = ir.IntType(64)
    index_of, _ = typed(context, builder, signature, args)
    first, left = (vector_of(builder, [builder.trunc(index_of(k), short)] * lanes) for k in (4, 5))
    ramp = ir.Constant(ir.VectorType(short, lanes), list(range(lanes)))
    near = builder.fcmp_ordered("<", tests, ir.Constant(tests.type, [1.0] * lanes))
    near = builder.and_(near, builder.icmp_signed("<", ramp, left))
    bits = ir.IntType(lanes)
    found = [ir.Constant(whole, 0)]
    if not _COMPRESSES:
        for lane in range(lanes):
            is_near = builder.extract_element(near, ir.Constant(short, lane))
            found.append(builder.add(found[-1], builder.zext(is_near, whole)))
    kept = [(0, row, vector) for row, vector in listed.items()]
    for k, row, vector in (*kept, (1, NODE, builder.add(first, ramp))):
        to = [ir.Constant(whole, int(row)), index_of(2)]
        target, align = pointer_to(context, builder, signature.args[k], args[k], to, lanes)
        if _COMPRESSES:
            number = signature.args[k].dtype
            letter = "f"
            if isinstance(number, types.Integer):
                letter = "i"
            of = ir.FunctionType(vector.type, [vector.type, near.type, vector.type])
            name = f"llvm.experimental.vector.compress.v{lanes}{letter}{number.bitwidth}"
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


def _loaded(context, builder, signature, args, lanes):
    """Vectors of the coordinates x, y and z of points, from the first one on."""
    index_of, _ = typed(context, builder, signature, args)
    for column in cgutils.unpack_tuple(builder, args[3]):
        pointer, align = pointer_to(
            context, builder, signature.args[3].dtype, column, [index_of(4)], lanes
        )
        yield builder.load(pointer, align=align)


def _list_near_point(typingctx, values, numbers, at, points, first, left, centre):
    def generate(context, builder, signature, args):
        lanes = VECTOR // (values.dtype.bitwidth // 8)
        d = []
        loaded = _loaded(context, builder, signature, args, lanes)
        for start, points in zip(cgutils.unpack_tuple(builder, args[6]), loaded, strict=True):
            d.append(builder.fsub(vector_of(builder, [start] * lanes), points))
        q2 = _dot(builder, d, d)
        return _kept(context, builder, signature, args, q2, {X: d[0], Y: d[1], Z: d[2], Q2: q2})

    three = types.UniTuple(values.dtype, 3)
    return types.uint64(values, numbers, at, points, first, left, three), generate


@compiled_as(_list_near_point)
def list_near_point(values, numbers, at, points, first, left, centre):
    """List the points among eight, from `first` on, that are closer than 1 to a point (x, y, z).

    `points` are three arrays, of x, y and z. No more than `left` points are looked at. What
    `nodes_in_ball` writes of each is written from `at` on; returns how many there are. Memory that
    follows them is overwritten, up to eight numbers from `at` on.
    """
    n = np.arange(int(first), int(first) + min(int(left), VECTOR // values.itemsize))
    a, b, c = (start - column[n] for start, column in zip(centre, points, strict=True))
    q2 = a * a + b * b + c * c
    near = q2 < 1.0
    here = slice(int(at), int(at) + int(near.sum()))
    values[X, here] = a[near]
    values[Y, here] = b[near]
    values[Z, here] = c[near]
    values[Q2, here] = q2[near]
    numbers[NODE, here] = n[near]
    return np.uint64(near.sum())


def _list_near_segment(
    typingctx, values, numbers, at, points, first, left, begin, direction, length
):
    def generate(context, builder, signature, args):
        _, value = typed(context, builder, signature, args)
        lanes = VECTOR // (values.dtype.bitwidth // 8)
        vector = ir.VectorType(context.get_data_type(values.dtype), lanes)
        d = []
        loaded = _loaded(context, builder, signature, args, lanes)
        for start, points in zip(cgutils.unpack_tuple(builder, args[6]), loaded, strict=True):
            apart = builder.fsub(points, vector_of(builder, [start] * lanes))
            if values.dtype == types.float32:
                apart = builder.fptrunc(apart, vector)
            d.append(apart)
        e = [
            vector_of(builder, [number] * lanes)
            for number in cgutils.unpack_tuple(builder, args[7])
        ]
        end = vector_of(builder, [value(8)] * lanes)
        r2 = _dot(builder, d, d)
        foot = _dot(builder, d, e)
        zero = ir.Constant(vector, None)
        within = builder.select(builder.fcmp_ordered(">", foot, zero), foot, zero)
        within = builder.select(builder.fcmp_ordered("<", within, end), within, end)
        past = builder.fsub(foot, within)
        away2 = builder.fadd(builder.fsub(r2, builder.fmul(foot, foot)), builder.fmul(past, past))
        return _kept(context, builder, signature, args, away2, {Q2: r2, ALONG: foot})

    start = types.UniTuple(types.float64, 3)
    along = types.UniTuple(values.dtype, 3)
    return types.uint64(values, numbers, at, points, first, left, start, along, length), generate


@compiled_as(_list_near_segment)
def list_near_segment(values, numbers, at, points, first, left, begin, direction, length):
    """List the points among eight, or sixteen in single precision, that are closer than 1 to a segment.

    The segment runs from `begin` along a unit vector. Differences of points are taken in
    double precision, the rest has the precision of the lists. Otherwise as `list_near_point`, with
    what `nodes_around_segment` writes.
    """
    real = values.dtype.type
    n = np.arange(int(first), int(first) + min(int(left), VECTOR // values.itemsize))
    a, b, c = (
        (column[n] - start).astype(real) for start, column in zip(begin, points, strict=True)
    )
    r2 = a * a + b * b + c * c
    ex, ey, ez = (real(number) for number in direction)
    foot = a * ex + b * ey + c * ez
    past = foot - np.minimum(real(length), np.maximum(real(0.0), foot))
    near = r2 - foot * foot + past * past < 1.0
    here = slice(int(at), int(at) + int(near.sum()))
    values[Q2, here] = r2[near]
    values[ALONG, here] = foot[near]
    numbers[NODE, here] = n[near]
    return np.uint64(near.sum())


_EIGHT = np.uint64(EIGHT)
END = MANY  # a row of cells has the first cell that is reached, and one past the last
# What rounding of single precision may move a distance by, relative to the largest squared one.
_ROUNDING = 2e-6


class PointCells(NamedTuple):
    """Points of a block in cells.

    Attributes
    ----------
    points : tuple of (n + PAD,)
        The points' coordinates x, y and z, sorted by cell; 0 along axes that do not count, and
        beyond the last.
    start : (cells + 1,)
        The first point of each cell, unsigned.
    lower, size, per_size : tuple of float
        Lower corner of the cells, their size, and its inverse: 0 along axes with one cell.
    shape : tuple of int
        Number of cells along each axis.
    margin : float
        What rounding may move a point by, as seen from its cell.
    """

    points: tuple[NDArray, NDArray, NDArray]
    start: NDArray
    lower: tuple[float, float, float]
    size: tuple[float, float, float]
    per_size: tuple[float, float, float]
    shape: tuple[int, int, int]
    margin: float


def lists_for_points(cells: PointCells, reach: Sequence[float], real: str = "float64") -> Lists:
    """Make lists of points for anything that reaches this far, from end to end: all points may coincide.

    The integers come with a table of the numbers of the first cells of rows.
    """
    rows = 1
    for far, per_size, count in zip(reach[:2], cells.per_size[:2], cells.shape[:2], strict=True):
        rows *= min(count, int(far * per_size) + 3)
    room = padded(max(len(cells.points[0]) - PAD, rows)) + PAD
    numbers = np.zeros((NUMBERS, room), "int32")
    numbers[OF_Y] = np.arange(room) * cells.shape[2]
    return Lists(np.zeros((LISTS, room), real), numbers)


def lists_of(nodes: BlockNodes, reach: Sequence[float], real: str = "float64") -> Lists:
    """Make lists of the nodes that a support or branch of the extent `reach` (3,) covers."""
    if nodes.rows is None:
        return lists_for_points(nodes.cells, reach, real)
    return lists_for(nodes.rows, nodes.active, reach, real)


@inner
def _cell_range(low, high, lower, per_size, count):
    """First and one past the last of the cells that meet an interval."""
    first = math.floor(min(max((low - lower) * per_size, 0.0), float(count)))
    last = math.floor(min(max((high - lower) * per_size, -1.0), float(count - 1)))
    return first, last + 1


@inner
def _beyond(x, k, lower, size, per_size, margin):
    """Return the least distance of a point from cell k of an axis; 0 where there is one cell only."""
    if per_size == 0.0:
        return 0.0
    low = lower + k * size
    return max(0.0, max(low - x, x - low - size) - margin)


@inner
def points_in_ball(x, y, z, cells, lists):
    """List the points of some cells that are closer than 1 to a point, as `nodes_in_ball` does."""
    if cells is None:
        return 0
    values = lists.values
    numbers = lists.numbers
    points = cells.points
    start = cells.start
    margin = cells.margin
    lower = cells.lower
    size = cells.size
    per_size = cells.per_size
    nx, ny, nz = cells.shape
    reach = 1.0 + margin
    hits = np.uint64(0)
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
    here = (z - lower[2]) * per_size[2]
    last = nz - 1.0
    for k in range(padded(count)):
        half = (math.sqrt(max(0.0, 1.0 - values[ROW2, k])) + margin) * per_size[2]
        begin, end = np.floor(here - half), np.floor(here + half)
        numbers[FIRST, k] = numbers[ROW, k] + np.int32(min(last + 1.0, max(0.0, begin)))
        numbers[END, k] = numbers[ROW, k] + np.int32(min(last, max(-1.0, end)) + 1.0)
    for k in range(count):
        if not values[ROW2, k] < 1.0:
            continue
        first = start[numbers[FIRST, k]]
        end = start[numbers[END, k]]
        left = np.int64(end - first)
        while True:
            hits += list_near_point(values, numbers, hits, points, first, left, (x, y, z))
            left -= EIGHT
            if left <= 0:
                break
            first += _EIGHT
    return np.int64(hits)


@inner
def points_around_segment(x, y, z, bx, by, bz, per_length, cells, lists):
    """List the points closer than 1 to the segment from a point to that point plus b, as `nodes_around_segment` does.

    Differences of points are taken in double precision; the rest has the precision of the lists.
    """
    if cells is None:
        return 0
    values = lists.values
    numbers = lists.numbers
    points = cells.points
    start = cells.start
    margin = cells.margin
    lower = cells.lower
    size = cells.size
    per_size = cells.per_size
    nx, ny, nz = cells.shape
    reach = 1.0 + margin
    length = math.sqrt(bx * bx + by * by + bz * bz)
    hits = np.uint64(0)
    x0, x1 = _cell_range(
        x + min(0.0, bx) - reach, x + max(0.0, bx) + reach, lower[0], per_size[0], nx
    )
    y0, y1 = _cell_range(
        y + min(0.0, by) - reach, y + max(0.0, by) + reach, lower[1], per_size[1], ny
    )
    # an axis with one cell tells nothing of distances
    several = (per_size[0] > 0.0, per_size[1] > 0.0, False)
    across_x, across_y, _ = along_active(bx, by, 0.0, several)
    across2 = across_x * across_x + across_y * across_y
    for j in range(y1 - y0):
        dy = 0.0
        if several[1]:
            dy = lower[1] + (y0 + j + 0.5) * size[1] - y
        values[OF_Y, j] = dy * across_y
        values[OF_Y2, j] = dy * dy
    count = 0
    for ix in range(x0, x1):
        dx = 0.0
        if several[0]:
            dx = lower[0] + (ix + 0.5) * size[0] - x
        for j in range(0, y1 - y0, EIGHT):
            add_scalar8(values, ROW2, count + j, dx * dx, OF_Y2, j)
            add_scalar8(values, ROW_DOT, count + j, dx * across_x, OF_Y, j)
            add_scalar8(numbers, ROW, count + j, (ix * ny + y0) * nz, OF_Y, j)
        count += y1 - y0
    real = values.dtype.type
    zero = real(0.0)
    one = real(1.0)
    two = real(2.0)
    far = 3.0 + 2.0 * length + size[0] + size[1]
    slack = margin + _ROUNDING * far * far
    corner = real(0.5 * math.sqrt(size[0] * size[0] + size[1] * size[1]) + slack)
    c2 = real(across2)
    per_c2 = zero
    if across2 > 0.0:
        per_c2 = real(1.0 / across2)
    # cells are counted from that of the start, so that few digits are enough
    here = (z - lower[2]) * per_size[2]
    base = math.floor(here)
    low = real(here - base + (min(0.0, bz) - slack) * per_size[2])
    high = real(here - base + (max(0.0, bz) + slack) * per_size[2])
    lowest = real(-base)
    highest = real(nz - 1 - base)
    per = real(per_size[2])
    for k in range(padded(count)):
        row2 = values[ROW2, k]
        dot = values[ROW_DOT, k]
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
    direction = (real(bx * per_length), real(by * per_length), real(bz * per_length))
    length = real(length)
    lanes = np.uint64(VECTOR // values.itemsize)
    for k in range(count):
        if not values[ROW2, k] < 1.0:
            continue
        first = start[numbers[FIRST, k]]
        end = start[numbers[END, k]]
        left = np.int64(end - first)
        while True:
            hits += list_near_segment(
                values, numbers, hits, points, first, left, (x, y, z), direction, length
            )
            left -= np.int64(lanes)
            if left <= 0:
                break
            first += lanes
    return np.int64(hits)
