"""MercuryDPM: ``.data`` (particles), ``.fstat`` (contacts), and the head of ``.restart`` (density, gravity).

Particles are numbered by their row in ``.data``, from 0, as ``.fstat`` does. A pair is listed in ``.fstat`` once
or twice; of two rows, the one with i < j is read, as the other has fewer digits.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.readers import names
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.files.table import parse_table, read_table
from xcg.readers.files.text import Scanner, check_rows, first_lines, scanned, source_of
from xcg.readers.paths import index_steps
from xcg.scene.schema import COMPONENTS, Frame

_ROW_3D = (
    "x",
    "y",
    "z",
    "vx",
    "vy",
    "vz",
    "radius",
    "alpha",
    "beta",
    "gamma",
    "omx",
    "omy",
    "omz",
    "species",
)
_ROW_2D = ("x", "y", "vx", "vy", "radius", "alpha", "om", "species")
_CONTACT = (
    "t",
    "i",
    "j",
    "cx",
    "cy",
    "cz",
    "delta",
    "ctheta",
    "fn",
    "ft",
    "nx",
    "ny",
    "nz",
    "tx",
    "ty",
    "tz",
)


class Mercury(Columnar):
    """Files ``.data``, ``.fstat`` and ``.restart`` of MercuryDPM."""

    OPTIONS = ("restart",)
    NEEDS_ID = False
    ROWS_ARE_IDS = True
    PARTICLE_SLOTS: ClassVar[names.Slots] = {
        **names.PARTICLE_SLOTS,
        "angular_velocity_z": ("omz", "om"),
    }

    def recognises(self, path: str) -> bool:
        """Return whether a file is ``.data`` (header of 8, in 2D 6, numbers) or ``.fstat`` (three comment lines)."""
        name = os.path.basename(path)
        lines = first_lines(path)
        if ".fstat" in name:
            return len(lines) >= 3 and all(line.startswith("#") for line in lines[:3])
        return ".data" in name and bool(lines) and _header(lines[0]) is not None

    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps, numbered from 0 over all files.

        As no header of ``.fstat`` counts the rows, ids are read to count them. Periodic boundaries of the restart file
        replace the edges in the headers of ``.data`` along axes where these are the same in all steps.
        """
        if contacts:
            return [
                replace(ref, step=k)
                for k, ref in enumerate(index_steps(paths, "mercury fstat", _fstat_steps))
            ]
        refs = index_steps(paths, "mercury data", _data_steps)
        restarts = {
            path: read_restart(path, options) or Restart(path, periodic=None) for path in paths
        }
        lasting = [
            len(set(edges)) == 1 for edges in zip(*(ref.box or () for ref in refs), strict=True)
        ]
        for number, ref in enumerate(refs):
            run = restarts[ref.path]
            box = tuple(
                run.edges.get(k, own) if lasting[k] else own for k, own in enumerate(ref.box or ())
            )
            refs[number] = replace(
                ref, step=number, box=box, periodic=run.periodic, gravity=run.gravity
            )
        return refs

    def contact_columns(
        self, ref: StepRef, options: ReadOptions, slots: names.Slots | None = None
    ) -> dict[str, str]:
        """Return the columns of contacts, which are all read."""
        return dict(zip(ref.columns, ref.columns, strict=True))

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> list[str]:
        """Names of the variables that `read_contacts` returns."""
        return [
            "contact_i",
            "contact_j",
            "contact_force",
            "contact_point",
            "contact_normal",
            "overlap",
        ]

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the particles of one step; the restart file knows the density of each species."""
        frame = super().read_particles(ref, options)
        restart = read_restart(ref.path, options)
        if (
            restart
            and restart.density
            and "species" in frame
            and not {"density", "mass"} & set(frame)
        ):
            unknown = set(np.unique(frame["species"])) - set(restart.density)
            if unknown:
                raise SceneError(
                    f"{source_of(ref)}: species {min(unknown):g} is not in {restart.path}, which knows "
                    f"{sorted(restart.density)}; name the restart file of this run with restart="
                )
            kinds, kind = np.unique(frame["species"], return_inverse=True)
            frame["density"] = np.array([restart.density[k] for k in kinds])[kind]
        return frame

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the contacts of one step; walls keep their negative numbers.

        Between particles n points from j to i and the force on i is ``fn n + ft t``; at walls n and t point the
        other way.
        """
        rows = read_table(ref, _CONTACT[1:], None, options)
        keep = _once(rows["i"], rows["j"])
        rows = {name: values[keep] for name, values in rows.items()}
        sign = np.where(rows["j"] < 0, -1.0, 1.0)[:, None]
        normal, tangent, point = (
            np.stack([rows[f"{letter}{axis}"] for axis in COMPONENTS], axis=1) for letter in "ntc"
        )
        return {
            "contact_i": rows["i"],
            "contact_j": rows["j"],
            "contact_force": sign * (rows["fn"][:, None] * normal + rows["ft"][:, None] * tangent),
            "contact_point": point,
            "contact_normal": sign * normal,
            "overlap": rows["delta"],
        }


# --- particles -------------------------------------------------------------------------------------------


def _data_steps(path: str) -> Iterator[StepRef]:
    with scanned(path) as scanner:
        while line := scanner.line():
            if not line.strip():
                continue
            header = _header(line.decode("utf-8", "replace"))
            if header is None:
                raise SceneError(
                    f"{path}: expected a header 'N t xmin ymin zmin xmax ymax zmax' (2D: without z) before "
                    f"byte {scanner.offset}, found {line[:60]!r}. The file is cut short, or is damaged"
                )
            rows, time, *edges = header
            axes = len(edges) // 2
            box = [*zip(edges[:axes], edges[axes:], strict=True), (-np.inf, np.inf)][:3]
            ref = StepRef(
                path,
                int(rows),
                time,
                box=tuple(box),
                columns=_ROW_3D if axes == 3 else _ROW_2D,
                offset=scanner.offset,
            )
            check_rows(ref)
            for row in range(ref.rows):
                if not scanner.line():
                    raise SceneError(
                        f"{path} (time {time:g}): {row} rows, but the header says {ref.rows}: the file is cut off here"
                    )
            yield replace(ref, length=scanner.offset - ref.offset)


