"""Rows of particles by their ids, and unit vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def rows_of(ids: NDArray, wanted: NDArray) -> NDArray:
    """Return the row of each wanted id among sorted ids (n,), -1 where it is not there.

    This is `wanted` itself where ids are 0, 1, 2, ...
    """
    if not len(ids):
        return np.full(len(wanted), -1)
    has_gaps = ids[-1] - ids[0] + 1 != len(ids)
    if not has_gaps:  # nothing to search for
        row = wanted - ids[0] if ids[0] else wanted
        known = (row >= 0) & (row < len(ids))
        return row if known.all() else np.where(known, row, -1)
    row = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
    return np.where(ids[row] == wanted, row, -1)


def unit_vectors(vector: NDArray) -> NDArray:
    """Return vectors (n, 3) over their lengths; zero where these are zero."""
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.divide(vector, length, out=np.zeros_like(vector), where=length > 0)
