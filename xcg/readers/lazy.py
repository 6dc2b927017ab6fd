"""Lazy arrays of a series: the tasks of dask that read its chunks of time."""

from __future__ import annotations

import math
from collections import Counter
from functools import partial
from itertools import accumulate
from typing import Any

import dask.array as da
import numpy as np
from dask.base import tokenize
from dask.highlevelgraph import HighLevelGraph

from xcg.readers.chunks import chunk_sizes, steps_in_a_task
from xcg.readers.read_steps import read_contact_chunk, read_particle_chunk
from xcg.readers.series import Series
from xcg.scene.frame import entries_of
from xcg.scene.schema import MOTION, ROTATION
from xcg.steps.mapping import picked

_BYTE = 1e-8  # seconds to parse a byte of text


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

    particle_count, contact_count = series.lengths()
    graphs: dict[str, tuple[HighLevelGraph, str]] = {}
    # what few fields need is read by tasks of its own; contacts are checked against the particles,
    # which come last
    seldom = [*ROTATION, *MOTION]
    kinds = {"rotation": ROTATION, "motion": MOTION, "particles": {*particle_types} - {*seldom}}
    for kind, names in kinds.items():
        layer = f"read-{kind}-{token}"
        tasks: dict[Any, Any] = {}
        types = {name: dtype for name, dtype in particle_types.items() if name in names}
        others = [name for name in seldom if name in particle_types and name not in types]
        reader = source.reading(unwanted=tuple(others))
        for k, part in enumerate(parts):
            edges = entries_of(boxes, part)
            task = partial(read_particle_chunk, reader, steps[part], types, particle_count, edges)
            tasks[layer, k] = (task,)
        graph = HighLevelGraph({layer: tasks}, {layer: set()})
        graphs |= dict.fromkeys(types, (graph, layer))
    if series.contact_names:
        particles = layer
        layer = f"read-contacts-{token}"
        tasks = {}
        for k, part in enumerate(parts):
            edges = entries_of(boxes, part)
            task = partial(
                read_contact_chunk, source, steps[part], series.contact_names, contact_count, edges
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


def _sensible(series: Series) -> int:
    """Count steps that make a task of a tenth of a second, with arrays no larger than dask's chunks."""
    refs = [ref for step in series.steps for ref in (step.particles, *step.contacts)]
    shared = Counter(ref.path for ref in refs)
    # bytes of a body, from its header, else its share of the file
    read = sum(ref.length or ref.size / shared[ref.path] for ref in refs) / len(series.steps)
    in_memory = 0  # bytes of a step
    for dtype, shape in series.arrays().values():
        in_memory += math.prod(shape[1:]) * np.dtype(dtype).itemsize
    size = sum(ref.rows for ref in refs) / len(series.steps)
    return steps_in_a_task(len(series.steps), size, in_memory, read * _BYTE)
