"""Tables of numbers: bodies of text, CSV and Parquet.

Text becomes columns block by block, in all threads where nothing else is read. CSV has commas,
semicolons, tabs or blanks between values. Of Parquet, pyarrow reads the columns and row groups that
are wanted.
"""

from __future__ import annotations

import codecs
import csv
import importlib
import math
import re
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from xcg.common import memory
from xcg.common.messages import SceneError
from xcg.compiled._jit import THREADS
from xcg.compiled.text import BEYOND, REST, read_rows
from xcg.readers.column_units import with_unit
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.text import PIECE, Scanner, body_of, scanned, source_of, whole_lines
from xcg.readers.names import PARTICLE_SLOTS, canonical

Columns: TypeAlias = dict[Any, NDArray]  # by name, and vectors by the names of their columns

_SHARED = 1 << 22  # bytes from which on a table is worth the threads
_LEFT = 1024  # words of a block that are read by Python at a time
_BELOW = (
    "this is a line of text below the rows: delete it, or leave it out by xcg.scene_from_table("
    "pandas.read_csv(file, skipfooter=1, engine='python'))"
)
_SEPARATORS = "\t;,"
_MOST_COLUMNS = 1000
_LONGEST_ROW = 1 << 14  # bytes
_QUOTED = re.compile(rb'"[^"]*"|\S+')  # words between blanks; quotes hold several together
_BLANKS_OF_CELLS = re.compile(rb"(?<=[^\s,;]) +(?=[^\s,;])")
_BLANKS_OF_DATES = re.compile(rb"(?<=\d{4}[-/]\d\d[-/]\d\d) +(?=\d\d:\d\d)")
_DATE = re.compile(rb"[\"']?\d{4}[-/]\d\d[-/]\d\d(?!\d)")
_OF_FORTRAN = bytes.maketrans(b"dD", b"eE")
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


def read_table(
    ref: StepRef,
    wanted: Iterable[str],
    rows: int | None,
    options: ReadOptions,
    body: Iterable[bytes] | None = None,
    separator: str = " ",
) -> Columns:
    """Read the wanted columns of one step's body, which is that of the file by default; see `parse_table`."""
    threads = 1
    if options.alone and ref.length > _SHARED:
        threads = THREADS
    return parse_table(
        body or body_of(ref),
        ref.columns,
        sorted(set(wanted)),
        rows,
        source_of(ref),
        threads,
        options.vectors,
        separator,
        ref.length,
    )


def parse_table(
    body: bytes | Iterable[bytes],
    columns: Sequence[str],
    wanted: Sequence[str],
    rows: int | None,
    name: str,
    threads: int = 1,
    vectors: Iterable[tuple[str, ...]] = (),
    separator: str = " ",
    length: int = 0,
) -> Columns:
    """Parse the wanted columns of a table of numbers.

    Parameters
    ----------
    body : bytes or iterable of bytes
        Rows of numbers, whole or in pieces.
    columns : sequence of str
        Names of all columns.
    wanted : sequence of str
        Names of those to parse. What nobody wants may be text, as LAMMPS' ``element``.
    rows : int or None
        Number of rows that must be there; None takes what there is.
    name : str
        File and step, for messages.
    threads : int
        Threads that share the blocks of the body.
    vectors : iterable of tuple of str
        Wanted columns that are the components of a vector.
    separator : str
        What stands between numbers besides white space.
    length : int
        Bytes of a body that comes in pieces, 0 where it is not known: sets memory aside.

    Returns
    -------
    dict of arrays of float64
        The columns (rows,) by name, and the vectors (rows, n) by their tuples, of which their
        columns are views. Each number is the nearest to its digits, as of Python's `float`.

    Raises
    ------
    SceneError
        If rows are missing, too many, or too short or long, or a wanted value is not a number; the
        message names the first such row, counted from 0.
    """
    wanted_columns = np.array([columns.index(column) for column in wanted], np.int64)
    if isinstance(body, bytes):
        text = body
        length = len(text)
        body = (text[at : at + PIECE] for at in range(0, len(text), PIECE))
    table = _ColumnBuffer(wanted, vectors, rows or 0)
    filled = 0
    parsed = 0  # bytes
    parse = partial(_parse, len(columns), wanted_columns, separator.encode())
    results = _in_order(whole_lines(body, name), parse, threads)
    for block, (numbers, whole) in results:
        end = filled + numbers.shape[1]
        if rows is not None and end + (not whole) > rows:
            surplus = _lines(block, separator)[rows - filled]
            raise SceneError(
                f"{name}: more rows than the {rows} that the header says; row {rows} is {_shown(surplus)}"
            )
        if not whole:
            line, *more = _lines(block, separator)[numbers.shape[1] :]
            last = not more and not any(following.strip() for following, _ in results)
            raise SceneError(
                f"{name}: row {end} {_fault(line, columns, wanted, last=last, separator=separator, source=name)}"
            )
        parsed += len(block) - BEYOND
        table.write(filled, numbers, parsed / (length or np.inf))
        filled = end
    if rows is not None and filled < rows:
        raise SceneError(
            f"{name}: {filled} rows, but the header says {rows}: row {filled} is missing, as when writing was stopped; "
            "write the file anew, or leave the step out"
        )
    return table.columns(filled)


