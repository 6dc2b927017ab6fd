"""A drum in axes along its surface, and a silo over its radius: docs/_static/drum.png, figures of docs/frames.md.

Run from anywhere::

    python docs/frames.py
"""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import matplotlib as mpl
import numpy as np
import xarray as xr

import xcg

mpl.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).parents[1]
DATA = ROOT / "examples" / "data"
OMEGA, RADIUS = 1.0, 0.03  # of drum.in


def drum() -> xr.Dataset:
    """Grains in a drum that turns about y; three steps of the steady flow."""
    return xcg.open_scene(
        DATA / "lammps_drum" / "particles.dump.gz", gravity=(0, 0, -9.81)
    ).compute()


def along_surface(ds: xr.Dataset) -> tuple[xcg.Rotated, float]:
    """Axes with x down the surface and z along its normal, and its slope (degrees): that of its middle."""
    mean = ds.cg.coarse_grain("volume_fraction", axes="xz").cg.time_average()
    fit = mean.cg.free_surface("z").sel(x=slice(-0.01, 0.01)).cg.fit_slope()
    slope = fit.angle.item()
    x = np.cos(np.radians(slope))
    z = np.sin(np.radians(slope))
    return xcg.Rotated(x=(x, 0.0, -z), y=(0.0, 1.0, 0.0)), slope


def below(ds: xr.Dataset) -> xr.Dataset:
    """Means over 1 rad of the drum's lower half, and over its length, by radius."""
    return ds.cg.coarse_grain(
        ["velocity", "volume_fraction", "velocity_gradient"], frame=xcg.Cylindrical("y"), axes="r", for_averages=True,
        bounds={"r": (0.0, RADIUS), "theta": (np.pi / 2 - 0.5, np.pi / 2 + 0.5)}, spacing=0.0005,
    ).cg.time_average()  # fmt: skip


def silo() -> xr.Dataset:
    """Volume fraction and stress over the radius of a silo, between 60 and 120 mm."""
    ds = xcg.open_scene(
        DATA / "lammps_silo" / "particles.dump.gz", contacts=DATA / "lammps_silo" / "contacts.dump.gz",
        walls={"side": "f_side[*]", "floor": "f_floor[*]"}, gravity=(0, 0, -9.81),
    ).compute()  # fmt: skip
    f = ds.cg.coarse_grain(
        ["volume_fraction", "stress", "density"], frame=xcg.Cylindrical("z"), axes="rz",
        bounds={"r": (0.0, 0.026), "z": (0.06, 0.12)}, spacing={"r": 0.0005, "z": 0.002}, width="0.3 d43",
    )  # fmt: skip
    return f.mean("z").isel(time=0)


def ratio(ds: xr.Dataset) -> tuple[float, int]:
    """Time of an average over theta beside that of a mesh of as many nodes as it takes places; and how many."""
    fields = ["density", "velocity", "granular_temperature"]
    frame = xcg.Cylindrical("y")
    options = {"axes": "rz", "spacing": 0.001}
    text = str(ds.cg.explain(fields, frame=frame, **options))
    places = int(text.split(" places")[0].split()[-1])
    lower = ds.attrs["particle_lower"]
    upper = ds.attrs["particle_upper"]
    spacing = float((np.prod(upper - lower + 0.006) / places) ** (1 / 3))
    times = []
    for given in ({"frame": frame, **options}, {"spacing": spacing}):
        best = np.inf
        for _ in range(3):
            start = perf_counter()
            ds.cg.coarse_grain(fields, **given)
            best = min(best, perf_counter() - start)
        times.append(best)
    return times[0] / times[1], places


def main() -> None:
    """Draw and print."""
    ds = drum()
    frame, slope = along_surface(ds)
    plane = ds.cg.coarse_grain("velocity", axes="xz", spacing=0.001).velocity.mean("time")
    profile = ds.cg.coarse_grain(
        ["velocity", "volume_fraction"],
        frame=frame,
        axes="z",
        at={"x": 0.0},
        spacing=0.0005,
        for_averages=True,
    ).cg.time_average()
    f = below(ds)
    g = silo()

    figure, (left, middle, right, last) = plt.subplots(
        1, 4, figsize=(14, 3.9), layout="constrained"
    )
    in_mm = {axis: (axis, plane[axis].values * 1e3, {"units": "mm"}) for axis in "xz"}
    plane.assign_coords(in_mm).to_dataset(name="velocity").cg.plot(ax=left)
    left.set(title=f"a drum, slope {slope:.0f}°")
    seen = profile.where(profile.volume_fraction > 0.1)
    middle.plot(seen.velocity.sel(component="x"), seen.z * 1e3)
    middle.plot(OMEGA * seen.z, seen.z * 1e3, "k--", label=r"$\Omega z$")
    middle.set(
        xlabel="velocity down the surface [m s$^{-1}$]",
        ylabel="along its normal [mm]",
        title="the drum, rotated axes",
    )
    middle.legend(fontsize=8)
    right.plot(f.r * 1e3, f.velocity.sel(component="theta"))
    right.plot(f.r * 1e3, OMEGA * f.r, "k--", label=r"$\Omega r$")
    right.set(
        xlabel="$r$ [mm]",
        ylabel=r"$V_\theta$ [m s$^{-1}$]",
        title="the drum, 1 rad of its lower half",
    )
    right.legend(fontsize=8)
    last.plot(g.r * 1e3, g.volume_fraction)
    last.axvline(25, color="k", lw=0.8)
    last.set(xlabel="$r$ [mm]", ylabel="volume fraction", title="a silo, layers at its side")
    path = ROOT / "docs" / "_static" / "drum.png"
    figure.savefig(path, dpi=110)

    rim = f.sel(r=slice(0.8 * RADIUS, RADIUS - 0.0015))
    turning = (rim.velocity.sel(component="theta") / rim.r).mean().item()
    print(
        f"V_theta / r = {turning:.3f} rad/s near the rim, the drum {OMEGA}; slope {slope:.1f} degrees"
    )
    share, places = ratio(ds)
    print(
        f"time of {places} places averaged over theta / of a mesh of as many nodes: {share:.2f}; {path.name}"
    )


if __name__ == "__main__":
    main()
