"""Scenes and results as NetCDF or Zarr: whole, compressed, without loss, one chunk of time after the other."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.build import storable
from xcg.writers.chunks import lock_for, over_time, write_chunks
from xcg.writers.files import hdf5_file, whole_file
from xcg.writers.folders import whole_folder


def save(ds: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a scene or a result, as the name says: NetCDF (``.nc``), Zarr (``.zarr``) or VTKHDF (``.vtkhdf``).

    A scene that is opened again with ``xr.open_dataset(path, chunks={})`` or ``xr.open_zarr(path)`` is the same to the
    last bit, and `ds.cg` works on it. It opens at once, and is read several times as fast as the text it came from.

    A lazy Dataset is computed and written one chunk of time after the other by one task each, where xarray's own
    `to_netcdf` and `to_zarr` make one a variable. So it takes thousands of steps; and it may run on a cluster of
    processes that see the same folder. A chunk on disk holds the steps of a chunk of the Dataset (one, where it is in
    memory). Padding of steps with fewer rows takes hardly any room, as it compresses away.

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
        If the name ends otherwise.
    """
    path = Path(path)
    if path.suffix == ".vtkhdf":
        from xcg.writers import chains, vtkhdf

        return (chains if "chain_id" in ds else vtkhdf).to_vtkhdf(ds, path, overwrite=overwrite)
    if path.suffix not in (".nc", ".zarr"):
        msg = f"{path}: expected a name that ends with .nc (NetCDF), .zarr (Zarr) or .vtkhdf (VTKHDF)"
        raise ValueError(msg)
    ds = storable(ds.drop_encoding())
    lazy = over_time(ds)
    ds = ds.assign({name: ds[name].variable.transpose("time", ...) for name in lazy})
    # What tasks do not write, as coordinates, is small.
    ds = ds.assign({n: v.compute() for n, v in ds.variables.items() if v.chunks is not None and n not in lazy})
    to_netcdf = path.suffix == ".nc"
    (_to_netcdf if to_netcdf else _to_zarr)(ds, path, overwrite=overwrite)
    return path


def _chunks(ds: xr.Dataset) -> dict[str, tuple[int, ...]]:
    """Shape of the chunks on disk of all variables over time, whole along other dimensions."""
    found = {}
    for name, data in ds.data_vars.items():
        if "time" in data.dims and data.size:
            steps = data.chunksizes.get("time", (1,))[0]
            found[str(name)] = tuple(steps if dim == "time" else n for dim, n in data.sizes.items())
    return found


def _outline(ds: xr.Dataset) -> xr.Dataset:
    """Give the same Dataset with arrays in place of lazy ones that take part in no graph worth the name."""
    empty = {}
    for name in over_time(ds):
        data = ds[name].variable
        empty[name] = data.copy(data=da.zeros(data.shape, dtype=data.dtype, chunks=-1))
    return ds.assign(empty)


# --- NetCDF ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Hdf5:
    """A NetCDF 4 file, which is an HDF5 file: opened and closed by every task, one at a time."""

    path: Path
    lock: Any

    def __call__(self, values: Mapping[str, NDArray], steps: slice) -> None:
        with self.lock, hdf5_file(self.path, "r+") as file:
            for name, array in values.items():
                file[name][steps] = array


def _to_netcdf(ds: xr.Dataset, path: Path, *, overwrite: bool) -> None:
    packed = {"zlib": True, "complevel": 1, "shuffle": True}
    encoding = {name: {**packed, "chunksizes": chunks} for name, chunks in _chunks(ds).items()}
    with whole_file(path, overwrite=overwrite) as part:
        # What this returns would write the zeros of the outline; it is let go, which closes the file.
        _outline(ds).to_netcdf(part, engine="netcdf4", encoding=encoding, compute=False)
        write_chunks(ds, _Hdf5(part, lock_for(part)))


# --- Zarr ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Zarr:
    """A Zarr folder, which tasks write to side by side: each has chunks of its own."""

    path: Path

    def __call__(self, values: Mapping[str, NDArray], steps: slice) -> None:
        import zarr

        group = zarr.open_group(self.path, mode="r+")
        for name, array in values.items():
            group[name][steps] = array


def _to_zarr(ds: xr.Dataset, path: Path, *, overwrite: bool) -> None:
    try:
        from zarr.codecs import BloscCodec
    except ImportError as error:
        msg = "writing Zarr needs the package zarr (version 3): pip install 'xcg[zarr]', or write NetCDF"
        raise ImportError(msg) from error
    packed = BloscCodec(cname="zstd", clevel=3, shuffle="shuffle")
    encoding: dict[str, Any] = {name: {"chunks": c, "compressors": [packed]} for name, c in _chunks(ds).items()}
    with whole_folder(path, overwrite=overwrite) as part:
        with warnings.catch_warnings():
            # What xarray looks for first when it opens a store; programs that do not know it pass over it.
            warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
            outline = _outline(ds)
            outline.to_zarr(part, encoding=encoding, zarr_format=3, consolidated=True, compute=False)
        write_chunks(_aligned(ds), _Zarr(part))


def _aligned(ds: xr.Dataset) -> xr.Dataset:
    """Give all variables the same even chunks of time, so that no two tasks write to one chunk on disk."""
    sizes = {ds[name].chunksizes["time"] for name in over_time(ds)}
    if all(len(set(s[:-1])) < 2 and s[-1] <= s[0] for s in sizes) and len(sizes) < 2:
        return ds
    largest = int(np.lcm.reduce([s[0] for s in sizes]))
    return ds.chunk(time=largest)
