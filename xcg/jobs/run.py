"""A job from files to files, which resumes: each step is written as soon as it is computed."""

from __future__ import annotations

import glob
import hashlib
import inspect
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import dask
import numpy as np
import xarray as xr

from xcg.analysis.slice_temperature import SliceMethod, slice_temperature
from xcg.common.messages import SceneError, unknown
from xcg.fields.coarse_grain import coarse_grain
from xcg.fields.presets.pysammos import pysammos_mesh
from xcg.jobs.job import PATHS, Job
from xcg.readers.open import open_scene
from xcg.readers.paths import expand_paths
from xcg.scene.conform import conform
from xcg.scene.phases import assign_phases, find_phases
from xcg.steps.faults import SKIPPED, collecting
from xcg.writers.encoding import Encoding
from xcg.writers.files import leftovers, lock_of, publish, work_folder
from xcg.writers.formats import NETCDF
from xcg.writers.interrupted import Mismatch
from xcg.writers.store import Output, write_file, write_files
from xcg.writers.store_layout import Format, Parts, StoreLayout, joined
from xcg.writers.vtkhdf import VTKHDF

_JOB = "job"  # attribute of the output: which job made it


def open_job(job: Job) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset | None]:
    """Open the scene of a job and set up its fields, lazily.

    Returns
    -------
    ds, fields : xarray.Dataset
        The scene, and its fields: none unless the job asks for fields and a file for them.
    slices : xarray.Dataset or None
        Sliced temperatures, if they are asked for.

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
            f"the job cannot be set up ({type(error).__name__}: {error}); "
            "check the types of what its file says"
        ) from error


def _opened(job: Job) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset | None]:
    ds = open_scene(**{**job.scene, "on_error": job.on_error})
    ds = conform(ds)  # a step that was saved alone gets its time
    if not ds.sizes["time"]:
        raise SceneError("nothing to do: the scene has no steps")
    options = {**job.fields, "on_error": job.on_error}
    if job.phases is not None:
        assigned = {"edges", "mapping", "by"} & set(job.phases)
        function: Callable[..., xr.Dataset] = find_phases
        if assigned:
            function = assign_phases
        _check_arguments(function, job.phases, "phases")
        if job.on_error == "skip":
            # in this thread, which tolerates faults
            with collecting(), dask.config.set(scheduler="synchronous"):
                ds = function(ds, **job.phases)
        else:
            ds = function(ds, **job.phases)
        if assigned or np.size(ds.attrs["phase_values"]) > 1:
            options["by"] = "phase"
        else:
            options.pop("by", None)
    _check_arguments(coarse_grain, options, "fields")
    if job.mesh is not None:
        options |= pysammos_mesh(ds, **job.mesh)
    fields = xr.Dataset()
    # fields that no file takes are not computed
    if options.get("fields", True) and (job.netcdf or job.vtkhdf):
        fields = coarse_grain(ds, **options)
    if job.slices is None and not fields.data_vars:
        raise SceneError(
            "nothing to do: no slice is asked for, and no field, or no file for fields "
            "(netcdf or vtkhdf of the output)"
        )
    slices = None
    if job.slices is not None:
        slices = _slices(ds, job)
    return ds, fields, slices


def _check_arguments(function: Callable[..., Any], options: Mapping[str, Any], table: str) -> None:
    names = [name for name in inspect.signature(function).parameters if name != "ds"]
    wrong = sorted(set(options) - set(names))
    if wrong:
        raise SceneError(f"[{table}]: {unknown('option', wrong[0], names)}")


def _slices(ds: xr.Dataset, job: Job) -> xr.Dataset:
    options = {"on_error": job.on_error, **(job.slices or {})}
    _check_arguments(slice_temperature, options, "slices")
    options.pop("method", None)
    label: dict[SliceMethod, str] = {"planes": "Kamrin", "bins": "LAMMPS"}
    results: list[xr.Dataset] = []
    axis = options.get("axis", "z")
    for method, name in label.items():
        temperatures = slice_temperature(ds, method=method, **options)
        if results:  # both methods read the same files, and skip the same steps
            temperatures = temperatures.drop_vars(SKIPPED, errors="ignore")
        renamed = [axis, *temperatures.data_vars]
        results.append(temperatures.rename({old: f"{old}_{name}" for old in renamed}))
    return xr.merge(results, combine_attrs="drop_conflicts", join="outer", compat="no_conflicts")


def run_job(
    job: Job, *, overwrite: bool = False, resume: bool = False, jobs: int | None = None
) -> Iterator[tuple[int, int]]:
    """Run a job, yielding (steps done, steps in total) after each batch.

    Files are written step by step in a hidden folder until all steps are there. A run that was
    interrupted goes on where it was, unless the job or its input changed.

    Parameters
    ----------
    job : Job
        What to do.
    overwrite : bool
        Replace output that is there.
    resume : bool
        Refuse to start anew where an interrupted run was of another job or other input, and be
        content where this job has ended already.
    jobs : int, optional
        Chunks of time at the same time; as many as there are processors by default. A cluster takes
        as many as it has threads.

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
    about = _description(job)
    mark = hashlib.sha256(f"{about}{version('xcg')}".encode()).hexdigest()
    outputs = outputs_of(job, fields, slices, mark)
    job.folder.mkdir(parents=True, exist_ok=True)
    count = outputs[0].output.ds.sizes["time"]
    targets = [path for of_job in outputs for path in of_job.paths]
    work = work_of(job)
    is_begun = (work / "state.json").exists()
    # also by a run that was killed at its very end
    is_interrupted = work.exists() or lock_of(work).exists() or bool(leftovers(work))
    existing = [path for path in targets if path.exists()]
    if (
        (resume or is_interrupted)
        and not (is_begun or overwrite)
        and existing == targets
        and all(_made_by(path) == mark for path in targets)
    ):
        with work_folder(work, work):  # which removes it
            pass
        yield count, count
        return
    if existing and not (overwrite or is_begun):
        raise _exists(existing[0], other_job=resume)
    replaced: list[Path] = []
    if overwrite:
        replaced = _images_of(job, targets)
    write = partial(
        write_files,
        [of_job.output for of_job in outputs],
        overwrite=True,
        work=work,
        about=about,
        batch=jobs or os.cpu_count() or 1,
        replaced=replaced,
    )
    try:
        for done in write():
            yield done, count
    except Mismatch as error:
        if resume and not overwrite:
            options = [change for change in error.changed if change.startswith("[")]
            changed = options or error.changed
            raise SceneError(
                f"{error.folder} is of a run of another job or other input ({'; '.join(changed)}); "
                "start over without --resume, or with --overwrite"
            ) from error
        if existing and not overwrite:
            raise _exists(existing[0]) from None
        shutil.rmtree(work, ignore_errors=True)
        for done in write():
            yield done, count


