"""HDF5 of any layout: ``mapping=`` assigns datasets to the variables of the scene.

A step is a group, whose name holds ``{time}`` or ``{step}``; or an entry along the first dimension
of all datasets; or a file. Datasets of vectors have two or three columns.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, did_you_mean
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.filenames import sort_by_numbers
from xcg.readers.files.hdf5data import dataset, is_hdf5, listing, opened, text_of
from xcg.readers.files.text import source_of
from xcg.readers.named_columns import factor_of, has_other_unit
from xcg.readers.names import ALL_SLOTS, CONTACT_SLOTS, vector_columns
from xcg.readers.paths import index_steps
from xcg.scene.schema import COMPONENTS

if TYPE_CHECKING:
    import h5py

_PLACEHOLDERS = {"{time}": r"([-+]?[\d.]+(?:[eE][-+]?\d+)?)", "{step}": r"(\d+)"}
_FIRST = ("position", "position_x", "contact_i")  # one of them tells the steps and the rows
_STACKED = "stacked"  # steps along the first dimension; else `kind` of a step is what stands in the name of its group


_NO_MAPPING = (
    "engine='hdf5' needs to be told where variables are: "
    "mapping={'position': '/Step{time}/Particles/Position', ...}"
)


class Hdf5(Columnar):
    """HDF5 by ``mapping=``."""

    OPTIONS = ("mapping", "timestep")
    NEEDS_ID = False

    def recognises(self, path: str) -> bool:
        """Return whether the suffix and the first bytes identify HDF5."""
        return Path(path).suffix.lower() in (".h5", ".hdf5") and is_hdf5(path)

    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps of particles, or of contacts, in the same files or others."""
        if not options.extra.get("mapping"):
            with opened(paths[0]) as file:
                raise SceneError(f"{paths[0]}: {_NO_MAPPING}; the file holds {listing(file)}")
        mapping = _mapping(options)
        time = mapping.pop("time", None)
        mine = {name: path for name, path in mapping.items() if _of_contacts(name) is contacts}
        if not any(name in mine for name in _FIRST):
            lacking = "contact_i" if contacts else "position"
            raise SceneError(f"mapping= lacks {lacking!r}; it has {', '.join(mapping)}")
        convert = "units" not in options.given
        scan = partial(_steps, mine=mine, time=time, convert=convert)
        key = f"hdf5 {mine} {time} {convert}"
        return index_steps(paths, key, scan, options.extra.get("timestep"))

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read the datasets of the wanted columns, in SI where attributes name their units."""
        convert = "units" not in options.given
        mapping = _mapping(options)
        first = _filled(mapping[_first_of(mapping)], ref)
        table: dict[str, NDArray] = {}
        with opened(ref.path) as file:
            for column in sorted(set(wanted)):
                name = column
                part = None
                if column not in mapping:
                    name, _, axis = column.rpartition("_")
                    part = COMPONENTS.index(axis)
                path = _filled(mapping[name], ref)
                if path.endswith("/*"):
                    table[column] = _numbers_of_members(file, path, first, ref)
                else:
                    table[column] = _values(file, path, ref, part)
                    if convert:
                        table[column] *= _factor(file, _members(file, path)[0], column)
        return table

    def particle_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the columns that particles are read from: all of them."""
        in_space = [axis for axis in COMPONENTS if f"position_{axis}" in ref.columns]
        _require_mapped(ref, "position", in_space if len(in_space) > 1 else COMPONENTS)
        if any(f"velocity_{axis}" in ref.columns for axis in COMPONENTS):
            _require_mapped(ref, "velocity", in_space)
        return super().particle_columns(ref, _by_themselves(ref, options))

    def contact_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the columns that contacts are read from: all of them."""
        vectors = ("contact_force", "normal_force", "tangential_force")
        total, normal, tangential = (f"{vector}_x" in ref.columns for vector in vectors)
        lacking = [name for name in ("contact_i", "contact_j") if name not in ref.columns]
        if not total and not normal:
            lacking.append("contact_force")
        if lacking:
            more = ", ".join(f"{name!r}: '...'" for name in lacking)
            raise SceneError(
                f"{ref.path}: mapping= lacks {' and '.join(lacking)} of contacts, and has {', '.join(ref.columns)}: "
                f"add the paths of their datasets, mapping={{..., {more}}}"
            )
        if total and tangential and not normal:
            raise SceneError(
                f"{ref.path}: mapping= has 'contact_force', the whole force, and 'tangential_force', a part: "
                "call the first 'normal_force' there to add the two up, or leave the second out"
            )
        return super().contact_columns(ref, _by_themselves(ref, options))


def _require_mapped(ref: StepRef, vector: str, axes: Sequence[str]) -> None:
    """Raise SceneError unless a mapping names the components of a vector along some axes."""
    lacking = [f"{vector}_{axis}" for axis in axes if f"{vector}_{axis}" not in ref.columns]
    if lacking:
        more = ", ".join(f"{name!r}: '...'" for name in lacking)
        raise SceneError(
            f"{ref.path}: mapping= lacks {' and '.join(lacking)}, and has {', '.join(ref.columns)}: add "
            f"the paths of their datasets, mapping={{..., {more}}}, or of one with all components, "
            f"mapping={{{vector!r}: '...'}}"
        )


def _by_themselves(ref: StepRef, options: ReadOptions) -> ReadOptions:
    return replace(options, names={column: column for column in ref.columns})


# --- the mapping -----------------------------------------------------------------------------------------


def _of_contacts(name: str) -> bool:
    return name.startswith("contact_") or name in CONTACT_SLOTS or f"{name}_x" in CONTACT_SLOTS


def _mapping(options: ReadOptions) -> dict[str, str]:
    """Paths of datasets by variable, checked."""
    mapping = options.extra.get("mapping")
    if not isinstance(mapping, Mapping) or not mapping:
        raise SceneError(_NO_MAPPING)
    names = {*ALL_SLOTS, *(slot[:-2] for slot in ALL_SLOTS if slot.endswith("_x")), "time"}
    for name, path in mapping.items():
        if not isinstance(path, str) or sum(map(path.count, _PLACEHOLDERS)) > 1:
            raise SceneError(
                f"mapping={{{name!r}: {path!r}}}: expected a path with at most one '{{time}}' or '{{step}}'"
            )
        likely = did_you_mean(name, names, 0.85)
        if likely and name not in names:
            raise SceneError(
                f"mapping={{{name!r}: ...}}: no variable of scenes has this name{likely}"
            )
    return dict(mapping)


def _filled(path: str, ref: StepRef) -> str:
    for placeholder in _PLACEHOLDERS:
        path = path.replace(placeholder, ref.kind)
    return path


# --- the index -------------------------------------------------------------------------------------------


def _steps(
    path: str, mine: Mapping[str, str], time: str | None, *, convert: bool
) -> Iterator[StepRef]:
    with opened(path) as file:
        first = _first_of(mine)
        for placeholder in _PLACEHOLDERS:
            if placeholder not in mine[first]:
                continue
            for text, number in _numbers_of_groups(file, mine[first], placeholder):
                ref = StepRef(path, 0, number, kind=text, step=-1)
                if placeholder == "{step}":
                    ref = replace(ref, step=int(text), time=_time(file, time, ref, convert=convert))
                yield _with_columns(file, ref, mine)
            return
        data = dataset(file, _members(file, mine[first])[0])
        if len(data.shape) > (2 if first == "position" else 1):
            for k in range(data.shape[0]):
                ref = StepRef(path, 0, kind=_STACKED, offset=k, step=k)
                ref = replace(ref, time=_time(file, time, ref, convert=convert))
                yield _with_columns(file, ref, mine, steps=data.shape[0])
            return
        ref = StepRef(path, 0, step=-1)
        yield _with_columns(file, replace(ref, time=_time(file, time, ref, convert=convert)), mine)


def _first_of(mine: Mapping[str, str]) -> str:
    """Return the variable of a mapping that defines the steps and the number of rows."""
    return next(name for name in _FIRST if name in mine)


def _numbers_of_groups(file: h5py.File, path: str, placeholder: str) -> list[tuple[str, float]]:
    """List the values of the placeholder in the names of a group's members, by number."""
    before, after = path.split(placeholder)
    parent_path, _, before = before.rpartition("/")
    after = after.partition("/")[0]
    parent = file[parent_path or "/"]
    pattern = re.compile(re.escape(before) + _PLACEHOLDERS[placeholder] + re.escape(after))
    numbers = []
    for match in filter(None, map(pattern.fullmatch, parent)):
        with suppress(ValueError):
            numbers.append((match[1], float(match[1])))
    if not numbers:
        members = ", ".join(list(parent)[:5]) or "nothing"
        raise SceneError(
            f"{file.filename}: no name like {before + placeholder + after!r} in {parent.name!r}, which holds {members}"
        )
    return sorted(numbers, key=lambda entry: entry[1])


