"""The engine's check: a face-centred cubic array of uniform spheres, compressed along <100> until it fails.

    python fcc.py work results

All steps of the study are the same here (contacts, servo, dumps, xcg), and the answer is known in closed form. The
derivation is in `docs/quasi_static.md`.
"""

import sys
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from engine import POISSON, PRESSURE, Engine, Sample, inertial_time
from grains import face_centred_cubic
from measure import open_run
from summary import sliding_array

DIAMETER = 1e-3  # m
FRICTIONS = (0.1, 0.2, 0.3, 0.4)
CELLS, STRAIN, FRAMES, NUMBER = 3, 0.01, 50, 3e-5


def run(friction: float, turning: bool, folder: Path) -> None:
    """Compress an array at constant mean stress, from the overlap at which it bears that stress at rest.

    Six contacts a sphere in a volume d^3 / sqrt(2): each bears p d^2 / (2 sqrt(2)), and Hertz says how deep that is.
    """
    sample = Sample(folder, DIAMETER, DIAMETER)
    folder.mkdir(parents=True, exist_ok=True)
    force = PRESSURE * DIAMETER**2 / np.sqrt(8)
    modulus = sample.young / (2 * (1 - POISSON**2))
    overlap = (3 * force / (4 * modulus * np.sqrt(DIAMETER / 4))) ** (2 / 3)
    x, box = face_centred_cubic(CELLS, DIAMETER, overlap / DIAMETER)
    with Engine(sample) as engine:
        engine.start(x, np.full(len(x), DIAMETER), box, friction)
        if not turning:
            engine.stop_turning()
        engine.shear(NUMBER / inertial_time(DIAMETER), STRAIN, FRAMES, folder)


def measure(folder: Path, friction: float, turning: bool) -> pd.DataFrame:
    """Stress and contacts of each frame, by xcg, and the slope of the contacts in that box."""
    ds = open_run(folder)
    m = ds.cg.microstructure(
        ["stress", "mean_stress", "coordination_number", "axial_strain"]
    ).compute()
    x, y, z = (m.stress.sel(component=a, direction=a).values for a in "xyz")
    lengths = (ds.box.isel(bound=1) - ds.box.isel(bound=0)).values
    return pd.DataFrame(
        {
            "friction": friction,
            "turning": turning,
            "axial_strain": m.axial_strain.values,
            "mean_stress": m.mean_stress.values,
        }
        | {
            "stress_x": x,
            "stress_y": y,
            "stress_z": z,
            "coordination_number": m.coordination_number.values,
        }
        | {"slope": (lengths[:, 0] + lengths[:, 1]) / 2 / lengths[:, 2]}
    )


def main(work: Path, results: Path) -> None:
    """Write fcc.csv."""
    tables = []
    for friction, turning in product(FRICTIONS, (True, False)):
        folder = work / f"fcc_{friction:g}{'' if turning else '_held'}"
        if not folder.exists():
            run(friction, turning, folder)
        tables.append(measure(folder, friction, turning))
        ratio = 2 * tables[-1].stress_z / (tables[-1].stress_x + tables[-1].stress_y)
        print(
            f"friction {friction}, turning {turning}: {ratio.max():.4f}, closed form {sliding_array(friction):.4f}",
            flush=True,
        )
    pd.concat(tables).to_csv(results / "fcc.csv", index=False, float_format="%.6g")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
