"""Fields at surfaces: the flow through planes, cylinders and triangles, and the traction of grains on walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_positive
from xcg.common.messages import unknown, warn_once
from xcg.fields.coarse_grain import coarse_grain
from xcg.fields.formulas.field import Sum
from xcg.fields.grids.frames import Rotated, axis_of
from xcg.fields.grids.grid import warn_beyond
from xcg.fields.grids.walls import Plane, Surface, SurfaceCells, Wall
from xcg.fields.sums.kernels import Kernel, KernelName, kernel_of
from xcg.scene.conform import require_scene, storable, takes_scene
from xcg.scene.contacts import Contacts, Walls, select_walls
from xcg.scene.description import Description, describe
from xcg.scene.facts import SETUP
from xcg.scene.frame import steps_in, without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, OF_STEP, ROTATION, Setup, Variable, units_in
from xcg.steps.faults import OnError
from xcg.steps.labels import format_call, label, provenance, results_of
from xcg.steps.mapping import map_over_time

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

    ``Q = int sum_i m_i v_i Psi(r - r_i) . n dA`` over the surface, positive along its normal n;
    with 1, V_i, m_i v_i or the energy in place of m_i. Momentum takes the contact stress along,
    ``int sigma^c . n dA``, and energy the work of contacts, where the scene has contact forces. It
    is defined in each step, and its integral over time is what crossed, up to what the kernel holds
    on both sides.

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
    of : str or list of str
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
    if not isinstance(surface, Wall):
        raise ValueError(f"surface={surface!r}: expected an xcg.Plane, xcg.Cylinder or xcg.Surface")
    wanted: list[Any] = [of] if isinstance(of, str) else list(of)
    for one in wanted:
        if one not in get_args(Flow):
            raise ValueError(unknown("flow", one, get_args(Flow)))
    call = format_call(
        "flow_rate", {"surface": surface, "of": of, "width": width, "kernel": kernel, "by": by}
    )
    require_scene(ds, ("velocity",), "flow_rate")
    scene = describe(ds)
    smooth = kernel_of(kernel, width, scene.sizes, scene.setup.dimension)
    if "momentum" in wanted:
        other = ds["velocity"].rename(component="direction")
        ds = ds.assign(
            velocity_squared=(ds["velocity"] * other).assign_attrs(units=units_in("m^2 s^-2", "SI"))
        )
    fields = [field for one in wanted for field in _fields(one, scene)]
    shared = {"kernel": smooth, "by": by, "groups": groups, "on_error": on_error}
    if isinstance(surface, Plane) and surface.bounds is None:
        flux = _through_plane(ds, scene, surface, fields, shared)
    else:
        flux = _through_points(
            ds, scene, surface, fields, shared, smooth.width * _FINE if spacing is None else spacing
        )
    found = {f"{one}_flow_rate": _rate(flux, one, scene) for one in wanted}
    result = xr.Dataset(found).drop_vars(
        [*COMPONENTS, "direction", SETUP], errors="ignore"
    )  # where the plane is, and the options of fields
    return result.assign_attrs(
        provenance(ds, call),
        kernel=smooth.name,
        width=smooth.width,
        cutoff=smooth.cutoff,
        surface=repr(surface),
    )


def _fields(flow: Flow, scene: Description) -> list[str | Sum]:
    """Densities of the flux of a quantity, whose last axis is that of the surface's normal."""
    if flow == "momentum":
        contacts = ["contact_stress"] if "contact_force" in scene.columns else []
        return [Sum("velocity_squared", "mass", "momentum_transport"), *contacts]
    if flow == "energy":
        return [
            "kinetic_energy_flux",
            *(["contact_energy_flux"] if "contact_force" in scene.columns else []),
        ]
    return [Sum("velocity", flow, f"{flow}_transport")]


