"""Lazy arrays of a series: which steps make a chunk, and the tasks that read and complete them."""

from __future__ import annotations

import math
import os
import threading
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate
from typing import Any, TypeAlias

import dask
import dask.array as da
import numpy as np
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph
from dask.utils import parse_bytes
from numpy.typing import DTypeLike, NDArray
from xarray.backends import BackendArray

from xcg.common.compat import (
    ExplicitIndexer,
    IndexingSupport,
    LazilyIndexedArray,
    MemoryCachedArray,
    explicit_indexing_adapter,
)
from xcg.common.messages import Once, SceneError, warn_once
from xcg.compiled._jit import THREADS
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.scene.complete import HINTS, complete_contacts, complete_particles
from xcg.scene.frame import frame_of, stack
from xcg.scene.lattice import Lattice
from xcg.scene.sanity_contacts import check_ends, is_central
from xcg.scene.schema import MOTION, ROTATION, VARIABLES, Frame, Setup, variable
from xcg.steps import faults as errors
from xcg.steps.mapping import picked

Chunks: TypeAlias = (
    int | str | Sequence[int] | Mapping[str, int | str | Sequence[int] | None] | None
)

_TASK = 0.1  # seconds of work that make the scheduling of a task, and the writing of a chunk, small beside it
# seconds to parse a byte of text, and to compute fields of a particle or contact
_BYTE = 1e-8
_ROW = 1e-6
_EXPECTED = (
    "expected the number of steps in a chunk, -1 for all, 'auto', None for no dask, or such as {'time': 10}, as the "
    "rows of a step stay together"
)


def chunk_sizes(chunks: Any, count: int, sensible: Callable[[], int]) -> tuple[int, ...]:
    """Numbers of steps in the chunks of `count` steps; "auto" takes as many a chunk as `sensible` says.

    Raises
    ------
    SceneError
        If this is nothing that xarray takes, or cuts other dimensions than time.
    """
    msg = f"chunks={chunks!r}: {_EXPECTED}"
    if isinstance(chunks, Mapping):
        if any(dim != "time" and size not in (None, -1) for dim, size in chunks.items()):
            raise SceneError(msg)
        chunks = chunks.get("time")
        if chunks is None:
            chunks = 1
    if isinstance(chunks, str) and chunks == "auto":
        chunks = sensible()
    sizes = np.atleast_1d(np.asarray(chunks))
    if sizes.dtype.kind not in "iu" or sizes.ndim != 1:
        raise SceneError(msg)
    if np.ndim(chunks):
        if (sizes < 1).any() or sizes.sum() != count:
            raise SceneError(
                f"chunks={chunks!r}: expected positive numbers that add up to the {count} steps"
            )
        return tuple(sizes.tolist())
    size = int(sizes[0])
    if size == -1:
        size = max(1, count)
    if size < 1:
        raise SceneError(msg)
    return tuple(min(size, count - start) for start in range(0, count, size))


def _sensible(series: Series) -> int:
    """Count steps that make a task of `_TASK` seconds, whose arrays are no larger than dask wants chunks to be."""
    refs = [ref for step in series.steps for ref in (step.particles, *step.contacts)]
    shared = Counter(ref.path for ref in refs)
    # bytes of a body, from its header, else its share of the file
    read = sum(ref.length or ref.size / shared[ref.path] for ref in refs) / len(series.steps)
    held: int = sum(
        math.prod(shape[1:]) * np.dtype(dtype).itemsize for dtype, shape in series.arrays().values()
    )
    rows = sum(ref.rows for ref in refs) / len(series.steps)
    return steps_in_a_task(rows, held, read * _BYTE)


