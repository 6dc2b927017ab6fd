"""Units of files: what headers name, and what the caller says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xcg.readers.engine import Engine, StepRef
from xcg.readers.files.text import source_of
from xcg.scene.schema import SceneError, Setup
from xcg.scene.warn import warn_user

# Factors to SI of the unit systems that headers name.
UNIT_SYSTEMS: dict[str, Mapping[str, float] | str | None] = {
    "si": None,
    "lj": "reduced",
    "cgs": {"length": 1e-2, "mass": 1e-3},
    "micro": {"length": 1e-6, "mass": 1e-15, "time": 1e-6},
    "nano": {"length": 1e-9, "mass": 1e-21, "time": 1e-9},
}


def names_no_units(engine: Engine, indexed: Mapping[str, Sequence[StepRef]]) -> bool:
    """Whether files could name their units, and do not."""
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
    """Refuse units other than those that the headers name.

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
