"""Legacy VTK files (``# vtk DataFile``), text or binary: PolyData and unstructured grids, read without VTK.

Headers of arrays stand between the values, so the whole file is looked through, without parsing its
numbers: in binary files values are skipped by their size, in text files up to the next line of
words.
"""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import BinaryIO
from urllib.parse import unquote

import numpy as np

from xcg.common.messages import SceneError
from xcg.readers.files.text import most_text, open_binary
from xcg.readers.files.vtkdata import VtkEncoding
from xcg.readers.files.vtkheader import (
    MOST_COMPONENTS,
    TIMES,
    TYPES,
    Array,
    Header,
    Piece,
    are_lines,
    check_header,
    mesh_of_cells,
    read_values,
)

MAGIC = b"# vtk DataFile"
_ENCODING = VtkEncoding(">", np.dtype(">u4"), "")
_LONGEST_LINE = 1 << 20  # bytes that are read at once
_BLOCK = 1 << 20  # bytes of numbers that are skipped at once
_OF_NUMBERS = b"0123456789+-.eE \t\r\n"
_MOST_DIGITS = 15  # of counts
_READ = ("POLYDATA", "UNSTRUCTURED_GRID")
_POINTS = "POINT_DATA"
_CELL_DATA = "CELL_DATA"

_KINDS = {
    "char": "Int8",
    "unsigned_char": "UInt8",
    "short": "Int16",
    "unsigned_short": "UInt16",
    "int": "Int32",
    "unsigned_int": "UInt32",
    "vtkidtype": "Int32",  # in files, whatever it is in memory
    "long": "Int64",
    "unsigned_long": "UInt64",
    "vtktypeint64": "Int64",
    "vtktypeuint64": "UInt64",
    "float": "Float32",
    "double": "Float64",
}
_STRINGS = ("string", "utf8_string", "variant")
_FIELD_TYPES = {*_KINDS, *_STRINGS, "bit"}

# sections of one array each, and its components
_ONE_ARRAY = {
    "VECTORS": 3,
    "NORMALS": 3,
    "TENSORS": 9,
    "TENSORS6": 6,
    "GLOBAL_IDS": 1,
    "PEDIGREE_IDS": 1,
    "EDGE_FLAGS": 1,
}
_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS")
_OTHERS = (
    "DATASET",
    "POINTS",
    "OFFSETS",
    "CONNECTIVITY",
    "CELL_TYPES",
    "POINT_DATA",
    "CELL_DATA",
    "SCALARS",
    "COLOR_SCALARS",
    "LOOKUP_TABLE",
    "TEXTURE_COORDINATES",
    "FIELD",
    "METADATA",
)
_KEYWORDS = {*_ONE_ARRAY, *_CELLS, *_OTHERS}


def is_legacy(path: str) -> bool:
    """Return whether a file is a legacy VTK file, by its first bytes."""
    with open_binary(path) as file:
        return file.read(len(MAGIC)) == MAGIC


def read_header(path: str, *, lines: bool = False) -> Header:
    """Read the header of a legacy VTK file, and check that the file is as long as it says.

    Where `lines` are wanted and cells have arrays, rows are lines, and the arrays belong to cells.

    Raises
    ------
    SceneError
        If the file is not of legacy VTK, damaged or shorter than promised; or if lines are wanted,
        and there are cells of other kinds beside them.
    """
    with open_binary(path) as file:
        scanner = _Scanner(file, path)
        contents = _contents_of(scanner)
        if not contents.dataset:
            raise scanner.damaged("it has no line DATASET with a kind")
        if contents.dataset not in _READ:
            return Header(path, _ENCODING, mesh=f"a data set of the kind {contents.dataset}")
        has_arrays = bool(contents.arrays[_CELL_DATA])
        of_lines = lines and has_arrays and are_lines(path, [*contents.cells])
        if of_lines:
            count = contents.number_of("LINES")
            piece = Piece(count, tuple(contents.arrays_of(_CELL_DATA, count, path)))
        else:
            piece = _points_of(contents, path)
        time = _time_of(file, contents, path)
        mesh = _mesh_of(file, contents, path)
    header = Header(path, _ENCODING, time, (piece,), of_lines=of_lines, mesh=mesh)
    check_header(header)
    return header


