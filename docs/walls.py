"""Pressure on the side of a silo beside Janssen's formula: docs/_static/silo.png and the figures of docs/walls.md.

Run from anywhere::

    python docs/walls.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import xarray as xr
from scipy.optimize import curve_fit

import xcg

mpl.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).parents[1]
DATA = ROOT / "examples" / "data" / "lammps_silo"
RADIUS, GRAVITY = 0.025, 9.81
SIDE = xcg.Cylinder((0, 0, 0), (0, 0, 1), RADIUS, low=0.0, high=0.24)
FLOOR = xcg.Plane((0, 0, 0), (0, 0, 1))


def scene() -> xr.Dataset:
    """Grains at rest in a cylinder, with its side and its floor apart."""
    return xcg.open_scene(
        DATA / "particles.dump.gz",
        contacts=DATA / "contacts.dump.gz",
        walls={"side": "f_side[*]", "floor": "f_floor[*]"},
        gravity=(0, 0, -GRAVITY),
    ).compute()


def janssen(depth: np.ndarray, k: float, length: float, load: float) -> np.ndarray:
    """Normal stress K sigma_z on the side, sigma_z = rho g l (1 - exp(-h / l)), l = R / (2 K mu); Janssen (1895)."""
    return k * load * length * (1 - np.exp(-depth / length))


def main() -> None:
    """Draw and print."""
    ds = scene()
    side = ds.cg.wall_stress(SIDE, "1 d43", walls="side").isel(time=0)
    floor = ds.cg.wall_stress(FLOOR, "1 d43", walls="floor").isel(time=0)
    inside = ds.cg.coarse_grain(
        ["volume_fraction", "density", "stress"], width="1 d43", axes="z", surfaces=[SIDE, FLOOR], per="accessible",
        spacing=1e-3,
    ).isel(time=0)  # fmt: skip
    weight = GRAVITY * float(ds.mass.sum())
    carried = (
        -float(side.wall_force.sel(component="z")),
        -float(floor.wall_force.sel(component="z")),
    )

    top = float(ds.position.sel(component="z").max())
    load = GRAVITY * float(inside.density.sel(z=slice(0.05, 0.18)).mean())
    mean = side.normal_traction.mean("theta")
    friction = -side.shear_traction.sel(along="z").mean("theta")
    fitted = mean.sel(z=slice(0.005, top - 0.005))
    (k, length), _ = curve_fit(
        lambda h, k, length: janssen(h, k, length, load), top - fitted.z, fitted, (0.5, 0.05)
    )

    z = np.linspace(0, top, 200)
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(11, 4.6), layout="constrained", width_ratios=[1.5, 1, 1]
    )
    image = left.pcolormesh(
        side.theta, side.z * 1e3, side.normal_traction.T / 1e3, cmap="viridis", vmax=4
    )
    figure.colorbar(image, label="normal traction [kPa]", extend="max")
    left.set(xlabel=r"$\theta$ [rad]", ylabel="$z$ [mm]", title="the side, unrolled")
    middle.plot(mean / 1e3, mean.z * 1e3, label="silo, mean over the angle")
    middle.plot(janssen(top - z, k, length, load) / 1e3, z * 1e3, "k--", label="Janssen, fitted")
    middle.plot(
        k * load * (top - z) / 1e3, z * 1e3, ":", color="0.5", label="without friction of the side"
    )
    middle.set(
        xlabel="pressure on the side [kPa]", ylabel="$z$ [mm]", xlim=(0, 3.5), ylim=(-15, 290)
    )
    middle.legend(loc="upper right", fontsize=8)
    right.plot(friction / 1e3, friction.z * 1e3, label="upwards on the grains, side")
    right.plot(
        inside.stress.sel(component="z", direction="z") / 1e3,
        inside.z * 1e3,
        label=r"$\sigma_{zz}$ inside",
    )
    right.plot(load * (top - z) / 1e3, z * 1e3, ":", color="0.5", label="weight above")
    right.set(xlabel="stress [kPa]", ylabel="$z$ [mm]", xlim=(-0.3, 3.0), ylim=middle.get_ylim())
    right.legend(loc="upper right", fontsize=8)
    path = ROOT / "docs" / "_static" / "silo.png"
    figure.savefig(path, dpi=110)

    print("| | N |\n|---|---|")
    print(f"| weight of the grains | {weight:.4f} |")
    print(f"| carried by the side | {carried[0]:.4f} |")
    print(f"| carried by the floor | {carried[1]:.4f} |")
    print(
        f"\nK = {k:.2f}, l = {length * 1e3:.0f} mm, K mu = {RADIUS / (2 * length):.3f}, fill {top * 1e3:.0f} mm"
    )
    bulk = inside.volume_fraction.sel(z=slice(0.05, 0.18)).mean().item()
    ratio = (side.shear_traction.sel(along="z") * side.area).sum() / (
        side.normal_traction * side.area
    ).sum()
    print(f"phi = {bulk:.3f}, shear over normal force on the side {-ratio.item():.3f}; {path.name}")


if __name__ == "__main__":
    main()
