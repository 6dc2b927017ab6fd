"""Time of the search for contacts: pytest tests/benchmarks --benchmark-only."""

import runpy

import numpy as np
import pytest

from tests import ROOT
from xcg.analysis.pairs import find_pairs

Packing = runpy.run_path(str(ROOT / "docs" / "contact_speed.py"))["Packing"]


@pytest.mark.parametrize("levels", [None, 1])
@pytest.mark.parametrize("kind", ["bidisperse", "series A"])
@pytest.mark.parametrize("ratio", [1, 3, 10])
def test_find_pairs(benchmark, kind, ratio, levels):
    packing = Packing.of(kind, ratio, 20_000)
    arguments = (packing.position, packing.radius, packing.box, "xyz")
    pairs = benchmark(find_pairs, *arguments, levels=levels, threads=1)
    assert len(pairs) > packing.radius.size
    assert (np.diff(pairs[:, 0]) >= 0).all()


def test_find_contacts(benchmark):
    import xcg

    packing = Packing.of("series A", 5, 20_000)
    ds = xcg.scene_from_arrays(
        packing.position, diameter=2 * packing.radius, density=1.0, box=packing.box, periodic="xyz"
    )
    found = benchmark(ds.cg.find_contacts, k_n=1.0)
    assert found.sizes["contact"] > ds.sizes["particle"]
