"""Nodes at which fields are evaluated: what loops and results take of them, and their blocks.

Blocks are filled one by one, or by several threads within one step. Threads are for scenes in
memory or of one chunk of time, as several chunks share the processors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import Any, Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.compiled.cells import lists_for_points
from xcg.compiled.reach import BlockNodes, Lists, Rows, lists_for
from xcg.compiled.rings import Rings
from xcg.scene.schema import COMPONENTS

# Sums are made over blocks of about this many nodes, so that memory holds those of a few blocks,
# not of all nodes.
BLOCK_NODES = 110_000
# Where there are more nodes than this in the box around a grain's support, sums have left the cache
# when the next grain comes to the same nodes: blocks then have so few that their sums stay there.
FINE = 1000
CACHED = 10_000_000  # bytes
FEWEST_NODES = 10_000  # however many numbers each has


def triple(values: NDArray | Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return three numbers, one for each axis, as loops take them."""
    x, y, z = np.asarray(values).tolist()
    return x, y, z


class Cutoffs(Protocol):
    """Lengths in radii of the support, as a `Smoothing` has them."""

    cutoff: float
    spacings: NDArray
    surroundings: tuple[tuple[bool, bool, bool], tuple[float, float, float]]


class Block(Protocol):
    """Nodes that are computed together: a part of a mesh, or neighbouring points."""

    @property
    def indices(self) -> NDArray:
        """Indices of the nodes among all nodes of the result, unsigned (nodes,)."""

    @property
    def order(self) -> NDArray | None:
        """Order of the nodes by their indices, unsigned (nodes,); None where they are in order."""

    @property
    def rings(self) -> Rings | None:
        """Rings whose averages are the nodes, where loops fill points at their angles."""

    @property
    def count(self) -> int:
        """Number of nodes that loops fill."""

    def nodes(self, cutoffs: Cutoffs) -> BlockNodes:
        """Return the nodes as loops take them, in cutoffs."""


@dataclass(frozen=True, eq=False)
class MeshBlock:
    """Nodes low <= (ix, iy, iz) < high of a mesh of a shape."""

    low: tuple[int, int, int]
    high: tuple[int, int, int]
    shape: tuple[int, int, int]
    order = rings = None

    @property
    def count(self) -> int:
        """Number of nodes."""
        return math.prod(high - low for low, high in zip(self.low, self.high, strict=True))

    @property
    def indices(self) -> NDArray:
        """Indices of the nodes among all nodes of the mesh, numbered row by row."""
        x, y, z = (
            np.arange(low, high, dtype="uint64")
            for low, high in zip(self.low, self.high, strict=True)
        )
        return ((x[:, None, None] * self.shape[1] + y[:, None]) * self.shape[2] + z).ravel()

    def nodes(self, cutoffs: Cutoffs) -> BlockNodes:
        """Return the nodes as loops take them, in cutoffs from the first node of the mesh on."""
        spacings = cutoffs.spacings.tolist()
        begin = [low * spacing for low, spacing in zip(self.low, spacings, strict=True)]
        end = [(high - 1) * spacing for high, spacing in zip(self.high, spacings, strict=True)]
        rows = Rows(
            self.low, self.high, triple(spacings), triple([1.0 / spacing for spacing in spacings])
        )
        return BlockNodes(triple(begin), triple(end), *cutoffs.surroundings, rows=rows)


def lists_of(nodes: BlockNodes, reach: Sequence[float], real: str = "float64") -> Lists:
    """Make scratch lists for the nodes that a support or branch of the extent `reach` (3,) covers."""
    if nodes.rows is None:
        return lists_for_points(nodes.cells, reach, real)
    return lists_for(nodes.rows, nodes.active, reach, real)


