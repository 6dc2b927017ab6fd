"""Compares the speed of the package with that of another commit: python -m docs.speed --against COMMIT.

Two processes stay alive, one with the package of each. They take turns, so that slow minutes are shared, and each turn
gives a ratio of times. What counts is the median of the ratios, with limits from their order, which need no
assumption about how times scatter.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binom

from tests.benchmarks import cases

ROOT = Path(__file__).parents[1]
CONFIDENCE = 0.99  # of the limits of each case
SMALLEST = 0.02  # changes below this are not told, however sure they are


@dataclass(frozen=True)
class Change:
    """How the time of a case changed: ratios new / old of all turns."""

    ratios: Sequence[float]

    @property
    def median(self) -> float:
        return float(np.median(self.ratios))

    @property
    def limits(self) -> tuple[float, float]:
        """Limits between which the median of many ratios lies with `CONFIDENCE`."""
        ordered = np.sort(self.ratios)
        outside = int(binom.ppf((1.0 - CONFIDENCE) / 2.0, len(ordered), 0.5)) - 1
        return float(ordered[outside]), float(ordered[-1 - outside])

    @property
    def verdict(self) -> str:
        low, high = self.limits
        if low > 1.0 and self.median > 1.0 + SMALLEST:
            return "slower"
        if high < 1.0 and self.median < 1.0 - SMALLEST:
            return "faster"
        return ""


def fewest() -> int:
    """Turns from which the order of the ratios gives limits."""
    return next(n for n in range(2, 100) if binom.ppf((1.0 - CONFIDENCE) / 2.0, n, 0.5) >= 1)


@contextmanager
def commit_folder(commit: str) -> Iterator[Path]:
    """A folder with the package of a commit, and the cases of the working tree."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        tree = Path(name) / "tree"
        folder = Path(name) / "run"
        _git("worktree", "add", "--detach", str(tree), commit)
        stack.callback(_git, "worktree", "remove", "--force", str(tree))
        folder.mkdir()
        for part, root in (("xcg", tree), ("tests", ROOT), ("docs", ROOT)):
            (folder / part).symlink_to(root / part)
        yield folder


def _git(*arguments: str) -> None:
    done = subprocess.run(
        ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode:
        message = f"git {' '.join(arguments)}: {done.stderr.strip()}"
        raise SystemExit(message)


@contextmanager
def worker(folder: Path, particles: int) -> Iterator[subprocess.Popen[str]]:
    """A process that runs cases with the package in a folder."""
    command = [sys.executable, "-m", "docs.against", str(particles)]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    pipe = subprocess.PIPE
    started = subprocess.Popen(
        command, cwd=folder, env=environment, stdin=pipe, stdout=pipe, text=True
    )
    try:
        yield started
    finally:
        started.kill()
        started.wait()


def seconds(process: subprocess.Popen[str], case: int) -> float:
    """Seconds that a worker takes for a case; NaN where its package cannot do it."""
    assert process.stdin is not None
    assert process.stdout is not None
    print(case, file=process.stdin, flush=True)
    answer = process.stdout.readline()
    if not answer:
        message = f"the process that runs {cases.CASES[case].name!r} ended: see above"
        raise SystemExit(message)
    return float(answer)


def compare(commit: str, particles: int, turns: int, words: str = "") -> bool:
    """Print how each case with these words changed; tell whether any became slower."""
    slower = False
    with (
        commit_folder(commit) as folder,
        worker(folder, particles) as old,
        worker(ROOT, particles) as new,
    ):
        print(
            f"| case | {commit} (s) | here (s) | ratio | {CONFIDENCE:.0%} limits | |\n|---|---|---|---|---|---|"
        )
        for number, case in enumerate(cases.CASES):
            if words not in case.name:
                continue
            name = f"{case.name}, {case.threads} thread{case.over and 's'}{case.over}"
            first = [
                seconds(process, number) for process in (old, new)
            ]  # compiles, and is not counted
            if not np.isfinite(first).all():
                print(f"| {name} | {first[0]:.3g} | {first[1]:.3g} | | | fails |", flush=True)
                continue
            took = np.array([_turn(old, new, number, swapped=bool(k % 2)) for k in range(turns)])
            change = Change(took[:, 1] / took[:, 0])
            slower |= change.verdict == "slower"
            low, high = change.limits
            best = " | ".join(f"{least:.3g}" for least in took.min(axis=0))
            print(
                f"| {name} | {best} | {change.median:.3f} | {low:.3f} to {high:.3f} | {change.verdict} |",
                flush=True,
            )
    return slower


def _turn(
    old: subprocess.Popen[str], new: subprocess.Popen[str], case: int, *, swapped: bool
) -> tuple[float, float]:
    """Seconds of both, in one order or the other."""
    if swapped:
        later = seconds(new, case)
        return seconds(old, case), later
    return seconds(old, case), seconds(new, case)


def serve(particles: int) -> None:
    """Run the cases whose numbers come, and print the seconds that each takes."""
    for line in sys.stdin:
        case = cases.CASES[int(line)]
        scene = case.scene(particles)
        begin = time.perf_counter()
        try:
            case.run(scene)
        except Exception as error:
            print(f"{case.name}: {error}", file=sys.stderr)
            begin = np.nan
        print(time.perf_counter() - begin, flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description="Run cases whose numbers come from standard input."
    )
    parser.add_argument("particles", type=int)
    serve(parser.parse_args().particles)
