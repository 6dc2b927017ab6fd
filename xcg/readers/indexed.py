"""Arrays of a series for `xarray.open_dataset`: indexed lazily, they share the last steps that were read."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from xarray.backends import BackendArray

from xcg.common.compat import (
    ExplicitIndexer,
    IndexingSupport,
    LazilyIndexedArray,
    MemoryCachedArray,
    explicit_indexing_adapter,
)
from xcg.readers.read_steps import read_contact_chunk, read_particle_chunk
from xcg.readers.series import Series
from xcg.scene.schema import Frame

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
        lengths = self.series.lengths()
        boxes = {name: values[t : t + 1] for name, values in series.boxes.items()}

        def particles() -> Frame:
            return read_particle_chunk(
                series.source, steps, series.particle_types, lengths[0], boxes
            )

        def contacts() -> Frame:
            beside = _kept((self.token, t, "particles"), particles)
            return read_contact_chunk(
                series.source, steps, series.contact_names, lengths[1], boxes, beside
            )

        read = particles if self.name in series.particle_types else contacts
        return _kept((self.token, t, read.__name__), read)[self.name][0]


def _kept(key: Hashable, read: Callable[[], Frame]) -> Frame:
    """Read a step, or give what was read; threads that want the same step wait for the first of them."""
    with _lock:
        earlier = _recent.pop(key, None)
        future = _recent[key] = earlier or Future()
        held = 0
        for k, (old, other) in enumerate(reversed([*_recent.items()])):
            held += _size(other)
            if k >= _KEPT and held > _MOST_KEPT:
                del _recent[old]
    if earlier is None:
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
