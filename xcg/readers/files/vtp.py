"""VTK XML PolyData files and their collections, read without an XML parser and without VTK.

Headers are text of a known form: they are searched for their few tags, so that entities are never expanded. Every
count in them is held against the size of the file before anything is made for it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO
from xml.sax.saxutils import unescape

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.files.text import most_text, open_binary, uncompressed_size
from xcg.readers.files.vtkdata import COMPRESSORS, DataError, VtkEncoding, parse_text, read_base64, read_raw

_HEAD = 1 << 14  # headers of MFiX take 2 to 5 kB
_LONGEST_TAG = 4096
_LONGEST_LIST = 1 << 28  # bytes of a collection
_BLOCK = 1 << 20
_MOST_COMPONENTS = 100
_OTHER_CELLS = ("Cells", "Verts", "Strips", "Polys")
_TYPES = {f"{kind}{bits}": f"{letter}{bits // 8}" for kind, letter, all_bits in (
    ("Int", "i", (8, 16, 32, 64)), ("UInt", "u", (8, 16, 32, 64)), ("Float", "f", (32, 64)),
) for bits in all_bits}  # fmt: skip

_ATTRIBUTE = re.compile(r"(\w+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
_TIME = re.compile(r"<!--\s*Time\s*=\s*([-+.\deEdD]+)\s*s", re.IGNORECASE)


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
    field_names : tuple of str
        Names of the arrays that belong to no point.
    of_lines : bool
        Whether rows are lines.
    """

    path: str
    size: int
    rows: int
    time: float | None
    arrays: tuple[Array, ...]
    encoding: VtkEncoding
    field_names: tuple[str, ...] = ()
    of_lines: bool = False

    @property
    def what(self) -> str:
        """Number of rows, in words."""
        return f"{self.rows} {'lines' if self.of_lines else 'points'}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays; the first one of points is that of their coordinates."""
        return tuple(array.name for array in self.arrays)


def _attributes(tag: str) -> dict[str, str]:
    found = _ATTRIBUTE.findall(tag[:_LONGEST_TAG])
    return {key: unescape(a or b, {"&quot;": '"', "&apos;": "'"}) for key, a, b in found}


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


def _without_comments(text: str) -> str:
    """Replace comments by blanks, so that all offsets stay."""
    parts, at = [], 0
    while (start := text.find("<!--", at)) >= 0:
        end = text.find("-->", start + 4)
        end = len(text) if end < 0 else end + 3
        parts += [text[at:start], " " * (end - start)]
        at = end
    return "".join([*parts, text[at:]])


def _tags(text: str, name: str, start: int = 0, stop: int | None = None) -> Iterator[tuple[str, int]]:
    """Attributes of the tags of this name as text, and where each tag ends."""
    stop = len(text) if stop is None else stop
    while (start := text.find(f"<{name}", start, stop)) >= 0:
        end = text.find(">", start, stop)
        if end < 0:
            return
        inside = text[start + 1 + len(name) : end]
        if not inside or not (inside[0].isalnum() or inside[0] == "_"):
            yield inside, end + 1
        start = end


def _section(text: str, name: str) -> tuple[int, int] | None:
    """Return the start and end of the content of an element; None if it is missing or incomplete."""
    start = next((end for _, end in _tags(text, name)), -1)
    end = text.find(f"</{name}>", start) if start >= 0 else -1
    return (start, end) if end >= 0 else None


def _refuse(path: str, text: str, *kinds: str) -> None:
    """Raise SceneError unless this is VTK XML of one of these kinds, without entities."""
    root = next((attributes for attributes, _ in _tags(text, "VTKFile")), None)
    found = None if root is None else _attributes(root).get("type")
    if found not in kinds:
        what = "no VTK XML file" if root is None else f"VTK data of type {found!r}"
        raise SceneError(f"{path}: expected VTK XML of type '{kinds[0]}', but this is {what}")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise SceneError(f"{path}: declares a document type or entities, which VTK files never need; it is not read")


def _nested(text: str) -> bool:
    """Return whether every element is closed in order; `VTKFile` may stay open before appended data."""
    opened: list[str] = []
    at = 0
    while (at := text.find("<", at)) >= 0:
        end = text.find(">", at)
        tag = text[at + 1 : end] if end >= 0 else ""
        if not tag.strip():
            return False
        if tag[0] == "/":
            if not opened or opened.pop() != tag[1:].strip():
                return False
        elif tag[0] not in "?!" and tag[-1] != "/":
            opened.append(tag.split(None, 1)[0])
        at = end
    return opened in ([], ["VTKFile"])


