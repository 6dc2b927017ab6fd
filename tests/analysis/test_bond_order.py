"""Bond order: crystals, definitions by brute force, freud."""

import math

import numpy as np
import pytest

import xcg
from tests.analysis.test_radial_distribution import pair_vectors
from tests.scenes import gas


def order_of(degree, bonds):
    """Steinhardt's order of vectors (n, 3) by the addition theorem: the mean of P_l over all pairs of them."""
    unit = bonds / np.linalg.norm(bonds, axis=1, keepdims=True)
    legendre = np.polynomial.legendre.Legendre.basis(degree)
    return np.sqrt(max(legendre(unit @ unit.T).mean(), 0.0))


LATTICES = {
    "box": ("xyz", {}),
    "open": ("", {}),
    "tilted": ("xyz", {"lattice": {"xy": 1.0, "xz": 0.5, "yz": -1.0}}),
}


@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("arguments", [{"neighbours": 9}, {"r_max": 2.0}])
def test_order_is_that_of_brute_force(lattice, arguments):
    periodic, options = LATTICES[lattice]
    ds = gas(1, 120, periodic, **options)
    found = ds.cg.bond_order([2, 4, 5, 6], **arguments)
    d, _ = pair_vectors(ds, {})
    r = np.linalg.norm(d, axis=-1)
    np.fill_diagonal(r, np.inf)
    chosen = [
        np.argsort(row)[:9] if "neighbours" in arguments else np.flatnonzero(row < 2.0) for row in r
    ]
    for degree in (2, 4, 5, 6):
        expected = [
            order_of(degree, d[i, near]) if len(near) else np.nan for i, near in enumerate(chosen)
        ]
        np.testing.assert_allclose(found[f"q{degree}"][0], expected, rtol=1e-10)
        bonds = np.concatenate([d[i, near] for i, near in enumerate(chosen)])
        assert float(found[f"global_q{degree}"][0]) == pytest.approx(
            order_of(degree, bonds), rel=1e-9, abs=1e-9
        )


@pytest.mark.parametrize(
    ("periodic", "lattice"), [("xy", None), ("xy", {"xy": 2.0}), ("x", None), ("", None)]
)
@pytest.mark.parametrize("arguments", [{"neighbours": 1}, {"neighbours": 6}, {"r_max": 1.0}])
def test_order_in_a_plane_is_that_of_brute_force(periodic, lattice, arguments):
    ds = gas(1, 90, periodic, 2, lattice=lattice)
    order = ds.cg.bond_order([4, 5, 6], **arguments)
    d, _ = pair_vectors(ds, {})
    r = np.linalg.norm(d, axis=-1)
    np.fill_diagonal(r, np.inf)
    near = r < arguments.get("r_max", 0.0)
    if "neighbours" in arguments:
        near = r.argsort(axis=1).argsort(axis=1) < arguments["neighbours"]
    turn = np.arctan2(d[..., 1], d[..., 0])
    for degree in (4, 5, 6):
        waves = np.where(near, np.exp(1j * degree * turn), 0.0)
        with np.errstate(invalid="ignore"):
            means = waves.sum(axis=1) / near.sum(axis=1)
        np.testing.assert_allclose(order[f"psi{degree}"][0], np.abs(means), rtol=0, atol=1e-13)
        np.testing.assert_allclose(
            np.exp(1j * degree * order[f"psi{degree}_angle"][0]) * np.abs(means), means, atol=1e-13
        )
        whole = np.abs(waves.sum()) / near.sum()
        assert float(order[f"global_psi{degree}"][0]) == pytest.approx(whole, abs=1e-13)


