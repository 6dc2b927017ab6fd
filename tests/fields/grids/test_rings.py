"""Fields in cylindrical axes: rigid rotation, explicit turning, averages over theta, mass, polar coordinates."""

from functools import cache, partial

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import truths

SUMS = [
    "density",
    "momentum_density",
    "contact_stress",
    "fabric",
    "contact_force_density",
    "couple_stress",
]
OMEGA = 0.7


@cache
def grains_along_z(**options):
    return xcg.datasets.random_scene(300, **{"periodic": "z", "walls": False, **options})


@cache
def rotating(axis=(0.0, 0.0, 1.0), drift=(0.0, 0.0, 0.0), dimension=3, noise=0.0):
    """Grains at random places that rotate about an axis through (1, 2, 3) like one body."""
    rng = np.random.default_rng(1)
    axis = np.asarray(axis) / np.linalg.norm(axis)
    middle = np.array([1.0, 2.0, 3.0 if dimension == 3 else 0.0])
    place = rng.uniform(-3, 3, (1500, 3)) * (1, 1, dimension == 3)
    velocity = (
        np.cross(OMEGA * axis, place)
        + drift
        + noise * rng.normal(size=(1500, 3)) * (1, 1, dimension == 3)
    )
    thickness = {"dimension": 2, "thickness": 1.0} if dimension == 2 else {}
    return xcg.scene_from_arrays(
        place + middle,
        diameter=rng.uniform(0.4, 0.6, 1500),
        density=1.0,
        velocity=velocity,
        **thickness,
    )


def turning(theta):
    c = np.cos(theta)
    s = np.sin(theta)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


# --- rigid rotation --------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", ["z", (1.0, 2.0, -1.0)], ids=str)
@pytest.mark.parametrize("axes", ["r", "rz", "rt", "rtz"])
def test_rigid_rotation_has_its_velocity_vorticity_and_no_temperature(axes, axis):
    """Antisymmetric gradient, no temperature, and V_theta = Omega r at the centre of mass of what a node sees."""
    ds = rotating(
        (0.0, 0.0, 1.0) if axis == "z" else axis,
        tuple(0.3 * np.array([0, 0, 1.0])) if axis == "z" else (0,) * 3,
    )
    bounds = {"r": (0.0, 2.0), "z": (-0.5, 0.5)}
    f = ds.cg.coarse_grain(
        ["velocity", "centre_offset", "velocity_gradient", "granular_temperature", "kinetic_stress", "shear_rate"],
        frame=xcg.Cylindrical(axis, origin=(1, 2, 3)), axes=axes, width=0.4, spacing=0.5,
        bounds={a: b for a, b in bounds.items() if a in axes}, extent={} if "z" in axes else {"z": 6.0},
    )  # fmt: skip
    assert f.component.values.tolist() == ["r", "theta", "z"]
    on_axis = f.velocity.sel(r=0.0)
    assert on_axis.sel(component=["r", "theta"]).isnull().all()
    np.testing.assert_allclose(on_axis.sel(component="z"), 0.3 if axis == "z" else 0.0, atol=1e-11)
    assert f.granular_temperature.notnull().any("r").all()
    f = f.isel(r=slice(1, None)).squeeze()
    g = f.velocity_gradient.transpose(..., "component", "direction").values
    want = np.array([[0, -OMEGA, 0], [OMEGA, 0, 0], [0, 0, 0.0]])
    np.testing.assert_allclose(g, np.broadcast_to(want, g.shape), atol=1e-11)
    assert float(np.abs(f.granular_temperature).max()) < 1e-14
    there = f.velocity - xr.dot(
        f.velocity_gradient, f.centre_offset.rename(component="direction"), dim="direction"
    )
    np.testing.assert_allclose(
        there.sel(component="theta"),
        (OMEGA * f.r).broadcast_like(there.isel(component=0)),
        atol=1e-11,
    )
    np.testing.assert_allclose(there.sel(component="r"), 0.0, atol=1e-11)
    np.testing.assert_allclose(there.sel(component="z"), 0.3 if axis == "z" else 0.0, atol=1e-11)


