"""VTK files of any code: points as particles or contacts, arrays by name."""

import numpy as np
import pytest
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import VTK_VERTEX, vtkCellArray, vtkPolyData, vtkUnstructuredGrid
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

import xcg
from tests.readers.engines.test_mfix import write_vtp
from xcg.readers.files.vtp import _HEAD, _LONG_HEAD

X = np.array([[0.0, 0, 0], [0.9, 0, 0], [5, 5, 5]])


def write_spheres(path, x=X, mode="Appended", **arrays):
    """As YADE's VTKRecorder does: a vertex for each sphere."""
    points = vtkPoints()
    grid = vtkUnstructuredGrid()
    points.SetData(numpy_to_vtk(x, deep=True))
    grid.SetPoints(points)
    for k in range(len(x)):
        grid.InsertNextCell(VTK_VERTEX, 1, [k])
    for name, values in arrays.items():
        array = numpy_to_vtk(np.asarray(values, float), deep=True)
        array.SetName(name)
        grid.GetPointData().AddArray(array)
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileName(str(path))
    getattr(writer, f"SetDataModeTo{mode}")()
    assert writer.Write()


def write_lines(path, ends, mode="Appended", verts=0, **arrays):
    """Each contact a line between two centres, with arrays of cells."""
    points = vtkPoints()
    lines = vtkCellArray()
    others = vtkCellArray()
    data = vtkPolyData()
    points.SetData(numpy_to_vtk(np.reshape(np.asarray(ends, float), (-1, 3)), deep=True))
    data.SetPoints(points)
    for k in range(len(ends)):
        lines.InsertNextCell(2, [2 * k, 2 * k + 1])
    for k in range(verts):
        others.InsertNextCell(1, [k])
    data.SetLines(lines)
    data.SetVerts(others)
    for name, values in arrays.items():
        array = numpy_to_vtk(np.asarray(values, float), deep=True)
        array.SetName(name)
        data.GetCellData().AddArray(array)
    writer = vtkXMLPolyDataWriter()
    writer.SetInputData(data)
    writer.SetFileName(str(path))
    getattr(writer, f"SetDataModeTo{mode}")()
    assert writer.Write()


@pytest.mark.parametrize("mode", ["Appended", "Binary", "Ascii"])
def test_spheres_written_by_yade_are_read(tmp_path, mode):
    velocity = np.arange(9.0).reshape(3, 3)
    for step in (100, 2000):
        write_spheres(
            tmp_path / f"run-spheres.{step}.vtu", mode=mode, radii=[0.5] * 3, linVelVec=velocity + step, id=[2, 0, 1],
            own=[7, 8, 9],
        )  # fmt: skip
    ds = xcg.open_scene(str(tmp_path / "run-spheres.*.vtu"), density=2.0, names={"own": "heat"})
    assert ds.attrs["engine"] == "vtk"
    np.testing.assert_array_equal(ds.step, [100, 2000])
    np.testing.assert_array_equal(ds.particle_id[0], [0, 1, 2])
    np.testing.assert_array_equal(ds.position[0], X[[1, 2, 0]])
    np.testing.assert_array_equal(ds.velocity[1], velocity[[1, 2, 0]] + 2000)
    np.testing.assert_array_equal(ds.diameter[0], [1, 1, 1])
    np.testing.assert_array_equal(ds.heat[0], [8, 9, 7])


# the tag of the data may begin in one block that is read and end in the next
@pytest.mark.parametrize("at", [_HEAD - 15, _HEAD - 5, _HEAD + _LONG_HEAD - 5, 2 * _LONG_HEAD])
@pytest.mark.parametrize("mode", ["Appended", "Binary"])
def test_headers_of_any_length_are_read(tmp_path, mode, at):
    path = tmp_path / "spheres_1.vtu"
    write_spheres(path, mode=mode, radii=np.full(len(X), 0.5))
    expected = xcg.open_scene(path, density=1.0, units="SI").position.to_numpy()
    text = path.read_bytes()
    mark = text.index(b"<AppendedData" if mode == "Appended" else b"</UnstructuredGrid>")
    path.write_bytes(text[:mark] + b" " * (at - mark) + text[mark:])
    padded = xcg.open_scene(path, density=1.0, units="SI").position.to_numpy()
    np.testing.assert_array_equal(padded, expected)


