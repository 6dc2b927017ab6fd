"""Phases of a mixture, and the stress that each of them bears in a growing pile.

    python examples/pile.py [output folder]

First phases are found in a synthetic mixture of two sizes and two densities (figure 4 of Pysammos, EGUsphere preprint
2026-2591). Then 927 spheres of three sizes are poured on a rough floor in one layer (LAMMPS, m = d = g = 1 for the
smallest), and the vertical stress of each size is drawn down the middle (figure 13 there).
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import xcg

DATA = Path(__file__).parent / "data" / "lammps_pile"
WIDTH = 2.0
MIDDLE = 0.0  # x
COLOURS = ("C0", "C1", "C3")  # of phases


def mixture(grains: int = 2000) -> xr.Dataset:
    """Return grains at random places, of two sizes and two densities."""
    rng = np.random.default_rng(0)
    large = rng.random(grains) < 0.4
    heavy = rng.random(grains) < 0.5
    diameter = np.where(large, rng.normal(4e-3, 2e-4, grains), rng.normal(2e-3, 2e-4, grains))
    density = np.where(heavy, rng.normal(4500, 150, grains), rng.normal(2500, 150, grains))
    position = rng.uniform(0, 0.1, (grains, 3))
    return xcg.scene_from_arrays(position, diameter=diameter, density=density)


def open_pile() -> xr.Dataset:
    """Open the pile, with its phases; the floor is species 4."""
    ds = xcg.open_scene(
        DATA / "particles.*.dump.gz",
        contacts=DATA / "contacts.*.dump.gz",
        frozen=4,
        periodic="",
        gravity=(0.0, -1.0, 0.0),
    )
    return ds.cg.find_phases()


def profile(ds: xr.Dataset) -> xr.Dataset:
    """Return the stress and the density down the middle, by phase and of the bulk, at the last step."""
    f = ds.isel(time=[-1]).cg.coarse_grain(
        ["contact_stress", "density"],
        axes="y",
        at={"x": MIDDLE},
        by="phase",
        width=WIDTH,
        bounds={"y": (0.0, 24.0)},
        spacing=0.25,
    )
    return f.isel(time=0).compute()


def draw(ds: xr.Dataset, path: Path) -> None:
    """Draw grains by phase over the vertical stress, and its profile down the middle by phase."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(13, 4.2), layout="constrained", width_ratios=[2.6, 1]
    )
    step = ds.isel(time=-1).compute()
    stress = (
        ds.isel(time=[-1])
        .cg.coarse_grain("contact_stress", axes="xy", width=WIDTH, spacing=0.5)
        .isel(time=0)
        .contact_stress.sel(component="y", direction="y")
        .compute()
    )
    drawn = left.pcolormesh(stress.x, stress.y, stress.T, cmap="Greys", shading="nearest")
    figure.colorbar(
        drawn, ax=left, location="bottom", aspect=50, label=r"$\sigma^c_{yy}$ [$m g / d^2$]"
    )
    loose = step.frozen.values == 0
    for phase in np.atleast_1d(ds.attrs["phase_values"]):
        rows = loose & (step.phase.values == phase)
        circles = [
            plt.Circle(centre, d / 2)
            for centre, d in zip(
                step.position.values[rows, :2], step.diameter.values[rows], strict=True
            )
        ]
        left.add_collection(
            plt.matplotlib.collections.PatchCollection(
                circles, facecolor="none", edgecolor=COLOURS[int(phase) - 1], lw=0.8
            )
        )
    f = profile(ds)
    vertical = f.contact_stress.sel(component="y", direction="y")
    for phase in f.phase.values:
        colour = "black"
        label = "all phases"
        if phase != "bulk":
            colour = COLOURS[int(phase) - 1]
            label = f"phase {phase}, $d$ = {ds.attrs['phase_diameter'][int(phase) - 1]:g}"
        right.plot(vertical.sel(phase=phase), f.y, color=colour, label=label)
    density = f.density.sel(phase="bulk")
    weight = density.integrate("y") - density.cumulative_integrate("y")
    right.plot(weight, f.y, "k:", label="weight above")
    left.axvline(MIDDLE, color="k", ls="--", lw=0.8)
    left.set(xlim=(-60, 60), ylim=(-1, 24), xlabel="$x$ [$d$]", ylabel="$y$ [$d$]", aspect="equal")
    right.set(xlabel=r"$\sigma^c_{yy}$ [$m g / d^2$]", ylabel="$y$ [$d$]")
    right.legend(fontsize="small")
    figure.savefig(path, dpi=90)
    plt.close(figure)


def main(output: Path) -> None:
    """Print the phases and the share of the stress that each bears, and draw both."""
    output.mkdir(parents=True, exist_ok=True)
    mixed = mixture().cg.find_phases()
    for diameter, density in zip(
        mixed.attrs["phase_diameter"], mixed.attrs["phase_density"], strict=True
    ):
        print(f"phase of {1e3 * diameter:.2f} mm and {density:.0f} kg m-3")
    print("silhouette of 2, 3, ... clusters:", np.round(mixed.attrs["phase_scores"], 2))
    figure = mixed.cg.plot_phases()
    figure.axes[0].locator_params(axis="x", nbins=4)
    figure.savefig(output / "phases.png", dpi=90)
    plt.close(figure)
    ds = open_pile()
    inside = profile(ds).sel(y=slice(3, 12)).mean("y")
    vertical = inside.contact_stress.sel(component="y", direction="y")
    for phase in inside.phase.values[inside.phase.values != "bulk"]:
        of_stress = float(vertical.sel(phase=phase) / vertical.sel(phase="bulk"))
        of_mass = float(inside.density.sel(phase=phase) / inside.density.sel(phase="bulk"))
        print(
            f"phase {phase}: {100 * of_stress:.0f} % of the stress, {100 * of_mass:.0f} % of the mass"
        )
    draw(ds, output / "pile.png")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "output"))