def test_rigid_rotation_in_a_plane():
    f = rotating(dimension=2).cg.coarse_grain(
        ["velocity_gradient", "granular_temperature", "shear_rate"], frame=xcg.Cylindrical(origin=(1, 2, 0)), axes="r",
        width=0.4, spacing=0.5, bounds={"r": (0.5, 2.0)},
    )  # fmt: skip
    np.testing.assert_allclose(f.velocity_gradient[0, :, 1, 0], OMEGA, atol=1e-11)
    np.testing.assert_allclose(f.velocity_gradient[0, :, 0, 1], -OMEGA, atol=1e-11)
    assert float(f.shear_rate.max()) < 1e-11
    with pytest.raises(ValueError, match="the axes of this scene are r, t "):
        rotating(dimension=2).cg.coarse_grain("density", frame=xcg.Cylindrical(), axes="rz")


# --- explicit turning ------------------------------------------------------------------------------------


def test_nodes_are_points_whose_fields_are_turned():
    ds = grains_along_z()
    frame = xcg.Cylindrical(origin=(2.5, 2.5, 1.0))
    names = [
        "density",
        "velocity",
        "contact_stress",
        "velocity_gradient",
        "granular_temperature",
        "fabric",
    ]
    grid = {"r": (0.5, 2.0), "theta": (0.3, 5.0), "z": (0.0, 2.0)}
    f = ds.cg.coarse_grain(
        names,
        frame=frame,
        axes="rtz",
        bounds=grid,
        spacing={"r": 0.75, "theta": 1.2, "z": 1.0},
        width=0.8,
    )
    x = 2.5 + f.r * np.cos(f.theta)
    y = 2.5 + f.r * np.sin(f.theta)
    z = 1.0 + f.z
    g = ds.cg.coarse_grain(names, at={"x": x, "y": y, "z": z}, width=0.8).transpose(
        "time", "r", "theta", "z", ...
    )
    for name in names:
        want = g[name].values[0]
        for k, theta in enumerate(f.theta.values):
            here = want[:, k]
            for axis in range(2, here.ndim):
                here = np.moveaxis(np.tensordot(turning(theta), here, (1, axis)), 0, axis)
            found = f[name].values[0][:, k]
            np.testing.assert_allclose(
                found, here, atol=1e-10 * np.nanmax(np.abs(want)), err_msg=name
            )


@pytest.mark.parametrize("part", [None, (0.4, 2.0), (-3.0, 1.0)])
@pytest.mark.parametrize("axes", ["r", "rz"])
def test_averages_over_theta_equal_those_of_many_turned_points(part, axes):
    """Sums at fine angles, turned one by one and averaged; ratios and gradients follow from them."""
    ds = grains_along_z()
    width = 0.6
    low, high = part or (0.0, 2 * np.pi)
    bounds = (
        {"r": (0.6, 1.8)}
        | ({"z": (1.0, 2.0)} if "z" in axes else {})
        | ({"theta": part} if part else {})
    )
    frame = xcg.Cylindrical(origin=(2.5, 2.5, 0.0), error=1e-6)
    f = ds.cg.coarse_grain(
        [*SUMS, "velocity"], frame=frame, axes=axes, bounds=bounds, spacing=0.6, width=width
    )
    count = 600
    theta = xr.DataArray(low + (high - low) * (np.arange(count) + 0.5) / count, dims="theta")
    at = {"x": 2.5 + f.r * np.cos(theta), "y": 2.5 + f.r * np.sin(theta)} | (
        {"z": f.z} if "z" in axes else {}
    )
    g = ds.cg.coarse_grain(SUMS, at=at, width=width)
    matrix = xr.DataArray(
        np.stack([turning(t) for t in theta.values]), dims=("theta", "new", "old")
    )
    for name in SUMS:
        values = g[name]
        for dim in [d for d in ("component", "direction") if d in values.dims]:
            values = xr.dot(values.drop_vars(dim).rename({dim: "old"}), matrix, dim="old").rename(
                new=dim
            )
        want = values.mean("theta").transpose(*f[name].dims)
        # midpoints of a part of a circle are right to the square of their distance
        np.testing.assert_allclose(
            f[name], want, atol=3e-5 * float(np.abs(want).max()), err_msg=name
        )
    np.testing.assert_allclose(f.velocity, f.momentum_density / f.density, rtol=1e-9, atol=1e-12)


