"""LAMMPS dumps: text, binary or NetCDF for particles, and rows of pairs for contacts; text of LIGGGHTS, too."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, compress
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers import wall_columns
from xcg.readers.assigned import FEWEST_OF_LIGGGHTS, unread_by_number
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines import lammps_binary, lammps_netcdf
from xcg.readers.engines.lammps_binary import with_bounds
from xcg.readers.files.text import (
    Scanner,
    check_rows,
    compression,
    first_lines,
    scanned,
    source_of,
    uncompressed_size,
)
from xcg.readers.names import is_of_liggghts
from xcg.readers.paths import index_steps
from xcg.scene.schema import COMPONENTS, Frame
from xcg.steps import faults as errors

# boundaries in a header: LAMMPS' two letters, one for each face, and words of other programs
_PERIODIC = {"pp", "p", "periodic", "per", "pbc", "t", "true", "1", "yes"}
_OPEN = {a + b for a in "fsm" for b in "fsm"} | {
    "f", "s", "m", "fixed", "open", "wall", "none", "shrink", "nonperiodic", "false", "0", "no",
}  # fmt: skip
_WALLS = "walls"  # kind of a step whose contacts stand in columns of the particles


class Dumps(Columnar):
    """Base class of the engines of dumps."""

    OPTIONS = ("timestep",)

    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps of ``dump custom`` files, or of local dumps with contacts.

        A file is read through only where it may hold several steps: not where its name holds the
        number of its first step and its size is that of one step.
        """
        atoms = not contacts
        scan = partial(_steps, atoms=atoms)
        return index_steps(paths, f"dump {atoms=}", scan, options.extra.get("timestep"))

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read columns of one step, in whatever form it is written.

        Raises
        ------
        SceneError
            If a column occurs twice in a text, with other values.
        """
        form = form_of(ref.path)
        if form:
            return form.read_columns(ref, wanted)
        wanted = list(wanted)
        twins = {name: _twins(ref, name, options) for name in wanted}
        table = super().read_columns(ref, [*wanted, *chain(*twins.values())], rows, options)
        for name, others in twins.items():
            for other in others:
                row = np.flatnonzero(table[name] != table[other])
                if row.size:
                    raise SceneError(
                        f"{source_of(ref)}: two columns are called {name!r}, and in row {row[0]} one is "
                        f"{table[name][row[0]]:g} and the other {table[other][row[0]]:g}; drop the second by "
                        f"names={{{other!r}: None}}, or take it in place of the first by names={{{name!r}: None, "
                        f"{other!r}: ...}}"
                    )
        return table

    def columns_read(self, ref: StepRef, options: ReadOptions, *, contacts: bool) -> dict[str, str]:
        """Return the slot of each column that is read, including walls and repeated columns."""
        if ref.kind == _WALLS:  # the particles are reported
            return dict.fromkeys(ref.columns, _WALLS)
        of_walls = {
            name: wall
            for wall, names in wall_columns.columns_of_walls(options).items()
            for name in names
        }
        read = super().columns_read(ref, options, contacts=contacts)
        twins = [name for name in ref.columns if _TWIN in name]  # named as a column before
        return dict.fromkeys(twins, "copy") | of_walls | read


class Lammps(Dumps):
    """Dumps of LAMMPS."""

    UNNAMED_UNITS = "have the files say it by 'dump_modify ... units yes'; for files of LIGGGHTS give engine='liggghts'"
    WHOLE_FORCES = "map the others with names={'column': 'tangential_force_x', ...}"

    def recognises(self, path: str) -> bool:
        """Return whether the file begins as a LAMMPS dump, and not as one that only LIGGGHTS writes."""
        if form_of(path):
            return True
        columns = body_columns(path)
        if columns is None or ".liggghts" in path:
            return False
        if len(set(columns)) < len(columns):  # as in what LIGGGHTS's tutorials write
            return False
        if is_of_liggghts(columns):
            return False
        return not is_numbered(columns) or len(columns) < FEWEST_OF_LIGGGHTS

    def wall_step(self, ref: StepRef, options: ReadOptions) -> StepRef:
        """Return the contacts with walls of a step; each grain may touch each wall once."""
        walls = wall_columns.wall_columns(ref, options)
        return replace(ref, kind=_WALLS, rows=ref.rows * len(walls))

    def unread_forces(self, ref: StepRef, options: ReadOptions) -> str:
        """Return a hint about columns that may hold the rest of the contact forces; "" without such columns."""
        if ref.kind == _WALLS:
            return ""
        return unread_by_number(ref, self.contact_columns(ref, options), options)

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """Names of the variables that `read_contacts` returns."""
        if ref.kind == _WALLS:
            return list(wall_columns.WALL_CONTACTS)
        return super().contact_variables(ref, options)

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the contacts of one step: those between grains, or those in columns of the grains."""
        if ref.kind == _WALLS:
            options = options.of_kind("particles")
            return wall_columns.wall_contacts_from(ref, options, self.read_columns)
        return super().read_contacts(ref, options)


