"""HDF5 files: opened and read so that what is wrong with them is said with their name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from xcg.common.messages import SceneError

if TYPE_CHECKING:
    import h5py

MAGIC = b"\x89HDF\r\n\x1a\n"
_PACKED = 1 << 15  # times that compressed bytes may grow
_SLACK = 1 << 26  # bytes that any dataset may have
_SHOWN = 8  # names in messages


def is_hdf5(path: str) -> bool:
    """Return whether the file begins with the signature of HDF5."""
    with open(path, "rb") as file:
        return file.read(len(MAGIC)) == MAGIC


@contextmanager
def opened(path: str) -> Iterator[h5py.File]:
    """Open a file.

    Raises
    ------
    SceneError
        While it is open, for whatever the library finds wrong with the file.
    """
    import h5py  # slow to import

    try:
        with h5py.File(path, "r") as file:
            yield file
    except SceneError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise SceneError(
            f"{path}: cannot be read as HDF5 ({str(error)[:200]}); leave the file out, or write it again"
        ) from None


def dataset(file: h5py.File, path: str) -> h5py.Dataset:
    """Return a dataset of numbers.

    Raises
    ------
    SceneError
        If there is no dataset of this path, it does not hold numbers, or it promises far more bytes
        than are stored.
    """
    import h5py

    found = file.get(path)
    if not isinstance(found, h5py.Dataset):
        parent = path
        while parent and parent not in file:
            parent = parent.rpartition("/")[0]
        group = file[parent or "/"]
        members = ", ".join(list(group)[:_SHOWN]) if isinstance(group, h5py.Group) else ""
        raise SceneError(
            f"{file.filename}: no dataset {path!r}; {parent or '/'!r} holds {members or 'no others'}"
        )
    if found.dtype.kind not in "fiub":
        raise SceneError(f"{file.filename}: {path!r} holds {found.dtype}, expected numbers")
    if found.nbytes > _PACKED * found.id.get_storage_size() + _SLACK:
        raise SceneError(
            f"{file.filename}: {path!r} promises {found.nbytes} bytes, and {found.id.get_storage_size()} are stored"
        )
    return found


def listing(file: h5py.File) -> str:
    """List paths and shapes of the first datasets, for messages."""
    import h5py

    shown: list[str] = []

    def add(path: str, member: object) -> bool | None:
        if isinstance(member, h5py.Dataset):
            shown.append(f"/{path} {member.shape}")
        return True if len(shown) == _SHOWN else None  # anything but None ends the visit

    file.visititems(add)
    return ", ".join(shown) or "no datasets"
