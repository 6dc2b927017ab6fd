"""End of the process at Ctrl-C."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable

# What a command that is stopped has to say.
last_words: list[Callable[[], str]] = []


def stop(*_: object) -> None:
    """End the process at once.

    An exception would unwind through libraries that do not expect it (a lock of xarray's, taken and
    not noted, then stops the run for ever), and threads that compute a step would be waited for.
    All files can stand an end like this.
    """
    # while it is not loaded nothing is begun
    abandon = getattr(sys.modules.get("xcg.writers.files"), "abandon", None)
    if abandon is not None:
        abandon()
    words = "".join(f"\n{last()}" for last in last_words)
    try:
        sys.stderr.write(f"\nstopped{words}\n")
        sys.stderr.flush()
    except (OSError, RuntimeError):  # interrupted while it prints
        pass
    os._exit(128 + signal.SIGINT)
