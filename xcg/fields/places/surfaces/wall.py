"""What is asked of a wall, whatever its shape.

A wall is a surface with a side where the grains are. Normals point to that side. Two things are asked of it: which part
of space is accessible (`xcg.fields.accessible`), and cells that its stress is a field on
(`xcg.fields.studies.wall_stress`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        """Tell whether the surface is another one when it is shifted along x, y or z."""

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
        """Tell which points (n, 3) near the surface are over its cells."""
        return np.ones(len(points), bool)
