"""Measures what long series cost: memory, opening, reading, the scheduler. Prints the tables of docs/scale.md.

Run from the root of the repository::

    python -m docs.scale write   /tmp/scale --particles 100000 --steps 1000
    python -m docs.scale open    /tmp/scale
    python -m docs.scale memory  /tmp/scale --steps 50 200 1000
    python -m docs.scale read    /tmp/scale
    python -m docs.scale text    /tmp/scale --particles 1000000
    python -m docs.scale convert /tmp/scale --steps 50
    python -m docs.scale overhead --steps 10000
    python -m docs.scale long    /tmp/long --particles 1000000 --steps 200   # 29 GB

`write` fills a folder with MFiX's binary regions; most of its files are hard links to a few. Each measurement of memory
is a process of its own, whose peak the system tells.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import xarray as xr
from dask.delayed import Delayed
from dask.highlevelgraph import HighLevelGraph

import xcg
from docs.accuracy import fastest
from tests.benchmarks import cases, series
from xcg.readers.engine import ReadOptions

FIELDS = ["volume_fraction", "velocity", "stress"]
SUFFIXES = {"NetCDF": ".nc", "Zarr": ".zarr", "VTKHDF": ".vtkhdf"}
MEGA = 1e6


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    print("| " + " | ".join(head) + " |", "|---" * len(head) + "|", sep="\n")
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |")


def processor(work: Callable[[], object], repeats: int = 5) -> float:
    """Least processor time of a few runs (s): others on the machine disturb it less than the clock."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def scene_of(folder: Path, steps: int | None = None) -> Any:
    ds = xcg.open_scene(**json.loads((folder / "scene.json").read_text()))
    return ds if steps is None else ds.isel(time=slice(0, steps))


def write(folder: Path, particles: int, steps: int) -> None:
    arguments = series.write_vtp_series(folder, particles, steps)
    (folder / "scene.json").write_text(json.dumps(arguments))


# --- opening ---------------------------------------------------------------------------------------------


def opening(folder: Path) -> None:
    """Processor time to open and to build graphs, with and without the index that was remembered."""
    with tempfile.TemporaryDirectory() as cache:
        os.environ["XDG_CACHE_HOME"] = cache
        open_scene = partial(scene_of, folder)
        rows = [["open the first time", f"{processor(open_scene, 1):.2f}"]]
        rows.append(["open again", f"{processor(open_scene):.2f}"])
        ds = open_scene()
        for name, wanted in (("3 fields", FIELDS), ("all fields", None)):
            rows.append(
                [f"`coarse_grain`, {name}", f"{processor(partial(ds.cg.coarse_grain, wanted)):.2f}"]
            )
            f = ds.cg.coarse_grain(wanted)
            seconds = processor(partial(f.to_netcdf, Path(cache) / "f.nc", compute=False), 2)
            rows.append([f"graph of `to_netcdf`, {name}", f"{seconds:.2f}"])
    table([f"{ds.sizes['time']} steps", "processor time (s)"], rows)


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
                command = [
                    sys.executable,
                    "-c",
                    _JOB,
                    str(folder),
                    str(steps),
                    f"{out}/f{SUFFIXES[form]}",
                ]
                done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(done.stderr)
            peak, seconds = map(float, done.stdout.split()[-2:])
            rows.append([form, steps, f"{peak:.0f}", f"{seconds / steps:.3f}"])
            print(rows[-1], file=sys.stderr, flush=True)
    table(["to", "steps", "peak memory (MB)", "time a step (s)"], rows)


# --- reading ---------------------------------------------------------------------------------------------


def reading(folder: Path, particles: int) -> None:
    """Speed of parsers and of whole steps, on one core."""
    from xcg.readers.files import vtkheader, vtp

    folder.mkdir(parents=True, exist_ok=True)
    (ds,) = series.packings(particles, 1)
    rows = []
    for encoding in ("raw", "base64", "zlib", "zlib base64"):
        path = series.write_vtp(folder / "p.vtp", ds, "position", series.PARTICLE_ARRAYS, encoding)
        header = vtp.read_header(str(path))
        seconds = processor(partial(vtkheader.read_arrays, header, header.names))
        values = 4 * particles * sum(array.components for array in header.arrays)
        rows.append([f"`.vtp`, {encoding}", f"{path.stat().st_size / seconds / MEGA:.0f}",
                     f"{values / seconds / MEGA:.0f}"])  # fmt: skip
    table(["", "bytes of the file (MB/s)", "bytes of values (MB/s)"], rows)


