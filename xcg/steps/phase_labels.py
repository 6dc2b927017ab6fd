"""Labels of phases: text, as "bulk" and "wall" are, and found by whole numbers, too."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike
from xarray.indexes import PandasIndex

PHASES = ("phase", "other_phase")


class PhaseLabels(pd.Index):
    """Text in which ``1`` finds "1": ``f.sel(phase=1)`` is ``f.sel(phase="1")``.

    It is a pandas index that xarray keeps inside its own, as its index of calendars is. So results align with those
    that were opened from files, which have the same labels as plain text.
    """

    def __new__(cls, data: ArrayLike, name: Any = None, **_: Any) -> Self:
        """Take labels as they come; pandas calls this, too."""
        return cls._simple_new(np.array(data, dtype=object), name)  # type: ignore[attr-defined]

    def get_loc(self, key: Any) -> Any:
        """Place of one label."""
        return super().get_loc(_as_text(key))

    def get_indexer(self, target: Any, *args: Any, **options: Any) -> Any:
        """Places of several labels, -1 where there is none."""
        labels = pd.Index([_as_text(label) for label in target], dtype=object)
        return super().get_indexer(labels, *args, **options)

    def slice_indexer(self, start: Any = None, end: Any = None, step: int | None = None) -> Any:
        """Places from one label to another."""
        return super().slice_indexer(_as_text(start), _as_text(end), step)


def _as_text(label: Any) -> Any:
    return str(label) if isinstance(label, (int, np.integer)) and not isinstance(label, bool) else label


def with_phase_labels(result: xr.Dataset) -> xr.Dataset:
    """Have phases of a result found by whole numbers, too."""
    for dim in PHASES:
        if dim in result.dims and dim in result.coords:
            plain = result[dim].variable
            index = PandasIndex(PhaseLabels(plain.to_numpy(), dim), dim, coord_dtype=plain.dtype)
            result = result.assign_coords(xr.Coordinates.from_xindex(index))
            result[dim].attrs, result[dim].encoding = plain.attrs, plain.encoding
    return result
