"""Modules of public names: read by editors and type checkers, and by `xcg/__init__.py`, which loads them.

Functions that are also methods of `ds.cg` are listed in `accessor.pyi` alone.
"""

from . import accessor, datasets, readers
from .accessor import *  # noqa: F403
from .accessor import CoarseGrainAccessor
from .analysis.chain_selection import BoxRegion, Region, Sphere
from .analysis.pairs import find_pairs
from .common.messages import SceneError, SceneWarning
from .fields.formulas.field import Conduction, Flux, Mean, Sum, Variance
from .fields.formulas.registration import register_field
from .fields.formulas.registry import FIELDS
from .fields.grids.frames import Cylindrical, Rotated
from .fields.grids.walls import Cylinder, Plane, Surface
from .fields.presets.lammps import lammps_mesh
from .fields.presets.pysammos import pysammos_mesh
from .fields.sums.kernels import Gaussian, Heaviside, Kernel, Lucy, register_kernel
from .readers.engines.vtk import mesh_points
from .readers.from_table import scene_from_table
from .readers.live import scene_from_lammps
from .readers.open import open_scene
from .scene.from_arrays import scene_from_arrays
from .scene.schema import Variable
from .steps.analysis import FrameAnalysis
from .steps.faults import SkippedStep
from .writers.record import Recorder, record
from .writers.save import register_writer

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
    "datasets",
    "find_pairs",
    "lammps_mesh",
    "mesh_points",
    "open_scene",
    "pysammos_mesh",
    "readers",
    "record",
    "register_field",
    "register_kernel",
    "register_writer",
    "scene_from_arrays",
    "scene_from_lammps",
    "scene_from_table",
]
__all__ += accessor.__all__
