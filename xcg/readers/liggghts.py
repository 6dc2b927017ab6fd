"""LIGGGHTS text dumps: ``dump custom``, and ``dump local`` of ``pair/gran/local`` and ``wall/gran/local``.

Local columns have numbers instead of names (``c_3[1]``, ...). Two layouts need no ``names=``: those of
``id pos force`` (12 columns) and ``id pos delta force`` (13). Pairs are x1(3) x2(3) id1 id2 flag force(3) overlap;
walls are point(3) x(3) mesh triangle id force(3) overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from xcg.readers import columns, dump
from xcg.readers.engine import ReadOptions, StepRef
from xcg.scene.schema import COMPONENTS, Frame

OPTIONS = ("timestep",)


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


def recognises(path: str) -> bool:
    """Tell dumps by their first lines, local ones by columns that have numbers instead of names."""
    found = dump.body_columns(path)
    return found is not None and (found[0] == "ATOMS" or dump.is_numbered(found[1]))


def index_particles(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``dump custom`` files."""
    refs = dump.index_dumps(paths, options, atoms=True)
    columns.warn_of_ignored(refs[0], _particle_columns(refs[0], options), columns.PARTICLE_SLOTS, options)
    return refs


def index_contacts(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``pair/gran/local`` files."""
    refs = dump.index_dumps(paths, options, atoms=False)
    _contact_columns(refs[0], options)
    return refs


def index_walls(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``wall/gran/local`` files."""
    refs = [replace(ref, kind="wall") for ref in dump.index_dumps(paths, options, atoms=False)]
    _contact_columns(refs[0], options)
    return refs


def contact_variables(ref: StepRef, options: ReadOptions) -> list[str]:
    """Names of the variables that `read_contacts` returns."""
    return columns.contact_names(_contact_columns(ref, options))


def read_particles(ref: StepRef, options: ReadOptions) -> Frame:
    """Parse the particles of one step."""
    return columns.particles_from(ref, _particle_columns(ref, options))


def read_contacts(ref: StepRef, options: ReadOptions) -> Frame:
    """Parse the contacts of one step; mesh k is the partner -(k + 1)."""
    frame = columns.contacts_from(ref, _contact_columns(ref, options))
    if ref.kind == "wall":
        frame["contact_j"] = -(frame["contact_j"] + 1)
    return frame


def _particle_columns(ref: StepRef, options: ReadOptions) -> dict[str, str]:
    return columns.particle_columns(ref, columns.PARTICLE_SLOTS, options)


def _contact_columns(ref: StepRef, options: ReadOptions) -> dict[str, str]:
    slots: columns.Slots = columns.CONTACT_SLOTS
    if dump.is_numbered(ref.columns):
        layout = _WALL if ref.kind == "wall" else _PAIR
        slots = dict.fromkeys(slots, ()) | {slot: ref.columns[at : at + 1] for slot, at in layout.items()}
    return columns.contact_columns(ref, slots, options)
