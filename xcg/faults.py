"""What becomes of a step that cannot be read or computed: its error is raised, or the step is skipped and named."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from xcg.schema import SceneWarning

ON_ERROR = ("raise", "skip")

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
        self.step, self.cause = step, cause

    def __str__(self) -> str:
        return f"step {self.step} is skipped: {self.cause}"


def check_on_error(on_error: str) -> str:
    """Refuse what is no choice of `on_error`."""
    if on_error not in ON_ERROR:
        msg = f"on_error={on_error!r}: expected 'raise' (stop at the first error) or 'skip' (go on without the step)"
        raise ValueError(msg)
    return on_error


class _Noted(threading.local):
    """Faults of this thread, by number of the step; None where they are raised."""

    faults: dict[int, str] | None = None


_noted = _Noted()


@contextmanager
def tolerated() -> Iterator[dict[int, str]]:
    """Give the faults that are noted in this thread instead of raised, by number of the step."""
    before, _noted.faults = _noted.faults, {}
    try:
        yield _noted.faults
    finally:
        _noted.faults = before


def note(step: int, error: Exception) -> bool:
    """Note the fault of a step; False where nobody tolerates it, and it must be raised."""
    if _noted.faults is None:
        return False
    _noted.faults.setdefault(step, str(error) or repr(error))
    return True


def warn_of(faults: dict[int, str]) -> None:
    """Warn of every step that was skipped."""
    for step, cause in faults.items():
        warnings.warn(SkippedStep(step, cause), stacklevel=3)
