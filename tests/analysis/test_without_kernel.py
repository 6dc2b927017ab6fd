"""Volumes of cells against integrals, temperatures of slices against loops over grains in plain Python."""

import math
import warnings
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import quad

import xcg


def chord_area(a, b):
    """Area of the unit disc with x > a and y > b, by integration over y."""
    low = max(b, -1.0)
    if low >= 1.0:
        return 0.0
    ends = sorted({low, 1.0, *(s * math.sqrt(1 - a * a) for s in (-1, 1) if abs(a) < 1)})
    ends = [y for y in ends if low <= y <= 1.0]

    def chord(y):
        half = math.sqrt(max(0.0, 1 - y * y))
        return max(0.0, half - max(a, -half))

    def smooth(t, p, q):  # the square root at the ends becomes smooth
        return chord((p + q) / 2 + (q - p) / 2 * math.sin(math.pi / 2 * t)) * math.cos(
            math.pi / 2 * t
        )

    return sum(
        math.pi / 4 * (q - p) * quad(smooth, -1, 1, (p, q), epsabs=1e-13)[0]
        for p, q in pairwise(ends)
    )


def test_areas_by_quadrature():
    rng = np.random.default_rng(1)
    for a, b in [
        *rng.uniform(-1.1, 1.1, (40, 2)),
        (0, 0),
        (-1, 0.5),
        (0.6, 0.8),
        (1, -1),
        (1e-9, -1e-9),
    ]:
        assert _disc(a, b) == pytest.approx(chord_area(a, b), abs=1e-9)


def _disc(a, b):
    """Area of the unit disc beyond two lines, from the cells of a scene with one disc."""
    return math.pi * share_of([(a, 3.0), (b, 3.0)], discs=True)


def share_of(box, *, discs=False):
    """Share of one grain of radius 1 in one cell with given ends along each axis."""
    centre = {x: sum(ends) / 2 for x, ends in zip("xyz", box, strict=False)}
    size = {x: ends[1] - ends[0] for x, ends in zip("xyz", box, strict=False)}
    more = {"dimension": 2, "thickness": 0.5, "shape": "disc"} if discs else {}
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0]], velocity=[[1.0, 2, 3]], diameter=[2.0], density=1.0, **more
    )
    f = ds.cg.cell_volumes(size, bounds={x: (c, c) for x, c in centre.items()})
    cell = math.prod(size.values()) * (0.5 if discs else 1.0)
    return f.number_density.item() * cell


def ball_volume(a, b, c):
    low = max(c, -1.0)
    if low >= 1.0:
        return 0.0
    squares = (a * a, b * b, a * a + b * b)
    ends = sorted({low, 1.0, *(s * math.sqrt(1 - t) for t in squares for s in (-1, 1) if t < 1)})
    ends = [z for z in ends if low <= z <= 1.0]

    def smooth(t, p, q):
        z = (p + q) / 2 + (q - p) / 2 * math.sin(math.pi / 2 * t)
        r = math.sqrt(max(0.0, 1 - z * z))
        return (r * r * chord_area(a / r, b / r) if r > 0 else 0.0) * math.cos(math.pi / 2 * t)

    return sum(
        math.pi / 4 * (q - p) * quad(smooth, -1, 1, (p, q), epsabs=1e-11)[0]
        for p, q in pairwise(ends)
    )


@pytest.mark.parametrize(
    "corner",
    [(0.1, 0.2, 0.3), (-0.4, 0.2, 0.7), (-0.3, -0.2, -0.6), (0.0, 0.0, 0.0), (0.5, -1.0, 0.2)],
)
def test_volumes_by_quadrature(corner):
    share = share_of([(end, 3.0) for end in corner])
    assert share * 4 * math.pi / 3 == pytest.approx(ball_volume(*corner), abs=1e-9)


def random_scene(count=300, spread=2.0, periodic="xyz", seed=4, steps=1):
    rng = np.random.default_rng(seed)
    diameter = rng.uniform(1 / spread, spread, count)
    return xcg.scene_from_arrays(
        rng.uniform(0, 6, (steps, count, 3)), velocity=rng.normal(size=(steps, count, 3)),
        diameter=np.broadcast_to(diameter, (steps, count)), density=3.0,
        species=np.broadcast_to(1 + (diameter > 1), (steps, count)), box=dict.fromkeys("xyz", (0.0, 6.0)),
        periodic=periodic,
    )  # fmt: skip


