from __future__ import annotations

import tracemalloc
from itertools import pairwise

import dask
import numpy as np
import pytest
import xarray as xr
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import xcg
from tests.networks import chains_of, fork, network, nine_particles
from tests.scenes import random_steps


def columns():
    return {frozenset(range(3 * k, 3 * k + 3)) for k in range(3)}


# --- fabricated networks ---------------------------------------------------------------------------------


def test_chains_of_nine_particles():
    """All contacts at 90 degrees, straight chains at 45, and a network split where chains must not branch."""
    ds = nine_particles()
    assert chains_of(ds.cg.force_chains(alpha=90)) == {frozenset(range(9))}
    assert chains_of(ds.cg.force_chains(alpha=45)) == columns()
    for alpha in (45, 90):
        assert chains_of(ds.cg.force_chains(alpha=alpha, algorithm="peters2005")) == columns()


def test_a_branching_chain_is_one_chain():
    ds = fork()
    fc = ds.cg.force_chains(alpha=45)
    assert chains_of(fc) == {frozenset(range(9))}
    assert fc.chain_links.values[0, 0] == 8
    assert fc.chain_branchings.values[0, 0] == 1
    assert fc.branching.values[0].tolist() == [0, 0, 1, 0, 0, 0, 0, 0, 0]
    assert fc.links.values[0].tolist() == [1, 2, 3, 2, 2, 1, 2, 2, 1]
    np.testing.assert_allclose(np.abs(fc.chain_normal.values[0, 0]), [0, 0, 1], atol=1e-12)
    linear = ds.cg.force_chains(alpha=45, algorithm="peters2005")
    assert linear.chain_particles.values[0, :2].tolist() == [6, 3]
    assert (linear.links.values <= 2).all()


def test_chains_that_part_and_merge_are_one_ring():
    """A ring is one chain with as many links as grains, and each particle has two."""
    angle = 2 * np.pi * np.arange(8) / 8
    position = np.stack([np.cos(angle), np.sin(angle)], axis=1) / (2 * np.sin(np.pi / 8))
    fc = network(
        position, [(k, (k + 1) % 8) for k in range(8)], np.ones(8), dimension=2, thickness=1.0
    ).cg.force_chains()
    assert fc.chain_particles.values[0, 0] == fc.chain_links.values[0, 0] == 8
    assert (fc.link_chain.values == 0).all()


def test_angles_in_radians_warn():
    with pytest.warns(xcg.SceneWarning, match="is it in radians"):
        xcg.datasets.random_scene(20).cg.force_chains(alpha=np.pi / 4)


def test_straight_chain():
    direction = np.array([1.0, 2.0, 3.0]) / np.sqrt(14)
    fc = network(
        np.outer(np.arange(5), direction), [(k, k + 1) for k in range(4)], np.ones(4)
    ).cg.force_chains(alpha=2)
    np.testing.assert_allclose(fc.chain_orientation.values[0, 0], direction, atol=1e-12)
    assert np.isnan(fc.chain_normal.values[0, 0]).all()
    # directions point onward, from the first particle to the last
    np.testing.assert_allclose(np.abs(fc.major_direction.values[0, 1:] @ direction), 1)
    assert (fc.major_direction.values[0, 1:] @ direction > 0).all()
    assert fc.parent_id.values[0].tolist() == [-1, 0, 1, 2, 3]


def test_long_chain():
    """No recursion: a chain of a million grains."""
    n = 1_000_000
    pairs = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    fc = network(np.arange(n)[:, None], pairs, np.ones(n - 1)).cg.force_chains()
    assert fc.chain_count.item() == 1
    assert fc.length_max.item() == n
    assert fc.chain_links.values[0, 0] == n - 1


def test_chain_across_a_periodic_edge():
    """A chain that spans the box closes on itself; its shape is that of the continuous chain."""
    position = np.stack([np.arange(10) + 0.25, np.full(10, 0.5), np.full(10, 0.5)], axis=1)
    shift = np.roll(position, 5, axis=0)
    pairs = [(k, (k + 1) % 10) for k in range(9)]
    force = np.tile([-1.0, 0, 0], (9, 1))
    ds = xcg.scene_from_arrays(
        shift, diameter=np.full(10, 1.1), density=1.0, contact_i=[i for i, _ in pairs], contact_j=[j for _, j in pairs],
        contact_force=force, box=[[0, 10.0]] * 3, periodic="x",
    )  # fmt: skip
    fc = ds.cg.force_chains(alpha=10)
    assert fc.length_max.item() == 10
    np.testing.assert_allclose(fc.chain_orientation.values[0, 0], [1, 0, 0], atol=1e-12)
    assert np.isnan(fc.chain_normal.values[0, 0]).all()


