from __future__ import annotations

import runpy

import matplotlib as mpl
import numpy as np
import pytest

import xcg
from tests import ROOT
from tests.networks import fork

mpl.use("agg")
plt = pytest.importorskip("matplotlib.pyplot")


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


@pytest.mark.parametrize("colour", ["stress", "chain"])
def test_plot_chains(colour):
    fc = fork().cg.force_chains()
    ax = fc.cg.plot_chains(color=colour)
    grains, links = ax.collections
    assert len(grains.get_offsets()) == 9
    assert len(links.get_segments()) == 8
    # the strongest links are the thickest
    assert np.argmax(links.get_linewidths()) in (0, 1)
    ax.figure.canvas.draw()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$x$ [m]", "$y$ [m]")
    if colour == "stress":
        assert links.colorbar.ax.get_ylabel() == "most compressive principal stress [Pa]"


def test_pictures_have_figures_of_their_own():
    """They do not paint over the current one."""
    fc = fork().cg.force_chains()
    mine = plt.figure().add_subplot()
    drawn = [fc.cg.plot_chains(), fc.cg.plot_rose(), fc.cg.plot_rose()]
    assert not [*mine.collections, *mine.lines, *mine.patches]
    assert len({ax.figure for ax in [mine, *drawn]}) == 4
    assert drawn[1].name == "polar"


def test_one_line_of_xarray_draws_the_lengths_of_chains():
    """As docs/how_do_i.md draws them."""
    fc = fork().cg.force_chains()
    share = fc.length_share.weighted(fc.chain_count).mean("time")
    (line,) = share.plot.line("o", yscale="log", ax=plt.figure().add_subplot())
    x, y = line.get_xydata().T
    assert x[y > 0].tolist() == [9]
    assert y.sum() == 1.0


def test_plot_rose():
    ax = fork().cg.force_chains().cg.plot_rose(bins=12)
    heights = np.array([petal.get_height() for petal in ax.patches])
    assert heights.sum() == pytest.approx(1)
    np.testing.assert_allclose(heights[:6], heights[6:])  # both ways


def test_pictures_are_those_of_the_last_step():
    one = fork()
    fc = one.isel(time=[0, 0]).assign_coords(time=[0.0, 1.0]).cg.force_chains()
    fc["link_chain"][0] = -1
    for name in ("plot_chains", "plot_rose"):
        first = getattr(fc.cg, name)(index=0)
        last = getattr(fc.cg, name)()
    assert sum(petal.get_height() for petal in first.patches) == 0
    assert sum(petal.get_height() for petal in last.patches) == pytest.approx(1)


def test_grains_are_drawn_whole():
    fc = fork().cg.force_chains()
    ax = fc.cg.plot_chains()
    radius = fc.diameter.isel(time=-1) / 2
    for name, (low, high) in {"x": ax.get_xlim(), "y": ax.get_ylim()}.items():
        place = fc.position.isel(time=-1).sel(component=name)
        assert low <= float((place - radius).min())
        assert high >= float((place + radius).max())


def test_plots_of_no_chains_are_empty():
    fc = fork().cg.force_chains(min_stress=1e9)
    fc.cg.plot_chains()
    fc.cg.plot_rose(ax=plt.figure().add_subplot(projection="polar"))


def test_the_example_script_runs(tmp_path, capsys):
    """Chains of a sheared layer lie along the compressive diagonal."""
    example = runpy.run_path(str(ROOT / "examples" / "force_chains.py"))
    example["main"](tmp_path)
    assert "links point at 138 degrees, the mean stress at 140" in capsys.readouterr().out
    assert (tmp_path / "force_chains.png").stat().st_size > 1e5


def test_wrong_plots_raise():
    fc = fork().cg.force_chains()
    with pytest.raises(ValueError, match="color='red'"):
        fc.cg.plot_chains(color="red")
    with pytest.raises(ValueError, match="bins=7: expected an even number"):
        fc.cg.plot_rose(bins=7)
    with pytest.raises(ValueError, match="plane='xx': expected two axes"):
        fc.cg.plot_rose(plane="xx")
    with pytest.raises(
        ValueError, match="index=1: expected the position of a step, a whole number from -1 to 0"
    ):
        fc.cg.plot_rose(index=1)
    with pytest.raises(ValueError, match="plot_chains draws one-layer scenes"):
        xcg.datasets.random_scene(20).cg.force_chains().cg.plot_chains()


def test_the_rose_of_a_scene_has_the_forces_of_its_contacts_by_direction():
    """A simple cubic packing has forces along x and z alone, of equal sums; each counts both ways."""
    plt = pytest.importorskip("matplotlib.pyplot")
    ds = xcg.datasets.simple_cubic(4, force=1.0)
    ax = ds.cg.plot_rose(bins=8, plane="xz")
    heights = np.array([bar.get_height() for bar in ax.patches])
    assert heights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(heights[:4], heights[4:])
    sheared = xcg.datasets.open("plane_shear").isel(time=[-1]).load()
    ax = sheared.cg.plot_rose(bins=4, plane="xz")
    step = sheared.isel(time=0)
    i = step.contact_i.to_numpy()
    j = step.contact_j.to_numpy()
    known = (i >= 0) & (j >= 0)
    row = {int(n): k for k, n in enumerate(step.particle_id.to_numpy())}
    r = step.position.to_numpy()
    weight = np.zeros(2)
    for a, b, force in zip(i[known], j[known], step.contact_force.to_numpy()[known], strict=True):
        away = r[row[a]] - r[row[b]]
        for k, axis in enumerate("xy"):
            period = float(np.ptp(step.box.sel(component=axis).to_numpy()))
            away[k] -= period * round(away[k] / period)
        angle = np.arctan2(away[2], away[0]) % np.pi
        weight[int(angle // (np.pi / 2))] += np.linalg.norm(force)
    heights = np.array([bar.get_height() for bar in ax.patches])
    np.testing.assert_allclose(heights[:2], weight / weight.sum() / 2, rtol=1e-3)
    plt.close("all")
