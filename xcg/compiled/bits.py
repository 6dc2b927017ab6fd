"""Bytes of text and bits of whole numbers in one instruction, written out for LLVM as in `xcg.compiled.simd`."""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from xcg.compiled.simd import compiled_as, pointer_to, typed

BLOCK = 64  # bytes that are looked at together


def _bytes_where(emit, compute):
    """Return what tells which of 64 bytes are of a kind, as bits of a whole number."""

    def of_bytes(typingctx, data, at):
        def generate(context, builder, signature, args):
            place, _ = typed(context, builder, signature, args)
            pointer, align = pointer_to(context, builder, signature.args[0], args[0], [place(1)], BLOCK)
            found = emit(builder, builder.load(pointer, align=align))
            return builder.bitcast(found, ir.IntType(BLOCK))

        return types.uint64(data, at), generate

    @compiled_as(of_bytes)
    def bytes_where(data, at):
        return np.uint64(sum(1 << k for k, byte in enumerate(data[at : at + BLOCK].tolist()) if compute(byte)))

    return bytes_where


def _all(byte):
    return ir.Constant(ir.VectorType(ir.IntType(8), BLOCK), [byte] * BLOCK)


# the white space of Python's bytes: a space, or one of the five from the tab on
white = _bytes_where(
    lambda builder, data: builder.or_(
        builder.icmp_unsigned("==", data, _all(32)),
        builder.icmp_unsigned("<", builder.sub(data, _all(9)), _all(5)),
    ),
    lambda byte: byte == 32 or 9 <= byte < 14,
)
newlines = _bytes_where(lambda builder, data: builder.icmp_unsigned("==", data, _all(10)), lambda byte: byte == 10)


def _load8(typingctx, data, at):
    def generate(context, builder, signature, args):
        place, _ = typed(context, builder, signature, args)
        pointer, align = pointer_to(context, builder, signature.args[0], args[0], [place(1)], 8)
        return builder.load(builder.bitcast(pointer, ir.IntType(64).as_pointer()), align=align)

    return types.uint64(data, at), generate


@compiled_as(_load8)
def load8(data, at):
    """Eight bytes as a whole number, the first the lowest."""
    return np.uint64(int.from_bytes(data[at : at + 8].tobytes(), "little"))


def _counted(name, compute):
    """Return what counts zeros among the bits of a whole number that is not 0."""

    def of_bits(typingctx, bits):
        def generate(context, builder, signature, args):
            whole, flag = ir.IntType(64), ir.IntType(1)
            call = cgutils.get_or_insert_function(builder.module, ir.FunctionType(whole, [whole, flag]), name)
            return builder.call(call, [args[0], ir.Constant(flag, 0)])

        return types.uint64(types.uint64), generate

    @compiled_as(of_bits)
    def zeros(bits):
        return np.uint64(compute(int(bits)))

    return zeros


trailing_zeros = _counted("llvm.cttz.i64", lambda bits: (bits & -bits).bit_length() - 1 if bits else 64)
leading_zeros = _counted("llvm.ctlz.i64", lambda bits: 64 - bits.bit_length())


def _high_product(typingctx, a, b):
    def generate(context, builder, signature, args):
        wide = ir.IntType(128)
        product = builder.mul(*(builder.zext(arg, wide) for arg in args))
        return builder.trunc(builder.lshr(product, ir.Constant(wide, 64)), ir.IntType(64))

    return types.uint64(types.uint64, types.uint64), generate


@compiled_as(_high_product)
def high_product(a, b):
    """Upper 64 of the 128 bits of a product."""
    return np.uint64(int(a) * int(b) >> 64)
