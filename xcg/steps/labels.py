"""Labels of results: dimensions, units, coordinates, phases, provenance, and a summary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Self

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike
from xarray.indexes import PandasIndex

from xcg.common.messages import printable
from xcg.scene.conform import storable
from xcg.scene.description import Description, Summary, rows_of_origin
from xcg.scene.frame import with_time
from xcg.scene.schema import COMPONENTS, Variable, units_in
from xcg.steps.faults import SKIPPED

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
    for name, array in arrays.items():
        if name == SKIPPED:
            continue
        row = variables[name]
        about = {"units": units_in(row.units, system), "long_name": row.long_name}
        if row.formula:
            about["formula"] = row.formula
        data[name] = xr.Variable(("time", *row.dims), array, about)
    # those of the scene may be changed in place
    labels: dict[str, Any] = {name: given.copy() for name, given in times_of(ds).items()}
    used = {dim for given in data.values() for dim in given.dims}
    for name, coord in (coords or {}).items():
        if used.issuperset(coord.dims):
            labels[name] = coord
    labels |= {dim: (dim, values) for dim, values in AXES.items() if dim in used - labels.keys()}
    result = storable(xr.Dataset(data, labels))
    result.attrs = provenance(ds, call) | attrs
    return mark_skipped(with_phase_labels(result), arrays)


def annotated(dims: str | Sequence[str], values: Any, units: str, long_name: str) -> xr.Variable:
    """Return values as a variable with their unit and long name."""
    return xr.Variable(dims, values, {"units": units, "long_name": long_name})


def labelled(values: xr.DataArray, units: str, long_name: str) -> xr.DataArray:
    """Return values with their unit and long name in place of other attributes."""
    values = values.drop_attrs(deep=False)
    values.attrs = {"units": units, "long_name": long_name}
    return values


def times_of(ds: xr.Dataset) -> dict[str, xr.Variable]:
    """Coordinates along time of a scene, which its results have, too."""
    coords = ds.coords
    return {name: ds.variables[name] for name in ("time", "step") if name in coords}


def mark_skipped(result: xr.Dataset, arrays: Mapping[str, Any]) -> xr.Dataset:
    """Label the skipped steps: the coordinate ``skipped``, and once known, an attribute."""
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
    numbers = (
        result["step"].to_numpy() if "step" in result.coords else np.arange(result.sizes["time"])
    )
    return result.assign_attrs(skipped_steps=numbers[skipped.to_numpy()])


def format_call(function: str, given: Mapping[str, Any]) -> str:
    """Write a call on one line, arrays by their shape."""
    shown = {}
    for name, value in given.items():
        if isinstance(value, Mapping) and any(
            np.ndim(one) and hasattr(one, "dtype") for one in value.values()
        ):
            shown[name] = format_call("dict", value)
        else:
            array = hasattr(value, "dtype") and np.ndim(value)
            shown[name] = f"<array {np.shape(value)}>" if array else printable(repr(value))
    return f"{function}({', '.join(f'{name}={text}' for name, text in shown.items())})".replace(
        "\n", " "
    )


def call_of(function: str, arguments: Mapping[str, Any]) -> str:
    """Write a call, without the data, `on_error`, and arguments that have no value."""
    left_out = ("ds", "f", "fc", "on_error")
    return format_call(
        function,
        {n: value for n, value in arguments.items() if n not in left_out and value is not None},
    )


def provenance(ds: xr.Dataset | Description, call: str) -> dict[str, Any]:
    """Attributes of a result: what holds for the scene, then its history with the time, the version and the call."""
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = f"{stamp} xcg {version('xcg')}: {call}"
    earlier = ds.attrs.get("history")
    kept = {name: ds.attrs[name] for name in ABOUT if name in ds.attrs}
    return kept | {"history": line if earlier is None else f"{earlier}\n{line}"}


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
    return (
        str(label)
        if isinstance(label, (int, np.integer)) and not isinstance(label, bool)
        else label
    )


def with_phase_labels(result: xr.Dataset) -> xr.Dataset:
    """Make phases of a result selectable by whole numbers, too."""
    for dim in PHASES:
        if dim in result.dims and dim in result.coords:
            plain = result[dim].variable
            index = PandasIndex(PhaseLabels(plain.to_numpy(), dim), dim, coord_dtype=plain.dtype)
            result = result.assign_coords(xr.Coordinates.from_xindex(index))
            result[dim].attrs, result[dim].encoding = plain.attrs, plain.encoding
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
    count = ds.sizes.get("time", 1)
    steps = (
        f"{count} step{'s' * (count != 1)}"
        if "time" in ds.dims
        else "one step"
        if "time" in ds.coords
        else "all times"
    )
    along = ", ".join(str(ds.attrs.get("averaged_axes", "")))
    over = ds.attrs.get("averaged_steps")
    averaged = [f"along {along}"] * bool(along) + [f"over {over} steps"] * (over is not None)
    known = {*of_frame, "time", *PHASES, *AXES}
    return Summary.of(
        f"result of {steps}" + (f" on {nodes} nodes" if nodes else ""),
        [
            ("fields", ", ".join(map(str, ds.data_vars)) or "none"),
            *((a, _nodes(ds[a])) for a in axes),
            (
                "fixed",
                ", ".join(
                    f"{a} = {float(ds[a]):.6g}"
                    for a in of_frame
                    if a in ds.coords and not ds[a].ndim
                ),
            ),
            ("averaged", ", ".join(averaged)),
            *(
                (dim, ", ".join(map(str, np.atleast_1d(ds[dim]))))
                for dim in PHASES
                if dim in ds.coords
            ),
            *((str(dim), str(size)) for dim, size in ds.sizes.items() if dim not in known),
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
    steps = np.diff(nodes)
    even = steps.size and np.allclose(steps, steps[0], rtol=1e-6, atol=0)
    ends = f"{nodes[0]:.6g} to {nodes[-1]:.6g}" if steps.size else f"{nodes[0]:.6g}"
    text = f"{ends} {unit}".rstrip()
    return f"{text}, spacing {steps[0]:.6g}" if even else text


def _kernel(ds: xr.Dataset) -> str:
    """Return name, width and cutoff; one of each for groups that have their own."""
    if "kernel" not in ds.attrs:
        return ""
    lengths = (
        (name, np.atleast_1d(ds.attrs[name])) for name in ("width", "cutoff") if name in ds.attrs
    )
    shown = (
        f"{name} {' and '.join(f'{value:.6g}' for value in values)}" for name, values in lengths
    )
    return ", ".join([str(ds.attrs["kernel"]), *shown])