# --- the meaning of the sections -------------------------------------------------------------------------


@dataclass
class _CellsOfKind:
    """Cells of one kind: their number, and their points, where each cell has one."""

    count: int
    vertices: Array | None


@dataclass
class _Contents:
    """Sections of a file.

    Attributes
    ----------
    dataset : str
        Kind of the data set.
    point_count : int
        Number of points.
    points : Array or None
        Their coordinates.
    cells : dict
        Cells by their kind.
    types : Array or None
        Types of the cells of an unstructured grid.
    arrays : dict
        Arrays with their rows, of points, of cells, and of the file (""), by the keyword above
        them.
    counts : dict
        Rows that these arrays should have.
    """

    dataset: str = ""
    point_count: int = 0
    points: Array | None = None
    cells: dict[str, _CellsOfKind] = field(default_factory=dict)
    types: Array | None = None
    arrays: dict[str, list[tuple[Array, int]]] = field(
        default_factory=lambda: {"": [], _POINTS: [], _CELL_DATA: []}
    )
    counts: dict[str, int] = field(default_factory=lambda: {"": 1, _POINTS: 0, _CELL_DATA: 0})

    def number_of(self, *kinds: str) -> int:
        """Return the number of cells of some kinds, of all kinds by default."""
        return sum(self.cells[kind].count for kind in kinds or self.cells if kind in self.cells)

    def arrays_of(self, section: str, expected: int, path: str) -> list[Array]:
        """Return the arrays of points or cells. Raise SceneError unless all have so many rows."""
        for array, count in self.arrays[section]:
            if count != expected:
                raise SceneError(
                    f"{path}: '{array.name}' has {count} rows below {section}, expected {expected}; the file is "
                    "damaged. Leave it out, or write it again"
                )
        return [array for array, _ in self.arrays[section]]


def _points_of(contents: _Contents, path: str) -> Piece:
    """Describe the points, with the arrays of cells where each point has one vertex."""
    count = contents.point_count
    if contents.points is None:
        raise SceneError(f"{path}: it has no section POINTS; the file was cut short, leave it out")
    arrays = [contents.points, *contents.arrays_of(_POINTS, count, path)]
    of_points = {array.name for array in arrays}
    of_cells = [array for array, _ in contents.arrays[_CELL_DATA] if array.name not in of_points]
    cells = contents.cells.get("VERTICES") or contents.cells.get("CELLS")
    if cells and cells.vertices and cells.count == contents.number_of() == count:
        fitting = contents.arrays_of(_CELL_DATA, count, path)
        arrays += [replace(array, of_vertices=True) for array in fitting if array in of_cells]
        return Piece(count, tuple(arrays), cells.vertices)
    return Piece(count, tuple(arrays), unread=tuple(array.name for array in of_cells))


def _mesh_of(file: BinaryIO, contents: _Contents, path: str) -> str:
    """Return what the file holds in place of grains; "" for grains."""
    types = np.empty(0)
    cells = contents.cells.get("CELLS")
    if cells and not cells.vertices and contents.types:
        types = read_values(file, path, contents.types, _ENCODING, cells.count)
    polygons = contents.number_of("POLYGONS", "TRIANGLE_STRIPS")
    return mesh_of_cells(polygons, contents.number_of("VERTICES"), types)


def _time_of(file: BinaryIO, contents: _Contents, path: str) -> float | None:
    """Return the time in an array of the file that is called TimeValue or TIME."""
    for array, count in contents.arrays[""]:
        if array.name.lower() in TIMES and count == array.components == 1:
            time = float(read_values(file, path, array, _ENCODING, 1)[0])
            return time if math.isfinite(time) else None
    return None


# --- the sections ----------------------------------------------------------------------------------------


