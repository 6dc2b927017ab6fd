"""The accessor `ds.cg`: each method is one call of the function of the same name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from xcg.chains.particle_stress import particle_stress
from xcg.chains.plots import plot_chains, plot_lengths, plot_rose
from xcg.chains.regions import Region
from xcg.chains.results import summary_of_chains
from xcg.chains.search import force_chains
from xcg.chains.selection import select_chains
from xcg.chains.tables import chain_table, link_table
from xcg.chains.tracks import track_chains
from xcg.fields.averages import profile, time_average
from xcg.fields.balance import balance
from xcg.fields.coarse_grain import coarse_grain, explain
from xcg.fields.plan import Plan
from xcg.fields.slice_temperature import slice_temperature
from xcg.fields.width_sweep import width_sweep
from xcg.packing.find_contacts import find_contacts
from xcg.packing.microstructure import microstructure
from xcg.scene.bodies import group_bodies
from xcg.scene.phases import assign_phases, find_phases, plot_phases
from xcg.scene.schema import printable
from xcg.scene.sizes import measure, size_statistics
from xcg.scene.summary import summary
from xcg.writers.save import save


@xr.register_dataset_accessor("cg")
class CoarseGrainAccessor:
    """Fields and force chains of a scene, and saving of them."""

    def __init__(self, ds: xr.Dataset) -> None:
        self._ds = ds

    def __repr__(self) -> str:
        return printable(summary_of_chains(self._ds) if "chain_id" in self._ds else summary(self._ds))

    def coarse_grain(self, fields: Any = None, **options: Any) -> xr.Dataset:
        """Coarse-grain the scene, see `xcg.coarse_grain`."""
        return coarse_grain(self._ds, fields, **options)

    def explain(self, fields: Any = None, **options: Any) -> Plan:
        """Say what `coarse_grain` with the same arguments will do: print the plan that this returns."""
        return explain(self._ds, fields, **options)

    def particle_stress(self, **options: Any) -> xr.Dataset:
        """Stress of each particle, see `xcg.particle_stress`."""
        return particle_stress(self._ds, **options)

    def force_chains(
        self, alpha: float = 45.0, threshold: Any = None, min_length: int = 3, **options: Any
    ) -> xr.Dataset:
        """Force chains of each step, see `xcg.force_chains`."""
        return force_chains(self._ds, alpha, threshold, min_length, **options)

    def group_bodies(self, by_body: str = "body_id") -> xr.Dataset:
        """Group component spheres into bodies, see `xcg.group_bodies`."""
        return group_bodies(self._ds, by_body)

    def find_phases(self, max_phases: int = 8, **options: Any) -> xr.Dataset:
        """Find phases as clusters of diameter and density, see `xcg.find_phases`."""
        return find_phases(self._ds, max_phases, **options)

    def assign_phases(self, **options: Any) -> xr.Dataset:
        """Give grains phases by size edges or by a mapping of types, see `xcg.assign_phases`."""
        return assign_phases(self._ds, **options)

    def plot_phases(self, step: int = 0) -> Any:
        """Draw the clusters and scores of `find_phases`, see `xcg.plot_phases`."""
        return plot_phases(self._ds, step)

    def size_statistics(self) -> xr.Dataset:
        """Sizes of the grains in each step, see `xcg.size_statistics`."""
        return size_statistics(self._ds)

    def slice_temperature(self, axis: str = "z", **options: Any) -> xr.Dataset:
        """Granular temperature of the scene in slices, see `xcg.slice_temperature`."""
        return slice_temperature(self._ds, axis, **options)

    def profile(self, axis: str) -> xr.Dataset:
        """Average a result over its other axes, see `xcg.profile`."""
        return profile(self._ds, axis)

    def time_average(self, window: int | None = None, *, every: int = 1) -> xr.Dataset:
        """Average a result over time, with standard errors, see `xcg.time_average`."""
        return time_average(self._ds, window, every=every)

    def width_sweep(self, widths: Any, fields: Any = None, **options: Any) -> xr.Dataset:
        """Coarse-grain with several widths and find the plateau, see `xcg.width_sweep`."""
        return width_sweep(self._ds, widths, fields, **options)

    def balance(self, **options: Any) -> xr.Dataset:
        """Residuals of the balance laws, see `xcg.balance`."""
        return balance(self._ds, **options)

    def measure(self) -> xr.Dataset:
        """Measure sizes and extent of all steps, see `xcg.measure`."""
        return measure(self._ds)

    def find_contacts(self, **options: Any) -> xr.Dataset:
        """Find contacts from positions and diameters, see `xcg.find_contacts`."""
        return find_contacts(self._ds, **options)

    def microstructure(self, quantities: Any = None, **options: Any) -> xr.Dataset:
        """Measure the microstructure of the packing, see `xcg.microstructure`."""
        return microstructure(self._ds, quantities, **options)

    def select_chains(self, region: Region | None = None, **conditions: Any) -> xr.Dataset:
        """Keep the chains that fulfil a condition, see `xcg.select_chains`."""
        return select_chains(self._ds, region, **conditions)

    def track_chains(self, overlap: float = 0.5) -> xr.Dataset:
        """Follow chains over time, see `xcg.track_chains`."""
        return track_chains(self._ds, overlap)

    def chain_table(self) -> pd.DataFrame:
        """List all chains, see `xcg.chain_table`."""
        return chain_table(self._ds)

    def link_table(self) -> pd.DataFrame:
        """List all links, see `xcg.link_table`."""
        return link_table(self._ds)

    def plot_chains(self, **options: Any) -> Any:
        """Draw the chains of one step of a one-layer scene, see `xcg.plot_chains`."""
        return plot_chains(self._ds, **options)

    def plot_lengths(self, **options: Any) -> Any:
        """Draw the distribution of chain lengths, see `xcg.plot_lengths`."""
        return plot_lengths(self._ds, **options)

    def plot_rose(self, **options: Any) -> Any:
        """Draw the directions of links, see `xcg.plot_rose`."""
        return plot_rose(self._ds, **options)

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write a scene or a result as NetCDF, Zarr or VTKHDF, see `xcg.save`."""
        return save(self._ds, path, overwrite=overwrite)

    def to_csv(self, path: str | Path, *, overwrite: bool = False) -> list[Path]:
        """Write chains in the columns of Force Chain Finder, see `xcg.writers.chains.to_csv`."""
        from xcg.writers import chains

        return chains.to_csv(self._ds, path, overwrite=overwrite)

    def to_vtp(self, path: str | Path, *, overwrite: bool = False) -> list[Path]:
        """Write chains as VTK PolyData, see `xcg.writers.chains.to_vtp`."""
        from xcg.writers import chains

        return chains.to_vtp(self._ds, path, overwrite=overwrite)

    def to_vtkhdf(self, path: str | Path, *, overwrite: bool = False, **options: Any) -> Path:
        """Write fields or chains as temporal VTKHDF, see `to_vtkhdf` in `xcg.writers` `vtkhdf` and `chains`."""
        from xcg.writers import chains, vtkhdf

        writer = chains if "chain_id" in self._ds else vtkhdf
        return writer.to_vtkhdf(self._ds, path, overwrite=overwrite, **options)
