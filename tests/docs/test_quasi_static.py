"""The shipped results of the quasi-static study are what the notebook says, and the notebook runs without LAMMPS."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from tests import ROOT

EXAMPLE = ROOT / "examples" / "quasi_static"


@pytest.fixture(scope="module", autouse=True)
def example_on_path():
    sys.path.insert(0, str(EXAMPLE))
    yield
    sys.path.remove(str(EXAMPLE))


@pytest.fixture(scope="module")
def tables(example_on_path):
    import summary

    return summary.load(EXAMPLE / "results")


@pytest.fixture(scope="module")
def values(tables):
    import summary

    return summary.steady(tables["history"])


def test_notebook_runs_without_lammps(monkeypatch):
    import matplotlib.pyplot as plt

    monkeypatch.chdir(ROOT / "docs")
    monkeypatch.setitem(sys.modules, "lammps", None)
    plt.switch_backend("agg")
    text = Path("quasi_static.md").read_text()
    cells = re.findall(
        r"```\{code-cell\} python\n(?::tags:[^\n]*\n)?(.*?)```", text, flags=re.DOTALL
    )
    assert len(cells) > 5
    names = {}
    for cell in cells:
        exec(compile(cell, "quasi_static.md", "exec"), names)
    assert len(plt.get_fignums()) >= 4
    plt.close("all")


def test_mean_stress_is_held(tables):
    quiet = tables["runs"][lambda t: ~t.run.isin(["prior", "0.01"])]
    assert np.abs(quiet.servo_mean / 1e5 - 1).max() < 0.01


def test_packings_are_at_100_kpa_before_shear(tables):
    history = tables["history"]
    first = history[history.run == "prior"].groupby("ratio").first()
    assert np.abs(first.mean_stress / 1e5 - 1).max() < 0.01
    assert (
        first.stress_ratio < 0.15
    ).all()  # grains have the velocities of the shear already, and damping with them


def test_engine_and_xcg_agree_on_the_mean_stress(tables):
    difference = np.abs(tables["history"].mean_stress / tables["history"].lammps_mean_stress - 1)
    assert difference.max() < 5e-4


def test_overlaps_are_small(values):
    assert values.overlap_max.max() < 0.01


def test_sizes_and_rates_are_as_requested(values):
    """The measured inertial number is that of the run's name, and sizes are those of series A."""
    np.testing.assert_allclose(values.inertial_d50, values.rate, rtol=0.06)
    np.testing.assert_allclose(
        values.inertial_dmax / values.inertial_d50, np.sqrt(values.ratio), rtol=0.05
    )


def test_contacts_come_back_as_shear_slows_down(values):
    """From I = 1e-2 to 1e-3, Z_mech and f_NR rise by far more than their errors, eta by less than a tenth."""
    import summary

    assert set(values.ratio) == {1.2, 2.0, 5.0}
    for _, table in values.groupby("ratio"):
        for name, least in (("z_mech", 0.025), ("f_nr", 0.03)):
            change, error = summary.change(table, name, 1e-2, 1e-3)
            assert change > max(least, 5 * error), name
        change, error = summary.change(table, "stress_ratio", 1e-2, 1e-3)
        assert abs(change) < 0.1


def test_wide_distributions_have_more_rattlers_and_pack_denser(values):
    slow = values[np.isclose(values.rate, 1e-3)].sort_values("ratio")
    assert (np.diff(slow.f_nr) < -0.05).all()
    assert (np.diff(slow.volume_fraction) > 0.005).all()


def test_array_slides_at_the_stress_of_the_closed_form(tables):
    import summary

    assert set(tables["fcc"].friction) == {0.1, 0.2, 0.3, 0.4}
    for (friction, turning), table in tables["fcc"].groupby(["friction", "turning"]):
        ratio = 2 * table.stress_z / (table.stress_x + table.stress_y)
        slides = table.coordination_number == 8
        assert slides.sum() > 20
        assert ratio.max() == pytest.approx(summary.sliding_array(friction), rel=0.02)
        if not turning:
            np.testing.assert_allclose(
                ratio[slides], summary.sliding_array(friction, table.slope[slides]), rtol=1e-4
            )


def test_closed_form_is_the_sum_over_sliding_contacts(example_on_path):
    """Eight contacts, listed one by one: the tangential force is against the motion that the deformation makes."""
    import summary

    for friction in (0.0, 0.2, 0.5):
        for slope in (1.0, 1.1):
            c = 1 / np.hypot(1, slope)
            s = slope / np.hypot(1, slope)
            normals = [(k * s, 0, m * c) for k in (1, -1) for m in (1, -1)]
            normals += [(0, k * s, m * c) for k in (1, -1) for m in (1, -1)]
            stress = np.zeros((3, 3))
            for normal in np.array(normals):
                # the box flattens along z and widens equally along x and y so that the contact keeps its length
                motion = normal * [c**2, c**2, -(s**2)]
                assert motion @ normal == pytest.approx(0, abs=1e-15)
                force = normal - friction * motion / np.linalg.norm(motion)
                stress += np.outer(force, normal)
            assert stress[0, 0] == pytest.approx(stress[1, 1])
            assert stress[2, 2] / stress[0, 0] == pytest.approx(
                summary.sliding_array(friction, slope)
            )


def test_partners_of_grains_make_the_coordination_number(tables):
    """Of the steady part of each run, from the distribution and from the mean of the same frames."""
    history = tables["history"]
    for (ratio, run), table in tables["connectivity"].groupby(["ratio", "run"]):
        part = history[(history.ratio == ratio) & (history.run == run)]
        mean = part[part.axial_strain > 0.05].coordination_number.mean()
        assert table.share.sum() == pytest.approx(1, abs=1e-5)
        assert (table.partners * table.share).sum() == pytest.approx(mean, rel=1e-4)
