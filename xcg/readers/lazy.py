"""Lazy arrays of a series: which steps make a chunk, and the tasks of dask that read them."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import Any, TypeAlias

import dask
import dask.array as da
import numpy as np
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph
from dask.utils import parse_bytes
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.read_steps import Source, Step, read_contact_chunk, read_particle_chunk
from xcg.scene.schema import MOTION, ROTATION, Frame, variable
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
    return steps_in_a_task(len(series.steps), rows, held, read * _BYTE)


def steps_in_a_task(count: int, rows: float, held: int, seconds: float = 0.0) -> int:
    """Count steps that make a sensible task.

    Tasks are equal, and fewer steps than two tasks take are one: two threads would wait for each
    other in Python.

    Parameters
    ----------
    count : int
        Number of all steps.
    rows, held, seconds
        Rows and bytes in memory of a step, and the time to read it.
    """
    steps = max(1, math.ceil(_TASK / max(seconds + rows * _ROW, 1e-9)))
    limit = parse_bytes(dask.config.get("array.chunk-size")) // max(held, 1)
    tasks = max(1, count // steps)
    return max(1, min(math.ceil(count / tasks), limit))


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
