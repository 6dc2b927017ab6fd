"""The accessor `ds.cg`: its methods are the functions of the package that take a Dataset first.

A function is loaded when its method is first used. Editors and type checkers take its arguments from
``accessor.pyi``, which imports it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import MethodType
from typing import Any

import xarray as xr

SCENE = "scene"
RESULT = "result"
CHAINS = "chains"
_SUMMARIES = {
    SCENE: ("xcg.scene.summary", "summary_of_scene"),
    RESULT: ("xcg.steps.labels", "summary_of_result"),
    CHAINS: ("xcg.analysis.chain_results", "summary_of_chains"),
}


def kind_of(ds: xr.Dataset) -> str:
    """Return "scene", "chains" or "result": the kind of Dataset."""
    if "chain_id" in ds:
        return CHAINS
    return SCENE if "position" in ds else RESULT


# Names of other packages for methods.
_OTHER_NAMES = {
    "compute": "coarse_grain",
    "fields": "coarse_grain",
    "rdf": "radial_distribution",
    "g_r": "radial_distribution",
    "vacf": "velocity_autocorrelation",
    "msd": "mean_squared_displacement",
    "mean": "time_average",
    "average": "time_average",
    "difference": "compare",
    "subtract": "compare",
    "minus": "compare",
    "principal_stress": "principal",
    "eigenvalues": "principal",
    "slope": "fit_slope",
    "derive_velocity": "derive",
    "query": "select",
    "where": "select",
    "filter": "select",
    "crop": "select",
    "to_netcdf": "save",
    "to_zarr": "save",
    "write": "save",
    "export": "save",
    "to_vtk": "to_vtu",
    "to_vtkhdf": "save",
    "to_paraview": "save",
    "paraview": "save",
    "quiver": "plot",
    "streamplot": "plot",
    "contour": "plot",
    "scatter": "plot",
    "render": "view",
    "animate": "movie",
    "show": "view",
}


_CALLS = {
    **dict.fromkeys(("info", "describe", "summary", "help"), "print(ds.cg)"),
    **dict.fromkeys(("rotate", "rotated", "tilt"), "the argument frame=xcg.Rotated(...)"),
    "cylindrical": "the argument frame=xcg.Cylindrical(...)",
}


def _likely_call(name: str) -> str:
    """Return the method, call or field that was probably meant, as the end of a message."""
    fields = import_module("xcg.fields.formulas.registry")
    calls = fields.CALLS | _CALLS
    field = fields.OTHER_NAMES.get(name, name)
    if field in fields.FIELDS:
        method = "displacement" if fields.FIELDS[field].option == "lag" else "coarse_grain"
        calls.setdefault(name, f"ds.cg.{method}({field!r})")
    if hasattr(xr.Dataset, name):
        calls.setdefault(name, f"ds.{name}, a method of xarray")
    if name in calls and name not in _OTHER_NAMES:
        return f"; did you mean {calls[name]}?"
    messages = import_module("xcg.common.messages")
    methods = [n for n, m in vars(CoarseGrainAccessor).items() if isinstance(m, Method)]
    return str(messages.did_you_mean(name, methods, synonyms=_OTHER_NAMES))


class Method:
    """The function of its name as a method: bound as methods are, with signature, docstring and source of its own.

    Parameters
    ----------
    module : str
        Where the function is.
    *kinds : str
        Kinds of Datasets that it is offered for.
    """

    def __init__(self, module: str, *kinds: str) -> None:
        self.module = module
        self.kinds = kinds

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, accessor: CoarseGrainAccessor | None, owner: type) -> Callable:
        function = getattr(import_module(self.module), self.name)
        if accessor is None:
            return function
        return MethodType(function, accessor._ds)


class CoarseGrainAccessor:
    """Fields and force chains of a scene, and saving of them: functions of `xcg` as methods.

    Completion offers what fits: of a scene, of fields and other results, of force chains.
    """

    def __init__(self, ds: xr.Dataset) -> None:
        self._ds = ds

    def __repr__(self) -> str:
        return str(self._summary())

    def _repr_html_(self) -> str:
        return self._summary().html()

    def __getattr__(self, name: str) -> Any:
        """Raise AttributeError with the method or call that was probably meant."""
        if name.startswith("_"):
            raise AttributeError(name)
        raise AttributeError(f"ds.cg has no method {name!r}{_likely_call(name)}", name=name)

    def __dir__(self) -> list[str]:
        kind = kind_of(self._ds)
        others = {
            n for n, m in vars(type(self)).items() if isinstance(m, Method) and kind not in m.kinds
        }
        return [name for name in super().__dir__() if name not in others]

    def _summary(self) -> Any:
        module, name = _SUMMARIES[kind_of(self._ds)]
        return getattr(import_module(module), name)(self._ds)

    coarse_grain = Method("xcg.fields.coarse_grain", SCENE)
    explain = Method("xcg.fields.coarse_grain", SCENE)
    displacement = Method("xcg.analysis.displacement", SCENE)
    mean_squared_displacement = Method("xcg.analysis.diffusion", SCENE)
    velocity_autocorrelation = Method("xcg.analysis.diffusion", SCENE)
    width_sweep = Method("xcg.analysis.widths", SCENE)
    choose_width = Method("xcg.analysis.choose_width", SCENE)
    balance = Method("xcg.analysis.balance", SCENE)
    slice_temperature = Method("xcg.analysis.slice_temperature", SCENE)
    cell_volumes = Method("xcg.analysis.cell_volumes", SCENE)
    depth_average = Method("xcg.analysis.shallow", SCENE)
    flow_rate = Method("xcg.analysis.flow_rate", SCENE)
    wall_stress = Method("xcg.analysis.wall_stress", SCENE)
    find_contacts = Method("xcg.analysis.find_contacts", SCENE)
    microstructure = Method("xcg.analysis.microstructure", SCENE)
    adjacency = Method("xcg.analysis.network", SCENE)
    contact_graph = Method("xcg.analysis.network", SCENE)
    contact_history = Method("xcg.analysis.contact_history", SCENE)
    voronoi = Method("xcg.analysis.voronoi", SCENE)
    particle_stress = Method("xcg.analysis.particle_stress", SCENE)
    force_chains = Method("xcg.analysis.force_chains", SCENE)
    radial_distribution = Method("xcg.analysis.radial_distribution", SCENE)
    contact_value = Method("xcg.analysis.contact_value", SCENE)
    structure_factor = Method("xcg.analysis.structure_factor", SCENE)
    bond_order = Method("xcg.analysis.bond_order", SCENE)
    measure = Method("xcg.scene.measure", SCENE)
    size_statistics = Method("xcg.scene.measure", SCENE)
    group_bodies = Method("xcg.scene.bodies", SCENE)
    find_phases = Method("xcg.scene.phases", SCENE)
    assign_phases = Method("xcg.scene.phases", SCENE)
    plot_phases = Method("xcg.scene.phases", SCENE)
    select = Method("xcg.scene.selected", SCENE)
    select_walls = Method("xcg.scene.contacts", SCENE)
    derive_director = Method("xcg.analysis.derived", SCENE)
    derive_superquadric = Method("xcg.analysis.derived", SCENE)
    derive = Method("xcg.analysis.derive", SCENE)

    principal = Method("xcg.analysis.principal", RESULT)
    plot_principal = Method("xcg.analysis.principal", RESULT)
    profile = Method("xcg.fields.formulas.averages", RESULT)
    coarsen = Method("xcg.fields.formulas.averages", RESULT)
    time_average = Method("xcg.fields.formulas.averages", RESULT)
    spatial_correlation = Method("xcg.analysis.correlations", RESULT)
    time_correlation = Method("xcg.analysis.correlations", RESULT)
    free_surface = Method("xcg.analysis.shallow", RESULT)
    compare = Method("xcg.analysis.compare", RESULT)
    fit_law = Method("xcg.analysis.fit_law", RESULT)
    fit_slope = Method("xcg.analysis.shallow", RESULT)
    plot = Method("xcg.analysis.plots", SCENE, RESULT)
    plot_width = Method("xcg.analysis.choose_width", RESULT)
    movie = Method("xcg.analysis.movie", RESULT)

    select_chains = Method("xcg.analysis.chain_selection", CHAINS)
    track_chains = Method("xcg.analysis.force_chains", CHAINS)
    chain_table = Method("xcg.analysis.chain_results", CHAINS)
    link_table = Method("xcg.analysis.chain_results", CHAINS)
    plot_chains = Method("xcg.analysis.chain_results", CHAINS)
    plot_rose = Method("xcg.analysis.chain_results", SCENE, CHAINS)
    to_csv = Method("xcg.writers.chains", CHAINS)
    to_vtp = Method("xcg.writers.chains", CHAINS)

    to_vtu = Method("xcg.writers.paraview", RESULT)
    to_pyvista = Method("xcg.writers.view", SCENE, RESULT, CHAINS)
    view = Method("xcg.writers.view", SCENE, RESULT, CHAINS)
    save = Method("xcg.writers.save", SCENE, RESULT, CHAINS)
    explore = Method("xcg.explore.app", SCENE, RESULT)
