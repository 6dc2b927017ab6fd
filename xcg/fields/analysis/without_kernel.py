"""Without a kernel: the solid volume in the cells of a mesh, and the granular temperature in slices.

Each grain's own volume is shared exactly among the cells that it overlaps. Slices are overlapping
planes or bins; both are coarser than `xcg.coarse_grain` and are here for comparison with what was
published with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_positive, is_whole, rising_pair
from xcg.common.messages import SceneError
from xcg.compiled.geometry import add_shares
from xcg.fields.grids.grid import make_grid, warn_beyond
from xcg.fields.layout import automatic_bounds
from xcg.fields.sums.nodes import Grid
from xcg.scene.conform import require_scene, storable, takes_scene
from xcg.scene.description import describe
from xcg.scene.frame import phase_of, steps_in, without_frozen
from xcg.scene.schema import COMPONENTS, OF_STEP, Setup, Variable, units_in
from xcg.steps.faults import OnError
from xcg.steps.labels import format_call, label, results_of, with_phase_labels
from xcg.steps.mapping import map_over_time

_SPHERE = 1e-6  # how far volumes may be from those of spheres of their diameters
_COLUMNS = 6  # number, volume, mass and momentum of each grain
_HAIR = 1e-9  # rounding of edges, as a share of the width
_MOST_PERIODS = 1000  # that a grain may reach over
_MOST = 1 << 20  # planes of all slices, each a step of a loop
_FIELDS = {
    "volume_fraction": Variable((), "1", "solid volume in the cell over its volume"),
    "void_fraction": Variable((), "1", "share of the cell between the grains"),
    "number_density": Variable((), "m^-3", "number of grains in a unit of volume, by their shares"),
    "density": Variable((), "kg m^-3", "mass of the grains in a unit of volume, by their shares"),
    "momentum_density": Variable(
        ("component",),
        "kg m^-2 s^-1",
        "momentum of the grains in a unit of volume, by their shares",
    ),
    "velocity": Variable(
        ("component",), "m s^-1", "velocity of the grains, weighted by the mass inside"
    ),
}
SliceMethod: TypeAlias = Literal["planes", "bins"]


def _along(axis: str, nodes: NDArray, system: str) -> tuple[str, NDArray, dict[str, str]]:
    """Coordinate of the cells or slices along an axis."""
    about = {
        "units": units_in("m", system),
        "long_name": f"position along {axis}",
        "axis": axis.upper(),
    }
    return axis, nodes, about


@dataclass(frozen=True, eq=False)
class _Cells:
    """Options of the shares of cells."""

    grid: Grid
    setup: Setup
    depth: float | str | None
    by: str | None
    groups: tuple[int, ...]


@takes_scene
def cell_volumes(
    ds: xr.Dataset,
    spacing: float | Mapping[str, float],
    *,
    axes: str | None = None,
    bounds: Mapping[str, Sequence[float]] | None = None,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Share the volume of each grain among the cells of a mesh that it overlaps, exactly; lazy where the scene is.

    No kernel is chosen: a sphere counts in a cell by the part of it that lies inside, in closed
    form, so that the solid volume of all cells is that of the grains to rounding. This is what
    fluid solvers of coupled runs (CFD-DEM) ask for. Fields jump where grains leave cells; smooth
    fields and stress take a kernel, see `coarse_grain`.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``diameter`` and ``volume``. Discs (a scene of one layer whose volumes differ
        from spheres) are shared by their areas; other shapes as spheres of their diameter.
    spacing : float or mapping
        Size of the cells (m), for all axes or by axis. Periodic axes without bounds take the
        nearest that divides them.
    axes : str, optional
        Axes that are divided into cells, all of the scene by default; cells reach through the box
        along the others.
    bounds : mapping, optional
        First and last centre of the cells by axis (m), as in `coarse_grain`; by default cells cover
        all grains.
    by, groups, on_error
        As in `coarse_grain`.

    Returns
    -------
    xarray.Dataset
        On the centres of the cells, (time, axes, phase): ``volume_fraction``, ``void_fraction``,
        ``number_density`` (m-3, parts of grains counted by their share), ``density``, and, where
        the scene has velocities, ``momentum_density`` and ``velocity``, the mean weighted by the
        mass inside.

    Raises
    ------
    SceneError
        If the scene lacks sizes, or its box is tilted.
    ValueError
        If an argument is wrong.

    Examples
    --------
    >>> import xcg
    >>> f = cell_volumes(xcg.datasets.simple_cubic(4), 2.0)
    >>> round(float(f.volume_fraction.mean()), 6)
    0.523599
    """
    require_scene(ds, ("diameter", "volume", "mass"), "cell_volumes")
    scene = describe(ds, by)
    setup = scene.setup
    if scene.tilted:
        raise SceneError(
            "cell_volumes takes boxes with edges along x, y and z, and this one is tilted"
        )
    if scene.cylindrical:
        raise SceneError("cell_volumes takes cells along x, y and z, not about an axis")
    axes = setup.plane if axes is None else axes
    largest = 0.5 * scene.sizes.get("dmax", 0.0)
    grid = make_grid(
        axes,
        {},
        bounds or {},
        spacing,
        plane=setup.plane,
        cutoff=largest or math.inf,
        automatic=automatic_bounds(scene, largest),
        period=scene.periods,
        cells=True,
    )
    if loose := [a for a in grid.averaged if a not in scene.edges]:
        raise ValueError(
            f"cells reach through the box along {loose}, and the scene has no finite box there: name them in axes="
        )
    values = scene.groups(by, groups)
    task = _Cells(grid, setup, scene.layer_depth, by, values)
    dims = (*grid.dims, *(("phase",) if by is not None else ()))
    rows = {
        name: replace(row, dims=(*dims, *row.dims))
        for name, row in _FIELDS.items()
        if "velocity" in ds or not row.dims
    }
    results = results_of(
        rows, dict(zip(grid.dims, grid.sizes, strict=True)) | {"phase": 1 + len(values)}
    )
    names = ["particle_id", "position", "diameter", "volume", "mass", *([by] if by else [])]
    names += [name for name in ("velocity", "frozen", *OF_STEP) if name in ds]
    found = map_over_time(ds, names, partial(_of_chunk, task), results, "cell-volumes", on_error)
    call = format_call("cell_volumes", {"spacing": spacing, "axes": axes, "by": by})
    result = label(ds, rows, found, call, sampling="cell")
    coords: dict[str, Any] = {
        a: _along(a, nodes.to_numpy(), setup.unit_system) for a, nodes in grid.coords.items()
    }
    if by is not None:
        coords["phase"] = ("phase", ["bulk", *map(str, values)], {"long_name": f"phase by {by}"})
    return with_phase_labels(storable(result.assign_coords(coords)))


