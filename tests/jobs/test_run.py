"""Runs that are killed, stopped, doubled, or run out of disk; how far they are. All twenty kills with XCG_FULL=1."""

import errno
import itertools
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ROOT, dumps
from tests.scenes import random_steps
from tests.test_cli import xcg_run
from xcg.jobs.config import read_config
from xcg.jobs.run import run_job
from xcg.steps.faults import SkippedStep
from xcg.writers.files import locked, whole_file

FULL = bool(os.environ.get("XCG_FULL"))
KILLS = 20 if FULL else 3
STEPS = 20
slow = pytest.mark.skipif(not FULL, reason="takes long: set XCG_FULL=1")
JOB = """
[scene]
particles = "p.*.dump"
engine = "lammps"
timestep = 0.1
chunks = 1
[fields]
fields = ["density", "velocity"]
width = 1.0
spacing = 0.75
bounds = { x = [0.0, 9.5], y = [0.0, 9.5], z = [-1.0, 8.5] }
[output]
folder = "out"
vtkhdf = "temporal"
"""
SLICED = """
[slices]
axis = "z"
bounds = [0.0, 9.0]
[output]
"""


def write_job(folder: Path, steps: int = STEPS, grains: int = 100) -> Path:
    rng = np.random.default_rng(0)
    for k in range(steps):
        rows = [f"{i + 1} 1 {x:.6f} {y:.6f} {z:.6f} {k} 0 0 0.5 1" for i, (x, y, z) in
                enumerate(rng.uniform(0, 9, (grains, 3)))]  # fmt: skip
        dumps.write(folder / f"p.{k}.dump", dumps.dump_text(rows, step=k))
    (folder / "job.toml").write_text(JOB)
    return folder / "job.toml"


@pytest.fixture
def job(tmp_path):
    return write_job(tmp_path)


def start(job: Path, *words: str, before="", **options) -> subprocess.Popen:
    code = f"{before}\nimport sys; from xcg.cli import main; main()"
    command = [sys.executable, "-c", code, "run", str(job), *words]
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env, **options
    )


def steps_there(job: Path) -> int:
    log = job.parent / "out" / ".fields.begun" / "done_0.jsonl"
    return log.read_text().count("}}") if log.exists() else 0


def wait_for(job: Path, steps: int, process: subprocess.Popen) -> None:
    while steps_there(job) < steps and process.poll() is None:
        time.sleep(0.002)


def loaded(path: Path) -> xr.Dataset:
    ds = xr.load_dataset(path)
    ds.attrs["history"] = re.sub(r"\d{4}-\S+Z", "when", ds.attrs["history"])
    return ds


# --- killed ----------------------------------------------------------------------------------------------


def test_killed_runs_go_on_and_give_the_same_file(job, tmp_path):
    xcg_run("run", job, "-q")
    whole = loaded(tmp_path / "out" / "fields.nc")
    shutil.move(tmp_path / "out", tmp_path / "reference")
    rng = random.Random(4)
    stops = sorted(rng.randrange(STEPS + 1) for _ in range(KILLS))
    for stop in stops:
        process = start(job, "--resume", "--jobs", "2")
        wait_for(job, stop, process)
        time.sleep(rng.uniform(0, 0.1))
        process.kill()
        process.communicate()
        for name in ("fields.nc", "fields.vtkhdf"):  # there only when whole
            path = tmp_path / "out" / name
            assert not path.exists() or path.stat().st_size > 10_000
    before = steps_there(job)
    said = xcg_run("run", job, "--resume")
    if (tmp_path / "out" / "fields.nc").exists() and before:
        assert f"{before} of {STEPS} steps are there" in said
    xr.testing.assert_identical(loaded(tmp_path / "out" / "fields.nc"), whole)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["fields.nc", "fields.vtkhdf"]