def test_the_heat_flux_of_a_ring_by_brute_force():
    """Third moments about the velocity of the ring, of grains in the axes at each angle."""
    ds = rotating(noise=0.5, drift=(0.2, -0.1, 0.4))
    width = 0.6
    count = 400
    f = ds.cg.coarse_grain(
        ["kinetic_heat_flux", "velocity"], frame=xcg.Cylindrical(origin=(1, 2, 3), error=1e-6), axes="r",
        at={"z": 0.0}, bounds={"r": (0.8, 1.6)}, spacing=0.8, width=width,
    )  # fmt: skip
    place = ds.position.values[0] - (1, 2, 3)
    kernel = xcg.Lucy(width, dimension=3)
    for k, r in enumerate(f.r.values):
        weight = []
        turned = []
        for theta in 2 * np.pi * (np.arange(count) + 0.5) / count:
            node = (r * np.cos(theta), r * np.sin(theta), 0.0)
            weight.append(
                ds.mass.values[0] * kernel.value(np.linalg.norm(place - node, axis=1)) / count
            )
            turned.append(ds.velocity.values[0] @ turning(theta).T)
        w = np.concatenate(weight)
        v = np.concatenate(turned)
        mean = w @ v / w.sum()
        flux = 0.5 * (w * ((v - mean) ** 2).sum(axis=1)) @ (v - mean)
        np.testing.assert_allclose(f.velocity[0, k], mean, atol=1e-6)
        np.testing.assert_allclose(f.kinetic_heat_flux[0, k], flux, atol=1e-5 * np.abs(flux).max())


def test_averages_over_theta_are_within_their_stated_error():
    """The error is a bound for each grain, and so for their sum."""
    ds = grains_along_z()
    options = {"axes": "r", "bounds": {"r": (0.0, 2.0)}, "spacing": 0.4, "width": 0.5}

    def density(error):
        return ds.cg.coarse_grain(
            "density", frame=xcg.Cylindrical(origin=(2.5, 2.5, 0), error=error), **options
        )

    exact = density(1e-9)
    for error in (1e-1, 1e-2, 1e-4):
        f = density(error)
        assert f.attrs["theta_error"] <= error
        assert float(np.abs(f.density - exact.density).max()) < error * float(exact.density.max())
    strict = xcg.Cylindrical(origin=(2.5, 2.5, 0), error=1e-5)
    jumps = ds.cg.coarse_grain("density", kernel="heaviside", frame=strict, **options)
    assert 1e-5 < jumps.attrs["theta_error"] < 1e-3


# --- integrals -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", ["x", "y", "z", (0.0, 1.0, 2.0)], ids=str)
def test_the_integral_over_the_cylinder_is_the_mass(axis):
    ds = rotating()
    mass = float(rotating().mass.sum())
    f = ds.cg.coarse_grain(
        ["density"],
        frame=xcg.Cylindrical(axis, origin=(1, 2, 3)),
        axes="r",
        width=0.5,
        spacing=0.05,
        extent={"z": 1.0},
    )  # around all grains by default
    total = float((f.density * 2 * np.pi * f.r).sum() * 0.05)
    assert total == pytest.approx(mass, rel=1e-3)
    parts = [
        ds.cg.coarse_grain(
            ["density"], frame=xcg.Cylindrical(axis, origin=(1, 2, 3)), axes="r", width=0.5, spacing=0.1,
            extent={"z": 1.0}, bounds={"r": (0, 5.4), "theta": limits},
        ).density * (limits[1] - limits[0])
        for limits in ((0.0, 2.0), (2.0, 2 * np.pi))
    ]  # fmt: skip
    np.testing.assert_allclose(
        parts[0] + parts[1], 2 * np.pi * f.density.sel(r=parts[0].r, method="nearest"), atol=1e-2
    )


def test_profiles_weight_rings_by_their_area():
    f = grains_along_z().cg.coarse_grain(
        ["density", "velocity", "momentum_density"], frame=xcg.Cylindrical(origin=(2.5, 2.5, 0)), axes="rz",
        bounds={"r": (0, 2.4)}, spacing=0.3, width=0.5,
    )  # fmt: skip
    p = xcg.profile(f, "z")
    want = (f.density * f.r).sum("r") / f.r.sum()
    np.testing.assert_allclose(p.density, want)
    momentum = (f.momentum_density * f.r).isel(r=slice(1, None)).sum("r", skipna=False) / f.r.sum()
    np.testing.assert_allclose(p.velocity, momentum / want)
    across = xcg.profile(f, "r")
    np.testing.assert_allclose(across.density, f.density.mean("z"))


