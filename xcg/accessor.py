"""The accessor `ds.cg`: each method is one call of the function of the same name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from xcg.coarse_grain import coarse_grain
from xcg.detection import find_contacts
from xcg.microstructure import microstructure
from xcg.plan import Plan, make_plan
from xcg.scene import measure, summary


@xr.register_dataset_accessor("cg")
class CoarseGrainAccessor:
    """Coarse-graining of a scene, and saving of its fields."""

    def __init__(self, ds: xr.Dataset) -> None:
        self._ds = ds

    def __repr__(self) -> str:
        return summary(self._ds)

    def coarse_grain(self, fields: Any = None, **options: Any) -> xr.Dataset:
        """Coarse-grain the scene, see `xcg.coarse_grain`."""
        return coarse_grain(self._ds, fields, **options)

    def explain(self, fields: Any = None, **options: Any) -> Plan:
        """Say what `coarse_grain` with the same arguments will do: print the plan that this returns."""
        return make_plan(self._ds, fields, **options)

    def measure(self) -> xr.Dataset:
        """Measure sizes and extent of all steps, see `xcg.measure`."""
        return measure(self._ds)

    def find_contacts(self, **options: Any) -> xr.Dataset:
        """Find contacts from positions and diameters, see `xcg.find_contacts`."""
        return find_contacts(self._ds, **options)

    def microstructure(self, quantities: Any = None, **options: Any) -> xr.Dataset:
        """Measure the microstructure of the packing, see `xcg.microstructure`."""
        return microstructure(self._ds, quantities, **options)

    def to_vtkhdf(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write fields as one temporal VTKHDF file, see `xcg.writers.vtkhdf.to_vtkhdf`."""
        from xcg.writers.vtkhdf import to_vtkhdf

        return to_vtkhdf(self._ds, path, overwrite=overwrite)
