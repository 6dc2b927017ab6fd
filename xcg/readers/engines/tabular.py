"""Tables of any origin, CSV (also compressed) and Parquet; columns are named as variables of scenes, or by ``names=``.

A file holds one step, or several that a column of times separates, whose rows are contiguous.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.messages import SceneError, warn_user
from xcg.readers.assigned import assign
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.filenames import suffix_of
from xcg.readers.files.blocks import row_below_text, scan_blocks, time_of
from xcg.readers.files.table import (
    TableIndex,
    first_row,
    read_csv,
    read_parquet,
    scan_csv,
    scan_parquet,
)
from xcg.readers.files.text import first_lines
from xcg.readers.likely_names import resembling_clock, times_by_unit
from xcg.readers.named_columns import columns_by_name, factor_of
from xcg.readers.names import CLOCK_SLOTS
from xcg.readers.paths import index_steps
from xcg.readers.unread import unread_format
from xcg.scene.times import read_times, without_noise

_POSITION = ("position_x", "position_y", "position_z")
_ENDS = ("contact_i", "contact_j")
# also with a decimal comma, which is an error by name when it is read
_NUMBER = re.compile(r"\s*[-+]?(\d+[.,]?\d*|[.,]\d+)([eEdD][-+]?\d+)?\s*")

_OF_TRACKPY = {"mass", "signal", "ecc"}  # its mass is the brightness of a feature


class Table(Columnar):
    """CSV and Parquet."""

    OPTIONS = ("timestep",)
    NAMES_IN_ORDER = True
    NEEDS_ID = False

    def recognises(self, path: str) -> bool:
        """Return whether the suffix is that of a table, or the first line of a text names its columns."""
        if suffix_of(path) in (".csv", ".tsv"):
            return unread_format(path) is None  # Excel, HTML and others are called .csv, too
        return suffix_of(path) == ".parquet" or _has_header(path)

    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps of particles or contacts, from the column of times where there is one."""
        by_caller = dict(options.names)
        kind = "contacts" if contacts else "particles"
        in_order = enumerate(options.listed.get(kind, ()))
        names = [name or f"column {k}" for k, name in in_order]
        convert = "units" not in options.given
        scan = partial(_steps, by_caller=by_caller, in_order=names, convert=convert)
        key = f"table {by_caller} {names} {convert}"
        refs = index_steps(paths, key, scan, options.extra.get("timestep"))
        if refs:
            warn_of_unread_clock(refs[0], options)
        return refs

    def particle_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the column of each slot; trackpy's `mass` (a brightness) is read only by `names`."""
        columns = super().particle_columns(ref, options)
        if set(ref.columns) >= _OF_TRACKPY and "mass" not in options.names:
            columns.pop("mass", None)
        return columns

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read columns of one step."""
        read = read_parquet if suffix_of(ref.path) == ".parquet" else read_csv
        return read(ref, sorted(set(wanted)), options)

    def columns_read(self, ref: StepRef, options: ReadOptions, *, contacts: bool) -> dict[str, str]:
        """Return the slot of each column that is read, including times and steps."""
        of_clock = {column: slot for slot, column in clock_of(ref.columns, options.names).items()}
        return of_clock | super().columns_read(ref, options, contacts=contacts)


def _has_header(path: str) -> bool:
    """Return whether a text names two axes of a position, or both ends of contacts, above a row of numbers."""
    if not first_lines(path):
        return False
    try:
        return _begins_a_table(path, *first_row(path)) or _begins_a_table(
            path, *row_below_text(path)
        )
    except SceneError:  # a line without an end
        return False


def _begins_a_table(path: str, names: tuple[str, ...], words: Sequence[str]) -> bool:
    """Return whether the column names mean positions or contacts, and numbers follow."""
    if len(words) not in (len(names), len(names) + 1):  # one more: an index without a name
        return False
    row = dict(zip(reversed(names), reversed(words), strict=False))
    ref = StepRef(path, 0, columns=names)
    for slots, needed in ((Table.PARTICLE_SLOTS, _POSITION), (Table.CONTACT_SLOTS, _ENDS)):
        sought = {slot: slots[slot] for slot in needed}
        columns = assign(ref, sought, ReadOptions()).values()
        if len(columns) >= 2 and all(_NUMBER.fullmatch(row[name]) for name in columns):
            return True
    return False


def clock_of(columns: Sequence[str], by_caller: Mapping[str, str | None]) -> dict[str, str]:
    """Return the columns of the time and of the number of the step, as far as there are such."""
    free = [name for name in columns if name not in by_caller]
    by_name = columns_by_name(free, CLOCK_SLOTS)
    clock_of_caller = {slot: name for name, slot in by_caller.items() if name in columns}
    clock = by_name | {slot: name for slot, name in clock_of_caller.items() if slot is not None}
    if not clock.keys() & CLOCK_SLOTS.keys():  # in another language, told by its unit
        times = times_by_unit(free)
        if times:
            clock["time"] = times[0]
    # the time, if there is one, separates the steps
    return {slot: clock[slot] for slot in CLOCK_SLOTS if slot in clock}


def warn_of_unread_clock(ref: StepRef, options: ReadOptions) -> None:
    """Warn of a column that may hold times, where none separates the rows into steps."""
    if clock_of(ref.columns, options.names):
        return
    free = [name for name in ref.columns if name not in options.names]
    likely = resembling_clock(free)
    if likely:
        listed = ", ".join(map(repr, likely))
        warn_user(
            f"{ref.path}: columns {listed} may hold times or numbers of steps and are not read, so all "
            f"rows are one step; map one, names={{{likely[0]!r}: 'time'}} (with "
            f"units={{'time': 1e-3}} for ms) or 'step', or drop it by names={{{likely[0]!r}: None}}"
        )


def _steps(
    path: str, by_caller: Mapping[str, str | None], in_order: Sequence[str], *, convert: bool
) -> Iterator[StepRef]:
    of_clock = partial(clock_of, by_caller=by_caller)
    if suffix_of(path) == ".parquet":
        yield from _steps_of(scan_parquet(path, of_clock), path, by_caller, convert=convert)
        return
    below_text = False
    for table in () if in_order else scan_blocks(path, of_clock, convert=convert):
        below_text = True
        yield from _steps_of(table, path, by_caller, convert=convert)
    if not below_text:
        table = scan_csv(path, of_clock, in_order)
        table = replace(table, time=time_of(table.comments, convert=convert))
        yield from _steps_of(table, path, by_caller, convert=convert)


def _steps_of(
    table: TableIndex, path: str, by_caller: Mapping[str, str | None], *, convert: bool
) -> Iterator[StepRef]:
    """Yield the steps of a table."""
    columns = clock_of(table.columns, by_caller)
    clock = {slot: table.clock[name] for slot, name in columns.items()}
    start = None
    if "time" in clock:
        clock["time"], start = read_clock(clock["time"], columns["time"], path, convert=convert)
    for first, stop in runs_of(clock, table.rows, path):
        offset, length = table.extent(first, stop)
        ref = StepRef(
            path,
            stop - first,
            step=-1,
            columns=table.columns,
            offset=offset,
            length=length,
            kind=table.kind,
            time=table.time,
        )
        if "time" in clock:
            ref = replace(ref, time=float(clock["time"][first]), start=start)
        if "step" in clock:
            ref = replace(ref, step=int(clock["step"][first]))
        yield ref


def read_clock(
    values: ArrayLike, column: str, source: str, *, convert: bool
) -> tuple[NDArray, str | None]:
    """Return the times of a column without rounding noise, and what they count from; see `read_times`.

    `convert`: whether numbers are converted to s by the unit in the name of the column.
    """
    try:
        times, start = read_times(values, f"{source}: column {column!r}")
    except SceneError as error:
        raise SceneError(f"{error}; if it holds no times, names={{{column!r}: None}}") from None
    if convert and start is None:
        times = times * factor_of(column, "time")
    if np.isfinite(times).all():
        times = without_noise(times)
    return times, start


def check_clock(clock: Mapping[str, NDArray], path: str) -> None:
    """Raise SceneError if a time is not finite, or a step number is not whole."""
    for slot, values in clock.items():
        fits = np.isfinite(values)
        expected = "numbers"
        if slot == "step":
            fits &= (values % 1 == 0) & (values >= 0) & (values < 2**63)
            expected = "0, 1, 2, ..."
        if not fits.all():
            row = int(np.argmin(fits))
            raise SceneError(
                f"{path}: the {slot} of row {row} is {values[row]}; expected {expected}"
            )


def runs_of(clock: Mapping[str, NDArray], rows: int, path: str) -> list[tuple[int, int]]:
    """First row of each step and the one after its last.

    Raises
    ------
    SceneError
        If the clock is not as `check_clock` expects, or rows of one time are not contiguous.
    """
    if not clock:
        return [(0, rows)]
    check_clock(clock, path)
    if not rows:
        raise SceneError(f"{path}: no rows follow the names of the columns")
    slot, key = next(iter(clock.items()))
    edges = [0, *(np.flatnonzero(np.diff(key)) + 1).tolist(), rows]
    firsts = key[edges[:-1]].tolist()
    if len(set(firsts)) < len(firsts):
        twice = next(value for value in firsts if firsts.count(value) > 1)
        raise SceneError(
            f"{path}: rows of the {slot} {twice!r} stand apart from each other; sort the table by "
            "it, or split it where another run begins and open the runs one by one"
        )
    return list(pairwise(edges))
