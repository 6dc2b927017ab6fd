"""What grains and contacts may reach of the nodes: what the loops over them rely on, checked before they start."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.compiled.segments import BRANCH, FORCE, GROUP
from xcg.fields.sums.nodes import Grid
from xcg.scene.schema import COMPONENTS

# Beyond this many cutoffs from the mesh, or spacings, places cannot be told apart, and cells and nodes not be counted.
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
# A node is numbered within a row in single precision where a branch spans no more spacings than this.
_SINGLE = 2.0**20
_BRANCHES = slice(BRANCH, FORCE)
# How far from the nodes a long branch is cut: beyond 1 nothing of it counts.
_MARGIN = 2.0


@dataclass(eq=False)
class Mesh:
    """Nodes and their surroundings as the loops see them: lengths in cutoffs, places relative to one of the nodes.

    Attributes
    ----------
    origin : array (3,)
        That node (m): of a mesh the first.
    steps : array (3,)
        Spacing of a mesh, where one node means nothing and is 1; infinity for points.
    half : array (3,)
        Half of the extent of the cells around nodes; 0 where values are those at the nodes.
    lower, upper : array (3,)
        Bounds of the nodes, or of their cells.
    active : array (3,)
        Axes along which distance counts.
    period : array (3,)
        Period, infinity along axes that are not periodic, or not active.
    nodes : int
        Number of nodes.
    cutoff : float
        The unit of length (m).
    """

    origin: NDArray
    steps: NDArray
    half: NDArray
    lower: NDArray
    upper: NDArray
    active: NDArray
    period: NDArray
    nodes: int
    cutoff: float

    @classmethod
    def of(cls, grid: Grid, period: NDArray, cutoff: float) -> Mesh:
        """Take over a grid and the periods of the scene (m)."""
        steps = np.where(np.array(grid.shape) > 1, grid.steps / cutoff, 1.0)
        lower, upper = (grid.lower - grid.origin) / cutoff, (grid.upper - grid.origin) / cutoff
        periods = np.where(grid.active, period, np.inf) / cutoff
        return cls(grid.origin, steps, grid.half / cutoff, lower, upper, grid.active, periods, grid.count, cutoff)

    def __post_init__(self) -> None:
        self.reach = 2.0 + 2.0 * self.half  # how far apart nodes are that see one point (3,)
        numbers = np.column_stack([self.upper - self.lower, self.steps, self.period]).tolist()
        self._along_active = [(k, numbers[k]) for k in range(3) if self.active[k]]  # extent, spacing and period

    def check_far(self, farthest: Sequence[float] | NDArray, source: str) -> None:
        """Refuse places (3,) too far from the first node to be numbered, or not finite; damaged files hold them.

        Here and below, `source` names the step in messages.
        """
        for k, _ in self._along_active:
            if not farthest[k] < _FAR:
                raise SceneError(
                    f"{source}: a particle or contact reaches {farthest[k] * self.cutoff:.3g} m from the mesh "
                    f"along '{COMPONENTS[k]}', where coordinates have no digits left; the file is damaged, or its "
                    "units are others"
                )

    def check_reach(self, reach: NDArray, source: str, *, paired: bool = False) -> None:
        """Refuse supports (3,), from end to end, of more nodes or periodic images than can be counted, or than end.

        `paired` says that images of one grain are multiplied with each other.
        """
        most = _MOST_PAIRED if paired else _MOST_IMAGES
        images, over_mesh = [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]
        for k, (extent, step, period) in self._along_active:
            if not (extent < _FAR and (reach[k] + extent) / step < _FAR):
                raise SceneError(
                    f"{source}: along '{COMPONENTS[k]}' the mesh is {extent * self.cutoff:.3g} m long "
                    f"with nodes {step * self.cutoff:.3g} m apart, and the radius of the support is "
                    f"{self.cutoff:.3g} m; choose a width and a spacing that are closer to each other"
                )
            images[k], over_mesh[k] = float(reach[k]) / period + 1.0, (float(reach[k]) + extent) / period + 1.0
        one, all_nodes = math.prod(images), math.prod(over_mesh)
        if not (one <= most and all_nodes <= _MOST_OVER_MESH + self.nodes * one):
            k = int(np.argmax(over_mesh))
            raise SceneError(
                f"{source}: the box is so small that a particle or contact reaches the mesh in "
                f"{all_nodes:.3g} periodic images (along '{COMPONENTS[k]}' the period is "
                f"{self.period[k] * self.cutoff:.3g} m, and the reach {reach[k] * self.cutoff:.3g} m); the box or a "
                "contact in the file is damaged, or the kernel is too wide"
            )

    def fits_single(self, longest: float) -> bool:
        """Tell whether single precision is enough to number the nodes that a branch of this length reaches."""
        return all((longest + 2.0) / step < _SINGLE for _, (_, step, _) in self._along_active)

    def too_long(self, longest: NDArray) -> bool:
        """Tell whether branches with these largest components (3,) must be cut."""
        return any(longest[k] > _LONG for k, _ in self._along_active)

    def cut(self, segments: NDArray, ends: NDArray, source: str) -> NDArray:
        """Cut long branches where nothing beyond reaches the mesh; those that never come near it are left out.

        Parameters
        ----------
        segments : array (n, SEGMENT)
            As from `list_segments`; changed in place.
        ends : array (2, n, 3)
            The contact point and the partner's centre of each segment (m). The branch of a segment leads to one of
            them, which has digits that the difference from a far start has lost.
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
        used = np.flatnonzero(segments[:, GROUP] >= 0.0)
        long = used[(np.abs(segments[used, _BRANCHES][:, self.active]) > _LONG).any(axis=1)]
        start, branch = segments[long, :BRANCH], segments[long, _BRANCHES]
        open_axes = self.active & np.isinf(self.period)
        end, ends = start - branch, (ends[:, long] - self.origin) / self.cutoff
        point_is_nearer = (((ends - end) ** 2 * open_axes).sum(axis=2)).argmin(axis=0) == 0
        end = np.where(open_axes, np.where(point_is_nearer[:, None], *ends), end)
        first, last, part = self._part_near(start, end, open_axes)
        segments[long, :BRANCH] = np.where(open_axes, first, start)
        segments[long, _BRANCHES] = np.where(open_axes, first - last, part * branch)
        segments[long[part[:, 0] == 0.0], GROUP] = -1.0
        sizes = np.abs(segments[used[segments[used, GROUP] >= 0.0], _BRANCHES])
        longest = np.array([*sizes.max(axis=0, initial=0.0), np.sqrt((sizes**2).sum(axis=1).max(initial=0.0))])
        if not longest[:3][self.active].max() < _TOO_LONG:
            raise SceneError(
                f"{source}: a contact is {longest[:3][self.active].max() * self.cutoff:.3g} m long within the "
                f"mesh or a periodic box, more than {_TOO_LONG:.0f} supports of the kernel; its particles are not in "
                "touch: check the ids and units of the contacts, or choose a larger width"
            )
        return longest

    def _part_near(self, start: NDArray, end: NDArray, axes: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """First and last point, (n, 3) each, of the part of lines that is near the mesh, and its share (n, 1).

        Points are counted from the end that is nearer to the mesh, so that none of its digits are lost.
        """
        lower, upper = self.lower - _MARGIN, self.upper + _MARGIN

        def distance(point: NDArray) -> NDArray:
            return (np.maximum(np.maximum(lower - point, point - upper), 0.0) * axes).max(axis=1, keepdims=True)

        turned = distance(start) < distance(end)
        near, far = np.where(turned, start, end), np.where(turned, end, start)
        along = np.where(axes, far - near, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossings = np.array([lower - near, upper - near]) / along  # not a number: within, or on a face
        within = (lower <= near) & (near <= upper) | ~axes
        enters = np.where(along != 0.0, crossings.min(axis=0), np.where(within, -np.inf, np.inf)).max(axis=1)
        leaves = np.where(along != 0.0, crossings.max(axis=0), np.inf).min(axis=1)
        begin = np.clip(enters, 0.0, 1.0)[:, None]
        finish = np.maximum(begin, np.clip(leaves, 0.0, 1.0)[:, None])
        points = near + begin * along, near + finish * along
        return np.where(turned, *points), np.where(turned, *points[::-1]), finish - begin
