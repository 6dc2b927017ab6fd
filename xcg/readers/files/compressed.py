"""Compressed files that wait where the last step ended, so that a long series in one file is decompressed once.

Gzip and Zstandard can be read from the front only. Reading step after step would decompress the file anew up to each of
them, which takes a time that grows with the square of their number; a file still open at an earlier step goes on from
there.
"""

from __future__ import annotations

import gzip
import importlib
import os
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any, BinaryIO, cast

from isal import igzip, isal_zlib

from xcg.common.messages import SceneError

# the first bytes, and how many bytes one can stand for: deflate repeats 258, Zstandard 128 KiB in a block of four bytes
_KINDS = {"gzip": (b"\x1f\x8b", 1032), "zstd": (b"\x28\xb5\x2f\xfd", 1 << 15)}
ENDINGS = (".gz", ".zst")  # of the names of compressed files
_MOST_WAITING = 8  # open files; each thread that reads a series keeps one
_LOOKED_AT, _MOST_FOUND = 1 << 16, 1 << 24  # bytes of a file, and of what they hold
_UNEVEN = 1.2  # parts of one table are compressed alike, to this factor
_waiting: list[tuple[tuple[str, int, int], BinaryIO]] = []  # by path, size and time of modification; last used last
_lock = threading.Lock()


def compression(path: str) -> str:
    """Return "gzip" or "zstd" by the first bytes of a file, "" for any other."""
    with open(path, "rb") as file:
        head = file.read(4)
    return next((kind for kind, (magic, _) in _KINDS.items() if head.startswith(magic)), "")


def plain_name(path: str) -> str:
    """Name of a file without the ending of its compression, if it has one."""
    name = os.path.basename(path)
    return name[: name.rindex(".")] if name.lower().endswith(ENDINGS) else name


def most_from(path: str) -> int:
    """Count the bytes that can come out of a file at most."""
    kind = compression(path)
    return os.path.getsize(path) * (_KINDS[kind][1] if kind else 1)


@cache
def _zstd() -> Any:
    """Return the standard library's module from Python 3.14 on, else its backport, else None."""
    for name in ("compression.zstd", "backports.zstd"):
        with suppress(ModuleNotFoundError):
            return importlib.import_module(name)
    return None


def errors() -> tuple[type[Exception], ...]:
    """Exceptions that mean damaged or cut off data."""
    zstd = _zstd()
    return (EOFError, zlib.error, gzip.BadGzipFile, isal_zlib.IsalError, *([zstd.ZstdError] if zstd else []))


def open_compressed(path: str, kind: str = "") -> BinaryIO:
    """Open a compressed file for reading what it holds; `kind` is that of `compression`, where it is known.

    Raises
    ------
    SceneError
        If what unpacks it is not installed.
    """
    if (kind or compression(path)) == "gzip":
        return cast(BinaryIO, igzip.open(path, "rb"))
    zstd = _zstd()
    if zstd is None:
        raise SceneError(
            f"{path}: to unpack Zstandard's files, Python before 3.14 needs a package; pip install 'xcg[zstd]'"
        )
    return cast(BinaryIO, zstd.open(path, "rb"))


def size_of_content(path: str) -> int:
    """Size of what a gzipped file holds; -1 where it may be several members one after the other, or over 4 GiB.

    Other sizes are unknown. The last bytes of a gzipped file hold the size of its last member, modulo 4 GiB. Whether
    there are others is seen where the first one ends in what is looked at, and else from how far that was compressed.
    """
    if compression(path) != "gzip":
        return -1
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        head = file.read(_LOOKED_AT)
        file.seek(max(0, size - 4))
        told = int.from_bytes(file.read(4), "little")
    member = isal_zlib.decompressobj(31)
    try:
        found = len(member.decompress(head, _MOST_FOUND))
    except errors():
        return -1
    taken = len(head) - len(member.unconsumed_tail) - len(member.unused_data)
    whole = taken == size if member.eof else found * size <= _UNEVEN * told * taken
    return told if whole else -1


def _ended(stream: BinaryIO) -> bool:
    """Return whether nothing more can be read."""
    try:
        return not cast(Any, stream).peek(1)
    except errors():
        return True


@contextmanager
def forward(path: str, offset: int) -> Iterator[BinaryIO]:
    """Lend a compressed file that stands at or before an offset; if more follows, it waits for the next step."""
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


def _take(key: tuple[str, int, int], offset: int) -> BinaryIO | None:
    """Return the waiting file with the largest position before an offset; or None."""
    with _lock:
        ready = [entry for entry in _waiting if entry[0] == key and entry[1].tell() <= offset]
        if not ready:
            return None
        nearest = max(ready, key=lambda entry: entry[1].tell())
        _waiting.remove(nearest)
        return nearest[1]
