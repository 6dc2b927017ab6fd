"""Indices of mixing: concentrations in cells against their limits, nearest neighbours, entropy.

All of it is of one phase beside the rest, or, for the bulk, of all phases. With c_ka the share of phase a in cell k,
p_a that in the region, W_k = sum w_i over the grains of the cell (w_i = 1, or the volume), W that over the region:

- variance ``S^2 = sum_k W_k / W (c_ka - p_a)^2``;
- segregated: ``S_0^2 = p_a (1 - p_a)``, every cell of one phase;
- random: ``S_r^2 = (K - 1) / (N - 1) * N sum_i w_i^2 (a_i - p_a)^2 / W^2``, the mean of S^2 over all ways to give the
  N grains in the K cells that are not empty their phases (a_i = 1 in phase a, else 0): exact by number, of first order
  in the number of grains of a cell by volume. With K cells of n grains it is Lacey's p (1 - p) / n for large N.

Lacey's index ``(S_0^2 - S^2) / (S_0^2 - S_r^2)`` is then 0 where phases are apart and 1 on average where they are at
random. For the bulk, variances are summed over the phases.

Sources: Lacey (1954), J. Appl. Chem. 4, 257; neighbours: Godlieb, Deen & Kuipers (2007), 6th Int. Conf. on Multiphase
Flow; entropy: Schutyser et al. (2001), Biotechnol. Bioeng. 75, 666.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.packing.quantities import ratio

ENOUGH = 5  # grains in a cell, on average, that a warning recommends


@dataclass(frozen=True, eq=False)
class Mixture:
    """The grains of a region by phase.

    Attributes
    ----------
    position : array (n, D)
        Centres in the axes of the scene, from the region's lower corner (m).
    phase : array (n,)
        0, 1, ...
    weight : array (n,)
        What grains count by.
    lengths : array (D,)
        Extent of the region (m).
    wraps : array (D,)
        Whether the region is a whole period along an axis.
    cell : float
        Edge of the cells (m), about.
    neighbours : int
        Nearest neighbours that are looked at.
    images : callable, optional
        In a box that is tilted: takes a distance, and gives all images that are no further from the region, as rows of
        the grains and positions; the grains themselves are among them.
    """

    position: NDArray
    phase: NDArray
    weight: NDArray
    lengths: NDArray
    wraps: NDArray
    cell: float
    neighbours: int
    images: Callable[[float], tuple[NDArray, NDArray]] | None = None

    @cached_property
    def cells(self) -> NDArray:
        """Number of the cell that each grain is in, counted over the cells that are not empty; (n,)."""
        counts = [max(1, round(length / self.cell)) for length in self.lengths.tolist()]
        place = np.zeros(len(self.position), "int64")
        for x, length, count in zip(self.position.T, self.lengths, counts, strict=True):
            place = place * count + np.clip((x / length * count).astype("int64"), 0, count - 1)
        return np.unique(place, return_inverse=True)[1]

    def members(self, which: int, *, rest: bool = False) -> NDArray:
        """Return masks of grains in phase `which` - 1, and in the `rest`; for 0, in each phase; (parts, n)."""
        if which == 0:
            return self.phase == np.unique(self.phase)[:, None]
        one = (self.phase == which - 1)[None]
        return np.concatenate([one, ~one]) if rest else one

    def shares(self, members: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return W_k / W (k,), c_ka (parts, k) and p_a (parts,)."""
        total = np.bincount(self.cells, self.weight)
        parts = np.array([np.bincount(self.cells, self.weight * a) for a in members]).reshape(len(members), -1)
        return total / total.sum(), parts / total, parts.sum(axis=1) / total.sum()

    def variance(self, which: int) -> float:
        """S^2."""
        if not len(self.phase):
            return np.nan
        weight, inside, share = self.shares(self.members(which))
        return float((weight * (inside - share[:, None]) ** 2).sum())

    def segregated_variance(self, which: int) -> float:
        """S_0^2."""
        if not len(self.phase):
            return np.nan
        _, _, share = self.shares(self.members(which))
        return float((share * (1 - share)).sum())

    def random_variance(self, which: int) -> float:
        """S_r^2."""
        count = len(self.phase)
        if count < 2:
            return np.nan
        members = self.members(which)
        weight, _, share = self.shares(members)
        spread = (self.weight * (members - share[:, None])) ** 2
        return float((len(weight) - 1) / (count - 1) * count * spread.sum() / self.weight.sum() ** 2)

    def lacey(self, which: int) -> float:
        """Lacey's index; NaN, with a warning, where no cell holds two grains, as all arrangements are then alike."""
        apart = self.segregated_variance(which)
        if apart > 0 and self.cells.max() + 1 == len(self.phase):
            warn_once("cells below a grain", self._too_small())
            return math.nan
        return float(ratio(apart - self.variance(which), apart - self.random_variance(which)))

    def _too_small(self) -> str:
        """Return a warning that recommends the smallest cell that holds `ENOUGH` grains on average."""
        count, edge = len(self.phase), self.cell
        message = f"lacey_index is NaN: no cell of edge {self.cell:g} holds more than one of the {count} grains; "
        if count < ENOUGH:
            return message + "the region holds too few grains for an index of mixing"
        while (replace(self, cell=edge).cells.max() + 1) * ENOUGH > count:
            edge = float(f"{1.3 * edge:.2g}")
        return message + f"take cell={edge:g} or more, which holds at least {ENOUGH} grains on average"

    def entropy(self, which: int) -> float:
        """Return the mean entropy of the cells over that of the region: 0 apart, 1 the same in all cells."""
        if not len(self.phase):
            return np.nan
        weight, inside, share = self.shares(self.members(which, rest=True))
        return float(ratio((weight * _entropy(inside)).sum(), float(_entropy(share))))

    @cached_property
    def unlike(self) -> NDArray:
        """Share of the nearest neighbours of each grain that are of another phase; (n,)."""
        from scipy.spatial import cKDTree

        count = min(self.neighbours, len(self.phase) - 1)
        if self.images is not None:
            return self._unlike_of(_nearest(self.position, self.lengths, count, self.images))
        tree = cKDTree(self.position, boxsize=np.where(self.wraps, self.lengths, 0.0))
        near = np.asarray(tree.query(self.position, count + 1)[1])
        own = near == np.arange(len(near))[:, None]
        own[~own.any(axis=1), -1] = True  # coincident grains may push the grain itself out of the list
        return self._unlike_of(near[~own].reshape(len(near), count))

    def _unlike_of(self, others: NDArray) -> NDArray:
        return np.asarray((self.phase[others] != self.phase[:, None]).mean(axis=1))

    def neighbour_index(self, which: int) -> float:
        """Return the unlike neighbours over their number among randomly placed grains: 0 apart, 1 at random."""
        count = len(self.phase)
        if count < 2:
            return np.nan
        members = self.members(which)
        number = members.sum(axis=1)
        expected = float((number * (count - number)).sum()) / (count - 1)
        return float(ratio(self.unlike[members.any(axis=0)].sum(), expected))


