"""Images for ParaView: VTK reads back what the fields hold, with times, names of components and units."""

import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDataArray
from vtkmodules.vtkIOXML import vtkXMLImageDataReader

import xcg
from tests import steps_of_random_scenes
from xcg.readers.vtp import read_collection


def read(path):
    reader = vtkXMLImageDataReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


@pytest.mark.parametrize("axes", ["xyz", "xz", "z"])
@pytest.mark.parametrize("by", [None, "species"])
def test_images_hold_the_fields(tmp_path, axes, by):
    f = steps_of_random_scenes(3).cg.coarse_grain(["density", "velocity", "stress"], axes=axes, spacing=1.0, by=by)
    f.cg.save(tmp_path / "f.pvd")
    listed = read_collection(str(tmp_path / "f.pvd"))
    assert [time for _, time in listed] == f.time.values.tolist()
    for t, (path, _) in enumerate(listed):
        image = read(path)
        for k, a in enumerate("xyz"):
            nodes = f[a].values if a in f.dims else np.zeros(1)
            assert image.GetDimensions()[k] == len(nodes)
            if len(nodes) > 1:
                np.testing.assert_allclose(
                    image.GetOrigin()[k] + image.GetSpacing()[k] * np.arange(len(nodes)), nodes, atol=1e-12
                )
        step = f.isel(time=t) if by is None else f.isel(time=t).sel(phase="bulk")
        for name, tail in (("density", ()), ("velocity", ("component",)), ("stress", ("component", "direction"))):
            array = image.GetPointData().GetArray(name)
            expected = step[name].transpose(*sorted(axes, reverse=True), *tail).values
            np.testing.assert_array_equal(vtk_to_numpy(array).reshape(expected.shape), expected)
            assert array.GetInformation().Get(vtkDataArray.UNITS_LABEL()) == f[name].attrs["units"]
        stress = image.GetPointData().GetArray("stress")
        assert [stress.GetComponentName(k) for k in (0, 1, 8)] == ["xx", "xy", "zz"]
        if by:
            assert image.GetPointData().GetArray("velocity_phase_1") is not None


def test_files_that_exist_are_kept(tmp_path):
    f = xcg.datasets.random_scene(30).cg.coarse_grain("density", axes="z")
    f.cg.save(tmp_path / "f.pvd")
    (tmp_path / "f.pvd").unlink()
    with pytest.raises(FileExistsError, match=r"f_0000\.vti"):
        f.cg.save(tmp_path / "f.pvd")
    f.cg.save(tmp_path / "f.pvd", overwrite=True, dtype="float32")
    assert vtk_to_numpy(read(tmp_path / "f_0000.vti").GetPointData().GetArray("density")).dtype == "f4"


def test_what_is_no_image_is_refused(tmp_path):
    scene = xcg.datasets.random_scene(30)
    with pytest.raises(ValueError, match="dimensions"):
        scene.cg.save(tmp_path / "f.pvd")
    assert not list(tmp_path.iterdir())
