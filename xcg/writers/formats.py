"""Formats that take chunks of time: NetCDF 4, which is HDF5, and Zarr; HDF5 files that survive full disks and kills."""

from __future__ import annotations

import io
import math
import os
import struct
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from xcg.common.checks import extra
from xcg.compiled._jit import for_each
from xcg.writers.encoding import Encoding
from xcg.writers.files import exclusive, reserve, whole_folder
from xcg.writers.store import lock_for
from xcg.writers.store_layout import Format, Parts, StoreLayout, joined

if TYPE_CHECKING:
    import h5py

# bytes besides values, which the NetCDF library writes; it does not recover from a full disk
_HEADER = 1 << 16
# of ISA-L, for any level that is asked: zlib's 4 to 9 take 10 to 100 times as long for 1 to 5 % of
# the size (8 % of four digits), and ISA-L's own 2 and 3 make nothing smaller
_ISAL_LEVEL = 1


@dataclass(frozen=True)
class StoredArray:
    """An array in a file.

    Attributes
    ----------
    name, variable : str
        Its name in the file, and that of the variable that it is made of.
    chunk : tuple of int
        Shape of its chunks.
    dtype : dtype
        Its type in the file.
    values : callable, optional
        Brings values of the variable, time first, into its form.
    """

    name: str
    variable: str
    chunk: tuple[int, ...]
    dtype: np.dtype[Any]
    values: Callable[[NDArray], NDArray] = np.asarray


class Hdf5Store:
    """Arrays of an HDF5 file that is laid out; `root` is the group of its attributes.

    The file is brought to its state after the last task that ended.
    """

    def __init__(
        self, path: Path, arrays: Sequence[StoredArray], layout: StoreLayout, root: str = "/"
    ) -> None:
        recover(path)
        self.path = path
        self.arrays = arrays
        self.root = root
        self.encoding = layout.encoding
        self.threads = layout.threads
        self.lock = lock_for(path)

    def __call__(self, parts: Parts, steps: slice) -> None:
        """Write the values of these steps."""
        values = {name: joined(part) for name, part in parts.items()}
        arrays = [array for array in self.arrays if array.variable in values]
        packed = for_each(
            arrays, lambda array: self._packed(array, values[array.variable]), self.threads
        )
        with self._writing() as file:
            for array, chunks in zip(arrays, packed, strict=True):
                for (first, *others), chunk in chunks:
                    # a file without a time axis has one step, the first
                    first_index = (steps.start + first, *others)
                    file[array.name].id.write_direct_chunk(first_index, chunk)

    def describe(self, attrs: Mapping[str, Any]) -> None:
        """Add attributes."""
        with self._writing() as file:
            file[self.root].attrs.update(attrs)

    @contextmanager
    def _writing(self) -> Iterator[h5py.File]:
        with self.lock, exclusive(self.path):
            recover(self.path)  # a worker of a cluster may have been killed in between
            with hdf5_file(self.path, "r+", journal=True) as file:
                yield file

    def _packed(self, array: StoredArray, values: NDArray) -> list[tuple[tuple[int, ...], Any]]:
        """Return the first indices of whole chunks, and their bytes."""
        values = self.encoding.reduced(array.values(values), array.variable)
        values = values.astype(array.dtype, copy=False)
        sizes = list(zip(values.shape, array.chunk, strict=True))
        packed: list[tuple[tuple[int, ...], Any]] = []
        for first_index in product(*(range(0, n, size) for n, size in sizes)):
            part = values[tuple(map(slice, first_index, np.add(first_index, array.chunk)))]
            if part.shape != array.chunk:  # beyond the end
                beyond = np.subtract(array.chunk, part.shape)
                part = np.pad(part, [(0, n) for n in beyond])
            if self.encoding.level:
                packed.append((first_index, deflated(part)))
            else:
                packed.append((first_index, np.ascontiguousarray(part)))
        return packed


def deflated(values: NDArray) -> bytes:
    """Shuffle the bytes of numbers and compress them, as the filters of HDF5 of these names do."""
    flat = np.ascontiguousarray(values).reshape(-1)
    out = np.ascontiguousarray(flat.view("u1").reshape(-1, flat.itemsize).T)
    return isal_zlib.compress(out.data, _ISAL_LEVEL)


# --- HDF5 files ------------------------------------------------------------------------------------------


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
        self._end = 0
        if journal:  # what is before is changed in the end only
            self._end = os.fstat(self.fileno()).st_size
        self._changes: list[tuple[int, bytes]] = []

    def write(self, data: Any) -> int:
        """Write all of the data, or remember why not."""
        view = memoryview(data).cast("B")
        at = 0
        offset = self.tell()
        if offset < self._end:
            at = min(len(view), self._end - offset)
            self._changes.append((offset, bytes(view[:at])))
            self.seek(offset + at)
        try:
            while self.problem is None and at < len(view):
                at += super().write(view[at:]) or 0
        except OSError as error:
            self.problem = error
        return len(view)

    def readinto(self, buffer: Any) -> int:
        """Read; zeros in place of what was lost.

        Changes that the journal holds are not read back: HDF5 keeps metadata that it changed.
        """
        view = memoryview(buffer).cast("B")
        got = super().readinto(view) or 0
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

    With a journal the file is changed as a whole: a process that is killed leaves it as it was, for
    `recover`.
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
                for offset, data in sink._changes:
                    out.write(struct.pack("<qq", offset, len(data)) + data)
            os.replace(part, _journal(path))
            _apply(sink._changes, sink.fileno())


