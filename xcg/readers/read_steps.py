"""Steps of a series: reading, checking and completing one, and a chunk of them for tasks."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from xcg.common.messages import Once, SceneError, warn_once
from xcg.compiled._jit import THREADS
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.files.text import source_of
from xcg.scene.complete import complete_particles
from xcg.scene.complete_contacts import HINTS, complete_contacts
from xcg.scene.frame import entries_of, frame_of, stack
from xcg.scene.lattice import Lattice
from xcg.scene.sanity_contacts import check_ends, is_central
from xcg.scene.schema import VARIABLES, Frame, Setup, variable
from xcg.steps import faults as errors


@dataclass(frozen=True)
class Step:
    """Step of the scene: its particles, and the files of its contacts."""

    particles: StepRef
    contacts: tuple[StepRef, ...] = ()
    time: float | None = None


def read_step(
    engine: Engine, options: ReadOptions, ref: StepRef, *, contacts: bool = False
) -> Frame:
    """Parse one body, or its pieces one after the other, in the file's units."""
    if ref.pieces:
        frames = [read_step(engine, options, piece, contacts=contacts) for piece in ref.pieces]
        joined = dict(frames[0])  # of hints, one for all pieces
        for name, values in joined.items():
            if np.ndim(values):
                joined[name] = np.concatenate([frame[name] for frame in frames])
        return joined
    kind = "contacts" if contacts else "particles"
    read = engine.read_contacts if contacts else engine.read_particles
    try:
        variables = read(ref, options.of_kind(kind))
    except SceneError:
        raise
    except ValueError as error:  # of engines of users, such as NumPy's for texts
        raise SceneError(
            f"{source_of(ref)}: the engine {engine.name!r} cannot read it: {error}"
        ) from error
    if not isinstance(variables, Mapping):
        raise SceneError(
            f"{source_of(ref)}: the engine {engine.name!r} gives {kind} as {type(variables).__name__}; "
            "expected a dict of arrays by the names of variables, such as 'position'"
        )
    frame: dict[str, Any] = {str(name): values for name, values in variables.items()}
    try:  # engines of users give lists and tables, too; masked arrays stay so, to be refused
        for name, values in frame.items():
            if name not in HINTS:
                frame[name] = np.asanyarray(values)
    except ValueError as error:
        raise SceneError(
            f"{source_of(ref)}: the engine {engine.name!r} gives values that are no array ({error})"
        ) from None
    if not contacts and np.ndim(frame.get("position", 0.0)) != 2:
        raise SceneError(
            f"{source_of(ref)}: no positions; expected a variable 'position' with three components"
        )
    _check_own_variables(frame, ref)
    return frame


def _check_own_variables(frame: Frame, ref: StepRef) -> None:
    """Raise SceneError for own variables that are not one number a row: lazy arrays have that shape."""
    for name, values in frame.items():
        if name not in {*VARIABLES, *HINTS} and values.ndim > 1:
            raise SceneError(
                f"{source_of(ref)}: {name!r} has shape {values.shape}, expected one number a row; leave it out "
                "of names=, and add vectors and tensors of your own with ds.assign"
            )


def _check_unchanged(ref: StepRef) -> None:
    """Raise SceneError for a file that changed since its headers were read."""
    for piece in ref.pieces:
        _check_unchanged(piece)
    if not ref.size:  # of steps that an engine lists without a file of their own
        return
    again = "open it again"
    try:
        state = os.stat(ref.path)
    except FileNotFoundError:
        now = "is gone"
        if not os.path.isabs(ref.path):
            again += f", by an absolute path where the current folder changed (it is {os.getcwd()})"
    else:
        if (state.st_size, state.st_mtime_ns) == (ref.size, ref.modified or state.st_mtime_ns):
            return
        now = "was written again"
        if state.st_size != ref.size:
            now = f"has {state.st_size} bytes, but had {ref.size}"
    raise SceneError(f"{source_of(ref)}: the file {now} after the scene was opened; {again}")


# bytes of a step that is kept from opening to its first use, alone or beside another
_MOST_OPENED = 1 << 28
_MOST_BESIDE = 1 << 25


class Opened:
    """Particles that were read when a scene was opened, until they are used for the first time.

    Not pickled: a copy in another process starts empty.
    """

    def __init__(self) -> None:
        self._frames: dict[StepRef, Frame] = {}
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[Opened], tuple[()]]:
        return Opened, ()

    def __dask_tokenize__(self) -> str:
        return type(self).__name__

    def keep(self, ref: StepRef, frame: Frame, *, beside: bool) -> None:
        """Keep the completed particles of a step, only of a small one `beside` another that follows."""
        most = _MOST_BESIDE if beside else _MOST_OPENED
        if sum(array.nbytes for array in frame.values()) <= most:
            self._frames[ref] = dict(frame)

    def take(self, ref: StepRef, names: Iterable[str]) -> Frame | None:
        """Return these variables of a step and forget them; None unless all of them are kept."""
        with self._lock:
            frame = self._frames.get(ref, {})
            if not set(names) <= set(frame):
                return None
            taken = {name: frame.pop(name) for name in names}
            if not frame:
                self._frames.pop(ref, None)
        return taken


