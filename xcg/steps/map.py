"""One function over all chunks of time: at once for arrays in memory, as one dask task a chunk for lazy ones.

Steps that fail may be skipped. dask gives up a whole computation when one task fails, so a chunk of time that may be
skipped is one task that holds all it depends on, down to the reading of its files, and looks after its own faults.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, TypeAlias

import dask.array as da
import numpy as np
import xarray as xr
from dask.base import tokenize
from dask.core import get
from dask.highlevelgraph import HighLevelGraph
from dask.optimization import cull
from numpy.typing import NDArray

from xcg.scene.schema import PADDING
from xcg.scene.warn import Once
from xcg.steps.errors import FAULTS, cause_of, check_on_error, collecting, warn_of
from xcg.steps.graph import Gathered, picked

# computes the results of a chunk from its arrays, time first, by name
Compute: TypeAlias = Callable[[Mapping[str, NDArray]], dict[str, NDArray]]
# shape of one step, and type
Result: TypeAlias = tuple[tuple[int, ...], str]


SKIPPED = "skipped"


def map_over_time(
    ds: xr.Dataset,
    names: Iterable[str],
    compute: Compute,
    results: Mapping[str, Result],
    label: str,
    on_error: str = "raise",
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
    on_error : {"raise", "skip"}
        "skip" fills the steps that cannot be read or computed with NaN (-1 in integers), warns of each when it is
        computed, and adds the result ``skipped``, True for these steps.

    Returns
    -------
    dict
        NumPy or dask arrays by the names in `results`, and ``skipped`` where steps may be.
    """
    compute = partial(_said_once, Once(), compute)
    inputs = _inputs(ds, names)
    lazy = {n: a for n, a in inputs.items() if isinstance(a, da.Array)}
    fixed = {n: a for n, a in inputs.items() if n not in lazy}
    skip = check_on_error(on_error) == "skip"
    if skip:
        results = dict(results) | {SKIPPED: ((), "bool")}
    if not lazy:
        return _guarded(compute, results, _numbers(ds), {}, {}, fixed) if skip else compute(fixed)
    name = f"{label}-{tokenize(compute, inputs, on_error)}"
    chunks = next(iter(lazy.values())).chunks[0]
    if skip:
        tasks = _guarded_tasks(name, partial(_guarded, compute, results), _numbers(ds), lazy, fixed, chunks)
        graph = HighLevelGraph({name: tasks}, {name: set()})
    else:
        tasks = _tasks(name, compute, lazy, fixed, chunks)
        graph = HighLevelGraph.from_collections(name, tasks, list(lazy.values()))
    return {
        result: picked(graph, name, result, f"{result}-{name}", chunks, shape, dtype)
        for result, (shape, dtype) in results.items()
    }


def _said_once(once: Once, compute: Compute, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Compute a chunk, with what `xcg.scene.warn.warn_once` says said once for all chunks."""
    with once.active():
        return compute(arrays)


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


# --- steps that may be skipped ---------------------------------------------------------------------------


def _numbers(ds: xr.Dataset) -> NDArray | None:
    """Numbers of the steps, by which faults are told; None where the scene has lost them."""
    if "step" not in ds.coords or ds["step"].dims != ("time",) or isinstance(ds["step"].variable._data, da.Array):
        return None
    return ds["step"].to_numpy()


def _guarded_tasks(
    name: str,
    guarded: Callable[..., dict[str, NDArray]],
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
        tasks[name, t] = (partial(guarded, these, part, keys, {n: a[start:stop] for n, a in fixed.items()}),)
    return tasks


def _guarded(
    compute: Compute,
    results: Mapping[str, Result],
    numbers: NDArray | None,
    graph: Mapping[Any, Any],
    keys: Mapping[str, Any],
    arrays: Mapping[str, NDArray],
) -> dict[str, NDArray]:
    """Results of one chunk; steps that cannot be read or computed are filled, and warned of."""
    with collecting() as faults:
        if keys:
            try:
                arrays = dict(arrays) | dict(zip(keys, get(graph, list(keys.values())), strict=True))
            except FAULTS as error:  # of none of its steps alone
                return _all_skipped(results, numbers, error)
    count = len(next(iter(arrays.values())))
    named = np.arange(count) if numbers is None else numbers
    if numbers is None and faults:
        faults = dict.fromkeys(named.tolist(), next(iter(faults.values())))
    if not any(number in faults for number in named.tolist()):
        try:
            return {**compute(arrays), SKIPPED: np.zeros(count, bool)}
        except FAULTS:
            pass  # find out which step it is
    found: dict[int, dict[str, NDArray]] = {}
    for t, number in enumerate(named.tolist()):
        if number in faults:
            continue
        try:
            found[t] = compute({of: a[t : t + 1] for of, a in arrays.items()})
        except FAULTS as error:
            faults[number] = cause_of(error)
    warn_of({number: cause for number, cause in faults.items() if number in named})
    return _filled(results, count, found)


def _all_skipped(results: Mapping[str, Result], numbers: NDArray | None, error: Exception) -> dict[str, NDArray]:
    if numbers is None:
        raise error  # how many steps there are is not known
    warn_of(dict.fromkeys(numbers.tolist(), cause_of(error)))
    return _filled(results, len(numbers), {})


def _filled(
    results: Mapping[str, Result], count: int, found: Mapping[int, Mapping[str, NDArray]]
) -> dict[str, NDArray]:
    """Results of the steps that were computed, and padding in place of the others."""
    out = {}
    for name, (shape, dtype) in results.items():
        if name == SKIPPED:
            out[name] = np.array([t not in found for t in range(count)])
            continue
        # a search in memory finds out by itself how many rows it returns
        sizes = [one[name].shape[1:] for one in found.values()] or [shape]
        whole = np.max(sizes, axis=0).astype(int) if shape else ()
        fill = np.nan if np.dtype(dtype).kind == "f" else PADDING
        out[name] = np.full((count, *whole), fill, dtype)
        for t, one in found.items():
            source: Any = (t, *map(slice, one[name].shape[1:]))
            out[name][source] = one[name][0]
    return out


def is_lazy(ds: xr.Dataset, names: Iterable[str]) -> bool:
    """Whether any of these variables is a dask array."""
    return any(isinstance(ds.variables[name]._data, da.Array) for name in names)


def chunks_in(ds: xr.Dataset, names: Iterable[str]) -> int:
    """How many chunks of time there are to compute, each by a thread of its own; 1 for a scene in memory."""
    lazy = (given for name in names if isinstance((given := ds.variables[name])._data, da.Array))
    return max((len(given.chunksizes.get("time", ())) for given in lazy), default=1)


def _inputs(ds: xr.Dataset, names: Iterable[str]) -> dict[str, Any]:
    """Arrays of the scene, time first, whole along every other dimension."""
    found: dict[str, Any] = {}
    for name in names:
        given = ds.variables[name]
        array = given.transpose("time", ..., *[d for d in ("component", "direction", "bound") if d in given.dims])
        found[name] = array._data if isinstance(array._data, da.Array) else array.to_numpy()
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