def parsing(folder: Path, particles: int) -> None:
    """Speed of reading text, plain and compressed, by one thread and by two; of other parsers; and of the fields."""
    from xcg.readers.engines.lammps import Lammps
    from xcg.readers.engines.mercury import Mercury
    from xcg.readers.files import text
    from xcg.readers.files.text import _zstd

    folder.mkdir(parents=True, exist_ok=True)
    (ds,) = series.packings(particles, 1)
    packers: dict[str, Callable[[bytes], bytes]] = {
        "": bytes,
        ".gz": partial(gzip.compress, compresslevel=6),
    }
    if _zstd() is not None:
        packers[".zst"] = _zstd().compress
    texts = dict(zip(("p.0.dump", "c.0.dump"), series.dump_texts(ds, 0), strict=True))
    texts["m.fstat"] = series.fstat_text(ds)
    rows = []
    for name, content in texts.items():
        engine = Mercury() if name == "m.fstat" else Lammps()
        kind = "particles" if name == "p.0.dump" else "contacts"
        raw = content.encode()
        for suffix, pack in packers.items():
            path = folder / f"{name}{suffix}"
            path.write_bytes(pack(raw))
            (ref,) = getattr(engine, f"index_{kind}")([str(path)], ReadOptions())
            size = ref.length / MEGA
            read = [
                partial(getattr(engine, f"read_{kind}"), ref, ReadOptions(alone=threads))
                for threads in (False, True)
            ]
            one = processor(read[0])
            unpacked = processor(lambda ref=ref: deque(text.body_of(ref), 0))
            with mock.patch("xcg.readers.files.table.THREADS", 2):
                alone, both = fastest(read, 5)
            rows.append([f"{kind} of {engine.name}{suffix}", f"{size:.0f}", f"{size / unpacked:.0f}",
                         f"{size / one:.0f}", f"{alone / both:.2f}", f"{one:.2f}"])  # fmt: skip
            path.unlink()
            if not suffix:
                body = (
                    raw[ref.offset :].replace(b" \n", b"\n").replace(b"\n", b" \n")
                )  # as these parsers are told
                for way, work in parsers(body, len(ref.columns)).items():
                    seconds = processor(work, 2)
                    rows.append(
                        [
                            f"- all columns by {way}",
                            "",
                            "",
                            f"{size / seconds:.0f}",
                            "",
                            f"{seconds:.2f}",
                        ]
                    )
    seconds = processor(partial(cases.fields, ds), 2)
    rows.append([f"all fields of {particles:,} grains", "", "", "", "", f"{seconds:.2f}"])
    table(["", "text (MB)", "read and unpacked (MB/s)", "read and parsed (MB/s)", "two threads, times as fast",
           "processor time (s)"], rows)  # fmt: skip


def parsers(body: bytes, columns: int) -> dict[str, Callable[[], object]]:
    """Ways to parse the same table; those that are not installed are left out."""
    import pandas as pd

    options: dict[str, Any] = {"header": None, "dtype": float, "engine": "c", "quoting": 3}
    ways: dict[str, Callable[[], object]] = {
        "pandas, any white space": lambda: pd.read_csv(
            io.BytesIO(body), sep=r"\s+", names=range(columns), **options
        ),
        "pandas, one space": lambda: pd.read_csv(
            io.BytesIO(body), sep=" ", names=range(columns + 1), usecols=range(columns), **options
        ),
    }  # fmt: skip
    with suppress(ImportError):
        import polars

        schema = {f"{k}": polars.Float64 for k in range(columns)} | {"end": polars.String}
        ways["polars"] = lambda: polars.read_csv(
            body, separator=" ", has_header=False, schema=schema
        )
    with suppress(ImportError):
        import pyarrow
        import pyarrow.csv

        names = [str(k) for k in range(columns)]
        ways["pyarrow"] = lambda: pyarrow.csv.read_csv(
            pyarrow.BufferReader(body),
            read_options=pyarrow.csv.ReadOptions(use_threads=False, column_names=[*names, "end"]),
            parse_options=pyarrow.csv.ParseOptions(delimiter=" ", quote_char=False),
            convert_options=pyarrow.csv.ConvertOptions(
                column_types=dict.fromkeys(names, pyarrow.float64()), include_columns=names
            ),
        )
    return ways


