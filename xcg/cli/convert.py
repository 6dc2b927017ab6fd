"""The command ``xcg convert``: from the files of a DEM code to a scene in NetCDF or Zarr."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from xcg.cli.messages import plain_messages
from xcg.cli.scene import said, takes_files


@click.command()
@takes_files
@click.option("--output", "-o", required=True, type=click.Path(path_type=Path), help="scene.nc or scene.zarr.")
@click.option("--chunks", type=int, help="Steps in a chunk on disk; one by default.")
@click.option("--dtype", type=click.Choice(["float32", "float64"]), help="Type of numbers on disk.")
@click.option("--digits", type=click.IntRange(1, 15), help="Significant digits to keep; all by default.")
@click.option("--compression", type=click.IntRange(0, 9), help="Level of compression, 0 for none; 1 by default.")
@click.option("--overwrite", is_flag=True, help="Replace output that is there.")
@click.option("--quiet", "-q", is_flag=True, help="No progress bar.")
def convert(
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
    from xcg.jobs.config import read_config
    from xcg.readers.series import open_scene
    from xcg.scene.conform import conform
    from xcg.writers.save import save

    with plain_messages(quiet=False):
        is_job = len(files) == 1 and Path(files[0]).suffix.lower() in (".toml", ".ini")
        scene = read_config(files[0]).scene if is_job else {"particles": list(files)}
        ds = conform(open_scene(**scene | said(options)))  # a step that was saved alone gets its time
        save(
            ds, output, overwrite=overwrite, dtype=dtype, digits=digits, compression=compression, progress=not quiet
        )  # fmt: skip
    click.echo(f"{ds.sizes['time']} steps in {output}; open it with xcg.open_scene({str(output)!r})")
