"""The table of engines: those of this package, and those that installed packages register."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points

from xcg.readers.engine import Engine
from xcg.scene.schema import SceneError, unknown
from xcg.scene.warn import warn_user

GROUP = "xcg.readers"
_OWN = {
    "lammps": "xcg.readers.codes.lammps:Lammps",
    "liggghts": "xcg.readers.codes.liggghts:Liggghts",
    "mercury": "xcg.readers.codes.mercury:Mercury",
    "mfix": "xcg.readers.codes.mfix:Mfix",
    "yade": "xcg.readers.codes.yade:Yade",
    "table": "xcg.readers.codes.tabular:Table",
    "hdf5": "xcg.readers.codes.hdf5:Hdf5",
    "vtk": "xcg.readers.codes.vtk_points:Vtk",
}


def engine_table() -> dict[str, EntryPoint]:
    """List the engines by name; those of this package come first, and first when files are recognised."""
    found = {name: EntryPoint(name, place, GROUP) for name, place in _OWN.items()}
    for entry in _installed(tuple(sys.path)):
        taken = found.setdefault(entry.name, entry)
        if taken.value != entry.value:
            warn_user(
                f"two engines are called {entry.name!r}: {taken.value} is taken; hand over the other one, "
                f"{entry.value}, as engine="
            )
    return found


@lru_cache(maxsize=1)
def _installed(places: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Engines of the packages in these places; to find them, a file of each package there is read."""
    return tuple(entry_points(group=GROUP))


def all_engines() -> Iterator[Engine]:
    """Load one engine after the other; those of packages that cannot be imported are left out, with a warning."""
    for name in engine_table():
        try:
            yield load_engine(name)
        except SceneError as error:
            warn_user(f"left out: {error}")


def load_engine(engine: str | Engine | type[Engine]) -> Engine:
    """Make an engine of its name, of its class, or of itself.

    Raises
    ------
    SceneError
        If there is none of this name, it cannot be imported, or it is no `Engine`.
    """
    given = _load(engine) if isinstance(engine, str) else engine
    if isinstance(given, type) and issubclass(given, Engine):
        try:
            return given()
        except TypeError as error:
            raise SceneError(f"engine={engine!r}: no object can be made of it without arguments ({error})") from None
    if not isinstance(given, Engine):
        raise SceneError(f"engine={engine!r}: expected a name, or a class or object derived from xcg.readers.Engine")
    return given


def _load(name: str) -> object:
    table = engine_table()
    if name not in table:
        raise SceneError(unknown("engine", name, table))
    try:
        return table[name].load()
    except (ImportError, AttributeError) as error:
        raise SceneError(f"the engine {name!r} ({table[name].value}) cannot be imported: {error}") from error
