"""Meshes of volumes, planes and lines, with the other axes averaged exactly."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_finite, rising_pair
from xcg.common.messages import warn_once, warn_user
from xcg.fields.sums.nodes import Grid
from xcg.scene.sanity import SAMPLE
from xcg.scene.schema import COMPONENTS

MAX_NODES = 2**31
_MOST_OF_ONE_AXIS = 1 << 24  # 134 MB of places
_FINEST = 1e-9  # least spacing, in radii of the support


def check_axes(name: str, given: Iterable[str], plane: str) -> None:
    """Raise ValueError for axes that the scene does not have."""
    if wrong := [a for a in given if a not in plane]:
        layer = " (one layer, dimension=2)" if len(plane) == 2 else ""
        joined = f"; write names without commas or spaces, such as {plane[:2]!r}" if {",", " "} & set(wrong) else ""
        raise ValueError(f"{name} names {wrong}: the axes of this scene are {', '.join(plane)}{layer}{joined}")


def _check_mesh_axes(axes: str, at: Mapping[str, float], bounds: Mapping[str, Sequence[float]], plane: str) -> None:
    for name, given in (("axes", axes), ("at", at), ("bounds", bounds)):
        check_axes(name, given, plane)
    if len(set(axes)) != len(axes):
        raise ValueError(f"axes={axes!r} names an axis twice")
    both = [a for a in axes if a in at]
    if both:
        raise ValueError(f"axes={axes!r} and at={dict(at)!r} both name {both}: an axis is either resolved or fixed")
    for a, value in at.items():
        if not is_finite(value):
            raise ValueError(f"at[{a!r}]={value!r}: expected one finite coordinate; use axes= with bounds= for several")
    loose = [a for a in bounds if a not in axes]
    if loose:
        raise ValueError(
            f"bounds are given for {loose}, but only {list(axes)} are resolved: the fields are averaged (or fixed) "
            "along the others. Add the axis to axes=, or leave its bounds out; extent= sets the length of an average"
        )


class MeshTooLargeError(ValueError):
    """A mesh has more nodes than loops count, or than there is memory for."""


def nodes_along(
    a: str, step: Any, axes: Iterable[str], bounds: Mapping[str, Sequence[float]],
    automatic: Mapping[str, tuple[float, float]], period: Mapping[str, float], cutoff: float, cells: bool = False,
) -> tuple[NDArray, float]:  # fmt: skip
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
        first, count = automatic[a][0], max(1, np.floor(period[a] / step + 0.5))
        step = period[a] / count
        first += 0.5 * step if cells else 0.0
    else:
        first, last = automatic[a]
        count = np.ceil((last - first) / step)
        count = max(1, count) if cells else count + 1
        first = 0.5 * (first + last) - 0.5 * (count - 1) * step
    if not count < _MOST_OF_ONE_AXIS:
        raise MeshTooLargeError(
            f"the mesh would have {count:.3g} nodes along {a!r}, more than {_MOST_OF_ONE_AXIS}: choose a larger "
            "spacing or smaller bounds"
        )
    if count > 1 and step > 2 * cutoff and not cells:
        warn_user(
            f"spacing {step:g} along {a!r} is larger than the support of the kernel (2 c = {2 * cutoff:g}): "
            "particles between nodes are not seen; choose a smaller spacing or a larger width, or "
            "sampling='cell' for averages over the spacing around each node"
        )
    return first + step * np.arange(int(count)), float(step)


def make_grid(
    axes: str,
    at: Mapping[str, float],
    bounds: Mapping[str, Sequence[float]],
    spacing: float | Mapping[str, float],
    *,
    plane: str,
    cutoff: float,
    automatic: Mapping[str, tuple[float, float]],
    period: Mapping[str, float],
    cells: bool = False,
) -> Grid:
    """Place nodes.

    Nodes stand at first, first + spacing, ... up to last. A periodic axis without bounds gets nodes that divide
    its period evenly, so its spacing is the nearest that fits. Cells without bounds lie side by side: from edge to edge
    of a period, and around the particles.

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
        Whether values are averages over the cells of the nodes.

    Raises
    ------
    ValueError
        For unknown axes, bounds on an axis that is not resolved, or a spacing that is not positive.
    """
    if not isinstance(axes, Iterable):
        raise ValueError(f"axes={axes!r}: expected any of {plane!r}, such as {plane[-1]!r}")
    axes = "".join(sorted(axes)) if set(axes) <= set(COMPONENTS) else axes
    _check_mesh_axes(axes, at, bounds, plane)
    steps = dict(spacing) if isinstance(spacing, Mapping) else dict.fromkeys(axes, spacing)
    nodes, taken = {}, {}
    for a in axes:
        nodes[a], taken[a] = nodes_along(a, steps.get(a), axes, bounds, automatic, period, cutoff, cells)
    shape = {a: len(x) for a, x in nodes.items()}
    if math.prod(map(float, shape.values())) > MAX_NODES:
        raise MeshTooLargeError(
            f"the mesh would have {tuple(shape.get(a, 1) for a in COMPONENTS)} nodes, more than {MAX_NODES}: choose a "
            "larger spacing or smaller bounds"
        )
    fixed = {a: float(v) for a, v in at.items()}
    coords = {a: xr.Variable(a, x) for a, x in nodes.items()} | {a: xr.Variable((), x) for a, x in fixed.items()}
    half = np.array([0.5 * taken[a] if cells and a in nodes else 0.0 for a in COMPONENTS])
    origin = np.array([nodes[a][0] if a in nodes else fixed.get(a, 0.0) for a in COMPONENTS])
    last = origin + [(shape.get(a, 1) - 1) * taken.get(a, 1.0) for a in COMPONENTS]
    text = {
        "nodes": (" x ".join(f"{n} {a}" for a, n in shape.items()) or "one")
        + (", averages over their cells" if cells and axes else ""),
        "fixed": ", ".join(f"{a} = {v:g}" for a, v in fixed.items()) or "none",
    }
    return Grid(
        dims=tuple(axes), sizes=tuple(shape.values()), coords=coords,
        seen="".join(a for a in COMPONENTS if a in nodes or a in fixed),
        averaged="".join(a for a in plane if a not in nodes and a not in fixed),
        origin=origin, lower=origin - half, upper=last + half, text=text,
        cuts={a: (place, place) for a, place in fixed.items()}, spacing=taken,
        fitted="".join(a for a in axes if a not in bounds and a not in period), half=half,
    )  # fmt: skip


def check_mesh(position: NDArray, grid: Grid, cutoff: float, open_axes: NDArray, source: str) -> None:
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
    first, last = grid.lower, grid.upper
    parts = (position[start : start + SAMPLE] for start in range(0, len(position), SAMPLE))
    reached = (np.all([(x[:, k] > first[k] - cutoff) & (x[:, k] < last[k] + cutoff) for k in axes], 0) for x in parts)
    if not any(some.any() for some in reached):
        spans = [(COMPONENTS[k], position[:, k].min(), position[:, k].max()) for k in axes]
        grains = ", ".join(f"{a} from {low:.6g} to {high:.6g}" for a, low, high in spans)
        nodes = ", ".join(f"{COMPONENTS[k]} from {first[k]:.6g} to {last[k]:.6g}" for k in axes)
        warn_once(
            "reach",
            f"{source}: no grain reaches any node, so that sums are zero: grains lie at {grains}, nodes at {nodes}, "
            f"and the kernel reaches {cutoff:.4g}; check bounds=, at= and the units of lengths",
        )
        return
    for k in [k for k in axes if COMPONENTS[k] in grid.fitted]:
        x = position[:, k]
        low, high = float(x.min()), float(x.max())
        if low < first[k] + 0.5 * cutoff or high > last[k] - 0.5 * cutoff:
            a = COMPONENTS[k]
            warn_once(
                f"beyond {a}",
                f"{source}: grains lie at {a} from {low:.6g} to {high:.6g}, and the support of some is cut off by the "
                f"mesh, which was laid around the first and the last step, from {first[k]:.6g} to {last[k]:.6g}; give "
                f"bounds={{{a!r}: (first, last)}}, or call ds = ds.cg.measure(), which looks at all steps",
            )
