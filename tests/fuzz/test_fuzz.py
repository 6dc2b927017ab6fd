"""A short form of ``python -m tests.fuzz.run``: damaged files are opened, or refused in the package's own words."""

import json
import os
import random
import subprocess
import sys
from unittest import mock

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import xcg
from tests.fuzz.check import damaged, lay, outcome
from tests.fuzz.targets import ROOT, TARGETS
from xcg.readers.engine import BUILT_IN, load_engine

EXAMPLES = dict.fromkeys(TARGETS, 12) | {"vtp": 4, "ini": 3, "toml": 6}


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files_open_or_raise_scene_errors(tmp_path_factory, name):
    folder = tmp_path_factory.mktemp(name)
    seeds = TARGETS[name].seeds(folder)

    @given(st.integers(0, 2**32))
    @settings(max_examples=EXAMPLES[name], deadline=None, derandomize=True, database=None,
              suppress_health_check=list(HealthCheck))  # fmt: skip
    def tried(seed):
        lay(folder / "now", damaged(name, seeds, random.Random(seed)))
        result, detail = outcome(name, folder / "now")
        assert result != "failed", detail

    lay(folder / "now", seeds)
    assert outcome(name, folder / "now") == ("opened", "")
    tried()


def test_every_engine_has_a_target(tmp_path):
    """A new engine has a set of files in `tests/fuzz/targets.py`, which it reads."""
    loaded = set()

    def recorded(engine):
        reader = load_engine(engine)
        loaded.add(reader.name)
        return reader

    with mock.patch("xcg.readers.arguments.load_engine", recorded):
        for name, target in TARGETS.items():
            # jobs read files of other targets
            if name in ("ini", "toml"):
                continue
            (tmp_path / f"{name}_seeds").mkdir()
            lay(tmp_path / name, target.seeds(tmp_path / f"{name}_seeds"))
            assert outcome(name, tmp_path / name) == ("opened", "")
    assert loaded == set(BUILT_IN)


# --- found by fuzzing ------------------------------------------------------------------------------------


def refused(name, folder, **changes):
    """Use a set of files with some of them changed: they must be refused; returns the message."""
    seeds = dict(TARGETS[name].seeds(folder))
    for file, (old, new) in changes.items():
        path = next(n for n in seeds if n.replace(".", "_").endswith(file))
        assert old in seeds[path]
        seeds[path] = seeds[path].replace(old, new, 1)
    lay(folder / "now", seeds)
    result, detail = outcome(name, folder / "now")
    assert result == "refused", (result, detail)
    return detail


def test_a_grain_far_away_raises(tmp_path):
    assert "run.data" not in refused(
        "mercury", tmp_path, run_data=(b"1 0.5 0.5 1 0", b"1 0.5 1e30 1 0")
    )


def test_a_count_beyond_the_file_raises(tmp_path):
    assert "promises" in refused(
        "mercury", tmp_path, run_data=(b"3 0 0 0 0 2 2 2", b"1e300 0 0 0 0 2 2 2")
    )


def test_a_step_beyond_int64_raises(tmp_path):
    assert "expected a whole number" in refused(
        "lammps", tmp_path, p_dump=(b"TIMESTEP\n0", b"TIMESTEP\n" + b"9" * 30)
    )


def test_an_item_without_a_name_raises(tmp_path):
    assert refused("lammps_gz", tmp_path, p_7_dump_gz=(b"\x1f\x8b", b"ITEM:\n\x1f"))


def test_a_restart_file_without_a_number_raises(tmp_path):
    assert "expected a number after 'density'" in refused(
        "mercury", tmp_path, run_restart=(b"density 2.0", b"density x")
    )


def test_a_file_name_that_is_too_long_raises(tmp_path):
    assert "do not exist" in refused("mfix", tmp_path, P_pvd=(b"P_1.vtp", b"P" * 1000))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            b'NumberOfPoints="   3 "',
            b'NumberOfPoints="999999999999"',
            "promises 999999999999 points",
        ),
        (b'offset="  0 "', b'offset="99999999"', "was cut short"),
        (b'NumberOfComponents="3"', b'NumberOfComponents="4000000000"', "components"),
        (b'<?xml version="1.0"?>', b'<!DOCTYPE a [<!ENTITY b "cc">]>', "entities"),
        (b"<PolyData>", b"<PolyData><!--" + b"<!--" * 1000, "its XML is damaged"),
        (b'type="Float32"', b'type="Float8"', "has type 'Float8'"),
        (b"<PolyData>", b"< >", "its XML is damaged"),
    ],
)
def test_wrong_headers_of_vtk_raise(tmp_path, old, new, message):
    assert message in refused("mfix", tmp_path, P_1_vtp=(old, new))


