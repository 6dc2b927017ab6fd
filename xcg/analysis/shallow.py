"""Shallow flows: where the surface is, how steep it is, and integrals over the depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import POSITIVE, between, check
from xcg.common.messages import SceneError
from xcg.fields.coarse_grain import coarse_grain
from xcg.fields.formulas.mean_sums import require_fields
from xcg.fields.sums.kernels import Kernel, KernelName, kernel_of
from xcg.scene.conform import takes_scene
from xcg.scene.facts import SETUP, require_facts, with_facts
from xcg.scene.frame import with_time
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS
from xcg.steps.faults import OnError
from xcg.steps.labels import call_of, format_call, labelled_table, provenance
from xcg.steps.mapping import apply_along


def free_surface(
    f: xr.Dataset, axis: str = "z", share: float = 0.5, *, field: str = "volume_fraction"
) -> xr.Dataset:
    """Find the free surface and the base of a flow, where a field falls to a share of its bulk.

    The bulk value of a step is ``sum phi^2 / sum phi`` over all nodes: phi itself where it is the
    same everywhere. Between nodes phi is interpolated linearly. Holes inside do not count: the
    surface is the highest crossing, the base the lowest.

    Parameters
    ----------
    f : xarray.Dataset
        A result of `xcg.coarse_grain` that is resolved along the axis, and holds the field.
    axis : str
        Across the base, upwards.
    share : float
        Share of the bulk value, between 0 and 1.
    field : str
        "volume_fraction" or "density".

    Returns
    -------
    xarray.Dataset
        ``height`` and ``base`` (m), without the axis, of all grains together or else of each phase
        that was selected; NaN where nothing is above this share, or where the mesh ends before
        the field falls through it. Lazy where the result is.

    Raises
    ------
    SceneError
        If results of different options were joined.
    ValueError
        If the axis is not resolved, the field is not there, or the share is not between 0 and
        1.

    Examples
    --------
    >>> import xcg
    >>> f = xcg.datasets.random_scene(500).cg.coarse_grain("volume_fraction", axes="xz")
    >>> free_surface(f).height.dims
    ('time', 'x')
    """
    require_fields(f, "free_surface")
    f = with_facts(f)
    if field not in f:
        fields = ", ".join(map(str, f.data_vars))
        raise ValueError(f"field={field!r}: expected a field of this result, which holds {fields}")
    if axis not in f[field].dims:
        axes = [a for a in COMPONENTS if a in f.dims]
        raise ValueError(f"free_surface({axis!r}): the result has the axes {axes}")
    check("share", share, between(0, 1), hint=", such as 0.5")
    values = f[field].sortby(axis)
    if "phase" in values.dims and "bulk" in values["phase"]:
        values = values.sel(phase="bulk", drop=True)
    # sums of lazy values and of those in memory are of one order
    values = xr.apply_ufunc(
        np.ascontiguousarray,
        values,
        keep_attrs=True,
        dask="parallelized",
        output_dtypes=[values.dtype],
    )
    nodes = [a for a in COMPONENTS if a in values.dims]
    bulk = (values**2).sum(nodes) / values.sum(nodes)
    crossings = apply_along(
        _crossings,
        values,
        share * bulk,
        along=[[axis], []],
        to=[["end"]],
        sizes={"end": 2},
        kwargs={"z": values[axis].to_numpy()},
    )
    attrs = {"units": f[axis].attrs.get("units", "m"), "surface_axis": axis}
    if "cutoff" in f.attrs:
        attrs["cutoff"] = f.attrs["cutoff"]
    where = f"along {axis}, where {field} is {share:g} of its bulk value"
    data = {}
    for end, (name, text) in enumerate({"base": "base", "height": "free surface"}.items()):
        data[name] = crossings.isel(end=end).drop_attrs(deep=False)
        data[name].attrs = attrs | {"long_name": f"{text} {where}"}
    call = format_call("free_surface", {"axis": axis, "share": share, "field": field})
    of_result = f.attrs | provenance(f, call) | {"surface_axis": axis}
    return xr.Dataset(data, attrs=of_result)[["height", "base"]]


def _crossings(values: NDArray, least: NDArray, z: NDArray) -> NDArray:
    """Return the lowest and the highest crossing (..., 2) of values (..., n) through `least`."""
    lowest = _first_crossing(values, least, z)
    highest = _first_crossing(values[..., ::-1], least, z[::-1])
    return np.stack([lowest, highest], axis=-1)


def _first_crossing(values: NDArray, least: NDArray, z: NDArray) -> NDArray:
    """Return the first height (...) where values (..., n) at z (n,) rise to `least` (...)."""
    above = values >= least[..., None]
    crosses = above[..., 1:] & ~above[..., :-1]
    k = crosses.argmax(-1)
    value_below = np.take_along_axis(values[..., :-1], k[..., None], -1)[..., 0]
    value_above = np.take_along_axis(values[..., 1:], k[..., None], -1)[..., 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        drop = value_above - np.where(np.isnan(value_below), 0.0, value_below)
        share = (value_above - least) / drop
    height = z[1:][k] + share * (z[:-1][k] - z[1:][k])
    starts_below = ~above[..., 0]  # else the mesh ends inside the flow
    return np.where(crosses.any(-1) & starts_below, height, np.nan)


def fit_slope(surface: xr.Dataset | xr.DataArray) -> xr.Dataset:
    """Fit a line or a plane to a surface: its slope, as of a heap at its angle of repose.

    Parameters
    ----------
    surface : xarray.Dataset or DataArray
        From `free_surface`, or its ``height``: select the part to fit first,
        ``surface.sel(x=slice(0.02, 0.1))``. Nodes without a surface are left out.

    Returns
    -------
    xarray.Dataset
        ``slope`` (component), dh/dx and dh/dy, if resolved; ``intercept``, the height of the fit
        at x = y = 0 (m); ``angle`` against the level (degrees); and standard errors ``slope_error``
        and ``angle_error``, from the scatter about the fit with one independent node for each
        support of the kernel (by the attribute ``cutoff``). NaN for fewer nodes than the fit takes.
        `Rotated.from_slope` makes axes of it.

    Raises
    ------
    ValueError
        If ``height`` is missing, or all axes are averaged or fixed.
    SceneError
        If a Dataset has lost its ``cutoff``, or parts of different widths were joined.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> x = np.linspace(0, 1, 11)
    >>> round(float(fit_slope(xr.DataArray(0.5 - 0.3 * x, {"x": x})).angle), 6)
    16.699244
    """
    height: Any = surface
    if isinstance(surface, xr.Dataset):
        if "height" not in surface:
            raise ValueError(
                "fit_slope needs 'height': call it on f.cg.free_surface(...), not on fields"
            )
        height = surface["height"]
    facts = with_facts(height.to_dataset(name="height").assign_attrs(surface.attrs))
    facts = facts.assign_attrs(height.attrs)
    if isinstance(surface, xr.Dataset):
        way_out = "or pass the heights alone, f.height, if no kernel smoothed them"
        require_facts(facts, ("cutoff",), "this surface", way_out)
    axes = [a for a in COMPONENTS if a in height.dims]
    if not axes:
        raise ValueError("fit_slope needs a surface along an axis, such as height (time, x)")
    grids = np.meshgrid(*(height[a].to_numpy() for a in axes), indexing="ij")
    points = np.stack([grid.ravel() for grid in grids], axis=1)
    support = 2 * float(np.max(facts.attrs.get("cutoff", 0.0)))
    count = len(axes)
    fit = apply_along(
        _fitted,
        height,
        along=[axes],
        to=[["number"]],
        sizes={"number": 2 * count + 3},
        kwargs={"points": points, "shared": nodes_a_support(height, axes, support)},
    )
    unit = str(height.attrs.get("units", "m"))
    at_zero = f"height of the fit at {' = '.join(axes)} = 0"
    errors = slice(count, 2 * count)
    parts = {
        "slope": (fit.isel(number=slice(count)), "1", "slope of the surface"),
        "slope_error": (fit.isel(number=errors), "1", "standard error of the slope"),
        "intercept": (fit.isel(number=2 * count), unit, at_zero),
        "angle": (fit.isel(number=-2), "degree", "angle of the surface"),
        "angle_error": (fit.isel(number=-1), "degree", "standard error of the angle"),
    }
    data = labelled_table(parts)
    kept = {k: facts.attrs[k] for k in ("surface_axis",) if k in facts.attrs}
    return xr.Dataset(data, attrs=kept).rename(number="component").assign_coords(component=axes)


def nodes_a_support(nodes: xr.Dataset | xr.DataArray, axes: Sequence[str], support: float) -> float:
    """Return the number of nodes along `axes` that share a support (m) of the kernel, 1 or more."""
    number = 1.0
    for a in axes:
        if nodes.sizes[a] > 1:
            spacing = float(abs(nodes[a][1] - nodes[a][0]))
            number *= max(1.0, support / spacing)
    return number


def _fitted(height: NDArray, points: NDArray, shared: float) -> NDArray:
    """Fit planes to heights (..., nodes along k axes) at points (nodes, k).

    Returns
    -------
    array (..., 2 k + 3)
        Slopes, their errors, the height at 0, the angle and its error (degrees). Errors hold for independent
        nodes, with `shared` nodes for one of them.
    """
    count = points.shape[1]
    heights = height.reshape(*height.shape[: height.ndim - count], -1)
    out = np.full((*heights.shape[:-1], 2 * count + 3), np.nan)
    for at in np.ndindex(heights.shape[:-1]):
        finite = np.isfinite(heights[at])
        x = points[finite]
        z = heights[at][finite]
        matrix = np.column_stack([np.ones(finite.sum()), x - x.mean(axis=0)])
        if len(matrix) < count + 1 or np.linalg.matrix_rank(matrix) < count + 1:
            continue
        coefficients = np.linalg.lstsq(matrix, z, rcond=None)[0]
        residual = z - matrix @ coefficients
        freedom = len(matrix) - count - 1
        variance = np.nan
        if freedom:
            variance = shared * (residual @ residual) / freedom
        covariance = variance * np.linalg.inv(matrix.T @ matrix)[1:, 1:]
        slope = coefficients[1:]
        steepness = np.linalg.norm(slope)
        along = slope / (steepness or 1.0)
        angle_error = np.sqrt(along @ covariance @ along) / (1 + steepness**2)
        slope_error = np.sqrt(np.diag(covariance))
        angle = np.degrees([np.arctan(steepness), angle_error])
        intercept = coefficients[0] - slope @ x.mean(axis=0)
        out[at] = np.concatenate([slope, slope_error, [intercept], angle])
    return out


@takes_scene
def depth_average(
    scene: Scene,
    axis: str = "z",
    *,
    axes: str | None = None,
    width: float | str | None = None,
    kernel: KernelName | str | Kernel = "lucy",
    spacing: float | None = None,
    bounds: Mapping[str, Sequence[float]] | None = None,
    extent: Mapping[str, float] | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Integrate fields over the depth of a flow, as depth-averaged models of avalanches need them.

    Integrals of sums are exact, without a mesh along the axis (the kernel's marginal). One integral
    is a sum over nodes a quarter of the width apart, ``int rho u u dz`` with the smoothed velocity
    u along the axis: it gives the shape factor
    ``alpha_k = int rho u_k^2 dz int rho dz / (int rho u_k dz)^2``, and refers the stress to u. Lazy
    where the scene is.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    axis : str
        Across the base; it may not be periodic.
    axes : str, optional
        Resolved axes, by default all others of the scene; "" for one column.
    width, kernel, spacing, bounds, extent, on_error
        As in `coarse_grain`, of resolved and averaged axes.

    Returns
    -------
    xarray.Dataset
        (time, axes): ``mass_per_area``, ``int rho dz`` (kg/m2); ``thickness`` (m), the height of
        the free surface above the base (`free_surface` at half of the bulk's volume fraction), NaN
        without a surface; ``solid_depth``, ``int phi dz`` (m), the height of the grains without
        voids; ``momentum_per_area`` (component, kg/m/s);
        ``depth_averaged_velocity`` (component, m/s), their ratio; ``shape_factor`` (component), 1
        for a block, 4/3 for a linear profile from rest, 5/4 for Bagnold's; with contact forces also
        ``depth_stress``, ``int sigma dz`` (component, direction, N/m), ``earth_pressure``
        (component), its normal stresses over that across the base, and ``basal_traction``
        (component, Pa), the force of walls on the grains per area of the base: contacts with walls
        and with frozen grains (``frozen=`` of `xcg.open_scene`), so zero where a scene has neither.
        Sources: Savage & Hutter (1989), J. Fluid Mech. 199, 177; Bouchut & Westdickenberg (2004).

    Raises
    ------
    SceneError
        If the scene lacks velocities, or the axis is periodic.
    ValueError
        If an argument is wrong.

    Examples
    --------
    >>> import xcg
    >>> d = depth_average(xcg.datasets.random_scene(300, periodic="xy", walls=True), axes="x")
    >>> d.mass_per_area.dims
    ('time', 'x')
    """
    call = call_of("depth_average", locals())
    ds = scene.ds
    scene.require(("velocity", "mass"), "depth_average")
    plane = scene.setup.plane
    scene.setup.check_axis(axis)
    if axis in scene.setup.periodic:
        raise SceneError(
            f"depth_average along {axis!r}: the box is periodic there, and a flow has no depth "
            "along it"
        )
    if axes is None:
        axes = "".join(a for a in plane if a != axis)
    if axis in axes:
        raise ValueError(f"axes={axes!r}: the depth is along {axis!r}; resolve the others")
    smooth = kernel_of(kernel, width, scene.sizes, scene.setup.dimension)
    check("spacing", spacing, POSITIVE, "m", optional=True)
    spacings = dict.fromkeys(axes, float(spacing or smooth.width))
    lengths = {a: length for a, length in (extent or {}).items() if a not in axes}
    shared: dict[str, Any] = {"kernel": smooth, "bounds": bounds, "on_error": on_error}

    # integrals of sums, by the kernel's marginal
    names = ["density", "momentum_density", "volume_fraction"]
    if "contact_force" in scene.columns:
        names += ["stress", "boundary_force_density"]
    sums = coarse_grain(
        ds, names, axes=axes, spacing=spacings or None, extent=lengths | {axis: 1.0}, **shared
    )

    # the integral of rho u u and the free surface, from nodes along the axis
    profile = coarse_grain(
        ds,
        ["density", "momentum_density", "volume_fraction"],
        axes="".join(a for a in plane if a in axes + axis),
        spacing=spacings | {axis: 0.25 * smooth.width},
        extent=lengths or None,
        **shared,
    )
    surface = free_surface(profile, axis).drop_vars(SETUP)  # that of the sums holds
    thickness = surface["height"] - surface["base"]
    rows = _of_depth(sums, _transport(profile).integrate(axis), thickness, axis)
    data = labelled_table(rows, scene.setup.unit_system)
    result = with_time(xr.Dataset(data, attrs=sums.attrs))
    return result.assign_attrs(provenance(ds, call), depth_axis=axis)


