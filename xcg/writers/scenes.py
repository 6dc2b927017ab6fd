"""Scenes as NetCDF or Zarr: a series of a DEM code converted once, to be opened by xarray alone ever after."""

from __future__ import annotations

import os
import shutil
import time
import uuid
import warnings
from pathlib import Path
from typing import Any

import xarray as xr

from xcg.scene import require_scene, storable
from xcg.writers.files import whole_file

_NETCDF = (".nc", ".nc4")


def save_scene(ds: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a scene as NetCDF or Zarr, without loss, compressed, one chunk of time after the other.

    Opened again with ``xr.open_dataset(path, chunks={})`` or ``xr.open_zarr(path)``, it is the same scene to the last
    bit, and `ds.cg` works on it. A chunk on disk holds the steps of a chunk of the scene (one, where it is in memory),
    so that steps are read on their own. Padding of steps with fewer rows takes hardly any room, as it compresses away.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene, lazy or in memory. A lazy one is read, written and forgotten step by step.
    path : str or path
        ``*.nc`` for NetCDF 4 (deflate), ``*.zarr`` for a Zarr folder (Zstandard, faster to write and to read, and
        written by all processes at the same time). It appears only when it is whole.
    overwrite : bool
        Replace what is there.

    Returns
    -------
    pathlib.Path
        The file or folder.

    Raises
    ------
    FileExistsError
        If it exists and `overwrite` is False.
    ImportError
        If Zarr is not installed.
    SceneError
        If `ds` is no scene.
    ValueError
        If the name ends otherwise.
    """
    path = Path(path)
    require_scene(ds, (), "save_scene")
    if path.suffix not in (*_NETCDF, ".zarr"):
        msg = f"{path}: expected a name that ends with .nc (NetCDF) or .zarr (Zarr)"
        raise ValueError(msg)
    ds = storable(ds.drop_encoding())
    if path.suffix == ".zarr":
        _to_zarr(ds, path, overwrite=overwrite)
        return path
    packed = {"zlib": True, "complevel": 1, "shuffle": True}
    encoding = {name: {**packed, "chunksizes": chunks} for name, chunks in _chunks(ds).items()}
    with whole_file(path, overwrite=overwrite) as part:
        ds.to_netcdf(part, engine="netcdf4", encoding=encoding)
    return path


def _chunks(ds: xr.Dataset) -> dict[str, tuple[int, ...]]:
    """Shape of the chunks on disk of all variables over time, whole along other dimensions."""
    found = {}
    for name, data in ds.data_vars.items():
        if "time" in data.dims and data.size:
            steps = data.chunksizes.get("time", (1,))[0]
            found[str(name)] = tuple(steps if dim == "time" else n for dim, n in data.sizes.items())
    return found


def _to_zarr(ds: xr.Dataset, path: Path, *, overwrite: bool) -> None:
    try:
        from zarr.codecs import BloscCodec
    except ImportError as error:
        msg = "writing Zarr needs the package zarr (version 3): pip install 'xcg[zarr]', or write NetCDF"
        raise ImportError(msg) from error
    if path.exists() and not overwrite:
        msg = f"{path} exists; choose another name, or pass overwrite=True to replace it"
        raise FileExistsError(msg)
    packed = BloscCodec(cname="zstd", clevel=3, shuffle="shuffle")
    encoding: dict[str, Any] = {name: {"chunks": c, "compressors": [packed]} for name, c in _chunks(ds).items()}
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        with warnings.catch_warnings():
            # What xarray looks for first when it opens a store; programs that do not know it pass over it.
            warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
            ds.to_zarr(part, encoding=encoding, zarr_format=3, consolidated=True)
        if path.exists():
            shutil.rmtree(path)
        part.rename(path)
    finally:
        _remove(part)


def _remove(folder: Path) -> None:
    """Remove a folder that tasks may write to for another moment, as they do after one of them failed."""
    for _ in range(100):
        if not folder.exists():
            return
        shutil.rmtree(folder, ignore_errors=True)
        time.sleep(0.05)
