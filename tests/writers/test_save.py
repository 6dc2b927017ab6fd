"""Scenes written as NetCDF and Zarr are the same to the last bit when they are opened again."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import dask.array as da
import h5py
import netCDF4
import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner

import xcg
from tests import real_data
from tests.dumps import write_series
from tests.scenes import random_steps, reopen
from xcg.cli import group
from xcg.jobs.config import read_config
from xcg.jobs.run import run_job
from xcg.steps.faults import SkippedStep
from xcg.writers.files import whole_folder


def assert_same_bits(one: xr.Dataset, other: xr.Dataset) -> None:
    assert set(one.variables) == set(other.variables)
    for name, variable in one.variables.items():
        there = other.variables[name]
        assert variable.dims == there.dims, name
        if variable.dtype.kind in "fi":
            assert variable.dtype == there.dtype, name
            assert (
                variable.to_numpy().tobytes() == np.ascontiguousarray(there.to_numpy()).tobytes()
            ), name
        else:
            assert variable.to_numpy().tolist() == there.to_numpy().tolist(), name


@pytest.fixture(params=[".nc", ".zarr"])
def suffix(request):
    return request.param


@pytest.mark.parametrize("compression", [0, 1])
def test_blocks_of_another_type_than_announced_are_converted(tmp_path, suffix, compression):
    """As of `map_blocks` with a wrong `dtype`: its bytes are not those of the array in the file."""
    numbers = np.arange(24.0).reshape(6, 4)
    blocks = da.from_array(numbers, chunks=(1, 4)).map_blocks(lambda x: x.astype("f4"), dtype="f8")
    f = xr.Dataset({"a": (("time", "x"), blocks)}, {"time": np.arange(6.0)})
    saved = reopen(xcg.save(f, tmp_path / f"f{suffix}", compression=compression))
    assert saved["a"].dtype == "f8"
    assert saved["a"].values.tolist() == numbers.tolist()


@pytest.mark.parametrize("dtype", [">f8", ">i4"])
def test_numbers_of_another_byte_order_keep_their_values(tmp_path, suffix, dtype):
    numbers = np.arange(24).reshape(6, 4).astype(dtype)
    f = xr.Dataset({"a": (("time", "x"), numbers)}, {"time": np.arange(6.0)})
    assert reopen(xcg.save(f, tmp_path / f"f{suffix}"))["a"].values.tolist() == numbers.tolist()


@pytest.mark.parametrize("lazy", [False, True])
def test_a_saved_scene_reads_back_equal(tmp_path, suffix, lazy):
    ds = random_steps(4)
    saved = xcg.save(ds.chunk(time=1) if lazy else ds, tmp_path / f"scene{suffix}")
    again = reopen(saved)
    assert_same_bits(ds, again)
    assert {name: np.asarray(v).tolist() for name, v in ds.attrs.items()} == {
        name: np.asarray(v).tolist() for name, v in again.attrs.items()
    }
    assert again["position"].chunks[0] == (
        (1, 1, 1, 1) if suffix == ".nc" else (4,)
    )  # short steps share a file
    assert sorted(path.name for path in tmp_path.iterdir()) == [saved.name]


def test_hdf5_is_netcdf_by_another_name(tmp_path):
    ds = random_steps(2)
    for what in (ds, ds.cg.coarse_grain("density", axes="z")):
        assert_same_bits(what, reopen(what.cg.save(tmp_path / "saved.h5", overwrite=True)))
    with h5py.File(tmp_path / "saved.h5") as file:
        assert "density" in file
    ds.cg.save(tmp_path / "scene.h5")
    assert_same_bits(ds, xcg.open_scene(tmp_path / "scene.h5"))


def test_functions_give_the_same_bits_on_a_saved_scene(tmp_path, suffix):
    ds = random_steps(2)
    again = reopen(ds.cg.save(tmp_path / f"scene{suffix}"))
    assert repr(again.cg) == repr(ds.cg)
    for options in (
        {},
        {"axes": "z", "by": "species"},
        {"axes": "xz", "at": {"y": 1.0}, "width": "0.5 d32"},
    ):
        assert_same_bits(ds.cg.coarse_grain(**options), again.cg.coarse_grain(**options).compute())
    assert_same_bits(ds.cg.force_chains(), again.cg.force_chains().compute())
    assert_same_bits(ds.cg.find_contacts(), again.compute().cg.find_contacts())


def test_real_output_is_saved_and_read_back(tmp_path, suffix):
    folder = real_data("mfix_chute")
    ds = xcg.open_scene(
        folder / "P_FB1_0004.vtp",
        contacts=folder / "FC_0004.vtp",
        periodic="xz",
        box={"x": (0, 0.04), "z": (0, 0.02)},
    )
    again = reopen(xcg.save(ds, tmp_path / f"scene{suffix}"))
    assert_same_bits(ds, again)
    assert np.isinf(again["box"].sel(component="y")).all()
    assert_same_bits(
        ds.cg.coarse_grain(axes="y").compute(), again.cg.coarse_grain(axes="y").compute()
    )


def test_scenes_without_contacts_are_saved(tmp_path, suffix):
    ds = random_steps(3).isel(contact=[])
    for k, scene in enumerate((ds, ds.chunk(time=1))):
        assert_same_bits(ds, reopen(xcg.save(scene, tmp_path / f"{k}{suffix}")))


def test_uneven_chunks(tmp_path, suffix):
    """No step is lost where chunks of time differ in size, and from variable to variable."""
    ds = random_steps(7)
    one = ds.chunk(time=(2, 3, 2))
    one["velocity"] = one["velocity"].chunk(time=(3, 1, 3))
    one["diameter"] = one["diameter"].compute()
    for k in (0, 1):
        assert_same_bits(ds, reopen(xcg.save(one, tmp_path / f"{k}{suffix}", compression=k)))


def test_padding_takes_no_room(tmp_path, suffix):
    """A step with a hundred times the rows does not make the others larger."""

    def size(path):
        files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
        return sum(p.stat().st_size for p in files)

    rng = np.random.default_rng(0)
    few = [rng.normal(size=(50, 3)) for _ in range(20)]
    many = rng.normal(size=(5000, 3))
    alone = xcg.scene_from_arrays([many], diameter=1.0 + 0 * np.arange(5000)[None], density=1.0)
    ragged = xcg.scene_from_arrays(
        [*few, many], diameter=[np.ones(len(p)) for p in [*few, many]], density=1.0
    )  # fmt: skip
    sizes = [size(xcg.save(ds, tmp_path / f"{k}{suffix}")) for k, ds in enumerate((alone, ragged))]
    assert ragged.nbytes > 15 * alone.nbytes
    assert sizes[1] < 2 * sizes[0]


def test_wrong_targets_raise(tmp_path, suffix):
    ds = random_steps(1)
    path = xcg.save(ds, tmp_path / f"scene{suffix}")
    with pytest.raises(FileExistsError, match="overwrite=True"):
        xcg.save(ds, path)
    assert_same_bits(ds, reopen(xcg.save(ds, path, overwrite=True)))
    with pytest.raises(ValueError, match=r"ends with \.nc \(NetCDF\), \.h5 \(HDF5\), \.zarr"):
        xcg.save(ds, tmp_path / "scene.csv")
    with pytest.raises(FileNotFoundError, match="create it first"):
        xcg.save(ds, tmp_path / "none" / f"scene{suffix}")


def test_an_error_leaves_no_file(tmp_path, suffix):
    particles, _ = write_series(tmp_path)
    ds = xcg.open_scene(particles)
    (tmp_path / "p.10.dump").write_text("changed")
    target = tmp_path / "out"
    target.mkdir()
    with pytest.raises(xcg.SceneError, match="open it again"):
        xcg.save(ds, target / f"scene{suffix}")
    assert list(target.iterdir()) == []


def test_a_folder_of_other_things_is_not_replaced(tmp_path):
    folder = tmp_path / "results.zarr"
    folder.mkdir()
    ds = random_steps(1)
    xcg.save(ds, folder, overwrite=True)  # an empty one
    xcg.save(ds, folder, overwrite=True)  # one of Zarr
    other = tmp_path / "thesis.zarr"
    other.mkdir()
    (other / "thesis.tex").write_text("years of work")
    with pytest.raises(FileExistsError, match="without Zarr data"):
        xcg.save(ds, other, overwrite=True)
    assert (other / "thesis.tex").read_text() == "years of work"


@pytest.mark.parametrize(
    "options", [{}, {"dtype": "float32", "compression": 0}, {"digits": 3, "compression": 0}]
)
@pytest.mark.parametrize("lazy", [False, True])
def test_chunks_are_as_zarr_writes_them(tmp_path, monkeypatch, lazy, options):
    """The same files with the same bytes, also where a chunk is blank, or reaches beyond the last step."""
    monkeypatch.setattr("xcg.writers.formats._steps_together", lambda layout: 2)
    f = random_steps(5).cg.coarse_grain(["density", "granular_temperature", "stress"], axes="z")
    f["density"][:4] = np.nan
    f["count"] = ("time", "z"), np.zeros((5, f.sizes["z"]), int)
    f["count"][4, 0] = 7
    f["chosen"] = "time", np.linspace(0, 1, 5) > 0.5
    saved = xcg.save(f.chunk(time=2) if lazy else f, tmp_path / "own.zarr", **options)
    other = shutil.copytree(saved, tmp_path / "other.zarr")
    one = zarr.open_group(saved, mode="r")
    two = zarr.open_group(other, mode="r+")
    for name in f.data_vars:
        assert np.allclose(
            one[name], f[name], rtol=1e-3 if options else 0.0, atol=0.0, equal_nan=True
        ), name
        for chunk in Path(other, name).glob("c.*"):
            chunk.unlink()
        for first in range(0, 5, 2):
            two[name][first : first + 2] = one[name][first : first + 2]
    files = [
        {str(p.relative_to(top)): p.read_bytes() for p in top.rglob("*") if p.is_file()}
        for top in (saved, other)
    ]
    assert files[0] == files[1]
    chunks = {name: sum(file.startswith(f"{name}/c.") for file in files[0]) for name in f.data_vars}
    assert chunks["stress"] > chunks["density"] == chunks["count"] == 1


# --- Zarr: stores that are replaced, killed writers, two writers -----------------------------------------


KILLED = """
import os, sys
from pathlib import Path
import xcg
from xcg.writers import files
when, target = sys.argv[1:]
real, remove_for_good, count = Path.rename, files.remove, [0]

