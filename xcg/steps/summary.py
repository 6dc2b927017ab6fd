"""What `ds.cg` shows of results: their variables, where and when they hold, and how they were made."""

from __future__ import annotations

import numpy as np
import xarray as xr

from xcg.scene.schema import COMPONENTS
from xcg.scene.summary import Summary, rows_of_origin
from xcg.scene.times import with_time


def summary_of_result(ds: xr.Dataset) -> Summary:
    """Tell what a result holds, also one that was averaged, sliced, or opened from a file, without computing it."""
    if not {"history", "kernel"} & set(ds.attrs) and not {"time", "phase", *COMPONENTS} & set(map(str, ds.coords)):
        return Summary.of(
            "neither a scene nor a result: no 'position', no coordinates",
            [("variables", ", ".join(map(str, ds.data_vars)) or "none")],
        )
    ds = with_time(ds)
    axes = [a for a in COMPONENTS if a in ds.dims]
    nodes = " x ".join(f"{ds.sizes[a]} {a}" for a in axes)
    steps = f"{ds.sizes['time']} steps" if "time" in ds.dims else "one step" if "time" in ds.coords else "all times"
    along = ", ".join(str(ds.attrs.get("averaged_axes", "")))
    over = ds.attrs.get("averaged_steps")
    averaged = [f"along {along}"] * bool(along) + [f"over {over} steps"] * (over is not None)
    known = {*COMPONENTS, "time", "phase", "other_phase", "component", "direction", "principal"}
    return Summary.of(
        f"result of {steps}" + (f" on {nodes} nodes" if nodes else ""),
        [
            ("fields", ", ".join(map(str, ds.data_vars)) or "none"),
            *((a, _nodes(ds[a])) for a in axes),
            ("fixed", ", ".join(f"{a} = {float(ds[a]):.6g}" for a in COMPONENTS if a in ds.coords and not ds[a].ndim)),
            ("averaged", ", ".join(averaged)),
            *((dim, _labels(ds, dim)) for dim in ("phase", "other_phase") if dim in ds.coords),
            *((str(dim), str(size)) for dim, size in ds.sizes.items() if dim not in known),
            ("kernel", _kernel(ds)),
            *rows_of_origin(ds),
            ("history", str(ds.attrs.get("history", "")).rpartition("\n")[2]),
        ],
    )


def _labels(ds: xr.Dataset, dim: str) -> str:
    return ", ".join(map(str, np.atleast_1d(ds[dim].to_numpy())))


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
    """Tell name, width and cutoff; one of each for groups that have their own."""
    if "kernel" not in ds.attrs:
        return ""
    lengths = ((name, np.atleast_1d(ds.attrs[name])) for name in ("width", "cutoff") if name in ds.attrs)
    shown = (f"{name} {' and '.join(f'{value:.6g}' for value in values)}" for name, values in lengths)
    return ", ".join([str(ds.attrs["kernel"]), *shown])
