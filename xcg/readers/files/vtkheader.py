"""Headers of VTK files, XML or legacy: pieces of points or lines, and the arrays that belong to them.

Every count in a header is checked against the size of the file before anything is made for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.messages import SceneError
from xcg.readers.files.text import open_binary
from xcg.readers.files.vtkdata import DataError, VtkEncoding, parse_text, read_base64, read_raw
from xcg.scene.schema import Frame

MOST_COMPONENTS = 100
LINE = 3  # of VTK's types of cells
LAST_LINE = 4  # of VTK's types of cells: vertices and lines come first, then those of an extent
OF_CELLS = " (of cells)"  # follows the names of arrays that belong to no single point
TIMES = ("timevalue", "time")  # names of the time among the arrays of a file, in lower case
TYPES = {
    f"{kind}{bits}": f"{letter}{bits // 8}"
    for kind, letter, all_bits in (
        ("Int", "i", (8, 16, 32, 64)),
        ("UInt", "u", (8, 16, 32, 64)),
        ("Float", "f", (32, 64)),
    )
    for bits in all_bits
}


@dataclass(frozen=True)
class Array:
    """Array as the header describes it.

    Attributes
    ----------
    name : str
        Its name.
    components : int
        Values a row.
    kind : str
        "Float32", "Int64", ...
    form : str
        "raw" or "base64" with the length before the values, "binary" without it, or "ascii".
    start, stop : int
        Bytes of the file, unpacked where it is compressed, where its data begin, and where they end
        at the latest.
    of_vertices : bool
        Whether its rows are vertices, in their order, and not points.
    """

    name: str
    components: int
    kind: str
    form: str
    start: int
    stop: int
    of_vertices: bool = False


@dataclass(frozen=True)
class Piece:
    """Part of the points of a file, or of its lines.

    Attributes
    ----------
    count : int
        Number of points, or of lines.
    arrays : tuple of Array
        The coordinates of the points, then the arrays of points and of vertices; or the arrays of
        the lines.
    vertices : Array or None
        Points of the vertices, the last component of each row, where there is one vertex for each
        point.
    unread : tuple of str
        Names of arrays of cells that belong to no single point.
    """

    count: int
    arrays: tuple[Array, ...]
    vertices: Array | None = None
    unread: tuple[str, ...] = ()


@dataclass(frozen=True)
class Header:
    """Header of one file.

    Attributes
    ----------
    path : str
        The file.
    encoding : VtkEncoding
        Byte order, type of lengths, and compression.
    time : float or None
        Physical time (s), where the file states it.
    pieces : tuple of Piece
        Parts whose rows follow one another; those without rows are left out, unless all are
        without.
    fields : mapping
        Numbers of the arrays that belong to no point, where the header holds them, by name.
    of_lines : bool
        Whether rows are lines.
    mesh : str
        What the file holds in place of grains, such as "1616 polygons"; empty for grains or
        contacts.
    """

    path: str
    encoding: VtkEncoding
    time: float | None = None
    pieces: tuple[Piece, ...] = (Piece(0, ()),)
    fields: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    of_lines: bool = False
    mesh: str = ""

    @property
    def count(self) -> int:
        """Number of points, or of lines."""
        return sum(piece.count for piece in self.pieces)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays; the first one of points is that of their coordinates."""
        first = self.pieces[0]
        return (
            *(array.name for array in first.arrays),
            *(name + OF_CELLS for name in first.unread),
        )


def check_header(header: Header) -> None:
    """Raise SceneError if pieces hold different arrays, or a header promises more values than bytes follow."""
    for piece in header.pieces:
        names = [array.name for array in piece.arrays]
        if names != [array.name for array in header.pieces[0].arrays]:
            raise SceneError(
                f"{header.path}: its pieces hold different arrays, {list(header.names)} and {names}; write the same "
                "arrays for all of them"
            )
        arrays = [*piece.arrays]
        if piece.vertices:
            arrays.append(piece.vertices)
        for array in arrays:
            check_size(header.path, array, header.encoding, piece.count)


