"""Results on the mesh and with the options of another."""

import numpy as np
import pytest
import xarray as xr

import xcg
from xcg.scene.facts import SAVED_OPTIONS, saved_options

FIELDS = ["velocity", "contact_stress"]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"axes": "z", "width": "0.9 d43", "kernel": "gaussian"},
        {"axes": "xz", "at": {"y": 1.5}, "spacing": 0.3, "bounds": {"x": (0.1, 2.0)}},
        {"axes": "z", "by": "species", "gradient": "paper", "rtol": 1e-3},
        {"axes": "z", "spacing": 1.0, "extent": {"x": 2.0}},
        {"axes": "", "at": {a: xr.DataArray([1.0, 2.0], dims="s") for a in "xyz"}},
    ],
)
def test_results_of_one_scene_are_the_same_bits(options):
    ds = xcg.datasets.random_scene(200, seed=1)
    f = ds.cg.coarse_grain(FIELDS, **options)
    again = ds.cg.coarse_grain(FIELDS, like=f)
    xr.testing.assert_equal(again, f)
    differ = {name for name in f.attrs if not np.array_equal(f.attrs[name], again.attrs[name])}
    assert differ <= {"history"}


def test_lengths_of_averages_are_plain_text_and_json_of_earlier_versions_is_read():
    ds = xcg.datasets.random_scene(50, seed=1)
    f = ds.cg.coarse_grain("density", axes="z", extent={"x": 2.0, "y": 1 / 3})
    assert f.attrs["extent"] == "x = 2.0, y = 0.3333333333333333"
    old = f.drop_vars("setup").assign_attrs(extent='{"x": 2.0, "y": 0.3333333333333333}')
    for pattern in (f, old):
        again = ds.cg.coarse_grain("density", like=pattern)
        assert again.attrs["extent"] == f.attrs["extent"]
        xr.testing.assert_equal(again.density, f.density)


def test_nodes_of_a_reversed_result_are_the_same():
    ds = xcg.datasets.random_scene(200, seed=1)
    f = ds.cg.coarse_grain("density", axes="xz")
    again = ds.cg.coarse_grain("density", like=f.isel(x=slice(None, None, -1)))
    xr.testing.assert_equal(again, f)


@pytest.mark.parametrize("mesh", [{"bounds": {"x": (0.5, 0.5)}}, {"spacing": {"x": 9.0, "z": 0.5}}])
def test_one_node_along_an_axis_is_a_pattern(mesh):
    """Also where that node fills the period, which derivatives and averages know."""
    ds = xcg.datasets.random_scene(60, seed=3)
    f = ds.cg.coarse_grain("velocity_gradient", axes="xz", width=0.5, **mesh)
    assert f.sizes["x"] == 1
    again = ds.cg.coarse_grain("velocity_gradient", like=f)
    xr.testing.assert_identical(again.drop_attrs(), f.drop_attrs())
    assert again.attrs["wrapped_axes"] == f.attrs["wrapped_axes"]


def test_results_of_other_scenes_have_the_same_nodes():
    """Other extents and sizes would lay other nodes, and the difference would be empty."""
    a = xcg.datasets.random_scene(200, seed=1, periodic="")
    b = xcg.datasets.random_scene(300, seed=2, periodic="")
    f = a.cg.coarse_grain(FIELDS)
    g = b.cg.coarse_grain(FIELDS, like=f)
    assert (f - g).sizes == f.sizes
    assert (f - b.cg.coarse_grain(FIELDS)).sizes != f.sizes
    expected = b.cg.coarse_grain(
        FIELDS,
        width=f.attrs["width"],
        at={k: xr.DataArray(f[k].to_numpy(), dims=f"n{k}") for k in "xyz"},
    )
    np.testing.assert_allclose(g.contact_stress, expected.contact_stress, atol=1e-9, rtol=1e-9)
    assert b.cg.explain(FIELDS, like=f).kernel.width == f.attrs["width"]


def test_averages_over_cells_of_earlier_versions_are_no_pattern():
    ds = xcg.datasets.random_scene(50)
    f = ds.cg.coarse_grain("density", axes="z")
    again = ds.cg.coarse_grain("density", like=f.assign_attrs(sampling="node"))
    xr.testing.assert_equal(again, f)
    with pytest.raises(ValueError, match=r"averages over cells.*give width=, spacing= and bounds="):
        ds.cg.coarse_grain("density", like=f.assign_attrs(sampling="cell"))


def test_options_of_results_are_those_of_the_table():
    ds = xcg.datasets.random_scene(40, seed=3)
    options = {
        "shear_dims": "zx",
        "pressure_dims": "z",
        "fluid_viscosity": 2.0,
        "friction": 0.5,
        "extent": {"x": 2.5, "y": 3.0},
        "size": "dmax",
        "rtol": 1e-3,
        "gradient": "paper",
        "temperature": "biased",
        "deviatoric": "rate",
        "kernel": "heaviside",
    }
    usual = ds.cg.explain("density", axes="z").attrs
    chosen = ds.cg.explain("density", axes="z", **options).attrs
    always = {name for name, option in SAVED_OPTIONS.items() if option.always}
    assert always <= usual.keys() <= chosen.keys() <= SAVED_OPTIONS.keys()
    saved = saved_options(chosen)
    assert {name: saved[name] for name in options} == options
    f = ds.cg.coarse_grain("density", axes="z", **options)
    again = ds.cg.coarse_grain("density", like=f)
    assert saved_options(again.attrs) == saved_options(f.attrs)


def test_unlike_arguments_are_named():
    ds = xcg.datasets.random_scene(50)
    f = ds.cg.coarse_grain("density", axes="z")
    with pytest.raises(ValueError, match=r"width= and like=: .* leave one out"):
        ds.cg.coarse_grain("density", like=f, width=1.0)
    with pytest.raises(ValueError, match="like= is a scene"):
        ds.cg.coarse_grain("density", like=ds)
    with pytest.raises(ValueError, match="like=str: expected a result"):
        ds.cg.coarse_grain("density", like="f.nc")
    with pytest.raises(xcg.SceneError, match="like="):
        ds.cg.coarse_grain("density", like=f.drop_attrs().drop_vars("setup"))