# Rows set aside over those that the bytes of the first block lead to expect, as later rows may be
# shorter. Memory that is not written is not taken.
_MARGIN = 1.05


class _ColumnBuffer:
    """Columns and vectors that are filled block by block."""

    def __init__(
        self, wanted: Sequence[str], vectors: Iterable[tuple[str, ...]], capacity: int
    ) -> None:
        self._order = {column: n for n, column in enumerate(wanted)}
        self._vectors = {vector: memory.empty((capacity, len(vector))) for vector in vectors}
        alone = self._order.keys() - set(chain(*self._vectors))
        self._columns = {column: memory.empty(capacity) for column in alone}
        self._capacity = capacity

    def write(self, first: int, numbers: NDArray, share: float) -> None:
        """Write a block (wanted, n) behind the rows before it.

        Parameters
        ----------
        first : int
            Row that it begins with.
        share : float
            Part of the body that ends with it, 0 where this is not known.
        """
        end = first + numbers.shape[1]
        if end > self._capacity:
            # it doubles at least where rows are not as long as expected, as copying it for each
            # block would take most of the time
            capacity = end + self._capacity
            if 0 < share <= 1:
                capacity = max(capacity, int(_MARGIN * end / share))
            self._resize(first, capacity)
        for column, array in self._columns.items():
            array[first:end] = numbers[self._order[column]]
        for vector, array in self._vectors.items():
            for k, column in enumerate(vector):
                array[first:end, k] = numbers[self._order[column]]

    def columns(self, filled: int) -> Columns:
        """Return the columns by name and the vectors by their tuples, without rows that were not filled."""
        self._replace(partial(memory.first_rows, count=filled))
        components = {
            column: array[:, k]
            for vector, array in self._vectors.items()
            for k, column in enumerate(vector)
        }
        return {**self._columns, **components, **self._vectors}

    def _resize(self, filled: int, capacity: int) -> None:
        """Copy the filled rows to arrays of another length."""

        def resized(array: NDArray) -> NDArray:
            longer = memory.empty((capacity, *array.shape[1:]))
            longer[:filled] = array[:filled]
            return longer

        self._replace(resized)
        self._capacity = capacity

    def _replace(self, change: Callable[[NDArray], NDArray]) -> None:
        """Change the arrays one after the other, so that memory holds one more at most."""
        kinds: tuple[dict[Any, NDArray], ...] = (self._columns, self._vectors)
        for arrays in kinds:
            for name, array in arrays.items():
                arrays[name] = change(array)


