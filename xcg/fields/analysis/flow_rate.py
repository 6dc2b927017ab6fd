"""Flow through surfaces: mass, number, volume, momentum and energy that cross planes, cylinders and triangles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import unknown
from xcg.fields.coarse_grain import coarse_grain
from xcg.fields.formulas.field import Sum
from xcg.fields.grids.frames import Rotated, axis_of
from xcg.fields.grids.walls import Plane, Surface, Wall
from xcg.fields.sums.kernels import Kernel, KernelName, kernel_of
from xcg.scene.conform import require_scene, takes_scene
from xcg.scene.description import Description, describe
from xcg.scene.schema import COMPONENTS, units_in
from xcg.steps.faults import OnError
from xcg.steps.labels import format_call, provenance

Flow: TypeAlias = Literal["mass", "number", "volume", "momentum", "energy"]
_UNITS = {"mass": "kg s^-1", "number": "s^-1", "volume": "m^3 s^-1", "momentum": "N", "energy": "W"}
_FINE = 0.25  # widths between the points of a quadrature


@takes_scene
def flow_rate(
    ds: xr.Dataset,
    surface: Wall,
    of: Flow | Sequence[Flow] = "mass",
    *,
    width: float | str | None = None,
    kernel: KernelName | str | Kernel = "lucy",
    spacing: float | None = None,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Rate at which mass, number, volume, momentum or energy crosses a surface; lazy where the scene is.

    ``Q = int sum_i m_i v_i Psi(r - r_i) . n dA`` over the surface, positive along its normal n; with 1, V_i, m_i v_i or
    the energy in place of m_i. Momentum takes the contact stress along, ``int sigma^c . n dA``, and energy the work of
    contacts, where the scene has contact forces. It is defined in each step, and its integral over time is what
    crossed, up to what the kernel holds on both sides.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    surface : Plane, Cylinder or Surface
        A plane without `bounds` is taken whole, exactly: ``sum_i m_i (v_i . n) psi_1((r_i - r_0) . n)``, psi_1 the
        kernel's marginal along n, along periodic axes over one period. Planes with `bounds`, the side of a cylinder
        between `low` and `high` and triangles are sums over points, see `spacing`.
    of : str or list of str
        "mass", "number", "volume", "momentum", "energy".
    width : float or str, optional
        Half-width w of the kernel (m), or a multiple of a size such as "0.75 d43" (the default).
    kernel : str or Kernel
        As in `coarse_grain`.
    spacing : float, optional
        Distance of the points on a part of a plane, a cylinder or triangles (m), a quarter of the width by default: the
        rate is then right to 1e-3 of that through the support of one grain.
    by, groups
        As in `coarse_grain`: adds the dimension ``phase``.
    on_error : {"raise", "skip"}
        As in `coarse_grain`.

    Returns
    -------
    xarray.Dataset
        ``mass_flow_rate`` (kg/s), ``number_flow_rate`` (1/s), ``volume_flow_rate`` (m3/s), ``momentum_flow_rate``
        (component, N) and ``energy_flow_rate`` (W), those asked for; (time) or (time, phase). Without contact forces
        the last two are carried by the particles alone, and their attribute ``comment`` says so.

    Raises
    ------
    SceneError
        If the scene lacks velocities or what is asked for, or a plane does not close in a periodic box.
    ValueError
        If an argument is wrong.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.random_scene(200)
    >>> flow_rate(ds, xcg.Plane((0, 0, 1.5), (0, 0, 1))).mass_flow_rate.dims
    ('time',)
    """
    if not isinstance(surface, Wall):
        raise ValueError(f"surface={surface!r}: expected an xcg.Plane, xcg.Cylinder or xcg.Surface")
    wanted: list[Any] = [of] if isinstance(of, str) else list(of)
    for one in wanted:
        if one not in get_args(Flow):
            raise ValueError(unknown("flow", one, get_args(Flow)))
    call = format_call("flow_rate", {"surface": surface, "of": of, "width": width, "kernel": kernel, "by": by})
    require_scene(ds, ("velocity",), "flow_rate")
    scene = describe(ds)
    smooth = kernel_of(kernel, width, scene.sizes, scene.setup.dimension)
    if "momentum" in wanted:
        other = ds["velocity"].rename(component="direction")
        ds = ds.assign(velocity_squared=(ds["velocity"] * other).assign_attrs(units=units_in("m^2 s^-2", "SI")))
    fields = [field for one in wanted for field in _fields(one, scene)]
    shared = {"kernel": smooth, "by": by, "groups": groups, "on_error": on_error}
    if isinstance(surface, Plane) and surface.bounds is None:
        flux = _through_plane(ds, scene, surface, fields, shared)
    else:
        flux = _through_points(ds, scene, surface, fields, shared, smooth.width * _FINE if spacing is None else spacing)
    found = {f"{one}_flow_rate": _labelled(sum(flux[_name(f)] for f in _fields(one, scene)), one, ds) for one in wanted}
    result = xr.Dataset(found).drop_vars([*COMPONENTS, "direction"], errors="ignore")  # where the plane is
    return result.assign_attrs(
        provenance(ds, call), kernel=smooth.name, width=smooth.width, cutoff=smooth.cutoff, surface=repr(surface)
    )


