"""Tables below a text, rows of units, and lines below the rows, as codes and spreadsheets export them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import xcg

NAMES = "ID,Position X (m),Position Y (m),Position Z (m),Diameter (m)"
ROWS = "5,0.1,0.2,0.3,0.1\n2,0.4,0.5,0.6,0.1\n"
BLOCK = "\nTIME: {} s\n" + NAMES + "\n" + ROWS
PLACES = [[0.4, 0.5, 0.6], [0.1, 0.2, 0.3]]  # by id


def open_text(tmp_path, text, name="p.csv", **options):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return xcg.open_scene(path, density=1.0, **options)


@pytest.mark.parametrize(
    "head", ["EXTRACTED EDEM DATA:,,\nDATE/TIME: Mon,,\n", "EDEM\nDATE/TIME: 1 2 2024 10:00\n"]
)
@pytest.mark.filterwarnings("error")
def test_tables_below_a_text_are_steps_with_the_times_above_them(tmp_path, head):
    ds = open_text(tmp_path, head + BLOCK.format("0.5") + BLOCK.format("1e0"))
    assert ds.time.values.tolist() == [0.5, 1.0]
    np.testing.assert_array_equal(ds.position, [PLACES, PLACES])
    np.testing.assert_array_equal(ds.particle_id, [[2, 5]] * 2)


@pytest.mark.parametrize(
    ("line", "time"),
    [
        ("TIME = 500 ms", 0.5),
        ("// t = 0.5 s", 0.5),
        ("Time (ms),500", 0.5),
        ("TIME:,0.5 s,", 0.5),
        ("Simulation time: 2", 2.0),
        ("time: [s] .5", None),
    ],
)
@pytest.mark.filterwarnings("error")
def test_times_in_a_text_have_units(tmp_path, line, time):
    ds = open_text(tmp_path, f"made by X\n{line}\n{NAMES}\n{ROWS}")
    np.testing.assert_array_equal(ds.position[0], PLACES)
    assert ds.time.values.tolist() == [0.0 if time is None else time]
    if "ms" in line:  # the units of the caller are those of the numbers
        ds = open_text(tmp_path, f"made by X\n{line}\n{NAMES}\n{ROWS}", units={"time": 1e-3})
        assert ds.time.values.tolist() == [time]


@pytest.mark.parametrize(
    "head",
    [
        "sep=,\n",
        "\ufeffsep=,\n",
        "// a b\n// c 1 2\n",
        "% made by X\n% ",
        "Run 7 of 9\n\n",
        "made by\n{units}",
    ],
)
@pytest.mark.filterwarnings("error")
def test_lines_above_the_names_are_passed_over(tmp_path, head):
    text = head + NAMES + "\n" + ROWS
    if "{units}" in head:
        text = "made by\n" + NAMES.replace(" (m)", "") + "\n,mm,mm,mm,mm\n" + ROWS
        expected = np.multiply(PLACES, 1e-3)
    else:
        expected = PLACES
    np.testing.assert_allclose(open_text(tmp_path, text).position[0], expected, rtol=1e-15)


@pytest.mark.parametrize(
    "units", ["-;mm;mm;mm;m/s;m/s;m/s;mm", "[];[mm];[mm];[mm];[m/s];[m/s];[m/s];[mm]"]
)
@pytest.mark.filterwarnings("error")
def test_units_in_a_row_of_their_own_are_converted(tmp_path, units):
    text = f"id;x;y;z;vx;vy;vz;radius\n{units}\n5;100;200;300;1;2;3;50\n"
    ds = open_text(tmp_path, text)
    np.testing.assert_allclose(ds.position[0], [[0.1, 0.2, 0.3]], rtol=1e-15)
    np.testing.assert_array_equal(ds.velocity[0], [[1, 2, 3]])
    np.testing.assert_allclose(ds.diameter, 0.1, rtol=1e-15)


@pytest.mark.filterwarnings("error")
def test_a_column_of_times_in_units_of_a_row_separates_steps(tmp_path):
    ds = open_text(tmp_path, "t,id,x,y,z,radius\nms,-,m,m,m,m\n500,1,1,1,1,1\n1000,1,1,1,1,1\n")
    assert ds.time.values.tolist() == [0.5, 1.0]


@pytest.mark.parametrize("first", ["EDEM", "TIME: 0.5 s"])
def test_tables_without_a_time_between_them_are_an_error(tmp_path, first):
    text = f"{first}\n" + f"{NAMES}\n{ROWS}\n" * 2
    with pytest.raises(
        xcg.SceneError, match=r"line 6 names the columns of one more table.*no line"
    ):
        open_text(tmp_path, text)


@pytest.mark.parametrize("line", ["7,1,2", "7,1,2,3,4,5", "\n7,1,2,3,1"])
def test_rows_that_are_cut_off_or_apart_are_an_error(tmp_path, line):
    text = f"EDEM\nTIME: 1 s\n{NAMES}\n{ROWS}{line}\n"
    number = 6 + line.count("\n")
    with pytest.raises(xcg.SceneError, match=f"line {number} begins with a number"):
        open_text(tmp_path, text)


def test_a_line_of_groups_above_the_names_is_read_by_pandas(tmp_path):
    text = ",position,position,position,velocity,velocity,velocity,\nid,x,y,z,x,y,z,radius\n1,1,2,3,4,5,6,7\n"
    with pytest.raises(xcg.SceneError, match="names 'x' twice, below a line of groups") as error:
        open_text(tmp_path, text)
    call = str(error.value).partition("read it by ")[2]
    ds = eval(call, {"xcg": xcg, "pandas": pd})
    assert ds.velocity.values[0, 0].tolist() == [4, 5, 6]
    assert ds.diameter.values.item() == 14


@pytest.mark.parametrize("line", ["Total: 2 particles", "mean,.2,.3,.4,.1"])
def test_a_line_of_text_below_the_rows_is_named(tmp_path, line):
    with pytest.raises(xcg.SceneError, match=r"line of text below the rows.*skipfooter=1"):
        open_text(tmp_path, f"{NAMES}\n{ROWS}{line}\n").load()


@pytest.mark.parametrize(
    ("row", "hint"),
    [
        (NAMES, "row 2 repeats the names of the columns.*delete"),
        ("# restart", r"row 2 is a comment \('# restart'\).*delete"),
        ('"7","0.1","0.2","0.3","0.1"', r"numbers in quotes are read by pandas.*sep=','\)\)$"),
    ],
)
def test_rows_of_other_words_name_the_cause(tmp_path, row, hint):
    with pytest.raises(xcg.SceneError, match=hint):
        open_text(tmp_path, f"{NAMES}\n{ROWS}{row}\n{ROWS}").load()


@pytest.mark.parametrize("name", ["p.csv", "p.txt"])
def test_carriage_returns_alone_are_named(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(f"{NAMES}\n{ROWS}".replace("\n", "\r").encode())
    with pytest.raises(xcg.SceneError, match=f"{name}: lines end in carriage returns alone"):
        xcg.open_scene(path, engine="table", density=1.0)


@pytest.mark.filterwarnings("error")
def test_quoted_names_hold_separators(tmp_path):
    names = "id,\"('pos', 'x')\",\"('pos', 'y')\",\"('pos', 'z')\",radius"
    np.testing.assert_array_equal(open_text(tmp_path, f"{names}\n{ROWS}").position[0], PLACES)


@pytest.mark.parametrize(
    "head", ["My code\ntime = 500 ms\n\n", "% t = 0.5 s\n% ", "# time = 0.5 s\n# "]
)
@pytest.mark.parametrize("suffix", ["txt", "dat", "csv"])
@pytest.mark.filterwarnings("error")
def test_texts_of_any_suffix_are_recognised_below_lines_with_the_time(tmp_path, head, suffix):
    text = head + "id x y z radius\n5 0.1 0.2 0.3 0.05\n2 0.4 0.5 0.6 0.05\n"
    ds = open_text(tmp_path, text, f"p.{suffix}")
    np.testing.assert_array_equal(ds.position[0], PLACES)
    assert ds.time.values.tolist() == [0.5]


def test_units_below_the_names_of_a_text_are_recognised(tmp_path):
    ds = open_text(tmp_path, "id x y z radius\n- mm mm mm mm\n5 1 2 3 .5\n", "p.txt")
    np.testing.assert_allclose(ds.position[0], [[1e-3, 2e-3, 3e-3]])


@pytest.mark.parametrize("end", [";;;;;\n", ";;;;;\n;;;;;", "\n; ; ;;;\n\n"])
@pytest.mark.parametrize("row_end", ["", ";"])
@pytest.mark.filterwarnings("error")
def test_rows_of_separators_at_the_end_are_none(tmp_path, end, row_end):
    lines = ["time;id;x;y;z;radius", "0;1;0;0;0;.5", "2;1;1;0;0;.5"]
    text = "".join(line + row_end + "\n" for line in lines) + end
    for eol in ("\n", "\r\n"):
        ds = open_text(tmp_path, text.replace("\n", eol)).load()
        np.testing.assert_array_equal(ds.position[:, 0, 0], [0.0, 1.0])


@pytest.mark.parametrize("sign", [";", "\t", " "])
def test_the_call_for_decimal_commas_can_be_pasted(tmp_path, sign):
    rows = ["id x y z radius", "1 0,5 0 0 0,25", "2 1,5 0 0 0,25"]
    text = "\n".join(row.replace(" ", sign) for row in rows) + "\n"
    with pytest.raises(xcg.SceneError, match="decimal commas") as error:
        open_text(tmp_path, text, "p.csv").load()
    call = str(error.value).partition("read by pandas: ")[2]
    ds = eval(call, {"xcg": xcg, "pandas": pd})  # as a user pastes it
    np.testing.assert_array_equal(ds.position[0, :, 0], [0.5, 1.5])


@pytest.mark.parametrize(
    ("column", "seconds"), [("Zeit [s]", 2.0), ("Temps (ms)", 2e-3), ("elapsed time [s]", 2.0)]
)
@pytest.mark.filterwarnings("error")
def test_times_in_another_language_are_told_by_their_unit(tmp_path, column, seconds):
    ds = open_text(tmp_path, f"{column};id;x;y;z;radius\n0;1;0;0;0;.5\n2;1;1;0;0;.5\n")
    assert ds.time.values.tolist() == [0.0, seconds]
    with pytest.warns(xcg.SceneWarning, match="all rows are one step"):
        open_text(
            tmp_path, "elapsed step time [s];id;x;y;z;radius\n0.1;1;0;0;0;.5\n0.1;2;1;0;0;.5\n"
        )
