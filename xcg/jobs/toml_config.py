"""Jobs in TOML."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import xarray as xr

from xcg.common.messages import SceneError
from xcg.jobs.job import PATHS, Job
from xcg.writers.encoding import Encoding

_TABLES = ("scene", "phases", "fields", "slices", "output")
_OUTPUT: dict[str, tuple[type, ...]] = {
    "folder": (str,),
    "name": (str,),
    "netcdf": (bool,),
    "vtkhdf": (str, bool),
}
_ENCODING = ("dtype", "digits", "compression")


def read_toml(path: Path) -> Job:
    """Read a job from TOML; raise SceneError naming the table and key that is wrong."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{path}: {error}") from None
    on_error = data.pop("on_error", "raise")
    scheduler = data.pop("scheduler", "")
    if not isinstance(scheduler, str):
        raise SceneError(
            f"{path}: scheduler = {scheduler!r}: expected an address, such as 'tcp://10.0.0.1:8786'"
        )
    unknown = [name for name in data if name not in _TABLES or not isinstance(data[name], dict)]
    if unknown or "particles" not in data.get("scene", {}):
        tables = ", ".join(_TABLES)
        raise SceneError(
            f"{path}: expected tables {tables} with scene.particles, on_error and scheduler; "
            f"found {sorted(data)}"
        )
    output = data.get("output", {})
    _check_output(path, output)
    encoding = {name: output[name] for name in _ENCODING if name in output}
    try:
        Encoding.of(xr.Dataset(), **encoding)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{path}: [output] has {error}") from None
    scene = _with_paths(path, data["scene"])
    phases = data.get("phases")
    if phases and "mapping" in phases:
        table = phases["mapping"]  # TOML's keys are text
        try:
            phases = phases | {"mapping": {int(kind): phase for kind, phase in table.items()}}
        except ValueError:
            raise SceneError(
                f"{path}: mapping = {table!r} in [phases]: expected numbers of types and of phases"
            ) from None
    return Job(
        scene=scene,
        fields=dict(data.get("fields", {})),
        phases=phases,
        slices=data.get("slices"),
        folder=path.parent / output.get("folder", "xcg-output"),
        name=output.get("name", "fields"),
        netcdf=bool(output.get("netcdf", True)),
        vtkhdf=output.get("vtkhdf") or "",
        encoding=encoding,
        on_error=on_error,
        scheduler=scheduler,
    )


def _check_output(path: Path, output: dict[str, Any]) -> None:
    """Raise SceneError for a key or value of the table ``[output]`` that is not allowed."""
    allowed = (*_OUTPUT, *_ENCODING)
    wrong = [name for name in output if name not in allowed]
    if wrong:
        raise SceneError(f"{path}: [output] has {wrong}; expected any of {', '.join(allowed)}")
    for key, kinds in _OUTPUT.items():
        if key in output and not isinstance(output[key], kinds):
            expected = " or ".join(kind.__name__ for kind in kinds)
            raise SceneError(f"{path}: {key} = {output[key]!r} in [output]: expected {expected}")
    name = output.get("name", "fields")
    if not name or name.startswith(".") or set(name) & set("/\\\0"):
        raise SceneError(
            f"{path}: name = {name!r} in [output]: expected the name of a file "
            "without its folder and suffix"
        )
    vtkhdf = output.get("vtkhdf", "")
    if vtkhdf not in ("steps", "temporal", "", False):
        raise SceneError(
            f"{path}: vtkhdf={vtkhdf!r} in [output]: expected 'steps', 'temporal' or false"
        )


def _with_paths(path: Path, scene: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table ``[scene]`` with its paths relative to the folder of the file at `path`."""
    scene = dict(scene)
    for key in set(PATHS) & set(scene):
        walls_are_columns = key == "walls" and isinstance(scene[key], dict)
        if walls_are_columns:
            continue
        files = scene[key]
        if isinstance(files, str):
            files = [files]
        if not isinstance(files, list) or not all(
            isinstance(file, str) and "\0" not in file for file in files
        ):
            raise SceneError(
                f"{path}: {key} = {files!r} in [scene]: expected a path, a pattern, "
                "or a list of them"
            )
        scene[key] = [str(path.parent / file) for file in files]
    return scene
