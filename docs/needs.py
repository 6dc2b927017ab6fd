"""Time, memory and error of no more than a question needs: python -m docs.needs [--particles 100000].

Writes docs/_static/needs.png and the tables of docs/needs.md. Run it on a machine that does nothing else (two minutes).
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import xarray as xr

import xcg
from docs.accuracy import machine
from docs.marks import write_between
from tests.benchmarks.cases import Case, fresh

mpl.use("agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parent / "_static" / "needs.png"
PLACES = {  # where: arguments
    "box": {"axes": ""},
    "profile": {"axes": "z"},
    "plane": {"axes": "xz", "at": {"y": 0.0}},
    "volume": {"axes": "xyz"},
}
FIELDS = {"volume fraction": ["volume_fraction"], "stress": ["stress"], "all fields": None}
BUSY = 2.5  # load above which other work ran on the two cores
LONGEST = 108  # letters of a line of `explain` on the page
MEMORY = """
import sys
import xcg

ds = xcg.datasets.dense_packing(int(sys.argv[1]))
names, where = eval(sys.argv[2])
low = int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0])
f = ds.cg.coarse_grain(names, **where)
print(int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) - low)
"""


@dataclass(frozen=True)
class Job:
    """Some fields at a place."""

    place: str
    fields: str

    def run(self, ds: xr.Dataset) -> xr.Dataset:
        """Compute them, in memory."""
        return ds.cg.coarse_grain(FIELDS[self.fields], **PLACES[self.place])

    def seconds(self, ds: xr.Dataset, repeats: int) -> float:
        """Return the least time, on one thread, after a first run."""
        case = Case("", self.run)
        case.run(ds)
        times = []
        for _ in range(repeats):
            begin = time.perf_counter()
            case.run(ds)
            times.append(time.perf_counter() - begin)
        return min(times)

    def memory(self, particles: int) -> float:
        """Return the growth of the peak memory of a fresh process that computes them (MB)."""
        what = repr((FIELDS[self.fields], PLACES[self.place]))
        return int(fresh(MEMORY, str(particles), what, PYTHONWARNINGS="ignore")) / 1000

    def spread(self, ds: xr.Dataset) -> float:
        """Return the rms deviation of the nodes from the exact value of the box, over that value.

        Of the volume fraction, and of the pressure where there is stress; the exact ones are sums over grains.
        """
        f = self.run(ds)
        box = float(np.prod(ds.attrs["box_upper"]))
        if self.fields == "volume fraction":
            values = f.volume_fraction
            exact = float(ds.volume.sum()) / box
        else:
            values = sum(f.stress.sel(component=a, direction=a) for a in "xyz")
            of_contacts = ds.cg.particle_stress().stress * ds.volume
            fast = ds.velocity - (ds.mass * ds.velocity).sum("particle") / ds.mass.sum("particle")
            exact = float(sum(of_contacts.sel(component=a, direction=a).sum() for a in "xyz"))
            exact = (exact + float((ds.mass * fast**2).sum())) / box
        return float(np.sqrt(((values / exact - 1) ** 2).mean()))


JOBS = [Job(place, fields) for place in PLACES for fields in FIELDS]


def measure(particles: int, repeats: int) -> pd.DataFrame:
    """Return nodes, time, memory and spread of each job."""
    ds = xcg.datasets.dense_packing(particles)
    rows = []
    for job in JOBS:
        nodes = int(np.prod([job.run(ds).sizes.get(a, 1) for a in "xyz"]))
        rows.append(
            {
                "place": job.place,
                "fields": job.fields,
                "nodes": nodes,
                "time": 1e6 * job.seconds(ds, repeats) / particles,
                "memory": job.memory(particles),
                "spread": job.spread(ds),
            }
        )
        print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def rows(table: pd.DataFrame) -> str:
    """Return the table of the page."""
    lines = [
        "| where | fields | nodes | time (µs a grain) | memory (MB) | spread of nodes |",
        "|---|---|---|---|---|---|",
    ]
    for row in table.itertuples():
        spread = "rounding" if row.spread < 1e-10 else f"{100 * row.spread:.2g} %"
        lines.append(
            f"| {row.place} | {row.fields} | {row.nodes:,} | {row.time:.2f} | {row.memory:.0f} | {spread} |"
        )
    return "\n".join(lines)


def explained() -> str:
    """Return what `explain` says for a few of them, on a smaller packing."""
    ds = xcg.datasets.dense_packing(20_000)
    parts = []
    for job in (
        Job("box", "volume fraction"),
        Job("profile", "stress"),
        Job("volume", "all fields"),
    ):
        where = ", ".join(f"{key}={value!r}" for key, value in PLACES[job.place].items())
        call = f"ds.cg.explain({FIELDS[job.fields] or 'None'}, {where})".replace("'", '"')
        said = ds.cg.explain(FIELDS[job.fields], **PLACES[job.place])
        lines = str(said).splitlines()
        short = "\n".join(
            line if len(line) <= LONGEST else f"{line[:LONGEST]} ..." for line in lines
        )
        parts.append(f"`{call}`\n\n```text\n{short}\n```")
    return "\n\n".join(parts)


def draw(table: pd.DataFrame) -> None:
    """Draw time, memory and spread by place, a line for each choice of fields."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    labels = {
        "time": "time, one thread (µs a grain)",
        "memory": "memory beside the scene (MB)",
        "spread": "spread of nodes about the box",
    }
    for ax, (column, label) in zip(axes, labels.items(), strict=True):
        for fields, part in table.groupby("fields", sort=False):
            if column == "spread" and fields == "all fields":
                continue  # the same as of stress
            shown = part[column].where(part[column] > 1e-10)
            ax.semilogy(range(len(PLACES)), shown, "o-", label=fields)
        ax.set_xticks(range(len(PLACES)), list(PLACES))
        ax.set_xlim(-0.3, len(PLACES) - 0.7)
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    axes[0].legend()
    axes[2].set_title("box: exact to rounding", fontsize="small")
    figure.savefig(PICTURE, dpi=90)
    plt.close(figure)


def main() -> None:
    """Measure, and write picture and page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--particles", type=int, default=100_000, help="grains of the packing")
    parser.add_argument("--repeats", type=int, default=5, help="runs of each job")
    given = parser.parse_args()
    warnings.simplefilter("ignore", xcg.SceneWarning)
    table = measure(given.particles, given.repeats)
    text = f"{rows(table)}\n\n{given.particles:,} grains, {machine()}."
    load = os.getloadavg()[0]
    if load > BUSY:
        text += f" The machine had other work (load {load:.1f}), so times are upper bounds."
    write_between("needs.md", "needs", text)
    write_between("needs.md", "explained", explained())
    draw(table)


if __name__ == "__main__":
    main()
