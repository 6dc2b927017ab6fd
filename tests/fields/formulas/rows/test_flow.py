"""Velocity gradients and temperatures: the choices of coarse_grain, and gradients along averaged axes."""

import warnings
from typing import get_args

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.brute_force import BruteKernel
from xcg import SceneWarning
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


def test_only_least_squares_is_exact_in_linear_flow():
    ds = linear_flow()
    errors = {}
    for gradient in get_args(Gradient):
        f = ds.cg.coarse_grain(
            ["velocity_gradient", "granular_temperature"], gradient=gradient, **INSIDE
        )
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
def test_fits_equal_those_of_lapack(about_node):
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
        f = ds.cg.coarse_grain(["velocity_gradient", "granular_temperature"], **options).isel(
            time=0
        )
        slopes = f.velocity_gradient.values.reshape(-1, 3, 3)
        temperature = f.granular_temperature.values.ravel()
        for n, (w, x, v) in enumerate(around(ds, f, 0.6)):
            rest = v - (w @ v) / w.sum() - (x - (w @ x) / w.sum()) @ slopes[n].T
            np.testing.assert_allclose(temperature[n], (w @ rest**2).sum() / w.sum() / 3, rtol=1e-9)


def test_finite_differences_tend_to_the_kernel_gradient():
    ds = linear_flow(seed=3, noise=0.5)
    errors = []
    for h in (0.04, 0.02):
        options = {
            "width": 0.6,
            "spacing": h,
            "bounds": dict.fromkeys("xyz", (2.5 - 2 * h, 2.5 + 2 * h)),
        }
        near, exact = (
            ds.cg.coarse_grain("velocity_gradient", gradient=g, **options).velocity_gradient.isel(
                time=0
            )
            for g in ("finite_difference", "kernel")
        )
        errors.append(float(np.abs(near - exact).max()))
    assert errors[0] < 0.05 * float(np.abs(exact).max())
    assert errors[1] == pytest.approx(errors[0] / 4, rel=0.25)  # second order, also at the ends


def test_finite_differences_wrap_around_a_period():
    ds = xcg.datasets.random_scene(800, periodic="xyz", seed=4)
    f = ds.cg.coarse_grain(
        ["velocity", "velocity_gradient"], gradient="finite_difference", width=0.9, spacing=0.5
    )
    v = f.velocity.isel(time=0)
    slope = (v.roll(x=-1) - v.roll(x=1)) / (2 * float(f.x[1] - f.x[0]))
    got = f.velocity_gradient.isel(time=0).sel(direction="x")
    np.testing.assert_allclose(got.values, slope.values, rtol=1e-12, atol=1e-12)


def test_finite_differences_are_nan_across_a_plane_and_zero_along_an_average():
    ds = linear_flow(seed=5)
    options = {"gradient": "finite_difference", "width": 0.6, "spacing": 0.5, "axes": "xz"}
    options["bounds"] = dict.fromkeys("xz", (1.5, 3.5))
    names = ["velocity_gradient", "granular_temperature"]
    cut = ds.cg.coarse_grain(names, at={"y": 2.5}, **options)
    assert np.isnan(cut.velocity_gradient.sel(direction="y")).all()
    assert np.isfinite(cut.velocity_gradient.sel(direction=["x", "z"])).all()
    assert np.isnan(
        cut.granular_temperature
    ).all()  # fluctuations about an unknown slope are unknown
    mean = ds.cg.coarse_grain(names, **options)
    assert (mean.velocity_gradient.sel(direction="y") == 0).all()
    assert np.isfinite(mean.granular_temperature).all()


# --- layers, and choices that are refused ----------------------------------------------------------------


def test_directional_temperatures_of_a_layer():
    ds = xcg.datasets.random_scene(150, periodic="", dimension=2, seed=7)
    f = ds.cg.coarse_grain(
        ["granular_temperature", "directional_temperature"], width=0.9, spacing=1.0
    )
    known = f.granular_temperature.notnull()
    two = f.directional_temperature.sel(component=["x", "y"]).mean("component")
    xr.testing.assert_allclose(two.where(known), f.granular_temperature)
    assert np.abs(f.directional_temperature.sel(component="z").where(known, 0)).max() < 1e-12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"pressure_dims": "xq"},
            r"pressure_dims names \['q'\]: the axes of this scene are x, y, z",
        ),
        ({"shear_dims": "xx"}, "names an axis twice"),
        ({"shear_dims": ""}, "expected axes such as"),
        ({"deviatoric": "neither"}, "expected one of 'both', 'stress', 'rate'"),
        ({"size": "d10"}, "expected one of 'd43', 'd32', 'd50', 'dmax'"),
        ({"fluid_viscosity": 0.0}, r"expected a positive number \(Pa s\)"),
        ({"gradient": "fd"}, "'least_squares', 'kernel', 'finite_difference', 'paper'"),
    ],
)
def test_wrong_choices_raise(options, message):
    with pytest.raises(ValueError, match=message):
        xcg.datasets.random_scene(20).cg.coarse_grain(**options)


def test_widths_in_units_of_any_mean_diameter():
    ds = xcg.datasets.random_scene(60)
    d = ds.diameter.values[0]
    expected = {
        "d43": (d**4).sum() / (d**3).sum(), "d32": (d**3).sum() / (d**2).sum(), "drms": np.sqrt((d**2).mean()),
        "dmax": d.max(), "dmin": d.min(),
    }  # fmt: skip
    for size, value in expected.items():
        assert ds.cg.explain("density", width=f"0.5 {size}").kernel.width == pytest.approx(
            0.5 * value, rel=1e-12
        )


