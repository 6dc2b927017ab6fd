"""Coarse-graining of granular matter: from DEM output to continuum fields."""

from importlib.metadata import version

from xcg import datasets
from xcg.accessor import CoarseGrainAccessor
from xcg.balance import balance
from xcg.chain_plots import plot_chains, plot_lengths, plot_rose
from xcg.chain_selection import select_chains
from xcg.chain_tables import chain_table, link_table
from xcg.chain_tracks import track_chains
from xcg.chains import force_chains
from xcg.coarse_grain import coarse_grain
from xcg.detection import find_contacts
from xcg.fields import FIELDS
from xcg.microstructure import microstructure
from xcg.particle_stress import particle_stress
from xcg.readers.series import open_scene
from xcg.regions import Box, Region, Sphere
from xcg.scene import measure, scene_from_arrays
from xcg.schema import SceneError, SceneWarning
from xcg.smoothing import Gaussian, Heaviside, Kernel, Lucy, register_kernel
from xcg.width_sweep import width_sweep

__version__ = version("xcg")
__all__ = [
    "FIELDS",
    "Box",
    "CoarseGrainAccessor",
    "Gaussian",
    "Heaviside",
    "Kernel",
    "Lucy",
    "Region",
    "SceneError",
    "SceneWarning",
    "Sphere",
    "balance",
    "chain_table",
    "coarse_grain",
    "datasets",
    "find_contacts",
    "force_chains",
    "link_table",
    "measure",
    "microstructure",
    "open_scene",
    "particle_stress",
    "plot_chains",
    "plot_lengths",
    "plot_rose",
    "register_kernel",
    "scene_from_arrays",
    "select_chains",
    "track_chains",
    "width_sweep",
]
