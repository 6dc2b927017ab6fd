"""Pressures, magnitudes and dimensionless numbers, from their definitions."""

import numpy as np
import pytest

import xcg


def whole_and(**options):
    ds = xcg.datasets.random_scene(150, seed=6)
    names = ["stress", "pressure", "deviatoric_stress", "shear_stress", "shear_rate_tensor", "shear_rate",
             "friction_coefficient", "inertial_number", "particle_density", "d43", "d32"]  # fmt: skip
    return ds.cg.coarse_grain(names, width=0.9, spacing=1.3, **options).isel(time=0)


@pytest.mark.parametrize("dims", ["x", "z", "xy", "xz", "yz", "xyz"])
def test_pressure_of_some_normal_stresses(dims):
    f = whole_and(pressure_dims=dims)
    expected = sum(f.stress.sel(component=a, direction=a) for a in dims) / len(dims)
    np.testing.assert_allclose(f.pressure, expected, rtol=1e-12)
    mu = (f.shear_stress / f.pressure).where(f.pressure > 0)
    np.testing.assert_allclose(f.friction_coefficient, mu, rtol=1e-12)
    assert f.attrs["pressure_dims"] == dims


@pytest.mark.parametrize("dims", ["xy", "xz", "yz"])
@pytest.mark.parametrize("deviatoric", ["stress", "rate", "both"])
def test_magnitudes_in_a_plane(dims, deviatoric):
    f = whole_and(shear_dims=dims, deviatoric=deviatoric)
    rows = ["xyz".index(a) for a in dims]
    both = {}
    for name in ("stress", "shear_rate_tensor"):
        part = f[name].values[..., rows, :][..., rows]
        half = (part[..., 0, 0] + part[..., 1, 1])[..., None, None] / 2 * np.eye(2)
        both[name] = part, part - half
    s = both["stress"][deviatoric in ("stress", "both")]
    g = both["shear_rate_tensor"][deviatoric in ("rate", "both")]
    np.testing.assert_allclose(f.shear_stress, np.sqrt((s**2).sum((-1, -2)) / 2), rtol=1e-12)
    np.testing.assert_allclose(f.shear_rate, np.sqrt(2 * (g**2).sum((-1, -2))), rtol=1e-12)
    np.testing.assert_allclose(
        f.deviatoric_stress.values[..., rows, :][..., rows], both["stress"][1], atol=1e-12
    )
    other = 3 - sum(rows)
    assert (f.deviatoric_stress.values[..., other, :] == 0).all()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("options", [{}, {"axes": "xz", "at": {"y": 0.1}}])
def test_the_shear_rate_of_compression_is_zero_and_of_simple_shear_its_rate(dimension, options):
    rng = np.random.default_rng(2)
    position = rng.uniform(-2, 2, (1500, 3))
    where = {}
    if dimension == 2:
        position[:, 1] = 0.0
        where = {"dimension": 2, "plane": "xz"}
        options = {key: value for key, value in options.items() if key == "axes"}
    rate = 0.1
    expected = {"compression": 0.0, "shear": rate}
    flows = {"compression": -rate * position, "shear": rate * position[:, [2, 1, 0]] * [1, 0, 0]}
    if dimension == 2:
        flows["compression"][:, 1] = 0.0
    for name, velocity in flows.items():
        ds = xcg.scene_from_arrays(
            position, velocity=velocity, diameter=np.full(1500, 0.3), density=1.0, **where
        )
        axes = options.get("axes", ds.attrs["plane"])
        bounds = dict.fromkeys(axes, (-1.0, 1.0))
        f = ds.cg.coarse_grain("shear_rate", width=0.6, spacing=0.5, bounds=bounds, **options)
        np.testing.assert_allclose(f.shear_rate, expected[name], atol=1e-12)
        whole = ds.cg.coarse_grain(
            "shear_rate", width=0.6, spacing=0.5, bounds=bounds, deviatoric="stress", **options
        )
        of_trace = np.sqrt(2 * dimension) * rate
        np.testing.assert_allclose(
            whole.shear_rate, {"compression": of_trace, "shear": rate}[name], rtol=1e-9
        )


