"""Options that several commands have."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import click

# what `xcg.steps.faults` takes, which is not imported for help; a test compares them
ON_ERROR = ("raise", "skip")


def _box(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> dict[str, list[float]] | None:
    if value is None:
        return None
    try:
        parts = [re.split("[=:]", part) for part in value.split(",")]
        return {a: [float(low), float(high)] for a, low, high in parts}
    except ValueError:
        raise click.BadParameter(f"{value!r} is not of the form x=0:0.1,z=0:0.2") from None


def _names(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> dict[str, Any] | list[str | None] | str | None:
    """Read names of columns from JSON, TOML's inline form, or lines of TOML."""
    import json
    import tomllib

    if value is None:
        return None

    def inline_toml(text: str) -> Any:
        return tomllib.loads(f"value = {text}")["value"]

    for read in (json.loads, inline_toml, tomllib.loads):
        with suppress(ValueError):
            names = read(value)
            if names and isinstance(names, (dict, list, str)):
                return names
    raise click.BadParameter(
        f"{value!r} is neither TOML nor JSON with names of columns: write --names "
        """'{"c_q[1]" = "charge"}' or --names '{"c_q[1]": "charge", "v_x": null}', each in single quotes"""
    )


# of `run` as well, whose other options of files stand in the job
NAMES = click.option(
    "--names",
    callback=_names,
    help="Variables by columns, as TOML or JSON: '{c_q = \"charge\"}'; null drops a column.",
)
_OPTIONS = (
    click.argument("files", nargs=-1, required=True),
    click.option(
        "--contacts",
        "-c",
        multiple=True,
        help="Files with contacts: a path or quoted pattern; repeatable.",
    ),
    click.option(
        "--walls",
        multiple=True,
        help="Files with contacts of walls, where they are apart; repeatable.",
    ),
    click.option("--engine", help="The code that wrote the files; guessed by default."),
    click.option("--periodic", help="Periodic axes, such as xy."),
    click.option("--box", callback=_box, help="Edges in the files' unit, such as x=0:0.1,z=0:0.2."),
    click.option(
        "--units", type=click.Choice(["SI", "reduced"]), help="Units of files that name none."
    ),
    click.option(
        "--allow-unknown", is_flag=True, default=None, help="Take unknown partners as walls."
    ),
    click.option(
        "--density", type=float, help="Density of the material, where files hold no mass."
    ),
    click.option(
        "--timestep",
        type=float,
        help="Time between steps of the simulation, where files do not tell it.",
    ),
    click.option(
        "--frozen", type=int, multiple=True, help="Species that are fixed in place; repeatable."
    ),
    click.option(
        "--missing", type=click.Choice(["raise", "skip", "empty"]), help="Steps without contacts."
    ),
    NAMES,
)


def takes_files(command: Callable) -> Callable:
    """Add the argument ``files`` and the options of `open_scene` to a command; None or () where they are not given."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def passed(options: Mapping[str, Any]) -> dict[str, Any]:
    """Keep the options that were passed, as arguments of functions."""
    arguments = {name: value for name, value in options.items() if value not in (None, ())}
    for name, value in arguments.items():
        if isinstance(value, tuple):
            arguments[name] = list(value)
    return arguments
