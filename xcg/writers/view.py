"""Results, scenes and chains in 3D: meshes of PyVista, and pictures of them."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.analysis.chain_results import require_chains, steps_of
from xcg.analysis.picture import without_air
from xcg.common.checks import extra
from xcg.common.drawing import check_ends
from xcg.common.messages import unknown
from xcg.scene.conform import conform
from xcg.scene.contacts import Contacts
from xcg.scene.frame import frame_at, step_at
from xcg.scene.schema import COMPONENTS
from xcg.writers.chains import VTK_VARIABLES, polydata_of
from xcg.writers.paraview import image_of
from xcg.writers.vtkhdf import arrays_of, checked

if TYPE_CHECKING:
    import pyvista

WIDEST = 0.3  # radius of a tube in mean radii of the grains, at the strongest forces
THINNEST = 0.02  # of that radius, so that weak contacts are seen
STRONGEST = 98  # percentile of the forces of the widest tubes, so that single ones do not make all others thin
_SPHERE = {"radius": 0.5, "theta_resolution": 16, "phi_resolution": 12}
FAINT = 0.04  # opacity of grains when contacts or chains are drawn
_BAR = {
    "vertical": True,
    "position_x": 0.85,
    "position_y": 0.25,
    "width": 0.05,
    "height": 0.5,
    "fmt": "%.4g",
    "title_font_size": 20,
    "label_font_size": 18,
}
# variables whose units arrays of other names have
_VARIABLES = {
    "stress": "major_stress",
    "force": "contact_force",
    "force_magnitude": "contact_force",
    "radius": "diameter",
}
_TICKS = 5  # steps between the ends of a bar, about
_LETTERS = 14  # in a line of the title of a bar


def to_pyvista(
    ds: xr.Dataset, index: int = -1, *, shapes: bool = True, chains: xr.Dataset | None = None
) -> pyvista.ImageData | pyvista.MultiBlock | pyvista.PolyData:
    """Return one step of a result, a scene or force chains as a mesh of PyVista.

    Parameters
    ----------
    ds : xarray.Dataset
        A result on evenly spaced nodes along x, y and z, a scene, or a result of `force_chains`.
        Only this step is computed.
    index : int
        Position of the step in time; the last one by default.
    shapes : bool
        Of scenes and chains: spheres in place of points, and tubes in place of lines, whose radius
        grows with the force (up to 0.3 mean radii of the grains at the 98th percentile of the
        forces).
    chains : xarray.Dataset, optional
        Of a scene: its result of `force_chains`, to be in the same mesh.

    Returns
    -------
    pyvista.ImageData, pyvista.MultiBlock or pyvista.PolyData
        Of a result, an image: fields are point data with 1, 3 or 9 components (xx, xy, xz, yx,
        ...), as in VTKHDF; of phases one array each. Nodes where a field is unknown hold NaN,
        which `view` leaves out and ``image.threshold(scalars=...)`` takes away.

        Of a scene, blocks: "particles", "contacts", "chains" and "box", those there are, with the
        scene's variables. A contact is two lines, from the centre of each of its grains to the
        contact point, so that none crosses a periodic box; they also hold ``force_magnitude`` (N).
        Of chains, their links, with the arrays of `to_vtp`.

        ``user_dict`` of a mesh or block has the ``units`` of its arrays, and ``time``.

    Raises
    ------
    ImportError
        If PyVista is not installed.
    ValueError
        If the step does not exist, or the fields form no image: on a cylinder, at points, or on
        uneven nodes.

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
        raise ValueError(
            "chains= is drawn with a scene: call to_pyvista on the scene that the chains were found in"
        )
    if "chain_id" in ds:
        return _links(pv, ds, index, shapes=shapes)
    if "position" in ds:
        return _blocks(pv, conform(ds), index, shapes=shapes, chains=chains)
    if {"r", "theta"} & {*map(str, ds.dims)}:
        raise ValueError(
            "these fields are on a cylinder, and an image has x, y and z: draw them with f.cg.plot"
        )
    step = checked(step_at(ds, index)).compute()
    variables = {array.name: array.variable for array in arrays_of(step)}
    return _noted(pv.wrap(image_of(step)), step, variables)


def _noted(mesh: Any, step: xr.Dataset, variables: Mapping[str, str]) -> Any:
    """Record the time of a mesh, and the units of its arrays."""
    units = {
        array: str(step[name].attrs["units"])
        for array, name in variables.items()
        if name in step and "units" in step[name].attrs
    }
    times = {name: step[name].values.item() for name in ("time", "step") if name in step.coords}
    mesh.user_dict = {"units": units, **times}
    return mesh


