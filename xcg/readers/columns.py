"""Columns of files: which variable of a scene each becomes, and frames made of them."""

from __future__ import annotations

import difflib
import re
from abc import abstractmethod
from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_user
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files.table import read_table
from xcg.readers.files.text import source_of
from xcg.readers.names import (
    CLOCK_SLOTS,
    CONTACT_SLOTS,
    PARTICLE_SLOTS,
    Slots,
    canonical,
    columns_by_name,
    components,
    other_unit,
    resembling,
)
from xcg.scene.contacts import FIRST_WALL
from xcg.scene.schema import COMPONENTS, Frame, variable

_FORCES = ("contact_force", "normal_force", "tangential_force")
_CONTACT_VECTORS = (*_FORCES, "contact_point", "contact_normal", "contact_branch", "end_i", "end_j")
_CONTACT_SCALARS = ("contact_i", "contact_j", "overlap")
_PLACES = (("position", "scaled"), ("unwrapped_position", "unwrapped_scaled"))
_PARTICLE_VECTORS = (
    *_PLACES[0],
    *_PLACES[1],
    "image",
    "velocity",
    "angular_velocity",
)
_PARTICLE_COMPONENTS = {component for slot in _PARTICLE_VECTORS for component in components(slot)}

# What the caller maps to the first displaces what fills the second by itself.
_RIVALS = (
    ("radius", "diameter"),
    ("scaled", "position"),
    ("normal_force", "contact_force"),
    ("tangential_force", "contact_force"),
)


def split_names(
    names: Mapping[str, Any] | Sequence[str | None] | str | None,
) -> tuple[dict[str, str | None], dict[str, tuple[str, ...]]]:
    """Return ``names=`` as a mapping from columns, and as words of the computes that wrote the contacts.

    Words are a text or a list, for files of contacts and of walls, or one of each in a mapping,
    ``{"contacts": "pos id force", "walls": "pos id force delta"}``, beside columns.
    """
    if names is None:
        return {}, {}
    if not isinstance(names, Mapping):
        names = dict.fromkeys(_KINDS_WITH_WORDS, names)
    words = {}
    for kind in _KINDS_WITH_WORDS:
        given = names.get(kind)
        if isinstance(given, str) and len(given.split()) > 1:
            words[kind] = tuple(given.split())
        elif isinstance(given, list | tuple):
            words[kind] = tuple(map(str, given))
    return {name: slot for name, slot in names.items() if name not in words}, words


_KINDS_WITH_WORDS = ("contacts", "walls")


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
        if slot is None or slot in PARTICLE_SLOTS or slot in CONTACT_SLOTS:
            continue
        pair = f"names={{{column!r}: {slot!r}}}"
        # all slots of contacts begin with one word
        prefix = "contact_" if slot.startswith("contact_") else ""
        endings = [name.removeprefix(prefix) for name in slots if name.startswith(prefix)]
        close = difflib.get_close_matches(slot.removeprefix(prefix), endings, 3, 0.8)
        if close:
            likely = " or ".join(repr(prefix + ending) for ending in close)
            raise SceneError(f"{pair}: did you mean {likely}?")
        meant = [name for name, aliases in slots.items() if canonical(slot) in aliases]
        if meant:
            raise SceneError(f"{pair}: that is a column; its variable is {meant[0]!r}")


def _lacks(ref: StepRef, what: str, slot: str) -> SceneError:
    word = re.compile(rf"(?<![a-z]){slot.rpartition('_')[2]}(?![a-z])", re.IGNORECASE)
    likely = next(filter(word.search, ref.columns), "its column")
    msg = (
        f"{source_of(ref)}: no {what} among the columns {' '.join(ref.columns)}; say which column it is, "
        f"for example names={{{likely!r}: {slot!r}}}"
    )
    if slot in CONTACT_SLOTS and any(map(_RAW.fullmatch, ref.columns)):
        rows = "".join(
            f"\n    {words:<14}{', '.join(slots)}" for words, slots in _WORDS_OF_COMPUTES
        )
        msg += f". Columns such as 'c_1[2]' have the order of the words in LAMMPS' compute, which become{rows}"
    return SceneError(msg)


