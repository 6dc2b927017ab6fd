"""Engines: what a reader of a format derives from, and the table of those there are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, ClassVar

import numpy as np

from xcg.common.messages import SceneError, unknown, warn_user
from xcg.scene.schema import Frame, Shape


def _tuples(values: Any) -> Any:
    if isinstance(values, list):
        return tuple(map(_tuples, values))
    return values


@dataclass(frozen=True)
class StepRef:
    """Step of a file: what its header holds, and where its body is.

    Only `path` and `rows` must be given.

    Attributes
    ----------
    path : str
        The file.
    rows : int
        Rows of the body as the header counts them (an upper bound for the rows of the frame).
    time : float or None
        Physical time in the file's unit, None where the file does not say.
    start : str or None
        What `time` counts from, in seconds, where the file holds dates (ISO 8601) or durations
        (""); None where it holds numbers.
    step : int
        Number of the time step, from the header or the file's name; negative and rising where
        neither has it, so that particles and contacts are paired in their order.
    box : tuple or None
        ``((x0, x1), (y0, y1), (z0, z1))`` in the file's unit; infinite edges where an axis is
        unbounded.
    lattice : tuple or None
        Vectors a, b, c to the next images in the file's unit, where the file may tilt the box;
        `box` then holds the edges without the tilt.
    periodic : str or None
        Periodic axes as the header says, None where it does not.
    columns : tuple of str
        Names of the columns or arrays in the body.
    offset, length : int
        Bytes (of the uncompressed stream) where the body starts and how many there are; 0 for a
        whole file.
    units : str or None
        Unit system that the header names ("si", "lj", ...).
    size, modified : int
        Size of the file (bytes) and time of its modification (ns) when it was indexed, so that a
        file that changed afterwards is noticed; `xcg.open_scene` fills them in.
    shear_rates : tuple
        Velocity gradients of the images as the file says, such as ``(("xy", 0.1),)`` for dv_x/dy,
        in the file's units.
    gravity : tuple of float or None
        Acceleration of gravity in the file's units, None where the file does not say.
    dimension : int or None
        2 or 3 as the file says, None where it does not.
    shape : {"sphere", "disc"} or None
        Shape of the grains as the file says. Discs have unit depth in the file's unit of length.
    kind : str
        A mark of the engine's own, for engines that read contacts from more than one kind of file.
    named : bool
        Whether `step` is the number in the name of the file, which does not say it.
    alone : bool
        Whether the step was taken for the only one of its file, without reading on.
    pieces : tuple of StepRef
        The parts of a step that was written to several files, which are read one after the other;
        engines get these.
    unknown : tuple of pairs of str
        Words of the header that are not understood, each with the argument of `xcg.open_scene` that
        says what they do not, such as ``("'BOX BOUNDS aa bb cc'", "periodic='xyz'")``.
    """

    path: str
    rows: int
    time: float | None = None
    step: int = 0
    box: tuple[tuple[float, float], ...] | None = None
    lattice: tuple[tuple[float, float, float], ...] | None = None
    periodic: str | None = None
    columns: tuple[str, ...] = ()
    offset: int = 0
    length: int = 0
    units: str | None = None
    size: int = 0
    modified: int = 0
    shear_rates: tuple[tuple[str, float], ...] = ()
    gravity: tuple[float, float, float] | None = None
    dimension: int | None = None
    shape: Shape | None = None
    kind: str = ""
    named: bool = False
    alone: bool = False
    pieces: tuple[StepRef, ...] = ()
    unknown: tuple[tuple[str, str], ...] = ()
    start: str | None = None

    @property
    def parts(self) -> tuple[StepRef, ...]:
        """The pieces, or the step itself if it has none."""
        return self.pieces or (self,)

    def __post_init__(self) -> None:
        """Make tuples of lists and arrays, as steps are hashed."""
        for name in ("box", "lattice", "gravity", "columns", "unknown"):
            value = getattr(self, name)
            if value is not None and not (
                type(value) is tuple and all(type(v) is not list for v in value)
            ):
                object.__setattr__(self, name, _tuples(np.asarray(value).tolist()))


@dataclass(frozen=True)
class ReadOptions:
    """Options of the caller: names, walls and options of single engines.

    Attributes
    ----------
    names : mapping
        From names in the file to names of the scene, beside or over the engine's own. ``None`` as
        the target drops a column.
    extra : mapping
        Options of one engine only, and ``missing`` ("raise" or "skip"): what to do about files that
        do not exist.
    walls : mapping
        From names of walls to the columns of particles that hold their contacts: a pattern, or
        names of columns.
    names_of : mapping
        `names` of each kind of file, where the caller gives them apart ("particles", "contacts").
    given : frozenset of str
        Which of ``box``, ``periodic``, ``lattice``, ``shape`` and ``units`` of `xcg.open_scene` the
        caller gave.
    unwanted : tuple of str
        Variables of the scene that an engine need not read this time.
    vectors : tuple of tuple of str
        Columns of the file that become the components of vectors; an engine may return them as
        views of one array (n, 3).
    listed : mapping
        Names of all columns of files without a line of names, by kind ("particles", "contacts");
        None skips a column. Words of the computes that wrote "contacts" and "walls" (LIGGGHTS).
    alone : bool
        Whether nothing else is read or computed meanwhile, so that one step may take all threads of
        the process.
    """

    names: Mapping[str, str | None] = field(default_factory=dict)
    names_of: Mapping[str, Mapping[str, str | None]] = field(default_factory=dict)
    extra: Mapping[str, object] = field(default_factory=dict)
    walls: Mapping[str, str | Sequence[str]] = field(default_factory=dict)
    given: frozenset[str] = frozenset()
    unwanted: tuple[str, ...] = ()
    vectors: tuple[tuple[str, ...], ...] = ()
    listed: Mapping[str, Sequence[str | None]] = field(default_factory=dict)
    alone: bool = False

    def of_kind(self, kind: str) -> ReadOptions:
        """Return the options for files of particles, or of contacts and walls."""
        if not self.names_of:
            return self
        kind = "particles" if kind == "particles" else "contacts"
        return replace(self, names=self.names_of.get(kind, {}))


class Engine(ABC):
    """A format of files: how its steps are listed, and how one of them is read.

    A subclass needs `index_particles` and `read_particles`; `index_contacts` and `read_contacts`
    where files hold contacts; `recognises` if it is to be found without ``engine=``.
    `xcg.open_scene` makes one object of it, without arguments, and sends it to the processes that
    read, so it should hold no open files. Packages register it by the entry point group
    ``xcg.readers``; any other is handed over, ``open_scene(..., engine=MyEngine)``.

    Steps are sorted, paired with their contacts, checked and converted to SI after an engine listed
    and read them.

    Attributes
    ----------
    OPTIONS : tuple of str
        Names of the keyword arguments of its own that `xcg.open_scene` takes; they come as
        ``options.extra``.
    NAMES_IN_ORDER : bool
        Whether files may lack names of columns, which are then in ``options.listed``.
    UNNAMED_UNITS : str
        What to do about files that do not name their units, for the warning that such files get;
        without it they are taken as SI without a word.
    WHOLE_FORCES : str
        What to do about contacts with normal forces alone, for the warning that such files get;
        without it these are contact forces without a word.
    WHOLE_VECTORS : bool
        Whether a column holds all components of a vector.
    ROWS_ARE_IDS : bool
        Whether rows without ``particle_id`` are the same particles in every step, unless their
        number falls, and contacts name them by the number of their row.

    Examples
    --------
    >>> import numpy as np
    >>> from xcg.readers import Engine, StepRef
    >>> class Points(Engine):
    ...     def index_particles(self, paths, options):
    ...         return [StepRef(path, rows=len(np.load(path)), step=k) for k, path in enumerate(paths)]
    ...
    ...     def read_particles(self, ref, options):
    ...         return {"position": np.load(ref.path)}
    """

    OPTIONS: ClassVar[tuple[str, ...]] = ()
    NAMES_IN_ORDER: ClassVar[bool] = False
    UNNAMED_UNITS: ClassVar[str] = ""
    WHOLE_FORCES: ClassVar[str] = ""
    WHOLE_VECTORS: ClassVar[bool] = False
    ROWS_ARE_IDS: ClassVar[bool] = True

    @property
    def name(self) -> str:
        """Name in messages and for ``engine=``; override it where the class is called otherwise."""
        return type(self).__name__.lower()

    def recognises(self, path: str) -> bool:
        """Return whether this engine reads the file, from its first bytes and its name.

        Called with any file, of particles or of contacts; an exception raised here makes opening
        fail.
        """
        return False

    @abstractmethod
    def index_particles(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps in files with particles, from headers alone.

        Parameters
        ----------
        paths : sequence of str
            Files that exist, in the order that the caller gave, globs in the order of the numbers
            in names.
        options : ReadOptions
            What the caller said.

        Returns
        -------
        list of StepRef
            The steps, with `time` in all of them or in none; the number of the step decides where
            no time is known.

        Raises
        ------
        SceneError
            If a file is not what it should be; `on_error` of `xcg.open_scene` leaves it out.
        """

    @abstractmethod
    def read_particles(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the particles of one step, of n rows at most ``ref.rows``.

        Returns
        -------
        dict of arrays
            By names of the scene, in the file's units: ``position`` (n, 3), and what there is of
            ``velocity``, ``angular_velocity`` (n, 3), ``particle_id``, ``species``, ``diameter``,
            ``density``, ``mass``, ``volume``, ``moment_of_inertia``, ``coordination_number`` (n,).
            Any other name becomes a variable of the particles. Rows come in any order; without
            ``particle_id`` their number is the id.

        Raises
        ------
        SceneError
            If the body does not fit its header.
        """

    def index_contacts(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps in files with contacts, from headers alone; see `index_particles`."""
        raise SceneError(f"contacts=: the engine '{self.name}' reads particles only")

    def index_walls(self, paths: Sequence[str], options: ReadOptions) -> list[StepRef]:
        """List the steps in files with contacts with walls, where these are kept apart; `read_contacts` reads them."""
        raise SceneError(
            f"walls=: the engine '{self.name}' reads contacts with walls among the others; give contacts="
        )

    def wall_step(self, ref: StepRef, options: ReadOptions) -> StepRef:
        """Return the contacts with walls that are columns of a step of particles, for `read_contacts`."""
        raise SceneError(
            f"walls={dict(options.walls)!r}: the engine '{self.name}' reads no walls from columns of particles"
        )

    def unread_forces(self, ref: StepRef, options: ReadOptions) -> str:
        """Return a hint about columns that may hold the rest of the contact forces; "" without such columns."""
        return ""

    def read_contacts(self, ref: StepRef, options: ReadOptions) -> Frame:
        """Read the contacts of one step, of n rows at most ``ref.rows``.

        Returns
        -------
        dict of arrays
            ``contact_i`` and ``contact_j`` (n,), ids of the partners, negative for a wall;
            ``contact_force`` (n, 3), on i; and what there is of ``contact_point``,
            ``contact_normal`` (n, 3) and ``overlap`` (n,).

        Raises
        ------
        SceneError
            If the body does not fit its header.
        """
        raise SceneError(f"contacts=: the engine '{self.name}' does not read contacts")

    def contact_variables(self, ref: StepRef, options: ReadOptions) -> Sequence[str]:
        """Names of what `read_contacts` returns; from the header where that is quicker than reading the step."""
        return list(self.read_contacts(ref, options))

    def contact_columns(self, ref: StepRef, options: ReadOptions) -> Mapping[str, str]:
        """Columns of the variables of `read_contacts` by their names, for messages; none by default."""
        return {}

    def recover_periods(self, ref: StepRef, options: ReadOptions) -> Mapping[str, float]:
        """Length of the period along some axes from the contacts of a step, where files lack it."""
        return {}

    def explained(
        self, ref: StepRef, options: ReadOptions, lengths: Sequence[str]
    ) -> Sequence[str]:
        """Return unread columns of lengths that follow from others; none by default."""
        return ()

    def columns_read(
        self, ref: StepRef, options: ReadOptions, *, contacts: bool
    ) -> dict[str, str] | None:
        """Return what each column of a step is read as; None by default: nothing is said about columns."""
        return None


GROUP = "xcg.readers"
BUILT_IN = {
    "lammps": "xcg.readers.engines.lammps:Lammps",
    "liggghts": "xcg.readers.engines.liggghts:Liggghts",
    "mercury": "xcg.readers.engines.mercury:Mercury",
    "mfix": "xcg.readers.engines.mfix:Mfix",
    "yade": "xcg.readers.engines.yade:Yade",
    "xyz": "xcg.readers.engines.xyz:Xyz",
    "table": "xcg.readers.engines.tabular:Table",
    "h5md": "xcg.readers.engines.h5md:H5md",
    "hdf5": "xcg.readers.engines.hdf5:Hdf5",
    "vtk": "xcg.readers.engines.vtk:Vtk",
}


@cache  # a file of each installed package is read to find them
def engine_table() -> dict[str, EntryPoint]:
    """List the engines by name; engines of this package come first, and first when files are recognised."""
    table = {name: EntryPoint(name, target, GROUP) for name, target in BUILT_IN.items()}
    for entry in entry_points(group=GROUP):
        taken = table.setdefault(entry.name, entry)
        if taken.value != entry.value:
            warn_user(
                f"two engines are called {entry.name!r}: {taken.value} is taken; hand over the other one, "
                f"{entry.value}, as engine="
            )
    return table


def all_engines() -> Iterator[Engine]:
    """Load one engine after the other; engines of packages that cannot be imported are left out, with a warning."""
    for name in engine_table():
        try:
            yield load_engine(name)
        except SceneError as error:
            warn_user(f"left out: {error}")


def load_engine(engine: str | Engine | type[Engine]) -> Engine:
    """Make an engine of its name, of its class, or of itself.

    Raises
    ------
    SceneError
        If no engine has this name, it cannot be imported, or it is not an `Engine`.
    """
    loaded: object = engine
    if isinstance(engine, str):
        table = engine_table()
        if engine not in table:
            raise SceneError(unknown("engine", engine, table))
        try:
            loaded = table[engine].load()
        except (ImportError, AttributeError) as error:
            raise SceneError(
                f"the engine {engine!r} ({table[engine].value}) cannot be imported: {error}"
            ) from error
    if isinstance(loaded, type) and issubclass(loaded, Engine):
        try:
            return loaded()
        except TypeError as error:
            raise SceneError(
                f"engine={engine!r}: no object can be made of it without arguments ({error})"
            ) from None
    if not isinstance(loaded, Engine):
        raise SceneError(
            f"engine={engine!r}: expected a name, or a class or object derived from xcg.readers.Engine"
        )
    return loaded
