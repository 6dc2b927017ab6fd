"""Frames and cells that shapes of walls are made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MOST_CELLS = 2**24


def axis_of(direction: NDArray) -> int | None:
    """Return the axis that a unit vector is along, None for others."""
    k = int(np.argmax(np.abs(direction)))
    return k if abs(direction[k]) > 1 - 1e-12 else None


def frame_about(direction: NDArray) -> tuple[NDArray, NDArray]:
    """Two unit vectors that make a right-handed frame with `direction` as the third; x and y for z."""
    k = axis_of(direction)
    first = np.eye(3)[(k + 1) % 3] if k is not None else np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first = first / np.linalg.norm(first)
    return first, np.cross(direction, first)


def cell_centres(low: float, high: float, spacing: float, what: str) -> NDArray:
    """Centres of cells of one size, as near to `spacing` as fits."""
    if not (
        np.isfinite(low) and np.isfinite(high) and low < high and spacing > 0 and (high - low) / spacing < _MOST_CELLS
    ):
        raise ValueError(
            f"cells along {what} from {low} to {high}, {spacing} apart: expected rising bounds and a positive spacing"
        )
    count = max(1, round((high - low) / spacing))
    return low + (high - low) * (np.arange(count) + 0.5) / count


def corners(lower: NDArray, upper: NDArray) -> NDArray:
    """Corners (8, 3) of a box."""
    return np.array([[(lower, upper)[b][k] for k, b in enumerate(bits)] for bits in np.ndindex(2, 2, 2)])
