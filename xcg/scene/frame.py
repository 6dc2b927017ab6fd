"""Frames, one step of a scene as plain arrays, and back; times of the steps; sizes and extent of the particles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_whole
from xcg.common.messages import SceneError, plain
from xcg.scene.lattice import Lattice
from xcg.scene.schema import (
    BOX,
    OF_STEP,
    PADDING,
    VARIABLES,
    Frame,
    variable,
)

T = TypeVar("T", xr.Dataset, xr.DataArray)


def with_rising(f: T, dims: Iterable[str]) -> T:
    """Sort data along dimensions whose coordinates do not rise, as after ``isel(x=slice(None, None, -1))``."""
    indexes = {dim: f.indexes[dim] for dim in dims if dim in f.indexes}
    others = [dim for dim, index in indexes.items() if not index.is_monotonic_increasing]
    if not others:
        return f
    return f.sortby(others)


def with_time(ds: xr.Dataset) -> xr.Dataset:
    """Name the dimension of the steps "time" where it goes by their numbers (``swap_dims(time="step")``)."""
    if "step" in ds.sizes and "time" not in ds.sizes and "time" in ds.coords:
        ds = ds.swap_dims(step="time")
    return ds


def require_steps(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for data whose dimension of time is empty, as after a selection."""
    if not ds.sizes.get("time", 1):
        raise SceneError(f"{purpose}: there is no step; select one at least")


def step_at(ds: xr.Dataset, index: int) -> xr.Dataset:
    """Select a step by its position; data without a dimension of time are one step.

    Raises
    ------
    ValueError
        If the step does not exist, or none.
    """
    ds = with_time(ds)
    require_steps(ds, f"index={plain(index)}")
    count = ds.sizes.get("time", 1)
    if not (isinstance(index, int | np.integer) and is_whole(index, -count, count - 1)):
        raise ValueError(
            f"index={plain(index)}: expected the position of a step, a whole number from {-count} to {count - 1}; "
            "select a time by .sel(time=...)"
        )
    if "time" in ds.sizes:
        ds = ds.isel(time=int(index))
    return ds


def frame_at(ds: xr.Dataset, index: int, names: Iterable[str]) -> tuple[Frame, Lattice, str]:
    """Compute some variables of the step at a position: its frame, periodic images and name; errors as `step_at`."""
    step = step_at(ds, index)
    wanted = {*names, *OF_STEP}
    step = step[[name for name in step.variables if name in wanted]].compute()
    arrays = {
        str(name): values.to_numpy()[None]
        for name, values in step.variables.items()
        if name in wanted
    }
    return next(steps_in(arrays, str(ds.attrs.get("periodic", ""))))


def stack(frames: Sequence[Frame], names: Sequence[str], length: int) -> Frame:
    """Stack frames along a new first axis, padded to `length` rows; one frame that fills them is not copied."""
    stacked = {}
    for name in names:
        row = variable(name, frames[0][name].dtype, frames[0][name].ndim)
        if len(frames) == 1 and len(frames[0][name]) == length:
            stacked[name] = np.ascontiguousarray(frames[0][name], row.dtype)[None]
            continue
        out = np.empty((len(frames), *row.shape(length)), row.dtype)
        for t, frame in enumerate(frames):
            out[t, : len(frame[name])] = frame[name]
            out[t, len(frame[name]) :] = row.fill
        stacked[name] = out
    return stacked


def particle_rows(ids: NDArray, source: str = "scene") -> slice | NDArray:
    """Return the indices of the particles of one padded step, by id: a slice where they are sorted already.

    Raises
    ------
    SceneError
        If an id occurs twice.
    """
    count = np.count_nonzero(ids != PADDING)
    if (ids[:count] != PADDING).all() and (ids[1:count] > ids[: max(count - 1, 0)]).all():
        return slice(0, count)
    indices = np.flatnonzero(ids != PADDING)
    indices = indices[np.argsort(ids[indices], kind="stable")]
    twice = np.flatnonzero(np.diff(ids[indices]) == 0)
    if twice.size:
        one, other = indices[twice[0] : twice[0] + 2]
        raise SceneError(
            f"{source}: particle id {ids[one]} occurs twice (rows {one} and {other}); ids must be unique: select parts "
            "that do not overlap before they are joined, or give the particles of one part other ids"
        )
    return indices


