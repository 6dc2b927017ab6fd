"""Progress: lines in a file, a bar in a terminal or notebook."""

from __future__ import annotations

import re
import sys

import dask
import pytest
import xarray as xr
from tqdm import tqdm

import xcg
from xcg.steps.progress import CountTasks, shown


class Stream:
    def __init__(self, terminal):
        self.text, self.terminal = "", terminal

    def isatty(self):
        return self.terminal

    def write(self, text):
        self.text += text

    def flush(self):
        pass


def test_a_finished_run_shows_no_progress(capsys):
    for done in (3, 4):
        with shown(4, wanted=True, done=done) as bar:
            bar.update(4 - done)
    assert [line.split(" steps")[0] for line in capsys.readouterr().err.splitlines()] == ["4 of 4"]


def test_saving_reports_progress(tmp_path, capsys):
    ds = xcg.datasets.random_scene(30)
    series = xr.concat([ds.assign_coords(time=[float(k)]) for k in range(4)], "time", data_vars="all").chunk(time=1)
    series.cg.save(tmp_path / "quiet.nc")
    assert capsys.readouterr().err == ""  # neither a terminal nor asked for
    series.cg.save(tmp_path / "told.nc", progress=True)
    assert [line.split(" steps")[0] for line in capsys.readouterr().err.splitlines()] == [
        "1 of 4", "2 of 4", "3 of 4", "4 of 4",
    ]  # fmt: skip


def test_a_notebook_shows_a_bar(monkeypatch):
    class OutStream(Stream):
        __module__ = "ipykernel.iostream"

    stream = OutStream(terminal=False)
    monkeypatch.setattr(sys, "stderr", stream)
    with shown(2, True) as bar:
        bar.update(1)
        bar.refresh()
        bar.update(1)
    assert "\r[###############---------------] 1 of 2 steps" in stream.text
    stream.text = ""
    with shown(2, None) as bar:  # nothing in the first seconds
        bar.update(2)
    assert stream.text == ""


@pytest.mark.parametrize("terminal", [True, False])
def test_progress_is_a_bar_in_terminals_and_lines_elsewhere(terminal, monkeypatch):
    stream = Stream(terminal)
    monkeypatch.setattr(sys, "stderr", stream)
    with shown(100, True, done=10) as bar:
        for _ in range(90):
            bar.update()
    if terminal:
        assert "[###---------------------------] 10 of 100 steps, " in stream.text
        assert re.search(r"\[#{30}\] 100 of 100 steps, .* steps/s, 00:00 left\n$", stream.text)
    else:
        lines = stream.text.splitlines()
        assert [line.split(",")[0] for line in lines] == [f"{n} of 100 steps" for n in range(20, 101, 10)]
        assert re.fullmatch(r"20 of 100 steps, .* steps/s, \d\d:\d\d left", lines[0])
        assert "\r" not in stream.text
    stream.text = ""
    with shown(10, False) as bar:
        bar.update(10)
    assert not stream.text


def test_tasks_count_the_steps_that_are_left():
    """Of 10 steps 4 were done: three tasks stand for the other six, whatever other tasks there are."""
    seen = []
    with tqdm(total=10, initial=4, file=Stream(False)) as bar, CountTasks(bar, lambda key: key.startswith("write")):
        tasks = {"other": (lambda: None,)}
        for name, before in (("write 1", "other"), ("write 2", "write 1"), ("write 3", "write 2")):
            tasks[name] = (lambda _: seen.append(bar.n), before)
        dask.get(tasks, "write 3")
        assert [*seen, bar.n] == [4, 6, 8, 10]
