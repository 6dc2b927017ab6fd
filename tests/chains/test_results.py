from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import xcg


def chains_over_time(*steps):
    """Series of 12 grains; each step is a list of chains, each a list of ids, laid out along lines of their own."""
    position, pairs = [], []
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


def test_wrong_arguments_raise():
    fc = chains_over_time([[0, 1, 2]])
    with pytest.raises(ValueError, match="overlap=0: expected a share"):
        fc.cg.track_chains(overlap=0)
    with pytest.raises(ValueError, match="no time dimension"):
        fc.isel(time=0).cg.track_chains()
