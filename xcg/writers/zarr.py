"""Scenes and results as Zarr, one chunk of time after the other, side by side."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr
from numpy.typing import NDArray

from xcg.scene.extras import extra
from xcg.writers.encoding import Encoding
from xcg.writers.folders import whole_folder
from xcg.writers.layout import chunk_shape, outline, prepared, steps_in_chunk, write_all

# Bytes of all variables of the steps that share the files of a Zarr array, where steps are short.
_SHARD = 64_000_000
# Chunks that do so are this many at least: putting them into one file costs more time than writing them.
_FEWEST = 4


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
    chunk, shard = steps_in_chunk(ds, over), _steps_in_shard(ds, over)
    layout: dict[str, Any] = {}
    for name in over:
        layout[name] = {"chunks": chunk_shape(ds[name], chunk), "compressors": packed}
        if shard > chunk:
            layout[name]["shards"] = (shard, *ds[name].shape[1:])
    with whole_folder(path, overwrite=overwrite) as part:
        with warnings.catch_warnings():
            # What xarray looks for first when it opens a store; programs that do not know it pass over it.
            warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
            outline(ds, over, encoding).to_zarr(part, encoding=layout, zarr_format=3, consolidated=True, compute=False)
        write_all(ds, over, _Zarr(part, encoding), shard)


def _steps_in_shard(ds: xr.Dataset, over: Sequence[str]) -> int:
    """How many steps share a file: whole chunks of as many as a task may hold in memory."""
    chunk, count = steps_in_chunk(ds, over), ds.sizes.get("time", 1)
    step = sum(ds[name].nbytes for name in over) / max(1, count)
    chunks = min(int(_SHARD / max(step * chunk, 1.0)), -(-count // chunk))
    return chunk * chunks if chunks >= _FEWEST else chunk
