"""VTK XML files of PolyData and unstructured grids, and lists of them, whose headers expat parses without VTK.

Document types are refused, so that entities are never expanded.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.files.text import most_text, open_binary, uncompressed_size
from xcg.readers.files.vtkdata import COMPRESSORS, VtkEncoding
from xcg.readers.files.vtkheader import (
    LAST_LINE,
    LINE,
    MOST_COMPONENTS,
    TIMES,
    TYPES,
    Array,
    Header,
    Piece,
    are_lines,
    check_header,
    check_size,
    mesh_of_cells,
    read_values,
)

_HEAD = 1 << 14  # headers of MFiX take 2 to 5 kB
_LONG_HEAD = 1 << 20  # of many pieces; where no data are appended by then, they stand in the XML
_APPENDED = b"<AppendedData"
_TAG = 256  # bytes of that tag, and of white space up to its data
_LONGEST_LIST = 1 << 28  # bytes of a collection
_BLOCK = 1 << 20
_GRIDS = ("RectilinearGrid", "StructuredGrid", "ImageData")  # data sets whose points are no grains
_CELLS = ("Cells", "Verts", "Lines", "Strips", "Polys")

_TIME = re.compile(r"\s*Time\s*=\s*([-+.\deEdD]+)\s*s", re.IGNORECASE)


@dataclass(frozen=True)
class _Element:
    """Element of a header: its name, that of the element around it, and where its content starts."""

    name: str
    parent: str
    attributes: dict[str, str]
    start: int


@dataclass(frozen=True)
class _Xml:
    """Elements of a header in their order, how many of each name are complete, and comments."""

    data: bytes
    elements: list[_Element]
    complete: Counter[str]
    comments: list[str]

    def pieces(self) -> list[_Xml]:
        """Split the elements by piece; each list begins with the piece itself."""
        starts = [k for k, element in enumerate(self.elements) if element.name == "Piece"]
        ends = [*starts, len(self.elements)][1:]
        return [
            replace(self, elements=self.elements[start:end])
            for start, end in zip(starts, ends, strict=True)
        ]

    def named(self, name: str) -> list[dict[str, str]]:
        """Attributes of the elements of a name."""
        return [element.attributes for element in self.elements if element.name == name]

    def arrays(self, section: str, name: str | None = None) -> list[_Element]:
        """Arrays within a section, all or the ones with a name."""
        return [
            element
            for element in self.elements
            if (element.parent, element.name) == (section, "DataArray")
            and name in (None, element.attributes.get("Name"))
        ]

    def content(self, element: _Element) -> bytes:
        """Text of an element that holds no others."""
        stop = self.data.find(b"<", element.start)
        return self.data[element.start : stop if stop >= 0 else None]


def _parsed(path: str, data: bytes, *kinds: str) -> _Xml:
    """Parse a header, which may end before the file does.

    Raises
    ------
    SceneError
        Unless this is VTK XML of one of these kinds, without entities, whose elements close in
        order.
    """
    parser = expat.ParserCreate("iso-8859-1")  # all bytes are characters; see `_utf8`
    elements: list[_Element] = []
    opened = [""]
    complete = Counter[str]()
    comments = list[str]()

    def start(name: str, attributes: dict[str, str]) -> None:
        elements.append(
            _Element(name, opened[-1], attributes, data.find(b">", parser.CurrentByteIndex) + 1)
        )
        opened.append(name)

    def declared(*_: object) -> None:
        raise SceneError(
            f"{path}: declares a document type or entities, which VTK files never need; it is not read"
        )

    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = declared
    parser.EndElementHandler = lambda _: complete.update([opened.pop()])
    parser.CommentHandler = comments.append
    fault = ""
    try:
        parser.Parse(data, False)
    except expat.ExpatError as error:
        fault = expat.ErrorString(error.code)
    what = "no VTK XML file"
    kind = None
    if elements and elements[0].name == "VTKFile":
        kind = elements[0].attributes.get("type")
        what = f"VTK data of type {kind!r}"
    if kind not in kinds:
        raise SceneError(
            f"{path}: expected VTK XML of type '{kinds[0]}', but this is {what}; give the files of grains, such as "
            "those that a multi-block file lists"
        )
    if fault:
        raise SceneError(f"{path}: its XML is damaged ({fault}); leave the file out")
    return _Xml(data, elements, complete, comments)


def _utf8(text: str) -> str:
    """Decode UTF-8 that was parsed byte by byte; other texts stay."""
    try:
        return text.encode("latin-1").decode("utf-8")
    except UnicodeError:
        return text


def _whole(text: str | None, what: str, path: str) -> int:
    try:
        number = int(text or "")
    except ValueError:
        number = -1
    if not 0 <= number < 1 << 62:
        raise SceneError(
            f"{path}: {what} is {(text or '')[:60]!r} in its header; expected a whole number. Leave the file out"
        )
    return number


def _text(path: str) -> tuple[bytes, int, int]:
    """Return the header up to the tag of appended data, where these start (else 0), and the unpacked size."""
    most = most_text(path)
    size = uncompressed_size(path)
    with open_binary(path) as file:
        head = file.read(_HEAD)
        for further in (_LONG_HEAD, -1 if most == math.inf else int(most)):
            if b"<VTKFile" in head and _APPENDED not in head:
                head += file.read(further)
        head += file.read(_TAG)
        if size < 0:  # a compressed file that does not tell it
            size = len(head) + sum(map(len, iter(partial(file.read, _BLOCK), b"")))
    size = int(min(size, most))
    begin = head.find(_APPENDED)
    end = head.find(b">", begin) + 1
    if begin < 0 or not end:
        return head, 0, size
    return head[:end], head.find(b"_", end) + 1, size


def read_header(path: str, *, lines: bool = False) -> Header:
    """Read the header of a ``.vtp`` or ``.vtu`` file, and check that the file is as long as it says.

    Where `lines` are wanted and cells have arrays, rows are lines, and the arrays belong to cells.

    Only the first kilobytes are read where data are appended; files with values in the XML (old
    ASCII output) are scanned as a whole, because the names of their arrays are spread over them.

    Raises
    ------
    SceneError
        If this is not VTK PolyData or an unstructured grid, or shorter than promised; or lines are
        wanted, and there are cells of other kinds beside them.
    """
    data, body, size = _text(path)
    xml = _parsed(path, data, "PolyData", "UnstructuredGrid", *_GRIDS)
    root = xml.elements[0].attributes
    encoding = _encoding(root, path)
    if root["type"] in _GRIDS:
        return Header(path, encoding, mesh=f"a data set of the kind {root['type']}")
    parts = xml.pieces()
    cut = [name for name in ("Points", "PointData") if xml.complete[name] != len(xml.named(name))]
    if not parts or cut:
        raise SceneError(
            f"{path}: its header has {len(parts)} pieces, and {' and '.join(cut) or 'no section'} is not complete; "
            "the file was cut short. Leave it out, or write it again"
        )
    form = next((tag.get("encoding", "raw") for tag in xml.named("AppendedData")), "")
    file = _File(path, form, body, size, encoding)
    of_lines = lines and len(parts) == 1 and _has_lines(file, parts[0])
    pieces = [_piece(file, part, of_lines=of_lines) for part in parts]
    meshes = [_mesh_of(file, part) for part in parts]
    header = Header(
        path,
        encoding,
        _time_of(file, xml),
        tuple(piece for piece in pieces if piece.count) or tuple(pieces[:1]),
        fields={
            _utf8(tag.attributes.get("Name", "")): _numbers(xml.content(tag))
            for tag in xml.arrays("FieldData")
        },
        of_lines=of_lines,
        mesh=next(filter(None, meshes), ""),
    )
    check_header(header)
    return header


@dataclass(frozen=True)
class _File:
    """A file, and where its appended data are.

    Attributes
    ----------
    path : str
        The file.
    form : str
        "raw" or "base64": form of the appended data; empty without such data.
    body : int
        Byte at which they start, 0 without them.
    size : int
        Bytes of the file, unpacked.
    encoding : VtkEncoding
        Byte order, type of lengths, and compression.
    """

    path: str
    form: str
    body: int
    size: int
    encoding: VtkEncoding


def _piece(file: _File, xml: _Xml, *, of_lines: bool) -> Piece:
    """Describe the points of a piece, or its lines."""
    of_cells = [_array(element, file, xml) for element in xml.arrays("CellData")]
    if of_lines:
        count = _count(file.path, xml, "Lines") or _count(file.path, xml, "Cells")
        return Piece(count, tuple(of_cells))
    count = _count(file.path, xml, "Points")
    tags = [*xml.arrays("Points"), *xml.arrays("PointData")]
    arrays = [_array(element, file, xml) for element in tags]
    if count and not (xml.arrays("Points") and arrays[0].components == 3):
        raise SceneError(
            f"{file.path}: its points have no array with three components; the file is damaged, leave it out"
        )
    of_points = {array.name for array in arrays}
    of_cells = [array for array in of_cells if array.name not in of_points]
    vertices = _vertices(file, xml, count) if of_cells else None
    if vertices is None:
        return Piece(count, tuple(arrays), unread=tuple(array.name for array in of_cells))
    arrays += [replace(array, of_vertices=True) for array in of_cells]
    return Piece(count, tuple(arrays), vertices)


def _vertices(file: _File, xml: _Xml, count: int) -> Array | None:
    """Return the array of the points of cells, if there is one cell for each point, and it may be a vertex."""
    counts = {cells: _count(file.path, xml, cells) for cells in _CELLS}
    for kind in ("Cells", "Verts"):
        tags = xml.arrays(kind, "connectivity")
        if tags and count and count == counts[kind] == sum(counts.values()):
            return _array(tags[0], file, xml)
    return None


def _mesh_of(file: _File, xml: _Xml) -> str:
    """Return what a piece holds in place of grains; "" for grains."""
    counts = {cells: _count(file.path, xml, cells) for cells in _CELLS}
    tags = xml.arrays("Cells", "types")
    types = np.empty(0)
    if tags and counts["Cells"] not in (0, _count(file.path, xml, "Points")):
        types = _values(file, _array(tags[0], file, xml), counts["Cells"])
    return mesh_of_cells(counts["Polys"] + counts["Strips"], counts["Verts"], types)


def _values(file: _File, array: Array, count: int) -> NDArray:
    """Read the values of one array while the header is read."""
    check_size(file.path, array, file.encoding, count)
    with open_binary(file.path) as stream:
        return read_values(stream, file.path, array, file.encoding, count)


def _time_of(file: _File, xml: _Xml) -> float | None:
    """Return the time in the comment of MFiX, or in an array of the file called TimeValue or TIME."""
    for comment in filter(None, map(_TIME.match, xml.comments)):
        return _time(comment[1])
    for tag in xml.arrays("FieldData"):
        if tag.attributes.get("Name", "").lower() in TIMES:
            time = float(_values(file, replace(_array(tag, file, xml), components=1), 1)[0])
            return time if math.isfinite(time) else None
    return None


def _count(path: str, piece: _Xml, what: str) -> int:
    """Return the number of points, which has to be there, or of cells of a kind in a piece."""
    counts = {f"NumberOf{cells}": "0" for cells in _CELLS} | piece.elements[0].attributes
    return _whole(counts.get(f"NumberOf{what}"), f"NumberOf{what}", path)


def _has_lines(file: _File, piece: _Xml) -> bool:
    """Return whether the arrays of cells belong to lines (perhaps none); False without arrays."""
    if not piece.arrays("CellData"):
        return False
    kinds = [kind for kind in _CELLS if _count(file.path, piece, kind)]
    tags = piece.arrays("Cells", "types")
    if kinds == ["Cells"] and tags:  # of an unstructured grid
        types = _values(file, _array(tags[0], file, piece), _count(file.path, piece, "Cells"))
        return bool((types == LAST_LINE).all() or (types == LINE).all())
    return are_lines(file.path, kinds)


def _numbers(text: bytes) -> tuple[float, ...]:
    """Numbers of a text; none if it holds anything else."""
    try:
        return tuple(float(token) for token in text.split())
    except ValueError:
        return ()


def _encoding(root: dict[str, str], path: str) -> VtkEncoding:
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    width = 8 if root.get("header_type") == "UInt64" else 4
    compressor = root.get("compressor", "")
    if compressor and compressor not in COMPRESSORS:
        raise SceneError(
            f"{path}: is compressed by {compressor[:60]!r}; expected one of {', '.join(COMPRESSORS)}"
        )
    return VtkEncoding(order, np.dtype(f"{order}u{width}"), compressor)


def _time(text: str) -> float | None:
    with suppress(ValueError):
        time = float(text.lower().replace("d", "e"))  # Fortran may write 0.1D+00
        if math.isfinite(time):
            return time
    return None


def _array(element: _Element, file: _File, xml: _Xml) -> Array:
    """Describe one array."""
    tag = element.attributes
    path = file.path
    name = _utf8(tag.get("Name", "Points"))
    kind = tag.get("type", "")
    if kind not in TYPES:
        raise SceneError(
            f"{path}: array '{name}' has type {kind!r}; expected one of {sorted(TYPES)}"
        )
    components = _whole(tag.get("NumberOfComponents", "1"), f"NumberOfComponents of '{name}'", path)
    if not 1 <= components <= MOST_COMPONENTS:
        raise SceneError(
            f"{path}: '{name}' has {components} components; expected 1 to {MOST_COMPONENTS}. Leave the file out"
        )
    if tag.get("format") == "appended":
        if file.form not in ("raw", "base64") or not file.body:
            raise SceneError(
                f"{path}: its header names appended data, but none follows; it was cut short, leave it out"
            )
        offset = _whole(tag.get("offset"), f"the offset of '{name}'", path)
        return Array(name, components, kind, file.form, file.body + offset, file.size)
    text = xml.content(element)
    stop = element.start + len(text)
    start = stop - len(text.lstrip())
    form = "base64" if tag.get("format") == "binary" else "ascii"
    return Array(name, components, kind, form, start, stop)


def read_collection(path: str) -> list[tuple[tuple[str, ...], float | None]]:
    """List the files of each step that a ``.pvd`` collection names, as (paths, time), in its order.

    Parts of one time are one step; a part that is listed again is another step of the same time.

    Raises
    ------
    SceneError
        If this is not a collection, or it names nothing.
    """
    xml = _parsed(path, _whole_list(path), "Collection")
    steps: dict[tuple[float | None, int], list[str]] = {}
    times_listed = Counter[tuple[float | None, str, str]]()
    for tag in xml.named("DataSet"):
        if not tag.get("file") or "\0" in tag["file"]:
            continue
        words = tag.get("timestep", "").strip()
        time = _time(words)
        if words and time is None:
            raise SceneError(
                f"{path}: timestep={words!r} is no finite number; correct it, or open the files that it lists, in a "
                "list with times=[...]"
            )
        part = (time, tag.get("group", ""), tag.get("part", "0"))
        steps.setdefault((time, times_listed[part]), []).append(_beside(path, tag["file"]))
        times_listed[part] += 1
    if not steps:
        raise SceneError(
            f"{path}: it names no files; expected entries like <DataSet timestep=... file=.../>"
        )
    return [(tuple(files), time) for (time, _), files in steps.items()]


def read_parallel(path: str) -> tuple[str, ...]:
    """List the files of the pieces that a ``.pvtu`` or ``.pvtp`` file names.

    Raises
    ------
    SceneError
        If the file is of another kind, or names nothing.
    """
    xml = _parsed(path, _whole_list(path), "PUnstructuredGrid", "PPolyData")
    sources = [tag.get("Source", "") for tag in xml.named("Piece")]
    files = [_beside(path, source) for source in sources if source and "\0" not in source]
    if not files:
        raise SceneError(f"{path}: it names no files; expected entries like <Piece Source=.../>")
    return tuple(dict.fromkeys(files))


def _whole_list(path: str) -> bytes:
    with open_binary(path) as file:
        return file.read(_LONGEST_LIST)


def _beside(path: str, name: str) -> str:
    """Return the path of a file that is named relative to the folder of a list."""
    return str(Path(path).parent / _utf8(name))
