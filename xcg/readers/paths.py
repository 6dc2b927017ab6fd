"""Paths and units that callers and headers give."""

from __future__ import annotations

import difflib
import glob
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from xcg.common.messages import SceneError, warn_user
from xcg.readers.engine import Engine, StepRef
from xcg.readers.files.text import source_of
from xcg.scene.schema import Setup
from xcg.steps import faults as errors

PathLike: TypeAlias = str | os.PathLike[str]


def natural_key(path: str) -> list[tuple[int, int, str]]:
    """Key that sorts the numbers in names by value: ``step9`` comes before ``step10``."""
    return [(1, int(part), part) if part.isdecimal() else (0, 0, part) for part in re.split(r"(\d+)", path)]


def expand_paths(paths: PathLike | Iterable[PathLike], argument: str) -> list[str]:
    """List the files that a path, a glob or a list of them means.

    Parameters
    ----------
    paths : str, path or iterable of them
        Globs are sorted naturally; a list keeps its order. A file named twice counts once.
    argument : str
        Name of the argument, for messages.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a glob matches nothing; the message names similar files.
    """
    if isinstance(paths, (str, os.PathLike)):
        return _expand(os.path.expanduser(os.fspath(paths)), argument)
    found = []
    for path in paths:
        try:
            found += _expand(os.path.expanduser(os.fspath(path)), argument)
        except FileNotFoundError as error:
            if not errors.record_fault(os.fspath(path), error):
                raise
    if not found:
        errors.raise_recorded()
        raise FileNotFoundError(f"{argument}=[]: expected at least one file")
    return list(dict.fromkeys(found))


def _expand(path: str, argument: str) -> list[str]:
    if os.path.isfile(path):
        return [path]
    if os.path.isdir(path):
        if os.path.splitext(os.path.abspath(path))[1].lower() == ".zarr":
            raise FileNotFoundError(
                f"{argument}={path!r} is a Zarr folder, which is opened alone, as a scene that xcg saved"
            )
        pattern = os.path.join(path, "*.dump")
        raise FileNotFoundError(f"{argument}={path!r} is a folder; give the files in it, for example {pattern!r}")
    if glob.has_magic(path):
        files = [file for file in glob.glob(path, recursive=True) if os.path.isfile(file)]
        if files:
            return sorted(files, key=natural_key)
    folder, name = os.path.split(path)
    problem = "no file matches this pattern" if glob.has_magic(path) else "no such file"
    raise FileNotFoundError(f"{argument}={path!r}: {problem}{_what_is_there(folder or '.', name)}")


def _what_is_there(folder: str, name: str) -> str:
    if glob.has_magic(folder):
        return ""
    if not os.path.isdir(folder):
        return f"; the folder {folder!r} does not exist"
    files = sorted((entry.name for entry in Path(folder).iterdir() if entry.is_file()), key=natural_key)
    if not files:
        return f"; the folder {folder!r} holds no files"
    similar = difflib.get_close_matches(name, files, n=3, cutoff=0.4) or files[:3]
    return f"; the folder {folder!r} holds {len(files)} files, among them {', '.join(map(repr, similar))}"


# Factors to SI of the unit systems that headers name.
UNIT_SYSTEMS: dict[str, Mapping[str, float] | str | None] = {
    "si": None,
    "lj": "reduced",
    "cgs": {"length": 1e-2, "mass": 1e-3},
    "micro": {"length": 1e-6, "mass": 1e-15, "time": 1e-6},
    "nano": {"length": 1e-9, "mass": 1e-21, "time": 1e-9},
}


def names_no_units(engine: Engine, indexed: Mapping[str, Sequence[StepRef]]) -> bool:
    """Return whether files could name their units, and do not."""
    return bool(engine.UNNAMED_UNITS) and all(refs[0].units is None for refs in indexed.values())


def units_of_headers(engine: Engine, indexed: Mapping[str, Sequence[StepRef]]) -> Mapping[str, float] | str | None:
    """Units as the headers name them; SI where they do not."""
    named = {refs[0].units: source_of(refs[0]) for refs in indexed.values() if refs[0].units is not None}
    if len(named) > 1:
        found = ", ".join(f"{system!r} in {name}" for system, name in named.items())
        raise SceneError(f"headers name different unit systems ({found}); give the factors to SI with units=")
    for system, name in named.items():
        if system not in UNIT_SYSTEMS:
            raise SceneError(
                f"{name}: the header names the unit system {system!r}, known are {', '.join(UNIT_SYSTEMS)}; "
                "give the factors to SI, for example units={'length': 1e-10, 'mass': 1e-3, 'time': 1e-15}"
            )
        return UNIT_SYSTEMS[system]
    if names_no_units(engine, indexed):
        warn_user(
            f"{source_of(indexed['particles'][0])}: the header does not name the units, and SI is taken; say "
            f"units='SI', 'reduced' (LAMMPS's lj) or factors such as {{'length': 1e-3}}, or {engine.UNNAMED_UNITS}"
        )
    return None


def not_against_headers(units: Mapping[str, float] | str, indexed: Mapping[str, Sequence[StepRef]]) -> Any:
    """Raise SceneError for units that differ from the headers.

    Factors may give reduced units (lj) a scale, and numbers in SI may be taken as scaled ones: none of them changes.
    """
    given = Setup.make(units=units)
    for refs in indexed.values():
        system = refs[0].units
        scaled = (system == "lj" and isinstance(units, Mapping)) or (system == "si" and units == "reduced")
        if system not in UNIT_SYSTEMS or scaled:
            continue
        named = Setup.make(units=UNIT_SYSTEMS[system])
        if given.unit_system != named.unit_system or not np.allclose(given.scales, named.scales, rtol=1e-12, atol=0):
            way_out = (
                "give factors to SI, for example units={'length': 1.0, 'mass': 1.0, 'time': 1.0}"
                if system == "lj"
                else "leave units= out, or change 'ITEM: UNITS' in the files if it is wrong"
            )
            raise SceneError(
                f"units={units!r}, but the header of {source_of(refs[0])} names the unit system {system!r}: {way_out}"
            )
    return units
