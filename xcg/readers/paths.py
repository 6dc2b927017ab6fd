"""Paths and units that callers and headers give; an index of headers, kept on disk."""

from __future__ import annotations

import difflib
import glob
import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np

from xcg.common.checks import POSITIVE, check
from xcg.common.messages import SceneError, warn_user
from xcg.readers.engine import StepRef
from xcg.readers.filenames import read_file_numbers, sort_by_numbers
from xcg.readers.files.text import source_of
from xcg.scene.schema import UNIT_SYSTEMS, Setup, units_of_system
from xcg.steps import faults as errors

PathLike: TypeAlias = str | os.PathLike[str]


def expand_paths(paths: PathLike | Iterable[PathLike], argument: str) -> list[str]:
    """List the files that a path, a glob or a list of them means.

    Parameters
    ----------
    paths : str, path or iterable of them
        Globs are sorted by the numbers in them; a list keeps its order. A file named twice counts
        once.
    argument : str
        Name of the argument, for messages.

    Raises
    ------
    FileNotFoundError
        If a path does not exist or a glob matches nothing; the message names similar files.
    """
    single = isinstance(paths, (str, os.PathLike))
    all_files: list[str] = []
    for listed in cast(Iterable[PathLike], [paths] if single else paths):
        path = os.path.expanduser(os.fspath(listed))
        files = [path]
        if not os.path.isfile(path):
            files = sort_by_numbers(filter(os.path.isfile, glob.glob(path, recursive=True)))
        if not files:
            error = FileNotFoundError(f"{argument}={path!r}{_why_none(path)}")
            if single or not errors.record_fault(os.fspath(listed), error):
                raise error
        all_files += files
    if not all_files:
        errors.raise_recorded()
        raise FileNotFoundError(f"{argument}=[]: expected at least one file")
    return list(dict.fromkeys(all_files))


def _why_none(path: str) -> str:
    """Return why a path or glob matches no file, with the files nearby."""
    if os.path.isdir(path):
        if os.path.splitext(os.path.abspath(path))[1].lower() == ".zarr":
            return " is a Zarr folder, opened alone, as a scene that xcg saved"
        return f" is a folder; give the files in it, for example {os.path.join(path, '*.dump')!r}"
    folder, name = os.path.split(path)
    folder = folder or "."
    problem = ": no such file"
    if glob.has_magic(path):
        problem = ": no file matches this pattern"
    if glob.has_magic(folder):
        return problem
    if not os.path.isdir(folder):
        return f"{problem}; the folder {folder!r} does not exist"
    names = [entry.name for entry in Path(folder).iterdir() if entry.is_file()]
    files = sort_by_numbers(names)
    if not files:
        return f"{problem}; the folder {folder!r} holds no files"
    similar = difflib.get_close_matches(name, files, n=3, cutoff=0.4) or files[:3]
    return f"{problem}; the folder {folder!r} holds {len(files)} files, among them {', '.join(map(repr, similar))}"


def units_of_headers(indexed: Mapping[str, Sequence[StepRef]]) -> Mapping[str, float] | str | None:
    """Units as the headers name them; SI where they do not."""
    named = {
        refs[0].units: source_of(refs[0]) for refs in indexed.values() if refs[0].units is not None
    }
    if len(named) > 1:
        listed = ", ".join(f"{system!r} in {name}" for system, name in named.items())
        raise SceneError(
            f"headers name different unit systems ({listed}); give the factors to SI with units="
        )
    for system, name in named.items():
        return units_of_system(system, f"{name}: the header names")
    return None


def not_against_headers(
    units: Mapping[str, float] | str, indexed: Mapping[str, Sequence[StepRef]]
) -> None:
    """Raise SceneError if `units` contradict the headers.

    Allowed all the same: factors where headers say lj, and "reduced" where they say si.
    """
    setup = Setup.make(units=units)
    for refs in indexed.values():
        system = refs[0].units
        if system not in UNIT_SYSTEMS:
            continue
        named = Setup.make(units=UNIT_SYSTEMS[system])
        agrees = setup.unit_system == named.unit_system and np.allclose(
            setup.scales, named.scales, rtol=1e-12, atol=0
        )
        way_out = "leave units= out, or change 'ITEM: UNITS' in the files if it is wrong"
        if system == "lj":
            agrees = agrees or isinstance(units, Mapping)
            way_out = (
                "give factors to SI, for example units={'length': 1.0, 'mass': 1.0, 'time': 1.0}"
            )
        if system == "si":
            agrees = agrees or setup.unit_system == "reduced"
        if not agrees:
            raise SceneError(
                f"units={units!r}, but the header of {source_of(refs[0])} names the unit system {system!r}: {way_out}"
            )


