"""Chunks of time: how many steps make one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from xcg.common.messages import SceneError

Chunks: TypeAlias = (
    int | str | Sequence[int] | Mapping[str, int | str | Sequence[int] | None] | None
)

_TASK = 0.1  # seconds of work that make the scheduling of a task, and the writing of a chunk, small beside it
_ROW = 1e-6  # seconds to compute fields of a particle or contact
_EXPECTED = (
    "expected the number of steps in a chunk, -1 for all, 'auto', None for no dask, or such as {'time': 10}, as the "
    "rows of a step stay together"
)


def is_automatic(chunks: Any) -> bool:
    """Return whether the number of steps in a chunk is left to xcg."""
    return isinstance(chunks, str) and chunks == "auto"


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
    if is_automatic(chunks):
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


def steps_in_a_task(count: int, size: float, held: int, seconds: float = 0.0) -> int:
    """Count steps that make a sensible task.

    Tasks are equal, and fewer steps than two tasks take are one: two threads would wait for each
    other in Python.

    Parameters
    ----------
    count : int
        Number of all steps.
    size, held, seconds
        Particles and contacts of a step, its bytes in memory, and the time to read it.
    """
    from dask import config  # slow to import
    from dask.utils import parse_bytes

    steps = max(1, math.ceil(_TASK / max(seconds + size * _ROW, 1e-9)))
    limit = parse_bytes(config.get("array.chunk-size")) // max(held, 1)
    tasks = max(1, count // steps)
    return max(1, min(math.ceil(count / tasks), limit))
