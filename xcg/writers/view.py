"""Pictures of results, scenes and chains in 3D, by PyVista."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from xcg.common.checks import extra
from xcg.common.messages import unknown
from xcg.writers.meshes import to_pyvista

if TYPE_CHECKING:
    import pyvista

FAINT = 0.04  # opacity of grains before their contacts or chains
_BAR = {
    "vertical": True, "position_x": 0.85, "position_y": 0.25, "width": 0.05, "height": 0.5, "fmt": "%.3g",
    "title_font_size": 20, "label_font_size": 18,
}  # fmt: skip
_LETTERS = 14  # in a line of the title of a bar


def view(
    ds: xr.Dataset,
    field: str | None = None,
    *,
    time: int = -1,
    component: str | None = None,
    direction: str | None = None,
    phase: int | str = "bulk",
    contacts: bool = False,
    chains: xr.Dataset | None = None,
    cmap: str = "viridis",
    clim: tuple[float, float] | None = None,
    plotter: pyvista.Plotter | None = None,
) -> pyvista.Plotter:
    """Draw one step of a result, a scene or force chains in 3D, with PyVista.

    A volume is cut along three planes through its middle, without nodes where the field is unknown; a plane is drawn in
    space. A scene is its grains, a result of `force_chains` its links.

    Parameters
    ----------
    ds : xarray.Dataset
        As `to_pyvista` takes it.
    field : str, optional
        What colours show: a field, a variable of the grains, or an array of chains. By default the first field but
        `sample_count`; the velocity of grains, or their diameter; the stress of links. Of a vector or tensor it is
        the magnitude.
    time : int
        Which step, by position; the last one by default.
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
    clim : tuple of float, optional
        Ends of the colours.
    plotter : pyvista.Plotter, optional
        Where to draw, without showing it. By default a new one, which is shown: in a notebook as a picture, or one to
        turn with the mouse where ``pip install 'pyvista[jupyter]'`` was done, else in a window.

    Returns
    -------
    pyvista.Plotter

    Raises
    ------
    ImportError
        If PyVista is not installed.
    ValueError
        As `to_pyvista`; if there is no such field, or a field has fewer than two axes.

    Examples
    --------
    >>> import xcg
    >>> f = xcg.datasets.random_scene().cg.coarse_grain("density", width=1.0)
    >>> f.cg.view("density")  # doctest: +SKIP
    """
    pv = extra("pyvista", "view", "a picture in 3D")
    target = pv.Plotter() if plotter is None else plotter
    style = {"cmap": cmap, "clim": clim}
    if "position" in ds and "chain_id" not in ds:
        _draw_scene(target, ds, field, time, contacts, chains, style)
    elif "chain_id" in ds:
        links: Any = to_pyvista(ds, time)
        _draw(target, links, field or "stress", links.user_dict["units"], style)
    else:
        _draw_field(target, ds, field, time, {"component": component, "direction": direction, "phase": phase}, style)
    target.add_axes()
    if plotter is None:
        target.show()
    return target


def _draw(plotter: Any, mesh: Any, array: str, units: Mapping[str, str], style: Mapping[str, Any]) -> None:
    """Draw a mesh coloured by one of its arrays, or by the magnitude of that."""
    names = [*mesh.point_data, *mesh.cell_data]
    if array not in names and mesh.n_points:
        raise ValueError(unknown("field", array, names, "others are those of to_pyvista()"))
    if mesh.n_points:
        text = array.replace("_", " ") + (", magnitude" if mesh[array].ndim > 1 else "")
        unit = f"[{units[array]}]" if units.get(array, "1") != "1" else ""
        title = "\n".join([*textwrap.wrap(text, _LETTERS), unit, ""])
        drawn = plotter.add_mesh(mesh, scalars=array, scalar_bar_args=_BAR | {"title": title}, **style)
        drawn.prop.interpolation = (
            "Gouraud"  # by the normals of spheres and tubes, which smooth_shading would compute anew
        )


def _draw_scene(
    plotter: Any, ds: xr.Dataset, field: str | None, time: int, contacts: bool, chains: xr.Dataset | None,
    style: Mapping[str, Any],
) -> None:  # fmt: skip
    blocks: Any = to_pyvista(ds, time, chains=chains)
    before = {"contacts": "force_magnitude"} if contacts else {"chains": "stress"} if chains is not None else {}
    if not blocks["particles"].n_points:
        return
    if before and field is None:
        plotter.add_mesh(blocks["particles"], color="grey", opacity=FAINT)
    else:
        named = field or ("velocity" if "velocity" in ds else "diameter")
        before = {"particles": named} | before
    for block, array in before.items():
        if block not in blocks.keys():  # noqa: SIM118
            raise ValueError(f"contacts={contacts!r}: the scene has no contacts; ds.cg.find_contacts() finds them")
        _draw(plotter, blocks[block], array, blocks[block].user_dict["units"], style)
    if "box" in blocks.keys():  # noqa: SIM118
        plotter.add_mesh(blocks["box"], color="black", line_width=1)
    plotter.view_isometric()
    plotter.reset_camera(bounds=blocks["particles"].bounds)  # boxes may be much higher
    plotter.camera_set = True


def _draw_field(
    plotter: Any, f: xr.Dataset, field: str | None, time: int, part: Mapping[str, Any], style: dict[str, Any]
) -> None:
    """Draw a field, through the middle of a volume."""
    name = field or next((str(n) for n in f.data_vars if n != "sample_count"), "")
    if name not in f:
        raise ValueError(unknown("field", name, f.data_vars, "others are listed by print(f)"))
    chosen = {dim: label for dim, label in part.items() if label is not None and dim in f[name].dims}
    try:
        image: Any = to_pyvista(f[[name]].sel(chosen), time)
    except KeyError as error:
        raise ValueError(f"{chosen}: {name!r} has no part of this name, {error}") from error
    resolved = sum(nodes > 1 for nodes in image.dimensions)
    if resolved < 2:
        raise ValueError(
            f"a picture in 3D needs two axes or three, and {name!r} has {resolved}: draw it with f.cg.plot"
        )
    unknown_at = np.isnan(image[name].reshape(image.n_points, -1)).any(axis=1)
    known = image.extract_points(~unknown_at, adjacent_cells=False)
    if resolved == 3 and known.n_points:
        known = known.slice_orthogonal(**dict(zip("xyz", image.center, strict=True))).combine()
    _draw(plotter, known, name, image.user_dict["units"], style | {"lighting": False})
    plotter.add_mesh(image.outline(), color="black", line_width=1)
