"""Fields at the points or cells of a mesh, written back onto it as VTK's unstructured grids."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.vtk_mesh import places_of, read_mesh
from xcg.scene.frame import with_time
from xcg.scene.schema import COMPONENTS
from xcg.writers.files import check_file, write_by_vtk
from xcg.writers.pvd import write_series
from xcg.writers.vtkhdf import arrays_of, with_components

_OTHERS = ("time", "phase", "component", "direction")
_CLOSE = 1e-6  # of the mesh's size: single precision of files


def to_vtu(
    fields: xr.Dataset, mesh: str | os.PathLike[str], path: str | os.PathLike[str], *, overwrite: bool = False
) -> Path:
    """Write fields onto the mesh whose points or cells they are at, for ParaView.

    Scalars, vectors and tensors become arrays with 1, 3 and 9 components of the mesh's points or cells; a field with
    phases becomes one array a phase, as in `to_vtkhdf`. Lazy fields are computed step by step.

    Parameters
    ----------
    fields : xarray.Dataset
        A result of `xcg.coarse_grain` with ``at=xcg.mesh_points(mesh)``.
    mesh : str or path
        The file of the mesh.
    path : str or path
        ``*.vtu``. Of several steps each is a file of its own, ``name_0000.vtu`` and so on, and beside them is
        ``name.pvd``, which ParaView opens as a series.
    overwrite : bool
        Replace files that exist.

    Returns
    -------
    pathlib.Path
        The file to open: ``*.vtu``, or ``*.pvd`` for several steps.

    Raises
    ------
    FileExistsError, FileNotFoundError
        If a file exists and `overwrite` is False, or a file or folder is not there.
    ValueError
        If the fields are not at the points or cells of this mesh: another number of them, or other places; or if some
        components of vectors are missing, or times are no numbers that rise.
    """
    path = Path(path)
    if path.suffix != ".vtu":
        raise ValueError(f"{path}: expected a name that ends with .vtu")
    fields, data = with_time(with_components(fields)), read_mesh(mesh)
    dim, cells = _place_of(fields, data, mesh)
    _check_places(fields, dim, places_of(data, centers=cells), mesh)
    bare = _bare_grid(data)
    write = partial(_write_step, dim, bare, cells=cells, overwrite=overwrite)
    if fields.sizes.get("time", 1) == 1:
        check_file(path, overwrite=overwrite)
        write(fields.compute(), path)
        return path
    series = path.with_suffix(".pvd")
    write_series(fields, series, ".vtu", write, overwrite=overwrite)
    return series


def _place_of(fields: xr.Dataset, mesh: Any, path: str | os.PathLike[str]) -> tuple[str, bool]:
    """Dimension of the points, and whether they are cells of the mesh."""
    dims = [str(dim) for dim in fields.dims if dim not in _OTHERS]
    if len(dims) != 1:
        raise ValueError(
            f"the fields have the dimensions {dims} beside {', '.join(_OTHERS)}: expected one, that of its points"
        )
    without = [str(name) for name, data in fields.data_vars.items() if dims[0] not in data.dims]
    if without or not fields.data_vars:
        raise ValueError(f"{without or 'fields'} holds nothing at the points: leave it out with fields.drop_vars")
    size, counts = fields.sizes[dims[0]], {"point": mesh.GetNumberOfPoints(), "cell": mesh.GetNumberOfCells()}
    fits = [kind for kind, count in counts.items() if count == size and dims[0] in (kind, *({dims[0]} - set(counts)))]
    if len(fits) != 1:
        raise ValueError(
            f"{os.fspath(path)} has {counts['point']} points and {counts['cell']} cells, and the fields have {size} "
            f"along {dims[0]!r}: take them at=xcg.mesh_points(...) of it, or name the dimension 'point' or 'cell'"
        )
    return dims[0], fits == ["cell"]


def _check_places(fields: xr.Dataset, dim: str, places: NDArray, path: str | os.PathLike[str]) -> None:
    """Refuse fields at other places, as of another mesh or order."""
    size = np.ptp(places, axis=0).max()
    for k, a in enumerate(COMPONENTS):
        if a in fields.coords and fields[a].dims in ((), (dim,)):
            away = np.abs(fields[a].to_numpy() - places[:, k])
            if not away.max() <= _CLOSE * size:
                row = int(away.argmax())
                found = np.broadcast_to(fields[a].to_numpy(), len(places))[row]
                raise ValueError(
                    f"{os.fspath(path)}: the field's {dim} {row} is at {a} = {found:.9g}, and that of the mesh at "
                    f"{places[row, k]:.9g}: the fields are those of another mesh, or in another order"
                )


def _bare_grid(mesh: Any) -> Any:
    """Return the mesh as an unstructured grid without data, its points and cells in their order."""
    from vtkmodules.vtkFiltersCore import vtkAppendFilter

    append = vtkAppendFilter()
    append.MergePointsOff()
    append.AddInputData(mesh)
    append.Update()
    grid = append.GetOutput()
    for data in (grid.GetPointData(), grid.GetCellData(), grid.GetFieldData()):
        data.Initialize()
    return grid


def _write_step(dim: str, bare: Any, step: xr.Dataset, path: Path, *, cells: bool, overwrite: bool) -> None:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    step = step.isel(time=0) if "time" in step.dims else step
    grid = vtkUnstructuredGrid()
    grid.ShallowCopy(bare)
    target = grid.GetCellData() if cells else grid.GetPointData()
    for array in arrays_of(step):
        data = step[array.variable].variable
        data = data if array.phase is None else data.isel(phase=array.phase)
        values = data.transpose(dim, *(d for d in ("component", "direction") if d in data.dims)).to_numpy()
        found = numpy_to_vtk(np.ascontiguousarray(values.reshape(len(values), -1), array.dtype), deep=True)
        found.SetName(array.name)
        target.AddArray(found)
    write_by_vtk(vtkXMLUnstructuredGridWriter(), grid, path, overwrite=overwrite)