def _blocks(pv: Any, ds: xr.Dataset, index: int, *, shapes: bool, chains: xr.Dataset | None) -> Any:
    """Grains, contacts, chains and box of a step."""
    names = {
        dim: [str(name) for name in ds.data_vars if dim in ds[name].dims]
        for dim in ("particle", "contact")
    }
    frame, lattice, source = frame_at(ds, index, [*names["particle"], *names["contact"]])
    step = step_at(ds, index)
    blocks = pv.MultiBlock()
    grains = pv.PolyData(frame["position"])
    if grains.n_points:  # PyVista takes no empty vectors
        grains.point_data.update({name: frame[name] for name in names["particle"]})
    sizes = frame.get("diameter", np.zeros(0))
    if shapes and len(sizes):
        grains = grains.glyph(geom=pv.Sphere(**_SPHERE), scale="diameter", orient=False)
    blocks["particles"] = _noted(grains, step, {name: name for name in names["particle"]})
    if "contact_i" in frame:
        values = {name: frame[name] for name in names["contact"]}
        if "contact_force" in frame:
            values["force_magnitude"] = np.linalg.norm(frame["contact_force"], axis=1)
        start, end, contact = _branches(Contacts.of(frame, lattice, source))
        lines = _lines(pv, start, end, {name: data[contact] for name, data in values.items()})
        if shapes:
            lines = _tubes(pv, lines, sizes)
        variables = {name: _VARIABLES.get(name, name) for name in values}
        blocks["contacts"] = _noted(lines, step, variables)
    if chains is not None:
        blocks["chains"] = _links(pv, chains, index, shapes=shapes)
    if lattice.edges is not None and np.isfinite(lattice.edges).all():
        blocks["box"] = _box(pv, lattice.edges, lattice.cell)
    return blocks


def _branches(contacts: Contacts) -> tuple[NDArray, NDArray, NDArray]:
    """Return the ends (n, 3) of lines from the centre of each grain to its contact points, and their contacts."""
    i = np.flatnonzero(contacts.i >= 0)
    j = np.flatnonzero(contacts.j >= 0)
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
    """Separate lines by their ends, (n, 3) each, and values."""
    lines = pv.line_segments_from_points(np.stack([start, end], axis=1).reshape(-1, 3))
    if len(start):  # PyVista takes no empty vectors
        lines.cell_data.update(values)
    return lines


def _tubes(pv: Any, lines: Any, sizes: NDArray) -> Any:
    """Tubes in place of lines, with radii by the force, for grains of these diameters."""
    if not lines.n_lines:
        return lines
    ends = np.asarray(lines.lines).reshape(-1, 3)[:, 1:].T
    start, end = np.asarray(lines.points)[ends]
    values = {name: np.asarray(lines.cell_data[name]) for name in lines.cell_data}
    force = values.get("force_magnitude", np.ones(len(start)))
    largest = np.percentile(force, STRONGEST) or force.max(initial=0.0) or 1.0
    apart = _lines(pv, start, end, values)
    radius = 0.05 * np.linalg.norm(end - start, axis=1).mean()
    if len(sizes):
        radius = WIDEST * sizes.mean() / 2
    apart.point_data["radius"] = np.repeat(radius * np.clip(force / largest, THINNEST, 1.0), 2)
    return apart.tube(scalars="radius", absolute=True, n_sides=8)


def _links(pv: Any, fc: xr.Dataset, index: int, *, shapes: bool) -> Any:
    """Links of the chains of a step."""
    require_chains(fc, "to_pyvista")
    one_step = step_at(fc, index)
    (step,) = steps_of(one_step, VTK_VARIABLES)
    links = pv.wrap(polydata_of(step))
    if shapes:
        links = _tubes(pv, links, 2 * np.asarray(links.point_data["radius"]))
    variables = {name: _VARIABLES.get(name, name) for name in links.array_names}
    return _noted(links, one_step, variables)


