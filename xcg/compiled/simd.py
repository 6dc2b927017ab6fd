"""Several neighbouring numbers of an array in one instruction, written out for LLVM.

Loops over four or eight numbers would be compiled one number at a time, and merged again afterwards, if they are.
Nothing is checked unless ``NUMBA_BOUNDSCHECK=1`` is set, which `prefetch` and addresses do not heed: places must lie
within the array, and addresses be those of arrays that are still there. Sums and products are those of the same formula
number by number, bit for bit.
"""

import math
from collections.abc import Callable

from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.extending import intrinsic

FOUR, EIGHT = 4, 8
TILE = 64  # nodes that the algebra is done for at a time


def _at(context, builder, array_type, array, indices, lanes):
    """Pointer to `lanes` numbers of a C-contiguous array, from a place on, and the alignment of one of them."""
    view = context.make_array(array_type)(context, builder, array)
    shape = cgutils.unpack_tuple(builder, view.shape)
    if config.BOUNDSCHECK:
        last = builder.add(indices[-1], ir.Constant(ir.IntType(64), lanes - 1))
        for index, extent in zip([*indices, last], [*shape, shape[-1]], strict=True):
            cgutils.do_boundscheck(context, builder, index, extent)
    place = indices[0]
    for index, extent in zip(indices[1:], shape[1:], strict=True):
        place = builder.add(builder.mul(place, extent), index)
    number = context.get_data_type(array_type.dtype)
    pointer = builder.gep(view.data, [place])
    return builder.bitcast(pointer, ir.VectorType(number, lanes).as_pointer()), context.get_abi_sizeof(number)


def _vector(builder, values):
    out = ir.Constant(ir.VectorType(values[0].type, len(values)), ir.Undefined)
    for k, value in enumerate(values):
        out = builder.insert_element(out, value, ir.Constant(ir.IntType(32), k))
    return out


def _cast(context, builder, signature, args):
    """Arguments by number, cast to what the array holds: places to 64 bits, values to the array's numbers."""

    def place(k):
        return context.cast(builder, args[k], signature.args[k], types.uint64)

    def value(k):
        return context.cast(builder, args[k], signature.args[k], signature.args[0].dtype)

    return place, value


@intrinsic
def add4(typingctx, records, group, row, first, weight, a, b, c, d):
    """``records[group, row, first : first + 4] += weight * (a, b, c, d)``."""

    def generate(context, builder, signature, args):
        place, value = _cast(context, builder, signature, args)
        source = [place(1), place(2), place(3)]
        pointer, align = _at(context, builder, signature.args[0], args[0], source, FOUR)
        weights, columns = _vector(builder, [value(4)] * FOUR), _vector(builder, [value(k) for k in range(5, 9)])
        sums = builder.fadd(builder.load(pointer, align=align), builder.fmul(weights, columns))
        builder.store(sums, pointer, align=align)
        return context.get_dummy_value()

    return types.void(records, group, row, first, weight, a, b, c, d), generate


@intrinsic
def fill8(typingctx, lists, row, at, value):
    """``lists[row, at : at + 8] = value``."""

    def generate(context, builder, signature, args):
        place, number = _cast(context, builder, signature, args)
        pointer, align = _at(context, builder, signature.args[0], args[0], [place(1), place(2)], EIGHT)
        builder.store(_vector(builder, [number(3)] * EIGHT), pointer, align=align)
        return context.get_dummy_value()

    return types.void(lists, row, at, value), generate


@intrinsic
def add_scalar8(typingctx, lists, row, at, value, table, first):
    """``lists[row, at : at + 8] = value + lists[table, first : first + 8]``."""

    def generate(context, builder, signature, args):
        place, number = _cast(context, builder, signature, args)
        source, align = _at(context, builder, signature.args[0], args[0], [place(4), place(5)], EIGHT)
        target, _ = _at(context, builder, signature.args[0], args[0], [place(1), place(2)], EIGHT)
        add = builder.add if isinstance(signature.args[0].dtype, types.Integer) else builder.fadd
        sums = add(_vector(builder, [number(3)] * EIGHT), builder.load(source, align=align))
        builder.store(sums, target, align=align)
        return context.get_dummy_value()

    return types.void(lists, row, at, value, table, first), generate


