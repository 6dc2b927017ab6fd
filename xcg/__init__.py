"""Coarse-graining of granular matter: from DEM output to continuum fields."""

from importlib.metadata import version

from xcg import datasets
from xcg.accessor import CoarseGrainAccessor
from xcg.coarse_grain import coarse_grain
from xcg.detection import find_contacts
from xcg.fields import FIELDS
from xcg.microstructure import microstructure
from xcg.readers.series import open_scene
from xcg.scene import measure, scene_from_arrays
from xcg.schema import SceneError, SceneWarning
from xcg.smoothing import Gaussian, Heaviside, Kernel, Lucy, register_kernel

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
    "coarse_grain",
    "datasets",
    "find_contacts",
    "measure",
    "microstructure",
    "open_scene",
    "register_kernel",
    "scene_from_arrays",
]
