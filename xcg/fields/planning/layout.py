"""Where fields are computed: nodes, the axes that are averaged, and the kernels that reach them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.compiled import smoothing as kinds
from xcg.fields.places.frames import Cylindrical, is_cylindrical
from xcg.fields.places.grid import make_grid
from xcg.fields.places.points import is_pointwise, make_points
from xcg.fields.places.rings import Rings, make_rings
from xcg.fields.request import Request
from xcg.fields.sums.nodes import Grid
from xcg.fields.sums.smoothing import Kernel, as_kernel, choose_width
from xcg.scene.lattice import Lattice
from xcg.scene.numbers import is_positive
from xcg.scene.query import axes_that_stay, box_stays, groups_of, known_without_reading
from xcg.scene.schema import BOX, COMPONENTS, Setup
from xcg.scene.warn import warn_user

_NARROW = 0.1  # widths, in mean diameters, that show single grains only


def nodes_of(
    ds: xr.Dataset, request: Request, setup: Setup, kernels: Sequence[Kernel],
    edges: Mapping[str, tuple[float, float]], period: Mapping[str, float],
) -> Grid:  # fmt: skip
    """Lay the nodes: points, where coordinates are arrays, or a mesh."""
    at: Mapping[str, Any] = request.at or {}
    narrowest = min(k.cutoff for k in kernels)
    if is_cylindrical(ds):
        return _rings(ds, request, setup, kernels, edges, period)
    if is_pointwise(at):
        _check_pointwise(request)
        return make_points(at, plane=setup.plane, cutoff=narrowest)
    return make_grid(
        setup.plane if request.axes is None and request.at is None else request.axes or "",
        at,
        request.bounds or {},
        min(k.width for k in kernels) if request.spacing is None else request.spacing,
        plane=setup.plane,
        cutoff=narrowest,
        automatic=_automatic(ds, setup, edges, max(k.cutoff for k in kernels)),
        period=period,
        cells=request.sampling == "cell",
    )


def _rings(
    ds: xr.Dataset, request: Request, setup: Setup, kernels: Sequence[Kernel],
    edges: Mapping[str, tuple[float, float]], period: Mapping[str, float],
) -> Rings:  # fmt: skip
    """Lay the nodes of a cylinder."""
    assert isinstance(request.frame, Cylindrical)
    if request.gradient == "finite_difference":
        msg = "gradient='finite_difference' takes a mesh along x, y and z, not a cylindrical frame; take another way"
        raise ValueError(msg)
    if request.sampling == "cell":
        msg = (
            "sampling='cell' takes the cells of a mesh along x, y and z, and a cylindrical frame has none: leave it out"
        )
        raise ValueError(msg)
    reach = max(k.cutoff for k in kernels)
    automatic = _automatic(ds, setup, edges, reach)
    if {"x", "y"} <= set(automatic):
        automatic["r"] = 0.0, _largest_radius(ds) + reach
    axes = ("rtz" if "z" in setup.plane else "rt") if request.axes is None and request.at is None else request.axes
    return make_rings(
        axes or "",
        request.at or {},
        request.bounds or {},
        min(k.width for k in kernels) if request.spacing is None else request.spacing,
        plane=setup.plane,
        kernel=min(kernels, key=lambda k: k.cutoff),
        seen_all=setup.dimension,
        error=request.frame.error,
        automatic=automatic,
        period=period,
    )


def _largest_radius(ds: xr.Dataset) -> float:
    """Distance from the axis z of the outermost grain of the first and last step; of the corners of a lazy scene."""
    if isinstance(ds["position"].variable._data, np.ndarray):
        ends = ds["position"].transpose("time", "particle", "component")[[0, -1]].to_numpy()
        return float(np.nanmax(np.hypot(ends[..., 0], ends[..., 1])))
    far = np.maximum(np.abs(ds.attrs["particle_lower"]), np.abs(ds.attrs["particle_upper"]))
    return float(np.hypot(far[0], far[1]))


def _check_pointwise(request: Request) -> None:
    """Refuse what only meshes have."""
    if request.sampling == "cell":
        msg = (
            "sampling='cell' takes averages over the cells of a mesh, and points, which at= has arrays of, have none: "
            "leave it out, or lay a mesh with axes=, bounds= and spacing="
        )
        raise ValueError(msg)
    for name in ("axes", "bounds", "spacing"):
        if getattr(request, name):
            msg = (
                f"{name}={getattr(request, name)!r} lays a mesh, and at= has arrays, which name points: leave it out "
                "(axes that at= does not name are averaged), or give the nodes along an axis as one more array of at=, "
                "such as xr.DataArray(z, dims='z'), which broadcasts against the others"
            )
            raise ValueError(msg)
    if request.gradient == "finite_difference":
        msg = (
            "gradient='finite_difference' takes differences between the nodes of a mesh, and points have no "
            "neighbours: take gradient='least_squares' (the default) or 'kernel'"
        )
        raise ValueError(msg)


def _automatic(
    ds: xr.Dataset, setup: Setup, edges: Mapping[str, tuple[float, float]], cutoff: float
) -> dict[str, tuple[float, float]]:
    """Bounds by default: the period, or the particles' extent with their supports, or the box they were read with."""
    lower, upper = ds.attrs.get("particle_lower"), ds.attrs.get("particle_upper")
    # a box does not follow positions that were changed
    follows = known_without_reading(ds, "position")
    found = {a: ends for a, ends in edges.items() if follows or a in setup.periodic}
    if lower is not None and upper is not None:
        for k, a in enumerate(COMPONENTS):
            if a not in setup.periodic or a not in edges:
                found[a] = (float(lower[k]) - cutoff, float(upper[k]) + cutoff)
    return found


