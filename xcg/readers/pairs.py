"""Steps of one series: listed, all of one kind, in order; steps of particles each with their contacts."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from xcg.common.checks import floats
from xcg.common.messages import SceneError, printable, unknown, warn_user
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.readers.lazy import Step, read_step
from xcg.readers.order import order_steps
from xcg.scene.schema import COMPONENTS
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
        refs = _stamped(getattr(reader, f"index_{kind}")(paths, options) or [], reader)
        if not refs:
            shown = f"{', '.join(paths[:3])}{', ...' if len(paths) > 3 else ''}"
            raise SceneError(
                f"{kind}: no step in {shown}; are these files empty, or of another code?"
            )
        same = [what for what in from_headers if kind == "particles" or what in ("units", "time")]
        indexed[kind] = one_series(refs, same)
    columns = {column for refs in indexed.values() for column in refs[0].columns}
    absent = sorted(set(options.names) - columns)
    if absent and columns:
        listed = f"columns are {' '.join(sorted(columns))}"
        raise SceneError(
            f"names={{{absent[0]!r}: ...}}: {unknown('column', absent[0], columns, listed)}"
        )
    return indexed


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
        problems = [
            f"column '{name}' is in the first only"
            for name in pattern.columns
            if name not in ref.columns
        ]
        problems += [
            f"column '{name}' is in the second only"
            for name in ref.columns
            if name not in pattern.columns
        ]
        for name in same:
            one, other = getattr(pattern, name), getattr(ref, name)
            if (one is None) != (other is None):
                problems.append(f"the {name} is in the {'second' if one is None else 'first'} only")
            elif name in ("periodic", "units") and one != other:
                problems.append(
                    f"{name}: {one!r} became {other!r} (the argument {name}= overrides both)"
                )
        if not problems:
            kept.append(ref)
            continue
        both = f"{source_of(pattern)} and {source_of(ref)} do not make one series"
        error = SceneError(f"{both}: {'; '.join(problems)}")
        if not errors.record_fault(source_of(ref), error):
            raise error
    return kept


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
    known: list[float | None] = [ref.time for ref in refs]
    if times is not None:
        given = floats(times)
        if given.shape != (len(refs),) or not np.isfinite(given).all():
            raise SceneError(
                f"times has shape {given.shape}: expected {len(refs)} finite numbers, one a step"
            )
        known = given.tolist()
    steps = [Step(ref, (), time) for ref, time in zip(refs, known, strict=True)]
    read = partial(read_step, reader, options)
    steps = order_steps(steps, "particles", read, timed=times is not None)
    read = partial(read, contacts=True)
    for kind in ("contacts", "walls"):
        if kind not in indexed:
            continue
        # with the caller's times, contacts that are listed as the particles are have the same ones
        alike = times is not None and [ref.step for ref in indexed[kind]] == [r.step for r in refs]
        clock = known if alike else [ref.time for ref in indexed[kind]]
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
    one = (
        together
        and len(steps) == len(others) == 1
        and (steps[0].particles.named or others[0].named)
    )
    if alike and len(steps) == len(others):
        partner = list(range(len(others)))
    elif timed:
        partner = _same_time(steps, others)
    # files that tell neither, in their order
    elif one or (others[-1].step < 0 and len(others) == len(steps)):
        partner = list(range(len(others)))
    else:
        rows = {ref.step: row for row, ref in enumerate(others)}
        partner = [rows.get(step.particles.step, -1) for step in steps]
    paired = [(step, row) for step, row in zip(steps, partner, strict=True) if row >= 0]
    lacking = [step.particles for step, row in zip(steps, partner, strict=True) if row < 0]
    unused = [ref for row, ref in enumerate(others) if row not in partner]
    if lacking and (missing == "raise" or not paired):
        same = "time" if timed else "step number"
        raise SceneError(
            f"{kind}: no step with the same {same} for {len(lacking)} of {len(steps)} steps of the particles "
            f"({_some(lacking)}); there are {_some(others)}. Give the files that are missing, or leave such "
            "steps out with missing='skip'; if nothing touches in them, pass missing='empty'"
        )
    if missing == "empty":
        paired = list(zip(steps, partner, strict=True))
    elif lacking:
        warn_user(
            f"{len(lacking)} of {len(steps)} steps have no {kind} and are left out: {_some(lacking)}"
        )
    if unused:
        warn_user(
            f"{len(unused)} steps of {kind} have no particles and are left out: {_some(unused)}"
        )
    _warn_of_boxes([(step, others[row]) for step, row in paired if row >= 0], kind)
    return [
        replace(step, contacts=(*step.contacts, *([others[row]] if row >= 0 else [])))
        for step, row in paired
    ]


def _warn_of_boxes(pairs: Sequence[tuple[Step, StepRef]], kind: str) -> None:
    """Warn of contacts in files with another box than that of the particles, along axes that may be periodic."""
    for step, ref in pairs:
        own, other = step.particles.box, ref.box
        if own is None or other is None:
            continue
        for k, a in enumerate(COMPONENTS):
            period = own[k][1] - own[k][0]
            if a in (step.particles.periodic or COMPONENTS) and not np.allclose(
                own[k], other[k], 0, 1e-4 * period
            ):
                warn_user(
                    f"{kind}: the box of {source_of(ref)} is {list(other[k])} along {a!r}, and that of the particles "
                    f"({source_of(step.particles)}) is {list(own[k])}, which is taken: are both of one run?"
                )
                return


def _same_time(steps: Sequence[Step], others: Sequence[StepRef]) -> list[int]:
    """Find the contacts nearest in time, -1 beyond 1e-3 of the shortest interval (one step: 1e-6 of its time)."""
    wanted = np.array([step.particles.time for step in steps], float)
    there = np.array([ref.time for ref in others], float)
    far = 1e-3 * np.diff(np.sort(wanted)).min() if len(wanted) > 1 else 1e-6 * abs(wanted[0])
    nearest = [int(np.argmin(np.abs(there - time))) for time in wanted]
    return [
        row if abs(there[row] - time) <= far else -1
        for row, time in zip(nearest, wanted, strict=True)
    ]


def _some(refs: Sequence[StepRef]) -> str:
    return ", ".join([*(source_of(ref) for ref in refs[:3]), *(["..."] if len(refs) > 3 else [])])


def origin_of(
    engine: Engine, files: Mapping[str, Sequence[str]], options: ReadOptions, steps: Sequence[Step]
) -> dict[str, str]:
    """Attributes on where a scene is from: engine, files, and columns that are not read, a line a kind of file."""
    named = {
        kind: p[0] if len(p) == 1 else f"{p[0]} to {p[-1]} ({len(p)} files)"
        for kind, p in files.items()
    }
    contacts = next((step.contacts for step in steps if step.contacts), ())
    refs = {"particles": [step.particles for step in steps[:1]], "contacts": contacts}
    said = {
        "engine": engine.name,
        "files": "\n".join(f"{kind}: {text}" for kind, text in named.items()),
        "ignored_columns": ignored_columns(engine, refs, options),
    }
    return {name: printable(text) for name, text in said.items() if text}


def ignored_columns(
    engine: Engine, refs: Mapping[str, Iterable[StepRef]], options: ReadOptions
) -> str:
    """List the columns that are not read, a line a kind of file."""
    left = {
        kind: [
            name
            for ref in listed
            for name in engine.ignored_columns(ref, options, contacts=kind == "contacts")
        ]
        for kind, listed in refs.items()
    }
    return "\n".join(
        f"{kind}: {', '.join(dict.fromkeys(names))}" for kind, names in left.items() if names
    )
