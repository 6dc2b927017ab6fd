"""The command ``xcg`` from its first moment on: Ctrl-C is looked after before libraries are loaded.

This module stands beside the package, as importing any part of the package loads them.

Exit codes: 0 done, 1 the job or its data are at fault (the message says what), 2 the command line is, 130 stopped by
Ctrl-C.
"""

import gc
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


def main() -> None:
    """Run the command; it ends at once, and without a traceback, when it is interrupted."""
    signal.signal(signal.SIGINT, stop)
    from xcg.cli.commands import group

    try:
        group(prog_name="xcg")
    except SystemExit as end:
        if isinstance(end.code, int) and end.code:  # threads would be waited for, a file of a full disk closed again
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code)
        gc.freeze()  # else Python looks through all objects of all libraries before it ends, for half a second
        raise
