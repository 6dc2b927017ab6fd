"""Pictures of grains: circles where a plane cuts spheres, with the colours of a variable."""

import matplotlib
import numpy as np
import pytest

import xcg

matplotlib.use("Agg")
from matplotlib import pyplot as plt


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def circles_of(ax):
    (drawn,) = ax.collections[:1]
    return drawn.get_offsets(), drawn._widths * 2, drawn.get_array()  # matplotlib keeps half-widths


def test_a_plane_cuts_spheres_in_circles():
    position = [[0.0, 0.0, 0.0], [3.0, 0.6, 1.0], [6.0, 1.0, 0.0]]
    ds = xcg.scene_from_arrays(position, diameter=2.0, density=1.0)
    offset, width, _ = circles_of(ds.cg.plot(at={"y": 0.0}))
    np.testing.assert_allclose(offset, [[0.0, 0.0], [3.0, 1.0]])
    np.testing.assert_allclose(width, [2.0, 1.6])  # 2 sqrt(1 - 0.36)


def test_the_area_of_a_cut_is_the_fraction_of_the_volume():
    """The areas of cuts through one sphere are a square of the place: three Gauss points give its volume."""
    ds = xcg.scene_from_arrays([[0.0, 0.0, 0.0]], diameter=1.0, density=1.0)
    places, weights = np.polynomial.legendre.leggauss(3)
    volume = 0.0
    for place, weight in zip(places / 2, weights / 2, strict=True):
        _, width, _ = circles_of(ds.cg.plot(at={"z": place}))
        volume += weight * np.pi / 4 * (width**2).sum()
        plt.close("all")
    assert volume == pytest.approx(np.pi / 6, rel=1e-12)


def test_colours_show_a_variable_of_the_grains_that_are_cut():
    ds = xcg.datasets.random_scene(100, seed=2)
    low = 2.0 - ds.diameter[0] / 2
    high = 2.0 + ds.diameter[0] / 2
    cut = (ds.position[0, :, 1] > low) & (ds.position[0, :, 1] < high)
    drawn = circles_of(ds.cg.plot("diameter", at={"y": 2.0}))[2]
    assert set(ds.diameter[0].values[cut.values]) <= set(drawn.tolist())
    speed = circles_of(ds.cg.plot("velocity", at={"y": 2.0}))[2]
    assert set(np.round(speed, 12)) <= set(
        np.round(np.linalg.norm(ds.velocity[0], axis=1), 12).tolist()
    )
    layer = xcg.datasets.random_scene(50, dimension=2)
    ax = layer.cg.plot("velocity", component="x", alpha=0.5, linewidth=2.0)
    offset, width, values = circles_of(ax)
    np.testing.assert_allclose(offset, layer.position[0, :, :2])
    np.testing.assert_allclose(width, layer.diameter[0])
    np.testing.assert_allclose(values, layer.velocity[0, :, 0])
    assert ax.collections[0].get_linewidth() == 2.0
    assert "step = 0" in ax.get_title()


def test_grains_across_a_periodic_edge_are_cut():
    ds = xcg.scene_from_arrays(
        [[1.0, 0.1, 1.0]], diameter=1.0, density=1.0, box=[[0, 4.0]] * 3, periodic="y"
    )
    _, width, _ = circles_of(ds.cg.plot(at={"y": 3.9}))
    np.testing.assert_allclose(width, 2 * np.sqrt(0.25 - 0.04))


def test_grains_across_a_periodic_edge_of_a_tilted_box_are_cut():
    """The box is tilted in the plane of the picture, so that images across it are not shifted."""
    ds = xcg.scene_from_arrays(
        [[1.0, 0.1, 1.0]],
        diameter=1.0,
        density=1.0,
        box=[[0, 4.0]] * 3,
        periodic="xyz",
        lattice={"xz": 1.0},
    )
    offset, width, _ = circles_of(ds.cg.plot(at={"y": 3.9}))
    np.testing.assert_allclose(offset, [[1.0, 1.0]])
    np.testing.assert_allclose(width, 2 * np.sqrt(0.25 - 0.04))


def test_wrong_arguments_raise():
    ds = xcg.datasets.random_scene(20)
    cases = [
        ({"field": "diamter"}, ValueError, "unknown variable 'diamter'; did you mean 'diameter'"),
        ({"field": "contact_force"}, ValueError, "unknown variable"),
        ({"at": {"q": 1.0}}, ValueError, "expected one axis and a coordinate"),
        ({"arrows": "velocity"}, ValueError, "this is a scene"),
        ({"phase": 1}, ValueError, "this is a scene"),
        ({"field": "mass", "component": "x"}, ValueError, "mass is a scalar"),
        ({"figsize": (3, 3)}, TypeError, "give ax="),
        ({"no_keyword": 1}, TypeError, "no_keyword"),
    ]
    for options, kind, message in cases:
        with pytest.raises(kind, match=message):
            ds.cg.plot(**options)
    bare = xcg.scene_from_arrays(np.eye(3))
    with pytest.raises(xcg.SceneError, match="plot of a scene needs"):
        bare.cg.plot()
    flat = xcg.datasets.random_scene(20, dimension=2)
    with pytest.raises(ValueError, match="is one layer along x, y"):
        flat.cg.plot(at={"y": 1.0})