def _of_chunk(task: _Cells, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Fields of one chunk of time."""
    grid, groups = task.grid, max(1, len(task.groups))
    steps = [_shares(task, groups, *step) for step in steps_in(arrays, task.setup.periodic)]
    sums = np.stack(steps)  # (time, groups, cells..., columns)
    if task.by is not None:
        sums = np.concatenate([sums.sum(axis=1, keepdims=True), sums], axis=1)
    sums = np.moveaxis(sums, 1, -2).reshape(
        len(sums), *grid.sizes, *(sums.shape[1:2] if task.by else ()), _COLUMNS
    )
    found = {
        "volume_fraction": sums[..., 1],
        "void_fraction": 1.0 - sums[..., 1],
        "number_density": sums[..., 0],
        "density": sums[..., 2],
    }
    if "velocity" in arrays:
        with np.errstate(invalid="ignore", divide="ignore"):
            found |= {"momentum_density": sums[..., 3:], "velocity": sums[..., 3:] / sums[..., 2:3]}
    return found


def _shares(task: _Cells, groups: int, frame: Any, lattice: Any, source: str) -> NDArray:
    """Return sums of one step per volume of a cell, (groups, nx, ny, nz, columns)."""
    grid, setup = task.grid, task.setup
    some = without_frozen(frame)
    for a in grid.fitted:
        k = COMPONENTS.index(a)
        warn_beyond(
            a,
            some["position"][:, k],
            grid.lower[k],
            grid.upper[k],
            source,
            room=some["diameter"] / 2,
        )
    phase = phase_of(some, task.by, task.groups, source)
    count, diameter, volume = len(some["position"]), some["diameter"], some["volume"]
    momentum = some["mass"][:, None] * some.get("velocity", np.zeros((count, 3)))
    values = np.column_stack([np.ones(count), volume, some["mass"], momentum])
    spheres = setup.dimension == 3 or np.allclose(
        volume, np.pi / 6 * diameter**3, rtol=_SPHERE, atol=0.0
    )
    across = next((k for k, a in enumerate(COMPONENTS) if a not in setup.plane), -1)
    step = np.array([grid.spacing.get(a, np.inf) for a in COMPONENTS])
    reach = [1.0 if np.isinf(size) else diameter.max(initial=0.0) // size + 3.0 for size in step]
    out = np.zeros((groups, *grid.shape, _COLUMNS))
    add_shares(
        np.ascontiguousarray(some["position"]),
        diameter / 2,
        values,
        phase,
        grid.lower,
        step,
        np.array(grid.shape),
        lattice.period,
        -1 if spheres else across,
        np.empty(int(math.prod(n + 1 for n in reach))),
        out,
    )
    lengths = [lattice.length(a) for a in grid.averaged]
    if task.depth is not None:  # of one layer
        lengths.append(lattice.length(task.depth) if isinstance(task.depth, str) else task.depth)
    return np.asarray(out / math.prod([*lengths, *grid.spacing.values()]))


# --- slices ----------------------------------------------------------------------------------------------


@takes_scene
def slice_temperature(
    ds: xr.Dataset,
    axis: str = "z",
    *,
    method: SliceMethod = "planes",
    width: float | None = None,
    spacing: float | None = None,
    bounds: Sequence[float] | None = None,
    planes: int = 5,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Granular temperature and velocity in slices across an axis, lazy where the scene is; without frozen grains.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``velocity``, and ``diameter`` (planes) or ``mass`` (bins).
    axis : str
        The axis that slices follow each other along.
    method : {"planes", "bins"}
        "planes": slices overlap, each holds ``2 planes + 1`` planes; on plane m a grain weighs by
        the area ``A_im`` of its cut, ``V_m = S A_im v_i / S A_im``, and the slice takes ``T = S_m
        w_m S_i A_im |v_i - V_m|^2 / (D S_m w_m S_i A_im)`` with weights ``w_m = 1 - |m| / (planes +
        1)``. Both sums of T are over the planes that cut two grains or more; one grain has no
        fluctuation about itself. After Zhang & Kamrin (2017). "bins": slices touch, a grain belongs to the one that
        holds its centre, ``T = S m_i |v_i - V|^2 / (D S m_i)`` about the velocity V of the bin, as
        LAMMPS computes it by chunks.
    width : float, optional
        Thickness of a slice (m), d43 by default.
    spacing : float, optional
        Distance of centres (m): half the width for planes; bins touch and take none.
    bounds : two floats, optional
        First and last centre for planes, edges of the first and last bin for bins (m). By default
        the edges of the box (of the first step) along a periodic axis, else the extent of the
        grains. Along a periodic axis every image of a grain counts, wherever its position is
        written.
    planes : int
        Planes on each side of a slice's centre.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error, or leave it
        NaN, warn of it, and mark it in the coordinate ``skipped`` (time).

    Returns
    -------
    xarray.Dataset
        ``granular_temperature`` (time, axis) in m2 s-2, ``velocity`` (time, axis, component) in m
        s-1, and ``sample_count`` (time, axis), the grains in each slice. The temperature is NaN for
        slices with fewer than two (on one plane, for planes), the velocity for empty ones.

    Raises
    ------
    SceneError
        If the scene lacks what the method needs.
    ValueError
        If an argument is wrong.
    """
    given = {
        name: value
        for name, value in locals().items()
        if name not in ("ds", "on_error") and value is not None
    }
    weight = {"planes": "diameter", "bins": "mass"}.get(method)
    if weight is None:
        raise ValueError(f"method={method!r}: expected 'planes' (overlapping slices) or 'bins'")
    if method == "bins" and spacing is not None:
        raise ValueError(
            f"spacing={spacing!r}: bins touch, and take their width=; leave spacing= out, or take planes"
        )
    require_scene(ds, ("velocity", weight), "slice_temperature")
    scene = describe(ds)
    setup = scene.setup
    if not isinstance(axis, str) or axis not in setup.plane or len(axis) != 1:
        raise ValueError(f"axis={axis!r}: expected one of the scene's axes {setup.plane!r}")
    k, fitted = COMPONENTS.index(axis), None
    if width is None:
        width = scene.sizes.get("d43", np.nan)
    if bounds is None and axis in setup.periodic:
        bounds = scene.edges.get(axis)
    elif bounds is None and scene.corners is not None:
        bounds = fitted = scene.corners[0][k], scene.corners[1][k]
    if not is_positive(width):
        raise ValueError(
            f"width={width!r}: expected a positive width (m); by default it is d43, from ds.cg.measure()"
        )
    width, bounds = float(width), rising_pair("bounds", bounds, equal=True)
    shared: dict[str, Any] = {
        "axis": k,
        "dims": [COMPONENTS.index(a) for a in setup.plane],
        "width": width,
    }
    if method == "bins":
        count = max(1, _whole(np.ceil((bounds[1] - bounds[0]) / width - 1e-9)))
        nodes = bounds[0] + width * (np.arange(count) + 0.5)
        hair = _HAIR * width  # the last edge is the first over again
        limits = (bounds[0] - hair, bounds[0] + count * width - 2 * hair)
        function = partial(_bins, edges=bounds[0], **shared)
    else:
        step = width / 2 if spacing is None else spacing
        if not (is_positive(step) and is_whole(planes, 0)):
            raise ValueError(
                f"spacing={spacing!r}, planes={planes!r}: expected a positive distance (m) and a number of planes"
            )
        step = float(step)
        nodes = bounds[0] + step * np.arange(
            _whole((bounds[1] - bounds[0]) / step + 1e-9, 2 * planes + 1) + 1
        )
        limits = (nodes[0] - width / 2, nodes[-1] + width / 2)
        function = partial(_planes, sides=planes, **shared)
    periodic = setup.periodic if scene.tilted else axis if axis in setup.periodic else ""
    compute = partial(
        _over_time,
        weight=weight,
        function=function,
        nodes=nodes,
        axis=k,
        limits=limits,
        periodic=periodic,
        fitted=fitted,
    )
    names = [
        "particle_id",
        "position",
        "velocity",
        weight,
        *(name for name in ("frozen", *OF_STEP) if name in ds),
    ]
    rows = {
        "granular_temperature": Variable(
            (axis,), "m^2 s^-2", f"granular temperature in slices ({method})"
        ),
        "velocity": Variable((axis, "component"), "m s^-1", "velocity of the slice"),
        "sample_count": Variable((axis,), "1", "number of particles in the slice"),
    }
    found = map_over_time(
        ds, names, compute, results_of(rows, {axis: len(nodes)}), "slices", on_error
    )
    result = label(
        ds, rows, found, format_call("slice_temperature", given), slice_width=width, method=method
    )
    return result.assign_coords({axis: _along(axis, nodes, setup.unit_system)})


def _whole(count: float, planes: int = 1) -> int:
    """Whole number of slices, refused before anything is made for too many."""
    if not (count + 1) * planes < _MOST:
        raise ValueError(
            f"{count + 1:.3g} slices of {planes} planes are more than {_MOST} planes: choose larger or fewer ones"
        )
    return int(count)


def _over_time(
    arrays: Mapping[str, NDArray],
    *,
    weight: str,
    function: Callable[..., NDArray],
    nodes: NDArray,
    axis: int,
    periodic: str,
    limits: tuple[float, float],
    fitted: tuple[float, float] | None,
) -> dict[str, NDArray]:
    """Temperature, velocity and count of the slices of one chunk of time."""
    out = np.empty((len(arrays[weight]), len(nodes), 5))
    for t, (whole, box, source) in enumerate(steps_in(arrays, periodic)):
        frame = without_frozen(whole)
        lattice, position, velocity = (
            box.seen(np.arange(3) == axis, source),
            frame["position"],
            frame["velocity"],
        )
        row = np.arange(len(position))
        if fitted is not None:
            warn_beyond(COMPONENTS[axis], position[:, axis], *fitted, source)
        # every image stands for itself, as its velocity may be another
        if lattice.vectors is not None:
            reach = 0.5 * frame[weight].max(initial=0.0) * (weight == "diameter")
            low, high = (
                np.where(np.arange(3) == axis, end, sign * np.inf)
                for sign, end in ((-1, limits[0] - reach), (1, limits[1] + reach))
            )
            row, shift, drift = lattice.images(position, low, high, source)
            frame = {weight: frame[weight][row]}
            position, velocity = position[row] + shift, velocity[row] + drift
        out[t] = function(
            position, velocity, frame[weight], nodes, row=row, period=float(lattice.period[axis])
        )
    return {
        "granular_temperature": out[..., 0],
        "velocity": out[..., 1:4],
        "sample_count": out[..., 4],
    }


def _images_between(x: NDArray, low: float, high: float, period: float) -> NDArray:
    """Count the images of coordinates that lie in [low, high): 0 or 1 each without a period."""
    if not np.isfinite(period):
        return ((low <= x) & (x < high)).astype(float)
    return np.ceil((high - x) / period) - np.ceil((low - x) / period)


def _bins(
    position: NDArray,
    velocity: NDArray,
    mass: NDArray,
    nodes: NDArray,
    *,
    axis: int,
    dims: list[int],
    edges: float,
    width: float,
    row: NDArray,
    period: float,
) -> NDArray:
    out = np.full((len(nodes), 5), np.nan)
    hair = _HAIR * width  # edges are known to rounding only
    for k in range(len(nodes)):
        # the last edge belongs to the last bin, unless it is the first edge over again
        end = hair if k == len(nodes) - 1 and not np.isfinite(period) else -hair
        images = _images_between(
            position[:, axis], edges + k * width - hair, edges + (k + 1) * width + end, period
        )
        here = images > 0
        m, v = (images * mass)[here], velocity[here]
        out[k, 4] = len(np.unique(row[here]))
        if len(m):
            out[k, 1:4] = (m @ v) / m.sum()
        if len(m) > 1:
            out[k, 0] = (m @ (v - out[k, 1:4])[:, dims] ** 2).sum() / (len(dims) * m.sum())
    return out


def _planes(
    position: NDArray,
    velocity: NDArray,
    diameter: NDArray,
    nodes: NDArray,
    *,
    axis: int,
    dims: list[int],
    sides: int,
    width: float,
    row: NDArray,
    period: float,
) -> NDArray:
    x, radius, grain = position[:, axis], diameter / 2, np.arange(len(position))
    reach = radius.max(initial=0.0)
    if not reach < _MOST_PERIODS * period:
        raise SceneError(
            f"a grain of diameter {2 * reach:.3g} m reaches over more than {_MOST_PERIODS} periods of {period:.3g} m"
        )
    # planes and grains are taken to [0, period), and images as far as grains reach beyond it
    if np.isfinite(period):
        images = period * np.arange(-np.ceil(reach / period), np.ceil(reach / period) + 1)
        grain = np.tile(grain, len(images))
        x = (np.mod(x, period) + images[:, None]).ravel()
    order = np.argsort(x)
    grain, x = grain[order], x[order]
    velocity, radius = velocity[grain], radius[grain]
    out = np.full((len(nodes), 5), np.nan)
    shifts = np.arange(-sides, sides + 1)
    for k, node in enumerate(nodes):
        total, energy, momentum, seen = 0.0, 0.0, np.zeros(3), np.zeros(len(position), bool)
        shared = 0.0
        for m in shifts:
            plane, share = node + m * width / (2 * max(sides, 1)), 1 - abs(m) / (sides + 1)
            plane = np.mod(plane, period) if np.isfinite(period) else plane
            near = slice(*np.searchsorted(x, (plane - reach, plane + reach)))
            area = np.pi * np.maximum(radius[near] ** 2 - (x[near] - plane) ** 2, 0.0)
            if not area.sum() > 0:
                continue
            seen[grain[near][area > 0]] = True
            v = velocity[near]
            mean = (area @ v) / area.sum()
            momentum += share * area.sum() * mean
            total += share * area.sum()
            if (area > 0).sum() > 1:  # one grain has no fluctuation about itself
                energy += share * (area @ (v - mean)[:, dims] ** 2).sum()
                shared += share * area.sum()
        out[k, 4] = len(np.unique(row[seen]))
        if total > 0:
            out[k, 1:4] = momentum / total
        if shared > 0:
            out[k, 0] = energy / (len(dims) * shared)
    return out
