"""The end of a command by Ctrl-C."""

import os
import signal
import sys
from collections.abc import Callable

# What a command that is stopped has to say.
last_words: list[Callable[[], str]] = []


def stop(*_: object) -> None:
    """End the process at once.

    An exception would unwind through libraries that do not expect it (a lock of xarray's, taken and not noted, then
    stops the run for ever), and threads that compute a step would be waited for. All files can stand an end like this.
    """
    abandon = getattr(sys.modules.get("xcg.writers.files"), "abandon", None)  # while it is not loaded nothing is begun
    if abandon is not None:
        abandon()
    said = "".join(f"\n{words()}" for words in last_words)
    try:
        sys.stderr.write(f"\nstopped{said}\n")
        sys.stderr.flush()
    except (OSError, RuntimeError):  # interrupted while it prints
        pass
    os._exit(128 + signal.SIGINT)
