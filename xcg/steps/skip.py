"""Steps that fail may be skipped: a chunk of time looks after its own faults, and fills the steps at fault.

dask gives up a whole computation when one task fails, so a chunk of time that may be skipped is one task that holds all
it depends on, down to the reading of its files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from xcg.scene.schema import PADDING
from xcg.steps.errors import FAULTS, cause_of, collecting, warn_of

# computes the results of a chunk from its arrays, time first, by name
Compute: TypeAlias = Callable[[Mapping[str, NDArray]], dict[str, NDArray]]
# shape of one step, and type
Result: TypeAlias = tuple[tuple[int, ...], str]


SKIPPED = "skipped"


def guarded(
    compute: Compute,
    results: Mapping[str, Result],
    numbers: NDArray | None,
    graph: Mapping[Any, Any],
    keys: Mapping[str, Any],
    arrays: Mapping[str, NDArray],
) -> dict[str, NDArray]:
    """Results of one chunk; steps that cannot be read or computed are filled, and warned of."""
    with collecting() as faults:
        if keys:
            from dask.core import get  # only lazy scenes have keys

            try:
                arrays = dict(arrays) | dict(zip(keys, get(graph, list(keys.values())), strict=True))
            except FAULTS as error:  # of none of its steps alone
                return _all_skipped(results, numbers, error)
    count = len(next(iter(arrays.values())))
    named = np.arange(count) if numbers is None else numbers
    if numbers is None and faults:
        faults = dict.fromkeys(named.tolist(), next(iter(faults.values())))
    if not any(number in faults for number in named.tolist()):
        try:
            return {**compute(arrays), SKIPPED: np.zeros(count, bool)}
        except FAULTS:
            pass  # find out which step it is
    found: dict[int, dict[str, NDArray]] = {}
    unread = set(faults)  # a step that cannot be computed says nothing of others with its number
    for t, number in enumerate(named.tolist()):
        if number in unread:
            continue
        try:
            found[t] = compute({of: a[t : t + 1] for of, a in arrays.items()})
        except FAULTS as error:
            faults[number] = cause_of(error)
    warn_of({number: cause for number, cause in faults.items() if number in named})
    return _filled(results, count, found)


def _all_skipped(results: Mapping[str, Result], numbers: NDArray | None, error: Exception) -> dict[str, NDArray]:
    if numbers is None:
        raise error  # how many steps there are is not known
    warn_of(dict.fromkeys(numbers.tolist(), cause_of(error)))
    return _filled(results, len(numbers), {})


def _filled(
    results: Mapping[str, Result], count: int, found: Mapping[int, Mapping[str, NDArray]]
) -> dict[str, NDArray]:
    """Results of the steps that were computed, and padding in place of the others."""
    out = {}
    for name, (shape, dtype) in results.items():
        if name == SKIPPED:
            out[name] = np.array([t not in found for t in range(count)])
            continue
        # a search in memory finds out by itself how many rows it returns
        sizes = [one[name].shape[1:] for one in found.values()] or [shape]
        whole = np.max(sizes, axis=0).astype(int) if shape else ()
        fill = np.nan if np.dtype(dtype).kind == "f" else PADDING
        out[name] = np.full((count, *whole), fill, dtype)
        for t, one in found.items():
            source: Any = (t, *map(slice, one[name].shape[1:]))
            out[name][source] = one[name][0]
    return out
