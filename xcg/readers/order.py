"""Order of the steps of one kind: runs one after the other, pieces of a step joined, no step twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_user
from xcg.readers.engine import StepRef
from xcg.readers.filenames import read_file_numbers
from xcg.readers.files.text import source_of
from xcg.readers.read_steps import Step
from xcg.scene.schema import Frame
from xcg.steps import faults as errors

Read: TypeAlias = Callable[[StepRef], Frame]
"""Reads the rows of one step."""


def order_steps(steps: Sequence[Step], kind: str, read: Read, *, timed: bool) -> list[Step]:
    """Return the steps in the order of time (without times, of their numbers), each once.

    Steps of one time or number are pieces of one step if they have no particle or contact in
    common; they are joined. Else the later one counts.

    Parameters
    ----------
    steps : sequence of Step
        Steps of particles or of contacts, in the order of the files.
    kind : str
        What they hold, for messages.
    read : callable
        Reads one of them; called for steps of one time or number only.
    timed : bool
        Whether the caller gave the times, which then decide.

    Raises
    ------
    SceneError
        If only the names of files number the steps, and do not show which number counts;
        if times or numbers go back within a file; if steps of two runs would lie between each
        other; if a piece of a step is missing.

    Warns
    -----
    SceneWarning
        If a step occurs twice.
    """
    if not timed:
        _check_names(steps, kind)
        _check_files(steps, kind)
    groups: dict[float, list[Step]] = {}
    for step in steps:
        groups.setdefault(_key(step), []).append(step)
    if len(groups) < len(steps) and _are_pieces(list(groups.values()), kind, read):
        return _joined(groups, kind)
    if not timed:
        _check_runs(steps, kind)
    repeated = [same for same in groups.values() if len(same) > 1]
    if repeated:
        old, new = (source_of(step.particles) for step in repeated[0][-2:])
        message = (
            f"{kind}: {old} is left out, as {new} has its time or step number (if not, give times=)"
        )
        others = len(steps) - len(groups) - 1
        if others:
            message += f"; so are {others} further steps that occur again"
        warn_user(message)
    return [groups[key][-1] for key in sorted(groups)]


def _key(step: Step) -> float:
    return step.particles.step if step.time is None else step.time


def _said(step: Step) -> str:
    """Return the time or number of a step, for messages."""
    return f"step {step.particles.step}" if step.time is None else f"time {step.time:g}"


def _way_out(steps: Sequence[Step], kind: str) -> str:
    if kind == "particles":
        return f"give times=, one for each of the {len(steps)} steps in the order of the files"
    return "give times= for the steps of the particles, if contacts are listed in the same order"


def _check_names(steps: Sequence[Step], kind: str) -> None:
    """Raise SceneError if only the names of files could number the steps, and they do not."""
    unnumbered = [step for step in steps if step.time is None and step.particles.step < 0]
    paths = list(dict.fromkeys(step.particles.path for step in unnumbered))
    problem = read_file_numbers(paths).problem
    if problem and len(paths) > 1:
        raise SceneError(
            f"{kind}: {problem}, so the steps of {paths[0]}, {paths[1]}, ... are not known; open the files of one run "
            f"alone, with one number that varies, or {_way_out(steps, kind)} (pieces of a step have the same time)"
        )


def _check_files(steps: Sequence[Step], kind: str) -> None:
    """Raise SceneError if times or numbers go back within a file."""
    for before, after in pairwise(steps):
        path = after.particles.path
        if before.particles.path == path and _key(after) < _key(before):
            raise SceneError(
                f"{kind}: {path}: {_said(after)} follows {_said(before)}, as where steps were counted anew or another "
                f"run was appended; split the file there and open the runs one by one, or {_way_out(steps, kind)}"
            )


# --- runs ------------------------------------------------------------------------------------------------


def _check_runs(steps: Sequence[Step], kind: str) -> None:
    """Raise SceneError if steps of two runs would be mixed, unless a run repeats the end of the other.

    A run is a file of several steps, or files whose names differ in one number. A run that was
    restarted may repeat the last steps of an earlier one.
    """
    counts = Counter(step.particles.path for step in steps)
    names = dict(zip(counts, read_file_numbers(list(counts)).runs, strict=True))
    runs: dict[str, list[Step]] = {}
    for step in steps:
        path = step.particles.path
        runs.setdefault(names[path] if counts[path] == 1 else path, []).append(step)
    ordered = sorted(runs.values(), key=lambda run: min(map(_key, run)))
    latest = ordered[0]  # the run that ends last
    for run in ordered[1:]:
        keys = set(map(_key, run))
        earlier = set(map(_key, latest))
        low = min(keys)
        high = min(max(keys), max(earlier))
        shared = {key for key in keys if low <= key <= high}
        shared_earlier = {key for key in earlier if low <= key <= high}
        begin_together = min(earlier) == low and len(keys) > 1
        repeats_the_end = shared == shared_earlier and not begin_together
        if low < max(earlier) and not repeats_the_end:
            last = max(latest, key=_key)
            first = min(run, key=_key)
            raise SceneError(
                f"{kind}: steps of two runs would be mixed, as {first.particles.path} ({_said(first)}) begins one "
                f"before {last.particles.path} ({_said(last)}) ends the other; open the runs one by one, leave out "
                f"the files of steps that were computed again, or {_way_out(steps, kind)}"
            )
        if max(keys) > max(earlier):
            latest = run


# --- pieces of one step ----------------------------------------------------------------------------------


def _are_pieces(groups: Sequence[Sequence[Step]], kind: str, read: Read) -> bool:
    """Return whether steps of one time or number have no rows in common, from the first that hold any."""
    repeated = [same for same in groups if len(same) > 1]
    repeated.sort(key=lambda same: any(step.particles.rows == 0 for step in same))
    for same in repeated:
        refs = [step.particles for step in same]
        try:
            frames = [read(ref) for ref in refs]
        except errors.FAULTS:
            if errors.recorded() is None:
                raise
            continue
        identities = [_identities(frame, refs, kind) for frame in frames]
        different = len(np.unique(np.concatenate(identities), axis=0))
        return different == sum(len(np.unique(ids, axis=0)) for ids in identities)
    return False


def _identities(frame: Frame, refs: Sequence[StepRef], kind: str) -> NDArray:
    """Return the id of each particle (n, 1), or the ids of each pair (n, 2), the smaller first."""
    names = ("particle_id",) if kind == "particles" else ("contact_i", "contact_j")
    if any(name not in frame for name in names):
        raise SceneError(
            f"{kind}: {source_of(refs[0])} and {source_of(refs[1])} have the same time or step number, and hold no ids "
            "to tell pieces of a step from a step that was written twice; leave one out, give times=, or map the "
            f"column of ids with names={{'column': {names[0]!r}}}"
        )
    return np.sort(np.stack([frame[name] for name in names], axis=1), axis=1)


def _joined(groups: dict[float, list[Step]], kind: str) -> list[Step]:
    """Join the pieces of each step; raise SceneError if one is missing, or they are of different boxes."""
    counts = Counter(map(len, groups.values()))
    usual = max(counts, key=lambda count: (counts[count], count))
    whole = []
    for key in sorted(groups):
        refs = [step.particles for step in groups[key]]
        problem = ""
        if len(refs) != usual:
            problem = f"is in {len(refs)} of the files, and other steps are in {usual}"
        elif len({(ref.box, ref.lattice) for ref in refs}) > 1:
            problem = f"has pieces of different boxes, as in {refs[-1].path}"
        if problem:
            error = SceneError(
                f"{kind}: {source_of(refs[0])} {problem}; the files hold pieces of steps: add the missing ones, leave "
                "out what is not of this run, or leave out the step (on_error='skip')"
            )
            if not errors.record_fault(source_of(refs[0]), error):
                raise error
            continue
        pieces = replace(
            refs[0],
            rows=sum(ref.rows for ref in refs),
            length=sum(ref.length for ref in refs),
            pieces=tuple(refs),
        )
        whole.append(replace(groups[key][0], particles=pieces))
    return whole


def warn_if_none_recurs(steps: Iterable[tuple[str, Frame]], cause: str) -> None:
    """Warn of a step none of whose particles is in any of the others.

    Parameters
    ----------
    steps : iterable of (str, frame)
        Name of each step for messages, and its particles; drawn only as far as nothing recurs.
    cause : str
        What the steps may be instead, and a call that reads them so.
    """
    drawn = iter(steps)
    first, frame = next(drawn)
    ids = frame.get("particle_id", ())
    apart = []
    for source, other in drawn:
        if not len(ids) or np.isin(ids, other.get("particle_id", ids)).any():
            return
        apart.append(source)
    if apart:
        warn_user(f"no particle of {first} is in {' or '.join(apart)}: {cause}")


def cause_by_files(count: int) -> str:
    """Return the likely cause, and a way out, where only names or order of files separate the steps."""
    times = f"[0] * {count}"
    if count <= 3:
        times = str([0] * count)
    return (
        f"if the files are pieces of one step, give all of them one time, times={times}; if ids "
        "go on from file to file, no grain can be followed"
    )


def cause_by_column(column: str, *, in_order: bool) -> str:
    """Return the likely cause, and a way out, where a column separates the steps.

    `in_order`: ``names=`` lists the columns.
    """
    call = f"names={{{column!r}: None}}"
    if in_order:
        call = "None in its place of names="
    return (
        f"if the column {column!r} is no time or step (but a type, a temperature), drop it by {call}; if "
        "ids go on from step to step, no grain can be followed"
    )
