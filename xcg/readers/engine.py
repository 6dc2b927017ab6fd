"""What a reader must offer: an index of steps from headers, and the body of one step as a frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from xcg.scene.schema import Frame


@dataclass(frozen=True)
class StepRef:
    """One step of one file: all that its header tells, and where its body is.

    Attributes
    ----------
    path : str
        The file.
    rows : int
        Rows of the body as the header counts them (an upper bound for the rows of the frame).
    time : float or None
        Physical time in the file's unit, None where the file does not say.
    step : int
        Number of the time step, from the header or the file's name.
    box : tuple or None
        ``((x0, x1), (y0, y1), (z0, z1))`` in the file's unit; infinite edges where an axis is unbounded.
    periodic : str or None
        Periodic axes as the header says, None where it does not.
    columns : tuple of str
        Names of the columns or arrays in the body.
    offset, length : int
        Bytes (of the uncompressed stream) where the body starts and how many there are; 0 for a whole file.
    units : str or None
        Unit system that the header names ("si", "lj", ...).
    size, modified : int
        Size of the file (bytes) and time of its modification (ns) when it was indexed, so that a file that changed
        afterwards is noticed.
    gravity : tuple of float or None
        Acceleration of gravity in the file's units, None where the file does not say.
    kind : str
        A mark of the engine's own, for engines that read contacts from more than one kind of file.
    alone : bool
        Whether the step was taken for the only one of its file, without reading on.
    """

    path: str
    rows: int
    time: float | None = None
    step: int = 0
    box: tuple[tuple[float, float], ...] | None = None
    periodic: str | None = None
    columns: tuple[str, ...] = ()
    offset: int = 0
    length: int = 0
    units: str | None = None
    size: int = 0
    modified: int = 0
    gravity: tuple[float, float, float] | None = None
    kind: str = ""
    alone: bool = False


@dataclass(frozen=True)
class ReadOptions:
    """What the caller says about the files.

    Attributes
    ----------
    names : mapping
        From names in the file to names of the scene, beside or over the engine's own. ``None`` as the target
        drops a column.
    extra : mapping
        Options of one engine only, and ``missing`` ("raise" or "skip"): what to do about files that do not
        exist.
    """

    names: Mapping[str, str | None] = field(default_factory=dict)
    extra: Mapping[str, object] = field(default_factory=dict)


class Engine(Protocol):
    """The functions of a reader module.

    A module may define more:

    - ``OPTIONS``, the names of its own options; others are then refused;
    - ``contact_variables(ref, options)``, the names that `read_contacts` will return, told from the header
      alone; without it, `xcg.open_scene` reads one frame of contacts;
    - ``recover_periods(ref, options)``, the length of the period along some axes from the contacts of one step, where
      the files do not tell it;
    - ``index_walls(paths, options)``, where contacts with walls stand in files of their own; `read_contacts`
      reads these, too.
    """

    def recognises(self, path: str) -> bool:
        """Tell from the first bytes and the name whether this engine reads the file."""

    def index_particles(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps in particle files from headers alone."""

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps in contact files from headers alone."""

    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the body of one step of particles, by scene name, in the file's units."""

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Parse the body of one step of contacts, by scene name, in the file's units."""
