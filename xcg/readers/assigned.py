"""Columns of files and the variables they are taken for, by ``names=`` and by their own names."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import chain

from xcg.common.messages import SceneError
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.readers.likely_names import aliases_of, resembles, words_of
from xcg.readers.named_columns import columns_by_name, vector_of
from xcg.readers.names import (
    ALL_SLOTS,
    CLOCK_SLOTS,
    CONTACT_ARRAYS,
    CONTACT_SLOTS,
    CONTACTS,
    PARTICLES,
    Slots,
    canonical,
)
from xcg.scene.schema import COMPONENTS, variable

# positions and what they follow from where fractions of the box are given
POSITIONS = (("position", "scaled"), ("unwrapped_position", "unwrapped_scaled"))
PARTICLE_VECTORS = (*POSITIONS[0], *POSITIONS[1], "image", "velocity", "angular_velocity")
_FORCES = ("contact_force", "normal_force", "tangential_force")
CONTACT_VECTORS = (*_FORCES, "contact_point", "contact_normal", "contact_branch", "end_i", "end_j")

# What the caller maps to the first displaces what fills the second by itself.
_RIVALS = (
    ("radius", "diameter"),
    ("scaled", "position"),
    ("normal_force", "contact_force"),
    ("tangential_force", "contact_force"),
)

RAW = re.compile(r"[cf]_\w+(\[\d+\])?")  # columns of LAMMPS without names of their own
_ID_AND_FORCE = 6  # columns of the shortest words of LIGGGHTS
FEWEST_OF_LIGGGHTS = 12  # columns with positions, ids and forces; one compute of LAMMPS has fewer
_WORDS_OF_COMPUTES = (
    ("patom1 patom2", ("contact_i", "contact_j")),
    ("dx dy dz", tuple(f"contact_branch_{axis}" for axis in COMPONENTS)),
    ("fx fy fz", tuple(f"normal_force_{axis}" for axis in COMPONENTS)),
    ("p1 p2 p3", (*(f"tangential_force_{axis}" for axis in COMPONENTS), "of granular styles")),
)


def assign(ref: StepRef, slots: Slots, options: ReadOptions) -> dict[str, str]:
    """Find the column of each slot that a file fills.

    Raises
    ------
    SceneError
        If `names` maps a column of this file to something that is almost, but not quite, a slot, or
        two columns to the same.
    """
    mapped = {column: slot for column, slot in options.names.items() if column in ref.columns}
    _check_names(ref, mapped, slots)
    by_caller = {
        slot: column for column, slot in mapped.items() if slot is not None and slot in slots
    }
    displaced = tuple(
        rival for first, rival in _RIVALS if any(slot.startswith(first) for slot in by_caller)
    )
    free = [column for column in ref.columns if column not in mapped]
    by_name = {
        slot: column
        for slot, column in columns_by_name(free, slots).items()
        if not slot.startswith(displaced)
    }
    filled = by_name | by_caller
    return {slot: filled[slot] for slot in slots if slot in filled}


def _check_names(ref: StepRef, mapped: Mapping[str, str | None], slots: Slots) -> None:
    """Raise SceneError if `names` maps two columns to one slot, or one to a misspelt slot."""
    counts = Counter(slot for slot in mapped.values() if slot is not None)
    twice = [slot for slot, count in counts.items() if count > 1]
    if twice:
        columns = " and ".join(repr(column) for column in mapped if mapped[column] == twice[0])
        raise SceneError(
            f"{source_of(ref)}: names maps {columns} to {twice[0]!r}, and only one of them can be; "
            "map the others to None"
        )
    for column, slot in mapped.items():
        if slot is None or slot in ALL_SLOTS:
            continue
        if slot in _FORCES and f"{slot}_x" in slots:
            raise SceneError(f"{source_of(ref)}: {magnitudes({slot: column})}")
        pair = f"names={{{column!r}: {slot!r}}}"
        prefix = ""
        if slot.startswith("contact_"):  # as all slots of contacts do
            prefix = "contact_"
        endings = [name.removeprefix(prefix) for name in slots if name.startswith(prefix)]
        close = difflib.get_close_matches(slot.removeprefix(prefix), endings, 3, 0.8)
        if close:
            likely = " or ".join(repr(prefix + ending) for ending in close)
            raise SceneError(f"{pair}: did you mean {likely}?")
        meant = [name for name, aliases in slots.items() if canonical(slot) in aliases]
        if meant:
            raise SceneError(f"{pair}: that is a column; its variable is {meant[0]!r}")


def lacks(ref: StepRef, what: str, slot: str) -> SceneError:
    """Make the error of a file that lacks a column, with the mapping that names it."""
    filled = columns_by_name(ref.columns, ALL_SLOTS)
    partners = ("contact_i", "contact_j")
    together = [slot]
    if vector_of(slot) != slot:
        together = [f"{vector_of(slot)}_{axis}" for axis in COMPONENTS]
    elif slot in partners:
        together = [*partners]
    likely = {other: _likely(ref, other) for other in together if other not in filled}
    if slot not in likely or None in likely.values():
        likely = {slot: _likely(ref, slot)}
    mapping = ", ".join(
        f"{column or 'its column'!r}: {meant!r}" for meant, column in likely.items()
    )
    msg = (
        f"{source_of(ref)}: no {what} among the columns {' '.join(ref.columns)}; say which column it is, "
        f"for example names={{{mapping}}}"
    )
    numbered = [column for column in ref.columns if RAW.fullmatch(column) and "[" in column]
    if slot not in CONTACT_SLOTS or not numbered:
        return SceneError(msg)
    computes = {column.partition("[")[0] for column in numbered}
    if len(computes) == 1 and len(numbered) >= _ID_AND_FORCE:
        msg += ". Files of LIGGGHTS are read by the words of their 'compute pair/gran/local', names='pos id force'"
    if len(numbered) < FEWEST_OF_LIGGGHTS:
        rows = "".join(
            f"\n    {words:<14}{', '.join(slots)}" for words, slots in _WORDS_OF_COMPUTES
        )
        msg += f". Columns such as 'c_1[2]' have the order of the words in LAMMPS' compute, which become{rows}"
    return SceneError(msg)


def _likely(ref: StepRef, slot: str) -> str | None:
    """Return the column that a slot which is not filled may have; None without such a column."""
    table = CONTACTS if slot in CONTACT_SLOTS else PARTICLES
    recognised = {*chain(*map(aliases_of, table.values()))}
    variable_name = vector_of(slot)
    axis = slot[-1] if variable_name != slot else ""
    free = [column for column in ref.columns if canonical(column) not in recognised]
    of_axis = [
        column
        for column in free
        if not axis or axis in words_of(column) or canonical(column).endswith(axis)
    ]
    alike = [column for column in of_axis if resembles(column, table[variable_name])]
    others = [column for column in of_axis if axis in words_of(column)]
    return next(iter(alike or others), None)


def magnitudes_among(columns: Iterable[str], names: Mapping[str, str | None]) -> dict[str, str]:
    """Return the columns of forces of contacts that are one number each, by their variable."""
    free = [column for column in columns if column not in names]
    forces = {slot: CONTACT_ARRAYS[slot] for slot in _FORCES}
    scalars = columns_by_name(free, forces)
    mapped = {
        slot: column for column, slot in names.items() if column in columns and slot in _FORCES
    }
    return {slot: column for slot, column in (scalars | mapped).items() if slot is not None}


def axes_of(filled: Iterable[str], slot: str) -> list[str]:
    """Return the axes of the components of a vector that are filled."""
    return [axis for axis in COMPONENTS if f"{slot}_{axis}" in filled]


def own_variables(ref: StepRef, options: ReadOptions, dim: str) -> dict[str, str]:
    """Columns that `names` maps to variables of the caller's own, of particles or of contacts."""
    standard = {*ALL_SLOTS, *CLOCK_SLOTS}
    return {
        slot: column
        for column, slot in options.names.items()
        if slot is not None
        and column in ref.columns
        and slot not in standard
        and variable(slot).dims == (dim,)
    }


