"""Integrals of fields are sums over grains and contacts: mass, marginals, virial; and periodic scenes have no edge."""

import numpy as np
import pytest
from hypothesis import given, settings

import xcg
from tests.identities import residuals
from tests.identities.scenes import OPEN, SYNTHETIC, load

REAL = pytest.mark.parametrize("name", list(OPEN))

# The sum over 128 nodes in c of the 1D marginal of one kernel is off by up to 3.8e-11 in 2D and 3.8e-12 in 3D, by the
# place of the nodes; it falls as h^4.5 and h^5. Rounding is below that.
SUM = {2: 4e-11, 3: 4e-12}


# --- 1: mass ---------------------------------------------------------------------------------------------


@REAL
def test_integral_of_density_is_the_mass(name):
    case = load(name)
    assert residuals.mass(case.ds, case.width).relative < SUM[case.ds.attrs["dimension"]]


@pytest.mark.slow  # the same identity on given scenes
@settings(deadline=None, max_examples=10)
@given(case=SYNTHETIC)
def test_integral_of_density_of_any_scene_is_the_mass(case):
    assert residuals.mass(case.ds, case.width).relative < SUM[case.ds.attrs["dimension"]]


def test_mass_on_a_mesh_converges_with_the_transform_of_the_kernel():
    """Error of the sum over a mesh: the transform of Lucy's kernel at 2 pi / h, which falls as (h / c)^5."""
    ds = xcg.datasets.random_scene(30, seed=1, periodic="x", edge=3.0)
    total = float(ds.mass.sum())
    errors = []
    for nodes in (3, 6, 12):
        f = ds.cg.coarse_grain("density", width=0.5, spacing=1 / nodes)
        cell = np.prod([float(f[a][1] - f[a][0]) for a in "xyz"])
        errors.append(abs(float(f.density.sum()) * cell / total - 1))
    # the sum over 30 grains adds errors of different signs: not less than 4th order is asked for
    assert errors[0] > 16 * errors[1] > 256 * errors[2]
    assert errors[2] < 1e-6


@REAL
def test_partial_fields_add_up(name):
    case = load(name)
    # any division of the grains will do; the files' own species are few, or one
    species = 1 + np.arange(case.ds.sizes["particle"]) % 3
    ds = case.ds.assign(
        species=(case.ds.particle_id.dims, np.broadcast_to(species, case.ds.particle_id.shape))
    )
    fields = [name for name, row in xcg.FIELDS.items() if row.additive and not row.option]
    whole = residuals.at_points(ds, fields, case.points, width=case.width)
    parts = residuals.at_points(ds, fields, case.points, width=case.width, by="species")
    for values in parts.values():
        assert values.shape[1] == 4
    bulk = {name: values[:, 0] for name, values in parts.items()}
    total = {name: values[:, 1:].sum(axis=1) for name, values in parts.items()}
    # additions in another order: 1e-16 for each of up to 1e3 terms, of random signs
    assert residuals.difference(ds, case.width, whole, bulk).relative < 1e-13
    assert residuals.difference(ds, case.width, bulk, total).relative < 1e-13


# --- 7: periodicity --------------------------------------------------------------------------------------


# Coordinates of a hundred cutoffs are rounded by 1e-14 cutoffs, and so are the fields.
SHIFT = 1e-12


@REAL
@pytest.mark.parametrize("seed", [0, 1])
def test_shifted_scenes_have_shifted_fields(name, seed):
    case = load(name)
    assert residuals.periodicity(case.ds, case.width, case.points, seed).relative < SHIFT


@pytest.mark.slow  # the same identity on given scenes
@settings(deadline=None, max_examples=10)
@given(case=SYNTHETIC)
def test_shifted_scenes_have_shifted_fields_for_any_scene(case):
    assert residuals.periodicity(case.ds, case.width, case.points).relative < SHIFT


# --- 8: marginals ----------------------------------------------------------------------------------------


# With 512 nodes in c for kernels with kinks and 256 for marginals (`residuals.marginals`) the sum over nodes is off by
# up to 3.6e-12 of the peak of each term, by the place of the nodes, falling as h^4; several terms add up.
MARGINAL = 2e-11


@REAL
def test_marginals_are_integrals(name):
    case = load(name)
    assert residuals.marginals(case.ds, case.width, case.points[0]).relative < MARGINAL


@pytest.mark.slow  # the same identity on given scenes
@settings(deadline=None, max_examples=10)
@given(case=SYNTHETIC)
def test_marginals_are_integrals_for_any_scene(case):
    assert residuals.marginals(case.ds, case.width, case.points[0]).relative < MARGINAL


@pytest.mark.parametrize("kernel", ["gaussian", "heaviside"])
def test_marginals_of_kernels_that_jump(kernel):
    """A sum over nodes misses up to one node at each jump: first order in h, and no more is asked for."""
    ds = xcg.datasets.random_scene(60, seed=2, periodic="xy")
    for fields in ("density", "contact_stress"):
        line = ds.cg.coarse_grain(
            fields, kernel=kernel, width=0.6, axes="x", at={"y": 1.0, "z": 2.0}, spacing=0.6 / 2000
        )
        mean = ds.cg.coarse_grain(
            fields, kernel=kernel, width=0.6, axes="", at={"y": 1.0, "z": 2.0}
        )
        scale = float(np.abs(line[fields]).max())
        np.testing.assert_allclose(line[fields].mean("x"), mean[fields], rtol=0, atol=1e-3 * scale)


# --- 9: virial -------------------------------------------------------------------------------------------


@REAL
def test_integral_of_contact_stress_is_the_virial(name):
    case = load(name)
    assert residuals.virial(case.ds, case.width).relative < SUM[case.ds.attrs["dimension"]]


@pytest.mark.slow  # the same identity on given scenes
@settings(deadline=None, max_examples=10)
@given(case=SYNTHETIC)
def test_integral_of_contact_stress_of_any_scene_is_the_virial(case):
    assert residuals.virial(case.ds, case.width).relative < SUM[case.ds.attrs["dimension"]]


@pytest.mark.parametrize(("rtol", "rounding"), [(9e-5, SUM[3]), (1e-2, 1e-7)])
def test_integral_of_contact_stress_by_quadrature_is_the_virial(rtol, rounding):
    """A quadrature keeps the integral of every segment: its weights add up to 1, wherever its points are.

    They do so to the rounding of the weights, which are in single precision from rtol = 1e-4 on.
    """
    ds = xcg.datasets.random_scene(60, seed=3)
    exact = ds.cg.coarse_grain("contact_stress", width=1.0, axes="", rtol=0).contact_stress
    f = ds.cg.coarse_grain(
        "contact_stress", width=1.0, axes="z", spacing=1 / 64, rtol=rtol
    ).contact_stress
    # 128 nodes in c leave 1e-12 of a smooth kernel
    np.testing.assert_allclose(
        f.mean("z"), exact, rtol=0, atol=rounding * float(np.abs(exact).max())
    )
