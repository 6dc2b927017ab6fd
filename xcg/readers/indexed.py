"""Arrays of a scene without dask, as xarray's backends give them: a step is read when one of its values is wanted.

A step is read whole, whichever variable asks first, so the last steps are kept for the other variables.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from xcg.readers.lazy import Series, read_contact_chunk, read_particle_chunk
from xcg.scene.schema import Frame, variable

_KEPT, _MOST_KEPT = 2, 1 << 28  # steps that are always kept, and bytes up to which more of them are

_recent: dict[Hashable, Future[Frame]] = {}  # the one that was used last comes last
_lock = threading.Lock()


def indexed_arrays(series: Series) -> dict[str, indexing.MemoryCachedArray]:
    """Arrays (time first, padded) of all variables, which are kept once they are loaded whole."""
    series = replace(series, source=series.source.taking_threads(len(series.steps) == 1))  # dask may wrap the arrays
    token = series.token()
    shapes = {name: (dtype, series.particle_rows) for name, dtype in series.particle_types.items()}
    shapes |= {name: (variable(name).dtype, series.contact_rows) for name in series.contact_names}
    return {
        name: indexing.MemoryCachedArray(indexing.LazilyIndexedArray(_Variable(series, token, name, dtype, rows)))
        for name, (dtype, rows) in shapes.items()
    }


class _Variable(BackendArray):
    """One variable of all steps."""

    def __init__(self, series: Series, token: str, name: str, dtype: DTypeLike, rows: int) -> None:
        self.series, self.token, self.name = series, token, name
        self.dtype = np.dtype(dtype)
        self.shape = (len(series.steps), *variable(name, dtype).shape(rows))

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER_1VECTOR, self._values)

    def _values(self, key: tuple[Any, ...]) -> NDArray:
        wanted = np.arange(self.shape[0])[key[0]]
        parts = [self._step(int(t))[key[1:]] for t in np.atleast_1d(wanted)]
        if wanted.ndim == 0:
            return parts[0].copy()
        return np.stack(parts) if parts else np.empty((0, *np.empty(self.shape[1:], self.dtype)[key[1:]].shape))

    def _step(self, t: int) -> NDArray:
        series, one = self.series, slice(t, t + 1)

        def particles() -> Frame:
            return read_particle_chunk(series.source, series.steps[one], series.particle_types, series.particle_rows)

        def contacts() -> Frame:
            boxes = {name: values[one] for name, values in series.boxes.items()}
            beside = _kept((self.token, t, "particles"), particles)
            return read_contact_chunk(
                series.source, series.steps[one], series.contact_names, series.contact_rows, boxes, beside
            )

        if self.name in series.particle_types:
            return _kept((self.token, t, "particles"), particles)[self.name][0]
        return _kept((self.token, t, "contacts"), contacts)[self.name][0]


def _kept(key: Hashable, read: Callable[[], Frame]) -> Frame:
    """Read a step, or give what was read; threads that want the same step wait for the first of them."""
    with _lock:
        there = _recent.pop(key, None)
        future = _recent[key] = there or Future()
        held = [(old, _size(other)) for old, other in reversed(_recent.items())]
        for k in range(_KEPT, len(held)):
            if sum(size for _, size in held[: k + 1]) > _MOST_KEPT:
                del _recent[held[k][0]]
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
