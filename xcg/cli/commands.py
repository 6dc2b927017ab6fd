"""The commands."""

import click

from xcg.cli.chains import chains
from xcg.cli.convert import convert
from xcg.cli.fields import fields
from xcg.cli.info import info
from xcg.cli.run import run


@click.group(commands=[chains, convert, fields, info, run], context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="xcg")
def group() -> None:
    """Continuum fields from granular simulations."""
