"""Force chains while a box of grains is compressed: their number over the stress, and the distribution of their sizes.

    python examples/compression.py [output folder]

1000 frictional spheres in a periodic box that shrinks on all sides (LAMMPS, d = m = 1), from a volume fraction of 0.43
to 0.64. The case is that of figures 6 and 7 of Force Chain Finder (Ejtehadi et al. 2024), with fewer grains.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

import xcg

DATA = Path(__file__).parent / "data" / "lammps_compression"
RULES = {
    r"$\alpha$ = 90°, all grains": {"alpha": 90},
    r"$\alpha$ = 45°, above the mean stress": {"alpha": 45, "min_stress": "mean"},
}
STEPS = (0, 6, 8, 10, 12)  # of the distribution of sizes, at 90 degrees


def open_box() -> xr.Dataset:
    """Open the series; mass 1 and diameter 1."""
    files = {"contacts": DATA / "contacts.*.dump.gz", "density": 6 / np.pi}
    return xcg.open_scene(DATA / "particles.*.dump.gz", **files).load()


def pressure(ds: xr.Dataset) -> xr.DataArray:
    """Return the pressure of the contacts over the whole box, by time."""
    f = ds.cg.coarse_grain("contact_stress", axes="", width=1.0).compute()
    return sum(f.contact_stress.sel(component=a, direction=a) for a in "xyz") / 3


def main(output: Path) -> None:
    """Print the number of chains at each step, and draw it and the distribution of sizes."""
    output.mkdir(parents=True, exist_ok=True)
    ds = open_box()
    fraction = ds.cg.microstructure("volume_fraction").volume_fraction.compute()
    p = pressure(ds)
    chains = {name: ds.cg.force_chains(**rule).compute() for name, rule in RULES.items()}
    every = chains[next(iter(RULES))]
    for k in range(0, ds.sizes["time"], 2):
        print(
            f"phi = {float(fraction[k]):.3f}, p = {float(p[k]):6.2f}: {int(every.chain_count[k])} chains, "
            f"of at most {int(every.length_max[k])} grains"
        )
    figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    for (name, fc), marker in zip(chains.items(), "os", strict=True):
        axes[0].semilogx(p, fc.chain_count, f"-{marker}", ms=4, label=name)
        axes[1].plot(fraction, fc.length_max, f"-{marker}", ms=4, label=f"largest, {name}")
        axes[1].plot(fraction, fc.length_mean, f":{marker}", ms=3, label=f"mean, {name}")
    for k in STEPS:
        share = every.length_share.isel(time=k)
        share = share.where(share > 0, drop=True)
        at_least = share.values[::-1].cumsum()[::-1]
        label = rf"$\phi$ = {float(fraction[k]):.2f}, {int(every.chain_count[k])} chains"
        axes[2].loglog(share.length, at_least, "o-", ms=4, label=label)
    axes[0].set(xlabel="pressure [$k_n / 2000 d$]", ylabel="number of chains")
    axes[1].set(xlabel=r"volume fraction $\phi$", ylabel="grains in a chain", yscale="log")
    axes[2].set(xlabel="grains $c$", ylabel="share of chains of at least $c$ grains")
    for letter, ax in zip("abc", axes, strict=True):
        ax.set_title(f"({letter})", loc="left")
    axes[0].legend(fontsize="small", loc=(0.36, 0.4))
    axes[1].legend(fontsize="small", loc="upper left")
    axes[1].set_ylim(top=2e4)
    axes[2].legend(fontsize="small", loc="upper right")
    figure.savefig(output / "compression.png", dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "output"))
