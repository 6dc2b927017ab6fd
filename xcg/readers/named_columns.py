"""Columns of a file by the slots that their names fill, and factors from the units in names."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import chain

from xcg.readers.column_units import names_unknown_unit, unit_of
from xcg.readers.names import ALL_SLOTS, Slots, canonical
from xcg.scene.schema import COMPONENTS, VARIABLES, Powers, powers_of

_NUMBERED = re.compile(r"(.*?)([^A-Za-z0-9]?)[\[(]?(\d)[\])]?$")
_UNITS_OF_SLOTS = {
    "radius": "m", "half_axis": "m", "whole_axis": "m", "normal_force": "N", "tangential_force": "N",
    "end_i": "m", "end_j": "m", "time": "s",
}  # fmt: skip


def canonical_columns(columns: Iterable[str]) -> dict[str, list[str]]:
    """Return the columns of each canonical name, in the order of the file.

    Three columns that are numbered 0, 1, 2 or 1, 2, 3 are components x, y, z of one vector. A
    number follows a sign (``v:0``, ``v[1]``, ``v_2``) or a word (``vel0``), so that ``d1``, ``d2``
    and ``d3`` are not taken for a vector. Names that end in a unit (``x_mm``) come last.
    """
    named: dict[str, list[str]] = defaultdict(list)
    vectors: dict[str, dict[int, str]] = defaultdict(dict)
    with_unit: list[tuple[str, str]] = []
    for column in columns:
        named[canonical(column)].append(column)
        unit = unit_of(column)
        if unit is not None and not unit.in_brackets:
            with_unit.append((canonical(unit.stem), column))
        numbered = _NUMBERED.match(unit.stem if unit and unit.in_brackets else column)
        if numbered:
            stem, sign, number = numbered.groups()
            brackets = column.endswith(("]", ")"))
            if sign or brackets or len(canonical(stem)) >= 3:
                vectors[canonical(stem)][int(number)] = column
    for stem, components in vectors.items():
        if sorted(components) in ([0, 1, 2], [1, 2, 3]):
            for axis, number in zip(COMPONENTS, sorted(components), strict=True):
                named[stem + axis].append(components[number])
    for name, column in with_unit:
        named[name].append(column)
    return named


def vector_of(slot: str) -> str:
    """Return the variable of a slot: the vector of a component."""
    vector, _, axis = slot.rpartition("_")
    return vector if axis in COMPONENTS and slot in ALL_SLOTS and vector != "quat" else slot


def powers_of_slot(slot: str) -> Powers:
    """Return the powers of length, mass and time of a slot; zeros for a variable of the caller's own."""
    name = vector_of(slot)
    units = _UNITS_OF_SLOTS.get(name)
    if units is None:
        units = VARIABLES[name].units if name in VARIABLES else "1"
    return powers_of(units)


def factor_of(column: str, slot: str) -> float:
    """Return the factor from the unit in the name of a column to SI; 1 where it names none of this slot."""
    unit = unit_of(column)
    if unit is None or unit.powers != powers_of_slot(slot):
        return 1.0
    return unit.factor


def has_other_unit(column: str, slot: str) -> bool:
    """Return whether the name of a column holds a unit that is not known, or not one of its slot."""
    powers = powers_of_slot(slot)
    unit = unit_of(column)
    if unit is None:
        return names_unknown_unit(column) and powers != (0, 0, 0)
    return unit.in_brackets and powers not in ((0, 0, 0), unit.powers)


def columns_by_name(columns: Sequence[str], slots: Slots) -> dict[str, str]:
    """Return the column of each slot that is called by one of its aliases, the preferred first.

    All components of a vector are of one spelling, the one with the most components: ``wx`` beside
    ``omega_z`` is something else. An ending such as ``_mm`` is a unit where it is one of the slot.
    """
    aliases = tuple((slot, tuple(names)) for slot, names in slots.items())
    return dict(_columns_by_name(tuple(columns), aliases))


def _named(slot: str, alias: str, candidates: Iterable[str]) -> Iterator[str]:
    """Yield the columns that are called by an alias, or by it and a unit of the slot."""
    for column in candidates:
        unit = unit_of(column)
        is_plain = unit is None or unit.in_brackets or canonical(unit.stem) != alias
        if is_plain or (unit is not None and unit.powers == powers_of_slot(slot) != (0, 0, 0)):
            yield column


@lru_cache(maxsize=256)  # the steps of a series have the same columns
def _columns_by_name(
    columns: tuple[str, ...], slots: tuple[tuple[str, tuple[str, ...]], ...]
) -> dict[str, str]:
    named = canonical_columns(columns)
    by_alias: dict[str, dict[int, str]] = {}
    for slot, aliases in slots:
        by_alias[slot] = {}
        for rank, alias in enumerate(map(canonical, aliases)):
            for column in _named(slot, alias, named.get(alias, ())):
                by_alias[slot].setdefault(rank, column)
    filled = {}
    for slot, candidates in by_alias.items():
        ranks = list(candidates)
        vector, _, axis = slot.rpartition("_")
        if axis in COMPONENTS:
            siblings = [by_alias.get(f"{vector}_{other}", {}) for other in COMPONENTS]
            counts = Counter(sorted(chain(*siblings)))
            ranks = [rank for rank, _ in counts.most_common(1) if rank in candidates]
        if ranks:
            filled[slot] = candidates[ranks[0]]
    return filled
