"""The command line.

Functions import what a command does when it is done, so that help comes soon.

Exit codes: 0 done, 1 the job or its data are at fault (`click.ClickException`), 2 the command line
is (`click.BadParameter`), 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

if TYPE_CHECKING:
    import xarray as xr

    from xcg.analysis.force_chains import Algorithm
    from xcg.jobs.job import Job
    from xcg.steps.faults import OnError


# What a command that is stopped has to say.
last_words: list[Callable[[], str]] = []


def stop(*_: object) -> None:
    """End the process at once.

    An exception would unwind through libraries that do not expect it (a lock of xarray's, taken and
    not noted, then stops the run for ever), and threads that compute a step would be waited for.
    All files can stand an end like this.
    """
    # while it is not loaded nothing is begun
    abandon = getattr(sys.modules.get("xcg.writers.files"), "abandon", None)
    if abandon is not None:
        abandon()
    words = "".join(f"\n{last()}" for last in last_words)
    try:
        sys.stderr.write(f"\nstopped{words}\n")
        sys.stderr.flush()
    except (OSError, RuntimeError):  # interrupted while it prints
        pass
    os._exit(128 + signal.SIGINT)


# what xcg.steps.faults and xcg.analysis.force_chains take, which are not imported for help; a test compares
# them
ON_ERROR = ("raise", "skip")
ALGORITHMS = ("branching", "peters2005")
# matches missing='skip', overwrite=True, contacts=; not quoted input such as alpha=100.0 or
# on_error='x':
_ARGUMENT = re.compile(r"\b(\w+)=(?:'(\w+)'(?!:)|True\b|(?=[\s?:;,.)]|$))")

# what messages say of calls in Python, and what helps here instead
_FOR_PYTHON = {
    r" to xcg\.open_scene( or xcg\.scene_from_arrays| \([^)]*\), or call ds\.cg\S+ first)": "",
    r"xcg\.FIELDS and by ds\.data_vars": "'xcg fields', variables of the scene by 'xcg info'",
    r"xcg\.FIELDS": "'xcg fields'",
    r"(errors|for_averages)=True": r"\1 = true",
    r"errors of time_average": "errors of xcg.time_average in Python",
}


@contextmanager
def plain_messages(quiet: bool) -> Iterator[None]:
    """Show warnings as one line each, and errors of data without a traceback."""
    from xcg.common.messages import SceneWarning, printable

    taken = click.get_current_context().command.params  # here, as threads that warn have no context
    options = {str(p.name): max(p.opts, key=len) for p in taken if isinstance(p, click.Option)}

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if quiet:
            return
        if sys.stderr.isatty():
            click.echo("\r\x1b[K", err=True, nl=False)  # over the bar, which is drawn again
        click.echo(f"warning: {printable(_as_options(str(message), options))}", err=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", SceneWarning)
        warnings.showwarning = show
        try:
            yield
        except (ValueError, OSError, ImportError) as error:
            raise click.ClickException(printable(_as_options(str(error), options))) from error
        except MemoryError as error:
            raise click.ClickException(
                f"not enough memory ({error}); take fewer steps at a time (--jobs 1), fewer fields, or a larger spacing"
            ) from error


def _as_options(message: str, options: Mapping[str, str]) -> str:
    """Call arguments of the library what the line calls them: ``missing='skip'`` is ``--missing skip`` there."""

    def called(argument: re.Match) -> str:
        name, value = argument.groups()
        if name not in options:
            return argument[0]
        return " ".join(filter(None, (options[name], value)))

    for in_python, here in _FOR_PYTHON.items():
        message = re.sub(in_python, here, message)
    return _ARGUMENT.sub(called, message)


def _box(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> dict[str, list[float]] | None:
    if value is None:
        return None
    try:
        parts = [re.split("[=:]", part) for part in value.split(",")]
        return {a: [float(low), float(high)] for a, low, high in parts}
    except ValueError:
        raise click.BadParameter(f"{value!r} is not of the form x=0:0.1,z=0:0.2") from None


def _names(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> dict[str, Any] | list[str | None] | str | None:
    """Read names of columns from text in JSON or TOML."""
    if value is None:
        return None
    names = None
    with suppress(ValueError):
        names = _from_text(value)
    if not names or not isinstance(names, (dict, list, str)):
        raise click.BadParameter(
            f"{value!r} is neither TOML nor JSON with names of columns: write --names "
            """'{"c_q[1]" = "charge"}' or --names '{"c_q[1]": "charge", "v_x": null}', each in single quotes"""
        )
    return names


def _from_text(text: str) -> Any:
    """Return the value of JSON, of TOML's inline form, or of lines of TOML; ValueError for other text."""
    import json
    import tomllib

    with suppress(ValueError):
        return json.loads(text)
    with suppress(ValueError):
        return tomllib.loads(f"value = {text}")["value"]
    return tomllib.loads(text)


