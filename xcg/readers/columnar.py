"""What engines share whose files are tables: `xcg.readers.columns` decides what their columns are in a scene."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

from numpy.typing import NDArray

from xcg.readers import columns
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files.table import read_table
from xcg.scene.schema import Frame


class Columnar(Engine):
    """An engine of files that hold columns of numbers; it lists their steps, and reads columns by name.

    Attributes
    ----------
    PARTICLE_SLOTS, CONTACT_SLOTS : mapping
        Columns that are taken for variables of the scene without ``names=``, see `xcg.readers.columns`.
    NEEDS_ID : bool
        Whether particles must have a column of ids; else the number of the row is the id where there is none.
    """

    PARTICLE_SLOTS: ClassVar[columns.Slots] = columns.PARTICLE_SLOTS
    CONTACT_SLOTS: ClassVar[columns.Slots] = columns.CONTACT_SLOTS
    NEEDS_ID: ClassVar[bool] = True

    def read_columns(
        self, ref: StepRef, wanted: Iterable[str], rows: int | None, options: ReadOptions
    ) -> dict[str, NDArray]:
        """Read columns (rows,) of one step by their names in the file; texts of numbers between blanks by default."""
        return read_table(ref, wanted, rows, options)

    def particle_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the columns that particles are read from."""
        slots = self.PARTICLE_SLOTS
        if not self.NEEDS_ID and "particle_id" not in columns.assign(ref, slots, options):
            slots = {slot: found for slot, found in slots.items() if slot != "particle_id"}
        return columns.particle_columns(ref, slots, options)

    def contact_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
        """Find the columns that contacts are read from."""
        return columns.contact_columns(ref, self.CONTACT_SLOTS, options)

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """Names of the variables that `read_contacts` returns."""
        return columns.contact_names(self.contact_columns(ref, options))

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the particles of one step."""
        return columns.particles_from(ref, self.particle_columns(ref, options), options, self.read_columns)

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the contacts of one step."""
        return columns.contacts_from(ref, self.contact_columns(ref, options), options, self.read_columns)

    def ignored_columns(self, ref: StepRef, options: ReadOptions, *, contacts: bool = False) -> list[str]:
        """Columns of a step that are not read."""
        read = self.contact_columns(ref, options) if contacts else self.particle_columns(ref, options)
        return [column for column in ref.columns if column not in read.values()]
