"""The command ``xcg``: what its line can say, and how it ends.

It stands beside the package `xcg`, because importing any part of that loads xarray. Modules here import what a command
does when it is done, so that help and completion come at once, and Ctrl-C is looked after before libraries are loaded.

Exit codes: 0 done, 1 the job or its data are at fault (the message says what), 2 the command line is, 130 stopped by
Ctrl-C.
"""

import os
import signal
import sys

from xcg_start.stop import stop


def main() -> None:
    """Run the command; it ends at once, and without a traceback, when it is interrupted."""
    signal.signal(signal.SIGINT, stop)
    from xcg_start.group import group

    try:
        group(prog_name="xcg")
    except SystemExit as end:
        if isinstance(end.code, int) and end.code:  # threads would be waited for, a file of a full disk closed again
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code)
        raise
