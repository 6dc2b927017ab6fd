"""A job from files to files: one step after the other, each written as soon as it is there, so that a run resumes."""

from __future__ import annotations

import glob
import hashlib
import inspect
import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path
from typing import Any

import dask
import numpy as np
import xarray as xr

from xcg.fields.coarse_grain import coarse_grain
from xcg.fields.presets.pysammos import pysammos_mesh
from xcg.fields.studies.slice_temperature import slice_temperature
from xcg.jobs.job import Job
from xcg.readers.paths import expand_paths
from xcg.readers.series import open_scene
from xcg.scene.conform import conform
from xcg.scene.phases import assign_phases, find_phases
from xcg.scene.schema import SceneError, unknown
from xcg.steps.each import chunks_of_time, each_step
from xcg.steps.errors import collecting, listen_for_skips
from xcg.steps.label import name_skipped
from xcg.steps.skip import SKIPPED
from xcg.writers.encoding import Encoding
from xcg.writers.files import leftovers, whole_file
from xcg.writers.lock import locked
from xcg.writers.netcdf import write_netcdf

_JOB = "job"  # attribute of the output: which job made it
_BECAUSE = "skipped_because"
_HEADER = 1 << 16  # bytes of a NetCDF file besides its values


def open_job(job: Job) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset | None]:
    """Open the scene of a job and set up its fields, lazily: scene, fields, and sliced temperatures if asked for.

    Raises
    ------
    SceneError
        If an argument is unknown or of a wrong type.
    """
    try:
        return _opened(job)
    except (TypeError, KeyError, AttributeError, IndexError, OverflowError) as error:
        # arguments come from a file, where any type can stand for any other
        raise SceneError(
            f"the job cannot be set up ({type(error).__name__}: {error}); check the types of what its file says"
        ) from error


def _opened(job: Job) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset | None]:
    ds = conform(open_scene(**{**job.scene, "on_error": job.on_error}))  # a step that was saved alone gets its time
    if not ds.sizes["time"]:
        raise SceneError("nothing to do: the scene has no steps")
    options = {**job.fields, "on_error": job.on_error}
    if job.phases is not None:
        assigned = {"edges", "mapping", "by"} & set(job.phases)
        function = assign_phases if assigned else find_phases
        _check_arguments(function, job.phases, "phases")
        if job.on_error == "skip":
            with collecting(), dask.config.set(scheduler="synchronous"):  # in this thread, which tolerates faults
                ds = function(ds, **job.phases)
        else:
            ds = function(ds, **job.phases)
        if len(np.atleast_1d(ds.attrs["phase_values"])) > 1 or assigned:
            options["by"] = "phase"
        else:
            options.pop("by", None)
    _check_arguments(coarse_grain, options, "fields")
    if job.mesh is not None:
        options |= pysammos_mesh(ds, **job.mesh)
    fields = coarse_grain(ds, **options) if options.get("fields", True) else xr.Dataset()
    if not (job.netcdf or job.vtkhdf):  # fields that no file takes are not computed
        fields = xr.Dataset()
    if job.slices is None and not fields.data_vars:
        raise SceneError(
            "nothing to do: no slice is asked for, and no field, or no file for fields (netcdf or vtkhdf of the output)"
        )
    return ds, fields, None if job.slices is None else _slices(ds, job)


def _check_arguments(function: Callable[..., Any], given: Mapping[str, Any], table: str) -> None:
    known = [name for name in inspect.signature(function).parameters if name != "ds"]
    wrong = sorted(set(given) - set(known))
    if wrong:
        raise SceneError(f"[{table}]: {unknown('option', wrong[0], known)}")


