"""Residuals of the identities that hold on any scene, for the sample data: writes a table of docs/stability.md.

Run from the root of the repository::

    python -m docs.residuals
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

from docs.marks import write_between
from tests import real_data
from tests.identities import residuals
from tests.identities.scenes import OPEN, Case

STATIC = ("liggghts_box",)


def columns(name: str) -> dict[str, Callable[[Case], str]]:
    """What to compute for a scene, by heading."""

    def number(residual: residuals.Residual) -> str:
        return f"{residual.relative:.0e}"

    def static(case: Case) -> tuple[str, str]:
        left, unexplained, _ = residuals.static_equilibrium(case.ds, case.width, case.points)
        return (number(left) if name in STATIC else "–", number(unexplained))

    return {
        "mass": lambda c: number(residuals.mass(c.ds, c.width)),
        "continuity": lambda c: number(residuals.continuity(c.ds, c.width, c.points)),
        "stress": lambda c: number(residuals.stress_divergence(c.ds, c.width, c.points)),
        "stress by quadrature": lambda c: number(
            residuals.stress_divergence(c.ds, c.width, c.points, rtol=1e-2)
        ),
        "periodicity": lambda c: number(residuals.periodicity(c.ds, c.width, c.points)),
        "marginals": lambda c: number(residuals.marginals(c.ds, c.width, c.points[0])),
        "virial": lambda c: number(residuals.virial(c.ds, c.width)),
        "equilibrium": lambda c: static(c)[0],
        "unexplained": lambda c: static(c)[1],
    }


def table(count: int) -> str:
    """Return the table in markdown: a row for each scene."""
    heads = ["scene", *columns("")]
    lines = ["{.numbers}", "| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name, opened in OPEN.items():
        case = Case.of(name, opened(real_data(name)), count=count)
        row = [name, *(compute(case) for compute in columns(name).values())]
        lines.append("| " + " | ".join(row) + " |")
        print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--points", type=int, default=5, help="points a scene (default 5)")
    given = parser.parse_args()
    write_between("stability.md", "residuals", table(given.points))


if __name__ == "__main__":
    main()
