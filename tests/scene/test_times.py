"""Times of any type as seconds, and rounding noise of times."""

from __future__ import annotations

import datetime

import numpy as np
import pandas as pd
import pytest

import xcg
from xcg.common.messages import SceneError
from xcg.scene.times import read_times, seconds_between, without_noise

_DAY = datetime.datetime(2024, 1, 31, 10)
_LATER = datetime.timedelta(seconds=1.5)
_ZONE = datetime.timezone(datetime.timedelta(hours=1))
_DATES = [
    [_DAY, _DAY + _LATER],
    [_DAY.replace(tzinfo=_ZONE), _DAY.replace(tzinfo=_ZONE) + _LATER],
    [pd.Timestamp(_DAY), pd.Timestamp(_DAY + _LATER)],
    pd.DatetimeIndex([_DAY, _DAY + _LATER], tz="Europe/Berlin"),
    np.array([_DAY, _DAY + _LATER], "datetime64[ns]"),
    np.array([_DAY, _DAY + _LATER], "datetime64[ms]"),
    ["2024-01-31T10:00:00", "2024-01-31T10:00:01.5"],
    ["2024-01-31 10:00", "2024-01-31 10:00:01.500000"],
    ["2024-01-31T10:00:00Z", "2024-01-31T10:00:01.5Z"],
    ["2024-01-31 10:00:00+01:00", "2024-01-31 11:00:01.5+02:00"],
    ["2024-01-31 10:00:00 UTC", "2024-01-31 10:00:01.5 UTC"],
    ["2024/01/31 10:00:00", "2024/01/31 10:00:01.5"],
    ["20240131T100000", "20240131T100001.5"],
]
_DURATIONS = [
    [datetime.timedelta(0), _LATER],
    pd.to_timedelta([0, 1.5], unit="s"),
    np.array([0, 1500], "timedelta64[ms]"),
    np.array([0, 1_500_000_000], "timedelta64[ns]"),
    ["0 days 00:00:00", "0 days 00:00:01.500000"],
    ["00:00:00", "00:00:01.5"],
    ["0 ms", "1500 ms"],
    [datetime.time(0), datetime.time(0, 0, 1, 500_000)],
]


@pytest.mark.parametrize("values", _DATES)
def test_dates_are_seconds_from_the_first(values):
    times, start = read_times(values, "table")
    np.testing.assert_array_equal(times, [0.0, 1.5])
    first = pd.Timestamp(start)
    if first.tz is None:
        assert first == pd.Timestamp(_DAY)
    else:
        assert first in (pd.Timestamp(_DAY, tz="UTC"), pd.Timestamp(_DAY, tz=_ZONE))


@pytest.mark.parametrize("values", _DURATIONS)
def test_durations_are_seconds(values):
    times, start = read_times(values, "table")
    np.testing.assert_array_equal(times, [0.0, 1.5])
    assert start == ""


@pytest.mark.parametrize("values", [[0.0, 1.5], ["0", "1.5"], np.array([0, 1.5], object)])
def test_numbers_stay_in_their_unit(values):
    times, start = read_times(values, "table")
    np.testing.assert_array_equal(times, [0.0, 1.5])
    assert start is None


def test_a_date_whose_day_may_be_its_month_is_refused():
    with pytest.raises(SceneError, match=r"table: '05/01/2024' .*dayfirst"):
        read_times(["05/01/2024", "06/01/2024"], "table")


def test_a_missing_date_is_named():
    with pytest.raises(SceneError, match="row 1 has no time"):
        read_times([pd.Timestamp(_DAY), pd.NaT], "table")


def test_seconds_between_dates_have_nanoseconds():
    # as a number of seconds since 1970 they would be rounded to 2e-7
    seconds = seconds_between("2024-01-31T10:00:00", "2024-01-31T10:00:00.000000001")
    assert seconds == pytest.approx(1e-9, rel=1e-9)


@pytest.mark.parametrize("values", [*_DATES, *_DURATIONS])
def test_arrays_and_tables_take_the_same_times(values):
    position = [np.zeros((1, 3)), np.full((1, 3), 0.75)]
    scene = xcg.scene_from_arrays(position, time=values, diameter=1.0, density=1.0)
    table = pd.DataFrame({"id": [1, 1], "x": [0, 0.75], "y": [0, 0.75], "z": [0, 0.75]})
    other = xcg.scene_from_table(table.assign(time=values), diameter=1.0, density=1.0)
    for ds in (scene, other):
        np.testing.assert_array_equal(ds.time, [0, 1.5])
        assert ds.attrs.get("start") == (read_times(values, "")[1] or None)
        velocity = xcg.derive(ds, "velocity").velocity
        np.testing.assert_allclose(velocity.isel(particle=0), 0.5)


def test_noise_of_rounding_is_no_interval():
    noisy = np.array([0, 1e-17, 0.1, 0.30000000000000004, 0.3, 0.1 + 1e-17, 0])
    np.testing.assert_array_equal(without_noise(noisy), [0, 0, 0.1, 0.3, 0.3, 0.1, 0])
    steps = np.array([0, 1e-9, 2e-9])
    np.testing.assert_array_equal(without_noise(steps), steps)


def test_rows_with_noisy_times_are_one_step():
    times = [0, 1e-17, 0.1, 0.1, 0.30000000000000004, 0.3]
    table = pd.DataFrame({"time": times, "id": [1, 2] * 3, "x": [0, 1] * 3, "y": 0.0, "z": 0.0})
    contacts = pd.DataFrame({"time": [1e-17, 0.3], "id1": 1, "id2": 2, "fx": 1.0, "fy": 0, "fz": 0})
    contacts = pd.concat([contacts, contacts.iloc[:1].assign(time=0.1)])
    scene = xcg.scene_from_table(table, contacts, diameter=1.0, density=1.0)
    np.testing.assert_array_equal(scene.time, [0, 0.1, 0.3])
    np.testing.assert_array_equal(scene.contact_i, [[1], [1], [1]])
