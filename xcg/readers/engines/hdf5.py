"""HDF5 of any layout: ``mapping=`` assigns datasets to the variables of the scene.

A step is a group, whose name holds ``{time}`` or ``{step}``; or an entry along the first dimension of all datasets; or
a file. Datasets of vectors have two or three columns.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, did_you_mean
from xcg.readers import columns
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.readers.paths import index_steps
from xcg.scene.schema import COMPONENTS

if TYPE_CHECKING:
    import h5py

MAGIC = b"\x89HDF\r\n\x1a\n"
_PLACES = {"{time}": r"([-+]?[\d.]+(?:[eE][-+]?\d+)?)", "{step}": r"(\d+)"}
_PACKED, _SLACK = (
    1 << 15,
    1 << 26,
)  # times that compressed bytes may grow, and bytes that any dataset may have
_ONE = ("position", "contact_i")  # of each kind, what tells the steps
_STACKED = "stacked"  # steps along the first dimension; else `kind` of a step is what stands in the name of its group


class Hdf5(Columnar):
    """HDF5 by ``mapping=``."""

    OPTIONS = ("mapping", "timestep")
    NEEDS_ID = False

    def recognises(self, path: str) -> bool:
        """Return whether the suffix and the first bytes identify HDF5."""
        if Path(path).suffix.lower() not in (".h5", ".hdf5"):
            return False
        with open(path, "rb") as file:
            return file.read(len(MAGIC)) == MAGIC

    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps of particles, or of contacts, in the same files or others."""
        places = _mapping(options)
        time = places.pop("time", None)
        mine = {name: path for name, path in places.items() if _of_contacts(name) is contacts}
        one = _ONE[contacts]
        if one not in mine and f"{one}_x" not in mine:
            raise SceneError(f"mapping= lacks {one!r}; it has {', '.join(places)}")
        scan = partial(_steps, mine=mine, time=time)
        return index_steps(paths, f"hdf5 {mine} {time}", scan, options.extra.get("timestep"))

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read the datasets of the wanted columns."""
        places = _mapping(options)
        found: dict[str, NDArray] = {}
        with opened(ref.path) as file:
            for column in sorted(set(wanted)):
                name = column if column in places else column[: -len("_x")]
                part = None if column in places else COMPONENTS.index(column[-1])
                found[column] = _values(file, _filled(places[name], ref), ref, part)
        return found

    def particle_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the columns that particles are read from: all of them."""
        return super().particle_columns(ref, _by_themselves(ref, options))

    def contact_columns(
        self, ref: StepRef, options: ReadOptions, slots: columns.Slots | None = None
    ) -> dict[str, str]:
        """Find the columns that contacts are read from: all of them."""
        return super().contact_columns(ref, _by_themselves(ref, options))


def _by_themselves(ref: StepRef, options: ReadOptions) -> ReadOptions:
    return replace(options, names={column: column for column in ref.columns})


# --- the mapping -----------------------------------------------------------------------------------------


def _of_contacts(name: str) -> bool:
    return name.startswith("contact_") or (
        name in columns.CONTACT_SLOTS or f"{name}_x" in columns.CONTACT_SLOTS
    )


def _mapping(options: ReadOptions) -> dict[str, str]:
    """Paths of datasets by variable, checked."""
    given = options.extra.get("mapping")
    example = "mapping={'position': '/Step{time}/Particles/Position', ...}"
    if not isinstance(given, Mapping) or not given:
        raise SceneError(
            f"engine='hdf5' needs to be told where variables are: {example}; h5ls -r lists a file"
        )
    slots = {**columns.PARTICLE_SLOTS, **columns.CONTACT_SLOTS}
    known = {*slots, *(slot[:-2] for slot in slots if slot.endswith("_x")), "time"}
    for name, path in given.items():
        if not isinstance(path, str) or sum(path.count(place) for place in _PLACES) > 1:
            raise SceneError(
                f"mapping={{{name!r}: {path!r}}}: expected a path with at most one '{{time}}' or '{{step}}'"
            )
        likely = "" if name in known else did_you_mean(name, known, 0.85)
        if likely:
            raise SceneError(
                f"mapping={{{name!r}: ...}}: no variable of scenes has this name{likely}"
            )
    return dict(given)


def _filled(path: str, ref: StepRef) -> str:
    for place in _PLACES:
        path = path.replace(place, ref.kind)
    return path


# --- the index -------------------------------------------------------------------------------------------


def _steps(path: str, mine: Mapping[str, str], time: str | None) -> Iterator[StepRef]:
    with opened(path) as file:
        first = next(iter(mine.values()))
        place = next((place for place in _PLACES if place in first), None)
        if place is not None:
            for text, number in _numbers_of_groups(file, first, place):
                ref = StepRef(path, 0, kind=text, step=int(text) if place == "{step}" else -1)
                ref = replace(ref, time=number if place == "{time}" else _time(file, time, ref))
                yield _with_columns(file, ref, mine)
            return
        name, data = _ONE[_of_contacts(next(iter(mine)))], dataset(file, first)
        wide = next(iter(mine)) == name == "position"
        if len(data.shape) > 1 + wide:
            for k in range(data.shape[0]):
                ref = StepRef(path, 0, kind=_STACKED, offset=k, step=k)
                yield _with_columns(file, replace(ref, time=_time(file, time, ref)), mine)
            return
        ref = StepRef(path, 0, step=-1)
        yield _with_columns(file, replace(ref, time=_time(file, time, ref)), mine)


