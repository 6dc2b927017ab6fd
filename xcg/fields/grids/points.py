"""Fields at any points: given one by one, sorted in space when the plan is made."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from xcg.compiled._jit import THREADS, for_each
from xcg.compiled.cells import PointCells, lists_for_points, sort_by_cell
from xcg.compiled.reach import PAD, Lists, Nodes
from xcg.fields.grids.grid import MAX_NODES, check_axes
from xcg.fields.sums.nodes import BLOCK_NODES, Grid, triple
from xcg.scene.schema import COMPONENTS

# Cells hold about this many points, but are no wider and no narrower than these shares of the support's radius:
# measured, see docs/measurements.md.
_IN_A_CELL = 16
_WIDEST, _NARROWEST = 1.0, 0.35
# They are flat, as the run of points within reach begins and ends with a cell.
_FLAT = 0.2
# Cells of a block, besides four for each point: where points are far apart, cells are wider.
_MOST_CELLS = 1 << 16
# Points that are divided no further where they are far apart: each grain may look at all of them.
_FEW = 4096
# Coordinates (m) whose squares are numbers.
_FARTHEST = 1e75
# coordinates of results besides those of the points
_OF_RESULTS = ("time", "interval", "phase", "other_phase", "component", "direction", "width")


@dataclass(frozen=True, eq=False)
class PointBlock:
    """Points that are neighbours in space, sorted by cell. Lengths are in radii of the support, from an origin on.

    Attributes
    ----------
    places : array (n,)
        Where they are among all points, unsigned.
    order : array (n,)
        Their order by these places, unsigned.
    position : array (3, n + PAD)
        The points, 0 along axes that are not seen, and beyond the last.
    lower, upper, size : array (3,)
        Bounds of the points, where the cells begin, and size of the cells.
    shape : tuple of int
        Number of cells along each axis.
    start : array (cells + 1,)
        First point of each cell, unsigned.
    unit : float
        That radius (m).
    """

    places: NDArray
    order: NDArray
    position: NDArray
    lower: NDArray
    upper: NDArray
    size: NDArray
    shape: tuple[int, int, int]
    start: NDArray
    unit: float
    inner = None

    @classmethod
    def of(cls, rows: NDArray, position: NDArray, unit: float) -> PointBlock:
        """Sort some points (3, n), which have these places (n,) among all, in ascending order."""
        lower, upper, many = position.min(axis=1), position.max(axis=1), len(rows)
        extent = upper - lower
        spread = extent[extent > _NARROWEST]
        width = (spread.prod() * _IN_A_CELL / many) ** (1 / max(1, len(spread)))
        size = np.clip(width, _NARROWEST, _WIDEST) * np.array([1.0, 1.0, _FLAT])
        while _cells_of(extent, size) > _MOST_CELLS + 4 * many:
            size[np.argmax(extent / size)] *= 2.0
        shape = (extent / size).astype(int) + 1
        start, rank, place, rows = _sorted(rows, position, lower, 1.0 / size, shape)
        return cls(rows, rank, place, lower, upper, size, triple(shape), start, unit)

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.places)

    def nodes(self, origin: NDArray, unit: float, active: NDArray, period: NDArray) -> Nodes:
        """Return the points as loops take them; the origin is theirs."""
        share = self.unit / unit
        place = self.position if share == 1.0 else self.position * share
        begin, end = self.lower * share, self.upper * share
        many = np.array(self.shape) > 1
        size, per_size = np.where(many, self.size * share, 0.0), np.where(many, 1.0 / (self.size * share), 0.0)
        margin = 1e-9 + 1e-15 * float(np.abs([begin, end]).max())
        x, y, z = place
        cells = PointCells(x, y, z, self.start, triple(begin), triple(size), triple(per_size), self.shape, margin)
        return Nodes(triple(begin), triple(end), triple(active), triple(period), cells=cells)

    def lists(self, nodes: Nodes, reach: Sequence[float], real: str = "float64") -> Lists:
        """Return scratch to list the points that something of this length reaches."""
        return lists_for_points(nodes.cells, reach, real)


def make_points(at: Mapping[str, Any], *, plane: str, cutoff: float) -> Grid:
    """Sort points in space.

    Parameters
    ----------
    at : mapping
        Coordinates (m) along some axes: DataArrays, which broadcast against each other, and numbers.
    plane : str
        The axes that the scene has.
    cutoff : float
        Radius of the smallest support (m).

    Raises
    ------
    ValueError
        For unknown axes; arrays without names of dimensions, or with result dimensions; arrays whose labels or sizes
        differ; coordinates that are not finite.
    """
    check_axes("at", at, plane)
    arrays = _aligned({a: _array(a, at[a]) for a in COMPONENTS if a in at})
    sizes = {str(dim): size for array in arrays.values() for dim, size in array.sizes.items()}
    shape = tuple(sizes.values())
    if math.prod(map(float, shape)) > MAX_NODES:
        raise ValueError(f"at= names {sizes} points, more than {MAX_NODES}: take fewer at a time")
    position = np.zeros((3, math.prod(shape)))
    for a, array in arrays.items():
        column = array.variable.set_dims(sizes).transpose(*sizes).to_numpy().ravel()
        if column.size and not -_FARTHEST < column.min() <= column.max() < _FARTHEST:
            lost = np.flatnonzero(~(np.abs(column) < _FARTHEST))
            where = dict(zip(sizes, (int(k) for k in np.unravel_index(lost[0], shape)), strict=True))
            raise ValueError(
                f"at[{a!r}] is {column[lost[0]]} at {where}: expected finite coordinates; leave these points out"
            )
        position[COMPONENTS.index(a)] = column
    lower, upper, origin = np.zeros((3, 3))
    if position.size:
        lower, upper = position.min(axis=1), position.max(axis=1)
        origin = np.array([np.partition(x, len(x) // 2)[len(x) // 2] for x in position])
    most = min(BLOCK_NODES, max(_FEW, position.shape[1] // (2 * THREADS) + 1))
    place = (position - origin[:, None]) / cutoff
    divided = _divide(np.arange(position.shape[1], dtype="uint64"), place, most)
    parts = tuple(for_each(list(divided), lambda part: PointBlock.of(*part, cutoff), THREADS))
    cuts = {a: (float(lower[k]), float(upper[k])) for k, a in enumerate(COMPONENTS) if a in arrays}
    spans = ", ".join(f"{a} from {low:.6g} to {high:.6g}" for a, (low, high) in cuts.items())
    text = " x ".join(f"{size} {dim}" for dim, size in sizes.items())
    return Grid(
        tuple(sizes), shape, _coords(arrays), "".join(arrays), "".join(a for a in plane if a not in arrays), origin,
        lower, upper, {"nodes": f"{text}, points with {spans}", "fixed": "none"}, cuts, parts=parts,
    )  # fmt: skip


def _array(axis: str, value: Any) -> xr.DataArray:
    """Return coordinates along an axis as numbers in memory."""
    if not isinstance(value, xr.DataArray) and np.ndim(value):
        raise ValueError(
            f"at[{axis!r}] is a {type(value).__name__} of shape {np.shape(value)}: points are DataArrays, whose named "
            f"dimensions say which coordinates belong together, such as xr.DataArray(values, dims='point')"
        )
    array = xr.DataArray(value)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"at[{axis!r}] holds {array.dtype}: expected coordinates (m)")
    stacked = [dim for dim in array.dims if isinstance(array.indexes.get(dim), pd.MultiIndex)]
    array = array.reset_index(stacked).drop_vars([*COMPONENTS, *_OF_RESULTS, "step"], errors="ignore")
    return array.copy(data=array.to_numpy().astype("float64"))


def _aligned(arrays: Mapping[str, xr.DataArray]) -> dict[str, xr.DataArray]:
    """Raise ValueError for arrays that do not belong together, or whose dimensions results have already."""
    for a, array in arrays.items():
        # a dimension may be named by the one axis that runs along it, as the nodes of a mesh are
        taken = [d for d in array.dims if d in COMPONENTS and (d not in arrays or arrays[str(d)].dims != (d,))]
        taken += [d for d in array.dims if d in _OF_RESULTS]
        if taken:
            raise ValueError(
                f"at[{a!r}] has the dimensions {array.dims}: {taken} are other dimensions of results; rename them"
            )
    try:
        return dict(zip(arrays, xr.align(*arrays.values(), join="exact", copy=False), strict=True))
    except ValueError as error:
        sizes = {a: dict(array.sizes) for a, array in arrays.items()}
        raise ValueError(
            f"the coordinates in at= have other sizes or labels along dimensions that they share, {sizes}: {error}"
        ) from error


def _coords(arrays: Mapping[str, xr.DataArray]) -> dict[str, xr.Variable]:
    """Coordinates of the points, and the other coordinates of their arrays."""
    found = {str(name): c.variable for array in arrays.values() for name, c in array.coords.items()}
    return found | {a: array.variable for a, array in arrays.items()}


def _cells_of(extent: NDArray, size: NDArray | float) -> float:
    """Return the number of cells of a size that cover an extent (3,)."""
    return float((np.floor(extent / size) + 1.0).prod())


def _sorted(
    rows: NDArray, position: NDArray, lower: NDArray, per_size: NDArray, shape: NDArray
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Sort points (3, n) by cell; points of one cell keep their order.

    Returns the first point of each cell (cells + 1,), the place of each point among the sorted ones (n,), these
    (3, n + PAD), with zeros beyond the last, and their rows. Whole numbers are unsigned.
    """
    many, count = len(rows), math.prod(shape.tolist())
    start, cell, rank = np.zeros(count + 2, "int64"), np.empty(many, "int64"), np.empty(many, "int64")
    place, sorted_rows = np.empty((3, many + PAD)), np.empty_like(rows)
    place[:, many:] = 0.0
    cells = triple(lower), triple(per_size), triple(shape)
    sort_by_cell(*position, rows, *cells, start, cell, rank, place, sorted_rows)
    return start[:-1].view("uint64"), rank.view("uint64"), place, sorted_rows


def _divide(rows: NDArray, position: NDArray, most: int) -> Iterator[tuple[NDArray, NDArray]]:
    """Divide points (3, n) into parts of at most about `most` that are neighbours in space, as (rows, points).

    Parts whose points are far apart are divided further, so that cells narrower than the support separate them.
    """
    many = len(rows)
    if not many:
        return
    lower = position.min(axis=1)
    extent = position.max(axis=1) - lower
    sparse = many > _FEW and _cells_of(extent, _WIDEST) > _MOST_CELLS + 4 * many
    if many <= most and not sparse:
        yield rows, position
        return
    wanted, parts = max(2, math.ceil(many / most)), np.ones(3, int)
    if not (extent > 1e-9).any():  # all in one place
        for k in np.array_split(np.arange(many), wanted):
            yield rows[k], position[:, k]
        return
    while parts.prod() < wanted:
        parts[np.argmax(extent / parts)] += 1
    per_size = parts / np.where(extent > 0.0, extent, np.inf)
    start, _, position, rows = _sorted(rows, position, lower, per_size, parts)
    for first, last in pairwise(start.tolist()):
        yield from _divide(rows[first:last], position[:, first:last], most)
