"""A job from files to files: one step after the other, each written as soon as it is there, so that a run resumes."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from xcg.cli.config import Job
from xcg.coarse_grain import coarse_grain
from xcg.phases import assign_phases, find_phases
from xcg.plan import choose_width
from xcg.pysammos import pysammos_mesh
from xcg.readers.series import open_scene
from xcg.scene import setup_of
from xcg.schema import COMPONENTS
from xcg.slices import slice_temperature
from xcg.smoothing import as_kernel


def open_job(job: Job) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset | None]:
    """Open the scene of a job and set up its fields, lazily: scene, fields, and sliced temperatures if asked for."""
    ds = open_scene(**job.scene)
    options = dict(job.fields)
    if job.phases is not None:
        assigned = {"edges", "mapping", "by"} & set(job.phases)
        ds = assign_phases(ds, **job.phases) if assigned else find_phases(ds, **job.phases)
        if len(np.atleast_1d(ds.attrs["phase_values"])) > 1 or assigned:
            options["by"] = "phase"
        else:
            options.pop("by", None)
    if job.mesh is not None:
        options |= pysammos_mesh(ds, job.mesh, kernel=options.get("kernel", "lucy"))
    elif options.get("preset") == "pysammos":
        options = _own_mesh(ds, options, job.middle)
    fields = coarse_grain(ds, **options) if options.get("fields", True) else xr.Dataset()
    slices = None
    if job.slices is not None:
        both = {m: slice_temperature(ds, **job.slices, method=m) for m in ("planes", "bins")}
        label = {"planes": "Kamrin", "bins": "LAMMPS"}
        axis = job.slices.get("axis", "z")
        slices = xr.merge(
            [
                s.rename({name: f"{name}_{label[m]}" for name in s.data_vars} | {axis: f"{axis}_{label[m]}"})
                for m, s in both.items()
            ],
            combine_attrs="drop_conflicts",
        )
    return ds, fields, slices


def _own_mesh(ds: xr.Dataset, options: dict[str, Any], middle: str) -> dict[str, Any]:
    """Bounds and cuts as given, spacing c / 2; axes that the scene lacks (one layer) need no cut."""
    setup = setup_of(ds)
    kernel = as_kernel(options.get("kernel", "lucy"), choose_width(options.get("width"), ds.attrs), setup.dimension)
    at = {a: cut for a, cut in options.get("at", {}).items() if a in setup.plane}
    for a in middle:
        if a in setup.plane:
            k = COMPONENTS.index(a)
            at[a] = 0.5 * float(ds.attrs["particle_lower"][k] + ds.attrs["particle_upper"][k])
    return {"spacing": kernel.cutoff / 2, **options, "at": at}


def run_job(job: Job, *, overwrite: bool = False, jobs: int | None = None) -> Iterator[tuple[int, int]]:
    """Run a job, yielding the number of steps done and to do after each batch; the files are whole at the end.

    Steps are kept in a hidden folder until all are there. A run that was interrupted goes on where it was, unless the
    job or its input changed.

    Raises
    ------
    FileExistsError
        If an output exists that this job did not leave half done.
    """
    _, fields, slices = open_job(job)
    job.folder.mkdir(parents=True, exist_ok=True)
    parts = job.folder / f".{job.name}.parts"
    mark = _signature(job)
    begun = (parts / "job").exists() and (parts / "job").read_text() == mark
    targets = list(_targets(job, fields, slices))
    there = [path for path in targets if path.exists()]
    if there and not (overwrite or begun):
        msg = f"{there[0]} exists; choose another output folder or name, or overwrite it (--overwrite)"
        raise FileExistsError(msg)
    if not begun:
        shutil.rmtree(parts, ignore_errors=True)
        parts.mkdir()
        (parts / "job").write_text(mark)
    series = {"fields": fields} if fields.data_vars else {}
    if slices is not None:
        series["slices"] = slices
    count = next(iter(series.values())).sizes["time"]
    todo = [t for t in range(count) if not all((parts / f"{name}.{t}.nc").exists() for name in series)]
    batch = jobs or os.cpu_count() or 1
    yield count - len(todo), count
    for first in range(0, len(todo), batch):
        some = todo[first : first + batch]
        for name, data in series.items():
            computed = data.isel(time=some).compute()
            for k, t in enumerate(some):
                _whole(parts / f"{name}.{t}.nc", computed.isel(time=[k]).to_netcdf)
        yield count - len(todo) + first + len(some), count
    for name in series:
        _assemble(job, name, [parts / f"{name}.{t}.nc" for t in range(count)])
    shutil.rmtree(parts)


def _signature(job: Job) -> str:
    """Tell a job apart from another, and from itself with other input."""
    paths = [p for key in ("particles", "contacts", "walls") for p in job.scene.get(key, []) if Path(p).exists()]
    text = repr(job) + repr([(p, os.stat(p).st_mtime_ns, os.stat(p).st_size) for p in paths])
    return hashlib.sha256(text.encode()).hexdigest()


def _targets(job: Job, fields: xr.Dataset, slices: xr.Dataset | None) -> Iterator[Path]:
    if fields.data_vars:
        if job.netcdf:
            yield job.folder / f"{job.name}{job.suffix}"
        yield from _vtkhdf_paths(job, fields)
    if slices is not None:
        yield job.folder / f"{_slices_name(job)}{job.suffix}"


def _slices_name(job: Job) -> str:
    return "CG_GranularTemperature_slices" if job.suffix == ".h5" else f"{job.name}_slices"


def _vtkhdf_paths(job: Job, fields: xr.Dataset) -> list[Path]:
    if job.vtkhdf == "steps":
        return [job.folder / f"{job.name}_{int(step):04d}.vtkhdf" for step in fields["step"].to_numpy()]
    return [job.folder / f"{job.name}.vtkhdf"] if job.vtkhdf else []


def _whole(path: Path, write: Callable[[Path], Any]) -> None:
    """Write a file under another name first, so that it is there only when it is whole."""
    part = path.with_name(f".{path.name}.part")
    write(part)
    os.replace(part, path)


def _assemble(job: Job, name: str, parts: list[Path]) -> None:
    """One file with all steps, and VTKHDF, from the files of the steps."""
    from xcg.writers.vtkhdf import to_vtkhdf

    opened = [xr.open_dataset(path, chunks={}) for path in parts]
    try:
        whole = xr.concat(opened, "time", data_vars="all", coords="minimal", compat="override", join="override",
                          combine_attrs="override")  # fmt: skip
        if name == "slices":
            _whole(job.folder / f"{_slices_name(job)}{job.suffix}", lambda p: whole.to_netcdf(p, engine="netcdf4"))
            return
        if job.netcdf:
            _whole(job.folder / f"{job.name}{job.suffix}", lambda p: whole.to_netcdf(p, engine="netcdf4"))
        paths = _vtkhdf_paths(job, whole)
        if job.vtkhdf == "steps":
            for path, step in zip(paths, opened, strict=True):
                to_vtkhdf(step, path, overwrite=True)
        elif paths:
            to_vtkhdf(whole, paths[0], overwrite=True)
    finally:
        for data in opened:
            data.close()
