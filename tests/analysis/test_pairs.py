"""Pairs against brute force on any scene: sizes, periods, layers, touching, coincident and lost particles."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import xcg
from xcg.analysis.pairs import CellLists, find_pairs


def all_pairs(position, radius, box=None, periodic="", skin=0.0):
    """Every pair straight from the definition: all distances, nearest images."""
    d = position[:, None] - position[None]
    for k, axis in enumerate("xyz"):
        if axis in periodic:
            period = box[k][1] - box[k][0]
            d[..., k] -= period * np.rint(d[..., k] / period)
    reach = radius[:, None] + radius[None] + skin
    return np.argwhere(np.triu((d**2).sum(axis=-1) < reach**2, 1))


PERIODIC = st.sampled_from(["", "x", "z", "xy", "yz", "xyz"])


@settings(deadline=None, max_examples=300)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 80),
    periodic=PERIODIC,
    lengths=st.tuples(*[st.floats(0.3, 6.0)] * 3),
    decades=st.sampled_from([0.0, 0.3, 1.0, 3.0]),
    skin=st.sampled_from([0.0, 0.0, 0.3]),
    origin=st.sampled_from([0.0, -2.0, 1e4]),
    layer=st.booleans(),
    levels=st.sampled_from([None, 1, 4]),
    threads=st.sampled_from([1, 3]),
)
def test_pairs_equal_those_of_brute_force(
    seed, count, periodic, lengths, decades, skin, origin, layer, levels, threads
):
    rng = np.random.default_rng(seed)
    # particles lie outside the box as well
    position = rng.uniform(-0.5, 1.5, (count, 3)) * lengths + origin
    if layer:
        position[:, 2] = origin
    radius = 0.4 * 10 ** (-decades * rng.random(count))
    box = [(origin, origin + length) for length in lengths]
    found = find_pairs(position, radius, box, periodic, skin=skin, levels=levels, threads=threads)
    np.testing.assert_array_equal(found, all_pairs(position, radius, box, periodic, skin))


@settings(deadline=None, max_examples=150)
@given(
    data=st.data(),
    periodic=PERIODIC,
    count=st.integers(0, 40),
    cells=st.tuples(*[st.integers(1, 5)] * 3),
    skin=st.sampled_from([0.0, 0.25]),
)
def test_exactly_touching_and_coincident_particles_are_found(data, periodic, count, cells, skin):
    """On a lattice of quarters every distance is exact: touching is not closer, and a duplicate is a pair."""
    place = st.tuples(*[st.integers(-2, 8 * n + 2) for n in cells])
    position = (
        np.array(data.draw(st.lists(place, min_size=count, max_size=count)), float).reshape(-1, 3)
        / 8
    )
    size = st.sampled_from([0.0, 0.125, 0.25, 0.5, 1.0, 2.0])
    radius = np.array(data.draw(st.lists(size, min_size=count, max_size=count)))
    box = [(0.0, float(n)) for n in cells]
    expected = all_pairs(position, radius, box, periodic, skin)
    for levels in (None, 1):
        np.testing.assert_array_equal(
            find_pairs(position, radius, box, periodic, skin=skin, levels=levels), expected
        )


@pytest.mark.parametrize("periodic", ["", "xyz"])
@pytest.mark.parametrize("decades", [0.0, 1.0])
def test_pairs_within_a_skin_of_many_radii(periodic, decades):
    """Cells and what is looked for in them reach as far as the skin does, not as far as radii alone."""
    rng = np.random.default_rng(4)
    position = rng.uniform(0, 10, (400, 3))
    radius = 0.05 * 10 ** (-decades * rng.random(400))
    box = [(0.0, 10.0)] * 3
    for skin in (0.4, 2.8, 6.0):  # the last reaches an image of its own partner
        expected = all_pairs(position, radius, box, periodic, skin)
        for levels in (None, 1):
            found = find_pairs(position, radius, box, periodic, skin=skin, levels=levels)
            np.testing.assert_array_equal(found, expected)


def test_touching_pairs_are_found_only_with_a_skin():
    position = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    assert find_pairs(position, [0.5, 0.5]).shape == (0, 2)
    assert find_pairs(position, [0.5, 0.5], skin=1e-9).tolist() == [[0, 1]]


def test_positions_in_a_plane_and_mappings_are_accepted():
    rng = np.random.default_rng(1)
    flat = rng.random((300, 2))
    radius = rng.uniform(0.01, 0.06, 300)
    solid = np.column_stack([flat, np.zeros(300)])
    expected = all_pairs(solid, radius, [(0, 1)] * 3, "xy")
    for box in ([(0, 1), (0, 1)], {"x": (0, 1), "y": (0, 1)}):
        np.testing.assert_array_equal(find_pairs(flat, radius, box, "xy"), expected)
    for axes in ([0, 1, 2], [2, 0, 1], [0, 2, 1]):
        np.testing.assert_array_equal(find_pairs(solid[:, axes], radius), all_pairs(solid, radius))


def test_a_lost_particle_does_not_slow_the_search():
    rng = np.random.default_rng(2)
    position = rng.random((20_000, 3))
    radius = np.full(20_000, 0.015)
    position[0] = 1e9
    lists = CellLists.of(position, radius, np.zeros(3), np.full(3, np.inf), skin=0.0, levels=None)
    assert lists.find(0, 20_000)[2] < 60 * 20_000
    assert len(lists.records.of_cell) < 20 * 20_000


def test_work_does_not_grow_with_the_ratio_of_sizes():
    rng = np.random.default_rng(3)
    for ratio in (1.0, 10.0, 100.0):
        radius = np.where(np.arange(20_000) < 3, ratio, 1.0)
        edge = float((4 / 3 * np.pi * (radius**3).sum() / 0.6) ** (1 / 3))
        position = rng.uniform(0, edge, (20_000, 3))
        lists = CellLists.of(position, radius, np.zeros(3), np.full(3, edge), skin=0.0, levels=None)
        assert lists.find(0, 20_000)[2] < 20 * 20_000


@pytest.mark.parametrize("count", [0, 1])
def test_no_pairs_among_few_particles(count):
    assert find_pairs(np.zeros((count, 3)), np.ones(count)).shape == (0, 2)
    assert find_pairs([], []).shape == (0, 2)


def test_particles_in_one_place_are_all_pairs():
    assert len(find_pairs(np.zeros((50, 3)), np.full(50, 0.1))) == 50 * 49 // 2
    assert len(find_pairs(np.zeros((50, 3)), np.zeros(50))) == 0


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((np.zeros((3, 4)), np.ones(3)), {}, r"shape \(3, 4\)"),
        ((np.zeros((3, 3)), np.ones(2)), {}, r"radius \(2,\)"),
        ((np.full((3, 3), np.nan), np.ones(3)), {}, "particle 0 has position"),
        ((np.zeros((3, 3)), [1, 1, -1]), {}, "particle 2 has position .* radius -1"),
        ((np.zeros((3, 3)), np.ones(3), None, "x"), {}, "axis 'x' is periodic"),
        ((np.zeros((3, 3)), np.ones(3)), {"skin": -1.0}, "skin=-1.0"),
        ((np.zeros((3, 3)), np.ones(3)), {"levels": 0}, "levels=0"),
        ((np.zeros((3, 3)), np.ones(3)), {"threads": 1.5}, "threads=1.5"),
    ],
)
def test_wrong_arguments_raise(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        find_pairs(*arguments, **options)


def test_fcc_has_twelve_neighbours():
    ds = xcg.datasets.face_centred_cubic(4)
    pairs = find_pairs(ds.position[0], ds.diameter[0] / 2, ds.box[0].values, "xyz", skin=1e-9)
    assert len(pairs) == 6 * ds.sizes["particle"]


@pytest.mark.skipif(sys.platform != "linux", reason="limits the memory of a process")
def test_too_many_pairs_end_the_search_before_memory_does():
    """30,000 grains in one place have 450 million pairs."""
    code = """
import resource, numpy as np, xcg
from xcg.analysis.pairs import find_pairs
find_pairs(np.zeros((2, 3)), np.ones(2))
ds = xcg.scene_from_arrays(np.zeros((30_000, 3)), diameter=np.ones(30_000))
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (1 << 30), used + (1 << 30)))
for call in (lambda: find_pairs(np.zeros((30_000, 3)), np.ones(30_000)), lambda: xcg.find_contacts(ds, max_contacts=9)):
    try:
        call()
    except xcg.SceneError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.count("more than 6000000 pairs of near particles among 30000") == 2, (
        done.stderr
    )


def test_most_raises_the_limit_on_pairs():
    n = 1500
    assert len(find_pairs(np.zeros((n, 3)), np.ones(n), max_pairs=2_000_000)) == n * (n - 1) // 2
    with pytest.raises(xcg.SceneError, match="more than 1000000 pairs"):
        find_pairs(np.zeros((n, 3)), np.ones(n))
