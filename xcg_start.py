"""The command ``xcg`` from its first moment on: Ctrl-C is looked after before libraries are loaded, for half a second.

This module stands beside the package, as importing any part of the package loads them.
"""

import os
import signal


def _stop(*_: object) -> None:
    os.write(2, b"\nstopped\n")
    os._exit(128 + signal.SIGINT)


def main() -> None:
    """Run the command; from when it is loaded on, it looks after Ctrl-C itself."""
    signal.signal(signal.SIGINT, _stop)
    from xcg.cli import main as command

    command(prog_name="xcg")
