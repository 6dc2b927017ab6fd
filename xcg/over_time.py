"""Map a function of one frame over the steps of a scene: at once where it is in memory, else one task a chunk."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import getitem
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph
from numpy.typing import NDArray

from xcg.scene import frame_of
from xcg.schema import Frame

# function(frame, box, where, out) fills the arrays of one step; box is None where the scene has none
StepFunction = Callable[[Frame, NDArray | None, str, Mapping[str, NDArray]], None]


@dataclass(frozen=True)
class Output:
    """One array that a step fills: its shape, type, and what it holds where it is not filled."""

    shape: tuple[int, ...]
    dtype: Any = "float64"
    fill: float | int = np.nan


def is_lazy(ds: xr.Dataset, variables: Sequence[str]) -> bool:
    """Whether any of these variables is a dask array."""
    return any(isinstance(ds[name].variable._data, da.Array) for name in variables)


def map_over_time(
    ds: xr.Dataset, variables: Sequence[str], function: StepFunction, outputs: Mapping[str, Output], name: str
) -> dict[str, Any]:
    """Apply a function to every step.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    variables : sequence of str
        What the function reads; the box and the number of the step come along.
    function : callable
        ``function(frame, box, where, out)`` for one step, which fills the arrays of `out`; it must pickle.
    outputs : mapping
        The arrays of one step, by name; what the function leaves out keeps their fill.
    name : str
        Of the tasks.

    Returns
    -------
    dict
        Arrays, time first: NumPy where the scene is in memory, else dask, with one task for each chunk of time.

    Raises
    ------
    ValueError
        If the scene has no time dimension.
    """
    inputs = inputs_of(ds, variables)
    if not any(isinstance(a, da.Array) for a in inputs.values()):
        return map_chunk(function, outputs, tuple(inputs), *inputs.values())
    layer = f"{name}-{tokenize(function, outputs, *inputs.values())}"
    chunks = next(iter(inputs.values())).chunks[0]
    tasks: dict[Any, Any] = {}
    for t in range(len(chunks)):
        keys = [(a.name, t, *(0,) * (a.ndim - 1)) for a in inputs.values()]
        tasks[layer, t] = (map_chunk, function, dict(outputs), tuple(inputs), *keys)
    graph = HighLevelGraph.from_collections(layer, tasks, dependencies=list(inputs.values()))
    out = {}
    for output, about in outputs.items():
        key = f"{output}-{layer}"
        zeros = (0,) * len(about.shape)
        picks = {(key, t, *zeros): (getitem, (layer, t), output) for t in range(len(chunks))}
        whole = HighLevelGraph({**graph.layers, key: picks}, {**graph.dependencies, key: {layer}})
        sizes = (chunks, *((n,) for n in about.shape))
        out[output] = da.Array(whole, key, sizes, meta=np.empty((0, *zeros), about.dtype))
    return out


def inputs_of(ds: xr.Dataset, variables: Sequence[str]) -> dict[str, Any]:
    """Arrays of the scene with the box and step numbers, time first, whole along every other dimension."""
    if "time" not in ds.dims:
        msg = "the scene has no time dimension; select steps with a list, ds.isel(time=[3]), to keep it"
        raise ValueError(msg)
    names = [*variables, *(name for name in ("box", "step") if name in ds)]
    found: dict[str, Any] = {}
    for name in names:
        array = ds[name].transpose("time", *[d for d in ds[name].dims if d not in ("time", "component", "bound")], ...)
        data = array.variable._data if isinstance(array.variable._data, da.Array) else array.to_numpy()
        found[name] = data
    lazy = [a for a in found.values() if isinstance(a, da.Array)]
    if lazy:
        finest = max((a.chunks[0] for a in lazy), key=len)
        found = {
            name: da.asarray(a).rechunk({0: finest, **dict.fromkeys(range(1, a.ndim), -1)}) for name, a in found.items()
        }
    return found


def steps_in(inputs: Mapping[str, NDArray]) -> Iterator[tuple[Frame, NDArray | None, str]]:
    """Frame, box and name of each step of padded arrays in memory."""
    boxes, steps = inputs.get("box"), inputs.get("step")
    rows = {name: a for name, a in inputs.items() if name not in ("box", "step")}
    for t in range(len(next(iter(rows.values())))):
        where = f"frame {t} of its chunk" if steps is None else f"step {steps[t]}"
        yield frame_of(rows, t), None if boxes is None else boxes[t], where


def map_chunk(
    function: StepFunction, outputs: Mapping[str, Output], names: Sequence[str], *arrays: NDArray
) -> dict[str, NDArray]:
    """Results of the steps of one chunk, from padded arrays in the order of `names`."""
    out = {name: np.full((len(arrays[0]), *about.shape), about.fill, about.dtype) for name, about in outputs.items()}
    for t, step in enumerate(steps_in(dict(zip(names, arrays, strict=True)))):
        function(*step, {name: a[t, ...] for name, a in out.items()})
    return out
