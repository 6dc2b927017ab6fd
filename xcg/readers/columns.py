"""Frames made of the columns of files."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from xcg.common import memory
from xcg.common.messages import SceneError
from xcg.readers.assigned import (
    CONTACT_VECTORS,
    PARTICLE_VECTORS,
    POSITIONS,
    assign,
    axes_of,
    lacks,
    magnitudes,
    magnitudes_among,
    own_variables,
)
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files.table import Columns, read_table
from xcg.readers.files.text import source_of
from xcg.readers.likely_names import words_of
from xcg.readers.named_columns import factor_of, vector_of
from xcg.readers.names import CONTACT_SLOTS, PARTICLE_SLOTS, Slots, canonical, components, slots_for
from xcg.readers.report import warn_of_lost_motion, warn_of_missing_height
from xcg.scene.schema import COMPONENTS, Frame

_CONTACT_COMPONENTS = {component for slot in CONTACT_VECTORS for component in components(slot)}
_NOT_IN_FRAMES = {component for slot in PARTICLE_VECTORS for component in components(slot)}
_NOT_IN_FRAMES |= {"scaled", "unwrapped_scaled"}
_SIZES = (
    ("diameter", "radius", 2.0),
    *((f"half_axis_{axis}", f"whole_axis_{axis}", 0.5) for axis in COMPONENTS),
)
_EXPLAINED = 1e-2  # relative difference of lengths that one follows from the other
_SHORT = 3  # letters of a name whose last one may be an axis
_ROUNDED = 1e-4  # dumps of LAMMPS have six digits


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
    NEEDS_ID = True
    ROWS_ARE_IDS = False
    MORE_DIGITS = "dump_modify ... format float %.10g"

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

    def _read_slots(
        self,
        ref: StepRef,
        columns: Mapping[str, str],
        vectors: Iterable[str],
        options: ReadOptions,
    ) -> Frame:
        """Read the values of each slot, and vectors (n, 3) under their names where the engine can.

        These are one array, of which the columns are views.
        """
        whole: dict[str, tuple[str, ...]] = {}
        for slot in vectors:
            if columns.keys() >= components(slot).keys():
                whole[slot] = tuple(columns[name] for name in components(slot))
        options = replace(options, vectors=tuple({*whole.values()}))
        table: Columns = self.read_columns(ref, columns.values(), ref.rows, options)
        if "units" not in options.given:
            _convert(table, columns)
        frame = {slot: table[column] for slot, column in columns.items()}
        return frame | {slot: table[group] for slot, group in whole.items() if group in table}

    def index_particles(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of particles, and check that columns are enough."""
        refs = self.list_steps(paths, options, contacts=False)
        read = self.particle_columns(refs[0], options)
        warn_of_missing_height(read, refs[0])
        warn_of_lost_motion(assign(refs[0], self.PARTICLE_SLOTS, options), read, refs[0])
        return refs

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of contacts, and check that columns are enough."""
        refs = self.list_steps(paths, options, contacts=True)
        self.contact_columns(refs[0], options)
        return refs

    def particle_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the column of each slot, checked to be enough for particles.

        Columns that `names` maps to other names become custom variables. A two-dimensional file
        need not hold z.
        """
        filled = assign(ref, slots_for(ref.columns, self.PARTICLE_SLOTS), options)
        if self.NEEDS_ID and "particle_id" not in filled:
            raise lacks(ref, "id of the particle", "particle_id")
        filled = _with_motion(filled, ref)
        present = {axis for slot in ("position", "scaled") for axis in axes_of(filled, slot)}
        for axis in COMPONENTS:
            # in a plane, nothing is along the third axis
            if axis not in present and (len(present) < 2 or _tells_of(axis, filled, ref, options)):
                raise lacks(ref, f"{axis} of the position", f"position_{axis}")
        for axis in sorted(present):
            moving = [filled[f"velocity_{other}"] for other in axes_of(filled, "velocity")]
            if moving and f"velocity_{axis}" not in filled:
                error = lacks(ref, f"{axis} of the velocity", f"velocity_{axis}")
                dropped = ", ".join(f"{column!r}: None" for column in moving)
                raise SceneError(f"{error}, or drop the others by names={{{dropped}}}")
        unwanted = options.unwanted
        if "image" in unwanted:
            unwanted = (*unwanted, "unwrapped_")
        turning = axes_of(filled, "angular_velocity")
        # in a plane, grains turn about its normal alone
        if 0 < len(turning) < 3 and turning != ["z"]:
            if any(str(slot).startswith("angular_velocity_") for slot in options.names.values()):
                raise _lacks_an_axis(ref, "angular_velocity", turning)
            # the file's column was mapped to something else
            unwanted = (*unwanted, "angular_velocity")
        read = {slot: column for slot, column in filled.items() if not slot.startswith(unwanted)}
        return read | own_variables(ref, options, "particle")

    def contact_slots(self, ref: StepRef, options: ReadOptions) -> Slots:
        """Return the columns that are taken for variables of contacts, where they depend on the file."""
        return self.CONTACT_SLOTS

    def contact_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the column of each slot, checked to be enough for contacts.

        The force is ``contact_force``; without it, the sum of ``normal_force`` and
        ``tangential_force``; without the second, the first alone. Columns that `names` maps to
        other names that begin with "contact_" become further variables.
        """
        filled = assign(ref, self.contact_slots(ref, options), options)
        for slot in ("contact_i", "contact_j"):
            if slot not in filled:
                raise lacks(ref, "ids of both partners", slot)
        axes = {slot: axes_of(filled, slot) for slot in CONTACT_VECTORS}
        unused = []
        # a hint: without all of it, images follow from positions
        if len(axes["contact_branch"]) < 3:
            unused.append("contact_branch")
        mapped = [f"contact_force_{axis}" in options.names.values() for axis in COMPONENTS]
        if len(axes["contact_force"]) < len(axes["normal_force"]) and not any(mapped):
            unused.append("contact_force")  # it is something else
        for slot in unused:
            axes[slot] = []
        in_plane = _plane_of_contacts(axes, filled, ref, options)
        for slot, present in axes.items():
            if 0 < len(present) < 3 and present != in_plane:
                raise _lacks_an_axis(ref, slot, present)
        if not axes["contact_force"] and not axes["normal_force"]:
            scalars = magnitudes_among(ref.columns, options.names)
            if scalars:
                raise SceneError(f"{source_of(ref)}: {magnitudes(scalars)}")
            raise lacks(ref, "contact force", "contact_force_x")
        if axes["contact_force"] and axes["tangential_force"] and not axes["normal_force"]:
            total = filled["contact_force_x"]
            part = filled["tangential_force_x"]
            raise SceneError(
                f"{source_of(ref)}: is '{total}' the whole contact force or its normal part, beside the tangential "
                f"'{part}'? Say names={{'{total}': 'normal_force_x', ...}} to add the two up, or "
                f"names={{'{part}': None, ...}} to take the first alone"
            )
        if axes["contact_force"]:
            unused += ["normal_force", "tangential_force"]
        read = {
            slot: column for slot, column in filled.items() if not slot.startswith(tuple(unused))
        }
        return read | own_variables(ref, options, "contact")

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """Names of the variables that follow from what `read_contacts` returns."""
        columns = self.contact_columns(ref, options)
        names = [slot for slot in columns if slot not in _CONTACT_COMPONENTS]
        names.append("contact_force")
        if axes_of(columns, "contact_point"):
            names.append("contact_point")
        if axes_of(columns, "contact_normal") or axes_of(columns, "end_i"):
            names.append("contact_normal")
        return names

    def explained(self, ref: StepRef, options: ReadOptions, lengths: Sequence[str]) -> list[str]:
        """Return unread columns that follow from others: radii of the volumes, or distances of the positions."""
        read = self.particle_columns(ref, options)
        positions = [read[f"position_{axis}"] for axis in axes_of(read, "position")]
        if "volume" not in read or not lengths:
            return []
        table = self.read_columns(ref, [read["volume"], *positions, *lengths], ref.rows, options)
        radius = np.cbrt(0.75 / np.pi * table[read["volume"]])
        squares = [table[column] ** 2 for column in positions]
        radii_and_distances = [radius, 2 * radius, np.sqrt(sum(squares)), np.sqrt(sum(squares[:2]))]
        return [
            column
            for column in lengths
            if any(np.allclose(table[column], values, _EXPLAINED) for values in radii_and_distances)
        ]

    def columns_read(self, ref: StepRef, options: ReadOptions, *, contacts: bool) -> dict[str, str]:
        """Return the slot of each column that is read."""
        columns_of = self.contact_columns if contacts else self.particle_columns
        return {column: slot for slot, column in columns_of(ref, options).items()}

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the particles of one step from the columns of `particle_columns`."""
        columns = self.particle_columns(ref, options)
        values = self._read_slots(ref, columns, PARTICLE_VECTORS, options)
        for position, scaled in POSITIONS:
            _add_unscaled(values, position, scaled, ref)
        for axis in axes_of(values, "position"):  # not periodic where only the others are unwrapped
            if axes_of(values, "unwrapped_position"):
                values.setdefault(f"unwrapped_position_{axis}", values[f"position_{axis}"])
        frame = {slot: array for slot, array in values.items() if slot not in _NOT_IN_FRAMES}
        for slot in ("position", "unwrapped_position", "image", "velocity", "angular_velocity"):
            if axes_of(values, slot) and slot not in frame:
                frame[slot] = _stacked(values, slot)
        unify_sizes(frame, ref)
        if columns.get("body_id") == "mol":  # LAMMPS' molecule 0 is none
            frame["body_id"] = np.where(frame["body_id"] == 0, -1, frame["body_id"])
        for name, array in frame.items():
            if not memory.owns_memory(array):  # a copy of a single column, so that the table can go
                frame[name] = array.copy()
        return frame

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the contacts of one step from the columns of `contact_columns`."""
        columns = self.contact_columns(ref, options)
        values = self._read_slots(ref, columns, CONTACT_VECTORS, options)
        frame = {slot: array for slot, array in values.items() if slot not in _CONTACT_COMPONENTS}
        for slot in CONTACT_VECTORS:
            if axes_of(columns, slot) and slot not in frame:
                frame[slot] = _stacked(values, slot)
        if "contact_force" not in frame:
            tangential = frame.pop("tangential_force", np.zeros(3))
            frame["contact_force"] = frame.pop("normal_force") + tangential
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


def _convert(table: Columns, columns: Mapping[str, str]) -> None:
    """Convert columns whose names hold a unit to SI, in place; vectors are one array with their columns."""
    for column, slot in {column: slot for slot, column in columns.items()}.items():
        factor = factor_of(column, slot)
        if factor != 1 and table[column].flags.writeable:
            table[column] *= factor
        elif factor != 1:
            table[column] = table[column] * factor


def _with_motion(filled: Mapping[str, str], ref: StepRef) -> dict[str, str]:
    """Return the slots that positions and their images are read from.

    Positions are unwrapped along axes without others. Images follow from unwrapped positions, else
    from ``image``; from neither where a component is missing along an axis that may be periodic.
    """
    filled = dict(filled)
    for axis in COMPONENTS:
        if not {f"{slot}_{axis}" for slot in POSITIONS[0]} & filled.keys():
            for slot, unwrapped in zip(*POSITIONS, strict=True):
                if f"{unwrapped}_{axis}" in filled:
                    filled[f"{slot}_{axis}"] = filled[f"{unwrapped}_{axis}"]
    needed = {axis for slot in POSITIONS[0] for axis in axes_of(filled, slot)}
    if ref.periodic is not None:
        needed &= {*ref.periodic}
    axes = {axis for slot in POSITIONS[1] for axis in axes_of(filled, slot)}
    unused = ["image_", "unwrapped_"]
    if axes and needed <= axes:
        unused.remove("unwrapped_")
    elif needed <= {*axes_of(filled, "image")}:
        unused.remove("image_")
    return {slot: column for slot, column in filled.items() if not slot.startswith(tuple(unused))}


def unify_sizes(frame: Frame, ref: StepRef) -> None:
    """Replace radii by diameters, and whole axes by half-axes.

    Raises
    ------
    SceneError
        If both are there and disagree.
    """
    for name, other, factor in _SIZES:
        if other not in frame:
            continue
        values = factor * frame.pop(other)
        if name not in frame:
            frame[name] = values
            continue
        same = np.isclose(frame[name], values, _ROUNDED, 0, equal_nan=True)
        if not same.all():
            row = int(np.argmin(same))
            raise SceneError(
                f"{source_of(ref)}: {name} {frame[name][row]:.6g} of row {row} is not {factor:g} times {other} "
                f"{values[row] / factor:.6g}; drop one of the two, names={{'column': None}}"
            )


def _add_unscaled(values: dict[str, NDArray], position: str, scaled: str, ref: StepRef) -> None:
    """Add the components of a position that follow from fractions of the box.

    Raises
    ------
    SceneError
        If the header has no box, or a fraction that a tilted box takes is missing.
    """
    for k, axis in enumerate(COMPONENTS):
        if f"{position}_{axis}" in values or f"{scaled}_{axis}" not in values:
            continue
        if ref.box is None:
            raise SceneError(
                f"{source_of(ref)}: positions are fractions of a box, and the header has no 'BOX "
                "BOUNDS'; dump x y z"
            )
        low, high = ref.box[k]
        values[f"{position}_{axis}"] = low + values[f"{scaled}_{axis}"] * (high - low)
        for other, vector in zip(COMPONENTS, ref.lattice or (), strict=False):
            if other == axis or not vector[k]:
                continue
            if f"{scaled}_{other}" not in values:
                raise SceneError(
                    f"{source_of(ref)}: the box is tilted, so {axis} follows from {axis}s and "
                    f"{other}s, and {other}s is missing; dump xs ys zs, or x y z"
                )
            values[f"{position}_{axis}"] += values[f"{scaled}_{other}"] * vector[k]


def _tells_of(axis: str, filled: Mapping[str, str], ref: StepRef, options: ReadOptions) -> bool:
    """Return whether columns show that positions have a component along x or y; z may be left out."""
    has_velocity = f"velocity_{axis}" in filled
    return axis != "z" and (has_velocity or axis in _axes_of_unread(filled, ref, options))


def _axes_of_unread(filled: Mapping[str, str], ref: StepRef, options: ReadOptions) -> set[str]:
    """Return the axes that names of unread columns hold, such as z in "fz" and "my z"."""
    axes: set[str] = set()
    for column in ref.columns:
        if column not in filled.values() and column not in options.names:
            letters = canonical(column)
            axes.update(words_of(column), letters[-1:] if len(letters) <= _SHORT else "")
    return axes & {*COMPONENTS}


def _plane_of_contacts(
    axes: Mapping[str, Sequence[str]],
    filled: Mapping[str, str],
    ref: StepRef,
    options: ReadOptions,
) -> list[str]:
    """Return the two axes of contacts in a plane: no column has a third; else an empty list."""
    present = {axis for listed in axes.values() for axis in listed}
    others = {*COMPONENTS} - present
    mapped = {vector_of(slot) for slot in options.names.values() if slot}
    if len(present) != 2 or mapped & {*CONTACT_VECTORS}:
        return []
    if others & _axes_of_unread(filled, ref, options):
        return []
    return [axis for axis in COMPONENTS if axis in present]


def _lacks_an_axis(ref: StepRef, vector: str, present: Sequence[str]) -> SceneError:
    """Make the error of a file with some components of a vector."""
    axis = next(axis for axis in COMPONENTS if axis not in present)
    return lacks(ref, f"{axis} of the {vector.replace('_', ' ')}", f"{vector}_{axis}")


def _stacked(values: Mapping[str, NDArray], slot: str) -> NDArray:
    """Vector (n, 3) from its components; 0 for one that is not there."""
    vector = np.empty((len(next(iter(values.values()))), 3))
    for k, axis in enumerate(COMPONENTS):
        vector[:, k] = values.get(f"{slot}_{axis}", 0.0)
    return vector
