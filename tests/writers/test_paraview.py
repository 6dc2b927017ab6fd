"""Images for ParaView: VTK reads back what the fields hold, with times, names of components and units."""

import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDataArray
from vtkmodules.vtkIOXML import vtkXMLImageDataReader

import xcg
from tests import steps_of_random_scenes
from xcg.readers.files.vtp import read_collection
from xcg.writers import paraview as vti


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


def test_a_shorter_series_takes_the_place_of_a_longer_one(tmp_path):
    """Steps that only the old list names go; files of other names stay."""
    f = steps_of_random_scenes(4).cg.coarse_grain("density", axes="z", spacing=1.0)
    other = tmp_path / "f_0009.vti"
    other.write_text("mine")
    f.cg.save(tmp_path / "f.pvd")
    f.isel(time=[0, 3]).cg.save(tmp_path / "f.pvd", overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["f.pvd", "f_0000.vti", "f_0001.vti", other.name]
    assert [time for _, time in read_collection(str(tmp_path / "f.pvd"))] == f.time.values[[0, 3]].tolist()


def test_a_series_that_cannot_be_finished_leaves_the_old_one(tmp_path, monkeypatch):
    """Until all new steps are written, list and steps are the old ones; nothing hidden is left."""
    f = steps_of_random_scenes(3).cg.coarse_grain("density", axes="z", spacing=1.0)
    f.cg.save(tmp_path / "f.pvd")
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    write = vti.write_by_vtk

    def fail(writer, data, path, **more):
        if path.name == "f_0002.vti":
            msg = "full"
            raise OSError(msg)
        write(writer, data, path, **more)

    monkeypatch.setattr(vti, "write_by_vtk", fail)
    with pytest.raises(OSError, match="full"):
        (2 * f).cg.save(tmp_path / "f.pvd", overwrite=True)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_folders_are_not_replaced_by_files(tmp_path):
    fields = xcg.datasets.random_scene(20).cg.coarse_grain("density")
    for name in ("f.pvd", "g_0000.vti"):
        (tmp_path / name).mkdir()
        with pytest.raises(IsADirectoryError, match=f"{name} is a folder, and a file is not put in its place"):
            fields.cg.save(tmp_path / f"{name[0]}.pvd", overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["f.pvd", "g_0000.vti"]
