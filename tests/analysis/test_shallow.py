"""Shallow flows: surfaces at known heights, heaps of known slope, profiles of known shape, weight at the base."""

import numpy as np
import pytest
import xarray as xr

import xcg

L, H = 20.0, 10.0


def flow(profile, count=40_000, seed=1, floor=0.0):
    """Small grains up to a height H above the floor, that move along x as the profile says at each height."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0, 1, (count, 3)) * [L, 4.0, H]
    position[:, 2] = np.linspace(0, H, count)
    velocity = profile(position[:, 2] / H)[:, None] * [1.0, 0.0, 0.0]
    position[:, 2] += floor
    return xcg.scene_from_arrays(
        position, velocity=velocity, diameter=np.full(count, 0.3), density=1.0,
        box={"x": (0, L), "y": (0, 4)}, periodic="xy",
    )  # fmt: skip


@pytest.mark.parametrize(("profile", "factor"), [
    (np.ones_like, 1.0), (lambda z: z, 4 / 3), (lambda z: 1 - (1 - z) ** 1.5, 5 / 4),
])  # fmt: skip
def test_shape_factors_of_known_profiles(profile, factor):
    d = flow(profile).cg.depth_average("z", axes="", width=0.3)
    # the kernel smears the profile at base and surface: an error of order (w / H)^2
    assert d.shape_factor.sel(component="x").item() == pytest.approx(factor, rel=5e-3)


def test_integrals_over_the_depth_equal_those_of_the_grains():
    ds = flow(lambda z: z)
    d = ds.cg.depth_average("z", axes="", width=0.5)
    assert "depth_average(axis='z', axes='', width=0.5, kernel='lucy')" in d.attrs["history"]
    x = ds.cg.depth_average(
        "z", axes="x", width=0.5, spacing=0.7, bounds={"x": (1.0, 5.0)}, extent={"y": 2.0}
    )
    assert "spacing=0.7, bounds={'x': (1.0, 5.0)}, extent={'y': 2.0})" in x.attrs["history"]
    area = L * 4.0
    mass = d.mass_per_area.item() * area
    assert mass == pytest.approx(float(ds.mass.sum()), rel=1e-10)
    assert d.solid_depth.item() * area == pytest.approx(float(ds.volume.sum()), rel=1e-10)
    momentum = d.momentum_per_area.sel(component="x").item() * area
    assert momentum == pytest.approx(
        float((ds.mass * ds.velocity.sel(component="x")).sum()), rel=1e-10
    )
    speed = d.depth_averaged_velocity.sel(component="x")
    xr.testing.assert_allclose(
        speed, (d.momentum_per_area.sel(component="x") / d.mass_per_area).drop_attrs()
    )
    assert d.mass_per_area.attrs["units"] == "kg m^-2"


def test_the_thickness_is_that_of_the_slab_and_the_solid_depth_that_of_its_grains():
    ds = flow(np.ones_like, floor=3.0)
    d = ds.cg.depth_average("z", axes="", width=0.3)
    assert d.thickness.item() == pytest.approx(H, abs=0.02)
    solid = float(ds.volume.sum()) / (L * 4.0)
    assert d.solid_depth.item() == pytest.approx(solid, rel=1e-10)
    assert d.thickness.attrs["units"] == d.solid_depth.attrs["units"] == "m"
    empty = ds.isel(particle=ds.position.values[0, :, 0] < 5.0)
    cut = empty.cg.depth_average("z", axes="x", width=0.3)
    assert cut.thickness.sel(x=10.0, method="nearest").isnull().all()


def column(layers=8):
    """A column of spheres on a floor that carry their weight: forces known."""
    position = np.array([[0.5, 0.5, 0.5 + k] for k in range(layers)])
    mass = np.pi / 6
    g = 9.81
    force = np.array([[0, 0, mass * g * (layers - k)] for k in range(layers)])
    return xcg.scene_from_arrays(
        position, velocity=np.zeros((layers, 3)), diameter=np.ones(layers), density=1.0, gravity=(0, 0, -g),
        contact_i=np.arange(layers), contact_j=np.array([-2, *range(layers - 1)]), contact_force=force,
        contact_point=position - [0, 0, 0.5], box={"x": (0, 1), "y": (0, 1)}, periodic="xy",
    )  # fmt: skip


def test_the_base_carries_the_weight():
    ds = column()
    d = ds.cg.depth_average("z", axes="", width=1.0)
    weight = float(ds.mass.sum()) * 9.81
    np.testing.assert_allclose(d.basal_traction.values[0], [0, 0, weight], atol=1e-10)
    assert d.mass_per_area.item() * 9.81 == pytest.approx(weight, rel=1e-12)
    # int sigma_zz dz = sum of f a over contacts, per area
    f = ds.contact_force.values[0, :, 2]
    a = np.array([0.5, *[1.0] * 7])
    assert d.depth_stress.sel(component="z", direction="z").item() == pytest.approx(
        (f * a).sum(), rel=1e-10
    )
    assert d.earth_pressure.sel(component="z").item() == pytest.approx(1.0)


def test_the_stress_over_the_depth_leaves_out_the_profile_of_the_flow():
    """Brute force: the stress at nodes, whose kinetic part is about the velocity there, integrated along z."""
    ds = xcg.datasets.open("chute").isel(time=[0])
    d = ds.cg.depth_average("z", axes="")
    profile = ds.cg.coarse_grain("stress", axes="z", spacing=0.1).stress.fillna(0.0).integrate("z")
    np.testing.assert_allclose(d.depth_stress, profile, atol=2e-3 * float(profile.max()))
    normal = np.diag(profile[0])
    np.testing.assert_allclose(d.earth_pressure[0], normal / normal[2], rtol=1e-3)


@pytest.mark.parametrize("chunks", [False, True])
def test_the_surface_of_a_slab(chunks):
    z = np.linspace(-1, 6, 71)
    x = np.arange(4.0)
    height = np.array([3.02, 2.5, 4.44, 0.0])
    base = 0.31
    profile = (
        np.clip((height[:, None] - z) / 0.2 + 0.5, 0, 1)
        * np.clip((z - base) / 0.2 + 0.5, 0, 1)
        * 0.6
    )
    profile[3] = 0.0
    f = xr.Dataset(
        {"volume_fraction": (("time", "x", "z"), profile[None])}, {"time": [0.0], "x": x, "z": z}
    )
    s = (f.chunk(time=1) if chunks else f).cg.free_surface("z")
    assert (s.height.chunks is not None) == chunks
    np.testing.assert_allclose(s.height.values[0], [3.02, 2.5, 4.44, np.nan], atol=0.02)
    np.testing.assert_allclose(s.base.values[0, :3], base, atol=0.02)
    inside = f.sel(z=slice(1, 2)).cg.free_surface("z")
    assert inside.height.isnull().all()


def test_the_surface_of_a_packing_is_where_its_grains_end():
    rng = np.random.default_rng(3)
    position = rng.uniform(0, 1, (20_000, 3)) * [8, 4, 5]
    ds = xcg.scene_from_arrays(position, diameter=np.full(20_000, 0.2), density=1.0, box={"x": (0, 8), "y": (0, 4)},
                               periodic="xy")  # fmt: skip
    f = ds.cg.coarse_grain("volume_fraction", axes="xz", width=0.3, spacing=0.1)
    s = f.cg.free_surface("z")
    np.testing.assert_allclose(s.height.mean(), 5.0, atol=0.02)
    np.testing.assert_allclose(s.base.mean(), 0.0, atol=0.02)


def test_the_surface_does_not_depend_on_the_order_of_the_nodes():
    f = flow(np.ones_like, 3000).cg.coarse_grain("volume_fraction", axes="xz", width=1.0)
    xr.testing.assert_equal(f.isel(z=slice(None, None, -1)).cg.free_surface(), f.cg.free_surface())


def test_selected_phases_have_a_surface_each():
    position = np.random.default_rng(1).uniform(0, 1, (4000, 3)) * [L, 4, H]
    ds = xcg.scene_from_arrays(
        position, diameter=np.full(4000, 0.3), density=1.0, species=1 + (position[:, 2] > H / 2), periodic="xy",
        box={"x": (0, L), "y": (0, 4)},
    )  # fmt: skip
    f = ds.cg.coarse_grain("volume_fraction", axes="z", by="species", width=0.5)
    s = f.sel(phase=["2", "1"]).cg.free_surface()
    assert s.height.sel(phase="1").item() == pytest.approx(H / 2, abs=0.1)
    assert s.base.sel(phase="2").item() == pytest.approx(H / 2, abs=0.1)
    for phase in "12":
        xr.testing.assert_equal(
            s.sel(phase=phase, drop=True), f.sel(phase=phase).cg.free_surface().drop_vars("phase")
        )
    for bulk in (f, f.sel(phase=["1", "bulk"])):
        assert bulk.cg.free_surface().height.dims == ("time",)
        assert bulk.cg.free_surface().height.item() == pytest.approx(H, abs=0.1)


def test_heights_hold_what_their_slope_and_their_history_need():
    f = flow(np.ones_like, 3000).cg.coarse_grain("volume_fraction", axes="xz", width=1.0)
    s = f.cg.free_surface()
    xr.testing.assert_identical(xcg.fit_slope(s.height), s.cg.fit_slope())
    assert (
        "free_surface(axis='z', share=0.5, field='volume_fraction')"
        in s.attrs["history"].splitlines()[-1]
    )
    assert "formula" not in s.height.attrs
    assert s.attrs["width"] == 1.0


@pytest.mark.parametrize("plane", [False, True])
def test_a_heap_of_known_slope(plane):
    rng = np.random.default_rng(5)
    slope = np.array([-0.45, 0.2]) if plane else np.array([-0.45])
    angle = np.degrees(np.arctan(np.linalg.norm(slope)))
    found = []
    axes = {"x": np.arange(30.0), "y": np.arange(12.0)} if plane else {"x": np.arange(30.0)}
    grid = np.meshgrid(*axes.values(), indexing="ij")
    for _ in range(60):
        height = (
            20
            + sum(s * g for s, g in zip(slope, grid, strict=True))
            + rng.normal(size=grid[0].shape)
        )
        height[3] = np.nan
        found.append(xcg.fit_slope(xr.DataArray(height, axes)))
    angles, errors = (
        np.array([float(one[name]) for one in found]) for name in ("angle", "angle_error")
    )
    assert angles.mean() == pytest.approx(angle, abs=3 * angles.std() / 60**0.5)
    assert errors.mean() == pytest.approx(angles.std(ddof=1), rel=0.25)
    np.testing.assert_allclose(found[0].slope, slope, atol=4 * float(found[0].slope_error.max()))


@pytest.mark.parametrize("steep", [0.0, 0.5, -2.0])
def test_errors_of_a_line_through_three_heights(steep):
    """Heights s x + (0, e, 0): squares of 2 e^2 / 3 are left to one degree of freedom, over sum x^2 = 2."""
    x = np.array([-1.0, 0.0, 1.0])
    e = 0.03
    found = xcg.fit_slope(xr.DataArray(steep * x + [0.0, e, 0.0], {"x": x}))
    assert float(found.slope[0]) == pytest.approx(steep, abs=1e-12)
    assert float(found.slope_error[0]) == pytest.approx(e / 3**0.5)
    assert float(found.angle_error) == pytest.approx(np.degrees(e / 3**0.5 / (1 + steep**2)))


def test_neighbours_within_a_support_are_not_independent():
    x = np.arange(0, 30, 0.5)
    rough = xr.DataArray(np.random.default_rng(1).normal(size=60), {"x": x})
    alone = xcg.fit_slope(rough)
    wide = xcg.fit_slope(rough.assign_attrs(cutoff=2.0))
    assert float(wide.slope_error[0] / alone.slope_error[0]) == pytest.approx(8**0.5)


@pytest.mark.parametrize(("call", "message"), [
    (lambda ds: ds.cg.depth_average("x"), "periodic"),
    (lambda ds: ds.cg.depth_average("z", axes="xz"), "the depth is along 'z'"),
    (lambda ds: ds.cg.coarse_grain("density", axes="z").cg.free_surface("z"), "field='volume_fraction'"),
    (lambda ds: ds.cg.coarse_grain("volume_fraction", axes="z").cg.free_surface("x"), r"the result has the axes"),
    (lambda ds: ds.cg.coarse_grain("volume_fraction", axes="z").cg.free_surface(share=2), "share=2"),
    (lambda ds: ds.cg.coarse_grain("density", axes="z").cg.fit_slope(), "fit_slope needs 'height'"),
])  # fmt: skip
def test_wrong_arguments_raise(call, message):
    with pytest.raises(ValueError, match=message):
        call(flow(np.ones_like, count=100))


def test_depth_averages_are_lazy():
    ds = column()
    two = xr.concat([ds, ds.assign_coords(time=[1.0])], "time", data_vars="minimal").chunk(time=1)
    d = two.cg.depth_average("z", axes="", width=1.0)
    assert d.shape_factor.chunks is not None
    np.testing.assert_allclose(
        d.mass_per_area.values, ds.cg.depth_average("z", axes="", width=1.0).mass_per_area.item()
    )
