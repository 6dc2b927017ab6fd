"""Scenes that xcg saved, opened as the files of a code are."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import xarray as xr
from dask.base import tokenize

from xcg.readers.chunks import Chunks, chunk_sizes, steps_in_a_task
from xcg.readers.paths import PathLike
from xcg.scene.schema import SceneError

_HDF5 = b"\x89HDF"  # how NetCDF 4 begins; codes write the classic formats


def saved_path(particles: PathLike | Iterable[PathLike]) -> str | None:
    """Path of the Zarr folder or NetCDF 4 file that is given in place of the files of a code; None for other files."""
    paths = [particles] if isinstance(particles, (str, os.PathLike)) else particles
    if not isinstance(paths, Sequence) or len(paths) != 1:
        return None
    path = Path(paths[0]).expanduser()
    if path.suffix.lower() == ".zarr":
        return str(path) if path.is_dir() else None
    if path.suffix.lower() != ".nc" or not path.is_file():
        return None
    with path.open("rb") as file:
        return str(path) if file.read(len(_HDF5)) == _HDF5 else None


def open_saved(path: str, chunks: Chunks) -> xr.Dataset:
    """Open a scene that xcg saved.

    Raises
    ------
    SceneError
        If it cannot be opened, or is no scene.
    """
    engine = "zarr" if path.lower().endswith(".zarr") else "netcdf4"
    try:
        ds = xr.open_dataset(path, engine=engine, cache=chunks is None)
    except (OSError, ValueError, KeyError) as error:
        msg = f"{path}: cannot be opened as {engine} ({type(error).__name__}: {error})"
        raise SceneError(msg) from error
    if not {"particle_id", "position", "time"} <= ds.variables.keys():
        held = ", ".join(map(str, list(ds.data_vars)[:5])) or "nothing"
        ds.close()
        msg = f"{path} is no scene that xcg saved (it holds {held}); xarray.open_dataset opens fields and other data"
        raise SceneError(msg)
    if chunks is None:
        return ds
    sizes = chunk_sizes(chunks, ds.sizes["time"], lambda: _sensible(ds))
    whole = {str(dim): sizes if dim == "time" else -1 for dim in ds.dims}
    return ds.chunk(whole, token=tokenize(path, os.stat(path).st_mtime_ns))


def _sensible(ds: xr.Dataset) -> int:
    """Count steps of a sensible chunk: whole chunks of the file."""
    rows = sum(ds.sizes.get(dim, 0) for dim in ("particle", "contact"))
    on_disk: int = ds["position"].encoding.get("preferred_chunks", {}).get("time", 1)
    steps = steps_in_a_task(rows, ds.nbytes // max(1, ds.sizes["time"]))
    return -(-steps // on_disk) * on_disk
