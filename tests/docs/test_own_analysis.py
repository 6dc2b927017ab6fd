"""The example of an own analysis: an ideal gas, in memory and lazily; `test_distributed` runs it on a cluster."""

import runpy

import numpy as np
import pytest

from tests import ROOT, raise_if_dask_computes

pytest.importorskip("distributed")  # which the script imports
SCRIPT = ROOT / "examples" / "own_analysis.py"


def test_the_radial_distribution_of_an_ideal_gas_is_one():
    example = runpy.run_path(str(SCRIPT))
    ds = example["gas"](steps=2, grains=300)
    analysis = example["RadialDistribution"](reach=0.5, bins=1)
    g = analysis.run(ds).g
    pairs = 2 * 300 * 299 / 2 * (4 / 3 * np.pi * 0.5**3)
    assert abs(float(g.mean()) - 1) < 5 / np.sqrt(pairs)
    with raise_if_dask_computes():
        lazy = analysis.run(ds.chunk(time=1))
    np.testing.assert_array_equal(lazy.g, g)
