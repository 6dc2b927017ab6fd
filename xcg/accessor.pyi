"""Methods of `ds.cg`: read by editors and type checkers, and by `accessor.py`, which loads their functions.

A method is one line of the class below, with the kinds of Datasets that it is offered for. Functions in `__all__` are
public names of `xcg` as well.
"""

from collections.abc import Callable
from typing import (
    Concatenate,
    Generic,
    Literal,
    ParamSpec,
    TypeAlias,
    TypeVar,
    overload,
    type_check_only,
)

import xarray as xr

from .analysis.balance import balance
from .analysis.bond_order import bond_order
from .analysis.cell_volumes import cell_volumes
from .analysis.chain_results import chain_table, link_table, plot_chains, plot_rose
from .analysis.chain_selection import select_chains
from .analysis.choose_width import choose_width, plot_width
from .analysis.compare import compare
from .analysis.contact_history import contact_history
from .analysis.contact_value import contact_value
from .analysis.correlations import spatial_correlation, time_correlation
from .analysis.derive import derive
from .analysis.derived import derive_director, derive_superquadric
from .analysis.diffusion import mean_squared_displacement, velocity_autocorrelation
from .analysis.displacement import displacement
from .analysis.find_contacts import find_contacts
from .analysis.fit_law import fit_law
from .analysis.flow_rate import flow_rate
from .analysis.force_chains import force_chains, track_chains
from .analysis.microstructure import microstructure
from .analysis.movie import movie
from .analysis.network import adjacency, contact_graph
from .analysis.particle_stress import particle_stress
from .analysis.plots import plot
from .analysis.principal import plot_principal, principal
from .analysis.radial_distribution import radial_distribution
from .analysis.shallow import depth_average, fit_slope, free_surface
from .analysis.slice_temperature import slice_temperature
from .analysis.structure_factor import structure_factor
from .analysis.voronoi import voronoi
from .analysis.wall_stress import wall_stress
from .analysis.widths import width_sweep
from .explore.app import explore
from .fields.coarse_grain import coarse_grain, explain
from .fields.formulas.averages import coarsen, profile, time_average
from .scene.bodies import group_bodies
from .scene.contacts import select_walls
from .scene.measure import measure, size_statistics
from .scene.phases import assign_phases, find_phases, plot_phases
from .scene.selected import select
from .writers.chains import to_csv, to_vtp
from .writers.paraview import to_vtu
from .writers.save import save
from .writers.view import to_pyvista, view

__all__ = [
    "adjacency",
    "assign_phases",
    "balance",
    "bond_order",
    "cell_volumes",
    "chain_table",
    "choose_width",
    "coarse_grain",
    "coarsen",
    "compare",
    "contact_graph",
    "contact_history",
    "contact_value",
    "depth_average",
    "derive",
    "derive_director",
    "derive_superquadric",
    "displacement",
    "find_contacts",
    "find_phases",
    "fit_law",
    "fit_slope",
    "flow_rate",
    "force_chains",
    "free_surface",
    "group_bodies",
    "link_table",
    "mean_squared_displacement",
    "measure",
    "microstructure",
    "movie",
    "particle_stress",
    "plot",
    "plot_chains",
    "plot_phases",
    "plot_principal",
    "plot_rose",
    "plot_width",
    "principal",
    "profile",
    "radial_distribution",
    "save",
    "select",
    "select_chains",
    "select_walls",
    "size_statistics",
    "slice_temperature",
    "spatial_correlation",
    "structure_factor",
    "time_average",
    "time_correlation",
    "track_chains",
    "velocity_autocorrelation",
    "voronoi",
    "wall_stress",
    "width_sweep",
]

P = ParamSpec("P")
R = TypeVar("R")

Kind: TypeAlias = Literal["scene", "result", "chains"]
SCENE: Kind
RESULT: Kind
CHAINS: Kind

def kind_of(ds: xr.Dataset) -> Kind: ...

class Method:
    module: str
    name: str
    kinds: tuple[Kind, ...]
    def __init__(self, module: str, name: str, *kinds: Kind) -> None: ...

