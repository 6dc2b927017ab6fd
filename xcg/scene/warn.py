"""Warnings: at the line of the user's program that asked, and once a call, whatever steps and threads find them."""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, ClassVar
from uuid import uuid4

from xcg.scene.schema import SceneWarning

# Packages whose lines stand between a line of the user's program and the one that warns.
_BETWEEN = {
    "xcg",
    "dask",
    "xarray",
    "distributed",
    "tornado",
    "asyncio",
    "selectors",
    "concurrent",
    "threading",
    "queue",
}


def warn_user(message: str | Warning, category: type[Warning] = SceneWarning) -> None:
    """Warn at the line of the user's program that made the call.

    That is the first line outside this package and those that run its tasks. In a thread of dask's, which has no such
    line, it is the line of the main thread that waits for the result. A worker of ``distributed`` tells its client.

    Parameters
    ----------
    message : str or Warning
        What is wrong, what it leads to, and what to do.
    category : type
        Class of the warning, where `message` is text.
    """
    _current.warnings += 1
    distributed: Any = sys.modules.get("distributed")
    if distributed is not None and _on_worker(distributed):
        distributed.worker.warn(message, category)
        return
    main = sys._current_frames().get(threading.main_thread().ident or 0)
    frame = _of_user(sys._getframe(1)) or _of_user(main) or sys._getframe(1)
    name = frame.f_globals.get("__name__", "<unknown>")
    registry = frame.f_globals.setdefault("__warningregistry__", {})
    warnings.warn_explicit(message, category, frame.f_code.co_filename, frame.f_lineno, name, registry)


def _of_user(frame: FrameType | None) -> FrameType | None:
    """Return the first frame from here outwards that is of none of the packages in between."""
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _BETWEEN:
        frame = frame.f_back
    return frame


def _on_worker(distributed: Any) -> bool:
    try:
        distributed.get_worker()
    except ValueError:
        return False
    return True


class Once:
    """Warnings of one call, each of them given once: copies in other threads and processes know what was said.

    Copies in one process share what was said, as they have the same key. The key is no part of what dask names tasks
    by, so that equal calls still have equal names.
    """

    _said: ClassVar[set[tuple[str, str]]] = set()
    _lock: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, key: str | None = None) -> None:
        self.key = key or uuid4().hex

    def __reduce__(self) -> tuple[type[Once], tuple[str]]:
        return Once, (self.key,)

    def __dask_tokenize__(self) -> str:
        return type(self).__name__

    def warn(self, about: str, message: str) -> None:
        """Warn, unless this call has warned about the same before.

        Parameters
        ----------
        about : str
            What the warning is about, the same for all steps.
        message : str
            Its text, which may name the step.
        """
        with self._lock:
            if (self.key, about) in self._said:
                return
            self._said.add((self.key, about))
        warn_user(message)

    @contextmanager
    def active(self) -> Iterator[None]:
        """Let `warn_once` in this thread speak for this call."""
        before, _current.call = _current.call, self
        try:
            yield
        finally:
            _current.call = before


class _Current(threading.local):
    """The call that this thread works for, and how many warnings it has given."""

    call: Once | None = None
    warnings: int = 0


_current = _Current()


def warnings_given() -> int:
    """How many times this thread has warned, whether or not it was shown."""
    return _current.warnings


def warn_once(about: str, message: str) -> None:
    """Warn of something found in a step, once for all steps of the call that is being computed; see `Once.warn`."""
    (_current.call or Once()).warn(about, message)
