"""One function over all chunks of time: at once for arrays in memory, as one dask task a chunk for lazy ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, TypeAlias

import dask.array as da
import numpy as np
import xarray as xr
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph
from numpy.typing import NDArray

from xcg.picks import Gathered, picked
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
    lazy = {n: a for n, a in inputs.items() if isinstance(a, da.Array)}
    if not lazy:
        return compute(inputs)
    fixed = {n: a for n, a in inputs.items() if n not in lazy}
    name = f"{label}-{tokenize(compute, inputs)}"
    chunks = next(iter(lazy.values())).chunks[0]
    graph = HighLevelGraph.from_collections(name, _tasks(name, compute, lazy, fixed, chunks), list(lazy.values()))
    return {
        result: picked(graph, name, result, f"{result}-{name}", chunks, shape, dtype)
        for result, (shape, dtype) in results.items()
    }


def _tasks(
    name: str, compute: Compute, lazy: Mapping[str, da.Array], fixed: Mapping[str, NDArray], chunks: Sequence[int]
) -> dict[Any, Any]:
    """One task a chunk of time, which computes all results."""
    gathered = Gathered.of(lazy)
    tasks = {}
    for t, (start, stop) in enumerate(pairwise(np.cumsum([0, *chunks]).tolist())):
        here = {n: a[start:stop] for n, a in fixed.items()}
        tasks[name, t] = (partial(_compute_chunk, compute, gathered, here), *gathered.keys(t))
    return tasks


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
    lazy = {n: a for n, a in found.items() if isinstance(a, da.Array)}
    if lazy:
        finest = max((a.chunks[0] for a in lazy.values()), key=len)
        whole = {n: a.rechunk({0: finest, **dict.fromkeys(range(1, a.ndim), -1)}) for n, a in lazy.items()}
        found |= whole
    return found


def _compute_chunk(
    compute: Compute, gathered: Gathered, fixed: Mapping[str, NDArray], *given: Any
) -> dict[str, NDArray]:
    return compute({**gathered.take(given), **fixed})