def _fields(flow: Flow, scene: Description) -> list[str | Sum]:
    """Densities of the flux of a quantity, whose last axis is that of the surface's normal."""
    if flow == "momentum":
        contacts = ["contact_stress"] if "contact_force" in scene.columns else []
        return [Sum("velocity_squared", "mass", "momentum_transport"), *contacts]
    if flow == "energy":
        return ["kinetic_energy_flux", *(["contact_energy_flux"] if "contact_force" in scene.columns else [])]
    return [Sum("velocity", flow, f"{flow}_transport")]


def _name(field: str | Sum) -> str:
    return field if isinstance(field, str) else str(field.name)


def _labelled(rate: Any, flow: Flow, ds: xr.Dataset) -> xr.DataArray:
    found: xr.DataArray = rate
    units = units_in(_UNITS[flow], str(ds.attrs.get("unit_system", "SI")))
    found = found.drop_attrs(deep=False).assign_attrs(units=units, long_name=f"flow rate of {flow} along the normal")
    if flow in ("momentum", "energy") and "contact_force" not in ds:
        found.attrs["comment"] = "carried by particles alone, as the scene holds no contact forces"
    return found


def _across(flux: xr.Dataset, normal: NDArray) -> xr.Dataset:
    """Parts of vectors and tensors along a normal (..., 3), which is that of their last axis."""
    found = {}
    for name, values in flux.data_vars.items():
        dim = "direction" if "direction" in values.dims else "component"
        dims = ("place", dim) if normal.ndim == 2 else (dim,)
        found[name] = (values * xr.Variable(dims, normal)).sum(dim, skipna=False)
    return xr.Dataset(found, flux.drop_dims("direction", errors="ignore").coords)


def _depth(scene: Description) -> float:
    """Thickness of a scene of one layer (m), 1 in three dimensions: fields are per volume."""
    depth = scene.layer_depth
    return scene.edges[depth][1] - scene.edges[depth][0] if isinstance(depth, str) else 1.0 if depth is None else depth


def _through_plane(
    ds: xr.Dataset, scene: Description, surface: Plane, fields: list[Any], shared: dict[str, Any]
) -> xr.Dataset:
    """Integrals over a whole plane, by the marginal of the kernel: averages times their extents of 1 m."""
    normal = surface.normals_at(np.zeros((1, 3)))[0]
    k, plane, turn = axis_of(normal), scene.setup.plane, np.eye(3)
    if k is not None:
        at, options = {COMPONENTS[k]: float(surface.point[k])}, dict[str, Any]()
    else:
        across = [a for a in COMPONENTS if a not in plane]
        along = "z" if not across else plane[0]
        frame = Rotated(**{along: normal.tolist(), **{a: np.eye(3)[COMPONENTS.index(a)].tolist() for a in across}},
                        origin=surface.point)  # fmt: skip
        at, options, turn = {along: 0.0}, {"frame": frame}, np.asarray(frame.axes)
    here = next(iter(at))
    extent = {a: 1.0 for a in plane if a != here}
    flux = coarse_grain(ds, fields, axes="", at=at, extent=extent, **options, **shared) * _depth(scene)
    toward = turn @ normal  # the normal in the axes of the fields
    flux = _across(flux, toward)
    if k is None and "momentum_transport" in flux:  # back to the axes of the scene
        back = xr.DataArray(turn, dims=("component", "own"))
        for name in {"momentum_transport", "contact_stress"} & {*map(str, flux.data_vars)}:
            turned = xr.dot(flux[name].drop_vars("component"), back, dim="component").rename(own="component")
            flux = flux.assign({name: turned.assign_coords(component=list(COMPONENTS))})
    return flux


def _through_points(
    ds: xr.Dataset, scene: Description, surface: Wall, fields: list[Any], shared: dict[str, Any], spacing: float
) -> xr.Dataset:
    """Sum over points of the surface, each with its share of the area."""
    centre, area = _points(surface, scene, spacing)
    at = {a: xr.DataArray(centre[:, COMPONENTS.index(a)], dims="place") for a in scene.setup.plane}
    flux = coarse_grain(ds, fields, at=at, **shared)
    found = _across(flux, surface.normals_at(centre)) * xr.Variable("place", area)
    return found.sum("place", skipna=False)


def _points(surface: Wall, scene: Description, spacing: float) -> tuple[NDArray, NDArray]:
    """Centres (n, 3) and areas (n,) of small cells of a surface; of triangles that are divided until they are small."""
    if not isinstance(surface, Surface):
        lower, upper = np.array(scene.corners if scene.corners is not None else np.full((2, 3), np.nan))
        cells = surface.cells(lower, upper, spacing)
        return cells.centre, cells.area
    centres, areas = [], []
    for a, b, c in surface.corners:
        longest = max(np.linalg.norm(one - other) for one, other in ((a, b), (b, c), (c, a)))
        count = max(1, int(np.ceil(longest / spacing)))
        i, j = (m.ravel() for m in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
        upright, turned = i + j < count, i + j < count - 1
        share = np.concatenate([np.stack([i, j], 1)[upright] + 1 / 3, np.stack([i, j], 1)[turned] + 2 / 3]) / count
        centres.append(a + share[:, :1] * (b - a) + share[:, 1:] * (c - a))
        areas.append(np.full(len(share), 0.5 * np.linalg.norm(np.cross(b - a, c - a)) / count**2))
    return np.concatenate(centres), np.concatenate(areas)
