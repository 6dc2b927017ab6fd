"""Normal and shear traction on a wall, as fields on its surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_positive
from xcg.common.messages import warn_once
from xcg.fields.grids.walls import SurfaceCells, Wall
from xcg.fields.sums.kernels import Kernel, KernelName, kernel_of
from xcg.scene.conform import require_scene, storable, takes_scene
from xcg.scene.contacts import Contacts, Walls, select_walls
from xcg.scene.description import Description, describe
from xcg.scene.frame import steps_in, without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, OF_STEP, Setup, units_in
from xcg.steps.faults import OnError
from xcg.steps.labels import format_call, mark_skipped, provenance, times_of
from xcg.steps.mapping import map_over_time

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
    ``t_k = sum_c w_ck F_c / A_k`` with ``w_ck = Psi(x_k - c) A_k / sum_l Psi(x_l - c) A_l``: cells at x_k of area A_k,
    distances through space. Weights of a contact add up to one, also at the rim, so that the sum of traction times
    area is the sum of the forces. Where a cell is larger than the support, the nearest one takes the whole force.

    Parameters
    ----------
    ds : xarray.Dataset
        A scene with contacts.
    surface : Plane, Cylinder or Surface
        The wall, with its normal to the side of the grains.
    width : float or str, optional
        Half-width w of the kernel (m), or a multiple of a size such as "0.75 d43" (the default).
    walls : str, int or list of these, optional
        Walls whose contacts are taken, by name or number, see `select_walls`; by default all, frozen grains among them.
        At edges, where contacts with one wall are near another, say which.
    kernel : str or Kernel
        As in `coarse_grain`.
    spacing : float, optional
        Size of the cells of a plane or cylinder (m), half the width by default. A `Surface` has its triangles.
    within : float, optional
        Distance of contact points from the surface up to which they are taken (m), the width by default.
    on_error : {"raise", "skip"}
        As in `coarse_grain`.

    Returns
    -------
    xarray.Dataset
        On the cells, (time, theta, z) of a cylinder, (time, x, y) or (time, u, v) of a plane, (time, triangle) of a
        surface, in Pa:

        - ``normal_traction``, the force of the grains on the wall against its normal: positive in compression,
        - ``shear_traction`` (..., along), the force of the grains on the wall along the surface's axes: the axes of the
          cells, or x, y, z of a surface,
        - ``traction`` (..., component), the force of the grains on the wall.

        Of each step: ``wall_force`` (component), the sum of the forces that were taken (N), and ``wall_contacts``,
        their number. ``area`` is a coordinate. Parts across and along the wall are taken where the grain touches,
        before smearing, so each of the three adds up to its own sum of forces; on curved walls they differ from parts
        of ``traction`` by the turn of the normal within the support, (w / R)^2.

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
    call = format_call("wall_stress", {"surface": surface, "width": width, "walls": walls, "within": within})
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
    cells = surface.cells(*_box_of_grains(scene), smooth.width / 2 if spacing is None else float(spacing))
    task = _Task(surface, cells, smooth, smooth.width if within is None else float(within), setup)
    axes = len(cells.axes)
    results = {
        "normal_traction": (cells.shape, "float64"),
        "shear_traction": ((*cells.shape, axes), "float64"),
        "traction": ((*cells.shape, 3), "float64"),
        "wall_force": ((3,), "float64"),
        "wall_contacts": ((), "int64"),
    }
    names = ["particle_id", "position", *_NEEDS, *(n for n in ("diameter", "frozen", *OF_STEP) if n in ds)]
    found = map_over_time(ds, names, partial(_of_chunk, task), results, "wall-stress", on_error)
    result = _label(ds, task, found).assign_attrs(
        **provenance(ds, call), kernel=smooth.name, width=smooth.width, cutoff=smooth.cutoff, surface=repr(surface)
    )
    return mark_skipped(result, found)


def _box_of_grains(scene: Description) -> tuple[NDArray, NDArray]:
    """Corners of what the grains fill: the period along periodic axes, else the centres with half a diameter."""
    edges = scene.edges
    low, high = (np.array([edges.get(a, (0.0, 0.0))[k] for a in COMPONENTS]) for k in (0, 1))
    if scene.corners is not None:
        low, high = map(np.array, scene.corners)
    room = 0.5 * scene.sizes.get("dmax", 0.0)
    low, high = low - room, high + room
    for a in scene.periods:
        k = COMPONENTS.index(a)
        low[k], high[k] = edges[a]
    return low, high


def _of_chunk(task: _Task, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Tractions of one chunk of time."""
    steps = [_of_step(task, *step) for step in steps_in(arrays, task.setup.periodic)]
    return {name: np.stack([step[name] for step in steps]) for name in steps[0]}


