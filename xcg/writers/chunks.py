"""Writing lazy variables by tasks: one task a chunk of time writes all variables of it, and keeps none.

So memory holds the chunks that are being worked on, every input file is parsed once, and a scheduler has one task where
xarray's own writers make one a variable. Tasks find the file by its name, so that they may run in any process.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import dask
import numpy as np
import xarray as xr
from dask.delayed import Delayed
from dask.highlevelgraph import HighLevelGraph
from numpy.typing import NDArray
from xarray.backends.locks import get_dask_scheduler, get_write_lock

from xcg.steps.each import chunks_of_time
from xcg.steps.graph import Gathered
from xcg.steps.progress import CountTasks, shown

if TYPE_CHECKING:
    import dask.array as da  # slow to import

# writes some steps of variables by name: arrays with time first, one or more that follow each other
Write: TypeAlias = Callable[[Mapping[str, Sequence[NDArray]], slice], None]

_WRITES = "write-"  # names of tasks that write begin like this


def lock_for(path: Path) -> AbstractContextManager[Any]:
    """Lock that lets one task at a time write to a file, whichever scheduler runs them."""
    with _config():
        return get_write_lock(str(path))


def _config() -> AbstractContextManager[Any]:
    """Have threads write where dask's own scheduler of processes is set: these cannot share a lock."""
    return dask.config.set(scheduler="threads") if get_dask_scheduler() == "multiprocessing" else nullcontext()


def over_time(ds: xr.Dataset) -> list[str]:
    """Names of the variables that are lazy and have a time."""
    return [str(name) for name, data in ds.data_vars.items() if data.chunks is not None and "time" in data.dims]


def write_chunks(ds: xr.Dataset, write: Write, steps: int = 1) -> None:
    """Compute and write all variables of `over_time`, chunk by chunk of time.

    Parameters
    ----------
    ds : xarray.Dataset
        Variables with the dimension ``time``.
    write : callable
        Is called by tasks, so it must pickle.
    steps : int
        What one task writes at least, unless the steps end: several chunks where they are shorter.
    """
    arrays = same_chunks(ds[over_time(ds)])
    if not arrays:
        return
    graph, name = graph_of(arrays, write, steps)
    with _config():
        Delayed(name, graph).compute()


def graph_of(arrays: Mapping[str, da.Array], write: Write, steps: int = 1) -> tuple[HighLevelGraph, str]:
    """Graph of the tasks that write arrays of the same chunks, and the name of the one that waits for all."""
    gathered = Gathered.of(arrays)
    name = f"{_WRITES}{uuid.uuid4().hex}"
    edges = np.cumsum([0, *next(iter(arrays.values())).chunks[0]]).tolist()
    firsts = [0]  # chunks that the tasks begin with
    for t, edge in enumerate(edges):
        if edge - edges[firsts[-1]] >= steps and t < len(edges) - 1:
            firsts.append(t)
    tasks: dict[Any, Any] = {}
    for first, end in pairwise([*firsts, len(edges) - 1]):
        keys = [key for t in range(first, end) for key in gathered.keys(t)]
        tasks[name, first] = (partial(_take_and_write, write, gathered, slice(edges[first], edges[end])), *keys)
    tasks[name] = (_wait, list(tasks))
    return HighLevelGraph.from_collections(name, tasks, list(arrays.values())), name


def same_chunks(ds: xr.Dataset) -> dict[str, da.Array]:
    """Lazy arrays, time first, in chunks of time that cut none of theirs, so that every chunk is computed once."""
    arrays = {str(name): data.transpose("time", ...).data for name, data in ds.data_vars.items()}
    sizes = tuple(steps.stop - steps.start for steps in chunks_of_time([ds])) if arrays else ()
    return {name: a.rechunk({0: sizes, **dict.fromkeys(range(1, a.ndim), -1)}) for name, a in arrays.items()}


def _take_and_write(write: Write, gathered: Gathered, steps: slice, *given: Any) -> None:
    a_chunk = len(gathered.sources)
    parts = [gathered.take(given[first : first + a_chunk]) for first in range(0, len(given), a_chunk)]
    write({name: [part[name] for part in parts] for name in parts[0]}, steps)


def joined(parts: Sequence[NDArray]) -> NDArray:
    """Give arrays that follow each other as one, which is no copy where there is one."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _wait(_: Any) -> None:
    """Depend on all tasks that write."""


@contextmanager
def telling(ds: xr.Dataset, progress: bool | None) -> Iterator[None]:
    """Show how many steps are written; `progress` as in `xcg.steps.progress.shown`. Tasks on a cluster are not seen."""
    with shown(ds.sizes.get("time", 1), progress) as bar, CountTasks(bar, _writes):
        yield


def _writes(key: Any) -> bool:
    return isinstance(key, tuple) and str(key[0]).startswith(_WRITES)
