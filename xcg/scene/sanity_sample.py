"""Grains of one step as the checks of plausible scenes take them: samples, and neighbours in a small region."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xcg.scene.frame import entries_of
from xcg.scene.lattice import Lattice
from xcg.scene.schema import Frame, Setup

FEW = 20  # grains or contacts that are too few for a verdict
_SAMPLE = 4096  # particles or contacts looked at, spread over all
_REGION = 300  # grains of a region whose neighbours are looked at
_HALVINGS = 30  # of a region, until it holds so few
_BLOCK = 64  # grains of a region that are compared with the others at once
_CROWD = 8  # nearest grains that are looked at
# Nearest grains of a lattice, also of one with scatter, lie in few directions: 1/6 (fcc), 1/4 (bcc)
# or 1/3 (cubic) of all pairs of directions are parallel, in a plane 1/3 (hexagonal) or 1/2. Of
# directions at random 1/66 are within ten degrees, in a plane 1/9.
_PARALLEL = np.cos(np.radians(10.0))
_ALIGNED = {2: 0.22, 3: 0.1}  # least share of parallel pairs in a lattice
_EVEN = 0.1  # most scatter of nearest distances in a lattice


def sample_of(count: int) -> slice:
    """Return a slice that spreads about 4096 samples over all."""
    return slice(None, None, max(1, count // _SAMPLE))


@dataclass(frozen=True, eq=False)
class Particles:
    """Particles of one step, as the checks take them.

    Attributes
    ----------
    frame : Frame
        Particles, completed.
    setup : Setup
        Arguments of the scene.
    lattice : Lattice
        Box and periodic axes of the step.
    is_volume : bool
        Whether the scene was named three-dimensional, or found to be so.
    """

    frame: Frame
    setup: Setup
    lattice: Lattice
    is_volume: bool = False

    @cached_property
    def count(self) -> int:
        """Number of particles."""
        return len(self.frame["position"])

    @cached_property
    def sample(self) -> Frame:
        """Variables of particles spread over all."""
        some = sample_of(self.count)
        return entries_of(self.frame, some)

    @cached_property
    def diameter(self) -> float:
        """Mean diameter (m), NaN where it is not known."""
        sizes = self.sample.get("diameter", np.empty(0))
        return float(sizes.mean()) if len(sizes) else np.nan

    @cached_property
    def edges(self) -> dict[int, tuple[float, float]]:
        """Edges of the box along the axes of the scene on which it is finite (m)."""
        if self.lattice.edges is None:
            return {}
        lengths = np.diff(self.lattice.edges, axis=1)[:, 0]
        return {
            k: (float(self.lattice.edges[k, 0]), float(self.lattice.edges[k, 1]))
            for k in self.setup.axes
            if np.isfinite(lengths[k])
        }

    @cached_property
    def neighbours(self) -> tuple[NDArray, NDArray]:
        """Neighbours of the grains inside of a small region.

        Distances over sums of radii to the nearest grains (n, k), sorted, and vectors to the
        very nearest (n, 3).
        """
        nothing = np.empty((0, 0)), np.empty((0, 3))
        if "diameter" not in self.frame or self.count < FEW:
            return nothing
        middle, reach, inside = self._region()
        if not FEW <= len(inside) <= 2 * _REGION:  # few, or many at one point
            return nothing
        position = self.frame["position"][inside]
        diameter = self.frame["diameter"][inside]
        to_edge = reach - np.abs(position - middle)[:, self.setup.axes].max(axis=1)
        nearest = []
        directions = []
        # of so few, all pairs are quicker than the import of a tree; in blocks, which take less memory
        for first in range(0, len(inside), _BLOCK):
            indices = np.arange(first, min(first + _BLOCK, len(inside)))
            away = np.sqrt(sum((x[indices, None] - x) ** 2 for x in position.T))
            away[indices - first, indices] = np.inf
            ratio = 2 * away / (diameter[indices, None] + diameter)
            if len(inside) < self.count:  # the nearest grain may be outside of the region
                is_nearest = to_edge[indices] >= away.min(axis=1)
                ratio = ratio[is_nearest]
                indices = indices[is_nearest]
            nearest.append(np.sort(ratio, axis=1)[:, :_CROWD])
            directions.append(position[indices] - position[ratio.argmin(axis=1)])
        return np.concatenate(nearest), np.concatenate(directions)

    @property
    def is_lattice(self) -> bool:
        """Return True if nearest grains lie at one distance and in few directions."""
        _, directions = self.neighbours
        length = np.linalg.norm(directions, axis=1)
        if len(length) < FEW or not length.min() > 0 or length.std() > _EVEN * length.mean():
            return False
        units = directions / length[:, None]
        parallel = (np.abs(units @ units.T) > _PARALLEL).sum() - len(units)
        return bool(parallel > _ALIGNED[len(self.setup.axes)] * len(units) * (len(units) - 1))

    def _region(self) -> tuple[NDArray, float, NDArray]:
        """Return the middle (3,) and half of the edge of a cube of about 300 grains, and their indices."""
        sampled = self.sample["position"]
        # a grain, as there may be none in the middle of a drum
        middle = sampled[((sampled - np.median(sampled, axis=0)) ** 2).sum(axis=1).argmin()]
        low, high = np.quantile(sampled[:, self.setup.axes], [0.02, 0.98], axis=0)
        share = min(1.0, _REGION / self.count)
        reach = 0.5 * (high - low).max() * share ** (1 / len(self.setup.axes))
        inside = self._around(middle, reach)
        for _ in range(_HALVINGS):
            if len(inside) <= 2 * _REGION:
                break
            reach *= 0.5
            inside = self._around(middle, reach)
        return middle, reach, inside

    def _around(self, middle: NDArray, reach: float) -> NDArray:
        """Return the indices of the particles in a cube, axis by axis, as few are left after the first."""
        position = self.frame["position"]
        indices = np.arange(self.count)
        for k in self.setup.axes:
            x = position[:, k] if len(indices) == self.count else position[indices, k]
            indices = indices[(x >= middle[k] - reach) & (x <= middle[k] + reach)]
        return indices

    def outside(self, k: int, position: NDArray, room: float) -> float:
        """Return the share of positions (n,) that are farther than `room` (m) from the box along an axis."""
        low, high = self.edges[k]
        return float(((position < low - room) | (position > high + room)).mean())