# --- gradients along averaged axes -----------------------------------------------------------------------

EDGE, SHEAR = 6.0, 0.37
FLOW = ["velocity", "velocity_gradient", "shear_rate", "granular_temperature", "kinetic_stress"]


def sheared(noise=0.0, wrapped=False):
    """Grains in a linear shear between images that move; those written another period further on have its velocity."""
    rng = np.random.default_rng(0)
    position = rng.uniform(0, EDGE, (400, 3))
    if wrapped:
        position[:, 1] += EDGE * rng.integers(-1, 2, len(position))
    velocity = noise * np.random.default_rng(5).normal(size=(400, 3)) + 0.4
    velocity[:, 0] += SHEAR * position[:, 1]
    return xcg.scene_from_arrays(
        position, velocity=velocity, diameter=np.full(400, 0.5), density=1.0, box=[[0, EDGE]] * 3, periodic="xyz",
        lattice={"xy": 0.0}, shear_rate={"xy": SHEAR},
    )  # fmt: skip


@pytest.mark.parametrize("lazy", [False, True], ids=["eager", "lazy"])
@pytest.mark.parametrize("axes", ["", "x", "z", "xz", "y"])
def test_the_gradient_of_a_sheared_box_is_its_shear_rate(axes, lazy):
    ds = sheared(wrapped=axes != "y")
    f = (ds.chunk(time=1) if lazy else ds).cg.coarse_grain(FLOW, axes=axes).compute()
    expected = np.zeros((3, 3))
    expected[0, 1] = SHEAR
    np.testing.assert_allclose(
        f.velocity_gradient, np.broadcast_to(expected, f.velocity_gradient.shape), atol=1e-13
    )
    np.testing.assert_allclose(f.shear_rate, SHEAR, rtol=1e-12)
    assert float(f.granular_temperature.max()) < 1e-15
    if "y" not in axes:
        assert float(abs(f.kinetic_stress).max()) < 1e-25
        np.testing.assert_allclose(
            f.velocity.sel(component="x"), 0.4 + SHEAR * EDGE / 2, rtol=1e-12
        )


def test_images_of_a_box_of_several_tilts_follow_the_gradient():
    """An image along c is further up y by the tilt yz, and moves as the flow there."""
    edges = np.array([[EDGE, 0, 0], [1.1, EDGE, 0], [0.4, -2, EDGE]])
    position = np.random.default_rng(0).random((400, 3)) @ edges
    ds = xcg.scene_from_arrays(
        position, velocity=SHEAR * position[:, [1, 1, 1]] * [1, 0, 0], diameter=np.ones(400), density=1.0,
        box=[[0, EDGE]] * 3, periodic="xyz", lattice={"xy": 1.1, "xz": 0.4, "yz": -2.0}, shear_rate={"xy": SHEAR},
    )  # fmt: skip
    f = ds.cg.coarse_grain(FLOW, width=0.9, spacing=1.0)
    assert float(f.granular_temperature.max()) < 1e-14
    np.testing.assert_allclose(
        f.velocity_gradient.sel(component="x", direction="y"), SHEAR, rtol=1e-10
    )


@pytest.mark.parametrize("axes", ["", "xz"])
def test_gradients_do_not_depend_on_the_written_images(axes):
    one, other = (
        sheared(noise=0.2, wrapped=w).cg.coarse_grain(FLOW, axes=axes) for w in (False, True)
    )
    for name in FLOW:
        np.testing.assert_allclose(one[name], other[name], rtol=1e-10, atol=1e-12)
    assert float(one.granular_temperature.mean()) == pytest.approx(0.04, rel=0.1)


def test_the_gradient_of_a_periodic_box_at_rest_is_zero():
    ds = xcg.datasets.random_scene(50)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        f = ds.cg.coarse_grain(["velocity_gradient", "inertial_number"], axes="")
    assert not f.velocity_gradient.any()
    assert (f.inertial_number == 0).all()


@pytest.mark.parametrize("lazy", [False, True], ids=["eager", "lazy"])
@pytest.mark.parametrize("gradient", ["least_squares", "kernel"])
def test_the_gradient_averaged_between_walls_is_nan_and_warns(gradient, lazy):
    ds = xcg.datasets.random_scene(50, periodic="xy")
    ds = ds.chunk(time=1) if lazy else ds
    names = ["velocity_gradient", "shear_rate", "vorticity", "inertial_number", "pressure"]
    with pytest.warns(
        SceneWarning, match=r"shear_rate, vorticity, inertial_number: NaN, .* axes='z'"
    ) as told:
        f = ds.cg.coarse_grain(names, axes="", extent={"z": 5.0}, gradient=gradient).compute()
    assert len(told) == 1
    for name in names[:4]:
        assert f[name].isnull().all()
    assert f.pressure.notnull().all()


def test_fields_without_a_gradient_do_not_warn():
    ds = xcg.datasets.random_scene(50, periodic="xy")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        f = ds.cg.coarse_grain(["stress", "granular_temperature"], axes="", extent={"z": 5.0})
    assert np.isfinite(f.granular_temperature).all()