_RAW = re.compile(r"[cf]_\w+(\[\d+\])?")  # columns of LAMMPS without names of their own
_WORDS_OF_COMPUTES = (
    ("patom1 patom2", ("contact_i", "contact_j")),
    ("dx dy dz", tuple(f"contact_branch_{axis}" for axis in COMPONENTS)),
    ("fx fy fz", tuple(f"normal_force_{axis}" for axis in COMPONENTS)),
    ("p1 p2 p3", (*(f"tangential_force_{axis}" for axis in COMPONENTS), "of granular styles")),
)


def unread_by_number(ref: StepRef, filled: Mapping[str, str], options: ReadOptions) -> str:
    """Return a hint about unnamed columns beside a complete force, with the mapping to use; "" without such columns.

    Where that force lies along all branches, they may hold its tangential part.
    """
    left = [
        name
        for name in ref.columns
        if _RAW.fullmatch(name) and name not in (*filled.values(), *options.names)
    ]
    if "contact_force_x" not in filled or len(left) < len(COMPONENTS):
        return ""
    mapping = f"{{{filled['contact_force_x']!r}: 'normal_force_x', {left[-3]!r}: 'tangential_force_x', ...}}"
    return (
        f"columns {' '.join(left)} are not read: if the tangential part is among them, say names={mapping}, and the "
        f"two are added up; otherwise drop them by names={{{left[0]!r}: None, ...}}"
    )


def _axes(filled: Iterable[str], slot: str) -> list[str]:
    return [axis for axis in COMPONENTS if f"{slot}_{axis}" in filled]


_SIZES = (
    ("diameter", "radius", 2.0),
    *((f"half_axis_{axis}", f"whole_axis_{axis}", 0.5) for axis in COMPONENTS),
)
_ROUNDED = 1e-4  # dumps of LAMMPS have six digits


def unify_sizes(frame: Frame, ref: StepRef) -> None:
    """Replace radii by diameters, and whole axes by half-axes. Raise SceneError if both are there and disagree."""
    for name, other, factor in _SIZES:
        if other not in frame:
            continue
        values = factor * frame.pop(other)
        there = frame.setdefault(name, values)
        if (
            there is not values
            and not (same := np.isclose(there, values, _ROUNDED, 0, equal_nan=True)).all()
        ):
            row = int(np.argmin(same))
            raise SceneError(
                f"{source_of(ref)}: {name} {there[row]:.6g} of row {row} is not {factor:g} times {other} "
                f"{values[row] / factor:.6g}; drop one of the two, names={{'column': None}}"
            )


def _with_motion(filled: Mapping[str, str], ref: StepRef) -> dict[str, str]:
    """Return the slots that positions and their images are read from.

    Positions are unwrapped along axes without others. Images follow from unwrapped positions, else
    from ``image``; from neither where a component is missing along an axis that may be periodic.
    """
    filled = dict(filled)
    for axis in COMPONENTS:
        if not {f"{slot}_{axis}" for slot in _PLACES[0]} & filled.keys():
            for slot, unwrapped in zip(*_PLACES, strict=True):
                if f"{unwrapped}_{axis}" in filled:
                    filled[f"{slot}_{axis}"] = filled[f"{unwrapped}_{axis}"]
    needed = {axis for slot in _PLACES[0] for axis in _axes(filled, slot)}
    if ref.periodic is not None:
        needed &= {*ref.periodic}
    known = {axis for slot in _PLACES[1] for axis in _axes(filled, slot)}
    unused = ["image_", "unwrapped_"]
    if known and needed <= known:
        unused.remove("unwrapped_")
    elif needed <= {*_axes(filled, "image")}:
        unused.remove("image_")
    return {slot: column for slot, column in filled.items() if not slot.startswith(tuple(unused))}


def _warn_of_lost_motion(filled: Mapping[str, str], read: Mapping[str, str], ref: StepRef) -> None:
    """Warn of images or unwrapped positions that are not used, as an axis is missing."""
    motion = ("image_", "unwrapped_")
    columns = [column for slot, column in filled.items() if slot.startswith(motion)]
    if columns and not any(slot.startswith(motion) for slot in read):
        warn_user(
            f"{source_of(ref)}: columns {' '.join(columns)} count periods along some axes only, and are not used to "
            "follow grains across periodic edges; write them for all periodic axes (ix iy iz, or xu yu zu)"
        )


