"""Writes two tables of docs/stability.md and its picture: python -m docs.stability, from the root of the repository."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from docs.marks import write_between
from tests.stability.cases import CASES, Case
from tests.stability.physical import LIMITS

HERE = Path(__file__).parent
COLUMNS = "| case | what goes wrong | what xcg does | naive error | xcg | tolerance |"
HEAD = f"{{.numbers}}\n{COLUMNS}\n|---|---|---|---|---|---|\n"
LIMITS_HEAD = (
    "| case | what goes wrong | what xcg states | true error | stated |\n|---|---|---|---|---|\n"
)


def error_of(case: Case) -> str:
    """Return the error of xcg as text; NaN where nothing is known, and nothing is returned."""
    if case.unknown and case.ours == 0.0:
        return "NaN"
    return f"{case.ours:.1e}"


def main() -> None:
    results = [case() for case in CASES]
    rows = [
        f"| {c.what} | {c.fails} | {c.does} | {c.naive:.1e} | {error_of(c)} | {c.bound:.0e} |\n".replace(
            "|V| / |v'|", "V / v'"
        ).replace("|x - r|^2", "(x - r)^2")
        for c in results
    ]
    limits = [limit() for limit in LIMITS]
    physical = [
        f"| {x.what} | {x.fails} | {x.says} | {100 * x.true:.2g} % | {100 * x.stated:.2g} % |\n"
        for x in limits
    ]
    write_between("stability.md", "cases", HEAD + "".join(rows))
    write_between("stability.md", "limits", LIMITS_HEAD + "".join(physical))
    figure, ax = plt.subplots(figsize=(8.5, 4.2), layout="constrained")
    y = np.arange(len(results))[::-1]
    floor = 1e-17
    ax.barh(
        y + 0.2, [max(c.naive, floor) for c in results], 0.38, left=floor, color="C3", label="naive"
    )
    ours = ax.barh(
        y - 0.2,
        [max(c.ours, 2 * floor) for c in results],
        0.38,
        left=floor,
        color="C0",
        label="xcg",
    )
    for bar, case in zip(ours, results, strict=True):
        if error_of(case) == "NaN":
            bar.set_visible(False)
            text = "NaN, with its count: unknown"
        elif case.ours == 0.0:
            text = "exact"
        else:
            continue
        ax.text(3 * floor, bar.get_y() + 0.19, text, va="center", fontsize="small")
    ax.plot([c.bound for c in results], y - 0.2, "k|", ms=9, label="tolerance")
    ax.set_xscale("log")
    ax.set_xlim(floor, None)
    ax.set_yticks(y, [c.what for c in results])
    ax.set_xlabel("error relative to the size of the field")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
    ax.grid(axis="x", alpha=0.3)
    figure.savefig(HERE / "_static" / "stability.png", dpi=130)


if __name__ == "__main__":
    main()
