"""Times of steps: of any type as seconds, without noise of rounding; whether they are known, and rise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from xcg.common.messages import SceneError, plain
from xcg.scene.schema import NUMBERED, units_in

_NOISE = 1e-9  # of the largest interval; times that are nearer to each other are one
_LAST_BITS = 8  # units in the last place of the largest time, by which one time may differ
_UTC = r"\s*(?:UTC|GMT)$"
_ZONE = r":?\d\d(?:\.\d+)?\s*(?:Z|[+-]\d\d:?(?:\d\d)?)$"  # behind the time of the day


def read_times(values: ArrayLike, source: str) -> tuple[NDArray[np.float64], str | None]:
    """Return times (n,) as numbers, and what they count from.

    Parameters
    ----------
    values : array (n,)
        Numbers, durations (timedelta64, `datetime.timedelta`), dates (datetime64,
        `datetime.datetime`, `pandas.Timestamp`), times of the day, or texts of these. Dates with a
        time zone are taken in UTC.
    source : str
        Names the values in messages, such as "table: column 'time'".

    Returns
    -------
    times : array (n,)
        The numbers; seconds of durations, seconds from the first of dates.
    start : str or None
        None for numbers; "" for durations; for dates the earliest one, as ISO 8601.

    Raises
    ------
    SceneError
        If values are neither numbers, durations nor dates, one is missing, or the order of day and
        month is not known.
    """
    series = values if isinstance(values, pd.Series) else pd.Series(np.atleast_1d(values))
    if series.dtype.kind in "iufb":
        return series.to_numpy("float64", na_value=np.nan), None
    if series.dtype.kind not in "mM":
        try:
            return series.to_numpy("float64", na_value=np.nan), None
        except (TypeError, ValueError):
            series = _from_objects(series, source)
    if series.isna().any():
        row = int(np.argmax(series.isna()))
        raise SceneError(f"{source}: row {row} has no time; drop the row, or fill its time in")
    if series.dtype.kind == "m":
        return np.asarray(series.dt.total_seconds(), "float64"), ""
    zone = ""
    if getattr(series.dtype, "tz", None) is not None:
        series = series.dt.tz_convert("UTC").dt.tz_localize(None)
        zone = "+00:00"
    first = series.min()
    start: str = first.isoformat() + zone if len(series) else ""
    return np.asarray((series - first).dt.total_seconds(), "float64"), start


def _from_objects(series: pd.Series, source: str) -> pd.Series:
    """Return durations or dates from objects or texts; raise SceneError for other values."""
    missing = series.isna()
    if missing.all():
        raise SceneError(f"{source}: row 0 has no time; drop the row, or fill its time in")
    first = series[~missing].iloc[0]
    if isinstance(first, pd.Period):
        return pd.Series(pd.PeriodIndex(series).to_timestamp())
    texts = series.map(str, na_action="ignore").str.strip().str.strip("\"'")
    # blanks within a word of a table are underscores there
    texts = texts.str.replace("_", " ").str.replace(_UTC, "Z", regex=True)
    try:
        return pd.to_timedelta(texts)
    except (ValueError, OverflowError):
        pass
    clocks = texts[~missing].str.partition("T" if "T" in texts[~missing].iloc[0] else " ")[2]
    utc = bool(clocks.str.contains(_ZONE).all())
    try:
        return pd.to_datetime(texts, format="ISO8601", utc=utc)
    except (ValueError, OverflowError):
        raise SceneError(
            f"{source}: {plain(str(first).replace('_', ' '))} is neither a number nor a date as 2024-01-31T10:00:00.5; "
            "convert the column with pandas, pd.to_datetime(column, dayfirst=...), and pass the table "
            "to xcg.scene_from_table, or give times="
        ) from None


def times_of_caller(times: Any, name: str, scale: float) -> tuple[Any, str | None]:
    """Return times of the caller in their unit, and the first of dates; numbers stay as they are.

    Parameters
    ----------
    times : array (n,)
        Numbers, durations or dates, see `read_times`.
    name : str
        The argument, for messages.
    scale : float
        Unit of the times that are numbers (s).
    """
    if np.asarray(times).dtype.kind not in "mMOUST":
        return times, None
    values, start = read_times(times, name)
    if start is None:
        return times, None
    return values / scale, start


def seconds_between(start: str, later: str) -> float:
    """Return the seconds from one date to another, both as ISO 8601."""
    return (pd.Timestamp(later) - pd.Timestamp(start)).total_seconds()


def without_noise(times: NDArray) -> NDArray:
    """Return times (n,), each that differs from the one below it by rounding noise replaced by that.

    Times are one if they differ by less than 1e-9 of the largest interval, or by the last bits of
    the largest time.
    """
    distinct, index = np.unique(times, return_inverse=True)
    gaps = np.diff(distinct)
    if not gaps.size:
        return times
    last_bits = _LAST_BITS * np.finfo(float).eps * np.abs(distinct).max()
    is_new = np.append(True, gaps > max(_NOISE * gaps.max(), last_bits))
    lowest = distinct[is_new]
    return lowest[np.cumsum(is_new) - 1][index].reshape(np.shape(times))


# --- of the steps of a scene or result ---------------------------------------------------------------


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
        times = f"{time}"
        if late.size:
            times = f"{time[late[0] + 1]} follows {time[late[0]]} at index {late[0] + 1}"
        raise SceneError(
            f"{purpose} needs finite times that rise from step to step, and {times}; {way_out}"
        )


def require_rising_times(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for a series whose times do not rise, as after a selection or joining: rates would be wrong."""
    check_times(
        ds["time"].to_numpy(),
        purpose,
        "order the steps with ds.sortby('time').drop_duplicates('time')",
    )


def times_are_known(ds: xr.Dataset) -> bool:
    """Return whether the coordinate time holds times, and not the numbers of the steps in their place.

    Arithmetic keeps attributes, so that assigned times may still be labelled as numbers; they
    differ from the steps, and where these are lazy, they are not whole.
    """
    if ds["time"].attrs.get("long_name") != NUMBERED:
        return True
    if "step" not in ds.coords:
        return False
    times = ds["time"].to_numpy()
    if ds["step"].chunks is not None:
        return bool((times % 1 != 0).any())
    return not np.array_equal(times, ds["step"])


def unit_of_times(ds: xr.Dataset) -> str:
    """Return the unit of differences of times: "1" where the times are not known."""
    if not times_are_known(ds):
        return "1"
    return units_in("s", str(ds.attrs.get("unit_system", "SI")))


def require_known_times(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for a series whose times are numbers of steps: rates would have a wrong unit."""
    if not times_are_known(ds):
        raise SceneError(
            f"{purpose}: the times of the steps are not known, and 'time' holds the numbers of the steps; give "
            "timestep= or times= in open_scene, time= in scene_from_arrays, or ds.assign_coords(time=seconds)"
        )


def require_times(ds: xr.Dataset, purpose: str) -> None:
    """Raise SceneError for a series whose times are not known, or do not rise."""
    require_known_times(ds, purpose)
    require_rising_times(ds, purpose)


def evenly_spaced(values: NDArray, what: str) -> float:
    """Return the distance of numbers that rise by equal steps; refuse others, as `what`."""
    _require_numbers(values, what)
    intervals = np.diff(values)
    if not (intervals > 0).all() or not np.allclose(intervals, intervals[0], rtol=1e-4, atol=0.0):
        raise SceneError(
            f"{what} at equal distances are needed, and these are {intervals.min():.6g} to {intervals.max():.6g} apart"
        )
    return float((values[-1] - values[0]) / len(intervals))
