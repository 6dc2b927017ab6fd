"""Where nodes stand: by bounds, by period, by the extent of the grains."""

import warnings

import numpy as np
import pytest

from xcg.common.messages import SceneWarning
from xcg.fields.grids.grid import make_grid


def grid(
    axes="x",
    *,
    at=None,
    bounds=None,
    spacing=1.0,
    plane="xyz",
    cutoff=10.0,
    automatic=None,
    period=None,
):
    options = {
        "plane": plane,
        "cutoff": cutoff,
        "automatic": automatic or {},
        "period": period or {},
    }
    return make_grid(axes, at or {}, bounds or {}, spacing, **options)


def test_bounds_include_their_last_node_despite_rounding():
    rng = np.random.default_rng(0)
    for first, step, parts in zip(
        rng.normal(size=200), 10 ** rng.uniform(-3, 0.5, 200), range(200), strict=True
    ):
        last = first + parts * step
        nodes = grid(bounds={"x": (first, last)}, spacing=step).coords["x"].values
        np.testing.assert_allclose(
            nodes, np.linspace(first, last, parts + 1), rtol=1e-12, atol=1e-12
        )
        assert (
            len(grid(bounds={"x": (first, last + 0.99 * step)}, spacing=step).coords["x"].values)
            == parts + 1
        )
    assert (
        len(grid(bounds={"x": (0, 0.3)}, spacing=0.1).coords["x"].values) == 4
    )  # 0.3 / 0.1 is less than 3


@pytest.mark.parametrize(
    ("step", "count"), [(0.7, 7), (0.75, 7), (0.78, 6), (1.0, 5), (2.1, 2), (3.4, 1), (11.0, 1)]
)
def test_nodes_divide_a_period_by_the_nearest_spacing(step, count):
    g = grid(spacing=step, automatic={"x": (-1.0, 4.0)}, period={"x": 5.0})
    np.testing.assert_allclose(g.coords["x"].values, -1 + 5 / count * np.arange(count))
    assert g.spacing["x"] == 5 / count


@pytest.mark.parametrize(("step", "count"), [(1.0, 6), (0.9, 7), (2.0, 4), (7.0, 2)])
def test_nodes_cover_the_extent_about_its_middle(step, count):
    nodes = grid(spacing=step, automatic={"x": (-1.0, 4.0)}).coords["x"].values
    np.testing.assert_allclose(nodes, 1.5 + step * (np.arange(count) - (count - 1) / 2))
    assert nodes[0] <= -1
    assert nodes[-1] >= 4


def test_a_spacing_beyond_the_support_warns():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grid(bounds={"x": (0, 8)}, spacing=2.0, cutoff=1.0)
        grid(bounds={"x": (0, 0)}, spacing=9.0, cutoff=1.0)  # one node
    with pytest.warns(SceneWarning, match="larger than the support"):
        grid(bounds={"x": (0, 8)}, spacing=2.001, cutoff=1.0)


def test_axes_are_resolved_fixed_or_averaged():
    g = grid("zx", at={"y": 7.0}, bounds={"x": (1, 2), "z": (5, 5)}, spacing={"x": 0.5, "z": 0.25})
    assert (g.axes, g.active_axes, g.averaged, g.shape) == ("xz", "xyz", "", (3, 1, 1))
    assert g.origin.tolist() == [1, 7, 5]
    assert g.spacings.tolist() == [0.5, 1, 0.25]
    assert g.active.all()
    g = grid("y", bounds={"y": (0, 2)}, plane="xy")
    assert (g.active_axes, g.averaged, g.shape) == ("y", "x", (1, 3, 1))
    assert g.active.tolist() == [False, True, False]
    assert g.origin.tolist() == [0, 0, 0]
    assert grid("", at=dict.fromkeys("xy", 1.0)).averaged == "z"
