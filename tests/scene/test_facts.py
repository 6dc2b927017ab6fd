"""The coordinate `setup`, which carries attributes through xarray."""

from pathlib import Path

import matplotlib.pyplot as plt
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
    ds = with_facts(with_setup(xr.Dataset(attrs=ATTRS)).drop_attrs(deep=False))
    assert ds.attrs.keys() == ATTRS.keys()
    for name, value in ATTRS.items():
        np.testing.assert_array_equal(ds.attrs[name], value)


def test_other_attributes_are_no_facts():
    assert setup_of({"history": "a call", "engine": "lammps"}).attrs == {}


def test_the_diameter_of_nodes_is_no_fact_of_the_result():
    """It is measured from each scene, so that parts of one kind would seem to differ."""
    for size, kept in (("d43", False), ("d32", False), ("d50", True), ("dmax", True)):
        facts = setup_of({"size": size, "size_diameter": 1.5}).attrs
        assert ("size_diameter" in facts) == kept


@pytest.mark.parametrize("value", [3.0, "my rig", "[1]", "{", ""])
def test_a_coordinate_of_the_user_is_named(value):
    ds = xcg.datasets.simple_cubic(3).assign_coords(setup=value)
    with pytest.raises(xcg.SceneError, match=r"'setup' holds .*drop_vars\('setup'\)"):
        ds.cg.coarse_grain("density")


@pytest.mark.parametrize("name", sorted(ATTRS))
def test_each_fact_changes_the_code(name):
    other = {"periodic": "x", "plane": "xz"}.get(name, 0.5)
    codes = {setup_of(ATTRS).item(), setup_of(ATTRS | {name: other}).item()}
    codes.add(setup_of({key: value for key, value in ATTRS.items() if key != name}).item())
    assert len(codes) == 3
    assert all(len(code) == 8 for code in codes)


def test_codes_do_not_depend_on_types_that_files_change():
    in_files = ATTRS | {"dimension": np.int32(2), "gravity": [0.0, 0.1, 1e-300], "width": [1 / 3]}
    assert setup_of(in_files).item() == setup_of(ATTRS).item()


def result():
    ds = xcg.datasets.random_scene(60, seed=1, periodic="xy")
    return ds.cg.coarse_grain(
        ["velocity", "inertial_number"], axes="xz", width=1.0, spacing=1.0, for_averages=True
    )


def test_titles_tables_and_reprs_have_no_json_and_the_width():
    """A title has the code and the width; xarray cuts what is longer than 50 characters."""
    f = result()
    scene = xcg.datasets.random_scene(60, seed=1, periodic="xy")
    mean = f.cg.time_average()
    pictures = [
        f.inertial_number.plot,
        f.velocity.sel(component="x").plot,
        f.inertial_number.isel(time=0, z=0).plot,
        mean.inertial_number.plot,
    ]
    for draw in pictures:
        draw()
        title = plt.gca().get_title()
        plt.close("all")
        assert "width = 1.0 [m]" in title
        assert "{" not in title
    over_lengths = scene.cg.coarse_grain("density", axes="z", extent={"x": 2.0})
    for ds in (f, scene, mean, f.cg.profile("z"), over_lengths):
        code = ds.setup.item()
        tables = [ds.to_dataframe(), ds[next(iter(ds.data_vars))].to_dataframe()]
        for table in tables:
            assert set(table["setup"]) == {code}
            assert "{" not in table.to_string()
        for shown in (ds, ds[next(iter(ds.data_vars))], ds.setup):
            assert "{" not in repr(shown)
            assert '{"' not in shown._repr_html_().replace("&quot;", '"')


def test_a_width_is_a_coordinate_with_its_unit_unless_each_phase_has_its_own():
    f = result()
    assert f.width.item() == 1.0
    assert f.width.attrs["units"] == "m"
    ds = xcg.datasets.random_scene(60, seed=1, periodic="xy")
    ds["kind"] = ("time", "particle"), np.arange(60)[None] % 2
    by_kind = ds.cg.coarse_grain("density", axes="z", by="kind", width={0: 1.0, 1: 1.5})
    assert "width" not in by_kind.coords
    np.testing.assert_allclose(by_kind.attrs["width"], [1.0, 1.5])
    assert "width" in ds.cg.coarse_grain("density", axes="z", by="kind", width=1.0).coords


def test_facts_survive_operations_of_xarray():
    f = result()
    results = [2 * f, f + f, f.mean("x"), f.isel(z=1), f.interp(x=[0.5]), f.rolling(x=2).mean()]
    results += [np.abs(f), f.coarsen(x=2, boundary="trim").mean(), f.where(f.inertial_number > 0)]
    for changed in results:
        back = with_facts(changed.drop_attrs(deep=False))
        assert back.attrs["width"] == 1.0
        assert back.attrs["periodic"] == "xy"


