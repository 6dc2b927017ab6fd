"""Force chains of nine grains: python docs/nine_grains.py writes docs/_static/nine_grains.png.

The case of figure 4 of Force Chain Finder (Ejtehadi et al. 2024): equal forces at all contacts of a square of nine
grains, but for that of grains 5 and 6, where there is none.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import xarray as xr

import xcg

mpl.use("agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parent / "_static" / "nine_grains.png"
ROWS = [(1, 2), (2, 3), (4, 5), (7, 8), (8, 9)]  # of which that of 5 and 6 is missing
COLUMNS = [(1, 4), (4, 7), (2, 5), (5, 8), (3, 6), (6, 9)]
CASES = {
    r"all links, $\alpha$ = 90°": {"alpha": 90},
    r"$\alpha$ = 45°": {"alpha": 45},
    r"Peters' rule, $\alpha$ = 90°": {"alpha": 90, "algorithm": "peters2005"},
}


def nine_grains(along_rows: float = 1.0, turn: float = 0.0) -> xr.Dataset:
    """Return the square, with forces of 1 in columns and others in rows, turned by an angle (degrees)."""
    angle = np.deg2rad(turn)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    places = np.array([(k % 3, k // 3) for k in range(9)], float) @ axes
    position = np.column_stack([places, np.zeros(9)])
    pairs = np.array(ROWS + COLUMNS) - 1
    force = np.array([along_rows] * len(ROWS) + [1.0] * len(COLUMNS))
    branch = position[pairs[:, 0]] - position[pairs[:, 1]]
    return xcg.scene_from_arrays(
        position,
        particle_id=np.arange(1, 10),
        diameter=1.0,
        density=1.0,
        contact_i=pairs[:, 0] + 1,
        contact_j=pairs[:, 1] + 1,
        contact_force=force[:, None] * branch,
        dimension=2,
        thickness=1.0,
    )


def chains(fc: xr.Dataset) -> list[tuple[int, ...]]:
    """Return the grains of each chain of the only step."""
    step = fc.isel(time=0)
    return [
        tuple(step.particle_id.values[step.chain_id.values == k].tolist())
        for k in range(int(step.chain_count))
    ]


def draw(ax: plt.Axes, ds: xr.Dataset, fc: xr.Dataset) -> None:
    """Draw the chains over the contacts, with the numbers of the grains and their major axes."""
    fc.cg.plot_chains(color="chain", ax=ax)
    position = ds.position.values[0, :, :2]
    for i, j in ROWS + COLUMNS:
        ax.plot(*position[[i - 1, j - 1]].T, color="0.5", lw=1, ls=":", zorder=0.5)
    direction = fc.major_direction.values[0, :, :2]
    axis = 0.3 * np.nan_to_num(direction)
    for k, (x, y) in enumerate(position):
        ax.plot([x - axis[k, 0], x + axis[k, 0]], [y - axis[k, 1], y + axis[k, 1]], "k", lw=1)
        ax.annotate(str(k + 1), (x - 0.28, y + 0.22), fontsize=10)


def main() -> None:
    """Print the chains of each case in three frames, and draw one frame."""
    figure, axes = plt.subplots(2, 3, figsize=(10.5, 7), layout="constrained")
    for row, (along_rows, forces) in zip(
        axes, {1.0: "equal forces", 1.01: "1 % more along rows"}.items(), strict=True
    ):
        for ax, (name, options) in zip(row, CASES.items(), strict=True):
            results = [nine_grains(along_rows, turn) for turn in (0, 1, 30)]
            found = [chains(ds.cg.force_chains(**options).compute()) for ds in results]
            print(
                f"{forces}, {options}: {found[0]}, equal in other frames: {found[1:] == found[:1] * 2}"
            )
            fc = results[0].cg.force_chains(**options).compute()
            draw(ax, results[0], fc)
            ax.set_title(f"{forces}\n{name}, chains: {len(found[0])}", fontsize="medium")
    figure.savefig(PICTURE, dpi=90)


if __name__ == "__main__":
    main()
