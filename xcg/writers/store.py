"""Scenes and results as NetCDF or Zarr: whole, one chunk of time after the other."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from xcg.compiled import THREADS
from xcg.fields.blocks import for_each
from xcg.scene.build import storable
from xcg.writers.chunks import Write, lock_for, over_time, write_chunks
from xcg.writers.encoding import Encoding, deflated
from xcg.writers.files import hdf5_file, whole_file
from xcg.writers.folders import whole_folder

# bytes of all variables that one file of a Zarr array holds the steps of, so that short steps share files
_SHARD = 64_000_000


def save(
    ds: xr.Dataset,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    dtype: DTypeLike | None = None,
    digits: int | None = None,
    compression: int | None = None,
) -> Path:
    """Write a scene or a result, as the name says: NetCDF (``.nc``), Zarr (``.zarr``) or VTKHDF (``.vtkhdf``).

    A scene that is opened again with ``xr.open_dataset(path, chunks={})`` or ``xr.open_zarr(path)`` is the same to the
    last bit, and `ds.cg` works on it. It opens at once, and is read several times as fast as the text it came from.

    A lazy Dataset is computed and written one chunk of time after the other by one task each, where xarray's own
    `to_netcdf` and `to_zarr` make one a variable. So it takes thousands of steps; and it may run on a cluster of
    processes that see the same folder. While one step is written, others are computed and compressed. A chunk on disk
    holds the steps of a chunk of the Dataset (one, where it is in memory); a file of a Zarr array holds several chunks
    where steps are short. Padding of steps with fewer rows takes hardly any room, as it compresses away.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene or a result, lazy or in memory.
    path : str or path
        ``*.nc`` for NetCDF 4 (deflate); ``*.zarr`` for a Zarr folder (Zstandard), which is written and read faster,
        by several tasks at a time; ``*.vtkhdf`` for fields and chains, see `to_vtkhdf` in `xcg.writers` `vtkhdf` and
        `chains`. It appears only when it is whole.
    overwrite : bool
        Replace what is there.
    dtype : {"float32", "float64"}, optional
        Type of floating-point numbers on disk; by default their own.
    digits : int, optional
        Significant digits to keep, 1 to 15: numbers are rounded to a relative error of at most ``0.5 * 10**-digits``,
        and compress well then. The attribute ``precision`` of each variable says so. By default all are kept.
    compression : int, optional
        Level of compression, 1 (fastest) to 9, or 0 for none. By default 1 for scenes, and for fields of fewer digits
        or single precision; none for fields of full precision, which become a fifth smaller only.

    Returns
    -------
    pathlib.Path
        The file or folder.

    Raises
    ------
    FileExistsError
        If it exists and `overwrite` is False, or another process is writing the same Zarr folder.
    ImportError
        If Zarr is not installed.
    ValueError
        If the name ends otherwise, or `dtype`, `digits` or `compression` is none of those above.
    """
    path = Path(path)
    encoding = Encoding.of(ds, dtype, digits, compression)
    if path.suffix == ".vtkhdf":
        from xcg.writers import chains, vtkhdf

        if "chain_id" in ds:
            return chains.to_vtkhdf(ds, path, overwrite=overwrite)
        return vtkhdf.to_vtkhdf(ds, path, overwrite=overwrite, dtype=dtype, digits=digits, compression=compression)
    if path.suffix not in (".nc", ".zarr"):
        msg = f"{path}: expected a name that ends with .nc (NetCDF), .zarr (Zarr) or .vtkhdf (VTKHDF)"
        raise ValueError(msg)
    (to_netcdf if path.suffix == ".nc" else _to_zarr)(ds, path, encoding, overwrite=overwrite)
    return path


def _prepared(ds: xr.Dataset, encoding: Encoding) -> tuple[xr.Dataset, list[str]]:
    """Give a Dataset as it is written, and the names of its variables over time, which are written step by step."""
    ds = encoding.noted(storable(ds.drop_encoding()))
    over = [str(name) for name, data in ds.data_vars.items() if "time" in data.dims and data.size]
    ds = ds.assign({name: ds[name].variable.transpose("time", ...) for name in over})
    # What tasks do not write, as coordinates, is small.
    ds = ds.assign({n: v.compute() for n, v in ds.variables.items() if v.chunks is not None and n not in over})
    return _aligned(ds, over), over


def _aligned(ds: xr.Dataset, over: Sequence[str]) -> xr.Dataset:
    """Give all lazy variables the same even chunks of time, so that no two tasks write to one chunk on disk."""
    lazy = [name for name in over if ds[name].chunks is not None]
    sizes = {ds[name].chunksizes["time"] for name in lazy}
    if all(len(set(s[:-1])) < 2 and s[-1] <= s[0] for s in sizes) and len(sizes) < 2:
        return ds
    steps = int(np.lcm.reduce([s[0] for s in sizes]))
    return ds.assign({name: ds[name].variable.chunk({"time": steps}) for name in lazy})


def _steps_in_chunk(ds: xr.Dataset, over: Sequence[str]) -> int:
    return max((ds[name].chunksizes["time"][0] for name in over if ds[name].chunks is not None), default=1)


def _chunk(data: xr.DataArray, steps: int) -> tuple[int, ...]:
    """Shape of the chunks on disk of a variable over time, whole along other dimensions."""
    return tuple(min(steps, n) if dim == "time" else n for dim, n in data.sizes.items())


def _outline(ds: xr.Dataset, over: Sequence[str], encoding: Encoding) -> xr.Dataset:
    """Give the same Dataset with zeros that nothing computes in place of what tasks write."""
    empty = {}
    for name in over:
        data = ds[name].variable
        empty[name] = data.copy(data=da.zeros(data.shape, dtype=encoding.type_of(data.dtype), chunks=-1))
    return ds.assign(empty)


def _write_all(ds: xr.Dataset, over: Sequence[str], write: Write, steps: int) -> None:
    """Write what is in memory, `steps` at a time, and compute and write the rest by tasks."""
    now = {name: ds[name].to_numpy() for name in over if ds[name].chunks is None}
    for first in range(0, ds.sizes["time"] if now else 0, steps):
        part = slice(first, min(first + steps, ds.sizes["time"]))
        write({name: values[part] for name, values in now.items()}, part)
    write_chunks(ds, write, steps)


# --- NetCDF ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Hdf5:
    """A NetCDF 4 file, which is an HDF5 file: opened and closed by every task, one at a time.

    The HDF5 library lets in one thread at a time. So chunks are rounded and compressed before, and it is given their
    bytes.
    """

    path: Path
    lock: Any
    encoding: Encoding
    steps: int  # in a chunk on disk
    threads: int

    def __call__(self, values: Mapping[str, NDArray], steps: slice) -> None:
        ready = dict(zip(values, for_each(list(values.values()), self._packed, self.threads), strict=True))
        with self.lock, hdf5_file(self.path, "r+") as file:
            for name, chunks in ready.items():
                if isinstance(chunks, np.ndarray):
                    file[name][steps] = chunks
                    continue
                for k, chunk in enumerate(chunks):
                    place = (steps.start + k * self.steps, *(0,) * (values[name].ndim - 1))
                    file[name].id.write_direct_chunk(place, chunk)

    def _packed(self, values: NDArray) -> NDArray | list[bytes]:
        """Numbers as they are, or the bytes of whole chunks, the last of which may reach beyond the end."""
        values = self.encoding.reduced(values)
        if not self.encoding.level or values.dtype.kind not in "fiu":
            return values
        packed = []
        for first in range(0, len(values), self.steps):
            part = values[first : first + self.steps]
            if len(part) < self.steps:
                part = np.concatenate([part, np.zeros((self.steps - len(part), *part.shape[1:]), part.dtype)])
            packed.append(deflated(part, self.encoding.level))
        return packed


def to_netcdf(ds: xr.Dataset, path: Path, encoding: Encoding, *, overwrite: bool, room: int = 0) -> None:
    """Write NetCDF under any name; `room` as in `xcg.writers.files.whole_file`."""
    ds, over = _prepared(ds, encoding)
    steps = min(_steps_in_chunk(ds, over), ds.sizes.get("time", 1))
    packed = {"zlib": True, "complevel": encoding.level, "shuffle": True} if encoding.level else {}
    layout: dict[str, Any] = {name: {**packed, "chunksizes": _chunk(ds[name], steps)} for name in over}
    # tasks share the processors; a single one has them all
    threads = THREADS if ds.sizes.get("time", 0) <= steps or not over_time(ds) else 1
    with whole_file(path, overwrite=overwrite, room=room) as part:
        # What this returns would write the zeros of the outline; it is let go, which closes the file.
        _outline(ds, over, encoding).to_netcdf(part, engine="netcdf4", encoding=layout, compute=False)
        _write_all(ds, over, _Hdf5(part, lock_for(part), encoding, steps, threads), steps)


# --- Zarr ------------------------------------------------------------------------------------------------


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


def _to_zarr(ds: xr.Dataset, path: Path, encoding: Encoding, *, overwrite: bool) -> None:
    try:
        from zarr.codecs import BloscCodec
    except ImportError as error:
        msg = "writing Zarr needs the package zarr (version 3): pip install 'xcg[zarr]', or write NetCDF"
        raise ImportError(msg) from error
    ds, over = _prepared(ds, encoding)
    packed = [BloscCodec(cname="zstd", clevel=encoding.level, shuffle="shuffle")] if encoding.level else []
    chunk, shard = _steps_in_chunk(ds, over), _steps_in_shard(ds, over)
    layout: dict[str, Any] = {}
    for name in over:
        layout[name] = {"chunks": _chunk(ds[name], chunk), "compressors": packed}
        if shard > chunk:
            layout[name]["shards"] = (shard, *ds[name].shape[1:])
    with whole_folder(path, overwrite=overwrite) as part:
        with warnings.catch_warnings():
            # What xarray looks for first when it opens a store; programs that do not know it pass over it.
            warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
            outline = _outline(ds, over, encoding)
            outline.to_zarr(part, encoding=layout, zarr_format=3, consolidated=True, compute=False)
        _write_all(ds, over, _Zarr(part, encoding), shard)


def _steps_in_shard(ds: xr.Dataset, over: Sequence[str]) -> int:
    """How many steps share a file: whole chunks of as many as a task may hold in memory."""
    chunk, count = _steps_in_chunk(ds, over), ds.sizes.get("time", 1)
    step = sum(ds[name].nbytes for name in over) / max(1, count)
    return chunk * max(1, min(int(_SHARD / max(step * chunk, 1.0)), -(-count // chunk)))
