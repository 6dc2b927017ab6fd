"""One run at a time for one output.

The lock is the kernel's own on an open file: it ends with the process that holds it, however that ends, so that no
lock is ever stale.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from xcg.writers.files import temporary

# What file systems without locks answer, as some of clusters; runs are not held apart there.
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
    file = _take(path, what)
    temporary.add(path)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # before it is closed, so that nobody locks a file without a name
        temporary.discard(path)
        os.close(file)


def _take(path: Path, what: str) -> int:
    while True:
        file = _open(path)
        if not _try_lock(file):
            holder = os.read(file, 32).decode("ascii", "replace").strip()
            os.close(file)
            raise FileExistsError(
                f"{what} is being written by another run{f' (process {holder})' if holder else ''}; wait for it to "
                "end, or choose another output folder or name"
            )
        if _is_at(file, path):
            os.ftruncate(file, 0)
            os.write(file, str(os.getpid()).encode())
            return file
        os.close(file)  # its owner removed it in between


def _open(path: Path) -> int:
    """Open the file, never another one that a link of its name leads to: its content is overwritten."""
    if path.is_symlink():
        raise OSError(errno.ELOOP, "is a symbolic link, where a lock is expected; remove it", str(path))
    return os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)


def _is_at(file: int, path: Path) -> bool:
    """Whether the open file is still the one of this name."""
    try:
        return os.path.samestat(os.fstat(file), os.lstat(path))
    except FileNotFoundError:
        return False


def _try_lock(file: int) -> bool:
    try:
        import fcntl
    except ImportError:  # Windows
        return _try_lock_elsewhere(file)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    return True


def _try_lock_elsewhere(file: int) -> bool:
    import msvcrt

    try:
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    except OSError:
        return False
    return True
