"""VTK XML PolyData files and their collections, whose headers expat parses, read without VTK.

Document types are refused, so that entities are never expanded. Every count in a header is held against the size of the
file before anything is made for it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import BinaryIO
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.files.text import most_text, open_binary, uncompressed_size
from xcg.readers.files.vtkdata import (
    COMPRESSORS,
    DataError,
    VtkEncoding,
    parse_text,
    read_base64,
    read_raw,
)

_HEAD = 1 << 14  # headers of MFiX take 2 to 5 kB
_LONGEST_LIST = 1 << 28  # bytes of a collection
_BLOCK = 1 << 20
_MOST_COMPONENTS = 100
_OTHER_CELLS = ("Cells", "Verts", "Strips", "Polys")
_TYPES = {
    f"{kind}{bits}": f"{letter}{bits // 8}"
    for kind, letter, all_bits in (
        ("Int", "i", (8, 16, 32, 64)),
        ("UInt", "u", (8, 16, 32, 64)),
        ("Float", "f", (32, 64)),
    )
    for bits in all_bits
}

_TIME = re.compile(r"\s*Time\s*=\s*([-+.\deEdD]+)\s*s", re.IGNORECASE)


@dataclass(frozen=True)
class Array:
    """Array as the header describes it.

    Attributes
    ----------
    name : str
        Its name.
    components : int
        Values a point.
    kind : str
        "Float32", "Int64", ...
    form : str
        "raw" or "base64", "ascii".
    start, stop : int
        Bytes of the file, unpacked where it is compressed, where its data begin, and where they end at the latest.
    """

    name: str
    components: int
    kind: str
    form: str
    start: int
    stop: int


@dataclass(frozen=True)
class Header:
    """Header of one file.

    Attributes
    ----------
    path : str
        The file.
    size : int
        Its size in bytes, as it is on the disk.
    rows : int
        Number of points, or of lines.
    time : float or None
        Physical time (s) from the comment that MFiX writes.
    arrays : tuple of Array
        The coordinates of the points, then the arrays of point data; or the arrays of the lines.
    encoding : VtkEncoding
        Byte order, type of lengths, and compression.
    fields : mapping
        Numbers of the arrays that belong to no point, where the header holds them, by name.
    of_lines : bool
        Whether rows are lines.
    """

    path: str
    size: int
    rows: int
    time: float | None
    arrays: tuple[Array, ...]
    encoding: VtkEncoding
    fields: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    of_lines: bool = False

    @property
    def what(self) -> str:
        """Number of rows, in words."""
        return f"{self.rows} {'lines' if self.of_lines else 'points'}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays; the first one of points is that of their coordinates."""
        return tuple(array.name for array in self.arrays)


@dataclass(frozen=True)
class _Element:
    """Element of a header: its name, that of the element around it, and where its content starts."""

    name: str
    parent: str
    attributes: dict[str, str]
    start: int


