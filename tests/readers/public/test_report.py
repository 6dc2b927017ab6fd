"""Every column of an input is read, not needed, or not understood: spellings of files that people post."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkIdList, vtkPoints
from vtkmodules.vtkCommonDataModel import VTK_LINE, vtkPolyData, vtkUnstructuredGrid
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

import xcg
from tests import ROOT, dumps

SHARED = ROOT.parent / "shared" / "data"
GRAINS = "id,x,y,z,radius\n1,0,0,0,.5\n2,0,0,.98,.5\n3,0,0,1.96,.5\n"
NORMAL = (0.0, 0.0, -7.0)
SHEAR = (0.5, 0.0, 0.0)


@pytest.fixture
def grains(tmp_path):
    return dumps.write(tmp_path / "g.csv", GRAINS)


def spelt(template, axes="xyz"):
    """Names of three components, "?" in the place of the axis or its number."""
    return [template.replace("?", axis) for axis in axes]


# --- two forces of a contact -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("normal", "shear", "axes"),
    [
        ("fn?", "fs?", "xyz"),
        ("fn?", "ft?", "xyz"),
        ("fn?", "fshear_?", "xyz"),
        ("fn_?", "fs_?", "xyz"),
        ("F_n:?", "F_t:?", "012"),
        ("force_normal[?]", "force_tangential[?]", "123"),
        ("Normal Force {?} (N)".replace("{?}", "?"), "Tangential Force ? (N)", "XYZ"),
        ("normal_force_?", "shear_?", "xyz"),
        ("ContactForce.normal.?", "ContactForce.shear.?", "xyz"),
        ("fn?", "force_shear_?", "xyz"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_normal_and_shear_forces_of_any_spelling_are_added(tmp_path, grains, normal, shear, axes):
    table = pd.DataFrame({"id1": [1, 2], "id2": [2, 3]})
    for template, force in ((normal, NORMAL), (shear, SHEAR)):
        for name, value in zip(spelt(template, axes), force, strict=True):
            table[name] = value
    table.to_csv(tmp_path / "c.csv", index=False)
    ds = xcg.open_scene(grains, tmp_path / "c.csv", density=1.0)
    np.testing.assert_array_equal(ds.contact_force[0], [np.add(NORMAL, SHEAR)] * 2)


def test_a_total_force_is_not_added_to_its_parts(tmp_path, grains):
    text = "id1,id2,fx,fy,fz,fnx,fny,fnz,fsx,fsy,fsz\n1,2,.5,0,-7,0,0,-7,.5,0,0\n"
    ds = xcg.open_scene(grains, dumps.write(tmp_path / "c.csv", text), density=1.0)
    np.testing.assert_array_equal(ds.contact_force[0], [[0.5, 0, -7]])
    text = "id1,id2,fx,fy,fz,fsx,fsy,fsz\n1,2,.5,0,-7,.5,0,0\n"
    with pytest.raises(xcg.SceneError, match="is 'fx' the whole contact force or its normal part"):
        xcg.open_scene(grains, dumps.write(tmp_path / "c.csv", text), density=1.0)


@pytest.mark.parametrize(
    ("columns", "likely"),
    [
        ("tx ty tz", "tangential_force"),
        ("Frict_X Frict_Y Frict_Z", "tangential_force"),
        ("tsx tsy tsz", "tangential_force"),
        ("Ffric:0 Ffric:1 Ffric:2", "tangential_force"),
        ("cx cy cz", "contact_point"),
        ("pos_x pos_y pos_z", "contact_point"),
        ("indentation", "overlap"),
    ],
)
def test_columns_of_contacts_that_resemble_a_variable_are_named(tmp_path, grains, columns, likely):
    names = columns.split()
    text = ",".join(["id1,id2,fnx,fny,fnz", *names]) + "\n1,2,0,0,-7" + ",.1" * len(names) + "\n"
    path = dumps.write(tmp_path / "c.csv", text)
    with pytest.warns(xcg.SceneWarning, match=rf"'{names[0]}' \({likely}\?\)") as caught:
        xcg.open_scene(grains, path, density=1.0)
    assert len(caught) == 1
    assert ("may also be a torque" in str(caught[0].message)) == (names[0] == "tx")
    with warnings.catch_warnings(action="error"):
        xcg.open_scene(grains, path, density=1.0, names=dict.fromkeys(names))


@pytest.mark.parametrize(
    "columns", ["fn ft", "fn", "normal_force tangential_force", "Fn Fs", "force", "total_force"]
)
def test_magnitudes_of_forces_name_the_way_that_reads_them(tmp_path, grains, columns):
    names = columns.split()
    text = ",".join(["id1,id2", *names]) + "\n1,2" + ",7" * len(names) + "\n"
    path = dumps.write(tmp_path / "c.csv", text)
    for variable in (None, "normal_force", "contact_force"):
        options = {"names": {names[0]: variable}} if variable else {}
        with pytest.raises(xcg.SceneError, match=f"'{names[0]}'.* magnitudes.*scene_from_table"):
            xcg.open_scene(grains, path, density=1.0, **options)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("columns", ["fn ft", "normal_force tangential_force", "a b"])
def test_magnitudes_in_tables_follow_the_centres(columns):
    normal, tangential = columns.split()
    grains = pd.DataFrame({"id": [1, 2], "x": [0.6, 0.0], "y": [0.8, 0.0], "z": 0.0, "radius": 0.5})
    names = {"a": "normal_force", "b": "tangential_force"} if columns == "a b" else {}
    contacts = pd.DataFrame({"id1": [1], "id2": [2], normal: [10.0], tangential: [5.0]})
    ds = xcg.scene_from_table(grains, contacts, density=1.0, names=names)
    np.testing.assert_allclose(ds.contact_force[0, 0], [6 - 4, 8 + 3, 0], atol=1e-14)
    grains = grains.assign(y=[0.0, 0.0], z=[0.8, 0.0])
    with pytest.raises(xcg.SceneError, match=f"'{tangential}' is a magnitude"):
        xcg.scene_from_table(grains, contacts, density=1.0, names=names)
    alone = contacts.drop(columns=tangential)
    ds = xcg.scene_from_table(
        grains, alone, density=1.0, names={k: v for k, v in names.items() if k == "a"}
    )
    np.testing.assert_allclose(ds.contact_force[0, 0], [6, 0, 8], atol=1e-14)
    whole = contacts.assign(fx=1.0, fy=2.0, fz=3.0).rename(columns={normal: "fn", tangential: "ft"})
    ds = xcg.scene_from_table(grains, whole, density=1.0)
    np.testing.assert_allclose(ds.contact_force[0, 0], [1, 2, 3])


@pytest.mark.parametrize("columns", ["nx ny nz", "torque_x torque_y torque_z", "mx my mz"])
@pytest.mark.filterwarnings("error")
def test_other_vectors_beside_normal_forces_are_not_needed(tmp_path, grains, columns):
    text = ",".join(["id1,id2,fnx,fny,fnz", *columns.split()]) + "\n1,2,0,0,-7,0,0,1\n"
    ds = xcg.open_scene(grains, dumps.write(tmp_path / "c.csv", text), density=1.0)
    assert ds.attrs["not_read"] == "contacts: " + columns.replace(" ", ", ")


@pytest.mark.parametrize(
    "columns",
    [
        "A,B", "end1,end2", "first,second", "Element A,Element B", "pid1,pid2", "body_1,body_2",
        "source,target", "Particle A ID,Particle B ID", "Home Particle ID,Near Particle ID", "node_i,node_j",
    ],
)  # fmt: skip
def test_ids_of_partners_of_other_names_are_offered(tmp_path, grains, columns):
    path = dumps.write(tmp_path / "c.csv", f"{columns},fx,fy,fz\n1,2,0,0,-7\n")
    first, second = columns.split(",")
    names = {first: "contact_i", second: "contact_j"}
    with pytest.raises(xcg.SceneError, match=re.escape(f"names={names}")):
        xcg.open_scene(grains, path, engine="table", density=1.0)
    ds = xcg.open_scene(grains, path, engine="table", density=1.0, names=names)
    assert ds.contact_j.values.item() == 2


def test_all_components_of_a_missing_vector_are_offered(tmp_path):
    path = dumps.write(
        tmp_path / "p.csv", "id,ball.pos.x,ball.pos.y,ball.pos.z,radius\n1,1,2,3,.5\n"
    )
    names = {f"ball.pos.{axis}": f"position_{axis}" for axis in "xyz"}
    with pytest.raises(xcg.SceneError, match=re.escape(f"names={names}")):
        xcg.open_scene(path, density=1.0)
    assert xcg.open_scene(path, density=1.0, names=names).position.values[0, 0].tolist() == [
        1,
        2,
        3,
    ]


def test_times_of_other_languages_are_named(tmp_path):
    path = dumps.write(tmp_path / "p.csv", "Zeit,x,y,z,radius\n1,1,2,3,.5\n2,1,2,3,.5\n")
    with pytest.warns(xcg.SceneWarning, match=r"names=\{'Zeit': 'time'\}"):
        xcg.open_scene(path, density=1.0)


def test_magnitudes_beside_a_vector_are_not_needed(tmp_path, grains):
    text = "id1,id2,fx,fy,fz,force,fn\n1,2,0,0,-7,7,7\n"
    path = dumps.write(tmp_path / "c.csv", text)
    with warnings.catch_warnings(action="error"):
        ds = xcg.open_scene(grains, path, density=1.0)
    assert ds.attrs["not_read"] == "contacts: force, fn"


def test_forces_of_vtk_lines_are_added(tmp_path):
    folder = SHARED / "public_cases_2"
    if not folder.exists():
        pytest.skip("the public cases are not here")
    case = folder / "vtk_two_forces"
    ds = xcg.open_scene(case / "sg_1.vtp", case / "lgv_1.vtp", density=1.0)
    np.testing.assert_allclose(ds.contact_force[0, 0], [0.5, 0, -7])


@pytest.mark.parametrize("suffix", ["vtu", "vtp"])
@pytest.mark.filterwarnings("error")
def test_lines_of_unstructured_grids_are_contacts(tmp_path, suffix):
    points = vtkPoints()
    for z in (0.0, 0.98, 1.96):
        points.InsertNextPoint(0.0, 0.0, z)
    grid = vtkUnstructuredGrid() if suffix == "vtu" else vtkPolyData()
    grid.SetPoints(points)
    grid.Allocate(2)
    for k in range(2):
        ends = vtkIdList()
        ends.InsertNextId(k)
        ends.InsertNextId(k + 1)
        grid.InsertNextCell(VTK_LINE, ends)
    arrays = {
        "id1": np.array([1, 2]),
        "id2": np.array([2, 3]),
        "force_normal": np.array([NORMAL, NORMAL]),
        "force_tangential": np.array([SHEAR, SHEAR]),
    }
    for name, values in arrays.items():
        array = numpy_to_vtk(values, deep=True)
        array.SetName(name)
        grid.GetCellData().AddArray(array)
    kinds = {"vtu": vtkXMLUnstructuredGridWriter, "vtp": vtkXMLPolyDataWriter}
    writer = kinds[suffix]()
    writer.SetFileName(str(tmp_path / f"c_1.{suffix}"))
    writer.SetInputData(grid)
    writer.Write()
    g = dumps.write(tmp_path / "g_1.csv", GRAINS)
    grains = xcg.open_scene(g, density=1.0)
    write_points(tmp_path / "g_1.vtp", grains)
    ds = xcg.open_scene(tmp_path / "g_1.vtp", tmp_path / f"c_1.{suffix}", density=1.0)
    np.testing.assert_array_equal(ds.contact_force[0], [np.add(NORMAL, SHEAR)] * 2)
    np.testing.assert_array_equal(ds.contact_j[0], [2, 3])


def write_points(path, grains, **arrays):
    """Write the grains of a scene of one step as VTK points, with more arrays."""
    points = vtkPoints()
    for place in grains.position.values[0]:
        points.InsertNextPoint(*place)
    data = vtkPolyData()
    data.SetPoints(points)
    arrays = {"id": grains.particle_id.values[0], "radius": grains.diameter.values[0] / 2} | arrays
    for name, values in arrays.items():
        array = numpy_to_vtk(np.asarray(values), deep=True)
        array.SetName(name)
        data.GetPointData().AddArray(array)
    writer = vtkXMLPolyDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    writer.Write()


@pytest.mark.parametrize("name", ["force", "force_normal"])
def test_magnitudes_of_forces_in_vtk_files_name_the_way_that_reads_them(tmp_path, grains, name):
    scene = xcg.open_scene(grains, density=1.0)
    write_points(tmp_path / "g_1.vtp", scene)
    arrays = {"id1": [1, 2, 3], "id2": [2, 3, 1], name: [7.0, 7.0, 7.0]}
    write_points(tmp_path / "c_1.vtp", scene, **arrays)
    ds = xcg.open_scene(tmp_path / "g_1.vtp", tmp_path / "c_1.vtp", density=1.0)
    with pytest.raises(xcg.SceneError, match=f"'{name}' are magnitudes.*scene_from_table"):
        ds.load()


@pytest.mark.filterwarnings("error")
def test_units_of_arrays_are_converted(tmp_path, grains):
    path = tmp_path / "g_1.vtp"
    arrays = {"velocity [mm/s]": np.ones((3, 3)), "density (g/cm^3)": np.full(3, 2.0)}
    write_points(path, xcg.open_scene(grains, density=1.0), **arrays)
    ds = xcg.open_scene(path)
    np.testing.assert_allclose(ds.velocity, 1e-3, rtol=1e-15)
    np.testing.assert_allclose(ds.density, 2000, rtol=1e-15)
    ds = xcg.open_scene(path, units={"length": 1e-3})
    np.testing.assert_allclose(ds.velocity, 1e-3, rtol=1e-15)
    np.testing.assert_allclose(ds.density, 2e9, rtol=1e-15)


@pytest.mark.filterwarnings("error")
def test_a_tensor_of_inertia_is_not_taken_for_a_number(tmp_path, grains):
    path = tmp_path / "g_1.vtp"
    write_points(path, xcg.open_scene(grains, density=1.0), inertia=np.ones((3, 9)))
    assert "moment_of_inertia" not in xcg.open_scene(path, density=1.0)


# --- the box and other words of headers ------------------------------------------------------------

FLAGS = {
    "pp pp pp": "xyz", "p p p": "xyz", "PP PP PP": "xyz", "periodic periodic fixed": "xy",
    "xx yy zz pp pp ff": "xy", "pp, pp, ff": "xy", "'pp' 'pp' 'fs'": "xy", "pp": "xyz", "mm ff sf": "",
    "T T F": "xy", "true,true,false": "xy", "xy xz yz PP PP PP": "xyz",
}  # fmt: skip


def flagged(flags):
    tilt = " 0" * flags.startswith("xy xz")
    bounds = f"0 1{tilt}\n" * 3
    return (
        f"ITEM: UNITS\nSI\nITEM: TIMESTEP\n1.0\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS {flags}\n"
        f"{bounds}ITEM: ATOMS id x y z radius\n1 0.03 0.5 0.5 0.05\n2 0.96 0.5 0.5 0.05\n"
    )


@pytest.mark.parametrize(("flags", "periodic"), FLAGS.items())
@pytest.mark.filterwarnings("error")
def test_flags_of_a_box_of_any_spelling_are_read(tmp_path, flags, periodic):
    ds = xcg.open_scene(dumps.write(tmp_path / "p.dump", flagged(flags)), density=1.0)
    assert ds.attrs["periodic"] == periodic
    pairs = ds.cg.find_contacts()
    assert int((pairs.contact_i >= 0).sum()) == ("x" in periodic)
    assert ds.attrs["unit_system"] == "SI"


@pytest.mark.parametrize("flags", ["aa bb cc", "pp pp", "p p", "pp pp pq", ""])
def test_flags_of_a_box_that_are_not_understood_are_named(tmp_path, flags):
    path = dumps.write(tmp_path / "p.dump", flagged(flags))
    with pytest.warns(
        xcg.SceneWarning, match=f"'{f'BOX BOUNDS {flags}'.strip()}'.* not understood; say periodic="
    ):
        xcg.open_scene(path, density=1.0)
    with warnings.catch_warnings(action="error"):
        ds = xcg.open_scene(path, density=1.0, periodic="xyz")
    assert ds.attrs["periodic"] == "xyz"


@pytest.mark.parametrize("key", ["cell", "Box", "box_size"])
def test_words_of_xyz_that_resemble_a_lattice_are_named(tmp_path, key):
    text = f'1\n{key}="9 9 9" Properties=pos:R:3:radius:R:1\n1 2 3 0.5\n'
    path = dumps.write(tmp_path / "p.xyz", text)
    with pytest.warns(xcg.SceneWarning, match=r"in the comment is not understood; say box="):
        xcg.open_scene(path, density=1.0)
    with warnings.catch_warnings(action="error"):
        xcg.open_scene(path, density=1.0, box=[[0, 9]] * 3)


@pytest.mark.parametrize("step", ["1.5", "many", "nan", "-inf"])
def test_a_step_that_is_no_whole_number_is_refused(tmp_path, step):
    text = flagged("pp pp pp").replace("1.0\n", f"{step}\n", 1)
    with pytest.raises(
        xcg.SceneError, match=f"'{step}' follows 'ITEM: TIMESTEP', expected a whole"
    ):
        xcg.open_scene(dumps.write(tmp_path / "p.dump", text))


# --- shapes and sizes ------------------------------------------------------------------------------

SHAPE = "id x y z radius mass shapex shapey shapez {} {} {} {} {} {}"
QUATERNIONS = {"liggghts": "quat1 quat2 quat3 quat4 blockiness1 blockiness2",
               "lammps": "quatw quati quatj quatk block1 block2"}  # fmt: skip


@pytest.mark.parametrize(("code", "half"), [("liggghts", 0.5), ("lammps", 0.25)])
@pytest.mark.parametrize("form", ["dump", "csv"])
def test_axes_of_superquadrics_are_those_of_the_code_whose_columns_they_are(
    tmp_path, code, half, form
):
    columns = SHAPE.format(*QUATERNIONS[code].split())
    row = "1 1 1 1 1 2094.395102 0.5 1 1 1 0 0 0 2 2"
    text = dumps.dump_text([row], columns)
    if form == "csv":
        text = f"{columns}\n{row}\n".replace(" ", ",")
    ds = xcg.open_scene(dumps.write(tmp_path / f"p.{form}", text))
    assert ds.half_axis_x.values == half
    volume = 4 / 3 * np.pi * half * (2 * half) ** 2
    np.testing.assert_allclose(ds.volume, volume, rtol=1e-12)
    np.testing.assert_allclose(ds.density, 2094.395102 / volume, rtol=1e-12)


def test_semi_axes_of_ovito_are_half_axes(tmp_path):
    text = "id,x,y,z,AsphericalShapeX,AsphericalShapeY,AsphericalShapeZ\n1,0,0,0,.5,1,2\n"
    ds = xcg.open_scene(dumps.write(tmp_path / "p.csv", text), density=1.0)
    assert [ds[f"half_axis_{axis}"].values.item() for axis in "xyz"] == [0.5, 1, 2]


@pytest.mark.parametrize(
    ("column", "value", "likely"),
    [("r", 0.5, "radius"), ("Diameter (contact) [m]", 0.5, "diameter"), ("d", 0.5, "diameter")],
)
def test_sizes_beside_a_volume_are_named(tmp_path, column, value, likely):
    text = f"id,x,y,z,volume,{column}\n1,3,4,0,5,{value}\n"
    with pytest.warns(xcg.SceneWarning, match=rf"\({likely}\?\) resemble"):
        xcg.open_scene(dumps.write(tmp_path / "p.csv", text), density=1.0)


@pytest.mark.parametrize("r", [(0.75 / np.pi * 5) ** (1 / 3), 5.0])
@pytest.mark.filterwarnings("error")
def test_radii_that_volumes_or_positions_explain_are_not_needed(tmp_path, r):
    text = f"id,x,y,z,volume,r\n1,3,4,0,5,{r!r}\n"
    ds = xcg.open_scene(dumps.write(tmp_path / "p.csv", text), density=1.0)
    assert ds.attrs["not_read"] == "particles: r"


@pytest.mark.parametrize(
    ("columns", "likely"),
    [
        ("idx", "particle_id"), ("pid", "particle_id"), ("xdot ydot zdot", "velocity"),
        ("vrot_x vrot_y vrot_z", "angular_velocity"), ("Angular_velocity_1", "angular_velocity"),
        ("speed rms (m/s)", "velocity"),
        ("c_shape[1] c_shape[2] c_shape[3]", "whole_axis"), ("Rhob [kg/m^3]", "density"),
    ],
)  # fmt: skip
def test_columns_of_grains_that_resemble_a_variable_are_named(tmp_path, columns, likely):
    names = [columns] if "(" in columns or "^" in columns else columns.split()
    text = ",".join(["x,y,z", *names]) + "\n0,0,0" + ",1" * len(names) + "\n"
    with pytest.warns(xcg.SceneWarning, match=rf"\({likely}\?\)") as caught:
        xcg.open_scene(dumps.write(tmp_path / "p.csv", text))
    assert len(caught) == 1


@pytest.mark.parametrize("column", ["height [m]", "Contact Area [m2]", "energy [J]", "T [K]"])
@pytest.mark.filterwarnings("error")
def test_letters_of_units_are_no_hints(tmp_path, column):
    text = f"id,x,y,z,radius,{column}\n1,0,0,0,0.1,1\n"
    ds = xcg.open_scene(dumps.write(tmp_path / "p.csv", text), density=1.0)
    assert ds.attrs["not_read"] == f"particles: {column}"


# --- names by kind, planes, records, blocks --------------------------------------------------------


@pytest.mark.filterwarnings("error")
def test_names_are_given_apart_for_grains_and_contacts(tmp_path):
    grains = "a,b,c,d,e\n1,0,0,0,.5\n2,0,0,.98,.5\n"
    contacts = "a,b,c,d,e\n1,2,0,0,-7\n"
    paths = [
        dumps.write(tmp_path / f"{kind}.csv", text)
        for kind, text in (("g", grains), ("c", contacts))
    ]
    of_grains = ["particle_id", "position_x", "position_y", "position_z", "radius"]
    of_contacts = ["contact_i", "contact_j", *spelt("contact_force_?")]
    names = {
        "particles": dict(zip("abcde", of_grains, strict=True)),
        "contacts": dict(zip("abcde", of_contacts, strict=True)),
    }
    tables = [pd.read_csv(path) for path in paths]
    for ds in (
        xcg.open_scene(*paths, engine="table", density=1.0, names=names),
        xcg.scene_from_table(*tables, density=1.0, names=names),
    ):
        np.testing.assert_array_equal(ds.contact_force[0], [NORMAL])
        np.testing.assert_array_equal(ds.position[0, 1], [0, 0, 0.98])
    with pytest.raises(xcg.SceneError, match=r"one mapping .* or one for each kind"):
        xcg.open_scene(*paths, engine="table", names=names | {"a": None})


@pytest.mark.parametrize(
    ("columns", "plane"),
    [("x,z", "xz"), ("y,z", "yz"), ("x,y", "xy"), ("Position X,Position Z", "xz")],
)
@pytest.mark.filterwarnings("error")
def test_tables_of_any_plane_are_read(tmp_path, columns, plane):
    text = f"id,{columns},radius\n1,0,0,.5\n2,.98,0,.5\n3,0,.98,.5\n"
    path = dumps.write(tmp_path / "g.csv", text)
    a, b = plane
    if " " not in columns:
        by_blanks = dumps.write(tmp_path / "g.txt", text.replace(",", " "))
        assert xcg.open_scene(by_blanks, density=1.0).attrs["plane"] == plane
    contacts = dumps.write(tmp_path / "c.csv", f"id1,id2,f{a},f{b}\n1,2,-7,0\n1,3,0,-5\n")
    for options in ({}, {"dimension": 2}):
        ds = xcg.open_scene(path, contacts, density=1.0, **options)
        assert ds.attrs["plane"] == plane
        force = ds.contact_force.sel(component=[*plane]).values[0]
        np.testing.assert_array_equal(force, [[-7, 0], [0, -5]])
        assert float(np.abs(ds.contact_force).sum()) == 12


def test_a_missing_axis_of_grains_in_space_is_an_error(tmp_path, grains):
    contacts = dumps.write(tmp_path / "c.csv", "id1,id2,fx,fy\n1,2,-7,0\n")
    with pytest.raises(xcg.SceneError, match=r"no z of the contact force.*dimension=2"):
        xcg.open_scene(grains, contacts, density=1.0)
    for columns in ("id,x,z,vx,vy,vz,radius", "id,x,z,y_wrong,radius"):
        text = columns + "\n" + ",".join("1" * len(columns.split(","))) + "\n"
        with pytest.raises(xcg.SceneError, match="no y of the position"):
            xcg.open_scene(dumps.write(tmp_path / "p.csv", text), density=1.0)


def test_a_missing_velocity_is_not_offered_a_position(tmp_path):
    path = dumps.write(tmp_path / "p.csv", "id,x,y,z,radius,vx,vz\n1,0,0,0,.5,1,1\n")
    with pytest.raises(xcg.SceneError, match="no y of the velocity") as error:
        xcg.open_scene(path, density=1.0)
    assert "'y'" not in str(error.value)
    assert "names={'vx': None, 'vz': None}" in str(error.value)
    assert "velocity" not in xcg.open_scene(path, density=1.0, names={"vx": None, "vz": None})


@pytest.mark.filterwarnings("error")
def test_records_of_hdf5_are_read_by_their_fields(tmp_path):
    rows = np.zeros(
        3, [("id", "i8"), ("x", "f8"), ("y", "f8"), ("v", "f8", (2,)), ("radius", "f8")]
    )
    rows["id"] = [7, 3, 5]
    rows["x"] = [0.1, 0.4, 0.7]
    rows["v"] = np.arange(6).reshape(3, 2)
    rows["radius"] = 0.05
    path = tmp_path / "c.h5"
    with h5py.File(path, "w") as file:
        file["table"] = rows
    places = {
        "particle_id": "id",
        "position_x": "x",
        "position_y": "y",
        "velocity": "v",
        "radius": "radius",
    }
    mapping = {name: f"/table/{field}" for name, field in places.items()}
    ds = xcg.open_scene(path, mapping=mapping, density=1.0)
    np.testing.assert_array_equal(ds.position[0, :, 0], [0.4, 0.7, 0.1])
    np.testing.assert_array_equal(ds.velocity[0], [[2, 3, 0], [4, 5, 0], [0, 1, 0]])
    with pytest.raises(xcg.SceneError, match=r"records; name one of their fields.*'/table/id'"):
        xcg.open_scene(path, mapping={"position": "/table"})
    with pytest.raises(xcg.SceneError, match="holds records with the fields id, x, y, v, radius"):
        xcg.open_scene(path, mapping={"position_x": "/table/xx", "position_y": "/table/y"})


@pytest.mark.filterwarnings("error")
def test_tables_of_two_levels_and_of_pyarrow_are_read():
    plain = {"id": [1, 2], "x": [0.0, 1.0], "y": [0.0, 0.0], "z": [0.0, 0.0], "radius": [0.5, 0.5]}
    levels = {name: ("position", name) if name in "xyz" else (name, "") for name in plain}
    table = pd.DataFrame({levels[name]: values for name, values in plain.items()})
    assert table.columns.nlevels == 2
    expected = xcg.scene_from_table(plain, density=1.0)
    xcg.scene_from_table(table, density=1.0).equals(expected)
    pyarrow = pytest.importorskip("pyarrow")
    assert xcg.scene_from_table(pyarrow.table(plain), density=1.0).equals(expected)


# --- LIGGGHTS with the number of the row -----------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"names": "pos id force"}, {"engine": "liggghts"}])
@pytest.mark.filterwarnings("ignore:.*does not name the units")
def test_contacts_of_liggghts_may_begin_with_the_number_of_the_row(tmp_path, options):
    grains = dumps.write(
        tmp_path / "p.dump",
        dumps.dump_text(["1 .5 .5 .4 .05", "2 .5 .5 .49 .05"], "id x y z radius"),
    )
    columns = "index " + " ".join(f"c_fc[{k}]" for k in range(1, 13))
    pairs = dumps.pairs_text(["1 .5 .5 .4 .5 .5 .49 1 2 0 0 0 -7"], columns)
    ds = xcg.open_scene(grains, dumps.write(tmp_path / "c.dump", pairs), density=1.0, **options)
    np.testing.assert_array_equal(ds.contact_force[0], [NORMAL])
    few = dumps.pairs_text(["1 2 0 0 0 -7"], "index " + " ".join(f"c_fc[{k}]" for k in range(1, 6)))
    with pytest.raises(xcg.SceneError, match=r"compute|names="):
        xcg.open_scene(grains, dumps.write(tmp_path / "few.dump", few), density=1.0)


@pytest.mark.parametrize("column", ["R", "size", "Diameter (contact) [mm]"])
def test_sizes_beside_volumes_of_a_table_in_memory_are_named(column):
    table = pd.DataFrame({"id": [1, 2], "x": [0.0, 9.0], "y": 0.0, "z": 0.0, "volume": 8.0})
    with pytest.warns(xcg.SceneWarning, match=re.escape(repr(column))):
        xcg.scene_from_table(table.assign(**{column: 0.5}), density=1.0)


# --- clean controls --------------------------------------------------------------------------------

CLEAN = {
    "times_with_dtype": ["*.parquet"],
    "shear_force_dropped": ["g.csv"],
    "liggghts_superquadric": ["*"],
    "plane_xz": ["xz.csv", "g2.csv"],
    "unit_letter_as_mass": ["PartFluid_0001.csv"],
    "normals_not_checked": ["g.csv"],
    "contacts_off_by_one": ["g.csv"],
    "wall_numbers": ["g.csv"],
}


OF_CONTACTS = ("FC_", "ENTIRE_DOMAIN")  # of MFiX; they are no grains


def controls() -> list[Path]:
    """Files that are right and complete: samples of the project, and the public cases."""
    files = [
        path
        for folder in (ROOT / "examples" / "data", ROOT / "tests" / "data")
        for path in sorted(folder.rglob("*"))
        if path.suffix in (".dump", ".vtp", ".csv", ".liggghts", ".data", ".txt")
    ]
    series = set()
    for path in sorted([*SHARED.rglob("*.gz"), *(ROOT / "examples" / "data").rglob("*.gz")]):
        name = path.parent / re.sub(r"\d+", "", path.name)
        if name not in series and not path.name.startswith(OF_CONTACTS):
            files.append(path)  # the first of a series
        series.add(name)
    for case, patterns in CLEAN.items():
        for pattern in patterns:
            files += sorted((SHARED / "public_cases_2" / case).glob(pattern))
    return files


@pytest.mark.parametrize("name", xcg.datasets.samples())
@pytest.mark.filterwarnings("error::xcg.SceneWarning")
def test_samples_open_in_silence(name):
    assert xcg.datasets.open(name.removeprefix("lammps_")).sizes["particle"]


@pytest.mark.parametrize("path", controls(), ids=lambda path: f"{path.parent.name}/{path.name}")
def test_columns_of_clean_files_are_understood(path):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            xcg.open_scene(path)
        except xcg.SceneError:
            return  # files of contacts, and others that are no grains
    said = [str(warning.message) for warning in caught]
    about = (
        "resemble variables", "not understood", "may be", "not that of a sphere", "of the half-axes",
        "only normal forces", "as long as the extent",
    )  # fmt: skip
    of_columns = [text for text in said if any(words in text for words in about)]
    if path.name.startswith(OF_CONTACTS):
        return
    assert not of_columns
