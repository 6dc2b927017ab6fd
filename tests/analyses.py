"""A call of each function that computes the steps of a scene, for tests that hold for all of them.

`test_all_analyses_are_called` of `tests/identities/test_analyses.py` fails where a method of the accessor, or a class
of `FrameAnalysis`, has no call here.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Mapping
from importlib import import_module

import numpy as np
import xarray as xr

import xcg
from xcg.accessor import CoarseGrainAccessor, Method
from xcg.steps.analysis import FrameAnalysis

EDGE = 3.0
PHASES = {"by": "species", "groups": [1, 2]}
PLANE = xcg.Plane((0, 0, 1.4), (0, 0, 1))
ABOVE_A_FLOOR = ("depth_average", "wall_stress")
FLOOR = xcg.Plane((0, 0, 0), (0, 0, 1))


def moving_spheres(name: str, steps: int = 3, offsets: np.ndarray | None = None) -> xr.Dataset:
    """Return moving spheres with contacts for a call, in memory: in a periodic box, or above a floor.

    Parameters
    ----------
    offsets : array (steps,), optional
        Offsets of the images along y of a box of Lees and Edwards (m), whose spheres are the same in all steps.
    """
    r = np.random.default_rng(2)
    start = r.uniform(0, EDGE, (40, 3))
    walk = 0.05 * r.normal(size=(steps, 40, 3)).cumsum(axis=0)
    options = {}
    if offsets is not None:
        walk = np.zeros_like(walk)
        options = {"lattice": {"xy": offsets}, "shear_rate": {"xy": 0.1}}
    position = start + walk
    if name in ABOVE_A_FLOOR:
        low = [np.flatnonzero(z < 0.3) for z in position[..., 2]]
        options["contact_i"] = low
        options["contact_j"] = [np.full(len(rows), -1) for rows in low]
        options["contact_point"] = [position[t, rows] * (1, 1, 0) for t, rows in enumerate(low)]
        options["contact_force"] = [np.ones((len(rows), 3)) for rows in low]
    ds = xcg.scene_from_arrays(
        position,
        velocity=np.tile(r.normal(size=(40, 3)), (steps, 1, 1)),
        angular_velocity=np.tile(r.normal(size=(40, 3)), (steps, 1, 1)),
        diameter=np.tile(r.uniform(0.4, 0.7, 40), (steps, 1)),
        density=1.0,
        species=np.tile(1 + np.arange(40) % 2, (steps, 1)),
        body_id=np.tile(np.arange(40) // 2, (steps, 1)),
        time=np.arange(float(steps)),
        box=dict.fromkeys("xyz", (0, EDGE)),
        periodic="xy" if name in ABOVE_A_FLOOR else "xyz",
        **options,
    )
    if name in ABOVE_A_FLOOR:
        return ds
    return ds.cg.find_contacts(k_n=1.0)


def _stress(ds: xr.Dataset) -> xr.Dataset:
    """Return fields of a scene, which do not depend on rows of padding."""
    bounds = {"z": (0.0, EDGE)}
    return ds.cg.coarse_grain(["density", "contact_stress"], axes="z", width=0.5, bounds=bounds)


def _fitted_shear(ds: xr.Dataset) -> xr.Dataset:
    f = ds.cg.coarse_grain("velocity", axes="z", width=0.5).sel(component="x")
    return f.cg.fit_law(lambda z, a, b: a + b * z, x="z", y="velocity")


CALLS: Mapping[str, Callable[[xr.Dataset], xr.Dataset]] = {
    "coarse_grain": lambda ds: ds.cg.coarse_grain(
        ["density", "velocity", "stress"], width=0.8, spacing=1.0
    ),
    "coarse_grain by phases": lambda ds: ds.cg.coarse_grain(
        ["density", "contact_stress"], axes="z", width=0.5, **PHASES
    ),
    "displacement": lambda ds: ds.cg.displacement(axes="z", width=0.8, lag=1),
    "mean_squared_displacement": lambda ds: ds.cg.mean_squared_displacement([1]),
    "velocity_autocorrelation": lambda ds: ds.cg.velocity_autocorrelation([1]),
    # without its norm, a mean of all nodes that dask takes in another order
    "balance": lambda ds: ds.cg.balance(axes="z", width=0.8, spacing=0.3)[["force_residual"]],
    "width_sweep": lambda ds: ds.cg.width_sweep([0.5, 0.8], "density", axes="z"),
    "slice_temperature": lambda ds: ds.cg.slice_temperature(),
    "cell_volumes": lambda ds: ds.cg.cell_volumes(1.0, **PHASES),
    "depth_average": lambda ds: ds.cg.depth_average(width=0.5),
    "flow_rate": lambda ds: ds.cg.flow_rate(PLANE, width=0.5),
    "wall_stress": lambda ds: ds.cg.wall_stress(FLOOR, 0.5, within=0.5),
    "find_contacts": lambda ds: _stress(ds.cg.find_contacts(k_n=2.0)),
    "microstructure": lambda ds: ds.cg.microstructure(),
    "contact_history": lambda ds: ds.cg.contact_history([1]),
    "voronoi": lambda ds: ds.cg.voronoi(),
    "particle_stress": lambda ds: ds.cg.particle_stress(),
    "force_chains": lambda ds: ds.cg.force_chains(),
    "select_chains": lambda ds: ds.cg.force_chains().cg.select_chains(min_stress=1e-3),
    "radial_distribution": lambda ds: ds.cg.radial_distribution(1.2, axis="z", **PHASES),
    "radial_distribution, scaled": lambda ds: ds.cg.radial_distribution(1.2, scaled=True),
    "contact_value": lambda ds: ds.cg.contact_value(**PHASES),
    "structure_factor": lambda ds: ds.cg.structure_factor(9.0, bins=5, samples=None, **PHASES),
    "structure_factor of waves": lambda ds: ds.cg.structure_factor(vectors=[(1, 0, 0), (2, -1, 3)]),
    "bond_order": lambda ds: ds.cg.bond_order(neighbours=4),
    "bond_order by distance": lambda ds: ds.cg.bond_order([5], r_max=1.0),
    "select": lambda ds: _stress(ds.cg.select("z > 1.5 and species == 1")),
    "derive": lambda ds: ds.drop_vars("velocity").cg.derive("velocity"),
    "derive of contacts": lambda ds: ds.cg.derive(["coordination_number", "mean_contact_age"]),
    "group_bodies": lambda ds: _stress(ds.drop_vars("species").cg.group_bodies()),
    "assign_phases": lambda ds: ds.cg.assign_phases(mapping={1: 2, 2: 1}),
    "fit_law": _fitted_shear,
}
# methods of a scene that return no result for each step, or only change attributes
OTHERS = {
    "explain": "text", "choose_width": "one answer for the series", "adjacency": "a sparse matrix of one step",
    "contact_graph": "a graph of one step", "measure": "attributes", "size_statistics": "attributes",
    "find_phases": "one answer for the series", "select_walls": "rows of contacts",
    "derive_director": "arithmetic of a variable", "derive_superquadric": "arithmetic of a variable",
    "plot_phases": "a picture", "plot_rose": "a picture", "plot": "a picture",
    "to_pyvista": "a mesh", "view": "a picture",
    "save": "a file", "explore": "a page",
}  # fmt: skip
# analyses that are parts of others
PARTS = {"_Ends": "a check of flow_rate through surfaces with open ends"}
# results that are computed when the function returns
COMPUTED = {
    "contact_history",
    "derive of contacts",
    "mean_squared_displacement",
    "velocity_autocorrelation",
    "fit_law",
}


def methods(kind: str) -> set[str]:
    """Return the names of the accessor's methods for a kind of Dataset."""
    rows = vars(CoarseGrainAccessor).items()
    return {name for name, row in rows if isinstance(row, Method) and kind in row.kinds}


def classes() -> set[type[FrameAnalysis]]:
    """Return the analyses of the package: the subclasses of FrameAnalysis without subclasses of their own."""
    for module in pkgutil.walk_packages(xcg.__path__, "xcg."):
        if not module.name.startswith(("xcg.explore", "xcg.readers.engines")):
            import_module(module.name)
    unseen = [FrameAnalysis]
    leaves = set()
    while unseen:
        cls = unseen.pop()
        below = [c for c in cls.__subclasses__() if c.__module__.startswith("xcg.")]
        unseen += below
        if not below and cls is not FrameAnalysis:
            leaves.add(cls)
    return leaves
