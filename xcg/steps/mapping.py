"""Map a function over all chunks of time: at once in memory, as one dask task a chunk for lazy scenes."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import Once
from xcg.steps.faults import SKIPPED, Compute, OnError, Result, check_on_error, guarded


def map_over_time(
    ds: xr.Dataset,
    names: Iterable[str],
    compute: Compute,
    results: Mapping[str, Result],
    label: str,
    on_error: OnError = "raise",
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
    once, variables = Once(), ds.variables
    inputs = {name: variables[name].transpose(*_order(variables[name].dims)) for name in names}
    skip = on_error != "raise" and check_on_error(on_error) == "skip"
    numbers = _numbers(ds) if skip else None
    if skip:
        results = dict(results) | {SKIPPED: ((), "bool")}
    if any(map(_chunked, inputs.values())):
        from xcg.steps.graph import lazy_results  # and with it dask

        return lazy_results(inputs, partial(_with_warnings_once, once, compute), results, label, numbers, on_error)
    arrays = {name: given.to_numpy() for name, given in inputs.items()}
    with once.active():
        return guarded(compute, results, numbers, {}, {}, arrays) if skip else compute(arrays)


def _with_warnings_once(once: Once, compute: Compute, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Compute a chunk; warnings of `xcg.common.messages.warn_once` are given once for all chunks."""
    with once.active():
        return compute(arrays)


@cache
def _order(dims: tuple[Hashable, ...]) -> tuple[Hashable, ...]:
    """Dimensions of a step in the order of tasks."""
    last = [dim for dim in ("component", "direction", "bound") if dim in dims]
    return ("time", *(dim for dim in dims if dim not in ("time", *last)), *last)


def _numbers(ds: xr.Dataset) -> NDArray | None:
    """Numbers of the steps, which messages about faults name; None where the scene has lost them."""
    if "step" not in ds.coords or ds["step"].dims != ("time",) or ds["step"].chunks is not None:
        return None
    return ds["step"].to_numpy()


def is_lazy(ds: xr.Dataset, names: Iterable[str]) -> bool:
    """Return whether any of these variables is a dask array."""
    variables = ds.variables
    return any(_chunked(variables[name]) for name in names)


def threads_a_chunk(ds: xr.Dataset, names: Iterable[str], threads: int) -> int:
    """Return the number of threads of a chunk of time: all for a single chunk, else one."""
    variables = ds.variables
    lazy = (given for name in names if _chunked(given := variables[name]))
    return threads if all(len(given.chunksizes.get("time", ())) <= 1 for given in lazy) else 1


def _chunked(given: xr.Variable) -> bool:
    return given.chunks is not None


def chunks_of_time(series: Iterable[xr.Dataset]) -> list[slice]:
    """List the steps of each chunk of time, which cuts no chunk of any variable; single steps where none is lazy.

    A task computes a whole chunk, whatever part of it is asked for.
    """
    edges = [set(range(ds.sizes["time"] + 1)) for ds in series]
    for ds in series:
        edges += [
            {0, *np.cumsum(values.chunks[values.get_axis_num("time")]).tolist()}
            for values in ds.variables.values()
            if values.chunks is not None and "time" in values.dims
        ]
    return [slice(first, end) for first, end in pairwise(sorted(set.intersection(*edges)))]


def each_step(ds: xr.Dataset) -> Iterator[xr.Dataset]:
    """Compute the steps of a Dataset, each with a time dimension of one; all of it where it has no time."""
    if "time" not in ds.dims:
        yield ds.compute()
        return
    for steps in chunks_of_time([ds]):
        chunk = ds.isel(time=steps).compute()
        for t in range(chunk.sizes["time"]):
            yield chunk.isel(time=[t])
