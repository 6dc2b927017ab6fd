"""Comments in CSV and in YADE's text, names of unit systems, and scenes without sizes."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import xcg
from tests.dumps import dump_text, write
from xcg.common.messages import SceneError
from xcg.readers.open import open_scene


@pytest.mark.parametrize(
    "text",
    [
        "# made today\nx,y,z,radius\n1,2,3,0.5\n2,2,3,0.5\n",
        "x,y,z,radius\n# made, today\n# again\n1,2,3,0.5\n2,2,3,0.5\n",
        "# one\n\ufeff# two\nx, y, z, radius\n# below\n1, 2, 3, 0.5\n2, 2, 3, 0.5\n",
        "# made today\n# x,y,z,radius\n1,2,3,0.5\n2,2,3,0.5\n",
        "#x y z radius\n# a comment of more words\n1 2 3 0.5\n2 2 3 0.5\n",
        "x; y; z; radius\n#\n1; 2; 3; 0.5\n2; 2; 3; 0.5\n",
        "# time = 0.5\nx,y,z,radius\n1,2,3,0.5\n2,2,3,0.5\n",
        "# time: 0.5 s\nx y z radius\n1 2 3 0.5\n2 2 3 0.5\n",
        "# time 0.5\nx,y,z,radius\n1,2,3,0.5\n2,2,3,0.5\n",
        "x,y,z,radius,\n1,2,3,0.5,\n2,2,3,0.5,\n",
    ],
)
def test_comments_of_csv_are_comments(tmp_path, text):
    scene = open_scene(write(tmp_path / "grains.csv", text)).compute()
    np.testing.assert_array_equal(scene.position[0], [[1, 2, 3], [2, 2, 3]])
    np.testing.assert_array_equal(scene.diameter[0], [1, 1])


@pytest.mark.parametrize(
    "text",
    [
        "#format x_y_z_r\n# my sample\n{}",
        "# my sample of 4 grains\n#format x_y_z_r\n{}",
        "#format x_y_z_r\n# x y z of my sample\n# id x y z\n{}",
        "# time 0.5 step 3\n# x y z r\n# it was a sample\n{}",
        "# a remark of six words here\n# time 0.5 step 3\n# x y z r\n{}",
    ],
)
def test_comments_of_yade_are_comments(tmp_path, text):
    path = write(tmp_path / "grains.txt", text.format("1 2 3 .5\n2 2 3 .5\n"))
    scene = open_scene(path).compute()
    np.testing.assert_array_equal(scene.position[0], [[1, 2, 3], [2, 2, 3]])
    np.testing.assert_array_equal(scene.diameter[0], [1, 1])


def test_materials_of_yade_are_species(tmp_path):
    text = "#format x_y_z_r_matId\n# matId below\n1\t2\t3\t.5\t4\n2\t2\t3\t.5\t6\n"
    scene = open_scene(write(tmp_path / "grains.txt", text))
    np.testing.assert_array_equal(scene.species[0], [4, 6])


def test_attributes_of_yade_fill_the_row(tmp_path):
    text = "#format x_y_z_r_attrs\n1 2 3 .5 7 8\n"
    scene = open_scene(write(tmp_path / "grains.txt", text), names={"attribute_2": "my_charge"})
    np.testing.assert_array_equal(scene.my_charge[0], [8])


def test_yade_comments_of_another_length_are_refused(tmp_path):
    path = write(tmp_path / "grains.txt", "#format x_y_z_r\n1 2 3 .5 7\n")
    with pytest.raises(
        SceneError, match="each of the 5 values of the first row, found format x_y_z_r"
    ):
        open_scene(path)


@pytest.mark.parametrize(
    ("units", "length", "mass", "system"),
    [
        ("lj", 1, 1, "reduced"),
        ("LJ", 1, 1, "reduced"),
        ("si", 1, 1, "SI"),
        ("cgs", 1e-2, 1e-3, "SI"),
        ("micro", 1e-6, 1e-15, "SI"),
        ("nano", 1e-9, 1e-21, "SI"),
    ],
)
def test_unit_systems_have_names(tmp_path, units, length, mass, system):
    text = dump_text(["1 1 1 1 2 0.5"], "id x y z mass radius").replace("ITEM: UNITS\nsi\n", "")
    scene = open_scene(write(tmp_path / "p.dump", text), units=units)
    np.testing.assert_allclose(scene.diameter, length)
    np.testing.assert_allclose(scene.mass, 2 * mass)
    assert scene.attrs["unit_system"] == system
    made = xcg.scene_from_arrays([[1.0, 1.0, 1.0]], diameter=[1.0], units=units)
    np.testing.assert_allclose(made.diameter, length)


@pytest.mark.parametrize("units", ["real", "metal", "electron"])
def test_unit_systems_whose_force_is_not_consistent_are_refused(tmp_path, units):
    path = write(tmp_path / "p.dump", dump_text())
    with pytest.raises(SceneError, match=f"{units}.*unit of force.*units="):
        open_scene(path, units=units)


def test_scenes_without_sizes_name_a_way_that_works(tmp_path):
    path = write(tmp_path / "p.dump", dump_text(["1 5 5 5 0.5"], "id x y z c_size"))
    scene = open_scene(path, names={"c_size": None})
    with pytest.raises(
        SceneError, match=r"names=\{'...': 'radius'\}.*ds.assign\(diameter=d"
    ) as error:
        xcg.coarse_grain(scene, "density", axes="x", width=1.0)
    call = "ds.assign(" + str(error.value).partition("ds.assign(")[2].partition(" (this")[0]
    d = xr.full_like(scene.position[..., 0], 0.001)
    names = {"ds": scene, "d": d, "np": np}
    assigned = eval(call, names)
    fields = xcg.coarse_grain(assigned, ["density", "volume_fraction"], axes="x", width=1.0)
    mapped = open_scene(path, names={"c_size": "diameter"}, density=2500)
    twice = xcg.coarse_grain(mapped, ["density", "volume_fraction"], axes="x", width=1.0)
    for name in ("density", "volume_fraction"):
        np.testing.assert_allclose(fields[name] * 500**3, twice[name], rtol=1e-12)


@pytest.mark.parametrize(
    "form", ["{}/mm", "{}, mm", "{} in mm", "{}:mm", "{} {{mm}}", "{} mm", "{} <mm>"]
)
@pytest.mark.filterwarnings("error")
def test_units_behind_a_sign_are_read(form):
    table = pd.DataFrame({"id": [1], "x": [3.0], "y": [0.0], "z": [0.0], "radius": [0.5]})
    named = table.rename(columns={name: form.format(name) for name in table.columns[1:]})
    ds = xcg.scene_from_table(named, density=1.0)
    np.testing.assert_allclose(ds.position[0], [[3e-3, 0, 0]])
    np.testing.assert_allclose(ds.diameter, 1e-3)
    mapped = named.rename(columns={form.format("x"): form.format("Ort")})
    ds = xcg.scene_from_table(mapped, names={form.format("Ort"): "position_x"}, density=1.0)
    np.testing.assert_allclose(ds.position[0, 0, 0], 3e-3)
