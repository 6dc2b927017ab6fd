"""How far long work is: a bar in a terminal or notebook, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import TextIO

_WIDTH = 30
_EVERY = 30.0  # seconds between plain lines at most
_SHARE = 0.1  # or this share of all steps
_LONG = 2.0  # seconds after which work is long enough to tell about it unasked


class Progress:
    """Tell steps done, their rate and the time left.

    Parameters
    ----------
    count, done : int
        Steps in all, and those that are there already.
    stream : file
        Where it is told; a terminal or notebook gets a bar that is drawn again and again, anything else lines.
    quiet : bool
        Tell nothing.
    clock : callable
        Seconds.
    what : str
        What is counted.
    after : float
        Seconds in which nothing is told.
    """

    def __init__(
        self,
        count: int,
        done: int,
        stream: TextIO,
        *,
        quiet: bool = False,
        clock: Callable[[], float] = time.monotonic,
        what: str = "steps",
        after: float = 0.0,
    ) -> None:
        self._count, self._first, self._stream, self._quiet, self._clock = count, done, stream, quiet, clock
        self._what, self._after = what, after
        self._start = self._said_at = clock()
        self._said = done
        self._bar = _redraws(stream)
        self._drawn = 0  # letters of the bar that stands there
        if self._bar and not quiet:
            self.update(done)

    def update(self, done: int) -> None:
        """Tell that so many steps are done."""
        if self._quiet or self._clock() - self._start < self._after:
            return
        if self._bar:
            filled = _WIDTH * done // max(1, self._count)
            bar = f"[{'#' * filled}{'-' * (_WIDTH - filled)}] {self._text(done)}"
            self._stream.write(f"\r{bar:{self._drawn}}")  # blanks over the rest of a longer one
            self._stream.flush()
            self._drawn = len(bar)
            return
        now = self._clock()
        if done == self._count or done - self._said >= _SHARE * self._count or now - self._said_at >= _EVERY:
            self._stream.write(f"{self._text(done)}\n")
            self._stream.flush()
            self._said, self._said_at = done, now

    def _text(self, done: int) -> str:
        new, seconds = done - self._first, self._clock() - self._start
        text = f"{done} of {self._count} {self._what}"
        if new > 0 and seconds > 0:
            left = timedelta(seconds=round((self._count - done) * seconds / new))
            text += f", {new / seconds:.3g} {self._what}/s, {left} left"
        return text

    def end(self) -> None:
        """Leave the line of the bar."""
        if self._drawn:
            self._stream.write("\n")
            self._stream.flush()


@contextmanager
def shown(count: int, wanted: bool | None, *, what: str = "steps") -> Iterator[Progress]:
    """Tell on the standard error how far a block of code is: always, never, or (None) where one would like to know.

    That is in a terminal or notebook, from two seconds on.
    """
    stream = sys.stderr
    quiet = not (_redraws(stream) if wanted is None else wanted)
    bar = Progress(count, 0, stream, quiet=quiet, what=what, after=_LONG if wanted is None else 0.0)
    try:
        yield bar
    finally:
        bar.end()


def _redraws(stream: TextIO) -> bool:
    """Whether what was written in a line can be written over."""
    return stream.isatty() or type(stream).__module__.startswith("ipykernel")
