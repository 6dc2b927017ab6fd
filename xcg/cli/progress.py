"""How far a run is: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import timedelta
from typing import TextIO

_WIDTH = 30
_EVERY = 30.0  # seconds between plain lines at most
_SHARE = 0.1  # or this share of all steps


class Progress:
    """Tell steps done, their rate and the time left.

    Parameters
    ----------
    count, done : int
        Steps in all, and those that are there already.
    stream : file
        Where it is told; a terminal gets a bar that is drawn again and again, anything else lines.
    quiet : bool
        Tell nothing.
    clock : callable
        Seconds.
    """

    def __init__(
        self, count: int, done: int, stream: TextIO, *, quiet: bool = False, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._count, self._first, self._stream, self._quiet, self._clock = count, done, stream, quiet, clock
        self._start = self._said_at = clock()
        self._said = done
        self._bar = stream.isatty()
        if self._bar and not quiet:
            self.update(done)

    def update(self, done: int) -> None:
        """Tell that so many steps are done."""
        if self._quiet:
            return
        if self._bar:
            filled = _WIDTH * done // max(1, self._count)
            self._stream.write(f"\r\x1b[K[{'#' * filled}{'-' * (_WIDTH - filled)}] {self._text(done)}")
            self._stream.flush()
            return
        now = self._clock()
        if done == self._count or done - self._said >= _SHARE * self._count or now - self._said_at >= _EVERY:
            self._stream.write(f"{self._text(done)}\n")
            self._stream.flush()
            self._said, self._said_at = done, now

    def _text(self, done: int) -> str:
        new, seconds = done - self._first, self._clock() - self._start
        text = f"{done} of {self._count} steps"
        if new > 0 and seconds > 0:
            left = timedelta(seconds=round((self._count - done) * seconds / new))
            text += f", {new / seconds:.3g} steps/s, {left} left"
        return text

    def end(self) -> None:
        """Leave the line of the bar."""
        if self._bar and not self._quiet:
            self._stream.write("\n")
            self._stream.flush()
