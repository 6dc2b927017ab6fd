"""Fields that users register: in the program or in NumPy with the same bits, in other processes, refused when wrong."""

import re
from unittest import mock

import numpy as np
import pytest

import xcg
from tests import ROOT, planning
from tests.scenes import random_steps
from xcg.fields.formulas import registry, tracing
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.rows.errors import OF_FITS
from xcg.scene.schema import powers_of

OWN = {
    "deviation": (
        lambda f, s, o: -f.stress * 0.5 + f.pressure[..., None, None] ** 2,
        2,
        ["stress", "pressure"],
    ),
    "exponential": (lambda f, s, o: np.exp(-f.volume_fraction), 0, ["volume_fraction"]),
    "doubled": (lambda f, s, o: 2 * f.exponential + s.mass, 0, ["exponential"]),
    "cube": (lambda f, s, o: np.abs(f.velocity) ** 3, 1, ["velocity"]),
    "dense": (lambda f, s, o: f.volume_fraction > 0.3, 0, ["volume_fraction"]),
    "branch": (lambda f, s, o: np.where(f.pressure > 0, f.pressure, 0.0), 0, ["pressure"]),
}
TRACED = {"deviation"}


def register_all():
    for name, (compute, rank, fields) in OWN.items():
        xcg.register_field(
            name, compute, rank=rank, fields=fields, moments=["mass"] if name == "doubled" else []
        )


def test_numpy_computes_operations_that_cannot_be_traced():
    register_all()
    names = (*OWN, "stress", "velocity_gradient")
    assert set(tracing.program_for(names, Options()).widths) == {
        *TRACED,
        "stress",
        "velocity_gradient",
    }
    assert tracing.program_for(("cube",), Options()) is None


@pytest.mark.parametrize(
    "options", [{}, {"by": "species"}, {"axes": "z"}, {"gradient": "finite_difference"}]
)
def test_program_and_numpy_give_the_same_bits(options):
    register_all()
    ds = xcg.datasets.random_scene(120, seed=8)
    ds = ds.assign(director=ds["velocity"])
    names = [*OWN, *registry.listed(registered=False)]
    names = [name for name in names if not registry.FIELDS[name].option]
    if "gradient" in options:  # which is not fitted
        names = [name for name in names if name not in OF_FITS]
    with planning(BLOCK_NODES=40), mock.patch("xcg.steps.analysis.THREADS", 2):
        mixed = ds.cg.coarse_grain(names, width=0.6, **options)
    with mock.patch("xcg.fields.evaluate.program_for", return_value=None):
        plain = ds.cg.coarse_grain(names, width=0.6, **options)
    for name in names:
        np.testing.assert_array_equal(mixed[name], plain[name], err_msg=name)
    np.testing.assert_array_equal(mixed.cube, np.abs(mixed.velocity) ** 3)
    np.testing.assert_array_equal(mixed.dense, mixed.volume_fraction > 0.3)
    known = [name for name in plain if name not in OWN]
    for name, values in ds.cg.coarse_grain(known, width=0.6, **options).items():
        np.testing.assert_array_equal(values, mixed[name], err_msg=name)


@pytest.mark.parametrize("scheduler", ["synchronous", "threads", "processes"])
def test_rows_pickle(computing, scheduler):
    xcg.register_field("swing", lambda f, s, o: np.sin(f.density), fields="density")
    xcg.register_field("rest", lambda f, s, o: f.swing - 1.0, fields="swing")
    ds = random_steps(2).chunk(time=1)
    f = ds.cg.coarse_grain(["density", "rest"], width=0.8)
    xcg.register_field(
        "swing", lambda f, s, o: np.cos(f.density), fields="density"
    )  # is for later calls
    f = f.compute(**computing(scheduler))
    np.testing.assert_array_equal(f.rest, np.sin(f.density) - 1.0)
    again = ds.cg.coarse_grain(["density", "swing"], width=0.8).compute()
    np.testing.assert_array_equal(again.swing, np.cos(again.density))