# of `run` as well, whose other options of files stand in the job
_NAMES = click.option(
    "--names",
    callback=_names,
    help="Variables by columns, as TOML or JSON: '{c_q = \"charge\"}'; null drops a column.",
)
_OPTIONS = (
    click.argument("files", nargs=-1, required=True),
    click.option(
        "--contacts",
        "-c",
        multiple=True,
        help="Files with contacts: a path or quoted pattern; repeatable.",
    ),
    click.option(
        "--walls",
        multiple=True,
        help="Files with contacts of walls, where they are apart; repeatable.",
    ),
    click.option("--engine", help="The code that wrote the files; guessed by default."),
    click.option("--periodic", help="Periodic axes, such as xy."),
    click.option("--box", callback=_box, help="Edges in the files' unit, such as x=0:0.1,z=0:0.2."),
    click.option(
        "--units", type=click.Choice(["SI", "reduced"]), help="Units of files that name none."
    ),
    click.option(
        "--allow-unknown", is_flag=True, default=None, help="Take unknown partners as walls."
    ),
    click.option(
        "--density", type=float, help="Density of the material, where files hold no mass."
    ),
    click.option(
        "--timestep",
        type=float,
        help="Time between steps of the simulation, where files do not tell it.",
    ),
    click.option(
        "--frozen", type=int, multiple=True, help="Species that are fixed in place; repeatable."
    ),
    click.option(
        "--missing", type=click.Choice(["raise", "skip", "empty"]), help="Steps without contacts."
    ),
    _NAMES,
)


def takes_files(command: Callable) -> Callable:
    """Add the argument ``files`` and the options of `open_scene` to a command; None or () where they are not given."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def passed(options: Mapping[str, Any]) -> dict[str, Any]:
    """Keep the options that were passed, as arguments of functions."""
    arguments = {name: value for name, value in options.items() if value not in (None, ())}
    for name, value in arguments.items():
        if isinstance(value, tuple):
            arguments[name] = list(value)
    return arguments


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


def _no_raw(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value:
        raise click.BadParameter(
            "chains follow the principal stresses of the symmetric part; leave it out"
        )


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
@click.option("--raw", is_flag=True, hidden=True, expose_value=False, callback=_no_raw)
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


@contextmanager
def _dashboard(jobs: int | None) -> Iterator[None]:
    """Run dask's tasks on a local cluster, and say where it can be watched."""
    from xcg.common.checks import extra

    extra("bokeh", "dashboard", "--dashboard")
    with extra("distributed", "dashboard", "--dashboard").Client(
        processes=False,
        n_workers=1,
        threads_per_worker=jobs or os.cpu_count(),
        dashboard_address=":0",
    ) as client:
        click.echo(f"dashboard: {client.dashboard_link}", err=True)
        yield


def _computer(
    job: Job, jobs: int | None, *, dashboard: bool, quiet: bool
) -> AbstractContextManager[None]:
    """Return the context in which a job computes: on its cluster, under a dashboard, or neither."""
    from xcg.jobs.cluster import cluster_of

    if job.scheduler:
        if jobs:
            raise click.UsageError(
                "--jobs is for this machine; a cluster takes as many chunks as it has threads"
            )

        def tell(line: str) -> None:
            if not quiet:
                click.echo(line, err=True)

        return cluster_of(job, tell)
    if dashboard:
        return _dashboard(jobs)
    return nullcontext()


def _outline(job: Job) -> str:
    """Return the scene of a job, its fields and outputs as text; nothing is computed."""
    from xcg.jobs.run import open_job, outputs_of

    scene, fields, slices = open_job(job)
    outputs = outputs_of(job, fields, slices)
    names = ", ".join(str(name) for of_job in outputs for name in of_job.output.ds.data_vars)
    lines = [repr(scene.cg), names, f"into {job.folder}/{job.name}*"]
    existing = [path for of_job in outputs for path in of_job.paths if path.exists()]
    if existing:
        lines.append(f"{existing[0]} exists; --overwrite replaces it")
    return "\n".join(lines)


