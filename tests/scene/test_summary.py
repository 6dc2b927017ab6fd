"""The summary that ``ds.cg`` shows, of scenes and of results."""

import re

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import dumps
from tests.scenes import random_steps

ENDS = {"nc": xr.open_dataset, "zarr": xr.open_zarr}


def rows(ds):
    """Rows of the text; those of the HTML are the same."""
    text = repr(ds.cg).splitlines()
    found = dict(re.fullmatch(r"  (\S+): *(.*)", line).groups() for line in text[1:])
    html = re.sub(r"<[^>]*>", "\n", ds.cg._repr_html_())
    for part in (text[0], *found, *found.values()):
        assert (
            part.replace("&", "&amp;")
            .replace("'", "&#x27;")
            .replace("<", "&lt;")
            .replace(">", "&gt;")
            in html
        )
    return {"title": text[0]} | found


@pytest.fixture
def opened(tmp_path):
    for step in (10, 20):
        dumps.write(
            tmp_path / f"p.{step}.dump",
            dumps.dump_text(columns=dumps.ATOMS.replace(" x ", " x "), step=step),
        )
    return xcg.open_scene(str(tmp_path / "p.*.dump"), units="SI", gravity=(0, 0, -9.81), names={"vx": None,
                          "vy": None, "vz": None})  # fmt: skip


def test_the_summary_of_a_scene_names_files_and_columns_that_are_not_read(opened, tmp_path):
    said = rows(opened)
    assert said["title"].startswith("scene of 2 steps with up to")
    assert said["engine"] == "lammps"
    assert re.fullmatch(r"particles: .*p\.10\.dump to .*p\.20\.dump \(2 files\)", said["files"])
    assert said["unread"].startswith("particles: ")
    assert {"vx", "vy", "vz"} <= set(said["unread"].removeprefix("particles: ").split(", "))
    assert said["gravity"] == "(0, 0, -9.81) m s^-2"
    assert said["units"] == "SI"
    assert said["time"] == "10 to 20 (numbers of steps, times are not known)"
    assert said["missing"] == "velocity, contact_force"


@pytest.mark.parametrize("suffix", ENDS)
def test_the_summary_is_kept_by_selections_and_files(opened, tmp_path, suffix):
    said = rows(opened)
    again = ENDS[suffix](opened.cg.save(tmp_path / f"scene.{suffix}"))
    for kept in (
        again,
        opened.isel(time=0),
        opened.isel(particle=slice(1)),
        opened.where(opened.diameter > 0),
    ):
        assert {
            name: rows(kept)[name]
            for name in ("engine", "files", "unread", "gravity", "units", "box")
        } == {name: said[name] for name in ("engine", "files", "unread", "gravity", "units", "box")}
    assert rows(again)["time"] == said["time"]


def test_labels_are_one_word_and_counts_agree_with_nouns():
    arrays = {"diameter": np.ones(2), "density": 1.0, "contact_i": [0], "contact_j": [1]}
    ds = xcg.scene_from_arrays(np.eye(3)[:2], **arrays, contact_force=np.ones((1, 3)))
    said = rows(ds)  # a row that does not match would raise
    assert said["sides"].startswith("contacts listed from both sides")
    assert said["title"].startswith("scene of 1 step with")
    f = ds.cg.coarse_grain("number_density", axes="x", extent={"y": 1.0, "z": 1.0})
    assert rows(f)["title"].startswith("result of 1 step on")


def test_walls_with_names_are_listed():
    """As the page on the silo says."""
    assert rows(xcg.datasets.open("silo"))["walls"] == "side (-2), floor (-3)"
    assert "walls" not in rows(xcg.datasets.open("chute"))


def test_names_in_files_are_made_printable(tmp_path):
    codes = "c_\x1b[31m"
    dumps.write(tmp_path / "p.10.dump", dumps.dump_text(columns=dumps.ATOMS.replace(" vx ", f" {codes} ")
                .replace(" vy ", " c_2 ").replace(" vz ", " c_3 "), step=10))  # fmt: skip
    ds = xcg.open_scene(tmp_path / "p.10.dump", units="SI")
    for text in (repr(ds.cg), ds.cg._repr_html_()):
        assert r"c_\x1b[31m" in text
        assert all(c.isprintable() or c == "\n" for c in text)


def test_markup_is_escaped():
    ds = random_steps(1).rename(species="<b>species</b>")
    assert "&lt;b&gt;species&lt;/b&gt;" in ds.cg._repr_html_()


def test_a_changing_box_is_noted():
    moving = xcg.scene_from_arrays(np.zeros((2, 1, 3)), diameter=np.ones((2, 1)), density=1.0,
                                   box=[[[0, 2.0]] * 3, [[0, 3.0]] * 3])  # fmt: skip
    assert rows(moving)["box"] == "x 0 to 2, y 0 to 2, z 0 to 2 m (first step)"
    assert rows(moving.chunk(time=1))["box"] == "changes with time"
    assert rows(moving.isel(time=1))["box"] == "x 0 to 3, y 0 to 3, z 0 to 3 m"


@pytest.mark.parametrize("suffix", ENDS)
def test_the_summary_of_a_result_has_mesh_kernel_and_times(tmp_path, suffix):
    ds = random_steps(3)
    f = ds.cg.coarse_grain(
        ["density", "velocity"], axes="xz", at={"y": 1.0}, width=0.8, spacing=1.0, by="species"
    )
    again = ENDS[suffix](f.cg.save(tmp_path / f"f.{suffix}"))
    for g in (f, again):
        said = rows(g)
        assert said["title"] == "result of 3 steps on 5 x x 5 z nodes"
        assert said["fields"] == "density, velocity"
        assert said["x"] == "0 to 4 m, spacing 1"
        assert said["fixed"] == "y = 1"
        assert said["phase"] == "bulk, 1, 2"
        assert said["kernel"] == "lucy, width 0.8, cutoff 1.6"
        assert said["time"] == "0 to 0.2 s"
        assert "coarse_grain(fields=" in said["history"]
        one = rows(g.isel(time=1, phase=0).sel(x=2.2, method="nearest"))
        assert (one["title"], one["fixed"], one["phase"]) == (
            "result of one step on 5 z nodes",
            "x = 2, y = 1",
            "bulk",
        )
        mean = rows(g.compute().cg.time_average())
        assert mean["averaged"] == "over 3 steps"
        assert "time" not in mean
        assert "z" not in rows(g.compute().cg.profile("x"))
    assert rows(ds.cg.coarse_grain("density", axes="z", width=0.8))["averaged"] == "along x, y"
    several = ds.cg.coarse_grain("density", axes="z", by="species", width={1: 0.5, 2: 0.8})
    assert rows(several)["kernel"] == "lucy, width 0.5 and 0.8, cutoff 1 and 1.6"


def test_all_results_and_other_datasets_have_a_summary():
    ds = random_steps(2)
    for task in (
        "particle_stress",
        "microstructure",
        "slice_temperature",
        "size_statistics",
        "force_chains",
    ):
        result = getattr(ds.cg, task)()
        for g in (result, result.isel(time=0)):
            assert len(repr(g.cg).splitlines()) > 2
            assert g.cg._repr_html_().startswith("<div>")
    assert rows(ds.cg.force_chains())["time"] == "0 to 0.1 s"
    assert rows(xr.Dataset({"a": 1}))["title"].startswith("neither a scene nor a result")
    assert rows(xr.Dataset())["variables"] == "none"
