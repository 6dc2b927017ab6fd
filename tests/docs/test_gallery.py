"""Scripts of the gallery run, agree with physics as well as they say, and have the form of the others."""

import re
import runpy

import matplotlib as mpl
import pytest

from tests import ROOT, pyvista_draws

mpl.use("agg")
SCRIPTS = sorted((ROOT / "examples" / "gallery").glob("*/*.py"))

# measured, expected, and how far apart they are at most as a share of the expected: names that the script defines
CHECKS = {
    "bedload": ("carried", "load", 0.02),
    "chute_profiles": ("carried", "load", 0.002),
    "collisions": ("measured", "expected", 0.02),
    "column_collapse": ("exponent", "expected", 0.1),
    "cooling_gas": ("fitted", "tau", 0.02),
    "dense_suspension": ("jammed", "measured", 0.03),
    "drum_mixing": ("down", "up", 0.2),
    "fluid_cells": ("found", "solid", 1e-6),
    "gas_structure": ("measured", "expected", 0.05),
    "glued_spheres": ("carried", "load", 0.001),
    "heat_conduction": ("carried", "given", 1e-7),
    "impact": ("contact", "expected", 0.01),
    "long_series": ("measured", "expected", 1e-5),
    "mu_of_i": ("measured", "expected", 0.2),
    "photoelastic": ("stress", "expected", 0.005),
    "rods_in_shear": ("measured", "expected", 0.05),
    "segregation": ("mass", "expected", 1e-4),
    "shear_band": ("band", "coulomb", 0.1),
    "heap": ("angle", "of_grains", 0.05),
    "silo_discharge": ("C", "published", 0.15),
    "silo_pressure": ("measured", "expected", 0.05),
    "voronoi_cells": ("measured", "expected", 0.01),
}


# building the site runs all scripts; these take seconds
QUICK = {
    "glued_spheres",
    "heap",
    "heat_conduction",
    "photoelastic",
    "rods_in_shear",
    "voronoi_cells",
}


@pytest.mark.parametrize(
    "script",
    [pytest.param(path, marks=() if path.stem in QUICK else pytest.mark.slow) for path in SCRIPTS],
    ids=lambda path: path.stem,
)
def test_each_script_agrees_with_physics(script, monkeypatch):
    from matplotlib import pyplot as plt

    if "cg.view(" in script.read_text():
        if not pyvista_draws():
            pytest.skip("needs PyVista, and a way to draw for VTK")
        monkeypatch.setattr(pytest.importorskip("pyvista"), "OFF_SCREEN", True)

    try:
        names = runpy.run_path(str(script))
        assert plt.get_fignums(), "no picture"
        for figure in map(plt.figure, plt.get_fignums()):
            for ax in figure.axes:
                below = ax.get_shared_x_axes()
                beside = ax.get_shared_y_axes()
                named = any(a.get_xlabel() for a in below.get_siblings(ax)) and any(
                    a.get_ylabel() for a in beside.get_siblings(ax)
                )
                assert named or ax.get_label() == "<colorbar>", "axes without a name"
    finally:
        plt.close("all")
    measured, expected, share = CHECKS[script.stem]
    assert float(names[measured]) == pytest.approx(float(names[expected]), rel=share)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_each_script_has_the_form_of_the_others(script):
    """A title, the script of the simulation, a check, and what to change for other data; data that come with xcg."""
    text = script.read_text()
    assert re.match(r'r?"""\n(.+)\n=+\n', text)
    for path in re.findall(r":download:`[^<`]+<([^>]+)>`", text):
        assert (ROOT / "docs" / "gallery" / script.parent.name / path).resolve().is_file(), path
    for wanted in (
        ":download:",
        "xcg.datasets.open(",
        "**Check.**",
        "**For your own data, change**",
    ):
        assert wanted in text, wanted
    for page in re.findall(r":doc:`[^<`]+<(/[^>]+)>`", text):
        assert (ROOT / "docs" / f"{page[1:]}.md").is_file(), page
