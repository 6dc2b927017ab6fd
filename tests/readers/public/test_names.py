"""Names of columns as people write them: read right, or named in a warning."""

from __future__ import annotations

import ast
import re
import warnings

import numpy as np
import pandas as pd
import pytest
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

import xcg
from tests import dumps
from xcg.readers.column_units import parse_unit
from xcg.readers.named_columns import columns_by_name
from xcg.readers.names import CLOCK_SLOTS, PARTICLE_SLOTS

STEP = 0.01  # m that every grain moves along x in one step


def write_steps(folder, columns):
    """Write three steps of four grains as CSV, with rows in another order in each."""
    ids = np.array([7, 3, 11, 5])
    for step, order in enumerate(([0, 1, 2, 3], [2, 0, 3, 1], [3, 2, 1, 0])):
        x = 0.1 * ids[order] + STEP * step
        table = {"id": ids[order], "x": x, "y": 0.0, "z": 0.0, "radius": 0.02}
        rows = pd.DataFrame({columns.get(name, name): values for name, values in table.items()})
        rows.to_csv(folder / f"p_{step}.csv", index=False)
    return str(folder / "p_*.csv")


@pytest.mark.parametrize(
    "name",
    [
        "id",
        "ID",
        "Id",
        "Particle ID",
        "particle_number",
        "ParticleId",
        "ball_id",
        "Label",
        "particle",
        "Global-ID",
        "TRACK_ID",
        "Particle Identifier",
    ],
)
def test_ids_of_any_spelling_follow_grains_whose_rows_change(tmp_path, name):
    files = write_steps(tmp_path, {"id": name})
    ds = xcg.open_scene(files, density=1.0, times=[0.0, 1.0, 2.0])
    velocity = ds.cg.derive("velocity").velocity
    np.testing.assert_allclose(velocity.sel(component="x"), STEP, rtol=1e-12)


def test_velocities_of_numbered_rows_are_an_error_that_names_the_columns(tmp_path):
    files = write_steps(tmp_path, {"id": "code"})
    with pytest.warns(xcg.SceneWarning, match="no column of particle ids.*columns are code x"):
        ds = xcg.open_scene(files, density=1.0, times=[0.0, 1.0, 2.0])
    for call in (
        lambda: ds.cg.derive("velocity"),
        lambda: ds.cg.displacement(width=0.1),
        ds.cg.mean_squared_displacement,
    ):
        with pytest.raises(xcg.SceneError, match="follows particles by their ids"):
            call()
    ds = xcg.open_scene(files, density=1.0, times=[0.0, 1.0, 2.0], names={"code": "particle_id"})
    velocity = ds.cg.derive("velocity").velocity
    np.testing.assert_allclose(velocity.sel(component="x"), STEP, rtol=1e-12)


def test_contacts_by_id_of_numbered_rows_are_an_error(tmp_path):
    particles = tmp_path / "p.csv"
    particles.write_text("x,y,z,radius\n0,0,0,0.5\n0.9,0,0,0.5\n")
    contacts = tmp_path / "c.csv"
    contacts.write_text("id1,id2,fx,fy,fz\n1,2,-1,0,0\n")
    with pytest.raises(xcg.SceneError, match="contacts name their particles by id; map it"):
        xcg.open_scene(particles, contacts=contacts, density=1.0)


COLUMNS = {
    "radius": ["Radius", "RADIUS", "radius [m]", "Radius (m)", "radii", "particle_radius", "Rad"],
    "vx vy vz": [
        "v_x v_y v_z", "Vx Vy Vz", "Velocity:0 Velocity:1 Velocity:2", "velocity_x velocity_y velocity_z",
        "v[1] v[2] v[3]", "Velocity-X Velocity-Y Velocity-Z", "vel.x vel.y vel.z", "velX velY velZ",
        "VELOCITY_0 VELOCITY_1 VELOCITY_2", "x_velocity y_velocity z_velocity",
        "particle-x-velocity particle-y-velocity particle-z-velocity",
    ],
    "x y z": [
        "X Y Z", "Points:0 Points:1 Points:2", "Points_0 Points_1 Points_2", "position_x position_y position_z",
        "pos_x pos_y pos_z", "PosX PosY PosZ", "x[m] y[m] z[m]", "Center:0 Center:1 Center:2",
        "coordinates:0 coordinates:1 coordinates:2", "location_x location_y location_z", "loc.x loc.y loc.z",
        "ParticleX-Coordinate[m] ParticleY-Coordinate[m] ParticleZ-Coordinate[m]",
    ],
    "type": ["Type", "Species", "material", "MatId", "phase_id", "Material ID"],
}  # fmt: skip
SPELLINGS = [(name, spelling) for name, many in COLUMNS.items() for spelling in many]


