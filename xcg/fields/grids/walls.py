"""Walls as geometry: planes, cylinders and triangulated surfaces.

A wall is a surface with a side where the grains are; normals point to that side. It says which part
of space is accessible (`xcg.fields.accessible`), and has cells for fields of its stress
(`xcg.wall_stress`).
"""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import (
    FINITE,
    POSITIVE,
    axis_vector,
    check,
    floats,
    rising_pair,
    unit_vector,
    vector,
)
from xcg.common.vtk_mesh import read_mesh
from xcg.compiled import geometry as loops
from xcg.fields.grids.frames import axis_of, corners, frame_about, turned
from xcg.scene.schema import COMPONENTS

_FILES = (".stl", ".obj", ".ply", ".vtp", ".vtk")
_MOST_CELLS = 2**24
_FARTHEST = 100.0  # extents of the grains that a surface may have: units are 1000 apart


def cell_centres(low: float, high: float, spacing: float, what: str) -> NDArray:
    """Centres of cells of one size, as near to `spacing` as fits."""
    if not (0 < high - low < math.inf and spacing > 0 and (high - low) / spacing < _MOST_CELLS):
        raise ValueError(
            f"cells along {what} from {low} to {high}, {spacing} apart: expected rising finite bounds, a positive "
            f"spacing, and fewer than {_MOST_CELLS} cells; is the wall in another unit of length than the scene?"
        )
    count = max(1, round((high - low) / spacing))
    return low + (high - low) * (np.arange(count) + 0.5) / count


def check_count(wall: object, count: float) -> None:
    """Raise ValueError if the cells of a wall are more than memory is worth."""
    if count >= _MOST_CELLS:
        raise ValueError(
            f"{wall!r} would have {count:.2g} cells of the kernel's size, expected fewer than "
            f"{_MOST_CELLS:.2g}: is the wall in another unit of length than the scene? Its numbers are "
            "in the scene's unit, m by default; or give a larger spacing="
        )


