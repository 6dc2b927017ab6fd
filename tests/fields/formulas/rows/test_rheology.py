"""Pressures, magnitudes and dimensionless numbers, from their definitions."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import xcg
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.rows import rheology

ROOT = Path(__file__).parents[4]


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


def angle_of(name, options=None, **tensors):
    return xcg.FIELDS[name].compute(SimpleNamespace(**tensors), None, options or Options())


@pytest.mark.parametrize(("principal", "degrees"), [
    ((5.0, 2.0, 2.0), 0.0), ((5.0, 5.0, 2.0), 60.0), ((3.0, 2.0, 1.0), 30.0), ((1.0, 0.0, -1.0), 30.0),
    ((-1.0, -2.0, -2.0), 0.0), ((2.0, 2.0, 2.0), np.nan), ((0.0, 0.0, 0.0), np.nan), ((np.nan, 1.0, 1.0), np.nan),
])  # fmt: skip
def test_the_lode_angle_of_known_stresses(principal, degrees):
    turn = Rotation.random(random_state=3).as_matrix()
    stress = turn @ np.diag(principal) @ turn.T
    lode = angle_of("lode_angle", stress=np.stack([stress, 1e6 * stress]))
    np.testing.assert_allclose(np.rad2deg(lode), degrees, atol=1e-6)


def test_the_lode_angle_has_the_invariants_of_the_deviator():
    """cos 3 theta = (3 sqrt 3 / 2) J3 / J2^(3/2)."""
    f = xcg.datasets.random_scene(150, seed=6).cg.coarse_grain(
        ["stress", "lode_angle"], width=0.9, spacing=1.3
    )
    stress = f.stress.values
    stress = (stress + np.swapaxes(stress, -1, -2)) / 2
    deviator = stress - np.trace(stress, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
    j2 = (deviator**2).sum((-2, -1)) / 2
    j3 = np.linalg.det(deviator)
    np.testing.assert_allclose(np.cos(3 * f.lode_angle), 1.5 * np.sqrt(3) * j3 / j2**1.5, rtol=1e-9)
    assert f.lode_angle.min() >= 0
    assert f.lode_angle.max() <= np.pi / 3


@pytest.mark.parametrize("degrees", [0.0, 1e-6, 20.0, 90.0, 130.0])
@pytest.mark.parametrize("dims", [None, "xz", "zx"])
def test_angles_between_axes_of_tensors_that_are_turned_against_each_other(degrees, dims):
    turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    stress = np.diag([3.0, 1.0, 0.5])
    options = Options(shear_dims=dims)
    expected = min(degrees, 180 - degrees)
    compression = turn @ np.diag([-0.2, 0.1, 0.1]) @ turn.T
    angle = angle_of(
        "stress_strain_rate_angle", options, stress=stress, shear_rate_tensor=compression
    )
    np.testing.assert_allclose(np.rad2deg(angle), expected, rtol=1e-7, atol=1e-12)
    fabric = turn @ np.diag([0.5, 0.3, 0.2]) @ turn.T
    angle = angle_of("stress_fabric_angle", options, stress=stress, contact_fabric=fabric)
    np.testing.assert_allclose(np.rad2deg(angle), expected, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize(
    "fabric", [np.eye(3) / 3, np.diag([0.4, 0.4, 0.2]), np.full((3, 3), np.nan)]
)
def test_an_angle_to_a_tensor_without_major_axis_is_nan(fabric):
    turn = Rotation.random(random_state=3).as_matrix()
    fabric = turn @ fabric @ turn.T
    assert np.isnan(
        angle_of("stress_fabric_angle", stress=np.diag([3.0, 1, 0]), contact_fabric=fabric)
    )


@pytest.mark.parametrize("layer", [False, True])
def test_angles_between_axes_of_a_scene(layer):
    if layer:
        ds = xcg.datasets.open("biaxial").isel(time=[-1])
    else:
        ds = xcg.datasets.random_scene(150, seed=6)
    names = ["stress", "shear_rate_tensor", "contact_fabric", "lode_angle",
             "stress_strain_rate_angle", "stress_fabric_angle"]  # fmt: skip
    f = ds.cg.coarse_grain(names).isel(time=0)
    f = f.isel({a: f.sizes[a] // 2 for a in ds.attrs["plane"]})
    plane = ["xyz".index(a) for a in ds.attrs["plane"]]
    tensors = (f.stress, -f.shear_rate_tensor, f.contact_fabric)
    symmetric = [(tensor.values + tensor.values.T)[plane][:, plane] for tensor in tensors]
    major = [np.linalg.eigh(tensor)[1][:, -1] for tensor in symmetric]
    for name, other in zip(names[-2:], major[1:], strict=True):
        np.testing.assert_allclose(np.cos(f[name]), abs(major[0] @ other), rtol=1e-9)
        assert f[name].attrs["units"] == "1"
    assert bool(f.lode_angle.isnull()) == layer


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


@pytest.mark.parametrize("name", [name for name in rheology.ROWS if not name.startswith("_")])
def test_every_row_cites_its_source(name):
    row = rheology.ROWS[name]
    sources = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8").partition("## Sources")[2]
    for reference in row.references.split("; "):
        author, year = re.fullmatch(r"(.+?)(?: et al\.)? (\d{4})", reference).groups()
        assert author.split(" & ")[0] in sources
        assert f"({year})" in sources


def test_results_hold_the_source_of_a_field():
    f = xcg.datasets.simple_cubic(3).cg.coarse_grain("friction_coefficient", axes="z")
    assert f.friction_coefficient.attrs["references"] == "Jop et al. 2006"
