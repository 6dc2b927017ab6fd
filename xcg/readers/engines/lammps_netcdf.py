"""LAMMPS dumps in NetCDF (``dump netcdf``, ``dump netcdf/mpiio``), in the conventions of AMBER.

``time`` counts steps, and its ``scale_factor`` is the time between two of them. Lengths of the box
are 0 along axes that are not periodic. Rows of atoms that were lost hold the fill value as their
id.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.cells import box_of_cell
from xcg.readers.engine import StepRef
from xcg.scene.schema import COMPONENTS

# names of vectors, and those of their components in dumps of text
_VECTORS = {
    "coordinates": "{}",
    "unwrapped_coordinates": "{}u",
    "scaled_coordinates": "{}s",
    "velocities": "v{}",
    "forces": "f{}",
    "mu": "mu{}",
}
_UNITS = {
    "meter": "si",
    "centimeter": "cgs",
    "micrometers": "micro",
    "nanometers": "nano",
    "lj": "lj",
}
_LOST = -(2**31) + 1  # the fill value of ids


def steps_of(path: str) -> Iterator[StepRef]:
    """List the steps of a file from its header and its times and boxes.

    Raises
    ------
    SceneError
        If the file is of another format, or damaged.
    """
    file = ClassicFile(path)
    needed = {"time": (), "cell_origin": (3,), "cell_lengths": (3,), "cell_angles": (3,)}
    shapes = {name: v.shape for name, v in file.variables.items() if v.recorded}
    lacking = [name for name, shape in needed.items() if shapes.get(name) != shape]
    columns = tuple(_variables_by_column(file))
    if not columns:
        lacking.append("columns of atoms")
    if lacking:
        file.refuse(f"lacks {', '.join(lacking)}, and was not written by 'dump netcdf'")
    units = str(file.variables["cell_lengths"].attrs.get("units", ""))
    scale = np.ravel(file.variables["time"].attrs.get("scale_factor", np.nan)).astype(float)
    for k in range(file.records):
        number = float(file.read("time", k))
        if not (math.isfinite(number) and abs(number) < 2**63):
            file.refuse(f"has the time {number} in record {k}, and is damaged")
        time = None
        if len(scale) == 1 and np.isfinite(scale[0]):
            time = number * float(scale[0])
        elif not number.is_integer():
            file.refuse(
                f"has the time {number:g} in record {k} and no scale_factor, which numbers of steps have: it is not by "
                "LAMMPS, and xcg.scene_from_arrays takes what xarray reads from it"
            )
        yield StepRef(
            path,
            file.dims["atom"],
            time=time,
            step=round(number),
            columns=columns,
            offset=k,
            units=_UNITS.get(units, units) or None,
            **_box(file, k),
        )


def _box(file: ClassicFile, record: int) -> dict[str, Any]:
    """Edges, tilt and periodic axes of a step."""
    low = file.read("cell_origin", record).astype(float)
    lengths = file.read("cell_lengths", record).astype(float)
    angles = file.read("cell_angles", record).astype(float)
    if (
        not np.isfinite([low, lengths, angles]).all()
        or (lengths < 0).any()
        or (np.abs(angles - 90) >= 90).any()
    ):
        file.refuse(
            f"has a box of lengths {lengths} and angles {angles} in record {record}, and is damaged"
        )
    periodic = "".join(compress(COMPONENTS, lengths > 0))
    if (np.abs(angles - 90) < 1e-4).all():  # angles in single precision
        return box_of_cell(np.diag(lengths), low, periodic, file.path)
    if len(periodic) < 3:
        file.refuse(
            "has a tilted box that is not periodic along all axes, whose tilts are not told; dump text"
        )
    a, b, c = lengths
    alpha, beta, gamma = np.cos(np.radians(angles))
    xy = b * gamma
    xz = c * beta
    y = math.sqrt(max(b**2 - xy**2, 0.0))
    yz = (b * c * alpha - xy * xz) / y
    z = math.sqrt(max(c**2 - xz**2 - yz**2, 0.0))
    return box_of_cell([[a, 0, 0], [xy, y, 0], [xz, yz, z]], low, periodic, file.path)


def _variables_by_column(file: ClassicFile) -> dict[str, tuple[str, int | None]]:
    """Variable and component of each column, named as in dumps of text."""
    by_column: dict[str, tuple[str, int | None]] = {}
    for name, values in file.variables.items():
        is_text = values.dtype.kind == "S"
        if is_text or not values.recorded or values.dims[:2] != ("frame", "atom"):
            continue
        if len(values.dims) == 2:
            by_column[name] = (name, None)
        if len(values.dims) == 3:
            width = values.shape[1]
            columns = [f"{name}[{k + 1}]" for k in range(min(width, 100))]
            if name in _VECTORS and width == len(COMPONENTS):
                columns = [_VECTORS[name].format(axis) for axis in COMPONENTS]
            by_column |= {column: (name, k) for k, column in enumerate(columns)}
    return by_column


def read_columns(ref: StepRef, wanted: Iterable[str]) -> dict[str, NDArray]:
    """Read columns of one step, without atoms that were lost."""
    file = ClassicFile(ref.path)
    by_column = _variables_by_column(file)

    names = {by_column[column][0] for column in wanted} | ({"id"} & {*by_column})
    arrays = {name: file.read(name, ref.offset) for name in names}
    exists = np.ones(ref.rows, bool)
    if "id" in arrays:
        exists = arrays["id"] != _LOST
    table = {}
    for column in wanted:
        name, k = by_column[column]
        values = arrays[name]
        if k is not None:
            values = values[:, k]
        table[column] = values[exists].astype("f8")
    return table


# --- classic NetCDF --------------------------------------------------------------------------------------
#
# CDF-1, CDF-2 and CDF-5 are read without the library, and their counts are checked first. Source:
# the NetCDF Classic Format Specification, and that of CDF-5 (Unidata).


MARKS = (b"CDF\x01", b"CDF\x02", b"CDF\x05")  # how a file begins
_TYPES = dict(
    enumerate(("i1", "S1", ">i2", ">i4", ">f4", ">f8", "u1", ">u2", ">u4", ">i8", ">u8"), 1)
)
_FARTHEST = 1 << 60  # byte of a file; further ones cannot be addressed
_MOST = 10_000  # dimensions, variables, or attributes of one of them
_LONGEST = 1 << 20  # bytes of a name or an attribute
_DIMENSIONS = 10
_VARIABLES = 11
_ATTRIBUTES = 12


@dataclass(frozen=True)
class ClassicVariable:
    """Variable as the header describes it; `shape` is without records, `begin` its first byte."""

    name: str
    dtype: np.dtype
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    attrs: dict[str, Any]
    begin: int
    recorded: bool

    @property
    def length(self) -> int:
        """Bytes of its values, of one record where it has records."""
        return math.prod(self.shape) * self.dtype.itemsize


class ClassicFile:
    """Header of a file: dimensions and variables.

    Attributes
    ----------
    records : int
        How many records the file holds.
    dims : dict
        Sizes of the dimensions by name; that of records is 0.
    variables : dict
        By name.

    Raises
    ------
    SceneError
        If the header is damaged, or promises more than the file holds.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        size = os.path.getsize(path)
        with open(path, "rb") as file:
            self._file: BinaryIO = file
            head = self._bytes(4)
            if head not in MARKS:
                self.refuse("is no NetCDF in a classic format")
            version = head[3]
            self._code_of_counts = ">Q" if version == 5 else ">I"
            self._code_of_offsets = ">Q" if version > 1 else ">I"
            records = self._number(self._code_of_counts)
            names = []
            self.dims: dict[str, int] = {}
            for _ in range(self._list(_DIMENSIONS)):
                names.append(self._name())
                self.dims[names[-1]] = self._number(self._code_of_counts)
            self._attributes()  # of the file
            variables = [self._variable(names) for _ in range(self._list(_VARIABLES))]
        self.variables = {variable.name: variable for variable in variables}
        recorded = [variable for variable in variables if variable.recorded]
        # padded to four bytes, unless it is the only variable
        self._record = sum(v.length + -v.length % 4 for v in recorded)
        if len(recorded) == 1:
            self._record = recorded[0].length
        room = 0
        if self._record:  # the last one may lack its padding
            room = (size - min(v.begin for v in recorded) + 3) // self._record
        self.records = records
        if records == 2 ** (8 * struct.calcsize(self._code_of_counts)) - 1:  # as many as there are
            self.records = room
        if self._record and self.records > room:
            self.refuse(
                f"promises {self.records} records, and has room for {room}; it was cut short"
            )
        for v in variables:
            if not v.recorded and v.begin + v.length > size:
                self.refuse(f"ends before its variable '{v.name}' does; it was cut short")

    def refuse(self, problem: str) -> NoReturn:
        """Raise an error that names the file."""
        raise SceneError(
            f"{self.path}: the file {problem}. Leave it out, or write it again"
        ) from None

    def _bytes(self, count: int) -> bytes:
        data = self._file.read(count)
        if len(data) < count:
            self.refuse("ends in its header")
        return data

    def _number(self, code: str) -> int:
        (number,) = struct.unpack(code, self._bytes(struct.calcsize(code)))
        return int(number)

    def _count(self, most: int = _MOST) -> int:
        number = self._number(self._code_of_counts)
        if number > most:
            self.refuse(f"has a count of {number} in its header, and is damaged")
        return number

    def _padded(self, count: int) -> bytes:
        return self._bytes(count + -count % 4)[:count]

    def _name(self) -> str:
        return self._padded(self._count(_LONGEST)).decode("utf-8", "replace")

    def _list(self, expected: int) -> int:
        tag = self._number(">i")
        count = self._count()
        if tag not in (0, expected) or (tag == 0 and count):
            self.refuse(
                f"has a list of kind {tag} in its header, expected {expected}, and is damaged"
            )
        return count

    def _type(self) -> np.dtype:
        kind = self._number(">i")
        if kind not in _TYPES:
            self.refuse(f"has numbers of type {kind}, and is damaged")
        return np.dtype(_TYPES[kind])

    def _attributes(self) -> dict[str, Any]:
        attributes: dict[str, Any] = {}
        for _ in range(self._list(_ATTRIBUTES)):
            name = self._name()
            dtype = self._type()
            count = self._count(_LONGEST)
            data = self._padded(count * dtype.itemsize)
            attributes[name] = np.frombuffer(data, dtype)
            if dtype.kind == "S":
                attributes[name] = data.decode("utf-8", "replace")
        return attributes

    def _variable(self, names: Sequence[str]) -> ClassicVariable:
        """Read a variable; `names` lists the dimensions of the file."""
        name = self._name()
        indices = [self._count() for _ in range(self._count())]
        if any(index >= len(names) for index in indices):
            self.refuse(f"gives '{name}' a dimension that it has not, and is damaged")
        attrs = self._attributes()
        dtype = self._type()
        # its size, which follows from the dimensions where it is not too large for this field
        self._number(self._code_of_counts)
        begin = self._number(self._code_of_offsets)
        if begin >= _FARTHEST:
            self.refuse(f"has '{name}' at byte {begin}, and is damaged")
        dims = tuple(names[index] for index in indices)
        recorded = bool(dims) and self.dims[dims[0]] == 0
        shape = tuple(self.dims[dim] for dim in dims[recorded:])
        return ClassicVariable(name, dtype, dims, shape, attrs, begin, recorded)

    def read(self, name: str, record: int) -> NDArray:
        """Read a variable, of one record where it has records."""
        variable = self.variables[name]
        begin = variable.begin
        if variable.recorded:
            begin += self._record * record
        with open(self.path, "rb") as file:
            file.seek(begin)
            data = file.read(variable.length)
        if len(data) < variable.length:
            self.refuse(f"ends within '{name}' of record {record}; it was cut short")
        return np.frombuffer(data, variable.dtype).reshape(variable.shape)
