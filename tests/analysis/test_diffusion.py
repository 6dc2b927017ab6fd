"""Mean squared displacement and self-diffusion: brute force, random walks, grains that come and go."""

import re
import warnings

import numpy as np
import pytest
import xarray as xr

import xcg

# of few grains in small boxes, for which more than one in a hundred moves by a quarter
pytestmark = pytest.mark.filterwarnings("ignore:.*particles move by up to 0.2")

# walks with steps of 0.3 and 0.6 in boxes of 6 to 8


def walks(steps=8, count=30, edge=4.0, seed=0, **options):
    """Random walks in a periodic box, wrapped, and without the edges."""
    kicks = 0.3 * np.random.default_rng(seed).normal(size=(steps, count, 3)) * [1.0, 1.0, 2.0]
    way = kicks.cumsum(axis=0)
    given = {"diameter": np.ones((steps, count)), "density": 1.0, "time": 0.25 * np.arange(steps)}
    return xcg.scene_from_arrays(
        list(way % edge), box=[[0, edge]] * 3, periodic="xyz", **(given | options)
    ), way


def same(found, expected, **options):
    np.testing.assert_allclose(found, expected, **({"rtol": 1e-11, "atol": 1e-13} | options))


@pytest.mark.parametrize("remove_drift", [True, False])
def test_displacements_equal_brute_force(remove_drift):
    species = np.tile(np.arange(30) % 3 + 1, (8, 1))
    ds, way = walks(species=species)
    if remove_drift:
        way = way - way.mean(axis=1, keepdims=True)
    m = ds.cg.mean_squared_displacement([1, 3, 5], by="species", remove_drift=remove_drift)
    assert m.phase.values.tolist() == ["bulk", "1", "2", "3"]
    same(m.lag, [0.25, 0.75, 1.25])
    for k, lag in enumerate((1, 3, 5)):
        u = way[lag:] - way[:-lag]
        for phase, chosen in (("bulk", species[0] > 0), *((n, species[0] == n) for n in (1, 2, 3))):
            products = np.einsum("tna,tnb->ab", u[:, chosen], u[:, chosen])
            count = (8 - lag) * chosen.sum()
            same(m.displacement_products.sel(phase=phase)[k], products / count)
            same(m.mean_squared_displacement.sel(phase=phase)[k], np.trace(products) / count)
            assert int(m.pair_count.sel(phase=phase)[k]) == count
    assert (m.mean_squared_displacement_error > 0).all()


def test_a_random_walk_diffuses():
    steps, count = 400, 60
    ds, _ = walks(steps, count, edge=8.0, seed=3)
    m = ds.cg.mean_squared_displacement(8, fit=(0.25, 2.0))
    # sigma^2 / (2 dt) along each axis, less the share of the mean that is taken off
    truth = 0.3**2 * np.array([1.0, 1.0, 4.0]) / (2 * 0.25) * (1 - 1 / count)
    lag = m.lag.values[:, None, None]
    away = (m.displacement_products - 2 * np.diag(truth) * lag) / m.displacement_products_error
    assert float(abs(away).max()) < 4.5
    away = (m.self_diffusion - np.diag(truth)) / m.self_diffusion_error
    assert float(abs(away).max()) < 4.0
    assert abs(float(m.diffusion_coefficient) - truth.mean()) < 4 * float(
        m.diffusion_coefficient_error
    )
    assert float(m.diffusion_coefficient_error) < 0.05 * truth.mean()
    assert m.self_diffusion.attrs["units"] == "m^2 s^-1"


@pytest.mark.slow  # test_widths and test_averages on errors of means
def test_errors_equal_those_of_repeated_walks():
    runs = [
        walks(80, 20, edge=8.0, seed=seed)[0].cg.mean_squared_displacement([1, 4], fit=(0.25, 1.0))
        for seed in range(40)
    ]
    many = xr.concat(runs, "run")
    for name in ("mean_squared_displacement", "diffusion_coefficient"):
        ratio = many[f"{name}_error"].mean("run") / many[name].std("run", ddof=1)
        assert float(ratio.min()) > 0.6, name
        assert float(ratio.max()) < 1.5, name


