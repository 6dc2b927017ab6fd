"""The accessor `ds.cg`: each method is one call of the function of the same name."""

from __future__ import annotations

from functools import wraps
from pathlib import Path
from typing import Any

import xarray as xr

from xcg.coarse_grain import coarse_grain
from xcg.plan import Plan, make_plan
from xcg.scene import measure, summary


@xr.register_dataset_accessor("cg")
class CoarseGrainAccessor:
    """Coarse-graining of a scene, and saving of its fields."""

    def __init__(self, ds: xr.Dataset) -> None:
        self._ds = ds

    def __repr__(self) -> str:
        return summary(self._ds)

    @wraps(coarse_grain, assigned=("__doc__",))
    def coarse_grain(self, fields: Any = None, **options: Any) -> xr.Dataset:
        return coarse_grain(self._ds, fields, **options)

    @wraps(make_plan, assigned=("__doc__",))
    def explain(self, fields: Any = None, **options: Any) -> Plan:
        return make_plan(self._ds, fields, **options)

    @wraps(measure, assigned=("__doc__",))
    def measure(self) -> xr.Dataset:
        return measure(self._ds)

    def to_vtkhdf(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write fields as one temporal VTKHDF file, see `xcg.writers.vtkhdf.to_vtkhdf`."""
        from xcg.writers.vtkhdf import to_vtkhdf

        return to_vtkhdf(self._ds, path, overwrite=overwrite)
