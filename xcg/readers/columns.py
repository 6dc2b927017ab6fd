"""From columns of text files to variables of the scene.

A *slot* is what a column can be: a variable of the scene (``species``), a component of one (``velocity_x``),
or an ingredient of one (``radius``, ``scaled_x``, ``normal_force_x``). Each engine lists which columns fill a
slot by themselves; ``names={column: slot}`` of the caller comes first.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.text import parse_table, read_body, where
from xcg.scene import COMPONENTS, Frame, SceneError

Slots: TypeAlias = Mapping[str, Sequence[str]]
"""Columns that fill each slot by default, the preferred first."""


def _vector(slot: str, columns: str) -> dict[str, tuple[str, ...]]:
    """Slots of three components; `columns` are templates such as "v?"."""
    names = [template.split("?") for template in columns.split()]
    return {f"{slot}_{axis}": tuple(axis.join(name) for name in names) for axis in COMPONENTS}


PARTICLE_SLOTS: Slots = {
    "particle_id": ("id",),
    "species": ("type",),
    "body_id": (),
    "frozen": (),
    "coordination_number": (),
    **_vector("position", "? ?u"),
    **_vector("scaled", "?s ?su"),
    **_vector("velocity", "v?"),
    "diameter": ("diameter",),
    "radius": ("radius",),
    "density": ("density",),
    "mass": ("mass",),
    "volume": ("volume",),
}
CONTACT_SLOTS: Slots = {
    "contact_i": ("id1", "patom1"),
    "contact_j": ("id2", "patom2"),
    **_vector("contact_force", "f?"),
    **_vector("normal_force", "fn?"),
    **_vector("tangential_force", "ft?"),
    **_vector("contact_point", ""),
    **_vector("contact_normal", ""),
    "overlap": ("overlap", "delta"),
}

_COMPONENT_SLOTS = {f"{slot}_{axis}" for slot in ("position", "scaled", "velocity") for axis in COMPONENTS}

# What the caller maps to the first displaces what the second would be filled with by default.
_RIVALS = (
    ("radius", "diameter"),
    ("scaled", "position"),
    ("normal", "contact_force"),
    ("tangential", "contact_force"),
)


def assign(ref: StepRef, slots: Slots, options: ReadOptions) -> dict[str, str]:
    """Column of each slot that this file fills.

    Raises
    ------
    SceneError
        If `names` maps a column of this file to something that is almost, but not quite, a slot.
    """
    columns = set(ref.columns)
    given = {column: slot for column, slot in options.names.items() if column in columns}
    mine = {slot: column for column, slot in given.items() if slot in slots}
    for column, slot in given.items():
        close = [] if slot is None or slot in slots else difflib.get_close_matches(slot, slots, 3, 0.8)
        if close and slot not in PARTICLE_SLOTS and slot not in CONTACT_SLOTS:
            msg = f"names={{{column!r}: {slot!r}}}: no such variable; did you mean {' or '.join(map(repr, close))}?"
            raise SceneError(msg)
    displaced = [rival for first, rival in _RIVALS if any(slot.startswith(first) for slot in mine)]
    filled = {}
    for slot, candidates in slots.items():
        default = next((column for column in candidates if column in columns and column not in given), None)
        if slot in mine:
            filled[slot] = mine[slot]
        elif default is not None and not slot.startswith(tuple(displaced)):
            filled[slot] = default
    return filled


def _lacks(ref: StepRef, what: str, slots: str) -> SceneError:
    msg = (
        f"{where(ref)}: no {what} among the columns {' '.join(ref.columns)}; say which they are, for example "
        f"names={{'column': '{slots}'}}"
    )
    return SceneError(msg)


def _axes(filled: Mapping[str, str], slot: str) -> list[str]:
    return [axis for axis in COMPONENTS if f"{slot}_{axis}" in filled]


# --- particles -------------------------------------------------------------------------------------------


def read_atoms(ref: StepRef, options: ReadOptions) -> Frame:
    """Particles of one step; columns that `names` maps to other names become variables of their own."""
    filled = assign(ref, PARTICLE_SLOTS, options)
    extra = {
        slot: column
        for column, slot in options.names.items()
        if slot is not None
        and column in ref.columns
        and slot not in PARTICLE_SLOTS
        and slot not in CONTACT_SLOTS
    }
    if "particle_id" not in filled:
        raise _lacks(ref, "ids of particles", "particle_id")
    if not {"position_x", "scaled_x"} & set(filled) or not {"position_y", "scaled_y"} & set(filled):
        raise _lacks(ref, "positions", "position_x")
    flat = not {"position_z", "scaled_z"} & set(filled)  # a two-dimensional run need not write z
    if _axes(filled, "velocity") not in ([], list("xyz"), *([list("xy")] if flat else [])):
        raise _lacks(ref, "full velocity", "velocity_z")
    columns = filled | extra
    table = parse_table(read_body(ref), ref.columns, sorted(set(columns.values())), ref.rows, where(ref))
    values = {slot: table[column] for slot, column in columns.items()}
    frame = {name: array for name, array in values.items() if name in extra or name not in _COMPONENT_SLOTS}
    frame["position"] = np.stack([_coordinate(ref, values, k) for k in range(3)], axis=1)
    if "velocity_x" in values:
        zero = np.zeros(ref.rows)
        frame["velocity"] = np.stack([values.get(f"velocity_{axis}", zero) for axis in COMPONENTS], axis=1)
    if "radius" in frame:
        radius = frame.pop("radius")
        frame.setdefault("diameter", 2 * radius)
    return frame


def _coordinate(ref: StepRef, values: Frame, k: int) -> NDArray:
    axis = COMPONENTS[k]
    if f"position_{axis}" in values:
        return values[f"position_{axis}"]
    if f"scaled_{axis}" not in values:
        return np.zeros(ref.rows)
    if ref.box is None:
        msg = f"{where(ref)}: coordinates are scaled by the box, and the header gives no box ('ITEM: BOX BOUNDS')"
        raise SceneError(msg)
    low, high = ref.box[k]
    return low + values[f"scaled_{axis}"] * (high - low)


# --- contacts --------------------------------------------------------------------------------------------


def contact_slots(ref: StepRef, slots: Slots, options: ReadOptions) -> dict[str, str]:
    """Column of each slot of contacts, checked to be enough for contacts.

    The force is ``contact_force``; without it, the sum of ``normal_force`` and ``tangential_force``; without the
    second, the first alone.
    """
    filled = assign(ref, slots, options)
    if "contact_i" not in filled or "contact_j" not in filled:
        raise _lacks(ref, "pairs of ids", "contact_i")
    vectors = {slot: _axes(filled, slot) for slot in _VECTORS}
    for slot, axes in vectors.items():
        if 0 < len(axes) < 3:
            raise _lacks(ref, f"full {slot.replace('_', ' ')} (only {', '.join(axes)})", f"{slot}_z")
    if not vectors["contact_force"] and not vectors["normal_force"]:
        raise _lacks(ref, "contact forces", "contact_force_x")
    if vectors["contact_force"] and vectors["tangential_force"] and not vectors["normal_force"]:
        total, part = filled["contact_force_x"], filled["tangential_force_x"]
        msg = (
            f"{where(ref)}: is '{total}' the total force or its normal part, beside the tangential '{part}'? Say "
            f"names={{'{total}': 'normal_force_x', ...}} to add them up, or names={{'{part}': None, ...}} to take "
            f"'{total}' as the total"
        )
        raise SceneError(msg)
    used = ("contact_force",) if vectors["contact_force"] else ("normal_force", "tangential_force")
    unused = tuple(set(_FORCES) - set(used))
    return {slot: column for slot, column in filled.items() if not slot.startswith(unused)}


_FORCES = ("contact_force", "normal_force", "tangential_force")
_VECTORS = (*_FORCES, "contact_point", "contact_normal")


def contact_names(filled: Mapping[str, str]) -> tuple[str, ...]:
    """Names of the variables that `contacts_from` makes of these slots."""
    optional = [name for name in ("contact_point", "contact_normal") if f"{name}_x" in filled]
    overlap = ["overlap"] if "overlap" in filled else []
    return ("contact_i", "contact_j", "contact_force", *optional, *overlap)


def contacts_from(ref: StepRef, filled: Mapping[str, str]) -> Frame:
    """Contacts of one step; slots that are not of the scene are handed on as they are."""
    table = parse_table(read_body(ref), ref.columns, sorted(set(filled.values())), ref.rows, where(ref))
    vectors = {
        slot: np.stack([table[filled[f"{slot}_{axis}"]] for axis in COMPONENTS], axis=1)
        for slot in _VECTORS
        if f"{slot}_x" in filled
    }
    frame = {slot: table[column] for slot, column in filled.items() if slot[:-2] not in vectors}
    if "normal_force" in vectors:
        normal = vectors.pop("normal_force")
        vectors["contact_force"] = normal + vectors.pop("tangential_force", np.zeros(3))
    _check_ids(ref, frame["contact_i"])
    return frame | vectors


def _check_ids(ref: StepRef, ids: NDArray) -> None:
    large = ids[ids >= 1e6]
    if len(large) > 10 and (large % 10 == 0).all():
        msg = (
            f"{where(ref)}: ids above a million were written with six digits (all end in 0), so that partners are "
            "lost; write the file anew with 'dump_modify ... format float %.10g'"
        )
        raise SceneError(msg)
