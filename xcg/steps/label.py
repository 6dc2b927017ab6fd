"""Results as Datasets: dimensions, units, coordinates, and where they came from."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.scene.build import storable
from xcg.scene.description import Description
from xcg.scene.schema import COMPONENTS, Variable, units_in
from xcg.steps.skip import SKIPPED, Result

# attributes of a scene that hold for its results, too
ABOUT = (
    "Conventions", "engine", "files", "periodic", "gravity", "unit_system", "dimension", "plane", "skipped_files",
    "frame", "frame_axes", "frame_origin",
)  # fmt: skip
AXES = {"component": list(COMPONENTS), "direction": list(COMPONENTS), "principal": [1, 2, 3]}


def _shape(row: Variable, sizes: Mapping[Any, int]) -> tuple[int, ...]:
    return tuple(3 if dim in AXES else sizes[dim] for dim in row.dims)


def results_of(variables: Mapping[str, Variable], sizes: Mapping[Any, int]) -> dict[str, Result]:
    """Shape of one step, and type, of each variable."""
    return {name: (_shape(row, sizes), row.dtype) for name, row in variables.items()}


def empty_results(variables: Mapping[str, Variable], sizes: Mapping[Any, int], steps: int) -> dict[str, NDArray]:
    """Arrays of padding, time first."""
    return {name: np.full((steps, *_shape(row, sizes)), row.fill, row.dtype) for name, row in variables.items()}


def label(
    ds: xr.Dataset,
    variables: Mapping[str, Variable],
    arrays: Mapping[str, Any],
    call: str,
    further: Mapping[str, xr.Variable] | None = None,
    **attrs: Any,
) -> xr.Dataset:
    """Label arrays, time first, as a result of the scene `ds`; with further variables, coordinates by their dimension.

    All go into the Dataset as it is made: what is assigned to one afterwards costs nearly as much as making it.
    """
    system = ds.attrs.get("unit_system", "SI")
    data = {}
    for name, array in arrays.items():
        if name != SKIPPED:
            row = variables[name]
            about = {"units": units_in(row.units, system), "long_name": row.long_name}
            data[name] = xr.Variable(("time", *row.dims), array, about)
    data |= further or {}
    # those of the scene may be changed in place
    coords: dict[str, Any] = {name: given.copy() for name, given in times_of(ds).items()}
    used = {dim for given in data.values() for dim in given.dims}
    coords |= {dim: (dim, values) for dim, values in AXES.items() if dim in used}
    result = storable(xr.Dataset(data, coords))
    result.attrs = provenance(ds, call) | attrs
    return mark_skipped(result, arrays)


def times_of(ds: xr.Dataset) -> dict[str, xr.Variable]:
    """Coordinates along time of a scene, which its results have, too."""
    coords = ds.coords
    return {name: ds.variables[name] for name in ("time", "step") if name in coords}


def mark_skipped(result: xr.Dataset, arrays: Mapping[str, Any]) -> xr.Dataset:
    """Say which steps were skipped, where they may be: the coordinate ``skipped``, and once known, an attribute."""
    if SKIPPED not in arrays:
        return result
    long_name = "whether the step was left out, as it could not be read or computed"
    result = result.assign_coords({SKIPPED: ("time", arrays[SKIPPED], {"long_name": long_name})})
    return name_skipped(result)


def name_skipped(result: xr.Dataset) -> xr.Dataset:
    """List the steps that were skipped in the attribute ``skipped_steps``, if that is known and there are any."""
    skipped = result.coords.get(SKIPPED)
    if skipped is None or skipped.chunks is not None or not skipped.to_numpy().any():
        return result
    numbers = result["step"].to_numpy() if "step" in result.coords else np.arange(result.sizes["time"])
    return result.assign_attrs(skipped_steps=numbers[skipped.to_numpy()])


def format_call(function: str, given: Mapping[str, Any]) -> str:
    """Write a call on one line, arrays by their shape."""
    shown = {k: f"<array {np.shape(v)}>" if hasattr(v, "dtype") and np.ndim(v) else repr(v) for k, v in given.items()}
    return f"{function}({', '.join(f'{k}={v}' for k, v in shown.items())})"


@cache
def _version() -> str:
    return version("xcg")  # which is read from a file


def provenance(ds: xr.Dataset | Description, call: str) -> dict[str, Any]:
    """Attributes of a result: what holds for the scene, then its history with the time, the version and the call."""
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = f"{stamp} xcg {_version()}: {call}"
    earlier = ds.attrs.get("history")
    kept = {name: ds.attrs[name] for name in ABOUT if name in ds.attrs}
    return kept | {"history": line if earlier is None else f"{earlier}\n{line}"}
