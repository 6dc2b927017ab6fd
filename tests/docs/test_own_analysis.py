"""The example of an own analysis: an ideal gas, in memory, lazily and on a cluster."""

import os
import runpy
import subprocess
import sys

import numpy as np
import pytest

from tests import ROOT, raise_if_dask_computes

pytest.importorskip("distributed")
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


def test_the_script_says_that_all_ways_agree():
    done = subprocess.run(
        [sys.executable, str(SCRIPT)],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count("same = True") == 2, done.stdout
