"""Files that describe a job for the command line: Pysammos's ``config.ini`` as it stands, and TOML."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import xarray as xr

from xcg.common.messages import SceneError
from xcg.jobs.pysammos_ini import read_ini
from xcg.steps.faults import OnError, check_on_error
from xcg.writers.encoding import Encoding


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


def read_config(path: str | Path) -> Job:
    """Read a job from ``.toml`` or from Pysammos's ``.ini``; paths in it are relative to its folder.

    Raises
    ------
    FileNotFoundError
        If the file does not exist, or names files that do not exist.
    SceneError
        If it cannot be understood; the message names section and key.

    Warns
    -----
    SceneWarning
        For keys that are not known.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist")
    try:
        job = _toml(path) if path.suffix.lower() == ".toml" else Job(**read_ini(path))
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: is no text in UTF-8 ({error.reason} at byte {error.start})") from None
    except (TypeError, AttributeError, RecursionError) as error:  # tables where values should be, and the like
        raise SceneError(
            f"{path}: cannot be understood ({error}); see the form of a job in the documentation"
        ) from None
    try:
        check_on_error(job.on_error)
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from None
    return job


# --- TOML ------------------------------------------------------------------------------------------------

_TABLES = ("scene", "phases", "fields", "slices", "output")
_OUTPUT = ("folder", "name", "netcdf", "vtkhdf", "dtype", "digits", "compression")
_PATHS = ("particles", "contacts", "walls", "restart")


def _toml(path: Path) -> Job:
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{path}: {error}") from None
    on_error = data.pop("on_error", "raise")
    unknown = [name for name in data if name not in _TABLES or not isinstance(data[name], dict)]
    if unknown or "particles" not in data.get("scene", {}):
        tables = ", ".join(_TABLES)
        raise SceneError(
            f"{path}: expected the tables {tables} with scene.particles, and on_error; found {sorted(data)}"
        )
    output = data.get("output", {})
    wrong = [name for name in output if name not in _OUTPUT]
    if wrong:
        raise SceneError(f"{path}: [output] has {wrong}; expected any of {', '.join(_OUTPUT)}")
    for key, kinds in {"folder": (str,), "name": (str,), "netcdf": (bool,), "vtkhdf": (str, bool)}.items():
        if key in output and not isinstance(output[key], kinds):
            expected = " or ".join(kind.__name__ for kind in kinds)
            raise SceneError(f"{path}: {key} = {output[key]!r} in [output]: expected {expected}")
    name = output.get("name", "fields")
    if not name or name.startswith(".") or set(name) & set("/\\\0") or len(name) > 200:  # leads out of its folder
        raise SceneError(
            f"{path}: name = {name[:60]!r} in [output]: expected the name of a file without its folder and suffix"
        )
    encoding = {name: output[name] for name in ("dtype", "digits", "compression") if name in output}
    try:
        Encoding.of(xr.Dataset(), **encoding)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{path}: [output] has {error}") from None
    vtkhdf = output.get("vtkhdf", "")
    if vtkhdf not in ("steps", "temporal", "", False):
        raise SceneError(f"{path}: vtkhdf={vtkhdf!r} in [output]: expected 'steps', 'temporal' or false")
    scene = dict(data["scene"])
    for key in set(_PATHS) & set(scene):
        if key == "walls" and isinstance(scene[key], dict):  # columns of the particles, by names of walls
            continue
        several = [scene[key]] if isinstance(scene[key], str) else scene[key]
        if not isinstance(several, list) or not all(isinstance(p, str) and "\0" not in p for p in several):
            raise SceneError(f"{path}: {key} = {several!r} in [scene]: expected a path, a pattern, or a list of them")
        scene[key] = [str(path.parent / p) for p in several]
    phases = data.get("phases")
    if phases and "mapping" in phases:  # keys of TOML are text
        try:
            mapping = {int(k): v for k, v in phases["mapping"].items()}
            if not all(type(v) is int and 0 <= v < 1 << 31 for v in mapping.values()):
                raise ValueError
            phases = phases | {"mapping": mapping}
        except ValueError:
            raise SceneError(
                f"{path}: mapping = {phases['mapping']!r} in [phases]: expected numbers of types and of phases"
            ) from None
    return Job(
        scene=scene,
        fields=dict(data.get("fields", {})),
        phases=phases,
        slices=data.get("slices"),
        folder=path.parent / output.get("folder", "xcg-output"),
        name=name,
        netcdf=bool(output.get("netcdf", True)),
        vtkhdf=vtkhdf or "",
        encoding=encoding,
        on_error=on_error,
    )
