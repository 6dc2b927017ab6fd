"""Tasks of dask, one a chunk of time, which computes all results; chunks and steps of series, and progress.

Functions import dask and tqdm themselves: they load slowly, and scenes in memory do without them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from operator import itemgetter
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import Once, active_call
from xcg.compiled._jit import is_interactive
from xcg.scene.conform import without_empty_chunks
from xcg.steps.faults import SKIPPED, Compute, Result, guarded

if TYPE_CHECKING:
    import dask.array as da
    from dask.callbacks import Callback
    from dask.highlevelgraph import HighLevelGraph
    from tqdm import tqdm

_SHARE = 0.1  # of all steps, from one plain line to the next
_LONG = 2.0  # seconds after which work is long enough to show progress unasked
_BAR = "[{bar:30}] {n_fmt} of {total_fmt}{unit}, {rate_noinv_fmt}, {remaining} left"
_LINE = "{n_fmt} of {total_fmt}{unit}, {rate_noinv_fmt}, {remaining} left"


def is_lazy(ds: xr.Dataset, names: Iterable[Hashable]) -> bool:
    """Return whether any of these variables is a dask array."""
    return any(ds.variables[name].chunks is not None for name in names)


def chunks_of_time(ds: xr.Dataset) -> list[slice]:
    """List the steps of each chunk of time, which cuts no chunk of any variable; single steps where none is lazy.

    A task computes a whole chunk, whatever part of it is asked for.
    """
    edges = [set(range(ds.sizes["time"] + 1))]
    for values in ds.variables.values():
        if "time" in values.chunksizes:
            edges.append({0, *np.cumsum(values.chunksizes["time"]).tolist()})
    return [slice(first, end) for first, end in pairwise(sorted(set.intersection(*edges)))]


def each_step(ds: xr.Dataset) -> Iterator[xr.Dataset]:
    """Compute the steps of a Dataset, each with a time dimension of one; all of it where it has no time."""
    if "time" not in ds.dims:
        yield ds.compute()
        return
    for steps in chunks_of_time(ds):
        chunk = ds.isel(time=steps).compute()
        for t in range(chunk.sizes["time"]):
            yield chunk.isel(time=[t])


def picked(
    graph: HighLevelGraph,
    layer: str,
    name: str,
    key: str,
    chunks: Sequence[int],
    shape: tuple[int, ...],
    dtype: Any,
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
    import dask.array as da
    from dask.blockwise import blockwise
    from dask.highlevelgraph import HighLevelGraph

    axes = tuple(range(1 + len(shape)))
    picks: Any = blockwise(
        itemgetter(name),
        key,
        axes,
        layer,
        (0,),
        numblocks={layer: (len(chunks),)},
        new_axes=dict.fromkeys(axes[1:], 1),
    )
    picks.origin = layer, name
    whole = HighLevelGraph({**graph.layers, key: picks}, {**graph.dependencies, key: {layer}})
    sizes = (tuple(chunks), *((n,) for n in shape))
    return da.Array(whole, key, sizes, meta=np.empty((0,) * (1 + len(shape)), dtype))


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
            # of what is `picked`
            picks = array.dask.layers.get(array.name)
            layer, entry = getattr(picks, "origin", (array.name, ""))
            source = (layer, array.ndim)
            if entry:
                source = (layer, 1)
            if source not in sources:
                sources.append(source)
            entries[name] = (sources.index(source), entry)
        return cls(tuple(sources), entries)

    def keys(self, chunk: int) -> list[tuple[Any, ...]]:
        """Keys that the task of one chunk depends on."""
        return [(layer, chunk, *(0,) * (indices - 1)) for layer, indices in self.sources]

    def take(self, values: Sequence[Any]) -> dict[str, NDArray]:
        """Arrays by name, from the values of the keys."""
        arrays = {}
        for name, (k, entry) in self.entries.items():
            arrays[name] = values[k]
            if entry:
                arrays[name] = values[k][entry]
        return arrays


def lazy_results(
    inputs: Mapping[str, xr.Variable],
    compute: Compute,
    results: Mapping[str, Result],
    label: str,
    numbers: NDArray | None,
    on_error: str,
) -> dict[str, Any]:
    """Dask arrays of all results, of variables (time, ...) some of which are lazy; see `map_over_time`."""
    from dask.base import tokenize
    from dask.highlevelgraph import HighLevelGraph
    from dask.optimization import cull

    compute = partial(_with_warnings_once, active_call(), compute)
    arrays: dict[str, Any] = {n: v.data for n, v in inputs.items() if v.chunks is not None}
    finest = max((a.chunks[0] for a in arrays.values()), key=len)
    # whole but along time
    lazy = {
        n: a.rechunk({0: finest, **dict.fromkeys(range(1, a.ndim), -1)}) for n, a in arrays.items()
    }
    fixed = {n: v.to_numpy() for n, v in inputs.items() if n not in arrays}
    name = f"{label}-{tokenize(compute, lazy, fixed, on_error)}"
    # a key of its own, so that what all tasks share, such as a million points, travels to a worker
    # once
    call = f"call-{name}"
    tasks: dict[Any, Any] = {call: compute}
    dependencies = list(lazy.values())
    gathered = Gathered.of(lazy)
    below: Mapping[Any, Any] = {}
    if SKIPPED in results:
        # tasks that record faults hold the graphs of their inputs, whose faults they record, too
        below = HighLevelGraph.merge(*(a.__dask_graph__() for a in dependencies)).to_dict()
        dependencies = []
    for t, (start, stop) in enumerate(pairwise(np.cumsum([0, *finest]).tolist())):
        here = {n: a[start:stop] for n, a in fixed.items()}
        if not below:
            tasks[name, t] = (partial(_compute_chunk, gathered, here), call, *gathered.keys(t))
            continue
        keys = {of: (a.name, t, *(0,) * (a.ndim - 1)) for of, a in lazy.items()}
        part, _ = cull(below, list(keys.values()))
        numbers_here = numbers
        if numbers is not None:
            numbers_here = numbers[start:stop]
        tasks[name, t] = (partial(guarded, results, numbers_here, part, keys, here), call)
    graph = HighLevelGraph.from_collections(name, tasks, dependencies)
    return {
        result: picked(graph, name, result, f"{result}-{name}", finest, shape, dtype)
        for result, (shape, dtype) in results.items()
    }


def _with_warnings_once(
    once: Once, compute: Compute, arrays: Mapping[str, NDArray]
) -> dict[str, NDArray]:
    """Compute a chunk in its task; `xcg.common.messages.warn_once` warns once for all tasks."""
    with once.active():
        return compute(arrays)


def _compute_chunk(
    gathered: Gathered, fixed: Mapping[str, NDArray], compute: Compute, *values: Any
) -> dict[str, NDArray]:
    return compute({**gathered.take(values), **fixed})


def apply_along(
    function: Callable[..., Any],
    *fields: xr.DataArray,
    along: Sequence[Sequence[str]],
    to: Sequence[Sequence[str]],
    sizes: Mapping[str, int] | None = None,
    **options: Any,
) -> Any:
    """Apply a function of arrays along dimensions of fields, lazily and in one chunk where they are lazy.

    Parameters
    ----------
    along, to : list of list of str
        Dimensions that each field loses and each result gains, its last ones.
    sizes : mapping, optional
        Lengths of dimensions that are new.
    **options
        For `xarray.apply_ufunc`.
    """
    return xr.apply_ufunc(
        function,
        *(field.copy(data=without_empty_chunks(field.variable).data) for field in fields),
        input_core_dims=along,
        output_core_dims=to,
        dask="parallelized",
        output_dtypes=[float] * len(to),
        dask_gufunc_kwargs={"output_sizes": sizes or {}, "allow_rechunk": True},
        **options,
    )


# --- progress: a bar in a terminal or notebook, plain lines elsewhere ------------------------------------


class _LogLines:
    """A stream in which every state of a bar is a line of its own."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._last = ""

    def write(self, text: str) -> None:
        line = text.strip("\r\n ")
        steps = line.split(",")[0]
        if line and steps != self._last:  # the last state comes twice
            self._stream.write(f"{line}\n")
        self._last = steps or self._last

    def flush(self) -> None:
        self._stream.flush()


