"""Gzipped files that wait where the last step ended, so that a long series in one file is decompressed once.

Gzip can be read from the front only. Reading step after step would decompress the file anew up to each of them, which
takes a time that grows with the square of their number; a file still open at an earlier step goes on from there.
"""

from __future__ import annotations

import gzip
import importlib
import importlib.util
import os
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO, cast

_MOST_WAITING = 8  # open files; each thread that reads a series keeps one
_LOOKED_AT, _MOST_FOUND = 1 << 16, 1 << 24  # bytes of a file, and of what they hold
_UNEVEN = 1.2  # parts of one table are compressed alike, to this factor
_waiting: list[tuple[tuple[str, int, int], BinaryIO]] = []  # by path, size and time of modification; last used last
_lock = threading.Lock()


def _module() -> Any:
    """Give isal where it is installed: three times as fast as the standard library, with the same interface."""
    return importlib.import_module("isal.igzip") if importlib.util.find_spec("isal") else gzip


def errors() -> tuple[type[Exception], ...]:
    """Exceptions that mean damaged or cut off data."""
    found = (EOFError, zlib.error, gzip.BadGzipFile)
    if importlib.util.find_spec("isal"):
        return (*found, importlib.import_module("isal.isal_zlib").IsalError)
    return found


def open_gzipped(path: str) -> BinaryIO:
    """Open a gzipped file for reading what it holds."""
    return cast(BinaryIO, _module().open(path, "rb"))


def size_of_content(path: str) -> int:
    """Size of what a gzipped file holds; -1 where it may be several members one after the other, or over 4 GiB.

    The last bytes of a file tell the size of its last member only, modulo 4 GiB. Whether there are others is seen where
    the first one ends in what is looked at, and else from how far that was compressed.
    """
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        head = file.read(_LOOKED_AT)
        file.seek(max(0, size - 4))
        told = int.from_bytes(file.read(4), "little")
    member = zlib.decompressobj(31)
    try:
        found = len(member.decompress(head, _MOST_FOUND))
    except zlib.error:
        return -1
    taken = len(head) - len(member.unconsumed_tail) - len(member.unused_data)
    whole = taken == size if member.eof else found * size <= _UNEVEN * told * taken
    return told if whole else -1


def _ended(stream: BinaryIO) -> bool:
    """Whether nothing more can be read."""
    try:
        return not cast(Any, stream).peek(1)
    except errors():
        return True


@contextmanager
def forward(path: str, offset: int) -> Iterator[BinaryIO]:
    """Lend a gzipped file that stands at or before an offset; if more follows, it waits for the next step."""
    state = os.stat(path)
    key = (path, state.st_size, state.st_mtime_ns)
    stream = _take(key, offset) or open_gzipped(path)
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
    """Take the waiting file that stands nearest before an offset; None if there is none."""
    with _lock:
        ready = [entry for entry in _waiting if entry[0] == key and entry[1].tell() <= offset]
        if not ready:
            return None
        nearest = max(ready, key=lambda entry: entry[1].tell())
        _waiting.remove(nearest)
        return nearest[1]
