"""Tables of numbers in text files, plain or gzipped: finding them and parsing them."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import BinaryIO

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from xcg.readers.engine import StepRef
from xcg.readers.gzipped import errors, forward, open_gzipped, size_of_content
from xcg.scene.schema import SceneError

_FIRST_BLOCK, _BLOCK = 1 << 16, 1 << 22  # small first, as the header is often all that is wanted
_LONGEST_LINE = 1 << 20  # bytes; a file of one endless line (or a few compressed kilobytes of one) is no text
_DEFLATE = 1032  # deflate packs at most this many bytes into one
_SAMPLE = 1 << 14
_TEXT = 50  # tables of numbers shrink to a fifth, and never to as little as this
_SLACK = 1 << 26  # bytes that any gzipped text may have
_MOST_BLANK = 10_000  # lines without a word between two that have some
_SMALL = 1 << 20  # bytes that are no matter; rows that are missing from small files are named when they are read
_LONGEST_VALUE = 64  # bytes of one number and the space before it


@contextmanager
def open_binary(path: str) -> Iterator[BinaryIO]:
    """Open a file for reading bytes, decompressed when it is gzipped (by its content, not its name).

    Raises
    ------
    SceneError
        While it is open, if the compressed data are damaged or end early.
    """
    with _damage_named(path), open_gzipped(path) if is_gzipped(path) else open(path, "rb") as stream:
        yield stream


@contextmanager
def _damage_named(path: str) -> Iterator[None]:
    """Name the file whose compressed data are damaged."""
    try:
        yield
    except errors() as error:
        msg = f"{path}: its compressed data are damaged or cut off ({error}); leave the file out, or write it again"
        raise SceneError(msg) from None


def is_gzipped(path: str) -> bool:
    """Tell gzipped files by their first bytes."""
    with open(path, "rb") as file:
        return file.read(2) == b"\x1f\x8b"


def uncompressed_size(path: str) -> int:
    """Size of what `open_binary` yields; -1 where a gzipped file does not tell it."""
    return size_of_content(path) if is_gzipped(path) else os.path.getsize(path)


def most_bytes(path: str) -> int:
    """Count the bytes that `open_binary` can yield at most, whatever a header says."""
    return os.path.getsize(path) * (_DEFLATE if is_gzipped(path) else 1)


def most_text(path: str) -> float:
    """Count the bytes of text that a file can hold if it is a table of numbers; more are only good to fill memory."""
    return os.path.getsize(path) * _TEXT + _SLACK if is_gzipped(path) else math.inf


def check_rows(ref: StepRef, room: int) -> None:
    """Refuse a header that promises more rows than its bytes can hold, before anything is made for them.

    Parameters
    ----------
    room : int
        Bytes that the rows have, at most.

    Raises
    ------
    SceneError
        If there are far fewer bytes than a digit and a space for each value.
    """
    if 2 * ref.rows * len(ref.columns) > room + _SMALL:
        msg = (
            f"{source_of(ref)}: its header promises {ref.rows} rows of {len(ref.columns)} values, but only {room} "
            "bytes follow; the file was cut short or is damaged. Leave it out, or write it again"
        )
        raise SceneError(msg)


def is_one_table(path: str, first: int, rows: int, marker: bytes) -> bool:
    """Tell whether a plain file holds nothing but a table of some rows from byte `first` on, from a few samples.

    Another table after it, which a marker begins, makes the file longer, or is seen among the last bytes.
    """
    size = os.path.getsize(path) - first
    lines, length = 0, 0
    with open(path, "rb") as file:
        for place in (first, first + size // 2, first + max(0, size - _SAMPLE)):
            file.seek(place)
            block = file.read(_SAMPLE)
            begin, end = (0 if place == first else block.find(b"\n") + 1), block.rfind(b"\n") + 1
            lines, length = lines + block.count(b"\n", begin, end), length + end - begin
        file.seek(first + max(0, size - max(_FIRST_BLOCK, size // 32)))
        return lines > 0 and size < 1.03 * rows * length / lines + _SAMPLE and marker not in file.read()


def first_lines(path: str, size: int = 1 << 16) -> list[str]:
    """Return the first lines of a file, to recognise it by; empty where it is not text."""
    with open_binary(path) as stream:
        head = stream.read(size)
    return [] if b"\0" in head else head.decode("utf-8", "replace").splitlines()


class Scanner:
    """Lines and blocks of a stream, read once from front to back.

    `offset` counts the (decompressed) bytes handed out so far; `name` is that of the file, for messages; beyond `most`
    bytes the stream is refused, see `most_text`.
    """

    def __init__(self, stream: BinaryIO, name: str = "the file", most: float = math.inf) -> None:
        self._stream = stream
        self._name = name
        self._most = most
        self._blank = 0
        self._data = b""
        self._at = 0
        self._block = _FIRST_BLOCK
        self.offset = 0

    def _more(self) -> bool:
        block = self._stream.read(self._block)
        self._data, self._at = self._data[self._at :] + block, 0
        self._block = _BLOCK
        return bool(block)

    def _take(self, end: int) -> bytes:
        taken = self._data[self._at : end]
        self._at = end
        self.offset += len(taken)
        if self.offset > self._most:
            msg = f"{self._name}: its compressed bytes stand for more than {self._most:.3g}; it is no table of numbers"
            raise SceneError(msg)
        return taken

    def line(self) -> bytes:
        """Return the next line with its end, or nothing at the end of the stream."""
        while (end := self._data.find(b"\n", self._at)) < 0:
            if len(self._data) - self._at > _LONGEST_LINE:
                msg = f"{self._name}: no end of a line in {_LONGEST_LINE} bytes after byte {self.offset}; it is no text"
                raise SceneError(msg)
            if not self._more():
                return self._take(len(self._data))
        self._blank = 0 if self._data[self._at : end].strip() else self._blank + 1
        if self._blank > _MOST_BLANK:
            msg = (
                f"{self._name}: more than {_MOST_BLANK} lines before byte {self.offset} are blank; the file is damaged"
            )
            raise SceneError(msg)
        return self._take(end + 1)

    def until(self, marker: bytes) -> Iterator[bytes]:
        """Yield, in pieces, all from the start of a line to the next line that begins with `marker`."""
        while len(self._data) - self._at < len(marker) and self._more():
            pass
        if self._data.startswith(marker, self._at):
            return
        needle = b"\n" + marker
        while (found := self._data.find(needle, self._at)) < 0:
            yield self._take(max(self._at, len(self._data) - len(marker)))  # a marker may straddle two blocks
            if not self._more():
                yield self._take(len(self._data))
                return
        yield self._take(found + 1)

    def sample(self, size: int) -> bytes:
        """Return bytes ahead without taking them."""
        if len(self._data) - self._at < size:
            self._more()
        return self._data[self._at : self._at + size]


def read_body(ref: StepRef) -> bytes:
    """Bytes of one step's body.

    Raises
    ------
    SceneError
        If it is longer than its rows can be, as where a few compressed kilobytes stand for gigabytes, or more follows
        it than was known.
    """
    if ref.length < 0 or (ref.rows and ref.length > _LONGEST_VALUE * (ref.rows + 1) * (len(ref.columns) + 1) + _BLOCK):
        msg = (
            f"{source_of(ref)}: {ref.length} bytes follow a header that promises {ref.rows} rows of {len(ref.columns)} "
            "values; the file is damaged. Leave it out, or write it again"
        )
        raise SceneError(msg)
    waits = is_gzipped(ref.path) and not ref.alone
    with _damage_named(ref.path), forward(ref.path, ref.offset) if waits else open_binary(ref.path) as stream:
        if ref.offset:
            stream.seek(ref.offset)
        body = stream.read(ref.length)
        if ref.alone and stream.read(1):
            msg = (
                f"{source_of(ref)}: more follows what was taken for the only step of the file, as where gzipped files "
                "were put one after the other; give the file a name without the number of the step, and it is read "
                "through"
            )
            raise SceneError(msg)
    return body


def source_of(ref: StepRef) -> str:
    """File and step, for messages."""
    return f"{ref.path} (step {ref.step})"


def parse_table(
    body: bytes, columns: Sequence[str], wanted: Sequence[str], rows: int | None, name: str
) -> dict[str, NDArray]:
    """Parse the wanted columns of a table of numbers.

    Parameters
    ----------
    body : bytes
        Rows of numbers between white space.
    columns : sequence of str
        Names of all columns.
    wanted : sequence of str
        Names of those to parse.
    rows : int or None
        Number of rows that must be there; None takes what there is.
    name : str
        File and step, for messages.

    Raises
    ------
    SceneError
        If rows are missing, too many, or too short or long, or a wanted value is not a number; the message
        names the first such row, counted from 0.
    """
    tokens, gaps = _count_tokens(body)
    if tokens == 0 and not rows:
        return {column: np.empty(0) for column in wanted}
    positions = {column: columns.index(column) for column in wanted}
    table = _single_spaced(body, len(columns), sorted(set(positions.values())), tokens, gaps)
    if table is not None and (rows is None or len(table) == rows):
        return {column: table[position].to_numpy() for column, position in positions.items()}
    last = len(columns) - 1
    # what nobody wants may be text, as LAMMPS' `element`; the last column is read to see whether rows are whole
    types = {**dict.fromkeys([last], "str"), **dict.fromkeys(positions.values(), "float64")}
    try:
        table = pd.read_csv(
            io.BytesIO(body), sep=r"\s+", header=None, names=range(len(columns)),
            usecols=sorted({*positions.values(), last}), dtype=types, engine="c", quoting=3,
        )  # fmt: skip
    except ValueError as error:
        msg = _fault(body, columns, wanted, rows, name) or f"{name}: cannot parse the table ({error})"
        raise SceneError(msg) from None
    # pandas fills rows that are too short with NaN, up to the last column, and cuts off what is too long.
    uneven = len(table) * len(columns) != tokens or (rows is not None and len(table) != rows)
    if uneven or table.isna().to_numpy().any():
        fault = _fault(body, columns, wanted, rows, name)
        if fault is None and uneven:  # as with a form feed or a lone carriage return among the values
            fault = f"{name}: its rows are not {len(columns)} numbers each; the file is damaged, leave it out"
        if fault:
            raise SceneError(fault)
    return {column: table[position].to_numpy() for column, position in positions.items()}


def _single_spaced(body: bytes, columns: int, positions: Sequence[int], tokens: int, gaps: int) -> pd.DataFrame | None:
    """Parse rows whose values are parted by one space, as most are, at twice the speed; None where that fails.

    Each line may end with a space, as those of LAMMPS do.
    """
    end = body.find(b"\n")
    trailing = end > 0 and body[end - 1 : end] == b" "
    # No two bytes of white space stand together, but for the ends of lines.
    if body[:1].isspace() or gaps != (body.count(b" \n") if trailing else 0):
        return None
    try:
        table = pd.read_csv(
            io.BytesIO(body), sep=" ", header=None, names=range(columns + trailing), index_col=False,
            usecols=sorted({*positions, columns - 1}), dtype=np.float64, engine="c", quoting=3,
        )  # fmt: skip
    except ValueError:
        return None
    # A row that is shorter lacks the last value; one that is longer is cut, and the number of values tells.
    whole = len(table) * columns == tokens and not table.isna().to_numpy().any()
    return table if whole else None


def _count_tokens(body: bytes) -> tuple[int, int]:
    """Count values, and places where white space follows white space."""
    count, gaps, before = 0, 0, True  # whether the byte before is white space
    for start in range(0, len(body), _BLOCK):  # in blocks that stay in the cache
        space = np.frombuffer(body[start : start + _BLOCK], np.uint8) <= ord(" ")
        count += int(np.count_nonzero(space[1:] < space[:-1])) + bool(before and not space[0])
        gaps += int(np.count_nonzero(space[1:] & space[:-1])) + bool(before and space[0] and start)
        before = space[-1]
    return count, gaps


def _fault(body: bytes, columns: Sequence[str], wanted: Sequence[str], rows: int | None, name: str) -> str | None:
    """Find the first row at fault, slowly, and say what is wrong with it."""
    positions = [(column, columns.index(column)) for column in wanted]
    lines = [line for line in body.decode("utf-8", "replace").splitlines() if line.strip()]
    for row, line in enumerate(lines[:rows]):
        tokens = line.split()
        if len(tokens) != len(columns):
            cut = row == len(lines) - 1 and len(tokens) < len(columns)
            hint = "the file is cut off here" if cut else f"the columns are {' '.join(columns)}"
            return f"{name}: row {row} has {len(tokens)} values, expected {len(columns)} ({line[:60]!r}); {hint}"
        for column, position in positions:
            if not _is_number(tokens[position]):
                return f"{name}: row {row} has {tokens[position]!r} in column '{column}', expected a number"
    if rows is not None and len(lines) < rows:
        return (
            f"{name}: {len(lines)} rows, but the header says {rows}: row {len(lines)} is missing, as when "
            "writing was stopped; write the file anew, or leave the step out"
        )
    if rows is not None and len(lines) > rows:
        return f"{name}: more rows than the {rows} that the header says; row {rows} is {lines[rows][:60]!r}"
    return None


def _is_number(token: str) -> bool:
    try:
        return not np.isnan(float(token))
    except ValueError:
        return False
