"""Time of the search for contacts over the number of levels: python -m docs.levels writes docs/_static/levels.png.

Shire, Hanley & Stratford found two or three levels to be best. One thread; processor time, the least of three runs.
"""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib as mpl

from docs.contact_speed import Packing, seconds
from xcg.analysis.pairs import find_pairs

mpl.use("agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parent / "_static" / "levels.png"
PARTICLES = 50_000
LEVELS = {3: range(1, 6), 10: range(1, 8), 30: range(2, 9)}  # by ratio of sizes


def times(kind: str, ratio: float, levels: range, particles: int = PARTICLES) -> dict[int, float]:
    """Return seconds a particle by number of levels, and under 0 with the default number."""
    packing = Packing.of(kind, ratio, particles)
    count = len(packing.radius)

    def search(number: int | None) -> float:
        def run() -> None:
            find_pairs(
                packing.position, packing.radius, packing.box, "xyz", levels=number, threads=1
            )

        return seconds(run, 3) / count

    return {0: search(None)} | {number: search(number) for number in levels}


def main() -> None:
    """Measure and draw; one line of JSON for each packing."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", sharey=True)
    for ax, kind in zip(axes, ("bidisperse", "series A"), strict=True):
        for colour, (ratio, levels) in enumerate(LEVELS.items()):
            packing = Packing.of(kind, ratio, PARTICLES)
            default = len(packing.lists(None).levels.largest)
            measured = times(kind, ratio, levels)
            print(json.dumps({"kind": kind, "ratio": ratio, "default": default} | measured))
            of_default = measured.pop(0)
            ax.semilogy(
                list(measured), [1e9 * t for t in measured.values()], "o-", color=f"C{colour}",
                label=f"ratio {ratio}",
            )  # fmt: skip
            ax.plot(default, 1e9 * of_default, "o", ms=12, mfc="none", color=f"C{colour}")
        ax.set(xlabel="number of levels", title=f"{kind} (rings: default)")
        ax.legend()
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("time a particle (ns), one thread")
    figure.savefig(PICTURE, dpi=90)


if __name__ == "__main__":
    main()
