"""Coarse-graining of granular matter: from DEM output to continuum fields."""

from importlib.metadata import version

from xcg import datasets
from xcg.accessor import CoarseGrainAccessor
from xcg.balance import balance
from xcg.coarse_grain import coarse_grain
from xcg.fields import FIELDS
from xcg.readers.series import open_scene
from xcg.scene import measure, scene_from_arrays
from xcg.schema import SceneError, SceneWarning
from xcg.smoothing import Gaussian, Heaviside, Kernel, Lucy, register_kernel
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
    "balance",
    "coarse_grain",
    "datasets",
    "measure",
    "open_scene",
    "register_kernel",
    "scene_from_arrays",
    "width_sweep",
]