def _with_columns(
    file: h5py.File, ref: StepRef, mine: Mapping[str, str], steps: int = 0
) -> StepRef:
    """Return the step with the columns that its datasets have, and the number of its rows.

    `steps` is the length of the first dimension where that counts the steps, else 0.
    """
    names: list[str] = []
    counts_by_path: dict[str, list[int]] = {}
    first = _filled(mine[_first_of(mine)], ref)
    firsts = [dataset(file, member).shape for member in _members(file, first)]
    stacks = {shape[:2] for shape in firsts if steps}
    for name, path in mine.items():
        filled = _filled(path, ref)
        if filled.endswith("/*"):  # the member that a row is from, not a dataset
            names.append(name)
            continue
        shapes = [dataset(file, member).shape for member in _members(file, filled)]
        shapes_of_row = {_shape_of_row(name, shape, ref, filled, stacks) for shape in shapes}
        if len(shapes_of_row) > 1:
            raise SceneError(f"{source_of(ref)}: {filled!r} has the shapes {shapes}, of two kinds")
        width, in_time = shapes_of_row.pop()
        names += vector_columns(name, width) or [name]
        counts_by_path[filled] = [shape[int(in_time)] for shape in shapes]
    if any(counts != counts_by_path[first] for counts in counts_by_path.values()):
        raise SceneError(
            f"{source_of(ref)}: datasets have different numbers of rows: {counts_by_path}"
        )
    return replace(ref, columns=tuple(names), rows=sum(counts_by_path[first]))


