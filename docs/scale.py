"""Measures what long series cost: memory, opening, reading, the scheduler. Prints the tables of docs/scale.md.

Run from the root of the repository::

    python -m docs.scale write   /tmp/scale --particles 100000 --steps 1000
    python -m docs.scale open    /tmp/scale
    python -m docs.scale memory  /tmp/scale --steps 50 200 1000
    python -m docs.scale read    /tmp/scale
    python -m docs.scale convert /tmp/scale --steps 50
    python -m docs.scale overhead --steps 10000

`write` fills a folder with MFiX's binary regions; most of its files are hard links to a few. Each measurement of memory
is a process of its own, whose peak the system tells.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import xcg
from tests.benchmarks import series

FIELDS = ["volume_fraction", "velocity", "stress"]
SUFFIXES = {"NetCDF": ".nc", "Zarr": ".zarr", "VTKHDF": ".vtkhdf"}
MEGA = 1e6


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    print("| " + " | ".join(head) + " |", "|---" * len(head) + "|", sep="\n")
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |")


def least(work: Callable[[], object], repeats: int = 3) -> float:
    """Least time of a few runs (s)."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def scene_of(folder: Path, steps: int | None = None) -> Any:
    ds = xcg.open_scene(**json.loads((folder / "scene.json").read_text()))
    return ds if steps is None else ds.isel(time=slice(0, steps))


def write(folder: Path, particles: int, steps: int) -> None:
    arguments = series.write_vtp_series(folder, particles, steps)
    (folder / "scene.json").write_text(json.dumps(arguments))


# --- opening ---------------------------------------------------------------------------------------------


def opening(folder: Path) -> None:
    """Time to open and to build graphs, with and without the index that was remembered."""
    with tempfile.TemporaryDirectory() as cache:
        os.environ["XDG_CACHE_HOME"] = cache
        start = time.perf_counter()
        ds = scene_of(folder)
        first = time.perf_counter() - start
        again = least(lambda: scene_of(folder))
        rows = [["open the first time", f"{first:.2f}"], ["open again", f"{again:.2f}"]]
        for name, wanted in (("3 fields", FIELDS), ("all fields", None)):
            rows.append([f"`coarse_grain`, {name}", f"{least(partial(ds.cg.coarse_grain, wanted)):.2f}"])
            f = ds.cg.coarse_grain(wanted)
            seconds = least(partial(f.to_netcdf, Path(cache) / "f.nc", compute=False), 2)
            rows.append([f"`to_netcdf(compute=False)`, {name}", f"{seconds:.2f}"])
    table([f"{ds.sizes['time']} steps", "time (s)"], rows)


# --- memory ----------------------------------------------------------------------------------------------

_JOB = """
import resource, sys, time, warnings
from pathlib import Path
import dask
from docs.scale import FIELDS, scene_of
folder, steps, target = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
with dask.config.set(scheduler="threads", num_workers=2):
    ds = scene_of(folder, steps)
    f = ds.cg.coarse_grain(FIELDS, axes="xyz", spacing=2.0 * ds.attrs["d43"])
    start = time.perf_counter()
    f.cg.save(target)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, time.perf_counter() - start)
"""


def memory(folder: Path, counts: Sequence[int], forms: Sequence[str]) -> None:
    """Peak memory of fresh processes by number of steps and format."""
    rows = []
    for form in forms:
        for steps in counts:
            with tempfile.TemporaryDirectory() as out:
                command = [sys.executable, "-c", _JOB, str(folder), str(steps), f"{out}/f{SUFFIXES[form]}"]
                done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(done.stderr)
            peak, seconds = map(float, done.stdout.split()[-2:])
            rows.append([form, steps, f"{peak:.0f}", f"{seconds / steps:.3f}"])
            print(rows[-1], file=sys.stderr, flush=True)
    table(["to", "steps", "peak memory (MB)", "time a step (s)"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("write", "open", "memory", "read", "convert"):
        command = commands.add_parser(name)
        command.add_argument("folder", type=Path)
        if name == "write":
            command.add_argument("--particles", type=int, default=100_000)
            command.add_argument("--steps", type=int, default=1000)
        if name == "memory":
            command.add_argument("--steps", type=int, nargs="+", default=[50, 200, 1000])
            command.add_argument("--to", nargs="+", default=list(SUFFIXES))
    given = parser.parse_args()
    if given.command == "write":
        write(given.folder, given.particles, given.steps)
    elif given.command == "open":
        opening(given.folder)
    elif given.command == "memory":
        memory(given.folder, given.steps, given.to)


if __name__ == "__main__":
    main()
