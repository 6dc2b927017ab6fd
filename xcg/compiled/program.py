"""The algebra at the nodes, step by step, over a few nodes at a time so that all intermediate results stay in cache."""

import ctypes
import math

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inner, leaf
from xcg.compiled.matrices import fit_rows
from xcg.compiled.simd import (
    EIGHT,
    TILE,
    load_number,
    store_fence,
    store_nontemporal,
    store_number,
    transpose8x8,
)

# The operations of a step (operation, result, a, b). Results and operands are rows of the scratch,
# but for a load and a store, which say what to load or store.
(
    CONSTANT,
    LOAD,
    STORE,
    ADD,
    SUBTRACT,
    MULTIPLY,
    DIVIDE,
    SQUARE_ROOT,
    WHERE_POSITIVE,
    AT_LEAST_ZERO,
    ZERO_IF_UNKNOWN,
    FIT,
    PART,
) = range(13)
THREE = np.uint64(3)
_NUMBER = np.dtype("float64")
BYTES = _NUMBER.itemsize
_LINE = 64  # bytes of a line of the cache


def room_for(rows: int) -> NDArray:
    """Make zeros (rows, TILE) that begin with a line of the cache: all steps take a seventh longer across two lines."""
    spare = np.zeros(rows * TILE + _LINE // BYTES)
    first = -spare.ctypes.data % _LINE // BYTES
    return spare[first : first + rows * TILE].reshape(rows, TILE)


def address_of(numbers: NDArray, rows: int, width: int, name: str) -> int:
    """Address of an array (rows, width), or with more rows, that a loop works on by address, where nothing is checked.

    Raises
    ------
    ValueError
        If the loop would read or write other memory, or other numbers.
    """
    fits = len(numbers) >= rows and numbers.size == len(numbers) * width
    if not (fits and numbers.dtype == _NUMBER and numbers.flags.carray):
        raise ValueError(
            f"{name!r}: expected ({rows}, {width}) numbers or more, float64 and one after the "
            f"other in memory that can be written to; this is an array {numbers.shape} of "
            f"{numbers.dtype} with strides {numbers.strides}, writeable={numbers.flags.writeable}"
        )
    if not numbers.size:
        return 0
    return ctypes.addressof(ctypes.c_char.from_buffer(numbers.data))


@leaf
def run(steps, records, source, fields, target, place, order, tile, scratch):
    """Do the steps of a program for all nodes.

    Parameters
    ----------
    steps : (n, 4)
        Operation, result and operands.
    records : (arrays, 3)
        Address of each array of sums (nodes, width), its width, and the row of the scratch where
        its columns begin.
    source : (loads, 2)
        Row of the column of each load, and the row of a factor.
    fields : (stores, 3)
        Address of the first component of each store, the numbers that the field holds for a place,
        and how many components are stored: 1, 3 or 9.
    target : (stores, 9)
        Rows of the components.
    place : (nodes,)
        Place of each node in the fields, in the order in which nodes are taken.
    order : (nodes,) or None
        Which record is that of each node; None where records are in that order, which leaves code
        out.
    tile : int
        Address of scratch for as many records as a tile has nodes, and eight numbers more, of the
        largest width.
    scratch : (rows, TILE)
        Holds constants and factors.
    """
    unread = 0.0
    for first in range(0, place.size, TILE):
        many = min(TILE, place.size - first)
        for n in range(records.shape[0]):
            address = records[n, 0]
            width = records[n, 1]
            row = records[n, 2]
            if order is None:
                unread += _transpose_records(address, width, row, first, many, place.size, scratch)
            else:
                unread += _gather_records(address, width, order, first, many, tile)
                _transpose_records(tile, width, row, 0, many, TILE + EIGHT, scratch)
        for step in range(steps.shape[0]):
            operation = steps[step, 0]
            r = steps[step, 1]
            a = steps[step, 2]
            b = steps[step, 3]
            if operation == STORE:
                address = fields[r, 0]
                width = fields[r, 1]
                components = fields[r, 2]
                rows = target[r]
                if width == components:
                    _store(address, width, rows, place, first, many, scratch)
                else:
                    _store_apart(address, width, components, rows, place, first, many, scratch)
            elif operation == FIT:
                fit_rows(scratch, a, r, many, b)
            elif operation == LOAD:
                _combine(np.uint64(MULTIPLY), scratch, r, source[a, 0], source[a, 1])
            else:
                _combine(operation, scratch, r, a, b)
    store_fence()
    scratch[0, 0] = unread


@inner
def _combine(operation, rows, to, a, b):
    """Write the result of an operation on two rows, or on the first of them, to a row."""
    if operation == ADD:
        for k in range(np.uint64(TILE)):
            rows[to, k] = rows[a, k] + rows[b, k]
    elif operation == SUBTRACT:
        for k in range(np.uint64(TILE)):
            rows[to, k] = rows[a, k] - rows[b, k]
    elif operation == MULTIPLY:
        for k in range(np.uint64(TILE)):
            rows[to, k] = rows[a, k] * rows[b, k]
    elif operation == DIVIDE:
        for k in range(np.uint64(TILE)):
            rows[to, k] = rows[a, k] / rows[b, k]
    elif operation == SQUARE_ROOT:
        for k in range(np.uint64(TILE)):
            rows[to, k] = np.sqrt(rows[a, k])
    elif operation == WHERE_POSITIVE:
        for k in range(np.uint64(TILE)):
            rows[to, k] = rows[a, k] if rows[a, k] > 0.0 else math.nan
    elif operation == AT_LEAST_ZERO:
        for k in range(np.uint64(TILE)):
            rows[to, k] = 0.0 if rows[a, k] < 0.0 else rows[a, k]
    elif operation == ZERO_IF_UNKNOWN:
        for k in range(np.uint64(TILE)):
            rows[to, k] = rows[a, k] if rows[a, k] == rows[a, k] else 0.0


@inner
def _gather_records(address, width, order, first, many, tile):
    """Copy some records (nodes, width) side by side; returns the sum of one number in each line of memory.

    Lines are first read without waiting for any of them.
    """
    read = 0.0
    for k in range(many):
        begin = order[first + k] * width
        for c in range(np.uint64(0), width, np.uint64(EIGHT)):
            read += load_number(address, begin + c)
        read += load_number(address, begin + width - np.uint64(1))
    for k in range(many):
        begin = order[first + k] * width
        to = k * width
        for c in range(width):
            store_number(tile, to + c, load_number(address, begin + c))
    return read


@inner
def _transpose_records(address, width, row, first, many, nodes, scratch):
    """Write the columns of some records (nodes, width) to rows; returns the sum of one number in each line of memory.

    Lines are first read one after the other, as the processor expects it: that takes half the time.
    """
    begin = first * width
    end = (first + many) * width
    read = 0.0
    for k in range(begin, end, np.uint64(EIGHT)):
        read += load_number(address, k)
    # eight numbers at a time also read what follows the last record
    if many == TILE and end + np.uint64(EIGHT) <= nodes * width:
        for k in range(0, TILE, EIGHT):
            for c in range(0, width, EIGHT):
                transpose8x8(address, begin + k * width + c, width, scratch, row + c, k)
    else:
        for k in range(many):
            for c in range(width):
                scratch[row + c, k] = load_number(address, begin + k * width + c)
    return read


@inner
def _store(address, width, row, place, first, many, scratch):
    """Store the components of a field (places, width), 1, 3 or 9, from their rows."""
    x, y, z = row[0], row[1], row[2]
    if width == 1:
        for k in range(many):
            store_nontemporal(address, place[first + k], scratch[x, k])
    elif width == 3:
        for k in range(many):
            to = width * place[first + k]
            _store_three(address, to, scratch[x, k], scratch[y, k], scratch[z, k])
    else:
        yx, yy, yz = row[3], row[4], row[5]
        zx, zy, zz = row[6], row[7], row[8]
        for k in range(many):
            to_x = width * place[first + k]
            to_y = to_x + THREE
            to_z = to_y + THREE
            _store_three(address, to_x, scratch[x, k], scratch[y, k], scratch[z, k])
            _store_three(address, to_y, scratch[yx, k], scratch[yy, k], scratch[yz, k])
            _store_three(address, to_z, scratch[zx, k], scratch[zy, k], scratch[zz, k])


@inner
def _store_apart(address, width, components, row, place, first, many, scratch):
    """Store some of the `width` numbers that a field holds for a place, through the caches, as there are gaps."""
    for c in range(components):
        x = row[c]
        for k in range(many):
            store_number(address, width * place[first + k] + c, scratch[x, k])


@inner
def _store_three(address, to, x, y, z):
    store_nontemporal(address, to, x)
    store_nontemporal(address, to + np.uint64(1), y)
    store_nontemporal(address, to + np.uint64(2), z)
