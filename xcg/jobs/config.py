"""Files that describe a job for the command line: Pysammos's ``config.ini`` as it stands, and TOML."""

from __future__ import annotations

import tomllib
from pathlib import Path

import xarray as xr

from xcg.common.messages import SceneError
from xcg.jobs.job import Job, _of_type, _on_error, _plain_name
from xcg.jobs.pysammos_ini import _ini
from xcg.writers.encoding import Encoding


def read_config(path: str | Path) -> Job:
    """Read a job from ``.toml`` or from Pysammos's ``.ini``; paths in it are relative to its folder.

    Raises
    ------
    FileNotFoundError
        If the file does not exist, or names files of which there are none.
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
        return _toml(path) if path.suffix.lower() == ".toml" else _ini(path)
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: is no text in UTF-8 ({error.reason} at byte {error.start})") from None
    except (TypeError, AttributeError, RecursionError) as error:  # tables where values should be, and the like
        raise SceneError(
            f"{path}: cannot be understood ({error}); see the form of a job in the documentation"
        ) from None


# --- TOML ------------------------------------------------------------------------------------------------

_TABLES = ("scene", "phases", "fields", "slices", "output")
_OUTPUT = ("folder", "name", "netcdf", "vtkhdf", "dtype", "digits", "compression")
_PATHS = ("particles", "contacts", "walls", "restart")


def _toml(path: Path) -> Job:
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{path}: {error}") from None
    on_error = _on_error(str(path), data.pop("on_error", "raise"))
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
    _of_type(path, "output", output, {"folder": str, "name": str, "netcdf": bool, "vtkhdf": (str, bool)})
    encoding = {name: output[name] for name in ("dtype", "digits", "compression") if name in output}
    try:
        Encoding.of(xr.Dataset(), **encoding)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{path}: [output] has {error}") from None
    vtkhdf = output.get("vtkhdf", "")
    if vtkhdf not in ("steps", "temporal", "", False):
        raise SceneError(f"{path}: vtkhdf={vtkhdf!r} in [output]: expected 'steps', 'temporal' or false")
    scene = dict(data["scene"])
    for name in set(_PATHS) & set(scene):
        if name == "walls" and isinstance(scene[name], dict):  # columns of the particles, by names of walls
            continue
        several = [scene[name]] if isinstance(scene[name], str) else scene[name]
        if not isinstance(several, list) or not all(isinstance(p, str) and "\0" not in p for p in several):
            raise SceneError(f"{path}: {name} = {several!r} in [scene]: expected a path, a pattern, or a list of them")
        scene[name] = [str(path.parent / p) for p in several]
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
    fields = dict(data.get("fields", {}))
    if phases is not None:
        fields.setdefault("by", "phase")
    return Job(
        scene=scene,
        fields=fields,
        phases=phases,
        slices=data.get("slices"),
        folder=path.parent / output.get("folder", "xcg-output"),
        name=_plain_name(path, output.get("name", "fields")),
        netcdf=bool(output.get("netcdf", True)),
        vtkhdf=vtkhdf or "",
        encoding=encoding,
        on_error=on_error,
    )


# --- Pysammos's config.ini -------------------------------------------------------------------------------
