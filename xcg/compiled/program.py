"""The algebra at the nodes, an instruction at a time over so few nodes that all intermediate results stay in cache."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inner, leaf
from xcg.compiled.gradient_fit import fit_rows
from xcg.compiled.simd import EIGHT, TILE, stream, transpose8x8

# The operations of an instruction (operation, result, a, b). Results and operands are rows of the scratch,
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
_LINE = 64  # bytes of a line of the cache
_OF_NUMBER = np.dtype("float64").itemsize
_FEWEST = 8  # arrays of a tuple; others have 4, 16, ... times as many


def as_tuple(arrays: Sequence[NDArray]) -> tuple[NDArray, ...]:
    """Return arrays as rows of numbers, filled up to one of few lengths, for each of which `run` is compiled."""
    rows = [array.reshape(-1) for array in arrays]
    length = _FEWEST
    while length < len(rows):
        length *= 4
    return (*rows, *[np.empty(0)] * (length - len(rows)))


def room_for(rows: int) -> NDArray:
    """Make zeros (rows, TILE) that begin with a cache line: a program takes a seventh longer across two lines."""
    spare = np.zeros(rows * TILE + _LINE // _OF_NUMBER)
    first = -spare.ctypes.data % _LINE // _OF_NUMBER
    return spare[first : first + rows * TILE].reshape(rows, TILE)


@leaf
def run(
    instructions,
    records,
    columns,
    source,
    fields,
    stores,
    target,
    index,
    order,
    fits,
    tile,
    scratch,
):
    """Run the instructions of a program for all nodes.

    Parameters
    ----------
    instructions : (n, 4)
        Operation, result and operands.
    records : tuple of (nodes * width,)
        Arrays of sums, node by node; more than there are `columns` of are not read.
    columns : (arrays, 2)
        Width of each, and the row of the scratch where its columns begin.
    source : (loads, 2)
        Row of the column of each load, and the row of a factor.
    fields : tuple of (nodes * width,)
        Written: the fields, node by node.
    stores : (stores, 4)
        Number of the field of each store, its first component, the numbers that the field holds for
        a node, and how many components are stored: 1, 3 or 9.
    target : (stores, 9)
        Rows of the components.
    index : (nodes,)
        Index of each node in the fields, in the order in which nodes are taken.
    order : (nodes,) or None
        Which record is that of each node; None where records are in that order, which leaves code
        out.
    fits : True or None
        None where no step is a fit, which leaves its code out.
    tile : (n,)
        Scratch for as many records as a tile has nodes, and eight more, of the largest width.
    scratch : (rows, TILE)
        Holds constants and factors.
    """
    unread = 0.0
    for first in range(0, index.size, TILE):
        many = min(TILE, index.size - first)
        for n in range(columns.shape[0]):
            numbers = records[n]
            width = columns[n, 0]
            row = columns[n, 1]
            if order is None:
                unread += _transpose_records(numbers, width, row, first, many, index.size, scratch)
            else:
                unread += _gather_records(numbers, width, order, first, many, tile)
                _transpose_records(tile, width, row, 0, many, TILE + EIGHT, scratch)
        for k in range(instructions.shape[0]):
            operation = instructions[k, 0]
            r = instructions[k, 1]
            a = instructions[k, 2]
            b = instructions[k, 3]
            if operation == STORE:
                field = fields[stores[r, 0]]
                _store(field, stores[r], target[r], index, first, many, scratch)
            elif operation == FIT:
                if fits is not None:
                    fit_rows(scratch, a, r, many, b)
            elif operation == LOAD:
                _combine(np.uint64(MULTIPLY), scratch, r, source[a, 0], source[a, 1])
            else:
                _combine(operation, scratch, r, a, b)
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
def _store(field, store, rows, index, first, many, scratch):
    """Write the components of a field, 1, 3 or 9 of the numbers that it holds for a node, from their rows."""
    begin = store[1]
    width = store[2]
    components = store[3]
    if components < width:  # of one phase of several, which leaves gaps
        for k in range(many):
            to = width * index[first + k] + begin
            for c in range(components):
                field[to + c] = scratch[rows[c], k]
        return
    x, y, z = rows[0], rows[1], rows[2]
    if components == 1:
        for k in range(many):
            stream(field, index[first + k], (scratch[x, k],))
    elif components == 3:
        for k in range(many):
            vector = (scratch[x, k], scratch[y, k], scratch[z, k])
            stream(field, components * index[first + k], vector)
    else:
        yx, yy, yz = rows[3], rows[4], rows[5]
        zx, zy, zz = rows[6], rows[7], rows[8]
        for k in range(many):
            tensor = (
                scratch[x, k], scratch[y, k], scratch[z, k],
                scratch[yx, k], scratch[yy, k], scratch[yz, k],
                scratch[zx, k], scratch[zy, k], scratch[zz, k],
            )  # fmt: skip
            stream(field, components * index[first + k], tensor)


@inner
def _gather_records(numbers, width, order, first, many, tile):
    """Copy some records (nodes, width) side by side; returns the sum of one number in each line of memory.

    Lines are first read without waiting for any of them.
    """
    read = 0.0
    for k in range(many):
        begin = order[first + k] * width
        for c in range(np.uint64(0), width, np.uint64(EIGHT)):
            read += numbers[begin + c]
        read += numbers[begin + width - np.uint64(1)]
    for k in range(many):
        begin = order[first + k] * width
        to = k * width
        for c in range(width):
            tile[to + c] = numbers[begin + c]
    return read


@inner
def _transpose_records(numbers, width, row, first, many, nodes, scratch):
    """Write the columns of some records (nodes, width) to rows; returns the sum of one number in each line of memory.

    Lines are first read one after the other, as the processor expects it: that takes half the time.
    """
    begin = first * width
    end = (first + many) * width
    read = 0.0
    for k in range(begin, end, np.uint64(EIGHT)):
        read += numbers[k]
    # eight numbers at a time also read what follows the last record
    if many == TILE and end + np.uint64(EIGHT) <= nodes * width:
        for k in range(0, TILE, EIGHT):
            for c in range(0, width, EIGHT):
                transpose8x8(numbers, begin + k * width + c, width, scratch, row + c, k)
    else:
        for k in range(many):
            for c in range(width):
                scratch[row + c, k] = numbers[begin + k * width + c]
    return read
