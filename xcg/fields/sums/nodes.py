"""Nodes at which fields are evaluated: what results take of them, their blocks, and both in cutoffs for the loops.

Blocks are filled one by one, or by several threads within one step. Threads are for scenes in
memory or of one chunk of time, as several chunks share the processors. What grains and contacts may
reach is checked before loops start, which rely on it.
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

from xcg.common.messages import SceneError
from xcg.compiled.reach import BlockNodes, Rows
from xcg.compiled.rings import Rings
from xcg.compiled.segments import BRANCH, FORCE, GROUP
from xcg.compiled.smoothing import KernelCode
from xcg.scene.schema import COMPONENTS

# Sums are made over blocks of about this many nodes, so that memory holds those of a few blocks,
# not of all nodes.
BLOCK_NODES = 110_000
# Where there are more nodes than this in the box around a grain's support, sums have left the cache
# when the next grain comes to the same nodes: blocks then have so few that their sums stay there.
FINE = 1000
CACHED = 10_000_000  # bytes
FEWEST_NODES = 10_000  # however many numbers each has
# Beyond this many cutoffs from the mesh, or spacings, places cannot be told apart, and cells and
# nodes not be counted.
_FAR = 2.0**50
# Periodic images of one grain or branch that reach one node,
_MOST_IMAGES = 10_000
# and where temperatures take products of all pairs of them.
_MOST_PAIRED = 300
# Images over the whole mesh, besides those for each node of a mesh over many periods.
_MOST_OVER_MESH = 10_000
# Weights of a branch of L cutoffs are exact to L^2 1e-16: longer ones are cut where the mesh ends,
_LONG = 64.0
# and refused where they are as long within it.
_TOO_LONG = 2.0**15
# A node is numbered within a row in single precision where a branch spans no more spacings than
# this.
_SINGLE = 2.0**20
_BRANCHES = slice(BRANCH, FORCE)
# How far apart nodes are that see one point (cutoffs).
DIAMETER = np.full(3, 2.0)
# How far from the nodes a long branch is cut: beyond 1 nothing of it counts.
_MARGIN = 2.0


def triple(values: NDArray | Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return three numbers, one for each axis, as loops take them."""
    x, y, z = np.asarray(values).tolist()
    return x, y, z


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

    def nodes(self, smoothing: Smoothing) -> BlockNodes:
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

    def nodes(self, smoothing: Smoothing) -> BlockNodes:
        """Return the nodes as loops take them, in cutoffs from the first node of the mesh on."""
        spacings = smoothing.spacings
        begin = triple(np.array(self.low) * spacings)
        end = triple((np.array(self.high) - 1) * spacings)
        rows = Rows(self.low, self.high, triple(spacings), triple(1.0 / spacings))
        return BlockNodes(begin, end, *smoothing.surroundings, rows=rows)


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


