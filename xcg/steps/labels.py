"""Labels of results: dimensions, units, coordinates, phases, provenance, and a summary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Self

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from xarray.indexes import PandasIndex

from xcg.common.messages import printable
from xcg.scene.conform import storable
from xcg.scene.frame import with_time
from xcg.scene.schema import COMPONENTS, Variable, units_in
from xcg.scene.summary import Summary, rows_of_origin
from xcg.steps.faults import SKIPPED

_VERSION = version("xcg")  # found once, as it takes half a millisecond
# attributes of a scene that hold for its results, too
ABOUT = (
    "Conventions",
    "engine",
    "files",
    "periodic",
    "gravity",
    "unit_system",
    "dimension",
    "plane",
    "skipped_files",
    "frame",
    "frame_axes",
    "frame_origin",
    "estimated_forces",
)
AXES = {"component": list(COMPONENTS), "direction": list(COMPONENTS), "principal": [1, 2, 3]}


def label(
    ds: xr.Dataset,
    variables: Mapping[str, Variable],
    arrays: Mapping[str, Any],
    call: str,
    *,
    coords: Mapping[str, xr.Variable] | None = None,
    **attrs: Any,
) -> xr.Dataset:
    """Label arrays, time first, as a result of the scene `ds`, with further coordinates.

    All go into the Dataset as it is made: what is assigned to one afterwards costs nearly as much
    as making it.
    """
    system = ds.attrs.get("unit_system", "SI")
    data = {}
    for name, row in variables.items():
        about = {"units": units_in(row.units, system), "long_name": row.long_name}
        if row.formula:
            about["formula"] = row.formula
        data[name] = xr.Variable(("time", *row.dims), arrays[name], about)
    labels: dict[str, Any] = {}
    for name in ("time", "step"):
        if name in ds.coords:
            labels[name] = ds.variables[name].copy()  # those of the scene may be changed in place
    if SKIPPED in arrays:
        long_name = "whether the step was left out, as it could not be read or computed"
        labels[SKIPPED] = ("time", arrays[SKIPPED], {"long_name": long_name})
    used = {dim for values in data.values() for dim in values.dims}
    for name, coord in (coords or {}).items():
        if used.issuperset(coord.dims):
            labels[name] = coord
    labels |= {dim: (dim, values) for dim, values in AXES.items() if dim in used - labels.keys()}
    result = storable(xr.Dataset(data, labels))
    result.attrs = provenance(ds, call) | attrs
    if used.intersection(PHASES):
        result = with_phase_labels(result)
    if SKIPPED in arrays:
        result = name_skipped(result)
    return result


def annotated(dims: str | Sequence[str], values: Any, units: str, long_name: str) -> xr.Variable:
    """Return values as a variable with their unit and long name."""
    return xr.Variable(dims, values, {"units": units, "long_name": long_name})


def place_along(axis: str, nodes: NDArray, system: str) -> xr.Variable:
    """Return the coordinate of nodes, cells or slices along an axis of a scene of a unit system."""
    coordinate = annotated(axis, nodes, units_in("m", system), f"position along {axis}")
    coordinate.attrs["axis"] = axis.upper()
    return coordinate


def labelled(values: xr.DataArray, units: str, long_name: str) -> xr.DataArray:
    """Return values with their unit and long name in place of other attributes."""
    values = values.drop_attrs(deep=False)
    values.attrs = {"units": units, "long_name": long_name}
    return values


def labelled_table(
    table: Mapping[str, tuple[Any, str, str]], system: str = "SI"
) -> dict[str, xr.DataArray]:
    """Return values by name, each with its SI unit and long name, as results of a unit system have them."""
    return {
        name: labelled(xr.DataArray(values), units_in(units, system), long_name)
        for name, (values, units, long_name) in table.items()
    }


def with_errors(
    values: xr.Dataset, errors: xr.Dataset, about: Mapping[str, tuple[str, str]], system: str = "SI"
) -> dict[str, xr.DataArray]:
    """Return each variable and its standard error, with units and long names from `about`."""
    table: dict[str, tuple[Any, str, str]] = {}
    for name in map(str, values.data_vars):
        units, long_name = about[name]
        table[name] = (values[name], units, long_name)
        table[f"{name}_error"] = (errors[name], units, f"standard error of the {long_name}")
    return labelled_table(table, system)


def name_skipped(result: xr.Dataset) -> xr.Dataset:
    """List the steps that were skipped in the attribute ``skipped_steps``, if that is known and there are any."""
    skipped = result.coords.get(SKIPPED)
    if skipped is None or skipped.chunks is not None or not skipped.to_numpy().any():
        return result
    numbers = np.arange(result.sizes["time"])
    if "step" in result.coords:
        numbers = result["step"].to_numpy()
    return result.assign_attrs(skipped_steps=numbers[skipped.to_numpy()])


def format_call(function: str, arguments: Mapping[str, Any]) -> str:
    """Write a call on one line, arrays by their shape."""
    texts = []
    for name, value in arguments.items():
        text = repr(value)
        if getattr(value, "shape", ()):
            text = f"<array {np.shape(value)}>"
        elif isinstance(value, Mapping) and any(
            getattr(part, "shape", ()) for part in value.values()
        ):
            text = format_call("dict", value)
        texts.append(f"{name}={text}")
    return printable(f"{function}({', '.join(texts)})").replace("\n", " ")


def call_of(function: str, arguments: Mapping[str, Any]) -> str:
    """Write a call, without the data, `on_error`, and arguments that have no value."""
    left_out = ("scene", "ds", "f", "fc", "on_error")
    return format_call(
        function,
        {n: value for n, value in arguments.items() if n not in left_out and value is not None},
    )


def provenance(ds: xr.Dataset, call: str) -> dict[str, Any]:
    """Attributes of a result: what holds for the scene, then its history with the time, the version and the call."""
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = f"{stamp} xcg {_VERSION}: {call}"
    if "history" in ds.attrs:
        line = f"{ds.attrs['history']}\n{line}"
    kept = {name: ds.attrs[name] for name in ABOUT if name in ds.attrs}
    return kept | {"history": line}


PHASES = ("phase", "other_phase")


def phases_of(by: str | None, groups: Iterable[int]) -> xr.Variable:
    """Return the coordinate ``phase``: the bulk, and the values of the variable `by`."""
    return xr.Variable("phase", ["bulk", *map(str, groups)], {"long_name": f"phase by {by}"})


class PhaseLabels(pd.Index):
    """Text in which ``1`` finds "1": ``f.sel(phase=1)`` is ``f.sel(phase="1")``.

    It is a pandas index that xarray keeps inside its own, as its index of calendars is. So results
    align with results that were opened from files, which have the same labels as plain text.
    """

    def __new__(cls, data: ArrayLike, name: Any = None, **_: Any) -> Self:
        """Convert a sequence of labels; pandas calls this, too."""
        return cls._simple_new(np.array(data, dtype=object), name)  # type: ignore[attr-defined]

    def get_loc(self, key: Any) -> Any:
        """Place of one label."""
        return super().get_loc(_as_text(key))

    def get_indexer(self, target: Any, *args: Any, **options: Any) -> Any:
        """Places of several labels, -1 if missing."""
        labels = pd.Index([_as_text(label) for label in target], dtype=object)
        return super().get_indexer(labels, *args, **options)

    def slice_indexer(self, start: Any = None, end: Any = None, step: int | None = None) -> Any:
        """Places from one label to another."""
        return super().slice_indexer(_as_text(start), _as_text(end), step)


def _as_text(label: Any) -> Any:
    if isinstance(label, (int, np.integer)) and not isinstance(label, bool):
        return str(label)
    return label


def with_phase_labels(result: xr.Dataset) -> xr.Dataset:
    """Make phases of a result selectable by whole numbers, too."""
    for dim in PHASES:
        if dim in result.dims and dim in result.coords:
            plain = result[dim].variable
            index = PandasIndex(PhaseLabels(plain.to_numpy(), dim), dim, coord_dtype=plain.dtype)
            result = result.assign_coords(xr.Coordinates.from_xindex(index))
            result[dim].attrs = plain.attrs
            result[dim].encoding = plain.encoding
    return result


def summary_of_result(ds: xr.Dataset) -> Summary:
    """Return a summary of a result, also if averaged, sliced, or opened from a file, without computing it."""
    if not {"history", "kernel"} & set(ds.attrs) and not {"time", "phase", *COMPONENTS} & set(
        map(str, ds.coords)
    ):
        return Summary.of(
            "neither a scene nor a result: no 'position', no coordinates",
            [("variables", ", ".join(map(str, ds.data_vars)) or "none")],
        )
    ds = with_time(ds)
    of_frame = ("r", "theta", *COMPONENTS)
    axes = [a for a in of_frame if a in ds.dims]
    nodes = " x ".join(f"{ds.sizes[a]} {a}" for a in axes)
    steps = "all times"
    if "time" in ds.coords:
        steps = "one step"
    if "time" in ds.dims:
        count = ds.sizes["time"]
        steps = f"{count} step" if count == 1 else f"{count} steps"
    title = f"result of {steps}"
    if nodes:
        title += f" on {nodes} nodes"
    fixed = [a for a in of_frame if a in ds.coords and not ds[a].ndim]
    averaged = []
    if ds.attrs.get("averaged_axes"):
        averaged.append(f"along {', '.join(str(ds.attrs['averaged_axes']))}")
    for what in ("steps", "runs"):
        if f"averaged_{what}" in ds.attrs:
            averaged.append(f"over {ds.attrs[f'averaged_{what}']} {what}")
    phases = [dim for dim in PHASES if dim in ds.coords]
    shown = {*of_frame, "time", *PHASES, *AXES}
    return Summary.of(
        title,
        [
            ("fields", ", ".join(map(str, ds.data_vars)) or "none"),
            *((a, _nodes(ds[a])) for a in axes),
            ("fixed", ", ".join(f"{a} = {float(ds[a]):.6g}" for a in fixed)),
            ("averaged", ", ".join(averaged)),
            *((dim, ", ".join(map(str, np.atleast_1d(ds[dim])))) for dim in phases),
            *((str(dim), str(size)) for dim, size in ds.sizes.items() if dim not in shown),
            ("kernel", _kernel(ds)),
            *rows_of_origin(ds),
            ("history", str(ds.attrs.get("history", "")).replace("\n", "; ")),
        ],
    )


def _nodes(axis: xr.DataArray) -> str:
    """Name ends and spacing of the nodes along an axis; no spacing where it varies."""
    nodes = axis.to_numpy()
    unit = str(axis.attrs.get("units", "")).removesuffix("1")
    if not nodes.size:
        return "no nodes"
    if nodes.size == 1:
        return f"{nodes[0]:.6g} {unit}".rstrip()
    text = f"{nodes[0]:.6g} to {nodes[-1]:.6g} {unit}".rstrip()
    steps = np.diff(nodes)
    if np.allclose(steps, steps[0], rtol=1e-6, atol=0):
        text += f", spacing {steps[0]:.6g}"
    return text


def _kernel(ds: xr.Dataset) -> str:
    """Return name, width and cutoff; one of each for groups that have their own."""
    if "kernel" not in ds.attrs:
        return ""
    parts = [str(ds.attrs["kernel"])]
    for name in ("width", "cutoff"):
        if name in ds.attrs:
            lengths = [f"{value:.6g}" for value in np.atleast_1d(ds.attrs[name])]
            parts.append(f"{name} {' and '.join(lengths)}")
    return ", ".join(parts)
