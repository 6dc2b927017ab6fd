"""Private names of xarray that the package needs; Numba's are in `xcg.compiled._jit`.

Tried with xarray 2025.11 and 2026.9. Nothing else uses private names of other packages (a test
checks that), so a new version that moves one is met here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

# Backends derive their arrays from these, as xarray's documentation shows; it has no public name
# for the module.
from xarray.core.indexing import (
    ExplicitIndexer,
    IndexingSupport,
    LazilyIndexedArray,
    MemoryCachedArray,
    explicit_indexing_adapter,
)

__all__ = [
    "ExplicitIndexer",
    "IndexingSupport",
    "LazilyIndexedArray",
    "MemoryCachedArray",
    "explicit_indexing_adapter",
    "is_in_memory",
    "stored_data",
]


def stored_data(variable: xr.Variable) -> Any:
    """Return the array of a variable as it is; the public ``data`` would load that of a file."""
    return variable._data


def is_in_memory(variable: xr.Variable) -> bool:
    """Return whether the values of a variable are a NumPy array, neither lazy nor still in a file."""
    return isinstance(variable._data, np.ndarray)
