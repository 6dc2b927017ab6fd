"""Files of ParaView: series of images (.vti and .pvd), and fields at the points or cells of a mesh (.vtu)."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.common.vtk_mesh import points_of, read_mesh
from xcg.readers.files.vtp import read_collection
from xcg.scene.frame import with_time
from xcg.scene.schema import COMPONENTS
from xcg.steps.mapping import each_step, shown
from xcg.writers.encoding import Encoding
from xcg.writers.files import (
    check_file,
    check_target,
    hidden_folder,
    publish,
    whole_file,
    write_by_vtk,
)
from xcg.writers.vtkhdf import Image, arrays_of, checked, times_of, with_components

_AS_THEY_ARE = Encoding()


def write_pvd(
    ds: xr.Dataset,
    path: Path,
    encoding: Encoding,
    *,
    overwrite: bool,
    progress: bool | None = False,
) -> None:
    """Write fields as ``name.pvd`` and ``name_0000.vti``, ``name_0001.vti``, ... beside it, step after step.

    Raises
    ------
    FileExistsError
        If one of the files exists and `overwrite` is False.
    ValueError
        If these are chains, or no image, as VTKHDF needs.
    """
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    if "chain_id" in ds:
        raise ValueError(
            f"{path}: chains are no image; save them as .vtkhdf, or step by step with to_vtp"
        )
    fields = encoding.noted(checked(ds))
    Image.of(fields)  # what is no image is refused before anything is written
    with shown(fields.sizes.get("time", 1), progress) as bar:

        def write(step: xr.Dataset, file: Path) -> None:
            image = image_of(step, encoding)
            write_by_vtk(vtkXMLImageDataWriter(), image, file, overwrite=overwrite)
            bar.update()

        write_series(fields, path, ".vti", write, overwrite=overwrite)


def image_of(step: xr.Dataset, encoding: Encoding = _AS_THEY_ARE) -> Any:
    """Return the fields of a step, in memory, as vtkImageData with units."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkDataArray
    from vtkmodules.vtkCommonDataModel import vtkImageData

    frame = Image.of(step)
    image = vtkImageData()
    image.SetDimensions(frame.nodes)
    image.SetOrigin(frame.origin)
    image.SetSpacing(frame.spacing)
    for array in arrays_of(step):
        data = step[array.variable]
        values = np.asarray(array.values(data.variable, frame))
        values = encoding.reduced(values, array.variable)
        column = numpy_to_vtk(values.reshape(-1, array.components), deep=True)
        column.SetName(array.name)
        rank = len({"component", "direction"} & {*data.dims})
        if rank:
            for k, label in enumerate(product(COMPONENTS, repeat=rank)):
                column.SetComponentName(k, "".join(label))
        if "units" in data.attrs:
            column.GetInformation().Set(vtkDataArray.UNITS_LABEL(), str(data.attrs["units"]))
        image.GetPointData().AddArray(column)
    return image


def write_series(
    fields: xr.Dataset,
    path: Path,
    suffix: str,
    write: Callable[[xr.Dataset, Path], None],
    *,
    overwrite: bool,
) -> None:
    """Compute and write steps one by one, as ``name_0000`` and so on with a suffix, and their list as ``name.pvd``.

    All steps are written, in a hidden folder, before the first of them gets its name. An old list
    goes before its steps are replaced and the new one comes last, so that a list never names steps
    of two series; old steps that the new series does not have are removed in the end.

    Parameters
    ----------
    fields : xarray.Dataset
        `write` is given each of its steps, computed, with the name of its file.
    path : Path
        The list.
    suffix : str
        That of the files.
    overwrite : bool
        Replace files that exist.

    Raises
    ------
    FileExistsError, FileNotFoundError
        If a file exists and `overwrite` is False, or the folder is not there; before anything is
        written.
    IsADirectoryError
        If a name is that of a folder; likewise.
    ValueError
        If times are no numbers that rise; likewise.
    """
    times = times_of(fields)
    if times is None:
        times = np.zeros(1)
    names = [path.with_name(f"{path.stem}_{t:04d}{suffix}") for t in range(len(times))]
    for name in (*names, path):
        check_file(name, overwrite=overwrite)
    rows = "".join(
        f'    <DataSet timestep="{float(time)!r}" part="0" file={quoteattr(name.name)}/>\n'
        for time, name in zip(times, names, strict=True)
    )
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    with hidden_folder(path) as folder:
        for step, name in zip(each_step(fields), names, strict=True):
            write(step, folder / name.name)
        old = _listed_files(path, suffix)
        check_target(path, overwrite=overwrite)
        path.unlink(missing_ok=True)
        for name in names:
            publish(folder / name.name, name, overwrite=overwrite)
    with whole_file(path, overwrite=overwrite) as part:
        part.write_text(f"{head}{rows}  </Collection>\n</VTKFile>\n")
    for name in old - set(names):
        name.unlink(missing_ok=True)


