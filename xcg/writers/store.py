"""Writing Datasets step by step, in one way for all formats.

One task a chunk of time computes, encodes and writes all variables of it, and keeps none. So memory
holds the chunks that are being worked on, every input file is parsed once, and a scheduler has one
task where xarray's own writers make one a variable. Tasks find the file by its name, so that they
may run in any process.
"""

from __future__ import annotations

import sys
import uuid
from collections.abc import Generator, Iterator, Mapping, Sequence, Set
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, zip_longest
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import dask
import numpy as np
import xarray as xr
from dask.base import get_scheduler
from dask.delayed import Delayed
from dask.highlevelgraph import HighLevelGraph
from dask.utils import SerializableLock
from numpy.typing import NDArray

from xcg.steps.faults import SKIPPED, SKIPS, listen_for_skips, skips_heard
from xcg.steps.mapping import Gathered, count_tasks, shown
from xcg.writers.encoding import Encoding
from xcg.writers.files import check_target, is_published, locked, signals_wait, sync, work_folder
from xcg.writers.interrupted import Begun, Log, state_of
from xcg.writers.store_layout import Format, Parts, Store, StoreLayout, joined

if TYPE_CHECKING:
    import dask.array as da  # slow to import

_WRITES = "write-"  # names of tasks that write begin like this


def client() -> Any:
    """Return the client of the distributed cluster that computes, or None."""
    distributed = sys.modules.get("distributed")
    if distributed is None:
        return None
    owner = getattr(get_scheduler(), "__self__", None)
    if isinstance(owner, distributed.Client):
        return owner
    return None


def lock_for(path: Path) -> AbstractContextManager[Any]:
    """Lock that lets one task at a time write to a file, whichever scheduler runs them."""
    if client() is not None:
        return sys.modules["distributed"].Lock(str(path))
    return SerializableLock(str(path))


def _config() -> AbstractContextManager[Any]:
    """Select threads for writing where dask's own scheduler of processes is set: processes cannot share a lock."""
    processes = sys.modules.get("dask.multiprocessing")
    if processes is not None and get_scheduler() is processes.get:
        return dask.config.set(scheduler="threads")
    return nullcontext()


@dataclass(frozen=True)
class Output:
    """A Dataset and the files that hold it, whose values are computed once for all of them."""

    ds: xr.Dataset
    files: Mapping[Path, Format]
    encoding: Encoding

    @property
    def name(self) -> str:
        """Name of the first file."""
        return next(iter(self.files)).name


def write_file(
    ds: xr.Dataset, path: Path, encoding: Encoding, kind: Format, *, overwrite: bool
) -> None:
    """Write one file."""
    write_all(Output(ds, {path: kind}, encoding), overwrite=overwrite)


def write_all(
    output: Output,
    *,
    overwrite: bool,
    resume: bool = False,
    progress: bool | None = False,
) -> None:
    """Write all files of an output; `progress` as in `xcg.steps.mapping.shown`."""
    work = None
    if resume:
        path = next(iter(output.files))
        work = path.with_name(f".{path.name}.begun")
    steps = write_files([output], overwrite=overwrite, work=work)
    done = next(steps)
    total = output.ds.sizes.get("time", 1)
    # callbacks of dask count the tasks of this process, and those of a cluster report by themselves
    with shown(total, progress, done=done) as bar, count_tasks(bar, _writes):
        for written in steps:
            bar.update(written - bar.n)


def write_files(
    outputs: Sequence[Output],
    *,
    overwrite: bool = False,
    work: Path | None = None,
    about: Mapping[str, str] = MappingProxyType({}),
    batch: int | None = None,
    replaced: Sequence[Path] = (),
) -> Generator[int, None, None]:
    """Write files, and yield the number of steps that all of them hold.

    The first number is that of steps from an earlier run, the others come after each batch. All
    files get their names in one step at the end: signals wait for it, and a run that was killed
    within it is completed by the next one.

    Parameters
    ----------
    outputs : sequence of Output
        Scenes or results, which are written side by side, a batch of chunks each in turn.
    overwrite : bool
        Replace files that exist.
    work : Path, optional
        Hidden folder for incomplete files, which stays after an error and is continued by the next
        run. By default a temporary one.
    about : mapping of str to str
        Distinguishes this run from others of the same Dataset, and names what differs.
    batch : int, optional
        Chunks of time between two reports; by default all. A cluster reports each.
    replaced : sequence of Path
        Files of an earlier run, which are removed at the end.

    Raises
    ------
    FileExistsError
        If a file exists and `overwrite` is False, or another run is writing.
    Mismatch
        If `work` is of another Dataset or call.
    """
    targets = {path: kind for output in outputs for path, kind in output.files.items()}
    if work is None or not Begun(work).is_whole():  # else some have their names already
        for path in targets:
            check_target(path, overwrite=overwrite)
    layouts: list[StoreLayout] = []
    state = dict(about)
    for output in outputs:
        layout, described = _laid_out(output, is_resumed=work is not None)
        layouts.append(layout)
        if len(outputs) > 1:
            described = {f"{output.name}: {key}": value for key, value in described.items()}
        state |= described
    with ExitStack() as stack:
        folder = stack.enter_context(work_folder(work, next(iter(targets))))
        for output in outputs[1:]:  # its files may belong to a run of another name as well
            path = next(iter(output.files))
            stack.enter_context(locked(path.with_name(f".{path.name}.lock"), str(path)))
        parts = {path: folder / path.name for path in targets}
        begun = Begun(folder)
        is_whole = begun.matches(state) and begun.is_whole()
        if is_whole:
            # an earlier run was killed while it gave the files their names
            parts = {path: part for path, part in parts.items() if not is_published(part, path)}
        for path, part in parts.items():
            stack.enter_context(targets[path].whole(path, overwrite=overwrite, part=part))
        if is_whole:
            yield max(layout.ds.sizes.get("time", 1) for layout in layouts)
        else:
            writes = _begin_all(outputs, layouts, begun, state)
            yield from _fill_all(layouts, writes, batch)
            for part in parts.values():
                if part.is_file():
                    sync(part)  # now, as signals should not wait for a slow disk
        with signals_wait():
            begun.end()
            for path in replaced:
                path.unlink(missing_ok=True)
            stack.close()


