"""Scenes as xarray opens other files: `xr.open_dataset` with the backend, and arrays without dask."""

import pickle

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.benchmarks import series
from xcg.readers import indexed
from xcg.readers.backend import SceneBackend

STEPS = 4


@pytest.fixture
def files(tmp_path):
    """Arguments of `xcg.open_scene` for a series."""
    return series.write_vtp_series(tmp_path, 60, STEPS, base=3)


def open_by_xarray(files, **options):
    others = {name: value for name, value in files.items() if name != "particles"}
    return xr.open_dataset(files["particles"], engine=SceneBackend, **others, **options)


@pytest.mark.parametrize(("chunks", "expected"), [
    (None, None), ({}, (1,) * STEPS), ("auto", (STEPS,)), ({"time": 3}, (3, 1)), (-1, (STEPS,)),
])  # fmt: skip
def test_each_body_is_read_once_for_all_variables(files, reads, chunks, expected):
    scene = xcg.open_scene(**files)
    whole = scene.compute()
    reads.clear()
    ds = open_by_xarray(files, chunks=chunks)
    assert (ds.position.chunks is None) if expected is None else (ds.position.chunks[0] == expected)
    assert ds.attrs.keys() == scene.attrs.keys()
    assert reads == {("particles", 0): 1, ("particles", STEPS - 1): 1}
    xr.testing.assert_identical(ds.compute(scheduler="sync"), whole)
    assert reads == {(kind, step): 1 for kind in ("particles", "contacts") for step in range(STEPS)}


def test_fields_have_the_bits_of_open_scene(files):
    fields = ["density", "contact_stress"]
    expected = xcg.open_scene(**files).cg.coarse_grain(fields).compute()
    for chunks in (None, {}, {"time": 2}):
        xr.testing.assert_equal(
            open_by_xarray(files, chunks=chunks).cg.coarse_grain(fields).compute(), expected
        )


def test_only_selected_variables_are_read(files, reads):
    whole = xcg.open_scene(**files).compute()
    ds = xcg.open_scene(**files, chunks=None)
    reads.clear()
    rng = np.random.default_rng(0)
    for take in (2, slice(1, 3), [3, 1], slice(0, 0)):
        one, other = (d.isel(time=take) for d in (ds, whole))
        for name in ("position", "contact_i"):
            xr.testing.assert_identical(one[name].load(), other[name])
        rows = rng.integers(0, 60, 7)
        xr.testing.assert_identical(
            one.velocity.isel(particle=rows, component=1).load(),
            other.velocity.isel(particle=rows, component=1),
        )
    assert {step for _, step in reads} == {1, 2, 3}
    assert max(reads.values()) == 1
    again = pickle.loads(pickle.dumps(ds))
    xr.testing.assert_identical(again.compute(), whole)


def test_a_single_step_is_read_once_without_dask(tmp_path, reads):
    one = series.write_vtp_series(tmp_path, 60, 1)
    ds = xcg.open_scene(**one)
    assert not ds.chunks
    first = ds.cg.coarse_grain("stress", axes="z")
    assert not first.chunks
    xr.testing.assert_identical(ds.cg.coarse_grain("stress", axes="z"), first)
    assert max(reads.values()) == 1
    chunked = xcg.open_scene(**one, chunks=1)
    assert chunked.chunks["time"] == (1,)
    xr.testing.assert_identical(chunked.compute(), ds)


def test_steps_are_kept_within_a_bound(files, reads, monkeypatch):
    monkeypatch.setattr(indexed, "_MOST_KEPT", 0)
    indexed._recent.clear()
    ds = xcg.open_scene(**files, chunks=None)
    ds.isel(time=[0, -1]).load()  # the steps that are kept from opening are used up
    indexed._recent.clear()
    reads.clear()
    ds.position.values, ds.velocity.values  # noqa: B018
    assert len(indexed._recent) == indexed._KEPT
    assert sum(reads.values()) == 2 * STEPS


def test_a_damaged_file_raises_each_time(files, tmp_path):
    ds = xcg.open_scene(**files, chunks=None)
    sorted(tmp_path.rglob("P*.vtp"))[1].unlink()
    for name in ("position", "velocity"):
        with pytest.raises(xcg.SceneError, match="is gone after the scene was opened"):
            ds[name].load()
    ds.position.isel(time=0).load()


def test_a_relative_path_and_another_current_folder(tmp_path, monkeypatch):
    (tmp_path / "grains.csv").write_text("x,y,z,radius\n0,0,0,1\n")
    monkeypatch.chdir(tmp_path)
    relative, absolute = (xcg.open_scene(path) for path in ("grains.csv", tmp_path / "grains.csv"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    absolute.position.load()
    with pytest.raises(
        xcg.SceneError,
        match=r"absolute path where the current folder changed \(it is .*elsewhere\)",
    ):
        relative.position.load()


def test_options_and_drop_variables_are_taken(files):
    ds = open_by_xarray(
        files,
        reader="mfix",
        drop_variables=["velocity", "nothing"],
        density=2500.0,
        gravity=(0, 0, -9.81),
    )
    assert "velocity" not in ds
    assert ds.attrs["gravity"].tolist() == [0, 0, -9.81]
    with pytest.raises(xcg.SceneError, match="unknown engine 'mfx'; did you mean 'mfix'"):
        open_by_xarray(files, reader="mfx")
    with pytest.raises(xcg.SceneError, match=r"no argument 'graviti' .*did you mean 'gravity'"):
        open_by_xarray(files, graviti=(0, 0, 1))


def test_only_files_that_an_engine_recognises_are_taken(files, tmp_path):
    backend = SceneBackend()
    assert backend.guess_can_open(files["particles"])
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "a.nc")
    (tmp_path / "cut.dump.gz").write_bytes(b"\x1f\x8b")
    for other in ("a.nc", "cut.dump.gz", "absent.vtp", ""):
        assert not backend.guess_can_open(tmp_path / other)
    assert not backend.guess_can_open("https://example.org/p.vtp")
    assert not backend.guess_can_open(b"ITEM: TIMESTEP")


@pytest.mark.parametrize("call", [xr.open_datatree, xr.open_groups])
def test_trees_name_the_call_that_opens_a_scene(files, call):
    with pytest.raises(xcg.SceneError, match=r"xarray.open_dataset\(..., engine='xcg'\)"):
        call(files["particles"], engine="xcg")
