"""Points in VTKHDF files (``.vtkhdf``, ``.hdf``): PolyData and unstructured grids, of one step or many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.engine import StepRef
from xcg.readers.files.hdf5data import dataset, opened, text_of
from xcg.readers.files.text import source_of
from xcg.readers.files.vtkheader import OF_CELLS, TIMES, mesh_of_cells
from xcg.scene.schema import Frame

if TYPE_CHECKING:
    import h5py

KIND = "vtkhdf"  # of a step
_POINTS = "Points"
_ROOT = "VTKHDF"


def has_group(path: str) -> bool:
    """Return whether an HDF5 file has the group of VTKHDF."""
    with opened(path) as file:
        return _ROOT in file


def mesh_of(path: str) -> str:
    """Return what a file holds in place of grains: polygons without vertices, cells of an extent, an image; else ""."""
    with opened(path) as file:
        if _ROOT not in file or "Type" not in file[_ROOT].attrs:
            raise SceneError(
                f"{path}: it has no group {_ROOT} with a type; give engine='hdf5' and mapping= for other HDF5"
            )
        kind = text_of(file[_ROOT].attrs["Type"])
        if kind == "PolyData":
            polygons = _cells(file, "Polygons") + _cells(file, "Strips")
            return mesh_of_cells(polygons, _cells(file, "Vertices"), ())
        if kind == "UnstructuredGrid":
            return mesh_of_cells(0, 0, dataset(file, f"{_ROOT}/Types")[()])
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
        of_cells = [name + OF_CELLS for name in _members(file, "CellData")]
        columns = (_POINTS, *_members(file, "PointData"), *of_cells)
        refs = _steps(file, path)
    count = max((ref.rows for ref in refs), default=0)
    if count > len(points):
        raise SceneError(
            f"{path}: a step of {count} points is promised, and the file holds {len(points)}; it was cut short. Leave "
            "it out, or write it again"
        )
    return [replace(ref, columns=columns, kind=KIND) for ref in refs]


def _steps(file: h5py.File, path: str) -> list[StepRef]:
    """List the steps with their rows and times."""
    counts = _numbers(file, "NumberOfPoints")
    if f"{_ROOT}/Steps" not in file:
        return [StepRef(path, int(counts.sum()), _time_of(file), step=-1)]
    times = np.asarray(dataset(file, f"{_ROOT}/Steps/Values"), "float64")
    starts = _numbers(file, "Steps/PartOffsets")
    parts = _numbers(file, "Steps/NumberOfParts")
    if not len(times) == len(starts) == len(parts) or not np.isfinite(times).all():
        raise SceneError(
            f"{path}: {_ROOT}/Steps holds {len(times)} times, {len(starts)} offsets and {len(parts)} numbers of "
            "parts; expected one of each for each step"
        )
    if len(starts) and (starts + parts).max() > len(counts):
        raise SceneError(f"{path}: {_ROOT}/Steps names parts beyond the {len(counts)} of the file")
    refs = []
    for step, (time, start, number) in enumerate(zip(times, starts, parts, strict=True)):
        count = int(counts[start : start + number].sum())
        refs.append(StepRef(path, count, float(time), step, offset=step))
    return refs


def read_arrays(ref: StepRef, names: Sequence[str]) -> Frame:
    """Read arrays of one step by name, as float64.

    Raises
    ------
    SceneError
        If the file is damaged, or shorter than its header says.
    """
    with opened(ref.path) as file:
        return {name: _read(file, ref, name) for name in dict.fromkeys(names)}


def _read(file: h5py.File, ref: StepRef, name: str) -> NDArray:
    path = f"{_ROOT}/PointData/{name}"
    if name == _POINTS:
        path = f"{_ROOT}/{_POINTS}"
    data = dataset(file, path)
    start = 0
    if f"{_ROOT}/Steps" in file:
        offsets = f"Steps/PointDataOffsets/{name}"
        if f"{_ROOT}/{offsets}" not in file:
            offsets = "Steps/PointOffsets"
        start = int(_numbers(file, offsets)[ref.offset : ref.offset + 1].sum())
    values = np.asarray(data[start : start + ref.rows], "float64")
    if len(values) != ref.rows:
        raise SceneError(
            f"{source_of(ref)}: {path} holds {len(data)} rows, and {ref.rows} from {start} on were promised; the "
            "file was cut short. Leave it out, or write it again"
        )
    return values


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
    path = f"{group}/NumberOfCells"
    return int(_numbers(file, path).sum()) if f"{_ROOT}/{path}" in file else 0


def _numbers(file: h5py.File, path: str) -> NDArray:
    """Read counts or offsets; raise SceneError for negative ones."""
    data = dataset(file, f"{_ROOT}/{path}")
    numbers = np.asarray(data).ravel()
    if numbers.dtype.kind not in "iu" or (numbers < 0).any() or (numbers > 1 << 48).any():
        raise SceneError(f"{file.filename}: {data.name} holds no counts; the file is damaged")
    return numbers.astype(np.int64)
