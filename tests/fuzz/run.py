"""Fuzz the readers: ``python -m tests.fuzz.run lammps --minutes 10``.

Every input runs in a child process with bounded memory and a time limit, and is written to disk before it is used, so
that what ends the interpreter can be tried again: ``python -m tests.fuzz.run lammps --again FOLDER``.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.fuzz.check import address_space, damaged, lay, outcome
from tests.fuzz.targets import TARGETS

_SECONDS = 30  # of the processor: an input that takes longer hangs (by the clock, so would one of a machine that waits)
_ASLEEP = 20  # times as long by the clock, for what waits for something that never comes
_EXTRA = 1 << 31  # bytes of memory beyond what the process has after its first inputs


def _child(name: str, seed: int, folder: str, pipe, deadline: float) -> None:
    def hang(*_: object) -> None:
        msg = f"took more than {_SECONDS} s"
        raise TimeoutError(msg)

    signal.signal(signal.SIGPROF, hang)
    signal.signal(signal.SIGALRM, hang)
    work = Path(folder)
    made = work / "seeds"
    made.mkdir(parents=True, exist_ok=True)
    seeds = TARGETS[name].seeds(made)
    lay(work / "now", seeds)
    first = outcome(name, work / "now")
    assert first[0] == "opened", first
    limit = address_space() + _EXTRA
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    rng = random.Random(seed)
    counts: Counter[str] = Counter()
    while time.monotonic() < deadline and sum(counts.values()) < 4000:
        lay(work / "now", damaged(name, seeds, rng))
        signal.setitimer(signal.ITIMER_PROF, _SECONDS)
        signal.alarm(_ASLEEP * _SECONDS)
        try:
            result, detail = outcome(name, work / "now")
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.alarm(0)
        if "took more than" in detail:
            result = "failed"
        counts[result] += 1
        if result == "failed":
            kept = work.parent / f"failure-{os.getpid()}-{counts['failed']}"
            shutil.copytree(work / "now", kept, dirs_exist_ok=True)
            (kept / "WHY.txt").write_text(detail)
            pipe.send(("failure", detail, str(kept)))
        if sum(counts.values()) % 50 == 0:
            pipe.send(("counts", dict(counts), ""))
    pipe.send(("end", dict(counts), ""))


def fuzz(name: str, minutes: float, seed: int, folder: Path) -> dict[str, object]:
    """Fuzz one target; returns counts and the failures, each kind once."""
    total: Counter[str] = Counter()
    kinds: dict[str, list[str]] = {}
    start = time.monotonic()
    deadline = start + 60 * minutes
    number = 0
    while time.monotonic() < deadline:
        number += 1
        here, there = multiprocessing.Pipe(duplex=False)
        work = folder / f"{name}-{seed}-{number}"
        process = multiprocessing.get_context("spawn").Process(
            target=_child, args=(name, 1000 * seed + number, str(work), there, deadline)
        )
        process.start()
        there.close()
        last: dict[str, int] = {}
        try:
            while True:
                kind, what, where = here.recv()
                if kind == "failure":
                    kinds.setdefault(what.strip().splitlines()[-1][:120], []).append(where)
                else:
                    last = what
        except EOFError:
            pass
        process.join()
        total.update(last)
        if process.exitcode:
            kept = folder / f"crash-{name}-{seed}-{number}"
            if (work / "now").exists():
                shutil.copytree(work / "now", kept, dirs_exist_ok=True)
            total["crashed"] += 1
            kinds.setdefault(f"the interpreter ended with {process.exitcode}", []).append(str(kept))
        shutil.rmtree(work, ignore_errors=True)
    return {
        "target": name, "minutes": round((time.monotonic() - start) / 60, 2), "seed": seed,
        "inputs": sum(total.values()), **total, "kinds": {k: (len(v), v[0]) for k, v in kinds.items()},
    }  # fmt: skip


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="*", help=f"of {', '.join(TARGETS)}; all by default")
    parser.add_argument("--minutes", type=float, default=10, help="for each target")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--folder", type=Path, help="where failures are kept; a temporary folder by default"
    )
    parser.add_argument(
        "--again", type=Path, help="a folder with one set of files, to be tried once"
    )
    given = parser.parse_args()
    if given.again:
        print(*outcome(given.targets[0], given.again), sep="\n")
        return
    folder = given.folder or Path(tempfile.mkdtemp(prefix="xcg-fuzz-"))
    for name in given.targets or TARGETS:
        print(json.dumps(fuzz(name, given.minutes, given.seed, folder)), flush=True)


if __name__ == "__main__":
    main()
