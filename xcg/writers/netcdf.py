"""NetCDF 4 and HDF5: chunks of time stored in HDF5 files, and scenes and results as NetCDF, which is HDF5."""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import for_each
from xcg.writers.encoding import Encoding, deflated
from xcg.writers.files import reserve
from xcg.writers.store import Format, Parts, StoreLayout, joined, lock_for

if TYPE_CHECKING:
    import h5py


@dataclass(frozen=True)
class StoredArray:
    """An array in a file.

    Attributes
    ----------
    name, variable : str
        Its name in the file, and that of the variable that it is made of.
    chunk : tuple of int
        Shape of its chunks.
    values : callable, optional
        Brings values of the variable, time first, into its form.
    over_time : bool
        Whether its first axis is time.
    """

    name: str
    variable: str
    chunk: tuple[int, ...]
    values: Callable[[NDArray], NDArray] | None = None
    over_time: bool = True


@dataclass(frozen=True)
class Hdf5Store:
    """Arrays of an HDF5 file that is laid out; `root` is the group of its attributes."""

    path: Path
    lock: Any
    arrays: tuple[StoredArray, ...]
    encoding: Encoding
    threads: int
    root: str = "/"

    @classmethod
    def of(cls, path: Path, arrays: list[StoredArray], encoding: Encoding, threads: int, root: str = "/") -> Hdf5Store:
        """Lock the file, and restore its state after the last task that ended."""
        recover(path)
        return cls(path, lock_for(path), tuple(arrays), encoding, threads, root)

    def __call__(self, parts: Parts, steps: slice) -> None:
        """Write the values of these steps."""
        values = {name: joined(part) for name, part in parts.items()}
        here = [array for array in self.arrays if array.variable in values]
        ready = for_each(here, lambda array: self._packed(array, values[array.variable]), self.threads)
        with self.lock, hdf5_file(self.path, "r+", journal=True) as file:
            for array, chunks in zip(here, ready, strict=True):
                if isinstance(chunks, np.ndarray):
                    file[array.name][steps if array.over_time else ...] = chunks
                    continue
                for (first, *others), chunk in chunks:
                    first += steps.start if array.over_time else 0
                    file[array.name].id.write_direct_chunk((first, *others), chunk)

    def describe(self, attrs: Mapping[str, Any]) -> None:
        """Add attributes."""
        with self.lock, hdf5_file(self.path, "r+", journal=True) as file:
            file[self.root].attrs.update(attrs)

    def _packed(self, array: StoredArray, values: NDArray) -> NDArray | list[tuple[tuple[int, ...], Any]]:
        """Bytes of whole chunks and their places; values as they are where the library has to convert them."""
        values = self.encoding.reduced(values if array.values is None else array.values(values))
        values = values.view("i1") if values.dtype.kind == "b" else values
        if values.dtype.kind not in "fiu" or not values.dtype.isnative:
            return values
        packed = []
        counts = [-(-n // size) for n, size in zip(values.shape, array.chunk, strict=True)]
        for index in np.ndindex(*counts):
            place = tuple(k * size for k, size in zip(index, array.chunk, strict=True))
            part = values[tuple(slice(k, k + size) for k, size in zip(place, array.chunk, strict=True))]
            if part.shape != array.chunk:  # beyond the end
                whole = np.zeros(array.chunk, part.dtype)
                whole[tuple(map(slice, part.shape))] = part
                part = whole
            data = deflated(part, self.encoding.level) if self.encoding.level else np.ascontiguousarray(part)
            packed.append((place, data))
        return packed


# --- files -----------------------------------------------------------------------------------------------


class Sink(io.FileIO):
    """A file for the HDF5 library, which crashes after a write that failed: from a full disk on, data are lost instead.

    Attributes
    ----------
    problem : OSError or None
        The first error; `check` raises it.
    """

    def __init__(self, path: Path, mode: str, *, journal: bool = False) -> None:
        super().__init__(path, mode)
        self.problem: OSError | None = None
        self._end = os.fstat(self.fileno()).st_size if journal else 0  # what is before is changed in the end only
        self._changes: list[tuple[int, bytes]] = []

    def write(self, data: Any) -> int:
        """Write all of the data, or remember why not."""
        view, at, place = memoryview(data).cast("B"), 0, self.tell()
        if place < self._end:
            at = min(len(view), self._end - place)
            self._changes.append((place, bytes(view[:at])))
            self.seek(place + at)
        try:
            while self.problem is None and at < len(view):
                at += super().write(view[at:]) or 0
        except OSError as error:
            self.problem = error
        return len(view)

    def readinto(self, buffer: Any) -> int:
        """Read; zeros in place of what was lost."""
        view, place = memoryview(buffer).cast("B"), self.tell()
        got = super().readinto(view) or 0
        for first, data in self._changes:
            low, high = max(first, place), min(first + len(data), place + got)
            if low < high:
                view[low - place : high - place] = data[low - first : high - first]
        if self.problem is not None and got < len(view):
            view[got:] = bytes(len(view) - got)
            return len(view)
        return got

    def truncate(self, size: int | None = None) -> int:
        """Change the size, or remember why not."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.problem = self.problem or error
        return size or 0

    def check(self) -> None:
        """Raise the first error that occurred."""
        if self.problem is not None:
            raise self.problem


def _journal(path: Path) -> Path:
    return path.with_name(f"{path.name}.journal")


@contextmanager
def hdf5_file(path: Path, mode: str, *, journal: bool = False) -> Iterator[h5py.File]:
    """Open an HDF5 file to make it ("w") or to write into it ("r+"); what the disk refused is raised in the end.

    With a journal the file is changed as a whole: a process that is killed leaves it as it was, for `recover`.
    """
    import h5py  # slow to import

    with Sink(path, {"w": "wb+", "r+": "rb+"}[mode], journal=journal) as sink:
        with h5py.File(sink, mode) as file:
            yield file
        sink.check()
        if journal:
            part = _journal(path).with_suffix(".new")
            with open(part, "wb") as out:
                out.write(struct.pack("<q", os.fstat(sink.fileno()).st_size))
                for place, data in sink._changes:
                    out.write(struct.pack("<qq", place, len(data)) + data)
            os.replace(part, _journal(path))
            _apply(sink._changes, sink.fileno())


def recover(path: Path) -> None:
    """Restore the state of a file when it was last closed."""
    journal = _journal(path)
    if not journal.exists():
        return
    held, changes, at = journal.read_bytes(), [], 8
    while at < len(held):
        place, size = struct.unpack_from("<qq", held, at)
        changes.append((place, held[at + 16 : at + 16 + size]))
        at += 16 + size
    with open(path, "rb+") as file:
        file.truncate(*struct.unpack_from("<q", held))
        _apply(changes, file.fileno())


def _apply(changes: list[tuple[int, bytes]], file: int) -> None:
    for place, data in changes:
        os.lseek(file, place, os.SEEK_SET)
        os.write(file, data)


_HEADER = 1 << 16  # bytes besides values, which the NetCDF library writes; it does not recover from a full disk


def _begin(layout: StoreLayout, path: Path, begun: bool) -> Hdf5Store:
    ds, level = layout.ds, layout.encoding.level
    if not begun:
        packed = {"zlib": True, "complevel": level, "shuffle": True} if level else {}
        how: dict[str, Any] = {name: {**packed, "chunksizes": layout.chunk_shape(name)} for name in layout.over}
        # Labels are characters of fixed length: netCDF 1.7 was seen to crash on texts of any length.
        how |= {str(name): {"dtype": "S1"} for name, data in ds.variables.items() if data.dtype.kind in "OUT"}
        reserve(path, _HEADER)
        # What this returns would write the zeros of the outline; it is let go, which closes the file.
        layout.outline().to_netcdf(path, engine="netcdf4", encoding=how, compute=False)
    arrays = [StoredArray(name, name, layout.chunk_shape(name)) for name in layout.over]
    return Hdf5Store.of(path, arrays, layout.encoding, layout.threads)


NETCDF = Format("NetCDF", _begin)
