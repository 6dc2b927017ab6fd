"""Selections of chains by place, direction and length; boxes and spheres as regions."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.networks import chains_of, nine_particles
from xcg import BoxRegion, Sphere
from xcg.common.messages import SceneError
from xcg.scene.lattice import Lattice

EVERYWHERE = xcg.BoxRegion((-np.inf,) * 3, (np.inf,) * 3)


def three_chains():
    """Columns at x = 0, 1, 2, ids 0 to 2, 3 to 5, 6 to 8; the second carries more."""
    ds = nine_particles(across=0.0)
    second = (ds.contact_i >= 3) & (ds.contact_i < 6)
    return ds.assign(contact_force=ds.contact_force * xr.where(second, 3.0, 1.0)).cg.force_chains()


def test_chains_with_any_or_all_particles_in_a_region():
    fc = three_chains()
    corner = xcg.BoxRegion((-0.5, -0.5, -1), (1.5, 1.5, 1))
    assert chains_of(fc.cg.select_chains(corner)) == {frozenset([0, 1, 2]), frozenset([3, 4, 5])}
    assert chains_of(fc.cg.select_chains(corner, how="all")) == set()
    left = xcg.BoxRegion((-0.5, -0.5, -1), (0.5, 2.5, 1))
    assert chains_of(fc.cg.select_chains(left, how="all")) == {frozenset([0, 1, 2])}
    assert chains_of(fc.cg.select_chains(~left, how="all")) == {
        frozenset([3, 4, 5]),
        frozenset([6, 7, 8]),
    }
    assert chains_of(fc.cg.select_chains(left | xcg.Sphere((2, 0, 0), 0.1))) == {
        frozenset([0, 1, 2]),
        frozenset([6, 7, 8]),
    }


def test_stress_and_composition():
    fc = three_chains()
    strong = 2 * float(fc.major_stress[0, 1])
    assert chains_of(fc.cg.select_chains(min_stress=strong)) == {frozenset([3, 4, 5])}
    assert chains_of(fc.cg.select_chains(min_stress=strong, how="all")) == set()
    right = xcg.BoxRegion((1.5, -1, -1), (3, 3, 1))
    assert chains_of(fc.cg.select_chains(min_stress=strong).cg.select_chains(right)) == set()
    # in one call, one particle must fulfil both
    assert chains_of(fc.cg.select_chains(xcg.Sphere((1, 0, 0), 0.1), min_stress=strong)) == set()
    assert chains_of(fc.cg.select_chains(xcg.Sphere((1, 1, 0), 0.1), min_stress=strong)) == {
        frozenset([3, 4, 5])
    }


def test_the_least_stress_is_included():
    fc = three_chains()
    largest = float(fc.major_stress.max())
    assert chains_of(fc.cg.select_chains(min_stress=largest)) == {frozenset([3, 4, 5])}
    assert chains_of(fc.cg.select_chains(min_stress=np.nextafter(largest, np.inf))) == set()


def test_counts_and_tables_of_selected_chains_are_consistent():
    fc = three_chains()
    some = fc.cg.select_chains(xcg.Sphere((1, 0, 0), 0.1))
    assert some.chain_id.values[0].tolist() == [
        -1,
        -1,
        -1,
        1,
        1,
        1,
        -1,
        -1,
        -1,
    ]  # chains keep their numbers
    assert (some.links.values[0] > 0).tolist() == (some.chain_id.values[0] >= 0).tolist()
    assert sorted(set(some.link_chain.values[0])) == [-1, 1]
    assert some.chain_particles.values[0].tolist() == [-1, 3, -1]
    assert (some.chain_count.item(), some.length_mean.item()) == (1, 3.0)
    assert some.length_share.sel(length=3).item() == 1
    assert len(some.cg.chain_table()) == 1
    assert len(some.cg.link_table()) == 2
    assert "select_chains" in some.attrs["history"]
    xr.testing.assert_equal(fc.cg.select_chains(EVERYWHERE), fc)
    assert fc.cg.select_chains(~EVERYWHERE).chain_count.item() == 0


def test_search_in_a_region():
    ds = nine_particles(across=0.0)
    assert chains_of(ds.cg.force_chains(region=xcg.BoxRegion((0.5, -1, -1), (3, 3, 1)))) == {
        frozenset([3, 4, 5]),
        frozenset([6, 7, 8]),
    }
    assert chains_of(ds.cg.force_chains(region=xcg.BoxRegion((-1, -1, -1), (3, 1.5, 1)))) == set()


def test_moving_region_follows_time():
    steps = nine_particles(across=0.0).isel(time=[0, 0, 0]).assign_coords(time=[0.0, 1.0, 2.0])
    fc = steps.cg.force_chains()
    moving = fc.cg.select_chains(xcg.BoxRegion((-0.5, -1, -1), (0.5, 3, 1), velocity=(1, 0, 0)))
    assert [chains_of(moving, t) for t in range(3)] == [
        {frozenset(range(3 * t, 3 * t + 3))} for t in range(3)
    ]


def test_wrong_regions_and_limits_raise():
    fc = three_chains()
    with pytest.raises(ValueError, match="how='most': expected one of 'any', 'all'"):
        fc.cg.select_chains(EVERYWHERE, how="most")
    with pytest.raises(ValueError, match="nothing to select by"):
        fc.cg.select_chains()


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (
            lambda fc: fc.cg.select_chains(min_stress="high"),
            "min_stress='high': expected a finite stress",
        ),
        (
            lambda fc: fc.cg.select_chains(min_stress=np.nan),
            "min_stress=nan: expected a finite stress",
        ),
        (lambda fc: fc.cg.select_chains((0, 1)), r"region=\(0, 1\): expected xcg.BoxRegion"),
        (
            lambda fc: fc.cg.track_chains(overlap="half"),
            "overlap='half': expected a number above 0",
        ),
        (
            lambda fc: fc.isel(chain=slice(0, 1)).cg.select_chains(min_stress=0),
            "needs all particles and chains",
        ),
        (
            lambda fc: fc.isel(particle=slice(0, 4)).cg.select_chains(min_stress=0),
            "needs all particles and chains",
        ),
        (
            lambda fc: fc.isel(chain=slice(0, 1)).cg.track_chains(),
            "track_chains needs all particles and chains",
        ),
        (lambda fc: fc.isel(time=[]).cg.chain_table(), "chain_table needs one step or more"),
        (lambda fc: fc.isel(time=[]).cg.link_table(), "link_table needs one step or more"),
    ],
)
def test_wrong_arguments_are_named(call, told):
    with pytest.raises(ValueError, match=told):
        call(three_chains().chunk(time=1))


# --- regions ---------------------------------------------------------------------------------------------

OPEN = np.full(3, np.inf)
FRAME = {
    "particle_id": np.array([2, 5, 7, 11]),
    "position": np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [3.9, 0.5, 0.5], [2.0, 2.0, 2.0]]),
}


def inside(region, time=0.0, period=OPEN):
    return FRAME["particle_id"][region.contains(FRAME, time, Lattice(period))].tolist()


def test_particles_in_a_box():
    assert inside(BoxRegion((0, 0, 0), (1.5, 1, 1))) == [2, 5]  # faces belong to it
    assert inside(BoxRegion((1, -np.inf, -np.inf), (np.inf, np.inf, np.inf))) == [5, 7, 11]
    assert inside(BoxRegion((1, 0, 0), (2, 1, 1), velocity=(2, 0, 0)), time=1.0) == [7]
    assert inside(BoxRegion((-2, -1, -1), (2, 1, 1), follow=5)) == [2, 5]
    assert inside(BoxRegion((-2, -1, -1), (2, 1, 1), follow=3)) == []


def test_particles_in_a_sphere():
    assert inside(Sphere((0.5, 0.5, 0.5), 1.0)) == [2, 5]
    assert inside(Sphere((0.5, 0.5, 0.5), 0.5, velocity=(1, 0, 0)), time=1.0) == [5]
    assert inside(Sphere((0, 0, 0), 2.4, follow=7)) == [5, 7]


def test_regions_reach_across_periodic_edges():
    period = np.array([4.0, np.inf, np.inf])
    assert inside(Sphere((0, 0.5, 0.5), 0.5), period=period) == [2, 7]
    assert inside(BoxRegion((-0.2, 0, 0), (0.2, 1, 1)), period=period) == [7]
    assert inside(BoxRegion((0, 0, 0), (1, 1, 1), velocity=(4, 0, 0)), time=3.0, period=period) == [
        2
    ]


def test_regions_are_intersected_united_and_inverted():
    left = BoxRegion((0, 0, 0), (2, 4, 4))
    low = BoxRegion((0, 0, 0), (4, 1, 1))
    assert inside(left & low) == [2, 5]
    assert inside(left | low) == [2, 5, 7, 11]
    assert inside(left & ~low) == [11]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BoxRegion((0, 0), (1, 1, 1)), r"lower=\(0, 0\): expected three numbers"),
        (lambda: BoxRegion((0, 0, 2), (1, 1, 1)), "expected every lower edge below the upper"),
        (lambda: Sphere((0, 0, 0), 0), "radius=0: expected a positive length"),
        (lambda: Sphere((0, 0, np.nan), 1), "centre=.*expected three finite numbers"),
        (lambda: Sphere((0, 0, 0), 1, velocity=(1, 0, 0), follow=3), "expected one of the two"),
        (
            lambda: Sphere((0, 0, 0), 1, follow=1.5),
            r"follow=1\.5: expected a whole number of at least 0, or None for no particle",
        ),
        (
            lambda: BoxRegion((0, 0, 0), (1, 1, 1), follow="a"),
            "follow='a': expected a whole number of at least 0",
        ),
    ],
)
def test_wrong_regions_raise(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    "combine", [lambda a: a, lambda a: ~a, lambda a: a | xcg.Sphere((0, 0, 0), 1.0)]
)
def test_regions_that_move_need_times(combine):
    ds = xcg.datasets.random_scene(30, seed=1)
    region = combine(xcg.BoxRegion((0, 0, 0), (1, 1, 1), velocity=(1.0, 0, 0)))
    with pytest.raises(SceneError, match="times of the steps are not known"):
        ds.cg.force_chains(region=region)
    ds.assign_coords(time=[0.0]).cg.force_chains(region=region)
