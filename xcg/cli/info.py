"""The command ``xcg info``: what files hold."""

from __future__ import annotations

from typing import Any

import click

from xcg.cli.messages import plain_messages
from xcg.cli.scene import said, takes_files


@click.command()
@takes_files
def info(files: tuple[str, ...], **options: Any) -> None:
    """Tell what FILES of a DEM code hold, and what is missing.

    For example: xcg info "particles.*.dump" -c "contacts.*.dump"
    """
    from xcg.readers.series import open_scene

    with plain_messages(quiet=False):
        click.echo(repr(open_scene(list(files), **said(options)).cg))
