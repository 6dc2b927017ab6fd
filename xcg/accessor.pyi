"""Signatures of the methods of `ds.cg`, read by editors and type checkers."""

from collections.abc import Callable
from typing import Concatenate, Generic, ParamSpec, TypeVar, overload, type_check_only

import xarray as xr

from xcg.analysis.balance import balance
from xcg.analysis.bond_order import bond_order
from xcg.analysis.cell_volumes import cell_volumes
from xcg.analysis.chain_results import chain_table, link_table, plot_chains, plot_rose
from xcg.analysis.chain_selection import select_chains
from xcg.analysis.choose_width import choose_width, plot_width
from xcg.analysis.compare import compare
from xcg.analysis.contact_history import contact_history
from xcg.analysis.contact_value import contact_value
from xcg.analysis.correlations import spatial_correlation, time_correlation
from xcg.analysis.derive import derive
from xcg.analysis.derived import derive_director, derive_superquadric
from xcg.analysis.diffusion import mean_squared_displacement, velocity_autocorrelation
from xcg.analysis.displacement import displacement
from xcg.analysis.find_contacts import find_contacts
from xcg.analysis.fit_law import fit_law
from xcg.analysis.flow_rate import flow_rate
from xcg.analysis.force_chains import force_chains, track_chains
from xcg.analysis.microstructure import microstructure
from xcg.analysis.movie import movie
from xcg.analysis.network import adjacency, contact_graph
from xcg.analysis.particle_stress import particle_stress
from xcg.analysis.plots import plot
from xcg.analysis.principal import plot_principal, principal
from xcg.analysis.radial_distribution import radial_distribution
from xcg.analysis.shallow import depth_average, fit_slope, free_surface
from xcg.analysis.slice_temperature import slice_temperature
from xcg.analysis.structure_factor import structure_factor
from xcg.analysis.voronoi import voronoi
from xcg.analysis.wall_stress import wall_stress
from xcg.analysis.widths import width_sweep
from xcg.explore.app import explore
from xcg.fields.coarse_grain import coarse_grain, explain
from xcg.fields.formulas.averages import coarsen, profile, time_average
from xcg.scene.bodies import group_bodies
from xcg.scene.contacts import select_walls
from xcg.scene.measure import measure, size_statistics
from xcg.scene.phases import assign_phases, find_phases, plot_phases
from xcg.scene.selected import select
from xcg.writers.chains import to_csv, to_vtp
from xcg.writers.paraview import to_vtu
from xcg.writers.save import save
from xcg.writers.view import to_pyvista, view

P = ParamSpec("P")
R = TypeVar("R")

def kind_of(ds: xr.Dataset) -> str: ...

class Method:
    module: str
    kinds: tuple[str, ...]
    name: str
    def __init__(self, module: str, *kinds: str) -> None: ...

# at run time each method is a `Method`, which imports its function when it is first used
@type_check_only
class _Bound(Generic[P, R]):
    def __init__(self, function: Callable[Concatenate[xr.Dataset, P], R]) -> None: ...
    @overload
    def __get__(self, accessor: None, owner: type) -> Callable[Concatenate[xr.Dataset, P], R]: ...
    @overload
    def __get__(self, accessor: CoarseGrainAccessor, owner: type) -> Callable[P, R]: ...

class CoarseGrainAccessor:
    def __init__(self, ds: xr.Dataset) -> None: ...
    def _repr_html_(self) -> str: ...
    coarse_grain = _Bound(coarse_grain)
    explain = _Bound(explain)
    displacement = _Bound(displacement)
    mean_squared_displacement = _Bound(mean_squared_displacement)
    velocity_autocorrelation = _Bound(velocity_autocorrelation)
    width_sweep = _Bound(width_sweep)
    choose_width = _Bound(choose_width)
    balance = _Bound(balance)
    slice_temperature = _Bound(slice_temperature)
    cell_volumes = _Bound(cell_volumes)
    depth_average = _Bound(depth_average)
    flow_rate = _Bound(flow_rate)
    wall_stress = _Bound(wall_stress)
    find_contacts = _Bound(find_contacts)
    microstructure = _Bound(microstructure)
    adjacency = _Bound(adjacency)
    contact_graph = _Bound(contact_graph)
    contact_history = _Bound(contact_history)
    voronoi = _Bound(voronoi)
    particle_stress = _Bound(particle_stress)
    force_chains = _Bound(force_chains)
    radial_distribution = _Bound(radial_distribution)
    contact_value = _Bound(contact_value)
    structure_factor = _Bound(structure_factor)
    bond_order = _Bound(bond_order)
    measure = _Bound(measure)
    size_statistics = _Bound(size_statistics)
    group_bodies = _Bound(group_bodies)
    find_phases = _Bound(find_phases)
    assign_phases = _Bound(assign_phases)
    plot_phases = _Bound(plot_phases)
    select = _Bound(select)
    select_walls = _Bound(select_walls)
    derive_director = _Bound(derive_director)
    derive_superquadric = _Bound(derive_superquadric)
    derive = _Bound(derive)
    principal = _Bound(principal)
    plot_principal = _Bound(plot_principal)
    profile = _Bound(profile)
    coarsen = _Bound(coarsen)
    time_average = _Bound(time_average)
    spatial_correlation = _Bound(spatial_correlation)
    time_correlation = _Bound(time_correlation)
    free_surface = _Bound(free_surface)
    compare = _Bound(compare)
    fit_law = _Bound(fit_law)
    fit_slope = _Bound(fit_slope)
    plot = _Bound(plot)
    plot_width = _Bound(plot_width)
    movie = _Bound(movie)
    select_chains = _Bound(select_chains)
    track_chains = _Bound(track_chains)
    chain_table = _Bound(chain_table)
    link_table = _Bound(link_table)
    plot_chains = _Bound(plot_chains)
    plot_rose = _Bound(plot_rose)
    to_csv = _Bound(to_csv)
    to_vtp = _Bound(to_vtp)
    to_vtu = _Bound(to_vtu)
    to_pyvista = _Bound(to_pyvista)
    view = _Bound(view)
    save = _Bound(save)
    explore = _Bound(explore)