@pytest.mark.parametrize(("name", "spelling"), SPELLINGS)
def test_other_spellings_make_the_same_scene(tmp_path, name, spelling):
    rng = np.random.default_rng(1)
    plain = ["id", "x", "y", "z", "vx", "vy", "vz", "radius", "type"]
    rows = np.column_stack([np.arange(5), rng.random((5, 6)), np.full(5, 0.01), [1, 2, 1, 2, 2]])
    scenes = []
    for file, other in (("plain.csv", name), ("other.csv", spelling)):
        renamed = dict(zip(name.split(), re.split(r" (?!\[|\(|[IiX]D)", other), strict=True))
        header = [renamed.get(column, column) for column in plain]
        pd.DataFrame(rows, columns=header).to_csv(tmp_path / file, index=False)
        scenes.append(xcg.open_scene(tmp_path / file, density=1.0))
    one, two = scenes
    assert set(one.data_vars) == set(two.data_vars)
    for variable in one.data_vars:
        np.testing.assert_array_equal(one[variable], two[variable])


@pytest.mark.parametrize("name", ["Time", "TIME", "time", "t", "Time [s]", "simulation_time"])
def test_times_of_any_spelling_separate_steps(tmp_path, name):
    path = tmp_path / "p.csv"
    path.write_text(f"id,{name},x,y,z,radius\n1,0.5,0,0,0,0.1\n1,1.5,1,0,0,0.1\n")
    ds = xcg.open_scene(path, density=1.0)
    np.testing.assert_array_equal(ds.time, [0.5, 1.5])
    np.testing.assert_array_equal(ds.position[:, 0, 0], [0.0, 1.0])


@pytest.mark.parametrize("name", ["Step", "timestep", "TimeStep", "frame"])
def test_step_numbers_of_any_spelling_separate_steps(tmp_path, name):
    path = tmp_path / "p.csv"
    path.write_text(f"id,{name},x,y,z,radius\n1,5,0,0,0,0.1\n1,15,1,0,0,0.1\n")
    np.testing.assert_array_equal(xcg.open_scene(path, density=1.0).step, [5, 15])


@pytest.mark.parametrize(
    ("column", "meant"),
    [
        ("r", "radius"),
        ("grain_size", "diameter"),
        ("c_rad", "radius"),
        ("vel_magnitude", "velocity"),
        ("Omega_z_total", "angular_velocity"),
        ("mat_name", "species"),
        ("bulk_density", "density"),
        ("No.", "particle_id"),
        ("image_count", "image"),
        ("size", "diameter"),
    ],
)
def test_columns_that_resemble_a_variable_are_named(tmp_path, column, meant):
    path = tmp_path / "p.csv"
    path.write_text(f"x,y,z,{column}\n0,0,0,1\n")
    with pytest.warns(xcg.SceneWarning, match=rf"{re.escape(repr(column))} \({meant}\?\) resemble"):
        xcg.open_scene(path)