def _numbers_of_groups(file: h5py.File, path: str, place: str) -> list[tuple[str, float]]:
    """List the values of the placeholder in the names of a group's members, by number."""
    parts = path.split("/")
    at = next(k for k, part in enumerate(parts) if place in part)
    parent = file["/".join(parts[:at]) or "/"]
    before, after = parts[at].split(place)
    pattern = re.compile(re.escape(before) + _PLACES[place] + re.escape(after))
    found = [match[1] for match in map(pattern.fullmatch, parent) if match]
    numbers = []
    for text in found:
        try:
            numbers.append((text, float(text)))
        except ValueError:
            continue
    if not numbers:
        there = ", ".join(list(parent)[:5]) or "nothing"
        raise SceneError(
            f"{file.filename}: no name like {parts[at]!r} in {parent.name!r}, which holds {there}"
        )
    return sorted(numbers, key=lambda entry: entry[1])


def _with_columns(file: h5py.File, ref: StepRef, mine: Mapping[str, str]) -> StepRef:
    """Names of the columns that the datasets of a step have, and the number of its rows."""
    names: list[str] = []
    rows: dict[str, int] = {}
    for name, path in mine.items():
        whole, stacked = dataset(file, _filled(path, ref)).shape, ref.kind == _STACKED
        shape, scalar = (
            whole[stacked:],
            name in columns.PARTICLE_SLOTS or name in columns.CONTACT_SLOTS,
        )
        if not (len(shape) == 1 or (len(shape) == 2 and shape[1] in (2, 3) and not scalar)):
            n = "(steps, n" if stacked else "(n"
            expected = f"{n})" if scalar else f"{n}), {n}, 2) or {n}, 3)"
            raise SceneError(
                f"{source_of(ref)}: {_filled(path, ref)!r} has the shape {whole}, expected {expected} for {name!r}"
            )
        names += (
            [name] if len(shape) == 1 else [f"{name}_{axis}" for axis in COMPONENTS[: shape[1]]]
        )
        rows[_filled(path, ref)] = shape[0]
    if len(set(rows.values())) > 1:
        raise SceneError(f"{source_of(ref)}: datasets have different numbers of rows: {rows}")
    return replace(ref, columns=tuple(names), rows=next(iter(rows.values())))


def _time(file: h5py.File, path: str | None, ref: StepRef) -> float | None:
    """Time of a step, from a dataset or an attribute ("group@name")."""
    if path is None:
        return None
    filled, _, attribute = _filled(path, ref).partition("@")
    value = np.ravel(
        file[filled or "/"].attrs[attribute] if attribute else dataset(file, filled)[()]
    )
    place = ref.offset if ref.kind == _STACKED and len(value) > 1 else 0
    number = float(value[place]) if place < len(value) and value.dtype.kind in "fiu" else np.nan
    if not np.isfinite(number):
        raise SceneError(
            f"{source_of(ref)}: {_filled(path, ref)!r} does not hold the time of this step"
        )
    return number


# --- datasets --------------------------------------------------------------------------------------------


@contextmanager
def opened(path: str) -> Iterator[h5py.File]:
    """Open a file; what the library finds wrong with it is said with its name."""
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
    """Return a dataset of numbers. Raise SceneError if there is none, or it promises more than is stored."""
    import h5py

    found = file.get(path)
    if not isinstance(found, h5py.Dataset):
        parent = path
        while parent and parent not in file:
            parent = parent.rpartition("/")[0]
        group = file[parent or "/"]
        there = ", ".join(list(group)[:8]) if isinstance(group, h5py.Group) else ""
        raise SceneError(
            f"{file.filename}: no dataset {path!r}; {parent or '/'!r} holds {there or 'no others'}"
        )
    if found.dtype.kind not in "fiub":
        raise SceneError(f"{file.filename}: {path!r} holds {found.dtype}, expected numbers")
    if found.nbytes > _PACKED * found.id.get_storage_size() + _SLACK:
        raise SceneError(
            f"{file.filename}: {path!r} promises {found.nbytes} bytes, and {found.id.get_storage_size()} are stored"
        )
    return found


def _values(file: h5py.File, path: str, ref: StepRef, part: int | None) -> NDArray:
    """Numbers of a step, of one component of a vector."""
    data = dataset(file, path)
    selection = (
        *((ref.offset,) if ref.kind == _STACKED else ()),
        slice(None),
        *(() if part is None else (part,)),
    )
    values = np.asarray(data[selection], "float64")
    if values.shape != (ref.rows,):
        raise SceneError(
            f"{source_of(ref)}: {path!r} has the shape {data.shape}, and {ref.rows} rows were promised"
        )
    return values