@dataclass(eq=False)
class Nodes:
    """Nodes of a result: a mesh, points, or rings of a cylinder.

    Attributes
    ----------
    dims, sizes : tuple
        Dimensions that the nodes have in results, and their lengths.
    coords : mapping
        Coordinates of results.
    active_axes : str
        Axes along which distance to a node counts.
    averaged : str
        Axes that are integrated over and divided by their extent.
    origin, lower, upper : array (3,)
        The place that loops take others relative to, and bounds of the nodes, or of the cells of
        `xcg.cell_volumes` (m).
    spacing : mapping
        Distance of nodes along each resolved axis of a mesh (m).
    fitted : str
        Axes whose bounds follow from the particles' extent.
    parts : sequence of Block, optional
        The nodes that stand apart, divided; None for a mesh, which is divided when it is filled.
    undirected : array
        Nodes where the axes of vectors have no direction.
    attrs : mapping
        Attributes of results that describe the nodes.

    Other attributes follow from these: `count`, the number of nodes; `active`, a mask (3,) of the
    axes along which distance to a node counts, resolved or fixed; `shape`, the number of nodes
    along x, y, z, of scattered ones as if in a row; `spacings`, the distance by which loops count
    nodes (3,), infinity where they do not.
    """

    dims: tuple[str, ...]
    sizes: tuple[int, ...]
    coords: Mapping[str, xr.Variable]
    active_axes: str
    averaged: str
    origin: NDArray
    lower: NDArray
    upper: NDArray
    spacing: Mapping[str, float] = field(default_factory=dict)
    fitted: str = ""
    parts: Sequence[Block] | None = None
    undirected: NDArray = field(default_factory=lambda: np.zeros(0, int))
    attrs: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.count = math.prod(self.sizes)
        self.active = np.array([a in self.active_axes for a in COMPONENTS])
        length = dict(zip(self.dims, self.sizes, strict=True))
        spacing = 1.0
        if self.parts is not None:  # as if in a row
            length = {"x": self.count}
            spacing = np.inf
        self.shape = triple([length.get(a, 1) for a in COMPONENTS])
        self.spacings = np.array([self.spacing.get(a, spacing) for a in COMPONENTS])

    @property
    def text(self) -> dict[str, str]:
        """Places of the nodes, in words."""
        nodes = " x ".join(f"{size} {dim}" for dim, size in zip(self.dims, self.sizes, strict=True))
        parts = self.parts or ()
        places = sum(part.count for part in parts)
        if parts and parts[0].rings is None:
            ends = zip(COMPONENTS, self.lower, self.upper, strict=True)
            spans = [
                f"{a} from {low:.6g} to {high:.6g}"
                for a, low, high in ends
                if a in self.active_axes
            ]
            return {"nodes": f"{nodes}, points with {', '.join(spans)}", "fixed": "none"}
        if places > self.count:
            nodes = f"{nodes or 'one'}, averages over {places} places"
        fixed = [f"{a} = {float(x):g}" for a, x in self.coords.items() if not x.dims]
        return {"nodes": nodes or "one", "fixed": ", ".join(fixed) or "none"}

    @property
    def axes(self) -> str:
        """Axes of a mesh that are dimensions of the result."""
        return "".join(self.spacing)

    def nodes_within(self, extent: float) -> float:
        """Return the number of nodes in a box (m); of scattered ones as if they were spread evenly."""
        if self.parts is None:
            return float(np.clip(extent / self.spacings, 1.0, self.shape)[self.active].prod())
        places = sum(part.count for part in self.parts)
        share = (extent / (self.upper - self.lower + extent))[self.active].prod()
        return max(1.0, places * float(share))

    def around(self, reach: float) -> tuple[NDArray, NDArray]:
        """Return the bounds (3,) of what reaches the nodes (m); infinity along averaged axes."""
        low = np.where(self.active, self.lower - reach, -np.inf)
        high = np.where(self.active, self.upper + reach, np.inf)
        return low, high

    def fills(self, period: NDArray) -> tuple[bool, bool, bool]:
        """Return a mask of the axes whose nodes fill a period (3,), so that the last is next to the first."""
        extent = [n * self.spacing.get(a, 0.0) for a, n in zip(COMPONENTS, self.shape, strict=True)]
        return triple(np.isclose(extent, period, atol=0.0))

    def blocks(self, size: int, threads: int) -> Sequence[Block]:
        """Divide a mesh into compact blocks of at most about `size` nodes; other nodes are divided already.

        There are at least two for each thread, so that none waits for long.
        """
        if self.parts is not None:
            return self.parts
        wanted = math.ceil(self.count / size)
        if threads > 1:
            wanted = max(wanted, 2 * threads)
        if wanted <= 1:
            return [MeshBlock((0, 0, 0), self.shape, self.shape)]
        return self._divided(min(wanted, self.count))

    def _divided(self, wanted: int) -> list[Block]:
        """Divide a mesh into so many blocks or more."""
        parts = np.ones(3, int)
        shape = np.array(self.shape)
        while parts.prod() < wanted:
            # rows of nodes run along the last axis: cut them later
            parts[np.argmax(np.where(parts < shape, shape / parts / (1, 1, 2), 0.0))] += 1
        edges = [
            np.linspace(0, n, p + 1).astype(int).tolist() for n, p in zip(shape, parts, strict=True)
        ]
        x, y, z = (list(pairwise(ends)) for ends in edges)
        return [
            MeshBlock((i[0], j[0], k[0]), (i[1], j[1], k[1]), self.shape)
            for i, j, k in product(x, y, z)
        ]