def _text(path: str) -> tuple[str, str | None, int | None, int]:
    """Text before the appended data, their encoding (None without any), where they start, size of it all unpacked."""
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
    size = int(min(size, most))
    text, tag, rest = head.partition(b"<AppendedData")
    opening = rest.partition(b">")[0]
    encoding = _attributes(opening.decode("latin-1")).get("encoding", "raw") if tag else None
    marker = head.find(b"_", len(text) + len(tag) + len(opening)) if tag else -1
    return text.decode("latin-1"), encoding, marker + 1 if marker >= 0 else None, size


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
    text, appended, body, size = _text(path)
    time = _TIME.search(text[:_LONGEST_TAG])
    text = _without_comments(text)
    _refuse(path, text, "PolyData", "UnstructuredGrid")
    root = _attributes(next(_tags(text, "VTKFile"))[0])
    pieces = [_attributes(attributes) for attributes, _ in _tags(text, "Piece")]
    of_lines = lines and len(pieces) == 1 and _has_lines(text, pieces[0], path)
    sections = [_section(text, "Points"), _section(text, "PointData")]
    if len(pieces) != 1 or sections[0] is None or (sections[1] is None and "<PointData" in text):
        raise SceneError(
            f"{path}: its header has {len(pieces)} pieces and {sum(s is not None for s in sections)} of the "
            "two sections Points and PointData, expected one piece with both; the file was cut short, or is "
            "not by MFiX"
        )
    if not _nested(text):
        raise SceneError(
            f"{path}: its XML is damaged: elements do not close in the order in which they open; leave the file out"
        )
    encoding = _encoding(root, path)
    counted, sections = ("NumberOfLines", [_section(text, "CellData")]) if of_lines else ("NumberOfPoints", sections)
    rows = _whole(pieces[0].get(counted), counted, path)
    tags = [(_attributes(tag), end) for s in sections if s for tag, end in _tags(text, "DataArray", *s)]
    if any(tag.get("format") == "appended" for tag, _ in tags) and (appended not in ("raw", "base64") or not body):
        raise SceneError(
            f"{path}: its header names appended data, but none follows; the file was cut short, leave it out"
        )
    arrays = tuple(_array(tag, path, text, end, (appended or "", body or 0, size)) for tag, end in tags)
    if not of_lines and (not arrays or arrays[0].components != 3):
        raise SceneError(f"{path}: its points have no array with three components; the file is not by MFiX, or damaged")
    section = _section(text, "FieldData")
    named = tuple(_attributes(tag).get("Name", "") for tag, _ in _tags(text, "DataArray", *section)) if section else ()
    clock = _time(time[1]) if time else None
    header = Header(path, os.path.getsize(path), rows, clock, arrays, encoding, named, of_lines)
    for array in arrays:
        _check_size(header, array)
    return header


def _has_lines(text: str, piece: dict[str, str], path: str) -> bool:
    """Return whether the arrays of cells belong to lines (perhaps none); False without arrays."""
    section = _section(text, "CellData")
    if section is None or not any(_tags(text, "DataArray", *section)):
        return False
    lines = _whole(piece.get("NumberOfLines", "0"), "NumberOfLines", path)
    others = [kind for kind in _OTHER_CELLS if _whole(piece.get(f"NumberOf{kind}", "0"), f"NumberOf{kind}", path)]
    if lines and others:
        raise SceneError(
            f"{path}: holds {' and '.join(others)} beside Lines; write the contacts, as lines, to files of their own"
        )
    return not others


def _encoding(root: dict[str, str], path: str) -> VtkEncoding:
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    compressor = root.get("compressor", "")
    if compressor and compressor not in COMPRESSORS:
        raise SceneError(f"{path}: is compressed by {compressor[:60]!r}; expected one of {', '.join(COMPRESSORS)}")
    return VtkEncoding(order, np.dtype(f"{order}u{8 if root.get('header_type') == 'UInt64' else 4}"), compressor)


def _time(text: str) -> float | None:
    try:
        time = float(text.lower().replace("d", "e"))  # Fortran may write 0.1D+00
    except ValueError:
        return None
    return time if np.isfinite(time) else None


def _array(tag: dict[str, str], path: str, text: str, end: int, appended: tuple[str, int, int]) -> Array:
    """Describe one array; `end` is where its tag ends, `appended` are form, start and end of the appended data."""
    name = tag.get("Name", "Points").encode("latin-1", "replace").decode("utf-8", "replace")
    kind, form, body = tag.get("type", ""), *appended[:2]
    if kind not in _TYPES:
        raise SceneError(f"{path}: array '{name}' has type {kind!r}; expected one of {sorted(_TYPES)}")
    components = _whole(tag.get("NumberOfComponents", "1"), f"NumberOfComponents of '{name}'", path)
    if not 1 <= components <= _MOST_COMPONENTS:
        raise SceneError(
            f"{path}: '{name}' has {components} components; expected 1 to {_MOST_COMPONENTS}. Leave the file out"
        )
    if tag.get("format") == "appended":
        offset = _whole(tag.get("offset"), f"the offset of '{name}'", path)
        return Array(name, components, kind, form, body + offset, appended[2])
    form = "base64" if tag.get("format") == "binary" else "ascii"
    stop = text.find("<", end)
    stop = len(text) if stop < 0 else stop
    blanks = len(text[end:stop]) - len(text[end:stop].lstrip())
    return Array(name, components, kind, form, end + blanks, stop)


def _type(header: Header, array: Array) -> np.dtype[np.generic]:
    return np.dtype(header.encoding.order + _TYPES[array.kind])


def _check_size(header: Header, array: Array) -> None:
    """Compare what the header promises with the bytes that there are."""
    values, room = header.rows * array.components, max(0, array.stop - array.start)
    needed = 2 * values - 1 if array.form == "ascii" else values * _type(header, array).itemsize
    there = room if array.form == "ascii" else header.encoding.room(room * 3 // 4 if array.form == "base64" else room)
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
    with open_binary(header.path) as file:  # once, as a compressed file can be read from the front only
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
        If this is not a collection, or it names nothing.
    """
    with open_binary(path) as file:
        text = _without_comments(file.read(_LONGEST_LIST).decode("utf-8", "replace"))
    _refuse(path, text, "Collection")
    entries = []
    for tag in (_attributes(tag) for tag, _ in _tags(text, "DataSet")):
        if tag.get("file") and "\0" not in tag["file"]:
            entries.append((str(Path(path).parent / tag["file"]), _time(tag.get("timestep", ""))))
    if not entries:
        raise SceneError(
            f"{path}: this collection names no files; expected entries like <DataSet timestep=... file=.../>"
        )
    return entries
