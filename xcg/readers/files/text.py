"""Text files, plain or compressed: lines, blocks, the bytes of a step; decompressed once."""

from __future__ import annotations

import gzip
import importlib
import math
import os
import threading
import zlib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from typing import Any, BinaryIO, TypeAlias, cast

from isal import igzip, isal_zlib

from xcg.common.messages import SceneError
from xcg.compiled.text import BEYOND
from xcg.readers.engine import StepRef

_FIRST_BLOCK = 1 << 16  # bytes; often the header is all that is wanted
_BLOCK = 1 << 22
# bytes; a file of one endless line (or a few compressed kilobytes of one) is no text
_LONGEST_LINE = 1 << 20
_TEXT = 50  # tables of numbers shrink to a fifth, and never to a fiftieth
_SLACK = 1 << 26  # bytes that any compressed text may have
_MOST_BLANK = 10_000  # blank lines in succession
# bytes that a header may promise too much; rows missing from small files are named on reading
_SMALL = 1 << 20
PIECE = 1 << 17  # bytes of text that stay in the processor's cache while they are parsed
_BLANK = b"\n" * BEYOND
_LONGEST_VALUE = 64  # bytes of one number and the space before it


@contextmanager
def open_binary(path: str, offset: int | None = None) -> Iterator[BinaryIO]:
    """Open a file for reading bytes, decompressed if it is compressed by its content.

    Parameters
    ----------
    offset : int, optional
        Where to begin, in a file that is read step after step; see `forward`.

    Raises
    ------
    SceneError
        While it is open, if the compressed data are damaged or end early.
    """
    kind = compression(path)
    try:
        with ExitStack() as stack:
            if not kind:
                stream: BinaryIO = stack.enter_context(open(path, "rb"))
            elif offset is None:
                stream = stack.enter_context(open_compressed(path, kind))
            else:
                stream = stack.enter_context(forward(path, offset))
            if offset:
                stream.seek(offset)
            yield stream
    except errors() as error:
        raise SceneError(
            f"{path}: its compressed data are damaged or cut off ({error}); "
            "leave the file out, or write it again"
        ) from None


def most_text(path: str) -> float:
    """Return the most bytes of text in a table of numbers of this size; no limit unless compressed.

    More would only fill memory.
    """
    if not compression(path):
        return math.inf
    return os.path.getsize(path) * _TEXT + _SLACK


def check_rows(ref: StepRef, room: int | None = None) -> None:
    """Raise SceneError for a header with more rows than its bytes can hold.

    It is called before memory is allocated for them.

    Parameters
    ----------
    room : int, optional
        Bytes that the rows have, at most; by default all that can come out of the file after the
        header.

    Raises
    ------
    SceneError
        If there are far fewer bytes than a digit and a space for each value.
    """
    if room is None:
        kind = compression(ref.path)
        most_a_byte = 1
        if kind:
            most_a_byte = _KINDS[kind][1]
        room = os.path.getsize(ref.path) * most_a_byte - ref.offset
    if 2 * ref.rows * len(ref.columns) > room + _SMALL:
        raise SceneError(
            f"{source_of(ref)}: its header promises {ref.rows} rows of {len(ref.columns)} values, "
            f"but only {room} bytes follow; the file was cut short or is damaged. "
            "Leave it out, or write it again"
        )


def first_lines(path: str, size: int = 1 << 16) -> list[str]:
    """Return the first lines of a file, to recognise it by; empty where it is not text."""
    with scanned(path) as scanner:
        head = scanner.sample(size)
    return [] if b"\0" in head else head.decode("utf-8", "replace").splitlines()