def test_harmonics_are_those_of_scipy():
    special = pytest.importorskip("scipy.special")
    if not hasattr(special, "sph_harm_y"):
        pytest.skip("needs SciPy 1.15")
    from xcg.analysis.bond_order import _waves

    rng = np.random.default_rng(1)
    bond = rng.normal(size=(50, 3))
    polar = np.arccos(bond[:, 2] / np.linalg.norm(bond, axis=1))
    turn = np.arctan2(bond[:, 1], bond[:, 0])
    for degree in (1, 4, 6, 30):
        for m, wave in enumerate(_waves(degree, bond)):
            scale = np.sqrt(4 * np.pi / (2 * degree + 1) * (2 if m else 1))
            expected = scale * special.sph_harm_y(degree, m, polar, turn)
            np.testing.assert_allclose(wave, expected, rtol=0, atol=1e-11)


def test_harmonics_keep_their_digits_at_the_pole():
    """To first order Y_lm is the angle to the pole to the power m, times (l + m)! / (l - m)! / 2^m m!."""
    from xcg.analysis.bond_order import _waves

    angle = 1e-9
    for degree in (1, 6):
        for m, wave in enumerate(_waves(degree, np.array([[angle, 0.0, 1.0]]))):
            ratio = math.factorial(degree + m) / math.factorial(degree - m)
            expected = math.sqrt(ratio * (2 if m else 1)) * (-angle / 2) ** m / math.factorial(m)
            np.testing.assert_allclose(wave, [expected], rtol=1e-14)


def test_crystals_have_the_values_of_the_literature():
    """Mickel et al. (2013), J. Chem. Phys. 138, 044501, table I."""
    fcc = xcg.datasets.face_centred_cubic(4).cg.bond_order()
    np.testing.assert_allclose(fcc.q4, 0.19094, atol=5e-6)
    np.testing.assert_allclose(fcc.q6, 0.57452, atol=5e-6)
    assert float(fcc.global_q6[0]) == pytest.approx(0.57452, abs=5e-6)
    cubic = xcg.datasets.simple_cubic(4).cg.bond_order(neighbours=6)
    np.testing.assert_allclose(cubic.q4, 0.76376, atol=5e-6)
    np.testing.assert_allclose(cubic.q6, 0.35355, atol=5e-6)


@pytest.mark.parametrize("dimension", [2, 3])
def test_independent_directions_have_the_order_of_a_random_walk(dimension):
    """The mean square over n neighbours of points at random is 1 / n, whatever the degree."""
    steps = 40
    periodic = "xyz"[:dimension]
    order = gas(steps, 150, periodic, dimension).cg.bond_order([3, 6], neighbours=7)
    letter = "q" if dimension == 3 else "psi"
    for degree in (3, 6):
        square = (order[f"{letter}{degree}"] ** 2).mean("particle")
        assert abs(float(square.mean()) - 1 / 7) < 4 * float(square.std()) / np.sqrt(steps)


def test_a_triangular_lattice_has_one_direction():
    rows, columns = 6, 8
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    places = np.stack([x + 0.5 * (y % 2), y * np.sqrt(0.75), 0 * x], axis=-1).reshape(-1, 3)
    ds = xcg.scene_from_arrays(
        places,
        diameter=np.ones(len(places)),
        density=1.0,
        box=[(0, columns), (0, rows * np.sqrt(0.75)), (0, 1)],
        periodic="xy",
        dimension=2,
    )
    order = ds.cg.bond_order()
    np.testing.assert_allclose(order.psi6, 1, atol=1e-12)
    np.testing.assert_allclose(order.psi6_angle, 0, atol=1e-12)
    np.testing.assert_allclose(order.global_psi6, 1, atol=1e-12)


