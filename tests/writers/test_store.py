"""Files that an interrupted save began are continued: the bits of an uninterrupted one, and no step twice."""

import os
import pickle
import re
import subprocess
import sys
from pathlib import Path

import dask
import h5py
import numpy as np
import pytest

import xcg
from tests import ROOT
from tests.scenes import random_steps
from xcg.writers import formats
from xcg.writers.formats import hdf5_file, recover
from xcg.writers.interrupted import Mismatch

SUFFIXES = [".nc", ".h5", ".zarr", ".vtkhdf"]
STEPS = 6


def fields(fail_at=None, seen=None, **options):
    """Fields of six chunks of time, one of which fails at a step; computed ones are noted."""
    ds = random_steps(STEPS).chunk(time=1)
    f = ds.cg.coarse_grain(["density", "velocity", "stress"], axes="xz", width=1.0, **options)
    if fail_at is None and seen is None:
        return f

    def note(values, block_info=None):
        step = block_info[0]["chunk-location"][0]
        if seen is not None and values.size:
            seen.append(step)
        if step == fail_at:
            raise RuntimeError("stopped")
        return values

    data = f.density.data.map_blocks(
        note, dtype="f8", meta=np.empty((0, 0, 0)), name=f"noted-{f.density.data.name}"
    )
    return f.assign(density=f.density.copy(data=data))


def assert_same_bits(one: Path, other: Path):
    if one.suffix == ".zarr":
        files = [
            {str(p.relative_to(top)): p.read_bytes() for p in top.rglob("*") if p.is_file()}
            for top in (one, other)
        ]
        for held in files:  # the history tells the time
            held.pop("zarr.json")
        assert files[0] == files[1]
        return
    arrays = {}
    with h5py.File(one) as file:
        file.visititems(
            lambda name, a: arrays.update({name: a[()]}) if isinstance(a, h5py.Dataset) else None
        )
    with h5py.File(other) as file:
        assert arrays
        for name, values in arrays.items():
            assert np.asarray(file[name]).tobytes() == np.asarray(values).tobytes(), name
            if file[name].chunks:
                chunks = [h5py.File(path)[name].id for path in (one, other)]
                assert chunks[0].get_num_chunks() == chunks[1].get_num_chunks(), name


@pytest.mark.parametrize("compression", [0, 1])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_error_midway_keeps_the_steps_before(tmp_path, suffix, compression, monkeypatch):
    monkeypatch.setattr("xcg.writers.formats._steps_together", lambda layout: 1)
    path = tmp_path / f"f{suffix}"
    options = {"compression": compression, "resume": True}
    with dask.config.set(scheduler="sync"):
        with pytest.raises(RuntimeError, match="stopped"):
            xcg.save(fields(fail_at=3, seen=[]), path, **options)
        assert not path.exists()
        lines = (tmp_path / f".f{suffix}.begun/done_0.jsonl").read_text()
        done = {int(first) for first in re.findall(r"\[(\d+),", lines)}
        seen = []
        xcg.save(fields(seen=seen), path, **options)
    assert done
    assert sorted(seen) == sorted(set(range(STEPS)) - done)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert_same_bits(path, xcg.save(fields(), tmp_path / f"whole{suffix}", compression=compression))


KILLED = """
import os, sys
import numpy as np, xcg, dask, zarr
from tests.writers.test_store import fields
from xcg.writers import formats, store
path, kills, where = sys.argv[1], int(sys.argv[2]), sys.argv[3]
formats._steps_together = lambda layout: 1
count = [0]
def counted(real):
    def call(*args, **kwargs):
        count[0] += 1
        if count[0] == kills:
            os._exit(9)
        return real(*args, **kwargs)
    return call
if where == "log":
    store.Log.add = counted(store.Log.add)
elif where == "apply":
    formats._apply = counted(formats._apply)
elif where == "write":
    formats.Sink.write = counted(formats.Sink.write)
elif where == "chunk":
    zarr.Array.__setitem__ = counted(zarr.Array.__setitem__)
with dask.config.set(scheduler="sync"):
    xcg.save(fields(), path, resume=True, compression=int(sys.argv[4]))
"""


