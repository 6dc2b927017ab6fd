"""One run at a time for one output.

The lock is the kernel's own on an open file: it ends with the process that holds it, however that ends, so that no
lock is ever stale.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

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
    lock = FileLock(path, thread_local=False)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        holder = path.read_bytes()[:32].decode("ascii", "replace").strip() if path.is_file() else ""
        raise FileExistsError(
            f"{what} is being written by another run{f' (process {holder})' if holder else ''}; wait for it to end, or "
            "choose another output folder or name"
        ) from None
    except OSError as error:
        if path.is_symlink():
            message = "is a symbolic link, where a lock is expected; remove it"
            raise OSError(errno.ELOOP, message, str(path)) from error
        if error.errno not in _NO_LOCKS:
            raise
    temporary.add(path)
    try:
        with suppress(OSError), open(path, "w", opener=_no_link) as file:
            file.write(str(os.getpid()))
        yield
    finally:
        path.unlink(missing_ok=True)  # before it is released, so that nobody locks a file without a name
        temporary.discard(path)
        lock.release()


def _no_link(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o644)
