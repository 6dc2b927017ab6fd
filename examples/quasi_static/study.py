"""The runs of the study: pack, shear to large strain, then go on at each rate.

    python study.py all work          # everything, one after the other
    python study.py pack 2 work       # one packing: size ratio, folder
    python study.py shear 2 1e-3 work # one rate: size ratio, inertial number, folder

`measure.py` turns the folder into the small tables in `results`. Runs that are done are not done again.
"""

import sys
from pathlib import Path
from time import perf_counter

import numpy as np
from engine import Engine, Sample, inertial_time
from grains import cloud, diameters

D50 = 1e-3  # m
COUNTS = {1.2: 1000, 2.0: 1500, 5.0: 2000}
YOUNG = {
    1.2: 6e9,
    2.0: 6e9,
    5.0: 10e9,
}  # Pa: stiffer where large grains press on small ones; overlaps below 1 % of d
RATES = (1e-3, 3e-3, 1e-2, 3e-4, 1e-4)  # inertial numbers with d50, in the order of running
SLOWEST = {1.2: 1e-4, 2.0: 3e-4, 5.0: 1e-4}  # what the budget allows
PRIOR, PRIOR_STRAIN = 3e-3, 0.25  # the shear from the isotropic state, where all rates start
STRAIN, SLOW_STRAIN, FRAMES = 0.2, 0.15, 60  # slow runs, below 1e-3, are long enough without
PACKING_FRICTION, FRICTION = 0.1, 0.3
LOOSE, ASPECT = 0.3, 1.5  # of the cloud; the box is as high as wide in the middle of the shear
SEED = 1


def sample(ratio: float, folder: Path) -> tuple[Sample, np.ndarray]:
    """Folder and sizes of one packing."""
    d = diameters(COUNTS[ratio], ratio, D50, SEED)
    return Sample(folder / f"ratio_{ratio:g}", d.min(), d.max(), YOUNG[ratio]), d


def pack(ratio: float, folder: Path) -> None:
    """Make the isotropic state at 100 kPa, and shear it at the rate `PRIOR`."""
    state, d = sample(ratio, folder)
    state.folder.mkdir(parents=True, exist_ok=True)
    began = perf_counter()
    with Engine(state) as engine:
        engine.start(*cloud_of(d), PACKING_FRICTION)
        engine.compress(0.02 / inertial_time(D50))
        engine.set_friction(FRICTION)
        engine.write("isotropic.restart")
    seconds = perf_counter() - began
    with Engine(state) as engine:
        engine.read("isotropic.restart", FRICTION)
        record = engine.shear(
            PRIOR / inertial_time(D50), PRIOR_STRAIN, FRAMES, state.folder / "prior"
        )
        engine.write("sheared.restart")
    _save(state.folder / "prior", record, packing_seconds=seconds)


def cloud_of(d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, diameters and box of the cloud that is compressed."""
    x, box = cloud(d, LOOSE, ASPECT, SEED + 1)
    return x, d, box


def shear(ratio: float, number: float, folder: Path) -> None:
    """Go on from the sheared state at another inertial number."""
    state, _ = sample(ratio, folder)
    with Engine(state) as engine:
        engine.read("sheared.restart", FRICTION)
        rate = number / inertial_time(D50)
        prior = PRIOR / inertial_time(D50)
        strain = STRAIN if number >= 1e-3 else SLOW_STRAIN
        record = engine.shear(rate, strain, FRAMES, state.folder / f"rate_{number:g}", prior)
    _save(state.folder / f"rate_{number:g}", record)


def _save(folder: Path, record: dict, **more: float) -> None:
    rows = record.pop("rows")
    np.savez(folder / "record.npz", **rows, **record, **more)
    means = record["chunk_means"]
    print(
        f"{folder}: {record['steps']} steps, {record['seconds']:.0f} s, "
        f"p' {means[len(means) // 4 :].mean():.0f} Pa, chunks +- {means[len(means) // 4 :].std():.0f} Pa", flush=True,
    )  # fmt: skip


def everything(folder: Path) -> None:
    """All runs, the slow ones last."""
    for ratio in COUNTS:
        if not (folder / f"ratio_{ratio:g}" / "prior" / "record.npz").exists():
            pack(ratio, folder)
    for number in RATES:
        for ratio in COUNTS:
            done = folder / f"ratio_{ratio:g}" / f"rate_{number:g}" / "record.npz"
            if number >= SLOWEST[ratio] and not done.exists():
                shear(ratio, number, folder)


if __name__ == "__main__":
    what, *values, folder = sys.argv[1:]
    {"all": everything, "pack": pack, "shear": shear}[what](*map(float, values), Path(folder))
