"""Frames, one step of a scene as plain arrays, and back; times of the steps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_whole
from xcg.common.messages import SceneError
from xcg.compiled.arrays import all_finite
from xcg.scene.lattice import Lattice
from xcg.scene.schema import BOX, OF_STEP, PADDING, VARIABLES, Frame, variable


def _require_numbers(times: NDArray, purpose: str) -> None:
    """Raise SceneError for dates and durations of NumPy, whose numbers are nanoseconds or the like."""
    if times.dtype.kind not in "fiu":
        raise SceneError(
            f"{purpose}: expected times as numbers (s), and these are {times.dtype}; ds.assign_coords(time=seconds)"
        )


def check_times(time: NDArray, purpose: str, way_out: str) -> None:
    """Raise SceneError for times (t,) that are not finite or do not rise; name the step."""
    _require_numbers(time, purpose)
    late = np.flatnonzero(~(time[1:] > time[:-1]))
    if not np.isfinite(time).all() or late.size:
        found = f"{time[late[0] + 1]} follows {time[late[0]]} at index {late[0] + 1}" if late.size else f"{time}"
        raise SceneError(f"{purpose} needs finite times that rise from step to step, and {found}; {way_out}")


def require_rising_times(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for a series whose times do not rise, as after a selection or joining: rates would be wrong."""
    check_times(ds["time"].to_numpy(), purpose, "order the steps with ds.sortby('time').drop_duplicates('time')")


def evenly_spaced(values: NDArray, what: str) -> float:
    """Return the distance of numbers that rise by equal steps; refuse others, as `what`."""
    _require_numbers(values, what)
    steps = np.diff(values)
    if not (steps > 0).all() or not np.allclose(steps, steps[0], rtol=1e-4, atol=0.0):
        raise SceneError(
            f"{what} at equal distances are needed, and these are {steps.min():.6g} to {steps.max():.6g} apart"
        )
    return float((values[-1] - values[0]) / len(steps))


def with_time(ds: xr.Dataset) -> xr.Dataset:
    """Name the dimension of the steps "time" where it goes by their numbers (``swap_dims(time="step")``)."""
    numbered = "step" in ds.sizes and "time" not in ds.sizes and "time" in ds.coords
    return ds.swap_dims(step="time") if numbered else ds


