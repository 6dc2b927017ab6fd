"""Images for ParaView as VTK reads them, and fields on the points and cells of other codes' meshes."""

import numpy as np
import pytest
import xarray as xr
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import VTK_DOUBLE, vtkDataArray, vtkPoints
from vtkmodules.vtkCommonDataModel import (
    VTK_HEXAHEDRON,
    VTK_TETRA,
    vtkImageData,
    vtkUnstructuredGrid,
)
from vtkmodules.vtkFiltersCore import vtkTriangleFilter
from vtkmodules.vtkFiltersSources import vtkCubeSource
from vtkmodules.vtkIOGeometry import vtkSTLWriter
from vtkmodules.vtkIOLegacy import vtkUnstructuredGridWriter
from vtkmodules.vtkIOXML import (
    vtkXMLImageDataReader,
    vtkXMLImageDataWriter,
    vtkXMLPolyDataWriter,
    vtkXMLUnstructuredGridReader,
    vtkXMLUnstructuredGridWriter,
)

import xcg
from tests.scenes import random_steps
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
    f = random_steps(3).cg.coarse_grain(
        ["density", "velocity", "stress"], axes=axes, spacing=1.0, by=by
    )
    f.cg.save(tmp_path / "f.pvd")
    listed = read_collection(str(tmp_path / "f.pvd"))
    assert [time for _, time in listed] == f.time.values.tolist()
    for t, ((path,), _) in enumerate(listed):
        image = read(path)
        for k, a in enumerate("xyz"):
            nodes = f[a].values if a in f.dims else np.zeros(1)
            assert image.GetDimensions()[k] == len(nodes)
            if len(nodes) > 1:
                np.testing.assert_allclose(
                    image.GetOrigin()[k] + image.GetSpacing()[k] * np.arange(len(nodes)),
                    nodes,
                    atol=1e-12,
                )
        step = f.isel(time=t) if by is None else f.isel(time=t).sel(phase="bulk")
        for name, tail in (
            ("density", ()),
            ("velocity", ("component",)),
            ("stress", ("component", "direction")),
        ):
            array = image.GetPointData().GetArray(name)
            expected = step[name].transpose(*sorted(axes, reverse=True), *tail).values
            np.testing.assert_array_equal(vtk_to_numpy(array).reshape(expected.shape), expected)
            assert array.GetInformation().Get(vtkDataArray.UNITS_LABEL()) == f[name].attrs["units"]
        stress = image.GetPointData().GetArray("stress")
        assert [stress.GetComponentName(k) for k in (0, 1, 8)] == ["xx", "xy", "zz"]
        if by:
            assert image.GetPointData().GetArray("velocity_phase_1") is not None


def test_existing_files_are_kept(tmp_path):
    f = xcg.datasets.random_scene(30).cg.coarse_grain("density", axes="z")
    f.cg.save(tmp_path / "f.pvd")
    (tmp_path / "f.pvd").unlink()
    with pytest.raises(FileExistsError, match=r"f_0000\.vti"):
        f.cg.save(tmp_path / "f.pvd")
    f.cg.save(tmp_path / "f.pvd", overwrite=True, dtype="float32")
    assert (
        vtk_to_numpy(read(tmp_path / "f_0000.vti").GetPointData().GetArray("density")).dtype == "f4"
    )


def test_fields_that_are_no_image_raise(tmp_path):
    scene = xcg.datasets.random_scene(30)
    with pytest.raises(ValueError, match="dimensions"):
        scene.cg.save(tmp_path / "f.pvd")
    assert not list(tmp_path.iterdir())


def test_a_shorter_series_replaces_a_longer_one(tmp_path):
    """Steps that only the old list names go; files of other names stay."""
    f = random_steps(4).cg.coarse_grain("density", axes="z", spacing=1.0)
    other = tmp_path / "f_0009.vti"
    other.write_text("mine")
    f.cg.save(tmp_path / "f.pvd")
    f.isel(time=[0, 3]).cg.save(tmp_path / "f.pvd", overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "f.pvd",
        "f_0000.vti",
        "f_0001.vti",
        other.name,
    ]
    assert [time for _, time in read_collection(str(tmp_path / "f.pvd"))] == f.time.values[
        [0, 3]
    ].tolist()


