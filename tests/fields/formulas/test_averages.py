"""Profiles and averages over time: ratios through their sums, errors of correlated samples."""

import warnings

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ensembles, raise_if_dask_computes, truths
from tests.scenes import random_steps
from xcg.fields.formulas import registry
from xcg.fields.formulas.block_errors import jackknife
from xcg.fields.formulas.rules import needed_for_averages

ALL = {"width": 0.8, "spacing": 1.0}


def assert_ratios_of_sums(got, f, dims):
    """Each averaged field by hand from sums over `dims`."""
    mean = {
        n: f[n].mean(dims)
        for n in ("density", "momentum_density", "volume_fraction", "number_density")
    }
    # about the averaged velocity
    v = f.velocity.fillna(0.0)
    flux = (f.stress + f.density * v * v.rename(component="direction")).mean(dims)
    u = mean["momentum_density"] / mean["density"]
    stress = flux - mean["density"] * u * u.rename(component="direction")
    np.testing.assert_allclose(got.density, mean["density"], rtol=1e-12)
    np.testing.assert_allclose(
        got.velocity, mean["momentum_density"] / mean["density"], rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(
        got.particle_density, mean["density"] / mean["volume_fraction"], rtol=1e-12
    )
    s2 = (f.volume_fraction / f.d32).mean(dims)
    s3 = f.volume_fraction.mean(dims)
    np.testing.assert_allclose(got.d32, s3 / s2, rtol=1e-12)
    np.testing.assert_allclose(got.d43, (f.volume_fraction * f.d43).mean(dims) / s3, rtol=1e-12)
    z = (f.coordination_number * f.number_density).mean(dims) / mean["number_density"]
    np.testing.assert_allclose(got.coordination_number, z, rtol=1e-12)
    known = f.granular_temperature.notnull()  # not where a node has too few grains for a fit
    energy = (
        sum(f.fluctuation_stress.sel(component=a, direction=a) for a in "xyz")
        .where(known, 0)
        .sum(dims)
    )
    temperature = energy / 3 / f.fluctuation_density.where(known, 0).sum(dims)
    np.testing.assert_allclose(got.granular_temperature, temperature, rtol=1e-9)
    sigma = stress.transpose(*got.stress.dims).values
    p = np.trace(sigma, axis1=-2, axis2=-1) / 3
    dev = sigma - p[..., None, None] * np.eye(3)
    shear = np.sqrt((dev**2).sum((-1, -2)) / 2)
    np.testing.assert_allclose(got.shear_stress, shear, rtol=1e-9)
    np.testing.assert_allclose(
        got.friction_coefficient, np.where(p > 0, shear / p, np.nan), rtol=1e-9
    )
    w = f.density.where(f.shear_rate_tensor.notnull(), 0)
    gamma = (f.shear_rate_tensor.fillna(0) * w).sum(dims) / w.sum(dims)
    trace = np.trace(gamma.values, axis1=-2, axis2=-1)
    dev = gamma.values - trace[..., None, None] / 3 * np.eye(3)
    rate = np.sqrt(2 * (dev**2).sum((-1, -2)))
    np.testing.assert_allclose(got.shear_rate, rate, rtol=1e-9)
    rho_p = (mean["density"] / mean["volume_fraction"]).values
    number = rate * got.d43.values * np.sqrt(rho_p / np.where(p > 0, p, np.nan))
    np.testing.assert_allclose(got.inertial_number, number, rtol=1e-9)


@pytest.mark.parametrize("lazy", [False, True])
def test_profile_and_average_are_ratios_of_sums(lazy):
    ds = random_steps(6, first=80, more=0)
    f = (ds.chunk(time=1) if lazy else ds).cg.coarse_grain(**ALL)
    profile = f.cg.profile("z")
    average = f.cg.time_average()
    if lazy:
        assert profile.velocity.chunks is not None
        assert average.inertial_number_error.chunks is not None
        f = f.compute()
        profile = profile.compute()
        average = average.compute()
    assert profile.velocity.dims == ("time", "z", "component")
    assert_ratios_of_sums(profile, f, ["x", "y"])
    assert average.velocity.dims == ("x", "y", "z", "component")
    assert_ratios_of_sums(average, f, ["time"])
    # and not the means of ratios
    assert float(np.abs(average.velocity - f.velocity.mean("time")).max()) > 1e-3
    assert (
        float(np.abs(average.friction_coefficient - f.friction_coefficient.mean("time")).max())
        > 1e-3
    )


def test_profile_is_the_mean_over_nodes():
    ds = xcg.datasets.simple_cubic(5)
    f = ds.cg.coarse_grain(["volume_fraction", "density", "stress"], width=2.0, spacing=1.0)
    p = f.cg.profile("z")
    np.testing.assert_allclose(p.volume_fraction, np.pi / 6, rtol=5e-3)
    assert p.volume_fraction.dims == ("time", "z")
    # over whole periods, at nodes close enough, the mesh agrees with the exact marginal
    random = xcg.datasets.random_scene(60, seed=2)
    mesh = random.cg.coarse_grain(["density", "velocity"], width=0.6, spacing=0.25).cg.profile("z")
    exact = random.cg.coarse_grain(["density", "velocity"], width=0.6, spacing=0.25, axes="z")
    np.testing.assert_allclose(mesh.density, exact.density, rtol=2e-4)
    np.testing.assert_allclose(mesh.velocity, exact.velocity, rtol=2e-3, atol=2e-4)


def test_variants_survive_an_average():
    options = {
        "pressure_dims": "z",
        "shear_dims": "xz",
        "deviatoric": "both",
        "size": "d32",
        "fluid_viscosity": 1e-3,
    }
    f = random_steps(1, first=80, more=0).cg.coarse_grain(**ALL, **options)
    once = f.cg.time_average()
    for name in f.data_vars:
        np.testing.assert_allclose(
            once[name], f[name].isel(time=0), rtol=1e-9, atol=1e-12, err_msg=name
        )
        assert np.isnan(once[f"{name}_error"]).all()
    whole = random_steps(1, first=80, more=0).cg.coarse_grain(size="dmax", **ALL)
    np.testing.assert_allclose(
        whole.cg.time_average().inertial_number, whole.inertial_number.isel(time=0), rtol=1e-9
    )


def test_moving_windows():
    f = random_steps(6, first=80, more=0).cg.coarse_grain(
        ["density", "velocity", "momentum_density"], **ALL
    )
    moving = f.cg.time_average(window=3)
    np.testing.assert_allclose(moving.time, [0.1, 0.2, 0.3, 0.4])
    for t in range(4):
        part = f.isel(time=slice(t, t + 3)).cg.time_average()
        for name in ("density", "velocity", "velocity_error"):
            np.testing.assert_allclose(
                moving[name].isel(time=t), part[name], rtol=1e-12, atol=1e-14
            )
    np.testing.assert_allclose(f.cg.time_average(window=2, every=2).time, [0.05, 0.25, 0.45])
    xr.testing.assert_allclose(
        f.cg.time_average(window=2.0, every=2.0), f.cg.time_average(window=2, every=2)
    )
    with pytest.raises(
        ValueError, match="every=2 is the distance of windows: give their length, window="
    ):
        f.cg.time_average(every=2)


def test_windows_of_dates_and_durations_lie_at_their_mean_time():
    f = random_steps(4).cg.coarse_grain("density", axes="z", width=0.8)
    durations = np.arange(4) * np.timedelta64(200, "ms")
    for start in (np.timedelta64(0, "ms"), np.datetime64("2024-02-28T23:59:59.5", "ms")):
        moving = f.assign_coords(time=start + durations).cg.time_average(window=2)
        expected = (start + np.array([100, 300, 500]) * np.timedelta64(1, "ms")).tolist()
        assert moving.time.values.astype(start.dtype).tolist() == expected


def test_results_in_chunks_of_components_and_phases_are_averaged():
    """As stores hold them that were written in such chunks."""
    ds = random_steps(2)
    fields = ["stress", "granular_temperature", "mixture_temperature"]
    f = ds.cg.coarse_grain(fields, axes="xz", by="species", width=0.9, for_averages=True)
    lazy = f.chunk(component=1, direction=2, phase=1, other_phase=1)
    xr.testing.assert_allclose(lazy.cg.profile("z").compute(), f.cg.profile("z"))


def test_moving_windows_of_a_lazy_result():
    """Fields that follow from tensors are computed anew in each window, lazily as in memory."""
    f = (
        random_steps(30, first=80, more=0)
        .chunk(time=30)
        .cg.coarse_grain("friction_coefficient", axes="y", width=1.0, for_averages=True)
    )
    lazy = f.cg.time_average(window=6, every=6)
    assert lazy.chunks
    xr.testing.assert_allclose(lazy.compute(), f.compute().cg.time_average(window=6, every=6))


def as_result(values, **more):
    """A result of one node whose density is a given series."""
    attrs = {"units": "kg m-3"}
    time = np.arange(len(values), dtype=float)
    return xr.Dataset(
        {"density": (("time", "x"), values, attrs), **more},
        {"time": time, "x": np.arange(values.shape[1])},
    )


def test_errors_of_few_samples_are_their_scatter_over_the_root_of_their_number():
    x = np.random.default_rng(2).normal(size=(5, 7))
    got = as_result(x).cg.time_average()
    np.testing.assert_allclose(got.density_error, x.std(axis=0, ddof=1) / np.sqrt(5), rtol=1e-12)


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_errors_of_correlated_samples(memory):
    rng = np.random.default_rng(0)
    n, columns = 4096, 400
    x = np.empty((n, columns))
    x[0] = rng.normal(size=columns)
    for t in range(1, n):
        x[t] = memory * x[t - 1] + np.sqrt(1 - memory**2) * rng.normal(size=columns)
    true = np.sqrt((1 + memory) / (1 - memory) / n)  # of the mean of n samples of variance 1
    got = as_result(10 + x).cg.time_average()
    scatter = float(got.density.std())
    assert scatter == pytest.approx(true, rel=0.1)
    assert float(got.density_error.mean()) == pytest.approx(true, rel=0.1)
    naive = float((x.std(axis=0, ddof=1) / np.sqrt(n)).mean())
    assert naive == pytest.approx(true / np.sqrt((1 + memory) / (1 - memory)), rel=0.05)


def test_the_error_equals_that_of_the_block_beyond_which_it_does_not_grow():
    n = 1024
    for length in (
        1,
        2,
        4,
        8,
    ):  # so many steps up, so many down: blocks of twice as many are all alike
        x = np.where(np.arange(n) // length % 2, 1.0, -1.0)[:, None]
        got = as_result(5 + x).cg.time_average().density_error.item()
        assert got == pytest.approx(1 / np.sqrt(n / length - 1), rel=1e-12)
    with pytest.warns(xcg.SceneWarning, match="density changes over the 64 steps"):
        ramp = as_result(np.arange(64.0)[:, None]).cg.time_average().density_error.item()
    # grows with every block: of sixteen, the fewest that are looked at
    assert ramp == pytest.approx(4 * np.sqrt((16**2 - 1) / 12 / 15), rel=1e-12)
    with pytest.warns(xcg.SceneWarning, match="density changes over the 8 steps"):
        short = as_result(np.arange(8.0)[:, None]).cg.time_average().density_error.item()
    assert short == pytest.approx(np.sqrt((8**2 - 1) / 12 / 7), rel=1e-12)


def test_the_block_is_chosen_within_the_scatter_of_the_errors():
    """The smallest block whose error is reached by none of the larger blocks' errors less their own scatter."""
    rng = np.random.default_rng(2)
    x = rng.normal(size=(700, 60))
    for t in range(1, 700):
        x[t] += np.linspace(0, 0.9, 60) * x[t - 1]
    got = as_result(x).cg.time_average().density_error.values
    chosen = []
    for column, error in zip(x.T, got, strict=True):
        errors = []
        scatter = []
        samples = column
        while len(samples) >= 16:
            errors.append(samples.std(ddof=1) / np.sqrt(len(samples)))
            scatter.append(errors[-1] / np.sqrt(2 * (len(samples) - 1)))
            samples = samples[: len(samples) // 2 * 2].reshape(-1, 2).mean(axis=1)
        fits = [all(e - s <= errors[k] for e, s in zip(errors[k + 1 :], scatter[k + 1 :], strict=True))
                for k in range(len(errors))]  # fmt: skip
        chosen.append(fits.index(True))
        assert error == pytest.approx(errors[chosen[-1]], rel=1e-9)
    assert len(set(chosen)) > 3


@pytest.mark.parametrize("lazy", [False, True])
def test_errors_of_steps_that_hardly_change_warn_that_they_grow(lazy):
    """Eight steps, each repeated eight times but for noise: blocks of four leave the error 31 % too small."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(8, 40))
    f = as_result(5 + np.repeat(x, 8, axis=0) + 1e-7 * rng.normal(size=(64, 40)))
    call = (f.chunk(time=8) if lazy else f).cg.time_average
    if lazy:
        with raise_if_dask_computes():
            mean = call()
        call = mean.compute
    with pytest.warns(xcg.SceneWarning, match="from blocks of 4 steps to blocks of 8") as warned:
        mean = call()
    assert len(warned) == 1
    right = x.std(axis=0, ddof=1) / np.sqrt(8)
    np.testing.assert_allclose(mean.density_error / right, np.sqrt(7 / 15), rtol=1e-5)
    if not lazy:
        assert mean.density_error.attrs["share_without_plateau"] == 1.0
        assert mean.density_error.attrs["share_with_drift"] == 0.0


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize(("different", "times"), [(3, 2), (8, 8), (16, 3), (24, 20)])
def test_steps_that_are_written_again_are_counted(different, times, lazy):
    x = 5 + np.random.default_rng(4).normal(size=(different, 40))
    f = as_result(np.repeat(x, times, axis=0))
    call = (f.chunk(time=times) if lazy else f).cg.time_average
    if lazy:
        call = call().compute
    with pytest.warns(xcg.SceneWarning, match=rf"% of the .* None, {times}\)") as warned:
        mean = call()
    assert len(warned) == 1
    right = x.std(axis=0, ddof=1) / np.sqrt(different)
    assert float((mean.density_error / right).mean()) < 0.9
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        once = f.isel(time=slice(None, None, times)).cg.time_average()
    np.testing.assert_allclose(once.density_error, right, rtol=1e-9)


def test_a_trend_warns_where_it_exceeds_three_of_its_errors():
    """The statistic of the test is that of the line fitted to the blocks: here one in which t is known."""
    x = np.arange(12) - 5.5
    across = x**2 - np.mean(x**2)  # no part of a line
    for t, speaks in ((5.0, True), (3.5, False)):  # 12 steps: p = 0.0027 at t = 3.96
        slope = t * np.sqrt(np.sum(across**2) / 10 / np.sum(x**2))
        f = as_result((100 + slope * x + across)[:, None])
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            mean = f.cg.time_average()
        assert ["changes over the 12 steps" in str(w.message) for w in warned] == [True] * speaks
        assert mean.density_error.attrs == {
            "units": "kg m-3", "long_name": "standard error of density", "share_with_drift": float(speaks),
        }  # fmt: skip


def test_errors_of_equal_lazy_averages_have_equal_names():
    """Their tasks hold what the warnings say, not the graphs of all errors."""
    f = as_result(np.random.default_rng(4).normal(size=(8, 5))).chunk(time=4)
    names = [f.cg.time_average().density_error.data.name for _ in range(2)]
    assert names[0] == names[1]


@pytest.mark.parametrize("steps", [8, 24, 64])
def test_steady_series_are_silent(steps):
    """Warnings are errors here: thousands of nodes, few blocks, and fields that do not change at all."""
    rng = np.random.default_rng(steps)
    as_result(rng.normal(size=(steps, 4000))).cg.time_average()
    as_result(np.exp(2 * rng.normal(size=(steps, 4000)))).cg.time_average()
    as_result(np.full((steps, 5), 0.1)).cg.time_average()
    rounding = 1e-10 * np.repeat(rng.normal(size=(steps // 8, 5)), 8, axis=0)
    mean = as_result(1.0 + rounding).cg.time_average()
    assert mean.density_error.attrs.get("share_without_plateau", 0.0) == 0.0


def test_directors_at_random_have_no_error_that_grows():
    """The sign of their order changes from block to block, which is no correlation."""
    for seed in range(12):
        ds = truths.rods(0.0, seed=seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            f = ds.cg.coarse_grain("nematic_order", axes="")
        with pytest.warns(xcg.SceneWarning) as warned:
            f.cg.time_average()
        assert ["sign of nematic_order is unsure" in str(w.message) for w in warned] == [True]


def test_errors_of_ratios_equal_those_of_the_ratio_of_sums():
    rng = np.random.default_rng(1)
    n, columns = 2048, 300
    rho = rng.uniform(1, 3, (n, columns))
    v = rng.normal(size=(n, columns, 3)) / rho[..., None] + 5.0
    f = as_result(rho, velocity=(("time", "x", "component"), v)).assign_coords(
        component=list("xyz")
    )
    got = f.cg.time_average()
    np.testing.assert_allclose(
        got.velocity, (rho[..., None] * v).sum(0) / rho.sum(0)[:, None], rtol=1e-12
    )
    assert float(got.velocity_error.mean()) == pytest.approx(float(got.velocity.std()), rel=0.1)


def test_the_density_of_the_material_is_averaged_by_volume():
    rng = np.random.default_rng(3)
    rho = rng.uniform(500, 3000, (9, 4))
    phi = rng.uniform(0.1, 0.6, (9, 4))
    ratios = {
        "volume_fraction": (("time", "x"), phi),
        "particle_density": (("time", "x"), rho / phi),
    }
    got = as_result(rho, **ratios).cg.time_average()
    np.testing.assert_allclose(got.particle_density, rho.sum(axis=0) / phi.sum(axis=0), rtol=1e-12)


def test_missing_sums_and_bad_arguments_are_named():
    names = ["velocity", "friction_coefficient", "inertial_number"]
    f = random_steps(2, first=80, more=0).cg.coarse_grain(names, for_averages=False, **ALL)
    lacking = "velocity needs density; friction_coefficient needs stress; inertial_number needs"
    with pytest.raises(ValueError, match=lacking):
        f.cg.time_average()
    with pytest.raises(ValueError, match="averages ratios through their sums"):
        f.cg.profile("z")
    density = random_steps(2, first=80, more=0).cg.coarse_grain("density", **ALL)
    for call, message in (
        (lambda: density.cg.profile("q"), "the resolved axes"),
        (lambda: density.cg.time_average(window=3), "from 1 to 2"),
        (lambda: density.isel(time=0).cg.time_average(), "dimension 'time'"),
        (lambda: density.assign(mine=density.density).cg.time_average(), "mine needs a rule"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_averages_return_the_fields_that_were_asked_for():
    """The sums that they need are coordinates, and averages are those of a result that names them."""
    ds = random_steps(4, first=80, more=0)
    names = ["velocity", "volume_fraction", "inertial_number"]
    f = ds.cg.coarse_grain(names, **ALL)
    whole = ds.cg.coarse_grain(names, for_averages=True, **ALL)
    assert list(f.data_vars) == names
    for name in names:
        xr.testing.assert_equal(
            f.cg.profile("z")[name].variable, whole.cg.profile("z")[name].variable
        )
    mean = f.cg.time_average()
    assert list(mean.data_vars) == [*names, *(f"{name}_error" for name in names)]
    expected = whole.cg.time_average()
    for name in mean:
        xr.testing.assert_equal(mean[name].variable, expected[name].variable)
    twice = f.cg.profile("z").cg.time_average()
    xr.testing.assert_allclose(
        twice.velocity.variable,
        whole.cg.profile("z").cg.time_average().velocity.variable,
        rtol=1e-14,
    )


@pytest.mark.filterwarnings("ignore:time_average. tangential_force_anisotropy is")
def test_every_field_has_an_averaging_rule():
    """Those of two frames are averaged in test_displacement, and those between phases where phases are."""
    ds = random_steps(2, first=80, more=0)
    ds = ds.assign(
        angular_velocity=ds.velocity * 0.3, moment_of_inertia=ds.mass * 0.1, director=ds.velocity
    )
    rows = {name: registry.FIELDS[name] for name in registry.listed()}
    names = [
        name
        for name, row in rows.items()
        if row.option in ("", "fluid_viscosity") and not row.paired
    ]
    names = [name for name in names if not name.endswith("_error")]  # see test_errors
    f = ds.cg.coarse_grain(names, fluid_viscosity=1e-3, for_averages=True, **ALL)
    assert set(f.cg.time_average()) == {*f, *(f"{n}_error" for n in f)}
    derived = {
        name
        for name, row in rows.items()
        if not row.additive and not row.weight and row.option != "lag"
    }
    assert {name for name in derived if not name.endswith("_error")} <= set(f)


@pytest.mark.parametrize(
    "options", [{}, {"size": "d32"}, {"shear_dims": "xz", "pressure_dims": "z"}]
)
def test_all_missing_sums_are_named_at_once(options):
    """Each field by itself, and what it needs: its averages are those of the result that holds all fields."""
    ds = random_steps(3, first=80, more=0)
    usual = ds.cg.coarse_grain(**ALL, fluid_viscosity=1e-3)
    whole = ds.cg.coarse_grain(**ALL, fluid_viscosity=1e-3, **options)
    average = whole.cg.time_average()
    chosen = registry.options_of(whole.attrs)
    changed = [name for name in whole.data_vars if not whole[name].equals(usual[name])]
    assert bool(changed) == bool(options)
    for name in changed or whole.data_vars:
        needs = needed_for_averages([name], chosen)
        part = whole[[name, *needs]]
        got = part.cg.time_average()[[name, f"{name}_error"]]
        np.testing.assert_allclose(got[name], average[name], rtol=1e-12, atol=1e-15, err_msg=name)
        np.testing.assert_allclose(
            got[f"{name}_error"], average[f"{name}_error"], rtol=1e-6, atol=1e-9, err_msg=name
        )
        for need in needs:
            # an error for a ratio, a warning for a stress
            with pytest.raises((ValueError, xcg.SceneWarning), match=f"(needs|lacks) .*{need}"):
                part.drop_vars(need).cg.time_average()


def test_for_averages_adds_the_needed_sums():
    names = ["velocity", "inertial_number"]
    ds = random_steps(3, first=80, more=0)
    f = ds.cg.coarse_grain(names, for_averages=True, **ALL)
    sums = {
        "density",
        "shear_rate_tensor",
        "pressure",
        "particle_density",
        "volume_fraction",
        "d43",
    }
    assert list(f)[:2] == names
    assert set(f) == {*names, *sums}
    average = f.cg.time_average()
    whole = ds.cg.coarse_grain(**ALL).cg.time_average()
    for name in names:
        np.testing.assert_allclose(average[name], whole[name], rtol=1e-12, err_msg=name)
    assert list(ds.cg.coarse_grain(names, **ALL)) == names


def test_nodes_that_are_empty_at_times():
    ds = xcg.scene_from_arrays(
        [[[0.0, 0, 0]], [[9.0, 0, 0]]], velocity=[[[1.0, 0, 0]], [[3.0, 0, 0]]], diameter=[[1.0], [1.0]], density=1.0,
    )  # fmt: skip
    options = {
        "axes": "x",
        "at": {"y": 0, "z": 0},
        "bounds": {"x": (0, 9)},
        "spacing": 4.5,
        "width": 1.2,
    }
    a = ds.cg.coarse_grain(["density", "velocity", "sample_count"], **options).cg.time_average()
    assert a.velocity.sel(component="x").values[[0, 2]].tolist() == [
        1.0,
        3.0,
    ]  # not halved by the empty step
    assert np.isnan(a.velocity.values[1]).all()
    assert a.sample_count.values.tolist() == [0.5, 0, 0.5]


def test_components_in_any_order_have_the_same_averages():
    f = random_steps(3, first=80, more=0).cg.coarse_grain(
        ["stress", "shear_stress", "shear_rate"], **ALL, shear_dims="xz", for_averages=True
    )
    turned = f.sel(component=["z", "x", "y"], direction=["y", "z", "x"])
    for average in (lambda f: f.cg.time_average(), lambda f: f.cg.profile("z")):
        got = average(turned)
        expected = average(f)
        assert set(got.data_vars) == set(expected.data_vars)
        for name in expected.data_vars:
            labels = {
                dim: list("xyz") for dim in ("component", "direction") if dim in expected[name].dims
            }
            np.testing.assert_allclose(got[name].sel(labels), expected[name], rtol=1e-9, atol=1e-15)


def test_fields_that_need_all_components_are_not_averaged_from_some():
    f = random_steps(3, first=80, more=0).cg.coarse_grain(
        ["velocity", "stress", "shear_stress"], **ALL, for_averages=True
    )
    for part in (f.sel(component="x"), f.sel(component=["x", "y"]), f.sel(direction="z")):
        for average in (lambda f: f.cg.time_average(), lambda f: f.cg.profile("z")):
            with pytest.raises(ValueError, match=r"computes shear_stress anew .* select after it"):
                average(part)
    x = f.sel(component="x").drop_vars(["stress", "shear_stress"]).cg.time_average()
    np.testing.assert_array_equal(x.velocity, f.cg.time_average().velocity.sel(component="x"))


def test_standard_errors_are_not_averaged():
    f = (
        random_steps(3, first=80, more=0)
        .cg.coarse_grain(["velocity", "density"], **ALL)
        .cg.time_average()
    )
    with pytest.raises(
        ValueError,
        match=r"no mean of errors and biases \(velocity_error, density_error\): call it before",
    ):
        f.cg.profile("z")


def test_averages_of_stacked_nodes_do_not_warn():
    f = random_steps(3, first=80, more=0).cg.coarse_grain("density", **ALL)
    stacked = f.stack(node=("x", "y", "z")).cg.time_average()  # warnings are errors in the tests
    xr.testing.assert_identical(
        stacked.density_error.unstack("node"), f.cg.time_average().density_error
    )


def test_averages_of_a_scene_raise():
    with pytest.raises(
        ValueError, match="this is a scene: call time_average on what its coarse_grain returns"
    ):
        xcg.datasets.random_scene(20).cg.time_average()


@pytest.mark.parametrize("unknown", [3, 32])
def test_the_error_is_nan_where_the_mean_is(unknown):
    values = np.random.default_rng(1).normal(size=(33, 4))
    values[unknown, 2] = np.nan
    f = xr.Dataset(
        {"density": (("time", "z"), values)}, {"time": np.arange(33.0), "z": np.arange(4.0)}
    )
    average = f.cg.time_average()
    assert np.isnan(average.density.values).tolist() == [False, False, True, False]
    assert np.isnan(average.density_error.values).tolist() == [False, False, True, False]


def test_averages_add_their_call_to_the_history():
    f = xcg.datasets.simple_cubic(3).cg.coarse_grain("density", width=1.0)
    mean = f.cg.time_average()
    assert mean.attrs["history"].startswith(f.attrs["history"] + "\n")
    assert "time_average(window=None" in mean.attrs["history"]
    assert "profile(axis='z')" in f.cg.profile("z").attrs["history"]


# --- kinetic stress about the averaged velocity ---

OF_MOTION = [
    "kinetic_stress", "density", "velocity", "fluctuating_kinetic_energy", "mean_kinetic_energy",
    "kinetic_energy",
]  # fmt: skip


def moving_grains(steps=8, count=300, *, drift=0.0, shear=1.0, side=8.0, seed=0):
    """Random places and velocities in each step, of two species, with a shear flow."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0, side, (steps, count, 3))
    velocity = rng.normal(size=(steps, count, 3)) + drift
    velocity[..., 0] += shear * position[..., 2]
    species = np.broadcast_to(1 + np.arange(count) % 2, (steps, count))
    return xcg.scene_from_arrays(
        position, velocity=velocity, species=species, diameter=np.ones((steps, count)), density=1.0,
        box=dict.fromkeys("xyz", (0.0, side)), periodic="xyz", time=np.arange(steps) * 0.1,
    )  # fmt: skip


def without_errors(f):
    return f.drop_vars([name for name in f.data_vars if str(name).endswith(("_error", "_bias"))])


@pytest.mark.parametrize("by", [None, "species"])
def test_kinetic_stress_of_an_average_is_about_the_averaged_velocity(by):
    ds = moving_grains()
    f = ds.cg.coarse_grain(OF_MOTION, width=1.0, spacing=0.5, by=by)
    # from sums of m v v Psi
    turned = {"component": "direction"}
    of_bulk = f.isel(phase=0, drop=True) if by else f
    v = f.velocity.fillna(0.0)
    v_of_bulk = of_bulk.velocity
    drift = f.density * (v - v_of_bulk)
    flux = f.kinetic_stress + f.density * v_of_bulk * v_of_bulk.rename(turned)
    flux = flux + drift * v_of_bulk.rename(turned) + v_of_bulk * drift.rename(turned)
    mean_flux = flux.mean("time")
    mean_momentum = (f.density * v).mean("time")
    density = f.density.mean("time")
    u = (of_bulk.density * v_of_bulk).mean("time") / of_bulk.density.mean("time")
    expected = mean_flux - mean_momentum * u.rename(turned) - u * mean_momentum.rename(turned)
    expected = expected + density * u * u.rename(turned)
    average = f.cg.time_average()
    expected = expected.transpose(*average.kinetic_stress.dims)
    np.testing.assert_allclose(average.kinetic_stress, expected, rtol=1e-9, atol=1e-11)
    assert float(np.abs(average.kinetic_stress - f.kinetic_stress.mean("time")).max()) > 0.1
    # the energies still add up
    total = average.mean_kinetic_energy + average.fluctuating_kinetic_energy
    np.testing.assert_allclose(total, average.kinetic_energy, rtol=1e-12)
    if by:
        partial = average.kinetic_stress.isel(phase=[1, 2]).sum("phase")
        np.testing.assert_allclose(partial, average.kinetic_stress.isel(phase=0), atol=1e-12)


@pytest.mark.parametrize("by", [None, "species"])
def test_the_profile_of_a_mesh_is_that_of_the_marginal_and_averages_commute(by):
    ds = moving_grains()
    f = ds.cg.coarse_grain(OF_MOTION, width=1.0, spacing=0.5, by=by)
    marginal = ds.cg.coarse_grain("kinetic_stress", width=1.0, spacing=0.5, by=by, axes="z")
    profile = f.cg.profile("z")
    largest = float(np.abs(marginal.kinetic_stress).max())
    np.testing.assert_allclose(
        profile.kinetic_stress, marginal.kinetic_stress, rtol=0, atol=1e-3 * largest
    )
    one = without_errors(profile.cg.time_average())
    other = without_errors(f.cg.time_average()).cg.profile("z")
    for name in OF_MOTION:
        np.testing.assert_allclose(one[name], other[name], rtol=1e-12, atol=1e-12 * largest)


def test_a_window_of_one_step_is_the_step_and_a_fast_frame_loses_no_digits():
    names = ["kinetic_stress", "density", "velocity"]
    at_rest = moving_grains().cg.coarse_grain(names, width=1.0, spacing=1.0)
    fast = moving_grains(drift=1e6).cg.coarse_grain(names, width=1.0, spacing=1.0)
    windows = at_rest.cg.time_average(window=1)
    np.testing.assert_allclose(windows.kinetic_stress, at_rest.kinetic_stress, rtol=1e-13)
    for call in (
        lambda f: f.cg.time_average(),
        lambda f: f.cg.time_average(window=3),
        lambda f: f.cg.profile("z"),
    ):
        largest = float(np.abs(call(at_rest).kinetic_stress).max())
        np.testing.assert_allclose(
            call(fast).kinetic_stress, call(at_rest).kinetic_stress, rtol=0, atol=1e-6 * largest
        )


def test_errors_of_the_kinetic_stress_are_those_of_averages_without_each_step():
    f = moving_grains(3).cg.coarse_grain(OF_MOTION, width=1.0, spacing=2.0, by="species")
    rest = [f.isel(time=[k for k in range(3) if k != step]) for step in range(3)]
    without = xr.concat([part.cg.time_average().kinetic_stress for part in rest], "left_out")
    error = without.std("left_out") * np.sqrt(2)
    np.testing.assert_allclose(f.cg.time_average().kinetic_stress_error, error, rtol=1e-9)


def test_stress_pressure_and_fields_made_of_them_follow_the_averaged_kinetic_stress():
    scenes = random_steps(6, first=80, more=0)
    ds = scenes.assign(
        velocity=30.0 * scenes.velocity
    )  # a kinetic stress as large as that of contacts
    every = ds.cg.coarse_grain(for_averages=True, **ALL).cg.time_average()
    sigma = every.contact_stress + every.kinetic_stress
    np.testing.assert_allclose(every.stress, sigma, rtol=1e-10, atol=1e-10)
    pressure = sum(sigma.sel(component=a, direction=a) for a in "xyz") / 3
    np.testing.assert_allclose(every.pressure, pressure, rtol=1e-10)
    kinetic = ds.cg.coarse_grain("kinetic_stress", **ALL).kinetic_stress.mean("time")
    assert float(np.abs(kinetic - every.kinetic_stress).max() / sigma.max()) > 0.01
    for name in ("stress", "pressure", "deviatoric_stress", "friction_coefficient"):
        alone = ds.cg.coarse_grain(name, **ALL)
        assert {"density", "velocity"} <= {*alone.coords}
        assert list(alone.data_vars) == [name]
        np.testing.assert_allclose(alone.cg.time_average()[name], every[name], rtol=1e-9, atol=1e-9)
    walls = [xcg.Plane(point=(0, 0, 1.0), normal=(0, 0, 1))]
    options = {**ALL, "bounds": {"z": (1.5, 4.5)}}
    per = ds.cg.coarse_grain(surfaces=walls, per="accessible", **options)
    plain = ds.cg.coarse_grain(surfaces=walls, **options).cg.time_average()
    np.testing.assert_allclose(
        per.cg.time_average().pressure, plain.pressure / plain.accessible_fraction, rtol=1e-9
    )


def test_results_without_density_and_velocity_are_averaged_as_before_and_warn():
    f = moving_grains().cg.coarse_grain(
        "kinetic_stress", width=1.0, spacing=2.0, for_averages=False
    )
    with pytest.warns(
        xcg.SceneWarning, match="lacks density and velocity: leave out for_averages=F"
    ):
        average = f.cg.time_average()
    np.testing.assert_allclose(average.kinetic_stress, f.kinetic_stress.mean("time"), rtol=1e-14)
    f = moving_grains().cg.coarse_grain("kinetic_stress", width=1.0, spacing=2.0, by="species")
    with pytest.warns(xcg.SceneWarning, match="lacks the bulk: choose phases after the average"):
        f.sel(phase="1").cg.profile("z")
    with pytest.warns(xcg.SceneWarning, match="choose components after the average"):
        f.sel(component=["x"], direction=["x"]).cg.profile("z")


def test_the_pressure_of_an_elastic_gas_is_n_t():
    rng = np.random.default_rng(5)
    steps, count, side = 40, 382, 10.0  # volume fraction 0.2
    ds = xcg.scene_from_arrays(
        rng.uniform(0, side, (steps, count, 3)), velocity=rng.normal(size=(steps, count, 3)),
        diameter=np.ones((steps, count)), density=6 / np.pi, box=dict.fromkeys("xyz", (0.0, side)),
        periodic="xyz", time=np.arange(steps) * 1.0,
    )  # fmt: skip
    f = ds.cg.coarse_grain("kinetic_stress", spacing=2.5)  # mass 1, T = 1
    truth = count / side**3

    def pressure(f):
        return sum(f.kinetic_stress.sel(component=a, direction=a) for a in "xyz") / 3

    average = f.cg.time_average()
    of_all = average.pipe(without_errors).cg.profile("x").pipe(pressure).mean()
    assert float(pressure(f).mean()) < 0.6 * truth  # of single steps, at the default width
    degrees = steps * count * 3
    assert abs(float(of_all) / truth - 1) < 3 * np.sqrt(2 / degrees) + 1e-2
    assert abs(float(pressure(average).mean()) / truth - 1) < 0.06  # N_eff of 40 steps: some 60


def test_averaged_fields_close_the_balance_of_momentum():
    rng = np.random.default_rng(3)
    steps, count, side, interval = 64, 40, 6.0, 0.05
    start = rng.uniform(0, side, (count, 3))
    velocity = rng.normal(size=(count, 3))

    def ballistic(times):
        position = (start + np.multiply.outer(times, velocity)) % side
        scene = xcg.scene_from_arrays(
            position, velocity=np.broadcast_to(velocity, position.shape), density=1.0,
            diameter=np.ones(position.shape[:2]), box=dict.fromkeys("xyz", (0.0, side)), periodic="xyz",
            time=times,
        )  # fmt: skip
        return scene.cg.coarse_grain(
            ["density", "velocity", "kinetic_stress", "momentum_density"], axes="z", width=1.0,
            spacing=0.05,
        )  # fmt: skip

    ends = ballistic(np.array([-0.5, steps - 0.5]) * interval)
    rate = np.diff(ends.momentum_density, axis=0)[0] / (steps * interval)
    f = ballistic(np.arange(steps) * interval)
    with pytest.warns(xcg.SceneWarning, match="still grows"):  # grains cross a support in 20 steps
        average = f.cg.time_average()
    of_flow = average.density * average.velocity * average.velocity.sel(component="z")

    def divergence(stress):
        flux = (of_flow + stress.sel(direction="z")).transpose("z", "component").values
        forward = np.roll(flux, -1, axis=0)
        back = np.roll(flux, 1, axis=0)
        return (forward - back) / 0.1

    closed = np.abs(rate + divergence(average.kinetic_stress)).max()
    open_ = np.abs(rate + divergence(f.kinetic_stress.mean("time"))).max()
    assert closed < 0.02 * np.abs(rate).max()
    assert open_ > 20 * closed


def test_the_flux_of_a_phase_in_an_average_is_relative_to_the_averaged_velocity_of_the_bulk():
    names = ["segregation_flux", "momentum_density", "density"]
    f = truths.segregating(4).cg.coarse_grain(names, by="species", axes="z", spacing=2.0)
    of_steps = f.mean("time")
    of_blocks = f.coarsen(z=2).mean()
    for mean, sums in ((f.cg.time_average(), of_steps), (f.cg.coarsen(z=2), of_blocks)):
        velocity = sums.momentum_density / sums.density
        flux = sums.density * (velocity - velocity.sel(phase="bulk", drop=True))
        np.testing.assert_allclose(
            mean.segregation_flux, flux.transpose(*mean.segregation_flux.dims), atol=1e-14
        )


def test_errors_of_the_flux_of_a_phase_are_those_of_averages_without_each_step():
    names = ["segregation_flux", "momentum_density", "density"]
    f = truths.segregating(5).cg.coarse_grain(names, by="species", axes="z", spacing=2.0)
    fluxes = []
    for t in range(5):
        sums = f.isel(time=[k for k in range(5) if k != t]).mean("time")
        velocity = sums.momentum_density / sums.density
        fluxes.append(sums.density * (velocity - velocity.sel(phase="bulk", drop=True)))
    error = xr.concat(fluxes, "step").std("step") * 2
    mean = f.cg.time_average()
    np.testing.assert_allclose(
        mean.segregation_flux_error, error.transpose(*mean.segregation_flux.dims), atol=1e-14
    )


def test_the_flux_of_segregating_phases_is_true_in_averages_and_said_to_be_small_in_a_step():
    ds = truths.segregating()
    options = {"by": "species", "spacing": 3.0}
    with pytest.warns(xcg.SceneWarning, match="segregation_flux lacks about 5. % of it"):
        f = ds.cg.coarse_grain("segregation_flux", **options)
    flux = f.segregation_flux.sel(phase="2", component="z")
    true = truths.of_segregating()["2"]["flux"]
    assert float(flux.mean()) < 0.8 * true
    mean = f.cg.time_average()
    assert float(mean.segregation_flux.sel(phase="2", component="z").mean()) == pytest.approx(
        true, rel=0.08
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ds.cg.coarse_grain("segregation_flux", by="species", axes="z")


def test_fluxes_and_powers_say_that_their_averages_are_means_of_steps():
    ds = moving_grains(2)
    f = ds.cg.coarse_grain(["kinetic_heat_flux", "kinetic_stress"], width=1.0, spacing=2.0)
    assert f.kinetic_heat_flux.attrs["averages"].startswith("means of the values of steps")
    assert f.kinetic_stress.attrs["averages"].startswith("about the averaged velocity")
    average = f.cg.time_average()
    np.testing.assert_allclose(average.kinetic_heat_flux, f.kinetic_heat_flux.mean("time"))


# --- blocks of nodes ---


@pytest.mark.parametrize("lazy", [False, True])
def test_blocks_of_nodes_keep_mass_and_hold_ratios_of_sums(lazy):
    ds = moving_grains(2)
    names = ["density", "velocity", "kinetic_stress", "momentum_flux", "granular_temperature"]
    scene = ds.chunk(time=1) if lazy else ds
    f = scene.cg.coarse_grain(names, width=1.0, spacing=1.0, for_averages=True)
    blocks = f.cg.coarsen(x=4, z=2)
    assert (blocks.velocity.chunks is not None) == lazy
    assert (blocks.sizes["x"], blocks.sizes["y"], blocks.sizes["z"]) == (2, 8, 4)
    np.testing.assert_array_equal(blocks.x, [1.5, 5.5])
    assert blocks.x.attrs == f.x.attrs
    total = blocks.density.sum(["x", "y", "z"]) * 8
    np.testing.assert_allclose(total, f.density.sum(["x", "y", "z"]), rtol=1e-14)
    # one block by hand, and as a profile
    part = f.isel(x=slice(4), z=slice(2, 4))
    u = (part.density * part.velocity).mean(["x", "z"]) / part.density.mean(["x", "z"])
    block = blocks.isel(x=0, z=1)
    np.testing.assert_allclose(block.velocity, u, rtol=1e-12)
    profile = part.cg.profile("y")
    for name in names:
        np.testing.assert_allclose(block[name], profile[name], rtol=1e-10, atol=1e-12)
    # and so the flux of momentum is that of the mean flow and the stress
    flow = blocks.density * blocks.velocity * blocks.velocity.rename(component="direction")
    expected = (flow + blocks.kinetic_stress).transpose(*blocks.momentum_flux.dims)
    np.testing.assert_allclose(blocks.momentum_flux, expected, rtol=1e-10, atol=1e-12)
    whole = f.cg.coarsen(x=8, y=8, z=8)
    np.testing.assert_allclose(
        whole.kinetic_stress.squeeze(), blocks.cg.coarsen(x=2, y=8, z=4).kinetic_stress.squeeze()
    )
    assert "coarsen(x=4, z=2)" in blocks.attrs["history"]


def test_blocks_that_do_not_fit_raise():
    f = moving_grains(1).cg.coarse_grain("velocity", width=1.0, spacing=1.0)
    with pytest.raises(ValueError, match=r"8 nodes along 'x' are 2 more .* f.isel\(x=slice\(6\)\)"):
        f.cg.coarsen(x=3)
    with pytest.raises(ValueError, match=r"coarsen\(r=2\): blocks are along x, y, z here"):
        f.cg.coarsen(r=2)
    with pytest.raises(ValueError, match="x=9: expected a whole number from 1 to 8"):
        f.cg.coarsen(x=9)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("coarsen", {"x": 2}),
        ("profile", {"axis": "z"}),
        ("time_average", {}),
        ("free_surface", {}),
        ("spatial_correlation", {"field": "velocity"}),
        ("fit_law", {}),
    ],
)
def test_a_scene_in_place_of_fields_is_named(name, arguments):
    with pytest.raises(ValueError, match=f"{name} takes fields, and this is a scene.*coarse_grain"):
        getattr(moving_grains(3).cg, name)(**arguments)


# --- bias ------------------------------------------------------------------------------------------------


def test_bias_of_kinetic_stress_is_that_of_a_variance():
    """With grains that stay in place, velocities of n steps leave 1 / n of their variance out."""
    steps = 16
    ds = ensembles.ensemble(41, shear=0.0, draws=steps)
    f = ds.cg.coarse_grain("kinetic_stress", axes="z", width=2.0)
    mean = f.cg.time_average()
    u = f.velocity - f.velocity.mean("time")
    rho = f.density.isel(time=0, drop=True)
    expected = -rho * (u * u.rename(component="direction")).sum("time") / (steps - 1) / steps
    np.testing.assert_allclose(
        mean.kinetic_stress_bias, expected.transpose(*mean.kinetic_stress_bias.dims), rtol=1e-9
    )


@pytest.mark.parametrize(
    ("name", "largest"),
    [
        ("contact_anisotropy", 0.03),
        ("normal_force_anisotropy", 0.03),
        ("friction_coefficient", 0.01),
    ],
)
def test_values_without_their_bias_are_true_and_errors_hold_two_thirds(anisotropic, name, largest):
    """Contacts of known tensors: 30 independent averages of 16 steps at each node."""
    deviation = anisotropic[name] - truths.known_contacts()[name]
    left = deviation - anisotropic[f"{name}_bias"]
    assert float(deviation.mean()) > 0.01
    assert abs(float(left.mean())) < min(largest, 0.4 * float(deviation.mean()))
    within = np.abs(left) < anisotropic[f"{name}_error"]
    assert float(within.mean()) == pytest.approx(0.68, abs=0.1)


@pytest.fixture(scope="module")
def anisotropic():
    ds = truths.contacts(480, 300, 6.0)
    names = [name for name in truths.known_contacts() if not name.endswith("_angle")]
    f = ds.cg.coarse_grain(names, axes="z", width=1.0, spacing=2.0, for_averages=True)
    return f.cg.time_average(16, every=16)


def test_the_square_of_a_norm_without_its_bias_is_that_of_the_mean_less_its_variance():
    """Exactly, however large the noise; 0 where the variance is the larger."""
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(9, 200, 5)) + np.linspace(0, 1, 200)[:, None]
    samples = xr.Dataset({"v": (("sample", "node", "k"), vectors)})
    blocks = jackknife(
        samples,
        "sample",
        lambda mean: xr.Dataset({"norm": (mean.v**2).sum("k") ** 0.5}),
        norms=["norm"],
    )
    square = (vectors.mean(axis=0) ** 2).sum(axis=-1)
    variance = vectors.var(axis=0, ddof=1).sum(axis=-1) / 9
    left = np.sqrt(square) - blocks.biases.norm
    assert 20 < np.count_nonzero(square < variance) < 100
    np.testing.assert_allclose(left**2, np.maximum(square - variance, 0.0), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("lazy", [False, True])
def test_norms_that_are_more_noise_than_truth_warn_of_both_values(lazy):
    ds = truths.contacts(16, 300, 6.0)
    names = ["contact_anisotropy", "friction_coefficient"]
    f = ds.cg.coarse_grain(names, spacing=2.0, for_averages=True)
    if lazy:
        f = f.chunk(x=1)
    with pytest.warns(xcg.SceneWarning) as caught:
        mean = f.cg.time_average().compute()
    texts = [str(warning.message) for warning in caught]
    for name in names:
        (text,) = [text for text in texts if text.startswith(f"time_average: {name} is ")]
        left = mean[name] - mean[f"{name}_bias"]
        assert f"is {float(mean[name].mean()):.2g} in the mean of the nodes, " in text
        assert f"{float(left.mean()):.2g} without its bias" in text
        noisy = left**2 < mean[name] ** 2 / 2
        assert f"at {100 * float(noisy.mean()):.0f} % of the nodes" in text


def test_norms_of_more_grains_are_silent():
    f = truths.contacts(16, 300, 6.0).cg.coarse_grain("contact_anisotropy", axes="z", width=1.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        f.cg.time_average()


def test_small_norms_are_silent():
    """mu of a gas is all noise, but little."""
    f = truths.gas(64, side=6.0).cg.coarse_grain("friction_coefficient", axes="z", width=1.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mean = f.cg.time_average()
    left = mean.friction_coefficient - mean.friction_coefficient_bias
    assert float((left**2 < mean.friction_coefficient**2 / 2).mean()) > 0.5


def test_bias_of_shear_rate_inertial_number_and_pressure_of_a_sheared_gas():
    ds = truths.gas(160, side=6.0, rate=0.5)
    names = ["shear_rate", "inertial_number", "pressure"]
    f = ds.cg.coarse_grain(names, axes="z", width=1.0, spacing=2.0)
    whole = f.cg.time_average()
    parts = f.cg.time_average(8, every=8)
    for name in names:
        excess = (parts[name] - (whole[name] - whole[f"{name}_bias"])).mean()
        error = parts[name].std() / parts[name].size ** 0.5
        assert abs(float(excess - parts[f"{name}_bias"].mean())) < 2.5 * float(error), name


def test_bias_takes_eight_blocks_and_fields_that_are_not_linear():
    f = truths.gas(8, side=6.0, rate=0.5).cg.coarse_grain(
        ["velocity", "density", "shear_rate", "pressure"], axes="z", width=1.0
    )
    mean = f.cg.time_average()
    assert {n for n in mean if n.endswith("_bias")} == {"shear_rate_bias", "pressure_bias"}
    assert mean.shear_rate_bias.notnull().all()
    assert mean.shear_rate_bias.attrs["units"] == f.shear_rate.attrs["units"]
    few = f.isel(time=slice(7)).cg.time_average()
    assert [n for n in few if n.endswith("_bias")] == []
    assert few.shear_rate_error.notnull().all()
    with pytest.raises(ValueError, match="no mean of errors and biases"):
        mean.cg.profile("z")


def test_bias_of_repeated_steps_is_that_of_the_steps():
    """Blocks are as long as for the error: frames that were written four times are no further samples."""
    steps = truths.gas(64, side=6.0, rate=0.5)
    f = steps.cg.coarse_grain(["shear_rate"], axes="z", width=1.0)
    again = f.isel(time=np.repeat(np.arange(64), 4)).assign_coords(time=np.arange(256.0))
    once = f.cg.time_average().shear_rate_bias.mean()
    assert float(again.cg.time_average().shear_rate_bias.mean()) == pytest.approx(
        float(once), rel=0.3
    )


def test_attributes_say_how_a_field_is_averaged():
    """Of xarray's mean of the values they warn, as that of a norm of few grains is too large."""
    names = ["density", "velocity", "friction_coefficient", "heat_flux"]
    f = random_steps(2, first=80, more=0).cg.coarse_grain(names, axes="z", for_averages=True)
    said = {name: f[name].attrs.get("averages", "") for name in names}
    assert said["density"] == ""
    assert said["velocity"].startswith("weighted by density (f.cg.time_average()")
    assert said["friction_coefficient"].startswith("computed anew from averaged sums")
    assert said["heat_flux"].startswith("means of the values of steps")
    assert f.cg.time_average().velocity.attrs["averages"] == said["velocity"]


# --- runs as samples -------------------------------------------------------------------------------------


of_random_forces = pytest.mark.filterwarnings("ignore:time_average. friction_coefficient is 0.0")


def runs(count, fields=("density", "velocity", "stress", "friction_coefficient"), **options):
    """Return results of runs that differ by their random numbers."""
    options = {"width": 1.0, "axes": "z", "bounds": {"z": (0.0, 4.0)}, "spacing": 1.0} | options
    results = []
    for k in range(count):
        scenes = [xcg.datasets.random_scene(200, seed=2 * k + step) for step in (0, 1)]
        steps = [ds.cg.coarse_grain([*fields], **options) for ds in scenes]
        results.append(xr.concat([f.assign_coords(time=[t]) for t, f in enumerate(steps)], "time"))
    return results


@of_random_forces
def test_runs_are_independent_samples_of_ratios_of_averaged_sums():
    parts = runs(10)
    mean = xr.concat(parts, "run").cg.time_average(dim="run")
    assert "run" not in mean.dims
    assert mean.sizes["time"] == 2
    density = np.stack([f.density for f in parts])
    np.testing.assert_allclose(mean.density, density.mean(axis=0), rtol=1e-12)
    scatter = density.std(axis=0, ddof=1) / np.sqrt(len(parts))
    np.testing.assert_allclose(mean.density_error, scatter, rtol=1e-9)
    momentum = sum(f.density * f.velocity for f in parts)
    expected = momentum / sum(f.density for f in parts)
    np.testing.assert_allclose(mean.velocity.transpose(*expected.dims), expected, rtol=1e-12)
    assert {"friction_coefficient_bias", "friction_coefficient_error"} <= {*mean.data_vars}
    assert mean.attrs["averaged_runs"] == 10
    assert "share_with_drift" not in mean.density_error.attrs


def test_a_drift_from_run_to_run_is_scatter():
    """Runs are in no order: with the drift of a series, a time average would warn."""
    f = xr.concat(runs(32, ("density",)), "run")
    f = f.assign(density=f.density * (1 + 10 * xr.DataArray(np.arange(32.0), dims="run")))
    mean = f.cg.time_average(dim="run")
    scatter = f.density.std("run", ddof=1) / np.sqrt(32)
    np.testing.assert_allclose(mean.density_error, scatter, rtol=1e-9)


@of_random_forces
def test_averages_over_time_are_samples_without_their_own_errors():
    parts = [f.cg.time_average() for f in runs(4)]
    mean = xr.concat(parts, "run").cg.time_average(dim="run")
    steps = [f.assign_coords(time=f.time + 2 * k) for k, f in enumerate(runs(4))]
    both = xr.concat(steps, "time").cg.time_average()
    for name in ("density", "velocity", "stress", "friction_coefficient"):
        np.testing.assert_allclose(mean[name], both[name], rtol=1e-10)
    density = np.stack([f.density for f in parts])
    np.testing.assert_allclose(mean.density_error, density.std(axis=0, ddof=1) / 2, rtol=1e-9)


def test_runs_on_other_meshes_and_of_other_options_are_refused_by_name():
    a, b = runs(2, ("density",))
    short, long = (runs(1, ("density",), bounds={"z": (0.0, high)})[0] for high in (2.0, 3.0))
    with pytest.raises(ValueError, match=r"the results differ in z, .*like=first"):
        xr.concat([short, long], "run", join="outer").cg.time_average(dim="run")
    lazy = xr.concat([short.chunk(time=1), long.chunk(time=1)], "run", join="outer")
    with raise_if_dask_computes():
        mean = lazy.cg.time_average(dim="run")
    with pytest.raises(ValueError, match=r"the results differ in z, .*like=first"):
        mean.density.compute()
    later = b.assign_coords(time=b.time + 100)
    with pytest.raises(ValueError, match="the results differ in time,"):
        xr.concat([a, later], "run", join="outer").cg.time_average(dim="run")
    wider = runs(1, ("density",), width=1.5)[0]
    with pytest.raises(xcg.SceneError, match=r"width is 1\.0 and 1\.5"):
        xr.concat([a, wider], "run").cg.time_average(dim="run")
    for wrong in ("run", "z", "component"):
        with pytest.raises(ValueError, match="join the results of runs along a dimension"):
            a.cg.time_average(dim=wrong)
    with pytest.raises(ValueError, match="a window is of steps"):
        xr.concat([a, b], "run").cg.time_average(2, dim="run")


@of_random_forces
def test_lazy_runs_are_averaged_to_the_same_bits():
    f = xr.concat(runs(9), "run")
    lazy = f.chunk()
    with raise_if_dask_computes():
        mean = lazy.cg.time_average(dim="run")
    xr.testing.assert_identical(
        mean.compute().drop_attrs(), f.cg.time_average(dim="run").drop_attrs()
    )


def test_differences_of_lazy_steps_without_the_sums_beside_them_stay_lazy():
    ds = truths.gas(2)
    ds = ds.chunk(time=1).assign_coords(step=ds.step)  # in memory, as of files
    f = ds.cg.coarse_grain("stress", axes="z")
    alone = ds.cg.coarse_grain("stress", axes="z", for_averages=False).stress
    stress = f.stress.drop_vars(["density", "velocity"])
    with raise_if_dask_computes():
        differences = [one.isel(time=0) - one.isel(time=1) for one in (stress, alone)]
    for difference in differences:
        np.testing.assert_array_equal(difference, f.stress[0].data - f.stress[1].data)
