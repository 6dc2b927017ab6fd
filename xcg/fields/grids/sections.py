"""The accessible fraction averaged along axes: the accessible share of these axes, smeared along the others.

Smearing and averaging commute: with L(r') the share of the averaged axes that is accessible at the place r' on the
seen axes, the average is ``chi(r) = int Psi(r - r') L(r') dr'``, where Psi is the kernel's marginal on the seen axes.
L comes from parallel rays, which stand on a lattice and cross the walls at exact places.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from xcg.fields.grids.walls import Wall
from xcg.fields.sums.kernels import Kernel

RAYS = 2**17
_RAYS_A_COLUMN = 256  # of the mesh of two seen axes
_POINTS = {1: 256, 2: 32}  # of the mesh in a cutoff, by the number of seen axes
_MOST_POINTS = 2**22  # of one mesh; more nodes are divided into slabs
_RAYS_AT_A_TIME = 2**15
_NODES_AT_A_TIME = 128
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


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


def averaged_fraction(
    nodes: NDArray,
    walls: Sequence[Wall],
    kernel: Kernel,
    seen: Sequence[int],
    averaged: Mapping[int, Span],
) -> NDArray:
    """Return the accessible fraction (n,) at nodes (n, 3), averaged along axes.

    Parameters
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

    Notes
    -----
    docs/walls.md lists the errors against closed forms and brute force.
    """
    share = math.prod((span.high - span.low) / span.extent for span in averaged.values())
    if not seen:
        return np.full(len(nodes), share * _open_share(walls, averaged))
    places = nodes[:, list(seen)]
    out = np.empty(len(nodes))
    for slab in _slabs(places, kernel.cutoff):
        mesh = _Mesh.around(places[slab], kernel.cutoff)
        open_share = _open_shares(mesh, walls, seen, averaged)
        out[slab] = share * _smeared(open_share, mesh, places[slab], kernel)
    return out


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
    place : array (n, k)
        Distances from the start (m), at most `reach`, in ascending order.
    change : array (n, k)
        1 where an accessible part begins, -1 where one ends, and 0 elsewhere.
    """
    places = [np.zeros((len(starts), 1))]
    steps = [np.zeros((len(starts), 1), int)]  # of the number of walls that the ray is behind
    behind = np.zeros((len(starts), 1), int)
    for wall in walls:
        is_open, crossings = wall.crossings_along(starts, axis, reach)
        crossings = np.minimum(np.sort(crossings, axis=1), reach)
        closes = is_open[:, None] ^ (np.arange(crossings.shape[1]) % 2 == 1)
        places.append(crossings)
        steps.append(np.where(closes, 1, -1))
        behind += ~is_open[:, None]
    place = np.concatenate(places, axis=1)
    order = np.argsort(place, axis=1, kind="stable")
    place = np.take_along_axis(place, order, axis=1)
    step = np.take_along_axis(np.concatenate(steps, axis=1), order, axis=1)
    is_open = behind + np.cumsum(step, axis=1) == 0
    change = np.diff(is_open.astype(int), axis=1, prepend=0)
    return place, change


def _lattice(ranges: Mapping[int, tuple[float, float]], count: int) -> Iterator[NDArray]:
    """Yield points (n, 3) that are spread evenly over ranges of one or two axes, and over each of these axes alone.

    Of two axes, the second takes multiples of the golden ratio, modulo one.
    """
    for first in range(0, count, _RAYS_AT_A_TIME):
        number = np.arange(first, min(count, first + _RAYS_AT_A_TIME)) + 0.5
        points = np.zeros((len(number), 3))
        shares = number / count, number * _GOLDEN % 1.0
        for (axis, (low, high)), share in zip(ranges.items(), shares, strict=False):
            points[:, axis] = low + (high - low) * share
        yield points


def _open_share(walls: Sequence[Wall], averaged: Mapping[int, Span]) -> float:
    """Return the share of the averaged axes that is accessible, where no axis is seen."""
    along, *across = averaged
    low, high = averaged[along].low, averaged[along].high
    ranges = {axis: (averaged[axis].low, averaged[axis].high) for axis in across}
    length = 0.0
    for rays in _lattice(ranges, RAYS):
        rays[:, along] = low
        place, change = open_ends(rays, walls, along, high - low)
        length += float((change * (high - low - place)).sum())
    return length / (RAYS * (high - low))


