"""Pair correlation at contact."""

import numpy as np
import pytest

import xcg
from tests.scenes import gas, hard_spheres


@pytest.mark.slow
def test_hard_spheres_follow_carnahan_and_starling():
    f = hard_spheres().cg.contact_value()
    error = float(f.contact_value.std("time")) / np.sqrt(f.sizes["time"])
    expected = (1 - 0.15) / (1 - 0.3) ** 3
    assert abs(float(f.contact_value.mean("time")) - expected) < 0.02 * expected + 3 * error
    # the error of a step is the scatter of the steps
    assert float(f.contact_value_error.mean()) == pytest.approx(
        float(f.contact_value.std("time")), rel=0.3
    )


def test_phases_of_one_size_have_the_value_of_all():
    ds = hard_spheres()
    f = ds.cg.contact_value(by="species")
    whole = float(f.contact_value[:, 0, 0].mean())
    error = f.contact_value.std("time") / np.sqrt(f.sizes["time"])
    assert (abs(f.contact_value.mean("time") - whole) < 4 * error).all()


def test_the_error_of_independent_pairs_is_their_scatter():
    """Of points at random, for pairs of all, of one phase, of all with one, and of two phases."""
    steps = 300
    ds = gas(steps, 150, "xyz")
    f = ds.cg.contact_value(by="species", groups=[1, 2, 3])
    scatter = f.contact_value.std("time", ddof=1)
    mean_square = np.sqrt((f.contact_value_error**2).mean("time"))
    # the relative error of a standard deviation is the root of 1 / 2 (n - 1)
    assert (np.abs(mean_square / scatter - 1) < 4 / np.sqrt(2 * (steps - 1))).all()


def test_distances_are_over_the_mean_diameter():
    """Sizes and places scaled by a factor have the same value."""
    ds = hard_spheres().isel(time=[0])
    large = xcg.scene_from_arrays(
        3 * ds.position.to_numpy(),
        diameter=3 * ds.diameter.to_numpy(),
        density=1.0,
        box=[(0, 3 * float(ds.box[0, 0, 1]))] * 3,
        periodic="xyz",
    )
    a = ds.cg.contact_value()
    b = large.cg.contact_value()
    np.testing.assert_allclose(a.contact_value, b.contact_value, rtol=1e-12)


@pytest.mark.parametrize("reach", [1.0, "nonsense", np.inf])
def test_wrong_reach_is_named(reach):
    with pytest.raises(ValueError, match="reach="):
        xcg.datasets.random_scene(30).cg.contact_value(reach)