def unread_by_number(ref: StepRef, filled: Mapping[str, str], options: ReadOptions) -> str:
    """Return a hint about unnamed columns beside a complete force, with the mapping to use; "" without such columns.

    Where that force lies along all branches, they may hold its tangential part.
    """
    left = [
        name
        for name in ref.columns
        if RAW.fullmatch(name) and name not in (*filled.values(), *options.names)
    ]
    if "contact_force_x" not in filled or len(left) < len(COMPONENTS):
        return ""
    mapping = f"{{{filled['contact_force_x']!r}: 'normal_force_x', {left[-3]!r}: 'tangential_force_x', ...}}"
    return (
        f"columns {' '.join(left)} are not read: if the tangential part is among them, say names={mapping}, and the "
        f"two are added up; otherwise drop them by names={{{left[0]!r}: None, ...}}"
    )


def magnitudes(filled: Mapping[str, str]) -> str:
    """Describe forces of contacts without a direction, and what to do, as the end of a message."""
    columns = [column for slot, column in filled.items() if slot in _FORCES]
    return (
        f"{' and '.join(map(repr, columns))} are magnitudes, and contact forces are vectors; write their components, "
        "or read both tables and pass them to xcg.scene_from_table(grains, contacts, "
        f"names={{{columns[0]!r}: 'normal_force', ...}}), which takes directions from the centres (of "
        "tangential forces only for discs in the plane of x and y)"
    )
