"""Contacts with walls in columns of the particles, as LAMMPS' ``fix wall/gran ... contacts`` writes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

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
    """Columns that the contacts with each wall have among those of particles: the whole array, or the six given."""
    return {
        wall: [given.replace("*", str(k + 1)) for k in range(WALL_ARRAY)]
        if isinstance(given, str)
        else list(given)
        for wall, given in options.walls.items()
    }


def wall_columns(ref: StepRef, options: ReadOptions) -> dict[str, list[str]]:
    """Columns of force (3) and point (3) of the contacts with each wall.

    Raises
    ------
    SceneError
        If a step of particles does not hold them.
    """
    found = columns_of_walls(options)
    for wall, given in options.walls.items():
        found[wall] = found[wall][_FORCE_AND_POINT] if isinstance(given, str) else found[wall]
        lacking = [column for column in found[wall] if column not in ref.columns]
        if (isinstance(given, str) and "*" not in given) or len(found[wall]) != 6 or lacking:
            there = (
                f"; it has no {' '.join(lacking)}, but {' '.join(ref.columns)}" if lacking else ""
            )
            raise SceneError(
                f"{source_of(ref)}: walls={{{wall!r}: {given!r}}}: expected the columns of a 'fix wall/gran ... "
                f"contacts', such as 'f_{wall}[*]', or names of six columns, force and point{there}"
            )
    return found


def wall_contacts_from(
    ref: StepRef, options: ReadOptions, read_columns: Callable[..., Mapping[str, NDArray]]
) -> Frame:
    """Read the contacts with walls from columns of a step of particles, wall after wall.

    `read_columns` is that of the engine, see `xcg.readers.columns.Columnar`.
    """
    name = assign(ref, PARTICLE_SLOTS, options)["particle_id"]
    walls = wall_columns(ref, options)
    wanted = {name, *(column for six in walls.values() for column in six)}
    table = read_columns(ref, wanted, ref.rows // len(walls), options)
    parts = []
    for number, six in enumerate(walls.values()):
        values = np.stack([table[column] for column in six], axis=1)
        row = np.flatnonzero((values != 0).any(axis=1))
        parts.append(
            (
                table[name][row],
                np.full(len(row), FIRST_WALL - number),
                values[row, :3],
                values[row, 3:],
            )
        )
    return dict(zip(WALL_CONTACTS, map(np.concatenate, zip(*parts, strict=True)), strict=True))
