"""Radial distribution: brute force, ideal gas, crystals, hard spheres, tilted boxes, regions, phases."""

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.analysis import percus_yevick_g
from tests.scenes import gas, hard_spheres


def pair_vectors(ds, bounds):
    """Vectors (n, n, 3) between all particles of the first step, to the nearest image, and who is inside."""
    x = ds.position.to_numpy()[0]
    d = x[None] - x[:, None]
    cell = np.diag([5.0, 6.0, 7.0])
    if "lattice" in ds:
        cell = ds.lattice.to_numpy().reshape(-1, 3, 3)[0]
    images = [
        [
            n if "xyz"[k] in ds.attrs["periodic"] and "xyz"[k] not in bounds else 0
            for n in (-1, 0, 1)
        ]
        for k in range(3)
    ]
    shifts = np.array(np.meshgrid(*images)).reshape(3, -1).T @ cell
    near = d[:, :, None] + np.unique(shifts, axis=0)
    best = (near**2).sum(axis=-1).argmin(axis=-1)
    inside = np.ones(len(x), bool)
    for axis, (low, high) in bounds.items():
        inside &= (x[:, "xyz".index(axis)] >= low) & (x[:, "xyz".index(axis)] < high)
    return np.take_along_axis(near, best[..., None, None], axis=2)[:, :, 0], inside


CASES = {
    "periodic": ("xyz", 3, {}, {}),
    "slab": ("xy", 3, {"z": (1.0, 5.0)}, {}),
    "open": ("", 3, {"x": (0.0, 5.0), "y": (1.0, 6.0), "z": (0.0, 7.0)}, {}),
    "part of a period": ("xyz", 3, {"y": (1.0, 4.0)}, {}),
    "layer": ("xy", 2, {}, {}),
    "strip": ("x", 2, {"y": (0.5, 6.0)}, {}),
    "tilted": ("xyz", 3, {}, {"lattice": {"xy": 1.0, "xz": 0.5, "yz": -1.0}}),
    "tilted slab": ("xyz", 3, {"z": (1.0, 5.0)}, {"lattice": {"xy": 2.0}}),
}


@pytest.mark.parametrize("case", CASES)
def test_pairs_are_those_of_brute_force(case):
    periodic, dimension, bounds, options = CASES[case]
    ds = gas(1, 250, periodic, dimension, **options)
    axis, bins, angles = "z", 7, 5
    g = ds.cg.radial_distribution(
        2.0, bins=bins, axis=axis, angles=angles, by="species", groups=[1, 2, 3], bounds=bounds
    )
    d, inside = pair_vectors(ds, bounds)
    r = np.linalg.norm(d, axis=-1)
    theta = np.arctan2(d[..., 1], d[..., 0]) % np.pi
    is_pair = np.outer(inside, inside) & ~np.eye(len(r), dtype=bool)
    species = ds.species.to_numpy()[0]
    for a in range(4):
        for b in range(4):
            chosen = is_pair & np.outer(species == a if a else True, np.full(len(r), True))
            chosen = chosen & (species == b if b else True)
            expected, _, _ = np.histogram2d(
                theta[chosen], r[chosen], [angles, bins], [[0, np.pi], [0, 2.0]]
            )
            np.testing.assert_array_equal(g.pair_count[0, a, b], expected)
    # by distance alone, and its normalisation in a box without open sides
    plain = ds.cg.radial_distribution(2.0, bins=bins, bounds=bounds)
    np.testing.assert_array_equal(plain.pair_count, g.pair_count[:, 0, 0].sum("theta"))
    if not bounds:
        count = len(r)
        edges = np.linspace(0, 2.0, bins + 1)
        shells = np.diff(4 / 3 * np.pi * edges**3) / 210 if dimension == 3 else None
        shells = np.diff(np.pi * edges**2) / 30 if shells is None else shells
        np.testing.assert_allclose(
            plain.radial_distribution[0],
            plain.pair_count[0] / (count * (count - 1) * shells),
            rtol=1e-12,
        )