@pytest.mark.parametrize("images", ["temporal", "steps"])
def test_runs_that_ended_between_the_names_of_two_files_go_on(tmp_path, monkeypatch, images):
    job = write_job(tmp_path)
    job.write_text(JOB.replace("temporal", images))
    xcg_run("run", job, "-q")
    whole = loaded(tmp_path / "out" / "fields.nc")
    names = sorted(p.name for p in (tmp_path / "out").iterdir())
    shutil.rmtree(tmp_path / "out")
    real = os.replace
    calls = itertools.count()

    def replace(part, path):
        if Path(path).parent == tmp_path / "out" and next(calls) == 1:
            raise KeyboardInterrupt
        return real(part, path)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(KeyboardInterrupt):
        list(run_job(read_config(job)))
    monkeypatch.undo()
    assert len(list((tmp_path / "out").glob("fields*"))) == 1
    xcg_run("run", job, "--resume", "-q")
    (
        tmp_path / "out" / "..fields.begun.0123abcd.part"
    ).mkdir()  # of a run that was killed when all was there
    (tmp_path / "out" / ".fields.begun.lock").touch()
    xcg_run("run", job, "--resume", "-q")
    xr.testing.assert_identical(loaded(tmp_path / "out" / "fields.nc"), whole)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == names


@pytest.mark.parametrize("images", ["temporal", "steps"])
def test_images_of_a_run_that_is_overwritten_go(job, tmp_path, images):
    job.write_text(JOB.replace("temporal", images))
    xcg_run("run", job, "-q")
    kept = tmp_path / "out" / "fields_9999.vtkhdf"
    kept.write_text("not of a run")
    job.write_text(JOB.replace('vtkhdf = "temporal"', "").replace("width = 1.0", "width = 1.2"))
    xcg_run("run", job, "-q", "--overwrite")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["fields.nc", kept.name]


def test_a_run_either_goes_on_or_starts_anew(job, tmp_path):
    xcg_run("run", job, "-q")
    assert "pass one of them" in xcg_run("run", job, "--resume", "--overwrite", code=2)
    job.write_text(JOB.replace("p.*.dump", "q.*.dump"))
    said = xcg_run("run", job, "--overwrite", code=1)
    assert "q.*.dump" in said
    assert "kept" not in said


def test_finished_steps_are_not_computed_again(job, reads):
    steps = run_job(read_config(job), jobs=5)
    for _ in range(3):
        done, _ = next(steps)
    steps.close()
    assert steps_there(job) == done == 10
    steps = run_job(read_config(job), jobs=5, resume=True)
    reads.clear()
    assert next(steps) == (10, STEPS)
    next(steps)
    assert steps_there(job) == 15
    # opening reads both ends, and the second step to compare its motion with the times
    assert len({step for _, step in reads} - {0, 1, STEPS - 1}) <= 5
    steps.close()


def test_chunks_are_computed_once(job, reads):
    job.write_text(JOB.replace("chunks = 1", "chunks = 6").replace("[output]", SLICED))
    done = list(run_job(read_config(job), jobs=2))
    assert done == [(0, 20), (12, 20), (20, 20)]
    # opening reads both ends; fields and slices share what is read
    of_ends = 1
    assert {step for _, step in reads} == set(range(STEPS))
    for (_, step), count in reads.items():
        assert count <= 1 + (of_ends if step in (0, STEPS - 1) else 0)


def test_resume_never_starts_over(job):
    steps = run_job(read_config(job), jobs=5)
    next(steps)
    next(steps)
    steps.close()
    dumps.write(job.parent / "p.99.dump", dumps.dump_text(step=99))
    said = " ".join(xcg_run("run", job, "--resume", code=1).split())
    assert "start over without --resume" in said
    assert "[scene] sizes and times of files: 21" in said
    assert "[fields]" not in said
    (job.parent / "p.99.dump").unlink()
    assert "5 of 20 steps are there" in xcg_run("run", job, "--resume")
    assert "20 of 20 steps are there" in xcg_run("run", job, "--resume")
    job.write_text(JOB.replace("spacing = 0.75", "spacing = 1.0"))
    assert "exists, of another job or other input; choose another" in xcg_run(
        "run", job, "--resume", code=1
    )


def test_resume_names_the_option_that_changed(job):
    steps = run_job(read_config(job), jobs=1)
    next(steps)
    next(steps)
    steps.close()
    job.write_text(JOB.replace("spacing = 0.75", "spacing = 1.0"))
    said = " ".join(xcg_run("run", job, "--resume", code=1).split())
    assert "([fields] spacing: 1.0 instead of 0.75)" in said


