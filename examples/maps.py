"""Maps of an impact, of bedload and of rods of glued spheres, with the samples that come with xcg.

    python examples/maps.py [output folder]

The cases are those of figures 9, 11 and 15 of Pysammos (EGUsphere preprint 2026-2591), with other and smaller data: a
sphere that falls on a bed, grains that a fluid drags along, and rods, which are at rest here. Inertial numbers and
frictions of the impact are left out: of one step at this width they are what few grains have by chance.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import xarray as xr

import xcg


def impact() -> xr.Dataset:
    """Return fields in the vertical plane of the impact, at the last step."""
    ds = xcg.datasets.open("impact").isel(time=[-1])
    y = float(ds.box.sel(component="y").mean())
    names = ["velocity", "pressure", "coordination_number"]
    f = ds.cg.coarse_grain(names, axes="xz", at={"y": y}, width="2.5 d50", spacing=1e-3)
    return f.isel(time=0).compute()


def bedload() -> xr.Dataset:
    """Return fields in a vertical plane along the flow, at the last step."""
    ds = xcg.datasets.open("bedload").isel(time=[-1])
    names = ["velocity", "pressure", "volume_fraction"]
    return ds.cg.coarse_grain(names, axes="xz", spacing=2.5e-4).isel(time=0).compute()


def rods() -> xr.Dataset:
    """Return fields of bodies in a vertical plane."""
    ds = xcg.datasets.open("glued")
    names = ["volume_fraction", "contact_stress", "coordination_number"]
    mesh = {"axes": "xz", "at": {"y": 5.0}, "bounds": {"z": (0.0, 16.0)}, "spacing": 0.25}
    return ds.cg.coarse_grain(names, by_body="body_id", width=1.0, **mesh).isel(time=0).compute()


def draw(ax: plt.Axes, field: xr.DataArray, title: str, unit: str) -> None:
    """Draw a field over x and z, in mm or in d; colours of velocities are even about zero."""
    scale = 1e3 if unit == "mm" else 1.0
    low, high = (float(q) for q in field.quantile([0.02, 0.98]))
    colours = "viridis"
    if low < 0:
        high = max(-low, high)
        low = -high
        colours = "RdBu"
    drawn = ax.pcolormesh(
        scale * field.x, scale * field.z, field.transpose("z", "x"), cmap=colours, vmin=low,
        vmax=high, shading="nearest",
    )  # fmt: skip
    ax.figure.colorbar(drawn, ax=ax)
    ax.set_title(title, fontsize="medium")
    ax.set(xlabel=f"$x$ [{unit}]", ylabel=f"$z$ [{unit}]", aspect="equal")


def main(output: Path) -> None:
    """Draw all maps."""
    output.mkdir(parents=True, exist_ok=True)
    struck = impact()
    flow = bedload()
    glued = rods()
    vertical = glued.contact_stress.sel(component="z", direction="z")
    panels = {
        "impact: $V_z$ [m/s]": struck.velocity.sel(component="z"),
        "impact: pressure [Pa]": struck.pressure,
        "impact: coordination number": struck.coordination_number,
        "bedload: $V_x$ [m/s]": flow.velocity.sel(component="x").clip(min=0),
        "bedload: pressure [Pa]": flow.pressure,
        "bedload: volume fraction": flow.volume_fraction,
        "rods: volume fraction": glued.volume_fraction,
        "rods: vertical stress [$m g / d^2$]": vertical,
        "rods: coordination number": glued.coordination_number,
    }
    figure, axes = plt.subplots(3, 3, figsize=(12, 10), layout="constrained")
    for k, (title, field) in enumerate(panels.items()):
        draw(axes.flat[k], field, title, "mm" if k < 6 else "d")
    figure.savefig(output / "maps.png", dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "output"))
