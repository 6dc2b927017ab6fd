"""Mixing of phases in a region: Lacey's index and the index of segregation.

Lacey's index compares concentrations in cells with their limits. All of it is of one phase
beside the rest, or, for the bulk, of all phases. With c_ka the share of phase a in cell k, p_a that
in the region, W_k = sum w_i over the grains of the cell (w_i = 1, or the volume), W that over the
region:

- variance ``S^2 = sum_k W_k / W (c_ka - p_a)^2``;
- segregated: ``S_0^2 = p_a (1 - p_a)``, every cell of one phase;
- random: ``S_r^2 = (K - 1) / (N - 1) * N sum_i w_i^2 (a_i - p_a)^2 / W^2``, the mean of S^2 over
  all ways to give the N grains in the K cells that are not empty their phases (a_i = 1 in phase a,
  else 0): exact by number, of first order in the number of grains of a cell by volume. With K cells
  of n grains it is Lacey's p (1 - p) / n for large N.

Lacey's index ``(S_0^2 - S^2) / (S_0^2 - S_r^2)`` is then 0 where phases are apart and 1 on average
where they are at random. For the bulk, variances are summed over the phases.

In a random mixture the index scatters by ``S_r^2 / (S_0^2 - S_r^2) sqrt((2 + (1 - 6 p q) / (p q)
<1 / n_k>) (1 - K / N) / (K - 1))``, q = 1 - p, from the moments of binomial numbers in cells of n_k
grains of a finite population. That is about ``sqrt(2 / K) / (n - 1)`` for K cells of n grains:
cells of ten grains or more are believed.

The index of segregation compares heights of centres, ``(z_a - z_rest) / (z_top - z_bottom)``, with
the heights of the same grains sorted so that the phase is uppermost (where it is below the
rest, the lowest): 1 where the phase lies on top, -1 at the bottom, 0 on average at random, whatever
its share. Heights weigh by volumes. In a
uniform bed of height H it is ``2 (z_a - z_rest) / H``.

Sources: Lacey (1954), J. Appl. Chem. 4, 257; centres: Staron & Phillips (2014), Phys. Fluids 26,
033302.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_once

NOISY = 0.1  # scatter of Lacey's index in a random mixture from which a warning is given


def ratio(a: Any, b: float) -> Any:
    """Return a / b, NaN where b is not positive."""
    if b > 0:
        return a / b
    return np.full(np.shape(a), np.nan)


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
    cell : array (D,)
        Edges of the cells (m), about; infinite along axes that are not divided.
    height : array (n,)
        Places along the axis of segregation (m).
    volume : array (n,)
        Volumes of the grains (m3).
    """

    position: NDArray
    phase: NDArray
    weight: NDArray
    lengths: NDArray
    cell: NDArray
    height: NDArray
    volume: NDArray

    @cached_property
    def cells(self) -> NDArray:
        """Number of each grain's cell, counted over the cells that are not empty; (n,)."""
        counts = [max(1, round(share)) for share in (self.lengths / self.cell).tolist()]
        cell = np.zeros(len(self.position), "int64")
        for x, length, count in zip(self.position.T, self.lengths, counts, strict=True):
            cell = cell * count + np.clip((x / length * count).astype("int64"), 0, count - 1)
        return np.unique(cell, return_inverse=True)[1]

    def members(self, which: int) -> NDArray:
        """Return masks (parts, n) of the grains in phase `which` - 1; for 0, in each of the phases."""
        if which == 0:
            return self.phase == np.unique(self.phase)[:, None]
        return (self.phase == which - 1)[None]

    def shares(self, members: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return W_k / W (k,), c_ka (parts, k) and p_a (parts,)."""
        total = np.bincount(self.cells, self.weight)
        parts = np.array([np.bincount(self.cells, self.weight * mask) for mask in members])
        parts = parts.reshape(len(members), -1)
        return total / total.sum(), parts / total, parts.sum(axis=1) / total.sum()

    def variance(self, which: int) -> float:
        """S^2."""
        weight, inside, share = self.shares(self.members(which))
        return float((weight * (inside - share[:, None]) ** 2).sum())

    def segregated_variance(self, which: int) -> float:
        """S_0^2."""
        _, _, share = self.shares(self.members(which))
        return float((share * (1 - share)).sum())

    def random_variance(self, which: int) -> float:
        """S_r^2."""
        return float(self._random_variances(which).sum())

    def _random_variances(self, which: int) -> NDArray:
        """S_r^2 of each part (parts,)."""
        members = self.members(which)
        weight, _, share = self.shares(members)
        spread = (self.weight * (members - share[:, None])) ** 2
        count = len(self.phase)
        factor = ratio(len(weight) - 1, count - 1) * count
        return np.asarray(factor * spread.sum(axis=1) / self.weight.sum() ** 2)

    def grains_per_cell(self, which: int) -> float:
        """Return the mean number of grains of all phases in the cells that are not empty."""
        return float(ratio(len(self.phase), len(np.unique(self.cells))))

    def lacey(self, which: int) -> float:
        """Return Lacey's index.

        NaN, with a warning, if all grains are of one phase, or no cell holds two grains, or one cell
        holds all of them, so that all arrangements are alike, or if S_r^2 >= S_0^2, as is possible by
        volume.
        """
        count = len(self.phase)
        apart = self.segregated_variance(which)
        cells = self.cells.max(initial=-1) + 1
        if count > 1 and len(np.unique(self.phase)) == 1:
            warn_once(
                "one phase",
                f"lacey_index is NaN: all {count} grains are of one phase; by= names the variable that "
                "holds the phases, and ds.cg.assign_phases(edges=[...]) makes one from diameters",
            )
        if apart > 0 and cells == 1:
            warn_once(
                "one cell",
                f"lacey_index is NaN: one cell holds all {count} grains of the region, which extends "
                f"over {' x '.join(f'{length:.3g}' for length in self.lengths)}; give a smaller cell=",
            )
            return math.nan
        if apart > 0 and cells == count:
            problem = f"no cell {self._edges()} holds more than one of the {count} grains"
            warn_once("cells below a grain", f"lacey_index is NaN: {problem}; {self._way_out()}")
            return math.nan
        random = self.random_variance(which)
        if 0 < apart <= random:
            warn_once(
                "few grains by volume",
                f"lacey_index is NaN: by volume a random mixture has the variance {random:.2g}, and "
                f"separate phases no more than {apart:.2g}, as few large grains hold most of the "
                "volume; pass mixing_weight='number', or take larger cells",
            )
            return math.nan
        noise = self.noise(which)
        if noise > NOISY:
            warn_once(
                "few grains a cell",
                f"lacey_index scatters by {noise:.2g} in a random mixture, as cells {self._edges()} hold "
                f"{self.grains_per_cell(which):.2g} grains on average (lacey_noise); {self._way_out()}",
            )
        return float(ratio(apart - self.variance(which), apart - random))

    def noise(self, which: int) -> float:
        """Return the standard deviation of Lacey's index in a random mixture, of first order.

        Numbers of a phase in cells of n_k grains are taken as binomial, and for the bulk deviations
        of the phases are added, as the two of a mixture of two phases are equal.
        """
        size = np.bincount(self.cells)
        if len(size) < 2:
            return math.nan
        share = self.members(which).mean(axis=1)
        spread = share * (1 - share)
        fourth = np.zeros(len(spread))
        np.divide((1 / size).mean() * (1 - 6 * spread), spread, out=fourth, where=spread > 0)
        finite = 1 - len(size) / len(self.phase)
        relative = np.sqrt(np.maximum(2 + fourth, 0) * finite / (len(size) - 1))
        random = self._random_variances(which)
        return float(
            ratio((random * relative).sum(), self.segregated_variance(which) - random.sum())
        )

    def _edges(self) -> str:
        """Return the edges of the cells, as part of a message."""
        divided = self.cell[np.isfinite(self.cell)]
        return f"of edge {' x '.join(f'{edge:g}' for edge in np.unique(divided))}"

    def _way_out(self) -> str:
        """Return the shortest edges for which the index scatters little, as the end of a message."""
        shortest = float(self.cell.min())
        edge = shortest
        while True:
            edge = float(f"{1.15 * edge:.2g}")
            larger = replace(self, cell=self.cell * (edge / shortest))
            if not larger.cells.any():
                return "the region holds too few grains for an index of mixing"
            if larger.cells.max() + 1 < len(self.phase) and larger.noise(0) <= NOISY:
                return f"take cell={edge:g} or more"

    def segregation(self, which: int) -> float:
        """Return the index of segregation by centres: 1 on top, -1 at the bottom; NaN for the bulk."""
        members = self.phase == which - 1
        if which == 0:
            return math.nan
        if len(members) and (members.all() or not members.any()):
            warn_once(
                "one phase by height",
                f"segregation_index is NaN: all {len(members)} grains that move are of one phase; by= names "
                "the variable that holds the phases, and ds.cg.assign_phases(edges=[...]) makes one from "
                "diameters",
            )
            return math.nan
        if not len(members):
            return math.nan
        apart = self._rise(members * self.volume)
        order = np.argsort(-self.height)
        if apart < 0:
            order = np.argsort(self.height)
        volume = self.volume[order]
        # the outermost places that the phase fills, the last of them in part
        left = self.volume[members].sum() - (np.cumsum(volume) - volume)
        outermost = np.empty(len(order))
        outermost[order] = np.clip(left, 0.0, volume)
        return float(ratio(apart, abs(self._rise(outermost))))

    def _rise(self, part: NDArray) -> float:
        """Return the height of the centre of parts (n,) of the volumes above that of the rest (m)."""
        rest = self.volume - part
        height = self.height - self.height.mean()
        return float((part * height).sum() / part.sum() - (rest * height).sum() / rest.sum())
