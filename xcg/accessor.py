"""The accessor `ds.cg`: its methods are the functions of the package that take a Dataset first.

A function is loaded when its method is first used. Where it stands says ``accessor.pyi``, so that editors and type
checkers know its arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import MethodType
from typing import Any

import xarray as xr

from xcg.stubs import homes

SCENE, RESULT, CHAINS = "scene", "result", "chains"
_HOMES = homes(__file__)
_SUMMARIES = {
    SCENE: ("xcg.scene.summary", "summary_of_scene"),
    RESULT: ("xcg.steps.summary", "summary_of_result"),
    CHAINS: ("xcg.chains.results", "summary_of_chains"),
}


def _load(module: str, name: str) -> Any:
    return getattr(import_module(module), name)


def kind_of(ds: xr.Dataset) -> str:
    """Tell a scene from a result of `force_chains` and from other results."""
    if "chain_id" in ds:
        return CHAINS
    return SCENE if "position" in ds else RESULT


class Method:
    """The function of its name as a method: bound as methods are, with signature, docstring and source of its own.

    Parameters
    ----------
    *kinds : str
        Kinds of Datasets that it is offered for.
    """

    def __init__(self, *kinds: str) -> None:
        self.kinds = kinds

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, accessor: CoarseGrainAccessor | None, owner: type) -> Callable:
        function = _load(_HOMES[self.name], self.name)
        return function if accessor is None else MethodType(function, accessor._ds)


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

    def __dir__(self) -> list[str]:
        kind = kind_of(self._ds)
        others = {n for n, m in vars(type(self)).items() if isinstance(m, Method) and kind not in m.kinds}
        return [name for name in super().__dir__() if name not in others]

    def _summary(self) -> Any:
        return _load(*_SUMMARIES[kind_of(self._ds)])(self._ds)

    coarse_grain = Method(SCENE)
    explain = Method(SCENE)
    displacement = Method(SCENE)
    mean_squared_displacement = Method(SCENE)
    width_sweep = Method(SCENE)
    balance = Method(SCENE)
    slice_temperature = Method(SCENE)
    wall_stress = Method(SCENE)
    find_contacts = Method(SCENE)
    microstructure = Method(SCENE)
    particle_stress = Method(SCENE)
    force_chains = Method(SCENE)
    measure = Method(SCENE)
    size_statistics = Method(SCENE)
    group_bodies = Method(SCENE)
    find_phases = Method(SCENE)
    assign_phases = Method(SCENE)
    plot_phases = Method(SCENE)
    select_walls = Method(SCENE)

    profile = Method(RESULT)
    time_average = Method(RESULT)
    spatial_correlation = Method(RESULT)
    time_correlation = Method(RESULT)
    plot = Method(RESULT)
    movie = Method(RESULT)

    select_chains = Method(CHAINS)
    track_chains = Method(CHAINS)
    chain_table = Method(CHAINS)
    link_table = Method(CHAINS)
    plot_chains = Method(CHAINS)
    plot_lengths = Method(CHAINS)
    plot_rose = Method(CHAINS)
    to_csv = Method(CHAINS)
    to_vtp = Method(CHAINS)

    to_vtkhdf = Method(RESULT, CHAINS)
    to_vtu = Method(RESULT)
    save = Method(SCENE, RESULT, CHAINS)
