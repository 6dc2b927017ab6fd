"""Writes tables of docs/temperature.md, temperatures over true ones: python -m docs.temperature, from the root.

Grains anywhere with independent velocities, gases, and dense shear. The runs of the last two are made by
LAMMPS, from `examples/data/lammps_gas/gas.in` and `examples/data/lammps_shear/shear.in`.
"""

import gzip
import warnings
from itertools import product
from pathlib import Path

import numpy as np
import xarray as xr

import xcg
from docs.marks import write_between

DATA = Path(__file__).parents[1] / "examples" / "data"
RATE = 0.1  # of shear.in
WIDTHS = (0.6, 0.75, 1.0, 1.5, 2.0)
NAMES = ["granular_temperature", "fluctuation_density", "effective_count"]


def found(
    ds: xr.Dataset, truth: np.ndarray, width: float, **options: object
) -> tuple[xr.DataArray, xr.DataArray, float]:
    """Ratio to the true temperatures (time,): without bias and with, and the share of nodes that know one."""
    ratios = []
    share = 0.0
    for way in ("biased", "unbiased"):
        f = ds.cg.coarse_grain(NAMES, width=width, temperature=way, **options)
        known = f.granular_temperature.notnull()
        weight = f.fluctuation_density.where(known, 0.0)
        rest = [d for d in weight.dims if d != "phase"]
        true = xr.DataArray(truth, dims="time")
        ratios.append(
            (f.granular_temperature.fillna(0.0) * weight).sum(rest) / (true * weight).sum(rest)
        )
        share = float(known.mean())
    return ratios[1], ratios[0], share