def lasting_periods(ds: xr.Dataset, setup: Setup, period: Mapping[str, float]) -> NDArray:
    """Period (3,) along each axis alone, infinity where there is none that is the same in all steps."""
    if "lattice" not in ds:
        lasting = axes_that_stay(ds)
        return np.array([period.get(a, np.inf) if a in lasting else np.inf for a in COMPONENTS])
    if not box_stays(ds):
        return np.full(3, np.inf)
    box = {name: ds[name].isel(time=0).transpose(*row.dims).to_numpy() for name, row in BOX.items() if name in ds}
    return Lattice.of(box, setup.periodic).axis_periods


def extents_of(
    grid: Grid, extent: Mapping[str, float], edges: Mapping[str, tuple[float, float]], *, tilted: bool
) -> dict[str, float | None]:
    """Length of each averaged axis (m), None for that of the box of each step."""
    loose = [a for a in extent if a not in grid.averaged]
    if loose:
        msg = f"extent names {loose}, but the averaged axes are {list(grid.averaged)}: leave it out"
        raise ValueError(msg)
    found: dict[str, float | None] = {}
    for a in grid.averaged:
        length = extent.get(a)
        if length is None and a not in edges and not tilted:
            msg = (
                f"fields are averaged along {a!r}, and the scene has no finite box there: give the length that the "
                f"integral is divided by, extent={{{a!r}: length}}, or resolve or fix the axis (axes=, at=)"
            )
            raise ValueError(msg)
        if length is not None and not is_positive(length):
            msg = f"extent[{a!r}]={length!r}: expected a positive length (m)"
            raise ValueError(msg)
        found[a] = None if length is None else float(length)
    return found


def kernels_of(ds: xr.Dataset, request: Request, dimension: int) -> list[Kernel]:
    """One kernel for all, or one for each group where `width` maps groups to widths."""
    kernel, width, by = request.kernel, request.width, request.by
    if not isinstance(width, Mapping):
        has_own = isinstance(kernel, Kernel) and width is None
        return [as_kernel(kernel, None if has_own else choose_width(width, ds.attrs), dimension)]
    if by is None or not isinstance(kernel, str):
        msg = f"width={dict(width)!r} gives each group its own: name the groups' variable with by=, and a kernel"
        raise ValueError(msg)
    own = {str(group): value for group, value in width.items()}
    known = groups_of(ds, by, request.groups)
    if set(own) != {str(g) for g in known}:
        msg = f"width={dict(width)!r}: expected a width for each of the groups {list(known)} of {by!r}"
        raise ValueError(msg)
    return [as_kernel(kernel, choose_width(own[str(g)], ds.attrs), dimension) for g in known]


def warn_of_width(width: float, diameter: Any) -> None:
    """Warn of a kernel that sees single grains."""
    if diameter is not None and width < _NARROW * diameter:
        msg = (
            f"width={width:.4g} is {width / diameter:.2g} of the grains' diameter ({diameter:.4g}): the kernel sees "
            "the inside of single grains, and no field of a continuum (volume fractions far above 1); the usual choice "
            "is 0.75 mean diameters, see the page on width"
        )
        warn_user(msg)


def warn_of_cuts(grid: Grid, edges: Mapping[str, tuple[float, float]], reach: float) -> None:
    """Warn of fixed coordinates that lie outside a periodic box."""
    for a, (low, high) in edges.items():
        # grains and cuts of scenes that were shifted, or are not wrapped, are beyond an edge by up to a period
        room = high - low + reach
        beyond = [x for x in grid.cuts.get(a, ()) if not low - room <= x <= high + room]
        if beyond:
            msg = (
                f"at={{{a!r}: {beyond[0]:g}}} is outside the box, which is periodic from {low:g} to {high:g} along "
                f"{a!r}: fields are those of the image inside; check the units of lengths"
            )
            warn_user(msg)


def check_differentiable(kernel: Kernel, seen: int) -> None:
    """Refuse gradients of a kernel that has none, and warn where it jumps."""
    if kernel.code == kinds.HEAVISIDE:
        msg = "gradient='kernel' needs a kernel that is differentiable: Heaviside is not; take gradient='least_squares'"
        raise ValueError(msg)
    if kernel.smoothness == 0:
        msg = (
            f"the {kernel.name} kernel is continuous, but its slope jumps at its cutoff: its gradient is exact almost "
            "everywhere, and the fields made of it jump where a grain comes into reach; take Lucy for smooth ones"
        )
        warn_user(msg)
    elif not kernel.differentiable:
        msg = (
            f"the {kernel.name} kernel jumps at its cutoff: its gradient leaves the jump out (8 % low for a Gaussian "
            "cut at 3 w); take Lucy, or gradient='least_squares'"
        )
        warn_user(msg)
