"""Tables of numbers in text: where words and lines begin and end, and the numbers of the wanted columns.

Words are found 64 bytes at a time, and those of other columns are not looked at.
"""

import numpy as np

from xcg.compiled._jit import inner, leaf
from xcg.compiled.bits import BLOCK, newlines, trailing_zeros, white
from xcg.compiled.decimal import number

BEYOND = 2 * BLOCK  # bytes of white space that must follow a text
REST = ("row", "place among the wanted", "first byte", "byte after it")  # of words left to the caller

_ONE, _LAST = np.uint64(1), np.uint64(BLOCK - 1)


@inner
def find_words(text, size, edges, lines):
    """Find the words and lines of a text that ends with white space: where words begin and end, in turn, and lines end.

    Returns
    -------
    words, lines : int
        How many there are; what follows them in `edges` and `lines` is beyond the text.
    """
    edge, line = 0, 0
    before = _ONE  # whether the byte before is white space
    for first in range(0, size, BLOCK):
        blank = white(text, first)
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
def read_rows(text, size, columns, wanted, out, row, edges, lines, rest):
    """Read rows of numbers until one is not as it should be.

    Parameters
    ----------
    text : array of uint8
        Lines, the last with its end, and `BEYOND` more bytes of white space.
    size : int
        Bytes of the lines.
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
        Rows that were read, bytes that are done with, and words in `rest`. Reading stops before a line with more or
        fewer words, one beyond the rows of `out`, and one for which `rest` may have no room.
    """
    words, count = find_words(text, size, edges, lines)
    for edge in range(2 * words, 2 * (words + columns) + 1):
        edges[edge] = text.size
    first, word, done, left = row, 0, 0, 0
    for line in range(count):
        end = lines[line]
        if edges[2 * word] < end:
            if edges[2 * (word + columns - 1)] > end or edges[2 * (word + columns)] < end:
                break
            if row == out.shape[1] or left + wanted.size > rest.shape[0]:
                break
            for w in range(wanted.size):
                edge = 2 * (word + wanted[w])
                start, stop = np.int64(edges[edge]), np.int64(edges[edge + 1])
                value, known = number(text, start, stop)
                out[w, row] = value
                if not known:
                    rest[left, 0], rest[left, 1], rest[left, 2], rest[left, 3] = row, w, start, stop
                    left += 1
            word += columns
            row += 1
        done = end + 1
    return row - first, min(done, size), left
