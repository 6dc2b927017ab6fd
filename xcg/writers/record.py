"""Fields of one step after the other into one file, while a simulation runs."""

from __future__ import annotations

import inspect
import json
import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike

from xcg.common.messages import SceneError, did_you_mean
from xcg.fields.coarse_grain import answer, coarse_grain
from xcg.fields.formulas.registry import saved_options
from xcg.fields.like import arguments_of_nodes, groups_of
from xcg.fields.request import OF_PRESETS, Request
from xcg.fields.sums.kernels import Kernel
from xcg.scene.conform import storable, takes_scene
from xcg.scene.facts import OF_RESULTS, OF_SCENES
from xcg.scene.scene import Scene
from xcg.scene.times import check_times
from xcg.steps.mapping import chunks_of_time, each_step
from xcg.writers.encoding import Encoding
from xcg.writers.files import check_target, locked, whole_file
from xcg.writers.formats import ZARR
from xcg.writers.store import write_file

_CDF5: Any = "NETCDF3_64BIT_DATA"  # which xarray hands on, though its annotations do not list it
_OF_A_STEP = ("size_diameter", "wrapped_axes")  # which change with the grains and the box
# attributes that all steps have in common
_SAME = tuple(name for name in (*OF_SCENES, *OF_RESULTS, "rtol") if name not in _OF_A_STEP)


# Files that grow by steps: what is in them is whole at any moment, whenever the process ends.


def _create_netcdf(path: Path, first: xr.Dataset, overwrite: bool) -> None:
    """Make a file in NetCDF's classic 64-bit format (CDF-5), with time as its record dimension.

    Steps are added to its end, and then their number is written into its header: a step that was
    not finished does not count. An HDF5 file could not be read after a process ended that was
    writing to it.
    """
    with whole_file(path, overwrite=overwrite) as part:
        first.to_netcdf(part, engine="netcdf4", format=_CDF5, unlimited_dims=["time"])


def _open_netcdf(path: Path) -> Any:
    import netCDF4

    file = netCDF4.Dataset(path, "r+")
    file.set_auto_maskandscale(False)
    return file


def _append_netcdf(file: Any, values: dict[str, np.ndarray], at: int) -> None:
    for name, value in values.items():
        file[name][at : at + 1] = value
    file.sync()


def _create_zarr(path: Path, first: xr.Dataset, overwrite: bool) -> None:
    """Make a Zarr folder with a file a variable and step.

    Steps count from the moment at which the consolidated metadata, one file that is replaced as a
    whole, says so.
    """
    write_file(first, path, Encoding(level=1), ZARR, overwrite=overwrite)


def _append_zarr(path: Path, values: dict[str, np.ndarray], at: int) -> None:
    import zarr

    group = zarr.open_group(path, mode="r+", use_consolidated=False)
    for name, value in values.items():
        array = group[name]
        array.resize((at + 1, *array.shape[1:]))
        array[at : at + 1] = value
    root = path / "zarr.json"
    metadata = json.loads(root.read_text())
    for name in values:
        metadata["consolidated_metadata"]["metadata"][name]["shape"][0] = at + 1
    part = root.with_suffix(".part")
    part.write_text(json.dumps(metadata))
    os.replace(part, root)


# how a file is made, opened for appending, and appended to
_FORMATS: dict[str, tuple[Callable, Callable, Callable]] = {
    ".nc": (_create_netcdf, _open_netcdf, _append_netcdf),
    ".zarr": (_create_zarr, nullcontext, _append_zarr),
}


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
        if path.suffix not in _FORMATS:
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
        self._create, self._open, self._append_values = _FORMATS[path.suffix]
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
            _check_request(self._request, recorded)
            self._remember(recorded)

    def _remember(self, fields: xr.Dataset) -> None:
        """Keep what all steps have in common, and the last time."""
        self._pattern = fields.isel(time=slice(-1, None)).load()
        self.steps = fields.sizes["time"]
        self._request = _with_mesh_of(self._request, fields)

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
                chunk = _fields(chunk, self._request)
            for step in each_step(chunk):
                self._add(_with_time(step))

    def _add(self, fields: xr.Dataset) -> None:
        """Write the fields of one step, and create the file if it is the first."""
        before = self._pattern
        if before is not None:
            _check(before, fields, self.path)
            times = np.concatenate([before["time"].to_numpy(), fields["time"].to_numpy()])
            check_times(times, str(self.path), "append steps in the order of time")
        fields = self._encoding.noted(fields).load()
        values: dict[str, np.ndarray] = {}
        for key, variable in fields.variables.items():
            name = str(key)
            if "time" not in variable.dims:
                continue
            values[name] = variable.data
            if name not in fields.coords:
                values[name] = self._encoding.reduced(variable.data, name)
        if before is None:
            stored = fields.assign({n: fields.variables[n].copy(data=x) for n, x in values.items()})
            self._create(self.path, storable(stored.drop_encoding()), self._overwrite)
            self._remember(fields)
            return
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


