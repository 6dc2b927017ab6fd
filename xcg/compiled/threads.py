"""Threads that share a piece of work: loops release the interpreter, so that threads of Python's are enough."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")
# Fewer particles than this are not worth a second thread.
PARTICLES_A_THREAD = 20_000


def worth(particles: int, threads: int) -> int:
    """How many of some threads are worth starting for the particles of one step."""
    return min(threads, 1 + particles // PARTICLES_A_THREAD)


def for_each(items: Sequence[T], do: Callable[[T], R], threads: int) -> list[R]:
    """Do something with each item, in turn or by several threads; return what it gave, raise an error of theirs.

    The calling thread is one of them, from the last item on, as it has more memory at hand: see docs/design.md.
    """
    if threads == 1 or len(items) < 2:
        return list(map(do, items))
    with ThreadPoolExecutor(threads - 1) as pool:
        others = [pool.submit(do, item) for item in items]
        try:
            own = {k: do(items[k]) for k in reversed(range(len(items))) if others[k].cancel()}
            return [own[k] if k in own else other.result() for k, other in enumerate(others)]
        finally:
            for other in others:
                other.cancel()


def for_parts(count: int, do: Callable[[int, int], R], threads: int, each: int = 1) -> list[R]:
    """Do something with all of `count` rows, ``do(first, last)``, in `each` parts a thread; one part for one thread."""
    parts = threads * each if threads > 1 else 1
    cuts = [count * k // parts for k in range(parts + 1)]
    return for_each(list(pairwise(cuts)), lambda part: do(*part), threads)