@intrinsic
def ramp8(typingctx, lists, to, squares, at, first, step, origin, factor):
    """Write d = (first + k) step - origin, times a factor, and its square, for k = 0, ... 7.

    ``lists[to, at + k] = factor * d`` and ``lists[squares, at + k] = d * d``.
    """

    def generate(context, builder, signature, args):
        place, number = _cast(context, builder, signature, args)
        target, align = _at(context, builder, signature.args[0], args[0], [place(1), place(3)], EIGHT)
        square, _ = _at(context, builder, signature.args[0], args[0], [place(2), place(3)], EIGHT)
        begin, step, origin, factor = (_vector(builder, [number(k)] * EIGHT) for k in range(4, 8))
        number_type = context.get_data_type(signature.args[0].dtype)
        ramp = ir.Constant(
            ir.VectorType(number_type, EIGHT), [ir.Constant(number_type, float(k)) for k in range(EIGHT)]
        )
        d = builder.fsub(builder.fmul(builder.fadd(begin, ramp), step), origin)
        builder.store(builder.fmul(factor, d), target, align=align)
        builder.store(builder.fmul(d, d), square, align=align)
        return context.get_dummy_value()

    return types.void(lists, to, squares, at, first, step, origin, factor), generate


@intrinsic
def prefetch(typingctx, array, row):
    """Ask for the start of a row of an array, which need not be there, so that it has come when it is read."""

    def generate(context, builder, signature, args):
        view = context.make_array(signature.args[0])(context, builder, args[0])
        index = builder.mul(args[1], cgutils.unpack_tuple(builder, view.strides)[0])
        first = builder.bitcast(view.data, cgutils.voidptr_t)
        flags = [ir.Constant(ir.IntType(32), flag) for flag in (0, 3, 1)]  # to read, into all caches, data
        of = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t] + [flag.type for flag in flags])
        prefetch = cgutils.get_or_insert_function(builder.module, of, "llvm.prefetch.p0i8")
        builder.call(prefetch, [builder.gep(first, [index]), *flags])
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


# --- rows of as many numbers as a tile has nodes ---------------------------------------------------------


def _of_rows(compute: Callable) -> Callable:
    """Return an intrinsic that writes a row of an array (rows, TILE), number by number from one or two others."""

    def of_rows(typingctx, rows, to, a, b):
        def generate(context, builder, signature, args):
            place, _ = _cast(context, builder, signature, args)
            first = ir.Constant(ir.IntType(64), 0)
            starts = [_at(context, builder, signature.args[0], args[0], [place(n), first], EIGHT) for n in (1, 2, 3)]
            align = starts[0][1]
            for k in range(TILE // EIGHT):
                target, *sources = (builder.gep(start, [ir.Constant(ir.IntType(64), k)]) for start, _ in starts)
                values = compute(builder, *(builder.load(pointer, align=align) for pointer in sources))
                builder.store(values, target, align=align)
            return context.get_dummy_value()

        return types.void(rows, to, a, b), generate

    return intrinsic(of_rows)


def _all(value: float) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.DoubleType(), EIGHT), [value] * EIGHT)


def _root(builder, a, _):
    of = ir.FunctionType(a.type, [a.type])
    return builder.call(cgutils.get_or_insert_function(builder.module, of, f"llvm.sqrt.v{EIGHT}f64"), [a])


