"""The accessible fraction: closed forms and brute force; fields per accessible volume."""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy.stats.qmc import Sobol

import xcg
from tests.analysis.test_wall_stress import box_surface
from xcg.fields import accessible
from xcg.fields.accessible import LEAST, fraction_at

UP = np.array([0.0, 0.0, 1.0])
FLOOR = xcg.Plane((0, 0, 0), (0, 0, 1))
SIDE = xcg.Cylinder((0, 0, 0), (0, 0, 1), 2.5)
PIPE = xcg.Cylinder((0, 0, 0), (0.2, 0, 1), 1.0, inside=False)
TILTED = xcg.Plane((0, 0, 0), (1, 0, 0.2))
WALLS = {
    "corner": [FLOOR, TILTED],
    "cylinder": [SIDE],
    "silo": [SIDE, FLOOR],
    "around a pipe": [PIPE],
    "triangles": [box_surface()],
    "triangles and a pipe": [box_surface(), PIPE],
}
KERNELS = [
    xcg.Lucy(0.75, dimension=3),
    xcg.Gaussian(0.5, dimension=3),
    xcg.Heaviside(1.5, dimension=3),
]


def by_points(places, walls, kernel):
    """Sum of the kernel over many points on the accessible side."""
    radius, cosine, turn = Sobol(3, seed=1).random_base2(15).T
    radius = kernel.cutoff * np.cbrt(radius)
    cosine = 2 * cosine - 1
    turn = 2 * np.pi * turn
    sine = np.sqrt(1 - cosine**2)
    away = radius[:, None] * np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
    weight = kernel.value(radius) / kernel.value(radius).sum()
    return np.array(
        [weight @ np.all([wall.distance(r + away) > 0 for wall in walls], axis=0) for r in places]
    )


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda k: k.name)
@pytest.mark.parametrize("name", WALLS)
def test_the_accessible_fraction_near_walls_equals_brute_force(name, kernel):
    rng = np.random.default_rng(0)
    places = rng.uniform(-3, 3, (2000, 3))
    nearest = np.min([wall.distance(places) for wall in WALLS[name]], axis=0)
    places = places[np.abs(nearest) < kernel.cutoff][:30]
    error = fraction_at(places, WALLS[name], kernel) - by_points(places, WALLS[name], kernel)
    assert np.sqrt((error**2).mean()) < 1.5e-3  # that of brute force with it
    assert np.abs(error).max() < 5e-3 + 1e-3


def test_the_accessible_fraction_beside_a_plane_is_a_polynomial():
    """The marginal of Lucy's kernel along one axis, integrated by hand."""
    c = 1.5
    x = np.linspace(-1.6, 1.6, 41)
    q = np.minimum(np.abs(x) / c, 1)
    # int_q^1 2 pi s (1 - 6 s^2 + 8 s^3 - 3 s^4) ds, integrated from 0 to q
    half = 105 / 8 * (q / 10 - q**3 / 6 + 3 * q**5 / 10 - 8 * q**6 / 30 + q**7 / 14)
    points = np.stack([x, x, x], axis=1)
    np.testing.assert_allclose(
        fraction_at(points, [FLOOR], KERNELS[0]), 0.5 + np.sign(x) * half, atol=1e-14
    )
    np.testing.assert_array_equal(
        fraction_at(np.array([[0, 0, 9.0], [0, 0, -9.0]]), [FLOOR, SIDE], KERNELS[0]), [1, 0]
    )
    right = fraction_at(np.zeros((1, 3)), [FLOOR, xcg.Plane((0, 0, 0), (1, 0, 0))], KERNELS[0])
    np.testing.assert_allclose(right, 0.25, atol=2e-3)


@pytest.fixture(scope="module")
def packed() -> xr.Dataset:
    """A crystal between two walls, as full near them as far from them."""
    x = np.arange(10) + 0.5
    place = np.stack([a.ravel() for a in np.meshgrid(x, x, x)], axis=1)
    rng = np.random.default_rng(3)
    return xcg.scene_from_arrays(
        [place, place[::2]], velocity=[rng.normal(size=place.shape), rng.normal(size=place[::2].shape)],
        diameter=[np.ones(1000), np.ones(500)], density=2.0, box=[[0, 10]] * 3, periodic="xy",
    )  # fmt: skip


BETWEEN = [FLOOR, xcg.Plane((0, 0, 10), (0, 0, -1))]
NAMES = [
    "density",
    "velocity",
    "kinetic_stress",
    "pressure",
    "shear_stress",
    "friction_coefficient",
    "sample_count",
]