# --- fluctuations ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("axes", ["r", "rz"])
def test_temperatures_of_rings_are_without_bias(axes):
    """Noise on a rigid rotation is found again, near the axis too, where grains see themselves on the ring."""
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        still = rotating()
        ds = still.assign(velocity=still.velocity + 0.1 * rng.normal(size=still.velocity.shape))
        f = ds.cg.coarse_grain(
            "granular_temperature", frame=xcg.Cylindrical(origin=(1, 2, 3)), axes=axes, width=0.45, spacing=0.4,
            bounds={"r": (0.0, 2.0)} | ({"z": (-2.0, 2.0)} if axes == "rz" else {}),
            extent={} if axes == "rz" else {"z": 6},
        )  # fmt: skip
        found.append(f.granular_temperature.mean("z") if axes == "rz" else f.granular_temperature)
    mean = xr.concat(found, "seed").mean("seed")[0] / 0.01
    np.testing.assert_allclose(mean, 1.0, atol=0.08)


@pytest.mark.filterwarnings("ignore:.*so that in a single step pressure lacks")
@pytest.mark.parametrize("axes", ["rz", "rtz"])
def test_averages_on_the_axis_have_no_pressure_that_lacks_the_velocity(axes):
    """Of a gas the pressure of averages is rho T; on the axis of a mesh with theta the velocity is not known."""
    f = truths.gas(16).cg.coarse_grain(
        ["pressure", "density"], frame=xcg.Cylindrical(origin=(6, 6, 0)), axes=axes, width=1.5, spacing=1.5,
        bounds={"r": (0.0, 3.0)} | ({"theta": (0.0, 6.0)} if axes == "rtz" else {}),
    )  # fmt: skip
    mean = f.cg.time_average()
    ratio = (mean.pressure / mean.density).mean([dim for dim in mean.pressure.dims if dim != "r"])
    np.testing.assert_allclose(ratio[1:], 1.0, atol=0.05)
    if axes == "rtz":
        assert np.isnan(ratio[0])
    else:
        assert float(ratio[0]) == pytest.approx(1.0, abs=0.1)


def test_large_velocities_leave_small_fluctuations():
    """References at all angles are brought together before squares are summed."""
    fast = rotating()
    slow = rotating(noise=1e-4)
    options = {
        "frame": xcg.Cylindrical(origin=(1, 2, 3)), "axes": "r", "width": 0.5, "bounds": {"r": (0.5, 2)},
        "extent": {"z": 6.0}, "spacing": 0.5,
    }  # fmt: skip
    noise = slow.velocity - fast.velocity
    names = ["granular_temperature"]
    alone = slow.assign(velocity=noise).cg.coarse_grain(names, **options)
    boosted = slow.assign(velocity=noise + 1e2 * fast.velocity).cg.coarse_grain(names, **options)
    np.testing.assert_allclose(boosted.granular_temperature, alone.granular_temperature, rtol=1e-3)


# --- phases, own variables, lazy scenes ------------------------------------------------------------------


def test_phases_own_variables_and_time_averages():
    ds = grains_along_z().assign(
        charge=grains_along_z().diameter * 2.0, pull=grains_along_z().velocity * 3.0
    )
    options = {
        "frame": xcg.Cylindrical(origin=(2.5, 2.5, 0)), "axes": "r", "width": 0.6, "bounds": {"r": (0.4, 2.0)},
        "spacing": 0.4,
    }  # fmt: skip
    f = ds.cg.coarse_grain([*SUMS, "granular_temperature"], by="species", **options)
    parts = f.sel(phase=["1", "2"])
    for name in SUMS:
        if "phase" in f[name].dims:
            np.testing.assert_allclose(
                parts[name].sum("phase"), f[name].sel(phase="bulk"), atol=1e-9, err_msg=name
            )
    g = ds.cg.coarse_grain(
        ["charge", "pull", xcg.Variance("charge"), xcg.Variance("pull"), "velocity"], **options
    )
    np.testing.assert_allclose(g.pull, 3 * g.velocity, rtol=1e-9, atol=1e-9)
    square = ds.assign(square=ds.charge**2).cg.coarse_grain("square", **options).square
    np.testing.assert_allclose(g.variance_charge, square - g.charge**2, rtol=1e-7)
    assert g.variance_pull.dims == ("time", "r", "component")
    with pytest.raises(ValueError, match="not there in a cylindrical frame"):
        ds.cg.coarse_grain(xcg.Flux("charge"), **options)
    two = xr.concat([ds, ds.assign_coords(time=[1.0])], "time", data_vars="all")
    mean = two.cg.coarse_grain(["velocity", "density"], **options).cg.time_average()
    np.testing.assert_allclose(mean.velocity, g.velocity[0], rtol=1e-9)


