"""Variants of fields that arguments of coarse_grain choose: gradients, temperatures, pressures, sizes, fluids."""

from typing import get_args

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.brute_force import BruteKernel
from xcg.fields.formulas.field import Gradient

RATE = np.array([[0.3, 1.0, -0.4], [0.1, -0.2, 0.5], [0.0, 0.7, -0.1]])
INSIDE = {"bounds": dict.fromkeys("xyz", (1.5, 3.5)), "width": 0.6, "spacing": 0.5}


def linear_flow(particles=400, seed=0, noise=0.0):
    """Random grains that move as v = RATE x (+ noise), not periodic."""
    ds = xcg.datasets.random_scene(particles, seed=seed, periodic="")
    v = np.einsum("ij,tpj->tpi", RATE, ds.position.values)
    v += noise * np.random.default_rng(seed).normal(size=v.shape)
    return ds.assign(velocity=ds.velocity.copy(data=v))


def around(ds, f, width):
    """Weights m Psi, offsets and velocities of the grains at each node, by brute force."""
    kernel = BruteKernel("lucy", width)
    x, v, m = (ds[n].values[0] for n in ("position", "velocity", "mass"))
    for node in np.stack(np.meshgrid(f.x, f.y, f.z, indexing="ij"), axis=-1).reshape(-1, 3):
        w = m * kernel(np.linalg.norm(x - node, axis=1))
        yield w[w > 0], (x - node)[w > 0], v[w > 0]


def test_least_squares_is_exact_in_linear_flow_and_the_paper_s_is_not():
    ds = linear_flow()
    errors = {}
    for gradient in get_args(Gradient):
        f = ds.cg.coarse_grain(["velocity_gradient", "granular_temperature"], gradient=gradient, **INSIDE)
        errors[gradient] = np.abs(f.velocity_gradient.values - RATE).max()
        if gradient == "least_squares":
            assert float(f.granular_temperature.max()) < 1e-14  # rounding of (rate width)^2
        else:
            assert float(f.granular_temperature.max()) > 1e-8
    assert errors["least_squares"] < 1e-12
    assert 1e-3 < errors["paper"] < errors["kernel"]
    # in linear flow the way about r leaves about a hundredth, the kernel's about a tenth
    f = ds.cg.coarse_grain("velocity_gradient", gradient="paper", **INSIDE)
    assert 1e-3 < float(np.median(np.abs(f.velocity_gradient.values - RATE))) < 5e-2


@pytest.mark.parametrize("about_node", [False, True])
def test_fits_are_those_of_lapack(about_node):
    ds = linear_flow(seed=1, noise=0.5)
    gradient = "paper" if about_node else "least_squares"
    names = ["velocity_gradient", "granular_temperature", "directional_temperature"]
    f = ds.cg.coarse_grain(names, gradient=gradient, temperature="biased", **INSIDE).isel(time=0)
    got = [f[n].values.reshape(-1, *f[n].shape[3:]) for n in names]
    for n, (w, x, v) in enumerate(around(ds, f, 0.6)):
        mean = (w @ v) / w.sum()
        offset = x if about_node else x - (w @ x) / w.sum()
        root = np.sqrt(w)[:, None]
        fit = np.linalg.lstsq(root * offset, root * (v - mean), rcond=None)[0].T
        np.testing.assert_allclose(got[0][n], fit, rtol=1e-9, atol=1e-9)
        rest = v - mean - offset @ fit.T
        along = (w @ rest**2) / w.sum()
        np.testing.assert_allclose(got[2][n], along, rtol=1e-9)
        np.testing.assert_allclose(got[1][n], along.mean(), rtol=1e-9)


def test_kernel_and_finite_difference_temperatures_by_brute_force():
    ds = linear_flow(seed=2, noise=0.5)
    for gradient in ("kernel", "finite_difference"):
        options = {"gradient": gradient, "temperature": "biased", **INSIDE}
        f = ds.cg.coarse_grain(["velocity_gradient", "granular_temperature"], **options).isel(time=0)
        slopes, temperature = f.velocity_gradient.values.reshape(-1, 3, 3), f.granular_temperature.values.ravel()
        for n, (w, x, v) in enumerate(around(ds, f, 0.6)):
            rest = v - (w @ v) / w.sum() - (x - (w @ x) / w.sum()) @ slopes[n].T
            np.testing.assert_allclose(temperature[n], (w @ rest**2).sum() / w.sum() / 3, rtol=1e-9)


def test_finite_differences_tend_to_the_kernel_gradient():
    ds = linear_flow(seed=3, noise=0.5)
    errors = []
    for h in (0.04, 0.02):
        options = {"width": 0.6, "spacing": h, "bounds": dict.fromkeys("xyz", (2.5 - 2 * h, 2.5 + 2 * h))}
        near, exact = (
            ds.cg.coarse_grain("velocity_gradient", gradient=g, **options).velocity_gradient.isel(time=0)
            for g in ("finite_difference", "kernel")
        )
        errors.append(float(np.abs(near - exact).max()))
    assert errors[0] < 0.05 * float(np.abs(exact).max())
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.25)  # second order, also at the ends


def test_finite_differences_wrap_around_a_period():
    ds = xcg.datasets.random_scene(800, periodic="xyz", seed=4)
    f = ds.cg.coarse_grain(["velocity", "velocity_gradient"], gradient="finite_difference", width=0.9, spacing=0.5)
    v = f.velocity.isel(time=0)
    slope = (v.roll(x=-1) - v.roll(x=1)) / (2 * float(f.x[1] - f.x[0]))
    got = f.velocity_gradient.isel(time=0).sel(direction="x")
    np.testing.assert_allclose(got.values, slope.values, rtol=1e-12, atol=1e-12)


