"""Variation of a flow within the support of a node and along averaged axes, of flows that are known."""

import numpy as np
import pytest

import xcg
from xcg.fields.plan import make_plan
from xcg.fields.pressures import pressures_of, variation_of_flow
from xcg.fields.request import Request
from xcg.scene.frame import frame_at
from xcg.scene.scene import Scene

SIDE = 20  # diameters


def of_flow(velocity, axes="xz", noise=0.0):
    """Return the variation of the flow V_x over mass, within supports and by averaged axis."""
    ds = xcg.datasets.simple_cubic(SIDE)
    z = ds.position.sel(component="z", drop=True)
    z = z - z.mean()
    v = np.zeros(ds.position.shape)
    v[..., 0] = velocity(z)
    v += noise * np.random.default_rng(1).normal(size=v.shape)
    ds = ds.assign(velocity=(ds.position.dims, v))
    plan = make_plan(Scene(ds), Request("kinetic_stress", axes=axes, width=1.5))
    frame, lattice, _ = frame_at(ds, 0, plan.variables)
    flow, smeared, averaged = variation_of_flow(plan, frame, lattice)
    mass = frame["mass"].sum()
    parts = {axis: part[0] / mass for axis, part in averaged.items()}
    np.testing.assert_array_equal(smeared[1:], 0.0)
    return ds, frame["velocity"] - flow, smeared[0] / mass, parts


@pytest.mark.parametrize("axes", ["z", "xz", "xyz"])
def test_a_linear_shear_adds_its_covariance_within_the_support(axes):
    """Of V = rate z the kinetic stress is rho rate^2 <z^2>, of grains in their weights at a node."""
    rate = 0.7
    ds, residual, smeared, averaged = of_flow(lambda z: rate * z, axes)
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)
    bounds = dict.fromkeys(axes, (SIDE / 2 - 3, SIDE / 2 + 3))
    f = ds.cg.coarse_grain(["kinetic_stress", "density"], axes=axes, width=1.5, bounds=bounds)
    node = f.isel(time=0).mean([*axes])
    stress = node.kinetic_stress.sel(component="x", direction="x")
    assert smeared == pytest.approx(float(stress / node.density), rel=0.02)
    np.testing.assert_allclose([*averaged.values()], 0.0, atol=1e-12)


@pytest.mark.parametrize("power", [1, 2, 3])
def test_an_averaged_axis_adds_the_variance_of_the_flow_along_it(power):
    layers = np.arange(SIDE) - (SIDE - 1) / 2
    _, _, smeared, averaged = of_flow(lambda z: z**power, axes="x")
    assert averaged["z"] == pytest.approx(np.var(layers**power), rel=1e-9)
    assert averaged["y"] == pytest.approx(0.0, abs=1e-9)
    assert smeared == pytest.approx(0.0, abs=1e-9)


def test_noise_is_no_variation_and_is_subtracted_from_one():
    _, _, smeared, averaged = of_flow(lambda z: 0.0 * z, axes="x", noise=1.0)
    assert smeared == 0.0
    assert not any(averaged.values())
    _, _, _, averaged = of_flow(lambda z: 0.1 * z, axes="x", noise=1.0)
    assert averaged["z"] == pytest.approx(0.01 * SIDE**2 / 12, rel=0.1)


@pytest.mark.parametrize("sampled", [2_000, 10**6])
def test_pressures_of_a_crystal_that_fluctuates(sampled, monkeypatch):
    """Its contacts carry force / diameter^2, and its grains a kinetic pressure of n m T."""
    monkeypatch.setattr("xcg.fields.pressures._SAMPLED", sampled)
    ds = xcg.datasets.simple_cubic(SIDE, force=3.0)
    v = np.random.default_rng(2).normal(size=ds.position.shape)
    ds = ds.assign(velocity=(ds.position.dims, v))
    plan = make_plan(Scene(ds), Request("stress", width=1.5))
    frame, lattice, _ = frame_at(ds, 0, plan.variables)
    parts = pressures_of(plan, frame, lattice)
    share = len(frame["mass"][:: max(1, SIDE**3 // sampled)]) / SIDE**3
    assert parts.contact.sum() == pytest.approx(3 * 3.0 * SIDE**3 * share, rel=1e-3)
    np.testing.assert_allclose(parts.contact, 3.0 * SIDE**3 * share, rtol=0.06)
    np.testing.assert_allclose(parts.kinetic, frame["mass"].sum() * share, rtol=0.08)
    np.testing.assert_array_equal(parts.smeared, 0.0)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_sheared_images_in_contact_do_not_fluctuate(noise):
    """Of a crystal in a homogeneous shear, grains in contact differ by the shear, also across its sheared edge."""
    rate = 0.7
    ds = xcg.datasets.simple_cubic(SIDE, force=3.0)
    v = noise * np.random.default_rng(2).normal(size=ds.position.shape)
    v[..., 0] += rate * ds.position.sel(component="z").to_numpy()
    parts = {"diameter", "density", "contact_i", "contact_j", "contact_force"}
    sheared = xcg.scene_from_arrays(
        ds.position.to_numpy(),
        velocity=v,
        box=ds.box.to_numpy()[0],
        periodic="xyz",
        lattice={"xz": 0.0},
        shear_rate={"xz": rate},
        **{name: ds[name].to_numpy() for name in parts},
    )
    plan = make_plan(Scene(sheared), Request("stress", width=1.5))
    frame, lattice, _ = frame_at(sheared, 0, plan.variables)
    kinetic = pressures_of(plan, frame, lattice).kinetic
    mass = frame["mass"][:: SIDE**3 // 2_000].sum()
    np.testing.assert_allclose(kinetic, noise**2 * mass, rtol=0.08, atol=1e-20 * mass)


def test_a_weak_shear_of_few_grains_is_known_by_its_mean_slope():
    """The noise of the slope of a line is a twentieth of that of the slopes of a cubic polynomial."""
    _, _, smeared, _ = of_flow(lambda z: 0.02 * z, axes="xyz", noise=1.0)
    variance = 0.75  # of the places in the weights of a node, width 1.5
    assert smeared == pytest.approx(0.02**2 * variance, rel=0.3)
