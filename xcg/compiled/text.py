"""Tables of numbers in text: words, lines, and the float64 nearest to a decimal number.

Words are found 64 bytes at a time, and words of other columns are skipped.

Digits are read eight at a time, and a word of up to eight characters, point and all, at once. A
number of up to 19 digits is a whole number m times a power of ten. Where both are exact in float64,
one product or quotient gives the nearest number; else 128 bits of the product of m and a power of
five do, by the algorithm of Eisel and Lemire (D. Lemire, Number parsing at a gigabyte per second,
Software: Practice and Experience 51, 1700, 2021). What this does not decide is left to the caller:
subnormal numbers, numbers halfway between two, infinities, longer numbers whose further digits
matter, and words that are no numbers.

Whole numbers whose bits are shifted are typed (`np.uint64`), because a signed one beside them makes
both float64.
"""

import numpy as np
from llvmlite import ir
from numba import types

from xcg.compiled._jit import cgutils, inlined, inner, leaf
from xcg.compiled.simd import compiled_as, pointer_to, typed, vector_of

# --- bytes and bits, written out for LLVM as in `xcg.compiled.simd` ------------------------------------------

BLOCK = 64  # bytes that are looked at together


def _bytes_where(emit, compute):
    """Return a mask of 64 bits that marks the bytes of one kind."""

    def of_bytes(typingctx, data, at):
        def generate(context, builder, signature, args):
            index_of, _ = typed(context, builder, signature, args)
            pointer, align = pointer_to(
                context, builder, signature.args[0], args[0], [index_of(1)], BLOCK
            )
            found = emit(builder, builder.load(pointer, align=align))
            return builder.bitcast(found, ir.IntType(BLOCK))

        return types.uint64(data, at), generate

    @compiled_as(of_bytes)
    def bytes_where(data, at):
        return np.uint64(
            sum(1 << k for k, byte in enumerate(data[at : at + BLOCK].tolist()) if compute(byte))
        )

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
newlines = _bytes_where(
    lambda builder, data: builder.icmp_unsigned("==", data, _all(10)), lambda byte: byte == 10
)


def _equal(typingctx, data, at, byte):
    def generate(context, builder, signature, args):
        index_of, value = typed(context, builder, signature, args)
        pointer, align = pointer_to(
            context, builder, signature.args[0], args[0], [index_of(1)], BLOCK
        )
        sought = vector_of(builder, [value(2)] * BLOCK)
        found = builder.icmp_unsigned("==", builder.load(pointer, align=align), sought)
        return builder.bitcast(found, ir.IntType(BLOCK))

    return types.uint64(data, at, byte), generate


@compiled_as(_equal)
def equal(data, at, byte):
    """Return a mask of 64 bits that marks the bytes of one value."""
    return np.uint64(sum(1 << k for k, one in enumerate(data[at : at + BLOCK]) if one == byte))


def _load8(typingctx, data, at):
    def generate(context, builder, signature, args):
        index_of, _ = typed(context, builder, signature, args)
        pointer, align = pointer_to(context, builder, signature.args[0], args[0], [index_of(1)], 8)
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
            whole = ir.IntType(64)
            flag = ir.IntType(1)
            call = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(whole, [whole, flag]), name
            )
            return builder.call(call, [args[0], ir.Constant(flag, 0)])

        return types.uint64(types.uint64), generate

    @compiled_as(of_bits)
    def zeros(bits):
        return np.uint64(compute(int(bits)))

    return zeros


trailing_zeros = _counted(
    "llvm.cttz.i64", lambda bits: (bits & -bits).bit_length() - 1 if bits else 64
)
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


# --- decimal numbers ---------------------------------------------------------------------------------------

_U = np.uint64
_ONE = _U(1)
_EIGHT = _U(8)
_MOST = 19  # digits that fit into 64 bits, whichever they are
_EXACT = _U(1 << 53)  # whole numbers up to here are exact in float64
_TENS = np.array([10.0**k for k in range(23)])  # all exact
_WHOLE_TENS = np.array([10**k for k in range(_MOST + 1)], np.uint64)


def _repeated(byte: int) -> np.uint64:
    return _U(int.from_bytes(bytes([byte]) * 8, "little"))


_ZEROS, _POINTS, _ONES, _TOP, _ABOVE_NINE = map(_repeated, (0x30, 0x2E, 0x01, 0x80, 0x76))


# --- powers of ten -----------------------------------------------------------------------------------------

_LEAST, _LARGEST = -342, 308  # powers of ten; with 19 digits, all beyond is 0 or infinite


def _fives():
    """128 bits of each power of five, the highest set: of positive powers cut off, of negative ones rounded up."""
    table = np.empty((_LARGEST - _LEAST + 1, 2), np.uint64)
    for q in range(_LEAST, _LARGEST + 1):
        if q >= 0:
            bits = 5**q << 128 >> (5**q).bit_length()
        else:
            length = (5**-q - 1).bit_length()
            shift = length + 127
            if q < -27:
                shift = 2 * length + 128
            bits = (1 << shift) // 5**-q + 1
            bits >>= max(0, bits.bit_length() - 128)
        table[q - _LEAST] = bits >> 64, bits & (1 << 64) - 1
    return table