def test_one_sided_does_not_turn_back():
    """A V whose arms meet at a sharp tip: links on both sides of a direction, but not both ahead."""
    arm = np.array([np.sin(0.5), np.cos(0.5)])
    position = [(k * arm[0], abs(k) * arm[1]) for k in range(-3, 4)]
    ds = network(position, [(k, k + 1) for k in range(6)], np.ones(6), dimension=2, thickness=1.0)
    assert chains_of(ds.cg.force_chains(alpha=45)) == {frozenset(range(7))}
    # from the end of one arm down to the tip, where the other arm lies behind
    assert chains_of(ds.cg.force_chains(alpha=45, one_sided=True)) == {
        frozenset([0, 1, 2, 3]),
        frozenset([4, 5, 6]),
    }


def test_threshold_and_least_length():
    ds = network(np.arange(9)[:, None], [(k, k + 1) for k in range(8)], [1, 1, 1, 1, 5, 5, 5, 5])
    assert chains_of(ds.cg.force_chains(min_stress="mean")) == {frozenset([4, 5, 6, 7])}
    strong = ds.cg.particle_stress().major_stress.values[0, 6]
    assert chains_of(ds.cg.force_chains(min_stress=strong)) == {frozenset([5, 6, 7])}
    none = ds.cg.force_chains(min_stress=2 * strong)
    assert none.chain_count.item() == 0
    assert np.isnan([none[f"length_{f}"].item() for f in ("mean", "median", "min", "max")]).all()
    assert chains_of(ds.cg.force_chains(min_length=10)) == set()
    assert chains_of(ds.cg.force_chains(min_length=9)) == {frozenset(range(9))}


def test_contacts_in_tension_make_no_chains():
    assert (
        nine_particles()
        .pipe(lambda ds: ds.assign(contact_force=-ds.contact_force))
        .cg.force_chains()
        .chain_count
        == 0
    )


def test_rounding_of_pure_tension_makes_no_chains():
    """In a line that is pulled the largest principal stress is zero, of either sign by rounding."""
    for axis in np.random.default_rng(0).normal(size=(20, 3)):
        line = np.arange(5)[:, None] * 0.98 * axis / np.linalg.norm(axis)
        fc = network(
            line, [(k, k + 1) for k in range(4)], [-1.0, -3.0, -2.0, -0.7]
        ).cg.force_chains(alpha=90)
        assert fc.chain_count == 0
        assert abs(fc.major_stress.values).max() < 1e-12 * abs(fc.principal_stress.values).max()


