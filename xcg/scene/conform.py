"""Scenes that were selected from, masked, reordered or joined by xarray, brought back to the form that tasks read.

What xarray's methods make of a scene shows in labels, dimensions and types, without reading: ``isel(time=0)`` takes the
dimension of time away, ``where`` and ``concat`` spread variables over the rows of others and turn whole numbers into
floats, ``sel`` reorders components. The order of rows is looked after where frames are made
(`xcg.scene.frame.frame_of`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.schema import BOX_EDGES, COMPONENTS, PADDING, VARIABLES, SceneError, Variable

_MOST_SPREAD = 2**27  # values a step of a variable that was spread over the rows of others: 1 GB

P = ParamSpec("P")
R = TypeVar("R")
Task = Callable[Concatenate[xr.Dataset, P], R]


def takes_scene(task: Task[P, R]) -> Task[P, R]:
    """Have a task take any selection of a scene; its result has the dimension of time only where the scene has it."""

    @wraps(task)
    def call(ds: xr.Dataset, *args: P.args, **options: P.kwargs) -> R:
        result: Any = task(conform(ds), *args, **options)
        alone = isinstance(result, xr.Dataset) and "time" in result.dims and "time" not in ds.dims
        return cast(R, result.isel(time=0) if alone else result)

    return cast("Task[P, R]", call)


def conform(ds: xr.Dataset) -> xr.Dataset:
    """Bring a scene to the form that tasks read, lazily; anything else is returned as it is.

    Raises
    ------
    SceneError
        If components are missing, or a variable has dimensions that a scene does not give it.
    """
    if "position" not in ds or "particle_id" not in ds:
        return ds
    scene = _with_components(ds if "time" in ds.dims else _with_time(ds))
    changed = {}
    for name, array in scene.data_vars.items():
        row = BOX_EDGES if name == "box" else VARIABLES.get(str(name))
        found = array if row is None else _with_dims(array, row)
        if found.dtype.kind == "f" and (f"{name}_values" in scene.attrs or (row and row.dtype == "int64")):
            found = _mapped(partial(_whole, name=str(name)), found, "int64")
        if found is not array:
            changed[name] = found
    return scene.assign(changed) if changed else scene


def _with_time(ds: xr.Dataset) -> xr.Dataset:
    """Give one step the dimension of time back."""
    series = ds.expand_dims("time")
    if "step" in ds.coords and ds["step"].ndim == 0:
        series = series.assign_coords(step=ds["step"].variable.expand_dims("time"))
    return series


def _with_components(ds: xr.Dataset) -> xr.Dataset:
    """Order components by their labels."""
    labels = np.atleast_1d(ds["component"]).tolist() if "component" in ds.coords else list(COMPONENTS)
    if sorted(labels) != list(COMPONENTS) or ds.sizes["component"] != len(COMPONENTS):
        msg = (
            f"the scene holds the components {labels}, and all of x, y, z are needed, each once: select components in "
            "the results, and axes with axes= and at="
        )
        raise SceneError(msg)
    return ds if labels == list(COMPONENTS) else ds.sel(component=list(COMPONENTS))


def _with_dims(array: xr.DataArray, row: Variable) -> xr.DataArray:
    """Take away the rows of others that a variable was spread over."""
    expected = ("time", *row.dims)
    lacking = [d for d in expected if d not in array.dims]
    spread = [str(d) for d in array.dims if d not in expected]
    if not lacking and not spread:
        return array
    size = array.size / max(array.sizes.get("time", 1), 1)
    if lacking or not set(spread) <= {"particle", "contact"} or not 0 < size <= _MOST_SPREAD:
        msg = (
            f"'{array.name}' has the dimensions {dict(array.sizes)}, expected {expected}. Where xarray's 'where' or "
            "'concat' spread it over rows that are not its own, select by ds.map(lambda v: v.where(chosen) if "
            "'particle' in v.dims else v), and join with data_vars='minimal'"
        )
        raise SceneError(msg)
    for dim in spread:
        whole = array.chunk({dim: -1}) if array.chunks is not None else array
        array = _mapped(partial(_same, name=str(array.name), dim=dim), whole, array.dtype, dim)
    return array


def _mapped(function: Callable[[NDArray], NDArray], array: xr.DataArray, dtype: Any, *dims: Any) -> xr.DataArray:
    """Map a function over the values of a variable, chunk by chunk where it is lazy; `dims` are reduced."""
    return xr.apply_ufunc(
        function, array, input_core_dims=[list(dims)], dask="parallelized", output_dtypes=[dtype], keep_attrs=True
    )


def _same(values: NDArray, name: str, dim: str) -> NDArray:
    """Take the one value along the last axis, NaN aside."""
    low, high = np.fmin.reduce(values, axis=-1), np.fmax.reduce(values, axis=-1)
    if (low < high).any():
        msg = (
            f"'{name}' differs along '{dim}', as where parts with other contacts or boxes are joined by xr.concat; "
            "build the joined scene with xcg.scene_from_arrays"
        )
        raise SceneError(msg)
    return low


def _whole(values: NDArray, name: str) -> NDArray:
    """Whole numbers from floats, NaN as padding."""
    padded = np.where(np.isnan(values), PADDING, values)
    if (padded != np.rint(padded)).any():
        msg = f"'{name}' holds {padded[padded != np.rint(padded)][0]!r}, expected whole numbers"
        raise SceneError(msg)
    return padded.astype("int64")
