"""Dates and durations in the columns of times of files."""

from __future__ import annotations

import datetime

import numpy as np
import pandas as pd
import pytest

import xcg
from tests.dumps import write
from xcg.common.messages import SceneError

_WAYS = {
    "T": "2024-01-31T10:00:0{}",
    "blank": "2024-01-31 10:00:0{}",
    "quoted": '"2024-01-31 10:00:0{}"',
    "fraction": "2024-01-31 10:00:0{}.000000",
    "zone": "2024-01-31 10:00:0{}+01:00",
    "slashes": "2024/01/31 10:00:0{}",
}


def _rows(way: str, separator: str) -> str:
    lines = []
    for k in range(3):
        words = (_WAYS[way].format(k), "1", f"{0.25 * k}", "0", "0", "0.5")
        lines.append(separator.join(words))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("separator", [",", "; ", "\t", " "])
@pytest.mark.parametrize("way", _WAYS)
def test_dates_in_text_are_seconds_from_the_first(tmp_path, way, separator):
    names = separator.join(["time", "id", "x", "y", "z", "radius"])
    path = write(tmp_path / "grains.csv", f"{names}\n{_rows(way, separator)}")
    scene = xcg.open_scene(path, density=1)
    np.testing.assert_array_equal(scene.time, [0, 1, 2])
    assert scene.attrs["start"].startswith("2024-01-31T")
    np.testing.assert_allclose(xcg.derive(scene, "velocity").velocity.isel(component=0), 0.25)


def test_names_of_columns_above_dates_may_be_a_comment(tmp_path):
    text = "# time id x y z radius\n" + _rows("blank", " ")
    scene = xcg.open_scene(write(tmp_path / "grains.txt", text), density=1)
    np.testing.assert_array_equal(scene.time, [0, 1, 2])


def test_blanks_within_other_texts_are_no_separators(tmp_path):
    text = "id,origin,x,y,z,radius\n1,glass bead,2,3,4,0.5\n2,sand,5,6,7,0.5\n"
    scene = xcg.open_scene(write(tmp_path / "grains.csv", text), density=1).compute()
    np.testing.assert_array_equal(scene.position[0], [[2, 3, 4], [5, 6, 7]])


def test_dates_of_several_files_count_from_the_earliest(tmp_path):
    names = "time,id,x,y,z,radius\n"
    for k, time in enumerate(("2024-01-31 23:59:59.5", "2024-02-01 00:00:00.5")):
        rows = f"{time},1,0,0,0,0.5\n{time},2,1,0,0,0.5\n"
        write(tmp_path / f"p_{k}.csv", names + rows)
    contacts = "time,id1,id2,fx,fy,fz\n2024-02-01T00:00:00.5,1,2,-1,0,0\n"
    path = write(tmp_path / "c.csv", contacts)
    scene = xcg.open_scene(str(tmp_path / "p_*.csv"), path, density=1, missing="empty").compute()
    np.testing.assert_array_equal(scene.time, [0, 1])
    np.testing.assert_array_equal(scene.contact_i, [[-1], [1]])


def test_dates_are_not_scaled_by_the_unit_of_numbers(tmp_path):
    text = "time,id,x,y,z,radius\n" + _rows("T", ",")
    scene = xcg.open_scene(write(tmp_path / "g.csv", text), density=1, units={"time": 1e-3})
    np.testing.assert_allclose(scene.time, [0, 1, 2])


@pytest.mark.parametrize(
    "values",
    [
        pd.to_datetime(["2024-01-31", "2024-02-01"]),
        pd.to_datetime(["2024-01-31", "2024-02-01"], utc=True),
        [datetime.date(2024, 1, 31), datetime.date(2024, 2, 1)],
        ["2024-01-31", "2024-02-01"],
        pd.to_timedelta([0, 1], unit="D"),
    ],
)
def test_parquet_holds_times_of_any_type(tmp_path, values):
    pytest.importorskip("pyarrow")
    table = pd.DataFrame({"time": values, "id": 1, "x": [0.0, 1.0], "y": 0.0, "z": 0.0})
    table.to_parquet(tmp_path / "g.parquet")
    scene = xcg.open_scene(tmp_path / "g.parquet", density=1, diameter=1)
    np.testing.assert_array_equal(scene.time, [0, 86400])


def test_times_of_the_caller_are_dates(tmp_path):
    paths = [write(tmp_path / f"p_{k}.csv", f"id,x,y,z,radius\n1,{k},0,0,0.5\n") for k in range(2)]
    dates = pd.to_datetime(["2024-01-31T10:00", "2024-01-31T10:01"])
    scene = xcg.open_scene(paths, density=1, times=dates)
    np.testing.assert_array_equal(scene.time, [0, 60])
    assert scene.attrs["start"] == "2024-01-31T10:00:00"


def test_dates_beside_numbers_are_refused(tmp_path):
    names = "time,id,x,y,z,radius\n"
    write(tmp_path / "p_0.csv", f"{names}2024-01-31,1,0,0,0,0.5\n")
    write(tmp_path / "p_1.csv", f"{names}1.0,1,0,0,0,0.5\n")
    with pytest.raises(SceneError, match=r"p_1.csv.*numbers as times"):
        xcg.open_scene(str(tmp_path / "p_*.csv"), density=1)


def test_a_column_t_of_words_is_no_time(tmp_path):
    path = write(tmp_path / "g.csv", "t,id,x,y,z,radius\nA1,1,0,0,0,0.5\nB2,2,1,0,0,0.5\n")
    with pytest.raises(SceneError, match=r"'A1' is neither a number nor a date.*names=.'t': None"):
        xcg.open_scene(path, density=1)
    assert xcg.open_scene(path, density=1, names={"t": None}).sizes["particle"] == 2
