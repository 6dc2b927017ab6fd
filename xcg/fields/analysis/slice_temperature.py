"""Granular temperature by slices of a scene, without a kernel: overlapping planes, or bins.

Both are coarser than `xcg.coarse_grain` and are here for comparison with what was published with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_positive, is_whole, rising_pair
from xcg.common.messages import SceneError
from xcg.scene.conform import require_scene, storable, takes_scene
from xcg.scene.description import describe
from xcg.scene.frame import steps_in
from xcg.scene.schema import COMPONENTS, OF_STEP, units_in
from xcg.steps.faults import OnError
from xcg.steps.labels import format_call, mark_skipped, provenance
from xcg.steps.mapping import map_over_time

_TABLE = "slices"  # temperature, velocity (3) and count, in columns
_HAIR = 1e-9  # rounding of edges, as a share of the width
_MOST_PERIODS = 1000  # that a grain may reach over
_MOST = 1 << 20  # planes of all slices, each a step of a loop


SliceMethod: TypeAlias = Literal["planes", "bins"]


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
    """Granular temperature and velocity in slices across an axis, lazy where the scene is.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with ``velocity``, and ``diameter`` (planes) or ``mass`` (bins).
    axis : str
        The axis that slices follow each other along.
    method : {"planes", "bins"}
        "planes": slices overlap, each holds ``2 planes + 1`` planes; on plane m a grain weighs by the area ``A_im`` of
        its cut, ``V_m = S A_im v_i / S A_im``, and the slice takes
        ``T = S_m w_m S_i A_im |v_i - V_m|^2 / (D S_m w_m S_i A_im)`` with weights ``w_m = 1 - |m| / (planes + 1)``.
        After Zhang & Kamrin (2017).
        "bins": slices touch, a grain belongs to the one that holds its centre, ``T = S m_i |v_i - V|^2 / (D S m_i)``
        about the velocity V of the bin, as LAMMPS computes it by chunks.
    width : float, optional
        Thickness of a slice (m), d43 by default.
    spacing : float, optional
        Distance of centres (m): half the width for planes; bins touch and take none.
    bounds : two floats, optional
        First and last centre for planes, edges of the first and last bin for bins (m). By default the edges of the box
        (of the first step) along a periodic axis, else the extent of the grains. Along a periodic axis every image of a
        grain counts, wherever its position is written.
    planes : int
        Planes on each side of a slice's centre.
    on_error : {"raise", "skip"}
        What to do about a step that cannot be read or computed: stop with its error, or leave it NaN, warn of it, and
        mark it in the coordinate ``skipped`` (time).

    Returns
    -------
    xarray.Dataset
        ``granular_temperature`` (time, axis) in m2 s-2, ``velocity`` (time, axis, component) in m s-1, and
        ``sample_count`` (time, axis), the grains in each slice. The temperature is NaN for slices with fewer than
        two, the velocity for empty ones.

    Raises
    ------
    SceneError
        If the scene lacks what the method needs.
    ValueError
        If an argument is wrong.
    """
    given = {name: value for name, value in locals().items() if name not in ("ds", "on_error") and value is not None}
    weight = {"planes": "diameter", "bins": "mass"}.get(method)
    if weight is None:
        raise ValueError(f"method={method!r}: expected 'planes' (overlapping slices) or 'bins'")
    require_scene(ds, ("velocity", weight), "slice_temperature")
    scene = describe(ds)
    setup = scene.setup
    if not isinstance(axis, str) or axis not in setup.plane or len(axis) != 1:
        raise ValueError(f"axis={axis!r}: expected one of the scene's axes {setup.plane!r}")
    k = COMPONENTS.index(axis)
    if width is None:
        width = scene.sizes.get("d43", np.nan)
    if bounds is None and axis in setup.periodic:
        bounds = scene.edges.get(axis)
    elif bounds is None and scene.corners is not None:
        bounds = scene.corners[0][k], scene.corners[1][k]
    if not is_positive(width):
        raise ValueError(f"width={width!r}: expected a positive width (m); by default it is d43, from ds.cg.measure()")
    width, bounds = float(width), rising_pair("bounds", bounds, equal=True)
    if method == "bins":
        count = max(1, _whole(np.ceil((bounds[1] - bounds[0]) / width - 1e-9)))
        nodes = bounds[0] + width * (np.arange(count) + 0.5)
        hair = _HAIR * width  # the last edge is the first over again
        limits = (bounds[0] - hair, bounds[0] + count * width - 2 * hair)
        function = partial(_bins, axis=k, dims=[*map(COMPONENTS.index, setup.plane)], edges=bounds[0], width=width)
    else:
        step = width / 2 if spacing is None else spacing
        if not (is_positive(step) and is_whole(planes, 0)):
            raise ValueError(
                f"spacing={spacing!r}, planes={planes!r}: expected a positive distance (m) and a number of planes"
            )
        step = float(step)
        nodes = bounds[0] + step * np.arange(_whole((bounds[1] - bounds[0]) / step + 1e-9, 2 * planes + 1) + 1)
        limits = (nodes[0] - width / 2, nodes[-1] + width / 2)
        function = partial(_planes, axis=k, dims=[*map(COMPONENTS.index, setup.plane)], sides=planes, width=width)
    periodic = setup.periodic if scene.tilted else axis if axis in setup.periodic else ""
    compute = partial(
        _over_time, weight=weight, function=function, nodes=nodes, axis=k, limits=limits, periodic=periodic
    )
    names = ["particle_id", "position", "velocity", weight, *(name for name in OF_STEP if name in ds)]
    shape = {_TABLE: ((len(nodes), 5), "float64")}
    found = map_over_time(ds, names, compute, shape, "slices", on_error)
    coords: dict[Any, Any] = dict(scene.times)
    table = xr.DataArray(found[_TABLE], coords, ("time", axis, "_column"))
    system = setup.unit_system
    length = units_in("m", system)
    coords |= {axis: (axis, nodes, {"units": length, "long_name": f"position along {axis}", "axis": axis.upper()})}
    velocity = table.isel(_column=slice(1, 4)).rename(_column="component")
    out = {
        "granular_temperature": table.isel(_column=0).assign_attrs(
            units=units_in("m^2 s^-2", system), long_name=f"granular temperature in slices ({method})"
        ),
        "velocity": velocity.assign_attrs(units=units_in("m s^-1", system), long_name="velocity of the slice"),
        "sample_count": table.isel(_column=4).assign_attrs(units="1", long_name="number of particles in the slice"),
    }
    attrs = provenance(ds, format_call("slice_temperature", given)) | {"slice_width": width, "method": method}
    result = storable(xr.Dataset(out, {**coords, "component": list(COMPONENTS)}, attrs))
    return mark_skipped(result, found)


def _whole(count: float, planes: int = 1) -> int:
    """Whole number of slices, refused before anything is made for too many."""
    if not (count + 1) * planes < _MOST:
        raise ValueError(
            f"{count + 1:.3g} slices of {planes} planes are more than {_MOST} planes: choose larger or fewer ones"
        )
    return int(count)


def _over_time(
    arrays: Mapping[str, NDArray], *, weight: str, function: Callable[..., NDArray], nodes: NDArray, axis: int,
    periodic: str, limits: tuple[float, float],
) -> dict[str, NDArray]:  # fmt: skip
    """Tables of the slices of one chunk of time."""
    out = np.empty((len(arrays[weight]), len(nodes), 5))
    for t, (frame, box, source) in enumerate(steps_in(arrays, periodic)):
        lattice, position, velocity = box.seen(np.arange(3) == axis, source), frame["position"], frame["velocity"]
        row = np.arange(len(position))
        if lattice.vectors is not None:  # every image stands for itself, as its velocity may be another
            reach = 0.5 * frame[weight].max(initial=0.0) * (weight == "diameter")
            low, high = (
                np.where(np.arange(3) == axis, end, sign * np.inf)
                for sign, end in ((-1, limits[0] - reach), (1, limits[1] + reach))
            )
            row, shift, drift = lattice.images(position, low, high, source)
            frame = {weight: frame[weight][row]}
            position, velocity = position[row] + shift, velocity[row] + drift
        out[t] = function(position, velocity, frame[weight], nodes, row=row, period=float(lattice.period[axis]))
    return {_TABLE: out}


def _images_between(x: NDArray, low: float, high: float, period: float) -> NDArray:
    """Count the images of coordinates that lie in [low, high): 0 or 1 each without a period."""
    if not np.isfinite(period):
        return ((low <= x) & (x < high)).astype(float)
    return np.ceil((high - x) / period) - np.ceil((low - x) / period)


def _bins(
    position: NDArray, velocity: NDArray, mass: NDArray, nodes: NDArray, *, axis: int, dims: list[int], edges: float,
    width: float, row: NDArray, period: float,
) -> NDArray:  # fmt: skip
    out = np.full((len(nodes), 5), np.nan)
    hair = _HAIR * width  # edges are known to rounding only
    for k in range(len(nodes)):
        # the last edge belongs to the last bin, unless it is the first edge over again
        end = hair if k == len(nodes) - 1 and not np.isfinite(period) else -hair
        images = _images_between(position[:, axis], edges + k * width - hair, edges + (k + 1) * width + end, period)
        here = images > 0
        m, v = (images * mass)[here], velocity[here]
        out[k, 4] = len(np.unique(row[here]))
        if len(m):
            out[k, 1:4] = (m @ v) / m.sum()
        if len(m) > 1:
            out[k, 0] = (m @ (v - out[k, 1:4])[:, dims] ** 2).sum() / (len(dims) * m.sum())
    return out


def _planes(
    position: NDArray, velocity: NDArray, diameter: NDArray, nodes: NDArray, *, axis: int, dims: list[int], sides: int,
    width: float, row: NDArray, period: float,
) -> NDArray:  # fmt: skip
    x, radius, grain = position[:, axis], diameter / 2, np.arange(len(position))
    reach = radius.max(initial=0.0)
    if not reach < _MOST_PERIODS * period:
        raise SceneError(
            f"a grain of diameter {2 * reach:.3g} m reaches over more than {_MOST_PERIODS} periods of {period:.3g} m"
        )
    if np.isfinite(period):  # planes and grains are taken to [0, period), and images as far as grains reach beyond it
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
