"""Errors and warnings: their classes and words, at the line of the user's program, once a call."""

from __future__ import annotations

import difflib
import re
import sys
import threading
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType, MappingProxyType
from typing import Any, ClassVar
from uuid import uuid4

_OF_NUMPY = re.compile(r"\bnp\.(?:float|u?int)\d+\(([^()]*)\)")


def printable(text: str) -> str:
    """Write what a terminal would obey or hide, as codes for colours or the title of its window, as escapes.

    Messages quote files, and files may come from strangers. NumPy's numbers become plain: 0.1 for
    np.float64(0.1).
    """
    text = _OF_NUMPY.sub(r"\1", text)
    return "".join(
        c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text
    )


def plain(value: object) -> str:
    """Write a value of the caller's in a message."""
    return printable(repr(value))


class _Printable(Exception):
    """Keeps its message printable."""

    def __init__(self, *args: object) -> None:
        super().__init__(*(printable(a) if isinstance(a, str) else a for a in args))


class SceneError(_Printable, ValueError):
    """Something in the DEM data is missing, contradictory or not finite."""


class SceneWarning(_Printable, UserWarning):
    """Something in the data or the request is probably a mistake."""


def did_you_mean(
    word: str,
    words: Iterable[str],
    cutoff: float = 0.6,
    synonyms: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Suggest the most similar of some words, as the end of a message; "" if none is similar.

    Names are compared by the parts between underscores in which they differ, so that "contact_heat"
    is not similar to "contact_j".

    Parameters
    ----------
    word : str
        The unknown word. Capitals, blanks and hyphens make no difference.
    words : iterable of str
        Known words.
    cutoff : float
        Least similarity, from 0 to 1.
    synonyms : mapping
        Known words by other names for them.
    """
    plainly = {_plainly(candidate): candidate for candidate in words}
    wanted = _plainly(word)
    if synonyms.get(wanted) in plainly.values():
        return f"; did you mean {synonyms[wanted]!r}?"
    likeness, nearest = max(
        ((_similarity(wanted, name), name) for name in plainly), default=(0.0, "")
    )
    if likeness < cutoff:
        return ""
    return f"; did you mean {plainly[nearest]!r}?"


def _similarity(word: str, other: str) -> float:
    """Return the similarity of two names, from 0 to 1.

    Unless they differ by one letter, or by two that are swapped, the parts at both ends that they
    share do not count.
    """
    whole = difflib.SequenceMatcher(None, other, word).ratio()
    unmatched = (1 - whole) * (len(word) + len(other))
    if round(unmatched) <= 2:
        return whole
    parts = word.split("_")
    others = other.split("_")
    for end in (0, -1):
        while parts and others and parts[end] == others[end]:
            del parts[end], others[end]
    if not parts or not others:
        return whole
    return difflib.SequenceMatcher(None, "_".join(others), "_".join(parts)).ratio()


def _plainly(word: str) -> str:
    return word.strip().lower().replace(" ", "_").replace("-", "_")


def unknown(
    what: str,
    word: object,
    valid: Iterable[object],
    listed: str = "",
    synonyms: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return a message about a name that does not exist: the most similar or one that contains it first, then all.

    Parameters
    ----------
    what : str
        What it was to be, such as "field".
    listed : str
        Where long lists are found, in place of all names.
    synonyms : mapping
        Known names by other names for them.
    """
    names = [str(name) for name in valid]
    rest = listed or f"expected one of {', '.join(names)}"
    hint = did_you_mean(str(word), names, synonyms=synonyms)
    if not hint and len(str(word)) > 2:
        longer = [name for name in names if _plainly(str(word)) in name]
        if longer:
            hint = f"; did you mean {min(longer, key=len)!r}?"
    if not hint:
        return f"unknown {what} {word!r}; {rest}"
    return f"unknown {what} {word!r}{hint} {rest[0].upper()}{rest[1:]}"


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


def warn_user(message: str | Warning) -> None:
    """Warn at the line of the user's program that made the call.

    It is the first line outside this package and the libraries that run its tasks. A thread of
    dask's has no such line; there it is the line of the main thread that waits for the result.
    Workers of ``distributed`` pass the warning on.

    Parameters
    ----------
    message : str or Warning
        What is wrong, what it leads to, and what to do; a text becomes a SceneWarning.
    """
    if current_worker() is not None:
        sys.modules["distributed"].worker.warn(message, SceneWarning)
        return
    # No local variable holds the frame of this function: that would keep it, and with it the
    # results of all its callers, until the garbage collector runs.
    frame = _of_user(sys._getframe(1)) or _of_user(_main_frame()) or sys._getframe(1)
    name = frame.f_globals.get("__name__", "<unknown>")
    registry = frame.f_globals.setdefault("__warningregistry__", {})
    warnings.warn_explicit(
        message, SceneWarning, frame.f_code.co_filename, frame.f_lineno, name, registry
    )


def _main_frame() -> FrameType | None:
    """Return the frame in which the main thread is."""
    return sys._current_frames().get(threading.main_thread().ident or 0)


def _of_user(frame: FrameType | None) -> FrameType | None:
    """Return the first frame from here outwards that is of none of the packages in between."""
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _BETWEEN:
        frame = frame.f_back
    return frame


def current_worker() -> Any:
    """Return the worker of distributed whose task this thread runs; None if it runs none."""
    distributed: Any = sys.modules.get("distributed")
    if distributed is None:
        return None
    try:
        return distributed.get_worker()
    except ValueError:
        return None


@dataclass(eq=False)
class Once:
    """Warnings of one call, each given once per process; copies in one process share them by their key.

    dask leaves the key out of the names of tasks, so that equal calls have equal names. The
    latest `REMEMBERED` warnings of the process are remembered.
    """

    REMEMBERED: ClassVar[int] = 10_000
    _said: ClassVar[dict[tuple[str, str], None]] = {}
    _lock: ClassVar[threading.Lock] = threading.Lock()

    key: str = field(default_factory=lambda: uuid4().hex)

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
        if self.is_new(about):
            warn_user(message)

    def is_new(self, about: str) -> bool:
        """Return whether this is the first time that the call asks about something."""
        with self._lock:
            if (self.key, about) in self._said:
                return False
            self._said[self.key, about] = None
            if len(self._said) > self.REMEMBERED:
                del self._said[next(iter(self._said))]
        return True

    def has_asked(self, about: str) -> bool:
        """Return whether the call asked `is_new` about something before."""
        return (self.key, about) in self._said

    @contextmanager
    def active(self) -> Iterator[None]:
        """Let `warn_once` in this thread speak for this call."""
        before = _current.call
        _current.call = self
        try:
            yield
        finally:
            _current.call = before


class _Current(threading.local):
    """The call that this thread works for."""

    call: Once | None = None


_current = _Current()


def active_call() -> Once:
    """Return the warnings of the call that this thread works for, or of a new one."""
    return _current.call or Once()


def warn_once(about: str, message: str) -> None:
    """Warn of something found in a step, once for all steps of the call that is being computed; see `Once.warn`."""
    active_call().warn(about, message)
