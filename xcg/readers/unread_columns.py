"""Warnings about columns that are not read, and what they may hold."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from xcg.common.messages import SceneError, warn_user
from xcg.readers.assigned import CONTACT_VECTORS, PARTICLE_VECTORS, RAW
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.readers.names import CONTACT_SLOTS, PARTICLE_SLOTS, canonical, other_unit, resembling
from xcg.readers.wall_columns import WALL_ARRAY, columns_of_walls
from xcg.scene.schema import COMPONENTS

_SUSPECT = re.compile("wall|force", re.IGNORECASE)
_AXIS = re.compile(r"(?<![A-Za-z])[xyzXYZ](?![A-Za-z])")


def warn_of_unread(
    ref: StepRef, filled: Mapping[str, str], options: ReadOptions, *, contacts: bool
) -> None:
    """Warn of columns that look like a variable by their names, and that are not read.

    Parameters
    ----------
    ref : StepRef
        A step of the file.
    filled : mapping
        The column of each slot that is read.
    options : ReadOptions
        The caller's options; columns in `names` and `walls` are no surprise.
    contacts : bool
        Whether the file holds contacts.
    """
    expected = {*filled.values(), *options.names}
    expected.update(*columns_of_walls(options).values())
    slots = CONTACT_SLOTS
    if not contacts:
        slots = PARTICLE_SLOTS
        expected |= _warn_of_wall_arrays(ref, expected)
    unread = [column for column in ref.columns if column not in expected]
    aliases = {alias: slot for slot, names in slots.items() for alias in names}
    spare = {column: aliases.get(canonical(column), "") for column in unread}
    slots_of_file = {aliases.get(canonical(column)) for column in ref.columns}
    suspects = []
    for column in filter(_SUSPECT.search, unread):
        of_vector = {f"{spare[column][:-2]}_{axis}" for axis in COMPONENTS}
        if not of_vector <= slots_of_file:
            suspects.append(column)
    if suspects:
        target = "contact_force_x"
        if not contacts:
            target = "my_" + re.sub(r"\W+", "_", suspects[0]).strip("_").lower()
        warn_user(
            f"{source_of(ref)}: columns {' '.join(suspects)} look like forces or contacts with walls "
            f"and are not read; map them, for example names={{{suspects[0]!r}: {target!r}}}, or drop "
            f"them by names={{{suspects[0]!r}: None}}. Contacts with walls are rows of the files of "
            "contacts (contacts=, walls=), with the grain as contact_i"
        )
    others = [column for column in unread if column not in suspects]
    warn_of_resembling(ref, others, filled, contacts=contacts)
    for column, slot in spare.items():
        if slot in filled:
            warn_user(
                f"{source_of(ref)}: both {filled[slot]!r} and {column!r} may be {slot!r}, and "
                f"{filled[slot]!r} is read; drop one of them, names={{{column!r}: None}}"
            )


def warn_of_resembling(
    ref: StepRef,
    unread: Iterable[str],
    filled: Iterable[str],
    *,
    contacts: bool,
    whole_vectors: bool = False,
) -> None:
    """Warn of unread columns whose names resemble a variable that the scene lacks.

    Vectors are columns for each component, or `whole_vectors`.
    """
    likely = resembling(unread, filled, contacts=contacts)
    if not likely:
        return
    listed = ", ".join(f"{name!r} ({variable_name}?)" for name, variable_name in likely.items())
    example = ""
    for column, meant in reversed(likely.items()):
        axis = _AXIS.search(column)
        if whole_vectors or meant not in PARTICLE_VECTORS + CONTACT_VECTORS:
            example = f", for example names={{{column!r}: {meant!r}}}"
        elif axis:
            example = f", for example names={{{column!r}: '{meant}_{axis[0].lower()}'}}"
    warn_user(
        f"{source_of(ref)}: columns {listed} resemble variables and are not read; map them{example}, "
        f"or drop them by names={{{next(iter(likely))!r}: None}}"
    )


def warn_of_other_units(ref: StepRef, options: ReadOptions) -> None:
    """Warn of columns that the caller maps, whose names hold a unit such as mm."""
    columns = [name for name in ref.columns if options.names.get(name) and other_unit(name)]
    if columns:
        warn_user(
            f"{source_of(ref)}: columns {', '.join(map(repr, columns))} name a unit, and SI is "
            "taken; give the factors to SI, such as units={'length': 1e-3} for mm, or units='SI'"
        )


def _warn_of_wall_arrays(ref: StepRef, expected: set[str]) -> set[str]:
    """Warn of arrays of contacts with walls (LAMMPS), and return their columns."""
    columns: set[str] = set()
    arrays = {column.removesuffix("[1]") for column in ref.columns if column.startswith("f_")}
    for array in sorted(arrays):
        numbered = [f"{array}[{k}]" for k in range(1, WALL_ARRAY + 1)]
        if set(numbered) <= set(ref.columns) - expected:
            columns.update(numbered)
            warn_user(
                f"{source_of(ref)}: columns {array}[1] to {array}[{WALL_ARRAY}] look like contacts "
                "with a wall (fix wall/gran ... contacts) and are not read; give the wall a name, "
                f"walls={{'side': '{array}[*]'}}, or drop them by names={{'{array}[1]': None, ...}}"
            )
    return columns


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


def warn_of_lost_motion(filled: Mapping[str, str], read: Mapping[str, str], ref: StepRef) -> None:
    """Warn of images or unwrapped positions that are not used, as an axis is missing."""
    motion = ("image_", "unwrapped_")
    columns = [column for slot, column in filled.items() if slot.startswith(motion)]
    if columns and not any(slot.startswith(motion) for slot in read):
        warn_user(
            f"{source_of(ref)}: columns {' '.join(columns)} count periods along some axes only, and are not used to "
            "follow grains across periodic edges; write them for all periodic axes (ix iy iz, or xu yu zu)"
        )


def warn_of_missing_height(read: Mapping[str, str], ref: StepRef) -> None:
    """Warn of positions without a z beside velocities with one."""
    if "velocity_z" in read and "position_z" not in read and "scaled_z" not in read:
        warn_user(
            f"{source_of(ref)}: no z of the position among the columns {' '.join(ref.columns)}, and "
            f"{read['velocity_z']!r} is one of the velocity: positions get z = 0, as of one layer; map the "
            f"column, names={{'its column': 'position_z'}}, or drop {read['velocity_z']!r} and the others of "
            "the velocity"
        )


def report_missing_ids(ref: StepRef, steps: int, *, contacts: bool) -> None:
    """Warn that rows are numbered in several steps; raise SceneError for contacts by id."""
    way_out = (
        "map it, names={'...': 'particle_id'} (HDF5: mapping={'particle_id': '...'}); the columns are "
        + " ".join(ref.columns)
    )
    if contacts:
        raise SceneError(
            f"{source_of(ref)}: no column of particle ids, and contacts name their particles by id; "
            f"{way_out}"
        )
    if steps > 1:
        warn_user(
            f"{source_of(ref)}: no column of particle ids, so rows are numbered, and may be other "
            "particles in every step: velocities from positions, displacements and diffusion are "
            f"refused. If there is such a column, {way_out}"
        )
