"""Files that describe a job for the command line: TOML, and Pysammos's ``config.ini`` as it is."""

from __future__ import annotations

from pathlib import Path

from xcg.common.messages import SceneError
from xcg.jobs.job import Job
from xcg.jobs.pysammos_config import read_ini
from xcg.jobs.toml_config import read_toml
from xcg.steps.faults import check_on_error


def read_config(path: str | Path) -> Job:
    """Read a job from ``.toml`` or from Pysammos's ``.ini``.

    Paths in the file are relative to its folder.

    Raises
    ------
    FileNotFoundError
        If the file does not exist, or names files that do not exist.
    SceneError
        If it cannot be understood; the message names section and key.

    Warns
    -----
    SceneWarning
        For keys that are not known.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist")
    read = read_ini
    if path.suffix.lower() == ".toml":
        read = read_toml
    try:
        job = read(path)
    except UnicodeDecodeError as error:
        raise SceneError(
            f"{path}: is no text in UTF-8 ({error.reason} at byte {error.start})"
        ) from None
    # tables where values should be, and the like
    except (TypeError, AttributeError, RecursionError) as error:
        raise SceneError(
            f"{path}: cannot be understood ({error}); see the form of jobs in the documentation"
        ) from None
    try:
        check_on_error(job.on_error)
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from None
    return job