def indices_of(ids: NDArray, wanted: NDArray) -> NDArray:
    """Return the index of each wanted id among sorted ids (n,), -1 where it is not there.

    This is `wanted` itself where ids are 0, 1, 2, ...
    """
    if not len(ids):
        return np.full(len(wanted), -1)
    has_gaps = ids[-1] - ids[0] + 1 != len(ids)
    if not has_gaps:  # nothing to search for
        index = wanted - ids[0] if ids[0] else wanted
        exists = (index >= 0) & (index < len(ids))
        return index if exists.all() else np.where(exists, index, -1)
    index = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
    return np.where(ids[index] == wanted, index, -1)


def frame_of(
    arrays: Mapping[str, NDArray],
    t: int,
    source: str = "scene",
    dims: Mapping[str, str] | None = None,
) -> Frame:
    """Return a frame of padded arrays: the rows of step `t` without padding, particles by id.

    `dims` holds the dimension of the rows of each variable, by default that of its name; arrays
    along other dimensions than particles and contacts are whole. Numbers of the steps themselves,
    such as times, have none ("").

    Raises
    ------
    SceneError
        If an id occurs twice, or a variable of scenes is not finite in one of these rows.
    """
    kept: dict[str, Any] = {}
    if "particle_id" in arrays:
        kept["particle"] = particle_rows(arrays["particle_id"][t], source)
    if "contact_i" in arrays:
        valid = arrays["contact_i"][t] != PADDING
        count = np.count_nonzero(valid)
        kept["contact"] = slice(0, count) if valid[:count].all() else valid
    frame: Frame = {}
    for name, values in arrays.items():
        row = variable(name, values.dtype, values.ndim - 1)
        dim = "".join(row.dims[:1]) if dims is None else dims[name]
        # as loops are compiled for: files may hold bytes or axes the other way round
        if dim in kept:
            frame[name] = values[t][kept[dim]].astype(row.dtype, order="C", copy=False)
        elif dims is not None or not dim:
            frame[name] = values[t]
    for name in frame:
        if name in VARIABLES:
            check_finite(name, frame, source)
    return frame


def entries_of(arrays: Mapping[str, NDArray], chosen: Any) -> Frame:
    """Return the entries of each array at an index, a slice, a mask or indices."""
    return {name: values[chosen] for name, values in arrays.items()}


def check_finite(name: str, frame: Frame, source: str) -> None:
    """Raise SceneError for a variable that is not finite in a row of data, as an assigned one may be."""
    if frame[name].dtype.kind != "f" or np.isfinite(frame[name]).all():
        return
    index = int(np.argwhere(~np.isfinite(frame[name]))[0][0])
    if variable(name).dims[0] == "contact":
        whose = f"contact row {index}"
    else:
        whose = f"particle {frame['particle_id'][index]}"
    raise SceneError(
        f"{source}: {name!r} of {whose} is {frame[name][index]}; every row must hold finite numbers: repair it, or "
        "leave the row out of the scene"
    )


def phase_of(frame: Frame, by: str | None, groups: Sequence[int], source: str) -> NDArray:
    """Return the group of each particle; raise SceneError for particles without one."""
    count = len(frame["position"])
    if by is None:
        return np.zeros(count, "int64")
    values = frame[by]
    numbers = np.asarray(groups)
    index = np.minimum(np.searchsorted(numbers, values), len(numbers) - 1)
    strange = np.flatnonzero(numbers[index] != values)
    if strange.size:
        raise SceneError(
            f"{source}: particle {frame['particle_id'][strange[0]]} has {by}={values[strange[0]]}, which is not among "
            f"the groups {list(groups)}; pass groups= with every value that occurs"
        )
    return index


def without_frozen(frame: Frame) -> Frame:
    """Drop frozen grains; contacts with them become contacts with a wall, as their partner is not there."""
    if "frozen" not in frame:
        return frame
    free = frame["frozen"] != 1
    particles = {
        name: values[free]
        for name, values in frame.items()
        if not name.startswith(("contact", "overlap"))
    }
    return {**frame, **particles}


def steps_in(
    arrays: Mapping[str, NDArray], periodic: str, dims: Mapping[str, str] | None = None
) -> Iterator[tuple[Frame, Lattice, str]]:
    """Yield frame, periodic images and name of each step of padded arrays; `dims` as in `frame_of`."""
    of_frames = {name: a for name, a in arrays.items() if name not in OF_STEP}
    for t in range(len(next(iter(arrays.values())))):
        source = f"frame {t} of its chunk"
        if "step" in arrays:
            source = f"step {arrays['step'][t]}"
        box = {name: arrays[name][t] for name in BOX if name in arrays}
        frame = frame_of(of_frames, t, source, dims)
        yield frame, Lattice.of(box, periodic, source), source