def work_of(job: Job) -> Path:
    """Return the hidden folder of a job's incomplete files."""
    return job.folder / f".{job.name}.begun"


def _images_of(job: Job, kept: list[Path]) -> list[Path]:
    """List the VTKHDF files of a run that this one replaces, except new ones."""
    images = []
    for path in job.folder.glob(f"{glob.escape(job.name)}*.vtkhdf"):
        is_image = re.fullmatch(rf"{re.escape(job.name)}(_\d+)?", path.stem)
        if is_image and path not in kept and _made_by(path):
            images.append(path)
    return images


@dataclass(frozen=True)
class JobOutput:
    """Output of a job: its fields or slices, and the names of their files."""

    output: Output
    paths: list[Path]


def outputs_of(
    job: Job, fields: xr.Dataset, slices: xr.Dataset | None, mark: str = ""
) -> list[JobOutput]:
    """List what a job writes, from what `open_job` returns; `mark` is noted in the files."""
    outputs: list[JobOutput] = []
    if fields.data_vars:
        files: dict[Path, Format] = {}
        images: list[Path] = []
        if job.netcdf:
            files[job.folder / f"{job.name}{job.suffix}"] = NETCDF
        if job.vtkhdf == "temporal":
            files[job.folder / f"{job.name}.vtkhdf"] = VTKHDF
        paths = list(files)
        if job.vtkhdf == "steps":
            numbers = fields["step"].to_numpy()
            images = [job.folder / f"{job.name}_{int(n):04d}.vtkhdf" for n in numbers]
            begin = partial(_Images, [path.name for path in images])
            by_steps = Format("VTKHDF by steps", begin, whole=partial(_whole_images, images))
            files[job.folder / f"{job.name}.images"] = by_steps
        outputs.append(_output(job, fields, mark, files, [*paths, *images]))
    if slices is not None:
        stem = f"{job.name}_slices"
        if job.suffix == ".h5":
            stem = "CG_GranularTemperature_slices"
        path = job.folder / f"{stem}{job.suffix}"
        outputs.append(_output(job, slices, mark, {path: NETCDF}, [path]))
    return outputs