_FIVES = _fives()


@inner
def _nearest(m, power):
    """Find the float64 nearest to m 10^power, and whether it is known; m is a uint64 and not 0."""
    if power < _LEAST or power > _LARGEST:
        return 0.0, False
    shift = leading_zeros(m)
    m = m << shift
    five = _FIVES[power - _LEAST]
    upper = high_product(m, five[0])
    lower = m * five[0]
    if upper & _U(0x1FF) == _U(0x1FF):  # bits that lower ones may yet change
        added = high_product(m, five[1])
        lower = lower + added
        if added > lower:
            upper = upper + _ONE
    top = upper >> _U(63)
    bits = upper >> (top + _U(9))  # one more than a float64 has
    exponent = ((217706 * power) >> 16) + 1086 + np.int64(top) - np.int64(shift)
    halfway = lower <= _ONE and bits & _U(3) == _ONE
    if exponent <= 0 or exponent >= 2046 or halfway or lower == _U(0xFFFFFFFFFFFFFFFF):
        return 0.0, False
    bits = (bits + (bits & _ONE)) >> _ONE  # 2^53 where it was rounded up to the next power of two
    return np.uint64(bits + (_U(exponent - 1) << _U(52))).view(np.float64), True


# --- words -------------------------------------------------------------------------------------------------


@inlined
def _digits(text, at, count):
    """Up to eight characters as numbers from 0 to 9 in eight bytes, the last in the highest, zeros before them."""
    half = _U(4 * (8 - count))  # twice, as no whole number can be shifted by all its bits
    return ((load8(text, at) ^ _ZEROS) << half) << half


@inlined
def _whole(digits):
    """Whole number of eight digits, the first in the lowest byte."""
    pairs = digits * _U(10) + (digits >> _EIGHT)
    odd = (pairs & _U(0x000000FF000000FF)) * _U(100 + (1000000 << 32))
    even = ((pairs >> _U(16)) & _U(0x000000FF000000FF)) * _U(1 + (10000 << 32))
    return (odd + even) >> _U(32)


@inlined
def _not_digits(digits):
    """Bits that are set where one of eight bytes is above 9; others may be set as well, outside `_TOP`."""
    return (digits + _ABOVE_NINE) | digits


@inlined
def _points(characters):
    """Bits of which the lowest is the highest bit of the first byte that holds a point; 0 without a point."""
    differs = characters ^ _POINTS
    return (differs - _ONES) & ~differs & _TOP


@inlined
def _short(text, at, count):
    """Read one to eight characters, digits with or without a point, as m 10^power; return whether they have that form.

    The point is taken out, and the digits before it move up by a byte.
    """
    unused = _U(8 * (8 - count))
    characters = load8(text, at)
    digits = (characters ^ _ZEROS) << unused
    points = _points(characters << unused)
    power = np.int64(0)
    if points:
        first = (points & (~points + _ONE)) >> _U(7)  # the lowest bit of the byte of the point
        power = -np.int64(leading_zeros(first) >> _U(3))
        digits = (digits & (first - _ONE)) << _EIGHT | digits & ~((first << _EIGHT) - _ONE)
    fits = _not_digits(digits) & _TOP == _U(0) and (count > 1 or points == _U(0))
    return _whole(digits), power, fits


@inlined
def _usual(text, at, end):
    """Read digits with a point and an exponent of two digits as m 10^power; return whether they have that form.

    There are up to 8 digits before the point, or where no point is, and 19 in all without zeros at
    the front.
    """
    power = np.int64(0)
    if end - at > 4:
        tail = load8(text, end - 4)
        sign = tail >> _EIGHT & _U(255)
        tens = np.int64(tail >> _U(16) & _U(255)) - 48
        ones = np.int64(tail >> _U(24) & _U(255)) - 48
        # "e-05", Fortran's "D-05"
        if (
            tail & _U(0xDE) == 68
            and (sign == 43 or sign == 45)
            and 0 <= tens <= 9
            and 0 <= ones <= 9
        ):
            power = 10 * tens + ones
            if sign == 45:
                power = -power
            end -= 4
    if 1 <= end - at <= 8:
        m, shift, fits = _short(text, at, end - at)
        return m, power + shift, fits
    before = min(np.int64(trailing_zeros(_points(load8(text, at))) >> _U(3)), end - at)
    after = end - at - before - 1  # -1 without a point
    if before + max(after, 0) < 1 or (after >= 0 and before == 8):
        return _U(0), 0, False
    digits = _digits(text, at, before)
    m = _whole(digits)
    wrong = _not_digits(digits)
    at += before + 1
    if after > 0:
        power -= after
    while after > 0:
        count = min(after, 8)
        if m >= _WHOLE_TENS[_MOST - count]:
            return _U(0), 0, False
        digits = _digits(text, at, count)
        m = m * _WHOLE_TENS[count] + _whole(digits)
        wrong |= _not_digits(digits)
        at += 8
        after -= count
    return m, power, wrong & _TOP == _U(0)