# ``rows[to] = rows[a] + rows[b]``, ...
row_sum = _of_rows(lambda builder, a, b: builder.fadd(a, b))
row_difference = _of_rows(lambda builder, a, b: builder.fsub(a, b))
row_product = _of_rows(lambda builder, a, b: builder.fmul(a, b))
row_quotient = _of_rows(lambda builder, a, b: builder.fdiv(a, b))
# of `a` alone: square roots; NaN where it is not positive; 0 where it is negative; 0 where it is NaN
row_root = _of_rows(_root)
nan_unless_positive = _of_rows(lambda b, a, _: b.select(b.fcmp_ordered(">", a, _all(0.0)), a, _all(math.nan)))
clip_at_zero = _of_rows(lambda b, a, _: b.select(b.fcmp_ordered("<", a, _all(0.0)), _all(0.0), a))
nan_to_zero = _of_rows(lambda b, a, _: b.select(b.fcmp_ordered("==", a, a), a, _all(0.0)))


# --- memory that is named by its address -----------------------------------------------------------------


def _pointer(context, builder, address, index):
    first = builder.inttoptr(address, ir.DoubleType().as_pointer())
    return builder.gep(first, [index])


@intrinsic
def load_number(typingctx, address, index):
    """Read the float64 that is `index` numbers from an address."""

    def generate(context, builder, signature, args):
        return builder.load(_pointer(context, builder, *args))

    return types.float64(types.uint64, types.uint64), generate


@intrinsic
def store_number(typingctx, address, index, value):
    """Write a float64 to the place that is `index` numbers from an address."""

    def generate(context, builder, signature, args):
        builder.store(args[2], _pointer(context, builder, *args[:2]))
        return context.get_dummy_value()

    return types.void(types.uint64, types.uint64, types.float64), generate


@intrinsic
def store_nontemporal(typingctx, address, index, value):
    """Write a float64 to the place that is `index` numbers from an address, past the caches.

    What is written in order, without gaps, goes to memory line by line, and nothing is read for it before.
    """

    def generate(context, builder, signature, args):
        whole = ir.IntType(64)  # of vectors the address would have to be aligned
        pointer = builder.bitcast(_pointer(context, builder, *args[:2]), whole.as_pointer())
        store = builder.store(builder.bitcast(args[2], whole), pointer)
        store.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)]))
        return context.get_dummy_value()

    return types.void(types.uint64, types.uint64, types.float64), generate


@intrinsic
def store_fence(typingctx):
    """Wait until all that was written past the caches is in memory, for other threads to see."""

    def generate(context, builder, signature, args):
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), generate


@intrinsic
def transpose8x8(typingctx, address, first, apart, rows, row, at):
    """``rows[row + c, at + k] = m[first + k * apart + c]`` for k, c = 0, ... 7, m the numbers from an address on."""

    def generate(context, builder, signature, args):
        place, _ = _cast(context, builder, signature, args)
        vectors = []
        for k in range(EIGHT):
            index = builder.add(place(1), builder.mul(place(2), ir.Constant(ir.IntType(64), k)))
            pointer = _pointer(context, builder, args[0], index)
            eight = ir.VectorType(ir.DoubleType(), EIGHT).as_pointer()
            vectors.append(builder.load(builder.bitcast(pointer, eight), align=8))
        half = EIGHT // 2
        merge = [
            ir.Constant(ir.VectorType(ir.IntType(32), EIGHT), [low + k // 2 + EIGHT * (k % 2) for k in range(EIGHT)])
            for low in (0, half)
        ]
        for _ in range(3):  # riffles of the halves, after which the vectors are the columns
            vectors = [
                builder.shuffle_vector(vectors[k // 2], vectors[k // 2 + half], merge[k % 2]) for k in range(EIGHT)
            ]
        for c, vector in enumerate(vectors):
            row = builder.add(place(4), ir.Constant(ir.IntType(64), c))
            pointer, align = _at(context, builder, signature.args[3], args[3], [row, place(5)], EIGHT)
            builder.store(vector, pointer, align=align)
        return context.get_dummy_value()

    return types.void(types.uint64, types.uint64, types.uint64, rows, types.uint64, types.uint64), generate