# --- the index of steps, and the headers of texts ("ITEM: ...") ------------------------------------------

_FORMS = (lammps_binary, lammps_netcdf)
# how the other items of a header begin
_NO_BODY = ("UNITS", "TIME", "TIMESTEP", "NUMBER OF", "BOX BOUNDS")
_LONGEST_HEADER = 1 << 20  # bytes
_LARGEST = 2**63  # steps are int64
_MOST_COLUMNS = 1000
_TWIN = " (column "  # in the names of columns that occur before
# bytes of a body and of its end, by which it is seen whether more follows
_SAMPLE = 1 << 14
_TAIL = 1 << 16


def form_of(path: str) -> ModuleType | None:
    """Return the module that reads a binary dump; None for texts and other files."""
    with open(path, "rb") as file:
        head = file.read(64)
    return next((form for form in _FORMS if head.startswith(tuple(form.MARKS))), None)


def body_columns(path: str) -> list[str] | None:
    """Return the columns of the first body of a dump; None where it is not a dump."""
    lines = first_lines(path)
    if not lines or not lines[0].startswith("ITEM:"):
        return None
    for line in lines:
        item = line.removeprefix("ITEM:").strip()
        if line.startswith("ITEM:") and item and not item.startswith(_NO_BODY):
            return item.split()[1:]
    return None


def without_index(names: Sequence[str]) -> Sequence[str]:
    """Return the names of columns without the number of the row, which comes first or not at all."""
    return names[1:] if names[:1] in (["index"], ("index",)) else names


def is_numbered(names: Sequence[str]) -> bool:
    """Return whether columns have numbers instead of names (``c_3[1] c_3[2] ...``), as LIGGGHTS writes contacts."""
    names = without_index(names)
    compute = names[0].removesuffix("[1]") if names else ""
    return list(names) == [f"{compute}[{k}]" for k in range(1, len(names) + 1)]


