"""Job: the files, options and outputs of one run."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from xcg.steps.faults import OnError

PATHS = ("particles", "contacts", "walls", "restart")  # arguments of a scene that name files


@dataclass(frozen=True)
class Job:
    """Job: the files, options and outputs of one run.

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
    scheduler : str
        Address of the scheduler of a dask.distributed cluster that computes; "" for this machine.
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
    scheduler: str = ""