def _of_depth(
    sums: xr.Dataset, transport: xr.DataArray, thickness: xr.DataArray, axis: str
) -> dict[str, tuple[xr.DataArray, str, str]]:
    """Return integrals over the depth with units and long names; `transport` is that of rho u u."""
    mass = sums["density"]
    momentum = sums["momentum_density"]
    velocity = momentum / mass.where(mass > 0)
    shape = _diagonal(transport) * mass / (momentum**2).where(momentum != 0)
    rows = {
        "mass_per_area": (mass, "kg m^-2", "mass per area"),
        "thickness": (thickness, "m", "height of the free surface above the base"),
        "solid_depth": (sums["volume_fraction"], "m", "volume of the grains per area"),
        "momentum_per_area": (momentum, "kg m^-1 s^-1", "momentum per area"),
        "depth_averaged_velocity": (velocity, "m s^-1", "depth-averaged velocity"),
        "shape_factor": (shape, "1", "shape factor of the velocity"),
    }
    if "stress" in sums:
        # the kinetic stress of the column is about its mean velocity, that of the flow about u
        # (without coordinates such as velocity: xarray computes lazy ones to compare them)
        stress = sums["stress"].reset_coords(drop=True) + _transport(sums) - transport
        normal = _diagonal(stress)
        across = normal.sel(component=axis, drop=True)
        pressure = normal / across.where(across != 0)
        traction = sums["boundary_force_density"]
        rows |= {
            "depth_stress": (stress, "N m^-1", "stress integrated over the depth"),
            "earth_pressure": (pressure, "1", f"normal stress over that along {axis}"),
            "basal_traction": (traction, "Pa", "force of walls on the grains per area"),
        }
    return rows


def _transport(f: xr.Dataset) -> xr.DataArray:
    """Return the transport of momentum by the mean flow, p p / rho, zero in empty nodes."""
    p = f["momentum_density"].reset_coords(drop=True)
    mass = f["density"]
    return (p * p.rename(component="direction") / mass.where(mass > 0)).fillna(0.0)


def _diagonal(tensor: xr.DataArray) -> xr.DataArray:
    """Return the diagonal of a tensor as a vector, its component last."""
    parts = [tensor.sel(component=a, direction=a, drop=True) for a in COMPONENTS]
    return xr.concat(parts, xr.Variable("component", list(COMPONENTS))).transpose(..., "component")
