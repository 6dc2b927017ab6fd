"""Steps of VTK files: lists of files and their times, pieces of one step, and what holds no grains."""

from __future__ import annotations

import filecmp
import json
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from xcg.common.messages import SceneError, warn_user
from xcg.readers.engine import ReadOptions, StepRef
from xcg.readers.engines import vtkhdf_points
from xcg.readers.filenames import suffix_of
from xcg.readers.files import legacy_vtk, vtp
from xcg.readers.files.hdf5data import is_hdf5
from xcg.readers.files.text import ENDINGS, open_binary, plain_name
from xcg.readers.files.vtkheader import Header
from xcg.readers.paths import number_steps, remembered, timed_steps
from xcg.steps import faults as errors

LINES = "lines"  # kind of a step whose contacts are lines
MESH = "mesh: "  # begins the kind of a file without grains; what it holds follows
_XML = (".vtp", ".vtu")
_PARALLEL = (".pvtu", ".pvtp")
_LONGEST_SERIES = 1 << 26  # bytes of a list in JSON


@dataclass(frozen=True)
class _Listed:
    """Files of one step: the file that names them (or the first), themselves, and the time in a list."""

    name: str
    files: tuple[str, ...]
    time: float | None = None


def read_header(path: str, *, lines: bool = False) -> Header:
    """Read the header of a VTK file, XML or legacy; see `xcg.readers.files.vtp.read_header`."""
    if suffix_of(path) not in _XML and legacy_vtk.is_legacy(path):
        return legacy_vtk.read_header(path, lines=lines)
    return vtp.read_header(path, lines=lines)


def list_steps(paths: Sequence[str], options: ReadOptions, *, lines: bool = False) -> list[StepRef]:
    """List the steps of files and lists without copies; of lines where files hold some and they are wanted.

    Raises
    ------
    SceneError
        If files are missing or damaged, none holds grains, or the pieces of a step hold different
        arrays.

    Warns
    -----
    SceneWarning
        For files without grains, and for missing files that are skipped.
    """
    listed = _existing(paths, options)
    files = list(dict.fromkeys(chain(*(step.files for step in listed))))
    scan = partial(_scan, lines=lines)
    scanned = dict(zip(files, remembered(files, f"vtk {lines=}", scan), strict=True))
    _warn_of_meshes(list(chain(*scanned.values())))
    names = []
    steps = []
    for entry in listed:
        parts = [scanned[file] for file in entry.files]
        refs = [ref for ref in chain(*parts) if not ref.kind.startswith(MESH)]
        if not refs or not all(parts):  # a mesh, or a file is at fault
            continue
        if len(parts) > 1:
            refs = [_joined(entry, refs)]
        names.append(entry.name)
        timed = [replace(ref, time=_time(ref.time, entry.time)) for ref in refs]
        steps.append(timed)
    numbered = number_steps(names, steps)
    return timed_steps(_once(_with_columns(numbered)), options.extra.get("timestep"))


def _scan(path: str, *, lines: bool) -> list[StepRef]:
    """Return the steps of a file, from its header."""
    if suffix_of(path) not in _XML and is_hdf5(path):
        mesh = vtkhdf_points.mesh_of(path)
        return [_mesh(path, mesh)] if mesh else vtkhdf_points.list_steps(path)
    header = read_header(path, lines=lines)
    if header.mesh:
        return [_mesh(path, header.mesh)]
    return [
        StepRef(
            path,
            rows=header.count,
            step=-1,
            time=header.time,
            columns=header.names,
            kind=LINES if header.of_lines else "",
        )
    ]


def _mesh(path: str, mesh: str) -> StepRef:
    """Return an empty step for a file without grains."""
    return StepRef(path, rows=0, step=-1, kind=MESH + mesh)


def _warn_of_meshes(refs: Sequence[StepRef]) -> None:
    """Warn of files without grains; raise SceneError if there are no others."""
    meshes = [ref for ref in refs if ref.kind.startswith(MESH)]
    shown = [f"{ref.path} ({ref.kind.removeprefix(MESH)})" for ref in meshes[:3]]
    if len(meshes) > 3:
        shown.append("...")
    count = f"{len(meshes)} of {len(refs)} files hold no grains"
    if meshes and len(meshes) == len(refs):
        raise SceneError(f"{count}: {', '.join(shown)}; give the files of the grains")
    if meshes:
        warn_user(f"{count} and are skipped: {', '.join(shown)}")


def _joined(entry: _Listed, refs: Sequence[StepRef]) -> StepRef:
    """Make one step of its pieces, without empty ones."""
    pieces = [ref for ref in refs if ref.rows] or list(refs[:1])
    first = pieces[0]
    for piece in pieces:
        differing = sorted({*piece.columns} ^ {*first.columns})
        if differing:
            raise SceneError(
                f"{first.path} and {piece.path} are pieces of one step ({entry.name}) but differ in their arrays: "
                f"{differing}; give the files of one kind of grains"
            )
    return replace(first, rows=sum(piece.rows for piece in pieces), pieces=tuple(pieces))