def test_a_series_that_cannot_be_finished_leaves_the_old_one(tmp_path, monkeypatch):
    """Until all new steps are written, list and steps are the old ones; nothing hidden is left."""
    f = random_steps(3).cg.coarse_grain("density", axes="z", spacing=1.0)
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
        with pytest.raises(
            IsADirectoryError, match=f"{name} is a folder, and a file is not put in its place"
        ):
            fields.cg.save(tmp_path / f"{name[0]}.pvd", overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["f.pvd", "g_0000.vti"]


# --- meshes of other codes -------------------------------------------------------------------------------

CORNERS = 1.0 + np.array(
    [[x, y, z] for z in (0, 3) for x, y in ((0, 0), (2, 0), (2, 1.5), (0, 1.5))]
)


def write_mesh(path):
    """A box of a hexahedron, and a tetrahedron on top of it: eight points and one, two cells."""
    grid = vtkUnstructuredGrid()
    points = vtkPoints()
    points.SetDataType(VTK_DOUBLE)
    for place in [*CORNERS.tolist(), [2.0, 2.0, 6.0]]:
        points.InsertNextPoint(place)
    grid.SetPoints(points)
    grid.InsertNextCell(VTK_HEXAHEDRON, 8, range(8))
    grid.InsertNextCell(VTK_TETRA, 4, [4, 5, 6, 8])
    writer = (
        vtkXMLUnstructuredGridWriter() if path.suffix == ".vtu" else vtkUnstructuredGridWriter()
    )
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    writer.Write()
    return path


def read_mesh(path):
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


@pytest.fixture
def mesh(tmp_path):
    return write_mesh(tmp_path / "mesh.vtu")


@pytest.fixture(scope="module")
def scene():
    return xcg.datasets.random_scene(40, seed=3)


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
def test_points_and_centres_equal_those_of_the_file(tmp_path, suffix):
    path = write_mesh(tmp_path / f"mesh{suffix}")
    points = xcg.mesh_points(path)
    centres = xcg.mesh_points(path, centers=True)
    assert points["x"].dims == ("point",)
    assert centres["x"].dims == ("cell",)
    np.testing.assert_allclose(np.stack([points[a] for a in "xyz"], 1)[:8], CORNERS)
    expected = [CORNERS.mean(axis=0), np.mean([*CORNERS[4:7], [2, 2, 6]], axis=0)]
    np.testing.assert_allclose(np.stack([centres[a] for a in "xyz"], 1), expected)


@pytest.mark.parametrize("suffix", [".stl", ".vtp", ".vti"])
def test_points_of_surfaces_and_images(tmp_path, suffix):
    source = vtkImageData() if suffix == ".vti" else vtkCubeSource()
    writers = {
        ".stl": vtkSTLWriter,
        ".vtp": vtkXMLPolyDataWriter,
        ".vti": vtkXMLImageDataWriter,
    }
    writer = writers[suffix]()
    if suffix == ".vti":
        source.SetDimensions(3, 2, 2)
        source.SetSpacing(0.5, 2.0, 3.0)
        writer.SetInputData(source)
    else:
        faces = vtkTriangleFilter()
        faces.SetInputConnection(source.GetOutputPort())
        writer.SetInputConnection(faces.GetOutputPort())
    writer.SetFileName(str(tmp_path / f"m{suffix}"))
    writer.Write()
    points = np.stack(list(xcg.mesh_points(tmp_path / f"m{suffix}").values()), 1)
    centres = np.stack(list(xcg.mesh_points(tmp_path / f"m{suffix}", centers=True).values()), 1)
    if suffix == ".vti":
        np.testing.assert_allclose(points[:4], [[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [0, 2, 0]])
        np.testing.assert_allclose(centres, [[0.25, 1, 1.5], [0.75, 1, 1.5]])
    else:
        np.testing.assert_allclose(np.abs(points), 0.5)
        assert len(centres) == 12


@pytest.mark.parametrize("centers", [True, False])
@pytest.mark.parametrize("lazy", [True, False])
def test_fields_go_back_onto_the_mesh(scene, mesh, tmp_path, centers, lazy):
    names = ["density", "velocity", "contact_stress"]
    ds = scene.chunk({"time": 1}) if lazy else scene
    f = ds.cg.coarse_grain(
        names, by="species", groups=[1, 2], at=xcg.mesh_points(mesh, centers=centers)
    )
    assert f.cg.to_vtu(mesh, tmp_path / "out.vtu") == tmp_path / "out.vtu"
    grid = read_mesh(tmp_path / "out.vtu")
    assert (grid.GetNumberOfPoints(), grid.GetNumberOfCells()) == (9, 2)
    data = grid.GetCellData() if centers else grid.GetPointData()
    assert (grid.GetPointData() if centers else grid.GetCellData()).GetNumberOfArrays() == 0
    for phase in f.phase.values:
        end = "" if phase == "bulk" else f"_phase_{phase}"
        for name, components in zip(names, (1, 3, 9), strict=True):
            found = vtk_to_numpy(data.GetArray(name + end)).reshape(-1, components)
            expected = f[name].isel(time=0).sel(phase=phase).values
            np.testing.assert_array_equal(found, expected.reshape(-1, components))


def test_components_in_any_order_make_the_same_file(scene, mesh, tmp_path):
    f = scene.cg.coarse_grain(["velocity", "contact_stress"], at=xcg.mesh_points(mesh))
    f.cg.to_vtu(mesh, tmp_path / "as_it_is.vtu")
    f.sel(component=["z", "x", "y"], direction=["y", "z", "x"]).cg.to_vtu(
        mesh, tmp_path / "turned.vtu"
    )
    assert (tmp_path / "as_it_is.vtu").read_bytes() == (tmp_path / "turned.vtu").read_bytes()
    with pytest.raises(
        ValueError, match=r"'component' of .*'velocity'\] holds \['x', 'y'\], expected x, y and z"
    ):
        f.sel(component=["x", "y"]).cg.to_vtu(mesh, tmp_path / "some.vtu")


def test_several_steps_are_a_series(scene, mesh, tmp_path):
    ds = xr.concat(
        [scene, scene.assign(position=scene.position + 1).assign_coords(time=[2.5])], "time"
    )
    f = ds.cg.coarse_grain("density", at=xcg.mesh_points(mesh))
    assert f.cg.to_vtu(mesh, tmp_path / "out.vtu") == tmp_path / "out.pvd"
    text = (tmp_path / "out.pvd").read_text()
    assert f'timestep="{float(f.time[0])!r}" part="0" file="out_0000.vtu"' in text
    assert 'timestep="2.5" part="0" file="out_0001.vtu"' in text
    for t in (0, 1):
        found = vtk_to_numpy(
            read_mesh(tmp_path / f"out_000{t}.vtu").GetPointData().GetArray("density")
        )
        np.testing.assert_array_equal(found, f.density[t])
    with pytest.raises(FileExistsError):
        f.cg.to_vtu(mesh, tmp_path / "out.vtu")
    f.cg.to_vtu(mesh, tmp_path / "out.vtu", overwrite=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.drop_vars("time"), "dimension 'time' has no coordinate; assign one"),
        (
            lambda f: f.assign_coords(time=np.array(["2020", "2021"], "M8[ns]")),
            "'time' holds .*2020.*; expected",
        ),
        (lambda f: f.isel(time=[1, 0]), "follows 2.5 at index 1; order the steps"),
    ],
)
def test_a_series_needs_times(scene, mesh, tmp_path, change, message):
    ds = xr.concat([scene, scene.assign_coords(time=[2.5])], "time")
    f = ds.cg.coarse_grain("density", at=xcg.mesh_points(mesh))
    with pytest.raises(ValueError, match=message):
        change(f).cg.to_vtu(mesh, tmp_path / "out.vtu")
    assert [p.name for p in tmp_path.iterdir()] == [mesh.name]