def _slices(ds: xr.Dataset, job: Job) -> xr.Dataset:
    options = {"on_error": job.on_error, **(job.slices or {})}
    _check_arguments(slice_temperature, options, "slices")
    options.pop("method", None)
    label = {"planes": "Kamrin", "bins": "LAMMPS"}
    both: list[xr.Dataset] = []
    axis = options.get("axis", "z")
    for method, name in label.items():
        found = slice_temperature(ds, method=method, **options)
        if both:  # both read the same files
            found = found.drop_vars(SKIPPED, errors="ignore")
        both.append(found.rename({n: f"{n}_{name}" for n in found.data_vars} | {axis: f"{axis}_{name}"}))
    return xr.merge(both, combine_attrs="drop_conflicts", join="outer", compat="no_conflicts")


def run_job(
    job: Job, *, overwrite: bool = False, resume: bool = False, jobs: int | None = None
) -> Iterator[tuple[int, int]]:
    """Run a job, yielding the number of steps done and to do after each batch; the files are whole at the end.

    Steps are kept in a hidden folder until all are there. A run that was interrupted goes on where it was, unless the
    job or its input changed.

    Parameters
    ----------
    job : Job
        What to do.
    overwrite : bool
        Replace output that is there.
    resume : bool
        Refuse to start anew where an interrupted run was of another job or other input, and be content where this
        job has ended already.
    jobs : int, optional
        Chunks of time at the same time; as many as there are processors by default.

    Raises
    ------
    FileExistsError
        If an output exists that this job did not leave half done, or another run is writing it.
    SceneError
        If `resume` is asked for and the job or its input changed.
    OSError
        If the disk is full; the steps that are done are kept.
    """
    _, fields, slices = open_job(job)
    mark = _signature(job)
    series = {"fields": fields} if fields.data_vars else {}
    if slices is not None:
        series["slices"] = slices
    series = {name: data.assign_attrs({_JOB: mark}) for name, data in series.items()}
    job.folder.mkdir(parents=True, exist_ok=True)
    stems = [job.name] if "fields" in series else []
    stems += [_slices_name(job)] if slices is not None else []
    with ExitStack() as held:
        for stem in stems:
            held.enter_context(locked(job.folder / f".{stem}.lock", f"{job.folder / stem}"))
        targets = list(_targets(job, fields, slices))
        parts = job.folder / f".{job.name}.parts"
        if not _begin(parts, targets, mark, overwrite=overwrite, resume=resume):
            count = next(iter(series.values())).sizes["time"]
            yield count, count
            return
        chunks = chunks_of_time(series.values())
        yield from _compute(parts, series, chunks, jobs or os.cpu_count() or 1)
        for name in series:
            _assemble(job, name, [_part(parts, name, steps) for steps in chunks])
        done = parts.with_name(f"{parts.name}.{uuid.uuid4().hex[:8]}")
        parts.rename(done)  # at once, so that no half of it is taken for a run to go on with
        shutil.rmtree(done)


def _begin(parts: Path, targets: list[Path], mark: str, *, overwrite: bool, resume: bool) -> bool:
    """Make the folder of steps, or keep the one that is there; False where the job has ended already."""
    begun = (parts / "job").exists() and (parts / "job").read_text() == mark
    there = [path for path in targets if path.exists()]
    if resume and not begun and not overwrite:
        if targets and there == targets and all(_made_by(path) == mark for path in targets):
            return False
        if (parts / "job").exists():
            raise SceneError(
                f"{parts} is of a run whose job or input was another: files changed, or were added, since; start over "
                "without --resume, or with --overwrite"
            )
    if there and not (overwrite or begun):
        raise FileExistsError(f"{there[0]} exists; choose another output folder or name, or overwrite it (--overwrite)")
    for old in parts.parent.glob(f"{glob.escape(parts.name)}.*"):
        shutil.rmtree(old, ignore_errors=True)
    for target in targets:
        for left in leftovers(target):
            left.unlink(missing_ok=True)
    if not begun:
        shutil.rmtree(parts, ignore_errors=True)
        parts.mkdir()
        with whole_file(parts / "job", overwrite=True) as path:
            path.write_text(mark)
    return True


