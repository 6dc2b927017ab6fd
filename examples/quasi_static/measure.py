"""From the dumps of the runs to the small tables that ship: everything here is measured by xcg.

python measure.py work results
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

import xcg

COLUMNS = {
    "axial_strain": "axial_strain",
    "volumetric_strain": "volumetric_strain",
    "mean_stress": "mean_stress",
    "stress_ratio": "stress_ratio",
    "volume_fraction": "volume_fraction",
    "coordination_number": "coordination_number",
    "mechanical_coordination_number": "z_mech",
    "non_rattler_fraction": "f_nr",
    "fabric_anisotropy": "fabric_anisotropy",
    "inertial_number_dmax": "inertial_dmax",
    "inertial_number_d50": "inertial_d50",
    "inertial_number_dbar": "inertial_dbar",
}
FORCE_BINS = np.logspace(-3, np.log10(30), 41)
WINDOW = 0.05  # axial strain of each run that is left out of force distributions


def open_run(folder: Path) -> xr.Dataset:
    """Scene of a run: all its frames."""
    return xcg.open_scene(
        str(folder / "particles.*.dump"), contacts=str(folder / "contacts.*.dump"), periodic="xyz"
    )


def overlaps(ds: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Mean and largest overlap over the smaller diameter, for each time, of contacts found from positions."""
    mean = []
    largest = []
    for t in range(ds.sizes["time"]):
        found = ds.isel(time=[t]).cg.find_contacts().isel(time=0).compute()
        size = pd.Series(found.diameter.values, index=found.particle_id.values)
        real = found.contact_i.values >= 0
        i, j = (size[found[name].values[real]].to_numpy() for name in ("contact_i", "contact_j"))
        share = found.overlap.values[real] / np.minimum(i, j)
        mean.append(share.mean() if len(share) else np.nan)
        largest.append(share.max(initial=0.0))
    return np.array(mean), np.array(largest)


def measure(folder: Path) -> tuple[pd.DataFrame, np.ndarray, np.ndarray]:
    """History of a run; contacts by normal force, and shares of grains by partners, in its steady part."""
    ds = open_run(folder)
    names = [*COLUMNS, "normal_force_count", "connectivity"]
    m = ds.cg.microstructure(names, force_bins=FORCE_BINS).compute()
    table = pd.DataFrame({short: m[name].values for name, short in COLUMNS.items()})
    record = np.load(folder / "record.npz")
    table["lammps_mean_stress"] = (record["lammps_x"] + record["lammps_y"] + record["lammps_z"]) / 3
    table["overlap_mean"], table["overlap_max"] = overlaps(ds)
    steady = m.axial_strain.values > WINDOW
    partners = m.connectivity.values[steady].mean(axis=0)
    return table, m.normal_force_count.values[steady].sum(axis=0), partners


def main(work: Path, results: Path) -> None:
    """Write history.csv, forces.csv, connectivity.csv and runs.csv."""
    histories = []
    forces = []
    shares = []
    runs = []
    for record_file in sorted(work.glob("ratio_*/*/record.npz")):
        folder = record_file.parent
        ratio = folder.parent.name.removeprefix("ratio_")
        run = folder.name.removeprefix("rate_")
        cached = folder / "history.pkl"
        if not cached.exists():
            pd.to_pickle(measure(folder), cached)
        table, count, partners = pd.read_pickle(cached)
        record = np.load(record_file)
        labels = {"ratio": ratio, "run": run}
        histories.append(table.assign(**labels))
        bins = {"low": FORCE_BINS[:-1], "high": FORCE_BINS[1:], "contacts": count}
        forces.append(pd.DataFrame(bins).assign(**labels))
        share = {"partners": np.arange(len(partners)), "share": partners}
        shares.append(pd.DataFrame(share).assign(**labels))
        means = record["chunk_means"]
        steady = means[int(len(means) * WINDOW / table.axial_strain.iloc[-1]) :]
        particles = int(open_run(folder).isel(time=0).particle_id.size)
        runs.append(
            labels
            | {
                "particles": particles,
                "steps": int(record["steps"]),
                "seconds": float(record["seconds"]),
            }
            | {"servo_mean": steady.mean(), "servo_scatter": steady.std()}
        )
        print(
            f"{ratio} {run}: p' {runs[-1]['servo_mean']:.0f} Pa, overlap {table.overlap_max.max():.4f}",
            flush=True,
        )
    results.mkdir(parents=True, exist_ok=True)
    tables = {
        "history": histories,
        "forces": forces,
        "connectivity": shares,
        "runs": [pd.DataFrame(runs)],
    }
    for name, rows in tables.items():
        whole = pd.concat(rows)
        first = ["ratio", "run"]
        whole = whole[first + [c for c in whole.columns if c not in first]]
        whole.to_csv(results / f"{name}.csv", index=False, float_format="%.6g")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