def _contents_of(scanner: _Scanner) -> _Contents:
    """Find the sections of a file; of data sets that are no points, the kind alone."""
    contents = _Contents()
    section = ""
    while words := scanner.words():
        keyword = words[0].upper()
        if _is_array_of_field(words):
            contents.arrays[section] += scanner.array_of_field(words)
        elif keyword == "DATASET":
            contents.dataset = _word(words, 1).upper()
            if contents.dataset not in _READ:
                return contents
        elif keyword == "POINTS":
            contents.point_count = scanner.number(words, 1)
            contents.points = scanner.values(
                "Points", scanner.kind(words, 2), contents.point_count, 3
            )
        elif keyword in _CELLS:
            contents.cells[keyword] = _cells(scanner, words)
        elif keyword == "CELL_TYPES":
            contents.types = scanner.values("CELL_TYPES", "Int32", scanner.number(words, 1))
        elif keyword in (_POINTS, _CELL_DATA):
            section = keyword
            contents.counts[section] = scanner.number(words, 1)
        elif keyword == "METADATA":
            scanner.skip_metadata()
        elif keyword == "LOOKUP_TABLE":  # of colours
            scanner.values("colours", scanner.colours, scanner.number(words, 2), 4)
        elif keyword != "FIELD":
            count = contents.counts[section]
            contents.arrays[section].append((_attribute(scanner, words, count), count))
    return contents


def _cells(scanner: _Scanner, words: list[str]) -> _CellsOfKind:
    """Find cells of one kind: before version 5 each with its number of points, then offsets and points apart."""
    count = scanner.number(words, 1)
    size = scanner.number(words, 2)
    if scanner.version >= 5:
        scanner.values("OFFSETS", scanner.kind(scanner.after("OFFSETS"), 1), count)
        kind = scanner.kind(scanner.after("CONNECTIVITY"), 1)
        points = scanner.values("CONNECTIVITY", kind, size)
        return _CellsOfKind(max(0, count - 1), points if size == count - 1 else None)
    if size == 2 * count:
        return _CellsOfKind(count, scanner.values(words[0], "Int32", count, 2))
    scanner.values(words[0], "Int32", size)
    return _CellsOfKind(count, None)


def _attribute(scanner: _Scanner, words: list[str], count: int) -> Array:
    """Find an array of a section of its own."""
    keyword = words[0].upper()
    name = unquote(_word(words, 1))
    if keyword == "SCALARS":
        kind = scanner.kind(words, 2)
        components = 1
        if len(words) > 3:
            components = scanner.number(words, 3)
        scanner.after("LOOKUP_TABLE")
        return scanner.values(name, kind, count, components)
    if keyword == "COLOR_SCALARS":
        return scanner.values(name, scanner.colours, count, scanner.number(words, 2))
    if keyword == "TEXTURE_COORDINATES":
        return scanner.values(name, scanner.kind(words, 3), count, scanner.number(words, 2))
    if keyword in _ONE_ARRAY:
        return scanner.values(name, scanner.kind(words, 2), count, _ONE_ARRAY[keyword])
    raise scanner.damaged(f"{' '.join(words)[:60]!r} begins no section")


def _is_array_of_field(words: list[str]) -> bool:
    """Return whether a line describes an array of a field: name, components, rows and type."""
    return (
        len(words) == 4
        and words[1].isdecimal()
        and words[2].isdecimal()
        and words[3].lower() in _FIELD_TYPES
    )


def _word(words: list[str], k: int) -> str:
    return words[k] if k < len(words) else ""


