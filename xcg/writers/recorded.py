"""Steps of one record: requests and steps are compared with the ones in its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from xcg.common.messages import SceneError
from xcg.fields.like import arguments_of_nodes, groups_of
from xcg.fields.request import Request
from xcg.fields.sums.kernels import Kernel
from xcg.scene.facts import OF_SCENES, SAVED_OPTIONS, saved_options

_OF_A_STEP = ("size_diameter", "wrapped_axes")  # which change with the grains and the box
# attributes that all steps have in common
_SAME = tuple(name for name in (*OF_SCENES, *SAVED_OPTIONS) if name not in _OF_A_STEP)


def check_request(request: Request, recorded: xr.Dataset) -> None:
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
        spacing = np.append(np.diff(x), np.inf)[0]
        # the last node lies before its bound where the spacing does not divide the range
        if 0 <= high - last < spacing * (1 - 1e-6):
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
    requested: Any = request.spacing
    if not isinstance(requested, Mapping):
        requested = dict.fromkeys("xyz", requested)
    for a, spacing in requested.items():
        if spacing is None or isinstance(spacing, str) or recorded.sizes.get(a, 0) < 2:
            continue
        of_file = float(recorded[a][1] - recorded[a][0])
        if a in recorded.attrs.get("periodic", "") and a not in (request.bounds or {}):
            # the nearest that divides the period
            period = recorded.sizes[a] * of_file
            spacing = period / max(1, np.floor(period / spacing + 0.5))
        pairs[f"spacing along {a}"] = (spacing, of_file)
    return pairs


def with_mesh_of(request: Request, fields: xr.Dataset) -> Request:
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


def check_step(before: xr.Dataset, fields: xr.Dataset, path: Path) -> None:
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
