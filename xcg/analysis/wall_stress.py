"""Traction of grains on walls."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.analysis.surfaces import attrs_of, check_surface, open_ends
from xcg.common.checks import POSITIVE, check
from xcg.common.messages import warn_once
from xcg.fields.grids.grid import warn_beyond
from xcg.fields.grids.walls import Surface, SurfaceCells, Wall
from xcg.fields.sums.kernels import Kernel, KernelName, kernel_of
from xcg.scene.conform import takes_scene
from xcg.scene.contacts import Contacts, Walls, select_walls
from xcg.scene.frame import without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, Frame, Variable, units_in
from xcg.steps.analysis import FrameAnalysis, run
from xcg.steps.faults import OnError
from xcg.steps.labels import annotated, call_of

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
        which; a warning counts them.
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
    check_surface(surface)
    check("spacing", spacing, POSITIVE, "m", optional=True)
    check("within", within, POSITIVE, "m", optional=True)
    if walls is not None:
        scene = Scene(select_walls(scene.ds, walls))
    smooth = kernel_of(kernel, width, scene.sizes, 2)
    low, high = _box_of_grains(scene)
    if isinstance(surface, Surface):
        surface.check_unit(low, high, scene.sizes.get("d43", 0.0))
    cells = surface.cells(low, high, float(spacing or smooth.width / 2))
    analysis = _WallStress(surface, cells, smooth, float(within or smooth.width))
    return run(scene, analysis, call=call, on_error=on_error)


_OFF = 0.1  # radii that the points of a flat wall's contacts are off its surface at most
_BESIDE = 0.5  # cosine of the direction to the grain and the normal of the surface


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
        """Return positions and areas of the cells, and the axes of shear."""
        return _coordinates(self.cells, self.setup.unit_system)

    def attrs(self, scene: Scene) -> dict[str, Any]:
        """Return kernel and surface, and where the cells end if the surface goes on."""
        attrs = attrs_of(self.kernel, self.surface)
        ends = [
            f"{dim} from {low:.6g} to {high:.6g}"
            for dim, (low, high) in open_ends(self.surface, self.cells, scene).items()
        ]
        if ends:
            attrs["comment"] = (
                f"the surface goes on beyond its cells, which end where the grains do: {', '.join(ends)}; "
                "bounds= of a plane, low= and high= of a cylinder set their ends"
            )
        return attrs

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, ArrayLike]:
        """Compute the tractions of one step."""
        free = without_frozen(frame)
        row, point, force = Contacts.of(free, lattice, source).at_walls
        arm = lattice.shortest(free["position"][row] - point)
        point, force, arm = _over_surface(self, point, [-force, arm], lattice, source)
        if not len(point):
            warn_once(
                "wall stress",
                f"{source}: no contact with a wall is within {self.within:.3g} m of {self.surface!r}",
            )
        self._warn_of_other_walls(point, arm, source)
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

    def _warn_of_other_walls(self, point: NDArray, arm: NDArray, source: str) -> None:
        """Warn where grains beside a flat wall touch another wall, whose contacts are taken, too."""
        radius = np.linalg.norm(arm, axis=1)
        across, _ = self.surface.in_surface(point, arm)
        off = np.abs(self.surface.distance(point)) > _OFF * radius
        beside = off & (np.abs(across) < _BESIDE * radius)
        is_flat = np.count_nonzero(~off) > np.count_nonzero(off & ~beside)
        if beside.any() and is_flat:
            warn_once(
                "other walls",
                f"{source}: {np.count_nonzero(beside)} of the {len(point)} contacts taken are off the surface, with "
                f"grains beside them, as on another wall; name the wall, walls=, or give a smaller within= than "
                f"{self.within:.3g} m",
            )

    def after(self, result: xr.Dataset, ds: xr.Dataset) -> xr.Dataset:
        """Mark sums over contacts, which averages take as they are."""
        for values in result.data_vars.values():
            values.attrs["source"] = "contact_force"
        return result


def _over_surface(
    task: _WallStress, point: NDArray, vectors: list[NDArray], lattice: Lattice, source: str
) -> tuple[NDArray, ...]:
    """Return points and vectors of contacts near the cells, as the images nearest to the surface."""
    if not len(point):
        return point, *vectors
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
        coordinates = surface.coordinates(point[beyond]).T
        for a, x, (low, high) in zip(dims, coordinates, cells.bounds, strict=True):
            if a not in task.setup.periodic:
                warn_beyond(a, x, low, high, source, what="contacts with the wall")
    return (point + shifts[nearest])[near], *(vector[near] for vector in vectors)


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
    """Return positions and areas of the cells, and the axes of shear."""
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
