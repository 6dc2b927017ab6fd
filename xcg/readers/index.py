"""Index of headers, kept between sessions: a series opens again without reading its files.

One small JSON file for each folder of data is in the user's cache (``$XDG_CACHE_HOME/xcg``, else ``~/.cache/xcg``),
never beside the data, which may be read-only or shared. A file counts as known if its size and its time of modification
(in nanoseconds) match the entry; any other is read. The cache may be deleted at any time, and
``XCG_INDEX_CACHE=0`` turns it off.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from xcg.common.messages import SceneError
from xcg.readers.engine import StepRef
from xcg.steps import faults as errors

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
            earlier = errors.recorded()
            for ref in _counted(path, scan(path)):  # where faults are tolerated, the steps before one stay
                found[path].append(replace(ref, size=before[0], modified=before[1]))
            after = _state(path)
            if before == after and time.time_ns() - after[1] > _SETTLED and errors.recorded() == earlier:
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
