"""XYZ: plain, and extended as ASE and OVITO write it; one or many frames in a file.

A frame is the number of its rows, a comment, and the rows. The comment of extended XYZ is a list
of ``key=value``: ``Properties=species:S:1:pos:R:3`` names the columns, and there may be a
``Lattice``, ``Origin``, ``pbc`` and a time. Plain XYZ has a species and the position in each row.
Species that are words are numbered in alphabetical order, over all files.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_user
from xcg.readers.cells import box_of_cell
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.filenames import suffix_of
from xcg.readers.files.table import read_table
from xcg.readers.files.text import (
    Scanner,
    body_of,
    check_rows,
    first_lines,
    scanned,
    source_of,
)
from xcg.readers.names import CLOCK_SLOTS, canonical, vector_columns
from xcg.readers.paths import index_steps
from xcg.scene.schema import COMPONENTS

_SUFFIXES = (".xyz", ".extxyz", ".exyz")
_MOST_COLUMNS = 1000
_MOST_SPECIES = 1000
_SPECIES = "species"
_PLAIN = (_SPECIES, *COMPONENTS)

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
_ENTRY = re.compile(
    r"""([\w.-]+)\s*=\s*("(?:[^"\\]|\\.)*"|'[^']*'|\{[^}]*\}|\[.*?\](?!\s*[,\]])|\S+)"""
)
# in comments of plain XYZ; T is a temperature
_TIME = re.compile(rf"(?:\b(?i:time)\s*[=:]?|\bt\s*[=:])\s*({_NUMBER})(?![\w.])")
_STEP = re.compile(r"(?:\b(?i:time_?step|step|frame|iteration)\s*[=:]?|\bi\s*=)\s*(\d+)(?![\w.])")
_REAL = re.compile(r"[-+]?\d*\.\d*(e[-+]?\d+)?", re.IGNORECASE)
_NO_SPECIES = (
    "the first column of plain XYZ is the species. If it is the id of the particle, say "
    "names={'species': 'particle_id'}; if it is x, say names={'species': 'position_x', "
    "'x': 'position_y', 'y': 'position_z', 'z': None}"
)
_LIKE_LATTICE = ("cell", "box", "boxsize", "boxlengths", "celllengths", "domain", "period")
_EDGES = "box=[[x0, x1], [y0, y1], [z0, z1]], periodic='xyz'"
_TRUE = ("t", "true", "1")
_FALSE = ("f", "false", "0")


class Xyz(Columnar):
    """Plain and extended XYZ."""

    OPTIONS = ("timestep",)
    NEEDS_ID = False

    def recognises(self, path: str) -> bool:
        """Return whether the first line is a number of rows, and the name or the second line XYZ's."""
        lines = first_lines(path)[:2]
        if len(lines) < 2 or not re.fullmatch(r"\s*\d+\s*", lines[0]):
            return False
        extended = re.search(r"\b(Properties|Lattice)\s*=", lines[1], re.IGNORECASE)
        return bool(extended) or suffix_of(path) in _SUFFIXES

    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps of all files, with the species of all of them in each."""
        if contacts:
            raise SceneError(
                f"contacts={paths[0]!r}: XYZ holds particles only; put contacts into a CSV file and "
                "the particles into another, engine='table', or use xcg.scene_from_arrays"
            )
        with_species = options.names.get(_SPECIES, _SPECIES) == _SPECIES
        refs = index_steps(
            paths,
            f"xyz {with_species}",
            partial(_steps, with_species=with_species),
            options.extra.get("timestep"),
        )
        _warn_of_unnamed(refs[0], options)
        words = sorted({word for ref in refs for word in ref.kind.split()})
        real = next(filter(_REAL.fullmatch, words), None)
        if real is not None:
            raise SceneError(
                f"{refs[0].path}: the species {real!r} is a real number; {_NO_SPECIES}"
            )
        if len(words) == refs[0].rows > 2:
            warn_user(
                f"{refs[0].path}: each row has a species of its own, such as {words[0]!r}; if these are "
                "the ids of the particles, say names={'species': 'particle_id'}"
            )
        if all(word.isdecimal() for word in words):
            return [replace(ref, kind="") for ref in refs]
        if len(words) > 1:
            numbered = [f"{k}: {word!r}" for k, word in enumerate(words[:20], 1)]
            if len(words) > 20:
                numbered.append("...")
            warn_user(
                f"{refs[0].path}: species are words and are numbered in alphabetical order: "
                f"{', '.join(numbered)}"
            )
        return [replace(ref, kind=" ".join(words)) for ref in refs]

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read columns of one step; species that are words become numbers."""
        numeric = set(wanted)
        if not ref.kind or _SPECIES not in numeric:
            return read_table(ref, numeric, rows, options)
        table = read_table(ref, numeric - {_SPECIES}, rows, options)
        return table | {_SPECIES: _numbers_of_species(ref)}


