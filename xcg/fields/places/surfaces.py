"""Walls as geometry: planes, cylinders and triangulated surfaces.

A wall is a surface with a side where the grains are. Normals point to that side. Two things are asked of it: which part
of space is accessible (`xcg.fields.accessible`), and cells that its stress is a field on
(`xcg.fields.studies.wall_stress`).
"""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.compiled import triangles as loops
from xcg.scene.numbers import floats, is_positive
from xcg.scene.schema import COMPONENTS
from xcg.scene.vtk_mesh import read_mesh

_MOST_CELLS = 2**24
Bounds = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Cells:
    """Cells of a surface.

    Attributes
    ----------
    dims : tuple of str
    coords : mapping
        Values and long name of each dimension.
    centre : array (n, 3)
        Centres (m), the last dimension running fastest.
    area : array (n,)
        Areas (m2).
    axes : tuple of str
        Names of the axes of shear: two along the surface, or x, y, z.
    bounds : tuple, optional
        First and last coordinate along both dimensions; None for the whole surface.
    """

    dims: tuple[str, ...]
    coords: Mapping[str, tuple[NDArray, str]]
    centre: NDArray
    area: NDArray
    axes: tuple[str, ...]
    bounds: Bounds | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each dimension."""
        return tuple(len(self.coords[dim][0]) for dim in self.dims)


class Wall(ABC):
    """A surface with grains on one side."""

    @abstractmethod
    def distance(self, points: NDArray) -> NDArray:
        """Distance (m) of points (n, 3) from the surface, positive on the side of the grains; (n,)."""

    @abstractmethod
    def normals_at(self, points: NDArray) -> NDArray:
        """Return the unit normals (n, 3), to the side of the grains, where the surface is nearest to each point."""

    @abstractmethod
    def crossings(self, points: NDArray, directions: NDArray, reach: float) -> NDArray:
        """Distances (n, m, k) at which rays (n, m, 3) from points (n, 3) cross the surface, infinity for none.

        Crossings farther than `reach` (m) may be left out.
        """

    @abstractmethod
    def varies(self, axis: int) -> bool:
        """Tell whether the surface is another one when it is shifted along x, y or z."""

    @abstractmethod
    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest coordinate that is accessible along an axis (m), infinite where it has no end."""

    @abstractmethod
    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> Cells:
        """Cells of about this size (m), where the surface has no end as far as a box (3,), (3,) reaches."""

    @abstractmethod
    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Split vectors (n, 3) at points: normal part (n,), and what is along the axes of `cells` (n, 2 or 3)."""

    def covers(self, points: NDArray, cells: Cells) -> NDArray:
        """Tell which points (n, 3) near the surface are over its cells."""
        return np.ones(len(points), bool)


def _vector(name: str, given: Any) -> NDArray:
    vector = floats(given)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        msg = f"{name}={given!r}: expected three finite numbers (x, y, z)"
        raise ValueError(msg)
    return vector


def _direction(name: str, given: Any) -> NDArray:
    vector = _vector(name, given)
    length = np.linalg.norm(vector)
    if not length > 0:
        msg = f"{name}={given!r}: expected a direction, not zero"
        raise ValueError(msg)
    return vector / length


def _axis_of(direction: NDArray) -> int | None:
    """Return the axis that a unit vector is along, None for others."""
    k = int(np.argmax(np.abs(direction)))
    return k if abs(direction[k]) > 1 - 1e-12 else None


def _frame_about(direction: NDArray) -> tuple[NDArray, NDArray]:
    """Two unit vectors that make a right-handed frame with `direction` as the third; x and y for z."""
    k = _axis_of(direction)
    first = np.eye(3)[(k + 1) % 3] if k is not None else np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first = first / np.linalg.norm(first)
    return first, np.cross(direction, first)


def _centres(low: float, high: float, spacing: float, what: str) -> NDArray:
    """Centres of cells of one size, as near to `spacing` as fits."""
    if not (np.isfinite(low) and np.isfinite(high) and low < high and spacing > 0 and (high - low) / spacing < 2**24):
        msg = f"cells along {what} from {low} to {high}, {spacing} apart: expected rising bounds and a positive spacing"
        raise ValueError(msg)
    count = max(1, round((high - low) / spacing))
    return low + (high - low) * (np.arange(count) + 0.5) / count


def _check_bounds(name: str, given: Any) -> tuple[float, float]:
    ends = floats(given)
    if ends.shape != (2,) or not np.isfinite(ends).all() or ends[0] >= ends[1]:
        msg = f"{name}={given!r}: expected (first, last) with first < last (m)"
        raise ValueError(msg)
    low, high = ends.tolist()
    return low, high


def _corners(lower: NDArray, upper: NDArray) -> NDArray:
    """Corners (8, 3) of a box."""
    return np.array([[(lower, upper)[b][k] for k, b in enumerate(bits)] for bits in np.ndindex(2, 2, 2)])


@dataclass(frozen=True)
class Plane(Wall):
    """A plane.

    Attributes
    ----------
    point : three floats
        A point of it (m).
    normal : three floats
        Its normal, to the side of the grains, of any length.
    bounds : pair of pairs of floats, optional
        First and last coordinate of its cells along its two axes (m), by default as far as the grains reach. The axes
        are two of x, y and z where it is across the third, else ``u`` and ``v``, counted from the point.

    Raises
    ------
    ValueError
        If these are not three finite numbers each, or the normal is zero.
    """

    point: Sequence[float]
    normal: Sequence[float]
    bounds: Sequence[Sequence[float]] | None = None

    def __post_init__(self) -> None:
        _vector("point", self.point)
        _direction("normal", self.normal)
        if self.bounds is not None:
            for name, pair in zip(("bounds[0]", "bounds[1]"), _pairs(self.bounds), strict=True):
                _check_bounds(name, pair)

    @cached_property
    def _frame(self) -> tuple[NDArray, NDArray, NDArray]:
        """The normal, and two axes along the plane: those of the coordinates where it is across one."""
        normal = _direction("normal", self.normal)
        k = _axis_of(normal)
        if k is not None:
            first, second = (np.eye(3)[a] for a in range(3) if a != k)
            return normal, first, second
        return (normal, *_frame_about(normal))

    @property
    def _origin(self) -> NDArray:
        """Where its two coordinates are zero."""
        point = _vector("point", self.point)
        k = _axis_of(self._frame[0])
        return point if k is None else np.where(np.arange(3) == k, point, 0.0)

    @property
    def _dims(self) -> tuple[str, str]:
        k = _axis_of(self._frame[0])
        first, second = ("u", "v") if k is None else (a for j, a in enumerate(COMPONENTS) if j != k)
        return first, second

    def distance(self, points: NDArray) -> NDArray:
        """Distance of points."""
        return (points - _vector("point", self.point)) @ self._frame[0]

    def normals_at(self, points: NDArray) -> NDArray:
        """Return normals."""
        return np.broadcast_to(self._frame[0], points.shape)

    def crossings(self, points: NDArray, directions: NDArray, reach: float) -> NDArray:
        """Where rays cross."""
        with np.errstate(divide="ignore", invalid="ignore"):
            s = -self.distance(points)[:, None] / (directions @ self._frame[0])
        return np.where(s > 0, s, np.inf)[..., None]

    def varies(self, axis: int) -> bool:
        """Whether a shift along an axis matters."""
        return bool(abs(self._frame[0][axis]) > 1e-12)

    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest accessible coordinate."""
        if _axis_of(self._frame[0]) != axis:
            return -np.inf, np.inf
        here = float(self.point[axis])
        return (here, np.inf) if self._frame[0][axis] > 0 else (-np.inf, here)

    def _coordinates(self, points: NDArray) -> NDArray:
        return np.stack([(points - self._origin) @ axis for axis in self._frame[1:]], axis=1)

    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> Cells:
        """Cells of a rectangle."""
        if self.bounds is None:
            reached = self._coordinates(_corners(lower, upper))
            bounds = [(float(low), float(high)) for low, high in zip(reached.min(0), reached.max(0), strict=True)]
        else:
            bounds = [_check_bounds("bounds", pair) for pair in self.bounds]
        sides = [_centres(*pair, spacing, dim) for pair, dim in zip(bounds, self._dims, strict=True)]
        first, second = (a.ravel() for a in np.meshgrid(*sides, indexing="ij"))
        centre = self._origin + first[:, None] * self._frame[1] + second[:, None] * self._frame[2]
        size = math.prod((high - low) / len(side) for (low, high), side in zip(bounds, sides, strict=True))
        coords = {dim: (side, f"position along {dim}") for dim, side in zip(self._dims, sides, strict=True)}
        return Cells(self._dims, coords, centre, np.full(len(centre), size), self._dims, (bounds[0], bounds[1]))

    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Parts of vectors across and along the plane."""
        normal, *along = self._frame
        return vectors @ normal, np.stack([vectors @ axis for axis in along], axis=1)

    def covers(self, points: NDArray, cells: Cells) -> NDArray:
        """Which points are over the cells."""
        assert cells.bounds is not None
        low, high = np.transpose(cells.bounds)
        x = self._coordinates(points)
        return np.asarray(((low <= x) & (x <= high)).all(axis=1))


def _pairs(bounds: Any) -> tuple[Any, Any]:
    try:
        first, second = bounds
    except (TypeError, ValueError):
        msg = f"bounds={bounds!r}: expected two pairs, ((first, last), (first, last))"
        raise ValueError(msg) from None
    return first, second


@dataclass(frozen=True)
class Cylinder(Wall):
    """The side of a circular cylinder.

    It has no ends as a wall: add planes for a floor or a lid. `low` and `high` bound the cells of its stress.

    Attributes
    ----------
    point : three floats
        A point of its axis (m).
    direction : three floats
        Along its axis, of any length.
    radius : float
        Radius (m).
    inside : bool
        Whether the grains are inside.
    low, high : float, optional
        Ends of its cells along the axis, from the point (m); by default as far as the grains reach.

    Raises
    ------
    ValueError
        If the vectors are not three finite numbers each, or the radius is not positive.
    """

    point: Sequence[float]
    direction: Sequence[float]
    radius: float
    inside: bool = True
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        _vector("point", self.point)
        _direction("direction", self.direction)
        if not (isinstance(self.radius, int | float | np.number) and 0 < self.radius < np.inf):
            msg = f"radius={self.radius!r}: expected a positive length (m)"
            raise ValueError(msg)
        if self.low is not None and self.high is not None:
            _check_bounds("(low, high)", (self.low, self.high))

    @cached_property
    def _frame(self) -> tuple[NDArray, NDArray, NDArray]:
        """The axis, and the directions of theta = 0 and a quarter turn."""
        axis = _direction("direction", self.direction)
        return (axis, *_frame_about(axis))

    @property
    def _sign(self) -> float:
        return -1.0 if self.inside else 1.0

    def _from_axis(self, points: NDArray) -> NDArray:
        """Coordinates of points across and along the axis, (n, 3)."""
        return np.stack([(points - _vector("point", self.point)) @ e for e in (*self._frame[1:], self._frame[0])], 1)

    def distance(self, points: NDArray) -> NDArray:
        """Distance of points."""
        x, y, _ = self._from_axis(points).T
        return self._sign * (np.hypot(x, y) - self.radius)

    def _radial(self, points: NDArray) -> NDArray:
        x, y, _ = self._from_axis(points).T
        theta = np.arctan2(y, x)  # zero on the axis, where no direction is the nearest
        return np.cos(theta)[:, None] * self._frame[1] + np.sin(theta)[:, None] * self._frame[2]

    def normals_at(self, points: NDArray) -> NDArray:
        """Return normals."""
        return self._sign * self._radial(points)

    def crossings(self, points: NDArray, directions: NDArray, reach: float) -> NDArray:
        """Where rays cross."""
        x, y, _ = self._from_axis(points).T
        u, v = (directions @ e for e in self._frame[1:])
        a, b = u * u + v * v, x[:, None] * u + y[:, None] * v
        c = (np.hypot(x, y) - self.radius) * (np.hypot(x, y) + self.radius)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(b * b - a * c[:, None])
            far = -b - np.where(b < 0, -root, root)  # the root without cancellation, and the other from their product
            both = np.stack([far / a, c[:, None] / far], axis=-1)
        return np.where(both > 0, both, np.inf)

    def varies(self, axis: int) -> bool:
        """Whether a shift along an axis matters."""
        return _axis_of(self._frame[0]) != axis

    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest accessible coordinate."""
        across = math.sqrt(max(0.0, 1 - float(self._frame[0][axis]) ** 2))
        if not self.inside or across < 1 - 1e-12:
            return -np.inf, np.inf
        return float(self.point[axis]) - self.radius, float(self.point[axis]) + self.radius

    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> Cells:
        """Cells in theta and along the axis."""
        reached = self._from_axis(_corners(lower, upper))[:, 2]
        low = float(reached.min()) if self.low is None else float(self.low)
        high = float(reached.max()) if self.high is None else float(self.high)
        theta = _centres(0.0, 2 * np.pi, spacing / self.radius, "theta")
        along = _centres(low, high, spacing, "the axis")
        angle, z = (a.ravel() for a in np.meshgrid(theta, along, indexing="ij"))
        axis, first, second = self._frame
        radial = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
        centre = _vector("point", self.point) + self.radius * radial + z[:, None] * axis
        size = 2 * np.pi * self.radius / len(theta) * (high - low) / len(along)
        coords = {"theta": (theta, "angle about the axis"), "z": (along, "position along the axis, from its point")}
        bounds = ((0.0, 2 * np.pi), (low, high))
        return Cells(("theta", "z"), coords, centre, np.full(len(centre), size), ("theta", "z"), bounds)

    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Parts of vectors across the side, around it and along the axis."""
        radial, axis = self._radial(points), self._frame[0]
        around = np.cross(axis, radial)
        normal = self._sign * (vectors * radial).sum(axis=1)
        return normal, np.stack([(vectors * around).sum(axis=1), vectors @ axis], axis=1)

    def covers(self, points: NDArray, cells: Cells) -> NDArray:
        """Which points are between the ends."""
        assert cells.bounds is not None
        low, high = cells.bounds[1]
        z = self._from_axis(points)[:, 2]
        return np.asarray((low <= z) & (z <= high))


class Surface(Wall):
    """A surface of triangles, closed or open.

    Parameters
    ----------
    vertices : path or array (n, 3)
        A file (``.stl``, ``.ply``, ``.obj``, ``.vtp``, ``.vtk``, by VTK's readers), or corners (m).
    triangles : array of int (m, 3), optional
        Rows of the corners of each triangle, counterclockwise seen from the grains.
    flip : bool
        Turn the normals round, where those of the file point away from the grains.
    scale : float
        Factor from the file's unit of length to that of the scene.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
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
                msg = "triangles= belongs to vertices as an array; a file holds its own"
                raise ValueError(msg)
            name = os.fspath(vertices)
            vertices, triangles = _read(name)
        if not is_positive(scale):
            msg = f"scale={scale!r}: expected a positive factor"
            raise ValueError(msg)
        points = np.asarray(vertices, float) * scale
        rows = np.asarray(np.empty((0, 3)) if triangles is None else triangles)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            msg = f"{name}: expected finite corners (n, 3), got an array {points.shape}"
            raise ValueError(msg)
        if rows.ndim != 2 or rows.shape[1] != 3 or not len(rows) or rows.dtype.kind not in "iu":
            msg = f"{name}: expected triangles, whole numbers (m, 3), got an array {rows.shape} of {rows.dtype}"
            raise ValueError(msg)
        if rows.min() < 0 or rows.max() >= len(points):
            msg = f"{name}: triangles name corners {rows.min()} to {rows.max()}, and there are {len(points)}"
            raise ValueError(msg)
        corners = points[rows[:, ::-1] if flip else rows]
        twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(twice, axis=1)
        if not (size > 0).any():
            msg = f"{name}: all triangles have no area"
            raise ValueError(msg)
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
        """Where rays cross."""
        out = np.full((*directions.shape[:2], loops.MOST_CROSSINGS), np.inf)
        given = (np.ascontiguousarray(a, "float64") for a in (points, directions))
        most = loops.crossings(*given, float(reach), self.corners, self.centre, self._radius, out)
        return out[..., : max(1, most)]

    def varies(self, axis: int) -> bool:
        """Whether a shift along an axis matters."""
        return True

    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest coordinate of its corners."""
        return float(self.corners[..., axis].min()), float(self.corners[..., axis].max())

    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> Cells:
        """Its triangles."""
        coords = {"triangle": (np.arange(len(self.area)), "number of the triangle")}
        return Cells(("triangle",), coords, self.centre, self.area, COMPONENTS)

    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Parts of vectors across the nearest triangles, and the rest."""
        normal = self.normals_at(points)
        across = (vectors * normal).sum(axis=1)
        return across, vectors - across[:, None] * normal


_SURFACES = (".stl", ".obj", ".ply", ".vtp", ".vtk")


def _read(path: str) -> tuple[NDArray, NDArray]:
    """Corners and triangles of a file."""
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in _SURFACES:
        msg = f"{path}: expected a surface in {', '.join(_SURFACES)}, or arrays of corners and triangles"
        raise ValueError(msg)
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
        msg = f"{path}: holds no triangle; is it a surface?"
        raise ValueError(msg)
    rows = vtk_to_numpy(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return vtk_to_numpy(data.GetPoints().GetData()).astype(float), rows.astype("int64")
