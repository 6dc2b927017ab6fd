"""Rates of flow through planes, cylinders and triangles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.analysis.surfaces import attrs_of, check_surface, open_ends, small_cells
from xcg.common.checks import POSITIVE, check
from xcg.common.compat import is_in_memory
from xcg.common.messages import unknown
from xcg.fields.coarse_grain import coarse_grain
from xcg.fields.formulas.field import Sum
from xcg.fields.grids.frames import Rotated, axis_of
from xcg.fields.grids.grid import warn_beyond
from xcg.fields.grids.walls import Plane, Wall
from xcg.fields.sums.kernels import Kernel, KernelName, kernel_of
from xcg.scene.conform import takes_scene
from xcg.scene.facts import SETUP
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, ROTATION, Frame, Variable, units_in
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.faults import OnError
from xcg.steps.labels import call_of, provenance

Flow: TypeAlias = Literal["mass", "number", "volume", "momentum", "energy"]
_UNITS = {"mass": "kg s^-1", "number": "s^-1", "volume": "m^3 s^-1", "momentum": "N", "energy": "W"}
_FINE = 0.25  # widths between the points of a quadrature


@takes_scene
def flow_rate(
    scene: Scene,
    surface: Wall,
    quantities: Flow | Sequence[Flow] = "mass",
    *,
    width: float | str | None = None,
    kernel: KernelName | str | Kernel = "lucy",
    spacing: float | None = None,
    by: str | None = None,
    groups: Sequence[int] | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Compute the rate at which mass, number, volume, momentum or energy crosses a surface.

    ``Q = int sum_i m_i v_i Psi(r - r_i) . n dA`` over the surface, positive along its normal n;
    with 1, V_i, m_i v_i or the energy in place of m_i. Momentum takes the contact stress along,
    ``int sigma^c . n dA``, and energy the work of contacts, where the scene has contact forces. It
    is defined in each step, and its integral over time is what crossed, up to what the kernel holds
    on both sides. Lazy where the scene is.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene.
    surface : Plane, Cylinder or Surface
        A plane without `bounds` is taken whole, exactly:
        ``sum_i m_i (v_i . n) psi_1((r_i - r_0) . n)``, psi_1 the kernel's marginal along n, along
        periodic axes over one period. Planes with `bounds`, the side of a cylinder between `low`
        and `high` and triangles are sums over points, see `spacing`. In a scene of one layer,
        planes and cylinders across it count within its thickness.
    quantities : str or list of str
        "mass", "number", "volume", "momentum", "energy".
    width : float or str, optional
        Half-width w of the kernel (m), or a multiple of a size such as "0.75 d43" (the default).
    kernel : str or Kernel
        As in `coarse_grain`.
    spacing : float, optional
        Distance of the points on a part of a plane, a cylinder or triangles (m), a quarter of the
        width by default: the rate is then right to 1e-3 of that through the support of one grain.
    by, groups
        As in `coarse_grain`: adds the dimension ``phase``.
    on_error : {"raise", "skip"}
        As in `coarse_grain`.

    Returns
    -------
    xarray.Dataset
        ``mass_flow_rate`` (kg/s), ``number_flow_rate`` (1/s), ``volume_flow_rate`` (m3/s),
        ``momentum_flow_rate`` (component, N) and ``energy_flow_rate`` (W), those asked for; (time)
        or (time, phase). Without contact forces the last two are carried by the particles alone,
        without angular velocities energy is without rotation, and their attribute ``comment`` says
        so.

    Raises
    ------
    SceneError
        If the scene lacks velocities or what is asked for, or a plane does not close in a periodic
        box.
    ValueError
        If an argument is wrong.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.random_scene(200)
    >>> flow_rate(ds, xcg.Plane((0, 0, 1.5), (0, 0, 1))).mass_flow_rate.dims
    ('time',)
    """
    call = call_of(
        "flow_rate",
        {"surface": surface, "quantities": quantities, "width": width, "kernel": kernel, "by": by},
    )
    check_surface(surface)
    if isinstance(quantities, str):
        quantities = [quantities]
    for flow in quantities:
        if flow not in get_args(Flow):
            raise ValueError(unknown("flow", flow, get_args(Flow)))
    check("spacing", spacing, POSITIVE, "m", optional=True)
    scene.require(("velocity",), "flow_rate")
    smooth = kernel_of(kernel, width, scene.sizes, scene.setup.dimension)
    if "momentum" in quantities:
        velocity = scene.ds["velocity"]
        squared = velocity * velocity.rename(component="direction")
        squared.attrs["units"] = units_in("m^2 s^-2", "SI")
        scene = Scene(scene.ds.assign(velocity_squared=squared))
    parts = {flow: _parts_of(flow, scene) for flow in quantities}
    fields = [field for of_flow in parts.values() for field in of_flow]
    shared = {"kernel": smooth, "by": by, "groups": groups, "on_error": on_error}
    if isinstance(surface, Plane) and surface.bounds is None:
        flux = _through_plane(scene, surface, fields, shared)
    else:
        distance = float(spacing or smooth.width * _FINE)
        flux = _through_points(scene, surface, fields, shared, distance)
    rates = {f"{flow}_flow_rate": _rate(flux, flow, parts[flow], scene) for flow in quantities}
    result = xr.Dataset(rates)
    # the position of the plane, and the options of fields
    result = result.drop_vars([*COMPONENTS, "direction", "width", SETUP], errors="ignore")
    return result.assign_attrs(provenance(scene.ds, call) | attrs_of(smooth, surface))


