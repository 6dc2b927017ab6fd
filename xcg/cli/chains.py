"""The command ``xcg chains``: from files to force chains, and on to files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from xcg.cli.messages import ALGORITHMS, ON_ERROR, plain_messages
from xcg.cli.scene import said, takes_files

if TYPE_CHECKING:
    import xarray as xr


def _threshold(context: click.Context, parameter: click.Parameter, value: str | None) -> float | str | None:
    if value is None or value == "mean":
        return value
    try:
        return float(value)
    except ValueError:
        raise click.BadParameter(f"{value!r} is neither 'mean' nor a stress") from None


@click.command()
@takes_files
@click.option("--alpha", default=45.0, show_default=True, help="Largest angle between stress and branch (degrees).")
@click.option("--threshold", callback=_threshold, help="Least major stress: a number (Pa), or mean.")
@click.option("--min-length", default=3, show_default=True, help="Least number of particles of a chain.")
@click.option("--algorithm", type=click.Choice(ALGORITHMS), default=ALGORITHMS[0], show_default=True)
@click.option("--raw", is_flag=True, help="Do not symmetrise the stress (as Force Chain Finder).")
@click.option("--csv", type=click.Path(path_type=Path), help="CSV of Force Chain Finder; {step} for several steps.")
@click.option("--vtp", type=click.Path(path_type=Path), help="VTK PolyData; {step} for several steps.")
@click.option("--vtkhdf", type=click.Path(path_type=Path), help="All steps as one temporal VTKHDF file.")
@click.option("--netcdf", type=click.Path(path_type=Path), help="The whole result as NetCDF.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@click.option("--on-error", type=click.Choice(ON_ERROR), default=ON_ERROR[0], show_default=True,
              help="Steps that cannot be read: stop, or leave them out.")  # fmt: skip
def chains(
    files: tuple[str, ...],
    *,
    alpha: float,
    threshold: float | str | None,
    min_length: int,
    algorithm: str,
    raw: bool,
    csv: Path | None,
    vtp: Path | None,
    vtkhdf: Path | None,
    netcdf: Path | None,
    overwrite: bool,
    on_error: str,
    **options: Any,
) -> None:
    """Find force chains in FILES and print their statistics.

    For example: xcg chains "particles.*.dump" --contacts "contacts.*.dump" --csv "chains_{step}.csv" --vtp
    "chains_{step}.vtp"
    """
    from xcg.chains.search import force_chains
    from xcg.readers.series import open_scene
    from xcg.scene.conform import conform
    from xcg.steps.label import name_skipped
    from xcg.writers.chains import targets, to_csv, to_vtkhdf, to_vtp
    from xcg.writers.files import check_target, whole_file

    with plain_messages(quiet=False):
        scene = conform(open_scene(list(files), on_error=on_error, **said(options)))
        fc = force_chains(scene, alpha, threshold, min_length, algorithm=algorithm, symmetric=not raw,
                          on_error=on_error)  # fmt: skip
        # names are looked at before anything is computed or written
        for path in filter(None, (netcdf, vtkhdf)):
            check_target(path, overwrite=overwrite)
        for path in filter(None, (csv, vtp)):
            targets(fc, path, overwrite=overwrite)
        fc = name_skipped(fc.compute())
        click.echo(statistics_table(fc))
        if netcdf:
            with whole_file(netcdf, overwrite=overwrite, room=fc.nbytes) as part:
                fc.to_netcdf(part, engine="netcdf4")
        if csv:
            to_csv(fc, csv, overwrite=overwrite)
        if vtp:
            to_vtp(fc, vtp, overwrite=overwrite)
        if vtkhdf:
            to_vtkhdf(fc, vtkhdf, overwrite=overwrite)


def statistics_table(fc: xr.Dataset) -> str:
    """Count and lengths of the chains of each step, as text."""
    names = ["chain_count", "length_mean", "length_median", "length_min", "length_max"]
    heads = "".join(f"{head:>9s}" for head in ("chains", "mean", "median", "min", "max"))
    lines = [f"{'step':>10s}{'time':>12s}{heads}"]
    for t in range(fc.sizes["time"]):
        step = fc.isel(time=t)
        values = "".join(f"{step[name].item():9.4g}" for name in names)
        lines.append(f"{step['step'].item():10d}{step['time'].item():12.5g}{values}")
    return "\n".join(lines)
