"""Dumps of LIGGGHTS. Columns of contacts have the order of the words of their compute.

``compute pair/gran/local`` and ``wall/gran/local`` write the values of the words that they are
given, whatever the order of these, in the order of `WORDS`. The columns have numbers for names
(``c_cpl[1] c_cpl[2] ...``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, unknown
from xcg.readers import names
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines.lammps import Dumps, body_columns, is_numbered, without_index
from xcg.readers.files.text import body_of, source_of
from xcg.scene.schema import COMPONENTS, Frame

# Columns of each word, in their order. The history has as many as the contact model needs (0 here).
WORDS = {
    "pos": 6,
    "vel": 6,
    "id": 3,
    "force": 3,
    "force_normal": 3,
    "force_tangential": 3,
    "torque": 3,
    "torque_normal": 3,
    "torque_tangential": 3,
    "history": 0,
    "contactArea": 1,
    "delta": 1,
    "contactPoint": 3,
    "ms_id": 2,
    "heatFlux": 1,
}
# Words that are guessed from the number of columns: those of LIGGGHTS without words, and the usual
# ones.
_DEFAULT = ("pos", "vel", "id", "force", "torque", "history", "contactArea")
_USUAL = {12: ("pos", "id", "force"), 13: ("pos", "id", "force", "delta")}
_FEWEST_OF_DEFAULT = 23
_SAMPLE = 100  # rows that a guess is checked with
# Cosines that half of the contacts exceed, for any coefficient of friction below 1.7.
_ALONG = 0.5  # of force and normal
_PARALLEL = 0.9  # of the torque and normal x force


class Liggghts(Dumps):
    """Dumps of LIGGGHTS, which hold half-axes of superquadrics where LAMMPS writes whole axes."""

    MORE_DIGITS = 'dump_modify ... format "%.10g %.10g ...", with one %.10g for each column'
    PARTICLE_SLOTS: ClassVar[names.Slots] = names.slots_of(names.PARTICLES, "liggghts")
    WHOLE_FORCES = "have LIGGGHTS write the word 'force'"

    def recognises(self, path: str) -> bool:
        """Return whether the first lines identify a dump; LAMMPS comes first."""
        return body_columns(path) is not None

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``pair/gran/local`` files."""
        return self._checked(self.list_steps(paths, options, contacts=True), options)

    def index_walls(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps of ``wall/gran/local`` files."""
        refs = [replace(ref, kind="wall") for ref in self.list_steps(paths, options, contacts=True)]
        return self._checked(refs, options)

    def _checked(self, refs: list[StepRef], options: ReadOptions) -> list[StepRef]:
        """Check the columns of the first step, and guessed words with some of its rows."""
        first = next((ref for ref in refs if ref.rows), refs[0])
        self.contact_columns(first, options)
        guess = _guess(first, options)
        if guess and not _words_of(first, options):
            _check_guess(first, guess)
        return refs

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the contacts of one step; mesh k is the partner -(k + 1)."""
        frame = super().read_contacts(ref, options)
        if ref.kind == "wall":
            frame["contact_j"] = -(frame["contact_j"] + 1)
        return frame

    def contact_slots(self, ref: StepRef, options: ReadOptions) -> names.Slots:
        """Return the columns that fill each slot, by the words of their compute."""
        words = _words_of(ref, options) or _guess(ref, options)
        if words:
            return dict.fromkeys(self.CONTACT_SLOTS, ()) | _slots_of(ref, words)
        if is_numbered(ref.columns) and "contact_i" not in options.names.values():
            raise SceneError(
                f"{source_of(ref)}: {len(ref.columns)} columns with numbers for names, and which words the compute was "
                f"given is not known; {_way_out(ref)}"
            )
        return self.CONTACT_SLOTS


def _words_of(ref: StepRef, options: ReadOptions) -> tuple[str, ...]:
    """Return the words that the caller gives for a kind of file."""
    kind = "walls" if ref.kind == "wall" else "contacts"
    return tuple(filter(None, options.listed.get(kind, ())))


def _guess(ref: StepRef, options: ReadOptions) -> tuple[str, ...]:
    """Return the words that the number of columns suggests, unless the caller maps columns; () without a guess."""
    if not is_numbered(ref.columns) or "contact_i" in options.names.values():
        return ()
    count = len(without_index(ref.columns))
    if count >= _FEWEST_OF_DEFAULT:
        return _DEFAULT
    return _USUAL.get(count, ())


def _first_columns(ref: StepRef, words: Sequence[str]) -> dict[str, int]:
    """Return the index of the first column of each word.

    Raises
    ------
    SceneError
        If a word is not known, or they do not have as many columns as the file.
    """
    spelt = {word.casefold(): word for word in WORDS}
    wrong = [word for word in words if word.casefold() not in spelt]
    if wrong:
        raise SceneError(f"names={' '.join(words)!r}: {unknown('word', wrong[0], WORDS)}")
    meant = {spelt[word.casefold()] for word in words}
    columns = sum(WORDS[word] for word in meant)
    count = len(without_index(ref.columns))
    history = count - columns
    if history < 0 or (history > 0) != ("history" in meant):
        promised = f"{columns} columns"
        if "history" in meant:
            promised += " and at least one of the history"
        raise SceneError(
            f"{source_of(ref)}: the words {' '.join(words)!r} have {promised}, but the "
            f"file has {count}; {_way_out(ref)}"
        )
    first_columns: dict[str, int] = {}
    column = 0
    for word, count in (WORDS | {"history": history}).items():
        if word in meant:
            first_columns[word] = column
            column += count
    return first_columns


def _slots_of(ref: StepRef, words: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the column of each slot of a contact."""
    first_columns = _first_columns(ref, words)
    if "id" not in first_columns or not {"force", "force_normal"} & set(first_columns):
        raise SceneError(
            f"{source_of(ref)}: the words {' '.join(words)!r} lack 'id' or 'force', which contacts need; have LIGGGHTS "
            "write both"
        )
    # Positions give the normal, with other digits than the particles' where a pair crosses a
    # periodic boundary. The flag of such pairs is not read: it misses some and marks others that do
    # not cross.
    numbers = {"contact_i": ("id", 0), "contact_j": ("id", 1), "overlap": ("delta", 0)}
    vectors = {
        "end_i": ("pos", 0),
        "end_j": ("pos", 3),
        "contact_point": ("contactPoint", 0),
        "contact_force": ("force", 0),
        "normal_force": ("force_normal", 0),
        "tangential_force": ("force_tangential", 0),
    }
    if ref.kind == "wall":
        numbers |= {"contact_i": ("id", 2), "contact_j": ("id", 0)}
        vectors |= {"end_i": ("pos", 3), "end_j": ("pos", 0)}
        vectors["contact_point"] = ("pos", 0)  # LIGGGHTS does not fill contactPoint at walls
    for slot, (word, offset) in vectors.items():
        for k, axis in enumerate(COMPONENTS):
            numbers[f"{slot}_{axis}"] = (word, offset + k)
    return {
        slot: (without_index(ref.columns)[first_columns[word] + offset],)
        for slot, (word, offset) in numbers.items()
        if word in first_columns
    }


def _way_out(ref: StepRef) -> str:
    """Return what to do about columns of unknown words."""
    compute = "wall/gran/local" if ref.kind == "wall" else "pair/gran/local"
    return (
        f"give the words of 'compute {compute}' in the input script, for example names='pos id force history "
        f"contactArea delta' (docs/other_codes.md; known are {' '.join(WORDS)})"
    )


# --- checks of guessed words -----------------------------------------------------------------------------


def _check_guess(ref: StepRef, words: Sequence[str]) -> None:
    """Raise SceneError if the first rows do not fit guessed words: ids, and directions of forces and torques."""
    first_columns = _first_columns(ref, words)
    rows = _first_rows(ref)
    if not len(rows):
        return
    ids = rows[:, first_columns["id"] :][:, :3]
    # a pair has two ids and a flag; a contact with a wall has mesh, triangle and id
    limits = (0, 0, 1) if ref.kind == "wall" else (1, 1, 0)
    fits = bool((ids == np.rint(ids)).all() and (ids >= limits).all())
    if ref.kind != "wall":
        fits = fits and bool((ids[:, 2] <= 1).all())
        crosses = ids[:, 2] != 0
        rows = rows[~crosses]
    ends = rows[:, first_columns["pos"] :][:, :6]
    normal = ends[:, :3] - ends[:, 3:]
    forces = _cosines(rows[:, first_columns["force"] :][:, :3], normal)
    fits = fits and not (len(forces) and np.median(forces) < _ALONG)
    if "torque" in first_columns:  # many words have as many columns; without torques, none is sure
        moments = np.cross(normal, rows[:, first_columns["force"] :][:, :3])
        torques = _cosines(rows[:, first_columns["torque"] :][:, :3], moments)
        fits = fits and len(torques) > 0 and np.median(torques) > _PARALLEL
    if not fits:
        raise SceneError(
            f"{source_of(ref)}: {len(ref.columns)} columns suggest the words {' '.join(words)!r}, but ids are not "
            f"whole numbers there, or forces and torques do not fit the line between both positions; {_way_out(ref)}"
        )


def _cosines(vectors: NDArray, directions: NDArray) -> NDArray:
    """Return absolute cosines of the angles between vectors (n, 3); zero vectors are left out."""
    lengths = np.linalg.norm(vectors, axis=1) * np.linalg.norm(directions, axis=1)
    positive = lengths > 0
    return np.abs((vectors * directions).sum(axis=1)[positive]) / lengths[positive]


def _first_rows(ref: StepRef) -> NDArray:
    """Return the first rows (n, columns) of a step; none if they are no numbers, which reading them says."""
    lines = next(iter(body_of(ref)), b"").split(b"\n")[: ref.rows][:_SAMPLE]
    rows = map(bytes.split, lines)
    whole = [row for row in rows if len(row) == len(ref.columns)]
    try:
        values = np.array(whole, float)
    except ValueError:
        values = np.empty((0, len(ref.columns)))
    return values[..., len(ref.columns) - len(without_index(ref.columns)) :]