def _in_order(
    blocks: Iterable[bytes], work: Callable, threads: int
) -> Iterator[tuple[bytes, tuple[NDArray, bool]]]:
    """Each block and what is made of it; threads work ahead while blocks are read, by a few of them."""
    if threads == 1:
        for block in blocks:
            yield block, work(block)
        return
    with ThreadPoolExecutor(threads) as pool:
        ahead: deque = deque()
        for block in blocks:
            ahead.append((block, pool.submit(work, block)))
            if len(ahead) > 4 * threads:
                first, result = ahead.popleft()
                yield first, result.result()
        for last, result in ahead:
            yield last, result.result()


def _parse(columns: int, wanted: NDArray, separator: bytes, block: bytes) -> tuple[NDArray, bool]:
    """Parse the rows of a block, (wanted, rows), and return whether all rows were read or one is faulty."""
    text = np.frombuffer(block, np.uint8)
    size = len(block) - BEYOND
    out = np.empty((len(wanted), size // (2 * columns) + 1))  # a digit and a space for each value
    edges = np.empty(text.size + 2 * columns + 2, np.int32)
    lines = np.empty(text.size, np.int32)
    left = np.empty((len(wanted) + _LEFT, len(REST)), np.int64)
    row = done = 0
    while done < size:
        # where nothing is compiled, NumPy warns of bits that products lose
        with np.errstate(over="ignore"):
            read, passed, count = read_rows(
                text[done:],
                size - done + 1,
                separator[0],
                columns,
                wanted,
                out,
                row,
                edges,
                lines,
                left,
            )
        for at, n, start, stop in left[:count].tolist():
            value = _number(block[done + start : done + stop])
            if math.isnan(value):
                return out[:, :at], False
            out[n, at] = value
        if passed == 0:
            return out[:, :row], False
        row += read
        done += passed
    return out[:, :row], True


def _number(word: bytes) -> float:
    """Read words that compiled code leaves undecided; NaN for anything but numbers.

    Fortran writes a D in place of the E.
    """
    try:
        return float(word.translate(_OF_FORTRAN)) if b"_" not in word else math.nan
    except ValueError:
        return math.nan


def _lines(block: bytes, separator: str) -> list[bytes]:
    """Return the lines of a block that hold values, with blanks between these."""
    blanks = block.replace(separator.encode(), b" ")
    return [line for line in blanks.split(b"\n") if line.strip()]


def _shown(line: bytes) -> str:
    return repr(line.decode("utf-8", "replace").strip()[:60])


def _fault(
    line: bytes,
    columns: Sequence[str],
    wanted: Sequence[str],
    *,
    last: bool,
    separator: str,
    source: str,
) -> str:
    """Describe the error of a row of a file, or a step in it (`source`)."""
    words = line.split()
    if words == " ".join(columns).encode().split():
        return "repeats the names of the columns, as after a restart: delete this line"
    if line.startswith(b"#") and len(words) != len(columns):
        return (
            f"is a comment ({_shown(line)}); comments stand above the rows only: delete this line"
        )
    if len(words) != len(columns):
        hint = f"the columns are {' '.join(columns)}"
        if last and line.count(b" ") < len(columns) - 1:  # else cells are empty
            hint = "the file is cut off here"
            if words[0][:1].isalpha():
                hint = _BELOW
        if len(words) == len(columns) + 1:
            hint += "; if the first value is an index without a name, write the table without it"
        return f"has {len(words)} values, expected {len(columns)} ({_shown(line)}); {hint}"
    wrong = next(column for column in wanted if math.isnan(_number(words[columns.index(column)])))
    word = words[columns.index(wrong)].decode("utf-8", "replace")
    fault = f"has {word!r} in column '{wrong}', expected a number"
    plain = word.strip("\"'")
    has_comma = _DECIMAL_COMMA.fullmatch(plain)
    if has_comma or (plain != word and is_number(plain.encode())):
        path = source.partition(" (step ")[0]
        sign = r"\s+" if separator == " " else separator
        what = "decimal commas" if has_comma else "numbers in quotes"
        decimal = ", decimal=','" if has_comma else ""
        fault += (
            f"; {what} are read by pandas: xcg.scene_from_table(pandas.read_csv({path!r}, "
            f"sep={sign!r}{decimal}))"
        )
    elif last and words[0][:1].isalpha() and columns[0] in wanted:
        fault += f"; {_BELOW}"
    elif word[:1].isalpha() and word.casefold() != "nan":
        fault += f"; {way_of_words(wrong)}"
    return fault


def way_of_words(column: str) -> str:
    """Return what to do with a column of words, as the end of a message."""
    way = f"a column of words is dropped by names={{{column!r}: None}}"
    if canonical(column) not in PARTICLE_SLOTS["species"]:
        return way
    return (
        f"{way}, or numbered in a table of pandas, table[{column!r}] = pandas.factorize(table[{column!r}], "
        "sort=True)[0], for xcg.scene_from_table(table)"
    )


# --- CSV: tables that name their columns in the first line -----------------------------------------------


@dataclass(frozen=True, eq=False)
class TableIndex:
    """Result of one pass through a file.

    Attributes
    ----------
    columns : tuple of str
        Names of the columns.
    rows : int
        Number of rows.
    clock : mapping
        Columns of times and numbers of steps; texts or objects where these are no numbers.
    starts : array (rows + 1,), optional
        Byte where each row begins, and where the last one ends; unknown of Parquet.
    kind : str
        What stands between values.
    time : float, optional
        Time in the text above the table (s).
    comments : tuple of bytes
        Comments above the first row.
    """

    columns: tuple[str, ...]
    rows: int
    clock: Mapping[str, NDArray]
    starts: NDArray | None = None
    kind: str = ""
    time: float | None = None
    comments: tuple[bytes, ...] = ()

    def extent(self, first: int, stop: int) -> tuple[int, int]:
        """Byte where some rows begin, and how many bytes there are; the first row where bytes are unknown."""
        if self.starts is None:
            return first, 0
        return int(self.starts[first]), int(self.starts[stop] - self.starts[first])


def scan_csv(
    path: str,
    clock_of: Callable[[Sequence[str]], Mapping[str, str]],
    in_order: Sequence[str] = (),
) -> TableIndex:
    """Read the names, count the rows, and read the columns of times.

    Parameters
    ----------
    in_order : sequence of str
        Names of all columns, for a file whose rows begin without a line of names.

    Raises
    ------
    SceneError
        If the first line names no columns, or one of them twice.
    """
    with scanned(path) as scanner:
        if in_order:
            comments = _comments(scanner)
            first = scanner.sample(PIECE).partition(b"\n")[0] + b"\n"
            separator = _separator_of(first.decode("utf-8-sig", "replace"))
            first = b"".join(_joined_words([first], separator, len(in_order)))
        else:
            first, comments = _header_line(scanner, path)
        line = first.decode("utf-8-sig", "replace").lstrip("#").strip()
        separator, names = split_header(line)
        twice = [name for name, count in Counter(names).items() if count > 1]
        named = any(math.isnan(_number(name.encode())) for name in names)
        if in_order:
            names = _names_in_order(path, in_order, names)
        elif not line or twice or not named or len(names) > _MOST_COLUMNS:
            why = repr(line[:60])
            if named and twice:
                why = f"{twice[0]!r} twice"
            way_out = ""
            if line and not named:
                way_out = (
                    f"; name the {len(names)} columns in their order, such as names=['id', 'x', 'y', 'z', 'radius'], "
                    "None for a column to skip"
                )
            raise SceneError(
                f"{path}: expected a first line that names each column once, such as 'x,y,z,radius', found "
                f"{why}{way_out}"
            )
        found = [np.array([scanner.offset])]
        tail: list[bytes] = []
        pieces = _joined_words(_pieces(scanner, found, tail), separator, len(names))
        wanted = sorted(set(clock_of(names).values()))
        clock = _clock_columns(pieces, names, wanted, separator, path)
        deque(pieces, 0)  # what is left
    edges = np.concatenate(found)
    end = scanner.offset
    blank = _blank_rows(tail[-1], separator) if tail else b""
    if blank:
        end -= len(blank)
        edges = edges[edges <= end]
    end_of_line = 2 if first.endswith(b"\r\n") else 1
    rows = np.diff(edges) > end_of_line  # others are blank
    starts = np.append(edges[:-1][rows], end)
    if wanted and len(clock[wanted[0]]) != len(starts) - 1:
        raise SceneError(f"{path}: lines of blanks only stand between rows; remove them")
    return TableIndex(names, len(starts) - 1, clock, starts, separator, comments=tuple(comments))


def _blank_rows(tail: bytes, separator: str) -> bytes:
    """Return the lines of separators at the end of a text, as spreadsheets write them; b"" without such lines."""
    kept = tail.rstrip(b" \r\n" + separator.encode())
    _, _, rest = tail[len(kept) :].partition(b"\n")
    if not kept or separator.encode() not in rest.replace(b" ", b""):
        return b""
    return rest


def clock_columns(
    body: bytes, names: Sequence[str], clock: Mapping[str, str], separator: str, path: str
) -> Columns:
    """Return the columns of times and numbers of steps of a text; see `TableIndex`."""
    pieces = _joined_words([body], separator, len(names))
    return _clock_columns(pieces, names, sorted(set(clock.values())), separator, path)


def _clock_columns(
    pieces: Iterator[bytes], names: Sequence[str], wanted: Sequence[str], separator: str, path: str
) -> Columns:
    if not wanted:
        return {}
    clock: Columns = {}
    row = next(pieces, b"")
    pieces = chain([row], pieces)
    values = dict(zip(names, _words(row.lstrip(), separator), strict=False))
    numeric = [name for name in wanted if not _is_date(values.get(name, b""))]
    if len(numeric) < len(wanted):
        body = b"".join(pieces)
        pieces = iter([body])
        texts = [name for name in wanted if name not in numeric]
        clock |= _texts(body, names, texts, separator, path)
    if numeric:
        clock |= parse_table(pieces, names, numeric, None, path, separator=separator)
    return clock


def _header_line(scanner: Scanner, path: str) -> tuple[bytes, list[bytes]]:
    """Return the line that names the columns, and the comments above and below it, and pass over them.

    It is the first line without "#", or, where that holds numbers, the last comment of as many
    words.

    Raises
    ------
    SceneError
        If lines have no ends but carriage returns.
    """
    comments = _comments(scanner)
    below = scanner.sample(_LONGEST_ROW)
    if b"\r" in below.partition(b"\n")[0].rstrip(b"\r"):
        raise SceneError(
            f"{path}: lines end in carriage returns alone, as of old Macs; convert the file, such as by "
            "tr '\\r' '\\n' < old > new"
        )
    first = cells_of(_BLANKS_OF_DATES.sub(b"_", below.partition(b"\n")[0]))
    if below.strip() and not all(map(_is_value, first)):
        header = scanner.line()
        return header, comments + _comments(scanner)
    names = [line for line in comments if len(cells_of(line)) == len(first)]
    return (names or comments or [scanner.line()])[-1], comments


def _comments(scanner: Scanner) -> list[bytes]:
    """Read lines that begin with "#", and return them."""
    lines = []
    while scanner.sample(_LONGEST_ROW).removeprefix(codecs.BOM_UTF8).startswith(b"#"):
        lines.append(scanner.line())
    return lines


def cells_of(line: bytes) -> list[bytes]:
    """Return what is between separators of a line."""
    line = line.removeprefix(codecs.BOM_UTF8).lstrip(b"#%/").strip()
    separators = [mark.encode() for mark in _SEPARATORS if mark.encode() in line]
    cells = line.split(separators[0]) if separators else _QUOTED.findall(line)
    while len(cells) > 1 and not cells[-1].strip():  # lines end in separators
        cells.pop()
    return [cell.strip() for cell in cells]


def _names_in_order(path: str, in_order: Sequence[str], words: Sequence[str]) -> tuple[str, ...]:
    """Return the caller's names of all columns; raise SceneError if the first row does not fit them."""
    texts = [word for word in words if math.isnan(_number(word.encode())) and word.lower() != "nan"]
    if words and len(texts) == len(words) == len(in_order):
        raise SceneError(
            f"{path}: names= is a list for files without names of columns, and the first line names them "
            f"({' '.join(words[:10])}); leave the list out, or map names that xcg does not know, such as "
            f"names={{{words[0]!r}: 'particle_id'}}"
        )
    if len(words) != len(in_order):
        raise SceneError(
            f"{path}: names= lists {len(in_order)} columns ({', '.join(in_order[:10])}), and the first row has "
            f"{len(words)} values ({' '.join(words)[:60]}); name each column in its order, None for a column to skip. "
            "Lines above the rows begin with '#'"
        )
    return tuple(in_order)


def first_row(path: str) -> tuple[tuple[str, ...], list[str]]:
    """Return the names of the columns of a text, and the words of its first row."""
    with scanned(path) as scanner:
        header, _ = _header_line(scanner, path)
        line = header.decode("utf-8-sig", "replace").lstrip("#").strip()
        separator, names = split_header(line)
        row = b"".join(_joined_words([scanner.line()], separator, len(names)))
        words = row.decode("utf-8", "replace").strip()
        return names, words.split(None if separator == " " else separator)


def split_header(line: str) -> tuple[str, tuple[str, ...]]:
    """Return what stands between the names of columns in a line, and the names."""
    separator = _separator_of(line)
    if separator == " ":
        words = [word.decode() for word in _QUOTED.findall(line.encode())]
    else:
        words = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    while len(words) > 1 and not words[-1].strip():  # rows end in separators, too
        del words[-1]
    return separator, tuple(word.strip().strip("\"'") for word in words)


def _separator_of(line: str) -> str:
    """Return what stands between the values of a line."""
    return next((mark for mark in _SEPARATORS if mark in line), " ")


def _words(text: bytes, separator: str) -> list[bytes]:
    """Return the values of the first line of a text, where blanks are separators, too."""
    return text.partition(b"\n")[0].replace(separator.encode(), b" ").split()


def _is_date(word: bytes) -> bool:
    """Return whether a word may be a date or a duration: it holds digits but is not a number."""
    is_number = not math.isnan(_number(word)) or _DECIMAL_COMMA.fullmatch(word.decode("latin-1"))
    return not is_number and any(byte in b"0123456789" for byte in word)


def is_number(cell: bytes) -> bool:
    """Return whether a cell is a number, also with a decimal comma, NaN or infinite."""
    plain = cell.strip(b"\"' ").replace(b",", b".")
    return not math.isnan(_number(plain)) or plain.lower() == b"nan"


def _is_value(cell: bytes) -> bool:
    """Return whether a cell is a finite number or a date."""
    return math.isfinite(_number(cell)) or _DATE.match(cell) is not None


def _joined_words(pieces: Iterable[bytes], separator: str, columns: int) -> Iterator[bytes]:
    """Yield the pieces of a table with underscores in place of blanks within cells, such as dates.

    Only where the first row has more words than columns. Of tables with blanks between columns, the
    blanks between dates and the time of the day count.
    """
    blanks = _BLANKS_OF_CELLS
    if separator.isspace():
        blanks = _BLANKS_OF_DATES
    begun: bytes | None = None
    pieces = iter(pieces)  # what is left is passed on
    for piece in pieces:
        if begun is None:
            if len(_words(piece.lstrip(), separator)) <= columns:
                yield piece
                yield from pieces
                return
            begun = b""
        end = piece.rfind(b"\n") + 1
        yield blanks.sub(lambda match: b"_" * len(match[0]), begun + piece[:end])
        begun = piece[end:]
    if begun:
        yield blanks.sub(lambda match: b"_" * len(match[0]), begun)


def _texts(
    body: bytes, columns: Sequence[str], wanted: Sequence[str], separator: str, path: str
) -> Columns:
    """Return columns of dates or durations as texts."""
    indices = [columns.index(name) for name in wanted]
    rows = []
    for row, line in enumerate(_lines(body, separator)):
        words = line.split()
        if len(words) != len(columns):
            fault = _fault(line, columns, (), last=False, separator=separator, source=path)
            raise SceneError(f"{path}: row {row} {fault}")
        rows.append([words[k].decode("utf-8", "replace").strip("\"'") for k in indices])
    values = np.array(rows, object).reshape(len(rows), len(wanted))
    return dict(zip(wanted, values.T, strict=True))


def _pieces(scanner: Scanner, starts: list[NDArray], tail: list[bytes]) -> Iterator[bytes]:
    """Yield the rest of a text, add the byte after each end of a line to `starts`, and its last piece to `tail`."""
    piece = b"\n"
    while block := scanner.block(PIECE):
        piece = block
        tail[:] = [piece]
        ends = np.flatnonzero(np.frombuffer(piece, np.uint8) == ord("\n"))
        starts.append(scanner.offset - len(piece) + 1 + ends)
        yield piece
    if not piece.endswith(b"\n"):  # as if it did
        starts.append(np.array([scanner.offset + 1]))


def _counted(pieces: Iterable[bytes], sign: str, found: list[int]) -> Iterator[bytes]:
    """Yield the pieces of a text, and count a sign in each of them."""
    for piece in pieces:
        found.append(int(np.count_nonzero(np.frombuffer(piece, np.uint8) == ord(sign))))
        yield piece


def read_csv(ref: StepRef, wanted: Sequence[str], options: ReadOptions) -> Columns:
    """Read columns of one step."""
    body = _joined_words(body_of(ref), ref.kind, len(ref.columns))
    if ref.kind.isspace():
        return read_table(ref, wanted, ref.rows, options, body)
    separators = list[int]()
    body = _counted(body, ref.kind, separators)
    table = read_table(ref, wanted, ref.rows, options, body, ref.kind)
    # as many values as columns, but more separators: cells are empty, and values may stand in other
    # columns
    more = sum(separators) - ref.rows * (len(ref.columns) - 1)
    if more not in (0, ref.rows):
        raise SceneError(
            f"{source_of(ref)}: {more} more {ref.kind!r} than {len(ref.columns)} columns have between them: some "
            "cells are empty or hold texts with this sign; every cell must hold a number"
        )
    return table


# --- Parquet ---------------------------------------------------------------------------------------------


@contextmanager
def _opened(path: str) -> Iterator[Any]:
    """Open a file; what pyarrow finds wrong with it is said with its name."""
    try:
        pyarrow = importlib.import_module("pyarrow")
        parquet = importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise SceneError(
            f"{path}: reading Parquet needs the package pyarrow: pip install 'xcg[parquet]', or write CSV"
        ) from None
    try:
        with parquet.ParquetFile(path) as file:
            yield file
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise SceneError(
            f"{path}: cannot be read as Parquet ({str(error)[:200]}); leave the file out, or write it again"
        ) from None


def _columns_of_parquet(file: Any) -> dict[str, tuple[str, int | None]]:
    """Return the file's name of each column, and the place in its lists, by its name and unit, ``x [mm]``."""
    columns: dict[str, tuple[str, int | None]] = {}
    for field in file.schema_arrow:
        for part in field.flatten():  # of position {x, y, z}: position.x, ...
            name = part.name
            if name != field.name:
                name = name.replace(".", "_")
            metadata = part.metadata or {}
            unit = metadata.get(b"units", metadata.get(b"unit", b"")).decode(errors="replace")
            if str(part.type).partition("<")[0].endswith("list"):  # of position [x, y, z]
                for k, axis in enumerate("xyz"):
                    columns[with_unit(f"{name}_{axis}", unit)] = (part.name, k)
            else:
                columns[with_unit(name, unit)] = (part.name, None)
    return columns


def _read_parquet(file: Any, wanted: Sequence[str], groups: Sequence[int] | None = None) -> Any:
    """Read columns by the names that `_columns_of_parquet` gives them, as a table of pyarrow."""
    arrow = importlib.import_module("pyarrow")
    compute = importlib.import_module("pyarrow.compute")
    in_file = [_columns_of_parquet(file)[name] for name in wanted]
    names = list({column: None for column, _ in in_file})
    if groups is None:
        groups = range(file.num_row_groups)
    table = file.read_row_groups(list(groups), columns=names).flatten()
    columns = []
    for column, k in in_file:
        values = table.column(column)
        if k is not None:
            values = compute.list_element(values, k)
        columns.append(values)
    return arrow.table(columns, names=list(wanted))


def scan_parquet(path: str, clock_of: Callable[[Sequence[str]], Mapping[str, str]]) -> TableIndex:
    """Read names of columns, number of rows, and the columns of times."""
    with _opened(path) as file:
        names = tuple(_columns_of_parquet(file))
        wanted = sorted(set(clock_of(names).values()))
        rows = file.metadata.num_rows
        table = _read_parquet(file, wanted)
        if wanted and table.num_rows != rows:
            raise SceneError(
                f"{path}: {table.num_rows} rows, but its metadata promise {rows}; the file is damaged"
            )
        return TableIndex(names, rows, {name: _clock(table, name, path) for name in wanted})


def read_parquet(ref: StepRef, wanted: Sequence[str], options: ReadOptions) -> dict[str, NDArray]:
    """Read columns of one step, from the row groups that it touches."""
    first = ref.offset
    stop = ref.offset + ref.rows
    with _opened(ref.path) as file:
        edges = np.cumsum(
            [0, *(file.metadata.row_group(k).num_rows for k in range(file.num_row_groups))]
        )
        groups = np.flatnonzero((edges[:-1] < stop) & (edges[1:] > first)).tolist()
        at = first - int(edges[groups[0]]) if groups else 0
        table = _read_parquet(file, wanted, groups).slice(at, ref.rows)
        if table.num_rows != ref.rows:
            raise SceneError(
                f"{source_of(ref)}: {table.num_rows} rows, but its metadata promise {ref.rows}; the file is damaged"
            )
        return {name: _numbers(table, name, source_of(ref)) for name in wanted}


def _clock(table: Any, name: str, source: str) -> Any:
    """Return a column of times or steps; dates, durations and texts as pandas has them."""
    column = table.column(name).to_pandas()
    if column.dtype.kind in "iufb":
        return _numbers(table, name, source)
    return column


def _numbers(table: Any, name: str, source: str) -> NDArray:
    column = table.column(name)
    if column.null_count:
        row = int(np.argmax(column.is_null().to_numpy(zero_copy_only=False)))
        raise SceneError(f"{source}: row {row} has no value in column '{name}', expected a number")
    try:
        return np.asarray(column.to_numpy(), "float64")
    except (TypeError, ValueError):
        raise SceneError(
            f"{source}: column '{name}' holds {column.type}, expected numbers; {way_of_words(name)}"
        ) from None
