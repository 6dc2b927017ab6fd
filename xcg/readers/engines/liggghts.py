"""LIGGGHTS text dumps: ``dump custom``, and ``dump local`` of ``pair/gran/local`` and ``wall/gran/local``.

Local columns have numbers instead of names (``c_3[1]``, ...). Two layouts need no ``names=``: those of
``id pos force`` (12 columns) and ``id pos delta force`` (13). Pairs are x1(3) x2(3) id1 id2 flag force(3) overlap;
walls are point(3) x(3) mesh triangle id force(3) overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from xcg.readers import columns
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines import dump
from xcg.scene.schema import COMPONENTS, Frame


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
    """Dumps of LIGGGHTS."""

    def recognises(self, path: str) -> bool:
        """Tell dumps by their first lines, local ones by columns that have numbers instead of names."""
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
