"""Results, scenes and chains as meshes of PyVista."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.chains.results import require_chains, steps_of
from xcg.common.checks import extra
from xcg.scene.conform import conform
from xcg.scene.contacts import Contacts
from xcg.scene.frame import frame_at, step_at
from xcg.writers.chains import VTK_VARIABLES, polydata_of
from xcg.writers.paraview import image_of
from xcg.writers.vtkhdf import arrays_of, checked

if TYPE_CHECKING:
    import pyvista

WIDEST = 0.3  # radius of a tube in mean radii of the grains, at the strongest forces
THINNEST = 0.02  # of that radius, so that weak contacts are seen
STRONGEST = 98  # percentile of the forces of the widest tubes, so that single ones do not make all others thin
_SPHERE = {"radius": 0.5, "theta_resolution": 16, "phi_resolution": 12}


def to_pyvista(
    ds: xr.Dataset, time: int = -1, *, shapes: bool = True, chains: xr.Dataset | None = None
) -> pyvista.ImageData | pyvista.MultiBlock | pyvista.PolyData:
    """Return one step of a result, a scene or force chains as a mesh of PyVista.

    Parameters
    ----------
    ds : xarray.Dataset
        A result on evenly spaced nodes along x, y and z, a scene, or a result of `force_chains`. Only this step is
        computed.
    time : int
        Which step, by position; the last one by default.
    shapes : bool
        Of scenes and chains: spheres in place of points, and tubes in place of lines, whose radius grows with the force
        (up to 0.3 mean radii of the grains at the 98th percentile of the forces).
    chains : xarray.Dataset, optional
        Of a scene: its result of `force_chains`, to be in the same mesh.

    Returns
    -------
    pyvista.ImageData, pyvista.MultiBlock or pyvista.PolyData
        Of a result, an image: fields are point data with 1, 3 or 9 components (xx, xy, xz, yx, ...), as in
        `to_vtkhdf`; of phases one array each. Nodes where a field is unknown hold NaN, which `view` leaves out and
        ``image.threshold(scalars=...)`` takes away.

        Of a scene, blocks: "particles", "contacts", "chains" and "box", those there are, with the scene's variables. A
        contact is two lines, from the centre of each of its grains to the contact point, so that none crosses a
        periodic box; they also hold ``force_magnitude`` (N). Of chains, their links, with the arrays of `to_vtp`.

        ``user_dict`` of a mesh or block has the ``units`` of its arrays, and ``time``.

    Raises
    ------
    ImportError
        If PyVista is not installed.
    ValueError
        If there is no such step, or the fields form no image: on a cylinder, at points, or on uneven nodes.

    Examples
    --------
    >>> import xcg
    >>> f = xcg.datasets.random_scene().cg.coarse_grain("density", width=1.0)
    >>> image = f.cg.to_pyvista()  # doctest: +SKIP
    >>> image.dimensions  # doctest: +SKIP
    (11, 11, 11)
    """
    pv = extra("pyvista", "view", "to_pyvista")
    if "position" not in ds and chains is not None:
        raise ValueError("chains= is drawn with a scene: call to_pyvista on the scene that the chains were found in")
    if "chain_id" in ds:
        return _links(pv, ds, time, shapes=shapes)
    if "position" in ds:
        return _blocks(pv, conform(ds), time, shapes=shapes, chains=chains)
    if {"r", "theta"} & {*map(str, ds.dims)}:
        raise ValueError("these fields are on a cylinder, and an image has x, y and z: draw them with f.cg.plot")
    step = checked(step_at(ds, time, "time")).compute()
    return _noted(pv.wrap(image_of(step)), step, {array.name: array.variable for array in arrays_of(step)})


def _noted(mesh: Any, step: xr.Dataset, variables: Mapping[str, str]) -> Any:
    """Note the time of a mesh, and the units of its arrays, by the variables that they are of."""
    units = {array: str(step[name].attrs["units"]) for array, name in variables.items() if "units" in step[name].attrs}
    times = {name: step[name].values.item() for name in ("time", "step") if name in step.coords}
    mesh.user_dict = {"units": units, **times}
    return mesh


def _blocks(pv: Any, ds: xr.Dataset, time: int, *, shapes: bool, chains: xr.Dataset | None) -> Any:
    """Grains, contacts, chains and box of a step."""
    rows = {dim: [str(name) for name in ds.data_vars if dim in ds[name].dims] for dim in ("particle", "contact")}
    frame, lattice, source = frame_at(ds, time, [*rows["particle"], *rows["contact"]])
    step, found = step_at(ds, time, "time"), pv.MultiBlock()
    grains = pv.PolyData(frame["position"])
    for name in rows["particle"] if grains.n_points else ():  # PyVista takes no empty vectors
        grains.point_data[name] = frame[name]
    sizes = frame.get("diameter", np.zeros(0))
    if shapes and len(sizes):
        grains = grains.glyph(geom=pv.Sphere(**_SPHERE), scale="diameter", orient=False)
    found["particles"] = _noted(grains, step, {name: name for name in rows["particle"]})
    if "contact_i" in frame:
        values = {name: frame[name] for name in rows["contact"]}
        if "contact_force" in frame:
            values["force_magnitude"] = np.linalg.norm(frame["contact_force"], axis=1)
        start, end, contact = _branches(Contacts.of(frame, lattice, source))
        lines = _lines(pv, start, end, {name: of_contact[contact] for name, of_contact in values.items()})
        lines = _tubes(pv, lines, sizes) if shapes else lines
        variables = {name: "contact_force" if name == "force_magnitude" else name for name in values}
        found["contacts"] = _noted(lines, step, variables)
    if chains is not None:
        found["chains"] = _links(pv, chains, time, shapes=shapes)
    if lattice.edges is not None and np.isfinite(lattice.edges).all():
        found["box"] = _box(pv, lattice.edges, lattice.cell)
    return found


def _branches(contacts: Contacts) -> tuple[NDArray, NDArray, NDArray]:
    """Return the ends (n, 3) of lines from the centre of each grain to its contact points, and their contacts."""
    i, j = np.flatnonzero(contacts.i >= 0), np.flatnonzero(contacts.j >= 0)
    start = contacts.position[np.concatenate([contacts.i[i], contacts.j[j]])]
    branch = np.concatenate([contacts.branch_i[i], contacts.branch_j[j]])
    return start, start - branch, np.concatenate([i, j])


def _box(pv: Any, edges: NDArray, cell: NDArray | None) -> Any:
    """Edges of a box, which its cell may tilt."""
    vectors = np.diag(edges[:, 1] - edges[:, 0])
    if cell is not None:
        vectors = np.where(cell.any(axis=1, keepdims=True), cell, vectors)
    grid = pv.StructuredGrid()
    grid.points = edges[:, 0] + np.indices((2, 2, 2)).reshape(3, -1).T[:, ::-1] @ vectors
    grid.dimensions = (2, 2, 2)
    return grid.extract_all_edges()


def _lines(pv: Any, start: NDArray, end: NDArray, values: Mapping[str, NDArray]) -> Any:
    """Lines with ends of their own, (n, 3) each, and values."""
    points = np.stack([start, end], axis=1).reshape(-1, 3)
    first = 2 * np.arange(len(start))
    lines = pv.PolyData(points, lines=np.column_stack([np.full(len(start), 2), first, first + 1]).ravel())
    for name, of_line in values.items() if len(start) else ():  # PyVista takes no empty vectors
        lines.cell_data[name] = of_line
    return lines


def _tubes(pv: Any, lines: Any, sizes: NDArray) -> Any:
    """Tubes in place of lines, with radii by the force, for grains of these diameters."""
    if not lines.n_lines:
        return lines
    start, end = np.asarray(lines.points)[np.asarray(lines.lines).reshape(-1, 3)[:, 1:]].transpose(1, 0, 2)
    values = {name: np.asarray(lines.cell_data[name]) for name in lines.cell_data}
    force = values.get("force_magnitude", np.ones(len(start)))
    largest = np.percentile(force, STRONGEST) or force.max(initial=0.0) or 1.0
    apart = _lines(pv, start, end, values)
    radius = WIDEST * sizes.mean() / 2 if len(sizes) else 0.05 * np.linalg.norm(end - start, axis=1).mean()
    apart.point_data["radius"] = np.repeat(radius * np.clip(force / largest, THINNEST, 1.0), 2)
    return apart.tube(scalars="radius", absolute=True, n_sides=8)


def _links(pv: Any, fc: xr.Dataset, time: int, *, shapes: bool) -> Any:
    """Links of the chains of a step."""
    require_chains(fc, "to_pyvista")
    one = step_at(fc, time, "time")
    (step,) = steps_of(one, VTK_VARIABLES)
    links = pv.wrap(polydata_of(step))
    links = _tubes(pv, links, 2 * np.asarray(links.point_data["radius"])) if shapes else links
    of = {"stress": "major_stress", "force": "contact_force", "force_magnitude": "contact_force", "radius": "diameter"}
    return _noted(links, one, {name: of.get(name, name) for name in links.array_names if of.get(name, name) in one})
