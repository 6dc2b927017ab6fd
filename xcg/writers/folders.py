"""Folders that appear only when they are whole, made by one writer at a time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from xcg.writers.files import check_target, exists_message, leftovers, part_of, remove, temporary
from xcg.writers.lock import locked


@contextmanager
def whole_folder(path: Path, *, overwrite: bool, part: Path | None = None) -> Iterator[Path]:
    """Give a temporary name beside `path` to make a folder at; rename it in the end, or remove it after an error.

    What it replaces is put aside before, and removed after. So one of both is there whole at any moment, if need be
    under the name ``.<name>.replaced``: where a process was killed in between, the next writer gives it its name back,
    and removes what such a process left. Only the writer that holds the lock ``.<name>.lock`` does any of this. `part`
    is a name to make it at instead, which stays after an error.

    Raises
    ------
    FileExistsError
        If `path` exists and `overwrite` is False, at the start or in the end, or another process is writing it.
    FileNotFoundError
        If the folder that it is to stand in does not exist.
    """
    check_target(path, overwrite=overwrite)
    with locked(path.with_name(f".{path.name}.lock"), str(path)):
        aside = path.with_name(f".{path.name}.replaced")
        _recover(path, aside, part)
        check_target(path, overwrite=overwrite)
        with _part(path) if part is None else nullcontext(part) as part:
            yield part
            if overwrite and path.exists():
                path.rename(aside)
            _publish(part, path, aside)
            remove(aside)


@contextmanager
def hidden_folder(path: Path) -> Iterator[Path]:
    """Give a new folder beside `path` for files that are not whole yet; it goes in the end.

    So does what a process left that was killed.

    Raises
    ------
    FileExistsError
        If another process is writing `path`.
    """
    with locked(path.with_name(f".{path.name}.lock"), str(path)):
        for left in leftovers(path):
            remove(left)
        with _part(path) as part:
            part.mkdir()
            yield part


@contextmanager
def _part(path: Path) -> Iterator[Path]:
    """Give a temporary name beside `path`; what stands there in the end is removed."""
    part = part_of(path)
    temporary.add(part)
    try:
        yield part
    finally:
        remove_for_good(part)
        temporary.discard(part)


def _recover(path: Path, aside: Path, work: Path | None) -> None:
    """Finish what a writer that was killed left half done."""
    if aside.exists() and not path.exists():
        aside.rename(path)
    for left in (aside, *leftovers(path)):
        if work is None or left not in work.parents:
            remove(left)


def _publish(part: Path, path: Path, aside: Path) -> None:
    """Give a whole folder its name; renaming fails where a folder that is not empty has it."""
    try:
        part.rename(path)
    except OSError as error:
        if path.exists():
            raise FileExistsError(exists_message(path)) from error
        if aside.exists():
            aside.rename(path)
        raise


def remove_for_good(folder: Path) -> None:
    """Remove a folder that tasks may write to for another moment, as they do after one of them failed."""
    for _ in range(100):
        if not folder.exists():
            return
        remove(folder)
        time.sleep(0.05)
