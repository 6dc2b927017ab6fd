"""The difference of two runs has the error of independent values, and only results of one method are subtracted."""

from __future__ import annotations

import re

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr

import xcg

mpl.use("agg")
plt = pytest.importorskip("matplotlib.pyplot")
FIELDS = ["velocity", "density"]


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def runs():
    """Averages of the first and of the last steps of a flow."""
    ds = xcg.datasets.open("plane_shear")
    a = ds.isel(time=slice(0, 8)).cg.coarse_grain(FIELDS, axes="z").cg.time_average()
    b = ds.isel(time=slice(9, 17)).cg.coarse_grain(FIELDS, like=a).cg.time_average()
    return a.compute(), b.compute()


def test_the_difference_of_repeated_runs_scatters_by_its_error():
    """2000 pairs of means of independent normal numbers, whose true difference is zero."""
    rng = np.random.default_rng(1)
    of_a = rng.normal(5.0, 0.3, 2000)
    of_b = rng.normal(5.0, 0.4, 2000)
    a, b = (
        xr.Dataset({"density": ("x", values), "density_error": ("x", np.full(2000, error))})
        for values, error in ((of_a, 0.3), (of_b, 0.4))
    )
    for relative in (False, True):
        c = xcg.compare(a, b, relative)
        assert abs((c.density / c.density_error).std().item() - 1) < 0.05
    np.testing.assert_allclose(xcg.compare(a, b).density_error, 0.5)


def test_the_difference_keeps_both_values_and_their_errors(runs):
    a, b = runs
    c = xcg.compare(a, b)
    for name in FIELDS:
        np.testing.assert_array_equal(c[name], b[name].values - a[name].values)
        squares = a[f"{name}_error"].values ** 2 + b[f"{name}_error"].values ** 2
        np.testing.assert_allclose(c[f"{name}_error"] ** 2, squares)
        for side, f in (("a", a), ("b", b)):
            np.testing.assert_array_equal(c[f"{name}_{side}"], f[name])
            np.testing.assert_array_equal(c[f"{name}_{side}_error"], f[f"{name}_error"])
    swapped = xcg.compare(b, a)
    np.testing.assert_array_equal(swapped.velocity, -c.velocity)
    np.testing.assert_array_equal(swapped.velocity_error, c.velocity_error)
    assert c.velocity.attrs["units"] == a.velocity.attrs["units"]


def test_the_relative_error_is_that_of_the_ratio(runs):
    """(b - a) / |a| is b / |a| less a sign, so its error is that of a ratio."""
    a, b = runs
    c = xcg.compare(a, b, relative=True)
    known = a.density.values > 0
    np.testing.assert_allclose((c.density + 1)[known], (b.density / a.density)[known])
    of_ratio = (b.density / a.density) * np.hypot(
        a.density_error / a.density, b.density_error / b.density
    )
    np.testing.assert_allclose(c.density_error[known], of_ratio[known])
    assert np.isnan(c.density.values[~known]).all()


def test_nodes_that_differ_in_the_last_digit_are_the_same(runs):
    a, b = runs
    moved = b.assign_coords(z=b.z * (1 + 1e-14))
    assert not np.array_equal(moved.z, b.z)
    np.testing.assert_array_equal(xcg.compare(a, moved).density, xcg.compare(a, b).density)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b.assign_attrs(width=0.5), r"width is .* in a and 0.5 in b.*like=a"),
        (lambda b: b.assign_attrs(kernel="gaussian"), "kernel is 'lucy' in a and 'gaussian'"),
        (lambda b: b.assign_attrs(unit_system="SI"), "unit_system is 'reduced' in a and 'SI'"),
        (lambda b: b.assign_coords(z=b.z + 0.1), "the results differ in z: 19 from .*like=a"),
        (lambda b: b.isel(z=slice(3)), "the results differ in z: 19 from .* 3 from"),
        (lambda b: b.expand_dims(time=[0.0, 1.0]), "velocity has the dimensions"),
        (lambda b: b[["velocity"]].rename(velocity="spin"), "no field in common"),
        (
            lambda b: b.assign(velocity=b.velocity.assign_attrs(units="mm s^-1")),
            "velocity is in '1' in a and in 'mm s",
        ),
    ],
)
def test_results_of_different_methods_are_not_subtracted(runs, change, message):
    a, b = runs
    with pytest.raises(ValueError, match=message):
        xcg.compare(a, change(b))


def test_runs_may_differ_in_gravity_and_friction(runs):
    a, b = runs
    steeper = b.assign_attrs(gravity=[0.5, 0.0, -0.8], friction=0.7)
    steeper = steeper.drop_vars("setup")
    np.testing.assert_array_equal(xcg.compare(a, steeper).density, xcg.compare(a, b).density)


def test_a_comparison_that_was_saved_is_drawn_the_same(runs, tmp_path):
    a, b = runs
    c = xcg.compare(a[["density", "density_error"]], b)
    c.cg.save(tmp_path / "c.nc")
    with xr.open_dataset(tmp_path / "c.nc") as opened:
        ax = opened.cg.plot()
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), c.density)


def test_a_missing_error_is_named(runs):
    a, b = runs
    with pytest.warns(xcg.SceneWarning, match="only one of the results has an error of density"):
        c = xcg.compare(a, b.drop_vars("density_error"))
    assert "density_error" not in c
    assert "velocity_error" in c


def test_the_picture_of_a_profile_shows_both_and_the_difference(runs):
    a, b = runs
    ax = xcg.compare(a, b).cg.plot("density")
    both, difference = ax.figure.axes
    assert ax is difference
    for line, f in zip(both.lines, runs, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), f.density)
    np.testing.assert_array_equal(difference.lines[0].get_xdata(), (b.density - a.density))
    assert [text.get_text() for text in both.get_legend().get_texts()] == ["a", "b"]
    band = difference.collections[0].get_paths()[0].vertices[:, 0]
    error = np.hypot(a.density_error, b.density_error)
    assert band.max() == pytest.approx((b.density - a.density + error).max().item())


def test_the_picture_of_a_map_shares_colours_of_both():
    ds = xcg.datasets.open("plane_shear").isel(time=[0, 16])
    a = ds.isel(time=[0]).cg.coarse_grain("density", axes="xz")
    b = ds.isel(time=[1]).cg.coarse_grain("density", like=a)
    ax = xcg.compare(a, b).cg.plot("density", shading="flat")
    left, right = (axes.collections[0] for axes in ax.figure.axes[:2])
    assert left.get_clim() == right.get_clim()
    np.testing.assert_array_equal(
        left.get_array().filled(0), a.density.isel(time=0).transpose("z", "x")
    )
    np.testing.assert_array_equal(
        ax.collections[0].get_array(), (b.density.values - a.density.values)[0].T
    )
    assert xcg.compare(a, b).cg.plot("density", ax=plt.subplots()[1]).figure.axes != []


def test_a_picture_refuses_an_error_that_is_negative(runs):
    a, b = runs
    with pytest.raises(ValueError, match=re.escape("xcg.compare(a, b)")):
        (b - a).cg.plot("velocity")