@pytest.mark.parametrize(
    "columns",
    [
        "spin_r_x spin_r_y spin_r_z", "V:mean:x V:mean:y V:mean:z", "U:0 U:1 U:2", "dx/dt dy/dt dz/dt",
        "f_vave[1] f_vave[2] f_vave[3]", "Vit.X Vit.Y Vit.Z", "xv yv zv",
    ],
)  # fmt: skip
def test_the_advice_for_components_can_be_followed(tmp_path, columns):
    path = tmp_path / "p.csv"
    path.write_text("id,x,y,z," + columns.replace(" ", ",") + "\n1,0,0,0,1,2,3\n")
    with pytest.warns(xcg.SceneWarning, match="resemble variables") as warned:
        xcg.open_scene(path)
    advice = re.search(r"for example names=(\{.*?\})", str(warned[0].message))
    names = ast.literal_eval(advice[1])
    assert [*names] == columns.split()
    ds = xcg.open_scene(path, names=names)
    variable = next(iter(names.values())).removesuffix("_x")
    np.testing.assert_array_equal(ds[variable][0, 0], [1, 2, 3])


@pytest.mark.parametrize(
    "columns",
    [["stress_xx", "stress_xy", "stress_xz"], ["vor_x", "vor_y", "vor_z"], ["q[1]", "q[2]"]],
)
@pytest.mark.filterwarnings("error")
def test_tensors_and_vectors_of_other_names_are_no_velocities(tmp_path, columns):
    path = tmp_path / "p.csv"
    path.write_text(",".join(["id,x,y,z", *columns]) + "\n1,0,0,0" + ",5" * len(columns) + "\n")
    xcg.open_scene(path)


def test_a_dump_without_ids_is_offered_the_column_that_resembles_them(tmp_path):
    text = dumps.dump_text().replace("ATOMS id", "ATOMS serial")
    with pytest.raises(xcg.SceneError, match=r"no id of the particle .*'serial': 'particle_id'"):
        xcg.open_scene(dumps.write(tmp_path / "p.dump", text))