def _begin_all(
    outputs: Sequence[Output],
    layouts: Sequence[StoreLayout],
    begun: Begun,
    state: Mapping[str, str],
) -> list[_WriteTask]:
    """Lay out the files of all outputs, unless an earlier run has, and return what writes to them."""
    is_begun = begun.matches(state) and all(
        (begun.folder / path.name).exists() for output in outputs for path in output.files
    )
    if not is_begun:
        begun.clear()
    writes: list[_WriteTask] = []
    for k, (output, layout) in enumerate(zip(outputs, layouts, strict=True)):
        stores = [
            kind.begin(layout, begun.folder / path.name, is_begun)
            for path, kind in output.files.items()
        ]
        writes.append(_WriteTask(tuple(stores), begun, state, begun.log(k), layout.step_numbers))
    if not is_begun:
        begun.begin(state)
    return writes


def _laid_out(output: Output, *, is_resumed: bool) -> tuple[StoreLayout, dict[str, str]]:
    """Return the layout of an output, and its state, by which a later run recognises it."""
    ds = output.ds
    together = None
    # without `work` nothing is resumed, and values in memory need not be hashed
    state: dict[str, str] = {}
    if is_resumed:
        state = state_of(ds, output.encoding, [kind.name for kind in output.files.values()])
    for kind in output.files.values():
        ds = kind.check(ds)
        together = kind.together or together
    layout = StoreLayout.of(ds, output.encoding, together)
    return layout, state | {"steps in a chunk": str(layout.steps)}


@dataclass(frozen=True, eq=False)
class _WriteTask:
    """Writes the values of some steps to all stores, and notes that they are there."""

    stores: tuple[Store, ...]
    begun: Begun
    state: Mapping[str, str]
    log: Log
    numbers: NDArray

    def __call__(self, parts: Parts, steps: slice, *, noted: bool = True) -> None:
        # a task of a cluster may outlive its run, and find the files of the next one
        self.begun.matches(self.state)
        for store in self.stores:
            store(parts, steps)
        if not noted:
            return
        causes: dict[int, str] = {}
        if SKIPPED in parts:
            heard = skips_heard()
            for t in np.flatnonzero(joined(parts[SKIPPED])) + steps.start:
                causes[int(t)] = heard.get(int(self.numbers[t]), "")
        self.log.add(steps, causes)

    def describe_skipped(self) -> None:
        """Add the steps that were skipped to the attributes of all files, and why."""
        skipped = self.log.skipped()
        if not skipped:
            return
        steps = self.numbers[list(skipped)]
        heard = self.log.causes()
        because: list[str] = []
        for step, own_cause in zip(steps.tolist(), skipped.values(), strict=True):
            cause = own_cause or heard.get(step)
            if cause:
                because.append(f"step {step}: {cause}")
        for store in self.stores:
            store.describe({"skipped_steps": steps, "skipped_because": "\n".join(because)})


