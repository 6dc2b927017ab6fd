"""LIGGGHTS text dumps: ``dump custom``, and ``dump local`` of ``pair/gran/local`` and ``wall/gran/local``.

Local columns have numbers instead of names (``c_3[1]``, ...). Two layouts need no ``names=``: ``id pos force``
(12 columns) and ``id pos force delta`` (13). Pairs are x1(3) x2(3) id1 id2 flag force(3) overlap; walls are
point(3) x(3) mesh triangle id force(3) overlap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from xcg.readers import dump
from xcg.readers.engine import ReadOptions, StepRef
from xcg.scene import COMPONENTS, Frame

OPTIONS = ("timestep",)


def _vector(slot: str, first: int) -> dict[str, int]:
    return {f"{slot}_{axis}": first + k for k, axis in enumerate(COMPONENTS)}


# Positions are left out: they are those of the particles. So is the flag of pairs across a periodic boundary,
# which misses some and marks one that does not cross.
_PAIR = {"contact_i": 6, "contact_j": 7, **_vector("contact_force", 9), "overlap": 12}
_WALL = {
    **_vector("contact_point", 0), "contact_j": 6, "contact_i": 8, **_vector("contact_force", 9), "overlap": 12,
}  # fmt: skip


def _slots(ref: StepRef) -> dump.Slots:
    layout: Mapping[str, int] = _WALL if ref.kind == "wall" else _PAIR
    if not dump.is_numbered(ref.columns):
        return dump.CONTACT_SLOTS
    numbered = {slot: ref.columns[at : at + 1] for slot, at in layout.items()}
    return {slot: numbered.get(slot, ()) for slot in dump.CONTACT_SLOTS}


def recognises(path: str) -> bool:
    """Tell dumps by their first lines, local ones by columns that have numbers instead of names."""
    found = dump.body_columns(path)
    return found is not None and (found[0] == "ATOMS" or dump.is_numbered(found[1]))


def index_particles(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``dump custom`` files."""
    return dump.index_dumps(paths, options, atoms=True)


def index_contacts(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``pair/gran/local`` files."""
    refs = dump.index_dumps(paths, options, atoms=False)
    contact_variables(refs[0], options)
    return refs


def index_walls(paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
    """List the steps of ``wall/gran/local`` files."""
    return [replace(ref, kind="wall") for ref in index_contacts(paths, options)]


def contact_variables(ref: StepRef, options: ReadOptions) -> tuple[str, ...]:
    """Names of the variables that `read_contacts` returns."""
    return dump.contact_names(dump.contact_slots(ref, _slots(ref), options))


def read_particles(ref: StepRef, options: ReadOptions) -> Frame:
    """Parse the particles of one step."""
    return dump.read_atoms(ref, options)


def read_contacts(ref: StepRef, options: ReadOptions) -> Frame:
    """Parse the contacts of one step; mesh k is the partner -(k + 1)."""
    frame = dump.contacts_from(ref, dump.contact_slots(ref, _slots(ref), options))
    if ref.kind == "wall":
        frame["contact_j"] = -(frame["contact_j"] + 1)
    return frame
