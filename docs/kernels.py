"""Draw the kernels and their marginals: python docs/kernels.py, which writes docs/_static/kernels.png."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

import xcg

mpl.use("agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parent / "_static" / "kernels.png"
KERNELS = (xcg.Lucy, xcg.Gaussian, xcg.Heaviside)
COLOURS = ("C0", "C1", "C2")


def second_moment(kernel: xcg.Lucy | xcg.Gaussian | xcg.Heaviside) -> float:
    """Return the variance of a 3D kernel along one axis (m2), from its marginal in 1D."""
    x = np.linspace(-kernel.cutoff, kernel.cutoff, 20_001)
    return float(np.trapezoid(x**2 * kernel.value(x, seen=1), x))


def main() -> None:
    """Draw the 3D kernel, and the 3D kernel seen in 2D and in 1D: of one width above, of one variance below."""
    figure, axes = plt.subplots(2, 3, figsize=(11, 6.4), layout="constrained")
    spread = second_moment(xcg.Lucy(1.0, dimension=3))
    for kind, colour in zip(KERNELS, COLOURS, strict=True):
        of_width = kind(1.0, dimension=3)
        scale = np.sqrt(spread / second_moment(of_width))
        of_variance = kind(scale, dimension=3)
        for row, kernel in zip(axes, (of_width, of_variance), strict=True):
            # nodes on both sides of the cutoff, so that jumps are drawn upright
            edge = kernel.cutoff * np.array([1 - 1e-9, 1 + 1e-9])
            r = np.sort(np.concatenate([np.linspace(-3.4, 3.4, 1361), edge, -edge]))
            label = f"{kind.__name__}, $w$ = {kernel.width:.2f}, $c$ = {kernel.cutoff:.2f}"
            for ax, seen in zip(row, (3, 2, 1), strict=True):
                ax.plot(r, kernel.value(r, seen=seen), color=colour, lw=1.6, label=label)
    names = (r"$\Psi(r)$ in 3D", "its marginal in 2D", "its marginal in 1D")
    for row, of_what in zip(axes, ("equal width", "equal variance"), strict=True):
        for ax, name, power in zip(row, names, (3, 2, 1), strict=True):
            unit = "$1/w$" if power == 1 else f"$1/w^{power}$"
            ax.set_title(f"{name} [{unit}], {of_what}", fontsize="medium")
            ax.set_ylim(bottom=0)
            ax.grid(alpha=0.3)
        row[0].set_ylim(top=1.45 * row[0].get_ylim()[1])
        row[0].legend(fontsize="small", loc="upper center")
    for ax in axes[1]:
        ax.set_xlabel("$r$ over the width of Lucy's kernel")
    figure.savefig(PICTURE, dpi=90)


if __name__ == "__main__":
    main()
