"""ParaView's older formats: an image a step (``.vti``), and the list of them with their times (``.pvd``)."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from xcg.writers.encoding import Encoding
from xcg.writers.files import write_by_vtk
from xcg.writers.pvd import write_series
from xcg.writers.vtkhdf import AXES, Image, arrays_of, checked


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
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkDataArray
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    frame, image = Image.of(step), vtkImageData()
    image.SetDimensions(frame.nodes)
    image.SetOrigin(frame.origin)
    image.SetSpacing(frame.spacing)
    for array in arrays_of(step):
        data = step[array.variable]
        values = encoding.reduced(np.asarray(array.values(data.variable, frame)))
        found = numpy_to_vtk(values.reshape(-1, array.components), deep=True)
        found.SetName(array.name)
        for k, label in enumerate(_labels(array.components)):
            found.SetComponentName(k, label)
        if "units" in data.attrs:
            found.GetInformation().Set(vtkDataArray.UNITS_LABEL(), str(data.attrs["units"]))
        image.GetPointData().AddArray(found)
    write_by_vtk(vtkXMLImageDataWriter(), image, path, overwrite=overwrite)


def _labels(components: int) -> list[str]:
    """Names of the components of a vector or a tensor; none of a scalar."""
    return {3: list(AXES), 9: [a + b for a in AXES for b in AXES]}.get(components, [])
