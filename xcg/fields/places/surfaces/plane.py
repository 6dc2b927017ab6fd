"""A plane as a wall."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.checks import rising_pair, unit_vector, vector
from xcg.fields.places.surfaces.geometry import axis_of, cell_centres, corners, frame_about
from xcg.fields.places.surfaces.wall import SurfaceCells, Wall
from xcg.scene.schema import COMPONENTS


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
        vector("point", self.point)
        unit_vector("normal", self.normal)
        if self.bounds is not None:
            for name, pair in zip(("bounds[0]", "bounds[1]"), _pairs(self.bounds), strict=True):
                rising_pair(name, pair)

    @cached_property
    def _frame(self) -> tuple[NDArray, NDArray, NDArray]:
        """The normal, and two axes along the plane: those of the coordinates where it is across one."""
        normal = unit_vector("normal", self.normal)
        k = axis_of(normal)
        if k is not None:
            first, second = (np.eye(3)[a] for a in range(3) if a != k)
            return normal, first, second
        return (normal, *frame_about(normal))

    @property
    def _origin(self) -> NDArray:
        """Where its two coordinates are zero."""
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
        """Where rays cross."""
        with np.errstate(divide="ignore", invalid="ignore"):
            s = -self.distance(points)[:, None] / (directions @ self._frame[0])
        return np.where(s > 0, s, np.inf)[..., None]

    def varies(self, axis: int) -> bool:
        """Whether a shift along an axis matters."""
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
        """Which points are over the cells."""
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