@pytest.mark.parametrize("periodic", ["xyz", "", "x"])
@pytest.mark.parametrize("spacing", [0.13, 1.0, 2.5, 6.0, {"x": 0.4, "y": 1.2, "z": 3.0}])
def test_cell_sums_are_the_totals_of_the_grains(periodic, spacing):
    ds = random_scene(40 if spacing == 0.13 else 300, periodic=periodic)
    f = ds.cg.cell_volumes(spacing)
    assert "sampling" not in f.attrs  # nothing else is sampled in this way
    step = [
        float(f[a][1] - f[a][0]) if f.sizes[a] > 1 else (6.0 if a in periodic else None)
        for a in "xyz"
    ]
    if None in step:
        step = [spacing if not isinstance(spacing, dict) else spacing[a] for a in "xyz"]
    cell = math.prod(step)
    for name, total in (
        ("volume_fraction", ds.volume),
        ("density", ds.mass),
        ("number_density", ds.mass * 0 + 1),
    ):
        assert float(f[name].sum()) * cell == pytest.approx(float(total.sum()), rel=1e-12)
    momentum = (ds.mass * ds.velocity).sum("particle").values[0]
    np.testing.assert_allclose(
        f.momentum_density.sum(["x", "y", "z"]).values[0] * cell, momentum, atol=1e-10
    )
    assert float(f.volume_fraction.min()) >= 0.0
    xr.testing.assert_allclose(f.void_fraction.drop_attrs(), (1 - f.volume_fraction).drop_attrs())


def test_faces_that_touch_and_cells_within_a_grain():
    assert share_of([(1.0, 3.0), (-1.0, 1.0), (-1.0, 1.0)]) == 0.0
    assert share_of([(-1.0, 1.0)] * 3) == pytest.approx(1.0, rel=1e-15)
    inside = share_of([(-0.1, 0.1), (0.2, 0.3), (-0.2, 0.0)])
    assert inside * 4 * math.pi / 3 == pytest.approx(0.2 * 0.1 * 0.2, rel=1e-12)
    assert share_of([(0.0, 3.0), (-3.0, 3.0), (-3.0, 3.0)]) == pytest.approx(0.5, rel=1e-15)


def test_axes_that_are_not_divided_reach_through_the_box():
    ds = random_scene(periodic="xyz")
    whole = ds.cg.cell_volumes(1.0)
    f = ds.cg.cell_volumes(1.0, axes="xz")
    assert f.volume_fraction.dims == ("time", "x", "z")
    np.testing.assert_allclose(f.volume_fraction, whole.volume_fraction.mean("y"), rtol=1e-12)


def test_a_layer_of_spheres_and_of_discs():
    rng = np.random.default_rng(2)
    position = rng.uniform(1, 5, (30, 3)) * [1, 1, 0]
    diameter = rng.uniform(0.5, 1.5, 30)
    for shape in ("sphere", "disc"):
        ds = xcg.scene_from_arrays(position, velocity=np.ones((30, 3)), diameter=diameter, density=1.0, dimension=2,
                                   thickness=2.0, shape=shape)  # fmt: skip
        f = ds.cg.cell_volumes(0.5)
        assert float(f.volume_fraction.sum()) * 0.25 * 2.0 == pytest.approx(
            float(ds.volume.sum()), rel=1e-13
        )


def test_phases_add_up_and_velocity_is_a_mean():
    f = random_scene().cg.cell_volumes(1.5, by="species")
    np.testing.assert_allclose(
        f.density.sel(phase=["1", "2"]).sum("phase"), f.density.sel(phase="bulk"), rtol=1e-13
    )
    np.testing.assert_allclose(f.velocity * f.density, f.momentum_density, rtol=1e-12, atol=1e-13)


def test_lazy_results_equal_eager_ones():
    ds = random_scene(steps=3)
    eager = ds.cg.cell_volumes(1.0)
    lazy = ds.chunk(time=1).cg.cell_volumes(1.0)
    assert lazy.density.chunks is not None
    xr.testing.assert_identical(lazy.compute().drop_attrs(), eager.drop_attrs())


@pytest.mark.parametrize(("options", "message"), [
    ({"spacing": -1.0}, "positive distance"), ({"spacing": 1.0, "axes": "q"}, "axes names"),
    ({"spacing": 1.0, "by": "none"}, "by='none'"),
])  # fmt: skip
def test_wrong_arguments_raise(options, message):
    with pytest.raises(ValueError, match=message):
        random_scene().cg.cell_volumes(**options)


def test_void_fractions_need_no_velocities():
    ds = xcg.datasets.simple_cubic(4)
    still = ds.drop_vars("velocity").cg.cell_volumes(2.0)
    np.testing.assert_array_equal(still.void_fraction, ds.cg.cell_volumes(2.0).void_fraction)
    assert not {"velocity", "momentum_density"} & set(still)


# --- slices ----------------------------------------------------------------------------------------------


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