@dataclass(frozen=True, eq=False)
class SurfaceCells:
    """Cells of a surface.

    Attributes
    ----------
    coords : mapping
        Values and long name of each dimension.
    centre : array (n, 3)
        Centres (m), the last dimension running fastest.
    area : array (n,)
        Areas (m2).
    axes : tuple of str
        Names of the axes of shear: two along the surface, or x, y, z.
    bounds : sequence of pairs
        Lowest and highest of the coordinates that bound them; none for the whole surface.
    """

    coords: Mapping[str, tuple[NDArray, str]]
    centre: NDArray
    area: NDArray
    axes: tuple[str, ...]
    bounds: NDArray | Sequence[tuple[float, float]] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each dimension."""
        return tuple(len(values) for values, _ in self.coords.values())


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

    def crossings_along(self, starts: NDArray, axis: int, reach: float) -> tuple[NDArray, NDArray]:
        """Return where rays from `starts` (n, 3) along x, y or z cross the surface.

        Returns
        -------
        is_open : array of bool (n,)
            Whether the start is on the side of the grains.
        distance : array (n, k)
            Distances of the crossings (m) in any order, infinity for none. Those beyond `reach` may
            be left out.
        """
        directions = np.broadcast_to(np.eye(3)[axis], (len(starts), 1, 3))
        return self.distance(starts) > 0, self.crossings(starts, directions, reach)[:, 0]

    @abstractmethod
    def in_axes(self, axes: NDArray, origin: NDArray) -> Wall:
        """Return the wall in other axes: `axes` (3, 3), a row each, and `origin` (3,) in the present ones."""

    @abstractmethod
    def varies(self, axis: int) -> bool:
        """Return whether a shift along x, y or z changes the surface."""

    @abstractmethod
    def turns(self) -> bool:
        """Return whether a rotation about the axis z changes the surface."""

    @abstractmethod
    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest coordinate that is accessible along an axis (m), infinite where it has no end."""

    @abstractmethod
    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> SurfaceCells:
        """Cells of about this size (m), where the surface has no end as far as a box (3,), (3,) reaches."""

    @abstractmethod
    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Split vectors (n, 3) at points: normal part (n,), and what is along the axes of `cells` (n, 2 or 3)."""

    def covers(self, points: NDArray, cells: SurfaceCells) -> NDArray:
        """Return a mask of the points (n, 3) near the surface that are over its cells."""
        if not len(cells.bounds):
            return np.ones(len(points), bool)
        low, high = np.transpose(cells.bounds)
        x = self.coordinates(points)
        return np.asarray(((low <= x) & (x <= high)).all(axis=1))

    def coordinates(self, points: NDArray) -> NDArray:
        """Coordinates along the surface that bound its cells, (n, coordinates)."""
        return np.empty((len(points), 0))


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
        First and last coordinate of its cells along its two axes (m), by default as far as the
        grains reach. The axes are two of x, y and z where it is across the third, else ``u`` and
        ``v``, counted from the point.

    Raises
    ------
    ValueError
        If point or normal are not three finite numbers, the normal is zero, or bounds are not two
        rising pairs.
    """

    point: Sequence[float]
    normal: Sequence[float]
    bounds: Sequence[Sequence[float]] | None = None

    def __post_init__(self) -> None:
        vector("point", self.point)
        unit_vector("normal", self.normal)
        if self.bounds is not None:
            if floats(self.bounds).shape != (2, 2):
                raise ValueError(
                    f"bounds={self.bounds!r}: expected two pairs, ((first, last), (first, last))"
                )
            for k in range(2):
                rising_pair(f"bounds[{k}]", self.bounds[k])

    @cached_property
    def _frame(self) -> tuple[NDArray, NDArray, NDArray]:
        """The normal, and two axes along the plane: coordinate axes where the normal is one."""
        normal = unit_vector("normal", self.normal)
        k = axis_of(normal)
        if k is None:
            return (normal, *frame_about(normal))
        return (normal, *np.delete(np.eye(3), k, axis=0))

    @property
    def _axis(self) -> int | None:
        """Axis that it is across; None for others."""
        return axis_of(self._frame[0])

    @property
    def _origin(self) -> NDArray:
        """Origin of its two coordinates."""
        point = floats(self.point)
        if self._axis is None:
            return point
        return np.where(np.arange(3) == self._axis, point, 0.0)

    def distance(self, points: NDArray) -> NDArray:
        """Distance of points."""
        return (points - floats(self.point)) @ self._frame[0]

    def normals_at(self, points: NDArray) -> NDArray:
        """Return normals."""
        return np.broadcast_to(self._frame[0], points.shape)

    def crossings(self, points: NDArray, directions: NDArray, reach: float) -> NDArray:
        """Return where rays cross."""
        with np.errstate(divide="ignore", invalid="ignore"):
            s = -self.distance(points)[:, None] / (directions @ self._frame[0])
        return np.where(s > 0, s, np.inf)[..., None]

    def in_axes(self, axes: NDArray, origin: NDArray) -> Plane:
        """Return the plane in other axes, without bounds of its cells."""
        point = axes @ (floats(self.point) - origin)
        return Plane(point.tolist(), (axes @ self._frame[0]).tolist())

    def varies(self, axis: int) -> bool:
        """Return whether a shift along an axis matters."""
        return bool(abs(self._frame[0][axis]) > 1e-12)

    def turns(self) -> bool:
        """Return whether a rotation about z matters."""
        return self._axis != 2

    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest accessible coordinate."""
        low, high = -np.inf, np.inf
        if self._axis == axis and self._frame[0][axis] > 0:
            low = float(self.point[axis])
        elif self._axis == axis:
            high = float(self.point[axis])
        return low, high

    def coordinates(self, points: NDArray) -> NDArray:
        """Coordinates along the surface."""
        return np.stack([(points - self._origin) @ axis for axis in self._frame[1:]], axis=1)

    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> SurfaceCells:
        """Cells of a rectangle."""
        reached = self.coordinates(corners(lower, upper))
        bounds = np.transpose([reached.min(0), reached.max(0)])
        if self.bounds is not None:
            bounds = floats(self.bounds)
        dims = tuple(a for k, a in enumerate(COMPONENTS) if k != self._axis)
        if self._axis is None:
            dims = ("u", "v")
        coords: dict[str, tuple[NDArray, str]] = {}
        size = 1.0
        for dim, (low, high) in zip(dims, bounds, strict=True):
            side = cell_centres(low, high, spacing, dim)
            size *= (high - low) / len(side)
            coords[dim] = (side, f"position along {dim}")
        check_count(self, math.prod(len(side) for side, _ in coords.values()))
        sides = np.meshgrid(*(side for side, _ in coords.values()), indexing="ij")
        first, second = (a.reshape(-1, 1) for a in sides)
        centre = self._origin + first * self._frame[1] + second * self._frame[2]
        return SurfaceCells(coords, centre, np.full(len(centre), size), dims, bounds)

    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Parts of vectors across and along the plane."""
        normal, *along = self._frame
        return vectors @ normal, np.stack([vectors @ axis for axis in along], axis=1)


