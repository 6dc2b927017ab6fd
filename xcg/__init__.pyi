"""Where each public name stands: read by editors and type checkers, and by `xcg/__init__.py`, which loads it."""

from xcg import datasets, readers
from xcg.accessor import CoarseGrainAccessor
from xcg.chains.particle_stress import particle_stress
from xcg.chains.plots import plot_chains, plot_lengths, plot_rose
from xcg.chains.regions import Box, Region, Sphere
from xcg.chains.search import force_chains
from xcg.chains.selection import select_chains
from xcg.chains.tables import chain_table, link_table
from xcg.chains.tracks import track_chains
from xcg.fields.coarse_grain import coarse_grain
from xcg.fields.formulas.averages import profile, time_average
from xcg.fields.formulas.register import register_field
from xcg.fields.formulas.registry import FIELDS
from xcg.fields.formulas.variables import Flux, Mean, Sum, Variance
from xcg.fields.places.frames import Cylindrical, Rotated
from xcg.fields.places.surfaces.cylinder import Cylinder
from xcg.fields.places.surfaces.plane import Plane
from xcg.fields.places.surfaces.triangles import Surface
from xcg.fields.presets.lammps import lammps_mesh
from xcg.fields.presets.pysammos import pysammos_mesh
from xcg.fields.studies.balance import balance
from xcg.fields.studies.correlations import spatial_correlation, time_correlation
from xcg.fields.studies.diffusion import mean_squared_displacement
from xcg.fields.studies.displacement import displacement
from xcg.fields.studies.plots import movie, plot
from xcg.fields.studies.slice_temperature import slice_temperature
from xcg.fields.studies.wall_stress import wall_stress
from xcg.fields.studies.width_sweep import width_sweep
from xcg.fields.sums.smoothing import Gaussian, Heaviside, Kernel, Lucy, register_kernel
from xcg.packing.find_contacts import find_contacts
from xcg.packing.microstructure import microstructure
from xcg.packing.pairs import find_pairs
from xcg.readers.from_table import scene_from_table
from xcg.readers.live import scene_from_lammps
from xcg.readers.mesh_points import mesh_points
from xcg.readers.series import open_scene
from xcg.scene.bodies import group_bodies
from xcg.scene.build import scene_from_arrays
from xcg.scene.measure import measure, size_statistics
from xcg.scene.phases import assign_phases, find_phases, plot_phases
from xcg.scene.schema import SceneError, SceneWarning
from xcg.scene.walls import select_walls
from xcg.steps.errors import SkippedStep
from xcg.writers.record import Recorder, record
from xcg.writers.save import register_writer, save

__version__: str
__all__ = [
    "FIELDS",
    "Box",
    "CoarseGrainAccessor",
    "Cylinder",
    "Cylindrical",
    "Flux",
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
    "Variance",
    "assign_phases",
    "balance",
    "chain_table",
    "coarse_grain",
    "datasets",
    "displacement",
    "find_contacts",
    "find_pairs",
    "find_phases",
    "force_chains",
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
    "plot_lengths",
    "plot_phases",
    "plot_rose",
    "profile",
    "pysammos_mesh",
    "readers",
    "record",
    "register_field",
    "register_kernel",
    "register_writer",
    "save",
    "scene_from_arrays",
    "scene_from_lammps",
    "scene_from_table",
    "select_chains",
    "select_walls",
    "size_statistics",
    "slice_temperature",
    "spatial_correlation",
    "time_average",
    "time_correlation",
    "track_chains",
    "wall_stress",
    "width_sweep",
]
