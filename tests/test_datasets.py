"""Sample data come with the package, and what tells the version says the same everywhere."""

import re
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest

import xcg
from tests import ROOT


def test_samples_open_with_contacts():
    chute = xcg.datasets.open("chute")
    assert (chute.sizes["time"], chute.sizes["particle"], chute.sizes["contact"]) == (1, 4398, 6229)
    assert chute.attrs["gravity"] == pytest.approx([0.4067, 0.0, -0.9135])
    shear = xcg.datasets.open("plane_shear")
    assert shear["position"].chunks is not None
    assert shear.sizes["time"] == 17
    # the sheared grains carry the shear stress from wall to wall
    p = (
        shear.isel(time=slice(8, None))
        .cg.coarse_grain(["stress", "velocity", "density"], axes="z")
        .compute()
    )
    middle = p.cg.time_average().sel(z=slice(3, 8))
    assert (middle.stress.sel(component="x", direction="z") < 0).all()
    assert float(middle.velocity.sel(component="x").differentiate("z").mean()) > 0.2


@pytest.mark.parametrize("name", ["biaxial", "column_2", "shear_cell_0.1"])
def test_discs_are_discs(name):
    ds = xcg.datasets.open(name)
    density = ds.density.where(ds.particle_id >= 0)
    assert float(abs(density - 4 / np.pi).max()) < 1e-3  # m = 1 at d = 1, thickness 1
    area = (np.pi / 4 * ds.diameter**2).sum("particle")
    box = ds.box.diff("bound").squeeze("bound")
    share = area / (box.sel(component="x") * box.sel(component="y"))
    found = ds.cg.microstructure("volume_fraction").volume_fraction
    assert found.values == pytest.approx(share.values, rel=1e-12)


def test_unknown_samples_raise(monkeypatch, tmp_path):
    with pytest.raises(ValueError, match=r"unknown sample 'drum'; did you mean 'mixing_drum'\?"):
        xcg.datasets.open("drum")
    with pytest.raises(
        ValueError,
        match=r"unknown sample 'shute'; did you mean 'chute'\? Samples are .*plane_shear",
    ):
        xcg.datasets.open("shute")
    monkeypatch.setattr(xcg.datasets, "_FOLDERS", (tmp_path,))
    with pytest.raises(FileNotFoundError, match="install xcg again"):
        xcg.datasets.open("chute")


def test_the_wheel_holds_the_samples():
    held = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"][
        "targets"
    ]["wheel"]
    targets = held["force-include"].values()
    assert {Path(t).parts[2] for t in targets} == {
        sample.folder for sample in xcg.datasets._SAMPLES.values()
    }
    for source in held["force-include"]:
        assert (ROOT / source).exists()


@pytest.mark.parametrize("name", xcg.datasets._SAMPLES)
def test_every_sample_opens_and_is_listed(name):
    """Default fields need no further argument, and nothing is odd about them."""
    ds = xcg.datasets.open(name).isel(time=[-1])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", xcg.SceneWarning)
        f = ds.cg.coarse_grain().compute()
    told = [str(one.message) for one in told]
    assert not any("lack" in text for text in told)
    told = [text for text in told if "is NaN at" not in text or "volume fraction" in text]
    if name in ("impact", "segregation"):  # where some grains are 4 and 2 times as large as others
        assert len(told) == 1
        assert "volume fraction" in told[0]
    else:
        assert told == []
    assert {"density", "velocity", "granular_temperature", "volume_fraction"} <= set(f.data_vars)
    table = (ROOT / "examples" / "data" / "README.md").read_text()
    (row,) = (
        line for line in table.splitlines() if f"| `{xcg.datasets._SAMPLES[name].folder}` |" in line
    )
    assert f'"{name}"' in row
    assert xcg.datasets.samples()[name] in row


def test_the_version_is_the_same_everywhere():
    assert (
        re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1]
        == xcg.__version__
    )