# --- the index of headers --------------------------------------------------------------------------------
#
# One small JSON file for each folder of data is in the user's cache (``$XDG_CACHE_HOME/xcg``, else
# ``~/.cache/xcg``), never beside the data, which may be read-only or shared. A file counts as known
# if its size and its time of modification (in nanoseconds) match the entry; any other is read. The
# cache may be deleted at any time, and ``XCG_INDEX_CACHE=0`` turns it off.


_VERSION = 9  # of the entries; raise it when headers are read in another way
_SETTLED = 2e9  # ns: a file that was modified just now may change again without another time stamp
_MOST_STEPS = 200_000  # in a file; each takes a kilobyte
_LEFT_OUT = ("path", "size", "modified")  # of entries: they are known when an entry is used


def remembered(
    paths: Sequence[str], kind: str, scan: Callable[[str], Iterable[StepRef]]
) -> list[list[StepRef]]:
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
    listed: list[list[StepRef]] = []
    indexes: dict[str, _Index] = {}
    for path in paths:
        folder = os.path.dirname(os.path.abspath(path))
        if folder not in indexes:
            indexes[folder] = _Index(folder, kind)
        steps: list[StepRef] = []
        listed.append(steps)
        try:
            indexes[folder].add_steps(path, scan, steps)
        except errors.FAULTS as error:
            if steps and isinstance(error, SceneError):
                kept = f"{len(steps)} whole steps before it"
                if steps[0].step >= 0:
                    kept += f" (step {steps[0].step} to {steps[-1].step})"
                kept += " are kept"
                if errors.recorded() is None:
                    kept += " with on_error='skip'"
                error = SceneError(f"{error}; {kept}")
            if not errors.record_fault(path, error):
                raise error from None
    for index in indexes.values():
        index.save()
    return listed


class _Index:
    """Headers of the files of one folder, as they were when these were read."""

    def __init__(self, folder: str, kind: str) -> None:
        self._folder = folder
        self._path, self._entries = _load(folder, kind)
        self._is_new = False

    def add_steps(
        self, path: str, scan: Callable[[str], Iterable[StepRef]], steps: list[StepRef]
    ) -> None:
        """Append the steps of a file; where it is damaged, those before the fault stay."""
        stamp = _stamp(path)
        name = os.path.basename(path)
        entry = self._entries.get(name, {})
        if entry.items() >= stamp.items():
            steps += [StepRef(path, **stamp, **step) for step in entry["steps"]]
            return
        earlier = len(errors.recorded() or ())
        for ref in scan(path):
            if len(steps) == _MOST_STEPS:  # more cannot be kept in memory and in a graph
                raise SceneError(
                    f"{path}: more than {_MOST_STEPS} steps in one file; split it, or thin it out"
                )
            steps.append(replace(ref, **stamp))
        is_settled = _stamp(path) == stamp and time.time_ns() - stamp["modified"] > _SETTLED
        if is_settled and len(errors.recorded() or ()) == earlier:
            self._entries[name] = stamp | {"steps": [_entry(ref) for ref in steps]}
            self._is_new = True

    def save(self) -> None:
        """Write the entries of files that exist, if one is new, whole or not at all."""
        if self._path is None or not self._is_new:
            return
        entries = {
            name: entry
            for name, entry in self._entries.items()
            if os.path.exists(os.path.join(self._folder, name))
        }
        text = json.dumps(entries, separators=(",", ":")).encode()
        part = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        with suppress(OSError):  # a cache that cannot be written is ignored
            self._path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(hashlib.sha256(text).hexdigest().encode() + b"\n" + text)
            os.replace(part, self._path)


