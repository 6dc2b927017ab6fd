"""Warnings about averages: of few steps, and of temperatures that are unknown at many nodes."""

import re
import warnings

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import raise_if_dask_computes, truths


def told(function, *args, **options):
    """Return the result of a call, and the texts of its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = function(*args, **options)
    return result, [str(warning.message) for warning in caught]


def rods(order, planar):
    """Grains with a share `order` of directors along z, or anywhere across it, and the others anywhere."""
    rng = np.random.default_rng(4)
    n = rng.normal(size=(16, 1320, 3))
    chosen = rng.uniform(size=n.shape[:2]) < order
    if planar:
        n[chosen, 2] = 0.0
    else:
        n[chosen] = (0.0, 0.0, 1.0)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    return xcg.scene_from_arrays(
        rng.uniform(0, 12.0, n.shape),
        velocity=np.zeros(n.shape),
        director=n,
        diameter=np.ones(n.shape[:2]),
        density=1.0,
        time=np.arange(16),
        box=dict.fromkeys("xyz", (0.0, 12.0)),
        periodic="xyz",
        units="reduced",
    )


@pytest.mark.parametrize("lazy", [False, True])
def test_an_unsure_sign_of_the_nematic_order_warns_and_has_no_bias(lazy):
    ds = rods(0.5, planar=True)
    f, _ = told(ds.cg.coarse_grain, "nematic_order", spacing=3.0, for_averages=True)
    average = f.cg.time_average
    if lazy:
        with raise_if_dask_computes():
            average = f.chunk(time=4).cg.time_average().compute
    mean, (text,) = told(average)
    is_wrong = mean.nematic_order > 0
    assert float(is_wrong.mean()) > 0.1
    unsure = mean.nematic_order_bias.isnull()
    assert float((is_wrong & ~unsure).sum()) <= 0.2 * float(is_wrong.sum())
    assert f"is unsure at {100 * float(unsure.mean()):.0f} % of the nodes" in text
    # what the jump from one eigenvalue to the other adds is no bias
    assert float(np.abs(mean.nematic_order_bias).max()) < 0.1


@pytest.mark.parametrize("planar", [False, True])
def test_a_sure_sign_of_the_nematic_order_is_silent(planar):
    ds = rods(0.5, planar)
    f, _ = told(ds.cg.coarse_grain, "nematic_order", spacing=3.0, width=1.5, for_averages=True)
    mean, texts = told(f.cg.time_average)
    assert texts == []
    truth = -0.25 if planar else 0.5
    unbiased = mean.nematic_order - mean.nematic_order_bias
    within = np.abs(unbiased - truth) < 2 * mean.nematic_order_error
    assert float(within.mean()) > 0.85


def gas_of_few_grains(steps, phi, width, seed=0):
    """A map of grains at random places with the temperature 1, of which a node sees a few."""
    rng = np.random.default_rng(seed)
    side = 24.0
    count = round(phi * side**2 * 4 / np.pi)
    flat = [1.0, 1.0, 0.0]
    ds = xcg.scene_from_arrays(
        rng.uniform(0, side, (steps, count, 3)) * flat,
        velocity=rng.normal(size=(steps, count, 3)) * flat,
        diameter=np.ones((steps, count)),
        density=1.0,
        time=np.arange(steps),
        box={"x": (0.0, side), "y": (0.0, side)},
        periodic="xy",
        dimension=2,
        thickness=1.0,
        units="reduced",
    )
    fields = ["granular_temperature", "directional_temperature", "velocity"]
    return told(ds.cg.coarse_grain, fields, axes="xy", spacing=3.0, width=width)[0]


def test_means_of_few_steps_warn_of_the_share_within_two_errors():
    f = gas_of_few_grains(16, 0.5, 0.75)
    mean, (text,) = told(f.cg.time_average)
    assert "the mean of granular_temperature, directional_temperature, as" in text
    weight = f.fluctuation_density.where(f.granular_temperature.notnull(), 0.0)
    number = weight.sum("time") ** 2 / (weight**2).sum("time")
    few = number.where(number < 5)
    share = few.notnull().sum() / number.notnull().sum()
    start = f"time_average: at {100 * float(share):.0f} % of the nodes {float(few.mean()):.1f} of the 16"
    assert text.startswith(start)
    temperature, error = mean.granular_temperature, mean.granular_temperature_error
    within = (np.abs(temperature - 1) < 2 * error).where(error.notnull()).mean()
    held = float(re.search(r"about (\d+) % of the values", text)[1])
    assert 100 * float(within) == pytest.approx(held, abs=12)


def test_means_of_many_steps_are_silent():
    assert told(gas_of_few_grains(16, 0.5, 1.25).cg.time_average)[1] == []
    f = gas_of_few_grains(16, 0.2, 0.75)
    velocity = f[["velocity"]].drop_vars("fluctuation_density")
    assert told(velocity.cg.time_average)[1] == []


def test_windows_count_their_own_steps():
    f = gas_of_few_grains(24, 0.5, 1.25)
    assert told(f.cg.time_average, 12, every=4)[1] == []


@pytest.mark.parametrize("lazy", [False, True])
def test_averaged_temperatures_of_phases_that_are_unknown_warn_of_their_share(lazy):
    ds = truths.gas(6, sizes=(1.0, 2.0))
    options = {"by": "species", "spacing": 3.0, "width": "0.75 d43"}
    f, _ = told(lambda: ds.cg.coarse_grain("granular_temperature", **options).compute())
    average = f.cg.time_average
    if lazy:
        with raise_if_dask_computes():
            average = f.chunk(time=2).cg.time_average().compute
    mean, texts = told(average)
    share = float(mean.granular_temperature.sel(phase="2").isnull().mean())
    assert share > 0.16
    (text,) = (text for text in texts if "is NaN" in text)
    assert f"{100 * share:.0f} % of the nodes of phase 2: the values at the others" in text


def test_averaged_temperatures_of_phases_that_are_known_are_silent():
    ds = truths.gas(8, sizes=(1.0, 2.0))
    f = ds.cg.coarse_grain("granular_temperature", by="species", spacing=3.0, width="1.5 d43")
    assert told(f.cg.time_average)[1] == []
    assert told(f.cg.profile, "z")[1] == []


AVERAGES = {
    "profile": lambda f: f.cg.profile("z"),
    "coarsen": lambda f: f.cg.coarsen(x=6, y=6, z=6),
    "time_average": lambda f: f.cg.time_average(),
}


@pytest.mark.parametrize(
    ("purpose", "steps"), [("profile", 1), ("coarsen", 1), ("time_average", 4)]
)
def test_norms_of_averages_of_few_grains_warn_of_their_floor(purpose, steps):
    """Of an isotropic packing mu and a_c are 0; the warning names what they are on average."""
    ds = truths.packing(count=300, steps=steps)
    names = ["friction_coefficient", "contact_anisotropy"]
    f, _ = told(ds.cg.coarse_grain, names, axes="xyz", width="0.75 d43", for_averages=True)
    f = f.isel({axis: slice(6) for axis in "xyz"})
    mean, (text,) = told(AVERAGES[purpose], f)
    assert text.startswith(f"{purpose}: ")
    for name in names:
        floor = re.search(rf"{name} is about ([\d.]+)", text)
        if floor:
            assert float(floor[1]) == pytest.approx(float(mean[name].mean()), rel=0.45), name
    assert "contact_anisotropy" in text
    # nobody asked for these by name
    f, _ = told(ds.cg.coarse_grain, axes="xyz", width="0.75 d43")
    assert told(AVERAGES[purpose], f.isel({axis: slice(6) for axis in "xyz"}))[1] == []


def test_anisotropies_without_a_floor_warn_of_the_noise_of_few_steps():
    """The floors of branches and tangential forces take the contacts of a step, which averages do not have."""
    ds = truths.packing(count=300, steps=4)
    names = ["branch_anisotropy", "contact_anisotropy"]
    f, _ = told(ds.cg.coarse_grain, names, spacing=2.0, for_averages=True)
    mean, texts = told(f.cg.time_average)
    (text,) = [text for text in texts if text.startswith("time_average: branch_anisotropy is ")]
    value = re.search(r"is ([\d.]+) in the mean of the nodes, ([\d.]+) without its bias", text)
    assert float(value[1]) == pytest.approx(float(mean.branch_anisotropy.mean()), rel=0.05)
    assert float(value[2]) < 0.6 * float(value[1])
    assert not any(
        "contact_anisotropy is" in text and "mean of the nodes" in text for text in texts
    )


def test_angles_that_are_noise_warn_and_have_no_bias():
    """Of turned contacts stress and fabric are 0.2 rad apart; in a volume noise turns both."""
    (system,) = truths.systems(["turned contacts"])
    f, _ = told(system.make().cg.coarse_grain, "stress_fabric_angle", **truths.VOLUME)
    mean, texts = told(f.cg.time_average)
    (text,) = [text for text in texts if "stress_fabric_angle is" in text]
    numbers = re.search(r"is ([\d.]+) rad in .* with an error of ([\d.]+) rad", text)
    assert float(numbers[1]) == pytest.approx(float(mean.stress_fabric_angle.mean()), rel=0.05)
    assert float(numbers[1]) > 1.5 * system.truths[1].value
    assert float(numbers[2]) > 0.5 * float(numbers[1])
    assert "stress_fabric_angle_bias" not in mean
    f, _ = told(system.make().cg.coarse_grain, "stress_fabric_angle", **truths.PROFILE)
    assert told(f.cg.time_average)[1] == []


def test_the_floor_of_a_profile_is_that_of_the_marginal():
    """As many places as share no grains are averaged: the support of a slab has all of them."""
    ds = truths.packing(count=300, steps=1)
    options = {"width": "1.5 d43", "for_averages": True}
    f, _ = told(ds.cg.coarse_grain, "friction_coefficient", axes="xyz", **options)
    of_profile, _ = told(f.cg.profile, "z")
    marginal, _ = told(ds.cg.coarse_grain, "friction_coefficient", axes="z", **options)
    floors = [g.friction_coefficient.attrs["floor_of_one_step"] for g in (of_profile, marginal)]
    assert floors[0] == pytest.approx(floors[1], rel=0.05)


def test_averages_of_many_grains_have_no_floor_to_warn_of():
    ds = truths.packing(count=300, steps=1)
    f, _ = told(
        ds.cg.coarse_grain, "friction_coefficient", axes="xyz", width="2 d43", for_averages=True
    )
    assert told(f.cg.profile, "z")[1] == []


def test_equal_lazy_averages_that_may_warn_have_equal_names():
    ds = xcg.datasets.random_scene(60).cg.find_contacts(k_n=1.0).chunk()
    fields = ["velocity", "stress", "granular_temperature", "friction_coefficient"]
    f = ds.cg.coarse_grain(fields, axes="z", width=0.8, by="species", for_averages=True)
    runs = xr.concat([f] * 8, "run")
    for average in (lambda: runs.cg.time_average(dim="run"), lambda: f.cg.profile("z")):
        assert average().__dask_layers__() == average().__dask_layers__()
