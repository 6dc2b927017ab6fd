"""YADE: text by scripts of its users (docs/other_codes.md has one) and by ``yade.export``.

Lines of comments come first. One names the columns; ``fn(3)`` means three columns. One may hold the
time, the number of the step and the cell: ``# time 0.5 step 1000 cell h00 h01 ... h22``, whose
columns are the vectors to the next images. Others are comments. Positions are not wrapped. The
forces that YADE keeps act on the second body of a contact.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from itertools import chain, takewhile
from typing import Any, ClassVar

import numpy as np

from xcg.common.messages import SceneError
from xcg.readers import names
from xcg.readers.cells import box_of_cell
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.text import check_rows, first_lines, scanned
from xcg.readers.paths import index_steps
from xcg.scene.schema import COMPONENTS

_MOST_COMMENTS = 1000
_LONGEST_ROW = 1 << 14  # bytes

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_PARTS_OF_FORCES = ("fn", "fs", "normal", "shear")
_WORDS = {"time": 1, "step": 1, "cell": 9}  # of comments, and how many numbers follow


class Yade(Columnar):
    """Text of YADE."""

    NEEDS_ID = False
    PARTICLE_SLOTS: ClassVar[names.Slots] = names.slots_of(names.PARTICLES, "yade")
    CONTACT_SLOTS: ClassVar[names.Slots] = names.slots_of(names.CONTACTS, "yade")

    def recognises(self, path: str) -> bool:
        """Return whether the comments above the rows hold a format, time or columns in YADE's words.

        Contacts with one force, `fx`, are those of a table: the force acts on the first body.
        """
        lines = first_lines(path)
        comments = [line.lstrip("#").split() for line in takewhile(_is_comment, lines)]
        if "," in "".join(lines[len(comments) :][:1]):  # CSV
            return False
        for words in comments:
            if {"id1", "id2"} <= {*words}:
                return any(word.startswith(_PARTS_OF_FORCES) for word in words)
        return any(map(_is_of_spheres, comments))

    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps of particles or contacts, one a file."""
        return index_steps(paths, "yade", _steps)


def _is_comment(line: str) -> bool:
    return line.startswith("#")


def _is_of_spheres(words: Sequence[str]) -> bool:
    """Return whether a comment is a format, a time, or names the columns of spheres of one step."""
    if words[:1] == ["time"] and _NUMBER.fullmatch(" ".join(words[1:2])):
        return True
    named = {*words}
    return words[:1] == ["format"] or (
        named >= {"id", "x", "y", "z", "r"} and not named & {"time", "t", "step"}
    )


_NAMES_READ = {*chain(*Yade.PARTICLE_SLOTS.values(), *Yade.CONTACT_SLOTS.values())}


def _steps(path: str) -> Iterator[StepRef]:
    """Return the step of a file, from its comments, and count its rows."""
    facts: dict[str, Any] = {"step": -1}
    comments: list[list[str]] = []
    with scanned(path) as scanner:
        for _ in range(_MOST_COMMENTS):
            if scanner.sample(1) != b"#":
                break
            words = scanner.line().decode("utf-8", "replace").lstrip("#").split()
            if words[:1] == ["time"]:
                facts = {"step": -1} | _facts(words, path)
            elif words:
                comments.append(words)
        values = len(scanner.sample(_LONGEST_ROW).partition(b"\n")[0].split())
        columns = _columns(comments, values, path)
        start = scanner.offset
        rows = 0
        last = b"\n"
        for piece in filter(None, scanner.until(b"#")):
            rows = rows + piece.count(b"\n")
            last = piece
        rows += not last.endswith(b"\n")
        length = scanner.offset - start
        if scanner.line():
            raise SceneError(
                f"{path}: a comment between rows at byte {scanner.offset}; expected one step a file"
            )
    ref = StepRef(path, rows, columns=columns, offset=start, length=length, **facts)
    check_rows(ref, length)
    yield ref


def _columns(comments: Sequence[Sequence[str]], values: int, path: str) -> tuple[str, ...]:
    """Return the names of the columns, from the format or from the comment with most names of variables.

    It has as many names as the first row has values (0 without rows).
    """
    formats = [words for words in comments if words[0] == "format"]
    lines = [_names(words, values) for words in formats or comments]
    fitting = [
        columns
        for columns in lines
        if len(set(columns)) == len(columns) and (not values or len(columns) == values)
    ]
    if not fitting:
        listed = "; ".join(" ".join(words)[:60] for words in comments) or "none"
        raise SceneError(
            f"{path}: expected a comment that names each column once, such as '# id x y z r', one for each of the "
            f"{values} values of the first row, found {listed}"
        )
    return max(
        reversed(fitting), key=lambda columns: len(_NAMES_READ & set(map(names.canonical, columns)))
    )


def _names(words: Sequence[str], values: int) -> tuple[str, ...]:
    """Names of columns, one for each component; attributes of the caller's own fill a row of so many values."""
    if words[0] == "format":  # yade.export.text
        words = [name for text in words[1:2] for name in text.split("_")]
        if words[-1:] == ["attrs"]:
            count = values - len(words) + 1
            words = [*words[:-1], *(f"attribute_{k + 1}" for k in range(count))]
    columns: list[str] = []
    for word in words:
        vector = re.fullmatch(r"(\w+)\((\d)\)", word)
        if vector is None:
            columns.append(word)
            continue
        ends = [f"[{k + 1}]" for k in range(int(vector[2]))]
        if len(ends) == len(COMPONENTS):
            ends = list(COMPONENTS)
        columns += [vector[1] + end for end in ends]
    return tuple(columns)


def _facts(words: Sequence[str], path: str) -> dict[str, Any]:
    """Time, step and cell of a comment, by the names of `StepRef`."""
    numbers: dict[str, list[float]] = {}
    facts: dict[str, Any] = {}
    try:
        for name, count in _WORDS.items():
            if name in words:
                at = words.index(name) + 1
                numbers[name] = [float(word) for word in words[at : at + count]]
                if len(numbers[name]) != count or not all(map(math.isfinite, numbers[name])):
                    raise ValueError
        if "step" in numbers:
            facts["step"] = int(words[words.index("step") + 1])
            if not 0 <= facts["step"] < 2**63:
                raise ValueError
    except (ValueError, OverflowError):
        raise SceneError(
            f"{path}: {' '.join(words)[:80]!r}: expected '# time 0.5 step 1000 cell' and nine numbers, row by row"
        ) from None
    (facts["time"],) = numbers["time"]
    if "cell" in numbers:
        vectors = np.reshape(numbers["cell"], (3, 3)).T
        facts |= box_of_cell(vectors, np.zeros(3), "xyz", path)
    return facts
