"""Report on the columns of an input: read, not needed, or not understood.

Not understood are columns that resemble a variable which is not read, carry its unit, or are a
second column of one that is. One warning a file lists them; all others that are not read are in the
attribute `not_read` alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain

from xcg.common.messages import SceneError, printable, warn_user
from xcg.readers.assigned import lacks, magnitudes_among
from xcg.readers.column_units import unit_of
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.readers.files.vtkheader import OF_CELLS
from xcg.readers.likely_names import resembling, vectors_among
from xcg.readers.named_columns import factor_of, has_other_unit, vector_of
from xcg.readers.names import ALL_SLOTS, CONTACT_SLOTS, PARTICLE_SLOTS, canonical
from xcg.readers.wall_columns import WALL_ARRAY
from xcg.scene.schema import COMPONENTS

_SUSPECT = re.compile("wall|force", re.IGNORECASE)
_ON_GRAINS = re.compile("(total|net)?forces?[xyz]|[xyz](total|net)?forces?")  # all that acts on one


@dataclass(frozen=True)
class Report:
    """Columns of one kind of file.

    Attributes
    ----------
    source : str
        File and step, for messages.
    contacts : bool
        Whether the file holds contacts.
    read : mapping
        Variable, slot or use of each column that is read.
    dropped : frozenset of str
        Columns that the caller drops.
    unread : tuple of str
        The other columns.
    whole_vectors : bool
        Whether vectors are one column each.
    whole_forces : str
        What to do where only normal forces are found.
    """

    source: str
    contacts: bool
    read: Mapping[str, str]
    dropped: frozenset[str]
    unread: tuple[str, ...]
    whole_vectors: bool = False
    whole_forces: str = ""

    @classmethod
    def of(
        cls,
        engine: Engine,
        ref: StepRef,
        options: ReadOptions,
        *,
        contacts: bool,
        arguments: Iterable[str] = (),
    ) -> Report | None:
        """Return the report on a step; None where the engine does not say what it reads.

        `arguments`: variables that the caller gives as arguments.
        """
        read = engine.columns_read(ref, options, contacts=contacts)
        if read is None:
            return None
        read |= {f"{name}=": name for name in arguments}
        dropped = frozenset(name for name, target in options.names.items() if target is None)
        unread = [name for name in ref.columns if name not in read and name not in dropped]
        return cls(
            source_of(ref),
            contacts,
            read,
            dropped,
            tuple(unread),
            engine.WHOLE_VECTORS,
            engine.WHOLE_FORCES,
        )

    @property
    def not_read(self) -> tuple[str, ...]:
        """Columns that are not read, in the order of the file."""
        return (*self.dropped, *self.unread)

    def warn(self) -> None:
        """Warn once of all columns that are not understood, with the likely reading and a call that works."""
        sentences = [
            *self._wall_arrays(),
            self._forces(),
            *self._second_columns(),
            self._resembling(),
            self._only_normal(),
        ]
        text = "; ".join(filter(None, sentences))
        if text:
            warn_user(f"{self.source}: {text}")

    def _slots(self) -> Mapping[str, str]:
        """Return the slot of each alias."""
        slots = CONTACT_SLOTS if self.contacts else PARTICLE_SLOTS
        return {alias: slot for slot, aliases in slots.items() for alias in aliases}

    def _arrays_of_walls(self) -> dict[str, list[str]]:
        """Return the columns of arrays of contacts with walls (LAMMPS), by the name of the array."""
        if self.contacts:
            return {}
        arrays = {}
        for array in sorted({name.partition("[")[0] for name in self.unread}):
            names = [f"{array}[{k}]" for k in range(1, WALL_ARRAY + 1)]
            if array.startswith("f_") and {*names} <= {*self.unread}:
                arrays[array] = names
        return arrays

    def _wall_arrays(self) -> list[str]:
        """Name arrays of contacts with walls, and the argument that reads them."""
        return [
            f"columns {array}[1] to {array}[{WALL_ARRAY}] look like contacts with a wall (fix wall/gran ... contacts) "
            f"and are not read; give the wall a name, walls={{'side': '{array}[*]'}}, or drop them by "
            f"names={{'{array}[1]': None, ...}}"
            for array in self._arrays_of_walls()
        ]

    def _suspects(self) -> list[str]:
        """Return columns with "wall" or "force" in their names, that are no part of a vector of the file."""
        harmless = {*chain(*self._arrays_of_walls().values())}
        if self.contacts:  # the length of a vector that is read
            harmless |= {*magnitudes_among(self.unread, {}).values()}
        aliases = self._slots()
        slots_of_file = {aliases.get(canonical(name)) for name in (*self.read, *self.unread)}
        suspects = []
        for name in filter(_SUSPECT.search, self.unread):
            slot = aliases.get(canonical(name), "")
            of_vector = {f"{slot[:-2]}_{axis}" for axis in COMPONENTS}
            if not self.contacts and _ON_GRAINS.fullmatch(canonical(name)):
                continue
            if name not in harmless and not of_vector <= slots_of_file:
                suspects.append(name)
        return suspects

    def _forces(self) -> str:
        """Name columns that look like forces or contacts with walls; "" without such columns."""
        suspects = self._suspects()
        if self.whole_vectors or not suspects:
            return ""
        if self.contacts:
            slots = {*self.read.values()}
            is_other_part = "normal_force_x" in slots and "tangential_force_x" not in slots
            vector = "tangential_force" if is_other_part else "contact_force"
            example = self._mapped(suspects, vector)
            example = example or f", for example names={{{suspects[0]!r}: '{vector}_x'}}"
        else:
            target = "my_" + re.sub(r"\W+", "_", suspects[0]).strip("_").lower()
            example = f", for example names={{{suspects[0]!r}: {target!r}}}"
        return (
            f"columns {' '.join(suspects)} look like forces or contacts with walls and are not read; map "
            f"them{example}, or drop them by names={{{suspects[0]!r}: None}}. Contacts with walls are rows of "
            "the files of contacts (contacts=, walls=), with the grain as contact_i"
        )

    @staticmethod
    def _mapped(columns: Iterable[str], vector: str) -> str:
        """Return the mapping of the first vector among columns, as the middle of a message; "" without one."""
        for _, parts in vectors_among(columns):
            mapping = {column: f"{vector}_{axis}" for axis, column in parts.items()}
            return f", for example names={mapping}"
        return ""

    def _second_columns(self) -> list[str]:
        """Name columns that are called as a variable that another one fills."""
        sentences: list[str] = []
        if self.whole_vectors:
            return sentences
        aliases = self._slots()
        filled = {slot: column for column, slot in self.read.items()}
        for name in self.unread:
            slot = aliases.get(canonical(name))
            if slot in filled:
                sentences.append(
                    f"both {filled[slot]!r} and {name!r} may be {slot!r}, and {filled[slot]!r} is read; drop one of "
                    f"them, names={{{name!r}: None}}"
                )
        return sentences

    def likely(self) -> dict[str, str]:
        """Return the variable that each column which is not read resembles."""
        reported = {*self._suspects(), *chain(*self._arrays_of_walls().values())}
        others = [n for n in self.unread if n not in reported and not n.endswith(OF_CELLS)]
        return resembling(others, self.read.values(), contacts=self.contacts)

    def _resembling(self) -> str:
        """Name columns that resemble variables; "" without such columns."""
        likely = self.likely()
        if not likely:
            return ""
        listed = ", ".join(f"{name!r} ({variable_name}?)" for name, variable_name in likely.items())
        example = ""
        column, meant = next(iter(likely.items()))
        if self.whole_vectors or f"{meant}_x" not in ALL_SLOTS:
            example = f", for example names={{{column!r}: {meant!r}}}"
        else:
            alike = [name for name, variable_name in likely.items() if variable_name == meant]
            example = self._mapped(alike, meant)
        doubt = ""
        if any(canonical(name) == "tx" for name in likely):
            doubt = " (tx may also be a torque or a direction)"
        if "momentum" in listed or "momenta" in listed:
            doubt = " (momenta are no velocities: divide them by the masses)"
        return (
            f"columns {listed} resemble variables and are not read{doubt}; map them{example}, or drop them by "
            f"names={{{next(iter(likely))!r}: None}}"
        )

    def _only_normal(self) -> str:
        """Name normal forces that are read as the whole contact forces; "" where others may add to them."""
        columns = {slot.removesuffix("_x"): column for column, slot in self.read.items()}
        others = {"contact_force", "tangential_force"}
        is_part = "normal_force" in columns and not others & columns.keys()
        has_tangential = "tangential_force" in self.likely().values()
        if not (self.contacts and self.whole_forces and is_part) or has_tangential:
            return ""
        return (
            f"only normal forces ({columns['normal_force']}, ...) were found, and are taken as the contact forces; "
            f"{self.whole_forces}"
        )

    def warn_of_unknown_units(self) -> None:
        """Warn of columns that are read, and whose names hold no unit of their variable, or only some of a vector."""
        columns = [name for name, slot in self.read.items() if has_other_unit(name, slot)]
        if columns:
            warn_user(
                f"{self.source}: columns {', '.join(map(repr, columns))} name a unit that is not known or not one of "
                "the variable, and SI is taken; give the factors to SI, such as units={'length': 1e-3} for mm, or "
                "units='SI'"
            )
        without = {vector_of(slot) for name, slot in self.read.items() if unit_of(name) is None}
        mixed = [
            name
            for name, slot in self.read.items()
            if factor_of(name, slot) != 1 and vector_of(slot) in without
        ]
        if mixed:
            warn_user(
                f"{self.source}: columns {', '.join(map(repr, mixed))} name a unit, and other components of their "
                "vectors do not and are read as SI; name it for all, or give the factors to SI, units={'length': ...}"
            )


def warn_of_columns(
    engine: Engine,
    ref: StepRef,
    options: ReadOptions,
    *,
    contacts: bool,
    arguments: Iterable[str] = (),
) -> None:
    """Warn of what is not understood in the header of a step: its columns, and other words."""
    report = Report.of(engine, ref, options, contacts=contacts, arguments=arguments)
    if report is not None:
        if "volume" in report.read.values() and not contacts:
            sizes = [
                name for name, meant in report.likely().items() if meant in ("radius", "diameter")
            ]
            explained = engine.explained(ref, options, sizes)
            unread = tuple(name for name in report.unread if name not in explained)
            report = replace(report, unread=unread)
        report.warn()
        if "units" not in options.given:
            report.warn_of_unknown_units()
    for words, way_out in () if contacts else ref.unknown:
        if way_out.partition("=")[0] not in options.given:
            warn_user(f"{source_of(ref)}: {words} is not understood; say {way_out}")


def list_not_read(
    engine: Engine, refs: Mapping[str, Iterable[StepRef]], options: ReadOptions
) -> str:
    """List the columns that are not read, a line a kind of file, for the attribute `not_read`."""
    lines = []
    for kind, listed in refs.items():
        names: dict[str, None] = {}
        for ref in listed:
            report = Report.of(engine, ref, options.of_kind(kind), contacts=kind == "contacts")
            if report is not None:
                unread = [name for name in ref.columns if name in report.not_read]
                names |= dict.fromkeys(unread)
        if names:
            lines.append(f"{kind}: {', '.join(names)}")
    return printable("\n".join(lines))


# --- what follows from columns that are missing ----------------------------------------------------


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


def check_plane(
    engine: Engine, particles: StepRef, contacts: StepRef, options: ReadOptions, dimension: int
) -> None:
    """Raise SceneError for contacts in a plane, whose forces lack an axis, beside particles that are not.

    Engines name the columns of both.
    """
    of_particles = engine.columns_read(particles, options.of_kind("particles"), contacts=False)
    of_contacts = engine.columns_read(contacts, options.of_kind("contacts"), contacts=True)
    forces = {
        slot[-1]
        for slot in (of_contacts or {}).values()
        if slot[:-2] in ("contact_force", "normal_force")
    }
    for axis in {*COMPONENTS} - forces if forces and dimension == len(COMPONENTS) else ():
        if f"position_{axis}" in (of_particles or {}).values():
            error = lacks(contacts, f"{axis} of the contact force", f"contact_force_{axis}")
            raise SceneError(f"{error}; if all is in one plane, say dimension=2")


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
