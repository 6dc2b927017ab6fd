"""A job: what a run is asked for, whatever file it was written in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from xcg.common.messages import SceneError
from xcg.steps.faults import OnError, check_on_error


@dataclass(frozen=True)
class Job:
    """What one run does.

    Attributes
    ----------
    scene : dict
        Arguments of `xcg.open_scene`.
    fields : dict
        Arguments of `xcg.coarse_grain`.
    phases : dict or None
        Arguments of `xcg.find_phases` or `xcg.assign_phases` before it.
    mesh : dict or None
        Arguments of `xcg.pysammos_mesh`, which places the nodes.
    slices : dict or None
        Arguments of `xcg.slice_temperature`.
    folder : Path
        Where output goes.
    name : str
        Stem of the output's names.
    netcdf : bool
        One file with all steps.
    vtkhdf : str
        "steps" (one file a step), "temporal" (one file) or "" (none).
    suffix : str
        Of the file with all steps: ".nc" or ".h5".
    encoding : dict
        ``dtype``, ``digits`` and ``compression`` of the numbers in the output, as in `xcg.save`.
    on_error : str
        What to do about steps that cannot be read or computed: "raise" or "skip".
    """

    scene: dict[str, Any]
    fields: dict[str, Any] = field(default_factory=dict)
    phases: dict[str, Any] | None = None
    mesh: dict[str, Any] | None = None
    slices: dict[str, Any] | None = None
    folder: Path = Path("xcg-output")
    name: str = "fields"
    netcdf: bool = True
    vtkhdf: str = ""
    suffix: str = ".nc"
    encoding: dict[str, Any] = field(default_factory=dict)
    on_error: OnError = "raise"


def _of_type(path: Path, table: str, values: Mapping[str, Any], kinds: Mapping[str, type | tuple[type, ...]]) -> None:
    """Refuse values of another type than expected."""
    for name, kind in kinds.items():
        if name in values and not isinstance(values[name], kind):
            expected = " or ".join(k.__name__ for k in (kind if isinstance(kind, tuple) else (kind,)))
            raise SceneError(f"{path}: {name} = {values[name]!r} in [{table}]: expected {expected}")


def _plain_name(path: Path, name: str) -> str:
    """Refuse a name of output that leads out of its folder."""
    if not name or name.startswith(".") or set(name) & set("/\\\0") or len(name) > 200:
        raise SceneError(
            f"{path}: name = {name[:60]!r} in [output]: expected the name of a file without its folder and suffix"
        )
    return name


def _on_error(source: str, value: str) -> OnError:
    try:
        return check_on_error(value)
    except ValueError as error:
        raise SceneError(f"{source}: {error}") from None