@pytest.mark.filterwarnings("ignore:.*particles move by up to 0.48")
def test_grains_that_come_back_count_as_new():
    ds, way = walks(6, 12)
    here = np.ones((6, 12), bool)
    here[2, :3] = here[0, 5] = here[5, 7] = False
    rng = np.random.default_rng(1)
    order = [rng.permutation(np.flatnonzero(row)) for row in here]
    ds = xcg.scene_from_arrays(
        [way[t][o] % 4.0 for t, o in enumerate(order)], particle_id=order, diameter=[np.ones(len(o)) for o in order],
        density=1.0, box=[[0, 4.0]] * 3, periodic="xyz", time=0.25 * np.arange(6),
    )  # fmt: skip
    m = ds.cg.mean_squared_displacement(3, remove_drift=False)
    for k, lag in enumerate((1, 2, 3)):
        products, count = 0.0, 0
        for t in range(6 - lag):
            stays = here[t : t + lag + 1].all(axis=0)
            products += ((way[t + lag] - way[t])[stays] ** 2).sum()
            count += stays.sum()
        assert int(m.pair_count[k]) == count
        same(m.mean_squared_displacement[k], products / count)


def test_deformation_of_the_box_is_no_diffusion():
    share = np.random.default_rng(2).uniform(0, 1, (50, 3))
    edges = np.array([[4.0 + 0.2 * t, 4.0, 4.0 - 0.1 * t] for t in range(5)])
    box = np.stack([np.zeros_like(edges), edges], axis=-1)
    ds = xcg.scene_from_arrays(
        [share * edge for edge in edges], diameter=np.ones((5, 50)), density=1.0, box=box, periodic="xyz",
        time=np.arange(5.0),
    )  # fmt: skip
    same(ds.cg.mean_squared_displacement(2).mean_squared_displacement, 0.0, atol=1e-28)


def test_layers_frozen_grains_and_lazy_scenes():
    rng = np.random.default_rng(3)
    way = np.cumsum(rng.normal(size=(5, 20, 3)) * [0.1, 0.0, 0.1], axis=0)
    frozen = np.zeros((5, 20), int)
    frozen[:, :4] = 1
    ds = xcg.scene_from_arrays(
        list(way), diameter=np.ones((5, 20)), density=1.0, frozen=frozen, dimension=2, plane="xz", thickness=1.0,
        time=np.arange(5.0),
    )  # fmt: skip
    m = ds.cg.mean_squared_displacement([2], remove_drift=False, fit=None)
    same(m.mean_squared_displacement, [((way[2:] - way[:-2])[:, 4:] ** 2).sum(axis=-1).mean()])
    lazy = ds.chunk(time=1).cg.mean_squared_displacement([2], remove_drift=False)
    xr.testing.assert_identical(lazy.drop_attrs(), m.drop_attrs())


