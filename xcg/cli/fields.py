"""The command ``xcg fields``: a list of all fields."""

from __future__ import annotations

import click


@click.command()
@click.option("--pysammos", is_flag=True, help="The names of the preset 'pysammos'.")
def fields(pysammos: bool) -> None:
    """List all fields, with their units and formulas."""
    from xcg.fields.formulas import registry
    from xcg.fields.presets.pysammos import rows

    if pysammos:
        table = [(name, "", row.field.formula) for name, row in rows("xy", "xyz").items()]
    else:
        table = [(name, registry.FIELDS[name].units, registry.FIELDS[name].formula)
                 for name in registry.listed()]  # fmt: skip
    wide = max(len(name) for name, _, _ in table)
    for name, unit, formula in table:
        click.echo(f"{name:{wide}}  {unit:12}  {formula}")
