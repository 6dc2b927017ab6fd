"""Binary dumps of LAMMPS, and the box of its headers: bounds and tilts."""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import compress
from typing import BinaryIO, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.messages import SceneError
from xcg.readers.engine import StepRef
from xcg.readers.files.text import source_of
from xcg.scene.schema import COMPONENTS


def with_bounds(
    ref: StepRef, low: ArrayLike, high: ArrayLike, tilts: ArrayLike | None = None
) -> StepRef:
    """Add the box of a step from lower and upper bounds (3,), which bound the tilted box, and xy, xz, yz.

    Raises
    ------
    ValueError
        If a lower edge is not below the upper one.
    """
    lower = np.array(low, float)
    upper = np.array(high, float)
    lattice = None
    if tilts is not None:
        xy, xz, yz = np.asarray(tilts, float).tolist()
        lower -= [min(0.0, xy, xz, xy + xz), min(0.0, yz), 0.0]
        upper -= [max(0.0, xy, xz, xy + xz), max(0.0, yz), 0.0]
        x, y, z = (upper - lower).tolist()
        lattice = ((x, 0.0, 0.0), (xy, y, 0.0), (xz, yz, z))
    if not (lower < upper).all():
        raise ValueError
    box = tuple(zip(lower.tolist(), upper.tolist(), strict=True))
    return replace(ref, box=box, lattice=lattice)


# how a file begins, and its order of bytes
MARKS = {
    struct.pack(f"{order}q", -len(word)) + word: order
    for order in "<>"
    for word in (b"DUMPCUSTOM", b"DUMPATOM")
}
_MOST_COLUMNS = 1000
_LONGEST_TEXT = 1 << 16  # bytes of the names of columns
_NEWEST = 2  # revision


class _Header:
    """Numbers of a header, one after the other."""

    def __init__(self, file: BinaryIO, path: str, order: str) -> None:
        self.file = file
        self.path = path
        self.start = file.tell()
        self.order = order

    def refuse(self, problem: str) -> NoReturn:
        raise SceneError(
            f"{self.path}: the header at byte {self.start} {problem}; leave the file out, or write it anew"
        ) from None

    def bytes(self, count: int) -> bytes:
        data = self.file.read(count)
        if len(data) < count:
            self.refuse("is cut off")
        return data

    def numbers(self, code: str) -> tuple:
        return struct.unpack(self.order + code, self.bytes(struct.calcsize("<" + code)))

    def text(self) -> str:
        (length,) = self.numbers("i")
        if not 0 <= length <= _LONGEST_TEXT:
            self.refuse(f"has a text of {length} bytes")
        return self.bytes(length).decode("utf-8", "replace")


def steps_of(path: str) -> Iterator[StepRef]:
    """List the steps of a file from its headers.

    Raises
    ------
    SceneError
        If a header or its blocks are not as described above, or the file ends within one.
    """
    size = os.path.getsize(path)
    order = _order_of(path)
    units = None
    with open(path, "rb") as file:
        while file.tell() < size:
            ref = _read_header(_Header(file, path, order))
            units = ref.units or units  # LAMMPS writes the units once a file
            end = _end_of_blocks(_Header(file, path, order), ref, size)
            yield replace(ref, units=units, length=end - ref.offset)
            file.seek(end)


def _read_header(header: _Header) -> StepRef:
    head = header.file.read(max(map(len, MARKS)))
    mark = next(filter(head.startswith, MARKS), None)
    if mark is None or MARKS[mark] != header.order:
        header.refuse("does not begin with 'DUMPCUSTOM' or 'DUMPATOM'")
    header.file.seek(header.start + len(mark))
    mark_of_order, revision, step, count, triclinic, *walls = header.numbers("iiqqi6i")
    if mark_of_order != 1 or not 1 <= revision <= _NEWEST:
        header.refuse(f"is of revision {revision}, expected 1 to {_NEWEST}")
    if triclinic not in (0, 1):
        header.refuse(
            "has a box of vectors in any direction; write 'dump_modify ... triclinic/general no'"
        )
    bounds = header.numbers("6d")
    tilts = header.numbers("3d") if triclinic else None
    (columns,) = header.numbers("i")
    units = header.text() or None
    time = None
    (has_time,) = header.numbers("?")
    if has_time:
        (time,) = header.numbers("d")
    names = tuple(header.text().split())
    if not 0 < columns == len(names) == len(set(names)) <= _MOST_COLUMNS or count < 0:
        header.refuse(
            f"promises {count} rows of {columns} columns, and names {' '.join(names[:50]) or 'none'}"
        )
    if not all(map(math.isfinite, (*bounds, *(tilts or ()), time or 0.0))):
        header.refuse("has a time or box that is not finite")
    wraps = [low == high == 0 for low, high in zip(walls[::2], walls[1::2], strict=True)]
    periodic = "".join(compress(COMPONENTS, wraps))
    ref = StepRef(
        header.path,
        count,
        time=time,
        step=step,
        periodic=periodic,
        columns=names,
        offset=header.file.tell(),
        units=units,
    )
    try:
        return with_bounds(ref, bounds[::2], bounds[1::2], tilts)
    except ValueError:
        header.refuse(f"has the box {bounds}, lower edges first")


def _end_of_blocks(header: _Header, ref: StepRef, size: int) -> int:
    """Byte after the last block of a step, whose rows are counted."""
    values = 0
    wide = len(ref.columns)
    (processes,) = header.numbers("i")
    for _ in range(processes):
        (count,) = header.numbers("i")
        end = header.file.tell() + 8 * count
        if count < 0 or count % wide or end > size:
            header.refuse(
                f"is followed by a block of {count} values, expected rows of {wide} within the file"
            )
        values += count
        header.file.seek(end)
    if values != ref.rows * wide:
        raise SceneError(
            f"{source_of(ref)}: its header promises {ref.rows} rows of {wide} values, and {values} values follow; "
            "leave the file out, or write it anew"
        )
    return header.file.tell()


def _order_of(path: str) -> str:
    """Order of bytes of a file."""
    with open(path, "rb") as file:
        head = file.read(max(map(len, MARKS)))
    return next((order for mark, order in MARKS.items() if head.startswith(mark)), "<")


def read_columns(ref: StepRef, wanted: Iterable[str]) -> dict[str, NDArray]:
    """Read columns of one step.

    Raises
    ------
    SceneError
        If the blocks are not as they were when they were listed.
    """
    order = _order_of(ref.path)
    wide = len(ref.columns)
    with open(ref.path, "rb") as file:
        file.seek(ref.offset)
        body = file.read(ref.length)
    blocks = [np.empty((0, wide))]
    at = 4
    while at < len(body):
        count = -1
        if at + 4 <= len(body):
            (count,) = struct.unpack_from(f"{order}i", body, at)
        if count < 0 or count % wide or at + 4 + 8 * count > len(body):
            raise SceneError(
                f"{source_of(ref)}: the file changed after the scene was opened; open it again"
            )
        blocks.append(np.frombuffer(body, f"{order}f8", count, at + 4).reshape(-1, wide))
        at += 4 + 8 * count
    table = np.concatenate(blocks)
    return {name: table[:, ref.columns.index(name)].astype("f8") for name in set(wanted)}
