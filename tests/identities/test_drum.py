"""A drum of LAMMPS in cylindrical axes and along its surface: its script turns it with 1 rad/s about y."""

import numpy as np

import xcg
from tests import ROOT

DUMP = ROOT / "examples" / "data" / "lammps_drum" / "particles.dump.gz"


def test_grains_at_the_rim_turn_with_the_drum():
    ds = xcg.open_scene(DUMP)
    below = {"r": (0.024, 0.0285), "theta": (np.pi / 2 - 0.5, np.pi / 2 + 0.5)}
    f = ds.cg.coarse_grain(
        "velocity", frame=xcg.Cylindrical("y"), axes="r", bounds=below, spacing=0.001
    )
    np.testing.assert_allclose(
        (f.velocity.sel(component="theta") / f.r).mean("time"), 1.0, atol=0.02
    )
    assert float(np.abs(f.velocity.sel(component="r")).max()) < 0.002


def test_grains_flow_down_the_surface():
    ds = xcg.open_scene(DUMP)
    down = xcg.Rotated(x=(0.82, 0, -0.57), y=(0, 1, 0))
    f = ds.cg.coarse_grain(
        ["velocity", "density"], axes="z", at={"x": 0.0}, frame=down, spacing=0.001
    )
    fastest = f.velocity.where(f.density > 500).max("z")
    assert (fastest.sel(component="x") > 3 * 0.03 * 1.0).all()  # faster than the drum
    assert float(np.abs(fastest.sel(component="y")).max()) < 0.02