@pytest.mark.parametrize("dims", [None, "xz", "yx", "zy"])
def test_normal_stress_differences_are_those_of_flow_gradient_and_vorticity(dims):
    """Compression is positive: N1 = T_ff - T_gg of tensile stresses T = -sigma."""
    ds = xcg.datasets.random_scene(150, seed=6)
    names = ["stress", "first_normal_stress_difference", "second_normal_stress_difference"]
    f = ds.cg.coarse_grain(names, width=0.9, spacing=1.3, shear_dims=dims)
    flow, gradient = dims or "xz"
    (vorticity,) = set("xyz") - {flow, gradient}
    tension = {a: -f.stress.sel(component=a, direction=a) for a in "xyz"}
    first = tension[flow] - tension[gradient]
    second = tension[gradient] - tension[vorticity]
    np.testing.assert_allclose(f.first_normal_stress_difference, first, rtol=1e-12)
    np.testing.assert_allclose(f.second_normal_stress_difference, second, rtol=1e-12)


def test_a_layer_has_no_second_normal_stress_difference():
    ds = xcg.datasets.open("biaxial").isel(time=[-1])
    names = ["stress", "first_normal_stress_difference", "second_normal_stress_difference"]
    f = ds.cg.coarse_grain(names, axes="").isel(time=0)
    x, y = (f.stress.sel(component=a, direction=a) for a in "xy")
    np.testing.assert_allclose(f.first_normal_stress_difference, y - x, rtol=1e-12)
    assert f.second_normal_stress_difference.isnull()


def test_the_inertial_number_takes_the_chosen_size():
    scene = xcg.datasets.random_scene(150, seed=6)
    ones = {}
    for size in ("d43", "d32", "d50", "dmax"):
        f = whole_and(size=size)
        d = f[size] if size in f else scene.attrs[size]
        ones[size] = (f.inertial_number / d).values
        assert f.attrs["size"] == size
    for size in ("d32", "d50", "dmax"):
        np.testing.assert_allclose(ones[size], ones["d43"], rtol=1e-12)


def test_viscous_number_and_relative_viscosity():
    ds = xcg.datasets.random_scene(150, seed=6)
    names = ["viscous_number", "relative_viscosity", "shear_rate", "pressure", "shear_stress"]
    f = ds.cg.coarse_grain(names, width=0.9, spacing=1.3, fluid_viscosity=2e-3)
    firm = f.pressure > 0
    assert firm.any()
    np.testing.assert_allclose(
        f.viscous_number, (2e-3 * f.shear_rate / f.pressure).where(firm), rtol=1e-12
    )
    np.testing.assert_allclose(
        f.relative_viscosity, (f.shear_stress / (2e-3 * f.shear_rate)).where(firm), rtol=1e-12
    )
    assert "viscous_number" not in ds.cg.coarse_grain(width=0.9, spacing=1.3)
    with pytest.raises(ValueError, match="needs the argument fluid_viscosity="):
        ds.cg.coarse_grain("viscous_number")


def test_the_granular_viscosity_is_the_relative_one_times_that_of_the_fluid():
    names = ["granular_viscosity", "relative_viscosity", "shear_stress", "shear_rate", "pressure"]
    ds = xcg.datasets.random_scene(150, seed=6)
    f = ds.cg.coarse_grain(names, width=0.9, spacing=1.3, fluid_viscosity=2e-3)
    viscosity = f.granular_viscosity
    assert viscosity.attrs["units"] == "Pa s"
    np.testing.assert_allclose(viscosity, f.shear_stress / f.shear_rate, rtol=1e-12)
    firm = f.pressure > 0
    np.testing.assert_allclose(viscosity.where(firm), 2e-3 * f.relative_viscosity, rtol=1e-12)


def test_rheology_is_nan_where_the_pressure_is_not_positive():
    ds = xcg.datasets.random_scene(150, seed=6)
    names = [
        "viscous_number",
        "relative_viscosity",
        "inertial_number",
        "friction_coefficient",
        "pressure",
    ]
    f = ds.assign(contact_force=1e5 * ds.contact_force).cg.coarse_grain(
        names, width=0.9, spacing=1.3, fluid_viscosity=2e-3
    )
    tension = f.pressure <= 0
    assert 0 < int(tension.sum()) < tension.size
    for name in names[:-1]:
        np.testing.assert_array_equal(np.isnan(f[name]), tension, err_msg=name)