@pytest.mark.parametrize(
    ("suffix", "where", "kills", "compression"),
    [
        (".nc", "apply", 2, 0),
        (".vtkhdf", "apply", 3, 1),
        (".zarr", "chunk", 8, 0),
        # the same at other places
        pytest.param(".nc", "log", 3, 1, marks=pytest.mark.slow),
        pytest.param(".nc", "write", 60, 1, marks=pytest.mark.slow),
        pytest.param(".nc", "write", 45, 0, marks=pytest.mark.slow),
        pytest.param(".vtkhdf", "log", 3, 1, marks=pytest.mark.slow),
        pytest.param(".vtkhdf", "write", 60, 0, marks=pytest.mark.slow),
        pytest.param(".vtkhdf", "write", 81, 1, marks=pytest.mark.slow),
        pytest.param(".zarr", "log", 2, 1, marks=pytest.mark.slow),
    ],
)
def test_a_killed_process_keeps_finished_steps(
    tmp_path, suffix, where, kills, compression, monkeypatch
):
    monkeypatch.setattr("xcg.writers.formats._steps_together", lambda layout: 1)
    path = tmp_path / f"f{suffix}"
    command = [sys.executable, "-c", KILLED, str(path), str(kills), where, str(compression)]
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": str(ROOT)}, timeout=120, check=False
    )
    assert done.returncode == 9
    assert not path.exists()
    xcg.save(fields(), path, resume=True, compression=compression)
    assert {p.name for p in tmp_path.iterdir()} == {path.name}
    assert_same_bits(path, xcg.save(fields(), tmp_path / f"whole{suffix}", compression=compression))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_resuming_with_another_call_raises(tmp_path, suffix):
    path = tmp_path / f"f{suffix}"
    with dask.config.set(scheduler="sync"), pytest.raises(RuntimeError, match="stopped"):
        xcg.save(fields(fail_at=3), path, resume=True)
    with pytest.raises(
        xcg.SceneError, match=r"another scene or call .*encoding: .*digits=4.* instead of"
    ):
        xcg.save(fields(fail_at=3), path, resume=True, digits=4)
    with pytest.raises(xcg.SceneError, match=r"values of 'velocity'"):
        xcg.save(fields(kernel="gaussian"), path, resume=True)
    with pytest.raises(xcg.SceneError, match=r"shape of 'time': .* 5.* instead of .* 6"):
        xcg.save(fields().isel(time=slice(5)), path, resume=True)
    xcg.save(fields(), path)  # without resume, it is let alone
    assert (tmp_path / f".f{suffix}.begun").is_dir()


def test_resume_writes_eager_results_and_refuses_other_formats(tmp_path):
    f = fields().compute()
    for suffix in SUFFIXES:
        assert_same_bits(
            xcg.save(f, tmp_path / f"a{suffix}", resume=True), xcg.save(f, tmp_path / f"b{suffix}")
        )
    with pytest.raises(ValueError, match=r"resume=True continues"):
        xcg.save(f, tmp_path / "f.pvd", resume=True)


def test_hdf5_reads_back_nothing_that_a_session_changed(tmp_path, monkeypatch):
    """Changes wait in the journal, and `Sink` reads what the file held before."""
    reads = []
    read = formats.Sink.readinto

    def readinto(sink, buffer):
        first = sink.tell()
        stop = first + len(memoryview(buffer).cast("B"))
        spans = [(place, place + len(data)) for place, data in sink._changes]
        reads.append(any(max(first, low) < min(stop, high) for low, high in spans))
        return read(sink, buffer)

    path = tmp_path / "f.h5"
    names = [f"v{k}" for k in range(30)]
    with h5py.File(path, "w") as file:
        for name in names:
            file.create_dataset(name, data=np.zeros((2000, 2)), chunks=(1, 2))
    monkeypatch.setattr(formats.Sink, "readinto", readinto)
    with hdf5_file(path, "r+", journal=True) as file:
        for step in range(0, 2000, 40):
            for name in names:
                file[name].id.write_direct_chunk((step, 0), np.full(2, 1.0 + step).tobytes())
    recover(path)
    assert len(reads) > 100
    assert not any(reads)
    with h5py.File(path) as file:
        for name in names:
            np.testing.assert_array_equal(file[name][::40, 1], 1.0 + np.arange(0, 2000, 40))


def test_a_file_comes_to_the_state_after_the_last_task(tmp_path, monkeypatch):
    """Of a process that ended before the changes in the journal were made, and after the next one had begun."""
    path = tmp_path / "f"
    with hdf5_file(path, "w") as file:
        file["a"] = np.arange(1000.0)
    for k in range(3):
        if k == 2:
            monkeypatch.setattr("xcg.writers.formats._apply", lambda changes, file: None)
        with hdf5_file(path, "r+", journal=True) as file:
            file[f"b{k}"] = np.full(100, k)
            file["a"][k] = -1.0
    with h5py.File(path) as file:
        assert sorted(file) == ["a", "b0", "b1"]
    monkeypatch.undo()
    path.write_bytes(path.read_bytes() + b"appended")
    recover(path)
    with h5py.File(path) as file:
        assert sorted(file) == ["a", "b0", "b1", "b2"]
        assert file["a"][:4].tolist() == [-1.0, -1.0, -1.0, 3.0]


def test_the_error_of_another_run_comes_back_from_a_worker(tmp_path):
    error = Mismatch(tmp_path, ["encoding: a instead of b"])
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error)
    assert (copy.folder, copy.changed) == (error.folder, error.changed)
