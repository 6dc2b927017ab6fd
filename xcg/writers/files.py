"""Files and folders that appear under their final names only when they are whole, and locks during writing."""

from __future__ import annotations

import errno
import glob
import os
import shutil
import signal
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

# Files and folders that go when their writers end; `abandon` removes them where writers cannot.
temporary: set[Path] = set()

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_ZARR = ("zarr.json", ".zgroup", ".zarray")  # what folders of Zarr have, of format 3 and 2
_LITTLE = 1 << 20  # bytes; a disk with less is full
_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")  # which end a process by default; Windows has no SIGHUP


@contextmanager
def whole_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary name beside `path` to write to; rename it at the end, or remove it after an error.

    It raises the same errors as `renamed_file`.
    """
    check_file(path, overwrite=overwrite)
    with _part(path) as part, renamed_file(path, overwrite=overwrite, part=part):
        yield part


@contextmanager
def renamed_file(path: Path, *, overwrite: bool, part: Path) -> Iterator[Path]:
    """Rename the file `part` to `path` at the end; it stays after an error.

    Parameters
    ----------
    overwrite : bool
        Replace a file that exists.

    Raises
    ------
    FileExistsError
        If the file exists and `overwrite` is False, at the start or in the end.
    FileNotFoundError
        If its folder does not exist.
    IsADirectoryError
        If it is a folder.
    OSError
        If it cannot be written, as where the disk is full.
    """
    check_file(path, overwrite=overwrite)
    with _disk_named(path, part):
        yield part
        publish(part, path, overwrite=overwrite)


def write_by_vtk(writer: Any, data: Any, path: Path, *, overwrite: bool) -> None:
    """Write data by one of VTK's writers to a file that appears when it is whole; errors as of `whole_file`."""
    with whole_file(path, overwrite=overwrite) as part:
        writer.SetInputData(data)
        writer.SetFileName(os.fspath(part))
        if not writer.Write():
            raise OSError(f"{path}: VTK cannot write it; is the disk full?")


@contextmanager
def signals_wait() -> Iterator[None]:
    """Hold back Ctrl-C and the signals of `kill` and of closed terminals until the block has ended.

    Python handles signals in the main thread, so in other threads there is nothing to hold back.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in _SIGNALS if hasattr(signal, name)]
    pending: list[int] = []
    before = {number: signal.getsignal(number) for number in numbers}
    for number, handler in before.items():
        if handler is not None and handler != signal.SIG_IGN:  # None is a handler in C
            signal.signal(number, lambda number, _: pending.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)
        for number in dict.fromkeys(pending):
            signal.raise_signal(number)


def abandon() -> None:
    """Remove what is being written, and locks, just before the process ends without ado."""
    for path in list(temporary):
        with suppress(OSError):
            remove(path)


def check_target(path: Path, *, overwrite: bool) -> None:
    """Raise an error for a name that is taken, or in a folder that does not exist."""
    if path.exists() and not overwrite:
        raise FileExistsError(exists_message(path))
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: the folder {path.parent} does not exist; create it first")


def check_file(path: Path, *, overwrite: bool) -> None:
    """Raise an error for a taken name, as `check_target`, and for a folder, before anything is computed."""
    check_target(path, overwrite=overwrite)
    if path.is_dir():
        raise IsADirectoryError(
            f"{path} is a folder, and a file is not put in its place; choose another name, or remove the folder"
        )


def exists_message(path: Path) -> str:
    """Return the message for a name that is taken."""
    return f"{path} exists; choose another name, or pass overwrite=True to replace it"


def remove(path: Path) -> None:
    """Remove a file, a link, or as much of a folder as can be."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def part_of(path: Path) -> Path:
    """Return a new temporary name beside `path`."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")


def leftovers(path: Path) -> list[Path]:
    """List the temporary files and folders that processes which were killed left beside `path`."""
    return list(path.parent.glob(f".{glob.escape(path.name)}.{'[0-9a-f]' * 8}.part"))


def reserve(part: Path, room: int) -> None:
    """Reserve room on the disk, and release it."""
    if not hasattr(os, "posix_fallocate"):
        if shutil.disk_usage(part.parent).free < room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return
    with open(part, "wb") as file:
        os.posix_fallocate(file.fileno(), 0, room)
    part.unlink()


def sync(path: Path) -> None:
    """Wait until the bytes of a file are on the disk."""
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def is_published(part: Path, path: Path) -> bool:
    """Return whether `publish` has given a complete file its name, though its process was killed then."""
    return not part.exists() or (path.exists() and path.samefile(part))


def publish(part: Path, path: Path, *, overwrite: bool) -> None:
    """Rename a complete file to its name, once its bytes are on the disk."""
    sync(part)
    if not overwrite:
        try:  # unlike a rename, this fails where another run was faster
            os.link(part, path)
        except FileExistsError:
            raise FileExistsError(exists_message(path)) from None
        except OSError:  # a file system without links
            pass
        else:
            return
    os.replace(part, path)


@contextmanager
def _disk_named(path: Path, part: Path) -> Iterator[None]:
    """Name the file in errors of a disk that is full or out of reach."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # netCDF4 raises RuntimeError
        left = ", and nothing was left behind"
        if part.parent.suffix == ".begun":
            left = ""
        free = _LITTLE
        with suppress(OSError):
            free = shutil.disk_usage(path.parent).free
        number = getattr(error, "errno", None)
        if number in _FULL or free < _LITTLE:
            reason = "the disk is full"
            if number == errno.EFBIG:
                reason = "a file may not be larger here"
            raise OSError(
                f"{path}: {reason} ({free / 1e6:.0f} MB free){left}; make room and run again"
            ) from error
        if isinstance(error, RuntimeError) and "HDF" in str(error):
            raise OSError(
                f"{path}: cannot be written ({error}){left}; is the disk full or out of reach?"
            ) from error
        raise


