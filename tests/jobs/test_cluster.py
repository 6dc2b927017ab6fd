"""Jobs on a running cluster: same bits, resume, a killed worker; clear errors for wrong addresses and workers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from tests import ROOT, dumps
from tests.jobs.test_run import INTERRUPTED, JOB, SLICED, STEPS, start, steps_there, write_job
from tests.stops import outputs
from tests.test_cli import xcg_run
from xcg.jobs import cluster
from xcg.jobs.config import read_config

pytest.importorskip("distributed")


def dask_command(*words: str) -> subprocess.Popen:
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "distributed.cli." + words[0], *words[1:]]
    return subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def running(tmp_path):
    """Address of a scheduler, and its two workers; each is a process of its own, in another folder."""
    file = tmp_path / "scheduler.json"
    here = ("--scheduler-file", str(file))
    loopback = ("--host", "127.0.0.1")
    scheduler = dask_command("dask_scheduler", *here, *loopback, "--port", "0", "--no-dashboard")
    workers = [
        dask_command("dask_worker", *here, *loopback, "--nthreads", "1", "--no-nanny")
        for _ in range(2)
    ]
    from distributed import Client

    while not file.exists():
        time.sleep(0.1)
    with Client(scheduler_file=str(file)) as client:
        client.wait_for_workers(2, timeout=120)
        address = client.scheduler.address
    yield address, workers
    for process in (*workers, scheduler):
        process.kill()
        process.wait()


@pytest.mark.slow  # test_distributed has the same bits on a cluster, and kills take a minute
def test_a_cluster_gives_the_same_bits_though_a_worker_is_killed(tmp_path, running):
    address, workers = running
    job = write_job(tmp_path)
    text = JOB.replace("[output]", SLICED)
    job.write_text(text)
    xcg_run("run", job, "-q")
    whole = outputs(job)
    (tmp_path / "out").rename(tmp_path / "reference")

    # begun on this machine, continued on the cluster, though the path is another spelling of it
    process = start(job, "--jobs", "2", before=INTERRUPTED.format(stop=4, steps=STEPS))
    process.communicate()
    before = steps_there(job)
    assert before >= 4
    process = start(Path("job.toml"), "--scheduler", address, cwd=tmp_path)
    while steps_there(job) < before + 3 and process.poll() is None:
        time.sleep(0.002)
    workers[0].send_signal(signal.SIGKILL)
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert f"of {STEPS} steps are there from an earlier run" in said
    assert "2 workers with 2 threads" in said
    assert f"{STEPS} of {STEPS} steps" in said
    assert outputs(job) == whole


def test_skipped_steps_on_a_cluster_keep_their_causes(tmp_path, cluster):
    job = write_job(tmp_path)
    (tmp_path / "p.7.dump").write_text(dumps.dump_text(step=7).replace("1.9", "oops"))
    job.write_text(f'on_error = "skip"\nscheduler = "{cluster.scheduler_address}"\n{JOB}')
    assert "warning: step 7 is skipped:" in xcg_run("run", job)
    f = xr.load_dataset(tmp_path / "out" / "fields.nc")
    assert np.atleast_1d(f.attrs["skipped_steps"]).tolist() == [7]
    assert "p.7.dump" in f.attrs["skipped_because"]


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense", "foo://x:1"])
def test_a_wrong_address_is_one_error(tmp_path, address, monkeypatch):
    monkeypatch.setattr(cluster, "_ANSWERS_WITHIN", 1.0)
    job = write_job(tmp_path, 1, 10)
    said = " ".join(xcg_run("run", job, "--scheduler", address, code=1).split())
    assert f"no dask scheduler answers at {address}" in said
    assert "start one with 'dask scheduler'" in said
    assert said.count("Error") == 1
    assert not (tmp_path / "out").exists()


def test_options_of_this_machine_do_not_hold_for_a_cluster(tmp_path):
    job = write_job(tmp_path, 1, 10)
    said = xcg_run("run", job, "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2", code=2)
    assert "--jobs is for this machine" in said
    job.write_text(f"scheduler = 8786\n{JOB}")
    assert "scheduler = 8786: expected an address" in xcg_run("run", job, code=1)


class Workers:
    """Client of one worker, which answers as it is told."""

    def __init__(self, answer):
        self.answer = answer

    def run(self, function, *arguments, on_error):
        answer = self.answer(function(*arguments))
        return {"tcp://10.0.0.2:4000": answer}


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda _: ModuleNotFoundError("No module named 'xcg'"), "cannot run xcg .*environment"),
        (lambda own: ("0.0.1", own[1]), r"has xcg 0\.0\.1, and this command"),
        (lambda own: (own[0], ["/data/p.1.dump"]), "does not see the files in /data"),
    ],
)
def test_workers_that_cannot_do_the_job_are_named(answer, message):
    with pytest.raises(OSError, match=f"10.0.0.2:4000 {message}"):
        cluster._check_workers(Workers(answer), [])


def test_workers_are_asked_for_the_first_file_of_a_pattern(tmp_path):
    job = read_config(write_job(tmp_path, 2, 10))
    (first,) = cluster._first_files(job)
    assert Path(first).parent == tmp_path
    cluster._check_workers(Workers(lambda own: own), [first])
    with pytest.raises(OSError, match="does not see the files"):
        cluster._check_workers(Workers(lambda own: own), [str(tmp_path / "gone" / "p.dump")])
