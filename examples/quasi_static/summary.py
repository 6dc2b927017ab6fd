"""Steady values of the runs with their errors, from the tables that ship."""

from pathlib import Path

import numpy as np
import pandas as pd

TRANSIENT = 0.05  # axial strain after a change of rate that is left out
BLOCKS = 5
QUANTITIES = ("stress_ratio", "volume_fraction", "z_mech", "f_nr")


def load(results: Path) -> dict[str, pd.DataFrame]:
    """Tables by name; runs are named by their inertial number, or "prior"."""
    kinds = {"ratio": float, "run": str}
    return {
        path.stem: pd.read_csv(path, dtype=kinds) for path in sorted(Path(results).glob("*.csv"))
    }


def steady(history: pd.DataFrame) -> pd.DataFrame:
    """Mean of each quantity over the steady part of each run, and its standard error.

    Frames are correlated, so errors come from the scatter of the means of `BLOCKS` equal parts of the run. With so few
    blocks the errors themselves are uncertain by a third.
    """
    rows = []
    for (ratio, run), table in history[history.run != "prior"].groupby(["ratio", "run"]):
        part = table[table.axial_strain > TRANSIENT]
        row = {"ratio": ratio, "rate": float(run)}
        names = [name for name in part.columns if name not in ("ratio", "run", "axial_strain")]
        for name in names:
            blocks = [block.mean() for block in np.array_split(part[name].to_numpy(), BLOCKS)]
            row[name] = part[name].max() if name == "overlap_max" else part[name].mean()
            row[f"{name}_error"] = np.std(blocks, ddof=1) / np.sqrt(BLOCKS)
        rows.append(row)
    return pd.DataFrame(rows).sort_values(["ratio", "rate"], ignore_index=True)


def normalised(values: pd.DataFrame, name: str, at: float = 1e-3) -> pd.DataFrame:
    """One quantity over its value at the rate `at` with the same sizes, and the error of that quotient.

    The two runs are independent, so relative errors add in squares; the point at `at` keeps its own.
    """
    parts = []
    for _, table in values.groupby("ratio"):
        reference = table[np.isclose(table.rate, at)].iloc[0]
        relative = table[f"{name}_error"] / table[name]
        other = np.where(
            np.isclose(table.rate, at), 0.0, reference[f"{name}_error"] / reference[name]
        )
        part = table[["ratio", "rate", "inertial_dmax", "inertial_d50", "inertial_dbar"]].copy()
        part["value"] = table[name] / reference[name]
        part["error"] = part["value"] * np.hypot(relative, other)
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def change(values: pd.DataFrame, name: str, above: float, below: float) -> tuple[float, float]:
    """Relative change of a quantity from the rate `above` down to `below`, for one size ratio, and its error."""
    high, low = (values[np.isclose(values.rate, rate)].iloc[0] for rate in (above, below))
    quotient = low[name] / high[name]
    error = quotient * np.hypot(
        low[f"{name}_error"] / low[name], high[f"{name}_error"] / high[name]
    )
    return quotient - 1, error


def sliding_array(friction: float, slope: float = 1.0) -> float:
    """Axial over lateral stress of a face-centred cubic array that slides under compression along <100>.

    `slope` is the tangent of the angle between its contacts and the axis, 1 before it deforms: Thornton (1979). Derived
    in the notebook.
    """
    return 2 * (1 + friction * slope) / (slope * (slope - friction))