def _header(line: str) -> list[float] | None:
    try:
        values = [float(token) for token in line.split()]
    except ValueError:
        return None
    edges = (len(values) - 2) // 2
    plausible = (
        len(values) in (6, 8)
        and values[0] >= 0
        and values[0].is_integer()
        and np.isfinite(values).all()
    )
    return (
        values
        if plausible and all(values[2 + k] <= values[2 + edges + k] for k in range(edges))
        else None
    )


# --- contacts --------------------------------------------------------------------------------------------


def _fstat_steps(path: str) -> Iterator[StepRef]:
    with scanned(path) as scanner:
        step = 0
        while (time := _comments(scanner, path)) is not None:
            start = scanner.offset
            body = b"".join(scanner.until(b"#"))
            ref = StepRef(path, 0, time, step, columns=_CONTACT, offset=start, length=len(body))
            ids = parse_table(body, _CONTACT, ("i", "j"), None, source_of(ref))
            yield replace(ref, rows=int(_once(ids["i"], ids["j"]).sum()))
            step += 1


def _comments(scanner: Scanner, path: str) -> float | None:
    """Time in the three comment lines before a step, None at the end of the file."""
    lines = [scanner.line().decode("utf-8", "replace") for _ in range(3)]
    if not any(lines):
        return None
    try:
        time = float(lines[0].removeprefix("#").split()[0])
    except (ValueError, IndexError):
        time = np.nan
    if not all(line.startswith("#") for line in lines) or not np.isfinite(time):
        raise SceneError(
            f"{path}: expected three lines with '#' and the time in the first, found {lines[0][:60]!r}"
        )
    return time


def _once(i: NDArray, j: NDArray) -> NDArray:
    """Rows to keep: those with i < j, with walls, and mirrored ones whose pair is not among the first."""
    keep = (i < j) | (j < 0)
    if not keep.all():
        pair = np.minimum(i, j) * (max(i.max(), j.max()) + 1) + np.maximum(i, j)
        keep[~keep] = ~np.isin(pair[~keep], pair[keep & (j >= 0)])
    return keep


# --- the restart file ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Restart:
    """Header of a restart file: what holds for the whole run."""

    path: str
    gravity: tuple[float, float, float] | None = None
    periodic: str | None = ""
    density: Mapping[float, float] = field(default_factory=dict)
    edges: Mapping[int, tuple[float, float]] = field(default_factory=dict)  # of periodic axes


def read_restart(data: str, options: ReadOptions) -> Restart | None:
    """Read the restart file that the caller names, or that lies next to a ``.data`` file.

    Only its head, down to the particles, is read.
    """
    given = options.extra.get("restart")
    path = str(given) if given else re.sub(r"\.data\b.*$", ".restart", data)
    if given is None and not Path(path).is_file():
        return None
    restart, density, edges = Restart(path), {}, dict[int, tuple[float, float]]()
    with scanned(path) as scanner:
        while raw := scanner.line():
            words = raw.decode("utf-8", "replace").split()
            if words[:1] == ["Particles"]:
                break
            if "gravity" in words:
                x, y, z = _numbers_after(words, "gravity", 3, path)
                restart = replace(restart, gravity=(x, y, z))
            if words and words[0].endswith("Species") and {"id", "density"} <= set(words):
                (number,), (value,) = (
                    _numbers_after(words, word, 1, path) for word in ("id", "density")
                )
                density[number] = value
            if words and words[0] == "PeriodicBoundary":
                edges |= _period(words, path)
    return replace(
        restart,
        density=density,
        periodic="".join(COMPONENTS[k] for k in sorted(edges)),
        edges=edges,
    )


def _period(words: Sequence[str], path: str) -> dict[int, tuple[float, float]]:
    """Return the two edges of a periodic boundary by its axis; names of the distances depend on the version."""
    given = ("normal", "shift") if "shift" in words else ("normal",)
    vectors = np.array([_numbers_after(words, name, 3, path) for name in given])
    axis = int(np.argmax(np.abs(vectors[0])))
    along, across = vectors[:, axis], np.delete(vectors, axis, axis=1)
    if (np.abs(across) > 1e-9 * np.abs(along[:, None])).any() or not along[0]:
        raise SceneError(
            f"{path}: the normal or shift of {' '.join(words)[:160]!r} is not along x, y or z; such a period is not "
            "read. Name a restart file without it in restart="
        )
    distances = [
        next((w for w in words if w.lower().endswith(end)), f"distance{end.title()}")
        for end in ("left", "right")
    ]
    low, high = sorted(
        _numbers_after(words, name, 1, path)[0] / float(along[0]) for name in distances
    )
    return {axis: (low, high)}


def _numbers_after(words: Sequence[str], word: str, count: int, path: str) -> list[float]:
    start = words.index(word) + 1 if word in words else len(words)
    try:
        found = [float(text) for text in words[start : start + count]]
    except ValueError:
        found = []
    if len(found) != count or not np.isfinite(found).all():
        expected = "a number" if count == 1 else "three numbers"
        raise SceneError(
            f"{path}: expected {expected} after {word!r} in {' '.join(words[:12])[:120]!r}"
        )
    return found
