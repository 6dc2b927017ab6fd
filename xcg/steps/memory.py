"""Memory of results that are done with serves the next ones of the same size, while a file is written.

The system hands out memory page by page, which may take as long as what is computed into it: see docs/design.md.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from threading import Lock

import numpy as np
from numpy.typing import NDArray

_MOST = 64_000_000  # bytes of the results of a chunk, of which some are there at a time; more would be missed elsewhere


class _Kept:
    """Memory that waits for arrays, by its size, as long as anybody writes."""

    def __init__(self) -> None:
        self._waiting: defaultdict[int, list[NDArray]] = defaultdict(list)
        self._writers, self._counting = 0, Lock()

    def __bool__(self) -> bool:
        return self._writers > 0

    @contextmanager
    def while_writing(self) -> Iterator[None]:
        with self._counting:
            self._writers += 1
        try:
            yield
        finally:
            with self._counting:
                self._writers -= 1
                if not self._writers:
                    self._waiting.clear()

    def take(self, size: int) -> NDArray:
        try:
            memory = self._waiting[size].pop()
        except IndexError:
            memory = np.empty(size, "u1")
        return np.asarray(_Loan(memory))

    def give_back(self, memory: NDArray) -> None:
        # without the lock, as an array may end its life at any line, and so at one that holds it
        if self:
            self._waiting[memory.size].append(memory)


class _Loan:
    """What arrays in some memory refer to: it ends with the last of them, and gives the memory back."""

    def __init__(self, memory: NDArray) -> None:
        self._memory, self.__array_interface__ = memory, memory.__array_interface__

    def __del__(self) -> None:
        _kept.give_back(self._memory)


_kept = _Kept()
memory_is_kept = _kept.while_writing


def empty_arrays(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, NDArray]:
    """Make arrays of numbers of these shapes, with anything in them."""
    if not _kept or 8 * sum(map(math.prod, shapes.values())) > _MOST:
        return {name: np.empty(shape) for name, shape in shapes.items()}
    return {name: _kept.take(8 * math.prod(shape)).view("float64").reshape(shape) for name, shape in shapes.items()}