def _of_step(task: _Task, frame: Any, lattice: Lattice, source: str) -> dict[str, NDArray]:
    _, point, force = Contacts.of(without_frozen(frame), lattice, source).at_walls
    point, force = _over_surface(task, point, -force, lattice)
    if not len(point):
        warn_once("wall stress", f"{source}: no contact with a wall is within {task.within:.3g} m of {task.surface!r}")
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


def _over_surface(task: _Task, point: NDArray, force: NDArray, lattice: Lattice) -> tuple[NDArray, NDArray]:
    """Contacts near the surface and over its cells, each as that image which is the nearest to it."""
    images = _images(lattice, 1)
    all_points = (point + images[:, None]).reshape(-1, 3)
    distance = np.abs(task.surface.distance(all_points)) if len(all_points) else np.empty(0)
    over = task.surface.covers(all_points, task.cells) if len(all_points) else np.empty(0, bool)
    distance = np.where(over, distance, np.inf).reshape(len(images), -1)
    image = np.argmin(distance, axis=0)
    near = distance[image, np.arange(len(point))] <= task.within
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
    out = np.zeros((len(cells.area), values.shape[1]))
    if not len(point):
        return out
    shifts = _images(lattice, int(np.ceil(cutoff / lattice.closest[0])))
    tree = cKDTree(cells.centre)
    pairs = [tree.sparse_distance_matrix(cKDTree(point + shift), cutoff, output_type="ndarray") for shift in shifts]
    cell, contact, distance = (np.concatenate([found[name] for found in pairs]) for name in ("i", "j", "v"))
    weight = task.kernel.value(distance) * cells.area[cell]
    total = np.bincount(contact, weight, len(point))
    alone = np.flatnonzero(total <= 0)
    weight[total[contact] <= 0] = 0.0  # below zero where the kernel is
    cell = np.concatenate([cell, tree.query(point[alone])[1]])
    contact, weight = np.concatenate([contact, alone]), np.concatenate([weight, np.ones(len(alone))])
    total[alone] = 1.0
    np.add.at(out, cell, (weight / total[contact])[:, None] * values[contact])
    return out / cells.area[:, None]


def _label(ds: xr.Dataset, task: _Task, found: Mapping[str, Any]) -> xr.Dataset:
    cells, system = task.cells, task.setup.unit_system
    length, stress, newton = (units_in(unit, system) for unit in ("m", "Pa", "N"))
    coords: dict[str, Any] = dict(times_of(ds))
    nodes = tuple(cells.coords)
    for dim, (values, text) in cells.coords.items():
        unit = {"theta": "rad", "triangle": "1"}.get(dim, length)
        coords[dim] = (dim, values, {"units": unit, "long_name": text})
    area = {"units": units_in("m^2", system), "long_name": "area of the cell"}
    coords["area"] = (nodes, cells.area.reshape(cells.shape), area)
    place = {"units": length, "long_name": "centre of the cell"}
    coords["centre"] = ((*nodes, "component"), cells.centre.reshape(*cells.shape, 3), place)
    coords |= {"component": list(COMPONENTS), "along": list(cells.axes)}
    rows = {
        "normal_traction": (
            (*cells.coords,),
            stress,
            "normal traction of the grains on the wall, compression positive",
        ),
        "shear_traction": ((*nodes, "along"), stress, "shear traction of the grains on the wall"),
        "traction": ((*nodes, "component"), stress, "traction of the grains on the wall"),
        "wall_force": (("component",), newton, "force of the grains on the wall"),
        "wall_contacts": ((), "1", "number of contacts with the wall"),
    }
    of_forces = {"source": "contact_force"}  # sums over contacts, which averages take as they are
    data = {
        name: (("time", *dims), found[name], {"units": unit, "long_name": text, **of_forces})
        for name, (dims, unit, text) in rows.items()
    }
    return storable(xr.Dataset(data, coords))
