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
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.engine import StepRef
from xcg.readers.files.text import source_of
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
    names = tuple(_places(file))
    lacking = [
        name
        for name, shape in needed.items()
        if name not in file.variables
        or not file.variables[name].recorded
        or file.variables[name].shape != shape
    ]
    lacking += [] if names else ["columns of atoms"]
    if lacking:
        file.refuse(f"lacks {', '.join(lacking)}, and was not written by 'dump netcdf'")
    scale = np.asarray(file.variables["time"].attrs.get("scale_factor", np.nan), float).ravel()
    length = file.variables["cell_lengths"].attrs.get("units")
    for k in range(file.records):
        number = float(file.read("time", k))
        if not (math.isfinite(number) and abs(number) < 2**63):
            file.refuse(f"has the time {number} in record {k}, and is damaged")
        time = number * float(scale[0]) if len(scale) == 1 and np.isfinite(scale[0]) else None
        yield StepRef(
            path,
            file.dims["atom"],
            time=time,
            step=round(number),
            columns=names,
            offset=k,
            units=_UNITS.get(str(length), str(length)) if length else None,
            **_box(file, k),
        )


def _box(file: ClassicFile, record: int) -> dict[str, Any]:
    """Edges, tilt and periodic axes of a step."""
    low, lengths, angles = (
        file.read(f"cell_{what}", record).astype(float) for what in ("origin", "lengths", "angles")
    )
    if (
        not np.isfinite([low, lengths, angles]).all()
        or (lengths < 0).any()
        or (np.abs(angles - 90) >= 90).any()
    ):
        file.refuse(
            f"has a box of lengths {lengths} and angles {angles} in record {record}, and is damaged"
        )
    periodic = lengths > 0
    told = {"periodic": "".join(a for a, there in zip(COMPONENTS, periodic, strict=True) if there)}
    if (np.abs(angles - 90) < 1e-4).all():  # angles in single precision
        high = [a + b if b else math.inf for a, b in zip(low, lengths, strict=True)]
        edges = [
            (a if b else -math.inf, c) for a, b, c in zip(low.tolist(), lengths, high, strict=True)
        ]
        return told | {"box": tuple(edges)}
    if not periodic.all():
        file.refuse(
            "has a tilted box that is not periodic along all axes, whose tilts are not told; dump text"
        )
    alpha, beta, gamma = np.cos(np.radians(angles))
    a, b, c = lengths
    xy, xz = b * gamma, c * beta
    y = math.sqrt(max(b**2 - xy**2, 0.0))
    yz = (b * c * alpha - xy * xz) / y
    z = math.sqrt(max(c**2 - xz**2 - yz**2, 0.0))
    edges = [
        (float(start), float(start + size)) for start, size in zip(low, (a, y, z), strict=True)
    ]
    lattice = ((float(a), 0.0, 0.0), (float(xy), float(y), 0.0), (float(xz), float(yz), float(z)))
    return told | {"box": tuple(edges), "lattice": lattice}


def _places(file: ClassicFile) -> dict[str, tuple[str, int | None]]:
    """Variable and component of each column, named as in dumps of text."""
    found: dict[str, tuple[str, int | None]] = {}
    for name, variable in file.variables.items():
        of_atoms = (
            variable.recorded
            and variable.dims[:2] == ("frame", "atom")
            and variable.dtype.kind != "S"
        )
        if not of_atoms or len(variable.dims) > 3:
            continue
        if len(variable.dims) == 2:
            found[name] = (name, None)
        elif name in _VECTORS and variable.shape[1] == len(COMPONENTS):
            found |= {_VECTORS[name].format(axis): (name, k) for k, axis in enumerate(COMPONENTS)}
        else:
            found |= {f"{name}[{k + 1}]": (name, k) for k in range(min(variable.shape[1], 100))}
    return found


def read_columns(ref: StepRef, wanted: Iterable[str]) -> dict[str, NDArray]:
    """Read columns of one step, without atoms that were lost."""
    file = ClassicFile(ref.path)
    places = _places(file)
    if tuple(places) != ref.columns or ref.offset >= file.records:
        raise SceneError(
            f"{source_of(ref)}: the file changed after the scene was opened; open it again"
        )
    arrays = {
        name: file.read(name, ref.offset)
        for name in {places[column][0] for column in wanted} | {"id"} & {*places}
    }
    there = arrays["id"] != _LOST if "id" in arrays else slice(None)
    return {
        column: np.asarray(arrays[name] if k is None else arrays[name][:, k])[there].astype("f8")
        for column, (name, k) in places.items()
        if column in wanted
    }


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
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12


@dataclass(frozen=True)
class ClassicVariable:
    """Variable as the header describes it; `shape` is without records, `length` in bytes, padded."""

    name: str
    dtype: np.dtype
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    attrs: dict[str, object]
    begin: int
    recorded: bool
    length: int