def _warn_of_unnamed(ref: StepRef, options: ReadOptions) -> None:
    """Warn of columns of plain XYZ that have no names, or raise SceneError where none has."""
    unnamed = [name for name in ref.columns if name.startswith("column_")]
    unread = [name for name in unnamed if name not in options.names]
    if unread and len(unnamed) == len(ref.columns):
        raise SceneError(
            f"{source_of(ref)}: the {len(ref.columns)} columns of plain XYZ have no names, and the first "
            "is no species; name them, names={'column_1': 'position_x', 'column_2': 'position_y', "
            "'column_3': 'position_z', 'column_4': 'radius', ...}, or drop some, {'column_5': None}"
        )
    if unread:
        warn_user(
            f"{source_of(ref)}: columns {' '.join(unread)} of plain XYZ have no names and are not "
            f"read; name them, for example names={{{unread[0]!r}: 'radius'}}, or drop them by None"
        )


def _numbers_of_species(ref: StepRef) -> NDArray:
    """Return the number of each row's species among the sorted words of `ref.kind`, from 1 on."""
    column = ref.columns.index(_SPECIES)
    numbers = {word: float(number) for number, word in enumerate(ref.kind.split(), 1)}
    lines = b"".join(body_of(ref)).decode("utf-8", "replace").split("\n")
    species = [line.split()[column] for line in lines if line.strip()]
    unknown = set(species) - set(numbers)
    if unknown:
        raise SceneError(
            f"{source_of(ref)}: the species {min(unknown)!r} was not in the file when it was "
            "opened; open it again"
        )
    return np.array([numbers[word] for word in species])


# --- the index -------------------------------------------------------------------------------------


def _steps(path: str, *, with_species: bool) -> Iterator[StepRef]:
    """Yield the frames of a file; `kind` of each lists its species where these may be words."""
    with scanned(path) as scanner:
        while line := scanner.line():
            if not line.strip():
                continue
            at = scanner.offset - len(line)
            if not re.fullmatch(rb"\s*\d{1,10}\s*", line):
                shown = line.decode("utf-8", "replace").strip()[:60]
                raise SceneError(
                    f"{path} from byte {at}: expected the number of rows of a frame, found {shown!r}"
                )
            rows = int(line)
            comment = scanner.line().decode("utf-8-sig", "replace").strip()
            yield _frame(scanner, StepRef(path, rows, step=-1), comment, with_species=with_species)


def _frame(scanner: Scanner, ref: StepRef, comment: str, *, with_species: bool) -> StepRef:
    """Return a frame with what its comment says, after passing its rows."""
    entries = {
        canonical(key): value.strip("\"'{}").strip() for key, value in _ENTRY.findall(comment)
    }
    source = f"{ref.path} from byte {scanner.offset}"
    properties = entries.get("properties")
    names: tuple[str, ...] = _PLAIN
    if properties is not None:
        names = _names_of_properties(properties, source)
    elif ref.rows:
        names = _names_of_plain(scanner.sample(1 << 16))
    ref = replace(ref, offset=scanner.offset, columns=names, **_clock(entries, comment))
    ref = replace(ref, **_box(entries, source))
    may_be_words = properties is None or "species:s:1" in properties.lower()
    column = None
    if with_species and may_be_words and _SPECIES in names:
        column = names.index(_SPECIES)
    words = _pass_rows(scanner, ref, column)
    ref = replace(ref, length=scanner.offset - ref.offset, kind=" ".join(sorted(words)))
    check_rows(ref, ref.length)
    return ref


