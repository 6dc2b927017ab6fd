"""Times of a series: numbers that rise, steps at equal distances, steps by their position."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_whole
from xcg.common.messages import SceneError


def _require_numbers(times: NDArray, purpose: str) -> None:
    """Refuse dates and durations of NumPy, whose numbers are nanoseconds or the like."""
    if times.dtype.kind not in "fiu":
        raise SceneError(
            f"{purpose}: expected times as numbers (s), and these are {times.dtype}; ds.assign_coords(time=seconds)"
        )


def check_times(time: NDArray, purpose: str, way_out: str) -> None:
    """Refuse times (t,) that are not finite or do not rise from step to step; the message says which."""
    _require_numbers(time, purpose)
    late = np.flatnonzero(~(time[1:] > time[:-1]))
    if not np.isfinite(time).all() or late.size:
        found = f"{time[late[0] + 1]} follows {time[late[0]]} at index {late[0] + 1}" if late.size else f"{time}"
        raise SceneError(f"{purpose} needs finite times that rise from step to step, and {found}; {way_out}")


def require_rising_times(ds: xr.Dataset, purpose: str) -> None:
    """Refuse a series whose times do not rise, as after a selection or joining: rates would be wrong."""
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


def step_at(ds: xr.Dataset, position: int, name: str) -> xr.Dataset:
    """Select a step by its position, which is the argument `name`; what has no steps is one.

    Raises
    ------
    ValueError
        If there is no such step.
    """
    ds = with_time(ds)
    if "time" not in ds.sizes:
        return ds
    count = ds.sizes["time"]
    if not is_whole(position, -count, count - 1):
        raise ValueError(f"{name}={position!r}: expected the position of a step, from {-count} to {count - 1}")
    return ds.isel(time=int(position))
