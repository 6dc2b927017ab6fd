"""ParaView's lists of files of one step each, with their times (``.pvd``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import xarray as xr
from numpy.typing import NDArray

from xcg.writers.files import check_target, whole_file


def write_series(
    steps: Sequence[xr.Dataset], times: NDArray, path: Path, suffix: str,
    write: Callable[[xr.Dataset, Path], None], *, overwrite: bool,
) -> None:  # fmt: skip
    """Compute and write steps one by one, as ``name_0000`` and so on with a suffix, and their list as ``name.pvd``.

    Parameters
    ----------
    steps : sequence of xarray.Dataset
        What `write` is given, computed, with the name of its file.
    times : array (steps,)
        Their times.
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
    """
    names = [path.with_name(f"{path.stem}_{t:04d}{suffix}") for t in range(len(steps))]
    for name in (*names, path):
        check_target(name, overwrite=overwrite)
    for step, name in zip(steps, names, strict=True):
        write(step.compute(), name)
    rows = "".join(
        f'    <DataSet timestep="{float(time)!r}" part="0" file={quoteattr(name.name)}/>\n'
        for time, name in zip(times, names, strict=True)
    )
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n  <Collection>\n'
    with whole_file(path, overwrite=overwrite) as part:
        part.write_text(f"{head}{rows}  </Collection>\n</VTKFile>\n")
