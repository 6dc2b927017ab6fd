"""Paths and units that callers and headers give; an index of headers, kept on disk."""

from __future__ import annotations

import difflib
import glob
import hashlib
import json
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from xcg.common.messages import SceneError, warn_user
from xcg.readers.engine import Engine, StepRef
from xcg.readers.files.text import source_of
from xcg.scene.schema import Setup
from xcg.steps import faults as errors

PathLike: TypeAlias = str | os.PathLike[str]


def natural_key(path: str) -> list[tuple[int, int, str]]:
    """Key that sorts the numbers in names by value: ``step9`` comes before ``step10``."""
    return [(1, int(part), part) if part.isdecimal() else (0, 0, part) for part in re.split(r"(\d+)", path)]


def expand_paths(paths: PathLike | Iterable[PathLike], argument: str) -> list[str]:
    """List the files that a path, a glob or a list of them means.

    Parameters
    ----------
    paths : str, path or iterable of them
        Globs are sorted naturally; a list keeps its order. A file named twice counts once.
    argument : str
        Name of the argument, for messages.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a glob matches nothing; the message names similar files.
    """
    if isinstance(paths, (str, os.PathLike)):
        return _expand(os.path.expanduser(os.fspath(paths)), argument)
    found = []
    for path in paths:
        try:
            found += _expand(os.path.expanduser(os.fspath(path)), argument)
        except FileNotFoundError as error:
            if not errors.record_fault(os.fspath(path), error):
                raise
    if not found:
        errors.raise_recorded()
        raise FileNotFoundError(f"{argument}=[]: expected at least one file")
    return list(dict.fromkeys(found))


def _expand(path: str, argument: str) -> list[str]:
    if os.path.isfile(path):
        return [path]
    if os.path.isdir(path):
        if os.path.splitext(os.path.abspath(path))[1].lower() == ".zarr":
            raise FileNotFoundError(f"{argument}={path!r} is a Zarr folder, opened alone, as a scene that xcg saved")
        pattern = os.path.join(path, "*.dump")
        raise FileNotFoundError(f"{argument}={path!r} is a folder; give the files in it, for example {pattern!r}")
    if glob.has_magic(path):
        files = [file for file in glob.glob(path, recursive=True) if os.path.isfile(file)]
        if files:
            return sorted(files, key=natural_key)
    folder, name = os.path.split(path)
    problem = "no file matches this pattern" if glob.has_magic(path) else "no such file"
    raise FileNotFoundError(f"{argument}={path!r}: {problem}{_what_is_there(folder or '.', name)}")


def _what_is_there(folder: str, name: str) -> str:
    if glob.has_magic(folder):
        return ""
    if not os.path.isdir(folder):
        return f"; the folder {folder!r} does not exist"
    files = sorted((entry.name for entry in Path(folder).iterdir() if entry.is_file()), key=natural_key)
    if not files:
        return f"; the folder {folder!r} holds no files"
    similar = difflib.get_close_matches(name, files, n=3, cutoff=0.4) or files[:3]
    return f"; the folder {folder!r} holds {len(files)} files, among them {', '.join(map(repr, similar))}"


# Factors to SI of the unit systems that headers name.
UNIT_SYSTEMS: dict[str, Mapping[str, float] | str | None] = {
    "si": None,
    "lj": "reduced",
    "cgs": {"length": 1e-2, "mass": 1e-3},
    "micro": {"length": 1e-6, "mass": 1e-15, "time": 1e-6},
    "nano": {"length": 1e-9, "mass": 1e-21, "time": 1e-9},
}


def names_no_units(engine: Engine, indexed: Mapping[str, Sequence[StepRef]]) -> bool:
    """Return whether files could name their units, and do not."""
    return bool(engine.UNNAMED_UNITS) and all(refs[0].units is None for refs in indexed.values())


def units_of_headers(engine: Engine, indexed: Mapping[str, Sequence[StepRef]]) -> Mapping[str, float] | str | None:
    """Units as the headers name them; SI where they do not."""
    named = {refs[0].units: source_of(refs[0]) for refs in indexed.values() if refs[0].units is not None}
    if len(named) > 1:
        found = ", ".join(f"{system!r} in {name}" for system, name in named.items())
        raise SceneError(f"headers name different unit systems ({found}); give the factors to SI with units=")
    for system, name in named.items():
        if system not in UNIT_SYSTEMS:
            raise SceneError(
                f"{name}: the header names the unit system {system!r}, known are {', '.join(UNIT_SYSTEMS)}; "
                "give the factors to SI, for example units={'length': 1e-10, 'mass': 1e-3, 'time': 1e-15}"
            )
        return UNIT_SYSTEMS[system]
    if names_no_units(engine, indexed):
        warn_user(
            f"{source_of(indexed['particles'][0])}: the header does not name the units, and SI is taken; say "
            f"units='SI', 'reduced' (LAMMPS's lj) or factors such as {{'length': 1e-3}}, or {engine.UNNAMED_UNITS}"
        )
    return None


def not_against_headers(units: Mapping[str, float] | str, indexed: Mapping[str, Sequence[StepRef]]) -> Any:
    """Return `units`; raise SceneError if they contradict the headers.

    Allowed all the same: factors where headers say lj, and "reduced" where they say si.
    """
    given = Setup.make(units=units)
    for refs in indexed.values():
        system = refs[0].units
        scaled = (system == "lj" and isinstance(units, Mapping)) or (system == "si" and units == "reduced")
        if system not in UNIT_SYSTEMS or scaled:
            continue
        named = Setup.make(units=UNIT_SYSTEMS[system])
        if given.unit_system != named.unit_system or not np.allclose(given.scales, named.scales, rtol=1e-12, atol=0):
            way_out = (
                "give factors to SI, for example units={'length': 1.0, 'mass': 1.0, 'time': 1.0}"
                if system == "lj"
                else "leave units= out, or change 'ITEM: UNITS' in the files if it is wrong"
            )
            raise SceneError(
                f"units={units!r}, but the header of {source_of(refs[0])} names the unit system {system!r}: {way_out}"
            )
    return units


