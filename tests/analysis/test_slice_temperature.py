"""Temperatures of slices against loops over grains in plain Python."""

import warnings

import numpy as np
import pytest
import xarray as xr

import xcg


def grains(ds):
    return (ds[n].values[0] for n in ("position", "velocity", "diameter", "mass"))


def test_temperatures_in_bins_equal_a_loop_over_grains():
    ds = xcg.datasets.random_scene(200, periodic="", seed=1)
    s = xcg.slice_temperature(ds, "z", method="bins", width=1.0, bounds=(0.0, 5.0)).isel(time=0)
    np.testing.assert_allclose(s.z, [0.5, 1.5, 2.5, 3.5, 4.5])
    x, v, _, m = grains(ds)
    for k in range(5):
        here = (x[:, 2] >= k) & (x[:, 2] < k + 1)
        mean = sum(mi * vi for mi, vi in zip(m[here], v[here], strict=True)) / m[here].sum()
        energy = sum(mi * ((vi - mean) ** 2).sum() for mi, vi in zip(m[here], v[here], strict=True))
        assert s.granular_temperature[k].item() == pytest.approx(energy / (3 * m[here].sum()))
        np.testing.assert_allclose(s.velocity[k], mean)
        assert s.sample_count[k].item() == here.sum()


@pytest.mark.parametrize("periodic", ["", "z"])
def test_temperatures_in_planes_equal_a_loop_over_grains(periodic):
    ds = xcg.datasets.random_scene(150, periodic=periodic, seed=2)
    n, width = 3, 0.8
    s = xcg.slice_temperature(ds, "z", width=width, spacing=1.2, bounds=(0.0, 5.0), planes=n).isel(
        time=0
    )
    np.testing.assert_allclose(s.z, [0.0, 1.2, 2.4, 3.6, 4.8])
    x, v, d, _ = grains(ds)
    for k, centre in enumerate(s.z.values):
        top = bottom = 0.0
        for m in range(-n, n + 1):
            plane = centre + m * width / (2 * n)
            share = 1 - abs(m) / (n + 1)
            h = x[:, 2] - plane
            if periodic:
                h -= 5.0 * np.rint(h / 5.0)
            area = [np.pi * max((di / 2) ** 2 - hi**2, 0.0) for di, hi in zip(d, h, strict=True)]
            if np.count_nonzero(area) < 2:
                continue
            mean = sum(a * vi for a, vi in zip(area, v, strict=True)) / sum(area)
            top += share * sum(a * ((vi - mean) ** 2).sum() for a, vi in zip(area, v, strict=True))
            bottom += share * sum(area)
        assert s.granular_temperature[k].item() == pytest.approx(top / (3 * bottom), rel=1e-9)


@pytest.mark.parametrize("method", ["planes", "bins"])
def test_slices_of_a_gas_a_layer_a_lazy_scene_and_nothing(method):
    ds = xcg.datasets.random_scene(4000, seed=3, polydispersity=1.0)
    s = ds.cg.slice_temperature("y", method=method)
    assert float(s.granular_temperature.mean()) == pytest.approx(1.0, rel=0.05)
    # a uniform velocity on top changes nothing; a gradient within the slice adds its own part
    fast = ds.assign(velocity=ds.velocity + 1e3).cg.slice_temperature("y", method=method)
    np.testing.assert_allclose(fast.granular_temperature, s.granular_temperature, rtol=1e-9)
    xr.testing.assert_allclose(
        ds.chunk(time=1).cg.slice_temperature("y", method=method).compute(), s
    )
    bounded = ds.assign_attrs(periodic="xz")  # along a period no slice is empty
    empty = bounded.cg.slice_temperature("y", method=method, bounds=(50.0, 51.0), width=0.5)
    assert np.isnan(empty.granular_temperature).all()
    assert (empty.sample_count == 0).all()


def test_wrong_slices_raise():
    ds = xcg.datasets.random_scene(20)
    for options, message in (
        ({"method": "kernel"}, "'planes'"),
        ({"axis": "q"}, "one of the scene's axes"),
        ({"width": -1.0}, "positive length"),
        ({"spacing": 0.0}, "positive length"),
        ({"spacing": 0.5, "method": "bins"}, "spacing=0.5: bins touch"),
        ({"bounds": (1.0, 0.0)}, "expected \\(first, last\\) with first <= last"),
        ({"bounds": 1.0}, "expected \\(first, last\\) with first <= last"),
        ({"bounds": ("a", "b")}, "expected \\(first, last\\) with first <= last"),
        ({"axis": 1}, "one of the scene's axes"),
        ({"spacing": [1.0]}, "positive length"),
        ({"planes": 1.5}, "planes=1.5: expected a whole number"),
        ({"planes": 10**30}, "planes are more than"),
        ({"width": 1e-300}, "planes are more than"),
        ({"width": 1e-300, "method": "bins"}, "1 planes are more than"),
    ):
        with pytest.raises(ValueError, match=message):
            xcg.slice_temperature(ds, **options)