def _steps(path: str, *, atoms: bool) -> Iterator[StepRef]:
    form = form_of(path)
    units = None
    if form and not atoms:
        raise SceneError(
            f"{path}: LAMMPS writes particles in this form, and contacts as text; is this a file for particles=?"
        )
    if form:
        yield from form.steps_of(path)
        return
    with scanned(path) as scanner:
        while True:
            start = scanner.offset
            try:
                ref = _header(scanner, path, atoms=atoms)
                if ref is None:
                    return
                check_rows(ref)
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
    """Return whether a step is the only one in its file, from its name and the length of some of its rows.

    Of a compressed file, these are the first ones. Another step after it makes the file longer, or
    is seen among the last bytes of a plain one.
    """
    numbers = [int(number) for number in re.findall(r"\d+", os.path.basename(ref.path))]
    if ref.step not in numbers or ref.rows == 0 or rest < 0:
        return False
    if compression(ref.path):
        sample = scanner.sample(_SAMPLE)
        lines = sample.count(b"\n")
        return lines > 0 and rest < 1.5 * ref.rows * (sample.rindex(b"\n") + 1) / lines
    samples = b""
    with open(ref.path, "rb") as file:
        for offset in (0, rest // 2, max(0, rest - _SAMPLE)):
            file.seek(ref.offset + offset)
            block = file.read(_SAMPLE)
            begin = 0
            if offset:  # within a line
                begin = block.find(b"\n") + 1
            samples += block[begin : block.rfind(b"\n") + 1]
        lines = samples.count(b"\n")
        if not lines or rest >= 1.03 * ref.rows * len(samples) / lines + _SAMPLE:
            return False
        file.seek(ref.offset + max(0, rest - max(_TAIL, rest // 32)))
        return b"\nITEM:" not in file.read()


def _header(scanner: Scanner, path: str, *, atoms: bool) -> StepRef | None:
    """Read one header, whatever the order of its items; None at the end of the file."""
    ref = empty = StepRef(path, rows=-1)
    start = scanner.offset
    while line := scanner.line().decode("utf-8", "replace"):
        if not line.strip():
            continue
        if not line.startswith("ITEM:"):
            before = f"before byte {scanner.offset}"
            raise SceneError(
                f"{path}: expected a line that begins with 'ITEM:' {before}, found {line.strip()[:60]!r}"
            )
        if scanner.offset - start > _LONGEST_HEADER:
            raise SceneError(
                f"{path}: the header that begins at byte {start} has no end in {_LONGEST_HEADER} bytes; it is damaged"
            )
        item = line.removeprefix("ITEM:").strip()
        if not item.startswith(_NO_BODY):
            _check_header(ref, item.split(), atoms=atoms)
            return replace(ref, columns=_apart(item.split()[1:]), offset=scanner.offset)
        read = _box if item.startswith("BOX BOUNDS") else _value
        ref = read(ref, scanner, item)
    if ref is empty:
        return None
    raise SceneError(
        f"{path}: the header of step {ref.step} is cut off; leave out the step or the file"
    )


def _value(ref: StepRef, scanner: Scanner, item: str) -> StepRef:
    """Add an item of one value."""
    value = scanner.line().decode("utf-8", "replace").strip()
    if item == "UNITS":
        return replace(ref, units=value.lower())
    try:
        number: Any = float(value)
        if item != "TIME" and number.is_integer():  # some programs write 1000.0
            number = int(number) if "." in value or "e" in value.lower() else int(value)
        if not abs(number) < _LARGEST or (item != "TIME" and isinstance(number, float)):
            raise ValueError  # NaN, too
    except (ValueError, OverflowError):
        expected = "a number" if item == "TIME" else "a whole number"
        raise SceneError(
            f"{ref.path}: {value[:60]!r} follows 'ITEM: {item}', expected {expected}"
        ) from None
    return replace(ref, **{{"TIME": "time", "TIMESTEP": "step"}.get(item, "rows"): number})


def _check_header(ref: StepRef, words: list[str], *, atoms: bool) -> None:
    label = words[0] if words else ""
    columns = len(words) - 1
    kind, argument = ("ATOMS", "contacts") if atoms else ("ENTRIES", "particles")
    if label in ("DIMENSION", "GRID"):
        msg = "a grid (dump grid) holds no particles; open the files of 'dump custom'"
    elif (label == "ATOMS") is not atoms:
        msg = f"found 'ITEM: {label}', expected 'ITEM: {kind}'; is this a file for {argument}=?"
    elif ref.rows < 0:
        msg = "the header does not say how many rows follow ('ITEM: NUMBER OF ...')"
    elif columns < 1:
        msg = f"'ITEM: {label}' names no columns"
    elif columns > _MOST_COLUMNS:
        msg = f"'ITEM: {label}' names {columns} columns, expected {_MOST_COLUMNS} at most"
    else:
        return
    raise SceneError(f"{source_of(ref)}: {msg}")


def _apart(names: Sequence[str]) -> tuple[str, ...]:
    """Return unique names of columns: repeated ones get the number of their column."""
    unique = list(names)
    for k, name in enumerate(names):
        if name in names[:k]:
            unique[k] = f"{name}{_TWIN}{k + 1})"
    return tuple(unique)


def _twins(ref: StepRef, name: str, options: ReadOptions) -> list[str]:
    """Return the columns of the same name as one, unless the caller maps them."""
    return [
        column
        for column in ref.columns
        if column.startswith(name + _TWIN) and column not in options.names
    ]


def _box(ref: StepRef, scanner: Scanner, item: str) -> StepRef:
    flags = re.findall(r"[^\s,;'\"()\[\]]+", item.casefold())[2:]
    lines = [scanner.line().decode("utf-8", "replace").split() for _ in COMPONENTS]
    if "abc" in flags:
        raise SceneError(
            f"{ref.path}: the box is written by vectors in any direction ('{item}'); write it by tilts, which LAMMPS "
            "does after 'dump_modify ... triclinic/general no'"
        )
    expected = "two numbers, the lower first"
    numbers_a_line = 2
    if flags[:3] == ["xy", "xz", "yz"]:
        expected = "three numbers, the bounds and a tilt"
        numbers_a_line = 3
        flags = flags[3:]
    try:
        numbers = np.array([[float(word) for word in line] for line in lines])
        if numbers.shape != (3, numbers_a_line) or not np.isfinite(numbers).all():
            raise ValueError
        low, high, *tilts = numbers.T
        ref = with_bounds(ref, low, high, *tilts)
    except ValueError:
        raise SceneError(
            f"{ref.path}: {lines} follow 'ITEM: {item}', expected three lines of {expected}"
        ) from None
    if flags[:3] == ["xx", "yy", "zz"]:  # of the three lines
        flags = flags[3:]
    if len(flags) == 1:
        flags *= len(COMPONENTS)
    if len(flags) == len(COMPONENTS) and {*flags} <= _PERIODIC | _OPEN:
        wraps = [flag in _PERIODIC for flag in flags]
        return replace(ref, periodic="".join(compress(COMPONENTS, wraps)))
    # files of other codes, and old ones, do not say what is periodic
    words = f"{item!r}{'' if flags else ' without flags'} (pp is periodic, ff open)"
    return replace(ref, unknown=((words, "periodic='xyz', or ''"),))
