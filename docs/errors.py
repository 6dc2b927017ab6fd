"""Writes tables of docs/width.md: python -m docs.errors. Predicted errors of one step against measured scatter."""

import warnings

import numpy as np

import xcg
from docs.marks import write_between
from tests.ensembles import (
    CASES,
    OF_MOTION,
    OF_VARIABLES,
    ensemble,
    predicted_over_measured,
)

NAMES = [
    "velocity",
    "velocity_gradient",
    "shear_rate",
    "granular_temperature",
    "kinetic_stress",
    "spin",
    "charge",
]

SAMPLES = {
    "plane_shear": "z",
    "segregation": "z",
    "suspension": "z",
    "cooling": "z",
}  # with the axis of the profile


def of_draws() -> list[str]:
    """Ratios for independent grains: the median over components, of 200 draws."""
    rows = [
        "| scene | N_eff | " + " | ".join(f"`{name}`" for name in NAMES) + " |",
        "|---" * (2 + len(NAMES)) + "|",
    ]
    for case, (scene, options) in CASES.items():
        f = ensemble(**scene).cg.coarse_grain(
            [*OF_MOTION, *OF_VARIABLES, "effective_count"], errors=True, **options
        )
        count = float(f.effective_count.mean())
        found = [f"{np.median(predicted_over_measured(f, name)):.2f}" for name in NAMES]
        rows.append(f"| {case} | {count:.0f} | " + " | ".join(found) + " |")
    return rows


def of_samples() -> list[str]:
    """Ratios for the samples that come with xcg: errors of one step over the scatter of all steps."""
    rows = [
        "| sample | steps | `velocity` | `granular_temperature` | `shear_rate` |",
        "|---|---|---|---|---|",
    ]
    for name, axis in SAMPLES.items():
        ds = xcg.datasets.open(name)
        f = ds.cg.coarse_grain(
            ["velocity", "granular_temperature", "shear_rate"], errors=True, axes=axis
        ).compute()
        found = []
        for field in ("velocity", "granular_temperature", "shear_rate"):
            scatter = f[field].std("time", ddof=1)
            error = np.sqrt((f[f"{field}_error"] ** 2).mean("time"))
            found.append(f"{float(error.median() / scatter.median()):.2f}")
        rows.append(f"| {name} | {f.sizes['time']} | " + " | ".join(found) + " |")
    return rows


def main() -> None:
    """Put the tables between their marks."""
    warnings.simplefilter("ignore")
    write_between("width.md", "draws", "\n".join(of_draws()))
    write_between("width.md", "samples", "\n".join(of_samples()))


if __name__ == "__main__":
    main()