class Scanner:
    """Lines and blocks of the stream of a file, read once from front to back.

    `offset` counts the (decompressed) bytes handed out so far. More than `most_text` raise
    SceneError.
    """

    def __init__(self, stream: BinaryIO, path: str) -> None:
        self._stream = stream
        self._name = path
        self._most = most_text(path)
        self._data = b""  # read from the stream
        self._at = 0  # offset in it of the next byte
        self._blank = 0  # blank lines since the last other one
        self._block = _FIRST_BLOCK
        self.offset = 0

    def _more(self) -> bool:
        """Read a block, and return whether there was one."""
        try:
            block = self._stream.read(self._block)
        except EOFError:
            block = _up_to_the_cut(self._name, self.offset + len(self._data) - self._at)
            if not block:
                raise
        self._data = self._data[self._at :] + block
        self._at = 0
        self._block = _BLOCK
        return bool(block)

    def _take(self, end: int) -> bytes:
        taken = self._data[self._at : end]
        self._at = end
        self.offset += len(taken)
        if self.offset > self._most:
            raise SceneError(
                f"{self._name}: its compressed bytes stand for more than {self._most:.3g}; "
                "it is no table of numbers"
            )
        return taken

    def line(self) -> bytes:
        """Return the next line with its end, or nothing at the end of the stream."""
        while (end := self._data.find(b"\n", self._at)) < 0:
            if len(self._data) - self._at > _LONGEST_LINE:
                raise SceneError(
                    f"{self._name}: no end of a line in {_LONGEST_LINE} bytes after byte "
                    f"{self.offset}; it is no text"
                )
            if not self._more():
                return self._take(len(self._data))
        self._blank += 1
        if self._data[self._at : end].strip():
            self._blank = 0
        if self._blank > _MOST_BLANK:
            raise SceneError(
                f"{self._name}: more than {_MOST_BLANK} lines before byte {self.offset} are blank; "
                "the file is damaged"
            )
        return self._take(end + 1)

    def until(self, marker: bytes) -> Iterator[bytes]:
        """Yield the lines before the next one that begins with `marker`, in pieces (some empty)."""
        while len(self._data) - self._at < len(marker) and self._more():
            pass
        if self._data.startswith(marker, self._at):
            return
        needle = b"\n" + marker
        while (end := self._data.find(needle, self._at)) < 0:
            # a marker may straddle two blocks
            yield self._take(max(self._at, len(self._data) - len(marker)))
            if not self._more():
                yield self._take(len(self._data))
                return
        yield self._take(end + 1)

    def block(self, size: int) -> bytes:
        """Return the next bytes, nothing at the end of the stream."""
        while len(self._data) - self._at < size and self._more():
            pass
        return self._take(min(len(self._data), self._at + size))

    def sample(self, size: int) -> bytes:
        """Return bytes ahead without taking them."""
        if len(self._data) - self._at < size:
            self._more()
        return self._data[self._at : self._at + size]


@contextmanager
def scanned(path: str) -> Iterator[Scanner]:
    """Open a file, compressed or not, to read its lines."""
    with open_binary(path) as stream:
        yield Scanner(stream, path)


def body_of(ref: StepRef) -> Iterator[bytes]:
    """Yield the bytes of one step's body, in pieces.

    Raises
    ------
    SceneError
        If it is longer than its rows can be, as where a few compressed kilobytes expand to
        gigabytes, or more follows it than was known.
    """
    most = _LONGEST_VALUE * (ref.rows + 1) * (len(ref.columns) + 1) + _BLOCK
    if ref.length < 0 or (ref.rows and ref.length > most):
        raise SceneError(
            f"{source_of(ref)}: {ref.length} bytes follow a header that promises {ref.rows} rows "
            f"of {len(ref.columns)} values; the file is damaged. Leave it out, or write it again"
        )
    with open_binary(ref.path, ref.offset) as stream:
        missing = ref.length
        # read() may read on to where a file is cut off, after the last whole step
        while missing > 0 and (piece := cast(Any, stream).read1(min(missing, PIECE))):
            missing -= len(piece)
            yield piece
        if ref.alone and stream.read(1):
            raise SceneError(
                f"{source_of(ref)}: more follows what was taken for the only step of the file, as "
                "where gzipped files were put one after the other; give the file a name without "
                "the number of the step, and it is read through"
            )


def whole_lines(pieces: Iterable[bytes], name: str) -> Iterator[bytes]:
    """Move the ends of pieces of a text to the ends of lines, and add `BEYOND` blank lines to each.

    Raises
    ------
    SceneError
        If a line is too long for any text; `name` is that of the file.
    """
    begun: list[bytes] = []  # a line that goes on
    for piece in pieces:
        end = piece.rfind(b"\n") + 1
        if end:
            yield b"".join([*begun, memoryview(piece)[:end], _BLANK])
            begun.clear()
        begun.append(piece[end:])
        if sum(map(len, begun)) > _LONGEST_LINE:
            raise SceneError(
                f"{name}: a line has no end in {_LONGEST_LINE} bytes; the file is damaged, "
                "leave it out"
            )
    yield b"".join([*begun, _BLANK])


def source_of(ref: StepRef) -> str:
    """File and step, for messages; the file alone where the step is unknown."""
    source = ref.path
    if ref.pieces:
        source += f" and {len(ref.pieces) - 1} more"
    if ref.step >= 0:
        source += f" (step {ref.step})"
    return source


# --- compressed files -----------------------------------------------------------------------------
#
# Gzip and Zstandard can be read from the front only. Reading step after step would decompress the
# file anew up to each of them, which takes a time that grows with the square of their number; a
# file still open at an earlier step goes on from there.


# the first bytes, and how many bytes one can stand for: deflate repeats 258, Zstandard 128 KiB in a
# block of four bytes
_KINDS = {"gzip": (b"\x1f\x8b", 1032), "zstd": (b"\x28\xb5\x2f\xfd", 1 << 15)}
ENDINGS = (".gz", ".zst")  # of the names of compressed files
_MOST_WAITING = 8  # open files; each thread that reads a series keeps one
_SAMPLE = 1 << 16  # bytes of a file that its size is estimated from
_MOST_OF_SAMPLE = 1 << 24  # bytes that they may expand to
_UNEVEN = 1.2  # parts of one table are compressed alike, to this factor
_Key: TypeAlias = tuple[str, int, int]  # path, size, time of modification
_waiting: list[tuple[_Key, BinaryIO]] = []  # last used last
_lock = threading.Lock()