@pytest.mark.parametrize("periodic", ["xy", ""])
def test_a_square_lattice_has_fourfold_order(periodic):
    """Its four neighbours cancel in degree 6."""
    places = np.stack([*np.indices((5, 5)), np.zeros((5, 5))], axis=-1).reshape(-1, 3)
    ds = xcg.scene_from_arrays(
        places,
        diameter=np.ones(25),
        density=1.0,
        box=[(0, 5), (0, 5), (0, 1)],
        periodic=periodic,
        dimension=2,
    )
    order = ds.cg.bond_order([4, 6], neighbours=4).isel(time=0)
    inside = np.ones(25, bool)
    if not periodic:
        inside = (places[:, :2] % 4 != 0).all(axis=1)
    np.testing.assert_allclose(order.psi4[inside], 1, atol=1e-14)
    np.testing.assert_allclose(order.psi4_angle[inside], 0, atol=1e-14)
    np.testing.assert_allclose(order.psi6[inside], 0, atol=1e-14)


def test_the_angle_turns_with_the_neighbours():
    turn = 0.1 + np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    ds = xcg.scene_from_arrays(
        np.concatenate([np.zeros((1, 3)), ring]),
        diameter=np.ones(7),
        density=1.0,
        dimension=2,
        box=[(-2, 2), (-2, 2), (0, 1)],
    )
    order = ds.cg.bond_order()
    assert float(order.psi6[0, 0]) == pytest.approx(1, abs=1e-12)
    assert float(order.psi6_angle[0, 0]) == pytest.approx(0.1, abs=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_freud_agrees_within_its_single_precision(dimension):
    freud = pytest.importorskip("freud")
    ds = xcg.datasets.random_scene(400, dimension=dimension, seed=2)
    position = ds.position.to_numpy()[0] - 2.5
    if dimension == 2:
        position[:, 2] = 0.0
    box = freud.box.Box.cube(5.0) if dimension == 3 else freud.box.Box.square(5.0)
    number = 12 if dimension == 3 else 6
    found = ds.cg.bond_order()
    system = (box, position)
    for degree in (4, 6) if dimension == 3 else (6,):
        kind = freud.order.Steinhardt(degree) if dimension == 3 else freud.order.Hexatic(degree)
        kind.compute(system, {"num_neighbors": number})
        name = f"q{degree}" if dimension == 3 else f"psi{degree}"
        np.testing.assert_allclose(found[name][0], np.abs(kind.particle_order), atol=1e-4)


@pytest.mark.parametrize("at_one_place", [2, 5])  # five push each other out of the two nearest
def test_a_neighbour_at_the_same_place_is_an_error(at_one_place):
    position = [[0.0, 0, 0]] + [[1.0, 0, 0]] * at_one_place
    ds = xcg.scene_from_arrays(position, diameter=1.0, density=1.0)
    for arguments in ({"r_max": 2.0}, {"neighbours": 2}):
        with pytest.raises(xcg.SceneError, match="particle 1 has a neighbour at its own place"):
            ds.cg.bond_order(**arguments)


def test_particles_without_neighbours_are_nan():
    position = [[0.0, 0, 0], [1, 0, 0], [9, 0, 0]]
    ds = xcg.scene_from_arrays(position, diameter=[1.0] * 3, density=1.0)
    order = ds.cg.bond_order(r_max=2.0)
    np.testing.assert_array_equal(np.isnan(order.q6[0]), [False, False, True])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_step_without_any_neighbour_is_nan_in_silence(dimension):
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0], [3, 0, 0]], diameter=[1.0, 1.0], density=1.0, dimension=dimension
    )
    order = ds.cg.bond_order(r_max=2.0).drop_vars("particle_id")
    assert all(order[name].isnull().all() for name in order.data_vars)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"r_max": 2.6}, r"r_max=2.6.*nearest image; take r_max=2.5 or less"),
        ({"neighbours": 40}, "nearest 40 particles, and the step holds 40"),
        ({"neighbours": 39}, "nearest 39 particles are beyond half"),
        ({"neighbours": 0}, "neighbours=0"),
        ({"neighbours": 3, "r_max": 1.0}, "one of neighbours= .* and r_max="),
        ({"degrees": [0]}, "degrees="),
        ({"r_max": -1.0}, "r_max=-1.0"),
    ],
)
def test_wrong_input_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        gas(1, 40, "xyz").cg.bond_order(**arguments)