# at run time each method is a `Method`, which imports its function when it is first used
@type_check_only
class _Bound(Generic[P, R]):
    def __init__(self, function: Callable[Concatenate[xr.Dataset, P], R], *kinds: Kind) -> None: ...
    @overload
    def __get__(self, accessor: None, owner: type) -> Callable[Concatenate[xr.Dataset, P], R]: ...
    @overload
    def __get__(self, accessor: CoarseGrainAccessor, owner: type) -> Callable[P, R]: ...

class CoarseGrainAccessor:
    def __init__(self, ds: xr.Dataset) -> None: ...
    def _repr_html_(self) -> str: ...
    coarse_grain = _Bound(coarse_grain, "scene")
    explain = _Bound(explain, "scene")
    displacement = _Bound(displacement, "scene")
    mean_squared_displacement = _Bound(mean_squared_displacement, "scene")
    velocity_autocorrelation = _Bound(velocity_autocorrelation, "scene")
    width_sweep = _Bound(width_sweep, "scene")
    choose_width = _Bound(choose_width, "scene")
    balance = _Bound(balance, "scene")
    slice_temperature = _Bound(slice_temperature, "scene")
    cell_volumes = _Bound(cell_volumes, "scene")
    depth_average = _Bound(depth_average, "scene")
    flow_rate = _Bound(flow_rate, "scene")
    wall_stress = _Bound(wall_stress, "scene")
    find_contacts = _Bound(find_contacts, "scene")
    microstructure = _Bound(microstructure, "scene")
    adjacency = _Bound(adjacency, "scene")
    contact_graph = _Bound(contact_graph, "scene")
    contact_history = _Bound(contact_history, "scene")
    voronoi = _Bound(voronoi, "scene")
    particle_stress = _Bound(particle_stress, "scene")
    force_chains = _Bound(force_chains, "scene")
    radial_distribution = _Bound(radial_distribution, "scene")
    contact_value = _Bound(contact_value, "scene")
    structure_factor = _Bound(structure_factor, "scene")
    bond_order = _Bound(bond_order, "scene")
    measure = _Bound(measure, "scene")
    size_statistics = _Bound(size_statistics, "scene")
    group_bodies = _Bound(group_bodies, "scene")
    find_phases = _Bound(find_phases, "scene")
    assign_phases = _Bound(assign_phases, "scene")
    plot_phases = _Bound(plot_phases, "scene")
    select = _Bound(select, "scene")
    select_walls = _Bound(select_walls, "scene")
    derive_director = _Bound(derive_director, "scene")
    derive_superquadric = _Bound(derive_superquadric, "scene")
    derive = _Bound(derive, "scene")
    principal = _Bound(principal, "result")
    plot_principal = _Bound(plot_principal, "result")
    profile = _Bound(profile, "result")
    coarsen = _Bound(coarsen, "result")
    time_average = _Bound(time_average, "result")
    spatial_correlation = _Bound(spatial_correlation, "result")
    time_correlation = _Bound(time_correlation, "result")
    free_surface = _Bound(free_surface, "result")
    compare = _Bound(compare, "result")
    fit_law = _Bound(fit_law, "result")
    fit_slope = _Bound(fit_slope, "result")
    plot = _Bound(plot, "scene", "result")
    plot_width = _Bound(plot_width, "result")
    movie = _Bound(movie, "result")
    select_chains = _Bound(select_chains, "chains")
    track_chains = _Bound(track_chains, "chains")
    chain_table = _Bound(chain_table, "chains")
    link_table = _Bound(link_table, "chains")
    plot_chains = _Bound(plot_chains, "chains")
    plot_rose = _Bound(plot_rose, "scene", "chains")
    to_csv = _Bound(to_csv, "chains")
    to_vtp = _Bound(to_vtp, "chains")
    to_vtu = _Bound(to_vtu, "result")
    to_pyvista = _Bound(to_pyvista, "scene", "result", "chains")
    view = _Bound(view, "scene", "result", "chains")
    save = _Bound(save, "scene", "result", "chains")
    explore = _Bound(explore, "scene", "result")
