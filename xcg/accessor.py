"""The accessor `ds.cg`: its methods are the functions of the package that take a Dataset first.

The methods, and the kinds of Datasets that they are offered for, are listed in ``accessor.pyi``, where editors and
type checkers find their arguments. A function is loaded when its method is first used.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from importlib import import_module
from types import MethodType
from typing import Any

import xarray as xr

from xcg.common.stubs import modules_of, read_stub

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
    module, name : str
        Where the function is.
    *kinds : str
        Kinds of Datasets that it is offered for.
    """

    def __init__(self, module: str, name: str, *kinds: str) -> None:
        self.module = module
        self.name = name
        self.kinds = kinds

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


def _add_methods() -> None:
    """Add the methods of the stub, which lists them as ``name = _Bound(name, "scene", ...)``."""
    stub = read_stub("accessor.pyi")
    modules = modules_of(stub)
    for node in ast.walk(stub[-1]):
        if isinstance(node, ast.Call):
            function, *kinds = node.args
            name = ast.unparse(function)
            method = Method(f"xcg.{modules[name]}", name, *map(ast.literal_eval, kinds))
            setattr(CoarseGrainAccessor, name, method)


_add_methods()


class Accessor:
    """``ds.cg``, made anew at each use.

    An accessor that xarray registers is kept by its Dataset, which it holds in turn: arrays of a
    Dataset that nobody needs any more would stay until Python looks for such circles.
    """

    def __get__(self, ds: xr.Dataset | None, kind: type) -> Any:
        if ds is None:
            return CoarseGrainAccessor
        return CoarseGrainAccessor(ds)
