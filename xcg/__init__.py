"""Coarse-graining of granular matter: from DEM output to continuum fields."""

from importlib.metadata import version

from xcg import datasets
from xcg.accessor import CoarseGrainAccessor
from xcg.balance import balance
from xcg.bodies import group_bodies
from xcg.coarse_grain import coarse_grain
from xcg.fields import FIELDS
from xcg.phases import assign_phases, find_phases, plot_phases
from xcg.pysammos import pysammos_mesh
from xcg.readers.series import open_scene
from xcg.scene import measure, scene_from_arrays
from xcg.schema import SceneError, SceneWarning
from xcg.slices import slice_temperature
from xcg.smoothing import Gaussian, Heaviside, Kernel, Lucy, register_kernel
from xcg.statistics import profile, size_statistics, time_average
from xcg.width_sweep import width_sweep

__version__ = version("xcg")
__all__ = [
    "FIELDS",
    "CoarseGrainAccessor",
    "Gaussian",
    "Heaviside",
    "Kernel",
    "Lucy",
    "SceneError",
    "SceneWarning",
    "assign_phases",
    "balance",
    "coarse_grain",
    "datasets",
    "find_phases",
    "group_bodies",
    "measure",
    "open_scene",
    "plot_phases",
    "profile",
    "pysammos_mesh",
    "register_kernel",
    "scene_from_arrays",
    "size_statistics",
    "slice_temperature",
    "time_average",
    "width_sweep",
]
