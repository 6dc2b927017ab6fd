"""Measures speed and memory, and writes the section on speed in docs/accuracy.md.

Run from the root of the repository, on a machine that does nothing else::

    python -m docs.speed [--particles 100000] [--large 1000000]
    python -m docs.speed --only "ten nodes"  # rows of the cases with these words, and writes nothing
    python -m docs.speed --against HEAD~1  # which case moved beyond noise; ends with 1 where one became slower
"""

from __future__ import annotations

import argparse
from functools import partial

from docs import against
from docs.accuracy import fastest, machine
from docs.marks import write_between
from tests.benchmarks import cases

HEAD = """## Speed

A dense packing (`xcg.datasets.dense_packing`): volume fraction 0.6, three contacts a grain, w = 0.75 d, nodes w
apart, Lucy's kernel. *All fields* are the {count} of the [registry](fields.md) that need no further argument. Threads
share the nodes of one step in memory (over space), or each take a step of a lazy scene (over time); the results are the
same bits. Times are the least of {repeats} ({few} for a million grains) after one to warm up, the cases
taking turns, from a scene in memory to labelled fields; peak memory is that of a fresh process that reads the scene
from a file (a lazy scene step by step) and does the job once, with Python and its libraries ({base:.0f} MB) in it.
*Data* are scene and fields together. The dumps are text with six digits, two files of 7 MB and 22 MB for each 100,000
grains, particles and contacts; their time is that of opening, parsing, sorting, checking and contact points. Made, on
{machine}, by

```bash
python -m docs.speed --particles {particles} --large {large} --repeats {repeats}
```

`pytest tests/benchmarks --benchmark-only` runs the same cases. [Kernels and widths](#kernels-and-widths) compares the
loops with the bare arithmetic.

"""
FEW = 2  # times that each large case is run
COLUMNS = ("case", "grains", "threads", "time a step (s)", "us a grain and step", "peak memory (MB)", "data (MB)")
FIRST = """
From the start of a process to all fields of 1000 grains that are given as arrays: {cold:.1f} s with nothing compiled,
{warm:.1f} s from the second time on (the least of four), as compiled code is kept on disk; importing
libraries takes {libraries:.1f} s of it (Numba and what it loads of SciPy, xarray with pandas, dask).

Many small steps, from gzipped dumps of LAMMPS, a pair of files a step, to a Zarr folder of all fields (milliseconds a
step, after a first one; processor time is that of all threads, in the program and in the system). A new file needs
memory pages of the system. A virtual machine may have to request these from its host, which takes several times as long
as computing; *at hand* are pages that a process released a moment before
([measurements](measurements.md#memory-comes-from-numpy-large-arrays-first)).

| steps | grains | threads | pages | time | program | system |
|---|---|---|---|---|---|---|
"""
SMALL = [(1000, 1000), (200, 10_000)]  # steps, and grains in each
PAGES = {"as they come": 0.0, "at hand": 6e9}
FIRST_CALL = """
The first call of a process, and the next one, with compiled code on disk, all fields of {grains:,} grains, rtol = 1e-3,
on one thread (seconds of processor time; rows of a million grains above that are far from the next call here probably
hold time of the system, too):

| pages | first: program | system | next: program | system | first / next |
|---|---|---|---|---|---|
"""


def rows(jobs: list[cases.Case], particles: int, repeats: int) -> list[str]:
    """Rows of the table; the jobs take turns, so that slow minutes are shared by all."""
    times = fastest([partial(job.run, job.scene(particles)) for job in jobs], repeats)
    return [row(job, particles, seconds) for job, seconds in zip(jobs, times, strict=True)]


def row(case: cases.Case, particles: int, seconds: float) -> str:
    ds = case.scene(particles)
    seconds /= ds.sizes["time"]
    grains = ds.sizes["particle"]
    result = case.run(ds)
    data = ds.nbytes + (0 if result is None else result.nbytes)
    del result
    peak = cases.peak_memory(case, particles)
    size = f"{data / 1e6:.0f}" if case.work is not cases.end_to_end else ""
    cells = (
        case.name,
        f"{grains:,}",
        f"{case.threads}{case.over}",
        f"{seconds:.3g}",
        f"{1e6 * seconds / grains:.2f}",
        f"{peak:.0f}",
    )
    return table_row(*cells, size)


def small_row(steps: int, grains: int, threads: int, pages: str) -> str:
    took = cases.small_steps(grains, steps, threads, PAGES[pages])
    return table_row(f"{steps:,}", f"{grains:,}", threads, pages, *(f"{1e3 * seconds:.1f}" for seconds in took))


def first_row(grains: int, pages: str) -> str:
    """What the first call of a process takes beside the next one."""
    first, following = cases.first_call(cases.CASES[0], grains, PAGES[pages])
    times = (f"{seconds:.2f}" for seconds in (*first, *following))
    return table_row(pages, *times, f"{sum(first) / sum(following):.2f}")


def table_row(*cells: object) -> str:
    line = "| " + " | ".join(map(str, cells)) + " |"
    print(line, flush=True)
    return line


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--particles", type=int, default=100_000, help="grains of the packing (default 100000)")
    parser.add_argument("--large", type=int, default=1_000_000, help="grains of the large one; 0 leaves it out")
    parser.add_argument("--repeats", type=int, default=5, help="times that each case is run (default 5)")
    parser.add_argument("--against", metavar="COMMIT", help="compare with the package of a commit, and write nothing")
    parser.add_argument("--only", metavar="WORDS", help="only cases with these words; write nothing")
    given = parser.parse_args()
    if given.against:
        turns = max(given.repeats, against.fewest())
        raise SystemExit(against.compare(given.against, given.particles, turns, given.only or ""))
    if given.only:
        rows([case for case in cases.CASES if given.only in case.name], given.particles, given.repeats)
        return
    lines = ["| " + " | ".join(COLUMNS) + " |", "|---" * len(COLUMNS) + "|"]
    lines += rows(cases.CASES, given.particles, given.repeats)
    cases.packing.cache_clear()
    if given.large:
        lines += rows(cases.LARGE, given.large, FEW)
    small = [small_row(*size, threads, pages) for size in SMALL for threads in (1, 2) for pages in PAGES]
    calls = [first_row(given.large or given.particles, pages) for pages in PAGES]
    cold, warm = cases.first_result()
    libraries = cases.libraries()
    count = len(cases.CASES[0].run(cases.packing(400)).data_vars)
    base = int(cases.fresh("import xcg\n" + cases.RESIDENT)) / 1000
    head = HEAD.format(count=count, base=base, few=FEW, machine=machine().replace("one of ", ""), **vars(given))
    text = head + "\n".join(lines) + "\n" + FIRST.format(cold=cold, warm=warm, libraries=libraries)
    text += "\n".join(small) + "\n"
    text += FIRST_CALL.format(grains=given.large or given.particles) + "\n".join(calls) + "\n"
    write_between("accuracy.md", "speed", text)


if __name__ == "__main__":
    main()
