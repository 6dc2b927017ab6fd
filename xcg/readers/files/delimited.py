"""Text tables whose first line names the columns: CSV with commas, semicolons, tabs or blanks between values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.compiled._jit import THREADS
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.table import SHARED, parse_table
from xcg.readers.files.text import PIECE, Scanner, body_of, most_text, open_binary, source_of

_SEPARATORS = "\t;,"
_MOST_COLUMNS = 1000


@dataclass(frozen=True, eq=False)
class Table:
    """Result of one pass through a file.

    Attributes
    ----------
    columns : tuple of str
        Names of the columns.
    rows : int
        Number of rows.
    clock : mapping
        Columns of times and numbers of steps.
    starts : array (rows + 1,)
        Byte where each row begins, and where the last one ends.
    kind : str
        What stands between values.
    """

    columns: tuple[str, ...]
    rows: int
    clock: Mapping[str, NDArray]
    starts: NDArray
    kind: str

    def place(self, first: int, stop: int) -> tuple[int, int]:
        """Byte where some rows begin, and how many bytes there are."""
        return int(self.starts[first]), int(self.starts[stop] - self.starts[first])


def scan(path: str, clock_of: Callable[[Sequence[str]], Mapping[str, str]]) -> Table:
    """Read the names, count the rows, and read the columns of times.

    Raises
    ------
    SceneError
        If the first line names no columns, or one of them twice, or a time is not a number.
    """
    with open_binary(path) as stream:
        scanner = Scanner(stream, path, most_text(path))
        first = scanner.line()
        line = first.decode("utf-8-sig", "replace").lstrip("#").strip()
        separator = next((mark for mark in _SEPARATORS if mark in line), " ")
        words = line.split(None if separator == " " else separator)
        names = tuple(word.strip().strip("\"'") for word in words)
        twice = [name for name, count in Counter(names).items() if count > 1]
        if not line or twice or len(names) > _MOST_COLUMNS or all(map(_is_number, names)):
            why = f"{twice[0]!r} twice" if twice else repr(line[:60])
            raise SceneError(
                f"{path}: expected a first line that names each column once, such as 'x,y,z,radius', found {why}"
            )
        lines = _Lines(scanner.offset, shortest=3 if first.endswith(b"\r\n") else 2)
        pieces = lines.passed(_pieces(scanner))
        wanted = sorted(set(clock_of(names).values()))
        if wanted:
            clock = parse_table(translated(pieces, separator), names, wanted, None, path)
        else:
            clock = {}
            for _ in pieces:
                pass
    starts = lines.starts()
    if wanted and len(clock[wanted[0]]) != len(starts) - 1:
        raise SceneError(f"{path}: lines of blanks only stand between rows; remove them")
    return Table(names, len(starts) - 1, clock, starts, separator)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _pieces(scanner: Scanner) -> Iterator[bytes]:
    while piece := scanner.block(PIECE):
        yield piece


class _Lines:
    """Find the starts of lines that are not blank in a stream of text; `shortest` of them in bytes, with its end."""

    def __init__(self, offset: int, shortest: int) -> None:
        self._end, self._found, self._shortest = offset, [np.array([offset])], shortest

    def passed(self, pieces: Iterable[bytes]) -> Iterator[bytes]:
        last = b"\n"
        for piece in pieces:
            self._found.append(self._end + 1 + np.flatnonzero(np.frombuffer(piece, np.uint8) == ord("\n")))
            self._end, last = self._end + len(piece), piece
            yield piece
        if not last.endswith(b"\n"):  # as if it did
            self._found.append(np.array([self._end + 1]))

    def starts(self) -> NDArray:
        edges = np.concatenate(self._found)
        rows = np.diff(edges) >= self._shortest
        return np.append(edges[:-1][rows], self._end)


def translated(pieces: Iterable[bytes], separator: str) -> Iterable[bytes]:
    """Replace separators between values by blanks."""
    if separator.isspace():
        return pieces
    blank = bytes.maketrans(separator.encode(), b" ")
    return (piece.translate(blank) for piece in pieces)


def read_columns(ref: StepRef, wanted: Sequence[str], options: ReadOptions) -> dict[str, NDArray]:
    """Read columns of one step."""
    threads = THREADS if options.alone and ref.length > SHARED else 1
    return parse_table(translated(body_of(ref), ref.kind), ref.columns, wanted, ref.rows, source_of(ref), threads)
