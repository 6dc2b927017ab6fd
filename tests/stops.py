"""Stop and kill jobs with several outputs at any moment and within their last step, repeat the command, and compare.

Run from the root of a clone, in the environment of the tests::

    python -m tests.stops [--stops 200] [--kills 200] [--vtkhdf steps]

A run is *inconsistent* if an output with its final name is incomplete, if the same command does not
complete all outputs, or if they differ from those of an undisturbed run. Stops are signals at random
moments of a run. Kills hit the step at the end that gives all outputs their names: first at each of
its changes of the disk, then at random moments. Processes are forks of this one, which has loaded all
libraries. The exit code is 1 if a run is inconsistent.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import dask
import h5py
import numpy as np

from tests import dumps
from xcg import cli
from xcg.jobs.config import read_config
from xcg.jobs.run import run_job
from xcg.writers import store

STEPS = 6
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
bounds = {{ x = [0.0, 9.5], y = [0.0, 9.5], z = [-1.0, 8.5] }}
[slices]
axis = "z"
bounds = [0.0, 9.0]
[output]
folder = "out"
vtkhdf = "{vtkhdf}"
"""
IMAGES = ("temporal", "steps")
_CHANGES = ("os.rename", "os.link", "os.remove", "os.rmdir", "os.mkdir")


def write_job(folder: Path, vtkhdf: str) -> Path:
    """Write a small series, and a job with several outputs: NetCDF, VTKHDF and slices."""
    rng = np.random.default_rng(0)
    for step in range(STEPS):
        rows = [
            f"{i + 1} 1 {x:.6f} {y:.6f} {z:.6f} {step} 0 0 0.5 1"
            for i, (x, y, z) in enumerate(rng.uniform(0, 9, (100, 3)))
        ]
        dumps.write(folder / f"p.{step}.dump", dumps.dump_text(rows, step=step))
    job = folder / "job.toml"
    job.write_text(JOB.format(vtkhdf=vtkhdf))
    return job


def outputs(job: Path) -> dict[str, dict[str, bytes]]:
    """Return the arrays of all outputs that have their names, by file; a file that cannot be read raises."""
    found = {}
    for path in sorted((job.parent / "out").glob("[!.]*")):
        arrays: dict[str, bytes] = {}
        with h5py.File(path) as file:
            file.visititems(
                lambda name, a, arrays=arrays: (
                    arrays.update({name: np.asarray(a).tobytes()})
                    if isinstance(a, h5py.Dataset)
                    else None
                )
            )
        found[path.name] = arrays
    return found


def hidden(job: Path) -> list[str]:
    """List what is left beside the outputs."""
    return sorted(path.name for path in (job.parent / "out").glob(".*"))


def fork(job: Path, *words: str, before: Callable[[], object] = lambda: None) -> int:
    """Run the command in a fork of this process, with no output, and return its id."""
    child = os.fork()
    if child:
        return child
    code = 99
    try:
        silent = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silent, stream)
        before()
        sys.argv = ["xcg", "run", str(job), "-q", *words]
        cli.main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0
    finally:
        os._exit(code)


