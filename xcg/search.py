"""Who is near whom: all pairs of spheres closer than their radii and a skin, for any mix of sizes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.complete import periods
from xcg.kernels import neighbours as kernel
from xcg.schema import SceneError

METHODS = ("hierarchical", "linked-cell")

# Largest over smallest radius within a level, where the caller gives no number of levels. Measured on log-linear
# packings: 1.5 to 2.5 cost the same within 10 %, below that levels cost more than they save.
LEVEL_RATIO = 2.0
# Cells are cut along z, where the cells that a particle can reach are one run of records: finer cells test fewer
# pairs and cost nothing but memory. Measured: 2 is 10 % faster than 1, 3 no faster than 2.
CUTS = 2
# More cells than this for each particle of a level only cost memory: cells are then made larger.
CELLS_A_PARTICLE = 8
# Fewer particles than this are not worth a second thread.
PARTICLES_A_THREAD = 20_000


@dataclass(frozen=True)
class Levels:
    """Cells of all levels, from small particles to large; see `xcg.kernels.neighbours`."""

    lower: NDArray
    inverse: NDArray
    cells: NDArray
    largest: NDArray
    fold: NDArray
    first_cell: NDArray
    total: int

    @classmethod
    def of(
        cls, largest: NDArray, members: NDArray, lower: NDArray, upper: NDArray, period: NDArray, skin: float,
        slack: float,
    ) -> Levels:  # fmt: skip
        """Choose cells for levels with these largest radii and numbers of particles, over lower to upper."""
        count = len(largest)
        periodic = np.isfinite(period)
        length = upper - lower
        cells = np.ones((count, 3), "int64")
        for k in range(count):
            # the least edge that a reach fits into, and a hair more, so that no rounding makes it span four cells
            edge = (2 * largest[k] + skin + 2 * slack) * (1 + 1e-9)
            edge = max(edge, _edge_for(length, max(CELLS_A_PARTICLE * members[k], 64)))
            if edge > 0:
                cells[k] = np.maximum(np.minimum(length / edge * (1, 1, CUTS), 2.0**31), 1).astype("int64")
                cells[k, periodic & (length < 3 * edge)] = 1
        inverse = np.divide(cells, length, out=np.zeros(cells.shape), where=length > 0)
        per_level = cells.prod(axis=1)
        return cls(
            lower=np.broadcast_to(lower, (count, 3)).copy(),
            inverse=inverse,
            cells=cells,
            largest=largest,
            fold=np.where(cells == 1, period, np.inf),
            first_cell=np.concatenate([[0], np.cumsum(per_level)[:-1]]),
            total=int(per_level.sum()),
        )


def _edge_for(length: NDArray, count: float) -> float:
    """Edge of cubes of which about `count` / CUTS fill the box; axes shorter than the edge are left out."""
    axes = np.sort(length[length > 0])
    for k in range(len(axes)):
        rest = axes[k:]
        edge = float(np.exp((np.log(rest).sum() - np.log(count / CUTS)) / len(rest)))
        if edge <= axes[k]:
            return edge
    return float(axes[-1]) if len(axes) else 0.0


@dataclass(frozen=True)
class Sorted:
    """Particles sorted into the cells of their levels, ready for the search."""

    levels: Levels
    records: NDArray
    row: NDArray
    first_record: NDArray
    starts: NDArray
    period: NDArray
    skin: float
    slack: float

    @classmethod
    def of(
        cls, position: NDArray, radius: NDArray, corner: NDArray, period: NDArray, *, skin: float, levels: int | None
    ) -> Sorted:
        """Sort particles into `levels` levels (None: as many as their sizes ask for)."""
        # a layer is sorted along y, so that runs of cells stay long
        axes = [2, 0, 1] if np.ptp(position[:, 2]) <= 2 * radius.max() + skin else [0, 1, 2]
        position, corner, period = position[:, axes], corner[axes], period[axes]
        level, largest, members = _by_size(radius, skin, levels)
        lower, upper = _extent(position, corner, period)
        # coordinates as large as these are rounded by no more than this, and so are their differences
        slack = 16 * np.finfo(float).eps * float(max(np.abs(position).max(), np.abs(lower).max(), np.abs(upper).max()))
        chosen = Levels.of(largest, members, lower, upper, period, skin, slack)
        count = len(position)
        wrapped, cell = np.empty((count, 3)), np.empty(count, "int64")
        starts = np.zeros(chosen.total + 1, "int64")
        kernel.locate(
            position, level, corner, period, chosen.lower, chosen.inverse, chosen.cells, chosen.first_cell,
            wrapped, cell, starts,
        )  # fmt: skip
        records, row = np.empty((count, 4)), np.empty(count, "int32")
        kernel.sort_by_cell(cell, wrapped, radius, starts, records, row)
        first_record = np.concatenate([[0], np.cumsum(members)])
        return cls(chosen, records, row, first_record, starts, period, skin, slack)

    def find(self, first: int, last: int) -> tuple[NDArray, NDArray, int]:
        """Pairs of the records from `first` to `last`, and how many distances that took."""
        capacity = 4 * (last - first) + 64
        at = self.levels
        left, right, found, tested = kernel.find(
            first, last, self.records, self.first_record, at.first_cell, self.starts, at.lower, at.inverse, at.cells,
            at.largest, self.period, at.fold, self.skin, self.slack, np.empty(capacity, "int32"),
            np.empty(capacity, "int32"),
        )  # fmt: skip
        return left[:found], right[:found], tested


def _by_size(radius: NDArray, skin: float, levels: int | None) -> tuple[NDArray, NDArray, NDArray]:
    """Level of each particle by logarithmic spacing; largest radius and number of particles of the levels in use."""
    reach = radius + skin / 2
    low, high = float(reach[reach > 0].min(initial=np.inf)), float(reach.max())
    if not low < high:
        return np.zeros(len(radius), "int64"), np.array([radius.max()]), np.array([len(radius)])
    span = np.log(high / low)
    count = levels or 1 + int(span / np.log(LEVEL_RATIO))
    step = np.log(np.maximum(reach, low) / low) * (count / span)
    level = np.minimum(step.astype("int64"), count - 1)
    members = np.bincount(level, minlength=count)
    largest = np.zeros(count)
    np.maximum.at(largest, level, radius)
    used = members > 0
    return (np.cumsum(used) - 1)[level], largest[used], members[used]


def _extent(position: NDArray, corner: NDArray, period: NDArray) -> tuple[NDArray, NDArray]:
    """Where cells lie: the box along periodic axes, else the particles, a few that are far astray left out."""
    sample = position[:: max(1, len(position) // 10_000)]
    low, high = np.quantile(sample, 0.01, axis=0), np.quantile(sample, 0.99, axis=0)
    margin = 0.05 * (high - low)
    lower = np.maximum(position.min(axis=0), low - margin)
    upper = np.minimum(position.max(axis=0), high + margin)
    periodic = np.isfinite(period)
    return np.where(periodic, corner, lower), np.where(periodic, corner + period, upper)


def find_pairs(
    position: ArrayLike,
    radius: ArrayLike,
    box: ArrayLike | Mapping[str, Sequence[float]] | None = None,
    periodic: str = "",
    *,
    skin: float = 0.0,
    method: str = "hierarchical",
    levels: int | None = None,
    threads: int | None = None,
) -> NDArray:
    """Find all pairs."""
    from xcg.scene import box_array

    centres = np.ascontiguousarray(position, float)
    radii = np.ascontiguousarray(radius, float)
    edges = None if box is None else box_array(box, 1)[0]
    period = periods(edges, periodic)
    if len(centres) < 2:
        return np.empty((0, 2), "int64")
    corner = np.zeros(3) if edges is None else np.where(np.isfinite(period), edges[:, 0], 0.0)
    ordered = Sorted.of(centres, radii, corner, period, skin=skin, levels=1 if method == "linked-cell" else levels)
    workers = threads or min(len(os.sched_getaffinity(0)), 1 + len(centres) // PARTICLES_A_THREAD)
    parts = 1 if workers == 1 else 8 * workers
    cuts = np.linspace(0, len(centres), parts + 1).astype(int)
    if workers == 1:
        found = [ordered.find(0, len(centres))]
    else:
        with ThreadPoolExecutor(workers) as pool:
            found = list(pool.map(ordered.find, cuts[:-1], cuts[1:]))
    left, right = (np.concatenate([f[k] for f in found]) for k in (0, 1))
    pairs = np.empty((len(left), 2), "int64")
    kernel.sort_pairs(left, right, ordered.row, pairs)
    return pairs