def test_density_per_accessible_volume_is_constant_up_to_the_wall(packed):
    given = {"width": 1.5, "axes": "z", "bounds": {"z": (0, 10)}, "spacing": 0.25}
    f = packed.isel(time=[0]).cg.coarse_grain(
        "density", surfaces=BETWEEN, per="accessible", **given
    )
    plain = packed.isel(time=[0]).cg.coarse_grain("density", **given)
    mean = 2.0 * np.pi / 6
    np.testing.assert_allclose(f.density, mean, rtol=0.03)
    assert float(plain.density.min()) < 0.52 * mean
    np.testing.assert_allclose(f.density * f.accessible_fraction, plain.density, rtol=1e-12)
    np.testing.assert_allclose(f.accessible_fraction[0, 0], 0.5, atol=1e-12)
    assert f.attrs["per"] == "accessible"


def test_sums_are_divided_ratios_stay_and_the_rest_follows():
    scene = xcg.datasets.random_scene(400, seed=1, edge=10.0, periodic="xy")
    moved = scene.assign(velocity=2 * scene.velocity).assign_coords(time=[1.0])
    packed = xr.concat([scene, moved], "time", data_vars="all")
    given = {"fields": NAMES, "width": 1.0, "spacing": 1.0, "axes": "xz", "bounds": {"z": (-3, 13)}}
    given["pressure_dims"] = "z"
    plain = packed.cg.coarse_grain(surfaces=BETWEEN, **given)
    f = packed.cg.coarse_grain(surfaces=BETWEEN, per="accessible", **given)
    assert list(f.data_vars) == [*NAMES, "accessible_fraction"]
    known = plain.accessible_fraction >= LEAST
    assert 0 < float(known.mean()) < 1
    for name in ("density", "kinetic_stress", "pressure", "shear_stress"):
        expected = (plain[name] / plain.accessible_fraction).where(known).transpose(*f[name].dims)
        np.testing.assert_allclose(f[name], expected, rtol=1e-12)
        assert f[name].attrs == plain[name].attrs
    np.testing.assert_array_equal(f.velocity, plain.velocity.where(known))
    np.testing.assert_allclose(
        f.friction_coefficient, plain.friction_coefficient.where(known), rtol=1e-12
    )
    np.testing.assert_array_equal(f.sample_count, plain.sample_count)
    lazy = packed.chunk(time=1).cg.coarse_grain(surfaces=BETWEEN, per="accessible", **given)
    assert lazy.density.chunks is not None
    assert lazy.accessible_fraction.chunks is not None
    xr.testing.assert_identical(lazy.compute().drop_attrs(), f.drop_attrs())
    one = packed.isel(time=0).cg.coarse_grain(surfaces=BETWEEN, per="accessible", **given)
    np.testing.assert_array_equal(one.density, f.density[0])
    mean = f[["density", "velocity", "accessible_fraction"]].cg.time_average()
    np.testing.assert_allclose(mean.accessible_fraction, f.accessible_fraction[0])


@pytest.mark.parametrize(("axes", "at"), [("z", None), ("xz", None), ("r", {"z": 3.0})])
def test_the_accessible_fraction_with_averaged_axes(axes, at):
    """Averages over the cross-section of a silo see its area, and the floor as a plane does."""
    rng = np.random.default_rng(4)
    grains = xcg.scene_from_arrays(
        rng.uniform(2, 3, (20, 3)),
        diameter=np.ones(20),
        density=1.0,
        box=[[-4, 4], [-4, 4], [-1, 8]],
    )
    given = {"width": 0.75, "spacing": 0.5, "bounds": {"z": (-1, 3)} if "z" in axes else {}}
    resolved = {"axes": axes.replace("r", ""), "at": at}
    f = grains.cg.coarse_grain(
        "density", surfaces=[SIDE, FLOOR], **given, **resolved
    ).accessible_fraction[0]
    if axes == "z":
        points = np.stack([0 * f.z, 0 * f.z, f.z], axis=1)
        expected = np.pi * 2.5**2 / 64 * fraction_at(points, [FLOOR], KERNELS[0])
    elif axes == "xz":  # the chord, seen through the marginal; far from the floor
        f = f.sel(z=3.0)
        s = np.linspace(-1.5, 1.5, 4001)
        chord = 2 * np.sqrt(np.maximum(0, 2.5**2 - (f.x.to_numpy()[:, None] - s) ** 2))
        expected = np.trapezoid(chord * KERNELS[0].value(s, seen=1), s, axis=1) / 8
    else:
        expected = np.pi * 2.5**2 / 64
    np.testing.assert_allclose(f, expected, atol=1.5e-3)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (0.4, 0.2, 0.0)])