@inner
def _any(text, at, end):
    """Read any decimal number as m 10^power; return whether further digits follow m, and whether it is a number."""
    m = _U(0)
    digits = 0
    power = np.int64(0)
    further = False
    point = False
    there = False
    while at < end:
        digit = np.int64(text[at]) - 48
        if 0 <= digit <= 9:
            there = True
            if digits < _MOST:
                m = m * _U(10) + _U(digit)
                digits += m != _U(0)
                power -= point
            else:
                further |= digit != 0
                power += not point
        elif digit == -2 and not point:
            point = True
        else:
            break
        at += 1
    if at < end:
        there &= (text[at] | 33) == 101  # e or E, or Fortran's d or D
        at += 1
        negative = at < end and text[at] == 45
        at += at < end and (text[at] == 45 or text[at] == 43)
        there &= at < end
        exponent = np.int64(0)
        while at < end:
            digit = np.int64(text[at]) - 48
            there &= 0 <= digit <= 9
            if exponent < 100000:
                exponent = 10 * exponent + digit
            at += 1
        power += -exponent if negative else exponent
    return m, power, further, there


@inlined
def number(text, start, end):
    """Read a word as a number.

    Returns
    -------
    value : float
        The nearest float64, ties to even.
    is_nearest : bool
        Whether it is; else Python's `float` decides, or the word is not a number.
    """
    negative = load8(text, start) & _U(255) == _U(45)
    m, power, is_nearest = _usual(text, start + negative, end)
    further = False
    if not is_nearest:
        m, power, further, is_nearest = _any(text, start + (negative or text[start] == 43), end)
    value = 0.0
    if is_nearest and m <= _EXACT and -22 <= power <= 22:  # both are exact
        value = float(m) / _TENS[-power] if power < 0 else float(m) * _TENS[power]
    elif is_nearest and m != _U(0):
        value, is_nearest = _nearest(m, power)
        if further:
            above, also = _nearest(m + _ONE, power)
            is_nearest = is_nearest and also and above == value
    return (-value if negative else value), is_nearest


# --- tables ------------------------------------------------------------------------------------------------

BEYOND = 2 * BLOCK  # bytes of white space that must follow a text
# of words left to the caller
REST = (
    "row",
    "index among the wanted",
    "first byte",
    "byte after it",
)

_LAST = _U(BLOCK - 1)


@inner
def find_words(text, size, separator, edges, lines):
    """Find the words and lines of a text that ends with white space: where words begin and end, in turn, and lines end.

    Words end at white space and at the `separator`, a byte.

    Returns
    -------
    words, lines : int
        How many there are; what follows them in `edges` and `lines` is beyond the text.
    """
    edge = 0
    line = 0
    before = _ONE  # whether the byte before is white space
    for first in range(0, size, BLOCK):
        blank = white(text, first) | equal(text, first, separator)
        changes = blank ^ ((blank << _ONE) | before)
        before = blank >> _LAST
        while changes:
            edges[edge] = first + np.int64(trailing_zeros(changes))
            edge += 1
            changes &= changes - _ONE
        ends = newlines(text, first)
        while ends:
            lines[line] = first + np.int64(trailing_zeros(ends))
            line += 1
            ends &= ends - _ONE
    return edge // 2, line


@leaf
def read_rows(text, size, separator, columns, wanted, out, row, edges, lines, rest):
    """Read rows of numbers until one is not as it should be.

    Parameters
    ----------
    text : array of uint8
        Lines, the last with its end, and `BEYOND` more bytes of white space.
    size : int
        Bytes of the lines.
    separator : int
        A byte that stands between words as white space does.
    columns : int
        Words that each line has, unless it is blank.
    wanted : array of int64, (w,)
        Columns to read.
    out : array, (w, rows)
        Where numbers are written, from `row` on.
    edges, lines : arrays of int32
        Scratch: for each word its first byte and the byte after it, and for each line its end.
    rest : array of int64, (n, 4)
        Words whose numbers are left to the caller, see `REST`.

    Returns
    -------
    rows, done, left : int
        Rows that were read, bytes that are done with, and words in `rest`. Reading stops before a
        line with more or fewer words, one beyond the rows of `out`, and one for which `rest` may
        have no room.
    """
    words, count = find_words(text, size, separator, edges, lines)
    for edge in range(2 * words, 2 * (words + columns) + 1):
        edges[edge] = text.size
    first = row
    word = 0
    done = 0
    left = 0
    for line in range(count):
        end = lines[line]
        if edges[2 * word] < end:
            if edges[2 * (word + columns - 1)] > end or edges[2 * (word + columns)] < end:
                break
            if row == out.shape[1] or left + wanted.size > rest.shape[0]:
                break
            for w in range(wanted.size):
                edge = 2 * (word + wanted[w])
                start = np.int64(edges[edge])
                stop = np.int64(edges[edge + 1])
                value, is_nearest = number(text, start, stop)
                out[w, row] = value
                if not is_nearest:
                    rest[left, 0] = row
                    rest[left, 1] = w
                    rest[left, 2] = start
                    rest[left, 3] = stop
                    left += 1
            word += columns
            row += 1
        done = end + 1
    return row - first, min(done, size), left