def _stamp(path: str) -> dict[str, Any]:
    """Return size and time of modification of a file."""
    state = os.stat(path)
    return {"size": state.st_size, "modified": state.st_mtime_ns}


def _entry(ref: StepRef) -> dict[str, Any]:
    """Return the items of a step that differ from the usual ones."""
    usual = {f.name: f.default for f in fields(StepRef) if f.name not in _LEFT_OUT}
    return {name: getattr(ref, name) for name in usual if getattr(ref, name) != usual[name]}


def index_steps(
    paths: Sequence[str],
    kind: str,
    scan: Callable[[str], Iterable[StepRef]],
    timestep: Any = None,
) -> list[StepRef]:
    """List the steps of all files, or of good files where faults are tolerated; arguments as of `remembered`.

    Steps without a number are numbered as of `number_steps`. With a `timestep`, steps without time
    get one.
    """
    steps_of_files = remembered(paths, kind, scan)
    for path, steps in zip(paths, steps_of_files, strict=True):
        if not steps:
            errors.raise_or_record(path, SceneError(f"{path}: the file is empty; leave it out"))
    refs = number_steps(paths, steps_of_files)
    if not refs:
        errors.raise_recorded()
    return timed_steps(refs, timestep)


# share by which times of the files and of timestep= may differ, as times have few digits
_SAME_DURATION = 1e-3


def timed_steps(refs: Sequence[StepRef], timestep: Any) -> list[StepRef]:
    """Return the steps; with a `timestep`, its product with the number of the step is the time where files hold none.

    Warn if the files hold other times.
    """
    if timestep is None or not refs:
        return list(refs)
    check("timestep", timestep, POSITIVE, hint=", the time between two steps")
    step_length = float(timestep)
    if refs[0].time is not None and refs[-1].time is not None:
        duration = refs[-1].time - refs[0].time
        by_timestep = (refs[-1].step - refs[0].step) * step_length
        if abs(duration - by_timestep) > _SAME_DURATION * max(abs(duration), abs(by_timestep)):
            warn_user(
                f"timestep={step_length:g} is not used, as the files hold times ({refs[0].time:g} to "
                f"{refs[-1].time:g}): leave it out, or give times="
            )
    first = min(refs[0].step, 0)
    timed = []
    for ref in refs:
        if ref.time is None:
            ref = replace(ref, time=(ref.step - first) * step_length)
        timed.append(ref)
    return timed


def number_steps(
    paths: Sequence[str], steps_of_files: Sequence[Sequence[StepRef]]
) -> list[StepRef]:
    """Return the steps of all files, each with a number.

    A step without a number (-1) gets the number or the time in the name of its file if it is the
    only one there, see `read_file_numbers`; else a negative number, in the order of the files.
    """
    by_name = read_file_numbers(paths)
    count = sum(map(len, steps_of_files))
    refs: list[StepRef] = []
    for steps, number, time_in_name in zip(
        steps_of_files, by_name.steps, by_name.times, strict=True
    ):
        for ref in steps:
            of_name = ref.step < 0 and len(steps) == 1
            if of_name and ref.time is None and time_in_name is not None:
                ref = replace(ref, time=time_in_name, named=True)
            if of_name and number is not None:
                ref = replace(ref, step=number, named=True)
            if ref.step < 0:
                ref = replace(ref, step=len(refs) - count)
            refs.append(ref)
    return refs


# --- the files of the index ------------------------------------------------------------------------------


def _load(folder: str, kind: str) -> tuple[Path | None, dict[str, Any]]:
    """Return the folder's index file and its entries by name of the file; no entries if it is absent or damaged.

    No path is returned if the index is turned off or the home is unknown.
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if os.environ.get("XCG_INDEX_CACHE", "1") == "0" or home.startswith("~"):
        return None, {}
    name = hashlib.sha256(f"{_VERSION} {kind} {os.path.realpath(folder)}".encode()).hexdigest()
    index_path = Path(home) / "xcg" / f"index-{name[:32]}.json"
    with suppress(OSError, ValueError):
        digest, _, text = index_path.read_bytes().partition(b"\n")
        if hashlib.sha256(text).hexdigest().encode() == digest:
            return index_path, dict(json.loads(text))
    return index_path, {}
