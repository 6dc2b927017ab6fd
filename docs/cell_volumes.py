"""Writes the table of docs/cfd_dem.md: python -m docs.cell_volumes. Volume fractions of cells, exact and by kernels."""

import warnings

import xcg
from docs.marks import write_between


def table() -> list[str]:
    """Mean and scatter of the volume fraction over cells of several sizes, in diameters."""
    ds = xcg.datasets.dense_packing(20_000)
    d = float(ds.attrs["d43"])
    rows = [
        "| h / d | exact | kernel, w = 0.5 d | kernel, w = 0.75 d | kernel, w = 1.5 d |",
        "|---|---|---|---|---|",
    ]
    for size in (0.5, 1.0, 2.0, 4.0):
        exact = ds.cg.cell_volumes(size * d).volume_fraction
        found = [f"{float(exact.mean()):.4f} ± {float(exact.std()):.3f}"]
        for width in (0.5, 0.75, 1.5):
            options = {"spacing": size * d, "width": width * d}
            phi = ds.cg.coarse_grain("volume_fraction", **options).volume_fraction
            found.append(f"{float(phi.mean()):.4f} ± {float(phi.std()):.3f}")
        rows.append(f"| {size:g} | " + " | ".join(found) + " |")
    return rows


def main() -> None:
    """Put the table between its marks."""
    warnings.simplefilter("ignore")
    write_between("cfd_dem.md", "cells", "\n".join(table()))


if __name__ == "__main__":
    main()
