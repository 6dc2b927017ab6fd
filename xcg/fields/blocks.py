"""Threads within one step: for scenes in memory or of one chunk of time, as several chunks share the processors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise, product
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
R = TypeVar("R")
NodeBlock = tuple[tuple[int, int, int], tuple[int, int, int]]


def for_each(items: Sequence[T], do: Callable[[T], R], threads: int) -> list[R]:
    """Do something with each item, in turn or by several threads; return what it gave, raise an error of theirs.

    The calling thread is one of them, from the last item on, as it has more memory at hand: see docs/design.md.
    """
    if threads == 1 or len(items) < 2:
        return [do(item) for item in items]
    with ThreadPoolExecutor(threads - 1) as pool:
        others = [pool.submit(do, item) for item in items]
        try:
            own = {k: do(items[k]) for k in reversed(range(len(items))) if others[k].cancel()}
            return [own[k] if k in own else other.result() for k, other in enumerate(others)]
        finally:
            for other in others:
                other.cancel()


def blocks(shape: Sequence[int], size: int, threads: int) -> list[NodeBlock]:
    """Boxes (first nodes, one past the last) that cover a mesh: compact, of at most about `size` nodes.

    At least two for each thread, so that none waits for long.
    """
    parts, wanted = np.ones(3, int), max(math.ceil(math.prod(shape) / size), 2 * threads if threads > 1 else 1)
    while parts.prod() < min(wanted, math.prod(shape)):
        # rows of nodes run along the last axis: cut them later
        parts[np.argmax(np.where(parts < shape, np.asarray(shape) / parts / (1, 1, 2), 0.0))] += 1
    edges = [np.linspace(0, n, p + 1).astype(int).tolist() for n, p in zip(shape, parts, strict=True)]
    (x, y, z) = (list(pairwise(ends)) for ends in edges)
    return [((i[0], j[0], k[0]), (i[1], j[1], k[1])) for i, j, k in product(x, y, z)]


def places(block: NodeBlock, shape: Sequence[int]) -> NDArray:
    """Where the nodes of a box are among all nodes of a mesh, numbered row by row."""
    x, y, z = (np.arange(low, high, dtype="uint64") for low, high in zip(*block, strict=True))
    return ((x[:, None, None] * shape[1] + y[:, None]) * shape[2] + z).ravel()
