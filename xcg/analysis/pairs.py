"""Pairs of particles that are near each other, by cells of the sizes that occur."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import NOT_NEGATIVE, check, whole
from xcg.common.messages import SceneError
from xcg.compiled import pairs as loops
from xcg.compiled._jit import THREADS, for_parts, threads_for
from xcg.compiled.arrays import sort_by_key
from xcg.compiled.pairs import Levels, Records, order_pairs, sort_pairs
from xcg.compiled.radial_distribution import Histogram
from xcg.scene.box import domain_of
from xcg.scene.frame import entries_of
from xcg.scene.lattice import Lattice
from xcg.scene.schema import periodic_axes

# Largest over smallest radius within a level, where the caller gives no number of levels. A level
# costs each smaller particle four or five runs of cells (20 ns each), a wide level more tests (2 ns
# each): between 2.5 and 4 the search of log-linear packings takes the same time within 15 %, at 1.5
# it takes twice as long.
LEVEL_RATIO = 3.0
# Edges of the cells along x, y and z over the reach of the level's largest particles. All cells
# along z that a particle can reach are one run of records: short ones test fewer pairs at no cost
# but memory. Long ones along x and y test more pairs in fewer runs, 11 % faster than 1 where cells
# hold a particle or two, but not where they hold many.
EDGES = np.array([1.0, 1.0, 1 / 3])
LONG_EDGES = np.array([1.5, 1.5, 1 / 3])
CROWDED = 2.5  # particles in a cube of the reach
# More cells than this for each particle of a level cost memory and find nothing: cells are then
# made larger.
CELLS_A_PARTICLE = 8
# Pairs that the search stops beyond, unless more are asked for: spheres without overlap have 7 a
# particle.
MOST_A_PARTICLE = 200
MOST_PAIRS = 1_000_000


def _cells_of_levels(
    largest: NDArray, members: NDArray, length: NDArray, period: NDArray, skin: float, slack: float
) -> NDArray:
    """Choose the number of cells of each level along each axis of a region of this length; (levels, 3)."""
    count = len(largest)
    cells = np.ones((count, 3), "int64")
    for k in range(count):
        # a hair more than the reach, so that no rounding makes it span a cell more
        reach = (2 * largest[k] + skin + 2 * slack) * (1 + 1e-9)
        share = np.divide(reach, length, out=np.ones(3), where=length > 0)
        edges = LONG_EDGES
        if members[k] * np.minimum(share, 1).prod() > CROWDED:
            edges = EDGES
        reach = max(reach, _reach_for(length / edges, max(CELLS_A_PARTICLE * members[k], 64)))
        if reach > 0:
            cells[k] = np.maximum(np.minimum(length / (reach * edges), 2.0**31), 1).astype("int64")
            cells[k, np.isfinite(period) & (length < 3 * reach * np.maximum(edges, 1))] = 1
    return cells


def _reach_for(scaled: NDArray, count: float) -> float:
    """Reach for which about `count` cells fill a box of these lengths over edges; short axes are left out."""
    scaled = np.sort(scaled[scaled > 0])
    for k in range(len(scaled)):
        rest = scaled[k:]
        reach = float(np.exp((np.log(rest).sum() - np.log(count)) / len(rest)))
        if reach <= scaled[k]:
            return reach
    return float(scaled.max(initial=0.0))


@dataclass(frozen=True, eq=False)
class CellLists:
    """Particles sorted into the cells of their levels, ready for the search.

    Attributes
    ----------
    levels : Levels
        Their cells.
    records : Records
        The particles, by level and cell.
    original : array (n,)
        Index of the particle that each record holds.
    axes : tuple of int
        Which of x, y, z each component of the records is.
    """

    levels: Levels
    records: Records
    original: NDArray
    axes: tuple[int, ...]

    @classmethod
    def of(
        cls,
        position: NDArray,
        radius: NDArray,
        corner: NDArray,
        period: NDArray,
        *,
        skin: float,
        levels: int | None,
        threads: int = 1,
    ) -> CellLists:
        """Sort particles into `levels` levels (None: as many as their sizes ask for)."""
        axes = [0, 1, 2]
        if np.ptp(position[:, 2]) <= 2 * radius.max() + skin:
            axes = [2, 0, 1]  # a layer is sorted along y, so that runs of cells stay long
        position = position[:, axes]
        corner = corner[axes]
        period = period[axes]
        level, largest, members = _by_size(radius, skin, levels)
        lower, upper = _extent(position, corner, period)
        # coordinates as large as these are rounded by no more than this, and so are their
        # differences
        largest_size = max(np.abs(some).max() for some in (position, lower, upper))
        slack = 16 * np.finfo(float).eps * float(largest_size)
        length = upper - lower
        cells = _cells_of_levels(largest, members, length, period, skin, slack)
        lower = np.broadcast_to(lower, cells.shape).copy()
        inverse = np.divide(cells, length, out=np.zeros(cells.shape), where=length > 0)
        first_cell = np.concatenate([[0], np.cumsum(cells.prod(axis=1))])
        fold = np.where(cells == 1, period, np.inf)
        sizes = Levels(lower, inverse, cells, first_cell, largest, period, fold, float(skin), slack)
        count = len(position)
        wrapped = np.empty((count, 3))
        cell = np.empty(count, "int64")

        def locate(first: int, last: int) -> None:
            some = slice(first, last)
            loops.locate(position[some], level[some], corner, sizes, wrapped[some], cell[some])

        for_parts(count, locate, threads)
        # the sort leaves where each cell ends, and the next begins
        starts = np.zeros(first_cell[-1] + 2, "int32")
        original = np.empty(count, "int32")
        sort_by_key(cell, starts[1:], original)
        starts = starts[:-1]
        records = np.empty((count, 4))

        def write(first: int, last: int) -> None:
            loops.write_records(original[first:last], wrapped, radius, records[first:last])

        for_parts(count, write, threads)
        first_record = np.concatenate([[0], np.cumsum(members)])
        return cls(sizes, Records(records, first_record, starts), original, tuple(axes))

    def find(self, first: int, last: int, max_pairs: int = 2**62) -> tuple[NDArray, NDArray, int]:
        """Pairs of some records, only some of more than `max_pairs`, and the distances that took."""
        capacity = 4 * (last - first) + 64
        left, right, count, tested = loops.find(
            first,
            last,
            self.levels,
            self.records,
            max_pairs,
            np.empty(capacity, "int32"),
            np.empty(capacity, "int32"),
            None,
        )
        return left[:count], right[:count], tested

    def count(self, first: int, last: int, histogram: Histogram) -> None:
        """Count pairs of some records in a histogram."""
        unused = np.empty(0, "int32")
        loops.find(first, last, self.levels, self.records, 2**62, unused, unused, histogram)


def _by_size(radius: NDArray, skin: float, levels: int | None) -> tuple[NDArray, NDArray, NDArray]:
    """Level of each particle by logarithmic spacing; largest radius and number of particles of the levels in use."""
    reach = radius + skin / 2
    high = float(reach.max())
    # as in damaged files: their ratio must stay a number
    low = max(float(reach[reach > 0].min(initial=np.inf)), 1e-300 * high)
    if not low < high:
        return np.zeros(len(radius), "int64"), np.array([radius.max()]), np.array([len(radius)])
    span = np.log(high / low)
    count = int(levels or 1 + span / np.log(LEVEL_RATIO))
    position = np.log(np.maximum(reach, low) / low) * (count / span)
    level = np.minimum(position.astype("int64"), count - 1)
    members = np.bincount(level, minlength=count)
    largest = np.zeros(count)
    np.maximum.at(largest, level, radius)
    used = members > 0
    return (np.cumsum(used) - 1)[level], largest[used], members[used]


def _extent(position: NDArray, corner: NDArray, period: NDArray) -> tuple[NDArray, NDArray]:
    """Return the region of the cells: the box along periodic axes, else the particles without a few outliers."""
    sample = position[:: max(1, len(position) // 10_000)]
    low, high = np.quantile(sample, (0.01, 0.99), axis=0)
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
    lattice: ArrayLike | Mapping[str, ArrayLike] | None = None,
    skin: float = 0.0,
    levels: int | None = None,
    threads: int | None = None,
    max_pairs: int | None = None,
) -> NDArray:
    """Find all pairs of spheres with ``|r_i - r_j| < R_i + R_j + skin``, each once, for any mix of sizes.

    Particles are sorted by size into levels, each with cells as large as its largest particles
    need. Pairs of one level are found in forward cells, pairs of two levels from the smaller
    particle in the cells of the larger level (Iwai, Hong & Greil 1999; Ogarko & Luding 2012; Shire,
    Hanley & Stratford 2020). Time and memory are linear in particles and pairs, whatever the ratio
    of sizes.

    Parameters
    ----------
    position : array (n, 3) or (n, 2)
        Centres (m). Those outside the box are wrapped into it along periodic axes; along the
        others, cells are laid where the particles are.
    radius : array (n,)
        Radii (m), zero included.
    box : array (3, 2) or (2, 2), or mapping, optional
        Edges of the domain (m), needed along periodic axes, for example ``{"x": (0.0, 0.1)}``.
    periodic : str
        Periodic axes, any of "xyz". Distances are to the nearest image; a particle is not a partner
        of its own image.
    lattice : array (3, 3) or mapping, optional
        Vectors a, b, c to the next images of a tilted box, or its tilts, as in
        `xcg.scene_from_arrays` (m).
    skin : float
        Width of gaps that still count (m).
    levels : int, optional
        Number of levels, spaced logarithmically from the smallest to the largest radius; levels
        that hold no particles are left out. By default one for each factor of 3. With 1 the search
        is that of linked cells, the common method.
    threads : int, optional
        Threads that search; by default all cores for many particles. The result does not depend on
        it.
    max_pairs : int, optional
        Limit on the number of pairs, where it is above a million and 200 a particle.

    Returns
    -------
    array (pairs, 2)
        Rows i < j of the particles of each pair, sorted by i, then j.

    Raises
    ------
    SceneError
        If arrays have the wrong shape or hold values that are not finite, a radius is negative, or
        the box is unbounded along a periodic axis, or there are more than max(10^6, 200 n, `max_pairs`)
        pairs.
    ValueError
        If `skin`, `levels` or `threads` is not as expected.

    Examples
    --------
    >>> find_pairs([[0.1, 0, 0], [9.9, 0, 0], [5.0, 0, 0]], [0.2, 0.2, 0.2], {"x": (0, 10)}, "x").tolist()
    [[0, 1]]
    """
    centres, radii = _spheres(position, radius)
    check_search(skin, levels, threads)
    if box is not None and not isinstance(box, Mapping) and np.shape(box) == (2, 2):
        box = dict(zip("xy", np.asarray(box, float).tolist(), strict=True))
    periodic = periodic_axes(periodic)
    arrays = domain_of(box, lattice, {}, periodic, 1)
    images = Lattice.of(entries_of(arrays, 0), periodic, "find_pairs")
    return pairs_of(
        centres,
        radii,
        images,
        skin=skin,
        levels=levels,
        threads=threads,
        max_pairs=max_pairs,
    )


def pairs_of(
    centres: NDArray,
    radii: NDArray,
    lattice: Lattice,
    *,
    skin: float,
    levels: int | None = None,
    threads: int | None,
    max_pairs: int | None,
    source: str = "find_pairs",
) -> NDArray:
    """Find pairs of spheres in any box, see `find_pairs`."""
    if len(centres) < 2:
        return np.empty((0, 2), "int64")
    count = len(centres)
    lists, whose = cells_of(
        centres, radii, lattice, skin=skin, levels=levels, threads=threads, source=source
    )
    workers = int(threads or threads_for(len(whose), THREADS))
    max_pairs = max(MOST_PAIRS, MOST_A_PARTICLE * len(whose), max_pairs or 0)
    counts = [0]

    def find(first: int, last: int) -> tuple[NDArray, NDArray]:
        left, right, _ = lists.find(first, last, max_pairs - sum(counts))
        counts.append(len(left))
        order_pairs(left, right, lists.original)
        return left, right

    # more parts than threads, as large particles take longer than small ones
    parts = for_parts(len(whose), find, workers, each=8)
    if sum(counts) > max_pairs:
        raise SceneError(
            f"more than {max_pairs} pairs of near particles among {len(whose)}: positions coincide, "
            "or diameters or skin= are too large for their unit. Where so many are meant, give max_pairs= "
            "(max_contacts= of find_contacts)"
        )
    low = np.concatenate([left for left, _ in parts])
    high = np.concatenate([right for _, right in parts])
    pairs = np.empty((len(low), 2), "int64")
    for_parts(
        len(whose),
        lambda first, last: sort_pairs(low, high, len(whose), first, last, pairs),
        workers,
    )
    if lattice.vectors is None:
        return pairs
    # of two images that are near each other one is in the box
    near = whose[pairs[pairs[:, 0] < count]]
    return np.unique(np.sort(near[near[:, 0] != near[:, 1]], axis=1), axis=0)


def cells_of(
    centres: NDArray,
    radii: NDArray,
    lattice: Lattice,
    *,
    skin: float = 0.0,
    levels: int | None = None,
    threads: int | None = None,
    source: str = "scene",
) -> tuple[CellLists, NDArray]:
    """Sort particles in any box into cells.

    Returns
    -------
    CellLists
        Cells of the particles; in tilted boxes also of their images near the box.
    array
        Row of the particle that each of them is, or is an image of: first the particles in order.
    """
    corner = lattice.corner
    whose = np.arange(len(centres))
    if lattice.vectors is not None:
        centres = lattice.wrapped(centres, corner, source)
        reach = 2 * radii.max() + skin
        low = centres.min(axis=0) - reach
        high = centres.max(axis=0) + reach
        index, shift, _ = lattice.images(centres, low, high, source)
        others = shift.any(axis=1)
        centres = np.concatenate([centres, centres[index[others]] + shift[others]])
        whose = np.concatenate([whose, index[others]])
    workers = int(threads or threads_for(len(centres), THREADS))
    lists = CellLists.of(
        centres, radii[whose], corner, lattice.period, skin=skin, levels=levels, threads=workers
    )
    return lists, whose


def _spheres(position: ArrayLike, radius: ArrayLike) -> tuple[NDArray, NDArray]:
    """Centres (n, 3) and radii (n,), checked."""
    centres = np.asarray(position, float)
    radii = np.ascontiguousarray(radius, float)
    if centres.size == 0:
        centres = centres.reshape(0, 3)
    if centres.ndim != 2 or centres.shape[1] not in (2, 3) or radii.shape != (len(centres),):
        raise SceneError(
            f"position has shape {np.shape(position)} and radius {np.shape(radius)}: expected (n, 3), or (n, 2) for a "
            "plane, and (n,)"
        )
    wrong = ~(np.isfinite(centres).all(axis=1) & np.isfinite(radii) & (radii >= 0))
    if wrong.any():
        index = int(np.flatnonzero(wrong)[0])
        raise SceneError(
            f"particle {index} has position {centres[index]} and radius {radii[index]} ({int(wrong.sum())} such rows): "
            "expected finite coordinates and a radius of at least 0; repair or drop these rows"
        )
    if centres.shape[1] == 2:
        centres = np.column_stack([centres, np.zeros(len(centres))])
    return np.ascontiguousarray(centres), radii


def check_search(skin: float, levels: int | None, threads: int | None = None) -> None:
    """Raise ValueError for invalid options of the search."""
    check("skin", skin, NOT_NEGATIVE, "m")
    check("levels", levels, whole(1), optional=True)
    check("threads", threads, whole(1), optional=True)