@pytest.mark.parametrize("method", ["planes", "bins"])
def test_integers_beyond_64_bits_are_taken_as_floats(method):
    ds = xcg.datasets.random_scene(20)
    wide = xcg.slice_temperature(ds, width=2**64 - 1, bounds=(0, 2**64), method=method)
    as_float = xcg.slice_temperature(ds, width=2.0**64, bounds=(0.0, 2.0**64), method=method)
    xr.testing.assert_equal(wide, as_float)


@pytest.mark.parametrize("method", ["planes", "bins"])
@pytest.mark.parametrize("tilt", [0.0, 1.3])
def test_slices_wider_than_the_period_count_each_grain_once(method, tilt):
    place = np.random.default_rng(1).uniform(0, 4, (20, 3))
    ds = xcg.scene_from_arrays(
        place, velocity=place, diameter=np.full(20, 0.5), density=1.0, box=[[0, 4]] * 3, periodic="xyz",
        lattice={"xz": tilt},
    )  # fmt: skip
    s = xcg.slice_temperature(ds, "z", method=method, width=8.0, bounds=(0.0, 8.0), planes=40)
    assert (s.sample_count == 20).all()


@pytest.mark.parametrize("call", [
    lambda ds: ds.cg.slice_temperature("x", method="bins", width=1.0),
    lambda ds: ds.cg.slice_temperature("x", width=1.0),
    lambda ds: ds.cg.cell_volumes(0.5),
    lambda ds: ds.cg.coarse_grain("density", width=0.5),
    lambda ds: ds.cg.wall_stress(xcg.Plane((0, 0, 0), (0, 0, 1)), 0.5),
    lambda ds: ds.cg.wall_stress(xcg.Cylinder((0, 0, 0), (1, 0, 0), 0.5), 1.0),
], ids=["bins", "planes", "cells", "kernel", "plane", "cylinder"])  # fmt: skip
def test_a_flow_that_is_wider_between_the_first_and_the_last_step_warns(call):
    x = np.array([[1.0, 2, 3], [1, 5, 9], [1, 2, 3]])
    place = np.stack([x, 0 * x, 0 * x], axis=-1)
    ds = xcg.scene_from_arrays(
        place, velocity=place, diameter=np.ones(3), density=1.0, time=np.arange(3.0), box=[[0, 10], [-5, 5], [-5, 5]],
        contact_i=np.tile(np.arange(3), (3, 1)), contact_j=np.full((3, 3), -2),
        contact_force=np.ones((3, 3, 3)), contact_point=place - [0, 0, 0.4],
    )  # fmt: skip
    first = ds.assign_attrs(
        particle_lower=place[0].min(axis=0), particle_upper=place[0].max(axis=0)
    )
    with pytest.warns(xcg.SceneWarning, match="to 9, and some are not or only partly on the mesh"):
        call(first)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        call(first.cg.measure())
        call(first.isel(time=[0, 2]))


@pytest.mark.parametrize("method", ["planes", "bins"])
def test_frozen_grains_are_in_no_slice(method):
    ds = xcg.datasets.random_scene(300)
    frozen = (ds.particle_id % 3 == 0).astype("int64").assign_attrs(ds.particle_id.attrs)
    options = {"method": method, "width": 1.0, "bounds": (0.0, 5.0)}
    s = ds.assign(frozen=frozen).cg.slice_temperature("z", **options)
    xr.testing.assert_equal(
        s, ds.where(frozen == 0, drop=True).cg.slice_temperature("z", **options)
    )


def test_slices_need_a_box_along_their_axis_alone():
    r = np.random.default_rng(0)
    ds = xcg.scene_from_arrays(
        r.uniform(0, 5, (300, 3)),
        diameter=np.full(300, 0.5),
        velocity=r.normal(size=(300, 3)),
        density=1.0,
        box={"z": (0, 5)},
        periodic="z",
    )
    f = ds.cg.slice_temperature("z", method="bins", width=1.0)
    g = ds.assign_attrs(periodic="xz").cg.slice_temperature("z", method="bins", width=1.0)
    for name in f:
        np.testing.assert_array_equal(f[name], g[name])
