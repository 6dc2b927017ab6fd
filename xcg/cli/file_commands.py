"""``xcg convert``, ``xcg info`` and ``xcg explore`` of files, and ``xcg fields``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from xcg.cli.options import passed, takes_files
from xcg.cli.wording import plain_messages


@click.command()
@takes_files
@click.option(
    "--output", "-o", required=True, type=click.Path(path_type=Path), help="scene.nc or scene.zarr."
)
@click.option("--chunks", type=int, help="Steps in a chunk on disk; one by default.")
@click.option("--dtype", type=click.Choice(["float32", "float64"]), help="Type of numbers on disk.")
@click.option(
    "--digits", type=click.IntRange(1, 15), help="Significant digits to keep; all by default."
)
@click.option(
    "--compression",
    type=click.IntRange(0, 9),
    help="Level of compression, 0 for none; 1 by default.",
)
@click.option("--overwrite", is_flag=True, help="Replace output that is there.")
@click.option("--quiet", "-q", is_flag=True, help="No progress bar, no warnings.")
def convert(
    files: tuple[str, ...],
    output: Path,
    *,
    overwrite: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Convert FILES of a DEM code to NetCDF or Zarr, which open at once.

    FILES are those with particles, or one job (TOML or Pysammos's config.ini) whose scene is meant.
    For example: xcg convert "particles.*.dump" -c "contacts.*.dump" -o scene.zarr
    """
    from xcg.jobs.config import read_config
    from xcg.readers.open import open_scene
    from xcg.scene.conform import conform
    from xcg.writers.save import save

    with plain_messages(quiet):
        scene: dict[str, Any] = {"particles": list(files)}
        if len(files) == 1 and Path(files[0]).suffix.lower() in (".toml", ".ini"):
            scene = read_config(files[0]).scene
        encoding = {name: options.pop(name) for name in ("dtype", "digits", "compression")}
        # a step that was saved alone gets its time
        ds = conform(open_scene(**scene | passed(options)))
        save(ds, output, overwrite=overwrite, progress=not quiet, **encoding)
    click.echo(
        f"{ds.sizes['time']} steps in {output}; open it with xcg.open_scene({str(output)!r})"
    )


@click.command()
@click.option("--pysammos", is_flag=True, help="The names of the preset 'pysammos'.")
def fields(pysammos: bool) -> None:
    """List all fields, with their units and formulas."""
    from xcg.fields.formulas import registry
    from xcg.fields.presets.pysammos import rows

    if pysammos:
        table = [(name, "", row.field.formula) for name, row in rows("xy", "xyz").items()]
    else:
        table = [
            (name, registry.FIELDS[name].units, registry.FIELDS[name].formula)
            for name in registry.listed()
        ]
    wide = max(len(name) for name, _, _ in table)
    for name, unit, formula in table:
        click.echo(f"{name:{wide}}  {unit:12}  {formula}")


@click.command()
@takes_files
def info(files: tuple[str, ...], **options: Any) -> None:
    """Show what FILES of a DEM code hold, and what is missing.

    For example: xcg info "particles.*.dump" -c "contacts.*.dump"
    """
    from xcg.readers.open import open_scene

    with plain_messages(quiet=False):
        click.echo(repr(open_scene(list(files), **passed(options)).cg))


@click.command()
@takes_files
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    help="Port at 127.0.0.1; a free one by default.",
)
@click.option(
    "--no-browser", is_flag=True, help="Print the address, without opening it in the browser."
)
def explore(files: tuple[str, ...], port: int, no_browser: bool, **options: Any) -> None:
    """Explore FILES in the browser: pictures of fields with sliders.

    FILES are the output of a DEM code, or one with a scene or a result that xcg saved. The page is for
    this machine alone; closing it ends the command. For example: xcg explore "particles.*.dump" -c
    "contacts.*.dump"
    """
    from xcg.explore.app import Explorer
    from xcg.explore.choices import pictures_of, written_call
    from xcg.explore.server import serve
    from xcg.readers.open import open_scene
    from xcg.readers.saved import open_result

    with plain_messages(quiet=False):
        arguments = {"particles": list(files), **passed(options)}
        opened = f"import xcg\n\nds = {written_call('xcg.open_scene', arguments)}\n"
        ds = open_result(files[0]) if len(files) == 1 else None
        if ds is None:
            ds = open_scene(**arguments)
        else:
            opened = f"import xarray as xr\nimport xcg\n\nf = xr.open_dataset({files[0]!r})\n"
        pictures = pictures_of(ds)
        serve(lambda: Explorer(pictures, opened).layout, port, show=not no_browser)