@dataclass(frozen=True, eq=False)
class _Mesh:
    """Mesh of the seen axes around some nodes.

    Attributes
    ----------
    origin : array (seen,)
        Its first point (m).
    shape : tuple of int
        Number of points along each axis.
    step : float
        Distance of neighbouring points (m).
    """

    origin: NDArray
    shape: tuple[int, ...]
    step: float

    @classmethod
    def around(cls, places: NDArray, cutoff: float) -> _Mesh:
        """Lay a mesh that ends a cutoff and two points beyond places (n, seen)."""
        step = cutoff / _POINTS[places.shape[1]]
        origin = places.min(axis=0) - cutoff - 2 * step
        count = np.ceil((places.max(axis=0) + cutoff - origin) / step) + 3
        return cls(origin, tuple(count.astype(int).tolist()), step)

    def range(self, k: int) -> tuple[float, float]:
        """Return the first and the last coordinate along one of its axes (m)."""
        low = float(self.origin[k])
        return low, low + self.step * (self.shape[k] - 1)


def _slabs(places: NDArray, cutoff: float) -> Iterator[NDArray]:
    """Divide nodes at places (n, seen) into slabs across the first axis, each with a mesh of limited size."""
    points = 1.0
    for k in range(1, places.shape[1]):
        points *= (np.ptp(places[:, k]) / cutoff + 3.0) * _POINTS[2]
    width = max(1.0, _MOST_POINTS / points / _POINTS[places.shape[1]]) * cutoff
    slab = (places[:, 0] - places[:, 0].min()) // width
    for number in np.unique(slab):
        yield np.flatnonzero(slab == number)


def _open_shares(
    mesh: _Mesh, walls: Sequence[Wall], seen: Sequence[int], averaged: Mapping[int, Span]
) -> NDArray:
    """Return the share of the averaged axes that is accessible at the points of a mesh.

    Rays are parallel to the last seen axis. Each end of an accessible part of a ray is shared by the points of the mesh
    beside it in proportion to their distances, so that the sum along the axis rises there from 0 to 1.
    """
    low, high = mesh.range(-1)
    ranges = {axis: (span.low, span.high) for axis, span in averaged.items()}
    columns, points = 1, mesh.shape[-1]
    if len(seen) == 2:
        ranges[seen[0]] = mesh.range(0)
        columns = mesh.shape[0]
    rises = np.zeros((columns + 1, points + 1))
    rays_of_column = np.zeros(columns + 1)
    for rays in _lattice(ranges, max(RAYS, _RAYS_A_COLUMN * columns)):
        rays[:, seen[-1]] = low
        place, change = open_ends(rays, walls, seen[-1], high - low)
        point, beyond = _divided(place / mesh.step)
        column, beside = np.zeros(len(rays), int), np.zeros(len(rays))
        if len(seen) == 2:
            column, beside = _divided((rays[:, seen[0]] - mesh.origin[0]) / mesh.step)
        for right in (0, 1):
            share = beside if right else 1.0 - beside
            np.add.at(rays_of_column, column + right, share)
            rise = share[:, None] * change
            np.add.at(rises, (column[:, None] + right, point), rise * (1.0 - beyond))
            np.add.at(rises, (column[:, None] + right, point + 1), rise * beyond)
    total = np.cumsum(rises[:columns, :points], axis=1)
    total[:, 1:] = 0.5 * (total[:, 1:] + total[:, :-1])  # the mean over the cell of a point
    open_shares = total / rays_of_column[:columns, None]
    return open_shares if len(seen) == 2 else open_shares[0]


def _divided(place: NDArray) -> tuple[NDArray, NDArray]:
    """Return the points of a mesh below places, and the distances from there, in units of its step."""
    point = np.floor(place).astype(int)
    return point, place - point


def _smeared(values: NDArray, mesh: _Mesh, places: NDArray, kernel: Kernel) -> NDArray:
    """Return the mean of values on a mesh about places (n, seen), weighted by the kernel's marginal."""
    seen = places.shape[1]
    within = math.ceil(kernel.cutoff / mesh.step)
    window = np.array(list(product(range(-within, within + 2), repeat=seen)))
    out = np.empty(len(places))
    for first in range(0, len(places), _NODES_AT_A_TIME):
        rows = slice(first, first + _NODES_AT_A_TIME)
        node = (places[rows] - mesh.origin) / mesh.step
        point = np.floor(node).astype(int)[:, None] + window
        distance = np.linalg.norm(point - node[:, None], axis=-1) * mesh.step
        weight = kernel.value(distance, seen=seen)
        near = values[tuple(np.moveaxis(point, -1, 0))]
        out[rows] = (weight * near).sum(axis=1) / weight.sum(axis=1)
    return out