def _shape_of_row(
    name: str, shape: tuple[int, ...], ref: StepRef, path: str, stacks: set[tuple[int, ...]]
) -> tuple[int, bool]:
    """Return the number of components, 0 for a number, and whether the first dimension counts steps.

    What does not begin with steps and rows of the positions (`stacks`) does not change in time.
    """
    in_time = shape[:2] in stacks
    if f"{name}_x" in ALL_SLOTS and len(shape) == 2:  # as many rows as steps
        in_time = False
    shape_of_row = shape[1 + int(in_time) :]
    if shape and not shape_of_row:
        return 0, in_time
    if shape_of_row in ((2,), (3,)) and name not in ALL_SLOTS:
        return shape_of_row[0], in_time
    n = "(steps, n" if stacks else "(n"
    expected = f"{n})"
    if name not in ALL_SLOTS:
        expected += f", {n}, 2) or {n}, 3)"
    raise SceneError(
        f"{source_of(ref)}: {path!r} has the shape {shape}, expected {expected} for {name!r}"
    )


def _members(file: h5py.File, path: str) -> list[str]:
    """Return the datasets that a path with ``*`` for a group means, in the order of numbers in their names.

    Members of the group that lack the dataset are left out, as types without particles.
    """
    before, star, after = path.partition("/*/")
    if not star:
        return [path]
    if before not in file:
        raise SceneError(f"{file.filename}: no group {before!r}, which {path!r} names")
    names = sort_by_numbers(file[before])
    members = [f"{before}/{name}/{after}" for name in names if f"{before}/{name}/{after}" in file]
    if not members:
        raise SceneError(
            f"{file.filename}: none of the members of {before!r} ({', '.join(names[:5])}) has {after!r}"
        )
    return members


def _factor(file: h5py.File, path: str, column: str) -> float:
    """Return the factor to SI of the unit that an attribute of a dataset names; 1 without one."""
    attributes = dataset(file, path).attrs
    for name in ("units", "unit"):
        for value in np.ravel(attributes.get(name, ()))[:1]:
            with_unit = f"{column} [{text_of(value)}]"
            if has_other_unit(with_unit, column):
                raise SceneError(
                    f"{file.filename}: {path!r} has the unit {text_of(value)!r}, which is not known or not one of "
                    f"{column}; give the factors to SI, such as units={{'length': 1e-3}} for mm, or units='SI'"
                )
            return factor_of(with_unit, column)
    return 1.0


def _time(file: h5py.File, path: str | None, ref: StepRef, *, convert: bool) -> float | None:
    """Time of a step, from a dataset or an attribute ("group@name")."""
    if path is None:
        return None
    filled = _filled(path, ref)
    group, _, attribute = filled.partition("@")
    stored = file[group or "/"].attrs[attribute] if attribute else dataset(file, group)[()]
    values = np.ravel(stored)
    if ref.kind == _STACKED and len(values) > 1:
        values = values[ref.offset :]
    time = np.nan
    if len(values) and values.dtype.kind in "fiu":
        time = float(values[0])
    if not np.isfinite(time):
        raise SceneError(f"{source_of(ref)}: {filled!r} does not hold the time of this step")
    if convert and not attribute:
        time *= _factor(file, group, "time")
    return time


# --- the rows of a step ----------------------------------------------------------------------------------


def _values(file: h5py.File, path: str, ref: StepRef, part: int | None) -> NDArray:
    """Return the numbers of a step (n,), of one component of a vector."""
    values = []
    for member in _members(file, path):
        data = dataset(file, member)
        selection: list[int | slice] = [slice(None)]
        if part is not None:
            selection.append(part)
        if len(data.shape) > len(selection):
            selection.insert(0, ref.offset)
        values.append(np.asarray(data[tuple(selection)], "float64"))
    joined = np.concatenate(values)
    if joined.shape != (ref.rows,):
        raise SceneError(
            f"{source_of(ref)}: {path!r} has {joined.shape} values, and {ref.rows} rows were promised"
        )
    return joined


def _numbers_of_members(file: h5py.File, path: str, first: str, ref: StepRef) -> NDArray:
    """Return for each row the number of the member of a group that it is from.

    The number is the name of the member; names that are words are numbered in their order, from 1
    on.
    """
    group = path.removesuffix("*")
    members = _members(file, first)
    if not first.startswith(path + "/"):
        raise SceneError(
            f"{source_of(ref)}: {path!r} is no group of the positions, {first!r}; a path that ends in "
            "'*' numbers the types that '*' stands for there"
        )
    names = [member[len(group) :].partition("/")[0] for member in members]
    numbers = [float(k) for k in range(1, len(names) + 1)]
    if all(name.isdecimal() for name in names):
        numbers = [float(name) for name in names]
    axis = 1 if ref.kind == _STACKED else 0
    counts = [dataset(file, member).shape[axis] for member in members]
    return np.repeat(numbers, counts)