@dataclass(frozen=True)
class _Xml:
    """Elements of a header in their order, names of those that are complete, and comments."""

    data: bytes
    elements: list[_Element]
    complete: set[str]
    comments: list[str]

    def named(self, name: str) -> list[dict[str, str]]:
        """Attributes of the elements of a name."""
        return [element.attributes for element in self.elements if element.name == name]

    def arrays(self, section: str) -> list[_Element]:
        """Arrays within a section."""
        return [
            element
            for element in self.elements
            if (element.parent, element.name) == (section, "DataArray")
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
        Unless this is VTK XML of one of these kinds, without entities, whose elements close in order.
    """
    parser = expat.ParserCreate("iso-8859-1")  # all bytes are characters; see `_utf8`
    elements: list[_Element] = []
    opened, complete, comments = [""], set[str](), list[str]()

    def start(name: str, attributes: dict[str, str]) -> None:
        elements.append(
            _Element(name, opened[-1], attributes, data.find(b">", parser.CurrentByteIndex) + 1)
        )
        opened.append(name)

    def declared(*_: object) -> None:
        raise SceneError(
            f"{path}: declares a document type or entities, which VTK files never need; it is not read"
        )

    parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, declared
    parser.EndElementHandler = lambda _: complete.add(opened.pop())
    parser.CommentHandler = comments.append
    fault = ""
    try:
        parser.Parse(data, False)
    except expat.ExpatError as error:
        fault = expat.ErrorString(error.code)
    root = elements[0] if elements and elements[0].name == "VTKFile" else None
    kind = None if root is None else root.attributes.get("type")
    if kind not in kinds:
        what = "no VTK XML file" if root is None else f"VTK data of type {kind!r}"
        raise SceneError(f"{path}: expected VTK XML of type '{kinds[0]}', but this is {what}")
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


def _text(path: str) -> tuple[bytes, int | None, int]:
    """Return the header up to the tag of appended data, where these start, and the size of the file unpacked."""
    most, size = most_text(path), uncompressed_size(path)
    with open_binary(path) as file:
        head = file.read(_HEAD)
        while b"<AppendedData" not in head[:-256] and b"<VTKFile" in head and len(head) < most:
            more = file.read(len(head))
            if not more:
                break
            head += more
        if size < 0:  # a compressed file that does not tell it
            size = len(head) + sum(map(len, iter(partial(file.read, _BLOCK), b"")))
    begin = head.find(b"<AppendedData")
    end = head.find(b">", begin) + 1 if begin >= 0 else 0
    marker = head.find(b"_", end) if end else -1
    return head[:end] if end else head, marker + 1 if marker >= 0 else None, int(min(size, most))


def read_header(path: str, *, lines: bool = False) -> Header:
    """Read the header of a ``.vtp`` or ``.vtu`` file, of its points, and check that the file is as long as it says.

    Where `lines` are wanted and cells have arrays, rows are lines, and the arrays belong to cells.

    Only the first kilobytes are read where data are appended; files with values in the XML (old ASCII output)
    are scanned as a whole, because the names of their arrays are spread over them.

    Raises
    ------
    SceneError
        If this is not VTK PolyData of one piece, or shorter than promised; or lines are wanted, and there are
        cells of other kinds beside them.
    """
    data, body, size = _text(path)
    xml = _parsed(path, data, "PolyData", "UnstructuredGrid")
    pieces = xml.named("Piece")
    of_lines = lines and len(pieces) == 1 and _has_lines(xml, pieces[0], path)
    there = [name in xml.complete for name in ("Points", "PointData")]
    if len(pieces) != 1 or not there[0] or (not there[1] and xml.named("PointData")):
        raise SceneError(
            f"{path}: its header has {len(pieces)} pieces and {sum(there)} of the two sections Points and PointData, "
            "expected one piece with both; the file was cut short, or is not by MFiX"
        )
    encoding = _encoding(xml.elements[0].attributes, path)
    counted, sections = (
        ("NumberOfLines", ["CellData"]) if of_lines else ("NumberOfPoints", ["Points", "PointData"])
    )
    rows = _whole(pieces[0].get(counted), counted, path)
    tags = [element for section in sections for element in xml.arrays(section)]
    form = next((tag.get("encoding", "raw") for tag in xml.named("AppendedData")), "")
    if any(tag.attributes.get("format") == "appended" for tag in tags) and (
        form not in ("raw", "base64") or not body
    ):
        raise SceneError(
            f"{path}: its header names appended data, but none follows; it was cut short, leave it out"
        )
    arrays = tuple(_array(tag, path, xml, (form, body or 0, size)) for tag in tags)
    if not of_lines and (not arrays or arrays[0].components != 3):
        raise SceneError(
            f"{path}: its points have no array with three components; the file is not by MFiX, or damaged"
        )
    fields = {
        _utf8(tag.attributes.get("Name", "")): _numbers(xml.content(tag))
        for tag in xml.arrays("FieldData")
    }
    time = next((_time(found[1]) for found in map(_TIME.match, xml.comments) if found), None)
    header = Header(path, os.path.getsize(path), rows, time, arrays, encoding, fields, of_lines)
    for array in arrays:
        _check_size(header, array)
    return header


def _has_lines(xml: _Xml, piece: dict[str, str], path: str) -> bool:
    """Return whether the arrays of cells belong to lines (perhaps none); False without arrays."""
    if not xml.arrays("CellData"):
        return False
    lines = _whole(piece.get("NumberOfLines", "0"), "NumberOfLines", path)
    others = [
        kind
        for kind in _OTHER_CELLS
        if _whole(piece.get(f"NumberOf{kind}", "0"), f"NumberOf{kind}", path)
    ]
    if lines and others:
        raise SceneError(
            f"{path}: holds {' and '.join(others)} beside Lines; write the contacts, as lines, to files of their own"
        )
    return not others


def _numbers(text: bytes) -> tuple[float, ...]:
    """Numbers of a text; none if it holds anything else."""
    try:
        return tuple(float(token) for token in text.split())
    except ValueError:
        return ()


def _encoding(root: dict[str, str], path: str) -> VtkEncoding:
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    compressor = root.get("compressor", "")
    if compressor and compressor not in COMPRESSORS:
        raise SceneError(
            f"{path}: is compressed by {compressor[:60]!r}; expected one of {', '.join(COMPRESSORS)}"
        )
    return VtkEncoding(
        order, np.dtype(f"{order}u{8 if root.get('header_type') == 'UInt64' else 4}"), compressor
    )


def _time(text: str) -> float | None:
    try:
        time = float(text.lower().replace("d", "e"))  # Fortran may write 0.1D+00
    except ValueError:
        return None
    return time if np.isfinite(time) else None


def _array(element: _Element, path: str, xml: _Xml, appended: tuple[str, int, int]) -> Array:
    """Describe one array; `appended` are form, start and end of the appended data."""
    tag = element.attributes
    name = _utf8(tag.get("Name", "Points"))
    kind, form, body = tag.get("type", ""), *appended[:2]
    if kind not in _TYPES:
        raise SceneError(
            f"{path}: array '{name}' has type {kind!r}; expected one of {sorted(_TYPES)}"
        )
    components = _whole(tag.get("NumberOfComponents", "1"), f"NumberOfComponents of '{name}'", path)
    if not 1 <= components <= _MOST_COMPONENTS:
        raise SceneError(
            f"{path}: '{name}' has {components} components; expected 1 to {_MOST_COMPONENTS}. Leave the file out"
        )
    if tag.get("format") == "appended":
        offset = _whole(tag.get("offset"), f"the offset of '{name}'", path)
        return Array(name, components, kind, form, body + offset, appended[2])
    text = xml.content(element)
    start, stop = element.start + len(text) - len(text.lstrip()), element.start + len(text)
    return Array(
        name, components, kind, "base64" if tag.get("format") == "binary" else "ascii", start, stop
    )


def _type(header: Header, array: Array) -> np.dtype[np.generic]:
    return np.dtype(header.encoding.order + _TYPES[array.kind])


def _check_size(header: Header, array: Array) -> None:
    """Compare what the header promises with the bytes that there are."""
    values, room = header.rows * array.components, max(0, array.stop - array.start)
    needed = 2 * values - 1 if array.form == "ascii" else values * _type(header, array).itemsize
    there = (
        room
        if array.form == "ascii"
        else header.encoding.room(room * 3 // 4 if array.form == "base64" else room)
    )
    if needed > there:
        raise SceneError(
            f"{header.path}: its header promises {header.what}, for which '{array.name}' needs {needed} "
            f"bytes, but {there} follow in the {array.stop} of the file; it was cut short, or is still being "
            "written. Leave it out, or write it again"
        )


def read_arrays(header: Header, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Read arrays of one file by name.

    Parameters
    ----------
    header : Header
        What `read_header` returned.
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
    result: dict[str, NDArray[np.float64]] = {}
    with open_binary(
        header.path
    ) as file:  # once, as a compressed file can be read from the front only
        for array in header.arrays:
            if array.name not in names or array.name in result:
                continue
            shape = (header.rows, array.components) if array.components > 1 else (header.rows,)
            try:
                result[array.name] = _read(file, header, array).reshape(shape)
            except DataError as error:
                raise SceneError(
                    f"{header.path}: '{array.name}' is not as its header says, which promises {header.what}: "
                    f"{error}; leave the file out, or write it again"
                ) from None
    return result


def _read(file: BinaryIO, header: Header, array: Array) -> NDArray[np.float64]:
    count = header.rows * array.components
    if not count:
        return np.empty(0)
    if array.form == "ascii":
        file.seek(array.start)
        return parse_text(file.read(array.stop - array.start), array.kind, count)
    read = read_base64 if array.form == "base64" else read_raw
    return read(file, array.start, header.encoding, _type(header, array), count)


def read_collection(path: str) -> list[tuple[str, float | None]]:
    """List the files that a ``.pvd`` collection names, as (path, time), in its order.

    Raises
    ------
    SceneError
        If this is not a collection, it names nothing, or a time has several parts.
    """
    with open_binary(path) as file:
        xml = _parsed(path, file.read(_LONGEST_LIST), "Collection")
    entries, parts = [], dict[float | None, str]()
    for tag in xml.named("DataSet"):
        if tag.get("file") and "\0" not in tag["file"]:
            time, part = _time(tag.get("timestep", "")), tag.get("part", "0")
            entries.append((str(Path(path).parent / _utf8(tag["file"])), time))
            if parts.setdefault(time, part) != part:
                raise SceneError(
                    f"{path}: lists parts {parts[time]!r} and {part!r} of one time, {time} s; give a list or pattern "
                    "of the files of one part, or merge the parts of each time into one file"
                )
    if not entries:
        raise SceneError(
            f"{path}: it names no files; expected entries like <DataSet timestep=... file=.../>"
        )
    return entries
