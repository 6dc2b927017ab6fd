"""Threads within one step: for scenes in memory only, as under dask the chunks of time already share the processors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

import numpy as np

T = TypeVar("T")


def for_each(items: Sequence[T], do: Callable[[T], None], threads: int) -> None:
    """Do something with each item, in turn or by several threads; the first error is raised."""
    if threads == 1 or len(items) < 2:
        for item in items:
            do(item)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(do, items))


def slices(count: int, size: int) -> list[slice]:
    """Consecutive slices of `size` that cover `count` items."""
    edges = [*range(0, count, max(1, size)), count]
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


def shares(count: int, threads: int) -> list[slice]:
    """Consecutive slices of nearly equal size, a few for each thread so that none waits for long."""
    parts = 1 if threads == 1 else min(4 * threads, count)
    edges = np.linspace(0, count, max(1, parts) + 1).astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]