@pytest.mark.parametrize(
    "drop",
    [
        lambda ds: ds.drop_attrs(),
        lambda ds: xr.merge([ds[[name]] for name in ds], combine_attrs="drop"),
    ],
)
def test_a_deep_drop_of_all_attributes_is_an_error_with_ways_out(drop):
    f = result()
    bare = drop(f)
    with pytest.raises(xcg.SceneError, match=r"lost its attributes periodic.*drop_vars\('setup'\)"):
        bare.cg.time_average()
    bare.attrs = f.attrs
    expected = f.cg.time_average().inertial_number
    np.testing.assert_array_equal(bare.cg.time_average().inertial_number, expected)
    np.testing.assert_array_equal(
        f.drop_attrs().assign_attrs(f.attrs).drop_vars("setup").cg.time_average().inertial_number,
        expected,
    )
    scene = xcg.datasets.random_scene(60, seed=1, periodic="xy")
    with pytest.raises(xcg.SceneError, match="lost its attributes periodic"):
        drop(scene).cg.coarse_grain("density")


@pytest.mark.filterwarnings("ignore:In a future version of xarray:FutureWarning")
def test_a_part_with_the_attributes_of_another_is_refused():
    """`xr.concat` keeps the attributes of the first part, the part selected is the second."""
    ds = xcg.datasets.random_scene(60, seed=1)
    parts = [
        ds.cg.coarse_grain("density", axes="z", gradient=gradient)
        for gradient in ("least_squares", "kernel")
    ]
    both = xr.concat(parts, "call")
    both.isel(call=0).cg.time_average()
    with pytest.raises(xcg.SceneError, match=r"attributes of another\. Select it before joining"):
        both.isel(call=1).cg.time_average()


@pytest.mark.filterwarnings("ignore:In a future version of xarray:FutureWarning")
def test_files_that_differ_are_refused_when_they_are_opened_as_one(tmp_path, monkeypatch):
    ds = xcg.datasets.random_scene(60, seed=1)
    paths = []
    for k, gradient in enumerate(("least_squares", "kernel", "kernel")):
        f = ds.cg.coarse_grain("density", axes="z", gradient=gradient)
        f = f.assign_coords(time=[float(k)])
        paths.append(xcg.save(f, tmp_path / f"{k}.nc"))
    monkeypatch.setattr("xcg.scene.facts._SEEN", {})  # as in another process
    options = {"combine": "nested", "concat_dim": "time", "data_vars": "all"}
    both = xr.open_mfdataset(paths[:2], **options)
    with both, pytest.raises(xcg.SceneError, match=r"setup is [0-9a-f]{8} and [0-9a-f]{8}"):
        both.cg.time_average()
    with xr.open_mfdataset(paths[1:], **options) as both:
        assert both.setup.ndim == 0
        assert both.cg.time_average().density.notnull().all()


def test_files_of_earlier_versions_open():
    """Their coordinate is JSON; averages have the code of the same facts."""
    with xr.open_dataset(Path(__file__).parents[1] / "data" / "setup_as_json" / "f.nc") as f:
        assert f.setup.item().startswith("{")
        means = [f.cg.time_average(), f.drop_attrs().cg.time_average()]
        joined = xr.concat(
            [f, with_facts(f).assign_coords(time=[1.0])],
            "time",
            coords="different",
            compat="equals",
        )
        means.append(joined.cg.time_average())
        for mean in means:
            assert len(mean.setup.item()) == 8
            assert mean.setup.attrs["width"] == 1.0
            np.testing.assert_allclose(mean.inertial_number, f.inertial_number[0], rtol=1e-12)


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


def test_saved_depth_averages_are_read_with_the_present_name_of_the_solid_depth():
    f = xcg.datasets.open("chute").cg.depth_average("z").compute()
    old = f.rename(solid_depth="depth")
    xr.testing.assert_identical(with_facts(old), with_facts(f))
    other = xcg.datasets.simple_cubic(3).cg.coarse_grain("density", axes="z", width=1.0)
    assert "depth" in with_facts(other.assign(depth=other.density))


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
        assert with_facts(back.drop_attrs(deep=False)).attrs["width"] == 1.0
        assert back.width.item() == 1.0


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_facts_stay_in_records(tmp_path, suffix):
    path = tmp_path / f"f{suffix}"
    ds = xcg.datasets.random_scene(60, seed=1, periodic="xy")
    with xcg.record(path, ["density", "velocity"], axes="z", width=1.0) as record:
        for step in range(2):
            record.append(ds.isel(time=0).assign_coords(time=float(step)))
    engine = {".nc": {}, ".zarr": {"engine": "zarr"}}[suffix]
    with xr.open_dataset(path, **engine) as f:
        assert f.setup.ndim == 0
        mean = f.drop_attrs(deep=False).cg.time_average()
        assert mean.attrs["periodic"] == "xy"
        assert mean.width.item() == 1.0


def test_a_chunked_scene_computes_nothing_for_its_facts():
    lazy = xcg.datasets.simple_cubic(3).chunk(time=1)
    assert lazy.setup.chunks is None
