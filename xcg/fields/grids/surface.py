"""A triangulated surface as a wall, of a file or of arrays."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import is_positive
from xcg.common.vtk_mesh import read_mesh
from xcg.compiled import geometry as loops
from xcg.fields.grids.wall_shapes import SurfaceCells, Wall
from xcg.scene.schema import COMPONENTS

_FILES = (".stl", ".obj", ".ply", ".vtp", ".vtk")


class Surface(Wall):
    """A surface of triangles, closed or open.

    Parameters
    ----------
    vertices : path or array (n, 3)
        A file (``.stl``, ``.ply``, ``.obj``, ``.vtp``, ``.vtk``, by VTK's readers), or corners (m).
    triangles : array of int (m, 3), optional
        Rows of the corners of each triangle, counterclockwise seen from the grains.
    flip : bool
        Turn the normals round, where normals in the file point away from the grains.
    scale : float
        Factor from the file's unit of length to that of the scene.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If the file is of another kind or holds no triangle, or corners are missing, not finite or in one line.
    """

    def __init__(
        self, vertices: str | os.PathLike[str] | ArrayLike, triangles: ArrayLike | None = None, *, flip: bool = False,
        scale: float = 1.0,
    ) -> None:  # fmt: skip
        name = "vertices"
        if isinstance(vertices, str | os.PathLike):
            if triangles is not None:
                raise ValueError("triangles= belongs to vertices as an array; a file holds its own")
            name = os.fspath(vertices)
            vertices, triangles = _read(name)
        if not is_positive(scale):
            raise ValueError(f"scale={scale!r}: expected a positive factor")
        points = np.asarray(vertices, float) * scale
        rows = np.asarray(np.empty((0, 3)) if triangles is None else triangles)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ValueError(f"{name}: expected finite corners (n, 3), got an array {points.shape}")
        if rows.ndim != 2 or rows.shape[1] != 3 or not len(rows) or rows.dtype.kind not in "iu":
            raise ValueError(f"{name}: expected triangles, whole numbers (m, 3), got {rows.shape} of {rows.dtype}")
        if rows.min() < 0 or rows.max() >= len(points):
            raise ValueError(f"{name}: triangles name corners {rows.min()} to {rows.max()}, there are {len(points)}")
        corners = points[rows[:, ::-1] if flip else rows]
        twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(twice, axis=1)
        if not (size > 0).any():
            raise ValueError(f"{name}: all triangles have no area")
        self.corners = np.ascontiguousarray(corners[size > 0])  # slivers without an area have no normal
        self.area = size[size > 0] / 2
        self.normals = twice[size > 0] / size[size > 0, None]
        self.centre = self.corners.mean(axis=1)
        self._radius = np.linalg.norm(self.corners - self.centre[:, None], axis=2).max(axis=1)

    def __repr__(self) -> str:
        return f"Surface({len(self.area)} triangles, {self.area.sum():g} m2)"

    def _nearest(self, points: NDArray) -> tuple[NDArray, NDArray]:
        """Signed distance (n,), and the number of the nearest triangle (n,)."""
        distance, triangle = np.empty(len(points)), np.empty(len(points), "int64")
        points = np.ascontiguousarray(points, "float64")
        loops.nearest(points, self.corners, self.normals, self.centre, self._radius, np.empty(3), distance, triangle)
        return distance, triangle

    def distance(self, points: NDArray) -> NDArray:
        """Distance of points."""
        return self._nearest(points)[0]

    def normals_at(self, points: NDArray) -> NDArray:
        """Return normals."""
        return self.normals[self._nearest(points)[1]]

    def crossings(self, points: NDArray, directions: NDArray, reach: float) -> NDArray:
        """Return where rays cross."""
        out = np.full((*directions.shape[:2], loops.MOST_CROSSINGS), np.inf)
        given = (np.ascontiguousarray(a, "float64") for a in (points, directions))
        most = loops.crossings(*given, float(reach), self.corners, self.centre, self._radius, out)
        return out[..., : max(1, most)]

    def varies(self, axis: int) -> bool:
        """Return whether a shift along an axis matters."""
        return True

    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest coordinate of its corners."""
        return float(self.corners[..., axis].min()), float(self.corners[..., axis].max())

    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> SurfaceCells:
        """Its triangles."""
        coords = {"triangle": (np.arange(len(self.area)), "number of the triangle")}
        return SurfaceCells(("triangle",), coords, self.centre, self.area, COMPONENTS)

    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Parts of vectors across the nearest triangles, and the rest."""
        normal = self.normals_at(points)
        across = (vectors * normal).sum(axis=1)
        return across, vectors - across[:, None] * normal


def _read(path: str) -> tuple[NDArray, NDArray]:
    """Corners and triangles of a file."""
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in _FILES:
        raise ValueError(f"{path}: expected a surface in {', '.join(_FILES)}, or arrays of corners and triangles")
    mesh = read_mesh(path, empty=True)

    from vtkmodules.util.numpy_support import vtk_to_numpy  # VTK is slow to import
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter

    faces = vtkTriangleFilter()
    if mesh.IsA("vtkPolyData"):
        faces.SetInputData(mesh)
        faces.PassLinesOff()
        faces.PassVertsOff()
        faces.Update()
    data = faces.GetOutput()
    if not data.GetNumberOfPolys():
        raise ValueError(f"{path}: holds no triangle; is it a surface?")
    rows = vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return vtk_to_numpy(data.GetPoints().GetData()).astype(float), rows.astype("int64")
