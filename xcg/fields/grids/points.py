"""Nodes at any points, sorted in space."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from xcg.compiled._jit import THREADS, for_each
from xcg.compiled.arrays import sort_by_key
from xcg.compiled.cells import PointCells
from xcg.compiled.reach import PAD, BlockNodes
from xcg.compiled.rings import Rings
from xcg.fields.grids.grid import MAX_NODES, check_places
from xcg.fields.sums.nodes import BLOCK_NODES, Nodes, Smoothing, triple
from xcg.scene.schema import COMPONENTS

# Cells hold about this many points, but are no wider and no narrower than these shares of the
# support's radius: measured, see docs/measurements.md.
_IN_A_CELL = 16
_WIDEST = 1.0
_NARROWEST = 0.35
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
    indices : array (nodes,)
        Indices of the nodes among all nodes of the result, unsigned.
    order : array (nodes,), optional
        Order of the nodes by their indices, unsigned; None where they are in order.
    cells : PointCells
        The points.
    lower, upper : array (3,)
        Bounds of the points.
    unit : float
        That radius (m).
    rings : Rings, optional
        Where the points are the angles of rings, and the nodes averages over these.
    """

    indices: NDArray
    order: NDArray | None
    cells: PointCells
    lower: NDArray
    upper: NDArray
    unit: float
    rings: Rings | None = None

    @classmethod
    def of(cls, rows: NDArray, position: NDArray, unit: float) -> PointBlock:
        """Sort some points (3, n), which have these indices (n,) among all, in ascending order."""
        lower = position.min(axis=1)
        upper = position.max(axis=1)
        many = len(rows)
        extent = upper - lower
        spread = extent[extent > _NARROWEST]
        width = (spread.prod() * _IN_A_CELL / many) ** (1 / max(1, len(spread)))
        size = np.clip(width, _NARROWEST, _WIDEST) * np.array([1.0, 1.0, _FLAT])
        while _cells_of(extent, size) > _MOST_CELLS + 4 * many:
            size[np.argmax(extent / size)] *= 2.0
        shape = (extent / size).astype(int) + 1
        start, order, (x, y, z), rows = _sorted(rows, position, lower, 1.0 / size, shape)
        cells = _cells((x, y, z), start, lower, upper, size, triple(shape))
        return cls(rows, order, cells, lower, upper, unit)

    @property
    def count(self) -> int:
        """Number of points."""
        return int(self.cells.start[-1])

    def nodes(self, smoothing: Smoothing) -> BlockNodes:
        """Return the points as loops take them, in cutoffs; the origin is theirs."""
        share = self.unit / smoothing.cutoff
        begin = self.lower * share
        end = self.upper * share
        cells = self.cells
        if share != 1.0:
            x, y, z = (place * share for place in cells.points)
            size = np.array(cells.size) * share
            cells = _cells((x, y, z), cells.start, begin, end, size, cells.shape)
        return BlockNodes(triple(begin), triple(end), *smoothing.surroundings, cells=cells)


def _cells(
    points: tuple[NDArray, NDArray, NDArray],
    start: NDArray,
    lower: NDArray,
    upper: NDArray,
    size: NDArray,
    shape: tuple[int, int, int],
) -> PointCells:
    """Return sorted points as loops take them, with bounds and size of their cells."""
    many = np.array(shape) > 1
    size = np.where(many, size, 0.0)
    per_size = np.where(many, 1.0 / np.where(many, size, 1.0), 0.0)
    margin = 1e-9 + 1e-15 * float(np.abs([lower, upper]).max())
    return PointCells(points, start, triple(lower), triple(size), triple(per_size), shape, margin)