def test_four_numbers_of_a_quaternion_are_named(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("id,x,y,z,c_q[1],c_q[2],c_q[3],c_q[4]\n1,0,0,0,1,0,0,0\n")
    with pytest.warns(xcg.SceneWarning, match=r"'c_q\[1\]' .quat_w.*'c_q\[4\]' .quat_z"):
        xcg.open_scene(path)


@pytest.mark.parametrize(
    "columns",
    [["Point ID", "Cell Type"], ["vtkOriginalPointIds"], ["v_press", "c_mean[1]", "f_ave[2]"]],
)
@pytest.mark.filterwarnings("error")
def test_columns_of_paraview_and_lammps_that_are_no_variables_are_not_named(tmp_path, columns):
    path = tmp_path / "p.csv"
    path.write_text(",".join(["x,y,z,radius", *columns]) + "\n0,0,0,1" + ",5" * len(columns) + "\n")
    assert xcg.open_scene(path, density=1).sizes["particle"] == 1


@pytest.mark.parametrize(
    "name",
    [
        "POSITION_T",
        "Slice",
        "step_no",
        "Frame number",
        "elapsed time",
    ],
)
def test_times_that_do_not_separate_steps_are_named(tmp_path, name):
    path = tmp_path / "p.csv"
    path.write_text(f"id,x,y,z,radius,{name}\n1,0,0,0,0.1,0\n2,5,0,0,0.1,1\n")
    with pytest.warns(xcg.SceneWarning, match=rf"{re.escape(repr(name))} may hold times"):
        xcg.open_scene(path, density=1)
    ds = xcg.open_scene(path, density=1, names={name: "time"}, units="SI")
    np.testing.assert_array_equal(ds.position[:, 0, 0], [0, 5])


@pytest.mark.parametrize("name", ["T", "residence_time", "contact time", "lifetime", "next"])
@pytest.mark.filterwarnings("error")
def test_other_columns_are_no_times(tmp_path, name):
    path = tmp_path / "p.csv"
    path.write_text(f"x,y,z,radius,{name}\n0,0,0,0.1,0\n5,0,0,0.1,1\n")
    assert xcg.open_scene(path, density=1).sizes["particle"] == 2


@pytest.mark.parametrize("radius", ["radius (mm)", "R [mm]", "radius_mm", "size [mm]", "Radius_mm"])
@pytest.mark.filterwarnings("error")
def test_units_in_names_are_converted_unless_units_are_given(tmp_path, radius):
    path = tmp_path / "p.csv"
    path.write_text(f"id,x [mm],y_mm,z (cm),vx_mm_s,vy [cm/s],vz [m/s],{radius}\n1,2,3,4,5,6,7,5\n")
    names = {radius: "radius"}
    ds = xcg.open_scene(path, density=1, names=names)
    np.testing.assert_allclose(ds.position[0, 0], [0.002, 0.003, 0.04], rtol=1e-15)
    np.testing.assert_allclose(ds.velocity[0, 0], [0.005, 0.06, 7], rtol=1e-15)
    np.testing.assert_allclose(ds.diameter, 0.01, rtol=1e-15)
    ds = xcg.open_scene(path, density=1, names=names, units={"length": 1e-2})
    np.testing.assert_allclose(ds.position[0, 0], [0.02, 0.03, 0.04], rtol=1e-15)
    np.testing.assert_allclose(ds.diameter, 0.1, rtol=1e-15)
    table = xcg.scene_from_table(pd.read_csv(path), density=1, names=names)
    np.testing.assert_allclose(table.position[0, 0], [0.002, 0.003, 0.04], rtol=1e-15)


@pytest.mark.parametrize("name", ["time [ms]", "Time_ms", "t_ms", "Time (ms)"])
@pytest.mark.filterwarnings("error")
def test_times_in_another_unit_are_converted(tmp_path, name):
    path = tmp_path / "p.csv"
    path.write_text(f"id,x,y,z,radius,{name}\n1,0,0,0,0.1,0\n1,5,0,0,0.1,2\n")
    for ds in (
        xcg.open_scene(path, density=1),
        xcg.scene_from_table(pd.read_csv(path), density=1),
    ):
        np.testing.assert_array_equal(ds.time, [0, 0.002])
    np.testing.assert_array_equal(xcg.open_scene(path, density=1, units="SI").time, [0, 2])


@pytest.mark.parametrize(
    ("unit", "factor", "powers"),
    [
        ("mm", 1e-3, (1, 0, 0)), ("µm", 1e-6, (1, 0, 0)), ("cm/s", 1e-2, (1, 0, -1)),
        ("g/cm^3", 1e3, (-3, 1, 0)), ("kg m^-3", 1, (-3, 1, 0)), ("kg·m²", 1, (2, 1, 0)),
        ("deg/s", np.pi / 180, (0, 0, -1)), ("rpm", np.pi / 30, (0, 0, -1)), ("mN", 1e-3, (1, 1, -2)),
        ("1/s", 1, (0, 0, -1)), ("in", 0.0254, (1, 0, 0)),
    ],
)  # fmt: skip
def test_units_of_columns_have_factors_to_si(unit, factor, powers):
    found = parse_unit(unit)
    assert found is not None
    np.testing.assert_allclose(found[0], factor, rtol=1e-13)
    assert found[1] == powers


@pytest.mark.parametrize("column", ["x_cm", "x_in", "x_ft", "mass_t", "t_min", "v_max", "id_m"])
def test_endings_that_may_mean_something_else_are_no_units(column):
    assert column not in columns_by_name([column], {**PARTICLE_SLOTS, **CLOCK_SLOTS}).values()


def test_an_ending_that_is_perhaps_a_unit_is_named_where_it_is_mapped(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("id,x_cm,y,z,radius\n1,2,3,4,5\n")
    with pytest.warns(xcg.SceneWarning, match="'x_cm' name a unit that is not known or not one of"):
        ds = xcg.open_scene(path, density=1, names={"x_cm": "position_x"})
    assert ds.position.values[0, 0, 0] == 2


@pytest.mark.parametrize("column", ["x [kg]", "radius [m/s]", "vx [-]"])
def test_units_of_another_quantity_are_named(tmp_path, column):
    header = "id,x,y,z,vx,vy,vz,radius".replace(column.partition(" ")[0], column, 1)
    path = tmp_path / "p.csv"
    path.write_text(f"{header}\n1,2,3,4,5,6,7,8\n")
    with pytest.warns(xcg.SceneWarning, match=re.escape(f"columns '{column}' name a unit")):
        ds = xcg.open_scene(path, density=1)
    assert ds.position.values[0, 0, 0] == 2
    assert ds.velocity.values[0, 0, 0] == 5


def test_a_unit_of_one_component_alone_is_named(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("id,x [m],y,z,vx [mm/s],vy,vz,radius [mm]\n1,2,3,4,5,6,7,8\n")
    with pytest.warns(
        xcg.SceneWarning, match=r"columns 'vx \[mm/s\]' name a unit, and other components"
    ):
        xcg.open_scene(path, density=1)
    path.write_text("id,x [m],y [mm],z [m],vx [mm/s],vy [m/s],vz [m/s],radius\n1,2,3,4,5,6,7,8\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ds = xcg.open_scene(path, density=1)
    np.testing.assert_allclose(ds.position[0, 0], [2, 3e-3, 4], rtol=1e-15)


@pytest.mark.parametrize("word", ["px", "contact", "of cells", "1", "2", "", "x", "Points"])
def test_other_words_in_brackets_are_no_units(word):
    assert parse_unit(word) is None


def test_brightness_in_tables_of_trackpy_is_no_mass(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(
        "y,x,mass,size,ecc,signal,raw_mass,ep,frame,particle\n1,10,250,2,.1,9,800,.1,0,7\n"
    )
    with pytest.warns(xcg.SceneWarning, match=r"'mass' \(mass\?\).* resemble"):
        ds = xcg.open_scene(path)
    assert "mass" not in ds
    ds = xcg.open_scene(path, names={"mass": "mass", "size": None, "raw_mass": None})
    assert ds.mass.values.tolist() == [[250]]


def test_tables_of_pandas_get_the_warnings_of_files():
    table = pd.DataFrame(
        {"id": [1, 2], "x (px)": [0, 5], "y": 0, "z": 0, "r": 1, "frame no": [0, 1]}
    )
    with pytest.warns(xcg.SceneWarning) as warned:
        xcg.scene_from_table(table, names={"x (px)": "position_x"})
    texts = [str(warning.message) for warning in warned]
    for part in ("'r' (radius?)", "'frame no' may hold times", "'x (px)' name a unit"):
        assert sum(part in text for text in texts) == 1


@pytest.mark.filterwarnings("error")
def test_columns_beside_arguments_that_replace_them_are_not_named():
    table = pd.DataFrame({"x": [0, 5], "y": 0, "z": 0, "size": 1})
    ds = xcg.scene_from_table(table, diameter=[0.1, 0.2], density=1.0)
    assert ds.diameter.values.tolist() == [[0.1, 0.2]]


def test_sizes_given_as_an_option_are_those_of_all_grains(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("x,y,z\n0,0,0\n1,0,0\n")
    ds = xcg.open_scene(path, diameter=0.1, density=2500.0)
    np.testing.assert_allclose(ds.diameter, 0.1)
    np.testing.assert_allclose(ds.mass, 2500 * np.pi / 6 * 1e-3)
    ds = xcg.open_scene(path, diameter=0.1, mass=2.0, units={"length": 1e-3})
    np.testing.assert_allclose(ds.diameter, 0.1)  # in m, as a density is in SI
    np.testing.assert_allclose(ds.mass, 2.0)
    path.write_text("x,y,z,diameter\n0,0,0,0.2\n1,0,0,0.2\n")
    with pytest.warns(xcg.SceneWarning, match=r"diameter=0.1 is not used, .*\(0.2 to 0.2\)"):
        ds = xcg.open_scene(path, diameter=0.1)
    np.testing.assert_allclose(ds.diameter, 0.2)
    with pytest.raises(xcg.SceneError, match=r"diameter=-1\.0: expected a positive number"):
        xcg.open_scene(path, diameter=-1.0)
    with pytest.raises(xcg.SceneError, match="did you mean diameter=, twice the radius"):
        xcg.open_scene(path, radius=0.1)


def test_other_codes_share_the_table(tmp_path):
    dump = tmp_path / "p.dump"
    dump.write_text(
        "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS pp pp pp\n0 1\n0 1\n0 1\n"
        "ITEM: ATOMS ID Type X Y Z Radius Velocity_x Velocity_y Velocity_z\n4 2 .5 .5 .5 .1 1 2 3\n"
    )
    yade = tmp_path / "p.txt"
    yade.write_text("# ID MatId X Y Z Radius v_x v_y v_z\n4 2 .5 .5 .5 .1 1 2 3\n")
    for path, options in ((dump, {"units": "SI"}), (yade, {"engine": "yade"})):
        ds = xcg.open_scene(path, density=1.0, **options)
        assert ds.particle_id.values.tolist() == [[4]]
        assert ds.species.values.tolist() == [[2]]
        np.testing.assert_allclose(ds.diameter, 0.2)
        np.testing.assert_array_equal(ds.velocity[0, 0], [1, 2, 3])


@pytest.mark.parametrize(
    "names",
    [
        {"Velocity": 3, "Radius": 1, "ID": 1},
        {"vel": 3, "radii": 1, "particle_number": 1},
        {"Velocity_X": 1, "Velocity_Y": 1, "Velocity_Z": 1, "RADIUS": 1, "Particle ID": 1},
        {"v_x": 1, "v_y": 1, "v_z": 1, "radius": 1, "label": 1},
    ],
)
def test_arrays_of_vtk_are_named_as_columns_are(tmp_path, names):
    points = vtkPoints()
    poly = vtkPolyData()
    points.SetData(numpy_to_vtk(np.array([[0.0, 0, 0], [1, 0, 0]]), deep=True))
    poly.SetPoints(points)
    velocity = [[1.0, 2, 3], [4, 5, 6]]
    scalars = iter(np.transpose(velocity))
    for name, components in names.items():
        values = np.array([8.0, 9.0]) if components == 1 else np.array(velocity)
        if name.lower().startswith("v") and components == 1:
            values = next(scalars)
        if name.lower().startswith("rad"):
            values = np.array([0.1, 0.2])
        array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
        array.SetName(name)
        poly.GetPointData().AddArray(array)
    writer = vtkXMLPolyDataWriter()
    writer.SetFileName(str(tmp_path / "p.vtp"))
    writer.SetInputData(poly)
    writer.Write()
    ds = xcg.open_scene(tmp_path / "p.vtp", engine="vtk", density=1.0)
    assert ds.particle_id.values.tolist() == [[8, 9]]
    np.testing.assert_allclose(ds.diameter, [[0.2, 0.4]])
    np.testing.assert_array_equal(ds.velocity[0], velocity)


def test_a_lost_height_beside_a_velocity_along_z_is_named(tmp_path):
    for file, separator in (("p.csv", ","), ("p.txt", " ")):
        path = tmp_path / file
        rows = ["id x y height vx vy vz radius", "1 0 0 5 1 2 3 0.1", "2 1 1 6 1 2 3 0.1"]
        path.write_text("".join(row.replace(" ", separator) + "\n" for row in rows))
        with pytest.warns(xcg.SceneWarning, match="no z of the position.*'vz'"):
            xcg.open_scene(path, density=1.0)
        ds = xcg.open_scene(path, density=1.0, names={"height": "position_z"})
        np.testing.assert_array_equal(ds.position[0, :, 2], [5.0, 6.0])


def test_a_dump_with_a_column_twice_opens_beside_named_contacts(tmp_path):
    grains = dumps.dump_text(["1 1 1 0 0 0 1", "2 1 1 2 0 0 1"], "id type type x y z radius")
    (tmp_path / "p.dump").write_text(grains)
    for columns, message in (
        ("id1 id2 fx fy fz", ""),
        ("id1 id2 fx FX fy fz", "both 'fx' and 'FX' may be 'contact_force_x'"),
    ):
        row = "1 2 -3 " + ("-9 " if message else "") + "0 0"
        (tmp_path / "c.dump").write_text(dumps.pairs_text([row], columns))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            ds = xcg.open_scene(
                tmp_path / "p.dump", contacts=tmp_path / "c.dump", density=1.0
            ).load()
        np.testing.assert_array_equal(ds.contact_force[0], [[-3.0, 0, 0]])
        assert message in " ".join(str(warning.message) for warning in caught)
