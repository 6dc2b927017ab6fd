"""Several neighbouring numbers of an array in one instruction, written out for LLVM.

Loops over four or eight numbers would be compiled one number at a time, and merged again afterwards, if they are.
Nothing is checked: all places must lie within the array. Sums and products are those of the same formula number by
number, bit for bit.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

FOUR, EIGHT = 4, 8


def _at(context, builder, array_type, array, indices, lanes):
    """Pointer to `lanes` numbers of a C-contiguous array, from a place on, and the alignment of one of them."""
    view = context.make_array(array_type)(context, builder, array)
    place = indices[0]
    for index, extent in zip(indices[1:], cgutils.unpack_tuple(builder, view.shape)[1:], strict=True):
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
def add_four(typingctx, records, group, row, first, weight, a, b, c, d):
    """``records[group, row, first : first + 4] += weight * (a, b, c, d)``."""

    def generate(context, builder, signature, args):
        place, value = _cast(context, builder, signature, args)
        where = [place(1), place(2), place(3)]
        pointer, align = _at(context, builder, signature.args[0], args[0], where, FOUR)
        weights, columns = _vector(builder, [value(4)] * FOUR), _vector(builder, [value(k) for k in range(5, 9)])
        sums = builder.fadd(builder.load(pointer, align=align), builder.fmul(weights, columns))
        builder.store(sums, pointer, align=align)
        return context.get_dummy_value()

    return types.void(records, group, row, first, weight, a, b, c, d), generate


@intrinsic
def put_eight(typingctx, lists, row, at, value):
    """``lists[row, at : at + 8] = value``."""

    def generate(context, builder, signature, args):
        place, number = _cast(context, builder, signature, args)
        pointer, align = _at(context, builder, signature.args[0], args[0], [place(1), place(2)], EIGHT)
        builder.store(_vector(builder, [number(3)] * EIGHT), pointer, align=align)
        return context.get_dummy_value()

    return types.void(lists, row, at, value), generate


@intrinsic
def put_sum(typingctx, lists, row, at, value, table, first):
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
def put_line(typingctx, lists, to, squares, at, first, step, origin, factor):
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