def make_points(at: Mapping[str, Any], *, plane: str, cutoff: float) -> Nodes:
    """Sort points in space.

    Parameters
    ----------
    at : mapping
        Coordinates (m) along some axes: DataArrays, which broadcast against each other, and
        numbers.
    plane : str
        The axes that the scene has.
    cutoff : float
        Radius of the smallest support (m).

    Raises
    ------
    ValueError
        For unknown axes; arrays without names of dimensions, or with result dimensions; arrays
        whose labels or sizes differ; coordinates that are not finite.
    """
    check_places("", dict.fromkeys(at, 0.0), {}, plane)  # names only
    arrays = _aligned({a: _array(a, at[a]) for a in COMPONENTS if a in at})
    sizes: dict[str, int] = {}
    for array in arrays.values():
        sizes |= {str(dim): size for dim, size in array.sizes.items()}
    if math.prod(map(float, sizes.values())) > MAX_NODES:
        raise ValueError(f"at= names {sizes} points, more than {MAX_NODES}: take fewer at a time")
    position = np.zeros((3, math.prod(sizes.values())))
    for a, array in arrays.items():
        position[COMPONENTS.index(a)] = _column(a, array, sizes)
    lower, upper, origin = np.zeros((3, 3))
    if position.size:
        lower = position.min(axis=1)
        upper = position.max(axis=1)
        origin = np.array([np.partition(x, len(x) // 2)[len(x) // 2] for x in position])
    most = min(BLOCK_NODES, max(_FEW, position.shape[1] // (2 * THREADS) + 1))
    place = (position - origin[:, None]) / cutoff
    divided = _divide(np.arange(position.shape[1], dtype="uint64"), place, most)
    parts = tuple(for_each(list(divided), lambda part: PointBlock.of(*part, cutoff), THREADS))
    coords: dict[str, xr.Variable] = {}
    for array in arrays.values():
        coords |= {str(name): coord.variable for name, coord in array.coords.items()}
    coords |= {a: array.variable for a, array in arrays.items()}
    return Nodes(
        tuple(sizes),
        tuple(sizes.values()),
        coords,
        "".join(arrays),
        "".join(a for a in plane if a not in arrays),
        origin,
        lower,
        upper,
        parts=parts,
    )


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
    array = array.reset_index(stacked).drop_vars(
        [*COMPONENTS, *_OF_RESULTS, "step"], errors="ignore"
    )
    return array.copy(data=array.to_numpy().astype("float64"))


def _aligned(arrays: Mapping[str, xr.DataArray]) -> dict[str, xr.DataArray]:
    """Raise ValueError for arrays that do not belong together, or whose dimensions results have already."""
    for a, array in arrays.items():
        # a dimension may be named by the one axis that runs along it, as the nodes of a mesh are
        own = {d for d in array.dims if d in arrays and arrays[str(d)].dims == (d,)}
        taken = [d for d in array.dims if d in {*COMPONENTS, *_OF_RESULTS} - own]
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


def _column(axis: str, array: xr.DataArray, sizes: Mapping[str, int]) -> NDArray:
    """Return the coordinates of all points along an axis (n,). Raise ValueError unless they are finite."""
    column = array.variable.set_dims(sizes).to_numpy().ravel()
    is_lost = ~(np.abs(column) < _FARTHEST)
    if is_lost.any():
        lost = int(is_lost.argmax())
        of_dims = map(int, np.unravel_index(lost, tuple(sizes.values())))
        where = dict(zip(sizes, of_dims, strict=True))
        raise ValueError(
            f"at[{axis!r}] is {column[lost]} at {where}: expected finite coordinates; leave these points out"
        )
    return column


def _cells_of(extent: NDArray, size: NDArray | float) -> float:
    """Return the number of cells of a size that cover an extent (3,)."""
    return float((np.floor(extent / size) + 1.0).prod())


def _sorted(
    rows: NDArray, position: NDArray, lower: NDArray, per_size: NDArray, shape: NDArray
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Sort points (3, n) by cell; points of one cell keep their order.

    Returns the first point of each cell (cells + 1,), the place of each point among the sorted ones
    (n,), these (3, n + PAD), with zeros beyond the last, and their rows. Whole numbers are
    unsigned.
    """
    many = len(rows)
    index = ((position - lower[:, None]) * per_size[:, None]).astype("int64")
    index = np.minimum(index, shape[:, None] - 1)
    cell = np.ravel_multi_index(tuple(index), tuple(shape))
    start = np.zeros(math.prod(shape.tolist()) + 2, "int64")
    order = np.empty(many, "int64")
    sort_by_key(cell, start[1:], order)  # leaves where each cell ends, and the next begins
    place = np.zeros((3, many + PAD))
    place[:, :many] = position[:, order]
    rank = np.empty(many, "uint64")
    rank[order] = np.arange(many, dtype="uint64")
    return start[:-1].view("uint64"), rank, place, rows[order]


def _divide(rows: NDArray, position: NDArray, most: int) -> Iterator[tuple[NDArray, NDArray]]:
    """Divide points (3, n) into parts of at most about `most` that are neighbours in space, as (rows, points).

    Parts whose points are far apart are divided further, so that cells narrower than the support
    separate them.
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
    wanted = max(2, math.ceil(many / most))
    parts = np.ones(3, int)
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