def converting(folder: Path, steps: int) -> None:
    """Size and speed of scenes saved as NetCDF and Zarr, against the files that they come from."""
    ds = scene_of(folder, steps)
    files = json.loads((folder / "scene.json").read_text())
    size = sum(
        path.stat().st_size
        for kind in ("particles", "contacts")
        for path in sorted(Path(files[kind]).parent.glob(f"{Path(files[kind]).stem}_[0-9]*.vtp"))[
            :steps
        ]
    )

    def load(scene: Any) -> float:
        return processor(lambda: scene.compute(scheduler="synchronous"), 2) / steps

    rows = [["MFiX", f"{size / steps / MEGA:.1f}", "", f"{load(ds):.3f}"]]
    with tempfile.TemporaryDirectory() as out:
        for suffix in (".nc", ".zarr"):
            target = Path(out) / f"scene{suffix}"
            seconds = processor(lambda target=target: ds.cg.save(target, overwrite=True), 1) / steps
            inside = [target] if suffix == ".nc" else [p for p in target.rglob("*") if p.is_file()]
            again = (
                xr.open_zarr(target) if suffix == ".zarr" else xr.open_dataset(target, chunks={})
            )
            size = sum(p.stat().st_size for p in inside)
            rows.append(
                [suffix, f"{size / steps / MEGA:.1f}", f"{seconds:.3f}", f"{load(again):.3f}"]
            )
            again.close()
    table(["", "MB a step", "processor time to convert a step (s)", "to load a step (s)"], rows)


# --- the scheduler ---------------------------------------------------------------------------------------


def _nothing(*_: object) -> None:
    """What a task does whose cost is that of the scheduler."""


def overhead(steps: int) -> None:
    """What schedulers cost: the graph of a long series, whose tasks do nothing."""
    from distributed import Client, LocalCluster

    tasks: dict[Any, Any] = {}
    for t in range(steps):
        tasks["read", t] = (_nothing, t)
        tasks["contacts", t] = (_nothing, ("read", t))
        tasks["compute", t] = (_nothing, ("read", t), ("contacts", t))
        tasks["write", t] = (_nothing, ("compute", t))
    tasks["all"] = (_nothing, [("write", t) for t in range(steps)])
    graph = Delayed("all", HighLevelGraph.from_collections("all", tasks))
    rows = []

    def run(name: str, **options: Any) -> None:
        start = time.perf_counter()
        busy = time.process_time()
        graph.compute(**options)
        seconds = time.perf_counter() - start
        busy = time.process_time() - busy
        rows.append(
            [
                name,
                f"{seconds:.1f}",
                f"{1e6 * seconds / len(tasks):.0f}",
                f"{1e6 * busy / len(tasks):.0f}",
            ]
        )

    run("1 thread", scheduler="synchronous")
    run("2 threads", scheduler="threads", num_workers=2)
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster),
    ):
        run("distributed, 2 processes")
    table(
        [
            f"{steps:,} steps, {len(tasks):,} tasks",
            "time (s)",
            "us a task",
            "of which in the scheduler's process",
        ],
        rows,
    )


# --- a job larger than memory ----------------------------------------------------------------------------

_LONG = """
import json, resource, sys, time, warnings
from pathlib import Path
import distributed
from docs.scale import FIELDS, scene_of


def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    folder, target = Path(sys.argv[1]), sys.argv[2]
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        print(json.dumps([worker.process.pid for worker in cluster.workers.values()]), flush=True)
        start = time.perf_counter()
        ds = scene_of(folder)
        ds.cg.coarse_grain(FIELDS, spacing=2.0 * ds.attrs["d43"]).cg.save(target, resume=True)
        print(json.dumps([time.perf_counter() - start, peak(), max(client.run(peak).values())]), flush=True)
"""


