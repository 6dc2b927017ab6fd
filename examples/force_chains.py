"""Force chains of a sheared layer of grains: from DEM files to chains, statistics, files and a picture.

    python examples/force_chains.py [output folder]

The data are two frames of 2000 spheres in one layer (LAMMPS), compressed and then sheared between a bottom of grains
that moves to the left and a top that moves to the right.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import xcg

DATA = Path(__file__).parent / "data" / "lammps_biaxial2d"


def mean_direction(fc: xr.Dataset) -> float:
    """Mean direction of the links of the last step (degrees above x), weighted by force."""
    links = fc.isel(time=[-1]).cg.link_table()
    step = fc.isel(time=-1)
    row = {key: k for k, key in enumerate(step.particle_id.values)}
    i, j = ([row[key] for key in links[name]] for name in ("particle_i", "particle_j"))
    branch = step.position.values[j] - step.position.values[i]
    length = float(step.box.sel(component="x").diff("bound").item())
    branch[:, 0] -= length * np.rint(branch[:, 0] / length)
    # directions without a sign: twice the angle goes round once
    double = 2 * np.arctan2(branch[:, 1], branch[:, 0])
    force = links["force"].to_numpy()
    return float(np.rad2deg(np.arctan2(force @ np.sin(double), force @ np.cos(double)) / 2) % 180)


def draw(fc: xr.Dataset, path: Path) -> None:
    """Chains of the last step, distribution of lengths, and directions of links."""
    figure = plt.figure(figsize=(12, 6.2), layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=[1.25, 1.25, 1])
    ax = fc.cg.plot_chains(index=-1, ax=figure.add_subplot(grid[:, :2]))
    ax.set_title("chains of the last step, line width by force")
    share = fc.length_share.weighted(fc.chain_count).mean("time")
    share.where(share > 0).plot.line("o", yscale="log", ax=figure.add_subplot(grid[0, 2]))
    rose = fc.cg.plot_rose(index=-1, ax=figure.add_subplot(grid[1, 2], projection="polar"))
    rose.plot(np.deg2rad([135, 315]), [rose.get_rmax()] * 2, "k:", lw=1)
    rose.set_title("links by force\n(dotted: compressive diagonal)", fontsize="medium")
    figure.savefig(path, dpi=80)


def main(output: Path) -> None:
    output.mkdir(parents=True, exist_ok=True)
    scene = xcg.open_scene(
        DATA / "particles.*.dump.gz", contacts=DATA / "contacts.*.dump.gz", periodic="x", frozen=2
    )  # fmt: skip
    fc = scene.cg.force_chains(alpha=45, min_stress="mean").compute()

    for t in range(fc.sizes["time"]):
        step = fc.isel(time=t)
        print(
            f"t = {float(step.time):.1f} s: {int(step.chain_count)} chains of {float(step.length_mean):.1f} grains on "
            f"average, {float(step.length_median):.0f} at the median, {int(step.length_max)} at most"
        )
    print(
        fc.isel(time=[-1])
        .cg.chain_table()
        .nlargest(3, "particles")
        .iloc[:, 2:7]
        .round(0)
        .to_string(index=False)
    )
    stress = scene.cg.particle_stress().isel(time=-1)
    total = (
        (stress.stress * scene.volume.isel(time=-1))
        .where(scene.frozen.isel(time=-1) == 0)
        .sum("particle")
        .values
    )
    major = np.linalg.eigh(total[:2, :2])[1][:, -1]
    print(f"links point at {mean_direction(fc):.0f} degrees, the mean stress at", end=" ")
    print(
        f"{np.rad2deg(np.arctan2(major[1], major[0])) % 180:.0f}, the compressive diagonal of the shear at 135"
    )
    tracks = fc.cg.track_chains(overlap=0.5)
    print(
        f"{int(tracks.survivors[-1])} chains live on from the first frame, {int(tracks.deaths[-1])} end",
        end="\n\n",
    )

    fc.to_netcdf(output / "chains.nc")
    fc.cg.to_csv(output / "chains_{step}.csv", overwrite=True)
    fc.cg.to_vtp(output / "chains_{step}.vtp", overwrite=True)
    fc.cg.save(output / "chains.vtkhdf", overwrite=True)
    draw(fc, output / "force_chains.png")
    for path in sorted(output.glob("*chains*")):
        print(f"{path.stat().st_size / 1e6:7.2f} MB  {path}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "output"))