@pytest.mark.parametrize(
    ("change", "options", "error", "message"),
    [
        (lambda ds: ds, {"lags": 8}, ValueError, "lags=8: expected numbers of steps from 1 to 7"),
        (lambda ds: ds, {"lags": [0, 1]}, ValueError, "lags=[0, 1]"),
        (lambda ds: ds, {"lags": [1.5]}, ValueError, "lags=[1.5]"),
        (lambda ds: ds.isel(time=0), {}, ValueError, "needs two steps or more, and the scene has 1"),
        (lambda ds: ds, {"lags": 3, "fit": (0.5, 1, 2)}, ValueError, "fit=(0.5, 1, 2): expected a range"),
        (lambda ds: ds, {"lags": 3, "fit": "ab"}, ValueError, "fit='ab': expected a range"),
        (lambda ds: ds, {"lags": 3, "fit": (0.25, 0.3)}, ValueError, "fit=(0.25, 0.3): expected a range"),
        (lambda ds: ds.isel(time=[0, 1, 3]), {}, xcg.SceneError, "times at equal distances"),
        (lambda ds: ds.isel(time=[1, 0]), {}, xcg.SceneError, "times at equal distances"),
        (lambda ds: ds, {"by": "phase"}, ValueError, "by='phase'"),
        (
            lambda ds: ds.assign(particle_id=ds.particle_id + 100 * xr.DataArray(np.arange(8) // 2, dims="time")), {},
            xcg.SceneError, "step 1 and step 2 have no particle id in common",
        ),
    ],
)  # fmt: skip
def test_wrong_input_raises(change, options, error, message):
    with pytest.raises(error, match=re.escape(message)):
        change(walks()[0]).cg.mean_squared_displacement(**options)


@pytest.mark.parametrize(("jump", "fires"), [(0.1, False), (0.3, True), (0.45, True)])
def test_grains_that_may_have_crossed_half_a_period_are_named(jump, fires):
    """The same check for velocities, displacements and their mean square."""
    place = np.random.default_rng(0).uniform(0, 1, (30, 3))
    moved = place + np.array([jump, 0.0, 0.0])
    ds = xcg.scene_from_arrays(
        [place, moved % 1.0], diameter=np.full((2, 30), 0.1), density=1.0, time=[0.0, 1.0],
        box=[[0, 1]] * 3, periodic="xyz",
    )  # fmt: skip
    calls = {
        "velocities": lambda: ds.cg.derive("velocity"),
        "displacements": lambda: ds.cg.displacement("displacement", axes="", width=0.3),
        "mean square": lambda: ds.cg.mean_squared_displacement([1]),
    }
    for name, call in calls.items():
        if not fires:
            call()
            continue
        results = "velocities" if name == "velocities" else "displacements"
        with pytest.warns(
            xcg.SceneWarning, match=rf"by up to {jump:.2f} .* along 'x' .*; {results} of"
        ):
            call()
    followed = ds.assign(image=ds.position.astype(int) * 0)
    followed.cg.mean_squared_displacement([1])


@pytest.mark.parametrize(("grains", "large", "speaks"), [(200, 2, False), (200, 3, True)])
def test_few_steps_of_a_walk_may_be_longer_than_a_quarter_of_the_period(grains, large, speaks):
    """Tails of a walk reach a quarter, and are not wrapped before the half."""
    step = np.full((grains, 3), 0.1)
    step[:large, 0] = 0.27
    start = np.random.default_rng(1).uniform(0, 1, (grains, 3))
    ds = xcg.scene_from_arrays(
        np.stack([start, (start + step) % 1]), time=[0.0, 1.0], diameter=np.full(grains, 0.01),
        density=1.0, box=[[0, 1.0]] * 3, periodic="xyz", particle_id=np.arange(grains),
    )  # fmt: skip
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        ds.cg.derive("velocity").velocity.compute()
    said = [str(w.message) for w in warned if "of the period along" in str(w.message)]
    assert [f"{large} of {grains} by more than a quarter" in text for text in said] == [
        True
    ] * speaks


def test_velocity_autocorrelation_of_langevin_grains_decays_by_its_friction():
    """v' = a v + sqrt(1 - a^2) xi: <v v(k)> = D a^k of unit variances."""
    rng = np.random.default_rng(5)
    a, steps, grains = 0.8, 65, 2000
    v = np.empty((steps, grains, 3))
    v[0] = rng.normal(size=(grains, 3))
    for t in range(1, steps):
        v[t] = a * v[t - 1] + (1 - a**2) ** 0.5 * rng.normal(size=(grains, 3))
    r = v.cumsum(axis=0)
    ds = xcg.scene_from_arrays(
        list(r), velocity=v, diameter=np.ones((steps, grains)), time=0.5 * np.arange(steps)
    )
    c = ds.cg.velocity_autocorrelation([1, 2, 4])
    np.testing.assert_array_equal(c.lag, [0, 0.5, 1.0, 2.0])
    expected = 3 * a ** np.array([0, 1, 2, 4])
    apart = c.velocity_autocorrelation - expected
    assert (abs(apart) < 4 * c.velocity_autocorrelation_error + 3 / grains).all()
    np.testing.assert_allclose(c.normalised_autocorrelation, expected / 3, atol=0.02)
    assert c.pair_count.values.tolist() == [grains * (steps - k) for k in (0, 1, 2, 4)]


def test_velocity_autocorrelation_follows_grains_by_their_ids():
    """In other rows at each step; one leaves, and another enters."""
    v = {1: [1.0, 0, 0], 2: [0, 2.0, 0], 3: [0, 0, 3.0], 0: [5.0, 0, 0]}
    ids = [[1, 2, 3], [0, 3, 2], [3, 2]]
    ds = xcg.scene_from_arrays(
        [np.eye(3)[: len(rows)] for rows in ids],
        velocity=[np.array([v[row] for row in rows]) for rows in ids],
        particle_id=ids,
        diameter=[np.full(len(rows), 0.1) for rows in ids],
        time=[0.0, 1.0, 2.0],
    )
    c = ds.cg.velocity_autocorrelation([1, 2], remove_drift=False)
    # lag 0: squares 1 + 4 + 9, 25 + 9 + 4 and 9 + 4, of 8 grains; then 4 + 9 of two grains
    np.testing.assert_allclose(c.velocity_autocorrelation, [65 / 8, 6.5, 6.5])
    assert c.pair_count.values.tolist() == [8, 4, 2]
    with pytest.raises(xcg.SceneError, match="velocity"):
        ds.drop_vars("velocity").cg.velocity_autocorrelation()
