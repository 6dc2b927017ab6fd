"""Averages of small lazy results in one task: dask takes longer to lay thousands of tasks than to do them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from xcg.common.messages import Once, active_call
from xcg.fields.formulas.doubts import NOT_NODES, SHARES

# Larger results are averaged variable by variable, so that those which are not asked for are never
# in memory.
_MOST = 2**27  # bytes


def is_small(f: xr.Dataset) -> bool:
    """Return whether a result is lazy, and all of it small."""
    # f.chunks raises where variables differ in their chunks
    is_lazy = any(variable.chunks for variable in f.variables.values())
    return is_lazy and f.nbytes <= _MOST


def in_one_task(
    function: Callable[..., xr.Dataset], f: xr.Dataset, arguments: Mapping[str, Any]
) -> xr.Dataset:
    """Return ``function(f, **arguments)`` lazily, as one task that takes all of a result.

    Names, dimensions, attributes and errors of the arguments come from a result of one unknown node.
    Dimensions of nodes must come out as they are.
    """
    nodes = [str(dim) for dim in f.dims if dim not in ("time", *NOT_NODES)]
    kwargs: dict[str, Any] = {
        "function": function,
        "call": active_call(),
        "arguments": dict(arguments),
    }
    template = _called(_unknown(f.isel(dict.fromkeys(nodes, slice(0, 1)))), **kwargs)
    variables = {}
    for name, variable in template.variables.items():
        attrs = {key: value for key, value in variable.attrs.items() if key not in SHARES}
        variable = variable.isel({dim: [0] * f.sizes[dim] for dim in nodes if dim in variable.dims})
        if name not in template.indexes:
            variable = variable.chunk()
        variables[name] = variable._replace(attrs=attrs)
    for dim in nodes:
        if dim in f.coords:
            variables[dim] = f[dim].variable
    template = xr.Dataset(variables, attrs=template.attrs).set_coords(list(template.coords))
    whole = f.chunk(dict.fromkeys(f.dims, -1))
    if not template.chunks:  # map_blocks takes no template of single numbers, as of a flow rate
        return function(whole, **arguments)
    return xr.map_blocks(_called, whole, kwargs=kwargs, template=template)


def _called(
    f: xr.Dataset, *, function: Callable[..., xr.Dataset], call: Once, arguments: dict[str, Any]
) -> xr.Dataset:
    """Call a function, which warns for the call that laid the task."""
    with call.active():
        return function(f, **arguments)


def _unknown(f: xr.Dataset) -> xr.Dataset:
    """Return a result in memory: NaN, 0 or False in place of lazy numbers; texts are read, such as `setup`."""
    variables = {}
    for name, variable in f.variables.items():
        if variable.dtype.kind not in "fiub":
            variable = variable.compute()
        if variable.chunks is not None:
            fill = np.nan if variable.dtype.kind == "f" else np.zeros((), variable.dtype)
            variable = variable.copy(data=np.full(variable.shape, fill, variable.dtype))
        variables[name] = variable
    return xr.Dataset(variables, attrs=f.attrs).set_coords(list(f.coords))