@contextmanager
def whole_folder(path: Path, *, overwrite: bool, part: Path) -> Iterator[Path]:
    """Rename the Zarr folder `part` to `path` at the end.

    What it replaces is put aside before, and removed after. So one of both is there whole at any
    moment, if need be under the name ``.<name>.replaced``: where a process was killed in between,
    the next writer gives it its name back, and removes what such a process left. Only the writer
    that holds the lock ``.<name>.lock`` does any of this.

    Raises
    ------
    FileExistsError
        If `path` exists and `overwrite` is False, at the start or in the end, or another process is
        writing it, or it is a folder that holds anything but Zarr data.
    FileNotFoundError
        If its folder does not exist.
    OSError
        If it cannot be written, as where the disk is full.
    """
    if path.is_dir() and any(path.iterdir()) and not any((path / name).exists() for name in _ZARR):
        raise FileExistsError(
            f"{path} is a folder without Zarr data, not replaced; choose another name, or remove it"
        )
    check_target(path, overwrite=overwrite)
    with locked(path.with_name(f".{path.name}.lock"), str(path)):
        aside = path.with_name(f".{path.name}.replaced")
        if aside.exists() and not path.exists():
            aside.rename(path)
        for left in (aside, *leftovers(path)):
            if left not in part.parents:
                remove(left)
        check_target(path, overwrite=overwrite)
        with _disk_named(path, part):
            yield part
            if overwrite and path.exists():
                path.rename(aside)
            try:
                part.rename(path)  # this fails where a folder that is not empty has the name
            except OSError as error:
                if path.exists():
                    raise FileExistsError(exists_message(path)) from error
                if aside.exists():
                    aside.rename(path)
                raise
            remove(aside)


@contextmanager
def hidden_folder(path: Path) -> Iterator[Path]:
    """Yield a new folder beside `path` for incomplete files; it is removed at the end, as what killed processes left.

    Raises
    ------
    FileExistsError
        If another process is writing `path`.
    """
    with locked(path.with_name(f".{path.name}.lock"), str(path)):
        for left in leftovers(path):
            remove(left)
        with work_folder(None, path) as part:
            yield part


@contextmanager
def work_folder(kept: Path | None, path: Path) -> Iterator[Path]:
    """Yield a folder for incomplete files, which is removed at the end.

    Parameters
    ----------
    kept : Path or None
        A folder that stays after an error, held by one process at a time; None for a temporary one
        beside `path`.

    Raises
    ------
    FileExistsError
        If another process holds it.
    """
    if kept is None:
        with _part(path) as work:
            work.mkdir()
            yield work
        return
    what = kept.name.removeprefix(".").removesuffix(".begun")
    with locked(lock_of(kept), str(kept.with_name(what))):
        kept.mkdir(exist_ok=True)
        yield kept
        # at once, so that no half of it is taken for a run to go on with
        kept.rename(part_of(kept))
        for gone in leftovers(kept):
            shutil.rmtree(gone, ignore_errors=True)


@contextmanager
def _part(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; whatever has it at the end is removed."""
    part = part_of(path)
    temporary.add(part)
    try:
        yield part
    except BaseException:
        # after one of them failed, tasks may write to a folder for a moment
        for _ in range(100):
            remove(part)
            time.sleep(0.05)
            if not part.exists():
                break
        raise
    finally:
        remove(part)
        temporary.discard(part)


@contextmanager
def exclusive(path: Path) -> Iterator[None]:
    """Let one process of any machine at a time write to a file, where its file system has locks.

    Tasks of a cluster may outlive the run that sent them, and its locks. This one ends with its
    process. Its file stays.
    """
    lock = FileLock(path.with_name(f"{path.name}.lock"), thread_local=False)
    try:
        lock.acquire(poll_interval=0.01)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    try:
        yield
    finally:
        lock.release()


def lock_of(kept: Path) -> Path:
    """Return the lock of a hidden folder that stays."""
    return kept.with_name(f"{kept.name}.lock")


# What file systems without locks answer, as some of clusters; runs are not kept apart there.
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP}


@contextmanager
def locked(path: Path, what: str) -> Iterator[None]:
    """Hold a lock on a file, which is made for it and removed in the end.

    Raises
    ------
    FileExistsError
        If another process holds it; the message names the process.
    OSError
        If a symbolic link has its name.
    """
    lock = FileLock(path, thread_local=False)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        by = "another run"
        with suppress(OSError):
            holder = path.read_bytes()[:32].decode("ascii", "replace").strip()
            if holder:
                by += f" (process {holder})"
        raise FileExistsError(
            f"{what} is being written by {by}; wait for it to end, or choose another output folder or name"
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    temporary.add(path)
    try:
        with suppress(OSError):
            path.write_text(str(os.getpid()))
        yield
    finally:
        # before it is released, so that nobody locks a file without a name
        path.unlink(missing_ok=True)
        temporary.discard(path)
        lock.release()
