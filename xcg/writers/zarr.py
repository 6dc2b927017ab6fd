"""Scenes and results as Zarr, one chunk of time after the other, side by side."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.checks import extra
from xcg.writers.encoding import Encoding
from xcg.writers.files import part_of, whole_folder
from xcg.writers.store import Format, Parts, StoreLayout, joined

# Bytes of a chunk of a variable, on average, where steps are shorter: a small file takes more time than its numbers.
_CHUNK = 4_000_000
# Bytes of the chunks of all variables, which one task holds.
_TOGETHER = 128_000_000


# Chunks of one variable are files in one folder: by default each has up to six folders of its own, and making these
# takes longer than writing small chunks.
_KEYS = {"name": "default", "separator": "."}
_NOT_STANDARD = "Consolidated metadata is currently not part"
_ZARR = ("zarr.json", ".zgroup", ".zarray")  # what folders of Zarr have, of format 3 and 2


@dataclass(frozen=True)
class _Plain:
    """Chunks that hold the numbers of a variable as they are in memory, as Zarr has them where nothing is compressed.

    Attributes
    ----------
    dtype : dtype
        Of the numbers.
    shape : tuple of int
        Of a chunk, which has some steps and is whole along other dimensions.
    fill : number
        What the last chunk holds beyond the last step. A chunk that holds nothing else has no file.
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fill: float

    @classmethod
    def of(cls, folder: Path) -> _Plain | None:
        """Read the metadata of a variable; None where its chunks are something else."""
        said = json.loads((folder / "zarr.json").read_text())
        dtype, fill = said["data_type"], said["fill_value"]
        as_they_are = [{"name": "bytes", "configuration": {"endian": sys.byteorder}}]
        known = dtype in ("float32", "float64", "int64") and (fill == "NaN" or not isinstance(fill, str))
        if (
            not known
            or said["codecs"] != as_they_are
            or said["chunk_key_encoding"]["configuration"] != {"separator": "."}
        ):
            return None
        return cls(np.dtype(dtype), tuple(said["chunk_grid"]["configuration"]["chunk_shape"]), float(fill))

    def write(self, folder: Path, parts: Sequence[NDArray], first: int) -> None:
        """Write the chunk that begins with a step; its file appears when it is whole."""
        file = folder / ".".join(["c", str(first // self.shape[0]), *("0" for _ in self.shape[1:])])
        if all(map(self._is_blank, parts)):
            file.unlink(missing_ok=True)
            return
        missing = self.shape[0] - sum(map(len, parts))
        beyond = [np.full((missing, *self.shape[1:]), self.fill)] if missing else []
        part = part_of(file)
        with open(part, "xb") as opened:
            for values in (*parts, *beyond):
                opened.write(np.ascontiguousarray(values, self.dtype).data)
        os.replace(part, file)

    def _is_blank(self, values: NDArray) -> bool:
        """Return whether all values are fill values; zeros of another sign differ."""
        for some in (values.reshape(-1)[:1], values):  # a first look is enough for nearly all
            blank = np.isnan(some) if np.isnan(self.fill) else (some == self.fill) & ~np.signbit(some)
            if not blank.all():
                return False
        return True


@dataclass(frozen=True)
class _Zarr:
    """A Zarr folder, which tasks write to side by side: each has files of its own.

    Plain chunks are written here. Others are left to zarr, which copies each and hands it to a thread.
    """

    path: Path
    encoding: Encoding
    plain: Mapping[str, _Plain]

    def __call__(self, parts: Parts, steps: slice) -> None:
        import zarr

        group = None
        for name, given in parts.items():
            ready = [self.encoding.reduced(values) for values in given]
            if name in self.plain:
                self.plain[name].write(self.path / name, ready, steps.start)
                continue
            group = group or zarr.open_group(self.path, mode="r+")
            group[name][steps] = joined(ready)

    def describe(self, attrs: Mapping[str, Any]) -> None:
        """Add attributes."""
        import zarr

        plain = {name: np.asarray(value).tolist() for name, value in attrs.items()}
        zarr.open_group(self.path, mode="r+", use_consolidated=False).attrs.update(plain)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", _NOT_STANDARD)
            zarr.consolidate_metadata(self.path)


def _begin(layout: StoreLayout, path: Path, begun: bool) -> _Zarr:
    BloscCodec = extra("zarr.codecs", "zarr", "writing Zarr").BloscCodec
    level = layout.encoding.level
    packed = [BloscCodec(cname="zstd", clevel=level, shuffle="shuffle")] if level else []
    how = {"compressors": packed, "chunk_key_encoding": _KEYS}
    if not begun:
        each = {name: {"chunks": layout.chunk_shape(name), **how} for name in layout.over}
        with warnings.catch_warnings():
            # What xarray looks for first when it opens a store; programs that do not know it pass over it.
            warnings.filterwarnings("ignore", _NOT_STANDARD)
            layout.outline().to_zarr(path, mode="w", encoding=each, zarr_format=3, consolidated=True, compute=False)
    plain = {name: found for name in layout.over if (found := _Plain.of(path / name))}
    return _Zarr(path, layout.encoding, plain)


@contextmanager
def _whole(path: Path, *, overwrite: bool, part: Path) -> Iterator[Path]:
    """As `whole_folder`; refuse to replace a folder that holds anything but Zarr data."""
    if path.is_dir() and any(path.iterdir()) and not any((path / name).exists() for name in _ZARR):
        raise FileExistsError(f"{path} is a folder without Zarr data, not replaced; choose another name, or remove it")
    with whole_folder(path, overwrite=overwrite, part=part):
        yield part


def _steps_together(layout: StoreLayout) -> int:
    """Return the number of steps of a chunk: whole chunks of the Dataset, as many as are worth a file each."""
    chunk, count = layout.steps, max(1, layout.ds.sizes.get("time", 1))
    size = max(1.0, chunk * sum(layout.ds[name].nbytes for name in layout.over) / count)
    return chunk * max(1, min(int(min(len(layout.over) * _CHUNK, _TOGETHER) / size), -(-count // chunk)))


ZARR = Format("Zarr", _begin, together=lambda layout: _steps_together(layout), whole=_whole)
