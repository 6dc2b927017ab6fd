"""What loops and results ask of the nodes at which fields are evaluated, whatever they form."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.fields.sums.blocks import Block
from xcg.scene.schema import COMPONENTS


class Grid(Protocol):
    """Where fields are evaluated: nodes on a mesh (`RegularGrid`), or anywhere (`xcg.fields.places.points.Points`)."""

    @property
    def seen(self) -> str:
        """Axes along which distance to a node counts."""

    @property
    def active(self) -> NDArray:
        """Which of the three axes are seen (3,)."""

    @property
    def averaged(self) -> str:
        """Axes that are integrated over and divided by their extent."""

    @property
    def axes(self) -> str:
        """Axes that are dimensions of the result."""

    @property
    def fitted(self) -> str:
        """Those of them along which the nodes were laid around the particles."""

    @property
    def cuts(self) -> Mapping[str, tuple[float, float]]:
        """Lowest and highest coordinate along each axis that is fixed, not resolved (m)."""

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions that the nodes have in results."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of these dimensions."""

    @property
    def count(self) -> int:
        """Number of nodes."""

    @property
    def coords(self) -> Mapping[str, xr.Variable]:
        """Coordinates of results."""

    @property
    def origin(self) -> NDArray:
        """Return the place that loops take others relative to (3,)."""

    @property
    def half(self) -> NDArray:
        """Half of the extent of the cells that values are averages over (3,); 0 where they are those at the nodes."""

    @property
    def lower(self) -> NDArray:
        """Lower bounds of the nodes, or of their cells (3,)."""

    @property
    def upper(self) -> NDArray:
        """Upper bounds of the nodes, or of their cells (3,)."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of nodes along x, y, z, for differences between neighbours."""

    @property
    def spacing(self) -> Mapping[str, float]:
        """Distance of neighbours along each axis that has any (m)."""

    @property
    def steps(self) -> NDArray:
        """Distance by which loops count nodes (3,), infinity where they do not."""

    def fills(self, period: NDArray) -> tuple[bool, bool, bool]:
        """Tell along which axes the nodes fill a period (3,), so that the last is next to the first."""

    @property
    def undirected(self) -> NDArray:
        """Nodes where the axes of vectors have no direction."""

    @property
    def attrs(self) -> Mapping[str, float]:
        """What results tell of the nodes."""

    def blocks(self, size: int, threads: int) -> Sequence[Block]:
        """Divide the nodes into blocks of at most about `size`, for some threads."""

    def describe(self) -> dict[str, str]:
        """Say where the nodes are."""


class SameAxes:
    """What nodes have in common whose vectors are all along the same axes."""

    @property
    def undirected(self) -> NDArray:
        """No node is without directions."""
        return np.zeros(0, int)

    @property
    def attrs(self) -> dict[str, float]:
        """Nothing more is told."""
        return {}


class Apart(SameAxes):
    """What nodes have in common that stand apart: no axis, no spacing, no neighbours, no cells."""

    @property
    def axes(self) -> str:
        """No axis x, y or z is a dimension of results."""
        return ""

    @property
    def fitted(self) -> str:
        """No axis follows the particles."""
        return ""

    @property
    def count(self: Grid) -> int:
        """Number of nodes."""
        return math.prod(self.sizes)

    @property
    def active(self: Grid) -> NDArray:
        """Which of the three axes are seen (3,)."""
        return np.array([a in self.seen for a in COMPONENTS])

    @property
    def shape(self: Grid) -> tuple[int, int, int]:
        """Number of nodes, as a row."""
        return self.count, 1, 1

    @property
    def steps(self) -> NDArray:
        """No spacing (3,)."""
        return np.full(3, np.inf)

    @property
    def half(self) -> NDArray:
        """No cells (3,)."""
        return np.zeros(3)

    @property
    def spacing(self) -> dict[str, float]:
        """No spacing."""
        return {}

    def fills(self, period: NDArray) -> tuple[bool, bool, bool]:
        """Nodes have no neighbours."""
        return False, False, False
