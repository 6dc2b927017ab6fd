"""The command ``xcg run``: a job from files to files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace

import click

from xcg.cli.messages import ON_ERROR, plain_messages
from xcg_start import last_words


@contextmanager
def _dashboard(jobs: int | None) -> Iterator[None]:
    """Run dask's tasks on a local cluster, and say where it can be watched."""
    try:
        import bokeh  # noqa: F401
        from distributed import Client
    except ImportError as error:
        raise click.ClickException(
            f"--dashboard needs {error.name}, which is not installed; pip install distributed bokeh"
        ) from None
    with Client(
        processes=False, n_workers=1, threads_per_worker=jobs or os.cpu_count(), dashboard_address=":0"
    ) as client:
        click.echo(f"dashboard: {client.dashboard_link}", err=True)
        yield


@click.command()
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
    from xcg.jobs.config import read_config
    from xcg.jobs.run import open_job, run_job
    from xcg.scene.schema import printable
    from xcg.steps.progress import shown

    with plain_messages(quiet):
        job = read_config(config)
        if on_error is not None:
            job = replace(job, on_error=on_error)
        if dry_run:
            scene, *results = open_job(job)
            names = ", ".join(str(name) for result in results if result is not None for name in result.data_vars)
            click.echo(printable(f"{scene.cg!r}\n{names}\ninto {job.folder}/{job.name}*"))
            return
        with _dashboard(jobs) if dashboard else nullcontext():
            steps = run_job(job, overwrite=overwrite, resume=resume, jobs=jobs)
            done = 0

            def kept() -> str:
                return f"{done} steps are kept; the same command goes on from there"

            try:
                done, count = next(steps)
                if done and not quiet:
                    click.echo(f"{done} of {count} steps are there from an earlier run", err=True)
                last_words.append(kept)
                with shown(count, not quiet, done=done) as bar:
                    for done, _ in steps:
                        bar.update(done - bar.n)
            except OSError as error:
                if error.errno is not None:  # not of a full disk
                    raise
                raise click.ClickException(f"{error}\n{kept()}") from error
            finally:
                last_words.clear()
    if not quiet:
        click.echo(printable(f"{count} steps in {job.folder}"))