def _output(
    job: Job, ds: xr.Dataset, mark: str, files: dict[Path, Format], paths: list[Path]
) -> JobOutput:
    encoding = Encoding.of(ds, **job.encoding)
    return JobOutput(Output(ds.assign_attrs({_JOB: mark}), files, encoding), paths)


def _exists(path: Path, *, other_job: bool = False) -> FileExistsError:
    message = f"{path} exists"
    if other_job:
        message += ", of another job or other input"
    return FileExistsError(
        f"{message}; choose another output folder or name, or overwrite it (--overwrite)"
    )


class _Images:
    """VTKHDF files of one step each, in a folder."""

    def __init__(self, files: list[str], layout: StoreLayout, folder: Path, begun: bool) -> None:
        folder.mkdir(exist_ok=True)
        names = [name for name in layout.over if name in layout.ds.data_vars]
        self._ds = layout.ds.drop_vars(layout.over)
        self._about = {name: (layout.ds[name].dims, layout.ds[name].attrs) for name in names}
        self._encoding = layout.encoding
        self._paths = [folder / file for file in files]

    def __call__(self, parts: Parts, steps: slice) -> None:
        """Write the files of these steps."""
        values = {
            name: (dims, joined(parts[name]), attrs) for name, (dims, attrs) in self._about.items()
        }
        fields = self._ds.isel(time=steps).assign(values)
        for t, path in enumerate(self._paths[steps]):
            write_file(fields.isel(time=[t]), path, self._encoding, VTKHDF, overwrite=True)

    def describe(self, attrs: Mapping[str, Any]) -> None:
        """Add nothing: images say nothing of other steps."""


@contextmanager
def _whole_images(images: list[Path], path: Path, *, overwrite: bool, part: Path) -> Iterator[Path]:
    """Rename the files in the folder `part` at the end."""
    yield part
    for image in images:
        if (part / image.name).exists():  # else a run that was killed has given it its name
            publish(part / image.name, image, overwrite=overwrite)


def _made_by(path: Path) -> str | None:
    """Return the signature of the job that wrote a file."""
    import h5py

    with suppress(OSError), h5py.File(path) as file:
        mark = file.get("xcg", file).attrs.get(_JOB)
        if mark is not None:
            return str(np.asarray(mark).astype(str))
    return None


def _description(job: Job) -> dict[str, str]:
    """Describe a job by its options and the state of its input, under names for messages."""
    paths: list[str] = []
    for key in PATHS:
        value = job.scene.get(key, [])
        if isinstance(value, dict):  # walls that are columns of the particles
            continue
        for path in np.atleast_1d(value).tolist():
            if glob.has_magic(path) and not Path(path).exists():
                paths += expand_paths([path], key)
            else:
                paths.append(path)
    files: list[Path] = []
    for path in map(Path, paths):
        # a folder of Zarr keeps its own time when one of its files changes
        files += [file for file in (path, *sorted(path.rglob("*"))) if file.exists()]
    states = repr([(str(file), file.stat().st_mtime_ns, file.stat().st_size) for file in files])
    digest = hashlib.sha256(states.encode()).hexdigest()
    about = {"[scene] sizes and times of files": f"{len(files)}, {digest[:8]}"}
    for option, value in vars(job).items():
        if option == "scheduler":  # results are the same wherever they are computed
            continue
        if not isinstance(value, dict):
            about[f"[{option}]"] = repr(value)
            continue
        for key, entry in value.items():
            about[f"[{option}] {key}"] = repr(entry)
    return about
