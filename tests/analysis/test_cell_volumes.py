"""Volumes of cells against integrals."""

import math
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


def test_cells_of_a_periodic_axis_begin_at_its_edge():
    ds = xcg.datasets.simple_cubic(4)
    low, high = (ds.attrs[f"box_{end}"][2] for end in ("lower", "upper"))
    z = ds.cg.cell_volumes((high - low) / 8, axes="z").z.values
    np.testing.assert_allclose(z, low + (np.arange(8) + 0.5) * (high - low) / 8, rtol=1e-12)


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
