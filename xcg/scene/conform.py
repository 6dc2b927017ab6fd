"""Scenes that were selected from, masked, reordered or joined by xarray, brought back to the form that tasks read.

What xarray's methods make of a scene shows in labels, dimensions and types, without reading:
``isel(time=0)`` takes the dimension of time away, ``swap_dims`` names it otherwise, ``set_coords``
makes coordinates of variables, ``where`` and ``concat`` spread variables over the rows of others
and turn whole numbers into floats, ``sel`` reorders components. The order of rows is looked after
where frames are made (`xcg.scene.frame.frame_of`).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from functools import partial, wraps
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.compat import is_in_memory
from xcg.common.messages import Once, SceneError, active_call, did_you_mean
from xcg.scene.facts import require_facts, with_facts
from xcg.scene.scene import Scene
from xcg.scene.schema import (
    BOX,
    COMPONENTS,
    MEASURED,
    PADDING,
    SCHEMA,
    VARIABLES,
    Variable,
    known_without_reading,
    variable,
)

_OF_ATTRIBUTES = (
    "or give them, ds.assign_attrs(periodic='xy', dimension=3); join scenes with combine_attrs='override', and build "
    "scenes from arrays by xcg.scene_from_arrays"
)
_MOST_SPREAD = 2**27  # values a step of a variable that was spread over the rows of others: 1 GB

P = ParamSpec("P")
R = TypeVar("R")


def takes_scene(
    task: Callable[Concatenate[Scene, P], R],
) -> Callable[Concatenate[xr.Dataset, P], R]:
    """Decorate a function of a `Scene`: it takes any selection of a Dataset, and its result has the same dimensions.

    The decorated function raises TypeError for anything but a Dataset, and for an argument that is
    unknown, missing or one too many; SceneError as `conform`.
    """
    of_task = inspect.signature(task)
    first, *others = of_task.parameters.values()
    ds_parameter = first.replace(name=first.name.replace("scene", "ds"), annotation="xr.Dataset")
    signature = of_task.replace(parameters=[ds_parameter, *others])

    @wraps(task)
    def call(ds: xr.Dataset, *args: P.args, **options: P.kwargs) -> R:
        name = task.__name__
        if not isinstance(ds, xr.Dataset):
            raise TypeError(
                f"{name}: expected a scene, an xarray.Dataset, not {type(ds).__name__}; files are opened by "
                "xcg.open_scene, arrays by xcg.scene_from_arrays"
            )
        try:
            signature.bind(ds, *args, **options)
        except TypeError as error:
            raise _argument_error(name, signature, options, error) from None
        scene = conform(ds)
        with active_call().active():
            result = task(Scene(scene), *args, **options)
        return result if scene is ds else as_selected(result, ds)

    shown = cast(Any, call)
    shown.__signature__ = signature
    shown.__annotations__ = {
        parameter.name: parameter.annotation for parameter in signature.parameters.values()
    }
    shown.__annotations__["return"] = signature.return_annotation
    return call


def _argument_error(
    name: str, signature: inspect.Signature, words: Iterable[str], error: TypeError
) -> TypeError:
    """Return the error of a call whose arguments do not fit; `words` are its keywords."""
    parameters = signature.parameters
    for word in words:
        if word not in parameters:
            hint = _likely_argument(word, parameters)
            return TypeError(f"{name}() got an unexpected keyword argument {word!r}{hint}")
    return TypeError(f"{name}(): {error}")


# Arguments by the words that others use for them.
_OTHER_ARGUMENTS = {
    "w": "width",
    "h": "width",
    "bandwidth": "width",
    "smoothing_length": "width",
    "kernel_width": "width",
    "resolution": "spacing",
    "dx": "spacing",
    "cell_size": "spacing",
    "grid": "spacing",
    "bins": "spacing",
    "variables": "fields",
    "quantities": "fields",
    "names": "fields",
    "dims": "axes",
    "phase": "by",
    "phases": "by",
    "species": "by",
    "groupby": "by",
    "limits": "bounds",
    "region": "bounds",
    "slice": "at",
    "points": "at",
    "point": "at",
    "walls": "surfaces",
    "stiffness": "k_n",
    "kn": "k_n",
    "colour": "cmap",
    "nx": "spacing",
    "ny": "spacing",
    "nz": "spacing",
    "n": "spacing",
    "nbins": "spacing",
    "threshold": "min_stress",
}
# Arguments of other calls, by name: what to do instead.
_ELSEWHERE = {
    "cutoff": "it is a part of the kernel, such as kernel=xcg.Lucy(cutoff=0.01)",
    "color": "pictures take it, ds.cg.coarse_grain(...).cg.plot(color=...)",
    "periodic": "it is a fact of the scene, given to xcg.open_scene or xcg.scene_from_arrays",
    "box": "it is a fact of the scene, given to xcg.open_scene or xcg.scene_from_arrays",
    "units": "it is a fact of the scene, given to xcg.open_scene or xcg.scene_from_arrays",
    "density": "it is a fact of the scene, given to xcg.open_scene or xcg.scene_from_arrays",
    "timestep": "it is a fact of the scene, given to xcg.open_scene",
    "dt": "times are those of the scene; timestep= is given to xcg.open_scene",
}


def _likely_argument(word: str, parameters: Mapping[str, object]) -> str:
    """Return the argument, or the other way, that was probably meant, as the end of a message."""
    if word in ("time", "step"):
        if "index" in parameters:
            return "; did you mean 'index', the position of a step?"
        return "; select steps before the call, ds.isel(time=-1)"
    if word in _ELSEWHERE:
        return f"; {_ELSEWHERE[word]}"
    return did_you_mean(word, parameters, synonyms=_OTHER_ARGUMENTS)


# attributes of `particle_id` where files hold no ids
ROW_NUMBERS = {"rows": 1, "long_name": "number of the row, as the files hold no ids"}


def _require_one_time(ds: xr.Dataset) -> None:
    """Raise SceneError for a scene that was averaged over time.

    Such a scene has neither time nor step, which a selected step keeps, and its ids are means.
    """
    ids = ds.variables["particle_id"]
    if ids.dtype.kind != "f" or {"time", "step"} & {*ds.dims, *ds.coords}:
        return
    raise SceneError(
        "the scene has no time, and its ids are no whole numbers, as after ds.mean('time'): positions that are means "
        "over time lie closer than grains can. Coarse-grain each step, then average the fields, "
        "ds.cg.coarse_grain(...).cg.time_average(). If it is one step, give its time, ds.assign_coords(time=0.0)"
    )


def conform(ds: xr.Dataset) -> xr.Dataset:
    """Convert a scene to the form that tasks read, lazily; return anything else unchanged.

    Raises
    ------
    SceneError
        If components are missing, a variable has dimensions that a scene does not give it, the
        scene was averaged over time, attributes are lost, or scenes with different ones were joined.
    """
    if "position" not in ds or "particle_id" not in ds:
        return ds
    ds = with_facts(ds)
    require_facts(ds, ("periodic", "dimension"), "the scene", _OF_ATTRIBUTES)
    if _is_conform(ds):
        return ds
    _require_one_time(ds)
    return _with_values(_with_dimensions(ds))


def _is_conform(ds: xr.Dataset) -> bool:
    """Return whether all variables are as xcg makes them: nothing was selected or added."""
    for name, values in ds.variables.items():
        row = SCHEMA.get(str(name))
        has_empty_chunks = 0 in values.chunksizes.get("time", ())
        if has_empty_chunks or (row is None) != (name in ds.coords):
            return False
        if row is not None:
            of_floats = row.dtype == "int64" and values.dtype.kind == "f"
            if of_floats or values.dims != ("time", *row.dims):
                return False
    return labels_along(ds, "component") == list(COMPONENTS)


def _with_dimensions(ds: xr.Dataset) -> xr.Dataset:
    """Restore the dimensions of a scene, its variables among coordinates, and the order of components."""
    scene = ds
    if renamed := _renamed(ds):
        scene = ds.swap_dims(renamed)
    for name, values in scene.variables.items():
        merged = without_empty_chunks(values)
        if merged is not values:
            scene = scene.assign({name: merged})
    if kept := [name for name in scene.coords if name in SCHEMA]:
        scene = scene.reset_coords(kept)
    for dim in _taken_away(scene):
        scene = _with_dim(scene, dim)
    return with_components(scene)


def _with_values(scene: xr.Dataset) -> xr.Dataset:
    """Restore the rows and the types of variables that were masked, spread over others, or joined."""
    masked = scene.variables["particle_id"].dtype.kind == "f"
    changed = {}
    for name in map(str, scene.data_vars):
        values = scene.variables[name]
        row = _row_of(name, values.dims, values.dtype)
        floats = values.dtype.kind == "f" and (
            f"{name}_values" in scene.attrs or (row and row.dtype == "int64")
        )
        if not (masked or floats) and (row is None or values.dims == ("time", *row.dims)):
            continue
        array = scene[name]
        if row is not None:
            array = _with_dims(array, row)
        if floats:
            array = _mapped(partial(_whole, name=name), array, "int64")
        if masked and "particle" in array.dims and not known_without_reading(scene, name):
            array = _as_measured(array, scene.attrs)
        changed[name] = array
    if not changed:
        return scene
    return scene.assign(changed)


# --- dimensions ------------------------------------------------------------------------------------------


def _renamed(ds: xr.Dataset) -> dict[str, str]:
    """Dimensions that ds.swap_dims named by a coordinate, with the names that tasks know them by."""
    labels = {"step": "time", "particle_id": "particle"}
    return {
        label: dim for label, dim in labels.items() if label in ds.sizes and dim not in ds.sizes
    }


def without_empty_chunks(values: xr.Variable) -> xr.Variable:
    """Return a variable whose chunks of time all have steps, or itself.

    dask leaves empty chunks in slices by a stride, and cannot index such arrays.
    """
    if is_in_memory(values):
        return values
    steps = values.chunksizes.get("time", ())
    if 0 in steps and any(steps):
        return values.chunk(time=tuple(n for n in steps if n))
    return values


def _taken_away(ds: xr.Dataset) -> list[str]:
    """Dimensions that a selection of one step, one particle or one contact has no more."""
    rows = {"time": ds.sizes, "particle": ds.variables["position"].dims}
    if "contact_i" in ds:
        rows["contact"] = ds.variables["contact_i"].dims
    return [dim for dim, dims in rows.items() if dim not in dims]


def _with_dim(ds: xr.Dataset, dim: str) -> xr.Dataset:
    """Restore the dimension of a single step, particle or contact."""
    if dim == "time":
        series = ds.expand_dims("time")
        if "step" in ds.coords and ds["step"].ndim == 0:
            series = series.assign_coords(step=ds["step"].variable.expand_dims("time"))
        return series
    of_step = {"time", "component", "direction"}
    names = [
        n
        for n in map(str, ds.data_vars)
        if n not in BOX and {*ds[n].dims} <= of_step and variable(n).dims[0] == dim
    ]
    expanded = {}
    for name in names:
        expanded[name] = ds[name].variable.set_dims([dim, *ds[name].dims])
        expanded[name].encoding = ds[name].encoding
    return ds.assign(expanded)


def _row_of(name: str, dims: tuple[Hashable, ...], dtype: np.dtype) -> Variable | None:
    """Row of the schema of a variable; none for what the user keeps beside the scene."""
    if name in BOX:
        return BOX[name]
    row = variable(name, dtype, 1 + sum(dim in dims for dim in ("component", "direction")))
    expected = {"time", *row.dims}
    if name in VARIABLES or expected <= {*dims} <= expected | {"particle", "contact"}:
        return row
    return None


def as_selected(result: R, ds: xr.Dataset) -> R:
    """Remove the dimensions that a selection dropped, and rename the others as it does; of a Dataset only."""
    if not isinstance(result, xr.Dataset) or "position" not in ds or "particle_id" not in ds:
        return result
    renamed = _renamed(ds)
    taken_away = _taken_away(ds.swap_dims(renamed))
    selected = result.isel({dim: 0 for dim in taken_away if dim in result.sizes})
    back = {
        dim: label
        for label, dim in renamed.items()
        if label in selected and selected[label].dims == (dim,)
    }
    return cast(R, selected.swap_dims(back))


def in_whole_rows(array: xr.DataArray) -> xr.DataArray:
    """Chunk a lazy variable over time alone."""
    if array.chunks is None:
        return array
    return array.chunk({dim: -1 for dim in array.dims if dim != "time"})


def storable(ds: xr.Dataset) -> xr.Dataset:
    """Store texts without a fixed length: Zarr 3 specifies no other text."""
    for values in ds.variables.values():
        if values.dtype.kind == "U":
            values.encoding["dtype"] = object
    return ds


def with_components(ds: xr.Dataset) -> xr.Dataset:
    """Order components by their labels.

    Raises
    ------
    SceneError
        If some are missing.
    """
    ordered = in_order(ds, "component", COMPONENTS)
    if ordered is None:
        raise SceneError(
            f"the scene holds the components {labels_along(ds, 'component')}, and all of x, y, z are needed, each "
            "once: select components in the results, and axes with axes= and at="
        )
    return ordered


def in_order(ds: xr.Dataset, dim: str, axes: Sequence[str]) -> xr.Dataset | None:
    """Sort a Dataset along `dim` into the order of `axes`; None unless it holds each of them once."""
    labels = labels_along(ds, dim)
    if sorted(map(str, labels)) != sorted(axes) or ds.sizes.get(dim) != len(axes):
        return None
    if labels == list(axes):
        return ds
    return ds.sel({dim: list(axes)})


def labels_along(ds: xr.Dataset, dim: str) -> list[Any]:
    """Labels along a dimension of components, x, y and z by default."""
    if dim not in ds.coords:
        return list(COMPONENTS)
    return np.atleast_1d(ds.variables[dim].to_numpy()).tolist()


def _with_dims(array: xr.DataArray, row: Variable) -> xr.DataArray:
    """Transpose dimensions, and remove the rows of others that a variable was spread over."""
    expected = ("time", *row.dims)
    lacking = [d for d in expected if d not in array.dims]
    spread = [str(d) for d in array.dims if d not in expected]
    if not lacking and not spread:
        return array.transpose(*expected)
    if spread and not array.size:
        raise SceneError(
            f"'{array.name}' holds no row, as after ds.where(condition, drop=True) with a condition that holds for "
            "no particle: change the condition, or select by ds.cg.select, which keeps steps"
        )
    size = array.size / max(array.sizes.get("time", 1), 1)
    if lacking == ["time"] and not spread:
        raise SceneError(
            f"'{array.name}' has the dimensions {dict(array.sizes)}, expected {expected}: add the dimension time, "
            f"ds.assign({array.name}=ds.{array.name}.expand_dims(time=ds.time))"
        )
    if lacking or not set(spread) <= {"particle", "contact"} or not 0 < size <= _MOST_SPREAD:
        raise SceneError(
            f"'{array.name}' has the dimensions {dict(array.sizes)}, expected {expected}. Where xarray's 'where' or "
            "'concat' spread it over rows that are not its own, select by ds.map(lambda v: v.where(chosen) if "
            "'particle' in v.dims else v), and join with data_vars='minimal'"
        )
    for dim in spread:
        whole = in_whole_rows(array)
        array = _mapped(partial(_same, name=str(array.name), dim=dim), whole, array.dtype, dim)
    return array.transpose(*expected)


# --- values ----------------------------------------------------------------------------------------------


def _as_measured(array: xr.DataArray, attrs: Mapping[Any, Any]) -> xr.DataArray:
    """Mark a lazy variable with masked rows as measured, and check it when it is read.

    Masking takes marks away, as arithmetic does. Diameters show which of them it was, positions do
    so when they are compared with the mesh, and groups when grains are counted to them.
    """
    if array.name == "diameter" and {"dmin", "dmax"} <= set(attrs):
        low, high = float(attrs["dmin"]), float(attrs["dmax"])
        array = _mapped(partial(_in_range, low=low, high=high, once=Once()), array, array.dtype)
    array = array.copy(deep=False)
    array.encoding[MEASURED] = True
    return array


def _in_range(diameter: NDArray, low: float, high: float, once: Once) -> NDArray:
    """Warn of diameters outside the range that was measured; NaN is in it."""
    small = 1e-9 * high
    if (diameter < low - small).any() or (diameter > high + small).any():
        once.warn(
            "diameters",
            f"diameters from {np.nanmin(diameter):.6g} to {np.nanmax(diameter):.6g} are not in the range that was "
            f"measured, {low:.6g} to {high:.6g}, and default widths follow from that; call ds = ds.cg.measure() first",
        )
    return diameter


def _mapped(
    function: Callable[[NDArray], NDArray], array: xr.DataArray, dtype: Any, *dims: Any
) -> xr.DataArray:
    """Map a function over the values of a variable, chunk by chunk where it is lazy; `dims` are reduced."""
    return xr.apply_ufunc(
        function,
        array,
        input_core_dims=[list(dims)],
        dask="parallelized",
        output_dtypes=[dtype],
        keep_attrs=True,
    )


def _same(values: NDArray, name: str, dim: str) -> NDArray:
    """Return the single value along the last axis, NaN aside."""
    low = np.fmin.reduce(values, axis=-1)
    high = np.fmax.reduce(values, axis=-1)
    if (low < high).any():
        raise SceneError(
            f"'{name}' differs along '{dim}', as where parts with other contacts or boxes are joined by xr.concat "
            "(build the joined scene with xcg.scene_from_arrays), or where 'where' puts other values than NaN into rows"
        )
    return low


def _whole(values: NDArray, name: str) -> NDArray:
    """Whole numbers from floats, NaN as padding."""
    padded = np.where(np.isnan(values), PADDING, values)
    if (padded != np.rint(padded)).any():
        raise SceneError(
            f"'{name}' holds {padded[padded != np.rint(padded)][0]!r}, expected whole numbers"
        )
    return padded.astype("int64")
