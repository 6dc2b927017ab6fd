"""The commands."""

import click

from xcg_start.chains import chains
from xcg_start.convert import convert
from xcg_start.fields import fields
from xcg_start.info import info
from xcg_start.run import run


@click.group(commands=[chains, convert, fields, info, run], context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="xcg")
def group() -> None:
    """Continuum fields from granular simulations."""
