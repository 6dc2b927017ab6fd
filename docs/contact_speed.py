"""Time of the search for contacts against the ratio of sizes: prints the table of docs/accuracy.md, draws its chart.

pip install . --group benchmark; python docs/contact_speed.py [--quick]

One thread; processor time, the least of several runs. Methods that would take minutes search for a share of the
particles, spread evenly, and that time is scaled up; those numbers are marked with a tilde.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from xcg.analysis.pairs import CellLists, find_pairs

PHI = 0.6
RATIOS = (1, 2, 3, 5, 10, 20, 50, 100)
MOST_TESTS = 1e9  # of one run
NAMES = {
    "hierarchical": "hierarchical",
    "linked": "linked cells",
    "tree": "cKDTree",
    "freud": "freud",
}


@dataclass(frozen=True)
class Packing:
    """Random points in a periodic cube, as spheres of a given size distribution at a volume fraction of 0.6."""

    position: NDArray
    radius: NDArray
    edge: float

    @classmethod
    def of(cls, kind: str, ratio: float, count: int) -> Packing:
        """ "bidisperse": equal volumes of both sizes; "series A": equal volume for each interval of log d."""
        rng = np.random.default_rng(0)
        count = max(count, int(ratio**3) + 1)
        if kind == "bidisperse":
            large = round(count / (1 + ratio**3)) if ratio > 1 else 0
            radius = np.where(np.arange(count) < large, float(ratio), 1.0)
        else:
            radius = (1 - (np.arange(count) + 0.5) / count * (1 - ratio**-3.0)) ** (-1 / 3)
            radius[-1] = ratio
        edge = float((4 / 3 * np.pi * (radius**3).sum() / PHI) ** (1 / 3))
        return cls(rng.uniform(0, edge, (count, 3)), rng.permutation(radius), edge)

    @property
    def box(self) -> list[tuple[float, float]]:
        """Edges of the box."""
        return [(0.0, self.edge)] * 3

    def lists(self, levels: int | None) -> CellLists:
        """Cell lists with so many levels."""
        return CellLists.of(
            self.position, self.radius, np.zeros(3), np.full(3, self.edge), skin=0.0, levels=levels
        )


@dataclass(frozen=True)
class Measured:
    """Seconds a particle, whether scaled up from a share, and distances computed a particle."""

    time: float
    scaled: bool = False
    tested: float = np.nan


def seconds(run: Callable[[], object], repeat: int) -> float:
    """Least processor time of several runs."""
    best = np.inf
    for _ in range(repeat):
        start = time.process_time()
        run()
        best = min(best, time.process_time() - start)
    return best


def ours(packing: Packing, levels: int | None, repeat: int) -> Measured:
    """`find_pairs`, whole, or cell lists and a share of the search."""
    count = len(packing.radius)
    lists = packing.lists(levels)
    probe = [
        lists.find(first, first + 10)[2] for first in np.linspace(0, count - 10, 20, dtype=int)
    ]
    expected = sum(probe) / 200 * count
    if expected < MOST_TESTS:

        def run() -> object:
            return find_pairs(
                packing.position, packing.radius, packing.box, "xyz", levels=levels, threads=1
            )

        return Measured(
            seconds(run, repeat if expected < MOST_TESTS / 10 else 1) / count,
            False,
            lists.find(0, count)[2] / count,
        )
    blocks = np.linspace(
        0, count - 10, max(20, int(MOST_TESTS / (expected / count) / 10)), dtype=int
    )
    tests = 0

    def share() -> None:
        nonlocal tests
        tests = sum(lists.find(first, first + 10)[2] for first in blocks)

    part = seconds(share, 1) / (10 * len(blocks))
    sort = seconds(lambda: packing.lists(1), 1) / count
    return Measured(sort + part, True, tests / (10 * len(blocks)))


def tree(packing: Packing, repeat: int) -> Measured:
    """scipy.spatial.cKDTree the faster of two ways: all pairs within the largest diameter, or for each particle its
    partners that are no larger, which lie within its own diameter."""
    from scipy.spatial import cKDTree

    x = packing.position
    r = packing.radius
    count = len(r)
    times = [seconds(lambda: cKDTree(x, boxsize=packing.edge).query_ball_point(x, 2 * r), 1)]
    within = count**2 / 2 * 4 / 3 * np.pi * (2 * r.max() / packing.edge) ** 3
    if within < 3e7:

        def run() -> NDArray:
            i, j = (
                cKDTree(x, boxsize=packing.edge).query_pairs(2 * r.max(), output_type="ndarray").T
            )
            return _touching(packing, i, j)

        times.append(seconds(run, repeat))
    return Measured(min(times) / count)


def _touching(packing: Packing, i: NDArray, j: NDArray) -> NDArray:
    d = packing.position[i] - packing.position[j]
    d -= packing.edge * np.rint(d / packing.edge)
    near = (d * d).sum(axis=1) < (packing.radius[i] + packing.radius[j]) ** 2
    return np.column_stack([i[near], j[near]])


def with_freud(packing: Packing, repeat: int) -> Measured | None:
    """freud's AABBQuery (its LinkCell takes minutes); None where freud is absent or can't reach past half the box."""
    try:
        import freud
    except ImportError:
        return None
    freud.parallel.set_num_threads(1)
    x = packing.position - packing.edge / 2
    r = packing.radius
    reach = 2 * float(r.max())
    count = len(r)
    if reach >= packing.edge / 2:
        return None
    within = count**2 * 4 / 3 * np.pi * (reach / packing.edge) ** 3
    some = np.linspace(0, count - 1, min(count, max(100, int(2e6 / within * count))), dtype=int)
    box = freud.box.Box.cube(packing.edge)

    def query() -> NDArray:
        pairs = freud.locality.AABBQuery(box, x).query(x[some], {"r_max": reach}).toNeighborList()
        i = some[pairs.query_point_indices]
        j = pairs.point_indices.astype(int)
        return _touching(packing, i[i < j], j[i < j])

    build = seconds(lambda: freud.locality.AABBQuery(box, x), repeat)
    return Measured(
        (build + (seconds(query, repeat) - build) * count / len(some)) / count, len(some) < count
    )


def measure(kind: str, count: int, ratios: tuple[int, ...], repeat: int) -> list[dict]:
    """One row a ratio."""
    rows = []
    for ratio in ratios:
        packing = Packing.of(kind, ratio, count)
        pairs = find_pairs(packing.position, packing.radius, packing.box, "xyz", threads=1)
        row = {
            "ratio": ratio,
            "count": len(packing.radius),
            "pairs": len(pairs) / len(packing.radius),
            "levels": len(packing.lists(None).levels.largest),
            "hierarchical": ours(packing, None, repeat),
            "linked": ours(packing, 1, repeat),
            "tree": tree(packing, min(repeat, 2)),
            "freud": with_freud(packing, min(repeat, 2)),
        }
        rows.append(row)
        print(line(row), flush=True)
    return rows


COLUMNS = (
    "dmax/dmin",
    "particles",
    "levels",
    "pairs",
    "tested",
    "tested, linked cells",
    "time",
    *list(NAMES.values())[1:],
)
HEAD = f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}"


def line(row: dict) -> str:
    """One line of the table: time of the hierarchical search in ns a particle, of the others relative to it."""
    own = row["hierarchical"]
    times = []
    for name in ("linked", "tree", "freud"):
        m = row[name]
        digits = "-" if m is None else f"{'~' * m.scaled}{_three(m.time / own.time)} x"
        times.append(digits)
    return (
        f"| {row['ratio']} | {row['count']} | {row['levels']} | {row['pairs']:.2f} | {_three(own.tested)} | "
        f"{_three(row['linked'].tested)} | {_three(own.time * 1e9)} | " + " | ".join(times) + " |"
    )


def _three(value: float) -> str:
    """Three significant digits, without an exponent."""
    return f"{float(f'{value:.3g}'):.12g}"


def draw(results: dict[str, list[dict]], path: Path) -> None:
    """Time a particle against the ratio of sizes, one panel a distribution."""
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        1, len(results), figsize=(10, 4.2), sharey=True, layout="constrained"
    )
    colours = {"hierarchical": "C0", "linked": "C3", "tree": "C1", "freud": "C2"}
    markers = {"hierarchical": "o", "linked": "s", "tree": "^", "freud": "D"}
    for panel, (kind, rows) in zip(panels, results.items(), strict=True):
        for name, label in NAMES.items():
            known = [(row["ratio"], row[name]) for row in rows if row[name] is not None]
            x = [ratio for ratio, _ in known]
            y = [m.time * 1e9 for _, m in known]
            panel.plot(
                x, y, markers[name], ls="-", ms=5, color=colours[name], label=label,
                lw=2 if name == "hierarchical" else 1.3,
            )  # fmt: skip
            for ratio, m in known:
                if m.scaled:
                    panel.plot(
                        ratio, m.time * 1e9, markers[name], color=colours[name], mfc="white", ms=5
                    )
        panel.set(xscale="log", yscale="log", title=kind, xlabel="largest over smallest diameter")
        panel.set_xticks(RATIOS, [str(r) for r in RATIOS])
        panel.minorticks_off()
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("time a particle (ns), one thread")
    panels[0].legend(frameon=False)
    figure.savefig(path, dpi=130)


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="20 000 particles, ratios to 10, no picture"
    )
    quick = parser.parse_args().quick
    results = {}
    for kind in ("bidisperse", "series A"):
        print(f"\n{kind}\n\n{HEAD}")
        results[kind] = (
            measure(kind, 20_000, RATIOS[:5], 2) if quick else measure(kind, 100_000, RATIOS, 4)
        )
    if not quick:
        draw(results, Path(__file__).parent / "_static" / "contact_speed.png")


if __name__ == "__main__":
    main()