def long(folder: Path, particles: int, steps: int) -> None:
    """Coarse-grain a series larger than memory by two processes, of which one is killed, then all; resume the job."""
    files = folder / "files"
    if not (folder / "files" / "scene.json").exists():
        arguments = series.write_distinct_vtp_series(files, particles, steps)
        (files / "scene.json").write_text(json.dumps(arguments))
    size = sum(path.stat().st_size for path in files.iterdir()) / 1e9
    script = folder / "job.py"
    target = folder / "fields.zarr"
    script.write_text(_LONG)
    command = [sys.executable, str(script), str(files), str(target)]
    environment = os.environ | {"PYTHONPATH": os.getcwd(), "OMP_NUM_THREADS": "1"}

    def started() -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        return subprocess.Popen(
            command, stdout=pipe, stderr=pipe, text=True, env=environment, start_new_session=True
        )

    def wait_for(share: float) -> None:
        while (
            len(list(folder.glob(".*.begun/*/velocity/c.*"))) < share * steps
        ):  # a step of this size is a chunk
            time.sleep(0.2)

    job = started()
    seconds = time.perf_counter()
    pids = json.loads(job.stdout.readline())  # type: ignore[union-attr]
    wait_for(0.2)
    os.kill(pids[0], signal.SIGKILL)
    wait_for(0.5)
    os.killpg(job.pid, signal.SIGKILL)
    first = time.perf_counter() - seconds
    out, said = started().communicate()
    print(said)
    second, client, worker = json.loads(out.splitlines()[1])
    f = xr.open_zarr(target)
    ds = scene_of(files)
    some = ds.isel(time=slice(None, None, max(1, steps // 10)))
    expected = some.cg.coarse_grain(FIELDS, spacing=2.0 * ds.attrs["d43"]).compute(
        scheduler="synchronous"
    )
    same = all(f[name].sel(time=some.time).load().equals(expected[name]) for name in FIELDS)
    growth = 1.0 + 0.01 * xr.DataArray(range(steps), dims="time")
    error = float(
        abs(f.velocity / growth - f.velocity.isel(time=0)).max()
        / abs(f.velocity.isel(time=0)).max()
    )
    reading = processor(lambda: some.isel(time=[1]).compute(scheduler="synchronous"), 3)
    rows = [
        ["files (GB)", f"{size:.1f}"], ["until all processes are killed (s)", f"{first:.0f}"],
        ["resumed, to the end (s)", f"{second:.0f}"], ["steps that equal those of one process", str(same)],
        ["velocity against its growth, error relative to the largest", f"{error:.1e}"],
        ["peak memory of a worker; of the client (MB)", f"{worker:.0f}; {client:.0f}"],
        ["reading a step, processor time (s)", f"{reading:.2f}"],
    ]  # fmt: skip
    table([f"{particles:,} grains, {steps} steps", ""], rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("write", "open", "memory", "read", "text", "convert"):
        command = commands.add_parser(name)
        command.add_argument("folder", type=Path)
        if name in ("write", "read", "text"):
            command.add_argument("--particles", type=int, default=100_000)
        if name in ("write", "convert"):
            command.add_argument("--steps", type=int, default=1000 if name == "write" else 10)
        if name == "memory":
            command.add_argument("--steps", type=int, nargs="+", default=[50, 200, 1000])
            command.add_argument("--to", nargs="+", default=list(SUFFIXES))
    command = commands.add_parser("long")
    command.add_argument("folder", type=Path)
    command.add_argument("--particles", type=int, default=1_000_000)
    command.add_argument("--steps", type=int, default=200)
    command = commands.add_parser("overhead")
    command.add_argument("--steps", type=int, default=10_000)
    given = parser.parse_args()
    if given.command == "write":
        write(given.folder, given.particles, given.steps)
    elif given.command == "open":
        opening(given.folder)
    elif given.command == "read":
        reading(given.folder, given.particles)
    elif given.command == "text":
        parsing(given.folder, given.particles)
    elif given.command == "convert":
        converting(given.folder, given.steps)
    elif given.command == "overhead":
        overhead(given.steps)
    elif given.command == "long":
        long(given.folder, given.particles, given.steps)
    elif given.command == "memory":
        memory(given.folder, given.steps, given.to)


if __name__ == "__main__":
    main()
