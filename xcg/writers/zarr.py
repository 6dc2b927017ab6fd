"""Scenes and results as Zarr, one chunk of time after the other, side by side."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.extras import extra
from xcg.writers.chunks import joined
from xcg.writers.encoding import Encoding
from xcg.writers.files import part_of
from xcg.writers.folders import whole_folder
from xcg.writers.layout import chunk_shape, outline, prepared, steps_in_chunk, write_all

# Bytes of a chunk of a variable, on average, where steps are shorter: a small file takes more time than its numbers.
_CHUNK = 4_000_000
# Bytes of the chunks of all variables, which one task holds.
_TOGETHER = 128_000_000


# Chunks of one variable are files in one folder: by default each has up to six folders of its own, and making these
# takes longer than writing small chunks.
_KEYS = {"name": "default", "separator": "."}
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
        """Whether there is nothing but what stands for no value; zeros of another sign are something else."""
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

    def __call__(self, parts: Mapping[str, Sequence[NDArray]], steps: slice) -> None:
        import zarr

        group = None
        for name, given in parts.items():
            ready = [self.encoding.reduced(values) for values in given]
            if name in self.plain:
                self.plain[name].write(self.path / name, ready, steps.start)
                continue
            group = group or zarr.open_group(self.path, mode="r+")
            group[name][steps] = joined(ready)


def write_zarr(ds: xr.Dataset, path: Path, encoding: Encoding, *, overwrite: bool) -> None:
    """Write a Zarr folder."""
    BloscCodec = extra("zarr.codecs", "zarr", "writing Zarr").BloscCodec
    ds, over = prepared(ds, encoding)
    packed = [BloscCodec(cname="zstd", clevel=encoding.level, shuffle="shuffle")] if encoding.level else []
    steps = _steps_together(ds, over)
    how = {"compressors": packed, "chunk_key_encoding": _KEYS}
    layout = {name: {"chunks": chunk_shape(ds[name], steps), **how} for name in over}
    _spare_other_folders(path)
    with whole_folder(path, overwrite=overwrite) as part:
        with warnings.catch_warnings():
            # What xarray looks for first when it opens a store; programs that do not know it pass over it.
            warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
            outline(ds, over, encoding).to_zarr(part, encoding=layout, zarr_format=3, consolidated=True, compute=False)
        plain = {name: found for name in over if (found := _Plain.of(part / name))}
        write_all(ds, over, _Zarr(part, encoding, plain), steps)


def _spare_other_folders(path: Path) -> None:
    """Refuse to replace a folder that holds anything but Zarr data."""
    if path.is_dir() and any(path.iterdir()) and not any((path / name).exists() for name in _ZARR):
        raise FileExistsError(
            f"{path} is a folder without Zarr data, and is not replaced; choose another name, or remove it"
        )


def _steps_together(ds: xr.Dataset, over: Sequence[str]) -> int:
    """How many steps share a chunk: whole chunks of the Dataset, as many as are worth a file each."""
    chunk, count = steps_in_chunk(ds, over), max(1, ds.sizes.get("time", 1))
    size = max(1.0, chunk * sum(ds[name].nbytes for name in over) / count)
    return chunk * max(1, min(int(min(len(over) * _CHUNK, _TOGETHER) / size), -(-count // chunk)))