def test_fields_of_users_are_requested_by_name():
    ds = xcg.datasets.simple_cubic(3)
    before = list(ds.cg.coarse_grain(axes="z"))
    xcg.register_field("twice", lambda f, s, o: 2 * f.density, fields="density")
    assert list(ds.cg.coarse_grain(axes="z")) == before
    with pytest.raises(TypeError):
        xcg.FIELDS["twice"] = xcg.FIELDS["density"]
    assert xcg.FIELDS["twice"] in xcg.FIELDS.values()
    assert ", registered 1)" in repr(xcg.FIELDS)


def test_a_field_inherits_the_options_of_its_inputs():
    xcg.register_field("twice", lambda f, s, o: 2 * f.viscous_number, fields="viscous_number")
    ds = xcg.datasets.random_scene(40, seed=1)
    with pytest.raises(ValueError, match="twice needs the argument fluid_viscosity="):
        ds.cg.coarse_grain("twice")
    f = ds.cg.coarse_grain(["viscous_number", "twice"], fluid_viscosity=1e-3, axes="z", width=0.8)
    np.testing.assert_array_equal(f.twice, 2 * f.viscous_number)


def change_what_is_given(f, s, o):
    f.stress[...] = 0.0
    return f.volume_fraction


def smallest_rate(f, s, o):
    return np.linalg.eigvalsh(f.shear_rate_tensor)[..., 0]


RIGHT = {"compute": lambda f, s, o: f.density, "fields": "density"}


@pytest.mark.parametrize(("name", "options", "message"), [
    ("density", {}, "that of a field of xcg"),
    ("phase", {}, "or of a coordinate"),
    ("two words", {}, "letters, digits and underscores"),
    ("_own", {}, "letters, digits and underscores"),
    ("own", {"compute": 3.0}, r"compute=3.0: expected a function"),
    ("own", {"rank": 3}, r"rank=3: expected 0 \(scalar\)"),
    ("own", {"powers": (1, 2)}, r"powers=\(1, 2\): expected whole powers"),
    ("own", {"powers": (0, 0, 1), "units": "s"}, r"units='s' and powers=\(0, 0, 1\) both give its unit"),
    ("own", {"units": "kg/m3"}, "units='kg/m3': expected '1' or a product of kg, m, s, N, Pa, J, W"),
    ("own", {"units": "bar"}, "units='bar': expected '1' or a product of"),
    ("own", {"units": "Pa"}, r"given as 'Pa', and its formula has the unit 'kg m\^-3': leave units= and powers= out"),
    ("own", {"powers": (-2, 1, 0)}, "its formula has the unit"),
    ("own", {"compute": lambda f, s, o: f.density / 2500, "units": "1"}, "pass constants=True if numbers in the"),
    ("own", {"compute": lambda f, s, o: np.exp(f.density), "units": "m"}, "and its formula has none: it mixes"),
    ("own", {"compute": lambda f, s, o: s.volume, "moments": "volume", "units": "m^3"}, "has the unit '1'"),
    ("own", {"fields": ()}, "name the fields= or moments="),
    ("own", {"fields": "densty"}, "it needs an unknown field 'densty'; did you mean 'density'"),
    ("own", {"fields": "_fit"}, "it needs an unknown field '_fit'; fields are in xcg.FIELDS"),
    ("own", {"moments": ["weight"]}, "it needs an unknown moment 'weight'"),
    ("own", {"weight": "velocity"}, "weight='velocity': expected"),
    ("own", {"weight": "density", "additive": True}, "for a field that is not additive"),
    ("own", {"rank": 1}, r"gives float64 \(3, 5\); of rank=1 it has to give numbers \(3, 5, 3\)"),
    ("own", {"compute": lambda f, s, o: f.stress}, "no attribute 'stress'"),
    ("own", {"compute": lambda f, s, o: f.density + 1j}, "gives complex128"),
    ("own", {"compute": lambda f, s, o: f.density / f.density.max()}, "depends on other nodes"),
    ("own", {"compute": change_what_is_given, "fields": ["stress", "volume_fraction"]}, "changes the field 'stress'"),
    ("own", {"compute": smallest_rate, "fields": "shear_rate_tensor"}, "one sees no grains .* LinAlgError"),
])  # fmt: skip
def test_wrong_fields_raise(name, options, message):
    with pytest.raises(ValueError, match=message):
        xcg.register_field(name, **(RIGHT | options))
    assert "own" not in xcg.FIELDS


