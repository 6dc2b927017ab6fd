"""Steps that cannot be read or computed: their errors are raised, or they are skipped and named."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import (
    SceneError,
    SceneWarning,
    current_worker,
    printable,
    warn_user,
)
from xcg.scene.schema import PADDING

OnError: TypeAlias = Literal["raise", "skip"]
ON_ERROR: tuple[OnError, ...] = get_args(OnError)

# Faults of data and of files; anything else is an error of a program and is never skipped.
FAULTS = (ValueError, OSError, EOFError, ArithmeticError)


class SkippedStep(SceneWarning):
    """A step was left out of a result because of an error; it is NaN there.

    Attributes
    ----------
    step : int
        Number of the time step.
    cause : str
        The error.
    """

    def __init__(self, step: int, cause: str) -> None:
        super().__init__(step, cause)
        self.step = step
        self.cause = printable(cause)

    def __str__(self) -> str:
        return f"step {self.step} is skipped: {self.cause}"


def check_on_error(on_error: str) -> OnError:
    """Raise ValueError unless `on_error` is one of its choices."""
    if on_error not in ON_ERROR:
        raise ValueError(
            f"on_error={on_error!r}: expected 'raise' (stop at the first error) or 'skip' (go on without the step)"
        )
    return on_error


class _Recorded(threading.local):
    """Faults of this thread, by number of the step or by file; None where they are raised."""

    faults: dict[int | str, str] | None = None


_recorded = _Recorded()


@contextmanager
def collecting() -> Iterator[dict[Any, str]]:
    """Yield a dict of the faults noted in this thread instead of raised, by number of the step or by file."""
    before = _recorded.faults
    _recorded.faults = {}
    try:
        yield _recorded.faults
    finally:
        _recorded.faults = before


def record_fault(source: int | str, error: Exception) -> bool:
    """Record the fault of a step or file; return False if nobody tolerates it and it must be raised."""
    if _recorded.faults is None:
        return False
    _recorded.faults.setdefault(source, cause_of(error))
    return True


def cause_of(error: Exception) -> str:
    """Return the message of an error, or its name where it has none."""
    return str(error) or repr(error)


def raise_or_record(path: str, error: Exception) -> None:
    """Record the fault of a file, unless one is recorded; raise it if faults are not collected."""
    is_recorded = any(str(source).startswith(path) for source in _recorded.faults or ())
    if not is_recorded and not record_fault(path, error):
        raise error


def recorded() -> Mapping[int | str, str] | None:
    """Return the faults that are noted in this thread; None where they are raised."""
    return _recorded.faults


def raise_recorded() -> None:
    """Raise the first fault that was noted, where nothing is left to go on with."""
    if _recorded.faults:
        raise SceneError(next(iter(_recorded.faults.values())))


SKIPS = "xcg-skips"

_listeners: list[dict[int, str]] = []


@contextmanager
def listen_for_skips() -> Iterator[dict[int, str]]:
    """Yield the faults of all steps that are skipped meanwhile in this process, in any thread."""
    found: dict[int, str] = {}
    _listeners.append(found)
    try:
        yield found
    finally:
        _listeners.remove(found)


def skips_heard() -> dict[int, str]:
    """Faults of the steps that were skipped in this process while somebody listens."""
    return {step: cause for listener in list(_listeners) for step, cause in listener.items()}


def warn_of(faults: Mapping[int, str]) -> None:
    """Warn of every step that was skipped; a worker of distributed also sends an event of the topic `SKIPS`."""
    worker = current_worker()
    for step, cause in faults.items():
        for listener in list(_listeners):
            listener[step] = cause
        if worker is not None:
            worker.log_event(SKIPS, {"step": int(step), "cause": cause})
        warn_user(SkippedStep(step, cause))


# computes the results of a chunk from its arrays, time first, by name
Compute: TypeAlias = Callable[[Mapping[str, NDArray]], dict[str, NDArray]]
# shape of one step, and type
Result: TypeAlias = tuple[tuple[int, ...], str]


SKIPPED = "skipped"


def guarded(
    results: Mapping[str, Result],
    numbers: NDArray | None,
    graph: Mapping[Any, Any],
    keys: Mapping[str, Any],
    arrays: Mapping[str, NDArray],
    compute: Compute,
) -> dict[str, NDArray]:
    """Results of one chunk; steps that cannot be read or computed are filled, and warned of."""
    with collecting() as faults:
        if keys:
            from dask.core import get  # only lazy scenes have keys

            try:
                read = get(graph, list(keys.values()))
                arrays = {**arrays, **dict(zip(keys, read, strict=True))}
            except FAULTS as error:  # of none of its steps alone
                if numbers is None:
                    raise  # how many steps there are is not known
                warn_of(dict.fromkeys(numbers.tolist(), cause_of(error)))
                return _filled(results, len(numbers), {})
    count = len(next(iter(arrays.values())))
    steps = list(range(count))
    if numbers is not None:
        steps = numbers.tolist()
    elif faults:
        faults = dict.fromkeys(steps, next(iter(faults.values())))
    if faults.keys().isdisjoint(steps):
        try:
            return {**compute(arrays), SKIPPED: np.zeros(count, bool)}
        except FAULTS:
            pass  # find out which step it is
    computed: dict[int, dict[str, NDArray]] = {}
    unread = set(faults)  # a step that cannot be computed says nothing of others with its number
    for t, number in enumerate(steps):
        if number in unread:
            continue
        try:
            computed[t] = compute({of: a[t : t + 1] for of, a in arrays.items()})
        except FAULTS as error:
            faults[number] = cause_of(error)
    warn_of({number: cause for number, cause in faults.items() if number in steps})
    return _filled(results, count, computed)


def _filled(
    results: Mapping[str, Result], count: int, computed: Mapping[int, Mapping[str, NDArray]]
) -> dict[str, NDArray]:
    """Results of the steps that were computed, and padding in place of the others."""
    out = {}
    for name, (shape, dtype) in results.items():
        if name == SKIPPED:
            out[name] = np.array([t not in computed for t in range(count)])
            continue
        of_steps = {t: arrays[name][0] for t, arrays in computed.items()}
        # a search in memory finds out by itself how many rows it returns
        sizes = [values.shape for values in of_steps.values()] or [shape]
        longest = [max(lengths) for lengths in zip(*sizes, strict=True)]
        fill = np.nan if np.dtype(dtype).kind == "f" else PADDING
        out[name] = np.full((count, *longest), fill, dtype)
        for t, values in of_steps.items():
            index: Any = (t, *map(slice, values.shape))
            out[name][index] = values
    return out
