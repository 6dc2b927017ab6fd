"""Scenes and results as Zarr, one chunk of time after the other, side by side."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import xarray as xr
from numpy.typing import NDArray

from xcg.scene.extras import extra
from xcg.writers.encoding import Encoding
from xcg.writers.folders import whole_folder
from xcg.writers.layout import chunk_shape, outline, prepared, steps_in_chunk, write_all

# Bytes of a chunk of a variable, on average, where steps are shorter: a small file takes more time than its numbers.
_CHUNK = 2_000_000
# Bytes of the chunks of all variables, which one task holds.
_TOGETHER = 64_000_000


@dataclass(frozen=True)
class _Zarr:
    """A Zarr folder, which tasks write to side by side: each has files of its own."""

    path: Path
    encoding: Encoding

    def __call__(self, values: Mapping[str, NDArray], steps: slice) -> None:
        import zarr

        group = zarr.open_group(self.path, mode="r+")
        for name, array in values.items():
            group[name][steps] = self.encoding.reduced(array)


def write_zarr(ds: xr.Dataset, path: Path, encoding: Encoding, *, overwrite: bool) -> None:
    """Write a Zarr folder."""
    BloscCodec = extra("zarr.codecs", "zarr", "writing Zarr").BloscCodec
    ds, over = prepared(ds, encoding)
    packed = [BloscCodec(cname="zstd", clevel=encoding.level, shuffle="shuffle")] if encoding.level else []
    steps = _steps_together(ds, over)
    layout = {name: {"chunks": chunk_shape(ds[name], steps), "compressors": packed} for name in over}
    with whole_folder(path, overwrite=overwrite) as part:
        with warnings.catch_warnings():
            # What xarray looks for first when it opens a store; programs that do not know it pass over it.
            warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
            outline(ds, over, encoding).to_zarr(part, encoding=layout, zarr_format=3, consolidated=True, compute=False)
        write_all(ds, over, _Zarr(part, encoding), steps)


def _steps_together(ds: xr.Dataset, over: Sequence[str]) -> int:
    """How many steps share a chunk: whole chunks of the Dataset, as many as are worth a file each."""
    chunk, count = steps_in_chunk(ds, over), max(1, ds.sizes.get("time", 1))
    size = max(1.0, chunk * sum(ds[name].nbytes for name in over) / count)
    return chunk * max(1, min(int(min(len(over) * _CHUNK, _TOGETHER) / size), -(-count // chunk)))