def test_resume_notices_changed_files(tmp_path):
    scene = random_steps(3).chunk(time=1).cg.save(tmp_path / "scene.zarr")
    job = tmp_path / "job.toml"
    job.write_text(
        '[scene]\nparticles = "scene.zarr"\nchunks = 1\n[fields]\nfields = "density"\naxes = "z"\n'
    )
    steps = run_job(read_config(job), jobs=1)
    next(steps)
    next(steps)
    steps.close()
    chunk = next((scene / "position").glob("c*"))
    before = scene.stat().st_mtime_ns
    os.utime(
        chunk, ns=(chunk.stat().st_atime_ns, chunk.stat().st_mtime_ns + 10**9)
    )  # as where it is written anew
    assert scene.stat().st_mtime_ns == before
    assert "sizes and times of files: " in " ".join(xcg_run("run", job, "--resume", code=1).split())


# --- stopped ---------------------------------------------------------------------------------------------


INTERRUPTED = """
import os, signal
from xcg.writers import store
add, end = store.Log.add, store.Begun.end
def add_and_interrupt(log, steps, skipped):
    add(log, steps, skipped)
    if len(log.steps()) == {stop}:
        os.kill(os.getpid(), signal.SIGINT)
def end_and_interrupt(begun):
    end(begun)
    os.kill(os.getpid(), signal.SIGINT)
store.Log.add = add_and_interrupt
if {stop} > {steps}:
    store.Begun.end = end_and_interrupt
"""


def test_ctrl_c_stops_a_run_and_keeps_finished_steps(job):
    stop = 12
    process = start(job, "--jobs", "2", before=INTERRUPTED.format(stop=stop, steps=STEPS))
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "kept; the same command continues from there" in said
    assert [p.name for p in (job.parent / "out").iterdir()] == [".fields.begun"]
    assert not list((job.parent / "out").rglob("*.part"))
    assert steps_there(job) >= stop


def test_ctrl_c_waits_until_all_outputs_have_their_names(job):
    job.write_text(JOB.replace("[output]", SLICED))
    process = start(job, before=INTERRUPTED.format(stop=STEPS + 1, steps=STEPS))
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert f"stopped\n{STEPS} steps in" in said
    names = ["fields.nc", "fields.vtkhdf", "fields_slices.nc"]
    assert sorted(p.name for p in (job.parent / "out").iterdir()) == names


# with signals and kills at random moments too: python -m tests.stops
@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks processes")
# images of steps are files of their own, a temporal one is written by the same changes but one
@pytest.mark.parametrize("images", ["steps", pytest.param("temporal", marks=pytest.mark.slow)])
def test_runs_killed_at_any_change_of_their_last_step_are_completed(images):
    command = [
        sys.executable,
        "-m",
        "tests.stops",
        "--stops",
        "0",
        "--kills",
        "0",
        "--vtkhdf",
        images,
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "no inconsistent run" in done.stdout


def test_ctrl_c_while_libraries_load_exits_quietly(tmp_path):
    (tmp_path / "numba.py").write_text(
        "import os, signal, time; os.kill(os.getpid(), signal.SIGINT); time.sleep(60)"
    )
    module, function = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"][
        "xcg"
    ].split(":")
    done = subprocess.run(
        [sys.executable, "-c", f"from {module} import {function}; {function}()", "info", __file__], capture_output=True,
        text=True, env=os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}, timeout=120, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "\nstopped\n")


# --- doubled ---------------------------------------------------------------------------------------------


def test_a_second_run_of_one_job_raises(job):
    first = run_job(read_config(job), jobs=5)
    next(first)
    said = " ".join(xcg_run("run", job, code=1).split())
    assert f"being written by another run (process {os.getpid()})" in said
    other = JOB.replace('folder = "out"', 'folder = "out"\nname = "other"')
    (job.parent / "other.toml").write_text(other)
    xcg_run("run", job.parent / "other.toml", "-q")
    for _ in first:
        pass
    assert not list((job.parent / "out").glob(".*"))


