"""Arguments of `xcg.open_scene`, as one value."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property
from typing import Any, Literal, TypeAlias

from numpy.typing import ArrayLike

from xcg.common.checks import check_choice
from xcg.common.messages import SceneError, did_you_mean
from xcg.readers.caller_names import CallerNames
from xcg.readers.chunks import Chunks
from xcg.readers.engine import Engine, ReadOptions, load_engine
from xcg.readers.names import ALL_SLOTS
from xcg.readers.paths import PathLike
from xcg.readers.recognise import guess_engine
from xcg.scene.schema import Shape, Sides
from xcg.steps.faults import OnError, check_on_error, collecting

Paths: TypeAlias = PathLike | Iterable[PathLike]
# what becomes of steps of particles without contacts
Missing: TypeAlias = Literal["raise", "skip", "empty"]

# what a scene that was saved takes
_OF_SAVED = ("particles", "chunks", "on_error")
_OF_TIME = ("dt", "delta_t", "step_size", "time_step")  # what others call timestep=


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `xcg.open_scene`, which describes them.

    Raises
    ------
    ValueError
        If `missing` or `on_error` is not one of its choices.
    """

    particles: Paths
    contacts: Paths | None = None
    walls: Paths | Mapping[str, str | Sequence[str]] | None = None
    engine: str | Engine | type[Engine] | None = None
    names: Mapping[str, Any] | Sequence[str | None] | str | None = None
    times: ArrayLike | None = None
    box: ArrayLike | Mapping[str, Sequence[float]] | None = None
    periodic: str | bool | Sequence[str] | Sequence[bool] | None = None
    lattice: ArrayLike | Mapping[str, ArrayLike] | None = None
    shear_rate: Mapping[str, ArrayLike] | None = None
    gravity: Sequence[float] | None = None
    density: float | None = None
    diameter: float | None = None
    mass: float | None = None
    frozen: int | Sequence[int] | None = None
    units: Mapping[str, float] | str | None = None
    dimension: int | None = None
    plane: str | None = None
    thickness: float | None = None
    shape: Shape | None = None
    allow_unknown: bool = False
    sides: Sides = "mean"
    missing: Missing = "raise"
    chunks: Chunks = "auto"
    on_error: OnError = "raise"
    engine_options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the choices."""
        check_on_error(self.on_error)
        check_choice("missing", self.missing, Missing)

    @property
    def wall_columns(self) -> dict[str, str | Sequence[str]]:
        """Columns of the particles that hold contacts with walls, by the name of the wall."""
        return dict(self.walls) if isinstance(self.walls, Mapping) else {}

    @property
    def alike(self) -> dict[str, Any]:
        """Numbers that hold for all particles where the files do not hold them, by their variable."""
        return {"density": self.density, "diameter": self.diameter, "mass": self.mass}

    @cached_property
    def caller_names(self) -> CallerNames:
        """The argument `names`, parsed."""
        return CallerNames.parse(self.names)

    @property
    def paths(self) -> dict[str, Paths]:
        """Paths of the files of each kind: particles, contacts, walls."""
        kinds: dict[str, Any] = {"particles": self.particles, "contacts": self.contacts}
        if not isinstance(self.walls, Mapping):
            kinds["walls"] = self.walls
        return {kind: paths for kind, paths in kinds.items() if paths is not None}

    def tolerating(self) -> AbstractContextManager[dict[Any, str]]:
        """Return a context that collects faults of files by file and step, if these are skipped."""
        return collecting() if self.on_error == "skip" else nullcontext({})

    def check_beside_saved(self, saved: str) -> None:
        """Raise SceneError for options of a code's files beside a saved scene, which takes none."""
        described = list(self.engine_options)
        for option in fields(self):
            if option.name in _OF_SAVED or option.default is MISSING:
                continue
            if repr(getattr(self, option.name)) != repr(option.default):
                described.append(option.name)
        if described:
            raise SceneError(
                f"{saved} is a scene that xcg saved, which takes no {described[0]}=; give it where the "
                "files of the code are opened, before they are saved"
            )

    def load_engine(self, files: Mapping[str, Sequence[str]]) -> Engine:
        """Return the engine that reads the files: the given one, that of the options, or guessed.

        Raises
        ------
        SceneError
            If no engine reads them, or it does not take all of the options.
        """
        engine = self.engine
        if engine is None and "mapping" in self.engine_options:
            engine = "hdf5"
        engine = engine or self._engine_of_names(files)
        reader = load_engine(engine or guess_engine(files))
        for option in self.engine_options:
            if option not in reader.OPTIONS:
                raise SceneError(
                    f"open_scene has no argument {option!r} for the engine '{reader.name}'"
                    f"{_likely(option, reader)}"
                )
        return reader

    def _engine_of_names(self, files: Mapping[str, Sequence[str]]) -> str | None:
        """Return the engine that takes lists of `names`, or None if `names` has no list."""
        if not self.caller_names.listed:
            return None
        is_dump = load_engine("liggghts").recognises(files["particles"][0])
        return "liggghts" if is_dump else "table"

    def read_options(self, reader: Engine) -> ReadOptions:
        """Return the options that the engine needs.

        Raises
        ------
        SceneError
            If `names` are of a form that the engine does not take.
        """
        names = self.caller_names
        mapped = names.mapped
        kinds: tuple[str, ...] = ()
        if reader.name == "liggghts":  # words of its computes
            kinds = ("contacts", "walls")
        elif reader.NAMES_IN_ORDER:
            kinds = ("particles", "contacts")
            mapped = names.own_of_lists() | dict(mapped)
        listed = {kind: columns for kind, columns in names.listed.items() if kind in kinds}
        is_apart = isinstance(self.names, Mapping)
        if names.listed and (not listed or (is_apart and listed != names.listed)):
            raise SceneError(
                f"names={self.names!r}: the engine '{reader.name}' reads the names of columns from the files; map "
                "them, names={'column': 'variable'}. Lists are for tables without a line of names (particles, "
                "contacts), and words of a compute are for the engine 'liggghts' (contacts, walls)"
            )
        missing = "raise"
        if "skip" in (self.missing, self.on_error):
            missing = "skip"
        answered = ("box", "periodic", "lattice", "shape", "units")
        return ReadOptions(
            mapped,
            names_of=names.of_kind,
            extra={**self.engine_options, "missing": missing},
            walls=self.wall_columns,
            given=frozenset(name for name in answered if getattr(self, name) is not None),
            listed=listed,
            alone=True,
        )


def _likely(option: str, reader: Engine) -> str:
    """Return the argument that was meant, as the end of a message; "" if none is near."""
    if option.lower() in ("radius", "radii"):
        return "; did you mean diameter=, twice the radius? A column is read by names={'its column': 'radius'}"
    if option in ALL_SLOTS:
        return f"; it is read from a column, names={{'its column': {option!r}}}"
    of_time = "timestep" if "timestep" in reader.OPTIONS else "times"
    synonyms = dict.fromkeys(_OF_TIME, of_time) | {"format": "engine"}
    names = [argument.name for argument in fields(Arguments) if argument.name != "engine_options"]
    return did_you_mean(option, [*names, *reader.OPTIONS], synonyms=synonyms)
