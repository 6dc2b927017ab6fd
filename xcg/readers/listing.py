"""Steps of all files, listed from their headers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from xcg.common.messages import Once, SceneError
from xcg.readers.arguments import Arguments
from xcg.readers.engine import Engine, ReadOptions, StepRef
from xcg.readers.pairs import from_first_date, index_files, pair_steps
from xcg.readers.paths import expand_paths
from xcg.readers.read_steps import Step
from xcg.scene.schema import Setup
from xcg.scene.times import times_of_caller


@dataclass(frozen=True)
class Listing:
    """Steps of all files, from their headers.

    Attributes
    ----------
    reader : Engine
        The engine.
    options : ReadOptions
        Its options.
    files : mapping
        Paths by kind of file.
    refs : mapping
        Steps by kind of file, before they were paired.
    steps : sequence of Step
        Steps of the scene, each with its contacts.
    left_out : dict
        Causes of faults that were tolerated, by file and step.
    start : str or None
        Date from which times count (ISO 8601), where files or arguments hold dates.
    once : Once
        Warnings about steps, each given once.
    """

    reader: Engine
    options: ReadOptions
    files: Mapping[str, Sequence[str]]
    refs: Mapping[str, list[StepRef]]
    steps: Sequence[Step]
    left_out: dict[Any, str]
    start: str | None = None
    once: Once = field(default_factory=Once)

    @property
    def units_are_assumed(self) -> bool:
        """Return True if files that usually name their units do not."""
        named = any(refs[0].units is not None for refs in self.refs.values())
        return bool(self.reader.UNNAMED_UNITS) and not named

    @property
    def skipped(self) -> list[str]:
        """Causes of faults that were tolerated, each with its file."""
        causes = []
        for source, cause in self.left_out.items():
            # most causes name the file; of one with many steps, the source goes on " from byte ..."
            if source.partition(" from byte ")[0] not in cause:
                cause = f"{source}: {cause}"
            causes.append(cause)
        return causes


def list_series(arguments: Arguments) -> Listing:
    """List the steps of all files from their headers, and pair particles with contacts.

    Raises
    ------
    FileNotFoundError, SceneError
        If files are missing, damaged, or do not make one series, unless such faults are tolerated.
    """
    with arguments.tolerating() as left_out:
        files = {kind: expand_paths(paths, kind) for kind, paths in arguments.paths.items()}
        reader = arguments.load_engine(files)
        options = arguments.read_options(reader)
        may_differ = {
            "periodic": arguments.periodic,
            "units": arguments.units,
            "box": arguments.box,
            "time": arguments.times,
        }
        refs = index_files(
            reader,
            files,
            options,
            [what for what, argument in may_differ.items() if argument is None],
        )
        time_unit = 1.0
        if arguments.units is not None:
            time_unit = Setup.make(units=arguments.units).scales[2]
        refs, start = from_first_date(refs, time_unit)
        times = arguments.times
        if times is not None:
            times, start = times_of_caller(times, "times=", time_unit)
        missing = arguments.missing
        if left_out and missing == "empty":
            _check_contacts_are_complete(left_out, files)
        if left_out and missing == "raise":
            missing = "skip"
        named_alone = all([str(paths)] == files[kind] for kind, paths in arguments.paths.items())
        steps = pair_steps(reader, options, refs, times, missing, together=named_alone)
    if arguments.wall_columns:
        steps = [_with_wall_columns(step, reader, options) for step in steps]
    if max(step.particles.step for step in steps) < 0:  # neither files nor their names tell any
        steps = [
            replace(step, particles=replace(step.particles, step=k)) for k, step in enumerate(steps)
        ]
    return Listing(reader, options, files, refs, steps, left_out, start)


def _with_wall_columns(step: Step, reader: Engine, options: ReadOptions) -> Step:
    """Return a step with the contacts with walls that are columns of its particles."""
    options = options.of_kind("particles")
    walls = [reader.wall_step(part, options) for part in step.particles.parts]
    return replace(step, contacts=(*step.contacts, *walls))


def _check_contacts_are_complete(
    left_out: Mapping[str, str], files: Mapping[str, Sequence[str]]
) -> None:
    """Raise SceneError if a damaged file of contacts could be taken for one without contacts."""
    contacts = [path for kind in ("contacts", "walls") for path in files.get(kind, ())]
    damaged = [source for source in left_out if any(source.startswith(path) for path in contacts)]
    if damaged:
        raise SceneError(
            f"{left_out[damaged[0]]} -- With missing='empty' its step would count as one without "
            "contacts: take missing='skip' to leave out steps without contacts, or repair or remove "
            "the file"
        )
