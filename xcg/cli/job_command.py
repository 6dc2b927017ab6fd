"""``xcg run``."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from xcg.cli.options import NAMES, ON_ERROR, passed
from xcg.cli.stopping import last_words
from xcg.cli.wording import plain_messages

if TYPE_CHECKING:
    from xcg.jobs.job import Job
    from xcg.steps.faults import OnError


@contextmanager
def _dashboard(jobs: int | None) -> Iterator[None]:
    """Run dask's tasks on a local cluster, and say where it can be watched."""
    from xcg.common.checks import extra

    extra("bokeh", "dashboard", "--dashboard")
    distributed = extra("distributed", "dashboard", "--dashboard")
    with distributed.Client(
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

        def show(line: str) -> None:
            if not quiet:
                click.echo(line, err=True)

        return cluster_of(job, show)
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
@NAMES
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
            of_job = job.scene.get("names")
            if isinstance(of_job, Mapping) and isinstance(names, Mapping):
                names = {**of_job, **names}
            job = replace(job, scene=job.scene | {"names": names})
        if dry_run:
            click.echo(printable(_outline(job)))
            return
        with _computer(job, jobs, dashboard=dashboard, quiet=quiet):
            steps = run_job(job, overwrite=overwrite, resume=resume, jobs=jobs)
            count = _follow(job, steps, quiet=quiet)
    if not quiet:
        click.echo(printable(f"{count} steps in {job.folder}"))
