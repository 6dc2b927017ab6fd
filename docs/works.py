"""Write the packings beside Table 1 of Shire, Hanley & Stratford into docs/works.md: python -m docs.works."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from docs.marks import write_between

RESULTS = Path(__file__).parents[1] / "examples" / "quasi_static" / "results"
# dmax / dmin: number of grains, phi0, Z0, Zmech0 of samples A1.2, A2 and A5
TABLE_1 = {
    1.2: (21052, 0.604, 5.23, 5.43),
    2.0: (45500, 0.637, 5.03, 5.43),
    5.0: (202606, 0.672, 4.17, 5.39),
}
COLUMNS = ("volume_fraction", "coordination_number", "z_mech")


def table() -> str:
    """Return a row for each size ratio: grains, phi0, Z0 and Zmech0 of the paper and of the first frame here."""
    history = pd.read_csv(RESULTS / "history.csv", dtype={"run": str})
    first = history[history.run == "prior"].groupby("ratio").first()
    grains = pd.read_csv(RESULTS / "runs.csv").groupby("ratio").particles.first()
    heads = ["$\\chi$", "grains", "", "$\\phi_0$", "", "$Z_0$", "", "$Z_{mech,0}$", ""]
    of_whom = [" ", *["paper", "xcg"] * 4]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", f"| {' | '.join(of_whom)} |"]
    for ratio, (count, *paper) in TABLE_1.items():
        cells = [f"{ratio:g}", f"{count}", f"{grains[ratio]}"]
        for value, name, digits in zip(paper, COLUMNS, (3, 2, 2), strict=True):
            cells += [f"{value:.{digits}f}", f"{first[name][ratio]:.{digits}f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    write_between("works.md", "table 1", table())
