"""Floors: what norms and eigenvalues of independent directions and velocities show, by brute force."""

from dataclasses import replace

import numpy as np
import pytest

import xcg
from tests import ensembles, truths
from xcg.fields.formulas import floors
from xcg.fields.formulas.field import Support
from xcg.fields.plan import make_plan
from xcg.fields.pressures import spread_of_contacts
from xcg.fields.request import Request
from xcg.fields.support import support_of
from xcg.scene.frame import frame_at
from xcg.scene.scene import Scene

DRAWS = 4000


def support(number, dimension, partners=0.0):
    return Support(number, number, partners, dimension, slope=1.0, volume_fraction=0.5)


def dyads(number, dimension, seed=1):
    """Means of dyads of directions, in many draws."""
    n = np.random.default_rng(seed).normal(size=(DRAWS, number, dimension))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    return np.einsum("sni,snj->sij", n, n) / number


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("number", [10, 100])
def test_anisotropy_of_independent_contacts(number, dimension):
    dev = dyads(number, dimension) - np.eye(dimension) / dimension
    squares = (dev**2).sum(axis=(1, 2))
    size = {2: 4 * np.sqrt(squares / 2), 3: 7.5 * np.sqrt(1.5 * squares)}[dimension]
    floor = floors.contact_anisotropy(support(number, dimension))
    assert floor == pytest.approx(size.mean(), rel=0.03)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("number", [10, 100])
def test_order_of_directors_at_random(number, dimension):
    tensor = (dimension * dyads(number, dimension) - np.eye(dimension)) / (dimension - 1)
    largest = np.abs(np.linalg.eigvalsh(tensor)).max(axis=-1)
    assert floors.order(support(number, dimension)) == pytest.approx(largest.mean(), rel=0.03)


def friction(tensors):
    """Friction coefficients of stress tensors."""
    d = tensors.shape[-1]
    p = np.trace(tensors, axis1=1, axis2=2) / d
    dev = tensors - p[:, None, None] * np.eye(d)
    return np.sqrt((dev**2).sum(axis=(1, 2)) / 2) / p


@pytest.mark.parametrize("dimension", [2, 3])
def test_friction_of_a_gas(dimension):
    v = np.random.default_rng(2).normal(size=(DRAWS, 50, dimension))
    mu = friction(np.einsum("sni,snj->sij", v, v))
    assert floors.friction(support(50, dimension)) == pytest.approx(mu.mean(), rel=0.03)


@pytest.mark.parametrize("dimension", [2, 3])
def test_friction_of_contacts_with_forces_of_an_exponential_distribution(dimension):
    rng = np.random.default_rng(3)
    n = rng.normal(size=(DRAWS, 100, dimension))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    mu = friction(np.einsum("sn,sni,snj->sij", rng.exponential(size=n.shape[:2]), n, n))
    # of contacts that do not exclude each other
    partners = 2.0
    left = 1 - partners / {2: 6.7, 3: 14.0}[dimension]
    floor = floors.friction(support(100, dimension, partners)) / np.sqrt(left)
    assert floor == pytest.approx(mu.mean(), rel=0.03)


@pytest.mark.parametrize("dimension", [2, 3])
def test_tangential_forces_of_independent_contacts(dimension):
    rng = np.random.default_rng(5)
    n = rng.normal(size=(DRAWS, 100, dimension))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    normal = rng.exponential(size=(DRAWS, 100))
    t = rng.normal(size=n.shape)
    t -= np.einsum("sni,sni->sn", t, n)[..., None] * n
    t *= 0.2 * normal[..., None]
    tensor = np.einsum("sni,snj->sij", t, n) / normal.sum(axis=1)[:, None, None]
    squares = (((tensor + tensor.swapaxes(1, 2)) / 2) ** 2).sum(axis=(1, 2))
    size = {2: 4 * np.sqrt(squares / 2), 3: 5 * np.sqrt(1.5 * squares)}[dimension]
    tangential = np.sqrt((t**2).sum(axis=-1).mean()) / normal.mean()
    floor = floors.tangential_anisotropy(replace(support(100, dimension), tangential=tangential))
    assert floor == pytest.approx(size.mean(), rel=0.03)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_single_grain_has_the_largest_friction(dimension):
    v = np.random.default_rng(4).normal(size=(10, 1, dimension))
    mu = friction(np.einsum("sni,snj->sij", v, v))
    np.testing.assert_allclose(floors.friction(support(1, dimension)), mu)


def major_axes(tensors):
    """Major axes of symmetric tensors."""
    return np.linalg.eigh(tensors)[1][..., -1]


def angles(axes, others):
    """Mean angle of axes without direction."""
    cosine = np.abs((axes * others).sum(axis=-1))
    return np.arccos(np.minimum(cosine, 1.0)).mean()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("number", [20, 100, 1000])