def _warn_of_missing_height(read: Mapping[str, str], ref: StepRef) -> None:
    """Warn of positions without a z beside velocities with one."""
    if "velocity_z" in read and "position_z" not in read and "scaled_z" not in read:
        warn_user(
            f"{source_of(ref)}: no z of the position among the columns {' '.join(ref.columns)}, and "
            f"{read['velocity_z']!r} is one of the velocity: positions get z = 0, as of one layer; map the "
            f"column, names={{'its column': 'position_z'}}, or drop {read['velocity_z']!r} and the others of "
            "the velocity"
        )


def _add_unscaled(values: dict[str, NDArray], place: str, scaled: str, ref: StepRef) -> None:
    """Add the components of a place that follow from fractions of the box.

    Raises
    ------
    SceneError
        If the header has no box, or a fraction that a tilted box takes is missing.
    """
    for k, axis in enumerate(COMPONENTS):
        if f"{place}_{axis}" in values or f"{scaled}_{axis}" not in values:
            continue
        if ref.box is None:
            raise SceneError(
                f"{source_of(ref)}: positions are fractions of a box, and the header has no 'BOX "
                "BOUNDS'; dump x y z"
            )
        low, high = ref.box[k]
        values[f"{place}_{axis}"] = low + values[f"{scaled}_{axis}"] * (high - low)
        for other, vector in zip(COMPONENTS, ref.lattice or (), strict=False):
            if other == axis or not vector[k]:
                continue
            if f"{scaled}_{other}" not in values:
                raise SceneError(
                    f"{source_of(ref)}: the box is tilted, so {axis} follows from {axis}s and "
                    f"{other}s, and {other}s is missing; dump xs ys zs, or x y z"
                )
            values[f"{place}_{axis}"] += values[f"{scaled}_{other}"] * vector[k]


def _stacked(values: Mapping[str, NDArray], slot: str) -> NDArray:
    """Vector (n, 3) from its components; 0 for one that is not there."""
    vector = np.empty((len(next(iter(values.values()))), 3))
    for k, axis in enumerate(COMPONENTS):
        vector[:, k] = values.get(f"{slot}_{axis}", 0.0)
    return vector


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
    if not contacts:
        expected |= _warn_of_wall_arrays(ref, expected)
    unread = [column for column in ref.columns if column not in expected]
    slots = CONTACT_SLOTS if contacts else PARTICLE_SLOTS
    aliases = {alias: slot for slot, names in slots.items() for alias in names}
    spare = {column: aliases.get(canonical(column), "") for column in unread}
    slots_of_file = {aliases.get(canonical(column)) for column in ref.columns}
    suspects = [
        column
        for column in unread
        if _SUSPECT.search(column) and not _is_whole(spare[column], slots_of_file)
    ]
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
        if whole_vectors or meant not in _PARTICLE_VECTORS + _CONTACT_VECTORS:
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


def _is_whole(slot: str, slots: Container[str | None]) -> bool:
    """Return whether all components of the vector of a slot are among these slots."""
    return all(f"{slot[:-2]}_{axis}" in slots for axis in COMPONENTS)


def _warn_of_wall_arrays(ref: StepRef, expected: set[str]) -> set[str]:
    """Warn of arrays of contacts with walls (LAMMPS), and return their columns."""
    columns: set[str] = set()
    arrays = {column.removesuffix("[1]") for column in ref.columns if column.startswith("f_")}
    for array in sorted(arrays):
        numbered = [f"{array}[{k}]" for k in range(1, _WALL_ARRAY + 1)]
        if set(numbered) <= set(ref.columns) - expected:
            columns.update(numbered)
            warn_user(
                f"{source_of(ref)}: columns {array}[1] to {array}[{_WALL_ARRAY}] look like contacts "
                "with a wall (fix wall/gran ... contacts) and are not read; give the wall a name, "
                f"walls={{'side': '{array}[*]'}}, or drop them by names={{'{array}[1]': None, ...}}"
            )
    return columns


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


