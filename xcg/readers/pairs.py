"""Steps of one series: listed, all of one kind, in order; steps of particles each with their contacts."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from xcg.common.checks import floats
from xcg.common.messages import SceneError, printable, unknown, warn_user
from xcg.readers.column_units import unit_of
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.readers.order import order_steps
from xcg.readers.read_steps import Step, read_step
from xcg.readers.report import list_not_read, warn_of_columns
from xcg.scene.schema import COMPONENTS
from xcg.scene.times import seconds_between
from xcg.steps import faults as errors


def index_files(
    reader: Engine,
    files: Mapping[str, Sequence[str]],
    options: ReadOptions,
    from_headers: Sequence[str],
) -> dict[str, list[StepRef]]:
    """Index each kind of file, and check that nothing changes along the way.

    `from_headers`: which of periodic, units, box and time come from the headers, not from the
    caller.
    """
    indexed: dict[str, list[StepRef]] = {}
    for kind, paths in files.items():
        of_kind = options.of_kind(kind)
        refs = _stamped(getattr(reader, f"index_{kind}")(paths, of_kind) or [], reader)
        if not refs:
            raise SceneError(
                f"{kind}: no step in {_some(paths)}; are these files empty, or of another code?"
            )
        same = [what for what in from_headers if kind == "particles" or what in ("units", "time")]
        indexed[kind] = one_series(refs, same)
        warn_of_columns(reader, refs[0], of_kind, contacts=kind != "particles")
    columns = {column for refs in indexed.values() for column in refs[0].columns}
    absent = sorted({*options.names, *chain(*options.names_of.values())} - columns)
    if absent and columns:
        listed = f"columns are {' '.join(sorted(columns))}"
        with_units = {}  # names end in the units that metadata hold
        for column in columns:
            unit = unit_of(column)
            if unit is not None:
                with_units[unit.stem.lower()] = column
        message = unknown("column", absent[0], columns, listed, with_units)
        raise SceneError(f"names={{{absent[0]!r}: ...}}: {message}")
    return indexed


def from_first_date(
    indexed: Mapping[str, list[StepRef]], scale: float
) -> tuple[dict[str, list[StepRef]], str | None]:
    """Return steps whose times count from the first date of the particles, and this date.

    `scale`: unit of the times that are numbers (s).

    Raises
    ------
    SceneError
        If some files hold dates, and others numbers.
    """
    starts = {ref.start for refs in indexed.values() for ref in refs}
    if starts == {None}:
        return dict(indexed), None
    dates = [ref.start for ref in indexed["particles"] if ref.start]
    first = None
    try:
        first = min(dates, key=pd.Timestamp, default=None)
    except TypeError:
        raise SceneError(
            f"{source_of(indexed['particles'][0])}: some files hold dates with a time zone, and others "
            "without: write times in one way, or give times="
        ) from None
    others = [
        ref for refs in indexed.values() for ref in refs if ref.time is not None and not ref.start
    ]
    if dates and others:
        raise SceneError(
            f"{source_of(others[0])} holds numbers as times, and other files hold dates: write times in "
            "one way, or give times="
        )
    shifted: dict[str, list[StepRef]] = {}
    for kind, refs in indexed.items():
        shifted[kind] = []
        for ref in refs:
            if ref.start is not None and ref.time is not None:
                seconds = ref.time
                if first and ref.start:
                    seconds += seconds_between(first, ref.start)
                ref = replace(ref, time=seconds / scale)
            shifted[kind].append(ref)
    return shifted, first


_FITS: Mapping[str, Callable[[Any], bool]] = {  # what engines of users may get wrong in a StepRef
    "rows": lambda v: isinstance(v, (int, np.integer)) and bool(v >= 0),
    "time": lambda v: v is None or isinstance(v, (int, float, np.number)),
    "step": lambda v: isinstance(v, (int, np.integer)),
    "box": lambda v: v is None or np.shape(v) == (3, 2),
    "lattice": lambda v: v is None or np.shape(v) == (3, 3),
    "gravity": lambda v: v is None or len(v) == 3,
    "periodic": lambda v: v is None or isinstance(v, str),
}


def _stamped(refs: Iterable[StepRef], engine: Engine) -> list[StepRef]:
    """Add the size and time of modification of its file to each step, where the engine did not."""
    state = cache(os.stat)
    stamped = []
    for ref in refs:
        if not isinstance(ref, StepRef):
            raise SceneError(
                f"the engine '{engine.name}' lists {ref!r} as a step; expected a list of xcg.readers.StepRef"
            )
        wrong = [
            f"{name}={getattr(ref, name)!r}"
            for name, fits in _FITS.items()
            if not fits(getattr(ref, name))
        ]
        if wrong:
            raise SceneError(
                f"{ref.path}: the engine '{engine.name}' gives a step {', '.join(wrong)}, which is of another type or "
                "shape than xcg.readers.StepRef says"
            )
        if not (ref.size or ref.modified):
            ref = replace(ref, size=state(ref.path).st_size, modified=state(ref.path).st_mtime_ns)
        stamped.append(ref)
    return stamped


def one_series(refs: list[StepRef], same: Sequence[str]) -> list[StepRef]:
    """Return the steps of one kind, all or an error; where faults are tolerated, those like most of them.

    They have the same columns and, as far as they are in `same`, units and periodic axes; a box and
    times in all of them or in none.
    """
    pattern = refs[0]
    if errors.recorded() is not None:
        often = Counter(ref.columns for ref in refs).most_common(1)[0][0]
        pattern = next(ref for ref in refs if ref.columns == often)
    kept = []
    for ref in refs:
        problems = _differences(pattern, ref, same)
        if not problems:
            kept.append(ref)
            continue
        both = f"{source_of(pattern)} and {source_of(ref)} do not make one series"
        error = SceneError(f"{both}: {'; '.join(problems)}")
        if not errors.record_fault(source_of(ref), error):
            raise error
    return kept


def _differences(first: StepRef, second: StepRef, same: Sequence[str]) -> list[str]:
    """Describe why two steps do not make one series; see `one_series`."""
    problems = []
    for held, other, which in ((first, second, "first"), (second, first, "second")):
        lacking = [f"column '{name}'" for name in held.columns if name not in other.columns]
        for name in same:
            if getattr(other, name) is None and getattr(held, name) is not None:
                lacking.append(f"the {name}")
        problems += [f"{what} is in the {which} only" for what in lacking]
    for name in same:
        before = getattr(first, name)
        after = getattr(second, name)
        if name in ("periodic", "units") and None not in (before, after) and before != after:
            problems.append(
                f"{name}: {before!r} became {after!r} (the argument {name}= overrides both)"
            )
    return problems


def pair_steps(
    reader: Engine,
    options: ReadOptions,
    indexed: Mapping[str, list[StepRef]],
    times: ArrayLike | None,
    missing: str,
    *,
    together: bool,
) -> list[Step]:
    """Order the steps of particles by time, each with its contacts.

    `together`: whether the caller named one file of each kind, whose steps, if there is one each,
    are a pair.
    """
    refs = indexed["particles"]
    times_of_steps: list[float | None] = [ref.time for ref in refs]
    if times is not None:
        numbers = floats(times)
        if numbers.shape != (len(refs),) or not np.isfinite(numbers).all():
            raise SceneError(
                f"times has shape {numbers.shape}: expected {len(refs)} finite numbers, one a step"
            )
        times_of_steps = numbers.tolist()
    steps = [Step(ref, (), time) for ref, time in zip(refs, times_of_steps, strict=True)]
    read = partial(read_step, reader, options)
    steps = order_steps(steps, "particles", read, timed=times is not None)
    read = partial(read, contacts=True)
    for kind in ("contacts", "walls"):
        if kind not in indexed:
            continue
        # with the caller's times, contacts that are listed as the particles are have the same ones
        alike = times is not None and [ref.step for ref in indexed[kind]] == [r.step for r in refs]
        clock = times_of_steps if alike else [ref.time for ref in indexed[kind]]
        others = [Step(ref, (), time) for ref, time in zip(indexed[kind], clock, strict=True)]
        others = order_steps(others, kind, read, timed=alike)
        refs_of_kind = [step.particles for step in others]
        steps = _join(steps, kind, refs_of_kind, missing, together=together, alike=alike)
    return steps


def _join(
    steps: list[Step],
    kind: str,
    others: list[StepRef],
    missing: str,
    *,
    together: bool,
    alike: bool,
) -> list[Step]:
    """Match contacts to steps: by time where both have one, else by number; one by one where they are listed alike."""
    timed = others[0].time is not None and steps[0].particles.time is not None
    same = "time" if timed else "step number"
    named = steps[0].particles.named or others[0].named
    is_one_pair = together and named and len(steps) == len(others) == 1
    unnumbered = others[-1].step < 0  # files that tell neither, in their order
    in_order = alike or (not timed and (is_one_pair or unnumbered))
    number_to_index = {ref.step: index for index, ref in enumerate(others)}
    if in_order and len(steps) == len(others):
        partner = list(range(len(others)))
    elif timed:
        partner = _same_time(steps, others)
    else:
        partner = [number_to_index.get(step.particles.step, -1) for step in steps]
    paired = list(zip(steps, partner, strict=True))
    matched = set(partner)
    lacking = [source_of(step.particles) for step, index in paired if index < 0]
    unused = [source_of(ref) for index, ref in enumerate(others) if index not in matched]
    if lacking and (missing == "raise" or len(lacking) == len(steps)):
        raise SceneError(
            f"{kind}: no step with the same {same} for {len(lacking)} of {len(steps)} steps of the particles "
            f"({_some(lacking)}); there are {_some([*map(source_of, others)])}. Give the files that are missing, or "
            "leave such steps out with missing='skip'; if nothing touches in them, pass missing='empty'"
        )
    if lacking and missing == "skip":
        paired = [(step, index) for step, index in paired if index >= 0]
        warn_user(
            f"{len(lacking)} of {len(steps)} steps have no {kind} and are left out: {_some(lacking)}"
        )
    if unused:
        warn_user(
            f"{len(unused)} steps of {kind} have no particles and are left out: {_some(unused)}"
        )
    partners = [(step, others[index]) for step, index in paired if index >= 0]
    _warn_of_boxes(partners, kind)
    joined = []
    for step, index in paired:
        if index >= 0:
            step = replace(step, contacts=(*step.contacts, others[index]))
        joined.append(step)
    return joined


def _warn_of_boxes(pairs: Sequence[tuple[Step, StepRef]], kind: str) -> None:
    """Warn of contacts in files with another box than that of the particles, along axes that may be periodic."""
    for step, ref in pairs:
        box = step.particles.box
        if box is None or ref.box is None:
            continue
        for axis, edges, others in zip(COMPONENTS, box, ref.box, strict=True):
            if axis not in (step.particles.periodic or COMPONENTS):
                continue
            if not np.allclose(edges, others, 0, 1e-4 * (edges[1] - edges[0])):
                warn_user(
                    f"{kind}: the box of {source_of(ref)} is {list(others)} along {axis!r}, and that of the particles "
                    f"({source_of(step.particles)}) is {list(edges)}, which is taken: are both of one run?"
                )
                return


def _same_time(steps: Sequence[Step], others: Sequence[StepRef]) -> list[int]:
    """Find the contacts nearest in time, -1 beyond 1e-3 of the shortest interval (one step: 1e-6 of its time)."""
    times = np.array([step.particles.time for step in steps], float)
    times_of_contacts = np.array([ref.time for ref in others], float)
    most = 1e-6 * abs(times[0])
    if len(times) > 1:
        most = 1e-3 * np.diff(np.sort(times)).min()
    nearest = [int(np.argmin(np.abs(times_of_contacts - time))) for time in times]
    near = np.abs(times_of_contacts[nearest] - times) <= most
    return np.where(near, nearest, -1).tolist()


def _some(names: Sequence[str]) -> str:
    """List the first three names."""
    shown = list(names[:3])
    if len(names) > 3:
        shown.append("...")
    return ", ".join(shown)


def origin_of(
    engine: Engine, files: Mapping[str, Sequence[str]], options: ReadOptions, steps: Sequence[Step]
) -> dict[str, str]:
    """Attributes on where a scene is from: engine, files, and columns that are not read, a line a kind of file."""
    lines = []
    for kind, paths in files.items():
        line = f"{kind}: {paths[0]}"
        if len(paths) > 1:
            line += f" to {paths[-1]} ({len(paths)} files)"
        lines.append(line)
    contacts = next((step.contacts for step in steps if step.contacts), ())
    refs = {"particles": [step.particles for step in steps[:1]], "contacts": contacts}
    attrs = {
        "engine": engine.name,
        "files": "\n".join(lines),
        "not_read": list_not_read(engine, refs, options),
    }
    return {name: printable(text) for name, text in attrs.items() if text}
