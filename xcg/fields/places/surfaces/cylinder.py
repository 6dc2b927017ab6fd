"""The side of a cylinder as a wall."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xcg.common.checks import is_positive, rising_pair, unit_vector, vector
from xcg.fields.places.surfaces.geometry import axis_of, cell_centres, corners, frame_about
from xcg.fields.places.surfaces.wall import SurfaceCells, Wall


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
        """Which points are between the ends."""
        assert cells.bounds is not None
        low, high = cells.bounds[1]
        z = self._from_axis(points)[:, 2]
        return np.asarray((low <= z) & (z <= high))