def test_finite_differences_know_nothing_across_a_plane_and_zero_along_an_average():
    ds = linear_flow(seed=5)
    options = {"gradient": "finite_difference", "width": 0.6, "spacing": 0.5, "axes": "xz"}
    options["bounds"] = dict.fromkeys("xz", (1.5, 3.5))
    names = ["velocity_gradient", "granular_temperature"]
    cut = ds.cg.coarse_grain(names, at={"y": 2.5}, **options)
    assert np.isnan(cut.velocity_gradient.sel(direction="y")).all()
    assert np.isfinite(cut.velocity_gradient.sel(direction=["x", "z"])).all()
    assert np.isnan(cut.granular_temperature).all()  # fluctuations about an unknown slope are unknown
    mean = ds.cg.coarse_grain(names, **options)
    assert (mean.velocity_gradient.sel(direction="y") == 0).all()
    assert np.isfinite(mean.granular_temperature).all()


# --- pressures, planes, magnitudes -----------------------------------------------------------------------


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
@pytest.mark.parametrize("deviatoric", ["stress", "rate", "both", "neither"])
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
    np.testing.assert_allclose(f.deviatoric_stress.values[..., rows, :][..., rows], both["stress"][1], atol=1e-12)
    other = 3 - sum(rows)
    assert (f.deviatoric_stress.values[..., other, :] == 0).all()


def test_size_in_the_inertial_number():
    scene = xcg.datasets.random_scene(150, seed=6)
    ones = {}
    for size in ("d43", "d32", "d50", "dmax"):
        f = whole_and(size=size)
        d = f[size] if size in f else scene.attrs[size]
        ones[size] = (f.inertial_number / d).values
        assert f.attrs["size"] == size
    for size in ("d32", "d50", "dmax"):
        np.testing.assert_allclose(ones[size], ones["d43"], rtol=1e-12)


def test_viscous_number_and_effective_viscosity():
    ds = xcg.datasets.random_scene(150, seed=6)
    names = ["viscous_number", "effective_viscosity", "shear_rate", "pressure", "shear_stress"]
    f = ds.cg.coarse_grain(names, width=0.9, spacing=1.3, fluid_viscosity=2e-3)
    firm = f.pressure > 0
    assert firm.any()
    np.testing.assert_allclose(f.viscous_number, (2e-3 * f.shear_rate / f.pressure).where(firm), rtol=1e-12)
    np.testing.assert_allclose(f.effective_viscosity, (f.shear_stress / (2e-3 * f.shear_rate)).where(firm), rtol=1e-12)
    assert "viscous_number" not in ds.cg.coarse_grain(width=0.9, spacing=1.3)
    with pytest.raises(ValueError, match="needs the argument fluid_viscosity="):
        ds.cg.coarse_grain("viscous_number")


def test_rheology_is_unknown_where_the_pressure_is_not_positive():
    ds = xcg.datasets.random_scene(150, seed=6)
    names = ["viscous_number", "effective_viscosity", "inertial_number", "friction_coefficient", "pressure"]
    f = ds.assign(contact_force=1e5 * ds.contact_force).cg.coarse_grain(
        names, width=0.9, spacing=1.3, fluid_viscosity=2e-3
    )
    tension = f.pressure <= 0
    assert 0 < int(tension.sum()) < tension.size
    for name in names[:-1]:
        np.testing.assert_array_equal(np.isnan(f[name]), tension, err_msg=name)


def test_directional_temperatures_of_a_layer():
    ds = xcg.datasets.random_scene(150, periodic="", dimension=2, seed=7)
    f = ds.cg.coarse_grain(["granular_temperature", "directional_temperature"], width=0.9, spacing=1.0)
    known = f.granular_temperature.notnull()
    two = f.directional_temperature.sel(component=["x", "y"]).mean("component")
    xr.testing.assert_allclose(two.where(known), f.granular_temperature)
    assert np.abs(f.directional_temperature.sel(component="z").where(known, 0)).max() < 1e-12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pressure_dims": "xq"}, "pressure_dims='xq': expected some of the scene's axes 'xyz'"),
        ({"shear_dims": "xx"}, "each once"),
        ({"shear_dims": ""}, "expected some of"),
        ({"deviatoric": True}, "expected one of stress, rate, both, neither"),
        ({"size": "d10"}, "expected one of d43, d32, d50, dmax"),
        ({"fluid_viscosity": 0.0}, "positive viscosity"),
        ({"gradient": "fd"}, "least_squares, kernel, finite_difference, paper"),
    ],
)
def test_bad_variants(options, message):
    with pytest.raises(ValueError, match=message):
        xcg.datasets.random_scene(20).cg.coarse_grain(**options)


def test_width_in_any_size():
    ds = xcg.datasets.random_scene(60)
    d = ds.diameter.values[0]
    expected = {
        "d43": (d**4).sum() / (d**3).sum(), "d32": (d**3).sum() / (d**2).sum(), "drms": np.sqrt((d**2).mean()),
        "dmax": d.max(), "dmin": d.min(),
    }  # fmt: skip
    for size, value in expected.items():
        assert ds.cg.explain("density", width=f"0.5 {size}").kernel.width == pytest.approx(0.5 * value, rel=1e-12)