def _nearest(
    position: NDArray, lengths: NDArray, count: int, images: Callable[[float], tuple[NDArray, NDArray]]
) -> NDArray:
    """Rows of the nearest others of each grain (n, count), each of them once, whichever image is the nearest."""
    from scipy.spatial import cKDTree

    own = np.arange(len(position))[:, None]
    reach, looked_at = float((lengths.prod() * count / len(position)) ** (1 / len(lengths))), 2 * count + 2
    while True:
        rows, places = images(reach)
        looked_at = min(looked_at, len(rows))
        distance, near = cKDTree(places).query(position, range(1, looked_at + 1))
        distance, found = np.asarray(distance), rows[near]
        fresh = found != own
        for k in range(looked_at):
            fresh[:, k] &= (found[:, :k] != found[:, k, None]).all(axis=1)
        first = np.argsort(~fresh, axis=1, kind="stable")[:, :count]
        # images further away than these are not among those that were looked at
        if (np.take_along_axis(fresh, first, 1) & (np.take_along_axis(distance, first, 1) <= reach)).all():
            return np.take_along_axis(found, first, 1)
        reach, looked_at = 2 * reach, 2 * looked_at


def _entropy(share: NDArray) -> NDArray:
    """-sum c ln c over the first axis."""
    return np.asarray(-(share * np.log(np.where(share > 0, share, 1.0))).sum(axis=0))