def test_radii_and_diameters_that_disagree_raise(tmp_path):
    write_spheres(tmp_path / "a.vtu", radius=[0.5] * 3, diameter=[1.0, 1.0, 3.0])
    with pytest.raises(
        xcg.SceneError, match=r"a\.vtu.*diameter 3 of row 2 is not 2 times radius 0\.5"
    ):
        xcg.open_scene(tmp_path / "a.vtu", density=1.0)


def test_contacts_as_points_are_read(tmp_path):
    """Their points are contact points, also between spheres of different sizes."""
    write_vtp(tmp_path / "p.vtp", X, id=[1, 2, 3], radius=[0.75, 0.25, 1], v=X, mass=[1, 1, 1])
    force = np.array([[-1.0, 2, 0]])
    write_vtp(tmp_path / "c.vtp", [[0.7, 0, 0]], first=[1], second=[2], F=force)
    names = {"first": "contact_i", "second": "contact_j", "F": "contact_force"}
    ds = xcg.open_scene(
        tmp_path / "p.vtp", contacts=tmp_path / "c.vtp", engine="vtk", names=names
    ).load()
    np.testing.assert_array_equal(ds.contact_force[0], force)
    np.testing.assert_allclose(ds.contact_point[0], [[0.7, 0, 0]], rtol=1e-7)
    with pytest.raises(
        xcg.SceneError, match=r"c\.vtp: contacts lack \['contact_i', 'contact_j', 'contact_force'\]"
    ):
        xcg.open_scene(tmp_path / "p.vtp", contacts=tmp_path / "c.vtp", engine="vtk")


NAMES = {"first": "contact_i", "second": "contact_j", "F": "contact_force"}


@pytest.mark.parametrize("mode", ["Appended", "Binary", "Ascii"])
def test_contacts_as_lines_are_read(tmp_path, mode):
    """A line between two centres, forces as data of cells; a step in which nothing touches has none."""
    force = np.array([[-1.0, 2, 0], [1, -2, 3]])
    for step, x, rows in ((1, X, 2), (2, 2 * X, 0)):
        write_vtp(
            tmp_path / f"p_{step}.vtp",
            x,
            time=step,
            id=[1, 2, 3],
            radius=[0.75, 0.25, 1],
            v=X,
            mass=[1, 1, 1],
        )
        write_lines(tmp_path / f"c_{step}.vtp", [x[[0, 1]], x[[1, 0]]][:rows], mode, first=[1, 2][:rows],
                    second=[2, 1][:rows], F=force[:rows], own=[5, 6][:rows])  # fmt: skip
    ds = xcg.open_scene(str(tmp_path / "p_*.vtp"), contacts=str(tmp_path / "c_*.vtp"), engine="vtk",
                        names=NAMES | {"own": "contact_own"}, times=[1, 2], sides="separate").load()  # fmt: skip
    np.testing.assert_array_equal(ds.contact_i, [[1, 2], [-1, -1]])
    np.testing.assert_array_equal(ds.contact_own[0], [5, 6])
    np.testing.assert_array_equal(ds.contact_force[0], force)
    np.testing.assert_allclose(ds.contact_point[0], [[0.7, 0, 0]] * 2, rtol=1e-6)


def test_contacts_as_lines_that_are_opened_as_grains_are_named(tmp_path):
    ends = [[[0, 0, 0], [1, 0, 0]]]
    write_lines(tmp_path / "fc_1.vtp", ends, id1=[7], id2=[3], force=[[0, 0, -7.0]])
    with pytest.warns(xcg.SceneWarning, match="those of contacts as lines.* contacts="):
        xcg.open_scene(tmp_path / "fc_1.vtp")


def test_lines_among_other_cells_are_read(tmp_path):
    """Data of cells are those of all kinds of cells, one after the other."""
    write_vtp(tmp_path / "p.vtp", X, id=[1, 2, 3], radius=[0.75, 0.25, 1])
    write_lines(
        tmp_path / "c.vtp", [X[[0, 1]]], verts=1, first=[0, 1], second=[0, 2], F=np.eye(3)[:2]
    )
    with pytest.raises(xcg.SceneError, match=r"c\.vtp: holds Verts beside Lines"):
        xcg.open_scene(
            tmp_path / "p.vtp", contacts=tmp_path / "c.vtp", engine="vtk", names=NAMES, density=1.0
        )
