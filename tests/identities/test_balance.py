"""Balance laws: mass, momentum, and the divergence of contact stress, which hold for any configuration."""

import numpy as np
import pytest
from hypothesis import given, settings

import xcg
from tests.identities import residuals
from tests.identities.scenes import OPEN, SYNTHETIC, load

REAL = pytest.mark.parametrize("name", list(OPEN))

# see residuals.STEP: a grain whose rim lies within the stencil leaves 3e-8 of its peak
KINK = 3e-8
# and without: rounding of 1e-15 / STEP, a little more in closed forms, which add a logarithm and polynomials
ROUNDING = 1e-10


# --- 2: continuity ---------------------------------------------------------------------------------------


@REAL
def test_the_continuity_equation_holds(name):
    case = load(name)
    assert residuals.continuity(case.ds, case.width, case.points).relative < KINK


@pytest.mark.slow  # the same identity on given scenes
@settings(deadline=None, max_examples=20)
@given(case=SYNTHETIC)
def test_the_continuity_equation_holds_for_any_scene(case):
    assert residuals.continuity(case.ds, case.width, case.points).relative < 2 * KINK


@REAL
def test_kernel_gradient_closes_the_mass_balance(name):
    """Rho tr(G) + V . grad rho = div p with G the exact derivative of V(r)."""
    case = load(name)
    options = {"width": case.width, "gradient": "kernel"}
    f = residuals.at_points(
        case.ds, ["density", "velocity", "velocity_gradient"], case.points, **options
    )
    div = residuals.divergence(case.ds, ["momentum_density"], case.points, case.width)[
        "momentum_density"
    ]
    slopes = np.zeros((len(case.points), 3))
    for k, point in enumerate(case.points):
        for axis in residuals.axes_of(case.ds):
            slopes[k, axis] = residuals.derivative(case.ds, ["density"], point, axis, case.width)[
                "density"
            ]
    left = f["density"] * np.einsum("nii->n", f["velocity_gradient"]) + np.einsum(
        "ni,ni->n", f["velocity"], slopes
    )
    scale = f["density"].max() / residuals.time_scale(case.ds, case.width)
    np.testing.assert_allclose(left, div, rtol=0, atol=KINK * scale)


@REAL
def test_mass_is_balanced_between_close_frames(name):
    case = load(name)
    step = 0.05 * residuals.time_scale(case.ds, case.width)
    coarse, fine = residuals.mass_between_frames(case.ds, case.width, case.points, step, step / 2)
    # grains move by 0.05 w at most: the leading term is dt^2 / 6 of the third derivative of the kernel, below 100 / w^3
    assert coarse.relative < 0.05**2 / 6 * 100
    assert second_order(coarse, fine)


def second_order(coarse: residuals.Residual, fine: residuals.Residual) -> bool:
    """Whether halving dt divides the residual by 4; grains at the jump of the third derivative spoil a part of it."""
    rms = [np.sqrt(np.mean(r.difference**2)) for r in (coarse, fine)]
    return 3.4 < rms[0] / rms[1] < 4.6


# --- 3: divergence of contact stress ---------------------------------------------------------------------


@REAL
def test_divergence_of_contact_stress_is_the_force_density(name):
    case = load(name)
    assert residuals.stress_divergence(case.ds, case.width, case.points).relative < ROUNDING


@REAL
def test_divergence_of_contact_stress_with_any_forces(name):
    """It is no property of the state: forces may be anything, as long as they are opposite on both sides."""
    case = load(name)
    noise = np.random.default_rng(5).normal(size=case.ds.contact_force.shape)
    if case.ds.attrs["dimension"] == 2:
        noise[..., 2] = 0
    ds = case.ds.assign(contact_force=case.ds.contact_force * 0 + noise)
    assert residuals.stress_divergence(ds, case.width, case.points).relative < ROUNDING


def in_halves(ds):
    """The scene with its grains in two phases, by turns."""
    return ds.assign(half=ds.particle_id % 2)


@pytest.mark.parametrize(
    "name", ["lammps_chute", "lammps_biaxial2d", "liggghts_box", "mercury_synthetic"]
)
def test_divergence_of_the_contact_stress_of_each_phase(name):
    case = load(name)
    found = residuals.phase_divergence(
        in_halves(case.ds), case.width, case.points[:3], "half", [0, 1]
    )
    assert found.relative < ROUNDING


@pytest.mark.slow  # the same identity on given scenes
@settings(deadline=None, max_examples=10)
@given(case=SYNTHETIC)
def test_divergence_of_the_contact_stress_of_each_phase_of_any_scene(case):
    assert (
        residuals.phase_divergence(
            in_halves(case.ds), case.width, case.points, "half", [0, 1]
        ).relative
        < 1e-9
    )


@pytest.mark.slow  # the same identity on given scenes
@settings(deadline=None, max_examples=20)
@given(case=SYNTHETIC)
def test_divergence_of_contact_stress_of_any_scene(case):
    # few and strong contacts: their own kinks of STEP^2.5 = 6e-10 are no longer averaged out
    assert residuals.stress_divergence(case.ds, case.width, case.points).relative < 1e-9


