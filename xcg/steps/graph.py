"""Dask tasks over time: one a chunk, which computes all results. Loaded for lazy scenes only, as dask loads slowly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import dask.array as da
import numpy as np
import xarray as xr
from dask.base import tokenize
from dask.blockwise import blockwise
from dask.highlevelgraph import HighLevelGraph
from dask.optimization import cull
from numpy.typing import NDArray

from xcg.steps.faults import SKIPPED, Compute, Result, guarded

if TYPE_CHECKING:
    import dask.array as da


def picked(
    graph: HighLevelGraph, layer: str, name: str, key: str, chunks: Sequence[int], shape: tuple[int, ...], dtype: Any
) -> da.Array:
    """Array of the entries `name` of the mappings that the tasks ``(layer, 0)``, ``(layer, 1)``, ... return.

    Parameters
    ----------
    graph : HighLevelGraph
        Holds `layer`.
    key : str
        Name of the array.
    chunks : sequence of int
        Steps in each chunk.
    shape : tuple of int
        Shape of one step.
    """
    import dask.array as da  # slow to import, and writers of arrays in memory take this module, too

    axes = tuple(range(1 + len(shape)))
    picks: Any = blockwise(
        itemgetter(name), key, axes, layer, (0,), numblocks={layer: (len(chunks),)}, new_axes=dict.fromkeys(axes[1:], 1)
    )
    picks.origin = layer, name
    whole = HighLevelGraph({**graph.layers, key: picks}, {**graph.dependencies, key: {layer}})
    sizes = (tuple(chunks), *((n,) for n in shape))
    return da.Array(whole, key, sizes, meta=np.empty((0,) * (1 + len(shape)), dtype))


def origin(array: da.Array) -> tuple[str, str] | None:
    """Layer and entry that all chunks of an array are picked from; None where it comes about otherwise."""
    return getattr(array.dask.layers.get(array.name), "origin", None)


@dataclass(frozen=True)
class Gathered:
    """Arrays of the same chunks of time, whole otherwise, for tasks that take one chunk of all of them.

    Attributes
    ----------
    sources : tuple
        What such a task depends on: layers by name and number of indices.
    entries : mapping
        Where each array is among them, and under which name in it; "" for an array itself.
    """

    sources: tuple[tuple[str, int], ...]
    entries: Mapping[str, tuple[int, str]]

    @classmethod
    def of(cls, arrays: Mapping[str, da.Array]) -> Gathered:
        """Find the sources of these arrays, each once."""
        sources: list[tuple[str, int]] = []
        entries = {}
        for name, array in arrays.items():
            found = origin(array)
            layer, entry = found or (array.name, "")
            source = (layer, 1 if found else array.ndim)
            if source not in sources:
                sources.append(source)
            entries[name] = (sources.index(source), entry)
        return cls(tuple(sources), entries)

    def keys(self, chunk: int) -> list[tuple[Any, ...]]:
        """Keys that the task of one chunk depends on."""
        return [(layer, chunk, *(0,) * (indices - 1)) for layer, indices in self.sources]

    def take(self, values: Sequence[Any]) -> dict[str, NDArray]:
        """Arrays by name, from the values of the keys."""
        return {name: values[k][entry] if entry else values[k] for name, (k, entry) in self.entries.items()}


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
    """Return the graph: one task a chunk of time, which computes all results."""
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