class ClassicFile:
    """Header of a file: dimensions, variables and attributes.

    Attributes
    ----------
    records : int
        How many records the file holds.
    dims : dict
        Sizes of the dimensions by name; that of records is 0.
    variables : dict
        By name.
    attrs : dict
        Attributes of the file: texts, or arrays of numbers.

    Raises
    ------
    SceneError
        If the header is damaged, or promises more than the file holds.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._size = os.path.getsize(path)
        with open(path, "rb") as file:
            self._file: BinaryIO = file
            head = self._bytes(4)
            if head not in MARKS:
                self.refuse("is no NetCDF in a classic format")
            self._wide = head[3] == 5
            self._far = head[3] > 1
            told = self._count(most=None)
            pairs = [(self._name(), self._count(most=None)) for _ in range(self._list(_DIMENSIONS))]
            self.dims = dict(pairs)
            self.attrs = self._attributes()
            found = [
                self._variable([name for name, _ in pairs]) for _ in range(self._list(_VARIABLES))
            ]
        self.variables = {variable.name: variable for variable in found}
        recorded = [variable for variable in found if variable.recorded]
        alone = len(recorded) == 1
        self._record = (
            sum(math.prod(v.shape) * v.dtype.itemsize if alone else v.length for v in recorded)
            if recorded
            else 0
        )
        first = min((v.begin for v in recorded), default=self._size)
        # the last one may lack its padding
        room = (self._size - first + 3) // self._record if self._record else 0
        self.records = room if told == (1 << (64 if self._wide else 32)) - 1 else told
        if self._record and self.records > room:
            self.refuse(
                f"promises {self.records} records, and has room for {room}; it was cut short"
            )
        for v in found:
            if not v.recorded and v.begin + math.prod(v.shape) * v.dtype.itemsize > self._size:
                self.refuse(f"ends before its variable '{v.name}' does; it was cut short")

    def refuse(self, problem: str) -> NoReturn:
        """Raise an error that names the file."""
        raise SceneError(
            f"{self.path}: the file {problem}. Leave it out, or write it again"
        ) from None

    def _bytes(self, count: int) -> bytes:
        found = self._file.read(count)
        if len(found) < count:
            self.refuse("ends in its header")
        return found

    def _int(self) -> int:
        return int(struct.unpack(">i", self._bytes(4))[0])

    def _count(self, most: int | None = _MOST) -> int:
        number = int(
            struct.unpack(">Q" if self._wide else ">I", self._bytes(8 if self._wide else 4))[0]
        )
        if most is not None and number > most:
            self.refuse(f"has a count of {number} in its header, and is damaged")
        return number

    def _padded(self, count: int) -> bytes:
        return self._bytes(count + -count % 4)[:count]

    def _name(self) -> str:
        return self._padded(self._count(_LONGEST)).decode("utf-8", "replace")

    def _list(self, expected: int) -> int:
        tag, count = self._int(), self._count()
        if tag not in (0, expected) or (tag == 0 and count):
            self.refuse(
                f"has a list of kind {tag} in its header, expected {expected}, and is damaged"
            )
        return count

    def _type(self) -> np.dtype:
        kind = self._int()
        if kind not in _TYPES:
            self.refuse(f"has numbers of type {kind}, and is damaged")
        return np.dtype(_TYPES[kind])

    def _attributes(self) -> dict[str, object]:
        found: dict[str, object] = {}
        for _ in range(self._list(_ATTRIBUTES)):
            name = self._name()
            dtype = self._type()
            count = self._count(_LONGEST)
            data = self._padded(count * dtype.itemsize)
            found[name] = (
                data.decode("utf-8", "replace") if dtype.kind == "S" else np.frombuffer(data, dtype)
            )
        return found

    def _variable(self, dims: Sequence[str]) -> ClassicVariable:
        name = self._name()
        places = [self._count() for _ in range(self._count())]
        if any(place >= len(dims) for place in places):
            self.refuse(f"gives '{name}' a dimension that it has not, and is damaged")
        attrs, dtype = self._attributes(), self._type()
        # its size, which follows from the dimensions where it is not too large for this field
        self._count(most=None)
        begin = int(
            struct.unpack(">Q" if self._far else ">I", self._bytes(8 if self._far else 4))[0]
        )
        if begin >= _FARTHEST:
            self.refuse(f"has '{name}' at byte {begin}, and is damaged")
        mine = tuple(dims[place] for place in places)
        recorded = bool(mine) and self.dims[mine[0]] == 0
        shape = tuple(self.dims[dim] for dim in mine[recorded:])
        length = math.prod(shape) * dtype.itemsize
        return ClassicVariable(
            name, dtype, mine, shape, attrs, begin, recorded, length + -length % 4
        )

    def read(self, name: str, record: int = 0) -> NDArray:
        """Read a variable, of one record where it has records."""
        variable = self.variables[name]
        count = math.prod(variable.shape)
        at = variable.begin + (self._record * record if variable.recorded else 0)
        with open(self.path, "rb") as file:
            file.seek(at)
            data = file.read(count * variable.dtype.itemsize)
        if len(data) < count * variable.dtype.itemsize:
            self.refuse(f"ends within '{name}' of record {record}; it was cut short")
        return np.frombuffer(data, variable.dtype).reshape(variable.shape)