class Smoothing:
    """Kernel of one cutoff in one step, with nodes and periods in cutoffs, from the origin of the nodes on.

    Parameters
    ----------
    nodes : Nodes
    period : array (3,)
        Periods of the scene (m).
    cutoff : float
        Radius of the support (m).
    weights : KernelCode
        The kernel as loops take it.

    Attributes
    ----------
    spacings : array (3,)
        Spacing of a mesh, where one node means nothing and is 1; infinity for points.
    lower, upper : array (3,)
        Bounds of the nodes.
    period : array (3,)
        Period, infinity along axes that are not periodic, or along which distance does not count.
    surroundings : tuple
        Axes along which distance counts, and periods, as loops take them.
    """

    def __init__(self, nodes: Nodes, period: NDArray, cutoff: float, weights: KernelCode) -> None:
        self.nodes = nodes
        self.cutoff = cutoff
        self.weights = weights
        self.spacings = np.where(np.array(nodes.shape) > 1, nodes.spacings / cutoff, 1.0)
        self.lower = (nodes.lower - nodes.origin) / cutoff
        self.upper = (nodes.upper - nodes.origin) / cutoff
        self.period = np.where(nodes.active, period, np.inf) / cutoff
        self.surroundings = triple(nodes.active), triple(self.period)

    def check_far(self, farthest: NDArray, source: str) -> None:
        """Raise SceneError for places (3,) not finite or too far away to be numbered; damaged files hold them.

        Here and below, `source` names the step in messages.
        """
        for k in np.flatnonzero(self.nodes.active):
            if not farthest[k] < _FAR:
                raise SceneError(
                    f"{source}: a particle or contact reaches {farthest[k] * self.cutoff:.3g} m from the mesh "
                    f"along '{COMPONENTS[k]}', too far for double precision; the file is damaged, or lengths "
                    "have another unit"
                )

    def check_reach(self, reach: NDArray, source: str, *, paired: bool = False) -> None:
        """Raise SceneError if a support (3,) covers more nodes or periodic images than the loops can index.

        `paired` says that images of one grain are multiplied with each other.
        """
        most = _MOST_IMAGES
        if paired:
            most = _MOST_PAIRED
        active = self.nodes.active
        extent = np.where(active, self.upper - self.lower, 0.0)
        reach = np.where(active, reach, 0.0)
        countable = (extent < _FAR) & ((reach + extent) / self.spacings < _FAR)
        if not countable.all():
            k = int(countable.argmin())
            raise SceneError(
                f"{source}: along '{COMPONENTS[k]}' the mesh is {extent[k] * self.cutoff:.3g} m long "
                f"with nodes {self.spacings[k] * self.cutoff:.3g} m apart, and the radius of the support is "
                f"{self.cutoff:.3g} m; choose a width and a spacing that are closer to each other"
            )
        over_mesh = (reach + extent) / self.period + 1.0
        of_node = math.prod((reach / self.period + 1.0).tolist())
        all_nodes = math.prod(over_mesh.tolist())
        if not (of_node <= most and all_nodes <= _MOST_OVER_MESH + self.nodes.count * of_node):
            k = int(np.argmax(over_mesh))
            raise SceneError(
                f"{source}: the box is so small that a particle or contact reaches the mesh in "
                f"{all_nodes:.3g} periodic images (along '{COMPONENTS[k]}' the period is "
                f"{self.period[k] * self.cutoff:.3g} m, and the reach {reach[k] * self.cutoff:.3g} m); the box or a "
                "contact in the file is damaged, or the kernel is too wide"
            )

    def fits_single(self, longest: float) -> bool:
        """Return whether single precision is enough to number the nodes that a branch of this length reaches."""
        return bool(((longest + 2.0) / self.spacings[self.nodes.active] < _SINGLE).all())

    def too_long(self, longest: NDArray) -> bool:
        """Return whether branches with these largest components (3,) must be cut."""
        return bool((longest[self.nodes.active] > _LONG).any())

    def cut(self, segments: NDArray, ends: NDArray, source: str) -> NDArray:
        """Cut long branches where nothing beyond reaches the mesh; branches that never come near it are left out.

        Parameters
        ----------
        segments : array (n, SEGMENT)
            As from `list_segments`; changed in place.
        ends : array (2, n, 3)
            The contact point and the partner's centre of each segment (m). The branch of a segment
            leads to one of them, which has digits that the difference from a far start has lost.
        source : str
            Names the step.

        Returns
        -------
        array (4,)
            The largest component along x, y, z, and length, of a branch.

        Raises
        ------
        SceneError
            If a branch is too long within the mesh, or along a periodic axis.
        """
        active = self.nodes.active
        used = np.flatnonzero(segments[:, GROUP] >= 0.0)
        long = used[(np.abs(segments[used, _BRANCHES][:, active]) > _LONG).any(axis=1)]
        start = segments[long, :BRANCH]
        branch = segments[long, _BRANCHES]
        open_axes = active & np.isinf(self.period)
        end = start - branch
        ends = (ends[:, long] - self.nodes.origin) / self.cutoff
        point_is_nearer = (((ends - end) ** 2 * open_axes).sum(axis=2)).argmin(axis=0) == 0
        end = np.where(open_axes, np.where(point_is_nearer[:, None], *ends), end)
        first, last, part = self._part_near(start, end, open_axes)
        segments[long, :BRANCH] = np.where(open_axes, first, start)
        segments[long, _BRANCHES] = np.where(open_axes, first - last, part * branch)
        segments[long[part[:, 0] == 0.0], GROUP] = -1.0
        sizes = np.abs(segments[used[segments[used, GROUP] >= 0.0], _BRANCHES])
        length = np.sqrt((sizes**2).sum(axis=1).max(initial=0.0))
        longest = np.array([*sizes.max(axis=0, initial=0.0), length])
        largest = longest[:3][active].max()
        if not largest < _TOO_LONG:
            raise SceneError(
                f"{source}: a contact is {largest * self.cutoff:.3g} m long within the "
                f"mesh or a periodic box, more than {_TOO_LONG:.0f} supports of the kernel; its particles are not in "
                "touch: check the ids and units of the contacts, or choose a larger width"
            )
        return longest

    def _part_near(
        self, start: NDArray, end: NDArray, axes: NDArray
    ) -> tuple[NDArray, NDArray, NDArray]:
        """First and last point, (n, 3) each, of the part of lines that is near the mesh, and its share (n, 1).

        Points are counted from the end that is nearer to the mesh, so that none of its digits are
        lost.
        """
        lower = self.lower - _MARGIN
        upper = self.upper + _MARGIN

        def distance(point: NDArray) -> NDArray:
            beyond = np.maximum(np.maximum(lower - point, point - upper), 0.0)
            return (beyond * axes).max(axis=1, keepdims=True)

        turned = distance(start) < distance(end)
        near = np.where(turned, start, end)
        far = np.where(turned, end, start)
        along = np.where(axes, far - near, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            # not a number: within, or on a face
            crossings = np.array([lower - near, upper - near]) / along
        within = (lower <= near) & (near <= upper) | ~axes
        unmoved = np.where(within, -np.inf, np.inf)
        enters = np.where(along != 0.0, crossings.min(axis=0), unmoved).max(axis=1)
        leaves = np.where(along != 0.0, crossings.max(axis=0), np.inf).min(axis=1)
        begin = np.clip(enters, 0.0, 1.0)[:, None]
        finish = np.maximum(begin, np.clip(leaves, 0.0, 1.0)[:, None])
        points = near + begin * along, near + finish * along
        return np.where(turned, *points), np.where(turned, *points[::-1]), finish - begin
