"""Speed of force chains: run with ``pytest tests/benchmarks --benchmark-only``."""

from __future__ import annotations

import numpy as np
import pytest

import xcg


def lattice(cells):
    """Periodic cubic lattice with three contacts a grain, and forces of random size and direction."""
    n = cells**3
    row = np.arange(n).reshape(cells, cells, cells)
    position = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(0)
    normal = np.repeat(-np.eye(3), n, axis=0)
    force = normal * rng.exponential(size=(3 * n, 1)) + 0.2 * rng.normal(size=(3 * n, 3))
    return xcg.scene_from_arrays(
        position, diameter=np.ones(n), density=1.0, box=[[0, cells]] * 3, periodic="xyz", contact_force=force,
        contact_i=np.tile(row.ravel(), 3), contact_j=np.concatenate([np.roll(row, -1, k).ravel() for k in range(3)]),
    )  # fmt: skip


@pytest.mark.parametrize("cells", [50, 100], ids=["1.25e5 grains", "1e6 grains"])
@pytest.mark.parametrize("algorithm", ["branching", "peters2005"])
def test_force_chains(benchmark, cells, algorithm):
    ds = lattice(cells)
    lattice(4).cg.force_chains(algorithm=algorithm)  # compiles
    fc = benchmark.pedantic(ds.cg.force_chains, kwargs={"algorithm": algorithm}, rounds=5)
    assert fc.chain_count.item() > 0.05 * cells**3