def _parts_of(flow: Flow, scene: Scene) -> list[str | Sum]:
    """Densities of the flux of a quantity, whose last axis is that of the surface's normal."""
    if flow == "momentum":
        carried: str | Sum = Sum("velocity_squared", "mass", "momentum_transport")
        by_contacts = "contact_stress"
    elif flow == "energy":
        carried = "kinetic_energy_flux"
        by_contacts = "contact_energy_flux"
    else:
        return [Sum("velocity", flow, f"{flow}_transport")]
    if "contact_force" in scene.columns:
        return [carried, by_contacts]
    return [carried]


def _rate(flux: xr.Dataset, flow: Flow, parts: Sequence[str | Sum], scene: Scene) -> xr.DataArray:
    """Add up the parts of a flow, and label their sum."""
    names = [getattr(part, "name", part) for part in parts]
    rate = sum((flux[name] for name in names[1:]), start=flux[names[0]]).drop_attrs(deep=False)
    rate.attrs["units"] = units_in(_UNITS[flow], scene.setup.unit_system)
    rate.attrs["long_name"] = f"flow rate of {flow} along the normal"
    rate.attrs["source"] = "velocity"  # a sum over particles, which averages take as it is
    comments = []
    if flow in ("momentum", "energy") and "contact_force" not in scene.columns:
        comments.append("carried by particles alone, as the scene holds no contact forces")
    missing = [name for name in ROTATION if name not in scene.columns]
    if flow == "energy" and missing:
        comments.append(f"without rotation, as the scene holds no {' and no '.join(missing)}")
    if comments:
        rate.attrs["comment"] = "; ".join(comments)
    return rate


def _across(flux: xr.Dataset, normal: NDArray) -> xr.Dataset:
    """Contract the last axis of vectors and tensors with a normal, (3,) or (places, 3)."""
    contracted = {}
    for name, values in flux.data_vars.items():
        dim = "component"
        if "direction" in values.dims:
            dim = "direction"
        factor = xr.Variable(("place", dim)[-normal.ndim :], normal)
        contracted[name] = (values * factor).sum(dim, skipna=False)
    return xr.Dataset(contracted, flux.drop_dims("direction", errors="ignore").coords)