def test_slices_wider_than_64_bits_raise(tmp_path):
    seeds = dict(TARGETS["toml"].seeds(tmp_path))
    seeds["job/job.toml"] = seeds["job/job.toml"].replace(
        b"width = 1.0", b"width = 18446744073709551615"
    )
    lay(tmp_path / "now", seeds)
    assert outcome("toml", tmp_path / "now") == ("opened", "")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b'name = "fields"', b'name = "../fields"', "without its folder"),
        (b'name = "fields"', b'name = "/tmp/fields"', "without its folder"),
        (b'name = "fields"', b'name = ""', "without its folder"),
        (b'name = "fields"', b"name = 1979-05-27", "expected str"),
        (b'axes = "z"', b"axes = 1", "axes=1: expected any of"),
        (b'axes = "z"', b'colour = "red"', "unknown option 'colour'"),
        (b"mapping = { 1 = 0, 2 = 1 }", b"mapping = { 1 = inf }", "expected whole numbers"),
        (b'particles = "p.*.dump"', b"particles = [[1]]", "expected a path"),
        (b"[scene]", b"scene = 1\n[other]", "expected tables"),
        (b"[scene]", b"\xff[scene]", "no text in UTF-8"),
        (b"[scene]", b"a = " + b"[" * 5000 + b"\n[scene]", "job.toml"),
        (b"spacing = 0.5", b"spacing = 1e-300", "spacing along 'z'"),
        (b"z = [0.0, 1.0]", b"z = [0.0, 1e300]", "nodes along 'z'"),
        (b"width = 1.0", b"width = 1e-300", "slices of 11 planes are more"),
    ],
)
def test_damaged_jobs_raise(tmp_path, old, new, message):
    assert message in refused("toml", tmp_path, job_toml=(old, new))


# --- hostile calls ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """Environment in which all indices are checked; loops that check them are kept apart from those that do not."""
    return os.environ | {
        "NUMBA_BOUNDSCHECK": "1",
        "NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("checked")),
    }


@pytest.mark.parametrize("bounds", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_calls_with_hostile_arguments_raise(bounds, request):
    """In a process of its own: results or errors of the package, nothing else."""
    count = 500 if bounds else 120
    command = [sys.executable, "-m", "tests.fuzz.calls", "--count", str(count)]
    environment = request.getfixturevalue("checked") if bounds else os.environ
    done = subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{done.stdout[-3000:]}\nlast call: {done.stderr[-500:]}"
    counts = json.loads(done.stdout.splitlines()[-1])
    assert counts["computed"] > 0.3 * count, counts
    assert counts["refused"] > 0.3 * count, counts


@pytest.mark.slow
def test_fields_under_bounds_checks(checked):
    command = [sys.executable, "-m", "pytest", "tests/fields/formulas/test_program.py", "-x", "-q"]
    done = subprocess.run(
        command, env=checked, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-3000:]


def test_bounds_checks_find_an_index_beyond_its_array(checked):
    """Also in the instructions that are written by hand."""
    code = """
import numpy as np, numba
from xcg.compiled._jit import leaf
from xcg.compiled.simd import add4, fill8

@leaf
def beyond(lists, row, at):
    fill8(lists, row, at, 1.0)

@leaf
def sums(records, n):
    add4(records, 0, n, 0, 1.0, (1.0, 1.0, 1.0, 1.0))

beyond(np.zeros((2, 16)), 1, 8)
sums(np.zeros((1, 5, 4)), 4)
for call in (lambda: beyond(np.zeros((2, 16)), 1, 9), lambda: beyond(np.zeros((2, 16)), 2, 0),
             lambda: sums(np.zeros((1, 5, 4)), 5)):
    try:
        call()
    except IndexError as error:
        print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=checked,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.count("out of bounds") == 3, done.stdout + done.stderr


def test_damaged_chunks_of_saved_scenes_raise(tmp_path):
    """Bytes of one chunk are changed, cut or repeated: a scene or an error of the package, nothing else."""
    pytest.importorskip("zarr", reason="saves to Zarr")
    xcg.datasets.random_scene(50, seed=1).cg.save(tmp_path / "scene.zarr")
    chunks = sorted(
        p for p in (tmp_path / "scene.zarr").glob("*/c*") if p.is_file() and p.stat().st_size > 16
    )
    rng = random.Random(1)
    raised = 0
    for _ in range(100):
        path = rng.choice(chunks)
        whole = path.read_bytes()
        data = bytearray(whole)
        at = rng.randrange(len(whole))
        if rng.random() < 0.5:
            data[at % 16] = rng.randrange(256)  # heads hold the sizes
        else:
            data[at:] = rng.choice(
                [b"", bytes(data[at : at + 8]) * 3, rng.randbytes(len(data) - at)]
            )
        path.write_bytes(data)
        try:
            xcg.open_scene(tmp_path / "scene.zarr").compute()
        except xcg.SceneError:
            raised += 1
        path.write_bytes(whole)
    assert raised > 15
