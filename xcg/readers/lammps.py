"""LAMMPS text dumps: ``dump custom`` for particles, ``dump local`` for contacts, plain or gzipped."""

from __future__ import annotations

from collections.abc import Sequence

from xcg.readers import columns, dump
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.text import source_of
from xcg.scene.schema import Frame
from xcg.scene.warn import warn_user

OPTIONS = ("timestep",)


def recognises(path: str) -> bool:
    """Tell LAMMPS dumps by their first lines, apart from those that only LIGGGHTS writes."""
    found = dump.body_columns(path)
    return found is not None and ".liggghts" not in path and not dump.is_numbered(found[1])


def index_particles(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``dump custom`` files."""
    refs = dump.index_dumps(paths, options, atoms=True)
    columns.warn_of_ignored(refs[0], _particle_columns(refs[0], options), columns.PARTICLE_SLOTS, options)
    return refs


def index_contacts(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``dump local`` files."""
    refs = dump.index_dumps(paths, options, atoms=False)
    found = _contact_columns(refs[0], options)
    columns.warn_of_ignored(refs[0], found, columns.CONTACT_SLOTS, options)
    if "normal_force_x" in found and "tangential_force_x" not in found:
        msg = (
            f"{source_of(refs[0])}: only normal forces ({found['normal_force_x']}, ...) were found, and they are "
            "taken as the contact forces; map the others with names={'column': 'tangential_force_x', ...}"
        )
        warn_user(msg)
    return refs


def contact_variables(ref: StepRef, options: ReadOptions) -> list[str]:
    """Names of the variables that `read_contacts` returns."""
    return columns.contact_names(_contact_columns(ref, options))


def read_particles(ref: StepRef, options: ReadOptions) -> Frame:
    """Parse the particles of one step."""
    return columns.particles_from(ref, _particle_columns(ref, options))


def read_contacts(ref: StepRef, options: ReadOptions) -> Frame:
    """Parse the contacts of one step."""
    return columns.contacts_from(ref, _contact_columns(ref, options))


def _particle_columns(ref: StepRef, options: ReadOptions) -> dict[str, str]:
    return columns.particle_columns(ref, columns.PARTICLE_SLOTS, options)


def _contact_columns(ref: StepRef, options: ReadOptions) -> dict[str, str]:
    return columns.contact_columns(ref, columns.CONTACT_SLOTS, options)
