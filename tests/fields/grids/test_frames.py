"""Fields in axes of the user's choice: equal to those of the scene, turned by hand."""

from functools import cache

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

import xcg

PLACES = ("position", "contact_point")
VECTORS = (*PLACES, "velocity", "angular_velocity", "contact_force")
FIELDS = [
    "sample_count", "density", "velocity", "contact_stress", "kinetic_stress", "velocity_gradient",
    "granular_temperature", "directional_temperature", "fabric", "angular_velocity", "couple_stress", "shear_stress",
    "boundary_force_density",
]  # fmt: skip
ROUNDING = 1e-11
directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@cache
def grains_with_tensors(periodic="", dimension=3):
    ds = xcg.datasets.random_scene(150, periodic=periodic, dimension=dimension)
    return ds.assign(
        pull=ds.velocity * 2.0, strain=ds.velocity * ds.position.rename(component="direction")
    )


def by_hand(ds, axes, origin=(0.0, 0.0, 0.0)):
    """Turn a scene without periods: places, vectors and a tensor."""
    found = {}
    for name in (*VECTORS, "pull"):
        if name in ds:
            shift = np.asarray(origin) if name in PLACES else 0.0
            found[name] = (ds[name].dims, np.einsum("ij,...j->...i", axes, ds[name].values - shift))
    found["strain"] = (
        ds.strain.dims,
        np.einsum("ij,kl,...jl->...ik", axes, axes, ds.strain.values),
    )
    out = ds.drop_vars("box").assign(found)
    out.attrs = {k: v for k, v in ds.attrs.items() if not k.startswith(("box", "particle_"))}
    return out


def assert_equal(a, b, rtol=ROUNDING):
    assert a.sizes == b.sizes
    for name in b.data_vars:
        size = float(np.abs(b[name]).max())
        np.testing.assert_allclose(
            a[name].values, b[name].values, rtol=rtol, atol=rtol * size, err_msg=name
        )


# --- axes ------------------------------------------------------------------------------------------------


@settings(deadline=None)
@given(x=directions, z=directions)
def test_axes_are_a_rotation_that_keeps_z_and_the_plane_of_x(x, z):
    if np.linalg.norm(np.cross(x, z)) < 0.01:
        return
    axes = xcg.Rotated(x=x, z=z).axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) > 0
    np.testing.assert_allclose(axes[2], np.asarray(z) / np.linalg.norm(z), atol=1e-14)
    np.testing.assert_allclose(np.cross(z, x) @ axes[0], 0.0, atol=1e-14)
    assert np.dot(axes[0], x) > 0