def test_a_lock_ends_with_its_process(tmp_path):
    code = f"""
import time; from pathlib import Path; from xcg.writers.files import locked
with locked(Path({str(tmp_path / "lock")!r}), "it"):
    print("held", flush=True); time.sleep(60)
"""
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=env
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    with (
        pytest.raises(FileExistsError, match=rf"another run \(process {process.pid}\)"),
        locked(tmp_path / "lock", "it"),
    ):
        pass
    process.kill()
    process.communicate()
    assert (tmp_path / "lock").exists()
    with locked(tmp_path / "lock", "it"):
        pass
    assert not (tmp_path / "lock").exists()


def test_a_lock_follows_no_link(job, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "precious").write_text("data")
    link = tmp_path / "out" / ".fields.begun.lock"
    link.symlink_to(tmp_path / "precious")
    assert "symbolic link" in " ".join(xcg_run("run", job, code=1).split())
    assert (tmp_path / "precious").read_text() == "data"
    assert link.is_symlink()


def test_runs_work_on_a_file_system_without_locks(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", refuse)
    with locked(tmp_path / "lock", "it"):
        assert (tmp_path / "lock").exists()


# --- out of disk -----------------------------------------------------------------------------------------


# the first step fails, or a later one, after which the run resumes in the same way
@pytest.mark.parametrize("limit", [20_000, pytest.param(600_000, marks=pytest.mark.slow)])
def test_a_full_disk_is_reported_and_the_run_resumes(job, limit):
    # Python would keep bytecode that is cut off at the limit, and no process could import it
    before = (
        "import resource, sys; sys.dont_write_bytecode = True; "
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))"
    )
    process = start(job, before=before)
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 1, said
    assert "Traceback" not in said
    assert "make room and run again" in said
    assert "kept; the same command continues from there" in " ".join(said.split())
    out = job.parent / "out"
    assert [p.name for p in out.iterdir()] == [".fields.begun"]
    assert not list(out.rglob("*.part"))
    assert steps_there(job) in ([0] if limit < 100_000 else range(1, STEPS))
    said = xcg_run("run", job, "--resume")
    assert xr.load_dataset(out / "fields.nc").density.notnull().all()


def test_writers_at_a_size_limit_leave_no_files(tmp_path):
    f = xcg.datasets.simple_cubic(8).cg.coarse_grain(["density", "velocity"], spacing=0.3)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with (
            pytest.raises(OSError, match="nothing was left behind"),
            whole_file(tmp_path / "a", overwrite=False) as part,
        ):
            part.write_bytes(b"0" * 20_000)
        with pytest.raises(
            OSError, match=r"f\.vtkhdf: a file may not be larger here.*nothing was left behind"
        ):
            f.cg.save(tmp_path / "f.vtkhdf")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def test_the_second_of_two_writers_raises(tmp_path):
    path = tmp_path / "f"

    def two():
        with whole_file(path, overwrite=False) as slow:
            slow.write_text("slow")
            with whole_file(path, overwrite=False) as fast:
                fast.write_text("fast")

    with pytest.raises(FileExistsError, match="f exists"):
        two()
    assert path.read_text() == "fast"
    assert [p.name for p in tmp_path.iterdir()] == ["f"]


# --- steps at fault --------------------------------------------------------------------------------------


