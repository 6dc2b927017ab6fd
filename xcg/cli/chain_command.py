"""``xcg chains``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from xcg.cli.options import ON_ERROR, passed, takes_files
from xcg.cli.wording import plain_messages

if TYPE_CHECKING:
    import xarray as xr

    from xcg.analysis.force_chains import Algorithm
    from xcg.steps.faults import OnError

# what `xcg.analysis.force_chains` takes, which is not imported for help; a test compares them
ALGORITHMS = ("branching", "peters2005")


def _stress(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> float | Literal["mean"] | None:
    if value is None:
        return None
    if value == "mean":
        return "mean"
    try:
        return float(value)
    except ValueError:
        raise click.BadParameter(f"{value!r} is neither 'mean' nor a stress") from None


@click.command()
@takes_files
@click.option(
    "--alpha",
    default=45.0,
    show_default=True,
    help="Largest angle between stress and branch (degrees).",
)
@click.option("--min-stress", callback=_stress, help="Least major stress: a number (Pa), or mean.")
@click.option(
    "--min-length", default=3, show_default=True, help="Least number of particles of a chain."
)
@click.option(
    "--algorithm", type=click.Choice(ALGORITHMS), default=ALGORITHMS[0], show_default=True
)
@click.option(
    "--csv",
    type=click.Path(path_type=Path),
    help="CSV of Force Chain Finder; {step} for several steps.",
)
@click.option(
    "--vtp", type=click.Path(path_type=Path), help="VTK PolyData; {step} for several steps."
)
@click.option(
    "--vtkhdf", type=click.Path(path_type=Path), help="All steps as one temporal VTKHDF file."
)
@click.option("--netcdf", type=click.Path(path_type=Path), help="The whole result as NetCDF.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@click.option(
    "--on-error",
    type=click.Choice(ON_ERROR),
    default=ON_ERROR[0],
    show_default=True,
    help="Steps that cannot be read: stop, or leave them out.",
)
def chains(
    files: tuple[str, ...],
    *,
    alpha: float,
    min_stress: float | Literal["mean"] | None,
    min_length: int,
    algorithm: Algorithm,
    csv: Path | None,
    vtp: Path | None,
    vtkhdf: Path | None,
    netcdf: Path | None,
    overwrite: bool,
    on_error: OnError,
    **options: Any,
) -> None:
    """Find force chains in FILES and print their statistics.

    For example: xcg chains "particles.*.dump" --contacts "contacts.*.dump" --csv
    "chains_{step}.csv" --vtp "chains_{step}.vtp"
    """
    from xcg.analysis.force_chains import force_chains
    from xcg.readers.open import open_scene
    from xcg.scene.conform import conform
    from xcg.steps.labels import name_skipped
    from xcg.writers.chains import targets, to_csv, to_vtkhdf, to_vtp
    from xcg.writers.encoding import Encoding
    from xcg.writers.files import check_target
    from xcg.writers.formats import NETCDF
    from xcg.writers.store import write_file

    with plain_messages(quiet=False):
        scene = conform(open_scene(list(files), on_error=on_error, **passed(options)))
        fc = force_chains(
            scene,
            alpha,
            min_stress,
            min_length,
            algorithm=algorithm,
            on_error=on_error,
        )
        # names are looked at before anything is computed or written
        for path in filter(None, (netcdf, vtkhdf)):
            check_target(path, overwrite=overwrite)
        for path in filter(None, (csv, vtp)):
            targets(fc, path, overwrite=overwrite)
        fc = name_skipped(fc.compute())
        click.echo(statistics_table(fc))
        if netcdf:
            write_file(fc, netcdf, Encoding.of(fc), NETCDF, overwrite=overwrite)
        for file, write in ((csv, to_csv), (vtp, to_vtp), (vtkhdf, to_vtkhdf)):
            if file:
                write(fc, file, overwrite=overwrite)


def statistics_table(fc: xr.Dataset) -> str:
    """Count and lengths of the chains of each step, as text."""
    names = ["chain_count", "length_mean", "length_median", "length_min", "length_max"]
    heads = "".join(f"{head:>9s}" for head in ("chains", "mean", "median", "min", "max"))
    lines = [f"{'step':>10s}{'time':>12s}{heads}"]
    for t in range(fc.sizes["time"]):
        step = fc.isel(time=t)
        values = "".join(f"{step[name].item():9.4g}" for name in names)
        if "skipped" in step.coords and step["skipped"].item():
            values = f"{'skipped':>9s}"
        lines.append(f"{step['step'].item():10d}{step['time'].item():12.5g}{values}")
    return "\n".join(lines)
