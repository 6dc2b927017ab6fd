"""The coordinate `setup`, which carries attributes through xarray."""

import json

import numpy as np
import pytest
import xarray as xr

import xcg
from xcg.scene.facts import RENAMED, setup_of, with_facts, with_setup

ATTRS = {
    "periodic": "xy",
    "dimension": 2,
    "plane": "xy",
    "thickness": 0.1,
    "gravity": np.array([0.0, 0.1, 1e-300]),
    "width": np.float64(1 / 3),
}


def test_facts_come_back_to_the_last_bit():
    ds = with_facts(with_setup(xr.Dataset(attrs=ATTRS)).drop_attrs())
    assert ds.attrs.keys() == ATTRS.keys()
    for name, value in ATTRS.items():
        np.testing.assert_array_equal(ds.attrs[name], value)


def test_other_attributes_are_no_facts():
    assert json.loads(setup_of({"history": "a call", "engine": "lammps"}).item()) == {}


def test_the_diameter_of_nodes_is_no_fact_of_the_result():
    """It is measured from each scene, so that parts of one kind would seem to differ."""
    for size, kept in (("d43", False), ("d32", False), ("d50", True), ("dmax", True)):
        facts = json.loads(setup_of({"size": size, "size_diameter": 1.5}).item())
        assert ("size_diameter" in facts) == kept


@pytest.mark.parametrize("value", [3.0, "my rig", "[1]", "{", ""])
def test_a_coordinate_of_the_user_is_named(value):
    ds = xcg.datasets.simple_cubic(3).assign_coords(setup=value)
    with pytest.raises(xcg.SceneError, match=r"'setup' holds .*drop_vars\('setup'\)"):
        ds.cg.coarse_grain("density")


def test_saved_results_are_read_with_the_present_names_of_fields(tmp_path):
    chute = xcg.datasets.open("chute")
    f = chute.cg.coarse_grain(["boundary_force_density", "stress"], axes="z", width=1.0)
    mean = f.cg.time_average()
    old = {new: name for name, new in RENAMED.items() if new in f}
    assert old == {"boundary_force_density": "wall_traction"}
    f.rename(old).to_netcdf(tmp_path / "old.nc")
    with xr.open_dataset(tmp_path / "old.nc") as back:
        xr.testing.assert_identical(back.cg.time_average().drop_attrs(), mean.drop_attrs())
        drawn = {"component": "z", "index": 0}
        assert back.cg.plot("boundary_force_density", **drawn) is not None


def test_variables_of_scenes_may_have_former_names_of_fields():
    ds = xcg.datasets.simple_cubic(3)
    ds["wall_traction"] = ds.mass.dims, ds.mass.values
    assert "wall_traction" in with_facts(ds)


def test_former_names_of_fields_in_a_request_are_errors_with_the_present_ones():
    ds = xcg.datasets.simple_cubic(3)
    for old, new in RENAMED.items():
        with pytest.raises(ValueError, match=f"unknown field '{old}'; did you mean '{new}'"):
            ds.cg.coarse_grain(old, fluid_viscosity=1.0)


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_facts_stay_in_files(tmp_path, suffix):
    ds = xcg.datasets.simple_cubic(3)
    f = ds.cg.coarse_grain("density", axes="z", width=1.0)
    own = tmp_path / f"own{suffix}"
    if suffix == ".nc":
        f.to_netcdf(own)
    else:
        f.to_zarr(own, consolidated=False)
    for path in (own, xcg.save(f, tmp_path / f"f{suffix}")):
        engine = {".nc": {}, ".zarr": {"engine": "zarr", "consolidated": False}}[suffix]
        back = xr.open_dataset(path, chunks={}, **engine)
        assert back.setup.item() == f.setup.item()
        assert with_facts(back.drop_attrs()).attrs["width"] == 1.0


def test_a_chunked_scene_computes_nothing_for_its_facts():
    lazy = xcg.datasets.simple_cubic(3).chunk(time=1)
    assert lazy.setup.chunks is None
