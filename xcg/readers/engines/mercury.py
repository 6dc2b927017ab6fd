"""MercuryDPM: ``.data`` (particles), ``.fstat`` (contacts), and the head of ``.restart``.

Particles are numbered by their row in ``.data``, from 0, as ``.fstat`` does. A pair is listed in
``.fstat`` once or twice; of two rows, the one with i < j is read, as the other has fewer digits.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_user
from xcg.readers import names
from xcg.readers.columns import Columnar
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines.mercury_restart import (
    LeesEdwards,
    Restart,
    is_restart,
    read_restart,
    restart_beside,
)
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
_SPIN_2D = "om"  # minus the angular velocity about z
_ROW_2D = ("x", "y", "vx", "vy", "radius", "alpha", _SPIN_2D, "species")
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
        **names.slots_of(names.PARTICLES, "mercury"),
        "angular_velocity_z": ("omz", _SPIN_2D),
    }

    def recognises(self, path: str) -> bool:
        """Return whether a file is ``.data`` (header of 8, in 2D 6, numbers) or ``.fstat`` (three comment lines).

        A restart file is recognised, too, so that `list_steps` can say what to give instead.
        """
        name = os.path.basename(path)
        lines = first_lines(path)
        if ".fstat" in name:
            return len(lines) >= 3 and all(line.startswith("#") for line in lines[:3])
        if ".data" in name:
            return bool(lines) and _header(lines[0]) is not None
        return is_restart(path)

    def list_steps(
        self, paths: Sequence[str], options: ReadOptions, *, contacts: bool
    ) -> list[StepRef]:
        """List the steps, numbered from 0 over all files.

        As no header of ``.fstat`` counts the rows, ids are read to count them. Periodic boundaries
        of the restart file replace the edges in the headers of ``.data`` along axes where these are
        the same in all steps.
        """
        for path in paths:
            if ".restart" not in os.path.basename(path) or not is_restart(path):
                continue
            data = path.replace(".restart", ".data")
            fstat = path.replace(".restart", ".fstat")
            raise SceneError(
                f"{path}: a restart file of MercuryDPM is not read for grains and contacts; open {data!r}, with "
                f"contacts={fstat!r}. The restart file beside it, or restart={path!r}, then gives densities, gravity "
                "and boundaries"
            )
        if contacts:
            refs = index_steps(paths, "mercury fstat", _fstat_steps)
            return [replace(ref, step=k) for k, ref in enumerate(refs)]
        refs = index_steps(paths, "mercury data", _data_steps)
        runs = {path: _restart_of(path, options) for path in paths}
        restarts = [run for run in runs.values() if run is not None]
        _warn_of_boundaries(restarts, refs, options)
        _check_shifts(refs, runs, options)
        boxes = [ref.box or () for ref in refs]
        lasting = [len(set(edges)) == 1 for edges in zip(*boxes, strict=True)]
        refs = [_with_restart(ref, runs[ref.path], lasting) for ref in refs]
        return [replace(ref, step=k) for k, ref in enumerate(refs)]

    def contact_columns(self, ref: StepRef, options: ReadOptions) -> dict[str, str]:
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
        """Parse the particles of one step. The restart file states the density of each species.

        Discs get a mass, as MercuryDPM computes it for unit depth.
        """
        frame = super().read_particles(ref, options)
        if self.particle_columns(ref, options).get("angular_velocity_z") == _SPIN_2D:
            frame["angular_velocity"] *= -1.0
        restart = _restart_of(ref.path, options)
        if restart is None or not restart.density or "species" not in frame:
            return frame
        if {"density", "mass"} & set(frame):
            return frame
        kinds, kind = np.unique(frame["species"], return_inverse=True)
        unknown = set(kinds) - set(restart.density)
        if unknown:
            raise SceneError(
                f"{source_of(ref)}: species {min(unknown):g} is not in {restart.path}, which knows "
                f"{sorted(restart.density)}; name the restart file of this run with restart="
            )
        density = np.array([restart.density[k] for k in kinds])[kind]
        if not restart.has_discs:
            frame["density"] = density
        elif "diameter" in frame:
            frame["mass"] = density * np.pi / 4 * frame["diameter"] ** 2
        return frame

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the contacts of one step; walls keep their negative numbers.

        Between particles n points from j to i and the force on i is ``fn n + ft t``; at walls n and
        t point the other way.
        """
        vectors = tuple(tuple(f"{letter}{axis}" for axis in COMPONENTS) for letter in "ntc")
        table: dict[Any, NDArray] = read_table(
            ref, _CONTACT[1:], None, replace(options, vectors=vectors)
        )
        keep = _once(table["i"], table["j"])
        if not keep.all():
            names: tuple[Any, ...] = ("i", "j", "fn", "ft", "delta", *vectors)
            table = {name: table[name][keep] for name in names}
        sign = np.where(table["j"] < 0, -1.0, 1.0)[:, None]
        normal, tangent, point = (table[vector] for vector in vectors)
        return {
            "contact_i": table["i"],
            "contact_j": table["j"],
            "contact_force": sign
            * (table["fn"][:, None] * normal + table["ft"][:, None] * tangent),
            "contact_point": point,
            "contact_normal": sign * normal,
            "overlap": table["delta"],
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
            row_count, time, *edges = header
            axes = len(edges) // 2
            box = [*zip(edges[:axes], edges[axes:], strict=True), (-np.inf, np.inf)][:3]
            ref = StepRef(
                path,
                int(row_count),
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
    """Return rows, time and edges of a step; None for any other line."""
    try:
        values = np.array(line.split(), float)
    except ValueError:
        return None
    if len(values) not in (6, 8) or not np.isfinite(values).all():
        return None
    low, high = values[2:].reshape(2, -1)
    if values[0] < 0 or values[0] % 1 or (low > high).any():
        return None
    return values.tolist()


# --- what the restart file says of the run ---------------------------------------------------------------

_SAME_SHIFT = 1e-6  # of a shift: less is rounding


def _restart_of(data: str, options: ReadOptions) -> Restart | None:
    """Read the restart file that the caller names, or that lies beside a ``.data`` file."""
    path = options.extra.get("restart") or restart_beside(data)
    return None if path is None else read_restart(str(path))


def _with_restart(ref: StepRef, run: Restart | None, lasting: Sequence[bool]) -> StepRef:
    """Return a step with what its restart file says."""
    dimension = None
    if ref.columns == _ROW_2D or (run and 2 in (run.dimension, run.particle_dimension)):
        dimension = 2
    if run is None:
        return replace(ref, dimension=dimension)
    box = list(ref.box or ())
    for k, edges in run.edges.items():
        if edges and lasting[k]:
            box[k] = edges
    periodic: str | None = run.periodic
    if not periodic and any("periodic" in doubt.answers for doubt in run.doubts):
        periodic = None  # a boundary that is not read may be periodic
    ref = replace(
        ref,
        box=tuple(box),
        periodic=periodic,
        gravity=run.gravity,
        dimension=dimension,
        shape="disc" if run.has_discs else "sphere",
    )
    vectors = np.diag([high - low for low, high in box])
    for axis, vector in run.vectors.items():
        vectors[axis] = vector
    images = run.lees_edwards
    if images is not None:
        length = vectors[0, 0]
        height = vectors[1, 1]
        shift = _shift_at(run, images, ref.time)
        vectors[1, 0] += shift - length * np.rint(shift / length)
        ref = replace(ref, shear_rates=(("xy", images.velocity / height),))
    if run.vectors or images:
        a, b, c = map(tuple, vectors.tolist())
        ref = replace(ref, lattice=(a, b, c))
    return ref


def _shift_at(run: Restart, images: LeesEdwards, time: float | None) -> float:
    """Return the shift of Lees-Edwards images at some time, from that in the restart file and its velocity."""
    if run.time is None or time is None:
        return images.shift
    return images.shift + images.velocity * (time - run.time)


def _warn_of_boundaries(
    runs: Sequence[Restart], refs: Sequence[StepRef], options: ReadOptions
) -> None:
    """Warn of boundaries that are not read, or not read completely, unless the caller gives what they lack."""
    doubts = [doubt for run in runs for doubt in run.doubts]
    for doubt in dict.fromkeys(doubts):
        if not options.given & set(doubt.answers):
            warn_user(doubt.message)
    if not runs and refs[0].columns == _ROW_2D and "shape" not in options.given:
        warn_user(
            f"{source_of(refs[0])}: no restart file states whether these grains in two dimensions are discs or "
            "spheres, and spheres are taken; give restart=, or shape='disc' with thickness=1, MercuryDPM's unit depth"
        )


def _check_shifts(
    refs: Sequence[StepRef], runs: Mapping[str, Restart | None], options: ReadOptions
) -> None:
    """Warn where shifts of Lees-Edwards images follow from their velocity. Raise SceneError where they cannot."""
    if "lattice" in options.given:
        return
    for ref in refs:
        run = runs[ref.path]
        if run is None or run.lees_edwards is None or not run.lees_edwards.velocity:
            continue
        images = run.lees_edwards
        way_out = "give lattice={'xy': shifts}, one for each step, and shear_rate="
        if run.time is None and len(refs) > 1:
            raise SceneError(
                f"{run.path}: the LeesEdwardsBoundary has the shift {images.shift:g} at a time that is not stated; "
                f"{way_out}"
            )
        if abs(_shift_at(run, images, ref.time) - images.shift) > _SAME_SHIFT * abs(images.shift):
            warn_user(
                f"{run.path}: the LeesEdwardsBoundary has the shift {images.shift:g} at time {run.time:g}; at other "
                f"steps, such as time {ref.time:g}, it follows from the velocity {images.velocity:g}, taken as "
                f"constant. If it is not, {way_out}"
            )
            return


# --- contacts --------------------------------------------------------------------------------------------


def _fstat_steps(path: str) -> Iterator[StepRef]:
    with scanned(path) as scanner:
        for step in count():
            time = _comments(scanner, path)
            if time is None:
                return
            start = scanner.offset
            body = b"".join(scanner.until(b"#"))
            ref = StepRef(path, 0, time, step, columns=_CONTACT, offset=start, length=len(body))
            ids = parse_table(body, _CONTACT, ("i", "j"), None, source_of(ref))
            yield replace(ref, rows=int(_once(ids["i"], ids["j"]).sum()))


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
