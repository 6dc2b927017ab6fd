"""Bias and plateau of fields by width, against flows that are known."""

from functools import partial

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import flows

WIDTHS = np.geomspace(0.3, 2.0, 9)


def test_each_width_is_the_field_at_that_width():
    ds = xcg.datasets.random_scene(100, seed=1)
    at = {"x": [1.0, 2.0], "y": [2.0, 3.0], "z": [2.5, 2.4]}
    s = ds.cg.width_sweep(WIDTHS, ["density", "stress"], at=at)
    assert s.stress.dims[:2] == ("width", "point")
    for k, w in enumerate(WIDTHS):
        alone = ds.cg.coarse_grain(
            "density", axes="", at={"x": 2.0, "y": 3.0, "z": 2.4}, width=w
        ).density
        assert s.density.isel(width=k, point=1).item() == alone.item()


def test_the_plateau_of_a_lattice_is_its_volume_fraction():
    ds = xcg.datasets.face_centred_cubic(5)
    s = ds.cg.width_sweep(WIDTHS, "volume_fraction", at={"x": 0.1, "y": 0.2, "z": 0.4})
    assert s.volume_fraction_plateau.item() == pytest.approx(np.pi / (3 * np.sqrt(2)), rel=1e-2)
    assert s.volume_fraction_plateau_width.item() > 0.5


def test_the_history_of_a_sweep_is_its_own_call():
    ds = xcg.datasets.random_scene(100, seed=1)
    s = ds.cg.width_sweep([0.6, 0.9, 1.2], "density", at={"x": 1.0, "y": 2.0, "z": 2.5})
    (call,) = s.attrs["history"].splitlines()[-1:]
    assert "width_sweep(widths=[0.6, 0.9, 1.2], fields='density'" in call
    assert "coarse_grain" not in s.attrs["history"]
    assert "on_error" not in call
    assert (
        s.density_slope.attrs["long_name"]
        == "size of the logarithmic slope of mass density of the mixture by width"
    )


def test_biases_and_slopes_have_no_formula_or_averaging_rule_of_their_field():
    ds = xcg.datasets.random_scene(60, seed=1)
    s = ds.cg.width_sweep([0.5, 0.7, 0.9], "velocity", axes="z")
    assert "formula" in s.velocity.attrs
    for name in ("bias", "extrapolated", "too_wide", "slope", "plateau_width"):
        assert set(s[f"velocity_{name}"].attrs) == {"units", "long_name"}


def test_a_missing_plateau_is_reported():
    """The density at a lone grain falls as w^-3 for ever."""
    ds = xcg.scene_from_arrays([[0.0, 0, 0]], diameter=[1.0], density=1.0)
    s = ds.cg.width_sweep(WIDTHS, "density", at={"x": 0, "y": 0, "z": 0})
    assert np.isnan(s.density_plateau_width.item())
    np.testing.assert_allclose(s.density_slope[1:-1], 3.0, rtol=0.1)


def test_profiles_keep_their_nodes():
    ds = xcg.datasets.random_scene(100, seed=1, periodic="xy").chunk()
    s = ds.cg.width_sweep(WIDTHS[::3], "density", axes="z")
    assert s.density.dims == ("width", "time", "z")
    assert s.density.notnull().all()
    lone = ds.cg.coarse_grain(
        "density", axes="z", width=WIDTHS[3], bounds={"z": (s.z[0], s.z[-1])}, spacing=WIDTHS[0]
    )
    swept = s.density.isel(width=1, drop=True).drop_vars("setup")  # which has no width
    xr.testing.assert_allclose(swept, lone.density.drop_vars(["setup", "width"]))


def test_wrong_arguments_raise():
    ds = xcg.datasets.random_scene(20)
    with pytest.raises(ValueError, match="two or more"):
        ds.cg.width_sweep([0.5, 0.5], "density")
    with pytest.raises(ValueError, match="same length"):
        ds.cg.width_sweep(WIDTHS, "density", at={"x": [1.0, 2.0], "y": [1.0]})


@pytest.mark.parametrize("name", ["sine", "band"])
def test_the_bias_of_two_widths_is_the_true_bias_within_a_third(name):
    """Without fluctuations and with many grains, where the bias is below a fifth of the field."""
    flow = {"sine": flows.sine, "band": partial(flows.band, thickness=3.0)}[name](
        60, temperature=0.0
    )
    for width in (0.75, 1.0, 1.4):
        s = flow.scene.cg.width_sweep([width, width * 2**0.5], "velocity", axes="z", spacing=0.5)
        f = s.isel(width=0).sel(component="x").mean("time")
        true = f.velocity - flow.truth(f.z)
        left = f.velocity_extrapolated - flow.truth(f.z)
        true, size, found, left = (
            float((x**2).mean() ** 0.5) for x in (true, f.velocity, f.velocity_bias, left)
        )
        assert 0.01 < true < 0.2 * size
        assert found == pytest.approx(true, rel=0.3)
        assert left < 0.35 * true


def test_the_bias_of_a_parabola_is_exact():
    """Of V = z^2 on a fine lattice, the kernel adds mu_2 at every node inside, and the extrapolated field is V."""
    z = np.linspace(-4, 4, 4001)
    ds = xcg.scene_from_arrays(
        np.stack([0 * z, 0 * z, z], 1), velocity=np.stack([z**2, 0 * z, 0 * z], 1), diameter=np.full(z.size, 0.1),
        density=1.0, box=np.array([[-1, 1], [-1, 1], [-8, 8]]), periodic="xy",
    )  # fmt: skip
    s = ds.cg.width_sweep(
        [0.5, 0.8], "velocity", axes="z", kernel="gaussian", bounds={"z": (-1, 1)}, spacing=0.25
    )
    s = s.sel(component="x", drop=True).isel(time=0, drop=True)
    moment = s.velocity.sel(z=0)
    assert moment.values[0] == pytest.approx(0.25, rel=0.1)
    xr.testing.assert_allclose(s.velocity_bias, moment * xr.ones_like(s.velocity), rtol=1e-4)
    np.testing.assert_allclose(
        s.velocity_extrapolated, xr.ones_like(s.velocity) * s.z**2, atol=1e-4
    )
    assert s.velocity_too_wide.all()  # by a fifth and by a third of the largest value
    assert not ds.cg.width_sweep(
        [0.1, 0.2], "velocity", axes="z", bounds={"z": (-1, 1)}
    ).velocity_too_wide.any()