def _listed_files(path: Path, suffix: str) -> set[Path]:
    """Return the files that a list names, as far as this module has named them."""
    listed: set[Path] = set()
    if path.exists():
        with suppress(SceneError):  # a list by another hand, or damaged
            listed = {Path(name) for names, _ in read_collection(str(path)) for name in names}
    series = re.compile(rf"{re.escape(path.stem)}_\d{{4,}}{re.escape(suffix)}")
    return {name for name in listed if name.parent == path.parent and series.fullmatch(name.name)}


_OTHERS = ("time", "phase", "component", "direction")
_CLOSE = 1e-6  # of the mesh's size: single precision of files


def to_vtu(
    fields: xr.Dataset,
    mesh: str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> Path:
    """Write fields onto the mesh whose points or cells they are at, for ParaView.

    Scalars, vectors and tensors become arrays with 1, 3 and 9 components of the mesh's points or
    cells; a field with phases becomes one array a phase, as in VTKHDF. Lazy fields are
    computed step by step.

    Parameters
    ----------
    fields : xarray.Dataset
        A result of `xcg.coarse_grain` with ``at=xcg.mesh_points(mesh)``.
    mesh : str or path
        The file of the mesh.
    path : str or path
        ``*.vtu``. Of several steps each is a file of its own, ``name_0000.vtu`` and so on, and
        beside them is ``name.pvd``, which ParaView opens as a series.
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
        If the fields are not at the points or cells of this mesh: another number of them, or other
        places; or if some components of vectors are missing, or times are no numbers that rise.
    """
    path = Path(path)
    if path.suffix != ".vtu":
        raise ValueError(f"{path}: expected a name that ends with .vtu")
    fields = with_time(with_components(fields))
    data = read_mesh(mesh)
    dim, cells = _dim_of_points(fields, data, mesh)
    _check_points(fields, dim, points_of(data, centers=cells), mesh)
    bare = _bare_grid(data)
    write = partial(_write_mesh_step, dim, bare, cells=cells, overwrite=overwrite)
    if fields.sizes.get("time", 1) == 1:
        check_file(path, overwrite=overwrite)
        write(fields.compute(), path)
        return path
    series = path.with_suffix(".pvd")
    write_series(fields, series, ".vtu", write, overwrite=overwrite)
    return series


def _dim_of_points(fields: xr.Dataset, mesh: Any, path: str | os.PathLike[str]) -> tuple[str, bool]:
    """Dimension of the points, and whether they are cells of the mesh."""
    dims = [str(dim) for dim in fields.dims if dim not in _OTHERS]
    if len(dims) != 1:
        raise ValueError(
            f"the fields have the dimensions {dims} beside {', '.join(_OTHERS)}: expected one, that of its points"
        )
    (dim,) = dims
    without = [str(name) for name, data in fields.data_vars.items() if dim not in data.dims]
    if without or not fields.data_vars:
        raise ValueError(
            f"{without or 'fields'} holds nothing at the points: leave it out with fields.drop_vars"
        )
    size = fields.sizes[dim]
    counts = {"point": mesh.GetNumberOfPoints(), "cell": mesh.GetNumberOfCells()}
    kinds = [dim] if dim in counts else list(counts)
    fitting = [kind for kind in kinds if counts[kind] == size]
    if len(fitting) != 1:
        raise ValueError(
            f"{os.fspath(path)} has {counts['point']} points and {counts['cell']} cells, and the fields have {size} "
            f"along {dim!r}: take them at=xcg.mesh_points(...) of it, or name the dimension 'point' or 'cell'"
        )
    return dim, fitting == ["cell"]


def _check_points(
    fields: xr.Dataset, dim: str, points: NDArray, path: str | os.PathLike[str]
) -> None:
    """Raise ValueError for fields at other points, as of another mesh or order."""
    size = np.ptp(points, axis=0).max()
    for k, a in enumerate(COMPONENTS):
        if a in fields.coords and fields[a].dims in ((), (dim,)):
            away = np.abs(fields[a].to_numpy() - points[:, k])
            if not away.max() <= _CLOSE * size:
                worst = int(away.argmax())
                of_field = np.broadcast_to(fields[a].to_numpy(), len(points))[worst]
                raise ValueError(
                    f"{os.fspath(path)}: the field's {dim} {worst} is at {a} = {of_field:.9g}, and that of the mesh at "
                    f"{points[worst, k]:.9g}: the fields are those of another mesh, or in another order"
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


def _write_mesh_step(
    dim: str, bare: Any, step: xr.Dataset, path: Path, *, cells: bool, overwrite: bool
) -> None:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    if "time" in step.dims:
        step = step.isel(time=0)
    grid = vtkUnstructuredGrid()
    grid.ShallowCopy(bare)
    target = grid.GetPointData()
    if cells:
        target = grid.GetCellData()
    for array in arrays_of(step):
        data = array.part(step[array.variable].variable)
        order = (dim, "component", "direction")
        values = data.transpose(*order, missing_dims="ignore").to_numpy()
        table = np.ascontiguousarray(values.reshape(len(values), -1), array.dtype)
        column = numpy_to_vtk(table, deep=True)
        column.SetName(array.name)
        target.AddArray(column)
    write_by_vtk(vtkXMLUnstructuredGridWriter(), grid, path, overwrite=overwrite)