def _depth(scene: Scene) -> float:
    """Thickness of a scene of one layer (m), 1 in three dimensions: fields are per volume."""
    depth = scene.layer_depth
    if depth is None:
        return 1.0
    if isinstance(depth, str):
        low, high = scene.edges[depth]
        return high - low
    return depth


def _through_plane(
    scene: Scene, surface: Plane, fields: list[Any], shared: dict[str, Any]
) -> xr.Dataset:
    """Integrate over a whole plane by the marginal of the kernel: averages over extents of 1 m."""
    normal = surface.normals_at(np.zeros((1, 3)))[0]
    k = axis_of(normal)
    plane = scene.setup.plane
    if k is not None:
        at = {COMPONENTS[k]: float(surface.point[k])}
        extent = {a: 1.0 for a in plane if a not in at}
        flux = coarse_grain(scene.ds, fields, axes="", at=at, extent=extent, **shared) * _depth(
            scene
        )
        return _across(flux, normal)
    # rotated axes: one is the normal, and the axis across a scene of one layer stays
    along = "z"
    axes = {}
    if scene.setup.dimension == 2:
        along = plane[0]
        (across,) = {0, 1, 2} - set(scene.setup.axes)
        axes[COMPONENTS[across]] = np.eye(3)[across].tolist()
    axes[along] = normal.tolist()
    frame = Rotated(**axes, origin=surface.point)
    rotation = np.asarray(frame.axes)
    extent = {a: 1.0 for a in plane if a != along}
    at = {along: 0.0}
    flux = coarse_grain(scene.ds, fields, axes="", at=at, extent=extent, frame=frame, **shared)
    flux = _across(flux * _depth(scene), rotation @ normal)
    # momentum back to the axes of the scene
    back = xr.DataArray(rotation, dims=("component", "of_scene"))
    for name in ("momentum_transport", "contact_stress"):
        if name in flux:
            turned = xr.dot(flux[name].drop_vars("component"), back, dim="component")
            turned = turned.rename(of_scene="component")
            flux = flux.assign({name: turned.assign_coords(component=list(COMPONENTS))})
    return flux


def _through_points(
    scene: Scene,
    surface: Wall,
    fields: list[Any],
    shared: dict[str, Any],
    spacing: float,
) -> xr.Dataset:
    """Sum over points of the surface, each with its share of the area."""
    cells = small_cells(surface, scene, spacing)
    centre = cells.centre
    at = {a: xr.DataArray(centre[:, COMPONENTS.index(a)], dims="place") for a in scene.setup.plane}
    flux = _across(coarse_grain(scene.ds, fields, at=at, **shared), surface.normals_at(centre))
    flux = (flux * xr.Variable("place", cells.area)).sum("place", skipna=False)
    ends = open_ends(surface, cells, scene)
    if not ends or is_in_memory(scene.columns["position"]):
        return flux
    analysis = _Ends(surface, ends, shared["kernel"].cutoff)
    checked = run(scene, analysis, on_error=shared["on_error"])
    return flux + checked["beyond"].reset_coords(drop=True)


@dataclass(frozen=True, eq=False)
class _Ends(FrameAnalysis):
    """Warning about grains beyond the ends of a surface, which follow from the first and the last step."""

    name = "flow_rate"

    surface: Wall
    ends: Mapping[str, tuple[float, float]]
    cutoff: float

    def reads(self, scene: Scene) -> list[str]:
        """Return the positions."""
        return ["position"]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return a zero for each step, which is added to its flow."""
        return {"beyond": Variable((), "1", "zero, once the step is checked")}

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, ArrayLike]:
        """Warn of grains of one step that the surface would see if it were longer."""
        position = frame["position"]
        near = position[np.abs(self.surface.distance(position)) < self.cutoff]
        if len(near):
            coordinates = self.surface.coordinates(near).T
            for (dim, (low, high)), x in zip(self.ends.items(), coordinates, strict=True):
                warn_beyond(dim, x, low, high, source)
        return {"beyond": 0.0}
