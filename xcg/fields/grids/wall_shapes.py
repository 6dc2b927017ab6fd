"""Walls as geometry: what all have in common, planes and cylinders; triangulated ones are in `surface`.

A wall is a surface with a side where the grains are; normals point to that side. It says which part of space is
accessible (`xcg.fields.accessible`), and has cells for fields of its stress (`xcg.fields.analysis.surfaces`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.checks import is_positive, rising_pair, unit_vector, vector
from xcg.scene.schema import COMPONENTS

_MOST_CELLS = 2**24


def axis_of(direction: NDArray) -> int | None:
    """Return the axis that a unit vector is along, None for others."""
    k = int(np.argmax(np.abs(direction)))
    return k if abs(direction[k]) > 1 - 1e-12 else None


def frame_about(direction: NDArray) -> tuple[NDArray, NDArray]:
    """Two unit vectors that make a right-handed frame with `direction` as the third; x and y for z."""
    k = axis_of(direction)
    first = np.eye(3)[(k + 1) % 3] if k is not None else np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first = first / np.linalg.norm(first)
    return first, np.cross(direction, first)


def cell_centres(low: float, high: float, spacing: float, what: str) -> NDArray:
    """Centres of cells of one size, as near to `spacing` as fits."""
    if not (
        np.isfinite(low) and np.isfinite(high) and low < high and spacing > 0 and (high - low) / spacing < _MOST_CELLS
    ):
        raise ValueError(
            f"cells along {what} from {low} to {high}, {spacing} apart: expected rising finite bounds, a positive "
            f"spacing, and fewer than {_MOST_CELLS} cells"
        )
    count = max(1, round((high - low) / spacing))
    return low + (high - low) * (np.arange(count) + 0.5) / count


def corners(lower: NDArray, upper: NDArray) -> NDArray:
    """Corners (8, 3) of a box."""
    return np.array([[(lower, upper)[b][k] for k, b in enumerate(bits)] for bits in np.ndindex(2, 2, 2)])


Bounds = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class SurfaceCells:
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
        """Return whether a shift along x, y or z changes the surface."""

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
        return np.ones(len(points), bool)


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
        If point or normal are not three finite numbers, the normal is zero, or bounds are not two rising pairs.
    """

    point: Sequence[float]
    normal: Sequence[float]
    bounds: Sequence[Sequence[float]] | None = None

    def __post_init__(self) -> None:
        vector("point", self.point)
        unit_vector("normal", self.normal)
        if self.bounds is not None:
            for name, pair in zip(("bounds[0]", "bounds[1]"), _pairs(self.bounds), strict=True):
                rising_pair(name, pair)

    @cached_property
    def _frame(self) -> tuple[NDArray, NDArray, NDArray]:
        """The normal, and two axes along the plane: coordinate axes where the normal is one."""
        normal = unit_vector("normal", self.normal)
        k = axis_of(normal)
        if k is not None:
            first, second = (np.eye(3)[a] for a in range(3) if a != k)
            return normal, first, second
        return (normal, *frame_about(normal))

    @property
    def _origin(self) -> NDArray:
        """Origin of its two coordinates."""
        point = vector("point", self.point)
        k = axis_of(self._frame[0])
        return point if k is None else np.where(np.arange(3) == k, point, 0.0)

    @property
    def _dims(self) -> tuple[str, str]:
        k = axis_of(self._frame[0])
        first, second = ("u", "v") if k is None else (a for j, a in enumerate(COMPONENTS) if j != k)
        return first, second

    def distance(self, points: NDArray) -> NDArray:
        """Distance of points."""
        return (points - vector("point", self.point)) @ self._frame[0]

    def normals_at(self, points: NDArray) -> NDArray:
        """Return normals."""
        return np.broadcast_to(self._frame[0], points.shape)

    def crossings(self, points: NDArray, directions: NDArray, reach: float) -> NDArray:
        """Return where rays cross."""
        with np.errstate(divide="ignore", invalid="ignore"):
            s = -self.distance(points)[:, None] / (directions @ self._frame[0])
        return np.where(s > 0, s, np.inf)[..., None]

    def varies(self, axis: int) -> bool:
        """Return whether a shift along an axis matters."""
        return bool(abs(self._frame[0][axis]) > 1e-12)

    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest accessible coordinate."""
        if axis_of(self._frame[0]) != axis:
            return -np.inf, np.inf
        here = float(self.point[axis])
        return (here, np.inf) if self._frame[0][axis] > 0 else (-np.inf, here)

    def _coordinates(self, points: NDArray) -> NDArray:
        return np.stack([(points - self._origin) @ axis for axis in self._frame[1:]], axis=1)

    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> SurfaceCells:
        """Cells of a rectangle."""
        if self.bounds is None:
            reached = self._coordinates(corners(lower, upper))
            bounds = [(float(low), float(high)) for low, high in zip(reached.min(0), reached.max(0), strict=True)]
        else:
            bounds = [rising_pair("bounds", pair) for pair in self.bounds]
        sides = [cell_centres(*pair, spacing, dim) for pair, dim in zip(bounds, self._dims, strict=True)]
        first, second = (a.ravel() for a in np.meshgrid(*sides, indexing="ij"))
        centre = self._origin + first[:, None] * self._frame[1] + second[:, None] * self._frame[2]
        size = math.prod((high - low) / len(side) for (low, high), side in zip(bounds, sides, strict=True))
        coords = {dim: (side, f"position along {dim}") for dim, side in zip(self._dims, sides, strict=True)}
        return SurfaceCells(self._dims, coords, centre, np.full(len(centre), size), self._dims, (bounds[0], bounds[1]))

    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Parts of vectors across and along the plane."""
        normal, *along = self._frame
        return vectors @ normal, np.stack([vectors @ axis for axis in along], axis=1)

    def covers(self, points: NDArray, cells: SurfaceCells) -> NDArray:
        """Return a mask of the points over the cells."""
        assert cells.bounds is not None
        low, high = np.transpose(cells.bounds)
        x = self._coordinates(points)
        return np.asarray(((low <= x) & (x <= high)).all(axis=1))


