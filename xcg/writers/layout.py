"""What of a Dataset is written step by step, in which chunks, and the writing of it from memory or by tasks."""

from __future__ import annotations

from collections.abc import Sequence

import dask
import numpy as np
import xarray as xr

from xcg.scene.build import storable
from xcg.writers.chunks import Write, write_chunks
from xcg.writers.encoding import Encoding


def prepared(ds: xr.Dataset, encoding: Encoding) -> tuple[xr.Dataset, list[str]]:
    """Give a Dataset as it is written, and the names of its numbers over time, which are written step by step."""
    ds = encoding.noted(storable(ds.drop_encoding()))
    # texts and dates are left to xarray, which writes them as something else
    numbers = {name: data for name, data in ds.data_vars.items() if data.dtype.kind in "biufc"}
    over = [str(name) for name, data in numbers.items() if "time" in data.dims and data.size]
    ds = ds.assign({name: ds[name].variable.transpose("time", ...) for name in over})
    # what tasks do not write, as coordinates, is small
    rest = {n: v for n, v in ds.variables.items() if v.chunks is not None and n not in over}
    ds = ds.assign(dask.compute(rest)[0])  # at once, as one task computes all fields of a step
    return _aligned(ds, over), over


def _aligned(ds: xr.Dataset, over: Sequence[str]) -> xr.Dataset:
    """Give all lazy variables the same even chunks of time, so that no two tasks write to one chunk on disk."""
    lazy = [name for name in over if ds[name].chunks is not None]
    sizes = {ds[name].chunksizes["time"] for name in lazy}
    if all(len(set(s[:-1])) < 2 and s[-1] <= s[0] for s in sizes) and len(sizes) < 2:
        return ds
    steps = int(np.lcm.reduce([s[0] for s in sizes]))
    return ds.assign({name: ds[name].variable.chunk({"time": steps}) for name in lazy})


def steps_in_chunk(ds: xr.Dataset, over: Sequence[str]) -> int:
    """Return the steps in a chunk on disk: those in a chunk of the Dataset, or one where it is in memory."""
    return max((ds[name].chunksizes["time"][0] for name in over if ds[name].chunks is not None), default=1)


def chunk_shape(data: xr.DataArray, steps: int) -> tuple[int, ...]:
    """Shape of the chunks on disk of a variable over time, whole along other dimensions."""
    return tuple(min(steps, n) if dim == "time" else n for dim, n in data.sizes.items())


def outline(ds: xr.Dataset, over: Sequence[str], encoding: Encoding) -> xr.Dataset:
    """Give the same Dataset with arrays that nothing computes in place of what tasks write."""
    import dask.array as da  # slow to import

    empty = {}
    for name in over:
        data = ds[name].variable
        chunks, tasks = tuple((n,) for n in data.shape), {(f"empty-{name}", *(0,) * data.ndim): None}
        nothing = da.Array(tasks, f"empty-{name}", chunks, encoding.type_of(data.dtype))
        empty[name] = data.copy(data=nothing)
    return ds.assign(empty)


def write_all(ds: xr.Dataset, over: Sequence[str], write: Write, steps: int) -> None:
    """Write what is in memory, `steps` at a time, and compute and write the rest by tasks."""
    now = {name: ds[name].to_numpy() for name in over if ds[name].chunks is None}
    for first in range(0, ds.sizes["time"] if now else 0, steps):
        part = slice(first, min(first + steps, ds.sizes["time"]))
        write({name: [values[part]] for name, values in now.items()}, part)
    write_chunks(ds, write, steps)