@takes_scene
def _fields(scene: Scene, request: Request) -> xr.Dataset:
    return answer(scene, request)


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


def _check_request(request: Request, recorded: xr.Dataset) -> None:
    """Raise SceneError if width, mesh, extent or phases differ from the recorded steps."""
    pairs: dict[str, tuple[Any, Any]] = {}  # values of the request, and of the file
    saved = saved_options(recorded.attrs)
    extent = saved.get("extent", {})
    for a, length in (request.extent or {}).items():
        pairs[f"extent along {a}"] = (length, extent.get(a, np.nan))
    pairs |= _spacings(request, recorded)
    if not isinstance(request.width, str | Mapping | None):
        pairs["width"] = (request.width, saved["width"])
    for a, (low, high) in (request.bounds or {}).items():
        if a not in recorded.dims:
            continue
        x = recorded[a].to_numpy()
        last = x[-1]
        step = np.inf
        if len(x) > 1:
            step = x[1] - x[0]
        # the last node lies before its bound where the spacing does not divide the range
        if 0 <= high - last < step * (1 - 1e-6):
            last = high
        pairs[a] = ((low, high), (x[0], last))
    for name, (requested, of_file) in pairs.items():
        if not np.allclose(requested, of_file, rtol=1e-6, atol=0):
            raise SceneError(
                f"{name} {requested} is not {of_file}, as of the steps that are there; leave it out"
            )
    if request.by is not None and "phase" not in recorded.dims:
        raise SceneError(
            f"by={request.by!r}: the steps that are there have no phases; record to another file"
        )


def _spacings(request: Request, recorded: xr.Dataset) -> dict[str, tuple[float, float]]:
    """Return the spacing of the request and that of the file along each axis, by names for messages."""
    pairs: dict[str, tuple[float, float]] = {}
    spacing: Any = request.spacing
    if not isinstance(spacing, Mapping):
        spacing = dict.fromkeys("xyz", spacing)
    for a, step in spacing.items():
        if step is None or isinstance(step, str) or recorded.sizes.get(a, 0) < 2:
            continue
        recorded_step = float(recorded[a][1] - recorded[a][0])
        if a in recorded.attrs.get("periodic", "") and a not in (request.bounds or {}):
            # the nearest that divides the period
            period = recorded.sizes[a] * recorded_step
            step = period / max(1, np.floor(period / step + 0.5))
        pairs[f"spacing along {a}"] = (step, recorded_step)
    return pairs


def _with_mesh_of(request: Request, fields: xr.Dataset) -> Request:
    """Fix nodes, width and phases as in a result."""
    saved = saved_options(fields.attrs)
    nodes = arguments_of_nodes(fields)
    fixed: dict[str, Any] = {"bounds": nodes["bounds"], "spacing": nodes["spacing"]}
    if "extent" in saved:
        fixed["extent"] = saved["extent"]
    if not isinstance(request.kernel, Kernel) and np.ndim(saved.get("width", ())) == 0:
        fixed["width"] = saved["width"]
    if request.by is not None and request.groups is None:
        fixed["groups"] = groups_of(fields)
    return replace(request, **fixed)


def _check(before: xr.Dataset, fields: xr.Dataset, path: Path) -> None:
    """Raise SceneError for a step with other fields, nodes or kernels than those before it."""
    problems: list[str] = []
    changed = sorted(set(map(str, before.data_vars)) ^ set(map(str, fields.data_vars)))
    if changed:
        problems.append(f"the fields {changed} are not in both")
    for name, size in before.sizes.items():
        if fields.sizes.get(name) != size:
            problems.append(f"{name!r} has the length {fields.sizes.get(name)} instead of {size}")
        elif name != "time" and name in before.coords:
            recorded = before[name].to_numpy()
            values = fields[name].to_numpy()
            if recorded.dtype.kind == "f":
                alike = np.allclose(recorded, values, rtol=1e-9, atol=0)
            else:
                alike = recorded.tolist() == values.tolist()  # text has several types
            if not alike:
                problems.append(f"{name!r} has other values")
    for name in _SAME:
        if not np.array_equal(before.attrs.get(name, ""), fields.attrs.get(name, "")):
            problems.append(
                f"{name} is {fields.attrs.get(name)!r} instead of {before.attrs.get(name)!r}"
            )
    if problems:
        raise SceneError(
            f"{path}: this step is not like those that are there: {'; '.join(problems)}; "
            "record it in another file"
        )


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
    known = inspect.signature(coarse_grain).parameters
    for word in options:
        if word not in known:
            raise TypeError(
                f"record() got an unexpected keyword argument {word!r}{did_you_mean(word, known)}"
            )
    of_preset = OF_PRESETS.get(str(options.get("preset")), {})
    request = Request(fields, **(of_preset | options))
    encoding = Encoding.of(xr.Dataset(), dtype, digits, 0)
    return Recorder(Path(path), request, encoding, overwrite=overwrite)
