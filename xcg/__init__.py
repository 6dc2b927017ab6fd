"""Coarse-graining of granular matter: from DEM output to continuum fields.

`open_scene` and `datasets.open` return a scene, an xarray Dataset whose accessor ``ds.cg`` has the
methods of xcg, such as ``ds.cg.coarse_grain(["velocity", "density"], axes="z")``. ``print(ds.cg)``
shows what a scene holds.

Names are loaded when they are first used, from the modules that ``__init__.pyi`` and ``accessor.pyi`` list.
"""

from importlib.metadata import version
from typing import Any

import lazy_loader
import xarray as xr

from xcg.accessor import Accessor
from xcg.common.stubs import modules_of, public_names, read_stub

__version__ = version("xcg")
_names: dict[str, list[str]] = {}
for _stub in (read_stub("__init__.pyi"), read_stub("accessor.pyi")):
    _modules = modules_of(_stub)
    for _name in public_names(_stub):
        _names.setdefault(_modules[_name], []).append(_name)
_load, _, __all__ = lazy_loader.attach(__name__, _names.pop(""), _names)

# Names of other packages for what is here.
_OTHER_NAMES = {
    "open": "open_scene",
    "load": "open_scene",
    "read": "open_scene",
    "open_dataset": "open_scene",
    "open_mfdataset": "open_scene",
    "load_dataset": "open_scene",
    "read_lammps": "open_scene",
    "read_files": "open_scene",
    "scene": "scene_from_arrays",
    "from_arrays": "scene_from_arrays",
    "from_numpy": "scene_from_arrays",
    "from_table": "scene_from_table",
    "from_pandas": "scene_from_table",
    "from_dataframe": "scene_from_table",
    "from_lammps": "scene_from_lammps",
    "data": "datasets",
    "examples": "datasets",
    "samples": "datasets",
    "fields": "FIELDS",
}


def __getattr__(name: str) -> Any:
    """Load a public name; raise AttributeError with the most similar one for another name."""
    if name in __all__ or name.startswith("_"):
        return _load(name)
    from xcg.common.messages import did_you_mean

    likely = did_you_mean(name, __all__, synonyms=_OTHER_NAMES)
    try:
        return _load(name)
    except AttributeError:
        raise AttributeError(f"module 'xcg' has no attribute {name!r}{likely}", name=name) from None


def __dir__() -> list[str]:
    """Completion shows what is public: modules have their own place in the documentation."""
    return [*__all__, "__version__"]


xr.Dataset.cg = Accessor()  # type: ignore[attr-defined]
