"""Nodes of a mesh of a volume, plane or line, with the other axes averaged exactly."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import FINITE, check, is_finite, rising_pair
from xcg.common.messages import warn_once
from xcg.fields.sums.nodes import Nodes
from xcg.scene.schema import COMPONENTS

# first and last place along axes (m)
Bounds: TypeAlias = Mapping[str, Sequence[float]]
MAX_NODES = 2**31
_MOST_OF_ONE_AXIS = 1 << 24  # 134 MB of places
_FINEST = 1e-9  # least spacing, in radii of the support


def check_axes(axes_of_scene: Sequence[str], **places: Iterable[str]) -> None:
    """Raise ValueError for axes that a scene does not have, or that an argument names twice."""
    for name, axes in places.items():
        wrong = [a for a in axes if a not in axes_of_scene]
        if wrong:
            listed = ", ".join(axes_of_scene)
            if len(axes_of_scene) == 2:
                listed += " (one layer, dimension=2)"
            if "r" in wrong:
                listed += "; axes r, theta and z need frame=xcg.Cylindrical(...)"
            raise ValueError(f"{name} names {wrong}: the axes of this scene are {listed}")
        if len(set(axes)) < len(list(axes)):
            raise ValueError(f"{name}={axes!r} names an axis twice")


def check_places(
    axes: Sequence[str],
    at: Mapping[str, float],
    bounds: Bounds,
    axes_of_scene: Sequence[str],
) -> None:
    """Raise ValueError for unknown axes, axes both resolved and fixed, and bounds of axes that are not resolved."""
    check_axes(axes_of_scene, axes=axes, at=at, bounds=bounds)
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


class MeshTooLargeError(ValueError):
    """A mesh has more nodes than loops count, or than there is memory for."""


def nodes_along(
    a: str,
    spacing: Any,
    axes: Iterable[str],
    bounds: Bounds,
    automatic: Bounds,
    period: Mapping[str, float],
    cutoff: float,
    cells: bool = False,
) -> tuple[NDArray, float]:
    """Nodes along one of the resolved axes, and their distance; arguments as in `make_grid`."""
    if not (is_finite(spacing) and spacing > _FINEST * cutoff):
        raise ValueError(
            f"spacing along {a!r} is {spacing!r}: expected a positive distance (m) for each of {list(axes)}, not far "
            f"below the radius of the support ({cutoff:g} m)"
        )
    if a in bounds:
        first, last = rising_pair(f"bounds[{a!r}]", bounds[a], equal=True)
        count = np.floor((last - first) / spacing * (1 + 1e-12) + 1e-9) + 1
    elif a not in automatic:
        raise ValueError(
            f"axis {a!r} has no bounds: the scene holds neither a box nor the particles' extent, or no longer, as "
            f"positions were changed. Give bounds={{{a!r}: (first, last)}}, or call ds = ds.cg.measure() first "
            "(of bodies: ds = ds.cg.group_bodies(...).cg.measure() in place of by_body=)"
        )
    elif a in period:
        first = automatic[a][0]
        count = max(1, np.floor(period[a] / spacing + 0.5))
        spacing = period[a] / count
        if cells:
            first += 0.5 * spacing
    else:
        first, last = automatic[a]
        count = np.ceil((last - first) / spacing) + 1
        if cells:
            count = max(1, count - 1)
        first = 0.5 * (first + last) - 0.5 * (count - 1) * spacing
    if not count < _MOST_OF_ONE_AXIS:
        raise MeshTooLargeError(
            f"the mesh would have {count:.3g} nodes along {a!r}, more than {_MOST_OF_ONE_AXIS}: choose a larger "
            "spacing or smaller bounds"
        )
    if count > 1 and spacing > 2 * cutoff and not cells:
        warn_once(
            f"spacing along {a}",
            f"spacing {spacing:g} along {a!r} is larger than the support of the kernel (2 c = {2 * cutoff:g}): "
            "particles between nodes are not seen; choose a smaller spacing or a larger width",
        )
    return first + spacing * np.arange(int(count)), float(spacing)


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
) -> Nodes:
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
    coords: dict[str, xr.Variable] = {}
    distances: dict[str, float] = {}
    for a in axes:
        distance = spacing.get(a) if isinstance(spacing, Mapping) else spacing
        nodes, distances[a] = nodes_along(
            a, distance, axes, bounds, automatic, period, cutoff, cells
        )
        coords[a] = xr.Variable(a, nodes)
    sizes = tuple(coord.size for coord in coords.values())
    if math.prod(sizes) > MAX_NODES:
        shape = tuple(coords[a].size if a in coords else 1 for a in COMPONENTS)
        raise MeshTooLargeError(
            f"the mesh would have {shape} nodes, more than {MAX_NODES}: choose a larger spacing or smaller bounds"
        )
    coords |= {a: xr.Variable((), float(x)) for a, x in at.items()}
    ends = np.zeros((2, 3))  # first and last node
    for k, a in enumerate(COMPONENTS):
        if a in coords:
            ends[:, k] = np.ravel(coords[a])[[0, -1]]
    half = np.array([0.5 * distances.get(a, 0.0) * cells for a in COMPONENTS])
    return Nodes(
        dims=tuple(axes),
        sizes=sizes,
        coords=coords,
        active_axes="".join(a for a in COMPONENTS if a in coords),
        averaged="".join(a for a in plane if a not in coords),
        origin=ends[0],
        lower=ends[0] - half,
        upper=ends[1] + half,
        spacing=distances,
        fitted="".join(a for a in axes if a not in bounds and a not in period),
    )


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
