"""Measures speed and memory, and writes the section on speed in docs/accuracy.md.

Run from the root of the repository, on a machine that does nothing else::

    python -m docs.speed [--particles 100000] [--large 1000000]
    python -m docs.speed --only "ten nodes"  # rows of the cases with these words, and writes nothing
    python -m docs.speed --against HEAD~1  # which case moved beyond noise; ends with 1 where one became slower

Each run is kept in docs/speed_runs.jsonl, and the section holds the ranges over all of them: one day says little.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from docs import against
from docs.accuracy import in_turn, machine
from docs.marks import write_between
from tests.benchmarks import cases

RUNS = Path(__file__).with_name("speed_runs.jsonl")
HEAD = """## Speed

A dense packing (`xcg.datasets.dense_packing`): volume fraction 0.6, three contacts a grain, w = 0.75 d, nodes w
apart, Lucy's kernel. *All fields* are the {count} of the [registry](fields.md) that need no further argument. Threads
share the nodes of one step in memory (over space), or each take a step of a lazy scene (over time); the results are the
same bits. Times are from a scene in memory to labelled fields, after one run to warm up, the cases taking turns: ranges
over {days} of the middle half of {repeats} repeats ({few} for a million grains). The same loops take up to twice
the time on another day of this virtual machine; ratios of rows hold better. Peak memory is that of a fresh process that
reads the scene from a file (a lazy scene step by step) and does the job once, with Python and its libraries
({base:.0f} MB) in it. *Data* are scene and fields together. The dumps are text with six digits, two files of 7 MB and
22 MB for each 100,000 grains, particles and contacts; their time is that of opening, parsing, sorting, checking and
contact points. Made, on {machine}, by

```bash
python -m docs.speed --particles {particles} --large {large} --repeats {repeats}
```

`pytest tests/benchmarks --benchmark-only` runs the same cases. [Kernels and widths](#kernels-and-widths) compares the
loops with the bare arithmetic.

"""
FEW = 4  # times that each large case is run
COLUMNS = (
    "case",
    "grains",
    "threads",
    "time a step (s)",
    "us a grain and step",
    "peak memory (MB)",
    "data (MB)",
)
FIRST = """
From the start of a process to all fields of 1000 grains that are given as arrays: {cold} s with nothing compiled,
{warm} s from the second time on (the least of four), as compiled code is kept on disk; importing
libraries takes {libraries} s of it (Numba and what it loads of SciPy, xarray with pandas, dask).

Many small steps, from gzipped dumps of LAMMPS, a pair of files a step, to a Zarr folder of all fields. A new file needs
memory pages of the system, which a virtual machine may have to request from its host
([measurements](measurements.md#memory-comes-from-numpy-large-arrays-first)); these times depend on the day most.

| steps | grains | threads | milliseconds a step |
|---|---|---|---|
"""
SMALL = [(1000, 1000), (200, 10_000)]  # steps, and grains in each


def measured(jobs: list[cases.Case], particles: int, repeats: int) -> dict[str, list[Any]]:
    """Measure cases, which take turns: their labels, quartiles of times a step (s), peak memory and data (MB)."""
    found: dict[str, list[Any]] = {}
    runs = [partial(job.run, job.scene(particles)) for job in jobs]
    for job, times in zip(jobs, in_turn(runs, repeats), strict=True):
        ds = job.scene(particles)
        quartiles = np.percentile(times, [25, 75]) / ds.sizes["time"]
        result = job.run(ds)
        data = (
            None
            if job.work is cases.end_to_end
            else round((ds.nbytes + getattr(result, "nbytes", 0)) / 1e6)
        )
        del result
        label = f"{job.name} | {ds.sizes['particle']:,} | {job.threads}{job.over}"
        found[label] = [
            *(float(f"{seconds:.3g}") for seconds in quartiles),
            round(cases.peak_memory(job, particles)),
            data,
        ]
        print(label, found[label], flush=True)
    return found


def measured_run(particles: int, large: int, repeats: int) -> dict[str, Any]:
    """Measure all that the section holds."""
    seconds = measured(cases.CASES, particles, repeats)
    cases.packing.cache_clear()
    if large:
        seconds |= measured(cases.LARGE, large, FEW)
    small = {
        f"{steps:,} | {grains:,} | {threads}": round(
            1e3 * cases.small_steps(grains, steps, threads), 1
        )
        for steps, grains in SMALL
        for threads in (1, 2)
    }
    first = [*cases.first_result(), cases.libraries()]
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "seconds": seconds,
        "small": small,
        "first": first,
    }


def between(values: Sequence[float], digits: str = ".3g") -> str:
    """Write the range of some values; one number where both ends are written alike."""
    low = format(min(values), digits)
    high = format(max(values), digits)
    return low if low == high else f"{low} to {high}"


def rows(runs: Sequence[dict[str, Any]]) -> list[str]:
    """Rows of the table, with ranges over all runs."""
    lines = []
    for label, (*_, peak, data) in runs[-1]["seconds"].items():
        times = [seconds for run in runs for seconds in run["seconds"].get(label, [])[:2]]
        grains = int(label.split(" | ")[1].replace(",", ""))
        each = between([1e6 * seconds / grains for seconds in times], ".2f")
        lines.append(
            f"| {label} | {between(times)} | {each} | {peak} | {'' if data is None else data} |"
        )
    return lines


def write_section(runs: Sequence[dict[str, Any]], given: argparse.Namespace) -> None:
    """Write the section from all runs."""
    count = len(cases.CASES[0].run(cases.packing(400)).data_vars)
    base = int(cases.fresh("import xcg\n" + cases.RESIDENT)) / 1000
    text = HEAD.format(
        count=count, base=base, few=FEW, machine=machine().replace("one of ", ""),
        days=" and ".join(run["date"] for run in runs), **vars(given),
    )  # fmt: skip
    text += (
        "\n".join(["| " + " | ".join(COLUMNS) + " |", "|---" * len(COLUMNS) + "|", *rows(runs)])
        + "\n"
    )
    cold, warm, libraries = (
        between([run["first"][k] for run in runs if len(run["first"]) > k], ".1f") for k in range(3)
    )
    text += FIRST.format(cold=cold, warm=warm, libraries=libraries)
    small = {label: [run["small"][label] for run in runs] for label in runs[-1]["small"]}
    text += (
        "\n".join(f"| {label} | {between(times, '.1f')} |" for label, times in small.items()) + "\n"
    )
    write_between("accuracy.md", "speed", text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--particles", type=int, default=100_000, help="grains of the packing (default 100000)"
    )
    parser.add_argument(
        "--large", type=int, default=1_000_000, help="grains of the large one; 0 leaves it out"
    )
    parser.add_argument(
        "--repeats", type=int, default=8, help="times that each case is run (default 8)"
    )
    parser.add_argument(
        "--against",
        metavar="COMMIT",
        help="compare with the package of a commit, and write nothing",
    )
    parser.add_argument(
        "--only", metavar="WORDS", help="only cases with these words; write nothing"
    )
    given = parser.parse_args()
    if given.against:
        turns = max(given.repeats, against.fewest())
        raise SystemExit(against.compare(given.against, given.particles, turns, given.only or ""))
    if given.only:
        measured(
            [case for case in cases.CASES if given.only in case.name],
            given.particles,
            given.repeats,
        )
        return
    with RUNS.open("a") as file:
        file.write(json.dumps(measured_run(given.particles, given.large, given.repeats)) + "\n")
    write_section([json.loads(line) for line in RUNS.read_text().splitlines()], given)


if __name__ == "__main__":
    main()