@contextmanager
def shown(count: int, wanted: bool | None, *, done: int = 0, what: str = "steps") -> Iterator[tqdm]:
    """Show on the standard error how far a block of code is; nothing where all steps are finished before.

    Parameters
    ----------
    count, done : int
        Number of all steps, and of finished steps.
    wanted : bool or None
        Always, never, or (None) from two seconds on in a terminal or notebook.
    what : str
        What is counted.

    Yields
    ------
    tqdm.tqdm
        Its method ``update(n)`` counts further steps.
    """
    from tqdm import tqdm

    redraws = is_interactive()
    how: dict[str, Any] = {"file": sys.stderr, "bar_format": _BAR, "delay": 0}
    if not redraws:
        how = {
            "file": _LogLines(sys.stderr),
            "bar_format": _LINE,
            "mininterval": 0,
            "miniters": _SHARE * count,
            "maxinterval": float("inf"),
            "delay": 1e-9,  # leaves out the line before the first step
        }
    if wanted is None:
        wanted = redraws
        how["delay"] = _LONG
    quiet = done >= count or not wanted
    with tqdm(total=count, initial=done, disable=quiet, unit=f" {what}", ascii="-#", **how) as bar:
        yield bar


def count_tasks(bar: tqdm, is_counted: Callable[[Any], bool]) -> Callback:
    """Return a dask callback that counts the tasks whose keys are chosen, and updates a bar of steps."""
    from dask.callbacks import Callback

    first = bar.n
    done = 0
    tasks = 1

    def begin(graph: Mapping[Any, Any]) -> None:
        nonlocal tasks
        tasks = max(1, sum(map(is_counted, graph)))

    def end(key: Any, *_: Any) -> None:
        nonlocal done
        if is_counted(key):
            done += 1
            steps = (bar.total - first) * done // tasks
            bar.update(first + steps - bar.n)

    return Callback(start=begin, posttask=end)
