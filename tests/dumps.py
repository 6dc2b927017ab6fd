"""Small dumps in the format of LAMMPS, for tests of readers."""

from __future__ import annotations

import gzip
from collections.abc import Iterable, Sequence
from pathlib import Path

BOX = "ITEM: BOX BOUNDS pp pp ff\n0 10\n0 10\n-1 9\n"
ATOMS = "id type x y z vx vy vz radius mass"
ROWS = ["3 2 3 3 0.5 0 0 0 0.5 1", "1 1 1 1 1 0.1 0.2 0.3 0.5 1", "2 1 1.9 1 1.5 0 0 0 0.5 1"]
PAIRS = "id1 id2 fnx fny fnz ftx fty ftz"
PAIR_ROWS = ["1 2 -9 0 0 0 1 0"]


def dump_text(
    rows: Sequence[str] = ROWS,
    columns: str = ATOMS,
    *,
    step: int = 0,
    label: str = "ATOMS",
    before: str = "",
    box: str = BOX,
    count: int | None = None,
) -> str:
    """One step of a dump, in SI unless `before`, items ahead of the time step, says otherwise."""
    before = before if "UNITS" in before else f"ITEM: UNITS\nsi\n{before}"
    head = f"{before}ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF {label}\n{len(rows) if count is None else count}\n"
    return f"{head}{box}ITEM: {label} {columns}\n" + "".join(f"{row} \n" for row in rows)


def pairs_text(rows: Sequence[str] = PAIR_ROWS, columns: str = PAIRS, **options: object) -> str:
    """One step of a local dump."""
    return dump_text(rows, columns, label="ENTRIES", **options)  # type: ignore[arg-type]


def write(path: Path, text: str | Iterable[str]) -> Path:
    """Write text, or texts one after the other; gzipped where the name says so."""
    data = (text if isinstance(text, str) else "".join(text)).encode()
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)
    return path


def write_series(
    folder: Path, steps: Sequence[int] = (0, 10, 20), before: str = ""
) -> tuple[str, str]:
    """Write one file a step of particles and of contacts; return their globs."""
    for step in steps:
        item = before.format(time=step / 10)
        write(folder / f"p.{step}.dump", dump_text(step=step, before=item))
        write(folder / f"c.{step}.dump", pairs_text(step=step, before=item))
    return str(folder / "p.*.dump"), str(folder / "c.*.dump")
