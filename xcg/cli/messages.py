"""What a command says of warnings and errors."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import click

# what xcg.steps.errors and xcg.chains.search take, which are not imported for help; a test compares them
ON_ERROR = ("raise", "skip")
ALGORITHMS = ("branching", "peters2005")
# missing='skip', overwrite=True, contacts=; but not alpha=100.0 or on_error='x': expected, which quote what was given
_ARGUMENT = re.compile(r"\b(\w+)=(?:'(\w+)'(?!:)|True\b|(?=[\s?:;,.)]|$))")


@contextmanager
def plain_messages(quiet: bool) -> Iterator[None]:
    """Show warnings as one line each, and errors of data without a traceback."""
    from xcg.scene.schema import SceneWarning, printable

    taken = click.get_current_context().command.params  # here, as threads that warn have no context
    options = {str(p.name): max(p.opts, key=len) for p in taken if isinstance(p, click.Option)}

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if not quiet:
            start = "\r\x1b[K" if sys.stderr.isatty() else ""  # over the bar, which is drawn again
            click.echo(f"{start}warning: {printable(_as_options(str(message), options))}", err=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", SceneWarning)
        warnings.showwarning = show
        try:
            yield
        except (ValueError, OSError, ImportError) as error:
            raise click.ClickException(printable(_as_options(str(error), options))) from error
        except MemoryError as error:
            raise click.ClickException(
                f"not enough memory ({error}); take fewer steps at a time (--jobs 1), fewer fields, or a larger spacing"
            ) from error


def _as_options(message: str, options: Mapping[str, str]) -> str:
    """Call arguments of the library what the line calls them: ``missing='skip'`` is ``--missing skip`` there."""

    def called(found: re.Match) -> str:
        name, value = found.groups()
        return " ".join(filter(None, (options[name], value))) if name in options else found[0]

    return _ARGUMENT.sub(called, message)
