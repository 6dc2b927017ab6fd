"""Files that appear only when they are whole."""

from __future__ import annotations

import errno
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_LITTLE = 1 << 20  # bytes; a disk with less is full


@contextmanager
def whole_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Give a temporary name beside `path` to write to; rename it in the end, or remove it after an error.

    Raises
    ------
    FileExistsError
        If the file exists and `overwrite` is False, at the start or in the end.
    FileNotFoundError
        If its folder does not exist.
    OSError
        If it cannot be written, as where the disk is full. Nothing is left behind then.
    """
    if path.exists() and not overwrite:
        raise FileExistsError(_exists(path))
    if not path.parent.is_dir():
        msg = f"{path}: the folder {path.parent} does not exist; create it first"
        raise FileNotFoundError(msg)
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        yield part
        _publish(part, path, overwrite=overwrite)
    except (OSError, RuntimeError) as error:  # netCDF4 raises RuntimeError
        problem = _cannot_write(path, error)
        if problem is None:
            raise
        raise problem from error
    finally:
        part.unlink(missing_ok=True)


def leftovers(path: Path) -> list[Path]:
    """List the temporary files that runs which were killed left beside `path`."""
    return [file for file in path.parent.glob(".*.part") if file.name.startswith(f".{path.name}.")]


def _exists(path: Path) -> str:
    return f"{path} exists; choose another name, or pass overwrite=True to replace it"


def _publish(part: Path, path: Path, *, overwrite: bool) -> None:
    """Give a whole file its name, once its bytes are on the disk."""
    with open(part, "rb+") as file:
        os.fsync(file.fileno())
    if not overwrite:
        try:  # unlike a rename, this fails where another run was faster
            os.link(part, path)
        except FileExistsError:
            raise FileExistsError(_exists(path)) from None
        except OSError:  # a file system without links
            pass
        else:
            return
    os.replace(part, path)


def _cannot_write(path: Path, error: Exception) -> OSError | None:
    """Say plainly that a file cannot be written; None where the error is another one."""
    number = getattr(error, "errno", None)
    free = _LITTLE
    with suppress(OSError):
        free = shutil.disk_usage(path.parent).free
    text = str(error)
    said = next((n for n in _FULL if f"errno = {n}," in text), number)  # HDF5 tells it in its text only
    if said in _FULL or free < _LITTLE:
        full = "a file may not be larger here" if said == errno.EFBIG else "the disk is full"
        msg = f"{path}: {full} ({free / 1e6:.0f} MB free), and nothing was left behind; make room and run again"
        return OSError(msg)
    if isinstance(error, RuntimeError) and "HDF" in text:
        msg = f"{path}: cannot be written ({error}), and nothing was left behind; is the disk full or out of reach?"
        return OSError(msg)
    return None
