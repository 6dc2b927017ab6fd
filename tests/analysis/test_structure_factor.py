"""Structure factor: sums of exponentials, crystals, hard spheres, fluctuations of numbers."""

import numpy as np
import pytest

from tests.analysis import percus_yevick
from tests.scenes import gas, hard_spheres

BOXES = {
    "box": ("xyz", 3, {}),
    "tilted": ("xyz", 3, {"lattice": {"xy": 1.0, "xz": 0.5, "yz": -1.0}}),
    "layer": ("xy", 2, {}),
}


@pytest.mark.parametrize("box", BOXES)
def test_waves_are_sums_of_exponentials(box):
    periodic, dimension, options = BOXES[box]
    ds = gas(1, 101, periodic, dimension, **options)
    rng = np.random.default_rng(1)
    numbers = rng.integers(-9, 10, (20, dimension))
    f = ds.cg.structure_factor(vectors=numbers, by="species", groups=[1, 2, 3])
    position = ds.position.to_numpy()[0]
    species = ds.species.to_numpy()[0]
    wave = np.exp(-1j * position @ f.wave_vector.to_numpy()[0].T)
    groups = [species > 0, *(species == k for k in (1, 2, 3))]
    for a, first in enumerate(groups):
        for b, second in enumerate(groups):
            product = wave[first].sum(axis=0) * wave[second].sum(axis=0).conj()
            expected = product.real / np.sqrt(first.sum() * second.sum())
            np.testing.assert_allclose(
                f.structure_factor[0, a, b], expected, rtol=1e-12, atol=1e-12
            )
    # wave vectors are those of the box: they do not change under its periods
    cell = np.diag([5.0, 6.0, 7.0])
    if "lattice" in ds:
        cell = ds.lattice.to_numpy().reshape(-1, 3, 3)[0]
    turns = f.wave_vector.to_numpy()[0] @ cell.T / (2 * np.pi)
    np.testing.assert_allclose(turns[:, :dimension], numbers, atol=1e-12)


@pytest.mark.parametrize("box", BOXES)
def test_the_isotropic_one_is_the_mean_over_all_vectors(box):
    periodic, dimension, options = BOXES[box]
    ds = gas(1, 60, periodic, dimension, **options)
    k_max, bins = 6.0, 4
    f = ds.cg.structure_factor(k_max, bins=bins, samples=None)
    grid = np.stack(np.meshgrid(*[np.arange(-12, 13)] * dimension), axis=-1).reshape(-1, dimension)
    waves = ds.cg.structure_factor(vectors=grid[grid.any(axis=1)])
    k = np.linalg.norm(waves.wave_vector[0], axis=1)
    number, _ = np.histogram(k, bins, (0, k_max))
    total, _ = np.histogram(k, bins, (0, k_max), weights=waves.structure_factor[0])
    np.testing.assert_array_equal(2 * f.wave_count[0], number)
    np.testing.assert_allclose(f.structure_factor[0], total / number, rtol=1e-11)
    drawn = ds.cg.structure_factor(k_max, bins=bins, samples=10)
    np.testing.assert_array_equal(drawn.wave_count, np.minimum(f.wave_count, 10))


def test_hard_spheres_follow_percus_and_yevick():
    ds = hard_spheres()
    f = ds.cg.structure_factor(18.0, bins=36)
    s = f.structure_factor.mean("time")
    error = f.structure_factor.std("time") / np.sqrt(f.sizes["time"])
    known = f.wave_count[0] > 0
    # the wavenumbers of a bin are not all its middle: compare with the mean over its width
    offsets = (np.arange(10) - 4.5) / 10 * 0.5
    expected = percus_yevick(f.k.to_numpy()[:, None] + offsets, 0.3).mean(axis=1)
    wide = known & (f.k > 3)
    assert (np.abs(s - expected) < 0.05 * expected + 4 * error).where(wide, True).all()


def test_long_waves_are_fluctuations_of_numbers():
    """Parseval: the variance of the number in Gaussian windows at all places is a sum over S(k)."""
    ds = gas(1, 200, "xyz")
    x = ds.position.to_numpy()[0, :, 0]
    edge = 5.0
    width = 0.5
    most = 12
    f = ds.cg.structure_factor(vectors=[(h, 0, 0) for h in range(1, most + 1)])
    k = f.wave_vector.to_numpy()[0, :, 0]
    window = np.sqrt(2 * np.pi) * width / edge * np.exp(-0.5 * (k * width) ** 2)
    variance = 2 * (len(x) * f.structure_factor[0] * window**2).sum()
    places = np.arange(64) * edge / 64
    images = np.arange(-3, 4)[:, None, None] * edge
    numbers = np.exp(-0.5 * ((x - places[:, None] + images) / width) ** 2).sum(axis=(0, 2))
    assert numbers.var() == pytest.approx(float(variance), rel=1e-10)


def test_compressibility_of_hard_spheres_is_reached_at_small_wavenumbers():
    """S(0) = (1 - phi)^4 / (1 + 4 phi + 4 phi^2 - 4 phi^3 + phi^4), Carnahan & Starling."""
    ds = hard_spheres()
    f = ds.cg.structure_factor(vectors=[(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1)])
    k = np.linalg.norm(f.wave_vector[0], axis=1)
    phi = 0.3
    zero = (1 - phi) ** 4 / (1 + 4 * phi + 4 * phi**2 - 4 * phi**3 + phi**4)
    # S(k) grows with k^2 at first, as Percus and Yevick have it
    expected = zero + percus_yevick(k, phi) - percus_yevick(1e-3, phi)
    mean = float((f.structure_factor / expected).mean())
    samples = (f.structure_factor / expected).mean("wave")
    assert abs(mean - 1) < 4 * float(samples.std("time")) / np.sqrt(f.sizes["time"])


@pytest.mark.parametrize(
    ("periodic", "arguments", "message"),
    [
        ("xy", {"k_max": 5.0}, "needs periodic axes; open: z"),
        ("xyz", {}, "takes one of k_max= .* and vectors="),
        ("xyz", {"k_max": -1.0}, "k_max=-1.0"),
        ("xyz", {"k_max": 5.0, "bins": 0}, "bins=0"),
        ("xyz", {"k_max": 5.0, "samples": 0.5}, "samples=0.5"),
        ("xyz", {"vectors": [(0.5, 0, 0)]}, "vectors=.*whole numbers"),
        ("xyz", {"vectors": [(1, 0)]}, r"vectors=.*\(waves, 3\)"),
        ("xyz", {"k_max": 1e4}, "more than 3e.08 wave vectors"),
    ],
)
def test_wrong_input_is_named(periodic, arguments, message):
    with pytest.raises(ValueError, match=message):
        gas(1, 40, periodic).cg.structure_factor(**arguments)
