"""Levels of cells: particles sorted by size into levels, and within a level by the cell that holds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import pairs as loops
from xcg.compiled.arrays import counting_sort_places
from xcg.compiled.threads import for_parts

# Largest over smallest radius within a level, where the caller gives no number of levels. A level costs each smaller
# particle four or five runs of cells (20 ns each), a wide level more tests (2 ns each): between 2.5 and 4 the search
# of log-linear packings takes the same time within 15 %, at 1.5 it takes twice as long.
LEVEL_RATIO = 3.0
# Edges of the cells along x, y and z over the reach of the level's largest particles. All cells along z that a particle
# can reach are one run of records: short ones test fewer pairs at no cost but memory. Long ones along x and y test more
# pairs in fewer runs, 11 % faster than 1 where cells hold a particle or two, but not where they hold many.
EDGES = np.array([1.0, 1.0, 1 / 3])
LONG_EDGES = np.array([1.5, 1.5, 1 / 3])
CROWDED = 2.5  # particles in a cube of the reach
# More cells than this for each particle of a level cost memory and find nothing: cells are then made larger.
CELLS_A_PARTICLE = 8


@dataclass(frozen=True, eq=False)
class Levels:
    """Cells of all levels, from small particles to large.

    Attributes
    ----------
    lower, inverse, cells : array (levels, 3)
        Corner (m), inverse edge (m-1) and number of the cells along each axis.
    largest : array (levels,)
        Largest radius (m).
    fold : array (levels, 3)
        The period along axes too short for three cells, infinity along the others.
    first_cell : array (levels,)
        Number of the first cell, all levels counted through.
    total : int
        Number of cells.
    """

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
            # a hair more than the reach, so that no rounding makes it span a cell more
            reach = (2 * largest[k] + skin + 2 * slack) * (1 + 1e-9)
            held = members[k] * np.minimum(np.divide(reach, length, out=np.ones(3), where=length > 0), 1).prod()
            edges = EDGES if held > CROWDED else LONG_EDGES
            reach = max(reach, _reach_for(length / edges, max(CELLS_A_PARTICLE * members[k], 64)))
            if reach > 0:
                cells[k] = np.maximum(np.minimum(length / (reach * edges), 2.0**31), 1).astype("int64")
                cells[k, periodic & (length < 3 * reach * np.maximum(edges, 1))] = 1
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


def _reach_for(scaled: NDArray, count: float) -> float:
    """Reach for which about `count` cells fill a box of these lengths over edges; short axes are left out."""
    scaled = np.sort(scaled[scaled > 0])
    for k in range(len(scaled)):
        rest = scaled[k:]
        reach = float(np.exp((np.log(rest).sum() - np.log(count)) / len(rest)))
        if reach <= scaled[k]:
            return reach
    return float(scaled[-1]) if len(scaled) else 0.0


@dataclass(frozen=True, eq=False)
class CellLists:
    """Particles sorted into the cells of their levels, ready for the search.

    Attributes
    ----------
    levels : Levels
    records : array (n, 4)
        x, y, z, radius, by level and cell (m).
    row : array (n,)
        Row of the particle that each record is.
    first_record : array (levels + 1,)
        First record of each level.
    starts : array (levels.total + 1,)
        First record of each cell.
    period : array (3,)
        Period of each axis (m), infinity where there is none.
    skin : float
        Pairs closer than the sum of their radii and this are found (m).
    slack : float
        Rounding of coordinates (m).
    """

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
        cls, position: NDArray, radius: NDArray, corner: NDArray, period: NDArray, *, skin: float, levels: int | None,
        threads: int = 1,
    ) -> CellLists:  # fmt: skip
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

        def locate(first: int, last: int) -> None:
            some = slice(first, last)
            loops.locate(
                position[some], level[some], corner, period, chosen.lower, chosen.inverse, chosen.cells,
                chosen.first_cell, wrapped[some], cell[some],
            )  # fmt: skip

        for_parts(count, locate, threads)
        # the sort leaves where each cell ends, and the next begins
        starts, place = np.zeros(chosen.total + 2, "int32"), np.empty(count, "int64")
        counting_sort_places(cell, starts[1:], place)
        starts = starts[:-1]
        records, row = np.empty((count, 4)), np.empty(count, "int32")

        def write(first: int, last: int) -> None:
            some = slice(first, last)
            loops.write_records(place[some], wrapped[some], radius[some], first, records, row)

        for_parts(count, write, threads)
        first_record = np.concatenate([[0], np.cumsum(members)])
        return cls(chosen, records, row, first_record, starts, period, skin, slack)

    def find(self, first: int, last: int, most: int = 2**62) -> tuple[NDArray, NDArray, int]:
        """Pairs of the records from `first` to `last`, of more than `most` only some, and the distances that took."""
        capacity = 4 * (last - first) + 64
        at = self.levels
        left, right, found, tested = loops.find(
            first, last, self.records, self.first_record, at.first_cell, self.starts, at.lower, at.inverse, at.cells,
            at.largest, self.period, at.fold, self.skin, self.slack, most,
            np.empty(capacity, "int32"), np.empty(capacity, "int32"),
        )  # fmt: skip
        return left[:found], right[:found], tested


def _by_size(radius: NDArray, skin: float, levels: int | None) -> tuple[NDArray, NDArray, NDArray]:
    """Level of each particle by logarithmic spacing; largest radius and number of particles of the levels in use."""
    reach = radius + skin / 2
    low, high = float(reach[reach > 0].min(initial=np.inf)), float(reach.max())
    low = max(low, 1e-300 * high)  # as in damaged files: their ratio must stay a number
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