def view(
    ds: xr.Dataset,
    field: str | None = None,
    *,
    index: int = -1,
    component: str | None = None,
    direction: str | None = None,
    phase: int | str = "bulk",
    contacts: bool = False,
    chains: xr.Dataset | None = None,
    cmap: str = "viridis",
    vmin: float | None = None,
    vmax: float | None = None,
    plotter: pyvista.Plotter | None = None,
) -> pyvista.Plotter:
    """Draw one step of a result, a scene or force chains in 3D, with PyVista.

    A volume is cut along three planes through its middle, without nodes where the field is unknown
    or no grains are; a plane is drawn in space. Boxes end where grains do, except along periodic
    axes. A scene is its grains, a result of `force_chains` its links.

    Parameters
    ----------
    ds : xarray.Dataset
        As `to_pyvista` takes it.
    field : str, optional
        What colours show: a field, a variable of the grains, or an array of chains. By default the
        first field but `sample_count`; the velocity of grains, or their diameter; the stress of
        links. Of a vector or tensor it is the magnitude.
    index : int
        Position of the step in time; the last one by default.
    component, direction : str, optional
        "x", "y" or "z": the part of a vector or tensor field.
    phase : int or str
        Which phase of a field.
    contacts : bool
        Of a scene: draw contacts as tubes, coloured by their force, and grains faintly.
    chains : xarray.Dataset, optional
        Of a scene: draw these chains, coloured by their stress, and grains faintly.
    cmap : str
        Colours, by the names of matplotlib.
    vmin, vmax : float, optional
        Ends of the colours; the smallest and largest number by default.
    plotter : pyvista.Plotter, optional
        Where to draw, without showing it. By default a new one, which is shown: in a notebook as a
        picture, or one to turn with the mouse where ``pip install 'pyvista[jupyter]'`` was done,
        else in a window.

    Returns
    -------
    pyvista.Plotter

    Raises
    ------
    ImportError
        If PyVista is not installed, or in a notebook trame is and ipywidgets is not.
    ValueError
        As `to_pyvista`; if the field does not exist, or a field has fewer than two axes.

    Examples
    --------
    >>> import xcg
    >>> f = xcg.datasets.random_scene().cg.coarse_grain("density", width=1.0)
    >>> f.cg.view("density")  # doctest: +SKIP
    """
    pv = extra("pyvista", "view", "a picture in 3D")
    part = {"component": component, "direction": direction, "phase": phase}
    if "position" in ds or "chain_id" in ds:
        for name, label in part.items():
            if label not in (None, "bulk"):
                raise ValueError(
                    f"{name}= chooses a part of a field of a result: leave it out for a scene and chains"
                )
    target = plotter or pv.Plotter()
    style = {"cmap": cmap, "vmin": vmin, "vmax": vmax}
    if "chain_id" in ds:
        links: Any = to_pyvista(ds, index)
        _draw(target, links, field or "stress", links.user_dict["units"], style)
    elif "position" in ds:
        _draw_scene(target, ds, field, index, contacts, chains, style)
    else:
        _draw_field(target, ds, field, index, part, style)
    target.add_axes()
    if plotter is None:
        try:
            target.show()
        except ImportError as error:  # trame without ipywidgets
            raise ImportError(
                f"view: PyVista cannot show a picture to turn in this notebook ({error}): pip install "
                "'pyvista[jupyter]' brings trame and ipywidgets; without them, "
                "pyvista.set_jupyter_backend('static') shows a still picture"
            ) from error
        _show_once(target)
    return target


def _show_once(plotter: Any) -> None:
    """Keep a notebook from repeating a picture, as the result of the cell that has shown it."""
    ipython: Any = sys.modules.get("IPython")
    shell = ipython and ipython.get_ipython()
    if not shell:
        return
    cell = shell.execution_count

    def display(**_: Any) -> None:
        if shell.execution_count != cell:
            del plotter._ipython_display_
            ipython.display.display(plotter)

    plotter._ipython_display_ = display


def _draw(
    plotter: Any, mesh: Any, array: str, units: Mapping[str, str], style: Mapping[str, Any]
) -> None:
    """Draw a mesh coloured by one of its arrays, or by the magnitude of that."""
    names = [*mesh.point_data, *mesh.cell_data]
    if array not in names and mesh.n_points:
        raise ValueError(unknown("field", array, names, "others are those of to_pyvista()"))
    if not mesh.n_points:
        return
    text = array.replace("_", " ")
    size = mesh[array]
    if size.ndim > 1:
        text += ", magnitude"
        size = np.linalg.norm(size, axis=1)
    unit = ""
    if units.get(array, "1") != "1":
        unit = f"[{units[array]}]"
    title = "\n".join([*textwrap.wrap(text, _LETTERS), unit, ""])
    options = dict(style)
    vmin = options.pop("vmin")
    vmax = options.pop("vmax")
    low = np.nanmin(size) if vmin is None else vmin
    high = np.nanmax(size) if vmax is None else vmax
    check_ends(low, high, vmin, vmax)
    drawn = plotter.add_mesh(
        mesh, scalars=array, clim=(low, high), scalar_bar_args=_BAR | {"title": title}, **options
    )
    bar = plotter.scalar_bars[title]
    _put_ticks(bar, low, high)
    table = drawn.mapper.lookup_table
    if (size > high).any():
        table.above_range_color = table.values[-1]
        bar.SetAboveRangeAnnotation("above")
        bar.DrawAboveRangeSwatchOn()
    if (size < low).any():
        table.below_range_color = table.values[0]
        bar.SetBelowRangeAnnotation("below")
        bar.DrawBelowRangeSwatchOn()
    # by the normals of spheres and tubes, which smooth_shading would compute anew
    drawn.prop.interpolation = "Gouraud"