def recover(path: Path) -> None:
    """Restore the state of a file when it was last closed."""
    journal = _journal(path)
    if not journal.exists():
        return
    content = journal.read_bytes()
    changes = []
    at = 8
    while at < len(content):
        offset, size = struct.unpack_from("<qq", content, at)
        changes.append((offset, content[at + 16 : at + 16 + size]))
        at += 16 + size
    with open(path, "rb+") as file:
        file.truncate(*struct.unpack_from("<q", content))
        _apply(changes, file.fileno())


def _apply(changes: list[tuple[int, bytes]], file: int) -> None:
    for offset, data in changes:
        os.lseek(file, offset, os.SEEK_SET)
        os.write(file, data)


def _begin_netcdf(layout: StoreLayout, path: Path, begun: bool) -> Hdf5Store:
    if not begun:
        packed: dict[str, Any] = {}
        if layout.encoding.level:
            packed = {"zlib": True, "complevel": layout.encoding.level, "shuffle": True}
        encoding = dict.fromkeys(layout.constant, packed)
        for name in layout.over:
            encoding[name] = packed | {"chunksizes": layout.chunk_shape(name)}
        for key, data in layout.ds.variables.items():
            # Labels are characters of fixed length: netCDF 1.7 was seen to crash on texts of any
            # length.
            if data.dtype.kind in "OUT":
                encoding[str(key)] = {"dtype": "S1"}
        reserve(path, _HEADER)
        # What this returns would write the zeros of the outline; it is let go, which closes the
        # file.
        layout.outline().to_netcdf(path, engine="netcdf4", encoding=encoding, compute=False)
    arrays: list[StoredArray] = []
    for name in layout.over:
        dtype = layout.encoding.type_of(layout.ds[name].dtype).newbyteorder("=")
        if dtype.kind == "b":
            dtype = np.dtype("i1")
        arrays.append(StoredArray(name, name, layout.chunk_shape(name), dtype))
    return Hdf5Store(path, arrays, layout)


NETCDF = Format("NetCDF", _begin_netcdf)


# --- Zarr ------------------------------------------------------------------------------------------------

# Bytes of a chunk of a variable, on average, where steps are shorter: a small file takes more time
# than its numbers.
_CHUNK = 4_000_000
# Bytes of the chunks of all variables, which one task holds.
_TOGETHER = 128_000_000
# Chunks of one variable are files in one folder: by default each has up to six folders of its own,
# and making these takes longer than writing small chunks.
_KEYS = {"name": "default", "separator": "."}
_NOT_STANDARD = "Consolidated metadata is currently not part"


@dataclass(frozen=True)
class _Zarr:
    """A Zarr folder, which tasks write to side by side: each has files of its own."""

    path: Path
    encoding: Encoding

    def __call__(self, parts: Parts, steps: slice) -> None:
        """Write the values of these steps."""
        import zarr

        group = zarr.open_group(self.path, mode="r+")
        for name, values in parts.items():
            group[name][steps] = self.encoding.reduced(joined(values), name)

    def describe(self, attrs: Mapping[str, Any]) -> None:
        """Add attributes."""
        import zarr

        plain = {name: np.asarray(value).tolist() for name, value in attrs.items()}
        zarr.open_group(self.path, mode="r+", use_consolidated=False).attrs.update(plain)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", _NOT_STANDARD)
            zarr.consolidate_metadata(self.path)


def _begin_zarr(layout: StoreLayout, path: Path, begun: bool) -> _Zarr:
    BloscCodec = extra("zarr.codecs", "zarr", "writing Zarr").BloscCodec
    level = layout.encoding.level
    if not begun:
        packed = []
        if level:
            packed.append(BloscCodec(cname="zstd", clevel=level, shuffle="shuffle"))
        encoding: dict[str, Any] = {name: {"compressors": packed} for name in layout.constant}
        for name in layout.over:
            encoding[name] = {
                "compressors": packed,
                "chunk_key_encoding": _KEYS,
                "chunks": layout.chunk_shape(name),
            }
        with warnings.catch_warnings():
            # What xarray looks for first when it opens a store; programs that do not know it pass
            # over it.
            warnings.filterwarnings("ignore", _NOT_STANDARD)
            layout.outline().to_zarr(
                path, mode="w", encoding=encoding, zarr_format=3, consolidated=True, compute=False
            )
    return _Zarr(path, layout.encoding)


def _steps_together(layout: StoreLayout) -> int:
    """Return the number of steps of a chunk: whole chunks of the Dataset, as many as are worth a file each."""
    count = max(1, layout.ds.sizes.get("time", 1))
    all_bytes = sum(layout.ds[name].nbytes for name in layout.over)
    chunk_bytes = max(1.0, layout.steps * all_bytes / count)
    wanted = int(min(len(layout.over) * _CHUNK, _TOGETHER) / chunk_bytes)
    available = math.ceil(count / layout.steps)
    return layout.steps * max(1, min(wanted, available))


ZARR = Format(
    "Zarr", _begin_zarr, together=lambda layout: _steps_together(layout), whole=whole_folder
)