def test_angles_of_contacts_whose_stress_and_fabric_have_one_axis(dimension, number):
    """Of the usual mu: normal forces grow along the first axis; the strain rate is known."""
    rng = np.random.default_rng(6)
    n = rng.normal(size=(1000, number, dimension))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    along = n[..., 0] ** 2 - 1 / dimension
    of_fabric = {2: 0.1 / 4, 3: 0.1 / 7.5 / 1.5}[dimension]
    uniaxial = np.diag([1.0] + [-1 / (dimension - 1)] * (dimension - 1))
    force = rng.exponential(size=along.shape) * (1 + {2: 1.2, 3: 1.3}[dimension] * along)
    stress = np.einsum("sn,sni,snj->sij", force, n, n)
    mean = stress.mean(axis=0)[None]
    assert friction(mean)[0] == pytest.approx(0.3, rel=0.1)
    fabric = np.einsum("sni,snj->sij", n, n)
    fabric += number * of_fabric * uniaxial
    # a_c = 0.1
    left = 1 - 2.0 / {2: 6.7, 3: 14.0}[dimension]
    here = replace(support(number * left, dimension, partners=2.0), slope=0.0)
    major = major_axes(stress)
    floor = floors.stress_fabric_angle(here)
    assert floor == pytest.approx(angles(major, major_axes(fabric)), rel=0.4)
    floor = floors.stress_strain_rate_angle(here)
    assert floor == pytest.approx(angles(major, np.eye(dimension)[0]), rel=0.4)
    if dimension == 3:
        low, middle, high = np.moveaxis(np.linalg.eigvalsh(stress), -1, 0)
        lode = np.arctan2(np.sqrt(3) * (middle - low), 2 * high - middle - low).mean()
        assert floors.lode_angle(here) == pytest.approx(lode, rel=0.4)


def of_scene(ds, **options):
    """Support of a node of a scene, and the options."""
    scene = Scene(ds)
    plan = make_plan(scene, Request("volume_fraction", **options))
    return support_of(scene, plan)


@pytest.mark.parametrize("width", [1.0, 1.5, 2.0])
def test_floors_of_a_gas(width):
    ds = truths.gas(4)
    names = ["friction_coefficient", "inertial_number"]
    f = ds.cg.coarse_grain(names, width=width, spacing=1.5)
    here = of_scene(ds, width=width)
    assert floors.friction(here) == pytest.approx(f.friction_coefficient.mean().item(), rel=0.15)
    assert floors.inertial_number(here) == pytest.approx(
        f.inertial_number.median().item(), rel=0.25
    )


@pytest.mark.parametrize(("layer", "count"), [(False, 1000), (True, 300)])
def test_shear_rate_of_independent_velocities(layer, count):
    """Many grains, of which a node sees some 100, with T = 1: the mean norm is that of normal components."""
    ds = ensembles.ensemble(count, shear=0.0, draws=20, layer=layer)
    if layer:  # whose grains move in it
        ds = ds.assign(velocity=ds.velocity * [1.0, 1.0, 0.0])
    f = ds.cg.coarse_grain("shear_rate", width=1.5)
    floor = floors.shear_rate(of_scene(ds, width=1.5)) / ds.attrs["d43"]
    assert floor == pytest.approx(float(f.shear_rate.mean()), rel=0.04)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("width", [0.75, 1.5])
def test_floors_of_relaxed_packings(width, dimension):
    """Contacts of a grain exclude each other: floors are below those of independent ones."""
    ds = truths.packing(**PACKINGS[dimension])
    ways = {
        "friction_coefficient": floors.friction,
        "contact_anisotropy": floors.contact_anisotropy,
        "normal_force_anisotropy": floors.force_anisotropy,
        "branch_anisotropy": floors.branch_anisotropy,
    }
    f = ds.cg.coarse_grain([*ways], width=f"{width} d43", for_averages=True)
    plan = make_plan(Scene(ds), Request("branch_anisotropy"))
    frame, lattice, _ = frame_at(ds, 0, plan.variables)
    branches, _ = spread_of_contacts(frame, lattice)
    here = replace(of_scene(ds, width=f"{width} d43"), branch_spread=branches)
    for name, floor in ways.items():
        assert floor(here) == pytest.approx(f[name].mean().item(), rel=0.4), name


PACKINGS = {
    2: {"dimension": 2, "phi": 0.9, "count": 200, "steps": 3},
    3: {"count": 200, "steps": 2},
}


@pytest.mark.parametrize("axes", ["xyz", "z"])
def test_order_of_rods_at_random(axes):
    ds = truths.rods(0.0, 4)
    f = ds.cg.coarse_grain("nematic_order", axes=axes)
    floor = floors.order(of_scene(ds, axes=axes))
    assert floor == pytest.approx(np.abs(f.nematic_order).mean().item(), rel=0.1)


@pytest.mark.parametrize(("axes", "grains"), [("", 27.0), ("z", None)])
def test_empty_parts_of_a_box_hold_no_grains(axes, grains):
    places = np.stack(np.meshgrid(*[[0.5, 1.5, 2.5]] * 3), axis=-1).reshape(-1, 3)
    near, far = (
        xcg.scene_from_arrays(places, diameter=np.ones(27), density=1.0, box=[[0.0, side]] * 3)
        for side in (3.0, 20.0)
    )
    number = of_scene(far, axes=axes, width=1.0).grains
    assert number == pytest.approx(of_scene(near, axes=axes, width=1.0).grains)
    f = far.cg.coarse_grain("effective_count", axes=axes, width=1.0)
    assert number == pytest.approx(grains or f.effective_count.max().item(), rel=0.2)