def _put_ticks(bar: Any, low: float, high: float) -> None:
    """Write round numbers beside a bar, in place of numbers at even parts of it."""
    from matplotlib.ticker import MaxNLocator  # comes with PyVista
    from vtkmodules.util.numpy_support import numpy_to_vtk

    ticks = np.asarray(MaxNLocator(_TICKS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    margin = 1e-6 * (high - low)
    inside = ticks[(ticks >= low - margin) & (ticks <= high + margin)]
    if len(inside) > 1:
        bar.SetCustomLabels(numpy_to_vtk(inside, deep=True))
        bar.SetUseCustomLabels(True)


def _draw_scene(
    plotter: Any,
    ds: xr.Dataset,
    field: str | None,
    index: int,
    contacts: bool,
    chains: xr.Dataset | None,
    style: Mapping[str, Any],
) -> None:
    blocks: Any = to_pyvista(ds, index, chains=chains)
    if not blocks["particles"].n_points:
        return
    arrays: dict[str, str] = {}  # of the blocks that are drawn
    if contacts:
        arrays["contacts"] = "force_magnitude"
    elif chains is not None:
        arrays["chains"] = "stress"
    if arrays and field is None:
        plotter.add_mesh(blocks["particles"], color="grey", opacity=FAINT)
    else:
        usual = "velocity" if "velocity" in ds else "diameter"
        arrays = {"particles": field or usual, **arrays}
    for block, array in arrays.items():
        if block not in blocks.keys():  # noqa: SIM118
            raise ValueError(
                f"contacts={contacts!r}: the scene has no contacts; ds.cg.find_contacts() finds them"
            )
        _draw(plotter, blocks[block], array, blocks[block].user_dict["units"], style)
    bounds = np.reshape(blocks["particles"].bounds, (3, 2))
    if "box" in blocks.keys():  # noqa: SIM118
        box = blocks["box"]
        points = np.array(box.points)
        periodic = str(ds.attrs.get("periodic", ""))
        for k, axis in enumerate(COMPONENTS):
            if axis not in periodic:  # it may be much higher than the grains
                points[:, k] = points[:, k].clip(*bounds[k])
        box.points = points
        plotter.add_mesh(box, color="black", line_width=1)
    plotter.view_isometric()
    plotter.reset_camera(bounds=bounds.ravel())
    plotter.camera_set = True


def _draw_field(
    plotter: Any,
    f: xr.Dataset,
    field: str | None,
    index: int,
    part: Mapping[str, Any],
    style: dict[str, Any],
) -> None:
    """Draw a field, through the middle of a volume."""
    name = field or next((str(n) for n in f.data_vars if n != "sample_count"), "")
    if name not in f:
        raise ValueError(unknown("field", name, f.data_vars, "others are listed by print(f)"))
    chosen = {
        dim: label for dim, label in part.items() if label is not None and dim in f[name].dims
    }
    try:
        without_gaps = without_air(f, name)
        image: Any = to_pyvista(without_gaps.to_dataset(name=name).sel(chosen), index)
    except KeyError as error:
        raise ValueError(f"{chosen}: {name!r} has no part of this name, {error}") from error
    resolved = sum(nodes > 1 for nodes in image.dimensions)
    if resolved < 2:
        raise ValueError(
            f"a picture in 3D needs two axes or three, and {name!r} has {resolved}: use f.cg.plot"
        )
    is_gap = np.isnan(image[name].reshape(image.n_points, -1)).any(axis=1)
    drawn = image.extract_points(~is_gap, adjacent_cells=False)
    outline = drawn.outline()
    if resolved == 3 and drawn.n_points:
        drawn = drawn.slice_orthogonal(**dict(zip("xyz", image.center, strict=True))).combine()
    _draw(plotter, drawn, name, image.user_dict["units"], style | {"lighting": False})
    if drawn.n_points:
        plotter.add_mesh(outline, color="black", line_width=1)