@dataclass(frozen=True)
class Cylinder(Wall):
    """The side of a circular cylinder.

    It has no ends as a wall: add planes for a floor or a lid. `low` and `high` bound the cells of
    its stress.

    Attributes
    ----------
    point : three floats
        A point of its axis (m).
    axis : {"x", "y", "z"} or three floats
        Direction of its axis, of any length.
    radius : float
        Radius (m).
    inside : bool
        Whether the grains are inside.
    low, high : float, optional
        Ends of its cells along the axis, from the point (m); by default as far as the grains reach.

    Raises
    ------
    ValueError
        If the point is not three finite numbers, the axis is no direction, or the radius is not positive.
    """

    point: Sequence[float]
    axis: str | Sequence[float]
    radius: float
    inside: bool = True
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        vector("point", self.point)
        axis_vector("axis", self.axis)
        check("radius", self.radius, POSITIVE, "m")
        check("low", self.low, FINITE, "m", optional=True)
        check("high", self.high, FINITE, "m", optional=True)
        if self.low is not None and self.high is not None:
            rising_pair("(low, high)", (self.low, self.high))

    @cached_property
    def _sign(self) -> float:
        return -1.0 if self.inside else 1.0

    @cached_property
    def _frame(self) -> tuple[NDArray, NDArray, NDArray]:
        """The axis, and the directions of theta = 0 and a quarter turn."""
        axis = axis_vector("axis", self.axis)
        return (axis, *frame_about(axis))

    def _from_axis(self, points: NDArray) -> NDArray:
        """Coordinates of points across and along the axis, (n, 3)."""
        axis, first, second = self._frame
        from_point = points - floats(self.point)
        return np.stack([from_point @ first, from_point @ second, from_point @ axis], axis=1)

    def coordinates(self, points: NDArray) -> NDArray:
        """Coordinates along the surface."""
        return self._from_axis(points)[:, 2:]

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
        """Return where rays cross."""
        x, y, _ = self._from_axis(points).T
        u, v = (directions @ e for e in self._frame[1:])
        a = u * u + v * v
        b = x[:, None] * u + y[:, None] * v
        c = (np.hypot(x, y) - self.radius) * (np.hypot(x, y) + self.radius)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(b * b - a * c[:, None])
            # the root without cancellation, and the other from their product
            far = -b - np.where(b < 0, -root, root)
            both = np.stack([far / a, c[:, None] / far], axis=-1)
        return np.where(both > 0, both, np.inf)

    def in_axes(self, axes: NDArray, origin: NDArray) -> Cylinder:
        """Return the cylinder in other axes."""
        point = axes @ (floats(self.point) - origin)
        return replace(self, point=point.tolist(), axis=(axes @ self._frame[0]).tolist())

    def varies(self, axis: int) -> bool:
        """Return whether a shift along an axis matters."""
        return axis_of(self._frame[0]) != axis

    def turns(self) -> bool:
        """Return whether a rotation about z matters."""
        beside = math.hypot(self.point[0], self.point[1])
        return axis_of(self._frame[0]) != 2 or beside > 1e-12 * self.radius

    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest accessible coordinate."""
        across = math.sqrt(max(0.0, 1 - float(self._frame[0][axis]) ** 2)) > 1 - 1e-12
        if not (self.inside and across):
            return -np.inf, np.inf
        return float(self.point[axis]) - self.radius, float(self.point[axis]) + self.radius

    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> SurfaceCells:
        """Cells in theta and along the axis."""
        reached = self.coordinates(corners(lower, upper))
        low = float(reached.min())
        high = float(reached.max())
        if self.low is not None:
            low = float(self.low)
        if self.high is not None:
            high = float(self.high)
        theta = cell_centres(0.0, 2 * np.pi, spacing / self.radius, "theta")
        along = cell_centres(low, high, spacing, "the axis")
        check_count(self, len(theta) * len(along))
        angle, z = (a.ravel() for a in np.meshgrid(theta, along, indexing="ij"))
        axis, first, second = self._frame
        radial = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
        centre = floats(self.point) + self.radius * radial + z[:, None] * axis
        size = 2 * np.pi * self.radius / len(theta) * (high - low) / len(along)
        coords = {
            "theta": (theta, "angle about the axis"),
            "z": (along, "position along the axis, from its point"),
        }
        return SurfaceCells(
            coords, centre, np.full(len(centre), size), tuple(coords), [(low, high)]
        )

    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Parts of vectors across the side, around it and along the axis."""
        radial = self._radial(points)
        axis = self._frame[0]
        around = np.cross(axis, radial)
        normal = self._sign * (vectors * radial).sum(axis=1)
        return normal, np.stack([(vectors * around).sum(axis=1), vectors @ axis], axis=1)


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
        If the file is of another kind or holds no triangle, or corners are missing, not finite or
        in one line.
    """

    def __init__(
        self,
        vertices: str | os.PathLike[str] | ArrayLike,
        triangles: ArrayLike | None = None,
        *,
        flip: bool = False,
        scale: float = 1.0,
    ) -> None:
        name = "vertices"
        if isinstance(vertices, str | os.PathLike):
            if triangles is not None:
                raise ValueError("triangles= belongs to vertices as an array; a file holds its own")
            name = os.fspath(vertices)
            vertices, triangles = _read(name)
        check("scale", scale, POSITIVE)
        points = np.asarray(vertices, float) * scale
        rows = np.asarray(triangles)
        if points.shape[1:] != (3,) or not np.isfinite(points).all():
            raise ValueError(f"{name}: expected finite corners (n, 3), got an array {points.shape}")
        if rows.shape[1:] != (3,) or not len(rows) or rows.dtype.kind not in "iu":
            raise ValueError(
                f"{name}: expected triangles, whole numbers (m, 3), got {rows.shape} of {rows.dtype}"
            )
        if rows.min() < 0 or rows.max() >= len(points):
            raise ValueError(
                f"{name}: triangles name corners {rows.min()} to {rows.max()}, there are {len(points)}"
            )
        if flip:
            rows = rows[:, ::-1]
        corners = points[rows]
        twice = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(twice, axis=1)
        if not (size > 0).any():
            raise ValueError(f"{name}: all triangles have no area")
        # slivers without an area have no normal
        self.corners = np.ascontiguousarray(corners[size > 0])
        self.area = size[size > 0] / 2
        self.normals = twice[size > 0] / size[size > 0, None]
        self.centre = self.corners.mean(axis=1)
        self._radius = np.linalg.norm(self.corners - self.centre[:, None], axis=2).max(axis=1)

    def __repr__(self) -> str:
        return f"Surface({len(self.area)} triangles, {self.area.sum():g} m2)"

    def check_unit(self, lower: NDArray, upper: NDArray, size: float) -> None:
        """Raise ValueError if the surface is far larger than the grains, or smaller than one.

        `lower` and `upper` (3,) are corners of the box around grains of diameter `size`.
        """
        extent = float(np.ptp(self.corners.reshape(-1, 3), axis=0).max())
        whole = float((upper - lower).max())
        if extent > _FARTHEST * whole > 0 or extent < size / 2:
            raise ValueError(
                f"{self!r} extends over {extent:.3g}, grains of {size:.3g} over {whole:.3g}: is it in another "
                "unit of length than the scene? xcg.Surface(..., scale=0.001) takes a file in mm for a "
                "scene in m. Of a surface that is really so large, pass the part at the grains"
            )

    def _nearest(self, points: NDArray) -> tuple[NDArray, NDArray]:
        """Signed distance (n,), and the number of the nearest triangle (n,)."""
        distance = np.empty(len(points))
        triangle = np.empty(len(points), "int64")
        points = np.ascontiguousarray(points, "float64")
        loops.nearest(
            points,
            self.corners,
            self.normals,
            self.centre,
            self._radius,
            np.empty(3),
            distance,
            triangle,
        )
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
        rays = (np.ascontiguousarray(a, "float64") for a in (points, directions))
        most = loops.crossings(*rays, float(reach), self.corners, self.centre, self._radius, out)
        return out[..., : max(1, most)]

    @cached_property
    def _encloses(self) -> bool:
        """Return True if each edge is shared by two triangles, so that the surface has an inside and an outside."""
        _, number = np.unique(self.corners.reshape(-1, 3), axis=0, return_inverse=True)
        rows = number.reshape(-1, 3)
        first = rows.ravel()
        second = np.roll(rows, -1, axis=1).ravel()
        count = len(number)
        return np.array_equal(np.sort(first * count + second), np.sort(second * count + first))

    def crossings_along(self, starts: NDArray, axis: int, reach: float) -> tuple[NDArray, NDArray]:
        """Return where rays from `starts` (n, 3) along x, y or z cross the surface.

        The sides of a ray follow from the triangle that its line crosses first. A line that crosses
        none is outside of a closed surface. Beside an open one, it is on the side of its point at
        half the height of the surface.
        """
        across = [k for k in range(3) if k != axis]
        order = np.argsort(starts[:, across[0]])
        lines = np.ascontiguousarray(starts[order][:, across])
        corners = np.ascontiguousarray(self.corners[..., [*across, axis]])
        facing = np.ascontiguousarray(self.normals[:, axis])
        count = np.zeros(len(starts), "int64")
        is_open_below = np.zeros(len(starts), bool)
        loops.line_crossings(
            lines, corners, facing, count, np.empty((len(starts), 0)), is_open_below
        )
        crossings = np.full((len(starts), max(1, int(count.max()))), np.inf)
        count[:] = 0
        loops.line_crossings(lines, corners, facing, count, crossings, is_open_below)
        missed = np.flatnonzero(count == 0)
        if self._encloses:
            heights = self.centre[:, axis] - self.centre[0, axis]
            # negative if normals point inwards
            volume = (heights * self.normals[:, axis] * self.area).sum()
            is_open_below[missed] = volume > 0
        elif len(missed):
            points = starts[order[missed]].copy()
            points[:, axis] = np.mean(self.span(axis))
            is_open_below[missed] = self.distance(points) > 0
        inverse = np.argsort(order)
        distance = crossings[inverse] - starts[:, axis, None]
        before = (distance <= 0).sum(axis=1)
        is_open = is_open_below[inverse] ^ (before % 2 == 1)
        return is_open, np.where(distance > 0, distance, np.inf)

    def in_axes(self, axes: NDArray, origin: NDArray) -> Surface:
        """Return the surface in other axes."""
        points = turned(self.corners.reshape(-1, 3), axes, origin)
        return Surface(points, np.arange(len(points)).reshape(-1, 3))

    def varies(self, axis: int) -> bool:
        """Return whether a shift along an axis matters."""
        return True

    def turns(self) -> bool:
        """Return whether a rotation about z matters."""
        return True

    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest coordinate of its corners."""
        return float(self.corners[..., axis].min()), float(self.corners[..., axis].max())

    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> SurfaceCells:
        """Its triangles."""
        coords = {"triangle": (np.arange(len(self.area)), "number of the triangle")}
        return SurfaceCells(coords, self.centre, self.area, COMPONENTS)

    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Parts of vectors across the nearest triangles, and the rest."""
        normal = self.normals_at(points)
        across = (vectors * normal).sum(axis=1)
        return across, vectors - across[:, None] * normal


def _read(path: str) -> tuple[NDArray, NDArray]:
    """Corners and triangles of a file."""
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in _FILES:
        raise ValueError(
            f"{path}: expected a surface in {', '.join(_FILES)}, or arrays of corners and triangles"
        )
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
