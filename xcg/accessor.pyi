"""Where functions stand that are methods of `ds.cg`: read by editors and type checkers, and by `xcg/accessor.py`."""

from collections.abc import Callable
from typing import Concatenate, Generic, ParamSpec, TypeVar, overload

import xarray as xr

from xcg.analysis.contact_history import contact_history
from xcg.analysis.fit_law import fit_law
from xcg.analysis.voronoi import voronoi
from xcg.chains.particle_stress import particle_stress
from xcg.chains.results import chain_table, link_table, plot_chains, plot_lengths, plot_rose
from xcg.chains.search import force_chains, track_chains
from xcg.chains.selection import select_chains
from xcg.fields.analysis.balance import balance
from xcg.fields.analysis.correlations import spatial_correlation, time_correlation
from xcg.fields.analysis.derived import derive_director, derive_superquadric, derive_velocity
from xcg.fields.analysis.diffusion import mean_squared_displacement
from xcg.fields.analysis.displacement import displacement
from xcg.fields.analysis.plots import movie, plot
from xcg.fields.analysis.shallow import depth_average, fit_slope, free_surface
from xcg.fields.analysis.surfaces import flow_rate, wall_stress
from xcg.fields.analysis.widths import choose_width, plot_width, width_sweep
from xcg.fields.analysis.without_kernel import cell_volumes, slice_temperature
from xcg.fields.coarse_grain import coarse_grain, explain
from xcg.fields.formulas.averages import profile, time_average
from xcg.packing.find_contacts import find_contacts
from xcg.packing.microstructure import microstructure
from xcg.packing.network import adjacency, contact_graph
from xcg.scene.bodies import group_bodies
from xcg.scene.contacts import select_walls
from xcg.scene.frame import measure, size_statistics
from xcg.scene.phases import assign_phases, find_phases, plot_phases
from xcg.writers.chains import to_csv, to_vtp
from xcg.writers.paraview import to_vtu
from xcg.writers.save import save
from xcg.writers.view import to_pyvista, view
from xcg.writers.vtkhdf import to_vtkhdf

P = ParamSpec("P")
R = TypeVar("R")

def kind_of(ds: xr.Dataset) -> str: ...

class Method(Generic[P, R]):
    def __init__(self, function: Callable[Concatenate[xr.Dataset, P], R]) -> None: ...
    @overload
    def __get__(self, accessor: None, owner: type) -> Callable[Concatenate[xr.Dataset, P], R]: ...
    @overload
    def __get__(self, accessor: CoarseGrainAccessor, owner: type) -> Callable[P, R]: ...

class CoarseGrainAccessor:
    def __init__(self, ds: xr.Dataset) -> None: ...
    def _repr_html_(self) -> str: ...
    coarse_grain = Method(coarse_grain)
    explain = Method(explain)
    displacement = Method(displacement)
    mean_squared_displacement = Method(mean_squared_displacement)
    width_sweep = Method(width_sweep)
    choose_width = Method(choose_width)
    balance = Method(balance)
    slice_temperature = Method(slice_temperature)
    flow_rate = Method(flow_rate)
    depth_average = Method(depth_average)
    cell_volumes = Method(cell_volumes)
    wall_stress = Method(wall_stress)
    find_contacts = Method(find_contacts)
    microstructure = Method(microstructure)
    adjacency = Method(adjacency)
    contact_graph = Method(contact_graph)
    contact_history = Method(contact_history)
    voronoi = Method(voronoi)
    particle_stress = Method(particle_stress)
    force_chains = Method(force_chains)
    measure = Method(measure)
    size_statistics = Method(size_statistics)
    group_bodies = Method(group_bodies)
    find_phases = Method(find_phases)
    assign_phases = Method(assign_phases)
    plot_phases = Method(plot_phases)
    select_walls = Method(select_walls)
    derive_velocity = Method(derive_velocity)
    derive_director = Method(derive_director)
    derive_superquadric = Method(derive_superquadric)
    profile = Method(profile)
    time_average = Method(time_average)
    spatial_correlation = Method(spatial_correlation)
    time_correlation = Method(time_correlation)
    free_surface = Method(free_surface)
    fit_law = Method(fit_law)
    fit_slope = Method(fit_slope)
    plot = Method(plot)
    plot_width = Method(plot_width)
    movie = Method(movie)
    select_chains = Method(select_chains)
    track_chains = Method(track_chains)
    chain_table = Method(chain_table)
    link_table = Method(link_table)
    plot_chains = Method(plot_chains)
    plot_lengths = Method(plot_lengths)
    plot_rose = Method(plot_rose)
    to_csv = Method(to_csv)
    to_vtp = Method(to_vtp)
    to_vtkhdf = Method(to_vtkhdf)
    to_vtu = Method(to_vtu)
    to_pyvista = Method(to_pyvista)
    view = Method(view)
    save = Method(save)