def test_frozen_grains_are_walls():
    ds = nine_particles()
    fc = (
        ds.assign(frozen=("particle", np.arange(9) // 8))
        .assign(frozen=lambda s: s.frozen.expand_dims("time"))
        .cg
    )
    assert chains_of(fc.force_chains(alpha=90)) == {frozenset(range(8))}


def test_several_contacts_of_a_pair_are_one_link():
    pairs = [(0, 1), (1, 0), (1, 2), (2, 3), (2, 3)]
    aside = np.array([0, 0.1, 0, 0, 0.1])
    i, j = np.array(pairs).T
    point = np.stack(
        [0.5 * (i + j), aside, np.zeros(5)], axis=1
    )  # those of one pair are not in one place
    ds = network(np.arange(4)[:, None], pairs, np.ones(5), contact_point=point)
    fc = ds.cg.force_chains()
    assert fc.links.values[0].tolist() == [1, 2, 2, 1]
    assert fc.link_chain.values[0].tolist() == [0, -1, 0, 0, -1]


def test_numbers_and_lengths_of_chains():
    ds = network(
        np.arange(12)[:, None],
        [(0, 1), (1, 2), (3, 4), (4, 5), (6, 7), (7, 8), (8, 9), (9, 10), (10, 11)],
        np.ones(9),
    )
    fc = ds.cg.force_chains()
    found = {
        name: fc[name].item()
        for name in ("chain_count", "length_mean", "length_median", "length_min", "length_max")
    }
    assert found == {
        "chain_count": 3,
        "length_mean": 4,
        "length_median": 3,
        "length_min": 3,
        "length_max": 6,
    }
    share = fc.length_share.isel(time=0)
    assert share.sel(length=3).item() == pytest.approx(2 / 3)
    assert share.sel(length=6).item() == pytest.approx(1 / 3)
    assert share.sum().item() == pytest.approx(1)


def test_tables_of_chains_and_links():
    fc = fork().cg.force_chains()
    assert repr(fc.cg).startswith("force chains of 1 steps, 9 particles, 8 contacts")
    chains = fc.cg.chain_table()
    links = fc.cg.link_table()
    assert chains[["chain", "particles", "links", "branchings"]].to_numpy().tolist() == [
        [0, 9, 8, 1]
    ]
    assert set(map(tuple, links[["particle_i", "particle_j"]].to_numpy().tolist())) == {
        (0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (2, 6), (6, 7), (7, 8),
    }  # fmt: skip
    np.testing.assert_allclose(links["force"], [2, 2, 1.1, 1, 1, 1.1, 1, 1])
    assert links["contact"].tolist() == list(range(8))


# --- invariance ------------------------------------------------------------------------------------------


def rotated(ds, matrix):
    vectors = [n for n in ("position", "velocity", "contact_force", "contact_point") if n in ds]
    turned = {n: (ds[n].dims, ds[n].values @ matrix.T) for n in vectors}
    return ds.drop_vars("box").assign(turned).assign_attrs(periodic="")


def relabelled(ds, rng):
    """Order the particles anew, under new ids, and the contacts too; return the scene and the new ids."""
    n = ds.sizes["particle"]
    m = ds.sizes["contact"]
    new = np.sort(rng.choice(10 * n, n, replace=False))[rng.permutation(n)]
    order = np.argsort(new)
    shuffled = rng.permutation(m)
    ids = {name: ds[name].values for name in ("contact_i", "contact_j")}
    ids = {
        name: (ds[name].dims, np.where(values >= 0, new[values], values))
        for name, values in ids.items()
    }
    ds = ds.assign(ids).isel(particle=order, contact=shuffled)
    return ds.assign(particle_id=(ds.particle_id.dims, new[order][None])), new


scenes = st.builds(
    lambda n, seed, dimension, polydispersity: xcg.datasets.random_scene(
        n, seed=seed, periodic="", dimension=dimension, polydispersity=polydispersity, edge=3.0
    ),
    st.integers(3, 60), st.integers(0, 10_000), st.sampled_from([2, 3]), st.floats(1.0, 4.0),
)  # fmt: skip
options = st.fixed_dictionaries(
    {
        "alpha": st.floats(5.0, 90.0),
        "algorithm": st.sampled_from(["branching", "peters2005"]),
        "min_stress": st.sampled_from([None, "mean"]),
        "min_length": st.integers(2, 4),
    }
)


@settings(deadline=None, max_examples=40)
@given(ds=scenes, given_options=options, seed=st.integers(0, 1000), mirror=st.booleans())
@example(  # three particles in contact with each other, of which either end of a chain could take the third
    ds=xcg.datasets.random_scene(27, seed=6246, periodic="", polydispersity=2.75, edge=3.0), mirror=False, seed=0,
    given_options={"alpha": 81.0, "algorithm": "peters2005", "min_stress": None, "min_length": 2},
)  # fmt: skip
def test_rotation_mirror_and_labels_change_nothing(ds, given_options, seed, mirror):
    rng = np.random.default_rng(seed)
    matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    matrix *= np.sign(np.linalg.det(matrix)) * (-1 if mirror else 1)
    expected = ds.cg.force_chains(**given_options)
    turned = (
        rotated(ds, matrix).assign_attrs(dimension=3, plane="xyz").cg.force_chains(**given_options)
    )
    assert chains_of(turned) == chains_of(expected)
    np.testing.assert_array_equal(turned.link_chain, expected.link_chain)
    np.testing.assert_allclose(turned.chain_stress, expected.chain_stress, rtol=1e-9)
    other, new = relabelled(ds, rng)
    expected_ids = {frozenset(new[list(chain)].tolist()) for chain in chains_of(expected)}
    assert chains_of(other.cg.force_chains(**given_options)) == expected_ids


def square(angle, across=1.0):
    """Square of 3 x 3 grains without the contact of two of them, turned by an angle."""
    position = np.array([(x, y) for x in range(3) for y in range(3)], float)
    along = [(3 * x + y, 3 * x + y + 1) for x in range(3) for y in range(2)]
    beside = [(3 * x + y, 3 * x + y + 3) for x in range(2) for y in range(3)]
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    pairs = [*along, *beside[:-1]]
    force = [1.0] * len(along) + [across] * (len(beside) - 1)
    return network(position @ turn, pairs, force, dimension=2, thickness=1.0)


@pytest.mark.parametrize("algorithm", ["branching", "peters2005"])
@pytest.mark.parametrize(("alpha", "first"), [(10, 0), (45, 1), (80, 2)])
def test_grains_of_isotropic_stress_have_no_direction(algorithm, alpha, first):
    """Five grains bear the same along both axes: the axis that rounding chooses is no direction."""
    options = {"alpha": alpha, "algorithm": algorithm}
    expected = chains_of(square(0.0, across=0.999).cg.force_chains(**options))
    for angle in np.linspace(0, np.pi, 37)[first::3]:
        fc = square(angle).cg.force_chains(**options).isel(time=0)
        assert fc.isotropic.values.tolist() == [1, 0, 1, 0, 1, 1, 1, 0, 0]
        assert np.isnan(fc.major_direction.values[fc.isotropic.values == 1]).all()
        assert fc.chain_count == 0, np.rad2deg(angle)
        # forces that differ by a thousandth have directions, which turn with the scene
        unequal = square(angle, across=0.999).cg.force_chains(**options)
        assert not unequal.isotropic.any()
        assert chains_of(unequal) == expected


def test_all_contacts_are_links_at_ninety_degrees_without_directions_too():
    for angle in np.linspace(0, np.pi, 37):
        assert chains_of(square(angle).cg.force_chains(alpha=90)) == {frozenset(range(9))}


@settings(deadline=None, max_examples=40)
@given(ds=scenes, threshold=st.sampled_from([None, "mean"]), seed=st.integers(0, 1000))
def test_ninety_degrees_are_connected_components(ds, threshold, seed):
    fc = ds.cg.force_chains(alpha=90, min_stress=threshold, min_length=2)
    stress = ds.cg.particle_stress()
    major = stress.major_stress.values[0]
    qualifies = major > 1e-9
    if threshold:
        qualifies &= major >= major.mean()
    i = ds.contact_i.values[0]
    j = ds.contact_j.values[0]
    edge = (j >= 0) & qualifies[i] & qualifies[np.maximum(j, 0)]
    n = ds.sizes["particle"]
    _, label = connected_components(
        coo_array((np.ones(edge.sum()), (i[edge], j[edge])), shape=(n, n)), directed=False
    )
    components = {
        frozenset(np.flatnonzero(label == k).tolist()) for k in np.unique(label[qualifies])
    }
    assert chains_of(fc) == {c for c in components if len(c) >= 2}
    assert ((fc.link_chain.values[0] >= 0) == edge).all()


@settings(deadline=None, max_examples=30)
@given(
    ds=scenes,
    alpha=st.floats(5.0, 90.0),
    one_sided=st.booleans(),
    algorithm=st.sampled_from(["branching", "peters2005"]),
)
def test_labels_links_and_counts_are_consistent(ds, alpha, one_sided, algorithm):
    fc = ds.cg.force_chains(alpha=alpha, one_sided=one_sided, algorithm=algorithm).isel(time=0)
    chain = fc.chain_id.values
    link = fc.link_chain.values
    links = fc.links.values
    i = fc.contact_i.values
    j = fc.contact_j.values
    on = fc.link_chain.values >= 0
    assert (chain[i[on]] == link[on]).all()
    assert (chain[j[on]] == link[on]).all()
    degree = np.bincount(np.concatenate([i[on], j[on]]), minlength=len(chain))
    assert (links == degree).all()
    assert (links[chain < 0] == 0).all()
    count = int(fc.chain_count)
    assert sorted(set(chain[chain >= 0])) == list(range(count))
    assert (
        fc.chain_particles.values[:count] == np.bincount(chain[chain >= 0], minlength=count)
    ).all()
    assert (fc.chain_links.values[:count] == np.bincount(link[on], minlength=count)).all()
    assert (fc.chain_particles.values[count:] == -1).all()
    # a chain hangs together: every particle but one was reached from another one of the same chain
    parent = fc.parent_id.values
    assert (parent[chain >= 0] == -1).sum() == count
    assert (chain[parent[parent >= 0]] == chain[parent >= 0]).all()


# --- lazy ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheduler", ["synchronous", "threads", "processes"])
def test_lazy_equals_eager_under_every_scheduler(scheduler, computing):
    ds = random_steps(4, more=5, density=1.0)
    region = xcg.BoxRegion((0, 0, 0), (4, 4, 4), velocity=(1, 0, 0)) | xcg.Sphere(
        (1, 1, 1), 2, follow=None
    )
    options = {"alpha": 60, "min_stress": "mean", "region": region}
    eager = ds.cg.force_chains(**options).drop_attrs()
    for chunk in (1, 3):
        lazy = ds.chunk(time=chunk).cg.force_chains(**options)
        assert lazy.chain_id.chunks[0] == ds.chunk(time=chunk).position.chunks[0]
        xr.testing.assert_identical(lazy.compute(**computing(scheduler)).drop_attrs(), eager)
    select = {"region": xcg.Sphere((2, 2, 2), 2), "min_stress": 0.1, "how": "any"}
    some = ds.chunk(time=1).cg.force_chains(**options).cg.select_chains(**select)
    expected = ds.cg.force_chains(**options).cg.select_chains(**select).drop_attrs()
    xr.testing.assert_identical(some.compute(**computing(scheduler)).drop_attrs(), expected)


def test_nothing_computes_while_the_graph_is_built():
    ds = random_steps(4, more=5, density=1.0).chunk(time=1)

    def refuse(dsk, keys, **kwargs):
        pytest.fail("computed while the graph was built")

    with dask.config.set(scheduler=refuse):
        fc = ds.cg.force_chains(min_stress="mean").cg.select_chains(xcg.Sphere((1, 1, 1), 1))
        mean = fc.length_mean.mean()
        stress = ds.cg.particle_stress().major_stress.max()
    assert dask.is_dask_collection(mean)
    assert dask.is_dask_collection(stress)


def test_memory_grows_in_proportion():
    fork().cg.force_chains()  # whatever is compiled and imported once
    peaks = []
    for cells in (20, 40):
        ds = xcg.datasets.random_scene(cells**3 // 4, seed=1, edge=float(cells), walls=False)
        tracemalloc.start()
        ds.cg.force_chains()
        peaks.append(
            tracemalloc.get_traced_memory()[1] / (ds.sizes["particle"] + ds.sizes["contact"])
        )
        tracemalloc.stop()
    assert peaks[1] == pytest.approx(peaks[0], rel=0.2)


def test_chains_written_to_netcdf_read_back_equal(tmp_path):
    fc = random_steps(4, more=5, density=1.0).cg.force_chains(min_stress="mean")
    fc.to_netcdf(tmp_path / "fc.nc")
    with xr.open_dataset(tmp_path / "fc.nc") as back:
        xr.testing.assert_equal(back.load(), fc)


# --- what is refused -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"alpha": 0}, "alpha=0: expected a number .degrees. above 0"),
        ({"alpha": 91}, "alpha=91"),
        (
            {"min_stress": "median"},
            "min_stress='median': expected a finite stress .Pa., or None, or 'mean'",
        ),
        ({"min_stress": np.nan}, "expected a finite stress"),
        ({"min_length": 1}, "min_length=1: expected a whole number"),
        ({"algorithm": "peters"}, "algorithm='peters': expected one of 'branching', 'peters2005'"),
        ({"region": "box"}, r"region='box': expected xcg.BoxRegion"),
        ({"volume": "area"}, "volume='area': expected one of 'particle', 'disc'"),
    ],
)
def test_wrong_arguments_raise(wrong, message):
    with pytest.raises(ValueError, match=message):
        nine_particles().cg.force_chains(**wrong)


def test_missing_contact_forces_raise():
    ds = nine_particles()
    with pytest.raises(xcg.SceneError, match=r"force_chains needs \['contact_force'\]"):
        ds.drop_vars("contact_force").cg.force_chains()
    with pytest.raises(xcg.SceneError, match="call it on a result of ds"):
        ds.cg.select_chains(min_stress=1)
    assert "time" not in ds.isel(time=0).cg.force_chains().dims


@pytest.mark.parametrize("particles", [0, 1, 2])
def test_scenes_of_up_to_two_particles(particles):
    fc = xcg.datasets.random_scene(particles).cg.force_chains()
    assert fc.chain_count.item() == 0
    assert fc.cg.chain_table().empty


def test_threads_give_the_same_bits(monkeypatch):
    ds = xcg.datasets.random_scene(300, seed=4, periodic="xy")
    alone = ds.cg.force_chains(), ds.cg.particle_stress()
    monkeypatch.setattr("xcg.compiled._jit.PARTICLES_A_THREAD", 90)
    monkeypatch.setattr("xcg.steps.analysis.THREADS", 3)
    shared = ds.cg.force_chains(), ds.cg.particle_stress()
    for one, other in zip(alone, shared, strict=True):
        xr.testing.assert_equal(one, other)


# --- from step to step ------------------------------------------------------------------------------------


def chains_over_time(*steps):
    """Series of 12 grains; each step is a list of chains, each a list of ids, laid out along lines of their own."""
    position = []
    pairs = []
    for chains in steps:
        x = np.zeros((12, 3))
        x[:, 1] = 100 + 10 * np.arange(12)
        pairs.append([])
        for k, chain in enumerate(chains):
            x[chain] = [[n, 10 * k, 0] for n in range(len(chain))]
            pairs[-1] += pairwise(chain)
        position.append(x)
    i, j = ([np.array([p[end] for p in step], int) for step in pairs] for end in (0, 1))
    force = [np.tile([-1.0, 0, 0], (len(step), 1)) for step in pairs]
    return xcg.scene_from_arrays(
        np.array(position), diameter=np.ones((len(steps), 12)), density=1.0, contact_i=i, contact_j=j,
        contact_force=force, time=0.5 * np.arange(len(steps)),
    ).cg.force_chains()  # fmt: skip


def test_births_deaths_and_lifetimes_of_tracked_chains():
    fc = chains_over_time(
        [[0, 1, 2, 3], [4, 5, 6]],  # two chains
        [[4, 5, 6], [0, 1, 2]],  # the first loses a grain
        [[0, 1, 2], [7, 8, 9]],  # one ends, one begins
        [[7, 8, 9, 10]],
    )
    tracks = fc.cg.track_chains(overlap=0.5)
    found = [t[t >= 0].tolist() for t in tracks.track_id.values]
    assert found == [[0, 1], [0, 1], [0, 2], [2]]
    assert tracks.births.values.tolist() == [2, 0, 1, 0]
    assert tracks.deaths.values.tolist() == [0, 0, 1, 1]
    assert tracks.survivors.values.tolist() == [0, 2, 1, 1]
    assert tracks.lifetime.values.tolist() == [1.0, 0.5, 0.5]
    assert tracks.steps.values.tolist() == [3, 2, 2]
    assert tracks.lifetime.attrs["units"] == "s"
    assert all(
        tracks[name].attrs["units"] == "1"
        for name in ("track_id", "births", "deaths", "survivors", "steps")
    )
    assert tracks.equals(fc.chunk(time=1).cg.track_chains(overlap=0.5))


def test_a_chain_survives_with_at_least_the_given_overlap():
    fc = chains_over_time([[0, 1, 2, 3]], [[0, 1, 2]])
    assert fc.cg.track_chains(overlap=0.75).survivors.values.tolist() == [0, 1]
    assert fc.cg.track_chains(overlap=0.76).survivors.values.tolist() == [0, 0]


def test_a_chain_that_splits_lives_on_in_the_larger_part():
    fc = chains_over_time([[0, 1, 2, 3, 4, 5, 6]], [[0, 1, 2], [3, 4, 5, 6]])
    tracks = fc.cg.track_chains(overlap=0.3)
    assert tracks.track_id.values[1, :2].tolist() == [1, 0]
    assert tracks.births.values.tolist() == [1, 1]


def test_tracks_of_no_chains_are_empty():
    tracks = chains_over_time([], [[0, 1, 2]], []).cg.track_chains()
    assert tracks.births.values.tolist() == [0, 1, 0]
    assert tracks.deaths.values.tolist() == [0, 0, 1]


def test_wrong_arguments_of_tracks_raise():
    fc = chains_over_time([[0, 1, 2]])
    with pytest.raises(ValueError, match="overlap=0: expected a number above 0"):
        fc.cg.track_chains(overlap=0)
    with pytest.raises(ValueError, match="no time dimension"):
        fc.isel(time=0).cg.track_chains()
