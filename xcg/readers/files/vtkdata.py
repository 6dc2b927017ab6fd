"""The data arrays of VTK XML files, decoded without VTK: raw, base64 or text, compressed or not.

VTK's own reader allocates what a header promises before it looks for the data, and ends the
interpreter where that fails. Here the length that stands before every block is compared with the
number of values first, so that nothing larger than the file's own data is ever made.
"""

from __future__ import annotations

import binascii
import lzma
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO, TypeAlias

import numpy as np
import pybase64
from isal import isal_zlib
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.files.table import parse_table
from xcg.readers.files.text import errors

_LZ4 = "vtkLZ4DataCompressor"
# Bytes that one compressed byte can stand for, at most.
COMPRESSORS = {"vtkZLibDataCompressor": 1032, _LZ4: 256, "vtkLZMADataCompressor": 1 << 14}
_ONE_A_LINE = bytes.maketrans(b" \t\r\v\f", b"\n" * 5)

Data: TypeAlias = bytes | memoryview
Take: TypeAlias = Callable[[int, int], Data]  # some bytes of a block: from, count


@dataclass(frozen=True)
class VtkEncoding:
    """Encoding of the arrays of one file.

    Attributes
    ----------
    order : str
        Byte order, "<" or ">".
    prefix : numpy.dtype
        Type of the lengths that stand before data.
    compressor : str
        VTK's name of it; empty for none.
    """

    order: str
    prefix: np.dtype
    compressor: str

    def room(self, size: int) -> int:
        """Bytes of values that `size` bytes of the file can hold, at most."""
        return size * COMPRESSORS.get(self.compressor, 1)


class DataError(ValueError):
    """The data do not fit the header."""


def parse_text(text: bytes, kind: str, count: int) -> NDArray:
    """Parse numbers written in the XML itself, or in the text of a legacy file."""
    try:
        columns = parse_table(text.translate(_ONE_A_LINE), ["number"], ["number"], count, "")
    except SceneError:
        present = len(text.split())
        if present != count:
            raise DataError(f"it holds {present} numbers, not {count}") from None
        raise DataError("it holds something else than finite numbers") from None
    values = columns["number"]
    if kind == "Float32":
        with np.errstate(over="ignore"):  # infinity is refused where values are checked
            values = values.astype("float32").astype("float64")
    return values


def read_raw(
    file: BinaryIO, start: int, encoding: VtkEncoding, dtype: np.dtype, count: int
) -> NDArray:
    """Read a raw block of the appended data."""

    def take(first: int, number: int) -> bytes:
        file.seek(start + first)
        return file.read(number)

    return _values(take, take, encoding, dtype, count, lambda number: number)


def read_base64(
    file: BinaryIO, start: int, encoding: VtkEncoding, dtype: np.dtype, count: int
) -> NDArray:
    """Read a block in base64. Lengths of compressed blocks are encoded apart from the blocks themselves."""

    def text(first: int, number: int) -> Data:
        file.seek(start + first)
        try:
            return memoryview(pybase64.b64decode(file.read(_encoded(number)), validate=True))
        except binascii.Error:
            raise DataError("its base64 data are damaged") from None

    def decoded(first: int, number: int) -> Data:
        skip = first % 3
        return text(4 * (first // 3), skip + number)[skip : skip + number]

    def after(first: int, number: int) -> Data:
        return text(first, number)[:number]

    return _values(decoded, after, encoding, dtype, count, _encoded)


def _encoded(number: int) -> int:
    return 4 * -(-number // 3)


def _values(
    head: Take,
    data: Take,
    encoding: VtkEncoding,
    dtype: np.dtype,
    count: int,
    length: Callable[[int], int],
) -> NDArray:
    """Values of a block; `length` is that of so many bytes in the file."""
    wanted = count * dtype.itemsize
    if encoding.compressor:
        raw = _uncompressed(head, data, encoding, wanted, length)
    else:
        (size,) = _numbers(head(0, encoding.prefix.itemsize), encoding, 1)
        if size != wanted:
            raise DataError(f"its block holds {size} bytes, not {wanted}")
        raw = head(encoding.prefix.itemsize, wanted)
    if len(raw) != wanted:
        raise DataError(f"its block ends after {len(raw)} of {wanted} bytes")
    return np.frombuffer(raw, dtype).astype("float64")


def _numbers(raw: Data, encoding: VtkEncoding, count: int) -> list[int]:
    if len(raw) != count * encoding.prefix.itemsize:
        raise DataError("its block lies beyond the end of the file")
    return [int(number) for number in np.frombuffer(raw, encoding.prefix)]


def _uncompressed(
    head: Take, data: Take, encoding: VtkEncoding, wanted: int, length: Callable[[int], int]
) -> Data:
    """Join the compressed parts of a block: number, size and last size come first, then the size of each part."""
    width = encoding.prefix.itemsize
    number, size, last = _numbers(head(0, 3 * width), encoding, 3)
    if not number and not wanted:
        return b""
    whole = number - (last > 0)
    # parts of no size at all would be unpacked without a limit
    if not 0 < number <= wanted or whole * size + last != wanted or (whole and not size):
        raise DataError(f"its block holds {number} parts of {size} bytes, not {wanted} bytes")
    sizes = _numbers(head(3 * width, number * width), encoding, number)
    if sum(sizes) > encoding.room(wanted) + 4096:
        raise DataError(f"its block holds {sum(sizes)} compressed bytes for {wanted} bytes")
    packed = memoryview(data(length((3 + number) * width), sum(sizes)))
    parts = []
    at = 0
    for k, taken in enumerate(sizes):
        expected = size if k < whole else last
        part = _inflate(packed[at : at + taken], encoding.compressor, expected)
        if len(part) != expected:
            raise DataError(f"part {k} of its block does not unpack to {expected} bytes")
        parts.append(part)
        at += taken
    return b"".join(parts)


def _inflate(packed: memoryview, compressor: str, expected: int) -> bytes:
    """Unpack one part, to no more than the bytes expected."""
    if compressor == _LZ4:
        return _lz4(packed, expected)
    unpack: Any = lzma.LZMADecompressor()
    if compressor == "vtkZLibDataCompressor":
        unpack = isal_zlib.decompressobj()
    damaged: tuple[type[Exception], ...] = (*errors(), lzma.LZMAError)
    try:
        return bytes(unpack.decompress(packed, expected))
    except damaged:
        return b""


def _lz4(packed: memoryview, expected: int) -> bytes:
    """Unpack through VTK, which checks both lengths; the standard library has no LZ4."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkObject
    from vtkmodules.vtkIOCore import vtkLZ4DataCompressor

    if not packed or expected > COMPRESSORS[_LZ4] * len(packed):
        return b""
    shown = vtkObject.GetGlobalWarningDisplay()
    vtkObject.GlobalWarningDisplayOff()
    try:
        compressor: Any = vtkLZ4DataCompressor()
        values = compressor.Uncompress(np.frombuffer(packed, "u1"), len(packed), expected)
    finally:
        vtkObject.SetGlobalWarningDisplay(shown)
    return b"" if values is None else vtk_to_numpy(values).tobytes()
