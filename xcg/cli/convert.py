"""The command ``xcg convert``: from the files of a DEM code to a scene in NetCDF or Zarr."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from xcg.cli.config import read_config
from xcg.cli.messages import plain_messages
from xcg.readers.series import open_scene
from xcg.writers.save import save


def _scene_options(files: tuple[str, ...], options: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `open_scene`: those of a job where one is given, and over them those of the command line."""
    given = {name: list(v) if isinstance(v, tuple) else v for name, v in options.items() if v not in (None, ())}
    if len(files) == 1 and Path(files[0]).suffix.lower() in (".toml", ".ini"):
        return read_config(files[0]).scene | given
    return {"particles": list(files)} | given


@click.command("convert")
@click.argument("files", nargs=-1, required=True)
@click.option("--output", "-o", required=True, type=click.Path(path_type=Path), help="scene.nc or scene.zarr.")
@click.option("--contacts", "-c", multiple=True, help="Files with contacts: a path or a quoted pattern; repeatable.")
@click.option("--walls", multiple=True, help="Files of contacts with walls, where they are apart.")
@click.option("--engine", help="The code that wrote the files; guessed by default.")
@click.option("--periodic", help="Periodic axes, such as xy.")
@click.option("--density", type=float, help="Density of the material, where files hold no mass.")
@click.option("--timestep", type=float, help="Time between two steps of the simulation, where files do not tell it.")
@click.option("--frozen", type=int, multiple=True, help="Species that are held in place; repeatable.")
@click.option("--missing", type=click.Choice(["raise", "skip", "empty"]), help="Steps of particles without contacts.")
@click.option("--chunks", type=int, help="Steps in a chunk on disk; one by default.")
@click.option("--dtype", type=click.Choice(["float32", "float64"]), help="Type of numbers on disk.")
@click.option("--digits", type=click.IntRange(1, 15), help="Significant digits to keep; all by default.")
@click.option("--compression", type=click.IntRange(0, 9), help="Level of compression, 0 for none; 1 by default.")
@click.option("--overwrite", is_flag=True, help="Replace output that is there.")
@click.option("--quiet", "-q", is_flag=True, help="No progress bar.")
def convert_command(
    files: tuple[str, ...],
    output: Path,
    *,
    dtype: str | None,
    digits: int | None,
    compression: int | None,
    overwrite: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Convert FILES of a DEM code to NetCDF or Zarr, which open at once.

    FILES are those with particles, or one job (TOML or Pysammos's config.ini) whose scene is meant. For example:
    xcg convert "particles.*.dump" -c "contacts.*.dump" -o scene.zarr
    """
    with plain_messages(quiet=False):
        ds = open_scene(**_scene_options(files, options))
        save(
            ds, output, overwrite=overwrite, dtype=dtype, digits=digits, compression=compression, progress=not quiet
        )  # fmt: skip
    reader = "open_zarr" if output.suffix == ".zarr" else "open_dataset"
    click.echo(f"{ds.sizes['time']} steps in {output}; open it with xarray.{reader}({str(output)!r})")
