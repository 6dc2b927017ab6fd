"""The accessor `ds.cg`: its methods are the functions of the package that take a Dataset first."""

from __future__ import annotations

from collections.abc import Callable
from types import MethodType
from typing import Concatenate, Generic, ParamSpec, TypeVar, overload

import xarray as xr

from xcg.chains.particle_stress import particle_stress
from xcg.chains.plots import plot_chains, plot_lengths, plot_rose
from xcg.chains.results import summary_of_chains
from xcg.chains.search import force_chains
from xcg.chains.selection import select_chains
from xcg.chains.tables import chain_table, link_table
from xcg.chains.tracks import track_chains
from xcg.fields.coarse_grain import coarse_grain, explain
from xcg.fields.formulas.averages import profile, time_average
from xcg.fields.studies.balance import balance
from xcg.fields.studies.correlations import spatial_correlation, time_correlation
from xcg.fields.studies.diffusion import mean_squared_displacement
from xcg.fields.studies.displacement import displacement
from xcg.fields.studies.plots import movie, plot
from xcg.fields.studies.slice_temperature import slice_temperature
from xcg.fields.studies.wall_stress import wall_stress
from xcg.fields.studies.width_sweep import width_sweep
from xcg.packing.find_contacts import find_contacts
from xcg.packing.microstructure import microstructure
from xcg.scene.bodies import group_bodies
from xcg.scene.phases import assign_phases, find_phases, plot_phases
from xcg.scene.sizes import measure, size_statistics
from xcg.scene.summary import summary_of_scene
from xcg.scene.walls import select_walls
from xcg.steps.summary import summary_of_result
from xcg.writers.chains import to_csv, to_vtp
from xcg.writers.save import save
from xcg.writers.vtkhdf import to_vtkhdf
from xcg.writers.vtu import to_vtu

P = ParamSpec("P")
R = TypeVar("R")
SCENE, RESULT, CHAINS = "scene", "result", "chains"


def kind_of(ds: xr.Dataset) -> str:
    """Tell a scene from a result of `force_chains` and from other results."""
    if "chain_id" in ds:
        return CHAINS
    return SCENE if "position" in ds else RESULT


class Method(Generic[P, R]):
    """A function of a Dataset as a method: bound as methods are, with signature, docstring and source of its own.

    Parameters
    ----------
    function : callable
        It takes the Dataset first.
    *kinds : str
        Kinds of Datasets that it is offered for.
    """

    def __init__(self, function: Callable[Concatenate[xr.Dataset, P], R], *kinds: str) -> None:
        self.function = function
        self.kinds = kinds

    @overload
    def __get__(self, accessor: None, owner: type) -> Callable[Concatenate[xr.Dataset, P], R]: ...
    @overload
    def __get__(self, accessor: CoarseGrainAccessor, owner: type) -> Callable[P, R]: ...
    def __get__(
        self, accessor: CoarseGrainAccessor | None, owner: type
    ) -> Callable[P, R] | Callable[Concatenate[xr.Dataset, P], R]:
        return self.function if accessor is None else MethodType(self.function, accessor._ds)


_SUMMARIES = {SCENE: summary_of_scene, RESULT: summary_of_result, CHAINS: summary_of_chains}


class CoarseGrainAccessor:
    """Fields and force chains of a scene, and saving of them: functions of `xcg` as methods.

    Completion offers what fits: of a scene, of fields and other results, of force chains.
    """

    def __init__(self, ds: xr.Dataset) -> None:
        self._ds = ds

    def __repr__(self) -> str:
        return str(_SUMMARIES[kind_of(self._ds)](self._ds))

    def _repr_html_(self) -> str:
        return _SUMMARIES[kind_of(self._ds)](self._ds).html()

    def __dir__(self) -> list[str]:
        kind = kind_of(self._ds)
        others = {n for n, m in vars(type(self)).items() if isinstance(m, Method) and kind not in m.kinds}
        return [name for name in super().__dir__() if name not in others]

    coarse_grain = Method(coarse_grain, SCENE)
    explain = Method(explain, SCENE)
    displacement = Method(displacement, SCENE)
    mean_squared_displacement = Method(mean_squared_displacement, SCENE)
    width_sweep = Method(width_sweep, SCENE)
    balance = Method(balance, SCENE)
    slice_temperature = Method(slice_temperature, SCENE)
    wall_stress = Method(wall_stress, SCENE)
    find_contacts = Method(find_contacts, SCENE)
    microstructure = Method(microstructure, SCENE)
    particle_stress = Method(particle_stress, SCENE)
    force_chains = Method(force_chains, SCENE)
    measure = Method(measure, SCENE)
    size_statistics = Method(size_statistics, SCENE)
    group_bodies = Method(group_bodies, SCENE)
    find_phases = Method(find_phases, SCENE)
    assign_phases = Method(assign_phases, SCENE)
    plot_phases = Method(plot_phases, SCENE)
    select_walls = Method(select_walls, SCENE)

    profile = Method(profile, RESULT)
    time_average = Method(time_average, RESULT)
    spatial_correlation = Method(spatial_correlation, RESULT)
    time_correlation = Method(time_correlation, RESULT)
    plot = Method(plot, RESULT)
    movie = Method(movie, RESULT)

    select_chains = Method(select_chains, CHAINS)
    track_chains = Method(track_chains, CHAINS)
    chain_table = Method(chain_table, CHAINS)
    link_table = Method(link_table, CHAINS)
    plot_chains = Method(plot_chains, CHAINS)
    plot_lengths = Method(plot_lengths, CHAINS)
    plot_rose = Method(plot_rose, CHAINS)
    to_csv = Method(to_csv, CHAINS)
    to_vtp = Method(to_vtp, CHAINS)

    to_vtkhdf = Method(to_vtkhdf, RESULT, CHAINS)
    to_vtu = Method(to_vtu, RESULT)
    save = Method(save, SCENE, RESULT, CHAINS)