@pytest.mark.parametrize("axes", ["r", "rz"])
def test_rings_average_the_fraction_over_their_angles(axes, origin):
    """Also about an axis beside that of the silo, where the angles of a ring differ."""
    grains = xcg.scene_from_arrays(
        np.random.default_rng(4).uniform([-1, -1, 1], [1, 1, 3], (20, 3)),
        diameter=np.ones(20),
        density=1.0,
        box=[[-4, 4], [-4, 4], [0, 8]],
    )
    given = {"width": 0.75, "spacing": 0.5, "bounds": {"r": (0.0, 3.5)} | {"z": (-1, 3)}}
    if axes == "r":
        del given["bounds"]["z"]
    frame = xcg.Cylindrical("z", origin=origin)
    found = grains.cg.coarse_grain(
        "density", surfaces=[SIDE, FLOOR], axes=axes, frame=frame, **given
    ).accessible_fraction[0]
    angle = 2 * np.pi * np.arange(60) / 60
    around = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    for r in found.r.to_numpy():
        ring = np.array(origin) + r * around
        if axes == "r":  # far from the floor, as only the box ends the average
            expected = fraction_at(ring, [SIDE], KERNELS[0]).mean()
            np.testing.assert_allclose(found.sel(r=r), expected, atol=2e-3)
            continue
        for z in found.z.to_numpy():
            expected = fraction_at(ring + z * UP, [SIDE, FLOOR], KERNELS[0]).mean()
            np.testing.assert_allclose(found.sel(r=r, z=z), expected, atol=2e-3)


def test_walls_turn_with_rotated_axes():
    """A silo that leans, in its own axes, is an upright one."""
    rng = np.random.default_rng(5)
    places = rng.uniform([-1, -1, 1], [1, 1, 3], (50, 3))
    frame = xcg.Rotated(z=(0, 1, 2), x=(1, 0, 0), origin=(1.0, 2.0, 3.0))
    given = {"diameter": np.ones(50), "density": 1.0}
    upright = xcg.scene_from_arrays(places, **given)
    leaning = xcg.scene_from_arrays(places @ frame.axes + frame.origin, **given)
    side = xcg.Cylinder(frame.origin, (0, 1, 2), 2.5)
    floor = xcg.Plane(frame.origin, (0, 1, 2))
    options = {"width": 0.75, "per": "accessible", "bounds": {"z": (0.0, 3.0)}, "axes": "z"}
    options["extent"] = {"x": 5.0, "y": 5.0}
    options["spacing"] = 0.5
    expected = upright.cg.coarse_grain("density", surfaces=[SIDE, FLOOR], **options)
    found = leaning.cg.coarse_grain("density", surfaces=[side, floor], frame=frame, **options)
    np.testing.assert_allclose(found.accessible_fraction, expected.accessible_fraction, atol=1e-9)
    np.testing.assert_allclose(found.density, expected.density, rtol=1e-9)
    assert found.attrs["surfaces"] == f"{side!r}\n{floor!r}"  # as they were given


def test_explain_names_the_work_for_walls(packed):
    text = str(packed.cg.explain("density", axes="z", surfaces=[SIDE, *BETWEEN]))
    assert "walls     the accessible fraction by 75025 rays along z takes about" in text
    text = str(packed.cg.explain("density", axes="xyz", spacing=2.0, surfaces=BETWEEN))
    assert "points, by up to 576 rays from each takes about" in text
    assert "walls " not in str(packed.cg.explain("density", axes="z"))
    with pytest.raises(ValueError, match="needs surfaces="):
        packed.cg.explain("density", axes="z", per="accessible")


@pytest.mark.parametrize("axes", ["z", "xyz"])
def test_long_work_for_walls_warns_before_and_counts_all_of_its_steps(packed, monkeypatch, axes):
    counted = []

    @contextmanager
    def bar(steps, wanted, what):
        assert wanted is None
        yield SimpleNamespace(update=counted.append)
        assert sum(counted) == steps

    monkeypatch.setattr(accessible, "_LONG", 0.0)
    monkeypatch.setattr(accessible, "shown", bar)
    with pytest.warns(xcg.SceneWarning, match="the accessible fraction .* takes about"):
        packed.cg.coarse_grain("density", axes=axes, spacing=2.0, surfaces=[SIDE, *BETWEEN])
    assert counted