def ended(child: int) -> int:
    """Wait for a process and return its exit code, or minus its signal."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def kill_at(change: int, folder: Path) -> Callable[[], None]:
    """Return a function that makes its process kill itself before a change of the disk in the last step."""

    def install() -> None:
        count = 0
        is_ending = False

        def hook(event: str, arguments: tuple) -> None:
            nonlocal count, is_ending
            is_marker = event == "open" and str(arguments[0]).endswith("begun/whole")
            is_ending = is_ending or (is_marker and arguments[2] & os.O_CREAT)
            is_write = event in _CHANGES or (is_marker and arguments[2] & os.O_CREAT)
            if is_ending and is_write:
                count += 1
                if count == change:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)

    return install


def slowed(pipe: int) -> Callable[[], None]:
    """Return a function that makes the last step of its process announce itself and take tens of milliseconds."""

    def install() -> None:
        end = store.Begun.end

        def announced(begun: store.Begun) -> None:
            os.write(pipe, b"!")
            sys.addaudithook(
                lambda event, _: time.sleep(0.003) if event in (*_CHANGES, "open") else None
            )
            end(begun)

        store.Begun.end = announced  # type: ignore[method-assign]

    return install


class Trials:
    """Runs of a job that are disturbed, repeated, and compared with an undisturbed run."""

    def __init__(self, folder: Path, vtkhdf: str) -> None:
        self.job = write_job(folder, vtkhdf)
        self.faults: list[str] = []
        with dask.config.set(scheduler="sync"):  # threads of this process would not be in its forks
            for _ in run_job(read_config(self.job), jobs=1):
                pass
        self.whole = outputs(self.job)
        self.clear()
        # all steps computed, and no output with its name
        child = fork(self.job, before=kill_at(1, folder))
        ended(child)
        shutil.copytree(self.job.parent / "out", folder / "computed")

    def clear(self) -> None:
        shutil.rmtree(self.job.parent / "out", ignore_errors=True)

    def prepare(self) -> None:
        """Bring the job to the state before its last step."""
        self.clear()
        shutil.copytree(self.job.parent / "computed", self.job.parent / "out")

    def check(self, what: str) -> None:
        """Compare the outputs that have their names, repeat the command, and compare all of them."""
        try:
            named = outputs(self.job)
            wrong = [name for name, arrays in named.items() if arrays != self.whole[name]]
            # a run that has ended refuses to begin anew
            is_done = named.keys() == self.whole.keys() and not hidden(self.job)
            code = 0 if is_done else ended(fork(self.job))
            is_same = outputs(self.job) == self.whole
        except (OSError, KeyError) as error:
            self.faults.append(f"{what}: {error}")
            return
        if wrong or code or not is_same or hidden(self.job):
            self.faults.append(
                f"{what}: wrong at first {wrong}; the same command ended with {code}, "
                f"all outputs the same: {is_same}, left over: {hidden(self.job)}"
            )

    def kill_at_each_change(self) -> int:
        """Kill the last step before each of its changes of the disk; return their number."""
        change = 0
        while True:
            change += 1
            self.prepare()
            code = ended(fork(self.job, before=kill_at(change, self.job.parent)))
            if code == 0:
                return change - 1
            if code != -signal.SIGKILL:
                self.faults.append(f"change {change}: the command ended with {code}")
            self.check(f"kill at change {change}")

    def kill_within(self, kills: int, rng: random.Random) -> int:
        """Kill the last step at random moments; return how many kills came before its end."""
        within = 0
        for k in range(kills):
            self.prepare()
            end, pipe = os.pipe()
            child = fork(self.job, before=slowed(pipe))
            os.close(pipe)
            os.read(end, 1)
            os.close(end)
            time.sleep(rng.uniform(0, 0.1))
            os.kill(child, signal.SIGKILL)
            within += ended(child) == -signal.SIGKILL
            self.check(f"kill {k}")
        return within

    def stop(self, stops: int, rng: random.Random) -> dict[int, int]:
        """Send signals at random moments of a run; return the number of runs by exit code."""
        codes: dict[int, int] = {}
        self.clear()
        begin = time.monotonic()
        ended(fork(self.job))
        lasts = time.monotonic() - begin
        for k in range(stops):
            self.clear()
            child = fork(self.job)
            time.sleep(rng.uniform(0, 1.1 * lasts))
            os.kill(child, signal.SIGINT if k % 4 else signal.SIGTERM)
            code = ended(child)
            codes[code] = codes.get(code, 0) + 1
            self.check(f"stop {k}")
        return codes


def main() -> int:
    """Run all trials; return 1 if a run is inconsistent."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--stops", type=int, default=200, help="signals at random moments")
    parser.add_argument("--kills", type=int, default=200, help="kills within the last step")
    parser.add_argument("--vtkhdf", choices=IMAGES, help="kind of image files (both by default)")
    arguments = parser.parse_args()
    faults: list[str] = []
    rng = random.Random(0)
    for vtkhdf in [arguments.vtkhdf] if arguments.vtkhdf else IMAGES:
        with tempfile.TemporaryDirectory() as folder:
            trials = Trials(Path(folder), vtkhdf)
            changes = trials.kill_at_each_change()
            within = trials.kill_within(arguments.kills // 2, rng)
            codes = trials.stop(arguments.stops // 2, rng)
        faults += [f"{vtkhdf}: {fault}" for fault in trials.faults]
        print(
            f"vtkhdf = {vtkhdf!r}: killed at each of {changes} changes of the last step; "
            f"{arguments.kills // 2} kills at random moments, {within} of them before its end; "
            f"{arguments.stops // 2} stops, exit codes {codes}; {len(trials.faults)} inconsistent",
            flush=True,
        )
    print("\n".join(faults) or "no inconsistent run")
    return int(bool(faults))


if __name__ == "__main__":
    raise SystemExit(main())
