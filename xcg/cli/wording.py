"""Warnings and errors of the library, in the words of the command line."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import click

# matches missing='skip', overwrite=True, contacts=; not quoted input such as alpha=100.0 or
# on_error='x':
_ARGUMENT = re.compile(r"\b(\w+)=(?:'(\w+)'(?!:)|True\b|(?=[\s?:;,.)]|$))")

# what messages say of calls in Python, and what helps here instead
_FOR_PYTHON = {
    r" to xcg\.open_scene( or xcg\.scene_from_arrays| \([^)]*\), or call ds\.cg\S+ first)": "",
    r"xcg\.FIELDS and by ds\.data_vars": "'xcg fields', variables of the scene by 'xcg info'",
    r"xcg\.FIELDS": "'xcg fields'",
    r"(errors|for_averages)=True": r"\1 = true",
    r"errors of time_average": "errors of xcg.time_average in Python",
}


@contextmanager
def plain_messages(quiet: bool) -> Iterator[None]:
    """Show warnings as one line each, and errors of data without a traceback."""
    from xcg.common.messages import SceneWarning, printable

    taken = click.get_current_context().command.params  # here, as threads that warn have no context
    options = {str(p.name): max(p.opts, key=len) for p in taken if isinstance(p, click.Option)}

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if quiet:
            return
        if sys.stderr.isatty():
            click.echo("\r\x1b[K", err=True, nl=False)  # over the bar, which is drawn again
        click.echo(f"warning: {printable(_as_options(str(message), options))}", err=True)

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

    def called(argument: re.Match) -> str:
        name, value = argument.groups()
        if name not in options:
            return argument[0]
        return " ".join(filter(None, (options[name], value)))

    for in_python, here in _FOR_PYTHON.items():
        message = re.sub(in_python, here, message)
    return _ARGUMENT.sub(called, message)
