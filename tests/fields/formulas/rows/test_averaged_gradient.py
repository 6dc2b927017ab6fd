"""Velocity gradients along averaged axes: those of a sheared box, zero in a periodic one at rest, else unknown."""

import warnings

import numpy as np
import pytest

import xcg
from xcg import SceneWarning

EDGE, RATE = 6.0, 0.37
FLOW = ["velocity", "velocity_gradient", "shear_rate", "granular_temperature", "kinetic_stress"]


def sheared(noise=0.0, wrapped=False):
    """Grains in a linear shear between images that move; those written another period further on have its velocity."""
    rng = np.random.default_rng(0)
    position = rng.uniform(0, EDGE, (400, 3))
    if wrapped:
        position[:, 1] += EDGE * rng.integers(-1, 2, len(position))
    velocity = noise * np.random.default_rng(5).normal(size=(400, 3)) + 0.4
    velocity[:, 0] += RATE * position[:, 1]
    return xcg.scene_from_arrays(
        position, velocity=velocity, diameter=np.full(400, 0.5), density=1.0, box=[[0, EDGE]] * 3, periodic="xyz",
        lattice={"xy": 0.0}, shear_rate={"xy": RATE},
    )  # fmt: skip


@pytest.mark.parametrize("lazy", [False, True], ids=["eager", "lazy"])
@pytest.mark.parametrize("axes", ["", "x", "z", "xz", "y"])
def test_a_sheared_box_has_its_rate(axes, lazy):
    ds = sheared(wrapped=axes != "y")
    f = (ds.chunk(time=1) if lazy else ds).cg.coarse_grain(FLOW, axes=axes).compute()
    expected = np.zeros((3, 3))
    expected[0, 1] = RATE
    np.testing.assert_allclose(f.velocity_gradient, np.broadcast_to(expected, f.velocity_gradient.shape), atol=1e-13)
    np.testing.assert_allclose(f.shear_rate, RATE, rtol=1e-12)
    assert float(f.granular_temperature.max()) < 1e-15
    if "y" not in axes:
        assert float(abs(f.kinetic_stress).max()) < 1e-25
        np.testing.assert_allclose(f.velocity.sel(component="x"), 0.4 + RATE * EDGE / 2, rtol=1e-12)


@pytest.mark.parametrize("axes", ["", "xz"])
def test_results_do_not_depend_on_how_grains_are_written(axes):
    one, other = (sheared(noise=0.2, wrapped=w).cg.coarse_grain(FLOW, axes=axes) for w in (False, True))
    for name in FLOW:
        np.testing.assert_allclose(one[name], other[name], rtol=1e-10, atol=1e-12)
    assert float(one.granular_temperature.mean()) == pytest.approx(0.04, rel=0.1)


def test_a_periodic_box_at_rest_has_none():
    ds = xcg.datasets.random_scene(50)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        f = ds.cg.coarse_grain(["velocity_gradient", "inertial_number"], axes="")
    assert not f.velocity_gradient.any()
    assert (f.inertial_number == 0).all()


@pytest.mark.parametrize("lazy", [False, True], ids=["eager", "lazy"])
@pytest.mark.parametrize("gradient", ["least_squares", "kernel"])
def test_between_walls_it_is_unknown_and_a_warning_tells_the_way_out(gradient, lazy):
    ds = xcg.datasets.random_scene(50, periodic="xy")
    ds = ds.chunk(time=1) if lazy else ds
    names = ["velocity_gradient", "shear_rate", "vorticity", "inertial_number", "pressure"]
    with pytest.warns(SceneWarning, match=r"shear_rate, vorticity, inertial_number: NaN, .* axes='z'") as told:
        f = ds.cg.coarse_grain(names, axes="", extent={"z": 5.0}, gradient=gradient).compute()
    assert len(told) == 1
    for name in names[:4]:
        assert f[name].isnull().all()
    assert f.pressure.notnull().all()


def test_fields_that_do_not_follow_from_it_are_not_warned_of():
    ds = xcg.datasets.random_scene(50, periodic="xy")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        f = ds.cg.coarse_grain(["stress", "granular_temperature"], axes="", extent={"z": 5.0})
    assert np.isfinite(f.granular_temperature).all()