def _fill_all(
    layouts: Sequence[StoreLayout], writes: Sequence[_WriteTask], batch: int | None
) -> Iterator[int]:
    """Fill the files of all outputs, a batch each in turn; yield the number of steps that all hold."""
    with ExitStack() as running:
        running.enter_context(listen_for_skips())
        cluster = client()
        if cluster is not None:
            logs = [write.log for write in writes]
            cluster.subscribe_topic(SKIPS, partial(_note_cause, logs))
            running.callback(cluster.unsubscribe_topic, SKIPS)
        fills = [
            running.enter_context(closing(_fill(layout, write, batch)))
            for layout, write in zip(layouts, writes, strict=True)
        ]
        done = [next(fill).steps for fill in fills]
        yield min(done)
        for batches in zip_longest(*fills):  # None of outputs that are complete
            waits = [each.wait for each in batches if each is not None and each.wait is not None]
            if waits:
                # at once: what several outputs are made of is read and computed for all of them
                with _config():
                    dask.compute(*waits)
            for k, each in enumerate(batches):
                if each is not None:
                    done[k] = each.steps
            yield min(done)
    for write in writes:
        write.describe_skipped()


def _note_cause(logs: Sequence[Log], event: tuple[float, Mapping[str, Any]]) -> None:
    """Add the cause of a skipped step to logs, from an event of a worker."""
    _, skip = event
    for log in logs:
        log.add_cause(skip["step"], skip["cause"])


class _Batch(NamedTuple):
    """Steps that an output holds, once `wait` has been computed by whoever gets it."""

    steps: int
    wait: Delayed | None = None


def _fill(
    layout: StoreLayout, write: _WriteTask, batch: int | None
) -> Generator[_Batch, None, None]:
    """Write what is not there: from memory, `layout.steps` at a time, and the rest by tasks."""
    ds = layout.ds
    done = write.log.steps()
    yield _Batch(sum(stop - first for first, stop in done))
    now = {name: ds[name].to_numpy() for name in layout.over if ds.variables[name].chunks is None}
    arrays = {name: ds.variables[name].data for name in layout.lazy}
    if now and not (arrays and done):  # else written before the tasks
        for first in range(0, ds.sizes["time"], layout.steps):
            part = slice(first, min(first + layout.steps, ds.sizes["time"]))
            if (part.start, part.stop) not in done:
                values = {name: [of_steps[part]] for name, of_steps in now.items()}
                write(values, part, noted=not arrays)
    if not arrays:
        return
    cluster = client()
    if cluster is not None:
        batch = 1  # the cluster orders its tasks by itself
    graph, layer, waits = graph_of(arrays, write, layout.steps, done, batch)
    ready = sum(stop - first for first, stop in done)
    if cluster is None:
        for wait, steps in waits.items():
            ready += steps
            yield _Batch(ready, Delayed(wait, graph, layer=layer))
        return
    futures = cluster.compute([Delayed(wait, graph, layer=layer) for wait in waits])
    counts = dict(zip(futures, waits.values(), strict=True))
    try:
        for future in sys.modules["distributed"].as_completed(futures):
            future.result()
            ready += counts[future]
            yield _Batch(ready)
    finally:
        cluster.cancel(futures)


def graph_of(
    arrays: Mapping[str, da.Array],
    write: _WriteTask,
    steps: int,
    done: Set[tuple[int, int]],
    batch: int | None,
) -> tuple[HighLevelGraph, str, dict[str, int]]:
    """Graph of the tasks that write arrays of the same chunks, its last layer, and keys that wait for each batch.

    The keys come with the number of steps in their batch.
    """
    gathered = Gathered.of(arrays)
    token = uuid.uuid4().hex
    edges = np.cumsum([0, *next(iter(arrays.values())).chunks[0]]).tolist()
    firsts = [0]  # chunks that the tasks begin with
    for t, edge in enumerate(edges):
        if edge - edges[firsts[-1]] >= steps and t < len(edges) - 1:
            firsts.append(t)
    tasks: dict[Any, Any] = {}
    sizes: list[int] = []  # steps of each task
    for first, end in pairwise([*firsts, len(edges) - 1]):
        if (edges[first], edges[end]) not in done:
            keys = [key for t in range(first, end) for key in gathered.keys(t)]
            task = partial(_take_and_write, write, gathered, slice(edges[first], edges[end]))
            tasks[_WRITES + token, first] = (task, *keys)
            sizes.append(edges[end] - edges[first])
    todo = list(tasks)
    waits: dict[str, int] = {}
    batch = batch or len(todo) or 1
    for first in range(0, len(todo), batch):
        wait = f"wait-{token}-{first}"
        waits[wait] = sum(sizes[first : first + batch])
        tasks[wait] = (_wait, todo[first : first + batch])
    return (
        HighLevelGraph.from_collections(_WRITES + token, tasks, list(arrays.values())),
        _WRITES + token,
        waits,
    )


def _take_and_write(write: _WriteTask, gathered: Gathered, steps: slice, *sources: Any) -> None:
    count = len(gathered.sources)  # of a chunk
    parts = [
        gathered.take(sources[first : first + count]) for first in range(0, len(sources), count)
    ]
    write({name: [part[name] for part in parts] for name in parts[0]}, steps)


def _wait(_: Any) -> None:
    """Depend on all tasks that write."""


def _writes(key: Any) -> bool:
    return isinstance(key, tuple) and str(key[0]).startswith(_WRITES)
