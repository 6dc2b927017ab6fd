"""Nodes of a mesh of a volume, plane or line, with the other axes averaged exactly; and any points, sorted in space."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import FINITE, check, is_finite, rising_pair
from xcg.common.messages import warn_once
from xcg.compiled._jit import THREADS, for_each
from xcg.compiled.arrays import sort_by_key
from xcg.compiled.cells import PointCells, lists_for_points
from xcg.compiled.reach import PAD, Lists, Nodes
from xcg.fields.sums.nodes import BLOCK_NODES, Grid, triple
from xcg.scene.schema import COMPONENTS

# first and last place along axes (m)
Bounds: TypeAlias = Mapping[str, Sequence[float]]
MAX_NODES = 2**31
_MOST_OF_ONE_AXIS = 1 << 24  # 134 MB of places
_FINEST = 1e-9  # least spacing, in radii of the support


def check_axes(known: Sequence[str], **places: Iterable[str]) -> None:
    """Raise ValueError for axes that a scene does not have, or that an argument names twice."""
    for name, axes in places.items():
        wrong = [a for a in axes if a not in known]
        if wrong:
            of_scene = ", ".join(known)
            if len(known) == 2:
                of_scene += " (one layer, dimension=2)"
            if "r" in wrong:
                of_scene += "; axes r, theta and z need frame=xcg.Cylindrical(...)"
            raise ValueError(f"{name} names {wrong}: the axes of this scene are {of_scene}")
        if len(set(axes)) < len(list(axes)):
            raise ValueError(f"{name}={axes!r} names an axis twice")


def check_places(
    axes: Sequence[str],
    at: Mapping[str, float],
    bounds: Bounds,
    known: Sequence[str],
) -> None:
    """Raise ValueError for unknown axes, axes both resolved and fixed, and bounds of axes that are not resolved."""
    check_axes(known, axes=axes, at=at, bounds=bounds)
    if both := [a for a in axes if a in at]:
        raise ValueError(
            f"axes= and at={dict(at)!r} both name {both}: an axis is either resolved or fixed"
        )
    for a, value in at.items():
        check(f"at[{a!r}]", value, FINITE, "m", hint="; use axes= with bounds= for several")
    if loose := [a for a in bounds if a not in axes]:
        raise ValueError(
            f"bounds are given for {loose}, but only {list(axes)} are resolved: the fields are averaged (or fixed) "
            "along the others. Add the axis to axes=, or leave its bounds out; extent= sets the length of an average"
        )


def labels_of(
    nodes: Mapping[str, NDArray], fixed: Mapping[str, float], note: str = ""
) -> tuple[dict[str, xr.Variable], dict[str, str]]:
    """Coordinates of results, and where the nodes are in words, with a note about them."""
    coords = {a: xr.Variable(a, x) for a, x in nodes.items()}
    coords |= {a: xr.Variable((), x) for a, x in fixed.items()}
    count = " x ".join(f"{len(x)} {a}" for a, x in nodes.items()) or "one"
    text = {
        "nodes": f"{count}{note}",
        "fixed": ", ".join(f"{a} = {x:g}" for a, x in fixed.items()) or "none",
    }
    return coords, text


class MeshTooLargeError(ValueError):
    """A mesh has more nodes than loops count, or than there is memory for."""


def nodes_along(
    a: str,
    step: Any,
    axes: Iterable[str],
    bounds: Bounds,
    automatic: Bounds,
    period: Mapping[str, float],
    cutoff: float,
    cells: bool = False,
) -> tuple[NDArray, float]:
    """Nodes along one of the resolved axes, and their distance; arguments as in `make_grid`."""
    if not (is_finite(step) and step > _FINEST * cutoff):
        raise ValueError(
            f"spacing along {a!r} is {step!r}: expected a positive distance (m) for each of {list(axes)}, not far "
            f"below the radius of the support ({cutoff:g} m)"
        )
    if a in bounds:
        first, last = rising_pair(f"bounds[{a!r}]", bounds[a], equal=True)
        count = np.floor((last - first) / step * (1 + 1e-12) + 1e-9) + 1
    elif a not in automatic:
        raise ValueError(
            f"axis {a!r} has no bounds: the scene holds neither a box nor the particles' extent, or no longer, as "
            f"positions were changed. Give bounds={{{a!r}: (first, last)}}, or call ds = ds.cg.measure() first "
            "(of bodies: ds = ds.cg.group_bodies(...).cg.measure() in place of by_body=)"
        )
    elif a in period:
        first = automatic[a][0]
        count = max(1, np.floor(period[a] / step + 0.5))
        step = period[a] / count
        if cells:
            first += 0.5 * step
    else:
        first, last = automatic[a]
        count = np.ceil((last - first) / step) + 1
        if cells:
            count = max(1, count - 1)
        first = 0.5 * (first + last) - 0.5 * (count - 1) * step
    if not count < _MOST_OF_ONE_AXIS:
        raise MeshTooLargeError(
            f"the mesh would have {count:.3g} nodes along {a!r}, more than {_MOST_OF_ONE_AXIS}: choose a larger "
            "spacing or smaller bounds"
        )
    if count > 1 and step > 2 * cutoff and not cells:
        warn_once(
            f"spacing along {a}",
            f"spacing {step:g} along {a!r} is larger than the support of the kernel (2 c = {2 * cutoff:g}): "
            "particles between nodes are not seen; choose a smaller spacing or a larger width",
        )
    return first + step * np.arange(int(count)), float(step)


def make_grid(
    axes: str,
    at: Mapping[str, float],
    bounds: Bounds,
    spacing: float | Mapping[str, float],
    *,
    plane: str,
    cutoff: float,
    automatic: Bounds,
    period: Mapping[str, float],
    cells: bool = False,
) -> Grid:
    """Place nodes.

    Nodes stand at first, first + spacing, ... up to last. A periodic axis without bounds gets nodes
    that divide its period evenly, so its spacing is the nearest that fits. Cells without bounds lie
    side by side: from edge to edge of a period, and around the particles.

    Parameters
    ----------
    axes, at, bounds, spacing
        As in `xcg.coarse_grain`.
    plane : str
        The axes that the scene has.
    cutoff : float
        Radius of the support (m), for the warning about nodes that are too far apart.
    automatic : mapping
        First and last node of axes without bounds (m); for a periodic axis, the edges of the box.
    period : mapping
        Length of the periodic axes (m).
    cells : bool
        Whether the nodes are centres of cells, as `xcg.cell_volumes` takes them.

    Raises
    ------
    ValueError
        For unknown axes, bounds on an axis that is not resolved, or a spacing that is not positive.
    """
    if not isinstance(axes, Iterable):
        raise ValueError(f"axes={axes!r}: expected any of {plane!r}, such as {plane[-1]!r}")
    check_places(axes, at, bounds, plane)
    axes = "".join(sorted(axes))
    steps: Mapping[str, Any] = dict.fromkeys(axes, spacing)
    if isinstance(spacing, Mapping):
        steps = spacing
    nodes: dict[str, NDArray] = {}
    distances: dict[str, float] = {}
    for a in axes:
        nodes[a], distances[a] = nodes_along(
            a, steps.get(a), axes, bounds, automatic, period, cutoff, cells
        )
    shape = {a: len(x) for a, x in nodes.items()}
    if math.prod(map(float, shape.values())) > MAX_NODES:
        raise MeshTooLargeError(
            f"the mesh would have {tuple(shape.get(a, 1) for a in COMPONENTS)} nodes, more than {MAX_NODES}: choose a "
            "larger spacing or smaller bounds"
        )
    fixed = {a: float(v) for a, v in at.items()}
    coords, text = labels_of(nodes, fixed)
    firsts = fixed | {a: float(x[0]) for a, x in nodes.items()}
    origin = np.array([firsts.get(a, 0.0) for a in COMPONENTS])
    steps_along = np.array([distances.get(a, 0.0) for a in COMPONENTS])
    last = origin + (np.array([shape.get(a, 1) for a in COMPONENTS]) - 1) * steps_along
    half = 0.5 * steps_along * cells
    return Grid(
        dims=tuple(axes),
        sizes=tuple(shape.values()),
        coords=coords,
        seen="".join(a for a in COMPONENTS if a in nodes or a in fixed),
        averaged="".join(a for a in plane if a not in nodes and a not in fixed),
        origin=origin,
        lower=origin - half,
        upper=last + half,
        text=text,
        cuts={a: (place, place) for a, place in fixed.items()},
        spacing=distances,
        fitted="".join(a for a in axes if a not in bounds and a not in period),
    )


def check_mesh(
    position: NDArray, grid: Grid, cutoff: float, open_axes: NDArray, source: str
) -> None:
    """Warn where no grain reaches any node, and where grains lie beyond a mesh that was laid around them.

    Parameters
    ----------
    position : array (n, 3)
        Centres (m).
    grid : Grid
        The nodes.
    cutoff : float
        Radius of the largest support (m).
    open_axes : array (3,)
        Axes along which nothing repeats.
    source : str
        Names the step.
    """
    axes = [k for k, a in enumerate(COMPONENTS) if a in grid.seen and open_axes[k]]
    if not len(position) or not axes or not grid.count:
        return
    first = grid.lower
    last = grid.upper
    x = position
    reaches = [(x[:, k] > first[k] - cutoff) & (x[:, k] < last[k] + cutoff) for k in axes]
    if not np.all(reaches, axis=0).any():
        grains = ", ".join(
            f"{COMPONENTS[k]} from {x[:, k].min():.6g} to {x[:, k].max():.6g}" for k in axes
        )
        nodes = ", ".join(f"{COMPONENTS[k]} from {first[k]:.6g} to {last[k]:.6g}" for k in axes)
        warn_once(
            "reach",
            f"{source}: no grain reaches any node, so that sums are zero: grains lie at {grains}, nodes at {nodes}, "
            f"and the kernel reaches {cutoff:.4g}; check bounds=, at= and the units of lengths",
        )
        return
    for k in [k for k in axes if COMPONENTS[k] in grid.fitted]:
        warn_beyond(COMPONENTS[k], position[:, k], first[k], last[k], source, room=0.5 * cutoff)


def warn_beyond(
    a: str,
    x: NDArray,
    first: float,
    last: float,
    source: str,
    room: float | NDArray = 0.0,
    what: str = "grains",
) -> None:
    """Warn where coordinates x (n,), and some room, reach beyond a mesh that was laid around two steps."""
    hair = 1e-9 * (last - first)
    if ((x - room < first - hair) | (x + room > last + hair)).any():
        warn_once(
            f"beyond {a}",
            f"{source}: {what} lie at {a} from {x.min():.6g} to {x.max():.6g}, and some are not or only partly on the "
            f"mesh, which was laid around the grains of the first and the last step, from {first:.6g} to {last:.6g}; "
            f"give bounds= along {a!r}, or call ds = ds.cg.measure(), which looks at all steps",
        )


# --- points ----------------------------------------------------------------------------------------------

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
        start, rank, place, rows = _sorted(rows, position, lower, 1.0 / size, shape)
        return cls(rows, rank, place, lower, upper, size, triple(shape), start, unit)

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.places)

    def nodes(self, origin: NDArray, unit: float, active: NDArray, period: NDArray) -> Nodes:
        """Return the points as loops take them; the origin is theirs."""
        share = self.unit / unit
        place = self.position * share
        begin = self.lower * share
        end = self.upper * share
        many = np.array(self.shape) > 1
        size = np.where(many, self.size * share, 0.0)
        per_size = np.where(many, 1.0 / (self.size * share), 0.0)
        margin = 1e-9 + 1e-15 * float(np.abs([begin, end]).max())
        x, y, z = place
        cells = PointCells(
            (x, y, z),
            self.start,
            triple(begin),
            triple(size),
            triple(per_size),
            self.shape,
            margin,
        )
        return Nodes(triple(begin), triple(end), triple(active), triple(period), cells=cells)

    def lists(self, nodes: Nodes, reach: Sequence[float], real: str = "float64") -> Lists:
        """Return scratch to list the points that something of this length reaches."""
        return lists_for_points(nodes.cells, reach, real)


def make_points(at: Mapping[str, Any], *, plane: str, cutoff: float) -> Grid:
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
    cuts = {a: (float(lower[k]), float(upper[k])) for k, a in enumerate(COMPONENTS) if a in arrays}
    spans = ", ".join(f"{a} from {low:.6g} to {high:.6g}" for a, (low, high) in cuts.items())
    text = " x ".join(f"{size} {dim}" for dim, size in sizes.items())
    coords: dict[str, xr.Variable] = {}
    for array in arrays.values():
        coords |= {str(name): coord.variable for name, coord in array.coords.items()}
    coords |= {a: array.variable for a, array in arrays.items()}
    return Grid(
        tuple(sizes),
        tuple(sizes.values()),
        coords,
        "".join(arrays),
        "".join(a for a in plane if a not in arrays),
        origin,
        lower,
        upper,
        {"nodes": f"{text}, points with {spans}", "fixed": "none"},
        cuts,
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
        indices = map(int, np.unravel_index(lost, tuple(sizes.values())))
        where = dict(zip(sizes, indices, strict=True))
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