@dataclass(frozen=True)
class Source:
    """Options of reading a step; they travel to the workers.

    Attributes
    ----------
    engine : Engine
        Reads one step.
    frozen : tuple of int or None
        Species that are fixed in place; None where the caller said nothing.
    once : Once
        Gives warnings of the scene's steps once.
    opened : Opened
        Steps that were read when the scene was opened.
    """

    engine: Engine
    options: ReadOptions
    setup: Setup
    frozen: tuple[int, ...] | None
    allow_unknown: bool
    once: Once = field(default_factory=Once, compare=False)
    opened: Opened = field(default_factory=Opened, compare=False)

    def reading(self, **options: Any) -> Source:
        """Return the same with other options of reading: `alone`, or variables that are `unwanted`."""
        return replace(self, options=replace(self.options, **options))

    def complete(self, frame: Frame, ref: StepRef, box: Frame) -> Frame:
        """Check and complete the particles of one step, in the box of this step.

        `frame` is empty afterwards, see `xcg.scene.complete.complete_particles`.
        """
        if self.frozen is not None:
            if "species" not in frame:
                raise SceneError(
                    f"{source_of(ref)}: frozen={self.frozen} needs 'species', and the file holds none"
                )
            frame["frozen"] = np.isin(frame["species"], self.frozen).astype("int64")
        lattice = None
        if "unwrapped_position" in frame:
            lattice = Lattice.of(box, self.setup.periodic, source_of(ref))
        threads = THREADS if self.options.alone else 1
        with self.once.active():
            return complete_particles(frame, self.setup, source_of(ref), lattice, threads)

    def contacts(
        self, refs: Sequence[StepRef], names: Sequence[str], particles: Frame, box: Frame
    ) -> Frame:
        """Read, check and complete the contacts of one step, from all its files."""
        parts = []
        options = self.options.of_kind("contacts")
        for ref in refs:
            lattice = Lattice.of(box, self.setup.periodic, source_of(ref))
            _check_unchanged(ref)
            raw = read_step(self.engine, self.options, ref, contacts=True)
            columns: Mapping[str, str] = {}
            if "overlap" in raw:
                columns = self.engine.contact_columns(ref, options)
            with self.once.active():
                if "wrapped_branch" in raw:
                    scaled = particles | {"position": particles["position"] / self.setup.scales[0]}
                    check_ends(raw, scaled, lattice.scaled(self.setup.scales[0]), source_of(ref))
                part = complete_contacts(
                    raw,
                    particles,
                    lattice,
                    self.setup,
                    source_of(ref),
                    allow_unknown=self.allow_unknown,
                    columns=columns,
                )
            parts.append(part)
            _require(parts[-1], names, ref)
            unread = self.engine.unread_forces(ref, options)
            if unread and is_central(parts[-1], particles, lattice):
                with self.once.active():
                    what = "all contact forces lie along the branches, as normal parts do"
                    warn_once("partial force", f"{source_of(ref)}: {what}, and {unread}")
        if not parts:  # nothing touches
            return _nothing({name: variable(name).dtype for name in names})
        if len(parts) == 1:
            return {name: parts[0][name] for name in names}
        return {name: np.concatenate([part[name] for part in parts]) for name in names}


def _require(frame: Frame, names: Sequence[str], ref: StepRef) -> None:
    """Raise SceneError for a frame that lacks variables of other steps, or has more rows than its header promised."""
    count = len(next(iter(frame.values())))
    if count > ref.rows:
        raise SceneError(
            f"{source_of(ref)}: {count} rows, but its index promised {ref.rows} at most"
        )
    lacking = [name for name in names if name not in frame]
    if lacking:
        raise SceneError(
            f"{source_of(ref)}: lacks {lacking}, which other steps hold; a series must hold the same throughout"
        )


def _chunk(
    steps: Sequence[Step], read: Callable[[int, Step], Frame], types: Mapping[str, Any], length: int
) -> Frame:
    """Frames of the steps of a chunk, padded; steps at fault are empty where faults are tolerated."""
    frames = []
    for t, step in enumerate(steps):
        try:
            frames.append(read(t, step))
        except errors.FAULTS as error:
            if not errors.record_fault(step.particles.step, error):
                raise
            frames.append(_nothing(types))
    return stack(frames, list(types), length)


def _nothing(types: Mapping[str, Any]) -> Frame:
    """Make a frame without rows."""
    return {name: np.empty(variable(name, dtype).shape(0), dtype) for name, dtype in types.items()}


def read_particle_chunk(
    source: Source, steps: Sequence[Step], types: Mapping[str, Any], length: int, boxes: Frame
) -> Frame:
    """Particles of the steps of a chunk, padded."""

    def read(t: int, step: Step) -> Frame:
        ref = step.particles
        _check_unchanged(ref)
        frame = source.opened.take(ref, types)
        if frame is None:
            raw = read_step(source.engine, source.options, ref)
            box = entries_of(boxes, t)
            frame = source.complete(raw, ref, box)
        _require(frame, list(types), ref)
        return frame

    return _chunk(steps, read, types, length)


def read_contact_chunk(
    source: Source,
    steps: Sequence[Step],
    names: Sequence[str],
    length: int,
    boxes: Frame,
    particles: Frame,
) -> Frame:
    """Contacts of the steps of a chunk, padded, checked against the particles of the same chunk."""

    def read(t: int, step: Step) -> Frame:
        box = entries_of(boxes, t)
        return source.contacts(step.contacts, names, frame_of(particles, t), box)

    types = {name: variable(name).dtype for name in names}
    return _chunk(steps, read, types, length)
