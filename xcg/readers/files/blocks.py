"""Tables below a text, one or more in a file, as EDEM exports them, and rows of units below the names."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from xcg.common.messages import SceneError
from xcg.readers.column_units import parse_unit
from xcg.readers.files.table import (
    TableIndex,
    cells_of,
    clock_columns,
    is_number,
    split_header,
)
from xcg.readers.files.text import PIECE, scanned

_MOST_TEXT = 1000  # lines in which the names of columns are looked for
_FEWEST_NAMES = 3
_LONGEST_ROW = 1 << 14  # bytes
_MARKS = b"#%/ \t"  # of comments
_TIME = re.compile(  # TIME: 0.5 s, TIME:,0.5, // t = 500 ms, Time (s),0.5
    r"\W*(?:simulation |sim |current |physical )?(?:time|t)\s*(?:[\[(](\w+)[\])])?\s*[:=,;\t ][,;\s]*"
    r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?)\s*[\[(]?([A-Za-zµ]*)[\])]?[\s,;]*",
    re.IGNORECASE,
)


def scan_blocks(
    path: str, clock_of: Callable[[Sequence[str]], Mapping[str, str]], *, convert: bool
) -> Iterator[TableIndex]:
    """Yield the tables of a file that does not begin with the names of columns, with the time above each.

    Nothing where the first line names the columns and numbers follow, or no line with numbers below
    it names any. Units in a separate row become part of the names, "x [mm]".

    Parameters
    ----------
    path : str
        File.
    clock_of : callable
        Returns the columns of times and steps among the names of columns.
    convert : bool
        Whether times are converted to s by the units beside them.

    Raises
    ------
    SceneError
        If there are several tables, and no time above one of them.
    """
    with scanned(path) as scanner:
        head = scanner.sample(PIECE).split(b"\n")[:_MOST_TEXT]
        names_at = _line_of_names(head)
        if names_at is None:
            return
        header, units = head[names_at], _units(head[names_at + 1])
        separator, names = split_header(_plain(header).decode("utf-8-sig", "replace"))
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise SceneError(
                f"{path}: line {names_at + 1} names {twice!r} twice, below a line of groups; read it by "
                f"xcg.scene_from_table(pandas.read_csv({path!r}, sep={separator!r}, header={[names_at - 1, names_at]}))"
            )
        if units:
            names = tuple(
                f"{name} [{unit}]" if unit else name
                for name, unit in zip(names, units, strict=True)
            )
        clock = clock_of(names)
        time: float | None = None
        number = tables = 0
        while line := scanner.line():
            number += 1
            time = time_of([line], time, convert=convert)
            if line.strip() != header.strip():
                if tables and any(map(is_number, cells_of(line)[:1])):
                    raise SceneError(
                        f"{path}: line {number} begins with a number ({line[:40].decode('utf-8', 'replace')!r}), and "
                        f"is no row of the {len(names)} columns that a line above it names"
                    )
                continue
            tables += 1
            if tables > 1 and time is None and not clock:
                raise SceneError(
                    f"{path}: line {number} names the columns of one more table, and no line above it holds "
                    "its time, such as 'TIME: 0.5 s'; write one, or one file a step"
                )
            if units:
                scanner.line()
            starts = [scanner.offset]
            rows = []
            # the next line is left where it is unless it is a row
            while _is_row(cells_of(scanner.sample(_LONGEST_ROW).partition(b"\n")[0]), len(names)):
                rows.append(scanner.line())
                starts.append(scanner.offset)
            number += len(rows) + bool(units)
            columns = clock_columns(b"".join(rows), names, clock, separator, path)
            yield TableIndex(names, len(rows), columns, np.array(starts), separator, time)
            time = None


def row_below_text(path: str) -> tuple[tuple[str, ...], list[str]]:
    """Return the names of the columns below a text, or above units, and the words of the first row; else nothing."""
    with scanned(path) as scanner:
        head = scanner.sample(PIECE).split(b"\n")[:_MOST_TEXT]
    names_at = _line_of_names(head)
    if names_at is None:
        return (), []
    _, names = split_header(_plain(head[names_at]).decode("utf-8-sig", "replace"))
    row = head[names_at + 1 + bool(_units(head[names_at + 1]))]
    return names, [cell.decode("utf-8", "replace") for cell in cells_of(row)]


def _line_of_names(lines: Sequence[bytes]) -> int | None:
    """Return the line that names the columns below a text, or above units; None for other files."""
    rows = [cells_of(line) for line in lines]
    texts = [sum(not is_number(cell) for cell in row) for row in rows]
    first = lines[0].removeprefix(codecs.BOM_UTF8).lstrip()
    if len(lines) < 2 or first.startswith(b"#"):
        return None
    has_numbers = 2 * texts[1] < len(rows[1]) and len(rows[1]) - len(rows[0]) in (0, 1)
    if has_numbers and not first.startswith((b"%", b"//")):
        return None
    for k in range(len(rows) - 1):
        below = k + 1 + bool(_units(lines[k + 1]))
        names_all = len(rows[k]) == texts[k] >= _FEWEST_NAMES and all(rows[k])
        if names_all and below < len(rows) and _is_row(rows[below], len(rows[k])):
            return k if k or below > 1 else None
    return None


def _plain(line: bytes) -> bytes:
    """Return a line of names without marks of a comment."""
    return line.removeprefix(codecs.BOM_UTF8).lstrip(_MARKS).strip()


def _is_row(cells: Sequence[bytes], count: int) -> bool:
    """Return whether a line holds as many values as columns, the first of them a number."""
    return len(cells) == count and is_number(cells[0]) and sum(map(is_number, cells)) * 2 > count


def _units(line: bytes) -> list[str]:
    """Return the units in a line of units alone, "" for a column without; nothing for another line."""
    words = [cell.decode("utf-8", "replace").strip("[]() \"'") for cell in cells_of(line)]
    parsed = [parse_unit(word) for word in words]
    is_unit = [
        unit is not None or word in ("", "1", "#") for word, unit in zip(words, parsed, strict=True)
    ]
    if not all(is_unit) or not any(unit and any(unit[1]) for unit in parsed):
        return []
    return ["" if word in ("", "-", "1", "#") else word for word in words]


def time_of(lines: Iterable[bytes], time: float | None = None, *, convert: bool) -> float | None:
    """Return the time in the last line of text that holds one, else the one before."""
    for line in lines:
        match = _TIME.fullmatch(line.decode("utf-8", "replace").strip())
        above, value, below = match.groups() if match is not None else ("", "", "")
        unit = parse_unit(below or above or "s")
        if value and unit is not None and unit[1] == (0, 0, 1):
            time = float(value.upper().replace("D", "E")) * (unit[0] if convert else 1.0)
    return time
