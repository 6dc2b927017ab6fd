"""One function over all chunks of time: at once for arrays in memory, as one dask task a chunk for lazy ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

import dask.array as da
import numpy as np
import xarray as xr
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph
from numpy.typing import NDArray

from xcg.scene import frame_of
from xcg.schema import Frame

# computes the results of a chunk from its arrays, time first, by name
Compute: TypeAlias = Callable[[Mapping[str, NDArray]], dict[str, NDArray]]
# shape of one step, and type
Result: TypeAlias = tuple[tuple[int, ...], str]


def map_over_time(
    ds: xr.Dataset, names: Iterable[str], compute: Compute, results: Mapping[str, Result], label: str
) -> dict[str, Any]:
    """Arrays of all results, time first: computed if the scene is in memory, else one task a chunk of time.

    Parameters
    ----------
    ds : xarray.Dataset
        A Dataset with the dimension ``time``.
    names : iterable of str
        Variables and coordinates that `compute` needs; each must have the dimension ``time``.
    compute : callable
        Takes and returns mappings from names to arrays, time first. It travels to the workers, so it must pickle.
    results : mapping
        Shape of one step, and type, of everything that `compute` returns.
    label : str
        Name of the tasks.

    Returns
    -------
    dict
        NumPy or dask arrays by the names in `results`.

    Raises
    ------
    ValueError
        If `ds` has no dimension ``time``.
    """
    if "time" not in ds.dims:
        msg = "the scene has no time dimension; select steps with a list, ds.isel(time=[3]), to keep it"
        raise ValueError(msg)
    inputs = _inputs(ds, names)
    if not any(isinstance(a, da.Array) for a in inputs.values()):
        return compute(inputs)
    lazy: dict[str, da.Array] = inputs
    name = f"{label}-{tokenize(compute, *lazy.values())}"
    chunks = next(iter(lazy.values())).chunks[0]
    tasks: dict[Any, Any] = {}
    for t in range(len(chunks)):
        keys = [(a.name, t, *(0,) * (a.ndim - 1)) for a in lazy.values()]
        tasks[name, t] = (partial(_compute_chunk, compute, tuple(lazy)), *keys)
    graph = HighLevelGraph.from_collections(name, tasks, dependencies=list(lazy.values()))
    out = {}
    for result, (shape, dtype) in results.items():
        key = f"{result}-{name}"
        picks = {(key, t, *(0,) * len(shape)): (_pick, (name, t), result) for t in range(len(chunks))}
        layers = HighLevelGraph({**graph.layers, key: picks}, {**graph.dependencies, key: {name}})
        meta = np.empty((0,) * (1 + len(shape)), dtype)
        out[result] = da.Array(layers, key, (chunks, *((n,) for n in shape)), meta=meta)
    return out


def steps_in(arrays: Mapping[str, NDArray]) -> Iterator[tuple[Frame, NDArray | None, str]]:
    """Frame, box and name of each step of padded arrays; the box is None where they hold none."""
    boxes, steps = arrays.get("box"), arrays.get("step")
    rows = {name: a for name, a in arrays.items() if name not in ("box", "step")}
    for t in range(len(next(iter(rows.values())))):
        where = f"frame {t} of its chunk" if steps is None else f"step {steps[t]}"
        yield frame_of(rows, t), None if boxes is None else boxes[t], where


def is_lazy(ds: xr.Dataset, names: Iterable[str]) -> bool:
    """Whether any of these variables is a dask array."""
    return any(isinstance(ds[name].variable._data, da.Array) for name in names)


def _inputs(ds: xr.Dataset, names: Iterable[str]) -> dict[str, Any]:
    """Arrays of the scene, time first, whole along every other dimension."""
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


def _compute_chunk(compute: Compute, names: Sequence[str], *arrays: NDArray) -> dict[str, NDArray]:
    return compute(dict(zip(names, arrays, strict=True)))


def _pick(arrays: Mapping[str, NDArray], name: str) -> NDArray:
    return arrays[name]