def test_boundary_force_density_is_a_large_part_of_the_balance_at_the_bottom():
    """At the bottom of a scene with walls the traction is a large part of the balance."""
    for case in (load("liggghts_box"), load("lammps_chute")):
        f = residuals.at_points(
            case.ds, ["boundary_force_density", "contact_stress"], case.points, width=case.width
        )
        assert (
            np.abs(f["boundary_force_density"]).max()
            > 0.1 * np.abs(f["contact_stress"]).max() / case.width
        )


@REAL
def test_quadrature_leaves_its_error_in_the_divergence(name):
    """What is left with quadrature is the error of the quadrature, far above rounding."""
    case = load(name)
    residual = residuals.stress_divergence(case.ds, case.width, case.points, rtol=1e-2).relative
    assert 1e-5 < residual < 0.1
    finer = residuals.stress_divergence(case.ds, case.width, case.points, rtol=1e-5).relative
    assert finer < residual / 10


# --- 4: static equilibrium -------------------------------------------------------------------------------


# A grain's resultant that is a share e of the mean contact force is felt as about that share of the stress over w,
# less what the sum over grains averages out. How static the data are is theirs: the grains still move a little. The
# bounds are round numbers above what the files hold; what is not in the files is rounding.
def test_stress_of_a_packing_at_rest_balances_gravity():
    case = load("liggghts_box")
    left, unexplained, resultant = residuals.static_equilibrium(case.ds, case.width, case.points)
    assert resultant < 0.1
    assert left.relative < 5e-3
    assert unexplained.relative < ROUNDING


FLOWING = ["lammps_chute", "lammps_biaxial2d", "mfix_chute", "mercury_synthetic"]


@pytest.mark.parametrize("name", FLOWING)
def test_residuals_out_of_equilibrium_follow_from_resultant_forces(name):
    """Flowing, or without all forces: div sigma - rho g - t is what the grains' resultants and div sigma^k make."""
    case = load(name)
    left, unexplained, _ = residuals.static_equilibrium(case.ds, case.width, case.points)
    assert left.relative > 1e-3
    # the kinetic stress is a sum of kernels, with their kinks
    kinetic = residuals.at_points(
        case.ds, ["kinetic_stress", "contact_stress"], case.points, width=case.width
    )
    share = np.abs(kinetic["kinetic_stress"]).max() / np.abs(kinetic["contact_stress"]).max()
    assert unexplained.relative < ROUNDING + KINK * share


# --- 5: momentum balance ---------------------------------------------------------------------------------


@REAL
def test_momentum_is_balanced_between_close_frames(name):
    case = load(name)
    step = 0.05 * residuals.time_scale(case.ds, case.width, residuals.accelerations(case.ds))
    coarse, fine = residuals.momentum_between_frames(
        case.ds, case.width, case.points, step, step / 2
    )
    # as for mass, with one more derivative of the kernel where grains are accelerated
    assert coarse.relative < 0.05**2 / 6 * 100
    assert second_order(coarse, fine)


@pytest.mark.slow  # the same identity on given scenes
@settings(deadline=None, max_examples=10)
@given(case=SYNTHETIC)
def test_momentum_of_any_scene_is_balanced_between_close_frames(case):
    step = 0.02 * residuals.time_scale(case.ds, case.width, residuals.accelerations(case.ds))
    steps = step, step / 4, step / 16
    coarse, fine, finest = residuals.momentum_between_frames(
        case.ds, case.width, case.points, *steps
    )
    # four times finer leaves 1/16, and no less than 1/8 with a few grains at their kinks; down to those in space
    floor = 2 * KINK * coarse.scale
    size = [np.abs(r.difference).max() for r in (coarse, fine, finest)]
    assert size[1] < size[0] / 8 + floor
    assert size[2] < size[1] / 8 + floor


def test_momentum_of_a_pair_without_gravity_is_balanced():
    """Two grains, one force: the stress lies along the branch, and its divergence is the pair of forces."""
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0], [1.0, 0, 0]], diameter=[1.0, 1.0], density=1.0, velocity=np.zeros((2, 3)),
        contact_i=[0], contact_j=[1], contact_force=[[-3.0, 0.5, 0]],
    )  # fmt: skip
    f = residuals.at_point(ds, ["contact_stress"], np.array([0.5, 0.2, 0]), width=0.75)[
        "contact_stress"
    ]
    assert f[0, 0] > 0  # repulsion is positive
    assert f[1, 0] == pytest.approx(-f[0, 0] / 6)  # component of the force first, then direction
    assert (f[:, 1:] == 0).all()
    points = np.array([[0.1, 0.2, 0.3], [0.5, 0.1, 0.0], [1.3, 0.0, 0.2]])
    # two grains and one branch average nothing: the kinks of residuals.STEP
    assert residuals.stress_divergence(ds, 0.75, points).relative < KINK
