"""The engine's check: a face-centred cubic array of uniform spheres, compressed along <100> until it fails.

    python fcc.py work results

All steps of the study are the same here (contacts, servo, dumps, xcg), and the answer is known in closed form. The
derivation is in `docs/quasi_static.md`.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from engine import Engine, Sample, inertial_time
from grains import face_centred_cubic
from measure import open_run
from summary import sliding_array

DIAMETER = 1e-3  # m
FRICTIONS = (0.1, 0.2, 0.3, 0.4)
CELLS, STRAIN, FRAMES, NUMBER = 3, 0.01, 50, 3e-5


def run(friction: float, folder: Path) -> None:
    """Compress an array at constant mean stress."""
    sample = Sample(folder, DIAMETER, DIAMETER)
    folder.mkdir(parents=True, exist_ok=True)
    x, box = face_centred_cubic(CELLS, DIAMETER, 1e-3)
    with Engine(sample) as engine:
        engine.start(x, np.full(len(x), DIAMETER), box, friction)
        engine.compress(1e-3 / inertial_time(DIAMETER))
        engine.shear(NUMBER / inertial_time(DIAMETER), STRAIN, FRAMES, folder)


def measure(folder: Path, friction: float) -> pd.DataFrame:
    """Stress and contacts of each frame, by xcg, and the slope of the contacts in that box."""
    ds = open_run(folder)
    m = ds.cg.microstructure(["stress", "mean_stress", "coordination_number", "axial_strain"]).compute()
    x, y, z = (m.stress.sel(component=a, direction=a).values for a in "xyz")
    lengths = (ds.box.isel(bound=1) - ds.box.isel(bound=0)).values
    return pd.DataFrame(
        {"friction": friction, "axial_strain": m.axial_strain.values, "mean_stress": m.mean_stress.values}
        | {"stress_x": x, "stress_y": y, "stress_z": z, "coordination_number": m.coordination_number.values}
        | {"slope": (lengths[:, 0] + lengths[:, 1]) / 2 / lengths[:, 2]}
    )


def main(work: Path, results: Path) -> None:
    """Write fcc.csv."""
    tables = []
    for friction in FRICTIONS:
        folder = work / f"fcc_{friction:g}"
        if not folder.exists():
            run(friction, folder)
        tables.append(measure(folder, friction))
        ratio = 2 * tables[-1].stress_z / (tables[-1].stress_x + tables[-1].stress_y)
        print(f"friction {friction}: {ratio.max():.4f}, closed form {sliding_array(friction):.4f}", flush=True)
    pd.concat(tables).to_csv(results / "fcc.csv", index=False, float_format="%.6g")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