def compression(path: str) -> str:
    """Return "gzip" or "zstd" by the first bytes of a file, "" for any other."""
    with open(path, "rb") as file:
        head = file.read(4)
    return next((kind for kind, (magic, _) in _KINDS.items() if head.startswith(magic)), "")


def plain_name(path: str) -> str:
    """Name of a file without the ending of its compression, if it has one."""
    name = os.path.basename(path)
    if name.lower().endswith(ENDINGS):
        name = name[: name.rindex(".")]
    return name


@cache
def _zstd() -> Any:
    """Return the standard library's module from Python 3.14 on, else its backport, else None."""
    for name in ("compression.zstd", "backports.zstd"):
        with suppress(ModuleNotFoundError):
            return importlib.import_module(name)
    return None


def errors() -> tuple[type[Exception], ...]:
    """Exceptions that mean damaged or cut off data."""
    kinds: list[Any] = [EOFError, zlib.error, gzip.BadGzipFile, isal_zlib.IsalError]
    zstd = _zstd()
    if zstd is not None:
        kinds.append(zstd.ZstdError)
    return tuple(kinds)


def open_compressed(path: str, kind: str = "") -> BinaryIO:
    """Open a compressed file for reading its decompressed bytes.

    Parameters
    ----------
    kind : str
        From `compression`, if it is known.

    Raises
    ------
    SceneError
        If the package that decompresses it is not installed.
    """
    if (kind or compression(path)) == "gzip":
        return cast(BinaryIO, igzip.open(path, "rb"))
    zstd = _zstd()
    if zstd is None:
        raise SceneError(
            f"{path}: to unpack Zstandard's files, Python before 3.14 needs a package; "
            "pip install 'xcg[zstd]'"
        )
    return cast(BinaryIO, zstd.open(path, "rb"))


def _up_to_the_cut(path: str, offset: int) -> bytes:
    """Return the last bytes of a file that ends early, from an offset on; igzip drops them."""
    pieces: list[bytes] = []
    unpack: Any = gzip.open if compression(path) == "gzip" else open_compressed
    with unpack(path) as stream, suppress(EOFError):
        stream.seek(offset)
        while piece := stream.read1(PIECE):
            pieces.append(piece)
    return b"".join(pieces)


def uncompressed_size(path: str) -> int:
    """Size of what `open_binary` yields; -1 where a compressed file does not state it.

    The last bytes of a gzipped file hold the size of its last member, modulo 4 GiB. This is the
    size of all if the first member ends at the end of the file, or else if the size agrees with
    how far the first bytes are compressed.
    """
    kind = compression(path)
    size = os.path.getsize(path)
    if not kind:
        return size
    if kind != "gzip":
        return -1
    with open(path, "rb") as file:
        head = file.read(_SAMPLE)
        file.seek(max(0, size - 4))
        of_last_member = int.from_bytes(file.read(4), "little")
    member = isal_zlib.decompressobj(31)
    try:
        expanded = len(member.decompress(head, _MOST_OF_SAMPLE))
    except errors():
        return -1
    taken = len(head) - len(member.unconsumed_tail) - len(member.unused_data)
    if member.eof:
        is_only_member = taken == size
    else:
        is_only_member = expanded * size <= _UNEVEN * of_last_member * taken
    return of_last_member if is_only_member else -1


def _ended(stream: BinaryIO) -> bool:
    """Return whether nothing more can be read."""
    try:
        return not cast(Any, stream).peek(1)
    except errors():
        return True


@contextmanager
def forward(path: str, offset: int) -> Iterator[BinaryIO]:
    """Open a compressed file at or before an offset; keep it for the next step if more follows."""
    state = os.stat(path)
    key = (path, state.st_size, state.st_mtime_ns)
    stream = _take(key, offset) or open_compressed(path)
    try:
        yield stream
    except BaseException:
        stream.close()
        raise
    if _ended(stream):
        stream.close()
        return
    with _lock:
        _waiting.append((key, stream))
        surplus = [_waiting.pop(0) for _ in range(len(_waiting) - _MOST_WAITING)]
    for _, unused in surplus:
        unused.close()


def _take(key: _Key, offset: int) -> BinaryIO | None:
    """Return the waiting file with the largest position before an offset; or None."""
    with _lock:
        ready = [entry for entry in _waiting if entry[0] == key and entry[1].tell() <= offset]
        if not ready:
            return None
        nearest = max(ready, key=lambda entry: entry[1].tell())
        _waiting.remove(nearest)
        return nearest[1]
