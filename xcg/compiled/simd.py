"""Several neighbouring numbers of an array in one instruction, written out for LLVM.

Numba compiles a Python loop over four or eight numbers one number at a time, and LLVM merges them
afterwards only sometimes. So each function here has two forms: the Python function says what it
does, and runs where nothing is compiled (``NUMBA_DISABLE_JIT=1``, to step through a loop in a
debugger); the function in front of it, of the same name with an underscore, writes the instructions
that compiled code has in its place. Both give the same bits.

Compiled code checks indices only where ``NUMBA_BOUNDSCHECK=1`` is set, and never what `prefetch` is
asked for: indices must lie within the array.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from xcg.compiled._jit import cgutils

FOUR = 4
EIGHT = 8
TILE = 64  # nodes that the algebra is done for at a time


def compiled_as(emit: Callable) -> Callable:
    """Pair a Python function with the instructions that compiled code has in its place.

    `emit` is what `numba.extending.intrinsic` takes: from the types of the arguments to a signature
    and a function that writes instructions. As of a compiled loop, the Python function is the
    attribute ``py_func``.
    """

    def pair(function: Callable) -> Any:
        if config.DISABLE_JIT:
            return function
        emit.__doc__ = function.__doc__
        instructions = intrinsic(emit)
        instructions.py_func = function
        return instructions

    return pair


def pointer_to(context, builder, array_type, array, indices, lanes):
    """Pointer to `lanes` numbers of a C-contiguous array, from indices on, and the alignment of one of them."""
    view = context.make_array(array_type)(context, builder, array)
    shape = cgutils.unpack_tuple(builder, view.shape)
    if config.BOUNDSCHECK:
        last = builder.add(indices[-1], ir.Constant(ir.IntType(64), lanes - 1))
        for index, extent in zip([*indices, last], [*shape, shape[-1]], strict=True):
            cgutils.do_boundscheck(context, builder, index, extent)
    flat = indices[0]
    for index, extent in zip(indices[1:], shape[1:], strict=True):
        flat = builder.add(builder.mul(flat, extent), index)
    number = context.get_data_type(array_type.dtype)
    pointer = builder.gep(view.data, [flat])
    return builder.bitcast(
        pointer, ir.VectorType(number, lanes).as_pointer()
    ), context.get_abi_sizeof(number)


def vector_of(builder, values):
    """Combine numbers into a vector."""
    out = ir.Constant(ir.VectorType(values[0].type, len(values)), ir.Undefined)
    for k, value in enumerate(values):
        out = builder.insert_element(out, value, ir.Constant(ir.IntType(32), k))
    return out


def typed(context, builder, signature, args):
    """Arguments by number, cast: indices to 64 bits, values to the type of the array."""

    def index_of(k):
        return context.cast(builder, args[k], signature.args[k], types.uint64)

    def value(k):
        return context.cast(builder, args[k], signature.args[k], signature.args[0].dtype)

    return index_of, value


def pointers(context, builder, signature, args):
    """Pointers to numbers of the array, see `pointer_to`, by the numbers of the arguments that are its indices."""
    index_of, _ = typed(context, builder, signature, args)

    def pointer(indices, lanes):
        numbers = [index_of(k) for k in indices]
        return pointer_to(context, builder, signature.args[0], args[0], numbers, lanes)

    return pointer


def _add4(typingctx, records, group, row, first, weight, columns):
    def generate(context, builder, signature, args):
        _, value = typed(context, builder, signature, args)
        pointer = pointers(context, builder, signature, args)
        source, align = pointer((1, 2, 3), FOUR)
        weights = vector_of(builder, [value(4)] * FOUR)
        numbers = vector_of(builder, cgutils.unpack_tuple(builder, args[5]))
        sums = builder.fadd(builder.load(source, align=align), builder.fmul(weights, numbers))
        builder.store(sums, source, align=align)
        return context.get_dummy_value()

    four = types.UniTuple(records.dtype, FOUR)
    return types.void(records, group, row, first, weight, four), generate


@compiled_as(_add4)
def add4(records, group, row, first, weight, columns):
    """``records[group, row, first : first + 4] += weight * columns``, of four columns."""
    real = records.dtype.type
    records[group, row, first : first + FOUR] += real(weight) * np.array(columns, real)


def _fill8(typingctx, lists, row, at, value):
    def generate(context, builder, signature, args):
        _, number = typed(context, builder, signature, args)
        pointer = pointers(context, builder, signature, args)
        target, align = pointer((1, 2), EIGHT)
        builder.store(vector_of(builder, [number(3)] * EIGHT), target, align=align)
        return context.get_dummy_value()

    return types.void(lists, row, at, value), generate


@compiled_as(_fill8)
def fill8(lists, row, at, value):
    """``lists[row, at : at + 8] = value``."""
    lists[row, at : at + EIGHT] = value


def _add_scalar8(typingctx, lists, row, at, value, table, first):
    def generate(context, builder, signature, args):
        _, number = typed(context, builder, signature, args)
        pointer = pointers(context, builder, signature, args)
        source, align = pointer((4, 5), EIGHT)
        target, _ = pointer((1, 2), EIGHT)
        add = builder.fadd
        if isinstance(lists.dtype, types.Integer):
            add = builder.add
        sums = add(vector_of(builder, [number(3)] * EIGHT), builder.load(source, align=align))
        builder.store(sums, target, align=align)
        return context.get_dummy_value()

    return types.void(lists, row, at, value, table, first), generate


@compiled_as(_add_scalar8)
def add_scalar8(lists, row, at, value, table, first):
    """``lists[row, at : at + 8] = value + lists[table, first : first + 8]``."""
    lists[row, at : at + EIGHT] = lists.dtype.type(value) + lists[table, first : first + EIGHT]


def _ramp8(typingctx, lists, to, squares, at, first, spacing, origin, factor):
    def generate(context, builder, signature, args):
        _, number = typed(context, builder, signature, args)
        pointer = pointers(context, builder, signature, args)
        target, align = pointer((1, 3), EIGHT)
        square, _ = pointer((2, 3), EIGHT)
        begin, spacing, origin, factor = (
            vector_of(builder, [number(k)] * EIGHT) for k in range(4, 8)
        )
        vector = ir.VectorType(context.get_data_type(lists.dtype), EIGHT)
        ramp = ir.Constant(vector, [float(k) for k in range(EIGHT)])
        d = builder.fsub(builder.fmul(builder.fadd(begin, ramp), spacing), origin)
        builder.store(builder.fmul(factor, d), target, align=align)
        builder.store(builder.fmul(d, d), square, align=align)
        return context.get_dummy_value()

    return types.void(lists, to, squares, at, first, spacing, origin, factor), generate


@compiled_as(_ramp8)
def ramp8(lists, to, squares, at, first, spacing, origin, factor):
    """Write d = (first + k) spacing - origin, times a factor, and its square, for k = 0, ... 7.

    ``lists[to, at + k] = factor * d`` and ``lists[squares, at + k] = d * d``.
    """
    real = lists.dtype.type
    d = (real(first) + np.arange(EIGHT, dtype=real)) * real(spacing) - real(origin)
    lists[to, at : at + EIGHT] = real(factor) * d
    lists[squares, at : at + EIGHT] = d * d


def _prefetch(typingctx, array, row):
    def generate(context, builder, signature, args):
        view = context.make_array(signature.args[0])(context, builder, args[0])
        index = builder.mul(args[1], cgutils.unpack_tuple(builder, view.strides)[0])
        first = builder.bitcast(view.data, cgutils.voidptr_t)
        # to read, into all caches, data
        flags = [ir.Constant(ir.IntType(32), flag) for flag in (0, 3, 1)]
        of = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t] + [flag.type for flag in flags])
        prefetch = cgutils.get_or_insert_function(builder.module, of, "llvm.prefetch.p0i8")
        builder.call(prefetch, [builder.gep(first, [index]), *flags])
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


@compiled_as(_prefetch)
def prefetch(array, row):
    """Ask for the start of a row of an array, which need not be there, so that it is in cache when it is read."""


def _transpose8x8(typingctx, numbers, first, apart, rows, row, at):
    def generate(context, builder, signature, args):
        index_of, _ = typed(context, builder, signature, args)
        vectors = []
        for k in range(EIGHT):
            index = builder.add(
                index_of(1), builder.mul(index_of(2), ir.Constant(ir.IntType(64), k))
            )
            source, align = pointer_to(context, builder, signature.args[0], args[0], [index], EIGHT)
            vectors.append(builder.load(source, align=align))
        half = EIGHT // 2
        merge = [
            ir.Constant(
                ir.VectorType(ir.IntType(32), EIGHT),
                [low + k // 2 + EIGHT * (k % 2) for k in range(EIGHT)],
            )
            for low in (0, half)
        ]
        for _ in range(3):  # riffles of the halves, after which the vectors are the columns
            vectors = [
                builder.shuffle_vector(vectors[k // 2], vectors[k // 2 + half], merge[k % 2])
                for k in range(EIGHT)
            ]
        for c, vector in enumerate(vectors):
            row = builder.add(index_of(4), ir.Constant(ir.IntType(64), c))
            pointer, align = pointer_to(
                context, builder, signature.args[3], args[3], [row, index_of(5)], EIGHT
            )
            builder.store(vector, pointer, align=align)
        return context.get_dummy_value()

    return types.void(
        numbers, types.uint64, types.uint64, rows, types.uint64, types.uint64
    ), generate


@compiled_as(_transpose8x8)
def transpose8x8(numbers, first, apart, rows, row, at):
    """``rows[row + c, at + k] = numbers[first + k * apart + c]`` for k, c = 0, ... 7."""
    for k in range(EIGHT):
        for c in range(EIGHT):
            rows[row + c, at + k] = numbers[first + k * apart + c]


def _stream(typingctx, array, at, values):
    def generate(context, builder, signature, args):
        bits = ir.IntType(64)  # of vectors the pointer would have to be aligned
        once = builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)])
        index_of, _ = typed(context, builder, signature, args)
        for k, value in enumerate(cgutils.unpack_tuple(builder, args[2])):
            index = builder.add(index_of(1), ir.Constant(bits, k))
            pointer, align = pointer_to(context, builder, signature.args[0], args[0], [index], 1)
            pointer = builder.bitcast(pointer, bits.as_pointer())
            store = builder.store(builder.bitcast(value, bits), pointer, align=align)
            store.set_metadata("nontemporal", once)
        return context.get_dummy_value()

    return types.void(array, types.uint64, values), generate


@compiled_as(_stream)
def stream(array, at, values):
    """``array[at : at + len(values)] = values``, past the caches.

    Memory that is written in order, without gaps, is not read before. Other threads see it once a lock
    has passed to them, which is a locked instruction: these wait for it.
    """
    array[at : at + len(values)] = values


def _mantissa(typingctx, number):
    def generate(context, builder, signature, args):
        whole = ir.IntType(64)
        bits = builder.bitcast(args[0], whole)
        bits = builder.and_(bits, ir.Constant(whole, (1 << 52) - 1))
        bits = builder.or_(bits, ir.Constant(whole, 1023 << 52))
        return builder.bitcast(bits, ir.DoubleType())

    return types.float64(types.float64), generate


@compiled_as(_mantissa)
def mantissa(number):
    """Return m of a positive number m 2^n, with 1 <= m < 2."""
    return 2.0 * math.frexp(number)[0]


def _exponent(typingctx, number):
    def generate(context, builder, signature, args):
        whole = ir.IntType(64)
        bits = builder.lshr(builder.bitcast(args[0], whole), ir.Constant(whole, 52))
        # processors turn several integers of 32 bits at once into floats
        exponent = builder.sub(
            builder.trunc(bits, ir.IntType(32)), ir.Constant(ir.IntType(32), 1023)
        )
        return builder.sitofp(exponent, ir.DoubleType())

    return types.float64(types.float64), generate


@compiled_as(_exponent)
def exponent(number):
    """Return n of a positive number m 2^n, with 1 <= m < 2, as a float."""
    return math.frexp(number)[1] - 1.0
