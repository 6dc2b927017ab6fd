"""The box of LAMMPS: bounds and tilts, as headers have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from xcg.readers.engine import StepRef


def with_bounds(ref: StepRef, low: ArrayLike, high: ArrayLike, tilts: Sequence[float] | None) -> StepRef:
    """Give a step its box, from lower and upper bounds (3,), which are those of the tilted box, and xy, xz, yz.

    Raises
    ------
    ValueError
        If a lower edge is not below the upper one.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    lattice = None
    if tilts is not None:
        xy, xz, yz = tilts
        low = low - [min(0.0, xy, xz, xy + xz), min(0.0, yz), 0.0]
        high = high - [max(0.0, xy, xz, xy + xz), max(0.0, yz), 0.0]
        x, y, z = (high - low).tolist()
        lattice = ((x, 0.0, 0.0), (xy, y, 0.0), (xz, yz, z))
    if not (low < high).all():
        raise ValueError
    return replace(ref, box=tuple(zip(low.tolist(), high.tolist(), strict=True)), lattice=lattice)