def check_size(path: str, array: Array, encoding: VtkEncoding, count: int) -> None:
    """Compare the rows that a header promises with the bytes that there are."""
    values = count * array.components
    needed = values * np.dtype(TYPES[array.kind]).itemsize
    present = max(0, array.stop - array.start)
    if array.form == "ascii":
        needed = 2 * values - 1
    elif array.form == "base64":
        present = encoding.room(present * 3 // 4)
    elif array.form == "raw":
        present = encoding.room(present)
    if needed > present:
        raise SceneError(
            f"{path}: its header promises {count} points, lines or cells, for which '{array.name}' needs {needed} "
            f"bytes, but {present} follow in the {array.stop} of the file; it was cut short, or is still being "
            "written. Leave it out, or write it again"
        )


def read_arrays(header: Header, names: Sequence[str]) -> Frame:
    """Read arrays of one file by name.

    Parameters
    ----------
    header : Header
        What `read_header` of the file's form returned.
    names : sequence of str
        Arrays to read, out of ``header.names``; the others are not parsed.

    Returns
    -------
    dict of float64 arrays
        Shape (points,) for one component, (points, components) for more.

    Raises
    ------
    SceneError
        If the file changed since its header was read, or its body does not match the header.
    """
    # once, as a compressed file can be read from the front only
    with open_binary(header.path) as file:
        pieces = [_read_piece(file, header, piece, names) for piece in header.pieces]
    if len(pieces) == 1:
        return pieces[0]
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def _read_piece(file: BinaryIO, header: Header, piece: Piece, names: Sequence[str]) -> Frame:
    """Read arrays of one piece, values of vertices in the order of the points."""
    arrays: Frame = {}
    vertices: NDArray | None = None
    for array in piece.arrays:
        if array.name not in names or array.name in arrays:
            continue
        values = _read_components(file, header, array, piece.count)
        if array.of_vertices and piece.vertices:
            if vertices is None:
                vertices = _points_of_vertices(file, header, piece.vertices, piece.count)
            by_vertex = values
            values = np.empty_like(by_vertex)
            values[vertices] = by_vertex
        arrays[array.name] = values
    return arrays


def _points_of_vertices(file: BinaryIO, header: Header, vertices: Array, count: int) -> NDArray:
    """Read the point of each vertex (rows,); each point has to have one vertex."""
    cells = _read_components(file, header, vertices, count).reshape(count, -1)
    points = cells[:, -1]
    if not np.array_equal(np.sort(points), np.arange(count)) or (cells[:, :-1] != 1).any():
        raise SceneError(
            f"{header.path}: arrays of cells are read as those of grains, but the cells are not one vertex for each "
            "point; write the arrays for the points, or drop them with names={'...': None}"
        )
    return points.astype(np.intp)


def _read_components(file: BinaryIO, header: Header, array: Array, count: int) -> NDArray:
    values = read_values(file, header.path, array, header.encoding, count)
    if array.components > 1:
        return values.reshape(count, array.components)
    return values


def read_values(
    file: BinaryIO, path: str, array: Array, encoding: VtkEncoding, rows: int
) -> NDArray:
    """Read the values of one array, row after row; raise SceneError if it is damaged, or holds more or fewer."""
    count = rows * array.components
    if not count:
        return np.empty(0)
    try:
        return _numbers(file, array, encoding, count)
    except DataError as error:
        raise SceneError(
            f"{path}: '{array.name}' is not as its header says, {rows} rows: {error}; leave the file out, or write "
            "it again"
        ) from None


def _numbers(file: BinaryIO, array: Array, encoding: VtkEncoding, count: int) -> NDArray:
    dtype = np.dtype(encoding.order + TYPES[array.kind])
    if array.form == "base64":
        return read_base64(file, array.start, encoding, dtype, count)
    if array.form == "raw":
        return read_raw(file, array.start, encoding, dtype, count)
    file.seek(array.start)
    if array.form == "ascii":
        return parse_text(file.read(array.stop - array.start), array.kind, count)
    raw = file.read(count * dtype.itemsize)
    if len(raw) != count * dtype.itemsize:
        raise DataError(f"its values end after {len(raw)} of {count * dtype.itemsize} bytes")
    return np.frombuffer(raw, dtype).astype("float64")


def mesh_of_cells(polygons: int, vertices: int, types: ArrayLike) -> str:
    """Return what a file holds in place of grains: polygons without vertices, or cells of an extent; else "".

    `types` holds the type of each cell of an unstructured grid.
    """
    if polygons and not vertices:
        return f"{polygons} polygons"
    extended = int(np.count_nonzero(np.asarray(types) > LAST_LINE))
    return f"{extended} cells that are no vertices" if extended else ""


def are_lines(path: str, kinds: Sequence[str]) -> bool:
    """Return whether all cells are lines; True without cells.

    Raises
    ------
    SceneError
        If there are others beside the lines.
    """
    lines = [kind for kind in kinds if kind.lower() == "lines"]
    others = [kind for kind in kinds if kind not in lines]
    if lines and others:
        raise SceneError(
            f"{path}: holds {' and '.join(others)} beside {lines[0]}; write the contacts, as lines, to files of their "
            "own"
        )
    return not others
