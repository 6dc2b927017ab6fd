"""The steps of a lazy Dataset one after the other, with each chunk of time computed once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np
import xarray as xr


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
