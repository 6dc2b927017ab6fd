"""How many steps a chunk has, from ``chunks=`` as xarray takes it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

import dask
import numpy as np
from dask.utils import parse_bytes

from xcg.readers.engine import StepRef
from xcg.readers.lazy import Series
from xcg.scene.schema import SceneError, variable

Chunks: TypeAlias = int | str | Sequence[int] | Mapping[str, int | str | Sequence[int] | None] | None

_TASK = 0.1  # seconds of work that make the scheduling of a task, and the writing of a chunk, small beside it
_BYTE, _ROW = 1e-8, 1e-6  # seconds to parse a byte of text, and to compute fields of a particle or contact
_EXPECTED = (
    "expected the number of steps in a chunk, -1 for all, 'auto', None for no dask, or such as {'time': 10}, as the "
    "rows of a step stay together"
)


def steps_of_chunks(chunks: Any, series: Series) -> tuple[int, ...]:
    """Numbers of steps in the chunks of a series."""
    return chunk_sizes(chunks, len(series.steps), partial(_sensible, series))


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
        chunks = 1 if chunks is None else chunks
    if isinstance(chunks, str) and chunks == "auto":
        chunks = sensible()
    sizes = np.atleast_1d(np.asarray(chunks))
    if sizes.dtype.kind not in "iu" or sizes.ndim != 1:
        raise SceneError(msg)
    if np.ndim(chunks):
        if (sizes < 1).any() or sizes.sum() != count:
            raise SceneError(f"chunks={chunks!r}: expected positive numbers that add up to the {count} steps")
        return tuple(sizes.tolist())
    size = max(1, count) if sizes[0] == -1 else int(sizes[0])
    if size < 1:
        raise SceneError(msg)
    return tuple(min(size, count - start) for start in range(0, count, size))


def _sensible(series: Series) -> int:
    """Count steps that make a task of `_TASK` seconds, whose arrays are no larger than dask wants chunks to be."""
    refs = [ref for step in series.steps for ref in (step.particles, *step.contacts)]
    shared = Counter(ref.path for ref in refs)
    read = sum(_bytes(ref, shared[ref.path]) for ref in refs) / len(series.steps)
    held: int = sum(_held(name, dtype, series.particle_rows) for name, dtype in series.particle_types.items())
    held += sum(_held(name, variable(name).dtype, series.contact_rows) for name in series.contact_names)
    rows = sum(ref.rows for ref in refs) / len(series.steps)
    return steps_in_a_task(rows, held, read * _BYTE)


def steps_in_a_task(rows: float, held: int, seconds: float = 0.0) -> int:
    """Count steps that make a sensible task, of so many rows and bytes in memory each, which take `seconds` to read."""
    limit = parse_bytes(dask.config.get("array.chunk-size"))
    return max(1, min(math.ceil(_TASK / max(seconds + rows * _ROW, 1e-9)), limit // max(held, 1)))


def _held(name: str, dtype: Any, rows: int) -> int:
    """Bytes of one step of a variable in memory."""
    return math.prod(variable(name, dtype).shape(rows)) * np.dtype(dtype).itemsize


def _bytes(ref: StepRef, steps: int) -> float:
    """Bytes of a body, as its header tells, else its share of the file."""
    return ref.length or ref.size / steps
