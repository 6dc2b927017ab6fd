"""HDF5 files: opened and read so that what is wrong with them is said with their name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

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
    except (SceneError, FileNotFoundError):
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError) as error:
        raise SceneError(
            f"{path}: cannot be read as HDF5 ({str(error)[:200]}); leave the file out, or write it again"
        ) from None


class RecordField:
    """Field of a dataset of records, read as a dataset."""

    def __init__(self, records: h5py.Dataset, field: str) -> None:
        self._records = records
        self._field = field
        kind = records.dtype[field]
        self.shape = (*records.shape, *kind.shape)
        self.ndim = len(self.shape)
        self.dtype = kind.base
        self.nbytes = records.nbytes
        self.name = f"{records.name}/{field}"
        self.id = records.id
        self.attrs = records.attrs

    def __getitem__(self, selection: Any) -> Any:
        """Read some of the values."""
        indices = selection if isinstance(selection, tuple) else (selection,)
        count = self._records.ndim
        values = self._records.fields(self._field)[indices[:count]]
        return values[(..., *indices[count:])]


def dataset(file: h5py.File, path: str) -> h5py.Dataset:
    """Return a dataset of numbers, or a field of records, such as ``/table/x``.

    Raises
    ------
    SceneError
        If the dataset does not exist, does not hold numbers, or promises far more bytes
        than are stored.
    """
    import h5py

    data = file.get(path)
    path_of_records, _, field = path.rpartition("/")
    records = file.get(path_of_records) if path_of_records and data is None else None
    if isinstance(records, h5py.Dataset) and field in (records.dtype.names or ()):
        data = RecordField(records, field)
    elif not isinstance(data, h5py.Dataset):
        parent = path
        while parent and parent not in file:
            parent = parent.rpartition("/")[0]
        parent = parent or "/"
        members = "no others"
        if isinstance(file[parent], h5py.Group) and len(file[parent]):
            members = ", ".join(list(file[parent])[:_SHOWN])
        elif isinstance(file[parent], h5py.Dataset) and file[parent].dtype.names:
            members = f"records with the fields {', '.join(file[parent].dtype.names)}"
        raise SceneError(f"{file.filename}: no dataset {path!r}; {parent!r} holds {members}")
    if data.dtype.names:
        raise SceneError(
            f"{file.filename}: {path!r} holds records; name one of their fields in mapping=, such as "
            f"{path + '/' + data.dtype.names[0]!r} ({', '.join(data.dtype.names)})"
        )
    if data.dtype.kind not in "fiub":
        raise SceneError(f"{file.filename}: {path!r} holds {data.dtype}, expected numbers")
    stored = data.id.get_storage_size()
    if data.nbytes > _PACKED * stored + _SLACK:
        raise SceneError(
            f"{file.filename}: {path!r} promises {data.nbytes} bytes, and {stored} are stored"
        )
    return data


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


def text_of(value: object) -> str:
    """Return a text that HDF5 holds as text or bytes."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return str(value)