def _rate(flux: xr.Dataset, flow: Flow, scene: Description) -> xr.DataArray:
    """Sum what the flow of a quantity consists of, and label it."""
    parts = [
        flux[field if isinstance(field, str) else field.name] for field in _fields(flow, scene)
    ]
    found = sum(parts[1:], start=parts[0]).drop_attrs(deep=False)
    found.attrs = {"units": units_in(_UNITS[flow], scene.setup.unit_system)}
    found.attrs["long_name"] = f"flow rate of {flow} along the normal"
    alone = flow in ("momentum", "energy") and "contact_force" not in scene.columns
    comments = ["carried by particles alone, as the scene holds no contact forces"] * alone
    if flow == "energy" and (lacking := [name for name in ROTATION if name not in scene.columns]):
        comments.append(f"without rotation, as the scene holds no {' and no '.join(lacking)}")
    return found.assign_attrs({"comment": "; ".join(comments)} if comments else {})


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
    return (
        scene.edges[depth][1] - scene.edges[depth][0]
        if isinstance(depth, str)
        else 1.0
        if depth is None
        else depth
    )


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
        frame = Rotated(
            **{
                along: normal.tolist(),
                **{a: np.eye(3)[COMPONENTS.index(a)].tolist() for a in across},
            },
            origin=surface.point,
        )
        at, options, turn = {along: 0.0}, {"frame": frame}, np.asarray(frame.axes)
    extent = {a: 1.0 for a in plane if a not in at}
    flux = coarse_grain(ds, fields, axes="", at=at, extent=extent, **options, **shared) * _depth(
        scene
    )
    flux = _across(flux, turn @ normal)  # the normal in the axes of the fields
    if k is None and "momentum_transport" in flux:  # back to the axes of the scene
        back = xr.DataArray(turn, dims=("component", "own"))
        for name in {"momentum_transport", "contact_stress"} & {*map(str, flux.data_vars)}:
            turned = xr.dot(flux[name].drop_vars("component"), back, dim="component").rename(
                own="component"
            )
            flux = flux.assign({name: turned.assign_coords(component=list(COMPONENTS))})
    return flux


