"""Points in VTKHDF files (``.vtkhdf``): PolyData and unstructured grids, of one step or many."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.engine import StepRef
from xcg.readers.files.hdf5data import MAGIC, dataset, opened
from xcg.readers.files.text import source_of
from xcg.readers.files.vtkheader import LAST_LINE, OF_CELLS, TIMES
from xcg.scene.schema import Frame

if TYPE_CHECKING:
    import h5py

KIND = "vtkhdf"  # of a step
_POINTS = "Points"
_ROOT = "VTKHDF"


def is_vtkhdf(path: str) -> bool:
    """Return whether a file is HDF5, by its first bytes."""
    with open(path, "rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def mesh_of(path: str) -> str:
    """Return what a file holds in place of grains: polygons without vertices, cells of an extent, an image; else ""."""
    with opened(path) as file:
        kind = _kind(file)
        if kind == "PolyData":
            polygons = _cells(file, "Polygons") + _cells(file, "Strips")
            return f"{polygons} polygons" if polygons and not _cells(file, "Vertices") else ""
        if kind == "UnstructuredGrid":
            extended = np.count_nonzero(np.asarray(dataset(file, f"{_ROOT}/Types")) > LAST_LINE)
            return f"{extended} cells that are no vertices" if extended else ""
        return f"VTKHDF of the type {kind}"


def list_steps(path: str) -> list[StepRef]:
    """List the steps of a file of points.

    Raises
    ------
    SceneError
        If the file is damaged, or counts and offsets lie beyond its arrays.
    """
    with opened(path) as file:
        points = dataset(file, f"{_ROOT}/{_POINTS}")
        if points.ndim != 2 or points.shape[1] != 3:
            raise SceneError(f"{path}: {points.name} has the shape {points.shape}, expected (n, 3)")
        columns = (
            _POINTS,
            *_members(file, "PointData"),
            *(name + OF_CELLS for name in _members(file, "CellData")),
        )
        counts = _numbers(file, "NumberOfPoints")
        if f"{_ROOT}/Steps" not in file:
            _check_points(path, counts.sum(), len(points))
            time = _time_of(file)
            return [StepRef(path, int(counts.sum()), time, step=-1, columns=columns, kind=KIND)]
        times = np.asarray(dataset(file, f"{_ROOT}/Steps/Values"), "float64")
        starts = _numbers(file, "Steps/PartOffsets")
        parts = _numbers(file, "Steps/NumberOfParts")
        if not len(times) == len(starts) == len(parts) or not np.isfinite(times).all():
            raise SceneError(
                f"{path}: {_ROOT}/Steps holds {len(times)} times, {len(starts)} offsets and {len(parts)} numbers of "
                "parts; expected one of each for each step"
            )
        if len(starts) and (starts + parts).max() > len(counts):
            raise SceneError(
                f"{path}: {_ROOT}/Steps names parts beyond the {len(counts)} of the file"
            )
        rows = [
            int(counts[start : start + number].sum())
            for start, number in zip(starts, parts, strict=True)
        ]
        _check_points(path, max(rows, default=0), len(points))
        return [
            StepRef(path, count, float(time), step, columns=columns, offset=step, kind=KIND)
            for step, (count, time) in enumerate(zip(rows, times, strict=True))
        ]


def _check_points(path: str, rows: int, points: int) -> None:
    """Raise SceneError for a step of more rows than there are points."""
    if rows > points:
        raise SceneError(
            f"{path}: a step of {rows} points is promised, and the file holds {points}; it was cut short. Leave it "
            "out, or write it again"
        )


def read_arrays(ref: StepRef, names: Sequence[str]) -> Frame:
    """Read arrays of one step by name, as float64; none of a step without points, whose file may lack them.

    Raises
    ------
    SceneError
        If the file is damaged, or shorter than its header says.
    """
    if not ref.rows:
        return {}
    with opened(ref.path) as file:
        return {name: _read(file, ref, name) for name in dict.fromkeys(names)}


def _read(file: h5py.File, ref: StepRef, name: str) -> NDArray[np.float64]:
    place = f"{_ROOT}/{_POINTS}" if name == _POINTS else f"{_ROOT}/PointData/{name}"
    data = dataset(file, place)
    start = 0
    if f"{_ROOT}/Steps" in file:
        own = f"Steps/PointDataOffsets/{name}"
        offsets = own if f"{_ROOT}/{own}" in file else "Steps/PointOffsets"
        start = int(_numbers(file, offsets)[ref.offset : ref.offset + 1].sum())
    values = np.asarray(data[start : start + ref.rows], "float64")
    if len(values) != ref.rows:
        raise SceneError(
            f"{source_of(ref)}: {place} holds {len(data)} rows, and {ref.rows} from {start} on were promised; the "
            "file was cut short. Leave it out, or write it again"
        )
    return values


def _kind(file: h5py.File) -> str:
    """Return the type of a VTKHDF file."""
    group = file.get(_ROOT)
    kind: Any = None if group is None else group.attrs.get("Type")
    if kind is None:
        raise SceneError(
            f"{file.filename}: it has no group {_ROOT} with a type; give engine='hdf5' and mapping= for other HDF5"
        )
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)


def _time_of(file: h5py.File) -> float | None:
    """Return the time in the array TimeValue or TIME of a file of one step."""
    for name in _members(file, "FieldData"):
        if name.lower() in TIMES:
            numbers = np.ravel(dataset(file, f"{_ROOT}/FieldData/{name}"))
            return float(numbers[0]) if numbers.size == 1 and np.isfinite(numbers[0]) else None
    return None


def _members(file: h5py.File, group: str) -> list[str]:
    """Return the names of the arrays in a group."""
    return list(file.get(f"{_ROOT}/{group}") or ())


def _cells(file: h5py.File, group: str) -> int:
    """Return the number of cells of one kind, of all steps."""
    place = f"{group}/NumberOfCells"
    return int(_numbers(file, place).sum()) if f"{_ROOT}/{place}" in file else 0


def _numbers(file: h5py.File, place: str) -> NDArray[np.int64]:
    """Read counts or offsets; raise SceneError for negative ones."""
    data = dataset(file, f"{_ROOT}/{place}")
    numbers = np.asarray(data).ravel()
    if numbers.dtype.kind not in "iu" or (numbers < 0).any() or (numbers > 1 << 48).any():
        raise SceneError(f"{file.filename}: {data.name} holds no counts; the file is damaged")
    return numbers.astype(np.int64)
