"""Dask tasks over time: one a chunk, which computes all results.

A scene in memory does without this module, as dask.array takes as long to import as xarray.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph
from dask.optimization import cull
from numpy.typing import NDArray

from xcg.steps.graph import Gathered, picked
from xcg.steps.skip import SKIPPED, Compute, Result, guarded


def lazy_results(
    inputs: Mapping[str, xr.Variable],
    compute: Compute,
    results: Mapping[str, Result],
    label: str,
    numbers: NDArray | None,
    on_error: str,
) -> dict[str, Any]:
    """Dask arrays of all results, of variables (time, ...) some of which are lazy; see `map_over_time`."""
    arrays = _in_chunks(inputs)
    lazy = {n: a for n, a in arrays.items() if isinstance(a, da.Array)}
    fixed = {n: a for n, a in arrays.items() if n not in lazy}
    name = f"{label}-{tokenize(compute, arrays, on_error)}"
    chunks = next(iter(lazy.values())).chunks[0]
    # a key of its own, so that what all tasks share, such as a million points, travels to a worker once
    call = f"call-{name}"
    if SKIPPED in results:
        tasks = {call: partial(guarded, compute, results), **_guarded_tasks(name, call, numbers, lazy, fixed, chunks)}
        graph = HighLevelGraph({name: tasks}, {name: set()})
    else:
        tasks = {call: compute, **_tasks(name, call, lazy, fixed, chunks)}
        graph = HighLevelGraph.from_collections(name, tasks, list(lazy.values()))
    return {
        result: picked(graph, name, result, f"{result}-{name}", chunks, shape, dtype)
        for result, (shape, dtype) in results.items()
    }


def _in_chunks(inputs: Mapping[str, xr.Variable]) -> dict[str, Any]:
    """Arrays whole along every dimension but time, and there with the finest chunks of all."""
    found = {n: v._data if isinstance(v._data, da.Array) else v.to_numpy() for n, v in inputs.items()}
    lazy = {n: a for n, a in found.items() if isinstance(a, da.Array)}
    finest = max((a.chunks[0] for a in lazy.values()), key=len)
    return found | {n: a.rechunk({0: finest, **dict.fromkeys(range(1, a.ndim), -1)}) for n, a in lazy.items()}


def _tasks(
    name: str, call: str, lazy: Mapping[str, da.Array], fixed: Mapping[str, NDArray], chunks: Sequence[int]
) -> dict[Any, Any]:
    """One task a chunk of time, which computes all results."""
    gathered = Gathered.of(lazy)
    tasks = {}
    for t, (start, stop) in enumerate(pairwise(np.cumsum([0, *chunks]).tolist())):
        here = {n: a[start:stop] for n, a in fixed.items()}
        tasks[name, t] = (partial(_compute_chunk, gathered, here), call, *gathered.keys(t))
    return tasks


def _guarded_tasks(
    name: str,
    call: str,
    numbers: NDArray | None,
    lazy: Mapping[str, da.Array],
    fixed: Mapping[str, NDArray],
    chunks: Sequence[int],
) -> dict[Any, Any]:
    """As `_tasks`, with every chunk looking after its own faults: what it needs is within its task."""
    below = HighLevelGraph.merge(*(a.__dask_graph__() for a in lazy.values())).to_dict()
    tasks: dict[Any, Any] = {}
    for t, (start, stop) in enumerate(pairwise(np.cumsum([0, *chunks]).tolist())):
        keys = {of: (a.name, t, *(0,) * (a.ndim - 1)) for of, a in lazy.items()}
        part, _ = cull(below, list(keys.values()))
        these = None if numbers is None else numbers[start:stop]
        here = {n: a[start:stop] for n, a in fixed.items()}
        tasks[name, t] = (partial(_compute_guarded, these, part, keys, here), call)
    return tasks


def _compute_chunk(
    gathered: Gathered, fixed: Mapping[str, NDArray], compute: Compute, *given: Any
) -> dict[str, NDArray]:
    return compute({**gathered.take(given), **fixed})


def _compute_guarded(*arguments: Any) -> dict[str, NDArray]:
    *chunk, compute = arguments
    return compute(*chunk)
