"""What commands that open the files of a DEM code take on their line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import click

_OPTIONS = (
    click.argument("files", nargs=-1, required=True),
    click.option("--contacts", "-c", multiple=True, help="Files with contacts: a path or quoted pattern; repeatable."),
    click.option("--walls", multiple=True, help="Files with contacts of walls, where they are apart; repeatable."),
    click.option("--engine", help="The code that wrote the files; guessed by default."),
    click.option("--periodic", help="Periodic axes, such as xy."),
    click.option("--density", type=float, help="Density of the material, where files hold no mass."),
    click.option("--timestep", type=float, help="Time between steps of the simulation, where files do not tell it."),
    click.option("--frozen", type=int, multiple=True, help="Species that are held in place; repeatable."),
    click.option("--missing", type=click.Choice(["raise", "skip", "empty"]), help="Particles without contacts."),
)


def takes_files(command: Callable) -> Callable:
    """Give a command the argument ``files`` and the options of `open_scene`; as keywords, None or () if not said."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def said(options: Mapping[str, Any]) -> dict[str, Any]:
    """Keep the options that were said, as arguments of `open_scene`."""
    return {name: list(v) if isinstance(v, tuple) else v for name, v in options.items() if v not in (None, ())}