def _with_columns(refs: Sequence[StepRef]) -> list[StepRef]:
    """Return the steps, those without any rows with the columns of the others, which their files may lack."""
    full = next((ref for ref in refs if ref.rows), None)
    if full is None:
        return list(refs)
    filled = []
    for ref in refs:
        if not ref.rows:
            pieces = tuple(
                replace(piece, columns=full.columns, kind=full.kind) for piece in ref.pieces
            )
            ref = replace(ref, columns=full.columns, kind=full.kind, pieces=pieces)
        filled.append(ref)
    return filled


# --- lists of files --------------------------------------------------------------------------------------


def _expanded(path: str) -> list[_Listed]:
    """List the steps that a file names, or the file itself."""
    suffix = suffix_of(path)
    if suffix not in (".pvd", ".series") or not os.path.isfile(path):
        return [_Listed(path, _parts(path))]
    read_list = vtp.read_collection if suffix == ".pvd" else read_series
    return [
        _Listed(files[0], tuple(chain(*map(_parts, files))), time)
        for files, time in read_list(path)
    ]


def _parts(path: str) -> tuple[str, ...]:
    """Return the files of the pieces of a parallel file, or the file itself."""
    if suffix_of(path) in _PARALLEL and os.path.isfile(path):
        return vtp.read_parallel(path)
    return (path,)


def read_series(path: str) -> list[tuple[tuple[str, ...], float | None]]:
    """List the files of each step that a list in JSON names (``.vtk.series``), as (paths, time), in its order.

    Raises
    ------
    SceneError
        If the file is another kind of list, or names nothing.
    """
    with open_binary(path) as file:
        text = file.read(_LONGEST_SERIES)
    folder = Path(path).parent
    steps: list[tuple[tuple[str, ...], float | None]] = []
    try:
        for entry in json.loads(text)["files"]:
            name = str(entry["name"])
            time = entry.get("time")
            if time is not None:
                time = float(time)
            if name and "\0" not in name:
                steps.append(((str(folder / name),), time))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        steps = []
    if not steps or not all(time is None or math.isfinite(time) for _, time in steps):
        raise SceneError(
            f'{path}: expected a list in JSON like {{"files": [{{"name": "grains_0.vtk", "time": 0.0}}]}}; the file is '
            "damaged, or of another kind"
        )
    return steps


def _existing(paths: Sequence[str], options: ReadOptions) -> list[_Listed]:
    """List the steps whose files exist: lists expanded, missing files refused or skipped with their steps."""
    listed: list[_Listed] = []
    for path in map(str, paths):
        try:
            listed += _expanded(path)
        except errors.FAULTS as error:
            if not errors.record_fault(path, error):
                raise
    listed = [replace(step, files=tuple(map(packed_path, step.files))) for step in listed]
    # a pipe would be waited for
    whole = [step for step in listed if all(map(os.path.isfile, step.files))]
    # MFiX lists its last frame twice: a copy that is gone is not missed.
    times = {step.time for step in whole if step.time is not None}
    unmatched = [file for step in listed if step.time not in times for file in step.files]
    gone = [file for file in unmatched if not os.path.isfile(file)]
    if not gone:
        return whole
    count = sum(len(step.files) for step in listed)
    shown = f"{len(gone)} of {count} files do not exist: {', '.join(gone)}"
    if not whole:
        raise SceneError(f"{shown}; restore them, or check the path")
    if options.extra.get("missing", "raise") == "raise":
        raise SceneError(f"{shown}; restore them, or pass missing='skip' to go on with the others")
    if not errors.record_fault(str(paths[0]), SceneError(f"{shown}; they are skipped")):
        warn_user(f"{shown}; they are skipped")
    return whole


def packed_path(path: str) -> str:
    """Return the path of a file that may have been compressed after it was listed."""
    candidates = (path, *(path + ending for ending in ENDINGS))
    return next(filter(os.path.isfile, candidates), path)


def _time(own: float | None, listed: float | None) -> float | None:
    """Time of a step: the file's own, unless the collection says otherwise (it prints seven digits)."""
    if listed is None or (own is not None and np.isclose(own, listed, rtol=1e-6, atol=0)):
        return own
    return listed


def _once(refs: Sequence[StepRef]) -> list[StepRef]:
    """Drop files with the bytes of an earlier one of the same time: MFiX writes its last frame twice."""
    firsts: dict[object, StepRef] = {}
    kept = []
    for ref in refs:
        key: object = ref.time
        if ref.time is None:
            key = (ref.path, ref.offset)
        first = firsts.setdefault(key, ref)
        if _region(first) != _region(ref):
            raise SceneError(
                f"{first.path} and {ref.path} are of the same time, {ref.time} s, but of different regions; "
                "open one region at a time"
            )
        may_be_copy = first is not ref and not ref.pieces and first.size == ref.size
        if not (may_be_copy and filecmp.cmp(first.path, ref.path, shallow=False)):
            kept.append(ref)
    return kept


def _region(ref: StepRef) -> str:
    return re.sub(r"\d+(?=\D*$)", "", Path(plain_name(ref.path)).stem)
