"""Meshes of other codes: their points and cells as nodes, and fields written back onto them."""

import numpy as np
import pytest
import xarray as xr

import xcg

vtk = pytest.importorskip("vtk")
from vtkmodules.util.numpy_support import vtk_to_numpy  # noqa: E402

CORNERS = 1.0 + np.array([[x, y, z] for z in (0, 3) for x, y in ((0, 0), (2, 0), (2, 1.5), (0, 1.5))])


def write_mesh(path):
    """A box of a hexahedron, and a tetrahedron on top of it: eight points and one, two cells."""
    grid, points = vtk.vtkUnstructuredGrid(), vtk.vtkPoints()
    points.SetDataType(vtk.VTK_DOUBLE)
    for place in [*CORNERS.tolist(), [2.0, 2.0, 6.0]]:
        points.InsertNextPoint(place)
    grid.SetPoints(points)
    grid.InsertNextCell(vtk.VTK_HEXAHEDRON, 8, range(8))
    grid.InsertNextCell(vtk.VTK_TETRA, 4, [4, 5, 6, 8])
    writer = vtk.vtkXMLUnstructuredGridWriter() if path.suffix == ".vtu" else vtk.vtkUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    writer.Write()
    return path


def read(path):
    reader = vtk.vtkXMLUnstructuredGridReader()
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
def test_points_and_centres_are_those_of_the_file(tmp_path, suffix):
    path = write_mesh(tmp_path / f"mesh{suffix}")
    points, centres = xcg.mesh_points(path), xcg.mesh_points(path, centers=True)
    assert points["x"].dims == ("point",)
    assert centres["x"].dims == ("cell",)
    np.testing.assert_allclose(np.stack([points[a] for a in "xyz"], 1)[:8], CORNERS)
    expected = [CORNERS.mean(axis=0), np.mean([*CORNERS[4:7], [2, 2, 6]], axis=0)]
    np.testing.assert_allclose(np.stack([centres[a] for a in "xyz"], 1), expected)


@pytest.mark.parametrize("suffix", [".stl", ".vtp", ".vti"])
def test_surfaces_and_images(tmp_path, suffix):
    source = vtk.vtkImageData() if suffix == ".vti" else vtk.vtkCubeSource()
    writers = {".stl": vtk.vtkSTLWriter, ".vtp": vtk.vtkXMLPolyDataWriter, ".vti": vtk.vtkXMLImageDataWriter}
    writer = writers[suffix]()
    if suffix == ".vti":
        source.SetDimensions(3, 2, 2)
        source.SetSpacing(0.5, 2.0, 3.0)
        writer.SetInputData(source)
    else:
        faces = vtk.vtkTriangleFilter()
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
    f = ds.cg.coarse_grain(names, by="species", groups=[1, 2], at=xcg.mesh_points(mesh, centers=centers))
    assert f.cg.to_vtu(mesh, tmp_path / "out.vtu") == tmp_path / "out.vtu"
    grid = read(tmp_path / "out.vtu")
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
    f.sel(component=["z", "x", "y"], direction=["y", "z", "x"]).cg.to_vtu(mesh, tmp_path / "turned.vtu")
    assert (tmp_path / "as_it_is.vtu").read_bytes() == (tmp_path / "turned.vtu").read_bytes()
    with pytest.raises(ValueError, match=r"'component' of .*'velocity'\] holds \['x', 'y'\], expected x, y and z"):
        f.sel(component=["x", "y"]).cg.to_vtu(mesh, tmp_path / "some.vtu")


def test_several_steps_are_a_series(scene, mesh, tmp_path):
    ds = xr.concat([scene, scene.assign(position=scene.position + 1).assign_coords(time=[2.5])], "time")
    f = ds.cg.coarse_grain("density", at=xcg.mesh_points(mesh))
    assert f.cg.to_vtu(mesh, tmp_path / "out.vtu") == tmp_path / "out.pvd"
    text = (tmp_path / "out.pvd").read_text()
    assert f'timestep="{float(f.time[0])!r}" part="0" file="out_0000.vtu"' in text
    assert 'timestep="2.5" part="0" file="out_0001.vtu"' in text
    for t in (0, 1):
        found = vtk_to_numpy(read(tmp_path / f"out_000{t}.vtu").GetPointData().GetArray("density"))
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
        (lambda f: f.isel(time=[1, 0]), "'time' goes from 2.5 to .* expected to rise"),
    ],
)
def test_a_series_needs_times(scene, mesh, tmp_path, change, message):
    ds = xr.concat([scene, scene.assign_coords(time=[2.5])], "time")
    f = ds.cg.coarse_grain("density", at=xcg.mesh_points(mesh))
    with pytest.raises(ValueError, match=message):
        change(f).cg.to_vtu(mesh, tmp_path / "out.vtu")
    assert [p.name for p in tmp_path.iterdir()] == [mesh.name]


def test_fields_of_another_mesh_are_refused(scene, mesh, tmp_path):
    at = xcg.mesh_points(mesh)
    f = scene.cg.coarse_grain("density", at=at)
    with pytest.raises(ValueError, match=r"mesh\.vtu has 9 points and 2 cells, and the fields have 8 along 'point'"):
        f.isel(point=slice(8)).cg.to_vtu(mesh, tmp_path / "out.vtu")
    with pytest.raises(ValueError, match=r"point [0-9] is at x = .* in another order"):
        f.isel(point=slice(None, None, -1)).cg.to_vtu(mesh, tmp_path / "out.vtu")
    with pytest.raises(ValueError, match=r"dimensions \['x', 'y', 'z'\]"):
        scene.cg.coarse_grain("density").cg.to_vtu(mesh, tmp_path / "out.vtu")
    with pytest.raises(ValueError, match=r"ends with \.vtu"):
        f.cg.to_vtu(mesh, tmp_path / "out.vtk")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mesh.vtu"]


def test_files_that_are_no_mesh(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        xcg.mesh_points(tmp_path / "none.vtu")
    with pytest.raises(ValueError, match=r"expected a mesh in \.vtu"):
        xcg.mesh_points(tmp_path / "mesh.msh")
    for suffix in (".vtu", ".vtk", ".stl"):
        (tmp_path / f"bad{suffix}").write_text("not a mesh")
        with pytest.raises(ValueError, match=rf"bad\{suffix}: VTK reads no points"):
            xcg.mesh_points(tmp_path / f"bad{suffix}")
