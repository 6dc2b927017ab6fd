"""Errors of one step against the scatter of ensembles: the same grains, with velocities drawn anew 200 times."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.ensembles import (
    CASES,
    LENGTH,
    OF_MOTION,
    OF_VARIABLES,
    ensemble,
    predicted_over_measured,
)
from xcg.fields.formulas.rows import errors as rows


@pytest.mark.parametrize("case", CASES)
def test_errors_are_the_scatter_of_draws(case):
    scene, options = CASES[case]
    f = ensemble(**scene).cg.coarse_grain(
        [*OF_MOTION, *OF_VARIABLES, "effective_count"], errors=True, **options
    )
    for name in [*OF_MOTION, "charge", "push", "charge_by_volume"]:
        found = predicted_over_measured(f, name)
        assert found.size, name
        # a node's scatter of 200 draws is known to 5 %, and neighbours share grains
        np.testing.assert_allclose(found, 1.0, atol=0.13, err_msg=name)
        assert np.median(found) == pytest.approx(1.0, abs=0.1), name


@pytest.mark.parametrize("slope", [0.0, 0.3, 2.0])
def test_a_steady_part_counts_as_far_as_it_exceeds_its_noise(slope):
    """The kinetic stress s and its steady part t = s - rho Theta, component by component."""
    mixed = np.random.default_rng(2).normal(size=(3, 3))
    theta = mixed @ mixed.T
    mass = 1.7
    share = 0.04
    steady = slope * np.outer([1.0, 2.0, 0.5], [1.0, 2.0, 0.5])
    whole = mass * theta + steady
    fields = SimpleNamespace(kinetic_stress=whole, _covariance=theta, _share=np.array(share))
    found = rows._kinetic_stress(fields, SimpleNamespace(mass=np.array(mass)), None)
    for i in range(3):
        for j in range(3):
            s2, t2 = (m[i, i] * m[j, j] + m[i, j] ** 2 for m in (whole, steady))
            variance = s2 / (1 + share * (2 if i == j else 1)) - max(0.0, t2 - 4 * share * s2)
            assert found[i, j] == pytest.approx(np.sqrt(variance * share), rel=1e-12)


def test_a_cylinder_has_errors_of_velocity_spin_and_means():
    ds = ensemble(226, shear=0.0)
    ds = ds.assign(position=ds.position - LENGTH / 2).drop_vars("box").assign_attrs(periodic="")
    names = ["velocity", "directional_temperature", "spin", "charge", "effective_count"]
    f = ds.cg.coarse_grain(
        names, errors=True, frame=xcg.Cylindrical("z"), axes="r", width=1.2, extent={"z": LENGTH}
    )
    for name in names[:-1]:
        np.testing.assert_allclose(
            predicted_over_measured(f, name, 20.0), 1.0, atol=0.2, err_msg=name
        )
    with pytest.raises(
        ValueError, match="velocity_gradient_error: available only in Cartesian axes"
    ):
        ds.cg.coarse_grain(
            "velocity_gradient_error", frame=xcg.Cylindrical("z"), axes="r", extent={"z": LENGTH}
        )


def test_errors_of_linear_fields_by_propagation():
    """G_kl = sum_i v_ik c_il with c_i = w_i A x_i: a sum T:G has the variance sum_i (T c_i) Theta (T c_i)."""
    rng = np.random.default_rng(8)
    place = rng.uniform(-1.5, 1.5, (60, 3))
    mixed = np.array([[1.0, 0, 0], [0.9, 0.3, 0], [-0.5, 0.6, 0.4]])
    ds = xcg.scene_from_arrays(
        place,
        velocity=rng.normal(size=(60, 3)) @ mixed.T,
        diameter=rng.uniform(0.3, 0.5, 60),
        density=1.0,
    )
    fields = ["velocity_gradient", "shear_rate_tensor", "vorticity"]
    names = [f"{name}_error" for name in fields]
    f = ds.cg.coarse_grain(
        [*names, "fluctuation_stress", "fluctuation_density"], at=dict.fromkeys("xyz", 0.1), width=0.8
    ).isel(time=0)  # fmt: skip
    w = ds.mass.values[0] * xcg.Lucy(0.8).value(np.linalg.norm(place - 0.1, axis=1))
    x = place - w @ place / w.sum()
    c = w[:, None] * x @ np.linalg.inv(np.einsum("n,ni,nj", w, x, x))
    theta = f.fluctuation_stress.values / float(f.fluctuation_density)

    def error(weights):
        return np.sqrt(np.einsum("nk,kl,nl", c @ weights.T, theta, c @ weights.T))

    one = np.eye(9).reshape(3, 3, 3, 3)
    rate = (one + one.swapaxes(0, 1)) / 2
    turn = np.array([one[2, 1] - one[1, 2], one[0, 2] - one[2, 0], one[1, 0] - one[0, 1]])
    for name, weights in zip(names, (one, rate, turn), strict=True):
        expected = np.array([error(t) for t in weights.reshape(-1, 3, 3)]).reshape(
            weights.shape[:-2]
        )
        np.testing.assert_allclose(f[name], expected, rtol=1e-9, err_msg=name)


def test_errors_have_units_and_formulas_of_their_fields():
    f = ensemble(100, draws=2).cg.coarse_grain(OF_MOTION, errors=True, axes="z")
    for name in OF_MOTION:
        assert f[f"{name}_error"].attrs["units"] == f[name].attrs["units"]
        assert f[f"{name}_error"].dims == f[name].dims
        assert f[f"{name}_error"].attrs["formula"]


def test_the_error_of_a_mean_by_brute_force():
    ds = ensemble(60, spread=1.5, draws=1)
    f = ds.cg.coarse_grain(["velocity", "charge", "directional_temperature"], errors=True, width=1.5, axes="",
                           at=dict.fromkeys("xyz", 3.0))  # fmt: skip
    one = ds.isel(time=0)
    apart = one.position.values - 3.0
    apart[:, 0] -= LENGTH * np.rint(apart[:, 0] / LENGTH)
    w = one.mass.values * xcg.Lucy(1.5, dimension=3).value(np.linalg.norm(apart, axis=1))
    q = one.charge.values
    mean = (w @ q) / w.sum()
    share = (w @ w) / w.sum() ** 2
    variance = (w @ (q - mean) ** 2) / (w.sum() - w @ w / w.sum())
    assert f.charge_error.item() == pytest.approx(np.sqrt(variance * share), rel=1e-10)
    expected = np.sqrt(f.directional_temperature.values.ravel() * share)
    np.testing.assert_allclose(f.velocity_error.values.ravel(), expected, rtol=1e-10)


@pytest.mark.filterwarnings("ignore:time_average. the error of velocity")  # of steps that drift
def test_an_average_over_steps_has_the_larger_error_and_names_it():
    f = ensemble(226, shear=0.0, draws=64).cg.coarse_grain(
        "velocity", errors=True, width=1.0, for_averages=True
    )
    mean = f.cg.time_average()
    assert mean.velocity_error_from.attrs["flag_meanings"] == "noise_of_each_step scatter_of_steps"
    # independent steps: both ways agree, and the larger is a little larger
    expected = np.sqrt((f.velocity_error**2).mean("time") / 64)
    assert float((mean.velocity_error / expected).mean()) == pytest.approx(1.05, abs=0.06)
    stuck = f.isel(time=[0] * 64).assign_coords(time=f.time)
    still = stuck.cg.time_average()
    assert (still.velocity_error_from == 0).all()  # no scatter: noise is all there is
    np.testing.assert_allclose(still.velocity_error, f.velocity_error[0] / 64**0.5, rtol=1e-9)
    drifting = f.assign(velocity=f.velocity + np.sin(f.time / 10.0))
    assert (drifting.cg.time_average().velocity_error_from == 1).all()
    alone = f.isel(time=[0]).cg.time_average()
    xr.testing.assert_allclose(
        alone.velocity_error, f.velocity_error.isel(time=0, drop=True).drop_attrs()
    )


def test_a_profile_has_the_error_of_its_independent_places():
    f = ensemble(226, shear=0.0).cg.coarse_grain(
        ["velocity", "charge"], errors=True, width=1.0, for_averages=True
    )
    profile = f.cg.profile("z")
    for name in ("velocity", "charge"):
        measured = float(profile[name].std("time").mean())
        assert float(profile[f"{name}_error"].mean()) == pytest.approx(measured, rel=0.12)
    assert profile.cg.time_average().velocity_error.dims == ("z", "component")


def test_errors_are_lazy_and_equal():
    ds = ensemble(100, draws=4)
    options = {"errors": True, "width": 1.0, "axes": "z"}
    eager, lazy = (
        one.cg.coarse_grain(["velocity", "charge"], **options) for one in (ds, ds.chunk(time=1))
    )
    assert lazy.velocity_error.chunks is not None
    xr.testing.assert_identical(lazy.compute().drop_attrs(), eager.drop_attrs())


@pytest.mark.parametrize(("options", "message"), [
    ({"fields": "density"}, "errors of a single step exist for .*, not for density: leave errors= out"),
    ({"fields": "velocity_gradient", "gradient": "kernel"}, "not for velocity_gradient: leave errors= out"),
    ({"fields": "velocity", "per": "accessible", "surfaces": [xcg.Plane((0, 0, 0), (0, 0, 1))]}, "leave one out"),
])  # fmt: skip
def test_fields_without_errors_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        ensemble(60, draws=1).cg.coarse_grain(errors=True, width=1.0, **options)


def test_errors_of_averages_are_not_averaged():
    f = ensemble(60, draws=4).cg.coarse_grain("velocity", errors=True, width=1.0, for_averages=True)
    with pytest.raises(ValueError, match="profile takes no mean of errors and biases"):
        f.cg.time_average().cg.profile("z")


@pytest.mark.parametrize(
    "options", [{}, {"axes": "z"}, {"axes": "xz", "at": {"y": 5.0}, "kernel": "gaussian"}]
)
def test_explain_states_the_noise_of_a_dense_packing(options):
    ds = xcg.datasets.dense_packing(8000)
    plan = ds.cg.explain("velocity", width=1.0, **options)
    seen = ds.cg.coarse_grain("effective_count", width=1.0, **options).effective_count.mean().item()
    assert plan.effective_count == pytest.approx(seen, rel=0.05)
    assert f"velocity +-{plan.effective_count**-0.5:.2g} sqrt(T)" in str(plan)
    points = xcg.scene_from_arrays(
        ds.position.values, velocity=ds.velocity.values, mass=np.ones(8000)
    )
    assert "noise" not in str(points.cg.explain("velocity", width=1.0))


def test_explain_states_no_noise_of_rings_and_widths_by_group():
    ds = xcg.datasets.dense_packing(1000)
    for options in (
        {"frame": xcg.Cylindrical("z"), "axes": "r", "extent": {"z": 1.0}},
        {"by": "species", "width": {1: 1.0, 2: 0.5}},
    ):  # fmt: skip
        assert "noise" not in str(
            ds.drop_vars("box")
            .assign_attrs(periodic="")
            .cg.explain("velocity", **{"width": 1.0} | options)
        )
