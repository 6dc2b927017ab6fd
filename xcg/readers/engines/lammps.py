"""LAMMPS and LIGGGHTS dumps: text, binary or NetCDF for particles, and rows of pairs for contacts."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from types import ModuleType
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from xcg.common.checks import is_positive
from xcg.common.messages import SceneError, warn_user
from xcg.readers import columns
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines import lammps_binary, lammps_netcdf
from xcg.readers.engines.lammps_binary import with_bounds
from xcg.readers.files.text import (
    Scanner,
    check_rows,
    compression,
    first_lines,
    is_one_table,
    most_from,
    most_text,
    open_binary,
    source_of,
    uncompressed_size,
)
from xcg.readers.paths import remembered
from xcg.scene.schema import COMPONENTS, Frame
from xcg.steps import faults as errors

_WALLS = "walls"  # kind of a step whose contacts stand in columns of the particles


class Dumps(Columnar):
    """Base class of the engines of dumps."""

    OPTIONS = ("timestep",)

    def index_particles(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``dump custom`` files."""
        refs = index_dumps(paths, options, atoms=True)
        columns.warn_of_ignored(refs[0], self.particle_columns(refs[0], options), columns.PARTICLE_SLOTS, options)
        return refs

    def unread_forces(self, ref: StepRef, options: ReadOptions) -> str:
        """Return a hint about columns that may hold the rest of the contact forces; "" without such columns."""
        return columns.unread_by_number(ref, self.contact_columns(ref, options), options)

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read columns of one step, in whatever form it is written."""
        form = form_of(ref.path)
        return form.read_columns(ref, wanted) if form else super().read_columns(ref, wanted, rows, options)


class Lammps(Dumps):
    """Dumps of LAMMPS."""

    UNNAMED_UNITS = "have the files say it by 'dump_modify ... units yes'"

    def recognises(self, path: str) -> bool:
        """Return whether the file begins as a LAMMPS dump, and not as one that only LIGGGHTS writes."""
        if form_of(path):
            return True
        found = body_columns(path)
        return found is not None and ".liggghts" not in path and not is_numbered(found[1])

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``dump local`` files."""
        refs = index_dumps(paths, options, atoms=False)
        found = self.contact_columns(refs[0], options)
        columns.warn_of_ignored(refs[0], found, columns.CONTACT_SLOTS, options)
        if "normal_force_x" in found and "tangential_force_x" not in found:
            warn_user(
                f"{source_of(refs[0])}: only normal forces ({found['normal_force_x']}, ...) were found, and they are "
                "taken as the contact forces; map the others with names={'column': 'tangential_force_x', ...}"
            )
        return refs

    def wall_step(self, ref: StepRef, options: ReadOptions) -> StepRef:
        """Return the contacts with walls of a step; each grain may touch each wall once."""
        return replace(ref, kind=_WALLS, rows=ref.rows * len(columns.wall_columns(ref, options)))

    def unread_forces(self, ref: StepRef, options: ReadOptions) -> str:
        """Return a hint about columns that may hold the rest of the contact forces; "" without such columns."""
        return "" if ref.kind == _WALLS else super().unread_forces(ref, options)

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """Names of the variables that `read_contacts` returns."""
        return list(columns.WALL_CONTACTS) if ref.kind == _WALLS else super().contact_variables(ref, options)

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the contacts of one step: those between grains, or those in columns of the grains."""
        if ref.kind == _WALLS:
            return columns.wall_contacts_from(ref, options, self.read_columns)
        return super().read_contacts(ref, options)

    def ignored_columns(self, ref: StepRef, options: ReadOptions, *, contacts: bool = False) -> list[str]:
        """Columns of a step that are not read."""
        if ref.kind == _WALLS:
            return []
        walls = () if contacts else columns.columns_of_walls(ref, options)
        return [name for name in super().ignored_columns(ref, options, contacts=contacts) if name not in walls]


def _vector(slot: str, first: int) -> dict[str, int]:
    return {f"{slot}_{axis}": first + k for k, axis in enumerate(COMPONENTS)}


# Positions give the normal, with other digits than the particles' where a pair crosses a periodic boundary. The flag
# of such pairs is not read: it misses some and marks others that do not cross.
_PAIR = {
    "contact_i": 6,
    "contact_j": 7,
    **_vector("end_i", 0),
    **_vector("end_j", 3),
    **_vector("contact_force", 9),
    "overlap": 12,
}
_WALL = {
    "contact_i": 8,
    "contact_j": 6,
    **_vector("contact_point", 0),
    **_vector("end_i", 3),
    **_vector("end_j", 0),
    **_vector("contact_force", 9),
    "overlap": 12,
}


class Liggghts(Dumps):
    """Dumps of LIGGGHTS, whose axes of superquadrics are halves, where those of LAMMPS are whole."""

    PARTICLE_SLOTS: ClassVar[columns.Slots] = {
        **columns.PARTICLE_SLOTS,
        **{f"half_axis_{axis}": (f"shape{axis}",) for axis in COMPONENTS},
        **{f"whole_axis_{axis}": () for axis in COMPONENTS},
    }

    def recognises(self, path: str) -> bool:
        """Return whether the first lines identify a dump; local ones have numbered columns."""
        found = body_columns(path)
        return found is not None and (found[0] == "ATOMS" or is_numbered(found[1]))

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``pair/gran/local`` files."""
        refs = index_dumps(paths, options, atoms=False)
        self.contact_columns(refs[0], options)
        return refs

    def index_walls(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``wall/gran/local`` files."""
        refs = [replace(ref, kind="wall") for ref in index_dumps(paths, options, atoms=False)]
        self.contact_columns(refs[0], options)
        return refs

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the contacts of one step; mesh k is the partner -(k + 1)."""
        frame = super().read_contacts(ref, options)
        if ref.kind == "wall":
            frame["contact_j"] = -(frame["contact_j"] + 1)
        return frame

    def contact_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the columns that contacts are read from, by their place where they have numbers for names."""
        if not is_numbered(ref.columns):
            return super().contact_columns(ref, options)
        layout = _WALL if ref.kind == "wall" else _PAIR
        slots: columns.Slots = dict.fromkeys(columns.CONTACT_SLOTS, ()) | {
            slot: ref.columns[at : at + 1] for slot, at in layout.items()
        }
        return columns.contact_columns(ref, slots, options)


# --- the index of steps, and the headers of texts ("ITEM: ...") ------------------------------------------

_FORMS = (lammps_binary, lammps_netcdf)


def form_of(path: str) -> ModuleType | None:
    """Return the module that reads a binary dump; None for texts and other files."""
    with open(path, "rb") as file:
        head = file.read(64)
    return next((form for form in _FORMS if form.begins(head)), None)


def body_columns(path: str) -> tuple[str, tuple[str, ...]] | None:
    """Label and columns of the first body of a dump ("ATOMS", ("id", ...)), None where it is not a dump."""
    lines = first_lines(path)
    if not lines or not lines[0].startswith("ITEM:"):
        return None
    for line in lines:
        item = line.removeprefix("ITEM:").split()
        if line.startswith("ITEM:") and item and _is_body(" ".join(item)):
            return item[0], tuple(item[1:])
    return None


def is_numbered(names: Sequence[str]) -> bool:
    """Return whether columns have numbers instead of names (``c_3[1] c_3[2] ...``), as LIGGGHTS writes contacts."""
    return len(names) in (12, 13) and all(re.fullmatch(rf"\w+\[{k}\]", name) for k, name in enumerate(names, 1))


def _is_body(item: str) -> bool:
    return item not in ("UNITS", "TIME", "TIMESTEP") and not item.startswith(("NUMBER OF", "BOX BOUNDS"))


def index_dumps(paths: Sequence[str], options: ReadOptions, *, atoms: bool) -> list[StepRef]:
    """List the steps of dump files.

    A file is read through only where it may hold several steps: not where its name holds the number of its
    first step and its size is that of one step.

    Parameters
    ----------
    atoms : bool
        True for per-atom dumps (``ITEM: ATOMS``), False for local ones.
    """
    timestep = options.extra.get("timestep")
    refs: list[StepRef] = []
    found = remembered(paths, f"dump {atoms=}", partial(_steps, atoms=atoms))
    for path, steps in zip(paths, found, strict=True):
        refs += steps
        if not steps:
            errors.raise_or_record(path, SceneError(f"{path}: the file is empty; expected a dump. Leave it out"))
    if paths and not refs:
        errors.raise_recorded()
    if timestep is None:
        return refs
    if not is_positive(timestep):
        raise SceneError(f"timestep={timestep!r}: expected a positive number, the time between two steps")
    return [ref if ref.time is not None else replace(ref, time=ref.step * float(timestep)) for ref in refs]


def _steps(path: str, *, atoms: bool) -> Iterator[StepRef]:
    form = form_of(path)
    if form is None:
        yield from _steps_of_text(path, atoms=atoms)
    elif atoms:
        yield from form.steps_of(path)
    else:
        raise SceneError(
            f"{path}: LAMMPS writes particles in this form, and contacts as text; is this a file for particles=?"
        )


def _steps_of_text(path: str, *, atoms: bool) -> Iterator[StepRef]:
    units = None
    with open_binary(path) as stream:
        scanner = Scanner(stream, path, most_text(path))
        while True:
            start = scanner.offset
            try:
                ref = _header(scanner, path, atoms=atoms)
                if ref is None:
                    return
                check_rows(ref, most_from(path) - ref.offset)
                units = ref.units or units  # LAMMPS writes the units once a file
                ref = replace(ref, units=units)
                rest = uncompressed_size(path) - ref.offset
                if _is_alone(ref, rest, scanner):
                    yield replace(ref, length=rest, alone=True)
                    return
                ref = replace(ref, length=sum(map(len, scanner.until(b"ITEM:"))))
                check_rows(ref, ref.length)
                yield ref
            except SceneError as error:
                if not errors.record_fault(f"{path} from byte {start} on", error):
                    raise
                for _ in scanner.until(b"ITEM: TIMESTEP"):  # the next step may be whole
                    pass


def _is_alone(ref: StepRef, rest: int, scanner: Scanner) -> bool:
    """Return whether a step is the only one in its file, from its name and the length of its first rows."""
    numbers = [int(number) for number in re.findall(r"\d+", os.path.basename(ref.path))]
    if ref.step not in numbers or ref.rows == 0 or rest < 0:
        return False
    if not compression(ref.path):
        return is_one_table(ref.path, ref.offset, ref.rows, b"\nITEM:")
    first = scanner.sample(1 << 14)
    lines = first.count(b"\n")
    return lines > 0 and rest < 1.5 * ref.rows * (first.rindex(b"\n") + 1) / lines


def _header(scanner: Scanner, path: str, *, atoms: bool) -> StepRef | None:
    """Read one header, whatever the order of its items; None at the end of the file."""
    ref = empty = StepRef(path, rows=-1)
    start = scanner.offset
    while line := scanner.line().decode("utf-8", "replace"):
        if not line.strip():
            continue
        if not line.startswith("ITEM:"):
            before = f"before byte {scanner.offset}"
            raise SceneError(f"{path}: expected a line that begins with 'ITEM:' {before}, found {line.strip()[:60]!r}")
        if scanner.offset - start > _LONGEST_HEADER:
            raise SceneError(
                f"{path}: the header that begins at byte {start} has no end in {_LONGEST_HEADER} bytes; it is damaged"
            )
        item = line.removeprefix("ITEM:").strip()
        if _is_body(item):
            _check_header(ref, item.split(), atoms=atoms)
            return replace(ref, columns=tuple(item.split()[1:]), offset=scanner.offset)
        ref = _box(ref, scanner, item) if item.startswith("BOX BOUNDS") else _value(ref, scanner, item)
    if ref is empty:
        return None
    raise SceneError(f"{path}: the header of step {ref.step} is cut off; leave out the step or the file")


_LONGEST_HEADER = 1 << 20  # bytes
_LARGEST = 2**63  # steps are int64
_MOST_COLUMNS = 1000


def _finite(text: str) -> float:
    value = float(text)
    if not np.isfinite(value):
        raise ValueError
    return value


def _value(ref: StepRef, scanner: Scanner, item: str) -> StepRef:
    """Add an item of one value."""
    value = scanner.line().decode("utf-8", "replace").strip()
    try:
        if item == "UNITS":
            return replace(ref, units=value)
        if item == "TIME":
            return replace(ref, time=_finite(value))
        number = int(value)
        if not -_LARGEST < number < _LARGEST:
            raise ValueError
        return replace(ref, step=number) if item == "TIMESTEP" else replace(ref, rows=number)
    except ValueError:
        raise SceneError(f"{ref.path}: {value[:60]!r} follows 'ITEM: {item}', expected a number") from None


def _check_header(ref: StepRef, words: list[str], *, atoms: bool) -> None:
    label, names = words[0] if words else "", words[1:]
    twice = sorted(column for column, count in Counter(names).items() if count > 1)
    if (label == "ATOMS") is not atoms:
        kind, argument = ("ATOMS", "contacts") if atoms else ("ENTRIES", "particles")
        msg = f"{source_of(ref)}: found 'ITEM: {label}', expected 'ITEM: {kind}'; is this a file for {argument}=?"
    elif ref.rows < 0:
        msg = f"{source_of(ref)}: the header does not say how many rows follow ('ITEM: NUMBER OF ...')"
    elif not names:
        msg = f"{source_of(ref)}: 'ITEM: {label}' names no columns"
    elif len(names) > _MOST_COLUMNS:
        msg = f"{source_of(ref)}: 'ITEM: {label}' names {len(names)} columns, expected {_MOST_COLUMNS} at most"
    elif twice:
        msg = f"{source_of(ref)}: columns {twice[:10]} occur twice; name them apart, as with dump_modify colname"
    else:
        return
    raise SceneError(msg)


def _box(ref: StepRef, scanner: Scanner, item: str) -> StepRef:
    flags = item.split()[2:]
    lines = [scanner.line().decode("utf-8", "replace").split() for _ in COMPONENTS]
    if "abc" in flags:
        raise SceneError(
            f"{ref.path}: the box is written by vectors in any direction ('{item}'); write it by tilts, which LAMMPS "
            "does after 'dump_modify ... triclinic/general no'"
        )
    tilted, flags = flags[:3] == ["xy", "xz", "yz"], [flag for flag in flags if flag not in ("xy", "xz", "yz")]
    try:
        low, high, *tilts = np.array([[_finite(word) for word in line] for line in lines]).T
        if len(tilts) != tilted:
            raise ValueError
        ref = with_bounds(ref, low, high, tilts[0].tolist() if tilted else None)
    except ValueError:
        what = "three lines of " + (
            "three numbers, the bounds and a tilt" if tilted else "two numbers, the lower first"
        )
        raise SceneError(f"{ref.path}: {lines} follow 'ITEM: {item}', expected {what}") from None
    if len(flags) != len(COMPONENTS):
        return ref  # old files do not say what is periodic
    periodic = "".join(axis for axis, flag in zip(COMPONENTS, flags, strict=True) if flag == "pp")
    return replace(ref, periodic=periodic)