def steps_in_a_task(rows: float, held: int, seconds: float = 0.0) -> int:
    """Count steps that make a sensible task, of so many rows and bytes in memory each, which take `seconds` to read."""
    limit = parse_bytes(dask.config.get("array.chunk-size"))
    return max(1, min(math.ceil(_TASK / max(seconds + rows * _ROW, 1e-9)), limit // max(held, 1)))


@dataclass(frozen=True)
class Step:
    """Step of the scene: its particles, and the files of its contacts."""

    particles: StepRef
    contacts: tuple[StepRef, ...] = ()
    time: float | None = None


def read_step(
    engine: Engine, options: ReadOptions, ref: StepRef, *, contacts: bool = False
) -> Frame:
    """Parse one body, or its pieces one after the other, in the file's units."""
    if ref.pieces:
        frames = [read_step(engine, options, piece, contacts=contacts) for piece in ref.pieces]
        joined = dict(frames[0])  # of hints, one for all pieces
        for name, values in joined.items():
            if np.ndim(values):
                joined[name] = np.concatenate([frame[name] for frame in frames])
        return joined
    kind = "contacts" if contacts else "particles"
    read = engine.read_contacts if contacts else engine.read_particles
    try:
        variables = read(ref, options.of_kind(kind))
    except SceneError:
        raise
    except ValueError as error:  # of engines of users, such as NumPy's for texts
        raise SceneError(
            f"{source_of(ref)}: the engine {engine.name!r} cannot read it: {error}"
        ) from error
    if not isinstance(variables, Mapping):
        raise SceneError(
            f"{source_of(ref)}: the engine {engine.name!r} gives {kind} as {type(variables).__name__}; "
            "expected a dict of arrays by the names of variables, such as 'position'"
        )
    frame: dict[str, Any] = {str(name): values for name, values in variables.items()}
    try:  # engines of users give lists and tables, too; masked arrays stay so, to be refused
        for name, values in frame.items():
            if name not in HINTS:
                frame[name] = np.asanyarray(values)
    except ValueError as error:
        raise SceneError(
            f"{source_of(ref)}: the engine {engine.name!r} gives values that are no array ({error})"
        ) from None
    if not contacts and np.ndim(frame.get("position", 0.0)) != 2:
        raise SceneError(
            f"{source_of(ref)}: no positions; expected a variable 'position' with three components"
        )
    _check_own_variables(frame, ref)
    return frame


def _check_own_variables(frame: Frame, ref: StepRef) -> None:
    """Raise SceneError for own variables that are not one number a row: lazy arrays have that shape."""
    for name, values in frame.items():
        if name not in {*VARIABLES, *HINTS} and values.ndim > 1:
            raise SceneError(
                f"{source_of(ref)}: {name!r} has shape {values.shape}, expected one number a row; leave it out "
                "of names=, and add vectors and tensors of your own with ds.assign"
            )


def _check_unchanged(ref: StepRef) -> None:
    """Raise SceneError for a file that changed since its headers were read."""
    for piece in ref.pieces:
        _check_unchanged(piece)
    if not ref.size:  # of steps that an engine lists without a file of their own
        return
    again = "open it again"
    try:
        state = os.stat(ref.path)
    except FileNotFoundError:
        now = "is gone"
        if not os.path.isabs(ref.path):
            again += f", by an absolute path where the current folder changed (it is {os.getcwd()})"
    else:
        if (state.st_size, state.st_mtime_ns) == (ref.size, ref.modified or state.st_mtime_ns):
            return
        now = "was written again"
        if state.st_size != ref.size:
            now = f"has {state.st_size} bytes, but had {ref.size}"
    raise SceneError(f"{source_of(ref)}: the file {now} after the scene was opened; {again}")


# bytes of a step that is kept from opening to its first use, alone or beside another
_MOST_OPENED = 1 << 28
_MOST_BESIDE = 1 << 25


class Opened:
    """Particles that were read when a scene was opened, until they are used for the first time.

    Not pickled: a copy in another process starts empty.
    """

    def __init__(self) -> None:
        self._frames: dict[StepRef, Frame] = {}
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[Opened], tuple[()]]:
        return Opened, ()

    def __dask_tokenize__(self) -> str:
        return type(self).__name__

    def keep(self, ref: StepRef, frame: Frame, *, beside: bool) -> None:
        """Keep the completed particles of a step, only of a small one `beside` another that follows."""
        most = _MOST_BESIDE if beside else _MOST_OPENED
        if sum(array.nbytes for array in frame.values()) <= most:
            self._frames[ref] = dict(frame)

    def take(self, ref: StepRef, names: Iterable[str]) -> Frame | None:
        """Return these variables of a step and forget them; None unless all of them are kept."""
        with self._lock:
            frame = self._frames.get(ref, {})
            if not set(names) <= set(frame):
                return None
            taken = {name: frame.pop(name) for name in names}
            if not frame:
                self._frames.pop(ref, None)
        return taken


@dataclass(frozen=True)
class Source:
    """Options of reading a step; they travel to the workers.

    Attributes
    ----------
    engine : Engine
        Reads one step.
    frozen : tuple of int or None
        Species that are fixed in place; None where the caller said nothing.
    once : Once
        Gives warnings of the scene's steps once.
    opened : Opened
        Steps that were read when the scene was opened.
    """

    engine: Engine
    options: ReadOptions
    setup: Setup
    frozen: tuple[int, ...] | None
    allow_unknown: bool
    once: Once = field(default_factory=Once, compare=False)
    opened: Opened = field(default_factory=Opened, compare=False)

    def reading(self, **options: Any) -> Source:
        """Return the same with other options of reading: `alone`, or variables that are `unwanted`."""
        return replace(self, options=replace(self.options, **options))

    def complete(self, frame: Frame, ref: StepRef, box: Frame) -> Frame:
        """Check and complete the particles of one step, in the box of this step.

        `frame` is empty afterwards, see `xcg.scene.complete.complete_particles`.
        """
        if self.frozen is not None:
            if "species" not in frame:
                raise SceneError(
                    f"{source_of(ref)}: frozen={self.frozen} needs 'species', and the file holds none"
                )
            frame["frozen"] = np.isin(frame["species"], self.frozen).astype("int64")
        lattice = None
        if "unwrapped_position" in frame:
            lattice = Lattice.of(box, self.setup.periodic, source_of(ref))
        threads = THREADS if self.options.alone else 1
        with self.once.active():
            return complete_particles(frame, self.setup, source_of(ref), lattice, threads)

    def contacts(
        self, refs: Sequence[StepRef], names: Sequence[str], particles: Frame, box: Frame
    ) -> Frame:
        """Read, check and complete the contacts of one step, from all its files."""
        parts = []
        options = self.options.of_kind("contacts")
        for ref in refs:
            lattice = Lattice.of(box, self.setup.periodic, source_of(ref))
            _check_unchanged(ref)
            raw = read_step(self.engine, self.options, ref, contacts=True)
            columns: Mapping[str, str] = {}
            if "overlap" in raw:
                columns = self.engine.contact_columns(ref, options)
            with self.once.active():
                if "wrapped_branch" in raw:
                    scaled = particles | {"position": particles["position"] / self.setup.scales[0]}
                    check_ends(raw, scaled, lattice.scaled(self.setup.scales[0]), source_of(ref))
                part = complete_contacts(
                    raw,
                    particles,
                    lattice,
                    self.setup,
                    source_of(ref),
                    allow_unknown=self.allow_unknown,
                    columns=columns,
                )
            parts.append(part)
            _require(parts[-1], names, ref)
            unread = self.engine.unread_forces(ref, options)
            if unread and is_central(parts[-1], particles, lattice):
                with self.once.active():
                    what = "all contact forces lie along the branches, as normal parts do"
                    warn_once("partial force", f"{source_of(ref)}: {what}, and {unread}")
        if not parts:  # nothing touches
            return _nothing({name: variable(name).dtype for name in names})
        if len(parts) == 1:
            return {name: parts[0][name] for name in names}
        return {name: np.concatenate([part[name] for part in parts]) for name in names}


def _require(frame: Frame, names: Sequence[str], ref: StepRef) -> None:
    """Raise SceneError for a frame that lacks variables of other steps, or has more rows than its header promised."""
    rows = len(next(iter(frame.values())))
    if rows > ref.rows:
        raise SceneError(
            f"{source_of(ref)}: {rows} rows, but its index promised {ref.rows} at most"
        )
    lacking = [name for name in names if name not in frame]
    if lacking:
        raise SceneError(
            f"{source_of(ref)}: lacks {lacking}, which other steps hold; a series must hold the same throughout"
        )


def _chunk(
    steps: Sequence[Step], read: Callable[[int, Step], Frame], types: Mapping[str, Any], rows: int
) -> Frame:
    """Frames of the steps of a chunk, padded; steps at fault are empty where faults are tolerated."""
    frames = []
    for t, step in enumerate(steps):
        try:
            frames.append(read(t, step))
        except errors.FAULTS as error:
            if not errors.record_fault(step.particles.step, error):
                raise
            frames.append(_nothing(types))
    return stack(frames, list(types), rows)


def _nothing(types: Mapping[str, Any]) -> Frame:
    """Make a frame without rows."""
    return {name: np.empty(variable(name, dtype).shape(0), dtype) for name, dtype in types.items()}


def read_particle_chunk(
    source: Source, steps: Sequence[Step], types: Mapping[str, Any], rows: int, boxes: Frame
) -> Frame:
    """Particles of the steps of a chunk, padded."""

    def read(t: int, step: Step) -> Frame:
        ref = step.particles
        _check_unchanged(ref)
        frame = source.opened.take(ref, types)
        if frame is None:
            raw = read_step(source.engine, source.options, ref)
            frame = source.complete(raw, ref, {name: values[t] for name, values in boxes.items()})
        _require(frame, list(types), ref)
        return frame

    return _chunk(steps, read, types, rows)


def read_contact_chunk(
    source: Source,
    steps: Sequence[Step],
    names: Sequence[str],
    rows: int,
    boxes: Frame,
    particles: Frame,
) -> Frame:
    """Contacts of the steps of a chunk, padded, checked against the particles of the same chunk."""

    def read(t: int, step: Step) -> Frame:
        box = {name: values[t] for name, values in boxes.items()}
        return source.contacts(step.contacts, names, frame_of(particles, t), box)

    return _chunk(steps, read, {name: variable(name).dtype for name in names}, rows)


@dataclass(frozen=True, eq=False)
class Series:
    """The steps of a scene, and what their bodies hold.

    Attributes
    ----------
    boxes : mapping
        Variables of the domain, time first, in the scene's units.
    particle_types : mapping
        Type of each variable of the particles.
    contact_names : sequence of str
        Variables of the contacts; empty without contacts.
    times : array (t,) or None
        Time of each step (s); None if it is not known.
    """

    source: Source
    steps: Sequence[Step]
    boxes: Frame
    particle_types: Mapping[str, Any]
    contact_names: Sequence[str]
    times: NDArray | None = None

    def rows(self) -> tuple[int, int]:
        """Rows of particles and of contacts in a step, at most."""
        contacts = max(sum(ref.rows for ref in step.contacts) for step in self.steps)
        return max(step.particles.rows for step in self.steps), contacts

    def arrays(self) -> dict[str, tuple[Any, tuple[int, ...]]]:
        """Type and shape of all variables."""
        particle_rows, contact_rows = self.rows()
        rows = {name: (dtype, particle_rows) for name, dtype in self.particle_types.items()}
        rows |= {name: (variable(name).dtype, contact_rows) for name in self.contact_names}
        return {
            name: (dtype, (len(self.steps), *variable(name, dtype).shape(n)))
            for name, (dtype, n) in rows.items()
        }

    def token(self) -> str:
        """Token of a series, from the files and options that it reads."""
        refs = [ref for step in self.steps for ref in (step.particles, *step.contacts)]
        paths = sorted({piece.path for ref in refs for piece in ref.parts})
        modified = [os.stat(path).st_mtime_ns for path in paths]
        # as text, which dask digests ten times as fast as thousands of objects
        steps = repr(self.steps)
        return tokenize(
            self.source, steps, modified, self.boxes, dict(self.particle_types), self.contact_names
        )


def lazy_arrays(series: Series, chunks: Any) -> dict[str, da.Array]:
    """Dask arrays (time first, padded) of all variables, in chunks as of `chunk_sizes`."""
    sizes = chunk_sizes(chunks, len(series.steps), partial(_sensible, series))
    source = series.source.reading(alone=len(sizes) == 1)
    steps = series.steps
    boxes = series.boxes
    particle_types = dict(series.particle_types)
    stops = list(accumulate(sizes))
    parts = [slice(stop - size, stop) for stop, size in zip(stops, sizes, strict=True)]
    token = tokenize(series.token(), sizes)

    rows, contact_rows = series.rows()
    graphs: dict[str, tuple[HighLevelGraph, str]] = {}
    # what few fields need is read by tasks of its own; contacts are checked against the particles,
    # which come last
    seldom = [*ROTATION, *MOTION]
    kinds = {
        "rotation": [name for name in particle_types if name in ROTATION],
        "motion": [name for name in particle_types if name in MOTION],
        "particles": [name for name in particle_types if name not in seldom],
    }
    for kind, wanted in kinds.items():
        layer = f"read-{kind}-{token}"
        tasks = dict[Any, Any]()
        types = {name: particle_types[name] for name in wanted}
        others = [name for name in seldom if name in particle_types and name not in wanted]
        reader = source.reading(unwanted=tuple(others))
        for k, part in enumerate(parts):
            edges = {name: values[part] for name, values in boxes.items()}
            task = partial(read_particle_chunk, reader, steps[part], types, rows, edges)
            tasks[layer, k] = (task,)
        graph = HighLevelGraph({layer: tasks}, {layer: set()})
        graphs |= dict.fromkeys(wanted, (graph, layer))
    if series.contact_names:
        particles = layer
        layer = f"read-contacts-{token}"
        tasks = {}
        for k, part in enumerate(parts):
            edges = {name: values[part] for name, values in boxes.items()}
            task = partial(
                read_contact_chunk, source, steps[part], series.contact_names, contact_rows, edges
            )
            tasks[layer, k] = (task, (particles, k))
        graph = HighLevelGraph(
            {**graph.layers, layer: tasks}, {**graph.dependencies, layer: {particles}}
        )
        graphs |= dict.fromkeys(series.contact_names, (graph, layer))
    return {
        name: picked(*graphs[name], name, f"{name}-{token}", sizes, shape[1:], dtype)
        for name, (dtype, shape) in series.arrays().items()
    }


_KEPT = 2  # steps that are always kept
_MOST_KEPT = 1 << 28  # bytes up to which more steps are kept

_recent: dict[Hashable, Future[Frame]] = {}  # the one that was used last comes last
_lock = threading.Lock()


def indexed_arrays(series: Series) -> dict[str, MemoryCachedArray]:
    """Arrays (time first, padded) of all variables, which are kept once they are loaded whole."""
    # dask may wrap the arrays
    series = replace(series, source=series.source.reading(alone=len(series.steps) == 1))
    token = series.token()
    return {
        name: MemoryCachedArray(LazilyIndexedArray(_Variable(series, token, name, *array)))
        for name, array in series.arrays().items()
    }


class _Variable(BackendArray):
    """Variable of all steps."""

    def __init__(
        self, series: Series, token: str, name: str, dtype: DTypeLike, shape: tuple[int, ...]
    ) -> None:
        self.series = series
        self.token = token
        self.name = name
        self.dtype = np.dtype(dtype)
        self.shape = shape

    def __getitem__(self, key: ExplicitIndexer) -> Any:
        return explicit_indexing_adapter(
            key, self.shape, IndexingSupport.OUTER_1VECTOR, self._values
        )

    def _values(self, key: tuple[Any, ...]) -> NDArray:
        wanted = np.arange(self.shape[0])[key[0]]
        parts = [self._step(int(t))[key[1:]] for t in np.atleast_1d(wanted)]
        if wanted.ndim == 0:
            return parts[0].copy()
        if parts:
            return np.stack(parts)
        nothing = np.empty((0, *self.shape[1:]), self.dtype)
        return nothing[(slice(None), *key[1:])]

    def _step(self, t: int) -> NDArray:
        series = self.series
        steps = self.series.steps[t : t + 1]
        rows = self.series.rows()
        boxes = {name: values[t : t + 1] for name, values in series.boxes.items()}

        def particles() -> Frame:
            return read_particle_chunk(series.source, steps, series.particle_types, rows[0], boxes)

        def contacts() -> Frame:
            beside = _kept((self.token, t, "particles"), particles)
            return read_contact_chunk(
                series.source, steps, series.contact_names, rows[1], boxes, beside
            )

        read = particles if self.name in series.particle_types else contacts
        return _kept((self.token, t, read.__name__), read)[self.name][0]


def _kept(key: Hashable, read: Callable[[], Frame]) -> Frame:
    """Read a step, or give what was read; threads that want the same step wait for the first of them."""
    with _lock:
        there = _recent.pop(key, None)
        future = _recent[key] = there or Future()
        held = 0
        for k, (old, other) in enumerate(reversed([*_recent.items()])):
            held += _size(other)
            if k >= _KEPT and held > _MOST_KEPT:
                del _recent[old]
    if there is None:
        try:
            future.set_result(read())
        except BaseException as error:
            future.set_exception(error)
            with _lock:
                _recent.pop(key, None)
    return future.result()


def _size(future: Future[Frame]) -> int:
    """Bytes of a step; 0 while it is being read."""
    if not future.done() or future.exception() is not None:
        return 0
    return sum(array.nbytes for array in future.result().values())