def _pass_rows(scanner: Scanner, ref: StepRef, column: int | None) -> set[str]:
    """Move behind the rows of a frame, and return the species in a column (`column`)."""
    species: set[bytes] = set()
    for row in range(ref.rows):
        words = scanner.line().split(None, (column or 0) + 1)
        if not words:
            raise SceneError(
                f"{ref.path}: {row} rows from byte {ref.offset}, but the frame promises {ref.rows}; "
                "the file is cut off or damaged. Write it again, or leave it out"
            )
        if column is not None:
            species.add(words[min(column, len(words) - 1)])
        if len(species) > _MOST_SPECIES:
            raise SceneError(
                f"{ref.path}: more than {_MOST_SPECIES} species from byte {ref.offset}; {_NO_SPECIES}"
            )
    return {word.decode("utf-8", "replace") for word in species}


def _names_of_properties(text: str, source: str) -> tuple[str, ...]:
    """Return the names of all columns: ``pos:R:3`` becomes pos_x, pos_y and pos_z."""
    words = text.split(":")
    names: list[str] = []
    fits = len(words) % 3 == 0
    for name, kind, number in zip(words[::3], words[1::3], words[2::3], strict=False):
        if kind.upper() not in ("S", "R", "I", "L") or not re.fullmatch(r"[0-9]{1,3}", number):
            fits = False
            break
        count = int(number)
        fits = fits and count > 0
        names += [name] if count == 1 else vector_columns(name, count)
    if not fits or len(set(names)) < len(names) or len(names) > _MOST_COLUMNS:
        raise SceneError(
            f"{source}: Properties={text[:80]!r}: expected names that differ, types (S, R, I, L) and "
            "numbers of columns, such as 'species:S:1:pos:R:3'"
        )
    return tuple(names)


def _names_of_plain(sample: bytes) -> tuple[str, ...]:
    """Return the names of columns without Properties: species, x, y, z, column_5, ...

    If the first column holds fractions, it cannot be a species, and no column has a name.
    """
    rows = [line.split() for line in sample.split(b"\n")[:100]]
    first = next(filter(None, rows), [])
    count = min(len(first), _MOST_COLUMNS)
    names = [f"column_{k}" for k in range(1, count + 1)]
    if count >= len(_PLAIN) and not _REAL.fullmatch(first[0].decode("ascii", "replace")):
        names[: len(_PLAIN)] = _PLAIN
    return tuple(names)


def _clock(entries: Mapping[str, str], comment: str) -> dict[str, Any]:
    """Return the time and the number of the step that a comment holds."""
    texts = {
        slot: entries[name]
        for slot, aliases in CLOCK_SLOTS.items()
        for name in reversed(aliases)
        if name in entries
    }
    if "properties" not in entries:
        for slot, pattern in (("time", _TIME), ("step", _STEP)):
            match = pattern.search(comment)
            if match:
                texts[slot] = match[1]
    clock: dict[str, Any] = {}
    if re.fullmatch(_NUMBER, texts.get("time", "")) and math.isfinite(_float(texts["time"])):
        clock["time"] = _float(texts["time"])
    if re.fullmatch(r"\d{1,18}", texts.get("step", "")):
        clock["step"] = int(texts["step"])
    return clock


def _box(entries: Mapping[str, str], source: str) -> dict[str, Any]:
    """Return box, lattice and periodic axes of a comment; without ``pbc`` a lattice is periodic."""
    if "lattice" not in entries:
        unknown = [(f"'{key}=' in the comment", _EDGES) for key in _LIKE_LATTICE if key in entries]
        return {"unknown": tuple(unknown)}
    cell = _numbers(entries["lattice"], 9, "Lattice", source).reshape(3, 3)
    origin = _numbers(entries.get("origin", "0 0 0"), 3, "Origin", source)
    words = re.findall(r"\w+", entries.get("pbc", "T T T").lower())
    if len(words) != 3 or not set(words) <= {*_TRUE, *_FALSE}:
        raise SceneError(f"{source}: pbc={entries['pbc'][:60]!r}, expected three of T and F")
    wraps = [word in _TRUE for word in words]
    return box_of_cell(cell, origin, "".join(compress(COMPONENTS, wraps)), source)


def _numbers(text: str, count: int, name: str, source: str) -> NDArray:
    numbers = re.findall(_NUMBER, text)
    if len(numbers) != count:
        raise SceneError(f"{source}: {name}={text[:80]!r}, expected {count} numbers")
    return np.array(list(map(_float, numbers)))


def _float(text: str) -> float:
    """Return a number that may have Fortran's exponent, as 1.5D-3."""
    return float(re.sub("[dD]", "e", text))
