"""One function over all chunks of time: at once for arrays in memory, as one dask task a chunk for lazy ones.

Steps that fail may be skipped. dask gives up a whole computation when one task fails, so a chunk of time that may be
skipped is one task that holds all it depends on, down to the reading of its files, and looks after its own faults.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

import dask.array as da
import numpy as np
import xarray as xr
from dask.base import tokenize
from dask.core import get
from dask.highlevelgraph import HighLevelGraph
from dask.optimization import cull
from numpy.typing import NDArray

from xcg.faults import FAULTS, check_on_error, tolerated, warn_of
from xcg.scene import frame_of
from xcg.schema import PADDING, Frame

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

    Raises
    ------
    ValueError
        If `ds` has no dimension ``time``.
    """
    if "time" not in ds.dims:
        msg = "the scene has no time dimension; select steps with a list, ds.isel(time=[3]), to keep it"
        raise ValueError(msg)
    inputs = _inputs(ds, names)
    lazy = any(isinstance(a, da.Array) for a in inputs.values())
    if check_on_error(on_error) == "skip":
        results = dict(results) | {SKIPPED: ((), "bool")}
        return _skipping(inputs, _numbers(ds), compute, results, label, lazy=lazy)
    if not lazy:
        return compute(inputs)
    name = f"{label}-{tokenize(compute, *inputs.values())}"
    chunks = next(iter(inputs.values())).chunks[0]
    tasks: dict[Any, Any] = {}
    for t in range(len(chunks)):
        keys = [(a.name, t, *(0,) * (a.ndim - 1)) for a in inputs.values()]
        tasks[name, t] = (partial(_compute_chunk, compute, tuple(inputs)), *keys)
    graph = HighLevelGraph.from_collections(name, tasks, dependencies=list(inputs.values()))
    return _picked(graph, name, results, chunks)


def _picked(
    graph: HighLevelGraph, name: str, results: Mapping[str, Result], chunks: tuple[int, ...]
) -> dict[str, da.Array]:
    """Lazy arrays of the results that the tasks of a layer return together."""
    out = {}
    for result, (shape, dtype) in results.items():
        key = f"{result}-{name}"
        picks = {(key, t, *(0,) * len(shape)): (_pick, (name, t), result) for t in range(len(chunks))}
        layers = HighLevelGraph({**graph.layers, key: picks}, {**graph.dependencies, key: {name}})
        meta = np.empty((0,) * (1 + len(shape)), dtype)
        out[result] = da.Array(layers, key, (chunks, *((n,) for n in shape)), meta=meta)
    return out


# --- steps that may be skipped ---------------------------------------------------------------------------


def _numbers(ds: xr.Dataset) -> NDArray | None:
    """Numbers of the steps, by which faults are told; None where the scene has lost them."""
    if "step" not in ds.coords or ds["step"].dims != ("time",) or isinstance(ds["step"].variable._data, da.Array):
        return None
    return ds["step"].to_numpy()


def _skipping(
    inputs: Mapping[str, Any],
    numbers: NDArray | None,
    compute: Compute,
    results: Mapping[str, Result],
    label: str,
    *,
    lazy: bool,
) -> dict[str, Any]:
    """As `map_over_time`, with every chunk looking after its own faults."""
    if not lazy:
        return _guarded(compute, results, numbers, {}, {}, inputs)
    name = f"{label}-skip-{tokenize(compute, *inputs.values())}"
    chunks = next(iter(inputs.values())).chunks[0]
    below = HighLevelGraph.merge(*(a.__dask_graph__() for a in inputs.values())).to_dict()
    tasks: dict[Any, Any] = {}
    start = 0
    for t, length in enumerate(chunks):
        keys = {of: (a.name, t, *(0,) * (a.ndim - 1)) for of, a in inputs.items()}
        part, _ = cull(below, list(keys.values()))
        these = None if numbers is None else numbers[start : start + length]
        # all that the chunk needs is within the task, where dask does not look
        tasks[name, t] = (partial(_guarded, compute, results, these, part, keys, {}),)
        start += length
    return _picked(HighLevelGraph({name: tasks}, {name: set()}), name, results, chunks)


def _guarded(
    compute: Compute,
    results: Mapping[str, Result],
    numbers: NDArray | None,
    graph: Mapping[Any, Any],
    keys: Mapping[str, Any],
    arrays: Mapping[str, NDArray],
) -> dict[str, NDArray]:
    """Results of one chunk; steps that cannot be read or computed are filled, and warned of."""
    with tolerated() as faults:
        if keys:
            try:
                arrays = dict(zip(keys, get(graph, list(keys.values())), strict=True))
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
            faults[number] = str(error)
    warn_of({number: cause for number, cause in faults.items() if number in named})
    return _filled(results, count, found)


def _all_skipped(results: Mapping[str, Result], numbers: NDArray | None, error: Exception) -> dict[str, NDArray]:
    if numbers is None:
        raise error  # how many steps there are is not known
    warn_of(dict.fromkeys(numbers.tolist(), str(error)))
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
            where: Any = (t, *map(slice, one[name].shape[1:]))
            out[name][where] = one[name][0]
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
