"""The main job, end to end: DEM files of a granular chute flow to continuum fields, files and a picture.

    python examples/chute.py [output folder]

The data are three frames of 4398 spheres flowing down a plane of 24 degrees over a bed of frozen grains (LAMMPS,
reduced units: d = m = g = 1).
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import xarray as xr

import xcg

DATA = Path(__file__).parent / "data" / "lammps_chute"


def table(profile: xr.Dataset) -> str:
    """Depth profile, averaged over time, as text."""
    columns = [
        "volume_fraction",
        "velocity",
        "shear_rate",
        "granular_temperature",
        "friction_coefficient",
        "inertial_number",
    ]
    heads = ["z/d", "phi", "V_x", "shear rate", "T", "mu", "I"]
    flow = profile.cg.time_average().sel(component="x", z=slice(2, 35)).isel(z=slice(None, None, 6))
    rows = [
        [float(flow.z[k]), *(float(flow[c][k]) for c in columns)] for k in range(flow.sizes["z"])
    ]
    lines = [
        "".join(f"{head:>11s}" for head in heads),
        *("".join(f"{v:11.4g}" for v in row) for row in rows),
    ]
    return "\n".join(lines)


def draw(profile: xr.Dataset, path: Path) -> None:
    """Depth profiles of each frame (thin) and their mean (thick)."""
    flow = profile.sel(component="x")
    mean = profile.cg.time_average().sel(component="x")
    panels = {
        "volume_fraction": r"$\phi$",
        "velocity": r"$V_x$  [$\sqrt{g d}$]",
        "shear_rate": r"$|\dot\gamma|$  [$\sqrt{g/d}$]",
        "granular_temperature": r"$T$  [$g d$]",
        "pressure": r"$p$  [$m g / d^2$]",
        "friction_coefficient": r"$\mu$",
        "inertial_number": r"$I$",
        "coordination_number": r"$Z$",
    }
    inside = mean.volume_fraction > 0.3
    figure, axes = plt.subplots(2, 4, figsize=(11, 6.4), sharey=True, layout="constrained")
    for ax, (name, label) in zip(axes.flat, panels.items(), strict=True):
        shown = True if name in ("volume_fraction", "pressure") else inside
        ax.plot(flow[name].where(shown).transpose("z", "time"), flow.z, color="0.7", lw=0.8)
        ax.plot(mean[name].where(shown), flow.z, color="C0", lw=2)
        ax.set_xlabel(label)
        ax.grid(alpha=0.3)
    # Steady flow has tan 24 in the ratio of shear to normal stress. The invariants differ from it by
    # normal stress differences: the mean of the normal stresses is not sigma_zz.
    sigma = profile.cg.time_average().stress.sel(direction="z")
    shear_ratio = -sigma.sel(component="x") / sigma.sel(component="z")
    dense_mu = axes.flat[5]
    dense_mu.plot(shear_ratio.where(inside), flow.z, color="C3", lw=2)
    dense_mu.set_xlabel(r"$|\sigma'|/p$ (blue), $-\sigma_{xz}/\sigma_{zz}$ (red)")
    dense_mu.axvline(0.4452, color="k", ls=":", lw=1)
    dense_mu.text(0.44, 22, r"$\tan 24^\circ$", ha="right")
    dense_mu.set_xlim(0.3, 0.6)
    for ax in axes[:, 0]:
        ax.set_ylabel("$z$ [$d$]")
    title = f"Chute flow at 24°, Lucy kernel, width {profile.attrs['width']:.2f} d"
    figure.suptitle(f"{title} (grey: three steps, colours: their mean)")
    figure.savefig(path, dpi=130)


def main(output: Path) -> None:
    output.mkdir(parents=True, exist_ok=True)
    scene = xcg.open_scene(
        DATA / "particles.*.dump.gz",
        contacts=DATA / "contacts.*.dump.gz",
        gravity=(0.4067, 0.0, -0.9135),
    )
    print(scene.cg, end="\n\n")

    fields = scene.cg.coarse_grain()
    fields.to_netcdf(output / "chute_3d.nc")
    xr.open_dataset(output / "chute_3d.nc").cg.save(output / "chute_3d.vtkhdf", overwrite=True)

    profile = scene.cg.coarse_grain(axes="z", spacing=0.25).compute()
    profile.to_netcdf(output / "chute_profile.nc")
    print(table(profile), end="\n\n")
    draw(profile, output / "chute_profile.png")
    for path in sorted(output.glob("chute_*")):
        print(f"{path.stat().st_size / 1e6:7.2f} MB  {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "output"))
