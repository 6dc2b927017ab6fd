"""Scenes that xcg saved, opened as the files of a code are."""

from __future__ import annotations

import glob
import os
from collections.abc import Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr
from dask.base import tokenize
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.chunks import Chunks, chunk_sizes, steps_in_a_task
from xcg.readers.paths import PathLike
from xcg.scene.schema import BOX

_HDF5 = b"\x89HDF"  # how NetCDF 4 begins; codes write the classic formats
_OF_HDF5 = (".h5", ".hdf5")  # which may hold anything
_SUFFIXES = (".zarr", ".nc", ".nc4", *_OF_HDF5)
_OF_SCENES = {"particle_id", "position", "time"}
# what the libraries raise for damaged files; decompressors also the last two
DAMAGED = (OSError, RuntimeError, ValueError, KeyError, SystemError, MemoryError)


def saved_path(particles: PathLike | Iterable[PathLike]) -> str | None:
    """Path of the Zarr folder or NetCDF 4 file that is given in place of the files of a code; None for other files.

    Raises
    ------
    SceneError
        If there are more files beside it.
    """
    paths = [particles] if isinstance(particles, (str, os.PathLike)) else particles
    if not isinstance(paths, Sequence) or not paths:
        return None
    if Path(paths[0]).suffix.lower() not in _SUFFIXES:
        return None
    files = []
    for path in map(os.path.expanduser, map(os.fspath, paths)):
        files += [path] if os.path.exists(path) else sorted(glob.glob(path))
    saved = [path for path in files if _may_be_saved(Path(path))]
    if saved and len(files) > 1:
        raise SceneError(
            f"{saved[0]} is a scene that xcg saved, which is opened alone; open the {len(files)} files one by one, and "
            "join their scenes by xarray.concat(scenes, 'time')"
        )
    return saved[0] if saved else None


def _may_be_saved(path: Path) -> bool:
    """Return whether this is a Zarr folder, a NetCDF 4 file, or an HDF5 file with a scene as xarray writes it."""
    suffix = path.suffix.lower()
    if not path.is_file():
        return suffix == ".zarr" and path.is_dir()
    with path.open("rb") as file:
        if file.read(len(_HDF5)) != _HDF5:
            return False
    if suffix not in _OF_HDF5:
        return True
    import h5py

    with suppress(*DAMAGED), h5py.File(path) as held:
        return held.keys() >= _OF_SCENES
    return False


def open_saved(path: str, chunks: Chunks) -> xr.Dataset:
    """Open a scene that xcg saved.

    Raises
    ------
    SceneError
        If it cannot be opened, or is not a scene.
    """
    engine = "zarr" if path.lower().endswith(".zarr") else "netcdf4"
    try:
        ds = xr.open_dataset(path, engine=engine, cache=chunks is None)
        # numbers of steps and boxes, by which faults are told
        for name in {*ds.coords} | (BOX.keys() & ds.keys()):
            ds.variables[name].load()
    except DAMAGED as error:
        raise SceneError(
            f"{path}: cannot be opened as {engine} ({type(error).__name__}: {error})"
        ) from error
    if not ds.variables.keys() >= _OF_SCENES:
        held = ", ".join(map(str, list(ds.data_vars)[:5])) or "nothing"
        ds.close()
        raise SceneError(
            f"{path} is no scene that xcg saved (it holds {held}); xarray.open_dataset opens fields and other data"
        )
    if chunks is None:
        return ds
    # None for a step that was selected alone, "step" after swap_dims
    of_time = next(iter(ds["time"].dims), None)
    # there may be no step
    sizes = chunk_sizes(chunks, ds["time"].size, lambda: _sensible(ds)) or (0,)
    whole: dict[Hashable, Any] = dict.fromkeys(ds.dims, -1)
    if of_time is not None:
        whole[of_time] = sizes
    token = tokenize(path, os.stat(path).st_mtime_ns)
    lazy = {
        name: _lazy(values.variable, f"{path}: '{name}'", whole, f"{name}-{token}")
        for name, values in ds.data_vars.items()
        if name not in BOX
    }
    return ds.assign(lazy)


def open_result(path: str) -> xr.Dataset | None:
    """Open fields or another result that xcg saved, lazily; None for other files, scenes among them."""
    if Path(path).suffix.lower() not in _SUFFIXES or not os.path.exists(path):
        return None
    try:
        ds = xr.open_dataset(path)
    except DAMAGED:
        return None
    if "history" in ds.attrs and not _OF_SCENES & ds.variables.keys() - {"time"}:
        return ds
    ds.close()
    return None


def _lazy(values: xr.Variable, named: str, chunks: Mapping[Hashable, Any], key: str) -> xr.Variable:
    """Wrap a lazy variable so that its errors name it and its file; xarray's errors do not."""
    import dask.array as da  # slow to import

    array = da.from_array(
        _Read(values, named), tuple(chunks[dim] for dim in values.dims), key, asarray=False
    )
    return values.copy(data=array)


@dataclass(frozen=True)
class _Read:
    """A variable of a file, read where it is indexed; `named` names both in errors."""

    values: xr.Variable
    named: str

    shape = property(lambda self: self.values.shape)
    dtype = property(lambda self: self.values.dtype)
    ndim = property(lambda self: self.values.ndim)

    def __getitem__(self, key: Any) -> NDArray:
        try:
            return self.values[key].to_numpy()
        except DAMAGED as error:
            first, stop = 0, self.shape[0]
            if "time" in self.values.dims[:1]:
                first, stop, _ = key[0].indices(stop)
            raise SceneError(
                f"{self.named} cannot be read at the steps {first} to {stop - 1} "
                f"({type(error).__name__}: {error}); it is damaged, or gone: save the scene again"
            ) from error


def _sensible(ds: xr.Dataset) -> int:
    """Count steps of a sensible chunk: whole chunks of the file."""
    size = sum(ds.sizes.get(dim, 0) for dim in ("particle", "contact"))
    on_disk: int = ds["position"].encoding.get("preferred_chunks", {}).get("time", 1)
    count = ds["time"].size
    steps = steps_in_a_task(count, size, ds.nbytes // max(1, count))
    return -(-steps // on_disk) * on_disk
