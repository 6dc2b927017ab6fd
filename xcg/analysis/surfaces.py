"""Fields at surfaces: flow through planes, cylinders and triangles, traction of grains on walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.common.checks import POSITIVE, axis_vector, check
from xcg.common.compat import is_in_memory
from xcg.common.messages import unknown, warn_once
from xcg.fields.coarse_grain import coarse_grain
from xcg.fields.formulas.field import Sum
from xcg.fields.grids.frames import Rotated, axis_of
from xcg.fields.grids.grid import warn_beyond
from xcg.fields.grids.walls import Cylinder, Plane, Surface, SurfaceCells, Wall
from xcg.fields.sums.kernels import Kernel, KernelName, kernel_of
from xcg.scene.conform import takes_scene
from xcg.scene.contacts import Contacts, Walls, select_walls
from xcg.scene.facts import SETUP
from xcg.scene.frame import without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, ROTATION, Frame, Variable, units_in
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.faults import OnError
from xcg.steps.labels import annotated, call_of, provenance

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
    _check_surface(surface)
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
    # the place of the plane, and the options of fields
    result = result.drop_vars([*COMPONENTS, "direction", "width", SETUP], errors="ignore")
    return result.assign_attrs(provenance(scene.ds, call) | _attrs_of(smooth, surface))


def _attrs_of(kernel: Kernel, surface: Wall) -> dict[str, Any]:
    return {
        "kernel": kernel.name,
        "width": kernel.width,
        "cutoff": kernel.cutoff,
        "surface": repr(surface),
    }


def _check_surface(surface: object) -> None:
    if not isinstance(surface, Wall):
        raise ValueError(f"surface={surface!r}: expected an xcg.Plane, xcg.Cylinder or xcg.Surface")


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
    cells = _points(surface, scene, spacing)
    centre = cells.centre
    at = {a: xr.DataArray(centre[:, COMPONENTS.index(a)], dims="place") for a in scene.setup.plane}
    flux = _across(coarse_grain(scene.ds, fields, at=at, **shared), surface.normals_at(centre))
    flux = (flux * xr.Variable("place", cells.area)).sum("place", skipna=False)
    ends = _open_ends(surface, cells, scene)
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
            places = self.surface.coordinates(near).T
            for (dim, (low, high)), x in zip(self.ends.items(), places, strict=True):
                warn_beyond(dim, x, low, high, source)
        return {"beyond": 0.0}


def _open_ends(surface: Wall, cells: SurfaceCells, scene: Scene) -> dict[str, tuple[float, float]]:
    """Return the ends of the cells along dimensions for which neither the surface nor a period has any."""
    has_bounds = getattr(surface, "bounds", None) is not None
    has_ends = None not in (getattr(surface, "low", None), getattr(surface, "high", None))
    if has_bounds or has_ends:
        return {}
    dims = [*cells.coords][-len(cells.bounds) :]
    ends = dict(zip(dims, map(tuple, cells.bounds), strict=False))
    if isinstance(surface, Cylinder):
        k = axis_of(axis_vector("axis", surface.axis))
        if k is not None and COMPONENTS[k] in scene.periods:
            return {}
        return ends
    return {dim: end for dim, end in ends.items() if dim not in scene.periods}


def _points(surface: Wall, scene: Scene, spacing: float) -> SurfaceCells:
    """Return small cells of a surface."""
    if isinstance(surface, Surface):
        return SurfaceCells({}, *_parts_of_triangles(surface, spacing), COMPONENTS)
    corners = np.full((2, 3), np.nan)
    if scene.corners is not None:
        corners = np.array(scene.corners)
    lower, upper = corners
    for a in scene.periods:
        k = COMPONENTS.index(a)
        lower[k], upper[k] = scene.edges[a]
    layer = scene.layer
    if layer is None:
        return surface.cells(lower, upper, spacing)
    # fields are the same all across a layer, so that only the part of the surface inside counts
    k, lower[k], upper[k] = layer
    cells = surface.cells(lower, upper, spacing)
    faces = np.where(np.arange(3) == k, corners, lower)
    ends = np.sort(surface.coordinates(faces), axis=0)
    inside = 1.0
    for (first, last), (low, high) in zip(cells.bounds, ends.T, strict=True):
        if np.isclose(high - low, upper[k] - lower[k], atol=0.0):
            inside = max(0.0, min(last, high) - max(first, low)) / (last - first)
    return replace(cells, area=cells.area * inside)


def _parts_of_triangles(surface: Surface, spacing: float) -> tuple[NDArray, NDArray]:
    """Centres (n, 3) and areas (n,) of equal parts of triangles, no wider than `spacing`."""
    centres = []
    areas = []
    for a, b, c in surface.corners:
        longest = max(np.linalg.norm(edge) for edge in (b - a, c - b, a - c))
        count = max(1, int(np.ceil(longest / spacing)))
        grid = np.indices((count, count)).reshape(2, -1).T
        upright = grid.sum(axis=1) < count
        turned = grid.sum(axis=1) < count - 1
        share = np.concatenate([grid[upright] + 1 / 3, grid[turned] + 2 / 3]) / count
        centres.append(a + share[:, :1] * (b - a) + share[:, 1:] * (c - a))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a)) / count**2
        areas.append(np.full(len(share), area))
    return np.concatenate(centres), np.concatenate(areas)


# --- traction on walls ----------------------------------------------------------------------------


_NEEDS = ("contact_i", "contact_j", "contact_force", "contact_point")


@takes_scene
def wall_stress(
    scene: Scene,
    surface: Wall,
    width: float | str | None = None,
    *,
    walls: Walls | None = None,
    kernel: KernelName | str | Kernel = "lucy",
    spacing: float | None = None,
    within: float | None = None,
    on_error: OnError = "raise",
) -> xr.Dataset:
    """Traction of the grains on a wall, as a field on its surface; lazy where the scene is.

    The force of each contact with a wall is smeared over the cells of the surface by the kernel,
    ``t_k = sum_c w_ck F_c / A_k`` with ``w_ck = Psi(x_k - c) A_k / sum_l Psi(x_l - c) A_l``: cells
    at x_k of area A_k, distances through space, in a scene of one layer within its plane. Weights
    of a contact add up to one, also at the rim, so that the sum of traction times area is the sum
    of the forces. Where a cell is larger than the support, the nearest one takes the whole force.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    surface : Plane, Cylinder or Surface
        The wall, with its normal to the side of the grains. Cells of a plane without `bounds` and
        of a cylinder without `low` or `high` end as far as the grains of the first and the last
        step reach, and the attribute ``comment`` says where.
    width : float or str, optional
        Half-width w of the kernel (m), or a multiple of a size such as "0.75 d43" (the default).
    walls : str, int or list of these, optional
        Walls whose contacts are taken, by name or number, see `select_walls`; by default all,
        frozen grains among them. At edges, where contacts with one wall are near another, say
        which.
    kernel : str or Kernel
        As in `coarse_grain`.
    spacing : float, optional
        Size of the cells of a plane or cylinder (m), half the width by default. A `Surface` has its
        triangles.
    within : float, optional
        Distance of contact points from the surface up to which they are taken (m), the width by
        default.
    on_error : {"raise", "skip"}
        As in `coarse_grain`.

    Returns
    -------
    xarray.Dataset
        On the cells, (time, theta, z) of a cylinder, (time, x, y) or (time, u, v) of a plane,
        (time, triangle) of a surface, in Pa:

        - ``normal_traction``, the force of the grains on the wall against its normal: positive in
          compression,
        - ``shear_traction`` (..., along), the force of the grains on the wall along the surface's
          axes: the axes of the cells, or x, y, z of a surface,
        - ``traction`` (..., component), the force of the grains on the wall.

        Of each step: ``wall_force`` (component), the sum of the forces that were taken (N), and
        ``wall_contacts``, their number. ``area`` is a coordinate. Parts across and along the wall
        are taken where the grain touches, before smearing, so each of the three adds up to its own
        sum of forces; on curved walls they differ from parts of ``traction`` by the turn of the
        normal within the support, (w / R)^2.

    Raises
    ------
    SceneError
        If the scene has no contacts.
    ValueError
        If an argument is wrong.

    Examples
    --------
    >>> import xcg
    >>> ds = xcg.datasets.random_scene(200, walls=True, periodic="xy")
    >>> f = wall_stress(ds, xcg.Plane(point=(0, 0, 0), normal=(0, 0, 1)))
    >>> f.normal_traction.dims
    ('time', 'x', 'y')
    """
    call = call_of(
        "wall_stress", {"surface": surface, "width": width, "walls": walls, "within": within}
    )
    scene.require(_NEEDS, "wall_stress")
    _check_surface(surface)
    check("spacing", spacing, POSITIVE, "m", optional=True)
    check("within", within, POSITIVE, "m", optional=True)
    if walls is not None:
        scene = Scene(select_walls(scene.ds, walls))
    smooth = kernel_of(kernel, width, scene.sizes, 2)
    low, high = _box_of_grains(scene)
    cells = surface.cells(low, high, float(spacing or smooth.width / 2))
    analysis = _WallStress(surface, cells, smooth, float(within or smooth.width))
    return run(scene, analysis, call=call, on_error=on_error)


def _box_of_grains(scene: Scene) -> tuple[NDArray, NDArray]:
    """Lowest and highest corners (3,) of the grains, or of the period or layer along its axes."""
    if scene.corners is None:
        low, high = np.array([scene.edges.get(a, (0.0, 0.0)) for a in COMPONENTS]).T
    else:
        low, high = map(np.array, scene.corners)
    radius = 0.5 * scene.sizes.get("dmax", 0.0)
    low = low - radius
    high = high + radius
    for a in scene.periods:
        k = COMPONENTS.index(a)
        low[k], high[k] = scene.edges[a]
    if scene.layer is not None:
        k, low[k], high[k] = scene.layer
    return low, high


@dataclass(frozen=True, eq=False)
class _WallStress(FrameAnalysis):
    """Traction of the grains on the cells of a surface."""

    name = "wall_stress"
    optional = ("diameter", "frozen")

    surface: Wall
    cells: SurfaceCells
    kernel: Kernel
    within: float

    def reads(self, scene: Scene) -> list[str]:
        """Return the positions and contacts."""
        return ["position", *_NEEDS]

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return tractions on the cells, and the sum and number of the forces of a step."""
        nodes = tuple(self.cells.coords)
        return {
            "normal_traction": Variable(
                nodes, "Pa", "normal traction of the grains on the wall, compression positive"
            ),
            "shear_traction": Variable(
                (*nodes, "along"), "Pa", "shear traction of the grains on the wall"
            ),
            "traction": Variable((*nodes, "component"), "Pa", "traction of the grains on the wall"),
            "wall_force": Variable(("component",), "N", "force of the grains on the wall"),
            "wall_contacts": Variable((), "1", "number of contacts with the wall", "int64"),
        }

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return places and areas of the cells, and the axes of shear."""
        return _coordinates(self.cells, self.setup.unit_system)

    def attrs(self, scene: Scene) -> dict[str, Any]:
        """Return kernel and surface, and where the cells end if the surface goes on."""
        attrs = _attrs_of(self.kernel, self.surface)
        ends = [
            f"{dim} from {low:.6g} to {high:.6g}"
            for dim, (low, high) in _open_ends(self.surface, self.cells, scene).items()
        ]
        if ends:
            attrs["comment"] = (
                f"the surface goes on beyond its cells, which end where the grains do: {', '.join(ends)}; "
                "bounds= of a plane, low= and high= of a cylinder set their ends"
            )
        return attrs

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, ArrayLike]:
        """Compute the tractions of one step."""
        _, point, force = Contacts.of(without_frozen(frame), lattice, source).at_walls
        point, force = _over_surface(self, point, -force, lattice, source)
        if not len(point):
            warn_once(
                "wall stress",
                f"{source}: no contact with a wall is within {self.within:.3g} m of {self.surface!r}",
            )
        normal, along = self.surface.in_surface(point, force)
        smeared = _smear(self, point, np.column_stack([-normal, along, force]), lattice)
        shape = self.cells.shape
        axes = len(self.cells.axes)
        return {
            "normal_traction": smeared[:, 0].reshape(shape),
            "shear_traction": smeared[:, 1 : 1 + axes].reshape(*shape, axes),
            "traction": smeared[:, 1 + axes :].reshape(*shape, 3),
            "wall_force": force.sum(axis=0),
            "wall_contacts": len(force),
        }

    def after(self, result: xr.Dataset, ds: xr.Dataset) -> xr.Dataset:
        """Mark sums over contacts, which averages take as they are."""
        for values in result.data_vars.values():
            values.attrs["source"] = "contact_force"
        return result


def _over_surface(
    task: _WallStress, point: NDArray, force: NDArray, lattice: Lattice, source: str
) -> tuple[NDArray, ...]:
    """Return points and forces of contacts near the cells, as the images nearest to the surface."""
    if not len(point):
        return point, force
    surface = task.surface
    cells = task.cells
    shifts = _shifts(lattice, 1)
    images = (point + shifts[:, None]).reshape(-1, 3)
    apart = np.abs(surface.distance(images)).reshape(len(shifts), -1)
    distance = np.where(surface.covers(images, cells).reshape(apart.shape), apart, np.inf)
    nearest = np.argmin(distance, axis=0)
    near = distance.min(axis=0) <= task.within
    beyond = ~near & (apart <= task.within).any(axis=0)
    is_bounded = any(getattr(surface, end, None) is not None for end in ("bounds", "low", "high"))
    if beyond.any() and not is_bounded:
        dims = [*cells.coords][-len(cells.bounds) :]
        places = surface.coordinates(point[beyond]).T
        for a, x, (low, high) in zip(dims, places, cells.bounds, strict=True):
            if a not in task.setup.periodic:
                warn_beyond(a, x, low, high, source, what="contacts with the wall")
    return (point + shifts[nearest])[near], force[near]


def _shifts(lattice: Lattice, count: int) -> NDArray:
    """Return shifts (n, 3) by up to `count` periods, zero first."""
    numbers = [0.0]
    for n in range(1, count + 1):
        numbers += [-float(n), float(n)]
    basis = lattice.basis
    return np.array(list(product(numbers, repeat=len(basis)))) @ basis


def _smear(task: _WallStress, point: NDArray, values: NDArray, lattice: Lattice) -> NDArray:
    """Sum over contacts weights (cells, contacts) times values (contacts, n), per area."""
    from scipy.spatial import cKDTree  # slow to import

    cells = task.cells
    cutoff = task.kernel.cutoff
    out = np.zeros((len(cells.area), values.shape[1]))
    if not len(point):
        return out
    in_plane = np.array([float(a in task.setup.plane) for a in COMPONENTS])  # alike across a layer
    tree = cKDTree(cells.centre * in_plane)
    pairs_of_shifts = []
    for shift in _shifts(lattice, int(np.ceil(cutoff / lattice.closest[0]))):
        images = cKDTree((point + shift) * in_plane)
        pairs = tree.sparse_distance_matrix(images, cutoff, output_type="ndarray")
        pairs_of_shifts.append(pairs)
    cell = np.concatenate([pairs["i"] for pairs in pairs_of_shifts])
    contact = np.concatenate([pairs["j"] for pairs in pairs_of_shifts])
    distance = np.concatenate([pairs["v"] for pairs in pairs_of_shifts])
    weight = task.kernel.value(distance) * cells.area[cell]
    total = np.bincount(contact, weight, len(point))
    alone = np.flatnonzero(total <= 0)
    weight[total[contact] <= 0] = 0.0  # below zero where the kernel is
    # the nearest cell takes the whole force of a contact without a cell in reach
    cell = np.concatenate([cell, tree.query(point[alone])[1]])
    contact = np.concatenate([contact, alone])
    weight = np.concatenate([weight, np.ones(len(alone))])
    total[alone] = 1.0
    np.add.at(out, cell, (weight / total[contact])[:, None] * values[contact])
    return out / cells.area[:, None]


def _coordinates(cells: SurfaceCells, system: str) -> dict[str, xr.Variable]:
    """Return places and areas of the cells, and the axes of shear."""
    metre = units_in("m", system)
    units = {"theta": "rad", "triangle": "1"}
    coords: dict[str, xr.Variable] = {}
    for dim, (values, text) in cells.coords.items():
        coords[dim] = annotated(dim, values, units.get(dim, metre), text)
    dims = tuple(cells.coords)
    area = cells.area.reshape(cells.shape)
    coords["area"] = annotated(dims, area, units_in("m^2", system), "area of the cell")
    centre = cells.centre.reshape(*cells.shape, 3)
    coords["centre"] = annotated((*dims, "component"), centre, metre, "centre of the cell")
    coords["along"] = xr.Variable("along", list(cells.axes))
    return coords
