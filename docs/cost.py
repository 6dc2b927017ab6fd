"""Cost a grain of all fields over the number of grains, widths and threads: writes docs/_static/cost.png.

Run from the root of the repository, on a machine that does nothing else (five minutes)::

    python -m docs.cost [--largest 1000000] [--repeats 3]

The measured times go to docs/cost.csv; ``python -m docs.cost --draw`` draws that file again. The chart is that of
figure 8 of Pysammos (EGUsphere preprint 2026-2591).
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import xarray as xr

import xcg
from docs.accuracy import machine
from docs.marks import write_between
from tests.benchmarks.cases import Case

mpl.use("agg")
from matplotlib import pyplot as plt

TABLE = Path(__file__).with_name("cost.csv")
PICTURE = Path(__file__).parent / "_static" / "cost.png"
WIDTHS = (0.75, 2.0, 4.0, 6.0)  # diameters, which are 1; nodes are as far apart
PAPER = 1e-4  # s a grain and step, at 1e6 grains and w = 0.75 d
REPEATS = 3
BUSY = 2.5  # load, over a quarter of an hour, above which other work ran on the two cores
SHORT = 0.2  # s; shorter jobs are repeated until they take as long


def cost(ds: xr.Dataset, width: float, threads: int, repeats: int) -> float:
    """Return the least time of all fields of one step (s), after a first run."""
    case = Case("", lambda scene: scene.cg.coarse_grain(width=width, spacing=width), threads)

    def seconds() -> float:
        begin = time.perf_counter()
        case.run(ds)
        return time.perf_counter() - begin

    first = seconds()
    return min(seconds() for _ in range(max(repeats, int(SHORT / first))))


def measure(largest: int, repeats: int) -> pd.DataFrame:
    """Return seconds a grain for each number of grains, width and number of threads."""
    rows = []
    counts = [10**k for k in range(3, 7) if 10**k <= largest]
    for count in counts:
        ds = xcg.datasets.dense_packing(count)
        for width in WIDTHS:
            for threads in (1, 2):
                seconds = cost(ds, width, threads, repeats) / count
                rows.append(
                    {"grains": count, "width": width, "threads": threads, "seconds": seconds}
                )
                print(f"{count:>8} grains, w = {width:g} d, {threads} threads: {seconds:.2e} s")
    return pd.DataFrame(rows)


def draw(table: pd.DataFrame) -> None:
    """Draw a panel for each width, as the paper does, and the paper's cost as a line."""
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.6), sharey=True, layout="constrained")
    for ax, (width, of_width) in zip(axes, table.groupby("width"), strict=True):
        for threads, part in of_width.groupby("threads"):
            label = f"xcg, {threads} thread{'s' * (threads > 1)}"
            ax.loglog(part.grains, part.seconds, "o-", color=f"C{threads - 1}", label=label)
        ax.set(title=f"$w / d$ = {width:g}", xlabel="grains", ylim=(3e-7, 1e-3))
        ax.grid(alpha=0.3)
    label = "Pysammos at $10^6$ grains,\nother machine (Archer2)"
    axes[0].axhline(PAPER, color="black", ls="--", lw=1, label=label)
    axes[0].legend(fontsize="small", loc="upper right", bbox_to_anchor=(1.0, 0.7))
    axes[0].set_ylabel("time a grain and step (s)")
    figure.savefig(PICTURE, dpi=90)
    plt.close(figure)


def rows(table: pd.DataFrame) -> str:
    """Return the table of the page: microseconds a grain, by width and threads."""
    counts = sorted(table.grains.unique())
    head = ["w / d", "threads", *(f"{count:,} grains" for count in counts)]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for (width, threads), part in table.groupby(["width", "threads"]):
        times = part.set_index("grains").seconds[counts]
        cells = [f"{width:g}", f"{threads}", *(f"{1e6 * seconds:.2f}" for seconds in times)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, and write the table, the page and the picture."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--largest", type=int, default=1_000_000, help="most grains")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="runs of each case")
    parser.add_argument("--draw", action="store_true", help="draw cost.csv again")
    given = parser.parse_args()
    warnings.simplefilter("ignore", xcg.SceneWarning)
    if not given.draw:
        measured = measure(given.largest, given.repeats)
        facts = {"machine": machine(), "load": os.getloadavg()[0]}
        measured.assign(**facts).to_csv(TABLE, index=False, float_format="%.4g")
    table = pd.read_csv(TABLE)
    on = table.machine.iloc[0].replace("one of ", "")
    text = f"{rows(table)}\n\nMicroseconds a grain and step, on {on}."
    if table.load.iloc[0] > BUSY:
        text += f" The machine had other work (load {table.load.iloc[0]:.1f}), so these are upper bounds."
    write_between("works.md", "cost", text)
    draw(table)
    slopes = table.pivot_table(index="grains", columns=["width", "threads"], values="seconds")
    print(np.round(1e6 * slopes, 2).to_string())


if __name__ == "__main__":
    main()
