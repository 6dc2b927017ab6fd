"""Fields of one step after the other into one file, while a simulation runs."""

from __future__ import annotations

import inspect
import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike

from xcg.common.messages import SceneError, did_you_mean
from xcg.fields.coarse_grain import answer, coarse_grain
from xcg.fields.request import OF_PRESETS, Request
from xcg.scene.conform import storable, takes_scene
from xcg.scene.times import check_times
from xcg.steps.mapping import chunks_of_time, each_step
from xcg.writers.encoding import Encoding
from xcg.writers.files import check_target, locked
from xcg.writers.growing import GROWING
from xcg.writers.recorded import check_request, check_step, with_mesh_of


class Recorder:
    """File of fields that grows by steps, returned by `xcg.record`. It is a context manager.

    Attributes
    ----------
    path : pathlib.Path
        The file or folder.
    steps : int
        Steps in it.
    """

    def __init__(
        self, path: Path, request: Request, encoding: Encoding, *, overwrite: bool
    ) -> None:
        if path.suffix not in GROWING:
            raise ValueError(
                f"{path}: expected a name that ends with .nc (NetCDF) or .zarr (Zarr); "
                "an HDF5 file is damaged where a process ends that writes to it"
            )
        check_target(path, overwrite=True)
        self.path = path
        self.steps = 0
        self._request = request
        self._encoding = encoding
        self._overwrite = overwrite
        self._create, self._open, self._append_values = GROWING[path.suffix]
        self._file: Any = None
        self._pattern: xr.Dataset | None = None
        self._stack = ExitStack()
        self._stack.enter_context(locked(path.with_name(f".{path.name}.record"), str(path)))
        try:
            if path.exists() and not overwrite:
                self._continue()
        except BaseException:
            self.close()
            raise

    def _continue(self) -> None:
        engine = {".nc": "netcdf4", ".zarr": "zarr"}[self.path.suffix]
        with xr.open_dataset(self.path, chunks=None, engine=engine) as recorded:
            if "time" not in recorded.dims:
                raise SceneError(
                    f"{self.path}: this is no record of fields over time; "
                    "overwrite=True replaces it"
                )
            check_request(self._request, recorded)
            self._remember(recorded)

    def _remember(self, fields: xr.Dataset) -> None:
        """Keep what all steps have in common, and the last time."""
        self._pattern = fields.isel(time=slice(-1, None)).load()
        self.steps = fields.sizes["time"]
        self._request = with_mesh_of(self._request, fields)

    def append(self, ds: xr.Dataset) -> None:
        """Add the fields of a scene, or fields, one step after the other.

        Mesh and width follow from the first step, whatever the extent of the grains in later ones.

        Parameters
        ----------
        ds : xarray.Dataset
            A scene, or a result of `xcg.coarse_grain`: one step or several.

        Raises
        ------
        SceneError
            If it is not later than the last step, or its fields have other names, nodes or kernels.
        """
        chunks = [ds]
        if "time" in ds.dims:
            chunks = [ds.isel(time=steps) for steps in chunks_of_time(ds)]
        for chunk in chunks:
            if "position" in ds:
                # before values are loaded: fields need only some variables of a lazy scene
                chunk = _answer(chunk, self._request)
            for step in each_step(chunk):
                self._add(_with_time(step))

    def _add(self, fields: xr.Dataset) -> None:
        """Write the fields of one step, and create the file if it is the first."""
        before = self._pattern
        if before is not None:
            check_step(before, fields, self.path)
            times = np.concatenate([before["time"].to_numpy(), fields["time"].to_numpy()])
            check_times(times, str(self.path), "append steps in the order of time")
        fields = self._encoding.noted(fields).load()
        stored = fields.copy()
        for name in map(str, fields.data_vars):
            if "time" in fields[name].dims:
                stored[name] = fields[name].copy(
                    data=self._encoding.reduced(fields[name].data, name)
                )
        if before is None:
            self._create(self.path, storable(stored.drop_encoding()), self._overwrite)
            self._remember(fields)
            return
        values = {}
        for key, variable in stored.variables.items():
            if "time" in variable.dims:
                values[str(key)] = variable.data
        self._file = self._file or self._stack.enter_context(self._open(self.path))
        self._append_values(self._file, values, self.steps)
        self._pattern = before.assign_coords(time=fields["time"])
        self.steps += 1

    def close(self) -> None:
        """Close the file; `xcg.record` on its name continues it."""
        self._stack.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


_answer = takes_scene(answer)  # of any selection


def _with_time(fields: xr.Dataset) -> xr.Dataset:
    """Return the fields of a step with the dimension time, which comes first."""
    if "time" in fields.dims:
        return fields.transpose("time", ...)
    if "time" not in fields.coords:
        raise SceneError("the fields lack the coordinate 'time'; add it by assign_coords(time=...)")
    with_time = fields.expand_dims("time")
    if "step" in fields.coords:
        step = fields["step"]
        with_time = with_time.assign_coords(step=("time", [step.item()], step.attrs))
    return with_time


def record(
    path: str | os.PathLike[str],
    fields: Any = None,
    *,
    overwrite: bool = False,
    dtype: DTypeLike | None = None,
    digits: int | None = None,
    **options: Any,
) -> Recorder:
    """Record the fields of one step after the other in a file, while a simulation runs.

    Each step is in the file when `append` returns, and the file can be read at any moment, also
    after the process was killed: the steps that were appended are whole. Only one step is in
    memory.

    Parameters
    ----------
    path : str or path
        ``*.nc`` for NetCDF, in its classic format with 64 bits, or ``*.zarr`` for a Zarr folder,
        which makes a file a field and step. A file that is there is continued, after a check that
        fields, mesh and kernel are the same.
    fields : optional
        As `xcg.coarse_grain`.
    overwrite : bool
        Replace a file that is there, with the first step that is appended.
    dtype, digits
        As in `xcg.save`.
    **options
        As `xcg.coarse_grain`. Mesh and width follow from the first step unless given.

    Returns
    -------
    Recorder
        Its method ``append(ds)`` takes a scene, or fields; ``close()``, or the end of the ``with``
        block, lets go of the file.

    Raises
    ------
    FileExistsError
        If another process is recording to the same file.
    SceneError
        If a file is there that holds no steps; by `append` if a step is not later than those
        before, or not like them.
    TypeError, ValueError
        If an argument is unknown or wrong.

    Examples
    --------
    >>> import xcg, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with xcg.record(f"{folder}/live.nc", "density", axes="z", width=1.0) as live:
    ...         live.append(xcg.datasets.simple_cubic(4))
    ...         live.steps
    1
    """
    arguments = inspect.signature(coarse_grain).parameters
    for word in options:
        if word not in arguments:
            raise TypeError(
                f"record() got an unexpected keyword argument {word!r}{did_you_mean(word, arguments)}"
            )
    of_preset = OF_PRESETS.get(str(options.get("preset")), {})
    request = Request(fields, **(of_preset | options))
    encoding = Encoding.of(xr.Dataset(), dtype, digits, 0)
    return Recorder(Path(path), request, encoding, overwrite=overwrite)
