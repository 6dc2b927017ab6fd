"""What becomes of a step that cannot be read or computed: its error is raised, or the step is skipped and named."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal, TypeAlias, get_args

from xcg.scene.schema import SceneError, SceneWarning, printable
from xcg.scene.warn import warn_user

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
        self.step, self.cause = step, printable(cause)

    def __str__(self) -> str:
        return f"step {self.step} is skipped: {self.cause}"


def check_on_error(on_error: str) -> OnError:
    """Refuse what is no choice of `on_error`."""
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
    """Give the faults that are noted in this thread instead of raised, by number of the step or by file."""
    before, _recorded.faults = _recorded.faults, {}
    try:
        yield _recorded.faults
    finally:
        _recorded.faults = before


@contextmanager
def raising() -> Iterator[dict[Any, str]]:
    """Let faults be raised; the counterpart of `collecting`."""
    yield {}


def record_fault(source: int | str, error: Exception) -> bool:
    """Note the fault of a step or file; False where nobody tolerates it, and it must be raised."""
    if _recorded.faults is None:
        return False
    _recorded.faults.setdefault(source, cause_of(error))
    return True


def cause_of(error: Exception) -> str:
    """Say what an error says, or its name where it says nothing."""
    return str(error) or repr(error)


def raise_or_record(path: str, error: Exception) -> None:
    """Raise the fault of a file, or note it, unless one of it is noted."""
    known = any(str(source).startswith(path) for source in _recorded.faults or ())
    if not known and not record_fault(path, error):
        raise error


def recorded() -> int:
    """Count the faults that are noted in this thread."""
    return len(_recorded.faults or ())


def is_collecting() -> bool:
    """Whether faults are tolerated in this thread."""
    return _recorded.faults is not None


def raise_recorded() -> None:
    """Raise the first fault that was noted, where nothing is left to go on with."""
    if _recorded.faults:
        raise SceneError(next(iter(_recorded.faults.values())))


_listeners: list[dict[int, str]] = []


@contextmanager
def listen_for_skips() -> Iterator[dict[int, str]]:
    """Give the faults of all steps that are skipped meanwhile in this process, in whatever thread."""
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
    """Warn of every step that was skipped."""
    for step, cause in faults.items():
        for listener in list(_listeners):
            listener[step] = cause
        warn_user(SkippedStep(step, cause))
