"""Head of a MercuryDPM ``.restart``: gravity, dimensions, densities and boundaries.

Read are versions 2 and 3 (``restart_version 2``: ``dim``, ``rho``, ``WallsPeriodic``), 0.14 and
1.0.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from xcg.common.messages import SceneError
from xcg.readers.files.text import first_lines, scanned
from xcg.scene.schema import COMPONENTS

_SECTIONS = ("Species", "Walls", "WallsPeriodic", "Boundaries", "Particles")
_BEGINNINGS = ("restart_version ", "MercuryDPM ")
# Boundaries that add or remove grains or act on them. They have no periodic images.
_WITHOUT_IMAGES = ("Insertion", "Deletion", "Flux", "Heater", "Droplet")
_ALONG = 1e-9  # share of the components across an axis that is rounding


@dataclass(frozen=True)
class LeesEdwards:
    """Offset of the images along y, written at one time: `shift` along x, which changes with `velocity`."""

    shift: float
    velocity: float


@dataclass(frozen=True)
class Doubt:
    """Boundary that is not read, or not read completely.

    Attributes
    ----------
    message : str
        What is not read and what to do.
    answers : tuple of str
        Arguments of `xcg.open_scene` that make the message unnecessary.
    """

    message: str
    answers: tuple[str, ...] = ()


@dataclass(frozen=True)
class Restart:
    """Head of a restart file: facts about the whole run.

    Attributes
    ----------
    time : float or None
        Time at which the file was written.
    dimension, particle_dimension : int or None
        2 or 3 for the system, and for the grains (2 for discs of unit depth).
    density : mapping
        Density of each species.
    edges : mapping
        Edges of the box along periodic axes, by the number of the axis; None for the edges of the
        ``.data`` file.
    vectors : mapping
        Vectors to the next images, by the number of the axis, where they do not point along it.
    """

    path: str
    time: float | None = None
    gravity: tuple[float, float, float] | None = None
    dimension: int | None = None
    particle_dimension: int | None = None
    density: Mapping[float, float] = field(default_factory=dict)
    edges: Mapping[int, tuple[float, float] | None] = field(default_factory=dict)
    vectors: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    lees_edwards: LeesEdwards | None = None
    doubts: tuple[Doubt, ...] = ()

    @property
    def periodic(self) -> str:
        """Periodic axes."""
        return "".join(COMPONENTS[k] for k in sorted(self.edges))

    @property
    def has_discs(self) -> bool:
        """Return True if grains are discs, whose mass is ``rho pi r^2``."""
        return self.particle_dimension is not None and self.particle_dimension < 3


def is_restart(path: str) -> bool:
    """Return whether a file begins as a restart file."""
    lines = first_lines(path, 64)
    return bool(lines) and lines[0].startswith(_BEGINNINGS)


def restart_beside(data: str) -> str | None:
    """Return the restart file that belongs to a ``.data`` file, None if it does not exist.

    ``run.data`` has ``run.restart``; ``run.data.12`` has that, or else ``run.restart.12``.
    """
    for name in (
        re.sub(r"\.data\b.*$", ".restart", data),
        re.sub(r"\.data\b", ".restart", data),
    ):
        if name != data and Path(name).is_file():
            return name
    return None


def read_restart(path: str) -> Restart:
    """Read the head of a restart file, down to the particles. Raise SceneError if it is another file."""
    lines = _lines_of_sections(path)
    head = [word for words in lines[""] for word in words]
    dimension = _dimension(head, ("systemDimensions", "dim"), path)
    particle_dimension = _dimension(head, ("particleDimensions",), path)
    density: dict[float, float] = {}
    for words in lines["Species"]:
        if words[0].endswith("Species") and {"id", "density"} <= set(words):
            (number,) = _numbers_after(words, "id", 1, path)
            (density[number],) = _numbers_after(words, "density", 1, path)
        elif "rho" in words:  # versions 2 and 3
            (density[float(len(density))],) = _numbers_after(words, "rho", 1, path)
            particle_dimension = _dimension(words, ("dim_particle",), path)
    gravity = None
    if "gravity" in head:
        x, y, z = _numbers_after(head, "gravity", 3, path)
        gravity = (x, y, z)
    time = None
    for name in ("time", "t"):
        if name in head:
            (time,) = _numbers_after(head, name, 1, path)
            break
    boundaries = _Boundaries(path, time)
    for words in lines["WallsPeriodic"]:
        boundaries.read(["PeriodicBoundary", *words])
    for words in lines["Boundaries"]:
        boundaries.read(words)
    return Restart(
        path,
        time,
        gravity,
        dimension,
        particle_dimension or dimension,
        density,
        boundaries.edges,
        boundaries.vectors,
        boundaries.lees_edwards,
        tuple(boundaries.doubts),
    )


def _lines_of_sections(path: str) -> dict[str, list[list[str]]]:
    """Return the words of each line above the particles, by the name of the section, "" for the head."""
    if not is_restart(path):
        raise SceneError(
            f"{path}: not a restart file of MercuryDPM, whose first word is 'restart_version' or 'MercuryDPM'; name "
            "that of this run in restart="
        )
    lines: dict[str, list[list[str]]] = defaultdict(list)
    section = ""
    with scanned(path) as scanner:
        while section != "Particles" and (line := scanner.line()):
            words = line.decode("utf-8", "replace").split()
            if words and words[0] in _SECTIONS:
                section = words[0]
            elif words:
                lines[section].append(words)
    return lines


def _dimension(words: Sequence[str], names: Sequence[str], path: str) -> int | None:
    """Return the number after the first of some words; None without it, or where it is 0 (old files)."""
    for name in names:
        if name in words:
            (number,) = _numbers_after(words, name, 1, path)
            if number not in (0, 1, 2, 3):
                raise SceneError(f"{path}: {name} {number:g}, expected 1, 2 or 3")
            return int(number) or None
    return None


class _Boundaries:
    """Periodic axes, vectors and doubts of the boundaries read so far."""

    def __init__(self, path: str, time: float | None) -> None:
        self.path = path
        self.time = time
        self.edges: dict[int, tuple[float, float] | None] = {}
        self.vectors: dict[int, tuple[float, float, float]] = {}
        self.lees_edwards: LeesEdwards | None = None
        self.doubts: list[Doubt] = []

    def read(self, words: Sequence[str]) -> None:
        """Add one boundary, by its name."""
        name = words[0].removesuffix("Boundary")
        readers: dict[str, Callable[[Sequence[str]], None]] = {
            "Periodic": self._periodic,
            "TimeDependentPeriodic": self._time_dependent,
            "LeesEdwards": self._lees_edwards,
            "StressStrainControl": self._stress_strain_control,
        }
        if name in readers:
            readers[name](words)
        elif "Maser" in name and "distanceLeft" in words:
            self._maser(words)
        elif not name.endswith(_WITHOUT_IMAGES):
            self._doubt(
                words,
                "is not read: averages near it lack its images, if it has any, and contacts across it get a wrong "
                "branch. Leave that region out, or, if it repeats the grains along axes, give periodic= and box=",
                "periodic",
            )

    def _doubt(self, words: Sequence[str], text: str, *answers: str) -> None:
        self.doubts.append(Doubt(f"{self.path}: {words[0]!r} {text}", answers))

    def _periodic(self, words: Sequence[str]) -> None:
        """Add a periodic axis. The names of the distances depend on the version."""
        normal = np.array(_numbers_after(words, "normal", 3, self.path))
        axis = int(np.argmax(np.abs(normal)))
        if not normal[axis] or not _is_along(normal, axis):
            raise SceneError(
                f"{self.path}: the normal of {' '.join(words)[:160]!r} is not along x, y or z; such a period is not "
                "read. Name a restart file without it in restart="
            )
        names = [
            next((w for w in words if w.lower().endswith(end)), f"distance{end.title()}")
            for end in ("left", "right")
        ]
        low, high = sorted(
            _numbers_after(words, name, 1, self.path)[0] / float(normal[axis]) for name in names
        )
        self.edges[axis] = (low, high)
        if "shift" not in words:
            return
        shift = np.array(_numbers_after(words, "shift", 3, self.path))
        shift *= np.sign(shift[axis]) or 1.0
        if abs(shift[axis] - (high - low)) > _ALONG * (high - low):
            raise SceneError(
                f"{self.path}: the shift of {' '.join(words)[:160]!r} is not as long as its period {high - low:g}; "
                "name a restart file without it in restart="
            )
        if not _is_along(shift, axis):
            x, y, z = shift.tolist()
            self.vectors[axis] = (x, y, z)

    def _time_dependent(self, words: Sequence[str]) -> None:
        self._periodic(words)
        self._doubt(
            words,
            "does not state by how much it shifts and accelerates its images; they are taken to be neither shifted nor "
            "moving: give lattice= and shear_rate= if they are",
            "lattice",
        )

    def _maser(self, words: Sequence[str]) -> None:
        """Add a maser as a periodic axis, unless it is active and feeds grains into an open region."""
        if _numbers_after(words, "maserIsActivated", 1, self.path) == [0.0]:
            self._periodic(words)
            return
        low, high = (
            _numbers_after(words, name, 1, self.path)[0]
            for name in ("distanceLeft", "distanceRight")
        )
        self._doubt(
            words,
            f"repeats the grains from {low:g} to {high:g} and feeds copies of them into an open region. It is read as "
            "open: averages near both edges lack its images, and contacts across them get a wrong branch. Leave these "
            "regions out; where files hold the periodic part alone, give periodic= and box=",
            "periodic",
        )

    def _lees_edwards(self, words: Sequence[str]) -> None:
        """Add periods along x and y; images along y are shifted, and move, along x."""
        left, right, down, up, shift, velocity = (
            _numbers_after(words, name, 1, self.path)[0]
            for name in ("left", "right", "down", "up", "shift", "vel")
        )
        if not (left < right and down < up):
            raise SceneError(
                f"{self.path}: {' '.join(words)[:160]!r}: expected left < right and down < up"
            )
        self.edges[0] = (left, right)
        self.edges[1] = (down, up)
        self.lees_edwards = LeesEdwards(shift, velocity)

    def _stress_strain_control(self, words: Sequence[str]) -> None:
        """Add three periods with the edges of the ``.data`` file; their shear is not read."""
        self.edges.update(dict.fromkeys(range(3)))
        goal, rate = (
            _numbers_after(words, name, 9, self.path)[1] for name in ("stressGoal", "strainRate")
        )
        if goal or rate:
            (shift,) = _numbers_after(words, "integratedShift", 1, self.path)
            at = ""
            if self.time is not None:
                at = f" at time {self.time:g}"
            self._doubt(
                words,
                f"shears the box in the plane xy, its images along y are shifted by {shift:g} along x{at}, and the "
                "shift at other times is not stated. No shift is taken: give lattice={'xy': shifts}, one for each "
                "step, and shear_rate=",
                "lattice",
            )


def _is_along(vector: np.ndarray, axis: int) -> bool:
    return bool((np.abs(np.delete(vector, axis)) <= _ALONG * abs(vector[axis])).all())


def _numbers_after(words: Sequence[str], word: str, count: int, path: str) -> list[float]:
    """Return the numbers after a word. Raise SceneError if it is absent or others follow."""
    start = words.index(word) + 1 if word in words else len(words)
    try:
        numbers = [float(text) for text in words[start : start + count]]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        expected = {1: "a number", 3: "three numbers"}.get(count, f"{count} numbers")
        raise SceneError(
            f"{path}: expected {expected} after {word!r} in {' '.join(words[:12])[:120]!r}"
        )
    return numbers