# --- the index of headers --------------------------------------------------------------------------------
#
# One small JSON file for each folder of data is in the user's cache (``$XDG_CACHE_HOME/xcg``, else ``~/.cache/xcg``),
# never beside the data, which may be read-only or shared. A file counts as known if its size and its time of
# modification (in nanoseconds) match the entry; any other is read. The cache may be deleted at any time, and
# ``XCG_INDEX_CACHE=0`` turns it off.


_VERSION = 3  # of the entries; raise it when headers are read in another way
_SETTLED = 2e9  # ns: a file that was modified just now may change again without another time stamp
_MOST_STEPS = 200_000  # in a file; each takes a kilobyte
_LEFT_OUT = ("path", "size", "modified")  # of entries: they are known when an entry is used


def remembered(paths: Sequence[str], kind: str, scan: Callable[[str], Iterable[StepRef]]) -> list[list[StepRef]]:
    """Return the steps of each file, from the index if it knows the file, else from its headers.

    Parameters
    ----------
    paths : sequence of str
        The files.
    kind : str
        What is read, for example "lammps particles": entries of another kind are no use.
    scan : callable
        Reads the headers of one file. What it returns may depend on the file and on `kind` only.
    """
    folders: dict[str, list[str]] = {}
    for path in paths:
        folders.setdefault(os.path.dirname(os.path.abspath(path)), []).append(path)
    found: dict[str, list[StepRef]] = {}
    for folder, files in folders.items():
        found |= _of_folder(folder, files, kind, scan)
    return [found[path] for path in paths]


def _of_folder(
    folder: str, paths: Sequence[str], kind: str, scan: Callable[[str], Iterable[StepRef]]
) -> dict[str, list[StepRef]]:
    place = _place(folder, kind)
    known = _load(place)
    found: dict[str, list[StepRef]] = {path: [] for path in paths}
    learnt = {}
    for path in paths:
        try:
            name, before = os.path.basename(path), _state(path)
            refs = _steps(path, known.get(name), before)
            if refs is not None:
                found[path] = refs
                continue
            earlier = len(errors.recorded() or ())
            for ref in _counted(path, scan(path)):  # where faults are tolerated, the steps before one stay
                found[path].append(replace(ref, size=before[0], modified=before[1]))
            after = _state(path)
            if before == after and time.time_ns() - after[1] > _SETTLED and len(errors.recorded() or ()) == earlier:
                learnt[name] = {"size": after[0], "modified": after[1], "steps": [_entry(ref) for ref in found[path]]}
        except errors.FAULTS as error:
            if not errors.record_fault(path, error):
                raise
    if learnt and place is not None:
        there = {name: entry for name, entry in known.items() if os.path.exists(os.path.join(folder, name))}
        _save(place, there | learnt)
    return found


def _counted(path: str, steps: Iterable[StepRef]) -> Iterator[StepRef]:
    """Pass steps on, and refuse a file of more than can be kept in memory and in a graph."""
    for number, step in enumerate(steps):
        if number == _MOST_STEPS:
            raise SceneError(f"{path}: more than {_MOST_STEPS} steps in one file; split it, or thin it out")
        yield step


def _state(path: str) -> tuple[int, int]:
    state = os.stat(path)
    return state.st_size, state.st_mtime_ns


def _entry(ref: StepRef) -> dict[str, Any]:
    """Return the items of a step that differ from the usual ones."""
    usual = {f.name: f.default for f in fields(StepRef) if f.name not in _LEFT_OUT}
    return {name: getattr(ref, name) for name, default in usual.items() if getattr(ref, name) != default}


def _steps(path: str, entry: Mapping[str, Any] | None, state: tuple[int, int]) -> list[StepRef] | None:
    """Return the steps of an entry; None without an entry, or if the file has changed."""
    if entry is None or (entry["size"], entry["modified"]) != state:
        return None
    size, modified = state
    return [
        StepRef(path=path, size=size, modified=modified, **{k: _tuples(v) for k, v in step.items()})
        for step in entry["steps"]
    ]


def _tuples(value: Any) -> Any:
    """JSON has lists only."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


# --- the files of the index ------------------------------------------------------------------------------


def _place(folder: str, kind: str) -> Path | None:
    """Return the folder's index file; None if the index is turned off or the home is unknown."""
    if os.environ.get("XCG_INDEX_CACHE", "1") == "0":
        return None
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if home.startswith("~"):
        return None
    digest = hashlib.sha256(f"{_VERSION} {kind} {os.path.realpath(folder)}".encode()).hexdigest()
    return Path(home) / "xcg" / f"index-{digest[:32]}.json"


def _load(place: Path | None) -> dict[str, Any]:
    """Entries by name of the file; none where the index is absent or damaged."""
    with suppress(OSError, ValueError):
        if place is not None:
            digest, _, text = place.read_bytes().partition(b"\n")
            if hashlib.sha256(text).hexdigest().encode() == digest:
                return dict(json.loads(text))
    return {}


def _save(place: Path, entries: Mapping[str, Any]) -> None:
    """Write the index whole or not at all; a cache that cannot be written is ignored."""
    text = json.dumps(entries, separators=(",", ":")).encode()
    part = place.with_name(f".{place.name}.{os.getpid()}")
    with suppress(OSError):
        place.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(hashlib.sha256(text).hexdigest().encode() + b"\n" + text)
        os.replace(part, place)
