"""Meshes and surfaces of files, by VTK's readers, which are imported when they are needed."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# reader of each suffix: its module in vtkmodules, and its name
READERS = {
    ".vtu": ("vtkIOXML", "vtkXMLUnstructuredGridReader"),
    ".vtp": ("vtkIOXML", "vtkXMLPolyDataReader"),
    ".vts": ("vtkIOXML", "vtkXMLStructuredGridReader"),
    ".vtr": ("vtkIOXML", "vtkXMLRectilinearGridReader"),
    ".vti": ("vtkIOXML", "vtkXMLImageDataReader"),
    ".vtk": ("vtkIOLegacy", "vtkDataSetReader"),
    ".stl": ("vtkIOGeometry", "vtkSTLReader"),
    ".obj": ("vtkIOGeometry", "vtkOBJReader"),
    ".ply": ("vtkIOPLY", "vtkPLYReader"),
}


def read_mesh(path: str | os.PathLike[str], *, empty: bool = False) -> Any:
    """Read a mesh or a surface: a vtkDataSet, with at least one point unless it may be `empty`.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If the name ends otherwise, or VTK cannot read the file.
    """
    path = Path(path)
    if path.suffix.lower() not in READERS:
        raise ValueError(f"{path}: expected a mesh in {', '.join(READERS)}")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such file")
    module, name = READERS[path.suffix.lower()]
    reader = getattr(importlib.import_module(f"vtkmodules.{module}"), name)()
    problems: list[str] = []

    def note(_: Any, __: str, text: str) -> None:
        problems.append(text.strip().splitlines()[-1])

    note.CallDataType = "string0"  # type: ignore[attr-defined]
    reader.AddObserver("ErrorEvent", note)
    if parser := getattr(reader, "GetXMLParser", lambda: None)():
        parser.AddObserver("ErrorEvent", note)
    reader.SetFileName(os.fspath(path))
    reader.Update()
    mesh = reader.GetOutput()
    if problems or mesh is None or not (empty or mesh.GetNumberOfPoints()):
        raise ValueError(
            f"{path}: VTK reads no points from it"
            + "".join(f"; {problem}" for problem in problems[:1])
        )
    return mesh


def points_of(mesh: Any, *, centers: bool) -> NDArray:
    """Points (n, 3) of a vtkDataSet, or centres of its cells."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkDoubleArray

    if centers:
        from vtkmodules.vtkFiltersCore import vtkCellCenters

        centres = vtkDoubleArray()
        centres.SetNumberOfComponents(3)
        centres.SetNumberOfTuples(mesh.GetNumberOfCells())
        vtkCellCenters.ComputeCellCenters(mesh, centres)
        return vtk_to_numpy(centres).reshape(-1, 3).copy()
    if hasattr(mesh, "GetPoints") and mesh.GetPoints() is not None:
        return vtk_to_numpy(mesh.GetPoints().GetData()).reshape(-1, 3).astype("float64")
    return np.array([mesh.GetPoint(k) for k in range(mesh.GetNumberOfPoints())])
