"""Fields of one step after the other into one file, while a simulation runs."""

from __future__ import annotations

import inspect
import json
import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike

from xcg.common.messages import SceneError, did_you_mean
from xcg.fields.coarse_grain import answer, coarse_grain
from xcg.fields.request import OF_PRESETS, Request
from xcg.fields.sums.kernels import Kernel
from xcg.scene.conform import storable, takes_scene
from xcg.scene.facts import OF_RESULTS, OF_SCENES
from xcg.scene.frame import check_times
from xcg.scene.schema import COMPONENTS
from xcg.steps.mapping import chunks_of_time, each_step
from xcg.writers.encoding import Encoding
from xcg.writers.files import check_target, locked, whole_file
from xcg.writers.formats import ZARR
from xcg.writers.store import write_file

_CDF5: Any = "NETCDF3_64BIT_DATA"  # which xarray hands on, though its annotations do not list it
# attributes that tell fields of one kind from those of another
_SAME = (*OF_SCENES, *OF_RESULTS, "rtol")
_OF_A_STEP = ("size_diameter", "wrapped_axes")  # which change with the grains and the box


# Files that grow by steps: what is in them is whole at any moment, whenever the process ends.


def _create_netcdf(path: Path, first: xr.Dataset, overwrite: bool) -> None:
    """Make a file in the classic format of NetCDF with 64 bits (CDF-5), whose time is its record dimension.

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
    said = json.loads(root.read_text())
    for name in values:
        said["consolidated_metadata"]["metadata"][name]["shape"][0] = at + 1
    part = root.with_suffix(".part")
    part.write_text(json.dumps(said))
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
            why = "; no HDF5 file, which is damaged where a process ends that writes to it" * (
                path.suffix == ".h5"
            )
            raise ValueError(
                f"{path}: expected a name that ends with .nc (NetCDF) or .zarr (Zarr){why}"
            )
        check_target(path, overwrite=True)
        self.path, self.steps = path, 0
        self._request, self._encoding, self._overwrite = request, encoding, overwrite
        self._create, self._open, self._append_values = _FORMATS[path.suffix]
        self._file: Any = None
        self._pattern: xr.Dataset | None = None
        self._held = ExitStack()
        self._held.enter_context(locked(path.with_name(f".{path.name}.record"), str(path)))
        try:
            if path.exists() and not overwrite:
                self._continue()
        except BaseException:
            self.close()
            raise

    def _continue(self) -> None:
        with xr.open_dataset(
            self.path, chunks=None, engine="zarr" if self.path.suffix == ".zarr" else None
        ) as there:
            if "time" not in there.dims:
                raise SceneError(
                    f"{self.path}: this is no record of fields over time; overwrite=True replaces it"
                )
            _check_asked(self._request, there)
            self._remember(there)

    def _remember(self, fields: xr.Dataset) -> None:
        """Keep what all steps have in common, and the last time."""
        self._pattern, self.steps = fields.isel(time=slice(-1, None)).load(), fields.sizes["time"]
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
        for part in (
            [ds.isel(time=steps) for steps in chunks_of_time(ds)] if "time" in ds.dims else [ds]
        ):
            # fields first: of a lazy scene they need only some variables
            for one in each_step(_fields(part, self._request) if "position" in ds else part):
                self._add(one)

    def _add(self, fields: xr.Dataset) -> None:
        fields = _one_step(fields)
        before = self._pattern
        if before is not None:
            _check(before, fields, self.path)
            times = np.concatenate([before["time"].to_numpy(), fields["time"].to_numpy()])
            check_times(times, str(self.path), "append steps in the order of time")
        fields = self._encoding.noted(fields).load()
        over_time = {str(n): v.data for n, v in fields.variables.items() if "time" in v.dims}
        values = {
            n: x if n in fields.coords else self._encoding.reduced(x, n)
            for n, x in over_time.items()
        }
        if before is None:
            stored = fields.assign({n: fields.variables[n].copy(data=x) for n, x in values.items()})
            self._create(self.path, storable(stored.drop_encoding()), self._overwrite)
            self._remember(fields)
            return
        self._file = self._file or self._held.enter_context(self._open(self.path))
        self._append_values(self._file, values, self.steps)
        self._pattern, self.steps = before.assign_coords(time=fields["time"]), self.steps + 1

    def close(self) -> None:
        """Let go of the file; `xcg.record` on its name goes on with it."""
        self._held.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


@takes_scene
def _fields(ds: xr.Dataset, request: Request) -> xr.Dataset:
    return answer(ds, request)


def _one_step(fields: xr.Dataset) -> xr.Dataset:
    if "time" in fields.dims:
        return fields.transpose("time", ...)
    if "time" not in fields.coords:
        raise SceneError("the fields lack the coordinate 'time'; add it by assign_coords(time=...)")
    step = (
        {"step": ("time", [fields["step"].item()], fields["step"].attrs)}
        if "step" in fields.coords
        else {}
    )
    return fields.expand_dims("time").assign_coords(step)


def _check_asked(request: Request, there: xr.Dataset) -> None:
    """Raise SceneError for width, mesh, extent or phases that are not those of the steps that are there."""
    asked: dict[str, tuple[Any, Any]] = {}
    bounds, extent = request.bounds or {}, json.loads(there.attrs.get("extent", "{}"))
    for a, length in (request.extent or {}).items():
        asked[f"extent along {a}"] = length, extent.get(a, np.nan)
    spacing = (
        request.spacing
        if isinstance(request.spacing, Mapping)
        else dict.fromkeys("xyz", request.spacing)
    )
    for a, step in spacing.items():
        if step is not None and there.sizes.get(a, 0) > 1:
            found = float(there[a][1] - there[a][0])
            length = there.sizes[a] * found
            around = (
                a in there.attrs.get("periodic", "") and a not in bounds
            )  # the nearest that divides the period
            asked[f"spacing along {a}"] = (
                length / max(1, np.floor(length / step + 0.5)) if around else step,
                found,
            )
    if not isinstance(request.width, str | Mapping | None):
        asked["width"] = request.width, there.attrs["width"]
    for a, (low, high) in bounds.items():
        if (
            a in there.dims
        ):  # the last node lies before its bound where the spacing does not divide the range
            x = there[a].to_numpy()
            step = x[1] - x[0] if len(x) > 1 else np.inf
            asked[a] = (
                (low, high),
                (x[0], high if 0 <= high - x[-1] < step * (1 - 1e-6) else x[-1]),
            )
    for name, (wanted, found) in asked.items():
        if not np.allclose(wanted, found, rtol=1e-6, atol=0):
            raise SceneError(
                f"{name} {wanted} is not {found}, as of the steps that are there; leave it out"
            )
    if request.by is not None and "phase" not in there.dims:
        raise SceneError(
            f"by={request.by!r}: the steps that are there have no phases; record to another file"
        )


def _with_mesh_of(request: Request, fields: xr.Dataset) -> Request:
    """Fix nodes, width and phases as in a result."""
    nodes = {a: fields[a].to_numpy() for a in COMPONENTS if a in fields.dims}
    bounds = {a: (float(x[0]), float(x[-1])) for a, x in nodes.items()}
    spacing = {a: float(x[-1] - x[0]) / (len(x) - 1) for a, x in nodes.items() if len(x) > 1}
    fixed: dict[str, Any] = {"bounds": bounds or None}
    if "extent" in fields.attrs:
        fixed["extent"] = json.loads(fields.attrs["extent"])
    if len(spacing) == len(nodes):
        fixed["spacing"] = spacing or None
    if not isinstance(request.kernel, Kernel) and np.ndim(fields.attrs.get("width", ())) == 0:
        fixed["width"] = float(fields.attrs["width"])
    if request.by is not None and request.groups is None:
        fixed["groups"] = [
            int(label) for label in fields["phase"].to_numpy().tolist() if label != "bulk"
        ]
    return replace(request, **fixed)


def _check(before: xr.Dataset, fields: xr.Dataset, path: Path) -> None:
    """Raise SceneError for a step with other fields, nodes or kernels than those before it."""
    problems = []
    changed = sorted(set(map(str, before.data_vars)) ^ set(map(str, fields.data_vars)))
    if changed:
        problems.append(f"the fields {changed} are not in both")
    for name, size in before.sizes.items():
        if fields.sizes.get(name) != size:
            problems.append(f"{name!r} has the length {fields.sizes.get(name)} instead of {size}")
        elif name != "time" and name in before.coords:
            there, new = before[name].to_numpy(), fields[name].to_numpy()
            if there.dtype.kind == "f":
                alike = np.allclose(there, new, rtol=1e-9, atol=0)
            else:
                alike = there.tolist() == new.tolist()  # text has several types
            if not alike:
                problems.append(f"{name!r} has other values")
    for name in _SAME:
        if name not in _OF_A_STEP and not np.array_equal(
            before.attrs.get(name, ""), fields.attrs.get(name, "")
        ):
            problems.append(
                f"{name} is {fields.attrs.get(name)!r} instead of {before.attrs.get(name)!r}"
            )
    if problems:
        raise SceneError(
            f"{path}: this step is not like those that are there: {'; '.join(problems)}; record it in another file"
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
    for word in options:
        if word not in (known := inspect.signature(coarse_grain).parameters):
            raise TypeError(
                f"record() got an unexpected keyword argument {word!r}{did_you_mean(word, known)}"
            )
    request = Request(fields, **(OF_PRESETS.get(str(options.get("preset")), {}) | options))
    return Recorder(
        Path(path), request, Encoding.of(xr.Dataset(), dtype, digits, 0), overwrite=overwrite
    )
