"""LAMMPS and LIGGGHTS dumps: text, binary or NetCDF for particles, and rows of pairs for contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

from xcg.common.messages import warn_user
from xcg.readers import columns
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines import dump
from xcg.readers.files.text import source_of
from xcg.scene.schema import COMPONENTS, Frame

_WALLS = "walls"  # kind of a step whose contacts stand in columns of the particles


class Lammps(dump.Dumps):
    """Dumps of LAMMPS."""

    UNNAMED_UNITS = "have the files say it by 'dump_modify ... units yes'"

    def recognises(self, path: str) -> bool:
        """Return whether the file begins as a LAMMPS dump, and not as one that only LIGGGHTS writes."""
        if dump.form_of(path):
            return True
        found = dump.body_columns(path)
        return found is not None and ".liggghts" not in path and not dump.is_numbered(found[1])

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``dump local`` files."""
        refs = dump.index_dumps(paths, options, atoms=False)
        found = self.contact_columns(refs[0], options)
        columns.warn_of_ignored(refs[0], found, columns.CONTACT_SLOTS, options)
        if "normal_force_x" in found and "tangential_force_x" not in found:
            warn_user(
                f"{source_of(refs[0])}: only normal forces ({found['normal_force_x']}, ...) were found, and they are "
                "taken as the contact forces; map the others with names={'column': 'tangential_force_x', ...}"
            )
        return refs

    def wall_step(self, ref: StepRef, options: ReadOptions) -> StepRef:
        """Return the contacts with walls of a step; each grain may touch each wall once."""
        return replace(ref, kind=_WALLS, rows=ref.rows * len(columns.wall_columns(ref, options)))

    def unread_forces(self, ref: StepRef, options: ReadOptions) -> str:
        """Return a hint about columns that may hold the rest of the contact forces; "" without such columns."""
        return "" if ref.kind == _WALLS else super().unread_forces(ref, options)

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """Names of the variables that `read_contacts` returns."""
        return list(columns.WALL_CONTACTS) if ref.kind == _WALLS else super().contact_variables(ref, options)

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the contacts of one step: those between grains, or those in columns of the grains."""
        if ref.kind == _WALLS:
            return columns.wall_contacts_from(ref, options, self.read_columns)
        return super().read_contacts(ref, options)

    def ignored_columns(self, ref: StepRef, options: ReadOptions, *, contacts: bool = False) -> list[str]:
        """Columns of a step that are not read."""
        if ref.kind == _WALLS:
            return []
        walls = () if contacts else columns.columns_of_walls(ref, options)
        return [name for name in super().ignored_columns(ref, options, contacts=contacts) if name not in walls]


def _vector(slot: str, first: int) -> dict[str, int]:
    return {f"{slot}_{axis}": first + k for k, axis in enumerate(COMPONENTS)}


# Positions give the normal, with other digits than the particles' where a pair crosses a periodic boundary. The flag
# of such pairs is not read: it misses some and marks others that do not cross.
_PAIR = {
    "contact_i": 6,
    "contact_j": 7,
    **_vector("end_i", 0),
    **_vector("end_j", 3),
    **_vector("contact_force", 9),
    "overlap": 12,
}
_WALL = {
    "contact_i": 8,
    "contact_j": 6,
    **_vector("contact_point", 0),
    **_vector("end_i", 3),
    **_vector("end_j", 0),
    **_vector("contact_force", 9),
    "overlap": 12,
}


class Liggghts(dump.Dumps):
    """Dumps of LIGGGHTS, whose axes of superquadrics are halves, where those of LAMMPS are whole."""

    PARTICLE_SLOTS: ClassVar[columns.Slots] = {
        **columns.PARTICLE_SLOTS,
        **{f"half_axis_{axis}": (f"shape{axis}",) for axis in COMPONENTS},
        **{f"whole_axis_{axis}": () for axis in COMPONENTS},
    }

    def recognises(self, path: str) -> bool:
        """Return whether the first lines identify a dump; local ones have numbered columns."""
        found = dump.body_columns(path)
        return found is not None and (found[0] == "ATOMS" or dump.is_numbered(found[1]))

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``pair/gran/local`` files."""
        refs = dump.index_dumps(paths, options, atoms=False)
        self.contact_columns(refs[0], options)
        return refs

    def index_walls(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``wall/gran/local`` files."""
        refs = [replace(ref, kind="wall") for ref in dump.index_dumps(paths, options, atoms=False)]
        self.contact_columns(refs[0], options)
        return refs

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the contacts of one step; mesh k is the partner -(k + 1)."""
        frame = super().read_contacts(ref, options)
        if ref.kind == "wall":
            frame["contact_j"] = -(frame["contact_j"] + 1)
        return frame

    def contact_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the columns that contacts are read from, by their place where they have numbers for names."""
        if not dump.is_numbered(ref.columns):
            return super().contact_columns(ref, options)
        layout = _WALL if ref.kind == "wall" else _PAIR
        slots: columns.Slots = dict.fromkeys(columns.CONTACT_SLOTS, ()) | {
            slot: ref.columns[at : at + 1] for slot, at in layout.items()
        }
        return columns.contact_columns(ref, slots, options)