@pytest.mark.parametrize(
    ("given", "want"),
    [
        ({"z": (0, 0, 2)}, np.eye(3)),
        ({"x": (0, 1, 0)}, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),  # z stays
        ({"z": (1, 0, 0)}, [[0, 0, -1], [0, 1, 0], [1, 0, 0]]),  # x would be parallel: y stays
        ({"y": (1, 0, 0)}, [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ({"z": (0, 1, 0), "x": (1, 1, 0)}, [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        ({"x": (0, 1, 0), "y": (0, 1, 1)}, [[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    ],
)
def test_axes_that_are_not_given_follow(given, want):
    np.testing.assert_allclose(xcg.Rotated(**given).axes, want, atol=1e-15)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "one or two"),
        ({"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}, "one or two"),
        ({"z": (0, 0, 0)}, "not all zero"),
        ({"z": (0, np.nan, 1)}, r"z=\(0, nan, 1\): expected three finite numbers"),
        ({"z": (0, 1)}, "three finite numbers"),
        (
            {"z": (0, 0, 1), "origin": (0, np.inf, 0)},
            r"origin=\(0, inf, 0\): expected three finite numbers",
        ),
        ({"z": (0, 0, 1), "x": (0, 0, -2)}, "parallel"),
    ],
)
def test_wrong_axes_raise(given, message):
    with pytest.raises(ValueError, match=message):
        xcg.Rotated(**given)


# --- turning the scene = turning the frame ---------------------------------------------------------------


@settings(deadline=None, max_examples=8)
@given(x=directions, z=directions, origin=directions)
def test_fields_equal_those_of_the_scene_turned_by_hand(x, z, origin):
    if np.linalg.norm(np.cross(x, z)) < 0.01:
        return
    frame = xcg.Rotated(x=x, z=z, origin=origin)
    ds = grains_with_tensors()
    fields = [*FIELDS, xcg.Mean("pull"), xcg.Mean("strain"), xcg.Variance("pull", name="scatter")]
    f = ds.cg.coarse_grain(fields, frame=frame, spacing=1.5, width=0.9)
    g = by_hand(ds, frame.axes, origin).cg.coarse_grain(fields, spacing=1.5, width=0.9)
    for a in "xyz":
        np.testing.assert_allclose(f[a], g[a], rtol=0, atol=1e-12)
    sums = ["density", "contact_stress", "fabric", "boundary_force_density"]
    assert_equal(f[sums], g[sums])
    known = g.sample_count > 12  # fits of few grains multiply the rounding of turned coordinates
    assert known.any()
    f = f.assign_coords({a: g[a] for a in "xyz"})  # which are rounded otherwise
    assert_equal(f.where(known), g.where(known), 1e-9)
    np.testing.assert_array_equal(f.attrs["frame_axes"], frame.axes.ravel())
    np.testing.assert_array_equal(f.attrs["frame_origin"], origin)


def test_tensors_turn_back_into_those_of_the_scene():
    """One point, given in either axes: what is found there is the same thing."""
    ds = grains_with_tensors()
    frame = xcg.Rotated(z=(1, 2, 3), x=(1, -1, 0.5), origin=(1, 0.5, -2))
    place = np.array([2.0, 2.5, 3.0])
    there = dict(zip("xyz", frame.axes @ (place - frame.origin), strict=True))
    for name in ("velocity", "contact_stress", "velocity_gradient", "granular_temperature"):
        here = ds.cg.coarse_grain(name, at=dict(zip("xyz", place, strict=True)))[name].values[0]
        found = ds.cg.coarse_grain(name, at=there, frame=frame)[name].values[0]
        for axis in range(here.ndim):
            here = np.moveaxis(np.tensordot(frame.axes, here, (1, axis)), 0, axis)
        np.testing.assert_allclose(
            found, here, rtol=1e-11, atol=1e-11 * np.abs(here).max(), err_msg=name
        )


def test_arguments_are_in_the_axes_of_the_frame():
    ds = grains_with_tensors()
    frame = xcg.Rotated(z=(0, 1, 1), x=(1, 0, 0))
    options = {
        "pressure_dims": "z",
        "shear_dims": "xz",
        "axes": "z",
        "at": {"x": 2.0},
        "extent": {"y": 4.0},
    }
    f = ds.cg.coarse_grain(["pressure", "shear_stress", "stress"], frame=frame, **options)
    g = by_hand(ds, frame.axes).cg.coarse_grain(["pressure", "shear_stress", "stress"], **options)
    assert_equal(f, g)
    np.testing.assert_allclose(f.pressure, f.stress.sel(component="z", direction="z"))
    assert "Rotated(" in f.attrs["history"]


def test_gravity_turns_with_the_frame():
    ds = grains_with_tensors().assign_attrs(gravity=np.array([0.0, 0.0, -9.81]))
    f = ds.cg.coarse_grain("density", frame=xcg.Rotated(z=(1, 0, 1), x=(1, 0, -1)), spacing=2.0)
    np.testing.assert_allclose(
        f.attrs["gravity"], np.array([1, 0, -1]) * 9.81 / np.sqrt(2), atol=1e-12
    )


# --- boxes -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("z", [(1, 0, 0), (0, -1, 0), (0, 0, -1)])
def test_periods_along_the_axes_stay_periods_along_axes(z):
    """Quarter turns give the nodes of the periodic mesh, each somewhere else, and averages over the box."""
    ds = grains_with_tensors("xyz")
    frame = xcg.Rotated(z=z)
    f = ds.cg.coarse_grain(["density", "contact_stress"], frame=frame, spacing=0.5)
    assert f.attrs["wrapped_axes"] == "xyz"
    g = ds.cg.coarse_grain("density", spacing=0.5)
    np.testing.assert_allclose(float(f.density.mean()), float(g.density.mean()), rtol=1e-12)
    own = "xyz"[int(np.argmax(np.abs(frame.axes[2])))]
    turned = ds.cg.coarse_grain(
        "contact_stress", axes="z", frame=frame, spacing=0.5
    ).contact_stress[0]
    here = ds.cg.coarse_grain("contact_stress", axes=own, spacing=0.5).contact_stress[0]
    here = np.einsum("ij,kl,njl->nik", frame.axes, frame.axes, here.values)
    turned = turned.values[:: int(np.sign(frame.axes[2].sum()))]
    if frame.axes[2].sum() < 0:  # both begin with the node at the lower edge
        turned = np.roll(turned, 1, axis=0)
    np.testing.assert_allclose(turned, here, rtol=1e-10, atol=1e-12 * np.abs(here).max())


@pytest.mark.parametrize("periodic", ["xyz", "xy", "z"])
@pytest.mark.parametrize("z", [(0, 1, 1), (1, 2, 3)])
def test_points_in_a_turned_periodic_box(periodic, z):
    """Images follow their box: the same places, in either axes, within it and in the next one."""
    ds = grains_with_tensors(periodic)
    frame = xcg.Rotated(z=z, origin=(1, 0, 0))
    place = np.random.default_rng(0).uniform(-2, 7, (12, 3))
    turned = (place - frame.origin) @ frame.axes.T
    here, there = (
        {a: xr.DataArray(x, dims="point") for a, x in zip("xyz", p.T, strict=True)}
        for p in (place, turned)
    )
    names = ["density", "contact_stress", "velocity"]
    a = ds.cg.coarse_grain(names, at=here)
    b = ds.cg.coarse_grain(names, at=there, frame=frame)
    np.testing.assert_allclose(b.density, a.density, rtol=1e-10, atol=1e-12)
    stress = np.einsum("ij,kl,tnjl->tnik", frame.axes, frame.axes, a.contact_stress)
    np.testing.assert_allclose(b.contact_stress, stress, atol=1e-11 * np.abs(stress).max())
    np.testing.assert_allclose(b.velocity, a.velocity.values @ frame.axes.T, atol=1e-11)


def test_averages_over_the_whole_periods_of_a_turned_box():
    """About y, the axes x and z together still are two axes of the box."""
    ds = grains_with_tensors("xyz")
    frame = xcg.Rotated(z=(1, 0, 2), y=(0, 1, 0))
    f = ds.cg.coarse_grain("density", frame=frame, axes="y", spacing=0.5)
    g = ds.cg.coarse_grain("density", axes="y", spacing=0.5)
    np.testing.assert_allclose(f.density, g.density, rtol=1e-12)


def test_undefined_averages_raise():
    frame = xcg.Rotated(z=(1, 0, 2), y=(0, 1, 0))
    with pytest.raises(xcg.SceneError, match=r"shifted along z.*does not exist"):
        grains_with_tensors("xyz").cg.coarse_grain("density", frame=frame, axes="z")
    with pytest.raises(ValueError, match="extent="):
        grains_with_tensors("y").cg.coarse_grain("density", frame=frame, axes="z")
    with pytest.raises(xcg.SceneError, match="extent="):
        grains_with_tensors("x").cg.coarse_grain("density", frame=frame, axes="y")
    f = grains_with_tensors("y").cg.coarse_grain(
        "density", frame=frame, axes="z", extent={"x": 5.0}
    )
    assert float(f.density.sum() * (f.z[1] - f.z[0])) * 25 == pytest.approx(
        float(grains_with_tensors("y").mass.sum()), rel=0.01
    )


def test_layers_turn_in_their_plane_only():
    ds = grains_with_tensors(dimension=2)
    f = ds.cg.coarse_grain(["density", "velocity"], frame=xcg.Rotated(x=(1, 1, 0)), spacing=1.0)
    assert set(f.density.dims) == {"time", "x", "y"}
    with pytest.raises(xcg.SceneError, match="lead out of it"):
        ds.cg.coarse_grain("density", frame=xcg.Rotated(z=(1, 0, 1)))


# --- other functions -------------------------------------------------------------------------------------


def test_lazy_results_in_turned_axes_equal_eager_ones(tmp_path):
    ds = xr.concat(
        [grains_with_tensors(), grains_with_tensors().assign_coords(time=[1.0])],
        "time",
        data_vars="all",
    )
    ds.cg.save(tmp_path / "scene.nc")
    lazy = xr.open_dataset(tmp_path / "scene.nc", chunks={"time": 1})
    frame = xcg.Rotated(z=(1, 2, 3))
    bounds = dict.fromkeys("xyz", (-1.0, 4.0))
    f = lazy.cg.coarse_grain(["density", "velocity"], frame=frame, spacing=1.0, bounds=bounds)
    assert f.density.chunks is not None
    assert_equal(
        f.compute(),
        ds.cg.coarse_grain(["density", "velocity"], frame=frame, spacing=1.0, bounds=bounds),
    )
    wide = lazy.cg.coarse_grain(
        "density", frame=frame, spacing=1.0
    )  # around the corners of the grains' extent
    assert float(wide.density[0].sum()) == pytest.approx(
        float(grains_with_tensors().mass.sum()), rel=0.05
    )


def test_widths_displacements_and_balances_take_a_frame():
    ds = grains_with_tensors()
    frame = xcg.Rotated(z=(1, 2, 3), x=(1, -1, 0), origin=(1, 1, 1))
    turned = by_hand(ds, frame.axes, frame.origin)
    at = {"x": 1.0, "y": 1.0, "z": 2.0}
    sweep = {"widths": [0.8, 1.0, 1.3], "fields": "stress", "at": at}
    assert_equal(
        ds.cg.width_sweep(frame=frame, **sweep)[["stress"]],
        turned.cg.width_sweep(**sweep)[["stress"]],
    )
    mesh = {"spacing": 0.5, "quantities": ["force"], "kernel": "lucy", "width": 1.2}
    assert_equal(ds.cg.balance(frame=frame, **mesh), turned.cg.balance(**mesh), 1e-9)
    later = ds.assign(position=ds.position + 0.1 * ds.velocity).assign_coords(time=[1.0])
    two = xr.concat([ds, later], "time", data_vars="all")
    two_turned = by_hand(two, frame.axes, frame.origin)
    a = two.cg.displacement("displacement", at=at, frame=frame)
    assert_equal(a, two_turned.cg.displacement("displacement", at=at))


def test_displacements_in_turned_boxes():
    """A periodic box that stays is turned with its grains; one that changes is refused."""
    ds = grains_with_tensors("xyz")
    frame = xcg.Rotated(z=(1, 2, 3))
    later = ds.assign(position=(ds.position + 0.1 * ds.velocity) % 5.0).assign_coords(time=[1.0])
    two = xr.concat([ds, later], "time", data_vars="all")
    at = dict.fromkeys("xyz", 2.0)
    turned = dict(zip("xyz", frame.axes @ [2.0, 2.0, 2.0], strict=True))
    here = two.cg.displacement("displacement", at=at).displacement.values
    there = two.cg.displacement("displacement", at=turned, frame=frame).displacement.values
    np.testing.assert_allclose(there, here @ frame.axes.T, atol=1e-11)
    grows = two.assign(box=two.box * xr.DataArray([1.0, 1.1], dims="time"))
    grows.attrs = {k: v for k, v in two.attrs.items() if not k.startswith("box_")}
    with pytest.raises(ValueError, match="leave frame= out"):
        grows.cg.displacement("displacement", at=turned, frame=frame)


# --- along a slope -------------------------------------------------------------------------------


def tilted(ds, axes):
    """A scene turned by hand, so that its own axes become the rows of `axes`."""
    vectors = ["position", "velocity", "contact_point", "contact_force"]
    turned = {name: (ds[name].dims, ds[name].values @ axes) for name in vectors}
    return ds.drop_vars("box", errors="ignore").assign(turned)


@pytest.mark.parametrize("slope", [(0.4, 0.0), (-0.4, 0.0), (0.3, -0.5), (0.0, 0.0)])
def test_a_bed_tilted_by_a_slope_has_the_fields_of_the_level_bed(slope):
    """Its surface is the plane z = 1 + slope . (x, y), 1 above the level one where x = y = 0."""
    x = xr.DataArray(np.linspace(-3, 3, 7), dims="x", coords={"x": np.linspace(-3, 3, 7)})
    plane = 1.0 + slope[0] * x + slope[1] * x.rename(x="y")
    frame = xcg.Rotated.from_slope(xcg.fit_slope(plane))
    assert frame.axes[2] @ [*slope, -1.0] < 0  # upwards
    assert frame.axes[2] @ [1.0, 0.0, slope[0]] == pytest.approx(0.0, abs=1e-14)
    assert frame.axes[2] @ [0.0, 1.0, slope[1]] == pytest.approx(0.0, abs=1e-14)
    assert frame.axes[0, 2] == pytest.approx(-np.sin(np.arctan(np.hypot(*slope))), abs=1e-14)
    level = xcg.datasets.random_scene(80, periodic="")
    scene = tilted(level, frame.axes)
    scene["position"] = scene.position + np.array([0, 0, 1.0])
    scene["contact_point"] = scene.contact_point + np.array([0, 0, 1.0])
    mesh = {
        "axes": "xz",
        "at": {"y": 2.0},
        "width": 1.0,
        "spacing": 1.0,
        "bounds": {"x": (1, 4), "z": (1, 4)},
    }
    names = ["density", "velocity", "stress"]
    f = scene.cg.coarse_grain(names, frame=frame, **mesh)
    expected = level.cg.coarse_grain(names, **mesh)
    for name in names:
        size = float(np.abs(expected[name]).max())
        np.testing.assert_allclose(f[name], expected[name], rtol=1e-10, atol=1e-12 * size)


def test_the_surface_of_a_tilted_lattice_gives_its_tilt():
    """Layers of a lattice in a turned box: the fitted frame is theirs within three standard errors."""
    sites = np.stack(np.meshgrid(*[np.arange(20.0), np.arange(3.0), np.arange(8.0)]), -1).reshape(
        -1, 3
    )
    turn = np.radians(15.0)
    axes = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    ds = xcg.scene_from_arrays(sites @ axes, diameter=np.ones(len(sites)), density=1.0)
    f = ds.cg.coarse_grain("volume_fraction", axes="xz", at={"y": 1.0}, width=1.0, spacing=0.5)
    fit = f.cg.free_surface("z").sel(x=slice(4.0, 16.0)).cg.fit_slope()
    assert fit.angle.item() == pytest.approx(15.0, abs=max(0.1, 3 * fit.angle_error.item()))
    frame = xcg.Rotated.from_slope(fit)
    np.testing.assert_allclose(frame.axes, axes, atol=0.01)
    # the surface lies at z = 0
    g = ds.cg.coarse_grain(
        "volume_fraction", axes="z", frame=frame, width=1.0, at={"x": 11.0, "y": 1.0}
    )
    assert g.cg.free_surface("z").height.item() == pytest.approx(0.0, abs=0.1)


def test_fits_that_are_no_single_surface_raise():
    x = np.linspace(0, 1, 5)
    fits = xcg.fit_slope(xr.DataArray([x, 2 * x], {"time": [0.0, 1.0], "x": x}))
    with pytest.raises(ValueError, match=r"one fit, and there are {'time': 2}.*fit.mean"):
        xcg.Rotated.from_slope(fits)
    assert xcg.Rotated.from_slope(fits.mean("time")).axes[0, 0] == pytest.approx(
        -1 / np.hypot(1, 1.5)
    )
    with pytest.raises(ValueError, match="the fit is NaN"):
        xcg.Rotated.from_slope(fits.mean("time") * np.nan)
    with pytest.raises(ValueError, match=r"expected a fit of xcg.fit_slope"):
        xcg.Rotated.from_slope(30.0)
    layer = xcg.fit_slope(xr.DataArray(0.75 * x, {"x": x}).assign_attrs(surface_axis="y"))
    np.testing.assert_allclose(xcg.Rotated.from_slope(layer).axes[2], [0, 0, -1], atol=1e-14)
