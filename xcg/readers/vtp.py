"""VTK XML PolyData files and their collections: headers as text, bodies through VTK's own reader.

VTK trusts headers: one that promises more points than the file holds ends in an error on the console and an
empty mesh, and one that promises fewer drops points without a word. So headers are checked here against the
size of the file and of its blocks, before VTK sees the file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from xml.sax.saxutils import unescape

import numpy as np
from numpy.typing import NDArray

from xcg.schema import SceneError

_HEAD = 1 << 14  # headers of MFiX take 2 to 5 kB
_SIZES = {f"{kind}{bits}": bits // 8 for kind in ("Int", "UInt", "Float") for bits in (8, 16, 32, 64)}

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_ATTRIBUTE = re.compile(r"(\w+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
_TIME = re.compile(r"<!--\s*Time\s*=\s*([-+.\deEdD]+)\s*s", re.IGNORECASE)


@dataclass(frozen=True)
class Array:
    """One array as the header describes it; `offset` is None where its values stand in the XML itself."""

    name: str
    components: int
    itemsize: int
    offset: int | None


@dataclass(frozen=True)
class Header:
    """What stands before the data of one file.

    Attributes
    ----------
    path : str
        The file.
    size : int
        Its size in bytes.
    points : int
        Number of points.
    time : float or None
        Physical time (s) from the comment that MFiX writes.
    arrays : tuple of Array
        The coordinates of the points, then the arrays of point data.
    body : int or None
        Byte where raw appended data starts; None for other encodings, whose sizes VTK checks itself.
    prefix : numpy.dtype
        Type of the number of bytes that precedes each raw block.
    """

    path: str
    size: int
    points: int
    time: float | None
    arrays: tuple[Array, ...]
    body: int | None
    prefix: np.dtype[Any]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays; the first one is that of the points."""
        return tuple(array.name for array in self.arrays)


def _attributes(tag: str) -> dict[str, str]:
    return {key: unescape(a or b, {"&quot;": '"', "&apos;": "'"}) for key, a, b in _ATTRIBUTE.findall(tag)}


def _whole(text: str | None, what: str, path: str) -> int:
    try:
        number = int(text or "")
    except ValueError:
        number = -1
    if number < 0:
        msg = f"{path}: {what} is {text!r} in its header; expected a whole number. Leave the file out"
        raise SceneError(msg)
    return number


def _refuse(path: str, text: str, kind: str) -> None:
    """Refuse what is not VTK XML of this kind, and documents with entities."""
    root = re.search(r"<VTKFile\b([^>]*)>", text)
    found = _attributes(root[1]).get("type") if root else None
    if found != kind:
        what = f"VTK data of type {found!r}" if root else "no VTK XML file"
        msg = f"{path}: expected VTK XML of type '{kind}', but this is {what}"
        raise SceneError(msg)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        msg = f"{path}: declares a document type or entities, which VTK files never need; it is not read"
        raise SceneError(msg)


def _text(path: str) -> tuple[str, str | None, int | None, int]:
    """Text before the appended data, their encoding (None without any), where raw ones start, file size."""
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(_HEAD)
        while b"<AppendedData" not in head[:-256] and b"<VTKFile" in head and (more := file.read(len(head))):
            head += more
    text, tag, rest = head.partition(b"<AppendedData")
    opening = rest.partition(b">")[0]
    encoding = _attributes(opening.decode("latin-1")).get("encoding", "raw") if tag else None
    marker = head.find(b"_", len(text) + len(tag) + len(opening)) if encoding == "raw" else -1
    return text.decode("utf-8", "replace"), encoding, marker + 1 if marker >= 0 else None, size


def read_header(path: str) -> Header:
    """Read the header of a ``.vtp`` file and check that the file is as long as it says.

    Only the first kilobytes are read where data are appended; files with values in the XML (old ASCII output)
    are scanned as a whole, because the names of their arrays are spread over them.

    Raises
    ------
    SceneError
        If this is no VTK PolyData of one piece, or shorter than its header promises.
    """
    text, encoding, body, size = _text(path)
    time = _TIME.search(text)
    text = _COMMENT.sub("", text)
    _refuse(path, text, "PolyData")
    file = _attributes(text[text.index("<VTKFile") : text.index(">", text.index("<VTKFile"))])
    pieces = re.findall(r"<Piece\b([^>]*)>", text)
    sections = [re.search(rf"<{s}\b[^>]*>(.*?)</{s}>", text, re.DOTALL) for s in ("Points", "PointData")]
    if len(pieces) != 1 or sections[0] is None or (sections[1] is None and "<PointData" in text):
        msg = (
            f"{path}: its header has {len(pieces)} pieces and {sum(s is not None for s in sections)} of the "
            "two sections Points and PointData, expected one piece with both; the file was cut short, or is "
            "not by MFiX"
        )
        raise SceneError(msg)
    points = _whole(_attributes(pieces[0]).get("NumberOfPoints"), "NumberOfPoints", path)
    tags = [_attributes(tag) for s in sections if s for tag in re.findall(r"<DataArray\b([^>]*)>", s[1])]
    arrays = tuple(_array(tag, path) for tag in tags)
    if not arrays or arrays[0].components != 3:
        msg = f"{path}: its points have no array with three components; the file is not by MFiX, or damaged"
        raise SceneError(msg)
    order = ">" if file.get("byte_order") == "BigEndian" else "<"
    prefix = np.dtype(f"{order}u{8 if file.get('header_type') == 'UInt64' else 4}")
    nothing_follows = encoding is None or (encoding == "raw" and body is None)
    if nothing_follows and any(array.offset is not None for array in arrays):
        msg = f"{path}: its header names appended data, but none follows; the file was cut short, leave it out"
        raise SceneError(msg)
    body = None if "compressor" in file else body
    header = Header(path, size, points, _time(time[1]) if time else None, arrays, body, prefix)
    _check_size(header)
    return header