def test_a_field_cannot_need_itself():
    xcg.register_field("first", lambda f, s, o: f.density, fields="density")
    xcg.register_field("second", lambda f, s, o: f.first, fields="first")
    with pytest.raises(ValueError, match="needs itself"):
        xcg.register_field("first", lambda f, s, o: f.second, fields="second")


@pytest.mark.parametrize("unit", [
    {"units": "kg m^-1 s^-2"}, {"units": "J m-3"}, {"units": "Pa"}, {"powers": (-1, 1, -2)},
])  # fmt: skip
def test_a_unit_is_given_as_text_or_as_powers(unit):
    xcg.register_field("own", lambda f, s, o: f.pressure, fields="pressure", **unit)
    assert xcg.FIELDS["own"].powers == xcg.FIELDS["pressure"].powers == (-1, 1, -2)
    ds = xcg.datasets.random_scene(40, seed=1)
    assert ds.cg.coarse_grain("own", axes="z").own.attrs["units"] == unit.get("units", "Pa")
    reduced = ds.assign_attrs(unit_system="reduced")
    assert reduced.cg.coarse_grain("own", axes="z").own.attrs["units"] == "1"


@pytest.mark.parametrize(("compute", "needs", "unit"), [
    (lambda f, s, o: f.pressure / f.density, {"fields": ["pressure", "density"]}, "m^2 s^-2"),
    (lambda f, s, o: f.shear_rate * o.fluid_viscosity, {"fields": "shear_rate"}, "Pa"),
    (lambda f, s, o: s.energy / s.volume, {"moments": ["energy", "volume"]}, "Pa"),
    (lambda f, s, o: s.rotation[..., -1], {"moments": "rotation"}, "kg^2 m^-2"),
    (lambda f, s, o: f.density > 0.3, {"fields": "density"}, "1"),
    (lambda f, s, o: np.log(f.density), {"fields": "density"}, "1"),
    (lambda f, s, o: np.sqrt(f.density), {"fields": "density"}, "1"),
])  # fmt: skip
def test_a_unit_is_by_default_that_of_the_formula(compute, needs, unit):
    xcg.register_field("own", compute, **needs)
    assert xcg.FIELDS["own"].powers == powers_of(unit)


def test_numbers_with_units_of_their_own_are_told():
    xcg.register_field(
        "fraction", lambda f, s, o: f.density / 2500, fields="density", units="1", constants=True
    )
    assert xcg.FIELDS["fraction"].units == "1"
    # others go by the unit that was told
    xcg.register_field("twice", lambda f, s, o: 2 * f.fraction, fields="fraction", units="1")


def test_an_own_field_may_take_the_mobilisation_of_friction():
    xcg.register_field(
        "unmobilised", lambda f, s, o: 1 - f.friction_mobilisation, fields="friction_mobilisation"
    )
    assert xcg.FIELDS["unmobilised"].units == "1"


# --- the page on own fields ------------------------------------------------------------------------------


def test_the_example_with_an_eigenvalue_runs():
    """The example of the docs: principal stresses by phase, averaged over nodes."""
    page = (ROOT / "docs" / "custom.md").read_text()
    names: dict = {}
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], names)
    ds = names["ds"]
    f = names["f"]
    mean = names["profile"]
    np.testing.assert_array_equal(f.major_stress, np.linalg.eigvalsh(f.stress)[..., -1])
    assert f.major_stress.dims == ("time", "x", "y", "z", "phase")
    assert f.major_stress.attrs["units"] == "Pa"
    assert f.major_stress.attrs["long_name"] == "largest principal stress"
    assert "major_stress" in xcg.FIELDS
    alone = ds.cg.coarse_grain("stress_anisotropy", width=0.8, by="species")
    np.testing.assert_array_equal(alone.stress_anisotropy, f.stress_anisotropy)
    sigma = mean.stress  # not the average of eigenvalues
    np.testing.assert_allclose(mean.major_stress, np.linalg.eigvalsh(sigma)[..., -1], rtol=1e-12)
    ratio = mean.major_stress / (sum(sigma.sel(component=a, direction=a) for a in "xyz") / 3) - 1
    np.testing.assert_allclose(mean.stress_anisotropy, ratio, rtol=1e-9)
