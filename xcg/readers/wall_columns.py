"""Contacts with walls in columns of the particles, as LAMMPS' ``fix wall/gran ... contacts`` writes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers.assigned import assign
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.readers.names import PARTICLE_SLOTS
from xcg.scene.contacts import FIRST_WALL
from xcg.scene.schema import Frame

# The per-atom array of LAMMPS' ``fix wall/gran ... contacts``: 1 where the grain touches, force on
# it (3), point on the wall (3), radius; zeros where it does not touch.
WALL_ARRAY = 8
_FORCE_AND_POINT = slice(1, 7)
WALL_CONTACTS = ("contact_i", "contact_j", "contact_force", "contact_point")


def columns_of_walls(options: ReadOptions) -> dict[str, list[str]]:
    """Columns of particles that hold the contacts with each wall: the whole array, or six by name."""
    columns = {}
    for wall, names in options.walls.items():
        if isinstance(names, str):
            columns[wall] = [names.replace("*", str(k + 1)) for k in range(WALL_ARRAY)]
        else:
            columns[wall] = list(names)
    return columns


def wall_columns(ref: StepRef, options: ReadOptions) -> dict[str, list[str]]:
    """Columns of force (3) and point (3) of the contacts with each wall.

    Raises
    ------
    SceneError
        If a step of particles does not hold them.
    """
    columns = columns_of_walls(options)
    for wall, names in options.walls.items():
        fits = len(names) == 6
        if isinstance(names, str):
            fits = "*" in names
            columns[wall] = columns[wall][_FORCE_AND_POINT]
        lacking = [column for column in columns[wall] if column not in ref.columns]
        if fits and not lacking:
            continue
        message = (
            f"{source_of(ref)}: walls={{{wall!r}: {names!r}}}: expected the columns of a 'fix wall/gran ... "
            f"contacts', such as 'f_{wall}[*]', or names of six columns, force and point"
        )
        if lacking:
            message += f"; it has no {' '.join(lacking)}, but {' '.join(ref.columns)}"
        raise SceneError(message)
    return columns


def wall_contacts_from(
    ref: StepRef, options: ReadOptions, read_columns: Callable[..., Mapping[str, NDArray]]
) -> Frame:
    """Read the contacts with walls from columns of a step of particles, wall after wall.

    `read_columns` is that of the engine, see `xcg.readers.columns.Columnar`.
    """
    of_ids = assign(ref, PARTICLE_SLOTS, options)["particle_id"]
    walls = wall_columns(ref, options)
    wanted = {of_ids, *chain(*walls.values())}
    table = read_columns(ref, wanted, ref.rows // len(walls), options)
    parts: dict[str, list[NDArray]] = {name: [] for name in WALL_CONTACTS}
    for number, columns in enumerate(walls.values()):
        values = np.stack([table[column] for column in columns], axis=1)
        touching = np.flatnonzero((values != 0).any(axis=1))
        parts["contact_i"].append(table[of_ids][touching])
        parts["contact_j"].append(np.full(len(touching), FIRST_WALL - number))
        parts["contact_force"].append(values[touching, :3])
        parts["contact_point"].append(values[touching, 3:])
    return {name: np.concatenate(arrays) for name, arrays in parts.items()}
