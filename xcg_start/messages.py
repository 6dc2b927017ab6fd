"""What a command says of warnings and errors."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import click

# what xcg.steps.errors and xcg.chains.search take, which are not imported for help; a test compares them
ON_ERROR = ("raise", "skip")
ALGORITHMS = ("branching", "peters2005")


@contextmanager
def plain_messages(quiet: bool) -> Iterator[None]:
    """Show warnings as one line each, and errors of data without a traceback."""
    from xcg.scene.schema import SceneWarning, printable

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if not quiet:
            start = "\r\x1b[K" if sys.stderr.isatty() else ""  # over the bar, which is drawn again
            click.echo(f"{start}warning: {printable(str(message))}", err=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", SceneWarning)
        warnings.showwarning = show
        try:
            yield
        except (ValueError, OSError, ImportError) as error:
            said = str(error).replace("overwrite=True", "--overwrite")  # what the line calls it
            raise click.ClickException(printable(said)) from error
        except MemoryError as error:
            msg = (
                f"not enough memory ({error}); take fewer steps at a time (--jobs 1), fewer fields, or a larger spacing"
            )
            raise click.ClickException(msg) from error