def _through_points(
    ds: xr.Dataset,
    scene: Description,
    surface: Wall,
    fields: list[Any],
    shared: dict[str, Any],
    spacing: float,
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
        lower, upper = np.array(
            scene.corners if scene.corners is not None else np.full((2, 3), np.nan)
        )
        inside, layer = 1.0, scene.layer
        if layer is not None:  # fields are the same all across it
            k, lower[k], upper[k] = layer
        cells = surface.cells(lower, upper, spacing)
        if layer is not None:
            ends = np.sort(
                surface.coordinates(np.where(np.arange(3) == k, [lower, upper], lower)), axis=0
            )
            for (first, last), (low, high) in zip(cells.bounds, ends.T, strict=True):
                if np.isclose(high - low, upper[k] - lower[k], atol=0.0):
                    inside = max(0.0, min(last, high) - max(first, low)) / (last - first)
        return cells.centre, cells.area * inside
    centres, areas = [], []
    for a, b, c in surface.corners:
        longest = max(np.linalg.norm(one - other) for one, other in ((a, b), (b, c), (c, a)))
        count = max(1, int(np.ceil(longest / spacing)))
        i, j = (m.ravel() for m in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
        upright, turned = i + j < count, i + j < count - 1
        share = (
            np.concatenate(
                [np.stack([i, j], 1)[upright] + 1 / 3, np.stack([i, j], 1)[turned] + 2 / 3]
            )
            / count
        )
        centres.append(a + share[:, :1] * (b - a) + share[:, 1:] * (c - a))
        areas.append(np.full(len(share), 0.5 * np.linalg.norm(np.cross(b - a, c - a)) / count**2))
    return np.concatenate(centres), np.concatenate(areas)


# --- traction on walls ----------------------------------------------------------------------------


_NEEDS = ("contact_i", "contact_j", "contact_force", "contact_point")


@dataclass(frozen=True)
class _Task:
    """Options of the traction on a surface."""

    surface: Wall
    cells: SurfaceCells
    kernel: Kernel
    within: float
    setup: Setup


@takes_scene
def wall_stress(
    ds: xr.Dataset,
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
        The wall, with its normal to the side of the grains.
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
    call = format_call(
        "wall_stress", {"surface": surface, "width": width, "walls": walls, "within": within}
    )
    require_scene(ds, _NEEDS, "wall_stress")
    if not isinstance(surface, Wall):
        raise ValueError(f"surface={surface!r}: expected an xcg.Plane, xcg.Cylinder or xcg.Surface")
    if walls is not None:
        ds = select_walls(ds, walls)
    scene = describe(ds)
    setup = scene.setup
    smooth = kernel_of(kernel, width, scene.sizes, 2)
    for name, value in (("spacing", spacing), ("within", within)):
        if value is not None and not is_positive(value):
            raise ValueError(f"{name}={value!r}: expected a positive length (m)")
    cells = surface.cells(
        *_box_of_grains(scene), smooth.width / 2 if spacing is None else float(spacing)
    )
    task = _Task(surface, cells, smooth, smooth.width if within is None else float(within), setup)
    nodes = tuple(cells.coords)
    rows = {
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
    results = results_of(
        rows, dict(zip(nodes, cells.shape, strict=True)) | {"along": len(cells.axes)}
    )
    names = [
        "particle_id",
        "position",
        *_NEEDS,
        *(n for n in ("diameter", "frozen", *OF_STEP) if n in ds),
    ]
    found = map_over_time(ds, names, partial(_of_chunk, task), results, "wall-stress", on_error)
    result = label(
        ds,
        rows,
        found,
        call,
        kernel=smooth.name,
        width=smooth.width,
        cutoff=smooth.cutoff,
        surface=repr(surface),
    )
    for values in result.data_vars.values():
        values.attrs["source"] = (
            "contact_force"  # sums over contacts, which averages take as they are
        )
    return storable(result.assign_coords(_coordinates(cells, setup.unit_system)))


def _box_of_grains(scene: Description) -> tuple[NDArray, NDArray]:
    """Corners of what the grains fill: period or layer where there is one, else the centres with half a diameter."""
    edges = scene.edges
    low, high = (np.array([edges.get(a, (0.0, 0.0))[k] for a in COMPONENTS]) for k in (0, 1))
    if scene.corners is not None:
        low, high = map(np.array, scene.corners)
    room = 0.5 * scene.sizes.get("dmax", 0.0)
    low, high = low - room, high + room
    for a in scene.periods:
        k = COMPONENTS.index(a)
        low[k], high[k] = edges[a]
    if layer := scene.layer:
        k, low[k], high[k] = layer
    return low, high


def _of_chunk(task: _Task, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Tractions of one chunk of time."""
    steps = [_of_step(task, *step) for step in steps_in(arrays, task.setup.periodic)]
    return {name: np.stack([step[name] for step in steps]) for name in steps[0]}


def _of_step(task: _Task, frame: Any, lattice: Lattice, source: str) -> dict[str, NDArray]:
    _, point, force = Contacts.of(without_frozen(frame), lattice, source).at_walls
    point, force = _over_surface(task, point, -force, lattice, source)
    if not len(point):
        warn_once(
            "wall stress",
            f"{source}: no contact with a wall is within {task.within:.3g} m of {task.surface!r}",
        )
    normal, along = task.surface.in_surface(point, force)
    smeared = _smear(task, point, np.column_stack([-normal, along, force]), lattice)
    shape, axes = task.cells.shape, len(task.cells.axes)
    return {
        "normal_traction": smeared[:, 0].reshape(shape),
        "shear_traction": smeared[:, 1 : 1 + axes].reshape(*shape, axes),
        "traction": smeared[:, 1 + axes :].reshape(*shape, 3),
        "wall_force": force.sum(axis=0),
        "wall_contacts": np.asarray(len(force)),
    }


def _over_surface(
    task: _Task, point: NDArray, force: NDArray, lattice: Lattice, source: str
) -> tuple[NDArray, ...]:
    """Contacts near the surface and over its cells, each as that image which is the nearest to it."""
    if not len(point):
        return point, force
    images = _images(lattice, 1)
    places = (point + images[:, None]).reshape(-1, 3)
    apart = np.abs(task.surface.distance(places)).reshape(len(images), -1)
    distance = np.where(task.surface.covers(places, task.cells).reshape(apart.shape), apart, np.inf)
    image, near = np.argmin(distance, axis=0), distance.min(axis=0) <= task.within
    lost = ~near & (apart <= task.within).any(axis=0)
    if lost.any() and all(
        getattr(task.surface, end, None) is None for end in ("bounds", "low", "high")
    ):
        dims = [*task.cells.coords][-len(task.cells.bounds) :]
        for a, x, (low, high) in zip(
            dims, task.surface.coordinates(point[lost]).T, task.cells.bounds, strict=True
        ):
            if a not in task.setup.periodic:
                warn_beyond(a, x, low, high, source, what="contacts with the wall")
    return (point + images[image])[near], force[near]


def _images(lattice: Lattice, count: int) -> NDArray:
    """Shifts by up to `count` periods, none first."""
    numbers = [0.0, *(s * n for n in range(1, count + 1) for s in (-1.0, 1.0))]
    basis = lattice.basis
    return np.array(list(product(numbers, repeat=len(basis)))) @ basis


def _smear(task: _Task, point: NDArray, values: NDArray, lattice: Lattice) -> NDArray:
    """Sum over contacts weights (cells, contacts) times values (contacts, n), per area."""
    from scipy.spatial import cKDTree  # slow to import

    cells, cutoff = task.cells, task.kernel.cutoff
    seen = np.array(
        [float(a in task.setup.plane) for a in COMPONENTS]
    )  # the same all across a layer
    out = np.zeros((len(cells.area), values.shape[1]))
    if not len(point):
        return out
    shifts = _images(lattice, int(np.ceil(cutoff / lattice.closest[0])))
    tree, trees = (
        cKDTree(cells.centre * seen),
        [cKDTree((point + shift) * seen) for shift in shifts],
    )
    pairs = [tree.sparse_distance_matrix(other, cutoff, output_type="ndarray") for other in trees]
    cell, contact, distance = (
        np.concatenate([found[name] for found in pairs]) for name in ("i", "j", "v")
    )
    weight = task.kernel.value(distance) * cells.area[cell]
    total = np.bincount(contact, weight, len(point))
    alone = np.flatnonzero(total <= 0)
    weight[total[contact] <= 0] = 0.0  # below zero where the kernel is
    cell = np.concatenate([cell, tree.query(point[alone])[1]])
    contact, weight = (
        np.concatenate([contact, alone]),
        np.concatenate([weight, np.ones(len(alone))]),
    )
    total[alone] = 1.0
    np.add.at(out, cell, (weight / total[contact])[:, None] * values[contact])
    return out / cells.area[:, None]


def _coordinates(cells: SurfaceCells, system: str) -> dict[str, Any]:
    """Places and areas of the cells, and the axes of shear."""
    length, area = (units_in(unit, system) for unit in ("m", "m^2"))
    coords: dict[str, Any] = {}
    for dim, (values, text) in cells.coords.items():
        unit = {"theta": "rad", "triangle": "1"}.get(dim, length)
        coords[dim] = (dim, values, {"units": unit, "long_name": text})
    about = {"units": area, "long_name": "area of the cell"}
    coords["area"] = (tuple(cells.coords), cells.area.reshape(cells.shape), about)
    about = {"units": length, "long_name": "centre of the cell"}
    coords["centre"] = ((*cells.coords, "component"), cells.centre.reshape(*cells.shape, 3), about)
    return coords | {"along": list(cells.axes)}
