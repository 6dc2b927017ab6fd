"""Figures of the quasi-static study beside those of the paper: python -m docs.quasi_static_figures.

Writes docs/_static/quasi_static.png and quasi_static_forces.png from the tables in examples/quasi_static/results.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "quasi_static"))
import summary

mpl.use("agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).parents[1]
STATIC = ROOT / "docs" / "_static"
SIZES = {"dmax": "$d_{max}$", "d50": "$d_{50}$", "dbar": r"$\bar d$, by volume"}
FIELDS = {"stress_ratio": r"$\eta$", "volume_fraction": r"$\phi$", "z_mech": "$Z_{mech}$"}
RUNS = ("0.01", "0.001", "0.0003", "0.0001")  # inertial numbers with d50
COLOURS = ("C3", "C1", "C2", "C0")
MARKERS = ("D", "s", "^", "o")


def draw_limits(path: Path) -> None:
    """Draw each quantity over its value at 1e-3 against the inertial number with each size."""
    values = summary.steady(summary.load(ROOT / "examples/quasi_static/results")["history"])
    figure, axes = plt.subplots(3, 3, figsize=(11, 8.5), sharey="row", layout="constrained")
    for row, (name, label) in zip(axes, FIELDS.items(), strict=True):
        for ax, (size, in_words) in zip(row, SIZES.items(), strict=True):
            packings = summary.normalised(values, name).groupby("ratio")
            for (ratio, table), marker in zip(packings, "os^", strict=True):
                ax.errorbar(
                    table[f"inertial_{size}"], table.value, table.error, marker=marker, ms=5,
                    capsize=2, lw=1, label=rf"$\chi$ = {ratio:g}",
                )  # fmt: skip
            ax.axhline(1, color="0.6", lw=0.8)
            ax.set_xscale("log")
            ax.set_xlabel(f"inertial number with {in_words}")
            ax.grid(alpha=0.3)
        row[0].set_ylabel(f"{label} over its value at $I$ = 0.001")
    axes[0, 0].axhline(0.846, color="black", ls=":", lw=1, label="paper: B20 at $I$ = 1e-6")
    axes[0, 0].legend(fontsize="small")
    figure.savefig(path, dpi=90)
    plt.close(figure)


def draw_forces(path: Path) -> None:
    """Draw distributions of normal forces and of partners by the inertial number."""
    tables = summary.load(ROOT / "examples/quasi_static/results")
    partners = tables["connectivity"]
    ratios = sorted(tables["forces"].ratio.unique())
    drawn = sorted(partners.ratio.unique())
    figure, axes = plt.subplots(2, 3, figsize=(12, 7.5), layout="constrained")
    for ax, ratio in zip(axes[0], ratios, strict=True):
        of_ratio = tables["forces"][tables["forces"].ratio == ratio]
        for run, colour, marker in zip(RUNS, COLOURS, MARKERS, strict=True):
            table = of_ratio[of_ratio.run == run]
            if table.empty:
                continue
            density = table.contacts / table.contacts.sum() / (table.high - table.low)
            middle = np.sqrt(table.low * table.high)
            seen = density.where(density > 0)
            ax.loglog(middle, seen, marker, ls="-", ms=3, color=colour, label=f"$I$ = {run}")
        ax.set_title(rf"normal forces, $\chi$ = {ratio:g}")
        ax.set(xlabel=r"$f / \langle f \rangle$", ylabel="probability density", ylim=(1e-5, 8))
        ax.legend(fontsize="small")
        ax.grid(alpha=0.3)
    for ax, ratio in zip(axes[1], drawn, strict=False):
        for run, colour, marker in zip(RUNS, COLOURS, MARKERS, strict=True):
            table = partners[(partners.ratio == ratio) & (partners.run == run)]
            if table.empty:
                continue
            share = table.share.where(table.share > 0)
            ax.plot(table.partners, share, marker, ls="-", ms=3, color=colour, label=f"$I$ = {run}")
        ax.set_title(rf"connectivity, $\chi$ = {ratio:g}")
        ax.set(
            xlabel="contacts of a grain", ylabel="share of grains", yscale="log", xlim=(-0.5, 24)
        )
        ax.legend(fontsize="small")
        ax.grid(alpha=0.3)
    for ax in axes[1, len(drawn) :]:
        ax.axis("off")
    figure.savefig(path, dpi=90)
    plt.close(figure)


def main() -> None:
    """Draw both figures."""
    draw_limits(STATIC / "quasi_static.png")
    draw_forces(STATIC / "quasi_static_forces.png")


if __name__ == "__main__":
    main()
