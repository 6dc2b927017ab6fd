"""The page on fluid between the grains: its example, and the sums that it promises."""

import re

import numpy as np
import pytest

import xcg
from tests import ROOT

PAGE = (ROOT / "docs" / "cfd_dem.md").read_text()


@pytest.mark.slow  # test_cells and test_cell_volumes
def test_the_example_of_the_page_runs():
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(block, names)
    f = names["f"]
    assert f.sum_drag_force.attrs["units"] == "N m^-3"
    np.testing.assert_allclose(names["per_fluid"] * f.void_fraction, f.sum_drag_force)
    np.testing.assert_allclose(names["slip"] + f.velocity, 1.0)
    np.testing.assert_array_equal(names["ds"]["drag_force"], names["drag"])


def test_the_force_on_all_grains_is_the_integral():
    ds = xcg.datasets.random_scene(80, seed=2)
    ds = ds.assign(drag_force=0.3 * ds.velocity)
    f = ds.cg.coarse_grain(xcg.Sum("drag_force"), width=1.0, spacing=0.25)
    cell = np.prod([float(f[a][1] - f[a][0]) for a in "xyz"])
    total = f.sum_drag_force.sum(["x", "y", "z"]) * cell
    expected = ds.drag_force.sum("particle")
    np.testing.assert_allclose(total, expected, atol=1e-3 * float(abs(ds.drag_force).sum()))
    phi = 1 - ds.cg.coarse_grain("void_fraction", axes="").void_fraction.item()
    assert phi == pytest.approx(float(ds.volume.sum()) / 125.0, rel=1e-12)
