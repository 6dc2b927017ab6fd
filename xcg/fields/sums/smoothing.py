"""Smoothing by the kernel of one cutoff: nodes and periods in cutoffs, and what reaches the nodes.

What grains and contacts may reach is checked before loops start, which rely on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.compiled.segments import BRANCH, FORCE, GROUP
from xcg.compiled.smoothing import KernelCode
from xcg.fields.sums.nodes import Nodes, triple
from xcg.scene.schema import COMPONENTS

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
        numbers = np.column_stack([self.upper - self.lower, self.spacings, self.period]).tolist()
        # extent, spacing and period
        self._along_active = [(k, numbers[k]) for k in range(3) if nodes.active[k]]

    def check_far(self, farthest: Sequence[float] | NDArray, source: str) -> None:
        """Raise SceneError for places (3,) not finite or too far away to be numbered; damaged files hold them.

        Here and below, `source` names the step in messages.
        """
        for k, _ in self._along_active:
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
        images = [1.0, 1.0, 1.0]
        over_mesh = [1.0, 1.0, 1.0]
        for k, (extent, spacing, period) in self._along_active:
            if not (extent < _FAR and (reach[k] + extent) / spacing < _FAR):
                raise SceneError(
                    f"{source}: along '{COMPONENTS[k]}' the mesh is {extent * self.cutoff:.3g} m long "
                    f"with nodes {spacing * self.cutoff:.3g} m apart, and the radius of the support is "
                    f"{self.cutoff:.3g} m; choose a width and a spacing that are closer to each other"
                )
            images[k] = float(reach[k]) / period + 1.0
            over_mesh[k] = (float(reach[k]) + extent) / period + 1.0
        of_node = math.prod(images)
        all_nodes = math.prod(over_mesh)
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
        return all((longest + 2.0) / spacing < _SINGLE for _, (_, spacing, _) in self._along_active)

    def too_long(self, longest: NDArray) -> bool:
        """Return whether branches with these largest components (3,) must be cut."""
        return any(longest[k] > _LONG for k, _ in self._along_active)

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