def _pairs(bounds: Any) -> tuple[Any, Any]:
    try:
        first, second = bounds
    except (TypeError, ValueError):
        raise ValueError(f"bounds={bounds!r}: expected two pairs, ((first, last), (first, last))") from None
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
        vector("point", self.point)
        unit_vector("direction", self.direction)
        if not is_positive(self.radius):
            raise ValueError(f"radius={self.radius!r}: expected a positive length (m)")
        if self.low is not None and self.high is not None:
            rising_pair("(low, high)", (self.low, self.high))

    @cached_property
    def _frame(self) -> tuple[NDArray, NDArray, NDArray]:
        """The axis, and the directions of theta = 0 and a quarter turn."""
        axis = unit_vector("direction", self.direction)
        return (axis, *frame_about(axis))

    @property
    def _sign(self) -> float:
        return -1.0 if self.inside else 1.0

    def _from_axis(self, points: NDArray) -> NDArray:
        """Coordinates of points across and along the axis, (n, 3)."""
        return np.stack([(points - vector("point", self.point)) @ e for e in (*self._frame[1:], self._frame[0])], 1)

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
        a, b = u * u + v * v, x[:, None] * u + y[:, None] * v
        c = (np.hypot(x, y) - self.radius) * (np.hypot(x, y) + self.radius)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(b * b - a * c[:, None])
            far = -b - np.where(b < 0, -root, root)  # the root without cancellation, and the other from their product
            both = np.stack([far / a, c[:, None] / far], axis=-1)
        return np.where(both > 0, both, np.inf)

    def varies(self, axis: int) -> bool:
        """Return whether a shift along an axis matters."""
        return axis_of(self._frame[0]) != axis

    def span(self, axis: int) -> tuple[float, float]:
        """Lowest and highest accessible coordinate."""
        across = math.sqrt(max(0.0, 1 - float(self._frame[0][axis]) ** 2))
        if not self.inside or across < 1 - 1e-12:
            return -np.inf, np.inf
        return float(self.point[axis]) - self.radius, float(self.point[axis]) + self.radius

    def cells(self, lower: NDArray, upper: NDArray, spacing: float) -> SurfaceCells:
        """Cells in theta and along the axis."""
        reached = self._from_axis(corners(lower, upper))[:, 2]
        low = float(reached.min()) if self.low is None else float(self.low)
        high = float(reached.max()) if self.high is None else float(self.high)
        theta = cell_centres(0.0, 2 * np.pi, spacing / self.radius, "theta")
        along = cell_centres(low, high, spacing, "the axis")
        angle, z = (a.ravel() for a in np.meshgrid(theta, along, indexing="ij"))
        axis, first, second = self._frame
        radial = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
        centre = vector("point", self.point) + self.radius * radial + z[:, None] * axis
        size = 2 * np.pi * self.radius / len(theta) * (high - low) / len(along)
        coords = {"theta": (theta, "angle about the axis"), "z": (along, "position along the axis, from its point")}
        bounds = ((0.0, 2 * np.pi), (low, high))
        return SurfaceCells(("theta", "z"), coords, centre, np.full(len(centre), size), ("theta", "z"), bounds)

    def in_surface(self, points: NDArray, vectors: NDArray) -> tuple[NDArray, NDArray]:
        """Parts of vectors across the side, around it and along the axis."""
        radial, axis = self._radial(points), self._frame[0]
        around = np.cross(axis, radial)
        normal = self._sign * (vectors * radial).sum(axis=1)
        return normal, np.stack([(vectors * around).sum(axis=1), vectors @ axis], axis=1)

    def covers(self, points: NDArray, cells: SurfaceCells) -> NDArray:
        """Return a mask of the points between the ends."""
        assert cells.bounds is not None
        low, high = cells.bounds[1]
        z = self._from_axis(points)[:, 2]
        return np.asarray((low <= z) & (z <= high))
