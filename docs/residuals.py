"""Residuals of the identities that hold on any scene, for the sample data: writes docs/residuals.md.

Run from the root of the repository, with the folder of the sample data::

    python -m docs.residuals DATA
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from tests.identities import residuals
from tests.identities.scenes import OPEN, Case

STATIC = ("lammps_polydisperse", "liggghts_box", "yade_periodic")
HEAD = """# Residuals of the identities

Some identities hold on any scene, whatever made it, and need no reference data. This table gives the largest residual
of each on one step of each folder of sample data, for Lucy's kernel of half-width 0.75 d43 and closed forms, at {count}
points near contacts (one across a periodic edge and one at a wall, where there are any). Residuals are in units of the
terms that must cancel. What is left is rounding, and the error of the finite differences and sums over nodes that
stand in for exact derivatives and integrals here. *Equilibrium* is for packings at rest: how far the field is
from equilibrium, which says how static the *data* are. *Unexplained* is what is not explained by the resultants
F + m g of the grains, at rest or not.

Made by `python -m docs.residuals DATA`, with `DATA` the folder of the sample data (two of the scenes ship in
`examples/data`). They are from LAMMPS, MFiX, LIGGGHTS (`force_chain_finder` too) and YADE, but for a synthetic one in
the format of MercuryDPM.

"""
NOTES = """
- **Mass**: the integral of rho over the whole support is the mass of the grains.
- **Continuity**: the exact rate of rho, -sum m v . grad Psi, is -div p.
- **Stress**: div sigma^c = -sum F Psi + t, with F the total contact force on a grain and t the traction of walls.
  Beside it, the same with a quadrature of rtol = 1e-2 in place of the closed form.
- **Equilibrium**: div sigma - rho g - t = 0 where nothing moves.
- **Periodicity**: shifting all grains by any vector, and wrapping them, shifts all fields.
- **Marginals**: a field averaged over an axis is the integral of the field along it.
- **Virial**: the integral of sigma^c is sum f a over both sides of all contacts.
"""


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
        "stress by quadrature": lambda c: number(residuals.stress_divergence(c.ds, c.width, c.points, rtol=1e-2)),
        "periodicity": lambda c: number(residuals.periodicity(c.ds, c.width, c.points)),
        "marginals": lambda c: number(residuals.marginals(c.ds, c.width, c.points[0])),
        "virial": lambda c: number(residuals.virial(c.ds, c.width)),
        "equilibrium": lambda c: static(c)[0],
        "unexplained": lambda c: static(c)[1],
    }


def table(data: Path, count: int) -> str:
    """Return the table in markdown: a row for each folder that is there."""
    heads = ["scene", *columns("")]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name, opened in OPEN.items():
        if not (data / name).is_dir():
            print(f"{name}: not in {data}, left out")
            continue
        case = Case.of(name, opened(data / name), count=count)
        row = [name, *(compute(case) for compute in columns(name).values())]
        lines.append("| " + " | ".join(row) + " |")
        print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("data", type=Path, help="folder of the sample data, with one folder a scene")
    parser.add_argument("--points", type=int, default=5, help="points a scene (default 5)")
    given = parser.parse_args()
    out = Path(__file__).with_name("residuals.md")
    out.write_text(HEAD.format(count=given.points) + table(given.data, given.points) + NOTES)


if __name__ == "__main__":
    main()