def rename(self, other):
    if when == "before" or (when == "between" and count[0] == 1):
        os._exit(9)
    count[0] += 1
    return real(self, other)

def remove(path):
    if Path(target).exists() and count[0] == 2:
        os._exit(9)
    remove_for_good(path)

Path.rename, files.remove = rename, remove
xcg.save(xcg.datasets.simple_cubic(3), target, overwrite=True)
"""


def test_a_full_disk_is_named_with_the_folder(tmp_path):
    path = tmp_path / "f.zarr"
    said = r"f\.zarr: the disk is full \(.* MB free\), and nothing was left behind; make room"
    with (
        pytest.raises(OSError, match=said),
        whole_folder(path, overwrite=False, part=tmp_path / "part"),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("when", "new"),
    [
        ("before", False),
        pytest.param("between", False, marks=pytest.mark.slow),  # the kills before and after
        ("after", True),
    ],
)
def test_a_killed_writer_leaves_the_old_or_the_new_store(tmp_path, when, new):
    """Killed before, between and after the two renames that put a new store in the place of an old one."""
    ds = xcg.datasets.simple_cubic(2)
    path = xcg.save(ds, tmp_path / "scene.zarr")
    done = subprocess.run([sys.executable, "-c", KILLED, when, str(path)], timeout=120, check=False)
    assert done.returncode == 9
    assert len(list(tmp_path.iterdir())) > 1
    with pytest.raises(FileExistsError, match="overwrite=True"):  # the next writer repairs first
        xcg.save(ds, path)
    assert_same_bits(xcg.datasets.simple_cubic(3) if new else ds, reopen(path))
    xcg.save(ds, path, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["scene.zarr"]


def test_leftovers_of_killed_writers_are_removed(tmp_path):
    """Of this store; those of a store with a longer name may be under way."""
    mine, other = ".a.zarr.0123abcd.part", ".a.zarr.b.zarr.0123abcd.part"
    for name in (mine, other):
        (tmp_path / name / "position").mkdir(parents=True)
    xcg.save(xcg.datasets.simple_cubic(2), tmp_path / "a.zarr")
    assert {p.name for p in tmp_path.iterdir()} == {"a.zarr", other}


def test_a_store_that_appears_meanwhile_is_kept(tmp_path):
    ds = random_steps(1)
    path = tmp_path / "scene.zarr"
    other = xcg.datasets.simple_cubic(2)

    def meanwhile(block):
        other.to_zarr(path, consolidated=False)
        return block

    lazy = ds["velocity"].chunk(time=1)
    late = ds.assign(
        velocity=lazy.copy(data=lazy.data.map_blocks(meanwhile, meta=np.empty((0, 0, 0))))
    )
    with pytest.raises(FileExistsError, match=r"scene\.zarr exists"):
        xcg.save(late, path)
    assert_same_bits(other, xr.open_zarr(path, consolidated=False))
    assert [p.name for p in tmp_path.iterdir()] == ["scene.zarr"]


def test_a_second_writer_of_a_store_raises(tmp_path):
    ds = xcg.datasets.simple_cubic(2)
    path = tmp_path / "scene.zarr"
    with whole_folder(path, overwrite=False, part=tmp_path / "part") as part:
        part.mkdir()
        with pytest.raises(
            FileExistsError, match=rf"being written by another run \(process {os.getpid()}\)"
        ):
            xcg.save(ds, path, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["scene.zarr"]


def test_a_store_that_cannot_take_its_place_leaves_the_old_one(tmp_path, monkeypatch):
    ds = xcg.datasets.simple_cubic(2)
    path = xcg.save(ds, tmp_path / "scene.zarr")
    real = Path.rename

    def rename(self, other):
        if self.parent.suffix == ".part":
            raise OSError(errno.EIO, "broken")
        return real(self, other)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(OSError, match="broken"):
        xcg.save(xcg.datasets.simple_cubic(3), path, overwrite=True)
    assert_same_bits(ds, reopen(path))
    assert [p.name for p in tmp_path.iterdir()] == ["scene.zarr"]


# --- results ---------------------------------------------------------------------------------------------


def test_results_are_stored_without_warnings_about_text(tmp_path):
    """Labels have no fixed length in Zarr, so that other programs can read them."""
    ds = random_steps(2)
    results = [
        ds.cg.coarse_grain(["stress"], by="species"),
        ds.cg.microstructure(),
        ds.cg.slice_temperature(),
    ]
    for k, f in enumerate(results):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            f.to_zarr(tmp_path / f"{k}.zarr", consolidated=False)
        again = xr.open_zarr(tmp_path / f"{k}.zarr", consolidated=False)
        assert (
            again["component"].values.tolist() == ["x", "y", "z"] if "component" in f.dims else True
        )
        assert_same_bits(f, again)


def test_suffixes_choose_the_format(tmp_path):
    ds = random_steps(2)
    assert xcg.save(ds.cg.coarse_grain("density"), tmp_path / "f.vtkhdf").exists()
    assert xcg.save(ds.cg.force_chains(), tmp_path / "c.vtkhdf").exists()


# --- opened as files of a code are -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("chunks", "expected"),
    [(None, None), (2, (2, 2, 1)), (-1, (5,)), ({"time": (1, 4)}, (1, 4)), ("auto", (5,))],
)
def test_open_scene_opens_saved_scenes(tmp_path, suffix, chunks, expected):
    ds = random_steps(5)
    saved = ds.cg.save(tmp_path / f"scene{suffix}")
    again = xcg.open_scene(saved, chunks=chunks)
    assert_same_bits(ds, again)
    assert again["position"].chunks == (
        None if chunks is None else (expected, *((n,) for n in ds["position"].shape[1:]))
    )
    fields = again.cg.coarse_grain("stress")
    assert fields.chunks.get("time") == expected
    assert_same_bits(ds.cg.coarse_grain("stress"), fields.compute())


def test_chunks_of_long_series_equal_those_of_the_file(tmp_path, monkeypatch):
    saved = random_steps(7).chunk(time=2).cg.save(tmp_path / "scene.nc")
    monkeypatch.setattr("xcg.readers.chunks._TASK", 1e-9)
    assert xcg.open_scene(saved).chunks["time"] == (2, 2, 2, 1)
    monkeypatch.setattr(
        "xcg.readers.chunks._TASK",
        2.5e-6 * sum(xcg.open_scene(saved).sizes[d] for d in ("particle", "contact")),
    )
    assert xcg.open_scene(saved).chunks["time"] == (4, 3)


@pytest.mark.parametrize(
    ("given", "named"),
    [({"contacts": "c.*.dump"}, "contacts"), ({"density": 2.0}, "density"), ({"timestep": 0.5}, "timestep"),
     ({"box": np.array([[0, 1]] * 3)}, "box"), ({"missing": "skip"}, "missing"),
     ({"allow_unknown": True}, "allow_unknown")],
)  # fmt: skip
def test_options_of_readers_raise_for_saved_scenes(tmp_path, suffix, given, named):
    saved = random_steps(1).cg.save(tmp_path / f"scene{suffix}")
    with pytest.raises(
        xcg.SceneError, match=rf"scene\{suffix} is a scene that xcg saved, which takes no {named}="
    ):
        xcg.open_scene(saved, **given)


@pytest.mark.parametrize(
    "name", ["scene.nc4", "scene.h5", "scene.HDF5", "a scene [1] é.nc", "a scene [1] é.zarr"]
)
def test_saved_scenes_open_under_any_name(tmp_path, name):
    ds = random_steps(2)
    saved = ds.cg.save(tmp_path / ("saved.zarr" if name.endswith("zarr") else "saved.nc"))
    saved.rename(tmp_path / name)
    assert_same_bits(ds, xcg.open_scene(tmp_path / name))
    job = tmp_path / "job.toml"
    job.write_text(f'[scene]\nparticles = "{name}"\n[fields]\nfields = "density"\naxes = "z"\n')
    assert sum(done for done, _ in [*run_job(read_config(job))][-1:]) == 2


def test_a_pattern_opens_one_saved_scene(tmp_path, suffix):
    ds = random_steps(2)
    saved = [ds.cg.save(tmp_path / f"scene{n}{suffix}") for n in (1, 2)]
    assert_same_bits(ds, xcg.open_scene(tmp_path / f"scene1*{suffix}"))
    for several in (saved, tmp_path / f"scene*{suffix}"):
        with pytest.raises(
            xcg.SceneError, match=r"scene1.* is a scene that xcg saved, .* open the 2"
        ):
            xcg.open_scene(several)


def test_a_damaged_chunk_is_named_and_skipped(tmp_path):
    ds = random_steps(4)
    saved = ds.chunk(time=1).cg.save(tmp_path / "scene.nc", compression=1)
    with h5py.File(saved) as file:
        chunk = file["position"].id.get_chunk_info(1)
    held = bytearray(saved.read_bytes())
    held[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    saved.write_bytes(held)
    again = xcg.open_scene(saved, chunks=1)
    said = r"scene\.nc: 'position' cannot be read at the steps 1 to 1 \(RuntimeError: .*\); it is damaged"
    with pytest.raises(xcg.SceneError, match=said):
        again.cg.coarse_grain("density", axes="z").compute()
    with pytest.warns(SkippedStep, match=f"step 1 is skipped: .*{said}"):
        f = again.cg.coarse_grain("density", axes="z", on_error="skip").compute()
    assert f.skipped.values.tolist() == [False, True, False, False]
    whole = ds.cg.coarse_grain("density", axes="z")
    np.testing.assert_array_equal(f.density[[0, 2, 3]], whole.density[[0, 2, 3]])


def test_coordinates_and_boxes_of_saved_scenes_are_in_memory(tmp_path, suffix):
    ds = random_steps(2)
    ds = ds.assign_coords(tag=("particle", np.arange(ds.sizes["particle"])))
    again = xcg.open_scene(ds.cg.save(tmp_path / f"scene{suffix}"))
    assert {name for name, values in again.variables.items() if values.chunks is None} == {
        *again.coords,
        "box",
    }
    assert_same_bits(ds, again)


def test_wrong_on_error_raises_for_saved_scenes(tmp_path, suffix):
    saved = random_steps(1).cg.save(tmp_path / f"scene{suffix}")
    with pytest.raises(ValueError, match="on_error='never'"):
        xcg.open_scene(saved, on_error="never")


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize(
    "values",
    [np.array(["2020-01-01", "2020-01-03"], "M8[ns]"), np.array([1, 5], "m8[s]").astype("m8[ns]"),
     np.array(["sand", "müll"]), np.array(["sand", "müll"], object)],
    ids=["dates", "spans", "texts", "objects"],
)  # fmt: skip
def test_nan_and_infinity_read_back_equal(tmp_path, suffix, lazy, values):
    ds = random_steps(2).assign(extra=("time", values)).assign_coords(when=("time", values))
    saved = (ds.chunk(time=1) if lazy else ds).cg.save(tmp_path / f"scene{suffix}")
    again = xcg.open_scene(saved)
    for name in ("extra", "when"):
        assert again[name].values.tolist() == values.tolist()
    assert_same_bits(ds.drop_vars(["extra", "when"]), again.drop_vars(["extra", "when"]))


def test_files_that_are_no_scene_raise(tmp_path, suffix):
    fields = random_steps(1).cg.coarse_grain("density").cg.save(tmp_path / f"fields{suffix}")
    with pytest.raises(
        xcg.SceneError, match=rf"fields\{suffix} is no scene that xcg saved \(it holds density\)"
    ):
        xcg.open_scene(fields, density=1.0)
    broken = tmp_path / f"broken{suffix}"
    if suffix == ".zarr":
        broken.mkdir()
    else:
        broken.write_bytes(fields.read_bytes()[:512])
    with pytest.raises(xcg.SceneError, match=rf"broken\{suffix}: cannot be opened as "):
        xcg.open_scene(broken)


def test_commands_accept_saved_scenes(tmp_path, suffix):
    ds = random_steps(2)
    saved = str(ds.cg.save(tmp_path / f"scene{suffix}"))
    told = CliRunner().invoke(group, ["info", saved])
    assert told.exit_code == 0, told.output
    assert told.output.strip() == repr(xcg.open_scene(saved).cg) == repr(ds.cg)
    chains = CliRunner().invoke(group, ["chains", saved, "--csv", str(tmp_path / "c_{step}.csv")])
    assert chains.exit_code == 0, chains.output
    assert len(list(tmp_path.glob("c_*.csv"))) == 2
    job = tmp_path / "job.toml"
    job.write_text(
        f'[scene]\nparticles = "scene{suffix}"\n[fields]\nfields = ["stress"]\n[output]\nfolder = "out"\n'
    )
    done = CliRunner().invoke(group, ["run", str(job)])
    assert done.exit_code == 0, done.output
    with xr.open_dataset(tmp_path / "out" / "fields.nc") as found:
        np.testing.assert_array_equal(found["stress"], ds.cg.coarse_grain("stress")["stress"])
    back = CliRunner().invoke(group, ["convert", saved, "-o", str(tmp_path / "again.zarr")])
    assert back.exit_code == 0, back.output
    assert_same_bits(ds, reopen(tmp_path / "again.zarr"))


# --- the command line ------------------------------------------------------------------------------------


def test_convert_writes_a_scene(tmp_path, suffix):
    particles, contacts = write_series(tmp_path)
    target = tmp_path / f"scene{suffix}"
    command = [
        "convert",
        particles,
        "-c",
        contacts,
        "-o",
        str(target),
        "--periodic",
        "x",
        "--timestep",
        "0.5",
    ]
    done = CliRunner().invoke(group, command)
    assert done.exit_code == 0, done.output
    assert "3 steps" in done.output
    assert_same_bits(
        xcg.open_scene(particles, contacts=contacts, periodic="x", timestep=0.5), reopen(target)
    )
    again = CliRunner().invoke(group, command)
    assert again.exit_code == 1
    assert "exists" in again.output
    assert CliRunner().invoke(group, [*command, "--overwrite"]).exit_code == 0


def test_convert_follows_a_job(tmp_path, suffix):
    write_series(tmp_path)
    job = tmp_path / "job.toml"
    text = '[scene]\nparticles = "p.*.dump"\ncontacts = "c.*.dump"\nnames = { mass = "weight" }\ndensity = 2.0\n'
    job.write_text(text)
    done = CliRunner().invoke(group, ["convert", str(job), "-o", str(tmp_path / f"scene{suffix}")])
    assert done.exit_code == 0, done.output
    assert "weight" in reopen(tmp_path / f"scene{suffix}")


def test_labels_are_characters_of_fixed_length(tmp_path):
    """Texts of any length were seen to crash the library when `open_mfdataset` was called again and again."""
    ds = random_steps(4)
    whole = ds.cg.coarse_grain(["density", "velocity"], axes="z", by="species")
    for t in range(4):
        whole.isel(time=[t]).cg.save(tmp_path / f"f_{t}.nc")
    with netCDF4.Dataset(tmp_path / "f_0.nc") as file:
        assert {file[name].dtype for name in ("phase", "component")} == {np.dtype("S1")}
    code = f"import xarray as xr, xcg\nfor _ in range(10): xr.open_mfdataset({str(tmp_path / 'f_*.nc')!r}, "
    code += "combine='nested', concat_dim='time', data_vars='minimal').load()\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    for t in range(4):
        again = xr.open_dataset(tmp_path / f"f_{t}.nc")
        xr.testing.assert_identical(again.load(), whole.isel(time=[t]))
        again.cg.save(tmp_path / "again.nc", overwrite=True)
        xr.testing.assert_identical(
            xr.open_dataset(tmp_path / "again.nc").load(), whole.isel(time=[t])
        )


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_a_series_without_steps_is_saved(tmp_path, suffix):
    f = xcg.datasets.simple_cubic(3).cg.coarse_grain("density", axes="z").isel(time=slice(0, 0))
    f.cg.save(tmp_path / f"f{suffix}")
    with xr.open_dataset(
        tmp_path / f"f{suffix}", engine="zarr" if suffix == ".zarr" else None
    ) as again:
        assert again.sizes == f.sizes


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("time", [slice(None), 0])
def test_a_list_of_names_writes_the_same_files(tmp_path, lazy, time):
    ds = random_steps(4)
    f = (ds.chunk(time=1) if lazy else ds).cg.coarse_grain(["density", "velocity"]).isel(time=time)
    names = ["f.nc", "f.zarr", "f.vtkhdf"]
    paths = f.cg.save([tmp_path / name for name in names])
    assert [path.name for path in paths] == names
    for name, path in zip(names[:2], paths[:2], strict=True):
        alone = f.cg.save(tmp_path / f"alone_{name}")
        xr.testing.assert_identical(reopen(path).compute(), reopen(alone).compute())
    alone = f.cg.save(tmp_path / "alone.vtkhdf")
    with h5py.File(paths[2]) as image, h5py.File(alone) as image_alone:
        where = "VTKHDF/PointData/velocity"
        np.testing.assert_array_equal(image[where], image_alone[where])


def test_a_list_of_names_computes_each_step_once(tmp_path):
    computed = []

    def seen(values):
        computed.append(len(values))
        return values

    f = random_steps(4).cg.coarse_grain(["density"]).chunk(time=1)
    f["density"] = f.density.copy(data=f.density.data.map_blocks(seen, meta=f.density.data._meta))
    f.cg.save([tmp_path / "f.nc", tmp_path / "f.vtkhdf"])
    assert computed == [1, 1, 1, 1]


@pytest.mark.parametrize("names", [[], ["f.nc", "f.pvd"], ["f.nc", "f.nc"]])
def test_lists_that_cannot_be_written_together_raise(tmp_path, names):
    f = random_steps(1).cg.coarse_grain(["density"])
    with pytest.raises(ValueError, match="expected different names"):
        f.cg.save([tmp_path / name for name in names])
    assert not list(tmp_path.iterdir())
