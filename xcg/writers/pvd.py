"""ParaView's lists of files of one step each, with their times (``.pvd``)."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import xarray as xr

from xcg.readers.files.vtp import read_collection
from xcg.scene.schema import SceneError
from xcg.steps.each import each_step
from xcg.writers.files import check_file, check_target, publish, whole_file
from xcg.writers.folders import hidden_folder
from xcg.writers.vtkhdf import times_of


def write_series(
    fields: xr.Dataset, path: Path, suffix: str, write: Callable[[xr.Dataset, Path], None], *, overwrite: bool
) -> None:
    """Compute and write steps one by one, as ``name_0000`` and so on with a suffix, and their list as ``name.pvd``.

    All steps are written, in a hidden folder, before the first of them gets its name. An old list goes before its steps
    are replaced and the new one comes last, so that a list never names steps of two series; old steps that the new
    series does not have are removed in the end.

    Parameters
    ----------
    fields : xarray.Dataset
        `write` is given each of its steps, computed, with the name of its file.
    path : Path
        The list.
    suffix : str
        That of the files.
    overwrite : bool
        Replace files that exist.

    Raises
    ------
    FileExistsError, FileNotFoundError
        If a file exists and `overwrite` is False, or the folder is not there; before anything is written.
    IsADirectoryError
        If a name is that of a folder; likewise.
    ValueError
        If times are no numbers that rise; likewise.
    """
    known = times_of(fields)
    times = np.zeros(1) if known is None else known
    names = [path.with_name(f"{path.stem}_{t:04d}{suffix}") for t in range(len(times))]
    for name in (*names, path):
        check_file(name, overwrite=overwrite)
    rows = "".join(
        f'    <DataSet timestep="{float(time)!r}" part="0" file={quoteattr(name.name)}/>\n'
        for time, name in zip(times, names, strict=True)
    )
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    with hidden_folder(path) as folder:
        for step, name in zip(each_step(fields), names, strict=True):
            write(step, folder / name.name)
        old = _steps_of(path, suffix)
        check_target(path, overwrite=overwrite)
        path.unlink(missing_ok=True)
        for name in names:
            publish(folder / name.name, name, overwrite=overwrite)
    with whole_file(path, overwrite=overwrite) as part:
        part.write_text(f"{head}{rows}  </Collection>\n</VTKFile>\n")
    for name in old - set(names):
        name.unlink(missing_ok=True)


def _steps_of(path: Path, suffix: str) -> set[Path]:
    """Files of the series that a list names, none but those that this module gives a name to."""
    if not path.exists():
        return set()
    with suppress(SceneError):  # a list by another hand, or damaged
        listed = {Path(name) for name, _ in read_collection(str(path))}
        own = re.compile(rf"{re.escape(path.stem)}_\d{{4,}}{re.escape(suffix)}")
        return {name for name in listed if name.parent == path.parent and own.fullmatch(name.name)}
    return set()