# --- contacts with walls, in columns of the particles -----------------------------------------------------

# The per-atom array of LAMMPS' ``fix wall/gran ... contacts``: 1 where the grain touches, force on
# it (3), point on the wall (3), radius; zeros where it does not touch.
_WALL_ARRAY = 8
_FORCE_AND_POINT = slice(1, 7)
WALL_CONTACTS = ("contact_i", "contact_j", "contact_force", "contact_point")


def columns_of_walls(options: ReadOptions) -> dict[str, list[str]]:
    """Columns that the contacts with each wall have among those of particles: the whole array, or the six given."""
    return {
        wall: [given.replace("*", str(k + 1)) for k in range(_WALL_ARRAY)]
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


def wall_contacts_from(ref: StepRef, options: ReadOptions, engine: Columnar) -> Frame:
    """Read the contacts with walls from columns of a step of particles, wall after wall."""
    name, walls = assign(ref, PARTICLE_SLOTS, options)["particle_id"], wall_columns(ref, options)
    wanted = {name, *(column for six in walls.values() for column in six)}
    table = engine.read_columns(ref, wanted, ref.rows // len(walls), options)
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


def _own(ref: StepRef, options: ReadOptions, dim: str) -> dict[str, str]:
    """Columns that `names` maps to variables of the caller's own, of particles or of contacts."""
    known = {*PARTICLE_SLOTS, *CONTACT_SLOTS, "time", "step"}
    return {
        slot: column
        for column, slot in options.names.items()
        if slot is not None
        and column in ref.columns
        and slot not in known
        and variable(slot).dims == (dim,)
    }


def read_names(
    names: Mapping[str, Any] | Sequence[str | None] | None,
) -> tuple[dict[str, str | None], dict[str, Sequence[str | None]]]:
    """Return ``names=`` as a mapping from columns, and as the columns of each kind of file in their order.

    Raises
    ------
    SceneError
        If names in their order are not texts or None, or one occurs twice.
    """
    if names is None:
        return {}, {}
    in_order: dict[str, Sequence[str | None]]
    if isinstance(names, Mapping):
        in_order = {kind: given for kind, given in names.items() if isinstance(given, list | tuple)}
        if not in_order:
            return dict(names), {}
        if set(names) != set(in_order) or not set(names) <= set(_KINDS):
            raise SceneError(
                f"names={dict(names)!r}: expected a mapping from columns to variables, or lists of all "
                "columns in their order, names={'particles': [...], 'contacts': [...]}"
            )
    elif isinstance(names, list | tuple):
        in_order = dict.fromkeys(_KINDS, names)
    else:
        raise SceneError(f"names={names!r}: expected a mapping or a list of names")
    aliases = {alias for slots in _ALL_SLOTS for found in slots.values() for alias in found}
    mapping: dict[str, str | None] = {}
    for given in in_order.values():
        for name, count in Counter(given).items():
            if name is None:
                continue
            if not isinstance(name, str) or count > 1:
                raise SceneError(
                    f"names={list(given)!r}: {name!r} stands there {count} times; expected the name of each column "
                    "once, in the order of the file, and None for a column to skip"
                )
            if canonical(name) not in aliases:  # a slot, or a variable of the caller's own
                mapping[name] = name
    return mapping, in_order


_KINDS = ("particles", "contacts")
_ALL_SLOTS = (PARTICLE_SLOTS, CONTACT_SLOTS, CLOCK_SLOTS)


class Columnar(Engine):
    """An engine of files that hold columns of numbers; it lists their steps, and reads columns by name.

    Attributes
    ----------
    PARTICLE_SLOTS, CONTACT_SLOTS : mapping
        Columns that are taken for variables of the scene without ``names=``, see
        `xcg.readers.names`.
    NEEDS_ID : bool
        Whether particles must have a column of ids.
    MORE_DIGITS : str
        Command of the code that writes numbers with more than six digits.
    """

    PARTICLE_SLOTS: ClassVar[Slots] = PARTICLE_SLOTS
    CONTACT_SLOTS: ClassVar[Slots] = CONTACT_SLOTS
    NEEDS_ID: ClassVar[bool] = True
    ROWS_ARE_IDS: ClassVar[bool] = False
    MORE_DIGITS: ClassVar[str] = "dump_modify ... format float %.10g"

    @abstractmethod
    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps in files with particles or contacts, from headers alone."""

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read columns (rows,) of one step by their names in the file; texts of numbers between blanks by default."""
        return read_table(ref, wanted, rows, options)

    def index_particles(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of particles, and warn of columns that are probably not ignored on purpose."""
        refs = self.list_steps(paths, options, contacts=False)
        read = self.particle_columns(refs[0], options)
        warn_of_unread(refs[0], read, options, contacts=False)
        _warn_of_missing_height(read, refs[0])
        _warn_of_lost_motion(assign(refs[0], self.PARTICLE_SLOTS, options), read, refs[0])
        return refs

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of contacts, and warn of columns that are probably not ignored on purpose."""
        refs = self.list_steps(paths, options, contacts=True)
        warn_of_unread(refs[0], self.contact_columns(refs[0], options), options, contacts=True)
        return refs

    def particle_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the column of each slot, checked to be enough for particles.

        Columns that `names` maps to other names become custom variables. A two-dimensional file
        need not hold z.
        """
        filled = assign(ref, self.PARTICLE_SLOTS, options)
        if self.NEEDS_ID and "particle_id" not in filled:
            raise _lacks(ref, "id of the particle", "particle_id")
        filled = _with_motion(filled, ref)
        present = {axis for slot in ("position", "scaled") for axis in _axes(filled, slot)}
        for axis in "xy":
            if axis not in present:
                raise _lacks(ref, f"{axis} of the position", f"position_{axis}")
        for axis in sorted(present):
            if _axes(filled, "velocity") and f"velocity_{axis}" not in filled:
                raise _lacks(ref, f"{axis} of the velocity", f"velocity_{axis}")
        unwanted = options.unwanted
        if "image" in unwanted:
            unwanted = (*unwanted, "unwrapped_")
        turning = _axes(filled, "angular_velocity")
        # in a plane, grains turn about its normal alone
        if 0 < len(turning) < 3 and turning != ["z"]:
            axis = next(axis for axis in COMPONENTS if axis not in turning)
            if any(str(slot).startswith("angular_velocity_") for slot in options.names.values()):
                raise _lacks(ref, f"{axis} of the angular velocity", f"angular_velocity_{axis}")
            # the file's column was mapped to something else
            unwanted = (
                *unwanted,
                "angular_velocity",
            )
        read = {slot: column for slot, column in filled.items() if not slot.startswith(unwanted)}
        return read | _own(ref, options, "particle")

    def contact_slots(self, ref: StepRef, options: ReadOptions) -> Slots:
        """Return the columns that are taken for variables of contacts, where they depend on the file."""
        return self.CONTACT_SLOTS

    def contact_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the column of each slot, checked to be enough for contacts.

        The force is ``contact_force``; without it, the sum of ``normal_force`` and
        ``tangential_force``; without the second, the first alone. Columns that `names` maps to
        other names that begin with "contact_" become variables of their own.
        """
        filled = assign(ref, self.contact_slots(ref, options), options)
        for slot in ("contact_i", "contact_j"):
            if slot not in filled:
                raise _lacks(ref, "ids of both partners", slot)
        # a hint: without all of it, images follow from positions
        if len(_axes(filled, "contact_branch")) < 3:
            filled = {
                slot: column
                for slot, column in filled.items()
                if not slot.startswith("contact_branch")
            }
        there = {slot: _axes(filled, slot) for slot in _CONTACT_VECTORS}
        if 0 < len(there["contact_force"]) < len(there["normal_force"]):  # it is something else
            mapped = [f"contact_force_{axis}" in options.names.values() for axis in COMPONENTS]
            if not any(mapped):
                filled = {s: c for s, c in filled.items() if not s.startswith("contact_force")}
                there["contact_force"] = []
        for slot, axes in there.items():
            if 0 < len(axes) < 3:
                lacking = next(axis for axis in COMPONENTS if axis not in axes)
                raise _lacks(ref, f"{lacking} of the {slot.replace('_', ' ')}", f"{slot}_{lacking}")
        if not there["contact_force"] and not there["normal_force"]:
            raise _lacks(ref, "contact force", "contact_force_x")
        if there["contact_force"] and there["tangential_force"] and not there["normal_force"]:
            total, part = filled["contact_force_x"], filled["tangential_force_x"]
            raise SceneError(
                f"{source_of(ref)}: is '{total}' the whole contact force or its normal part, beside the tangential "
                f"'{part}'? Say names={{'{total}': 'normal_force_x', ...}} to add the two up, or "
                f"names={{'{part}': None, ...}} to take the first alone"
            )
        unused = (
            ("normal_force", "tangential_force") if there["contact_force"] else ("contact_force",)
        )
        read = {slot: column for slot, column in filled.items() if not slot.startswith(unused)}
        return read | _own(ref, options, "contact")

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """Names of the variables that follow from what `read_contacts` returns."""
        columns = self.contact_columns(ref, options)
        scalars = [
            slot for slot in columns if slot in _CONTACT_SCALARS or slot not in CONTACT_SLOTS
        ]
        normal = "contact_normal_x" in columns or "end_i_x" in columns
        point = ["contact_point"] if "contact_point_x" in columns else []
        return [*scalars, "contact_force", *point, *(["contact_normal"] if normal else [])]

    def ignored_columns(
        self, ref: StepRef, options: ReadOptions, *, contacts: bool = False
    ) -> list[str]:
        """Columns of a step that are not read."""
        read = (
            self.contact_columns(ref, options) if contacts else self.particle_columns(ref, options)
        )
        return [column for column in ref.columns if column not in read.values()]

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the particles of one step from the columns of `particle_columns`."""
        columns = self.particle_columns(ref, options)
        table = self.read_columns(ref, columns.values(), ref.rows, options)
        values = {slot: table[column] for slot, column in columns.items()}
        for place, scaled in _PLACES:
            _add_unscaled(values, place, scaled, ref)
        for axis in _axes(values, "position"):  # not periodic where only the others are unwrapped
            if _axes(values, "unwrapped_position"):
                values.setdefault(f"unwrapped_position_{axis}", values[f"position_{axis}"])
        frame = {slot: array for slot, array in values.items() if slot not in _PARTICLE_COMPONENTS}
        vectors = ("position", "unwrapped_position", "image", "velocity", "angular_velocity")
        frame |= {slot: _stacked(values, slot) for slot in vectors if _axes(values, slot)}
        unify_sizes(frame, ref)
        if columns.get("body_id") == "mol":  # LAMMPS' molecule 0 is none
            frame["body_id"] = np.where(frame["body_id"] == 0, -1, frame["body_id"])
        # copies of single columns, so that the table can go
        return {
            name: array if array.base is None else array.copy() for name, array in frame.items()
        }

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the contacts of one step from the columns of `contact_columns`."""
        columns = self.contact_columns(ref, options)
        table = self.read_columns(ref, columns.values(), ref.rows, options)
        values = {slot: table[column] for slot, column in columns.items()}
        frame: Frame = {
            s: v for s, v in values.items() if s in _CONTACT_SCALARS or s not in CONTACT_SLOTS
        }
        frame |= {
            slot: _stacked(values, slot) for slot in _CONTACT_VECTORS if f"{slot}_x" in columns
        }
        if "contact_force" not in frame:
            frame["contact_force"] = frame.pop("normal_force") + frame.pop(
                "tangential_force", np.zeros(3)
            )
        # wrapped positions: the nearest image is taken where the periods are known
        if "end_i" in frame:
            frame["wrapped_branch"] = frame.pop("end_i") - frame.pop("end_j")
        large = frame["contact_i"][frame["contact_i"] >= 1e6]
        if len(large) > 10 and (large % 10 == 0).all():
            raise SceneError(
                f"{source_of(ref)}: ids above a million all end in 0, as they were written with six digits, the "
                f"default of 'dump local'; write the file anew with '{self.MORE_DIGITS}'"
            )
        return frame
