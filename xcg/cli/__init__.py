"""The command line.

Functions import what a command does when it is done, so that help comes soon.

Exit codes: 0 done, 1 the job or its data are at fault (`click.ClickException`), 2 the command line
is (`click.BadParameter`), 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import gc
import os
import signal
import sys

import click

from xcg.cli.chain_command import chains
from xcg.cli.file_commands import convert, explore, fields, info
from xcg.cli.job_command import run
from xcg.cli.stopping import stop


@click.group(
    commands=[chains, convert, explore, fields, info, run],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="xcg")
def group() -> None:
    """Continuum fields from granular simulations."""


def main() -> None:
    """Run the command; it ends at once, and without a traceback, when it is interrupted."""
    signal.signal(signal.SIGINT, stop)
    try:
        group(prog_name="xcg")
    except SystemExit as end:
        # threads would be waited for, a file of a full disk closed again
        if isinstance(end.code, int) and end.code:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code)
        gc.freeze()  # else Python looks through all objects of all libraries before it ends, for half a second
        raise
