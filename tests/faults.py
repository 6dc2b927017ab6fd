"""Kill processes that save, resume and record, at any moment, and compare what they leave with undisturbed runs.

Run from the root of a clone, in the environment of the tests::

    python -m tests.faults [--kills 100]

Kills are divided among NetCDF, Zarr and VTKHDF that are saved and resumed, and NetCDF and Zarr that are recorded. Two
more rounds let the disk run full, and start two writers of one file. The exit code is 1 if a file is wrong.
"""

from __future__ import annotations

import argparse
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import xarray as xr

import xcg
from tests import ROOT
from tests.scenes import random_steps

STEPS, NODES = 12, 30
SAVED = (".nc", ".zarr", ".vtkhdf")
RECORDED = (".nc", ".zarr")


def fields() -> xr.Dataset:
    """Return fields of several chunks of time that take a second or two to save."""
    ds = random_steps(STEPS).chunk(time=1)
    names = ["density", "velocity", "stress", "volume_fraction"]
    return ds.cg.coarse_grain(names, width=1.0, spacing=5.0 / NODES)


def save(path: Path) -> None:
    """Save, or go on."""
    print("ready", flush=True)
    xcg.save(fields(), path, resume=True, compression=1)


def record(path: Path) -> None:
    """Record all steps that are not there yet."""
    ready = fields().compute(scheduler="synchronous")
    print("ready", flush=True)
    with xcg.record(path) as live:
        for step in range(live.steps, STEPS):
            live.append(ready.isel(time=[step]))
            time.sleep(0.02)


def start(job: str, path: Path, most: int | None = None) -> subprocess.Popen:
    """Start a process that saves or records, with files of at most so many bytes."""

    def limit() -> None:
        if most is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    # -B: bytecode that is cut off at the limit would be kept
    call = [sys.executable, "-B", "-m", "tests.faults", "--job", job, str(path)]
    return subprocess.Popen(
        call, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=limit
    )


def opened(path: Path) -> xr.Dataset:
    """Return all fields of a file."""
    if path.suffix == ".vtkhdf":
        import h5py

        with h5py.File(path) as file:
            found = {}
            file.visititems(
                lambda name, a: found.update({name: a[()]}) if isinstance(a, h5py.Dataset) else None
            )
        return xr.Dataset(
            {name.replace("/", "."): ((), values.tobytes()) for name, values in found.items()}
        )
    with xr.open_zarr(path, chunks=None) if path.suffix == ".zarr" else xr.open_dataset(path) as ds:
        return ds.load()


def killed(
    job: str, path: Path, whole: xr.Dataset, kills: int, rng: random.Random
) -> tuple[int, list[str]]:
    """Kill a job so many times, let it end, and compare; return how many kills were at work, and faults."""
    faults = []
    midst = 0
    for _ in range(kills):
        process = start(job, path)
        process.stdout.readline()
        time.sleep(rng.uniform(0.0, 1.2 if job == "save" else 0.4))
        midst += process.poll() is None
        process.kill()
        process.communicate()
        if path.exists():
            found = opened(path)
            if job == "save" and not found.equals(whole):
                faults.append(f"{path.name}: a file that is there is not whole")
            if job == "record" and not found.equals(whole.isel(time=slice(found.sizes["time"]))):
                faults.append(f"{path.name}: steps that are there are wrong")
            if job == "save":
                remove(path)
    said = start(job, path).communicate()[1]
    if not path.exists() or not opened(path).equals(whole):
        faults.append(f"{path.name}: the end is not that of an undisturbed run: {said[-300:]}")
    return midst, faults


def remove(path: Path) -> None:
    """Remove a file or folder."""
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def full_disk(path: Path, whole: xr.Dataset) -> list[str]:
    """Let the disk run full; the error is to name the file, nothing half-written to stay in its place."""
    faults = []
    said = start("save", path, most=200_000).communicate()[1]
    if path.exists():
        faults.append(f"{path.name}: a file on a full disk")
    if path.name not in said:
        faults.append(
            f"{path.name}: the error of a full disk does not name the file: {said[-300:]}"
        )
    start("save", path).communicate()
    if not opened(path).equals(whole):
        faults.append(f"{path.name}: not whole when there is room again")
    return faults


def two_writers(job: str, path: Path, whole: xr.Dataset) -> list[str]:
    """Start two writers at once: one writes, the other stops with an error that names the file, or after it."""
    both = [start(job, path) for _ in range(2)]
    said = [process.communicate()[1] for process in both]
    codes = [process.returncode for process in both]
    faults = [] if opened(path).equals(whole) else [f"{path.name}: wrong after two writers"]
    if 0 not in codes:
        faults.append(f"{path.name}: no writer of two ended well: {said}")
    return faults + [
        f"{path.name}: {text[-300:]}"
        for code, text in zip(codes, said, strict=True)
        if code and path.name not in text
    ]


def main() -> int:
    """Run the rounds; return 1 if there is a fault."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=100, help="kills in all")
    parser.add_argument("--job", nargs=2, metavar=("JOB", "PATH"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.job:
        {"save": save, "record": record}[arguments.job[0]](Path(arguments.job[1]))
        return 0
    rng = random.Random(0)
    faults = []
    rounds = [("save", suffix) for suffix in SAVED] + [("record", suffix) for suffix in RECORDED]
    kills = np.diff(np.linspace(0, arguments.kills, len(rounds) + 1).astype(int)).tolist()
    with tempfile.TemporaryDirectory() as folder:
        for (job, suffix), count in zip(rounds, kills, strict=True):
            reference = Path(folder) / f"{job}-whole{suffix}"
            start(job, reference).communicate()
            whole = opened(reference)
            midst, found = killed(job, Path(folder) / f"{job}{suffix}", whole, count, rng)
            found += two_writers(job, Path(folder) / f"{job}-two{suffix}", whole)
            if job == "save":
                found += full_disk(Path(folder) / f"{job}-full{suffix}", whole)
            left = sorted(p.name for p in Path(folder).iterdir() if p.name.startswith("."))
            print(
                f"{job} {suffix}: {count} kills, {midst} of them at work; {len(found)} faults; left over: {left}",
                flush=True,
            )
            faults += found
    print("\n".join(faults) or "no faults")
    return int(bool(faults))


if __name__ == "__main__":
    raise SystemExit(main())
