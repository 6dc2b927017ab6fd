"""Running dask.distributed clusters, to which jobs are handed."""

from __future__ import annotations

import asyncio
import glob
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from xcg.common.checks import extra
from xcg.jobs.job import PATHS, Job

_ANSWERS_WITHIN = 5.0  # seconds


@contextmanager
def cluster_of(job: Job, show: Callable[[str], object]) -> Iterator[None]:
    """Let the cluster of a job's scheduler compute all tasks meanwhile.

    Parameters
    ----------
    job : Job
        All workers must see its input and its folder.
    show : callable
        Prints a line about the cluster: its size, its dashboard, and that workers are waited for.

    Raises
    ------
    ImportError
        If distributed is not installed.
    OSError
        If no scheduler answers, a worker does not see the files or has another version of xcg, or
        the cluster is lost while it computes.
    """
    distributed = extra("distributed", "distributed", "--scheduler")
    from distributed.client import FutureCancelledError

    address = job.scheduler
    try:
        asyncio.run(_connect(address))
    except (OSError, ValueError, TypeError, OverflowError) as error:
        raise OSError(
            f"no dask scheduler answers at {address} ({_short(error)}); start one with 'dask scheduler' and pass the "
            "address that it prints, such as tcp://10.0.0.1:8786"
        ) from error
    with distributed.Client(address, timeout=_ANSWERS_WITHIN) as client:
        show(f"dashboard: {client.dashboard_link}")
        if not client.nthreads():
            show("the cluster has no workers yet; waiting for the first")
            client.wait_for_workers(1)
        job.folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=job.folder, prefix=".xcg-") as mark:
            _check_workers(client, [mark.name, *_first_files(job)])
        threads = client.nthreads()
        show(f"{len(threads)} workers with {sum(threads.values())} threads")
        try:
            yield
        except distributed.KilledWorker as error:
            raise OSError(
                f"several workers ended while they computed the same steps ({_short(error)}); give them "
                "more memory, or fewer steps at a time (chunks = 1 in [scene]); the same command continues"
            ) from error
        except (FutureCancelledError, distributed.CommClosedError) as error:
            raise OSError(
                f"the scheduler at {address} is lost ({_short(error)}); the same command continues"
            ) from error


async def _connect(address: str) -> None:
    """Connect to a scheduler once, since a Client that fails stays half made.

    It would stay dask's default, and Python may collect it while the next Client starts, where its
    end waits for ever for the lock of that start.
    """
    from distributed import comm

    connection = await comm.connect(address, timeout=_ANSWERS_WITHIN)
    await connection.close()


def _first_files(job: Job) -> list[str]:
    """List one existing input file of each kind."""
    files = []
    for key in PATHS:
        paths = job.scene.get(key)
        if not isinstance(paths, list) or not paths:  # walls may be columns of the particles
            continue
        if os.path.exists(paths[0]):
            files.append(paths[0])
        else:
            files += glob.glob(paths[0])[:1]
    return files


def _check_workers(client: Any, paths: list[str]) -> None:
    """Raise OSError for a worker that cannot do the job as this process would."""
    answers = client.run(_answer, paths, on_error="return")
    expected = version("xcg")
    for worker, answer in sorted(answers.items()):
        if isinstance(answer, Exception):
            raise OSError(
                f"the worker {worker} cannot run xcg ({_short(answer)}); start the workers in the environment of this "
                "command"
            )
        release, unseen = answer
        if release != expected:
            raise OSError(
                f"the worker {worker} has xcg {release}, and this command {expected}; start the workers in the "
                "environment of this command"
            )
        if unseen:
            folder = Path(unseen[0]).parent
            raise OSError(
                f"the worker {worker} does not see the files in {folder}; input and output must be on a file system "
                "that all workers share"
            )


def _answer(paths: list[str]) -> tuple[str, list[str]]:
    """Return the version of xcg in this process, and the paths that it does not see."""
    return version("xcg"), [path for path in paths if not os.path.exists(path)]


def _short(error: BaseException) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