def test_lazy_results_on_rings_equal_eager_ones(tmp_path):
    ds = grains_along_z()
    ds.cg.save(tmp_path / "scene.nc")
    lazy = xr.open_dataset(tmp_path / "scene.nc", chunks={"time": 1})
    options = {
        "frame": xcg.Cylindrical("z", origin=(2.5, 2.5, 0)),
        "axes": "rz",
        "bounds": {"r": (0, 2.0)},
    }
    f = lazy.cg.coarse_grain(["stress", "density"], **options)
    assert f.density.chunks is not None
    g = ds.cg.coarse_grain(["stress", "density"], **options)
    for name in g.data_vars:
        np.testing.assert_allclose(f[name], g[name], atol=1e-10 * float(np.abs(g[name]).max()))
    assert f.z.size == round(5.0 / (0.75 * ds.attrs["d43"]))  # nodes divide the period


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"axes": "rx"}, "the axes of this scene are r, t, z"),
        ({"axes": "z"}, "takes r"),
        ({"axes": "r", "at": {"r": 1.0}}, "either resolved or fixed"),
        ({"axes": "r", "bounds": {"z": (0, 1)}}, r"bounds are given for \['z'\]"),
        ({"axes": "r", "bounds": {"r": (-1, 1)}}, "none below zero"),
        ({"axes": "r", "bounds": {"theta": (0, 7)}}, "at most a circle"),
        ({"axes": "r", "at": {"x": 1.0}}, "at names"),
        ({"axes": "r", "gradient": "finite_difference"}, "leave it out"),
        ({"at": {"r": xr.DataArray([1.0], dims="p")}}, "name points"),
    ],
)
def test_meaningless_requests_raise(given, message):
    with pytest.raises(ValueError, match=message):
        grains_along_z().cg.coarse_grain(["velocity_gradient"], frame=xcg.Cylindrical(), **given)


def test_wrong_frames_raise():
    for given in (
        {"axis": "w"},
        {"axis": (0, 0, 0)},
        {"error": 0.0},
        {"axis": "z", "x": (0, 0, 1)},
    ):
        with pytest.raises(ValueError, match=r"expected|parallel"):
            xcg.Cylindrical(**given)
    for call in ("balance", "width_sweep"):
        with pytest.raises(ValueError, match="Cartesian axes"):
            getattr(grains_along_z().cg, call)(
                frame=xcg.Cylindrical(), **({"widths": [1, 2, 3]} if call == "width_sweep" else {})
            )


@pytest.mark.parametrize("axes", ["rz", "rtz"])
def test_on_the_axis_the_part_along_it_is_that_of_cartesian_axes(axes):
    ds = grains_along_z()
    options = {"width": 1.0, "spacing": {"r": 0.5, "theta": 1.0, "z": 1.0}}
    names = ["velocity", "stress", *SUMS]
    frame = xcg.Cylindrical("z", origin=(2.5, 2.2, 0))
    f = ds.cg.coarse_grain(names, axes=axes, frame=frame, bounds={"r": (0, 0.5)}, **options)
    on_axis = f.sel(r=0)
    cartesian = ds.cg.coarse_grain(names, axes="z", at={"x": 2.5, "y": 2.2}, width=1.0, spacing=1.0)
    for name in names:
        along = {dim: "z" for dim in ("component", "direction") if dim in f[name].dims}
        want = cartesian[name].sel(along, drop=True)
        found = on_axis[name].sel(along, drop=True)
        np.testing.assert_allclose(*xr.broadcast(found, want), atol=1e-12 * float(abs(want).max()))
        if along:
            known = on_axis[name].notnull().sum([*along])
            np.testing.assert_array_equal(known, 1)
    assert f.sel(r=0.5).notnull().all()


@pytest.mark.parametrize(
    "options", [{"origin": (1000, 2, 0)}, {"axis": "x", "origin": (0, 2, -900)}]
)
def test_an_axis_far_from_the_particles_is_named(options):
    ds = xcg.datasets.simple_cubic(4)
    call = partial(ds.cg.coarse_grain, "density", axes="r", width=0.5)
    with pytest.raises(ValueError, match=r"axis of the cylinder is 9\d\d(\.\d)? m .*origin="):
        call(frame=xcg.Cylindrical(**options))
    call(frame=xcg.Cylindrical(origin=(-9, 2, 0)))  # of a part of a ring