def test_steps_at_fault_are_left_out_and_listed(job):
    text = (job.parent / "p.7.dump").read_text()
    (job.parent / "p.7.dump").write_text(text[: len(text) // 2])
    (job.parent / "p.9.dump").write_text("")
    assert "p.9.dump" in xcg_run("run", job, code=1)
    said = xcg_run("run", job, "--on-error", "skip")
    assert "warning: left out:" in said
    assert "warning: step 7 is skipped:" in said
    f = xr.load_dataset(job.parent / "out" / "fields.nc")
    assert f.sizes["time"] == STEPS - 1
    assert f.step.values[f.skipped.values].tolist() == [7]
    assert f.attrs["skipped_steps"] == 7
    assert "p.7.dump (step 7): " in f.attrs["skipped_because"]
    assert "p.9.dump: the file is empty" in f.attrs["skipped_files"]
    assert f.density.isel(time=f.skipped.values).isnull().all()
    assert f.density.isel(time=~f.skipped.values).notnull().all()


def test_on_error_is_read_from_the_job(job):
    (job.parent / "p.7.dump").write_text(dumps.dump_text(step=7).replace("1.9", "oops"))
    job.write_text('on_error = "skip"\n' + JOB.replace("[output]", SLICED))
    with pytest.warns(SkippedStep):
        for _ in run_job(read_config(job)):
            pass
    for name in ("fields", "fields_slices"):
        assert xr.load_dataset(job.parent / "out" / f"{name}.nc").skipped.values.sum() == 1
    job.write_text('on_error = "ignore"\n' + JOB)
    assert "on_error='ignore': expected" in xcg_run("run", job, code=1)


# --- dashboard -------------------------------------------------------------------------------------------


def test_the_dashboard_without_distributed_raises(job, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert "pip install 'xcg[dashboard]'" in xcg_run("run", job, "--dashboard", code=1)


@slow
def test_the_dashboard_is_served_during_a_run(tmp_path):
    pytest.importorskip("distributed")
    pytest.importorskip("bokeh")
    job = write_job(tmp_path, 3, 10)
    process = start(job, "--dashboard", "--jobs", "2")
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert "dashboard: http" in said
    assert (tmp_path / "out" / "fields.nc").exists()


# --- a worker is killed ----------------------------------------------------------------------------------


@slow
def test_a_run_survives_a_killed_worker(tmp_path):
    pytest.importorskip("distributed")
    write_job(tmp_path, 12, 20)
    code = f"""
import os, signal, threading, time, warnings
import xcg
from distributed import Client
if __name__ == "__main__":
    with Client(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0") as client:
        ds = xcg.open_scene({str(tmp_path / "p.*.dump")!r})
        f = ds.cg.coarse_grain("density", axes="z", on_error="skip")
        future = client.compute(f)
        time.sleep(0.3)
        os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)
        got = future.result(60)
        print("skipped", int(got.skipped.sum()), "same", bool(got.density.equals(f.density.compute(scheduler="sync"))))
"""
    (tmp_path / "killed.py").write_text(code)
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, str(tmp_path / "killed.py")],
        capture_output=True,
        text=True,
        env=env,
        timeout=120,
        check=False,
    )
    assert "skipped 0 same True" in done.stdout, done.stdout + done.stderr[-2000:]


def test_fields_without_a_file_raise(job):
    plain = job.read_text().replace('vtkhdf = "temporal"', "netcdf = false")
    job.write_text(plain)
    for options in ([], ["--dry-run"]):
        assert "no file for fields (netcdf or vtkhdf" in xcg_run("run", job, *options, code=1)
    job.write_text(plain + '[slices]\naxis = "z"\nwidth = 3.0\n')
    xcg_run("run", job, "-q")
    assert [path.name for path in (job.parent / "out").iterdir()] == ["fields_slices.nc"]


def test_walls_of_a_job_may_be_columns(tmp_path):
    data = ROOT / "examples" / "data" / "lammps_silo"
    walls = {"side": "f_side[*]", "floor": "f_floor[*]"}
    table = ", ".join(f'{name} = "{columns}"' for name, columns in walls.items())
    job = tmp_path / "job.toml"
    job.write_text(
        f'[scene]\nparticles = "{data}/particles.dump.gz"\nwalls = {{ {table} }}\n[fields]\n'
        'fields = ["boundary_force_density"]\naxes = "z"\nextent = { x = 1.0, y = 1.0 }\n'
    )
    xcg_run("run", job, "-q")
    ds = xcg.open_scene(data / "particles.dump.gz", walls=walls)
    expected = ds.cg.coarse_grain(
        "boundary_force_density", axes="z", extent={"x": 1.0, "y": 1.0}
    ).compute()
    with xr.open_dataset(tmp_path / "xcg-output" / "fields.nc") as found:
        np.testing.assert_array_equal(found.boundary_force_density, expected.boundary_force_density)
