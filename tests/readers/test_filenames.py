"""Numbers in the names of files: their order, and whether a dot is a decimal point."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xcg.readers.filenames import read_file_numbers, sort_by_numbers

WHOLE = st.lists(st.integers(0, 10**9), min_size=2, max_size=20, unique=True)


@given(WHOLE, st.integers(0, 9))
def test_whole_numbers_are_sorted_by_value(numbers, digits):
    paths = [f"run2/p{number:0{digits}}.dump" for number in numbers]
    assert sort_by_numbers(paths) == [f"run2/p{n:0{digits}}.dump" for n in sorted(numbers)]
    assert read_file_numbers(paths).steps == numbers


@given(WHOLE, st.sampled_from(["{:.9f}", "{:.12g}", "{!r}", "{:.15e}"]))
def test_decimals_are_sorted_by_value(numbers, form):
    times = [form.format(number / 1e6) for number in numbers]
    paths = [f"t_{time}.csv" for time in times]
    assert sort_by_numbers(paths) == [f"t_{time}.csv" for time in sorted(times, key=float)]
    found = read_file_numbers(paths)
    if any(not time.isdecimal() for time in times):
        assert found.times == [float(time) for time in times]
        assert found.steps == [None] * len(times)


@pytest.mark.parametrize(
    ("names", "steps"),
    [
        (["piece.0.5", "piece.1.5", "piece.0.7", "piece.1.7"], [5, 5, 7, 7]),
        (["o.0.0.vtu", "o.0.1.vtu", "o.9.0.vtu", "o.9.1.vtu"], [0, 0, 9, 9]),
        (["mu0.5.csv"], [5]),
        (["run_2.100.csv", "run_2.200.csv"], [100, 200]),
        (["run2.100.csv", "run2.200.csv"], [100, 200]),
        (["x.5.h5", "x.6.h5"], [5, 6]),
        (["a.csv", "b.csv"], [None, None]),
        (["a_1.csv", "b_1.csv"], [1, 1]),
    ],
)
def test_dots_between_whole_numbers_are_no_points(names, steps):
    found = read_file_numbers(names)
    assert (found.steps, found.times, found.problem) == (steps, [None] * len(names), "")


def test_files_of_one_run_share_their_name_without_the_number():
    names = ["a/p_1.csv", "a/p_2.csv", "b/p_3.csv"]
    assert read_file_numbers(names).runs == ["a/p_#", "a/p_#", "b/p_#"]
    assert read_file_numbers(["p.0.5", "p.1.5", "p.0.7", "p.1.7"]).runs == [
        "p.0.#",
        "p.1.#",
        "p.0.#",
        "p.1.#",
    ]
