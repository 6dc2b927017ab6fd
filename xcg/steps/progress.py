"""Progress of long work: a bar in a terminal or notebook, plain lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TextIO

from dask.callbacks import Callback
from tqdm import tqdm

from xcg.compiled._jit import is_interactive

_SHARE = 0.1  # of all steps, from one plain line to the next
_LONG = 2.0  # seconds after which work is long enough to show progress unasked
_BAR = "[{bar:30}] {n_fmt} of {total_fmt}{unit}, {rate_noinv_fmt}, {remaining} left"
_LINE = "{n_fmt} of {total_fmt}{unit}, {rate_noinv_fmt}, {remaining} left"


class _LogLines:
    """A stream in which every state of a bar is a line of its own."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._last = stream, ""

    def write(self, text: str) -> None:
        line = text.strip("\r\n ")
        steps = line.split(",")[0]
        if line and steps != self._last:  # the last state comes twice
            self._stream.write(f"{line}\n")
        self._last = steps or self._last

    def flush(self) -> None:
        self._stream.flush()


@contextmanager
def shown(count: int, wanted: bool | None, *, done: int = 0, what: str = "steps") -> Iterator[tqdm]:
    """Show on the standard error how far a block of code is; nothing where all steps are finished before.

    Parameters
    ----------
    count, done : int
        Number of all steps, and of finished steps.
    wanted : bool or None
        Always, never, or (None) from two seconds on in a terminal or notebook.
    what : str
        What is counted.

    Yields
    ------
    tqdm.tqdm
        Its method ``update(n)`` counts further steps.
    """
    redraws = is_interactive()
    how: dict[str, Any] = {"file": sys.stderr, "bar_format": _BAR, "delay": 0}
    if not redraws:
        how = {"file": _LogLines(sys.stderr), "bar_format": _LINE, "mininterval": 0, "miniters": _SHARE * count}
        how |= {"maxinterval": float("inf"), "delay": 1e-9}  # which leaves out the line before the first step
    how |= {"delay": _LONG} if wanted is None else {}
    quiet = done >= count or not (redraws if wanted is None else wanted)
    with tqdm(total=count, initial=done, disable=quiet, unit=f" {what}", ascii="-#", **how) as bar:
        yield bar


class CountTasks(Callback):
    """Dask callback that counts the tasks whose keys are chosen, and updates a bar of steps.

    Parameters
    ----------
    bar : tqdm.tqdm
        Steps.
    is_counted : callable
        Whether a key is that of a task to count.
    """

    def __init__(self, bar: tqdm, is_counted: Callable[[Any], bool]) -> None:
        super().__init__(start=self._begin, posttask=self._end)
        self._bar, self._is_counted, self._tasks, self._done, self._first = bar, is_counted, 1, 0, bar.n

    def _begin(self, graph: Mapping[Any, Any]) -> None:
        self._tasks = max(1, sum(map(self._is_counted, graph)))

    def _end(self, key: Any, *_: Any) -> None:
        if self._is_counted(key):
            self._done += 1
            steps = (self._bar.total - self._first) * self._done // self._tasks
            self._bar.update(self._first + steps - self._bar.n)
