"""Names of columns that resemble a variable or a time: words, hints and units in them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from functools import cache
from itertools import chain

from xcg.readers.column_units import unit_of
from xcg.readers.named_columns import powers_of_slot
from xcg.readers.names import CONTACTS, PARTICLES, Names, canonical, components
from xcg.scene.schema import COMPONENTS

_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_OF_LAMMPS = re.compile(r"^(?:[vcfdi]|[di]2)_(?=\w\w)")  # variables, computes, fixes, properties
# vectors of contacts that are no forces, by the beginning of their names
_OTHER_VECTORS = (
    "n",
    "torq",
    "moment",
    "m",
    "vel",
    "v",
    "omega",
    "w",
    "branch",
    "l",
    "pos",
    "end",
    "heat",
)
_OF_VELOCITY = re.compile(
    "v(?!ec|ir|is|ol|or|ar)"
)  # no vector, virial, volume, vorticity, variance
_TOLD_BY_UNITS = {"density", "velocity"}  # units of nothing else
_OF_PARAVIEW = {
    "pointid", "cellid", "celltype", "blockname", "blocknumber", "vtkoriginalpointids",
    "vtkoriginalcellids", "vtkghosttype",
}  # fmt: skip
_CLOCK_WORDS = {
    "t", "time", "times", "zeit", "temps", "tiempo", "tempo", "timestep", "timestamp", "step", "steps", "frame",
    "slice", "iteration", "cycle",
}  # fmt: skip
_BESIDE_CLOCK_WORDS = {
    "sim", "simulation", "physical", "elapsed", "current", "position", "no", "nr", "number", "index",
    "id", "s", "sec", "seconds", "ms", "us", "ns", "min",
}  # fmt: skip


def words_of(column: str) -> list[str]:
    """Return the words in the name of a column, without its unit and the prefix of LAMMPS."""
    unit = unit_of(column)
    name = column
    if unit is not None and (unit.in_brackets or unit.powers != (0, 0, 0)):
        name = unit.stem
    return [word.casefold() for word in _WORD.findall(_OF_LAMMPS.sub("", name))]


@cache
def aliases_of(names: Names) -> frozenset[str]:
    """Return the canonical names of the columns of a variable."""
    aliases = (
        components("", *names.listed) if names.is_vector else {"": map(canonical, names.listed)}
    )
    return frozenset(chain(*aliases.values()))


def resembles(column: str, names: Names) -> bool:
    """Return whether the name of a column has a word of the hints of a variable."""
    hints = names.hints.split()
    stems = tuple(hint[:-1] for hint in hints if hint.endswith("*"))
    words = words_of(column)
    unit = unit_of(column)
    plain = canonical(_OF_LAMMPS.sub("", column))
    whole = {canonical(column), plain, canonical(unit.stem) if unit is not None else ""}
    if any("=" + name in hints for name in whole):
        return True
    if _OF_LAMMPS.match(column) and plain in aliases_of(names):
        return True
    return any(word in hints or (stems and word.startswith(stems)) for word in words)


def vectors_among(columns: Iterable[str]) -> list[tuple[str, dict[str, str]]]:
    """Return the canonical name of each vector, without its axis, and its columns by axis.

    Columns of a vector differ by a letter x, y, z, of which one may be missing, or by a number from
    0 or 1 on. Components of tensors (xx, xy, xz) and four numbered columns do not make vectors.
    """
    names = list(dict.fromkeys(columns))
    vectors: list[tuple[str, dict[str, str]]] = []
    for column in names:
        for k, letter in enumerate(column):
            for axes in ("xyz", "XYZ", "012", "123"):
                parts = {
                    axis: column[:k] + mark + column[k + 1 :]
                    for axis, mark in zip(COMPONENTS, axes, strict=True)
                }
                present = {axis: name for axis, name in parts.items() if name in names}
                is_first = column == next(iter(present.values()), "") and letter in axes
                if is_first and len(present) >= (2 if axes.isalpha() else 3):
                    stem = _OF_LAMMPS.sub("", column[:k] + column[k + 1 :])
                    vectors.append((canonical(stem), present))
    counts = Counter(chain(*(parts.values() for _, parts in vectors)))
    return [
        (stem, parts)
        for stem, parts in vectors
        if all(counts[column] == 1 for column in parts.values())
    ]


def resembling(
    columns: Iterable[str], variables: Iterable[str], *, contacts: bool
) -> dict[str, str]:
    """Return columns that are not read and resemble a variable that is not read either, by words or unit.

    Parameters
    ----------
    columns : iterable of str
        Columns that are not read.
    variables : iterable of str
        Variables or slots that are read.
    contacts : bool
        Whether the file holds contacts.
    """
    slots = tuple(variables)
    table = CONTACTS if contacts else PARTICLES
    lacking = {
        variable: names
        for variable, names in table.items()
        if not any(slot.startswith((variable, *names.instead.split())) for slot in slots)
    }
    likely: dict[str, str] = {}
    candidates = [name for name in columns if canonical(name) not in _OF_PARAVIEW]
    for variable, names in lacking.items():
        powers = powers_of_slot(variable)
        for column in candidates:
            unit = unit_of(column)
            has_other_unit = unit is not None and unit.in_brackets and unit.powers != powers
            of_spin = variable == "velocity" and resembles(column, PARTICLES["angular_velocity"])
            of_another = has_other_unit or of_spin
            is_alias = not aliases_of(names).isdisjoint(words_of(column))
            if not of_another and resembles(column, names) and (is_alias or column not in likely):
                likely[column] = variable
    for stem, parts in vectors_among(candidates):
        meant = ""
        # of any name, where the force is the normal one
        if contacts and "tangential_force" in lacking and not stem.startswith(_OTHER_VECTORS):
            meant = "tangential_force"
        elif not contacts and "velocity" in lacking and _OF_VELOCITY.match(stem):
            meant = "velocity"
        for column in parts.values() if meant else ():
            likely.setdefault(column, meant)
    of_quaternion = [name for name, variable in likely.items() if variable.startswith("quat_")]
    if len(of_quaternion) < 4:
        likely = {name: meant for name, meant in likely.items() if name not in of_quaternion}
    for column in candidates:
        unit = unit_of(column)
        for variable in _TOLD_BY_UNITS & lacking.keys():
            if unit and unit.in_brackets and unit.powers == powers_of_slot(variable):
                likely.setdefault(column, variable)
    return likely


def resembling_clock(columns: Iterable[str]) -> list[str]:
    """Return columns whose names resemble a time or the number of a step; ``T`` is a temperature."""
    likely = []
    for column in columns:
        words = {word.casefold() for word in _WORD.findall(column)}
        of_clock = words & _CLOCK_WORDS
        if of_clock and words <= _CLOCK_WORDS | _BESIDE_CLOCK_WORDS and canonical(column) != "T":
            likely.append(column)
    return likely


def times_by_unit(columns: Iterable[str]) -> list[str]:
    """Return the column that resembles a time, and names a unit of time in brackets; nothing if there are two."""
    times = []
    for column in resembling_clock(columns):
        unit = unit_of(column)
        is_time = unit is not None and unit.in_brackets and unit.powers == powers_of_slot("time")
        if is_time and "step" not in canonical(column):
            times.append(column)
    return times if len(times) == 1 else []
