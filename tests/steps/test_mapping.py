"""Chunks of a lazy series are read and computed once each; progress is lines in a file, a bar in a terminal."""

from __future__ import annotations

import re
import sys

import dask
import numpy as np
import pytest
import xarray as xr
from tqdm import tqdm

import xcg
from tests.dumps import write_series
from tests.scenes import random_steps
from xcg.steps.mapping import chunks_of_time, count_tasks, each_step, shown


def lazy(**chunks):
    values = {name: ("time", np.arange(7.0)) for name in ("a", "b", "c")}
    ds = xr.Dataset(values | {"d": 1.0}).chunk(time=-1)
    return ds.assign({name: ds[name].chunk(time=sizes) for name, sizes in chunks.items()})


def test_chunks_follow_those_of_all_variables():
    def edges(ds):
        return [(steps.start, steps.stop) for steps in chunks_of_time(ds)]

    assert edges(lazy()) == [(0, 7)]
    assert edges(lazy(a=(2, 2, 3), b=(4, 3), c=(1, 3, 3))) == [(0, 4), (4, 7)]
    assert edges(lazy(a=(2, 5), b=(2, 5), c=1)) == [(0, 2), (2, 7)]
    assert edges(lazy().compute()) == [(t, t + 1) for t in range(7)]


def test_mapping_yields_the_steps_of_the_series():
    ds = lazy(a=(2, 2, 3), b=(4, 3), c=1)
    xr.testing.assert_identical(xr.concat(each_step(ds), "time", data_vars="minimal"), ds.compute())
    assert all(step.sizes["time"] == 1 and step["a"].chunks is None for step in each_step(ds))
    (one,) = each_step(ds.isel(time=3))
    xr.testing.assert_identical(one, ds.isel(time=3).compute())


def test_tasks_take_the_finest_chunks_of_their_variables():
    ds = random_steps(4)
    mixed = ds.chunk(time=4).assign(
        velocity=ds.velocity.chunk(time=(1, 3)), mass=ds.mass.chunk(time=(1, 1, 2))
    )
    f = mixed.cg.coarse_grain(["velocity"], width=1.0, axes="z")
    assert f.velocity.chunks[0] == (1, 1, 2)
    xr.testing.assert_equal(f.compute(), ds.cg.coarse_grain(["velocity"], width=1.0, axes="z"))


def movie(ds, folder):
    ds.cg.coarse_grain("density", axes="z").cg.movie(folder / "a.gif", "density")


def to_vtu(ds, folder):
    nodes = np.zeros((1, 3))
    vtk = pytest.importorskip("vtkmodules.vtkCommonDataModel")
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    points = vtkPoints()
    mesh = vtk.vtkUnstructuredGrid()
    writer = vtkXMLUnstructuredGridWriter()
    points.SetData(numpy_to_vtk(nodes, deep=True))
    mesh.SetPoints(points)
    writer.SetFileName(str(folder / "mesh.vtu"))
    writer.SetInputData(mesh)
    writer.Write()
    at = xcg.mesh_points(folder / "mesh.vtu")
    ds.cg.coarse_grain("density", at=at).cg.to_vtu(folder / "mesh.vtu", folder / "f.vtu")


@pytest.mark.parametrize(
    "task",
    [
        lambda ds, folder: ds.cg.coarse_grain("density").cg.save(folder / "f.pvd"),
        lambda ds, folder: xcg.record(folder / "f.nc", fields="density").append(ds.cg.coarse_grain("density")),
        lambda ds, folder: xcg.record(folder / "f.nc", fields="density").append(ds),
        lambda ds, folder: ds.cg.force_chains().cg.to_csv(folder / "c_{step}.csv"),
        lambda ds, folder: ds.cg.mean_squared_displacement(lags=[1]),
        movie,
        to_vtu,
    ],
)  # fmt: skip
def test_bodies_are_read_once(tmp_path, reads, task):
    particles, contacts = write_series(tmp_path)
    ds = xcg.open_scene(particles, contacts=contacts, chunks=2, timestep=1e-3)
    task(ds, tmp_path)
    assert {step for _, step in reads} == set(ds.step.values.tolist())
    assert set(reads.values()) == {1}


# --- progress --------------------------------------------------------------------------------------------


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
    series = xr.concat(
        [ds.assign_coords(time=[float(k)]) for k in range(4)], "time", data_vars="all"
    ).chunk(time=1)
    series.cg.save(tmp_path / "quiet.nc")
    assert capsys.readouterr().err == ""  # neither a terminal nor asked for
    for what, name in (
        (series, "told.nc"),
        (series.cg.coarse_grain("density", axes="xz"), "told.pvd"),
    ):
        what.cg.save(tmp_path / name, progress=True)
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
        assert [line.split(",")[0] for line in lines] == [
            f"{n} of 100 steps" for n in range(20, 101, 10)
        ]
        assert re.fullmatch(r"20 of 100 steps, .* steps/s, \d\d:\d\d left", lines[0])
        assert "\r" not in stream.text
    stream.text = ""
    with shown(10, False) as bar:
        bar.update(10)
    assert not stream.text


def test_tasks_count_the_steps_that_are_left():
    """Of 10 steps 4 were done: three tasks stand for the other six, whatever other tasks there are."""
    seen = []
    with (
        tqdm(total=10, initial=4, file=Stream(False)) as bar,
        count_tasks(bar, lambda key: key.startswith("write")),
    ):
        tasks = {"other": (lambda: None,)}
        for name, before in (("write 1", "other"), ("write 2", "write 1"), ("write 3", "write 2")):
            tasks[name] = (lambda _: seen.append(bar.n), before)
        dask.get(tasks, "write 3")
        assert [*seen, bar.n] == [4, 6, 8, 10]


@pytest.mark.filterwarnings("ignore:no step is left")
@pytest.mark.parametrize("lazily", [False, True])
def test_a_scene_without_steps_has_results_without_steps(lazily):
    scene = random_steps(2)
    scene = (scene.chunk(time=1) if lazily else scene).isel(time=slice(0, 0))
    floor = xcg.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    for result in (
        scene.cg.coarse_grain("density", axes="z"),
        scene.cg.wall_stress(floor, width=0.5),
        scene.cg.cell_volumes(spacing=0.5),
    ):
        assert result.sizes["time"] == 0


def test_what_needs_a_step_says_so(tmp_path):
    f = random_steps(2).cg.coarse_grain("density", axes="xz").isel(time=slice(0, 0))
    for call in (
        lambda: f.cg.movie(tmp_path / "f.gif"),
        lambda: f.cg.spatial_correlation("density"),
        lambda: f.cg.plot("density"),
        lambda: f.cg.time_average(),
    ):
        with pytest.raises(xcg.SceneError, match="there is no step; select one at least"):
            call()
