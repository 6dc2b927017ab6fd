"""Correlations in space and time: brute force, and closed forms of waves, noise and smeared points."""

import itertools
import re

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ROOT
from xcg.analysis.correlations import falls_to


def result(values, wrapped, spacing=0.5, names=("x", "y", "z"), tail=()):
    """A result of one field `a` (time, nodes, ...)."""
    values = np.asarray(values, float)
    axes = names[: values.ndim - 1 - len(tail)]
    coords = {
        a: (a, spacing * np.arange(n), {"units": "m"})
        for a, n in zip(axes, values.shape[1:], strict=False)
    }
    coords["time"] = ("time", 0.1 * np.arange(len(values)), {"units": "s"})
    return xr.Dataset({"a": (("time", *axes, *tail), values)}, coords, {"wrapped_axes": wrapped})


def direct(a, b, wraps):
    """Correlation at all lags from double loops over the nodes of all steps (time, nodes, components)."""
    shape = a.shape[1:-1]
    known = [np.isfinite(x).all(axis=-1) for x in (a, b)]
    away = [
        np.where(
            k[..., None],
            x
            - np.stack([x[t][k[t]].mean(axis=0) for t in range(len(x))])[
                (slice(None), *[None] * len(shape))
            ],
            0.0,
        )
        for x, k in zip((a, b), known, strict=True)
    ]
    scale = np.sqrt(np.prod([(x**2).sum() / k.sum() for x, k in zip(away, known, strict=True)]))
    products = {}
    pairs = {}
    for t, p, q in itertools.product(range(len(a)), np.ndindex(shape), np.ndindex(shape)):
        if known[0][(t, *p)] and known[1][(t, *q)]:
            lag = tuple(
                (j - i + n // 2) % n - n // 2 if w else j - i
                for i, j, n, w in zip(p, q, shape, wraps, strict=True)
            )
            products[lag] = products.get(lag, 0.0) + away[0][(t, *p)] @ away[1][(t, *q)]
            pairs[lag] = pairs.get(lag, 0) + 1
    return {lag: products[lag] / pairs[lag] / scale for lag in pairs}, {
        lag: n / len(a) for lag, n in pairs.items()
    }


@pytest.mark.parametrize(
    ("shape", "wrapped", "components"),
    [
        ((7,), "", 1),
        ((6,), "x", 1),
        ((5, 4), "y", 1),
        ((4, 5), "xy", 3),
        ((3, 4, 3), "xz", 1),
        ((3, 3, 2), "", 9),
    ],
)
def test_correlations_equal_brute_force(shape, wrapped, components):
    rng = np.random.default_rng(0)
    tail = {1: (), 3: ("component",), 9: ("component", "direction")}[components]
    values = rng.normal(size=(3, *shape, *(3,) * len(tail))) + 5.0
    values[rng.uniform(size=(3, *shape)) < 0.2] = np.nan
    other = rng.normal(size=values.shape) - 3.0 * values
    f = result(values, wrapped, tail=tail)
    f["b"] = f.a.copy(data=other)
    wraps = [axis in wrapped for axis in "xyz"[: len(shape)]]
    flat = [x.reshape(3, *shape, components) for x in (values, other)]
    for name, second in (("a", flat[0]), ("b", flat[1])):
        c = xcg.spatial_correlation(f, "a", name)
        expected, pairs = direct(flat[0], second, wraps)
        shells = {}
        longest = max(abs(i) for lag in pairs for i in lag)
        for place in np.ndindex(c.correlation.shape):
            found = c.correlation[place]
            lag = tuple(round(float(found[f"lag_{axis}"]) / 0.5) for axis in "xyz"[: len(shape)])
            np.testing.assert_allclose(found, expected.get(lag, np.nan), rtol=0, atol=1e-12)
            assert float(c.pairs[place]) == pytest.approx(pairs.get(lag, 0.0), abs=1e-12)
            length = float(np.linalg.norm(lag))
            if lag in pairs and length <= longest:
                shells.setdefault(round(length), []).append((pairs[lag], expected[lag]))
        assert set(c.correlation.dims) == {f"lag_{axis}" for axis in "xyz"[: len(shape)]}
        for r, found in zip(c.r, c.radial_correlation, strict=True):
            weights, values_ = np.array(shells[round(float(r) / 0.5)]).T
            np.testing.assert_allclose(found, weights @ values_ / weights.sum(), rtol=0, atol=1e-12)


def test_a_wave_is_a_cosine():
    x = np.arange(24) * 0.5
    k = 2 * np.pi * 3 / 12.0
    c = result([np.cos(k * x + 0.3), 2 * np.cos(k * x)], "x").cg.spatial_correlation("a")
    np.testing.assert_allclose(c.correlation, np.cos(k * c.lag_x), atol=1e-14)
    np.testing.assert_allclose(c.correlation_error, 0.0, atol=1e-7)
    fall = np.interp(-np.exp(-1), -np.cos(k * np.array([0.5, 1.0])), [0.5, 1.0])
    np.testing.assert_allclose(c.correlation_length, fall, rtol=1e-12)


@pytest.mark.parametrize("axes", ["x", "y", "xy"])
def test_reversed_axes_have_the_same_correlations(axes):
    f = result(np.random.default_rng(5).normal(size=(4, 8, 6)), "x")
    backwards = f.isel(dict.fromkeys(axes, slice(None, None, -1)))
    xr.testing.assert_allclose(
        backwards.cg.spatial_correlation("a").drop_attrs(),
        f.cg.spatial_correlation("a").drop_attrs(),
    )
    late = backwards.isel(time=slice(None, None, -1)).cg.time_correlation("a").sortby(["x", "y"])
    xr.testing.assert_allclose(late.drop_attrs(), f.cg.time_correlation("a").drop_attrs())


def test_white_noise_is_a_spike_within_its_errors():
    values = np.random.default_rng(1).normal(size=(64, 16, 16))
    c = result(values, "xy").cg.spatial_correlation("a")
    rest = c.where((abs(c.lag_x) + abs(c.lag_y)) > 0)
    assert float(c.correlation.sel(lag_x=0, lag_y=0)) == pytest.approx(1.0, abs=1e-14)
    share = (rest.correlation + 1 / 255) / rest.correlation_error
    # the mean of the nodes takes one of 256 numbers
    assert 0.9 < float(share.std()) < 1.3
    assert abs(float(share.mean())) < 0.1


def test_smeared_points_have_the_correlation_of_the_kernel():
    rng = np.random.default_rng(2)
    steps, edge, width = 160, 8.0, 1.0
    r = rng.uniform(0, edge, (steps, 100, 3))
    ds = xcg.scene_from_arrays(
        list(r),
        diameter=np.ones((steps, 100)),
        density=1.0,
        box=[[0, edge]] * 3,
        periodic="xyz",
        time=np.arange(steps) * 1.0,
    )
    f = ds.cg.coarse_grain("number_density", axes="x", width=width, spacing=0.25)
    c = f.cg.spatial_correlation("number_density")

    def marginal(x):
        cut = 2 * width
        if abs(x) >= cut:
            return 0.0
        q = np.linspace(0, np.sqrt(cut**2 - x**2), 2001)
        s = np.sqrt(q**2 + x**2) / cut
        return np.trapezoid(2 * np.pi * q * (1 + 3 * s) * (1 - s) ** 3, q)

    table = np.array([marginal(x) for x in f.x.values - edge / 2])
    spectrum = np.abs(np.fft.fft(table)) ** 2
    spectrum[0] = 0.0  # the mean is taken off
    expected = np.fft.fftshift(np.fft.ifft(spectrum).real)
    expected /= expected.max()
    away = (c.correlation - expected) / c.correlation_error.where(c.lag_x != 0)
    assert float(abs(away).max()) < 4.5
    assert float(c.correlation_error.max()) < 0.1
    assert c.correlation.attrs == {
        "units": "1",
        "long_name": "correlation of number_density with number_density",
    }
    fall = falls_to(expected[16:], c.lag_x.values[16:])
    assert abs(c.correlation_length - fall) < 4 * c.correlation_length_error


def test_falls_to_interpolates_where_values_fall_below_a_level():
    at = np.array([0.0, 1.0, 2.0, 3.0])
    values = np.array(
        [[1.0, 0.6, 0.2, 0.1], [1.0, 0.9, 0.8, 0.7], [0.1, 0.9, 0.1, 0.0], [1.0, np.nan, 0.1, 0.0]]
    )
    np.testing.assert_allclose(falls_to(values, at, 0.4), [1.5, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(
        falls_to(values, at**2, 0.3), [1.0 + 3.0 * 0.75, np.nan, np.nan, np.nan]
    )


# --- in time ---------------------------------------------------------------------------------------------


def test_time_correlation_by_brute_force():
    rng = np.random.default_rng(3)
    values = rng.normal(size=(9, 4, 2, 3)).cumsum(axis=0)
    values[rng.uniform(size=(9, 4, 2)) < 0.2] = np.nan
    c = result(values, "", tail=("component",)).cg.time_correlation("a", 5)
    assert c.correlation.dims == ("lag", "x", "y")
    np.testing.assert_allclose(c.lag, 0.1 * np.arange(6))
    away = values - np.nanmean(values, axis=0)
    total = np.zeros(6)
    count = np.zeros(6)
    for node in np.ndindex(4, 2):
        a = away[(slice(None), *node)]
        at_node = []
        for lag in range(6):
            products = [a[t] @ a[t + lag] for t in range(9 - lag)]
            total[lag] += np.nansum(products)
            count[lag] += np.isfinite(products).sum()
            at_node.append(np.nanmean(products))
        found = c.correlation[(slice(None), *node)]
        np.testing.assert_allclose(found, np.array(at_node) / at_node[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        c.mean_correlation, total / count / (total[0] / count[0]), rtol=0, atol=1e-12
    )


def test_errors_cover_a_process_that_forgets_by_a_share_each_step():
    rng = np.random.default_rng(4)
    steps, keep = 2048, 0.8
    values = np.zeros((steps, 6))
    noise = rng.normal(size=(steps + 100, 6))
    state = noise[0]
    for t, kick in enumerate(noise):
        state = keep * state + np.sqrt(1 - keep**2) * kick
        if t >= 100:
            values[t - 100] = state
    f = result(values, "")
    c = f.cg.time_correlation("a", 12)
    away = (c.mean_correlation - keep ** np.arange(13)) / c.mean_correlation_error.where(c.lag > 0)
    assert float(abs(away).max()) < 3.5
    assert 0.005 < float(c.mean_correlation_error[1:].mean()) < 0.05
    assert float(c.mean_correlation_error[0]) == pytest.approx(0.0, abs=1e-12)
    forgets = falls_to(keep ** np.arange(13), 0.1 * np.arange(13))
    assert abs(float(c.correlation_time) - forgets) < 3.5 * float(c.correlation_time_error)


# --- results of scenes -----------------------------------------------------------------------------------


def moving(steps=5):
    rng = np.random.default_rng(5)
    r = [rng.uniform(0, 5, (150, 3))]
    for _ in range(steps - 1):
        r.append(r[-1] + 0.2 * rng.normal(size=(150, 3)))
    return xcg.scene_from_arrays(
        r, diameter=np.ones((steps, 150)), velocity=[rng.normal(size=(150, 3)) for _ in r], density=1.0,
        species=np.tile(np.arange(150) % 2 + 1, (steps, 1)), box=[[0, 5]] * 3, periodic="xy",
        time=np.arange(steps) * 0.5,
    )  # fmt: skip


@pytest.mark.parametrize("chunk", [1, 2])
def test_lazy_correlations_equal_eager_ones(chunk):
    options = {
        "fields": ["velocity", "volume_fraction"],
        "axes": "xz",
        "by": "species",
        "spacing": 0.5,
    }
    eager = moving().cg.coarse_grain(width=0.75, bounds={"z": (1.0, 3.0)}, **options)
    lazy = (
        moving().chunk(time=chunk).cg.coarse_grain(width=0.75, bounds={"z": (1.0, 3.0)}, **options)
    )
    assert eager.attrs["wrapped_axes"] == "x"
    for one, other in (
        (lazy.cg.spatial_correlation("velocity"), eager.cg.spatial_correlation("velocity")),
        (lazy.cg.time_correlation("velocity"), eager.cg.time_correlation("velocity")),
    ):
        assert all(a.chunks is not None for a in one.data_vars.values())
        assert "phase" in one.coords
        xr.testing.assert_allclose(one.compute(), other, rtol=1e-12, atol=1e-12)


def test_correlations_wrap_around_periodic_axes_only():
    ds = moving()
    assert ds.cg.coarse_grain("density").attrs["wrapped_axes"] == "xy"
    bounded = ds.cg.coarse_grain("density", axes="xy", bounds={"x": (0.0, 4.0)}, extent={"z": 5.0})
    assert bounded.attrs["wrapped_axes"] == "y"
    ds["box"] = ds.box * xr.DataArray([1.0, 1.0, 1.0, 1.0, 1.1], dims="time")
    assert ds.cg.coarse_grain("density").attrs["wrapped_axes"] == ""


def test_correlations_of_a_part_of_a_period_end_at_its_edges():
    x = np.random.default_rng(0).uniform(0, 10, (4000, 3))
    ds = xcg.scene_from_arrays(x, velocity=x * [1, 0, 0], diameter=np.full(4000, 0.3), density=1.0, box=[[0, 10]] * 3,
                               periodic="xyz")  # fmt: skip
    f = ds.cg.coarse_grain("velocity", axes="x", width=0.5, spacing=0.25)
    assert f.x.attrs["period"] == 10.0
    part = f.sel(x=slice(2, 8))
    found, ends = (
        g.cg.spatial_correlation("velocity") for g in (part, part.assign_attrs(wrapped_axes=""))
    )
    xr.testing.assert_identical(found, ends)
    assert found.sizes["lag_x"] == 2 * part.sizes["x"] - 1
    assert f.cg.spatial_correlation("velocity").sizes["lag_x"] == f.sizes["x"]
    assert (
        f.isel(x=slice(None, None, 2)).cg.spatial_correlation("velocity").sizes["lag_x"]
        == f.sizes["x"] // 2
    )


@pytest.mark.parametrize(
    ("method", "change", "options", "error", "message"),
    [
        ("spatial_correlation", None, {"field": "b"}, ValueError, "spatial_correlation('b'): no such field"),
        ("spatial_correlation", lambda f: f.isel(x=0), {"field": "a"}, ValueError, "needs resolved axes of two nodes"),
        ("spatial_correlation", lambda f: f.isel(x=[0, 1, 3]), {"field": "a"}, xcg.SceneError, "nodes along 'x' at"),
        (
            "spatial_correlation", lambda f: f.assign(v=f.a.expand_dims(component=3)), {"field": "a", "other": "v"},
            ValueError, "'a' has the dimensions",
        ),
        ("time_correlation", None, {"field": "b"}, ValueError, "time_correlation('b'): no such field"),
        ("time_correlation", lambda f: f.isel(time=[0, 1]), {"field": "a"}, ValueError, "three steps or more"),
        ("time_correlation", lambda f: f.isel(time=[0, 1, 3]), {"field": "a"}, xcg.SceneError, "times at equal"),
        ("time_correlation", None, {"field": "a", "max_lag": 4}, ValueError, "max_lag=4: expected a whole number"),
        ("time_correlation", None, {"field": "a", "max_lag": 0}, ValueError, "max_lag=0"),
    ],
)  # fmt: skip
def test_wrong_input_raises(method, change, options, error, message):
    f = result(np.random.default_rng(6).normal(size=(4, 5)), "x")
    with pytest.raises(error, match=re.escape(message)):
        getattr(xcg, method)(f if change is None else change(f), **options)


def test_constant_fields_have_no_correlation():
    f = result(np.ones((4, 5)), "x")
    assert np.isnan(f.cg.spatial_correlation("a").correlation).all()
    assert np.isnan(f.cg.time_correlation("a").mean_correlation).all()


def test_the_page_on_correlations_runs(monkeypatch):
    monkeypatch.chdir(ROOT)
    names = {}
    for block in re.findall(
        r"```python\n(.*?)```", (ROOT / "docs" / "displacement.md").read_text(), re.DOTALL
    ):
        exec(compile(block, "displacement.md", "exec"), names)
    c, k, m = (names[n] for n in "ckm")
    assert 0.5 < c.correlation_length < 5
    # velocities forget 0.2 of themselves a step: 1 / ln(1 / 0.8) s, and D = 0.01^2 / (2 * 0.2^2)
    assert abs(k.correlation_time - 4.48) < 4 * k.correlation_time_error
    assert abs(m.diffusion_coefficient - 0.00125 * 299 / 300) < 4 * m.diffusion_coefficient_error
    slope = m.mean_squared_displacement.differentiate("lag")
    assert slope[0] < 0.5 * slope[-1]


def test_durations_as_times_raise():
    ds = (
        xcg.datasets.random_scene(30)
        .isel(time=[0, 0, 0, 0])
        .assign_coords(time=np.arange(4).astype("m8[ns]"))
    )
    f = ds.cg.coarse_grain("density", axes="z")
    for call in (
        lambda: f.cg.time_correlation("density"),
        lambda: ds.cg.mean_squared_displacement(lags=[1]),
    ):
        with pytest.raises(
            xcg.SceneError, match=r"times as numbers \(s\), and these are timedelta64"
        ):
            call()
