"""The command ``xcg`` from its first moment: importing the package takes a second, in which Ctrl-C may come.

It stands beside the package because nothing within can run before ``xcg/__init__.py`` has imported everything.
"""

import os
import signal
import threading


def _stop(*_: object) -> None:
    """End the process at once: an exception would come out of any of a hundred modules, or be swallowed by one."""
    os.write(2, b"\nstopped\n")
    os._exit(130)


def main() -> None:
    """Import the package and run the command, which then looks after Ctrl-C itself."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, _stop)
    from xcg.cli import main as command

    command(prog_name="xcg")


if __name__ == "__main__":
    main()