def test_fields_of_another_mesh_raise(scene, mesh, tmp_path):
    at = xcg.mesh_points(mesh)
    f = scene.cg.coarse_grain("density", at=at)
    with pytest.raises(
        ValueError, match=r"mesh\.vtu has 9 points and 2 cells, and the fields have 8 along 'point'"
    ):
        f.isel(point=slice(8)).cg.to_vtu(mesh, tmp_path / "out.vtu")
    with pytest.raises(ValueError, match=r"point [0-9] is at x = .* in another order"):
        f.isel(point=slice(None, None, -1)).cg.to_vtu(mesh, tmp_path / "out.vtu")
    with pytest.raises(ValueError, match=r"dimensions \['x', 'y', 'z'\]"):
        scene.cg.coarse_grain("density").cg.to_vtu(mesh, tmp_path / "out.vtu")
    with pytest.raises(ValueError, match=r"ends with \.vtu"):
        f.cg.to_vtu(mesh, tmp_path / "out.vtk")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mesh.vtu"]


def test_files_that_are_no_mesh_raise(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        xcg.mesh_points(tmp_path / "none.vtu")
    with pytest.raises(ValueError, match=r"expected a mesh in \.vtu"):
        xcg.mesh_points(tmp_path / "mesh.msh")
    for suffix in (".vtu", ".vtk", ".stl"):
        (tmp_path / f"bad{suffix}").write_text("not a mesh")
        with pytest.raises(ValueError, match=rf"bad\{suffix}: VTK reads no points"):
            xcg.mesh_points(tmp_path / f"bad{suffix}")
