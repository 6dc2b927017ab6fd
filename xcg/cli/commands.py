"""The command ``xcg``: run a job, look into files, list fields, find force chains.

Exit codes: 0 done, 1 the job or its data are at fault (the message says what), 2 the command line is, 130 stopped by
Ctrl-C.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from typing import Any

import click

import xcg
from xcg.cli.chains import chains_command
from xcg.cli.convert import convert_command
from xcg.cli.messages import plain_messages
from xcg.fields.formulas import registry
from xcg.scene.schema import printable, units_of
from xcg.steps.errors import ON_ERROR
from xcg.writers.files import abandon

INTERRUPTED = 130


# What a command that is stopped has to say.
_last_words: list[Callable[[], str]] = []


def _stop(*_: object) -> None:
    """End the process at once.

    An exception would unwind through libraries that do not expect it (a lock of xarray's, taken and not noted, then
    stops the run for ever), and threads that compute a step would be waited for. All files can stand an end like this.
    """
    abandon()
    said = "".join(f"\n{words()}" for words in _last_words)
    with suppress(OSError, RuntimeError):  # interrupted while it prints
        sys.stderr.write(f"\nstopped{said}\n")
        sys.stderr.flush()
    os._exit(INTERRUPTED)


class _Group(click.Group):
    """A group of commands that ends at once, and without a traceback, when it is interrupted."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run as the program, as opposed to within another one."""
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, _stop)
        try:
            return self.main(*args, **kwargs)
        except SystemExit as end:
            if (
                isinstance(end.code, int) and end.code
            ):  # threads would be waited for, a file of a full disk closed again
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(end.code)
            raise


@contextmanager
def _dashboard(jobs: int | None) -> Iterator[None]:
    """Run dask's tasks on a local cluster, and say where it can be watched."""
    try:
        import bokeh  # noqa: F401
        from distributed import Client
    except ImportError as error:
        msg = f"--dashboard needs {error.name}, which is not installed; pip install distributed bokeh"
        raise click.ClickException(msg) from None
    with Client(
        processes=False, n_workers=1, threads_per_worker=jobs or os.cpu_count(), dashboard_address=":0"
    ) as client:
        click.echo(f"dashboard: {client.dashboard_link}", err=True)
        yield


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(xcg.__version__, prog_name="xcg")
def main() -> None:
    """Continuum fields from granular simulations."""


@main.command()
@click.argument("config", type=click.Path(exists=True, dir_okay=False))
@click.option("--quiet", "-q", is_flag=True, help="No progress bar, no warnings.")
@click.option("--overwrite", is_flag=True, help="Replace output that is there.")
@click.option("--resume", is_flag=True, help="Go on with a run of this very job, or find it done; never start over.")
@click.option("--on-error", type=click.Choice(ON_ERROR), help="Steps that cannot be read: stop, or leave them out.")
@click.option("--dashboard", is_flag=True, help="Watch dask at work in a browser (needs distributed and bokeh).")
@click.option("--jobs", "-j", type=click.IntRange(1), help="Chunks of time at once; all processors by default.")
@click.option("--dry-run", is_flag=True, help="Say what would be done.")
def run(
    config: str,
    quiet: bool,
    overwrite: bool,
    resume: bool,
    on_error: str | None,
    dashboard: bool,
    jobs: int | None,
    dry_run: bool,
) -> None:
    """Run a job: Pysammos's config.ini as it stands, or TOML.

    An interrupted run goes on where it was.
    """
    from xcg.cli.config import read_config
    from xcg.cli.run import open_job, run_job
    from xcg.steps.progress import Progress

    with plain_messages(quiet):
        job = read_config(config)
        if on_error is not None:
            job = replace(job, on_error=on_error)
        if dry_run:
            scene, fields, _ = open_job(job)
            names = ", ".join(map(str, fields.data_vars))
            click.echo(printable(f"{scene.cg!r}\n{names}\ninto {job.folder}/{job.name}*"))
            return
        with _dashboard(jobs) if dashboard else nullcontext():
            steps = run_job(job, overwrite=overwrite, resume=resume, jobs=jobs)
            done, count = next(steps)
            if done and not quiet:
                click.echo(f"{done} of {count} steps are there from an earlier run", err=True)
            bar = Progress(count, done, sys.stderr, quiet=quiet)

            def kept() -> str:
                return f"{done} of {count} steps are kept; the same command goes on from there"

            _last_words.append(kept)
            try:
                for done, _ in steps:
                    bar.update(done)
            except OSError as error:
                msg = f"{error}\n{kept()}"
                raise click.ClickException(msg) from error
            finally:
                _last_words.remove(kept)
                bar.end()
    if not quiet:
        click.echo(printable(f"{count} steps in {job.folder}"))


@main.command()
@click.argument("files", nargs=-1, required=True)
@click.option("--contacts", "-c", multiple=True, help="Files with contacts.")
@click.option("--engine", help="What wrote the files; guessed by default.")
@click.option("--periodic", help="Periodic axes, such as xy.")
@click.option("--density", type=float, help="Density of the material, where files hold no mass.")
def info(files: tuple[str, ...], contacts: tuple[str, ...], **options: object) -> None:
    """Tell what files of a DEM code hold, and what is missing."""
    given = {name: value for name, value in options.items() if value is not None}
    if contacts:
        given["contacts"] = list(contacts)
    with plain_messages(quiet=False):
        ds = xcg.open_scene(list(files), **given)  # type: ignore[arg-type]
        click.echo(repr(ds.cg))


@main.command()
@click.option("--pysammos", is_flag=True, help="The names of the preset 'pysammos'.")
def fields(pysammos: bool) -> None:
    """List all fields, with their units and formulas."""
    if pysammos:
        from xcg.fields.presets.pysammos import rows

        table = [(name, "", row.field.formula) for name, row in rows("xy", "xyz").items()]
    else:
        table = [(name, units_of(registry.FIELDS[name].powers), registry.FIELDS[name].formula)
                 for name in registry.listed()]  # fmt: skip
    wide = max(len(name) for name, _, _ in table)
    for name, unit, formula in table:
        click.echo(f"{name:{wide}}  {unit:12}  {formula}")


main.add_command(chains_command)
main.add_command(convert_command)


if __name__ == "__main__":
    main()
