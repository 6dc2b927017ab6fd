"""LAMMPS text dumps: ``dump custom`` for particles, ``dump local`` for contacts, plain or gzipped."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from xcg.readers import dump
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.text import where
from xcg.scene import Frame, SceneWarning

OPTIONS = ("timestep",)


def recognises(path: str) -> bool:
    """Tell LAMMPS dumps by their first lines, apart from those that only LIGGGHTS writes."""
    found = dump.body_columns(path)
    return found is not None and ".liggghts" not in path and not dump.is_numbered(found[1])


def index_particles(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``dump custom`` files."""
    return dump.index_dumps(paths, options, atoms=True)


def index_contacts(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``dump local`` files."""
    refs = dump.index_dumps(paths, options, atoms=False)
    if refs:
        filled = dump.contact_slots(refs[0], dump.CONTACT_SLOTS, options)
        if "normal_force_x" in filled and "tangential_force_x" not in filled:
            msg = (
                f"{where(refs[0])}: only normal forces were found ({filled['normal_force_x']}, ...), and they are "
                "taken as the contact forces; map tangential ones with names={'column': 'tangential_force_x', ...}"
            )
            warnings.warn(msg, SceneWarning, stacklevel=3)
    return refs


def contact_variables(ref: StepRef, options: ReadOptions) -> tuple[str, ...]:
    """Names of the variables that `read_contacts` returns."""
    return dump.contact_names(dump.contact_slots(ref, dump.CONTACT_SLOTS, options))


def read_particles(ref: StepRef, options: ReadOptions) -> Frame:
    """Parse the particles of one step."""
    return dump.read_atoms(ref, options)


def read_contacts(ref: StepRef, options: ReadOptions) -> Frame:
    """Parse the contacts of one step."""
    return dump.contacts_from(ref, dump.contact_slots(ref, dump.CONTACT_SLOTS, options))
