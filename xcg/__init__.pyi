"""Where each public name stands: read by editors and type checkers, and by `xcg/__init__.py`, which loads it."""

from . import datasets, readers
from .accessor import CoarseGrainAccessor
from .analysis.balance import balance
from .analysis.bond_order import bond_order
from .analysis.cell_volumes import cell_volumes
from .analysis.chain_results import chain_table, link_table, plot_chains, plot_rose
from .analysis.chain_selection import BoxRegion, Region, Sphere, select_chains
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
from .analysis.pairs import find_pairs
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
from .common.messages import SceneError, SceneWarning
from .fields.coarse_grain import coarse_grain
from .fields.formulas.averages import coarsen, profile, time_average
from .fields.formulas.field import Conduction, Flux, Mean, Sum, Variance
from .fields.formulas.registry import FIELDS, register_field
from .fields.grids.frames import Cylindrical, Rotated
from .fields.grids.walls import Cylinder, Plane, Surface
from .fields.presets.lammps import lammps_mesh
from .fields.presets.pysammos import pysammos_mesh
from .fields.sums.kernels import Gaussian, Heaviside, Kernel, Lucy, register_kernel
from .readers.engines.vtk import mesh_points
from .readers.from_table import scene_from_table
from .readers.live import scene_from_lammps
from .readers.open import open_scene
from .scene.bodies import group_bodies
from .scene.contacts import select_walls
from .scene.from_arrays import scene_from_arrays
from .scene.measure import measure, size_statistics
from .scene.phases import assign_phases, find_phases, plot_phases
from .scene.schema import Variable
from .scene.selected import select
from .steps.analysis import FrameAnalysis
from .steps.faults import SkippedStep
from .writers.record import Recorder, record
from .writers.save import register_writer, save

__version__: str
__all__ = [
    "FIELDS",
    "BoxRegion",
    "CoarseGrainAccessor",
    "Conduction",
    "Cylinder",
    "Cylindrical",
    "Flux",
    "FrameAnalysis",
    "Gaussian",
    "Heaviside",
    "Kernel",
    "Lucy",
    "Mean",
    "Plane",
    "Recorder",
    "Region",
    "Rotated",
    "SceneError",
    "SceneWarning",
    "SkippedStep",
    "Sphere",
    "Sum",
    "Surface",
    "Variable",
    "Variance",
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
    "datasets",
    "depth_average",
    "derive",
    "derive_director",
    "derive_superquadric",
    "displacement",
    "find_contacts",
    "find_pairs",
    "find_phases",
    "fit_law",
    "fit_slope",
    "flow_rate",
    "force_chains",
    "free_surface",
    "group_bodies",
    "lammps_mesh",
    "link_table",
    "mean_squared_displacement",
    "measure",
    "mesh_points",
    "microstructure",
    "movie",
    "open_scene",
    "particle_stress",
    "plot",
    "plot_chains",
    "plot_phases",
    "plot_principal",
    "plot_rose",
    "plot_width",
    "principal",
    "profile",
    "pysammos_mesh",
    "radial_distribution",
    "readers",
    "record",
    "register_field",
    "register_kernel",
    "register_writer",
    "save",
    "scene_from_arrays",
    "scene_from_lammps",
    "scene_from_table",
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