def _time(text: str) -> float | None:
    try:
        return float(text.lower().replace("d", "e"))  # Fortran may write 0.1D+00
    except ValueError:
        return None


def _array(tag: dict[str, str], path: str) -> Array:
    name = tag.get("Name", "Points")
    kind = tag.get("type", "")
    if kind not in _SIZES:
        msg = f"{path}: array '{name}' has type {kind!r}; expected one of {sorted(_SIZES)}"
        raise SceneError(msg)
    offset = None
    if tag.get("format") == "appended":
        offset = _whole(tag.get("offset"), f"the offset of '{name}'", path)
    components = _whole(tag.get("NumberOfComponents", "1"), f"NumberOfComponents of '{name}'", path)
    return Array(name, components, _SIZES[kind], offset)


def _bytes(header: Header, array: Array) -> int:
    return header.points * array.components * array.itemsize


def _check_size(header: Header) -> None:
    if header.body is None:
        return
    ends = [a.offset + header.prefix.itemsize + _bytes(header, a) for a in header.arrays if a.offset is not None]
    needed = header.body + max(ends, default=0)
    if needed > header.size:
        msg = (
            f"{header.path}: its header promises {header.points} points, which need {needed} bytes, but the "
            f"file has {header.size}; it was cut short, or is still being written. Leave it out, or write it "
            "again"
        )
        raise SceneError(msg)


def _check_blocks(header: Header, file: BinaryIO, arrays: Sequence[Array]) -> None:
    """Compare the number of points with the length that stands before each raw block, or with the text."""
    problem = ""
    for array in arrays:
        if header.body is not None and array.offset is not None:
            file.seek(header.body + array.offset)
            found = int(np.frombuffer(file.read(header.prefix.itemsize), header.prefix)[0])
            if found != _bytes(header, array):
                problem = f"the block of '{array.name}' holds {found} bytes, not {_bytes(header, array)}"
                break
    points = header.arrays[0]
    if points.offset is None:
        file.seek(0)
        inner = re.search(rb'<Points>\s*<DataArray\b([^>]*format="ascii"[^>]*)>([^<]*)<', file.read())
        if inner and len(inner[2].split()) != 3 * header.points:
            problem = f"'{points.name}' holds {len(inner[2].split())} numbers, not {3 * header.points}"
    if problem:
        msg = f"{header.path}: its header promises {header.points} points, but {problem}; leave the file out"
        raise SceneError(msg)


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
    wanted = [array for array in header.arrays if array.name in set(names)]
    if header.points == 0:
        return {a.name: np.empty((0, a.components) if a.components > 1 else 0) for a in wanted}
    with open(header.path, "rb") as file:
        _check_blocks(header, file, wanted)
    from vtkmodules.util.numpy_support import vtk_to_numpy

    mesh, errors = _through_vtk(header, [array.name for array in wanted])
    data, coordinates = mesh.GetPointData(), mesh.GetPoints()
    result = {}
    for array in wanted:
        points = array is header.arrays[0]
        parsed = (coordinates and coordinates.GetData()) if points else data.GetArray(array.name)
        if errors or parsed is None or parsed.GetNumberOfTuples() != header.points:
            found = 0 if parsed is None else parsed.GetNumberOfTuples()
            why = errors[0] if errors else f"'{array.name}' has {found} rows of {header.points}"
            msg = f"{header.path}: VTK cannot read it ({why}); leave the file out, or write it again"
            raise SceneError(msg)
        result[array.name] = vtk_to_numpy(parsed).astype("float64")
    return result


def _through_vtk(header: Header, names: Sequence[str]) -> tuple[Any, list[str]]:
    """Mesh and error messages from VTK's reader, with nothing printed."""
    from vtkmodules.util.misc import calldata_type
    from vtkmodules.util.vtkConstants import VTK_STRING
    from vtkmodules.vtkCommonCore import vtkCallbackCommand
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

    errors: list[str] = []

    @calldata_type(VTK_STRING)
    def listen(_caller: Any, _event: str, text: str) -> None:
        errors.append(" ".join(text.split("): ")[-1].split()))

    reader = vtkXMLPolyDataReader()
    # Three objects complain: the reader, its parser (which takes a vtkCommand only; an empty one is silent,
    # and the reader repeats what matters) and its executive. Without an observer each prints to the console.
    silent = vtkCallbackCommand()
    reader.SetParserErrorObserver(silent)
    reader.AddObserver("ErrorEvent", listen)
    reader.GetExecutive().AddObserver("ErrorEvent", listen)
    reader.SetFileName(header.path)
    reader.UpdateInformation()
    if not errors:
        selection = reader.GetPointDataArraySelection()
        selection.DisableAllArrays()
        for name in names:
            selection.EnableArray(name)
        reader.Update()
    return reader.GetOutput(), errors


def read_collection(path: str) -> list[tuple[str, float | None]]:
    """List the files that a ``.pvd`` collection names, as (path, time), in its order.

    Raises
    ------
    SceneError
        If this is no collection, or it names nothing.
    """
    text = _COMMENT.sub("", Path(path).read_text(encoding="utf-8", errors="replace"))
    _refuse(path, text, "Collection")
    entries = []
    for tag in map(_attributes, re.findall(r"<DataSet\b([^>]*)>", text)):
        if "file" in tag:
            entries.append((str(Path(path).parent / tag["file"]), _time(tag.get("timestep", ""))))
    if not entries:
        msg = f"{path}: this collection names no files; expected entries like <DataSet timestep=... file=.../>"
        raise SceneError(msg)
    return entries
