"""Coarse-graining of granular matter: from DEM output to continuum fields.

`open_scene` and `datasets.open` return a scene, an xarray Dataset whose accessor ``ds.cg`` has the
methods of xcg, such as ``ds.cg.coarse_grain(["velocity", "density"], axes="z")``. ``print(ds.cg)``
shows what a scene holds.

Names are loaded when they are first used, from the modules that ``__init__.pyi`` lists.
"""

from importlib import import_module
from importlib.metadata import version
from typing import Any

import lazy_loader
import xarray as xr

__version__ = version("xcg")
__getattr__, _, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __dir__() -> list[str]:
    """Completion shows what is public: modules have their own place in the documentation."""
    return [*__all__, "__version__"]


class _Accessor:
    """``ds.cg``, made anew at each use.

    An accessor that xarray registers is kept by its Dataset, which it holds in turn: arrays of a
    Dataset that nobody needs any more would stay until Python looks for such circles.
    """

    def __get__(self, ds: xr.Dataset | None, kind: type) -> Any:
        accessor = import_module("xcg.accessor").CoarseGrainAccessor
        return accessor if ds is None else accessor(ds)


xr.Dataset.cg = _Accessor()  # type: ignore[attr-defined]