@pytest.mark.parametrize("case", CASES)
def test_the_ideal_gas_is_one_within_its_standard_error(case):
    """Also at the sides of a region, where shells are cut, for phases, and for distances over diameters."""
    periodic, dimension, bounds, options = CASES[case]
    steps = 75
    ds = gas(steps, 200, periodic, dimension, **options)
    for more in (
        {"axis": "z"},
        {"by": "species", "groups": [1, 2, 3]},
        {"axis": "z", "scaled": True, "r_max": 6.0},
    ):
        arguments = {"r_max": 2.0, "bins": 3, "angles": 2, "bounds": bounds} | more
        g = ds.cg.radial_distribution(**arguments).radial_distribution
        deviation = (g.mean("time") - 1) / (g.std("time") / np.sqrt(steps))
        assert np.abs(deviation).max() < 4.5
        assert float((deviation**2).mean()) < 3


def test_accessible_shells_are_those_of_quadrature():
    """The mean number of pairs of a cut region, against the integral of the overlap of the region with itself."""
    from xcg.analysis.radial_distribution import RadialDistribution
    from xcg.scene.lattice import Lattice

    lengths = np.array([5.0, 3.0, 4.0])
    bounds = {a: (0.0, length) for a, length in zip("xyz", lengths.tolist(), strict=True)}
    analysis = RadialDistribution(r_max=2.5, bins=5, axis="y", angles=4, bounds=bounds)
    radius = np.full(100, 0.5)
    found = analysis._expected(radius, np.zeros(100, int), Lattice(np.full(3, np.inf)))[0, 0]
    x, w = np.polynomial.legendre.leggauss(40)
    edges = np.linspace(0, 2.5, 6)
    for angle in range(4):
        for shell in range(5):
            half = 0.5 * np.diff(edges)[shell]
            r = edges[shell] + half * (x + 1)
            polar = np.pi / 4 * (x + 1)  # a half of the sphere, twice
            turn = np.pi / 4 * (angle + 0.5 * (x + 1))
            rr, pp, tt = np.meshgrid(r, polar, turn, indexing="ij")
            weight = half * np.pi / 4 * np.pi / 8 * np.einsum("i,j,k->ijk", w, w, w)
            h = np.stack([np.sin(pp) * np.cos(tt), np.cos(pp), np.sin(pp) * np.sin(tt)]) * rr
            overlap = (1 - np.abs(h) / lengths[:, None, None, None]).prod(axis=0)
            # both halves, and both directions of a pair
            volume = 4 * (weight * rr**2 * np.sin(pp) * overlap).sum()
            expected = 100 * 99 / lengths.prod() * volume
            assert found[angle, shell] == pytest.approx(expected, rel=1e-12)


def test_shells_of_a_crystal_hold_their_neighbours():
    ds = xcg.datasets.face_centred_cubic(5)
    # shells of fcc at 1, sqrt 2, sqrt 3, 2, sqrt 5, sqrt 6, sqrt 7: 12, 6, 24, 12, 24, 8, 48
    g = ds.cg.radial_distribution(2.7, bins=27)
    per_particle = g.pair_count[0] / ds.sizes["particle"]
    places = np.sqrt(np.arange(2, 8))
    for place, number in zip(places, [6, 24, 12, 24, 8, 48], strict=True):
        around = per_particle.sel(r=slice(place - 0.08, place + 0.08))
        assert float(around.sum()) == number
    assert int(per_particle.sel(r=slice(0, 1.2)).sum()) == 12


def test_hard_spheres_follow_percus_and_yevick():
    ds = hard_spheres()
    g = ds.cg.radial_distribution(3.0, bins=150).radial_distribution
    assert float(g.sel(r=slice(0, 0.99)).max()) == 0
    r, expected = percus_yevick_g(0.3)
    mean = g.mean("time")
    error = g.std("time") / np.sqrt(ds.sizes["time"])
    beyond = mean.r > 1.1
    difference = mean - np.interp(mean.r, r, expected)
    # Percus and Yevick are 2 % off at this density; the fixed number of particles shifts g by 1 / N
    assert (np.abs(difference) < 0.03 + 4 * error).where(beyond, True).all()
    assert float(np.sqrt((difference**2).where(beyond).mean())) < 0.02


