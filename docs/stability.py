"""Writes docs/stability.md and its picture: python -m docs.stability, from the root of the repository."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from tests.stability.cases import CASES
from tests.stability.physical import LIMITS

HERE = Path(__file__).parent
HEAD = """# Where methods fail

Cases in which a straightforward coarse-grainer returns wrong numbers without a word, and what xcg does. Every row is a
test (`tests/stability/`) that runs both methods; errors are relative to the size of the field. Made by
`python -m docs.stability`.

![Errors of the naive method and of xcg](_static/stability.png)

| case | what goes wrong | what xcg does | naive error | xcg | held to |
|---|---|---|---|---|---|
"""


PHYSICAL = """
## Physical limits

No method is right here: the scene does not hold what is asked for. What counts is that the result says so: the
[error of one frame](errors.md), the [bias of the width](width.md#bias), or NaN. Errors are root mean squares relative
to the field.

| case | what goes wrong | what xcg states | true error | stated |
|---|---|---|---|---|
"""


def main() -> None:
    results = [case() for case in CASES]
    rows = [
        f"| {c.what} | {c.fails} | {c.does} | {c.naive:.1e} | {c.ours:.1e} | {c.bound:.0e} |\n".replace(
            "|V| / |v'|", "V / v'"
        ).replace("|x - r|^2", "(x - r)^2")
        for c in results
    ]
    tail = (
        '\nWhere the answer is "unknown" (few grains, degenerate rows), any number counts as an error of 1, NaN with '
        "its count as none.\n"
    )
    limits = [limit() for limit in LIMITS]
    physical = [
        f"| {x.what} | {x.fails} | {x.says} | {100 * x.true:.2g} % | {100 * x.stated:.2g} % |\n" for x in limits
    ]
    (HERE / "stability.md").write_text(HEAD + "".join(rows) + tail + PHYSICAL + "".join(physical))
    figure, ax = plt.subplots(figsize=(8.5, 4.2), layout="constrained")
    y = np.arange(len(results))[::-1]
    floor = 1e-17
    ax.barh(y + 0.2, [max(c.naive, floor) for c in results], 0.38, left=floor, color="C3", label="naive")
    ax.barh(y - 0.2, [max(c.ours, floor) for c in results], 0.38, left=floor, color="C0", label="xcg")
    ax.plot([c.bound for c in results], y - 0.2, "k|", ms=9, label="held to")
    ax.set_xscale("log")
    ax.set_xlim(floor, None)
    ax.set_yticks(y, [c.what for c in results])
    ax.set_xlabel("error relative to the size of the field")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
    ax.grid(axis="x", alpha=0.3)
    figure.savefig(HERE / "_static" / "stability.png", dpi=130)


if __name__ == "__main__":
    main()