def _follow(job: Job, steps: Iterator[tuple[int, int]], *, quiet: bool) -> int:
    """Run a job with a progress bar, and return its number of steps; errors and stops name the steps that are kept."""
    from xcg.jobs.run import work_of
    from xcg.steps.mapping import shown

    done = 0
    count = 0

    def kept() -> str:
        if done and done == count and not work_of(job).exists():
            return f"{count} steps in {job.folder}"
        noun = "step" if done == 1 else "steps"
        return f"{done} {noun} kept; the same command continues from there"

    try:
        done, count = next(steps)
        if done and not quiet:
            click.echo(f"{done} of {count} steps are there from an earlier run", err=True)
        last_words.append(kept)
        with shown(count, not quiet, done=done) as bar:
            for done, _ in steps:
                bar.update(done - bar.n)
    except (FileExistsError, FileNotFoundError):
        raise
    except OSError as error:
        if error.errno is not None:
            raise
        raise click.ClickException(f"{error}\n{kept()}") from error
    finally:
        last_words.clear()
    return count


def _added(of_job: Any, names: Any) -> Any:
    """Return the names of a job and further ones, where both are mappings; else the further ones."""
    if isinstance(of_job, Mapping) and isinstance(names, Mapping):
        return {**of_job, **names}
    return names


@click.command()
@click.argument("config", type=click.Path(exists=True, dir_okay=False))
@click.option("--quiet", "-q", is_flag=True, help="No progress bar, no warnings.")
@click.option("--overwrite", is_flag=True, help="Replace output that is there.")
@click.option("--resume", is_flag=True, help="Resume this job's interrupted run; never start over.")
@click.option(
    "--on-error",
    type=click.Choice(ON_ERROR),
    help="Steps that cannot be read: stop, or leave them out.",
)
@click.option(
    "--dashboard",
    is_flag=True,
    help="Watch dask at work in a browser (needs distributed and bokeh).",
)
@click.option(
    "--jobs",
    "-j",
    type=click.IntRange(1),
    help="Chunks of time at once; all processors by default.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Compute on the running dask cluster of this scheduler (needs distributed).",
)
@click.option("--dry-run", is_flag=True, help="Say what would be done.")
@_NAMES
def run(
    config: str,
    quiet: bool,
    overwrite: bool,
    resume: bool,
    on_error: OnError | None,
    dashboard: bool,
    jobs: int | None,
    scheduler: str | None,
    dry_run: bool,
    names: dict[str, Any] | list[str | None] | str | None,
) -> None:
    """Run a job: Pysammos's config.ini as it stands, or TOML.

    An interrupted run goes on where it was.
    """
    from xcg.common.messages import printable
    from xcg.jobs.config import read_config
    from xcg.jobs.run import run_job

    if resume and overwrite:
        raise click.UsageError(
            "--resume goes on with a run, and --overwrite starts anew: pass one of them"
        )
    with plain_messages(quiet):
        # absolute, as workers and later runs may have another current folder
        job = read_config(Path(config).absolute())
        job = replace(job, **passed({"on_error": on_error, "scheduler": scheduler}))
        if names is not None:
            job = replace(job, scene=job.scene | {"names": _added(job.scene.get("names"), names)})
        if dry_run:
            click.echo(printable(_outline(job)))
            return
        with _computer(job, jobs, dashboard=dashboard, quiet=quiet):
            steps = run_job(job, overwrite=overwrite, resume=resume, jobs=jobs)
            count = _follow(job, steps, quiet=quiet)
    if not quiet:
        click.echo(printable(f"{count} steps in {job.folder}"))


@click.group(
    commands=[chains, convert, explore, fields, info, run],
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="xcg")
def group() -> None:
    """Continuum fields from granular simulations."""


def main() -> None:
    """Run the command; it ends at once, and without a traceback, when it is interrupted."""
    signal.signal(signal.SIGINT, stop)
    try:
        group(prog_name="xcg")
    except SystemExit as end:
        # threads would be waited for, a file of a full disk closed again
        if isinstance(end.code, int) and end.code:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code)
        gc.freeze()  # else Python looks through all objects of all libraries before it ends, for half a second
        raise


if __name__ == "__main__":
    main()