def test_directions_of_a_crystal_are_resolved():
    """Neighbours of a simple cubic lattice lie along axes: at angles 0 and pi/2, also across the periods."""
    ds = xcg.datasets.simple_cubic(4)
    g = ds.assign(position=ds.position + 0.3).cg.radial_distribution(
        1.2, bins=1, axis="y", angles=9
    )
    pairs = g.pair_count[0, :, 0] / ds.sizes["particle"]
    # along x at 0 (or pi, by rounding), along z at pi/2; along y itself at any angle
    assert int(pairs.sum()) == 6
    assert int(pairs[4]) == 2
    assert int(pairs[0] + pairs[-1]) in (2, 4)


def test_frozen_particles_are_left_out():
    ds = gas(1, 100, "xyz")
    frozen = xr.zeros_like(ds.species).where(ds.particle < 50, 1).astype("int64")
    half = ds.isel(particle=slice(0, 50))
    xr.testing.assert_equal(
        ds.assign(frozen=frozen).cg.radial_distribution(2.0),
        half.cg.radial_distribution(2.0),
    )


def test_steps_share_threads_with_the_same_bits():
    from tests import sharing_threads

    ds = gas(1, 50_000, "xyz")
    one = ds.cg.radial_distribution(0.3)
    with sharing_threads(3):
        xr.testing.assert_equal(ds.cg.radial_distribution(0.3), one)


@pytest.mark.parametrize(
    ("periodic", "arguments", "message"),
    [
        ("xyz", {"r_max": 2.6}, r"r_max=2.6.*nearest image.*5 along 'x'.*r_max=2.5 or less"),
        ("xy", {"r_max": 1.0}, r"along z: .*bounds=\{'z': \(low, high\)\}.*0\..* and 6\."),
        ("xy", {"r_max": 2.0, "bounds": {"z": (0, 1)}}, "r_max=2.*1 of bounds.*take r_max=1"),
        ("xyz", {"r_max": 1.0, "bounds": {"z": (0, 1e-9)}}, "region holds 0"),
        ("xyz", {"r_max": 0.0}, "r_max=0"),
        ("xyz", {"r_max": 1.0, "bins": 0}, "bins=0"),
        ("xyz", {"r_max": 1.0, "axis": "q"}, "axis='q'"),
        ("xyz", {"r_max": 1.0, "bounds": {"q": (0, 1)}}, "bounds="),
    ],
)
def test_wrong_input_is_named(periodic, arguments, message):
    with pytest.raises(ValueError, match=message):
        gas(1, 40, periodic).cg.radial_distribution(**arguments)


def test_bounds_that_cut_tilted_images_are_an_error():
    ds = gas(1, 40, "xyz", lattice={"xy": 1.0})
    with pytest.raises(xcg.SceneError, match="box is tilted"):
        ds.cg.radial_distribution(1.0, bounds={"x": (0.0, 2.0)})


def test_all_open_axes_are_named_in_order():
    with pytest.raises(xcg.SceneError, match=r"not periodic along x, y, z: .*'x': .*'y': .*'z'"):
        gas(1, 40, "").cg.contact_value()


def test_particles_without_size_have_no_scaled_distances():
    ds = gas(1, 40, "xyz")
    with pytest.raises(xcg.SceneError, match="all diameters are zero"):
        ds.assign(diameter=0 * ds.diameter).cg.contact_value()


def test_one_particle_is_an_error():
    with pytest.raises(xcg.SceneError, match="needs two particles"):
        gas(1, 1, "xyz").cg.radial_distribution(1.0)


def test_freud_agrees_within_its_single_precision():
    freud = pytest.importorskip("freud")
    count = 10_000
    edge = (count * np.pi / 6 / 0.6) ** (1 / 3)
    rng = np.random.default_rng(0)
    position = rng.uniform(0, edge, (1, count, 3))
    ds = xcg.scene_from_arrays(
        position, diameter=np.ones((1, count)), density=1.0, box=[(0, edge)] * 3, periodic="xyz"
    )
    g = ds.cg.radial_distribution(5.0)
    rdf = freud.density.RDF(bins=100, r_max=5.0)
    rdf.compute((freud.box.Box.cube(edge), position[0] - edge / 2))
    assert abs(int(g.pair_count.sum()) - int(rdf.bin_counts.sum())) <= 20
    scale = (count - 1) / count
    np.testing.assert_allclose(g.radial_distribution[0, 5:] * scale, rdf.rdf[5:], rtol=2e-3)
