"""Parquet, by pyarrow where it is installed: only the columns and row groups that are wanted are read."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.text import source_of


@dataclass(frozen=True, eq=False)
class Table:
    """Metadata of a file and its columns of times; see `xcg.readers.files.table.Table`."""

    columns: tuple[str, ...]
    rows: int
    clock: Mapping[str, NDArray]
    kind: str = ""

    def place(self, first: int, stop: int) -> tuple[int, int]:
        """First row; bytes are not known."""
        return first, 0


@contextmanager
def _opened(path: str) -> Iterator[Any]:
    """Open a file; what pyarrow finds wrong with it is said with its name."""
    try:
        pyarrow, parquet = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise SceneError(
            f"{path}: reading Parquet needs the package pyarrow: pip install 'xcg[parquet]', or write CSV"
        ) from None
    try:
        with parquet.ParquetFile(path) as file:
            yield file
    except (pyarrow.ArrowException, OSError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise SceneError(
            f"{path}: cannot be read as Parquet ({str(error)[:200]}); leave the file out, or write it again"
        ) from None


def scan(path: str, clock_of: Callable[[Sequence[str]], Mapping[str, str]]) -> Table:
    """Read names of columns, number of rows, and the columns of times."""
    with _opened(path) as file:
        names = tuple(file.schema_arrow.names)
        wanted = sorted(set(clock_of(names).values()))
        table = file.read(columns=wanted)
        return Table(names, file.metadata.num_rows, {name: _numbers(table, name, path) for name in wanted})


def read_columns(ref: StepRef, wanted: Sequence[str], options: ReadOptions) -> dict[str, NDArray]:
    """Read columns of one step, from the row groups that it touches."""
    first, stop = ref.offset, ref.offset + ref.rows
    with _opened(ref.path) as file:
        edges = np.cumsum([0, *(file.metadata.row_group(k).num_rows for k in range(file.num_row_groups))])
        groups = np.flatnonzero((edges[:-1] < stop) & (edges[1:] > first)).tolist()
        table = file.read_row_groups(groups, columns=list(wanted))
        at = first - int(edges[groups[0]]) if groups else 0
        table = table.slice(at, ref.rows)
        if table.num_rows != ref.rows:
            raise SceneError(
                f"{source_of(ref)}: {table.num_rows} rows, but its metadata promise {ref.rows}; the file is damaged"
            )
        return {name: _numbers(table, name, source_of(ref)) for name in wanted}


def _numbers(table: Any, name: str, source: str) -> NDArray:
    column = table.column(name)
    if column.null_count:
        row = int(np.argmax(column.is_null().to_numpy(zero_copy_only=False)))
        raise SceneError(f"{source}: row {row} has no value in column '{name}', expected a number")
    try:
        return np.asarray(column.to_numpy(), "float64")
    except (TypeError, ValueError):
        raise SceneError(f"{source}: column '{name}' holds {column.type}, expected numbers") from None
