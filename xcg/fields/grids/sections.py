"""The accessible fraction averaged along axes: the accessible share of these axes, smeared along the others.

Smearing and averaging commute: with L(r') the share of the averaged axes that is accessible at the
place r' on the seen axes, the average is ``chi(r) = int Psi(r - r') L(r') dr'``, where Psi is the
kernel's marginal on the seen axes. L comes from parallel rays, which stand on a lattice and cross
the walls at exact places.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from xcg.fields.grids.walls import Wall
from xcg.fields.sums.kernels import Kernel

RAYS = 75025  # a Fibonacci number, for which the points of `_lattice` have few gaps
_RAYS_A_COLUMN = 256  # of cells of two seen axes
_CELLS = {1: 256, 2: 24}  # in a cutoff, by the number of seen axes
_MOST_CELLS = 2**22  # at a time; more nodes are divided into slabs
_RAYS_AT_A_TIME = 2**14
_RAYS_TIMED = 2**9
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True)
class Span:
    """Bounds of an averaged axis.

    Attributes
    ----------
    low, high : float
        Ends of the space that grains can reach (m).
    extent : float
        Length that sums along the axis are divided by (m).
    """

    low: float
    high: float
    extent: float


def open_ends(
    starts: NDArray, walls: Sequence[Wall], axis: int, reach: float
) -> tuple[NDArray, NDArray]:
    """Find the ends of the parts of parallel rays that are on the accessible side of all walls.

    Parameters
    ----------
    starts : array (n, 3)
        Starts of the rays (m).
    walls : sequence of Wall
        Walls.
    axis : int
        Axis that the rays are parallel to.
    reach : float
        Their length (m).

    Returns
    -------
    distance : array (n, k)
        Distances from the start (m), at most `reach`, in ascending order.
    change : array (n, k)
        1 where an accessible part begins, -1 where one ends, and 0 elsewhere.
    """
    distances = [np.zeros((len(starts), 1))]
    jumps = [np.zeros((len(starts), 1), int)]  # of the number of walls that the ray is behind
    behind = np.zeros((len(starts), 1), int)
    for wall in walls:
        is_open, crossings = wall.crossings_along(starts, axis, reach)
        crossings = np.minimum(np.sort(crossings, axis=1), reach)
        closes = is_open[:, None] ^ (np.arange(crossings.shape[1]) % 2 == 1)
        distances.append(crossings)
        jumps.append(np.where(closes, 1, -1))
        behind += ~is_open[:, None]
    distance = np.concatenate(distances, axis=1)
    order = np.argsort(distance, axis=1, kind="stable")
    distance = np.take_along_axis(distance, order, axis=1)
    jump = np.take_along_axis(np.concatenate(jumps, axis=1), order, axis=1)
    is_open = behind + np.cumsum(jump, axis=1) == 0
    change = np.diff(is_open.astype(int), axis=1, prepend=0)
    return distance, change


def _lattice(ranges: Sequence[tuple[int, float, float]], count: int) -> Iterator[NDArray]:
    """Yield points (n, 3) that are spread evenly over ranges of one or two axes, and over each of these axes alone.

    Coordinates on the first axis are equally spaced; those on the second are multiples of the
    golden ratio, modulo one.
    """
    for first in range(0, count, _RAYS_AT_A_TIME):
        number = np.arange(first, min(count, first + _RAYS_AT_A_TIME)) + 0.5
        points = np.zeros((len(number), 3))
        shares = number / count, number * GOLDEN % 1.0
        for (axis, low, high), share in zip(ranges, shares, strict=False):
            points[:, axis] = low + (high - low) * share
        yield points


@dataclass(frozen=True, eq=False)
class _SeenCells:
    """Cells of the seen axes around some nodes.

    Attributes
    ----------
    indices : array (n,)
        Indices of the nodes.
    origin : array (seen,)
        Lowest corner of the first cell (m).
    shape : tuple of int
        Number of cells along each axis.
    size : float
        Edge of the cells (m).
    """

    indices: NDArray
    origin: NDArray
    shape: tuple[int, ...]
    size: float

    @classmethod
    def around(cls, indices: NDArray, coordinates: NDArray, cutoff: float) -> _SeenCells:
        """Lay cells as far as a cutoff and two cells around coordinates (n, seen)."""
        size = cutoff / _CELLS[coordinates.shape[1]]
        origin = coordinates.min(axis=0) - cutoff - 2 * size
        count = np.ceil((coordinates.max(axis=0) + cutoff - origin) / size) + 2
        return cls(indices, origin, tuple(count.astype(int).tolist()), size)

    def bounds(self, k: int) -> tuple[float, float]:
        """Return the lowest and the highest coordinate along one of the axes (m)."""
        low = float(self.origin[k])
        return low, low + self.size * self.shape[k]

    @property
    def columns(self) -> int:
        """Number of columns along the last axis."""
        return math.prod(self.shape[:-1])

    @property
    def rays(self) -> int:
        """Number of rays along the last axis, equally many in each column."""
        if self.columns == 1:
            return RAYS
        return self.columns * max(_RAYS_A_COLUMN, RAYS // self.columns)


@dataclass(frozen=True, eq=False)
class AveragedFraction:
    """The accessible fraction at nodes, averaged along axes; `values` computes it.

    Attributes
    ----------
    nodes : array (n, 3)
        Nodes (m). Their coordinates on averaged axes have no effect.
    walls : sequence of Wall
        Walls.
    kernel : Kernel
        Kernel of the scene's dimension.
    seen : sequence of int
        The axes that are not averaged, at most two.
    averaged : mapping of int to Span
        The averaged axes along which walls vary, at least one.
    """

    nodes: NDArray
    walls: Sequence[Wall]
    kernel: Kernel
    seen: Sequence[int]
    averaged: Mapping[int, Span]

    @cached_property
    def _slabs(self) -> list[_SeenCells]:
        """Cells around nodes, divided across the first axis, so that their number is limited."""
        coordinates = self.nodes[:, list(self.seen)]
        cutoff = self.kernel.cutoff
        if not self.seen or not len(coordinates):
            return []
        a_cutoff = _CELLS[len(self.seen)]
        layer = 1.0  # cells of a layer across the first axis
        for k in range(1, len(self.seen)):
            layer *= (np.ptp(coordinates[:, k]) / cutoff + 3.0) * a_cutoff
        width = max(1.0, _MOST_CELLS / layer / a_cutoff) * cutoff
        slab = (coordinates[:, 0] - coordinates[:, 0].min()) // width
        members = [np.flatnonzero(slab == number) for number in np.unique(slab)]
        return [_SeenCells.around(indices, coordinates[indices], cutoff) for indices in members]

    @property
    def ray_count(self) -> int:
        """Number of rays."""
        if not self.seen:
            return RAYS
        return sum(cells.rays for cells in self._slabs)

    @property
    def along(self) -> int:
        """Axis that the rays are parallel to."""
        if self.seen:
            return self.seen[-1]
        return next(iter(self.averaged))

    def _ranges(self, cells: _SeenCells | None) -> list[tuple[int, float, float]]:
        """Return the axes across the rays and their bounds, first that of the columns of cells."""
        ranges = [
            (axis, span.low, span.high)
            for axis, span in self.averaged.items()
            if axis != self.along
        ]
        if cells is not None and len(self.seen) == 2:
            return [(self.seen[0], *cells.bounds(0)), *ranges]
        return ranges

    def seconds(self) -> float:
        """Estimate how long `values` takes, from some of its rays."""
        cells = None
        if self.seen:
            cells = self._slabs[0]
        low, high = self._bounds(cells)
        rays = next(_lattice(self._ranges(cells), _RAYS_TIMED))
        rays[:, self.along] = low
        open_ends(rays[:1], self.walls, self.along, high - low)  # compiles what is not compiled yet
        start = perf_counter()
        open_ends(rays, self.walls, self.along, high - low)
        return (perf_counter() - start) * self.ray_count / len(rays)

    def _bounds(self, cells: _SeenCells | None) -> tuple[float, float]:
        """Return where rays begin and end (m)."""
        if cells is not None:
            return cells.bounds(-1)
        return self.averaged[self.along].low, self.averaged[self.along].high

    def values(self, advance: Callable[[int], object]) -> NDArray:
        """Compute the fraction (n,).

        Parameters
        ----------
        advance : callable
            Called with the number of rays that are finished.

        Notes
        -----
        docs/walls.md lists the errors against closed forms and brute force.
        """
        share = math.prod((span.high - span.low) / span.extent for span in self.averaged.values())
        if not self.seen:
            return np.full(len(self.nodes), share * self._open_share(advance))
        out = np.empty(len(self.nodes))
        for cells in self._slabs:
            open_shares = self._open_shares(cells, advance)
            first_centre = cells.origin + 0.5 * cells.size
            coordinates = self.nodes[cells.indices][:, list(self.seen)] - first_centre
            out[cells.indices] = share * self.kernel.mean_of_cells(
                open_shares, coordinates, cells.size
            )
        return out

    def _open_share(self, advance: Callable[[int], object]) -> float:
        """Return the share of the averaged axes that is accessible, where no axis is seen."""
        low, high = self._bounds(None)
        length = 0.0
        for rays in _lattice(self._ranges(None), RAYS):
            rays[:, self.along] = low
            distance, change = open_ends(rays, self.walls, self.along, high - low)
            length += float((change * (high - low - distance)).sum())
            advance(len(rays))
        return length / (RAYS * (high - low))

    def _open_shares(self, cells: _SeenCells, advance: Callable[[int], object]) -> NDArray:
        """Return the mean over each cell of the share of the averaged axes that is accessible.

        Where an accessible part of a ray begins or ends in a cell, the part of the cell beyond is
        added or subtracted there, and the rest in the next cell, so that the sum along the column
        is exact.
        """
        low, high = cells.bounds(-1)
        rays_a_column = cells.rays // cells.columns
        rises = np.zeros((cells.columns, cells.shape[-1] + 2))
        first = 0
        for rays in _lattice(self._ranges(cells), cells.rays):
            rays[:, self.along] = low
            distance, change = open_ends(rays, self.walls, self.along, high - low)
            ray, end = np.nonzero(change)
            column = (first + ray) // rays_a_column
            cell, beyond = np.divmod(distance[ray, end] / cells.size, 1.0)
            cell = cell.astype(int)
            rise = change[ray, end] / rays_a_column
            np.add.at(rises, (column, cell), rise * (1.0 - beyond))
            np.add.at(rises, (column, cell + 1), rise * beyond)
            first += len(rays)
            advance(len(rays))
        return np.cumsum(rises, axis=1)[:, : cells.shape[-1]].reshape(cells.shape)