def _made_by(path: Path) -> str | None:
    """Which job wrote a file."""
    import h5py

    try:
        with h5py.File(path) as file:
            found = file.get("xcg", file).attrs.get(_JOB)
    except OSError:
        return None
    return found.decode() if isinstance(found, bytes) else found


def _part(parts: Path, name: str, steps: slice) -> Path:
    return parts / f"{name}.{steps.start}-{steps.stop}.nc"


def _compute(
    parts: Path, series: Mapping[str, xr.Dataset], chunks: Sequence[slice], batch: int
) -> Iterator[tuple[int, int]]:
    """Write the chunks of time that are not there, some at a time."""
    todo = [steps for steps in chunks if not all(_part(parts, name, steps).exists() for name in series)]
    count, left = chunks[-1].stop, sum(steps.stop - steps.start for steps in todo)
    yield count - left, count
    for first in range(0, len(todo), batch):
        some = todo[first : first + batch]
        for name, data in series.items():
            with listen_for_skips() as causes:
                computed = dask.compute(*(data.isel(time=steps) for steps in some))
            for steps, chunk in zip(some, computed, strict=True):
                numbers = chunk["step"].to_numpy().tolist() if "step" in chunk.coords else []
                here = {str(number): causes[number] for number in numbers if number in causes}
                marked = chunk.assign_attrs({_BECAUSE: json.dumps(here)}) if here else chunk
                with whole_file(_part(parts, name, steps), overwrite=True, room=chunk.nbytes + _HEADER) as path:
                    marked.to_netcdf(path, engine="netcdf4")
        left -= sum(steps.stop - steps.start for steps in some)
        yield count - left, count


def _signature(job: Job) -> str:
    """Tell a job apart from another, and from itself with other input or another version of xcg."""
    paths: list[str] = []
    for key in ("particles", "contacts", "walls", "restart"):
        given = job.scene.get(key, [])
        if isinstance(given, dict):  # walls that are columns of the particles
            continue
        for path in [given] if isinstance(given, str) else given:
            paths += expand_paths([path], key) if glob.has_magic(path) and not Path(path).exists() else [path]
    # a folder of Zarr keeps its own time when one of its files changes
    files = [file for path in map(Path, paths) for file in (path, *sorted(path.rglob("*"))) if file.exists()]
    states = [(str(file), file.stat().st_mtime_ns, file.stat().st_size) for file in files]
    text = repr(job) + repr(states) + version("xcg")
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


def _assemble(job: Job, name: str, parts: list[Path]) -> None:
    """One file with all steps, and VTKHDF, from the files of the chunks."""
    from xcg.writers.vtkhdf import to_vtkhdf

    opened = [xr.open_dataset(path, chunks={}) for path in parts]
    try:
        failed = [json.loads(chunk.attrs.pop(_BECAUSE)) for chunk in opened if _BECAUSE in chunk.attrs]
        causes = [f"step {step}: {cause}" for chunk in failed for step, cause in chunk.items()]
        whole = xr.concat(opened, "time", data_vars="all", coords="minimal", compat="override", join="override",
                          combine_attrs="override")  # fmt: skip
        if SKIPPED in whole.coords:
            whole = name_skipped(whole.assign_coords({SKIPPED: whole[SKIPPED].compute()}))
        if causes:
            whole = whole.assign_attrs({_BECAUSE: "\n".join(causes)})
        stem = job.name if name == "fields" else _slices_name(job)
        if job.netcdf or name == "slices":
            file = job.folder / f"{stem}{job.suffix}"
            write_netcdf(whole, file, Encoding.of(whole, **job.encoding), overwrite=True, room=whole.nbytes + _HEADER)
        if name == "slices":
            return
        paths = _vtkhdf_paths(job, whole)
        if job.vtkhdf == "steps":
            for step, path in zip(each_step(whole), paths, strict=True):
                to_vtkhdf(step, path, overwrite=True, **job.encoding)
        elif paths:
            to_vtkhdf(whole, paths[0], overwrite=True, **job.encoding)
    finally:
        for data in opened:
            data.close()