def independent(
    phi: float, small: float, grains: int = 40_000, *, equal_energy: bool = False
) -> xr.Dataset:
    """Grains anywhere, half of them smaller, with independent velocities of temperature 1, in many steps.

    With `equal_energy`, small grains are faster, so that m <v^2> is the same.
    """
    rng = np.random.default_rng(1)
    length = 12.0
    sizes = np.array([1.0, small])
    count = round(phi * length**3 / (np.pi / 6 * (sizes**3).mean()))
    steps = max(2, grains // count)
    species = np.tile(np.arange(count) % 2 + 1, (steps, 1))
    velocity = rng.normal(size=(steps, count, 3))
    if equal_energy:
        velocity *= sizes[species - 1, None] ** -1.5
    return xcg.scene_from_arrays(
        rng.uniform(0, length, (steps, count, 3)), velocity=velocity, density=1.0, time=np.arange(steps) * 1.0,
        diameter=sizes[species - 1], species=species, box=dict.fromkeys("xyz", (0.0, length)), periodic="xyz",
    )  # fmt: skip


def of_mixture(small: float, ds: xr.Dataset, width: float, *, equal_energy: bool) -> str:
    """Ratios to the true temperatures of bulk, large and small grains, from sums of all steps and nodes."""
    f = ds.cg.coarse_grain("granular_temperature", width=width, spacing=0.75, by="species")
    mean = f.cg.coarsen(x=f.sizes["x"], y=f.sizes["y"], z=f.sizes["z"]).cg.time_average()
    masses = np.array([1.0, small**3])
    temperatures = 1 / masses if equal_energy else np.ones(2)
    truth = np.array([(masses * temperatures).sum() / masses.sum(), *temperatures])
    return ", ".join(f"{ratio:.2f}" for ratio in mean.granular_temperature.values.squeeze() / truth)


def table_of_independent() -> str:
    mixtures = "2 : 1, equal variance | 2 : 1, equal energy | `by=` left out"
    lines = [
        f'| w / d | phi | volume | plane (`axes="xz"`) | profile | {mixtures} | known |',
        "|---" * 9 + "|",
    ]
    for width, phi in product(WIDTHS, (0.1, 0.3, 0.6)):
        same = independent(phi, 1.0)
        mixed = independent(phi, 0.5)
        equal = independent(phi, 0.5, equal_energy=True)
        options = {"spacing": 0.75, "width": width}
        ones = [
            found(same, np.ones(same.sizes["time"]), axes=axes, **options)
            for axes in ("xyz", "xz", "z")
        ]
        cells = [f"{float(new):.2f}, {float(old):.2f}" for new, old, _ in ones]
        cells.append(of_mixture(0.5, mixed, width, equal_energy=False))
        cells.append(of_mixture(0.5, equal, width, equal_energy=True))
        truth = 2 / (1 + 0.5**3)  # of the bulk: the sum of equal energies over that of masses
        alone = found(equal, np.full(equal.sizes["time"], truth), **options)[0]
        cells.append(f"{float(alone):.2f}")
        lines.append(f"| {width} | {phi} | " + " | ".join(cells) + f" | {100 * ones[0][2]:.0f} % |")
        print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def table_of_gases() -> str:
    lines = ["| w / d | phi = 0.1 | known | phi = 0.4 | known |", "|---" * 5 + "|"]
    for width in WIDTHS:
        cells = []
        for phi in (0.1, 0.4):
            ds = xcg.open_scene(
                str(DATA / "lammps_gas" / f"gas_{phi}.dump.gz"), units="reduced"
            ).load()
            new, old, share = found(
                ds, ds.velocity.var("particle").mean("component").values, width, spacing=0.5
            )
            cells.append(f"{float(new):.2f}, {float(old):.2f} | {100 * share:.0f} %")
        lines.append(f"| {width} | " + " | ".join(cells) + " |")
        print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def sheared() -> tuple[xr.Dataset, np.ndarray, float]:
    """Steps of the shear with the images of its grains, which move with the flow; true temperatures, and the edge."""
    with gzip.open(DATA / "lammps_shear" / "shear.dump.gz", "rt") as file:
        lines = file.read().split("\n")
    starts = [k for k, line in enumerate(lines) if line == "ITEM: TIMESTEP"]
    steps = []
    truth = []
    for start in starts:
        tilt = float(lines[start + 5].split()[2])
        length = float(lines[start + 6].split()[1])
        rows = np.array(
            [line.split() for line in lines[start + 9 : start + 9 + int(lines[start + 3])]], float
        )
        x = rows[:, 1:4]
        v = rows[:, 4:7]
        own = v - [1, 0, 0] * (RATE * x[:, 1:2])
        truth.append(((own - own.mean(axis=0)) ** 2).mean())
        cell = np.array([[length, 0, 0], [tilt, length, 0], [0, 0, length]])
        images = np.array(list(product((-2, -1, 0, 1, 2), (-1, 0, 1), (-1, 0, 1))))
        position = (x + (images @ cell)[:, None]).reshape(-1, 3)
        velocity = (v + RATE * length * images[:, 1, None, None] * np.array([1, 0, 0])).reshape(
            -1, 3
        )
        near = ((position > -4.0) & (position < length + 4.0)).all(axis=1)  # the widest support
        steps.append((position[near], velocity[near]))
    positions, velocities = zip(*steps, strict=True)
    sizes = [np.ones(len(p)) for p in positions]
    ds = xcg.scene_from_arrays(
        list(positions), velocity=list(velocities), diameter=sizes, density=1.0, units="reduced"
    )
    return ds, np.array(truth), length


def table_of_shear() -> str:
    ds, truth, length = sheared()
    lines = ["| w / d | without bias | per density | known |", "|---" * 4 + "|"]
    bounds = dict.fromkeys("xyz", (0.0, length - 0.5))
    for width in WIDTHS:
        new, old, share = found(ds, truth, width, bounds=bounds, spacing=0.5)
        lines.append(f"| {width} | {float(new):.2f} | {float(old):.2f} | {100 * share:.0f} % |")
        print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def main() -> None:
    for known in ("a node sees", "assumes that all"):
        warnings.filterwarnings("ignore", f".*{known}", xcg.SceneWarning)
    write_between("temperature.md", "independent", table_of_independent())
    write_between("temperature.md", "gases", table_of_gases())
    write_between("temperature.md", "shear", table_of_shear())


if __name__ == "__main__":
    main()
