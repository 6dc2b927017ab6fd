"""Points of a mesh in a file, for fields at them."""

from __future__ import annotations

import os

import xarray as xr

from xcg.common.vtk_mesh import places_of, read_mesh
from xcg.scene.schema import COMPONENTS


def mesh_points(path: str | os.PathLike[str], *, centers: bool = False) -> dict[str, xr.DataArray]:
    """Points of a mesh or surface, or the centres of its cells, as `coarse_grain` takes them: ``at=mesh_points(...)``.

    `to_vtu` writes the fields at them back onto the mesh.

    Parameters
    ----------
    path : str or path
        A file that VTK reads: ``.vtu``, ``.vtp``, ``.vts``, ``.vtr``, ``.vti``, ``.vtk``, ``.stl``, ``.obj``, ``.ply``.
    centers : bool
        Take the centres of cells (VTK's parametric centres, as ParaView's filter "Cell Centers"), where codes of finite
        volumes keep their fields; else the points.

    Returns
    -------
    dict
        Coordinates ``x``, ``y`` and ``z`` (m) with the dimension ``cell`` or ``point``, in the order of the file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the name ends otherwise, or the file holds no points.
    """
    places = places_of(read_mesh(path), centers=centers)
    return {a: xr.DataArray(places[:, k], dims="cell" if centers else "point") for k, a in enumerate(COMPONENTS)}
