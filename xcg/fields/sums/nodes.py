"""Nodes at which fields are evaluated: what loops and results take of them, and the blocks that are filled.

Blocks are filled one by one, or by several threads within one step. Threads are for scenes in memory or of one chunk of
time, as several chunks share the processors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from types import MappingProxyType
from typing import Any, Protocol, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.compiled.reach import Lists, Nodes, Rows, lists_for
from xcg.compiled.volumes import Volumes
from xcg.scene.schema import COMPONENTS

R = TypeVar("R")

# Sums are made over blocks of about this many nodes, so that memory holds those of a few blocks, not of all nodes.
BLOCK_NODES = 110_000
# Where there are more nodes than this in the box around a grain's support, sums have left the cache when the next grain
# comes to the same nodes: blocks then have so few that their sums stay there.
FINE = 1000
_CACHED, _FEWEST = 10_000_000, 10_000  # bytes; nodes, however many numbers each has


def nodes_in_cache(numbers: int) -> int:
    """Return how many nodes have sums that stay in cache, of so many numbers each."""
    return max(_FEWEST, _CACHED // (8 * max(1, numbers)))


def triple(values: NDArray | Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return three numbers, one for each axis, as loops take them."""
    x, y, z = values.tolist() if isinstance(values, np.ndarray) else values
    return x, y, z


class Block(Protocol):
    """Nodes of the result that are computed at one time."""

    @property
    def places(self) -> NDArray:
        """Where the nodes are among all nodes of the result, unsigned (nodes,)."""

    @property
    def order(self) -> NDArray | None:
        """Order of the nodes by their places, unsigned (nodes,); None where they are in order."""

    @property
    def inner(self) -> NodeBlock | None:
        """The nodes that are filled, where `averages` of these make those of the block; else it is one itself."""


class NodeBlock(Protocol):
    """Nodes that are filled at one time, as they are neighbours in space."""

    @property
    def count(self) -> int:
        """Number of nodes."""

    def nodes(self, origin: NDArray, unit: float, active: NDArray, period: NDArray) -> Nodes:
        """Return the nodes as loops take them.

        Parameters
        ----------
        origin, unit : array (3,), float
            What lengths are relative to, and measured in (m).
        active, period : array (3,)
            Axes along which distance counts, and periods in the unit.
        """

    def lists(self, nodes: Nodes, reach: Sequence[float], real: str = "float64") -> Lists:
        """Return scratch to list those nodes that something of this length (3,), from end to end, reaches."""


@dataclass(frozen=True, eq=False)
class MeshBlock:
    """Nodes low <= (ix, iy, iz) < high of a mesh of a shape, with distances between them (m).

    `half` is half of the extent of the cells around them (m); 0 along all axes where values are those at the nodes.
    """

    low: tuple[int, int, int]
    high: tuple[int, int, int]
    shape: tuple[int, int, int]
    steps: NDArray
    half: NDArray
    order = inner = None

    @property
    def count(self) -> int:
        """Number of nodes."""
        return math.prod(high - low for low, high in zip(self.low, self.high, strict=True))

    @property
    def places(self) -> NDArray:
        """Where the nodes are among all nodes of the mesh, numbered row by row."""
        if self.count == math.prod(self.shape):
            return np.arange(self.count, dtype="uint64")
        x, y, z = (np.arange(low, high, dtype="uint64") for low, high in zip(self.low, self.high, strict=True))
        return ((x[:, None, None] * self.shape[1] + y[:, None]) * self.shape[2] + z).ravel()

    def nodes(self, origin: NDArray, unit: float, active: NDArray, period: NDArray) -> Nodes:
        """Return the nodes as loops take them; the origin is the first node of the mesh."""
        half = [length / unit for length in self.half.tolist()]
        # the step of one node means nothing
        steps = [step / unit if n > 1 else 1.0 for n, step in zip(self.shape, self.steps.tolist(), strict=True)]
        begin = [low * step - h for low, step, h in zip(self.low, steps, half, strict=True)]
        end = [(high - 1) * step + h for high, step, h in zip(self.high, steps, half, strict=True)]
        rows = Rows(self.low, self.high, triple(steps), triple([1.0 / step for step in steps]))
        volumes = Volumes(rows, triple(half), triple(sorted(range(3), key=lambda k: half[k] > 0.0)))
        of = {"volumes": volumes} if any(half) else {"rows": rows}
        return Nodes(triple(begin), triple(end), triple(active), triple(period), **of)

    def lists(self, nodes: Nodes, reach: Sequence[float], real: str = "float64") -> Lists:
        """Return scratch to list the nodes that something of this length reaches."""
        rows = nodes.rows if nodes.volumes is None else nodes.volumes.rows
        return lists_for(rows, nodes.active, reach, real)


def mesh_blocks(shape: tuple[int, int, int], steps: NDArray, half: NDArray, size: int, threads: int) -> list[MeshBlock]:
    """Cover a mesh with blocks: compact, of at most about `size` nodes.

    At least two for each thread, so that none waits for long.
    """
    parts, wanted = np.ones(3, int), max(math.ceil(math.prod(shape) / size), 2 * threads if threads > 1 else 1)
    if wanted == 1:
        return [MeshBlock((0, 0, 0), shape, shape, steps, half)]
    while parts.prod() < min(wanted, math.prod(shape)):
        # rows of nodes run along the last axis: cut them later
        parts[np.argmax(np.where(parts < shape, np.asarray(shape) / parts / (1, 1, 2), 0.0))] += 1
    edges = [np.linspace(0, n, p + 1).astype(int).tolist() for n, p in zip(shape, parts, strict=True)]
    (x, y, z) = (list(pairwise(ends)) for ends in edges)
    return [MeshBlock((i[0], j[0], k[0]), (i[1], j[1], k[1]), shape, steps, half) for i, j, k in product(x, y, z)]


class Grid(Protocol):
    """Where fields are evaluated: nodes on a mesh (`RegularGrid`), or anywhere (`xcg.fields.grids.points.Points`)."""

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

    undirected = np.zeros(0, int)
    attrs: Mapping[str, float] = MappingProxyType({})


class Apart:
    """What nodes have in common that stand apart: no axis, no spacing, no neighbours, no cells."""

    axes = fitted = ""
    steps, half = np.full(3, np.inf), np.zeros(3)
    spacing: Mapping[str, float] = MappingProxyType({})

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

    def fills(self, period: NDArray) -> tuple[bool, bool, bool]:
        """Nodes have no neighbours."""
        return False, False, False
