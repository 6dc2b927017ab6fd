"""Measures what saving costs, and writes the table in docs/saving.md.

Run from the root of the repository, on a machine that does nothing else::

    python -m docs.saving [--particles 100000]
"""

from __future__ import annotations

import argparse
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import xarray as xr

import xcg
from docs.accuracy import fastest
from docs.marks import write_between

WAYS: dict[str, dict[str, Any]] = {
    "default": {},
    "`compression=1`": {"compression": 1},
    '`dtype="float32"`': {"dtype": "float32"},
    '`dtype="float32", compression=0`': {"dtype": "float32", "compression": 0},
    "`digits=4`": {"digits": 4},
    '`digits=4, dtype="float32"`': {"digits": 4, "dtype": "float32"},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--particles", type=int, default=100_000, help="grains of the packing (default 100000)"
    )
    parser.add_argument(
        "--repeats", type=int, default=5, help="times that each case is run (default 5)"
    )
    given = parser.parse_args()
    ds = xcg.datasets.dense_packing(given.particles)
    fields = ds.cg.coarse_grain()
    with tempfile.TemporaryDirectory() as folder:

        def save(suffix: str, options: dict[str, Any]) -> Path:
            return xcg.save(fields, Path(folder) / f"f{suffix}", overwrite=True, **options)

        cases = [
            partial(save, suffix, options)
            for suffix in (".nc", ".zarr")
            for options in WAYS.values()
        ]
        cases += [partial(ds.cg.coarse_grain), partial(by_xarray, fields, Path(folder) / "x.nc")]
        times = fastest(cases, given.repeats)
        sizes = [size_of(case()) for case in cases[: 2 * len(WAYS)]]
    count = len(WAYS)
    computing = times[2 * len(WAYS)]
    lines = ["| way | NetCDF (s) | Zarr (s) | size |", "|---|---|---|---|"]
    for k, name in enumerate(WAYS):
        lines.append(
            f"| {name} | {times[k]:.2f} | {times[count + k]:.2f} | {sizes[k] / fields.nbytes:.0%} |"
        )
    lines.append(f"| xarray's `to_netcdf(encoding={{... zlib level 1}})` | {times[-1]:.2f} | | |")
    lines.append(f"| for comparison: computing the fields | {computing:.2f} | | |")
    write_between("saving.md", "table", "\n".join(lines))
    print("\n".join(lines))


def by_xarray(fields: xr.Dataset, path: Path) -> None:
    packed = {"zlib": True, "complevel": 1, "shuffle": True}
    fields.to_netcdf(path, encoding=dict.fromkeys(map(str, fields.data_vars), packed))


def size_of(path: Path) -> int:
    return (
        sum(p.stat().st_size for p in path.rglob("*") if p.is_file())
        if path.is_dir()
        else path.stat().st_size
    )


if __name__ == "__main__":
    main()
