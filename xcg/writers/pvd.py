"""Series of image files for ParaView: one .vti a step, and the .pvd that lists them."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.files.vtp import read_collection
from xcg.steps.mapping import each_step
from xcg.writers.encoding import Encoding
from xcg.writers.files import check_file, check_target, hidden_folder, publish, whole_file, write_by_vtk
from xcg.writers.vtkhdf import AXES, Image, arrays_of, checked, times_of


def write_pvd(ds: xr.Dataset, path: Path, encoding: Encoding, *, overwrite: bool) -> None:
    """Write fields as ``name.pvd`` and ``name_0000.vti``, ``name_0001.vti``, ... beside it, step after step.

    Raises
    ------
    FileExistsError
        If one of the files exists and `overwrite` is False.
    ValueError
        If these are chains, or no image; see `to_vtkhdf`.
    """
    if "chain_id" in ds:
        raise ValueError(f"{path}: chains are no image; save them as .vtkhdf, or step by step with to_vtp")
    fields = encoding.noted(checked(ds))
    Image.of(fields)  # what is no image is refused before anything is written
    write_series(fields, path, ".vti", partial(_write_step, encoding, overwrite=overwrite), overwrite=overwrite)


def _write_step(encoding: Encoding, step: xr.Dataset, path: Path, *, overwrite: bool) -> None:
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    write_by_vtk(vtkXMLImageDataWriter(), image_of(step, encoding.reduced), path, overwrite=overwrite)


def image_of(step: xr.Dataset, reduced: Callable[[NDArray], NDArray] = np.asarray) -> Any:
    """Return the fields of a step, in memory, as vtkImageData with units; `reduced` is called on all values."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkDataArray
    from vtkmodules.vtkCommonDataModel import vtkImageData

    frame, image = Image.of(step), vtkImageData()
    image.SetDimensions(frame.nodes)
    image.SetOrigin(frame.origin)
    image.SetSpacing(frame.spacing)
    for array in arrays_of(step):
        data = step[array.variable]
        values = reduced(np.asarray(array.values(data.variable, frame)))
        found = numpy_to_vtk(values.reshape(-1, array.components), deep=True)
        found.SetName(array.name)
        for k, label in enumerate(_labels(array.components)):
            found.SetComponentName(k, label)
        if "units" in data.attrs:
            found.GetInformation().Set(vtkDataArray.UNITS_LABEL(), str(data.attrs["units"]))
        image.GetPointData().AddArray(found)
    return image


def _labels(components: int) -> list[str]:
    """Names of the components of a vector or a tensor; none of a scalar."""
    return {3: list(AXES), 9: [a + b for a in AXES for b in AXES]}.get(components, [])


def write_series(
    fields: xr.Dataset, path: Path, suffix: str, write: Callable[[xr.Dataset, Path], None], *, overwrite: bool
) -> None:
    """Compute and write steps one by one, as ``name_0000`` and so on with a suffix, and their list as ``name.pvd``.

    All steps are written, in a hidden folder, before the first of them gets its name. An old list goes before its steps
    are replaced and the new one comes last, so that a list never names steps of two series; old steps that the new
    series does not have are removed in the end.

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
        If a file exists and `overwrite` is False, or the folder is not there; before anything is written.
    IsADirectoryError
        If a name is that of a folder; likewise.
    ValueError
        If times are no numbers that rise; likewise.
    """
    known = times_of(fields)
    times = np.zeros(1) if known is None else known
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
        old = _steps_of(path, suffix)
        check_target(path, overwrite=overwrite)
        path.unlink(missing_ok=True)
        for name in names:
            publish(folder / name.name, name, overwrite=overwrite)
    with whole_file(path, overwrite=overwrite) as part:
        part.write_text(f"{head}{rows}  </Collection>\n</VTKFile>\n")
    for name in old - set(names):
        name.unlink(missing_ok=True)


def _steps_of(path: Path, suffix: str) -> set[Path]:
    """Files of the series that a list names, none but those that this module gives a name to."""
    if not path.exists():
        return set()
    with suppress(SceneError):  # a list by another hand, or damaged
        listed = {Path(name) for name, _ in read_collection(str(path))}
        own = re.compile(rf"{re.escape(path.stem)}_\d{{4,}}{re.escape(suffix)}")
        return {name for name in listed if name.parent == path.parent and own.fullmatch(name.name)}
    return set()
