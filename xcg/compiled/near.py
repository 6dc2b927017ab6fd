"""Which of some neighbouring points are near a place or a segment: as many at a time as one vector instruction takes.

Points are tested once, and all that lists hold of those that are near moves to the front of the vectors by one mask, so
that nothing goes through memory in between. As in `xcg.compiled.simd`, each function has two forms, which give the same
bits.
"""

import numpy as np
from llvmlite import ir
from numba import types

from xcg.compiled.reach import ALONG, NODE, Q2, X, Y, Z
from xcg.compiled.simd import compiled_as, lanes_before, pointer_to, typed, vector_of, write_kept

VECTOR = 64  # bytes of the vectors, whatever their numbers are


def _dot(builder, a, b):
    x, y, z = (builder.fmul(p, q) for p, q in zip(a, b, strict=True))
    return builder.fadd(builder.fadd(x, y), z)


def _kept(context, builder, signature, args, tests, listed):
    """Write what `listed` says, rows and vectors, of the points whose tests are below 1; returns how many they are."""
    lanes, short = tests.type.count, ir.IntType(32)
    place, _ = typed(context, builder, signature, args)
    at, first, left = place(2), place(6), place(7)
    near = builder.fcmp_ordered("<", tests, ir.Constant(tests.type, [1.0] * lanes))
    near = builder.and_(near, lanes_before(builder, left, lanes))
    ramp = ir.Constant(ir.VectorType(short, lanes), list(range(lanes)))
    numbers = builder.add(vector_of(builder, [builder.trunc(first, short)] * lanes), ramp)
    kept = [(signature.args[0], args[0], row, vector) for row, vector in listed.items()]
    kept.append((signature.args[1], args[1], NODE, numbers))
    rows = [(kind, array, ir.Constant(ir.IntType(64), int(row)), vector) for kind, array, row, vector in kept]
    return write_kept(context, builder, near, at, rows)


def _list_near_place(typingctx, values, numbers, at, px, py, pz, first, left, x, y, z):
    def generate(context, builder, signature, args):
        place, value = typed(context, builder, signature, args)
        lanes, d = VECTOR // (values.dtype.bitwidth // 8), []
        for k in range(3):
            pointer, align = pointer_to(context, builder, signature.args[3 + k], args[3 + k], [place(6)], lanes)
            d.append(builder.fsub(vector_of(builder, [value(8 + k)] * lanes), builder.load(pointer, align=align)))
        q2 = _dot(builder, d, d)
        return _kept(context, builder, signature, args, q2, {X: d[0], Y: d[1], Z: d[2], Q2: q2})

    return types.uint64(values, numbers, at, px, py, pz, first, left, x, y, z), generate


@compiled_as(_list_near_place)
def list_near_place(values, numbers, at, px, py, pz, first, left, x, y, z):
    """List those of eight points, from `first` on, that are closer than 1 to a place.

    No more than `left` points are looked at. What `nodes_in_ball` writes of each is written from `at` on; returns how
    many there are. Memory that follows them is spoilt, up to eight numbers from `at` on.
    """
    n = np.arange(int(first), int(first) + min(int(left), VECTOR // values.itemsize))
    a, b, c = x - px[n], y - py[n], z - pz[n]
    q2 = a * a + b * b + c * c
    near = q2 < 1.0
    here = slice(int(at), int(at) + int(near.sum()))
    values[X, here], values[Y, here], values[Z, here], values[Q2, here] = a[near], b[near], c[near], q2[near]
    numbers[NODE, here] = n[near]
    return np.uint64(near.sum())


def _list_near_segment(typingctx, values, numbers, at, px, py, pz, first, left, x, y, z, ex, ey, ez, length):
    def generate(context, builder, signature, args):
        place, value = typed(context, builder, signature, args)
        lanes = VECTOR // (values.dtype.bitwidth // 8)
        vector, d = ir.VectorType(context.get_data_type(values.dtype), lanes), []
        for k in range(3):
            pointer, align = pointer_to(context, builder, signature.args[3 + k], args[3 + k], [place(6)], lanes)
            start = context.cast(builder, args[8 + k], signature.args[8 + k], types.float64)
            apart = builder.fsub(builder.load(pointer, align=align), vector_of(builder, [start] * lanes))
            d.append(builder.fptrunc(apart, vector) if values.dtype == types.float32 else apart)
        ex, ey, ez, end = (vector_of(builder, [value(k)] * lanes) for k in range(11, 15))
        r2, foot, zero = _dot(builder, d, d), _dot(builder, d, (ex, ey, ez)), ir.Constant(vector, None)
        within = builder.select(builder.fcmp_ordered(">", foot, zero), foot, zero)
        within = builder.select(builder.fcmp_ordered("<", within, end), within, end)
        past = builder.fsub(foot, within)
        away2 = builder.fadd(builder.fsub(r2, builder.fmul(foot, foot)), builder.fmul(past, past))
        return _kept(context, builder, signature, args, away2, {Q2: r2, ALONG: foot})

    return types.uint64(values, numbers, at, px, py, pz, first, left, x, y, z, ex, ey, ez, length), generate


@compiled_as(_list_near_segment)
def list_near_segment(values, numbers, at, px, py, pz, first, left, x, y, z, ex, ey, ez, length):
    """List those of eight points, or of sixteen in single precision, that are closer than 1 to a segment.

    The segment begins at a place and runs along a unit vector e. Differences of places are taken in double precision,
    the rest has the precision of the lists. Otherwise as `list_near_place`, with what `nodes_around_segment` writes.
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
