"""What headers said is remembered, and forgotten when the files change."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests import real_data
from tests.dumps import dump_text, write, write_series
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines import lammps as lammps_engine
from xcg.readers.engines import vtk_steps
from xcg.readers.engines.lammps import Lammps
from xcg.readers.engines.mfix import Mfix
from xcg.readers.open import open_scene
from xcg.readers.paths import remembered


def settle(folder: Path) -> None:
    """Make files look older than the moment in which they may still change."""
    for path in folder.iterdir():
        at = os.stat(path).st_mtime_ns - 10 * 10**9
        os.utime(path, ns=(at, at))


@pytest.fixture(autouse=True)
def cache(tmp_path_factory, monkeypatch):
    home = tmp_path_factory.mktemp("home")
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    return home / "xcg"


@pytest.fixture
def scanned(monkeypatch):
    """Count how often the headers of each dump are read."""
    counts: Counter = Counter()
    original = lammps_engine._steps

    def counted(path, *, atoms):
        counts[os.path.basename(path)] += 1
        yield from original(path, atoms=atoms)

    monkeypatch.setattr(lammps_engine, "_steps", counted)
    return counts


@pytest.fixture
def series(tmp_path):
    particles, contacts = write_series(tmp_path, before="ITEM: TIME\n{time}\n")
    settle(tmp_path)
    return particles, contacts


def assert_opens_equal(one, other):
    assert one.chunks == other.chunks
    assert one.compute().identical(other.compute())


def test_headers_are_read_once(series, scanned, cache):
    first = open_scene(series[0], contacts=series[1])
    assert set(scanned.values()) == {1}
    again = open_scene(series[0], contacts=series[1])
    assert set(scanned.values()) == {1}
    assert_opens_equal(first, again)
    assert len(list(cache.iterdir())) == 2  # one for particles, one for contacts of the folder


def test_nothing_is_written_beside_the_data(series, tmp_path):
    before = sorted(tmp_path.iterdir())
    open_scene(series[0])
    assert sorted(tmp_path.iterdir()) == before


def test_only_changed_files_are_read_again(series, scanned, tmp_path):
    open_scene(series[0])
    write(tmp_path / "p.10.dump", dump_text(step=10, before="ITEM: TIME\n1.5\n"))  # another size
    at = os.stat(tmp_path / "p.20.dump").st_mtime_ns
    write(
        tmp_path / "p.20.dump", dump_text(step=20, before="ITEM: TIME\n4.0\n")
    )  # the same size, another time
    os.utime(tmp_path / "p.20.dump", ns=(at, at + 1))
    write(tmp_path / "p.30.dump", dump_text(step=30, before="ITEM: TIME\n5.0\n"))  # one more
    scanned.clear()
    np.testing.assert_array_equal(open_scene(series[0])["time"], [0, 1.5, 4, 5])
    assert scanned == {"p.10.dump": 1, "p.20.dump": 1, "p.30.dump": 1}


def test_files_that_may_still_change_are_not_indexed(series, scanned, tmp_path):
    write(tmp_path / "p.20.dump", dump_text(step=20, before="ITEM: TIME\n4.0\n"))
    open_scene(series[0])
    open_scene(series[0])
    assert scanned == {"p.0.dump": 1, "p.10.dump": 1, "p.20.dump": 2}


def test_files_that_are_gone_are_forgotten(series, tmp_path, cache):
    open_scene(series[0])
    (tmp_path / "p.10.dump").unlink()
    write(tmp_path / "p.30.dump", dump_text(step=30, before="ITEM: TIME\n5.0\n"))
    settle(tmp_path)
    open_scene(series[0])
    (index,) = cache.iterdir()
    assert b"p.30.dump" in index.read_bytes()
    assert b"p.10.dump" not in index.read_bytes()


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: b"\0" * len(data),
        lambda data: data.replace(b'"rows":3', b'"rows":4'),
        lambda data: b'{"p.0.dump": 1}',
    ],
)
def test_a_damaged_index_is_ignored(series, scanned, cache, damage):
    first = open_scene(series[0])
    (index,) = cache.iterdir()
    whole = index.read_bytes()
    index.write_bytes(damage(whole))
    assert index.read_bytes() != whole
    assert_opens_equal(first, open_scene(series[0]))
    assert set(scanned.values()) == {2}
    assert index.read_bytes() == whole  # and mended


def test_the_index_can_be_turned_off(series, scanned, cache, monkeypatch):
    monkeypatch.setenv("XCG_INDEX_CACHE", "0")
    open_scene(series[0])
    open_scene(series[0])
    assert set(scanned.values()) == {2}
    assert not cache.exists()


def test_a_cache_that_cannot_be_written_is_no_error(series, scanned, cache):
    cache.write_text("a file where the folder should be")
    open_scene(series[0])
    assert open_scene(series[0]).sizes["time"] == 3
    assert set(scanned.values()) == {2}


def test_particles_and_contacts_are_indexed_apart(tmp_path):
    path = write(tmp_path / "a", "x")
    settle(tmp_path)
    for kind, rows in (("one", 1), ("other", 2), ("one", 1)):
        ((ref,),) = remembered([str(path)], kind, lambda p, rows=rows: [StepRef(p, rows)])
        assert ref == StepRef(str(path), rows, size=1, modified=path.stat().st_mtime_ns)


def test_all_values_of_a_header_are_indexed(tmp_path):
    path = write(tmp_path / "a", "x")
    settle(tmp_path)
    ref = StepRef(
        str(path), 5, time=0.1 + 0.2, step=7, box=((0.0, 1e300), (-np.inf, np.inf), (0.0, 0.1)), periodic="",
        modified=path.stat().st_mtime_ns, alone=True, units="si",
        columns=("id", "Überlappung"), offset=3, length=4, size=1, gravity=(0.0, -0.0, 9.81), kind="wall",
    )  # fmt: skip
    for scan in (lambda p: [ref, ref], None):
        assert remembered([str(path)], "kind", scan) == [[ref, ref]]


@pytest.mark.parametrize(("engine", "folder", "pattern"), [
    (Lammps(), "lammps_chute", "particles.*.gz"), (Mfix(), "mfix_chute", "P_FB1_0*.vtp"),
])  # fmt: skip
def test_real_output_is_indexed(tmp_path, monkeypatch, engine, folder, pattern):
    for path in real_data(folder).glob(pattern):
        shutil.copy(path, tmp_path)
    settle(tmp_path)
    paths = sorted(map(str, tmp_path.iterdir()))
    first = engine.index_particles(paths, ReadOptions())
    for module, scan in ((lammps_engine, "_steps"), (vtk_steps, "_scan")):
        monkeypatch.setattr(module, scan, lambda *_, **__: pytest.fail("headers are read again"))
    assert engine.index_particles(paths, ReadOptions()) == first
