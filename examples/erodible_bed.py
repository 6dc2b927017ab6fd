"""Profiles of an erodible bed in time: solid fraction, velocity and three granular temperatures over the height.

    python examples/erodible_bed.py [output folder]

A rough plate drags a layer of spheres over a bed on a plane of 24 degrees (LAMMPS, d = m = g = 1). The bed is fixed
until the flow above it is steady, and free from time 0. The case is that of figure 14 of Pysammos (EGUsphere preprint
2026-2591), with fewer grains.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import xarray as xr

import xcg

DATA = Path(__file__).parent / "data" / "lammps_erodible"
BOUNDS = (0.0, 17.0)  # heights; one grain left the flow, above the plate
STEPS = 9  # averaged at each end of the series, 20 units of time
ENDS = {"first": slice(None, STEPS), "last": slice(-STEPS, None)}
LINES = {"first": "-", "last": "--"}


def open_bed() -> xr.Dataset:
    """Open the series; its lowest grains, species 2, are the plane."""
    return xcg.open_scene(DATA / "particles.*.dump.gz", frozen=2)


def profiles(ds: xr.Dataset) -> xr.Dataset:
    """Return solid fraction, velocity and granular temperature over the height, at each step."""
    names = ["volume_fraction", "velocity", "granular_temperature", "directional_temperature"]
    return ds.cg.coarse_grain(
        names, axes="z", bounds={"z": BOUNDS}, spacing=0.25, for_averages=True
    ).compute()


def temperatures(ds: xr.Dataset, f: xr.Dataset, steps: slice) -> dict[str, xr.DataArray]:
    """Return mean granular temperatures: by the kernel, planes (Zhang & Kamrin) and bins (LAMMPS)."""
    part = ds.isel(time=steps)
    planes = part.cg.slice_temperature("z", bounds=BOUNDS)
    bins = part.cg.slice_temperature("z", method="bins", bounds=BOUNDS)
    return {
        "kernel": f.isel(time=steps).cg.time_average().granular_temperature.compute(),
        "planes": planes.granular_temperature.mean("time").compute(),
        "bins": bins.granular_temperature.mean("time").compute(),
    }


def draw(ds: xr.Dataset, f: xr.Dataset, path: Path) -> None:
    """Draw profiles of all steps, coloured by time, and their first and last mean."""
    figure, axes = plt.subplots(1, 4, figsize=(13, 5), layout="constrained", sharey=True)
    fraction, by_method, temperature, velocity = axes
    time = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, float(f.time[-1])), "viridis")
    horizontal = {
        fraction: f.volume_fraction,
        temperature: f.directional_temperature.sel(component="x"),
        velocity: f.velocity.sel(component="x"),
    }
    for ax, field in horizontal.items():
        for step in field:
            ax.plot(step, f.z, color=time.to_rgba(float(step.time)), lw=0.7, alpha=0.7)
    for name, steps in ENDS.items():
        mean = f.isel(time=steps).cg.time_average().compute()
        means = {
            fraction: mean.volume_fraction,
            temperature: mean.directional_temperature.sel(component="x"),
            velocity: mean.velocity.sel(component="x"),
        }
        for ax, field in means.items():
            ax.plot(
                field, f.z, LINES[name], color="red", lw=2, label=f"{name} mean of {STEPS} steps"
            )
        for colour, (method, field) in enumerate(temperatures(ds, f, steps).items()):
            by_method.plot(
                field, field.z, LINES[name], color=f"C{colour}", label=f"{name} mean, {method}"
            )
    labels = {
        fraction: r"solid fraction $\phi$",
        by_method: "granular temperature $T$ [$g d$]",
        temperature: "horizontal temperature $T_x$ [$g d$]",
        velocity: r"velocity $V_x$ [$\sqrt{g d}$]",
    }
    for letter, (ax, label) in zip("abcd", labels.items(), strict=True):
        ax.set_xlabel(label)
        ax.set_title(f"({letter})", loc="left")
    fraction.set_ylabel("height $z$ [$d$]")
    for ax in (by_method, temperature):
        ax.set_xscale("log")
    by_method.set_xlim(0.01, 2)
    temperature.set_xlim(1e-3, 2)
    fraction.set_ylim(0, 16.5)
    lines = [*velocity.get_legend_handles_labels()[0], *by_method.get_legend_handles_labels()[0]]
    figure.legend(handles=lines, loc="outside lower center", ncols=4, fontsize="small")
    figure.colorbar(time, ax=velocity, label=r"time since the bed is free [$\sqrt{d / g}$]")
    figure.savefig(path, dpi=90)


def draw_series(f: xr.Dataset, path: Path) -> None:
    """Draw the velocity over time and height, and means with standard errors at the end."""
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(12, 3.8), layout="constrained", sharey=True, width_ratios=[1.6, 1, 1]
    )
    speed = f.velocity.sel(component="x").where(f.volume_fraction > 0.05)
    drawn = left.pcolormesh(f.time, f.z, speed.transpose("z", "time"), shading="nearest")
    figure.colorbar(drawn, ax=left, label=r"velocity $V_x$ [$\sqrt{g d}$]")
    mean = f.isel(time=slice(-2 * STEPS, None)).cg.time_average().compute()
    mean = mean.isel(z=slice(None, None, 3)).sel(z=slice(1, 15))
    middle.errorbar(
        mean.velocity.sel(component="x"), mean.z, fmt="o", ms=3, capsize=2,
        xerr=2 * mean.velocity_error.sel(component="x"),
    )  # fmt: skip
    right.errorbar(
        mean.granular_temperature, mean.z, fmt="o", ms=3, capsize=2,
        xerr=2 * mean.granular_temperature_error,
    )  # fmt: skip
    left.set(xlabel=r"time [$\sqrt{d / g}$]", ylabel="height $z$ [$d$]", ylim=(0, 16))
    middle.set(xlabel=r"mean velocity $V_x$ [$\sqrt{g d}$]")
    right.set(xlabel=r"mean temperature $T$ [$g d$]")
    middle.set_title(f"last {2 * STEPS} steps, bars: two standard errors", fontsize="small")
    figure.savefig(path, dpi=90)


def main(output: Path) -> None:
    """Print the mean profiles at both ends, and draw all of them."""
    output.mkdir(parents=True, exist_ok=True)
    ds = open_bed()
    f = profiles(ds)
    for name, steps in ENDS.items():
        mean = f.isel(time=steps).cg.time_average().compute()
        print(f"mean of the {name} {STEPS} steps:")
        table = {
            "V_x": mean.velocity.sel(component="x"),
            **temperatures(ds, f, steps),
        }
        for z in (2.0, 5.0, 8.0, 11.0, 14.0):
            values = [f"{key} {float(field.interp(z=z)):.3f}" for key, field in table.items()]
            print(f"  z = {z:4.1f}: {', '.join(values)}")
    draw(ds, f, output / "erodible_bed.png")
    draw_series(f, output / "erodible_series.png")
    plt.close("all")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "output"))