def require_steps(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for data whose dimension of time is empty, as after a selection."""
    if not ds.sizes.get("time", 1):
        raise SceneError(f"{purpose}: there is no step; select one at least")


def step_at(ds: xr.Dataset, position: int, name: str) -> xr.Dataset:
    """Select a step by its position; `name` is the argument in messages. Data without steps stay as they are.

    Raises
    ------
    ValueError
        If the step does not exist, or none.
    """
    ds = with_time(ds)
    require_steps(ds, f"{name}={position!r}")
    if "time" not in ds.sizes:
        return ds
    count = ds.sizes["time"]
    if not (isinstance(position, int | np.integer) and is_whole(position, -count, count - 1)):
        raise ValueError(
            f"{name}={position!r}: expected the position of a step, a whole number from {-count} to {count - 1}; "
            "select a time by .sel(time=...)"
        )
    return ds.isel(time=int(position))


def frame_at(ds: xr.Dataset, position: int, names: Iterable[str]) -> tuple[Frame, Lattice, str]:
    """Compute some variables of the step at a position: its frame, periodic images and name; errors as `step_at`."""
    step, wanted = step_at(ds, position, "time"), {*names, *OF_STEP}
    step = step[[name for name in step.variables if name in wanted]].compute()
    arrays = {str(name): values.to_numpy()[None] for name, values in step.variables.items() if name in wanted}
    return next(steps_in(arrays, str(ds.attrs.get("periodic", ""))))


def stack(frames: Sequence[Frame], names: Sequence[str], rows: int) -> Frame:
    """Stack frames along a new first axis, padded to `rows` rows; one frame that fills them is not copied."""
    stacked = {}
    for name in names:
        row = variable(name, frames[0][name].dtype, frames[0][name].ndim)
        if len(frames) == 1 and len(frames[0][name]) == rows:
            stacked[name] = np.ascontiguousarray(frames[0][name], row.dtype)[None]
            continue
        out = np.empty((len(frames), *row.shape(rows)), row.dtype)
        for t, frame in enumerate(frames):
            out[t, : len(frame[name])] = frame[name]
            out[t, len(frame[name]) :] = row.fill
        stacked[name] = out
    return stacked


def particle_rows(ids: NDArray, source: str = "scene") -> slice | NDArray:
    """Rows of the particles of one padded step, by id: a slice where they are sorted already.

    Raises
    ------
    SceneError
        If an id occurs twice.
    """
    count = np.count_nonzero(ids != PADDING)
    if (ids[:count] != PADDING).all() and (ids[1:count] > ids[: max(count - 1, 0)]).all():
        return slice(0, count)
    rows = np.flatnonzero(ids != PADDING)
    rows = rows[np.argsort(ids[rows], kind="stable")]
    twice = np.flatnonzero(np.diff(ids[rows]) == 0)
    if twice.size:
        one, other = rows[twice[0] : twice[0] + 2]
        raise SceneError(
            f"{source}: particle id {ids[one]} occurs twice (rows {one} and {other}); ids must be unique: select parts "
            "that do not overlap before they are joined, or give the particles of one part other ids"
        )
    return rows


def frame_of(arrays: Mapping[str, NDArray], t: int, source: str = "scene") -> Frame:
    """Return a frame of padded arrays: the rows of step `t` without padding, particles by id.

    Raises
    ------
    SceneError
        If an id occurs twice, or a variable of scenes is not finite in one of these rows.
    """
    rows: dict[str, Any] = {}
    if "particle_id" in arrays:
        rows["particle"] = particle_rows(arrays["particle_id"][t], source)
    if "contact_i" in arrays:
        valid = arrays["contact_i"][t] != PADDING
        count = np.count_nonzero(valid)
        rows["contact"] = slice(0, count) if valid[:count].all() else valid
    found: Frame = {}
    for name, values in arrays.items():
        row = variable(name, values.dtype, values.ndim - 1)
        if row.dims[0] in rows:  # as loops are compiled for: files may hold bytes or axes the other way round
            found[name] = values[t][rows[row.dims[0]]].astype(row.dtype, order="C", copy=False)
    for name in found:
        if name in VARIABLES:
            check_finite(name, found, source)
    return found


def check_finite(name: str, frame: Frame, source: str) -> None:
    """Raise SceneError for a variable that is not finite in a row of data, as an assigned one may be."""
    if frame[name].dtype != np.float64 or all_finite(np.ascontiguousarray(frame[name]).reshape(-1)):
        return
    row = int(np.argwhere(~np.isfinite(frame[name]))[0][0])
    at_contacts = variable(name).dims[0] == "contact"
    whose = f"contact row {row}" if at_contacts else f"particle {frame['particle_id'][row]}"
    raise SceneError(
        f"{source}: {name!r} of {whose} is {frame[name][row]}; every row must hold finite numbers: repair it, or leave "
        "the row out of the scene"
    )


def phase_of(frame: Frame, by: str | None, groups: Sequence[int], source: str) -> NDArray:
    """Return the group of each particle; raise SceneError for particles without one."""
    count = len(frame["position"])
    if by is None:
        return np.zeros(count, "int64")
    values, known = frame[by], np.asarray(groups)
    row = np.minimum(np.searchsorted(known, values), len(known) - 1)
    strange = np.flatnonzero(known[row] != values)
    if strange.size:
        raise SceneError(
            f"{source}: particle {frame['particle_id'][strange[0]]} has {by}={values[strange[0]]}, which is not among "
            f"the groups {list(groups)}; pass groups= with every value that occurs"
        )
    return row


def without_frozen(frame: Frame) -> Frame:
    """Drop frozen grains; contacts with them become contacts with a wall, as their partner is not there."""
    if "frozen" not in frame:
        return frame
    free = frame["frozen"] != 1
    particles = {name: values[free] for name, values in frame.items() if not name.startswith(("contact", "overlap"))}
    return {**frame, **particles}


def steps_in(arrays: Mapping[str, NDArray], periodic: str) -> Iterator[tuple[Frame, Lattice, str]]:
    """Frame, periodic images and name of each step of padded arrays."""
    rows = {name: a for name, a in arrays.items() if name not in (*OF_STEP, "time")}
    for t in range(len(next(iter(rows.values())))):
        source = f"step {arrays['step'][t]}" if "step" in arrays else f"frame {t} of its chunk"
        box = {name: arrays[name][t] for name in BOX if name in arrays}
        yield frame_of(rows, t, source), Lattice.of(box, periodic, source), source