def test_layers_accept_walls_across_them():
    ds = xcg.scene_from_arrays(
        np.array([[1.0, 1, 0], [2, 1, 0], [1, 2, 0]]), diameter=np.ones(3), density=1.0, dimension=2, plane="xy",
        thickness=1.0,
    )  # fmt: skip
    given = {
        "fields": "density",
        "width": 1.0,
        "bounds": {"x": (0, 3), "y": (0, 3)},
        "spacing": 0.5,
    }
    disc = xcg.Cylinder((0, 0, 0), (0, 0, 1), 3.0)
    chi = ds.cg.coarse_grain(
        surfaces=[xcg.Plane((0, 0, 0), (0, 1, 0)), disc], **given
    ).accessible_fraction[0]
    kernel = xcg.Lucy(1.0, dimension=2)
    s = np.linspace(-2, 2, 801)
    x, y = np.meshgrid(s, s)
    weight = kernel.value(np.hypot(x, y))
    for i, j in [(0, 0), (3, 1), (4, 4), (6, 0)]:
        inside = (np.hypot(x + float(chi.x[i]), y + float(chi.y[j])) < 3) & (
            y + float(chi.y[j]) > 0
        )
        np.testing.assert_allclose(chi[i, j], (weight * inside).sum() / weight.sum(), atol=5e-3)
    with pytest.raises(ValueError, match="one layer across 'z'"):
        ds.cg.coarse_grain(surfaces=[FLOOR], **given)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"surfaces": FLOOR}, r"expected a list of xcg\.Plane"),
        ({"surfaces": []}, r"expected a list of xcg\.Plane"),
        ({"surfaces": ["floor"]}, r"expected a list of xcg\.Plane"),
        ({"per": "accessible"}, r"needs surfaces="),
        ({"surfaces": [FLOOR], "per": "volume"}, "per='volume'"),
        ({"surfaces": [FLOOR], "preset": "pysammos"}, "presets know no"),
        (
            {"surfaces": [FLOOR], "kernel": xcg.Lucy(1.0, dimension=2), "axes": "z"},
            "kernels of the scene's dimension",
        ),
    ],
)
def test_wrong_walls_raise(packed, options, message):
    with pytest.raises(ValueError, match=message):
        packed.cg.coarse_grain(["density"], **options)


def test_averages_over_unbounded_space_raise():
    ds = xcg.scene_from_arrays(np.eye(3), diameter=np.ones(3), density=1.0)
    with pytest.raises(ValueError, match="nor a box bound the space"):
        ds.cg.coarse_grain("density", axes="xy", extent={"z": 1.0}, surfaces=[FLOOR])


def test_normals_that_point_away_from_the_grains_warn(packed):
    with pytest.warns(xcg.SceneWarning, match="the middle of the grains lies behind it"):
        packed.cg.coarse_grain("density", axes="z", surfaces=[xcg.Plane((0, 0, 0), (0, 0, -1))])


@pytest.mark.parametrize("periodic", ["xy", ""])
@pytest.mark.parametrize("reach", [0.0, 1.0, 5.0])
def test_surfaces_beyond_the_box_count_as_far_as_the_box(periodic, reach):
    """Averaged over x and y, a floor of triangles beyond the box is a plane, and a wide tube is nothing."""
    ds = xcg.datasets.random_scene(60, seed=1, periodic=periodic)
    side = float(ds.box[0, 0, 1])
    low = -reach
    high = side + reach
    corners = [[low, low, 0], [high, low, 0], [high, high, 0], [low, high, 0]]
    given = {"axes": "z", "width": 0.5, "spacing": 0.25, "bounds": {"z": (-0.5, 2.0)}}

    def fraction(wall):
        return ds.cg.coarse_grain("density", surfaces=[wall], **given).accessible_fraction[0]

    plane = fraction(xcg.Plane((0, 0, 0), (0, 0, 1)))
    floor = fraction(xcg.Surface(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]])))
    np.testing.assert_allclose(floor, plane, atol=2e-4)
    np.testing.assert_allclose(
        fraction(xcg.Cylinder((side / 2, side / 2, 0), (0, 0, 1), 20.0)), 1.0, atol=1e-3
    )
