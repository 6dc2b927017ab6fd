"""Fields of a crystal against the width of the kernel: writes docs/_static/width_study.png.

In a face-centred cubic lattice the volume fraction and the stress are known in closed form. Narrow kernels show
single grains, wide ones the plateau; how wide is wide enough depends on the kernel. Points are quasi-random.
Run from the root of the repository::

    python -m docs.width_study
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from scipy.stats.qmc import Sobol

import xcg
from tests.flows import sine

mpl.use("Agg")
from matplotlib import pyplot as plt

DIAMETER, BOND, FORCE = 1.0, 0.98, 1.0
VOLUME_FRACTION = np.pi / (3 * np.sqrt(2)) * (DIAMETER / BOND) ** 3
PRESSURE = 2 * np.sqrt(2) * FORCE / BOND**2
KERNELS = {"heaviside": "tab:green", "lucy": "tab:blue", "gaussian": "tab:orange"}
WIDTHS = np.geomspace(0.3, 3.0, 21)
POINTS = 128


def sweep(ds, kernel: str, width: float, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Volume fraction and pressure at points."""
    found = [
        ds.cg.coarse_grain(
            ["volume_fraction", "pressure"],
            kernel=kernel,
            width=width,
            axes="",
            at=dict(zip("xyz", point, strict=True)),
        )
        for point in points.tolist()
    ]
    return np.array([f.volume_fraction.item() for f in found]), np.array(
        [f.pressure.item() for f in found]
    )


def main() -> None:
    ds = xcg.datasets.face_centred_cubic(2, diameter=DIAMETER, bond=BOND, force=FORCE)
    edge = ds.attrs["box_upper"][0]
    points = edge * Sobol(3, rng=0).random(POINTS)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4), layout="constrained", sharex=True)
    for kernel, colour in KERNELS.items():
        values = np.array(
            [sweep(ds, kernel, w * DIAMETER, points) for w in WIDTHS]
        )  # width, field, point
        for k, axes in enumerate((left, right)):
            low = values[:, k].min(axis=1)
            high = values[:, k].max(axis=1)
            axes.fill_between(WIDTHS, low, high, color=colour, alpha=0.15, lw=0)
            for edge_of_band in (low, high):
                axes.plot(WIDTHS, edge_of_band, color=colour, lw=0.6)
            axes.plot(WIDTHS, values[:, k].mean(axis=1), color=colour, label=kernel.title())
        spread = np.ptp(values, axis=2) / values.mean(axis=2)
        for target in (0.75, 1.5, 3.0):
            nearest = np.abs(WIDTHS - target).argmin()
            print(
                f"{kernel:10s} w = {WIDTHS[nearest]:.2f} d: (max - min) / mean = {spread[nearest].round(5)}"
            )
    for axes, exact, name in (
        (left, VOLUME_FRACTION, "volume fraction"),
        (right, PRESSURE, r"pressure [$f / d^2$]"),
    ):
        axes.axhline(exact, color="black", lw=1, ls="--", label="exact")
        axes.set(
            xlabel="width over diameter, $w / d$", ylabel=name, xscale="log", ylim=(0, 2.2 * exact)
        )
        axes.set_xticks(
            [0.3, 0.5, 0.75, 1, 1.5, 2, 3], ["0.3", "0.5", "0.75", "1", "1.5", "2", "3"]
        )
        axes.minorticks_off()
    left.legend(title=f"mean, min and max\nover {POINTS} points")
    folder = Path(__file__).with_name("_static")
    folder.mkdir(exist_ok=True)
    figure.savefig(folder / "width_study.png", dpi=150)
    figure, axes = plt.subplots(figsize=(5.5, 3.6), layout="constrained")
    sine(60).scene.cg.choose_width("velocity", axes="z", frames=20, sample=16).cg.plot_width(axes)
    figure.savefig(folder / "choose_width.png", dpi=130)


if __name__ == "__main__":
    main()