class _Scanner:
    """Lines of words of a file, and the offsets of the values between them."""

    def __init__(self, file: BinaryIO, path: str) -> None:
        self._file = file
        self._path = path
        self._most = most_text(path)
        self._at = 0
        self._waiting: deque[bytes] = deque()
        first = self._line()
        self._line()  # the title
        form = self._line().strip().upper()
        if not first.startswith(MAGIC) or form not in (b"ASCII", b"BINARY"):
            raise self.damaged("ASCII or BINARY is missing in its third line")
        version = re.findall(rb"Version +(\d{1,9})", first)
        self.version = int(version[0]) if version else 0
        self._binary = form == b"BINARY"
        self.colours = "UInt8" if self._binary else "Float32"

    def damaged(self, reason: str) -> SceneError:
        """Return an error about what was read last."""
        return SceneError(
            f"{self._path}: {reason}, before byte {self._at}; the legacy VTK file is damaged or cut short. Leave it "
            "out, or write it again"
        )

    def _line(self) -> bytes:
        if self._waiting:
            line = self._waiting.popleft()
        else:
            line = self._file.readline(_LONGEST_LINE)
        self._advance(len(line))
        return line

    def _advance(self, size: int) -> None:
        """Count bytes that were read; raise SceneError beyond what compressed bytes may unpack to."""
        self._at += size
        if self._at > self._most:
            raise self.damaged(f"its compressed bytes stand for more than {self._most:.3g}")

    def words(self) -> list[str]:
        """Return the words of the next line that has some; none at the end of the file."""
        while line := self._line():
            words = line.decode("utf-8", "replace").split()
            if words:
                return words
        return []

    def after(self, keyword: str) -> list[str]:
        """Return the words of the next line, which has to begin with a keyword."""
        words = self.words()
        if not words or words[0].upper() != keyword:
            raise self.damaged(f"a line {keyword} is missing")
        return words

    def number(self, words: list[str], k: int) -> int:
        """Return the count in a line of words."""
        text = _word(words, k)
        if not (text.isascii() and text.isdecimal() and len(text) <= _MOST_DIGITS):
            raise self.damaged(f"{' '.join(words)[:60]!r} has no count as its word {k + 1}")
        return int(text)

    def kind(self, words: list[str], k: int) -> str:
        """Return the type that a line of words names."""
        text = _word(words, k).lower()
        if text not in _KINDS:
            raise self.damaged(
                f"{' '.join(words)[:60]!r} has no type of numbers as its word {k + 1}"
            )
        return _KINDS[text]

    def values(self, name: str, kind: str, count: int, components: int = 1) -> Array:
        """Return the array at the present offset, and skip its values."""
        if not 1 <= components <= MOST_COMPONENTS:
            raise self.damaged(
                f"{name!r} has {components} components; expected 1 to {MOST_COMPONENTS}"
            )
        start = self._at
        form = "ascii"
        if self._binary:
            form = "binary"
            self._skip_bytes(name, count * components * np.dtype(TYPES[kind]).itemsize)
        else:
            self._skip_text()
        return Array(name, components, kind, form, start, self._at)

    def array_of_field(self, words: list[str]) -> list[tuple[Array, int]]:
        """Return an array of a field with its rows; nothing if it holds bits or strings."""
        name = unquote(words[0])
        components = self.number(words, 1)
        count = self.number(words, 2)
        kind = words[3].lower()
        if kind in _KINDS:
            return [(self.values(name, _KINDS[kind], count, components), count)]
        if kind == "bit" and self._binary:
            self._skip_bytes(name, (count * components + 7) // 8)
        elif kind == "bit":
            self._skip_text()
        else:
            self._skip_strings(name, count * components)
        return []

    def _skip_bytes(self, name: str, size: int) -> None:
        if size:
            self._file.seek(self._at + size - 1)
            if not self._file.read(1):
                raise self.damaged(f"{name!r} needs {size} bytes, but the file ends earlier")
        self._at += size

    def _skip_text(self) -> None:
        """Skip lines of numbers: blocks of lines without any letter at once, others line by line."""
        self._skip_blocks()
        while line := self._line():
            text = line.strip()
            if text[:1].isalpha() or text[-1:].isalpha():
                words = text.decode("utf-8", "replace").split()
                if words[0].upper() in _KEYWORDS or _is_array_of_field(words):
                    self._at -= len(line)
                    self._waiting.appendleft(line)
                    return
            self._skip_blocks()

    def _skip_blocks(self) -> None:
        """Skip blocks of lines that hold numbers alone, unless lines wait; the lines of the next block then wait."""
        while not self._waiting:
            block = self._file.read(_BLOCK)
            block += self._file.readline(_LONGEST_LINE)
            if not block:
                return
            if block.translate(None, _OF_NUMBERS):
                self._waiting.extend(BytesIO(block).readlines())
            else:
                self._advance(len(block))

    def _skip_strings(self, name: str, count: int) -> None:
        """Skip strings, one a line."""
        if self._binary:
            raise self.damaged(f"{name!r} holds strings, which are not read from binary files")
        for _ in range(count):
            if not self._line():
                raise self.damaged(f"{name!r} ends early")

    def skip_metadata(self) -> None:
        """Skip lines up to a blank one."""
        while self._line().strip():
            pass
