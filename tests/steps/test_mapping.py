"""What goes through a lazy series step by step reads and computes each chunk of time once."""

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import steps_of_random_scenes
from tests.dumps import write_series
from xcg.steps.mapping import chunks_of_time, each_step


def lazy(**chunks):
    values = {name: ("time", np.arange(7.0)) for name in ("a", "b", "c")}
    ds = xr.Dataset(values | {"d": 1.0}).chunk(time=-1)
    return ds.assign({name: ds[name].chunk(time=sizes) for name, sizes in chunks.items()})


def test_chunks_follow_those_of_all_variables():
    def edges(*series):
        return [(steps.start, steps.stop) for steps in chunks_of_time(series)]

    assert edges(lazy()) == [(0, 7)]
    assert edges(lazy(a=(2, 2, 3), b=(4, 3), c=(1, 3, 3))) == [(0, 4), (4, 7)]
    assert edges(lazy(a=(2, 5), b=(2, 5), c=(2, 5)), lazy(a=1, b=1, c=1)) == [(0, 2), (2, 7)]
    assert edges(lazy().compute()) == [(t, t + 1) for t in range(7)]


def test_mapping_yields_the_steps_of_the_series():
    ds = lazy(a=(2, 2, 3), b=(4, 3), c=1)
    xr.testing.assert_identical(xr.concat(each_step(ds), "time", data_vars="minimal"), ds.compute())
    assert all(step.sizes["time"] == 1 and step["a"].chunks is None for step in each_step(ds))
    (one,) = each_step(ds.isel(time=3))
    xr.testing.assert_identical(one, ds.isel(time=3).compute())


def test_tasks_take_the_finest_chunks_of_their_variables():
    ds = steps_of_random_scenes(4)
    mixed = ds.chunk(time=4).assign(velocity=ds.velocity.chunk(time=(1, 3)), mass=ds.mass.chunk(time=(1, 1, 2)))
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

    points, mesh, writer = vtkPoints(), vtk.vtkUnstructuredGrid(), vtkXMLUnstructuredGridWriter()
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
    ds = xcg.open_scene(particles, contacts=contacts, chunks=2)
    reads.clear()
    task(ds, tmp_path)
    assert {step for _, step in reads} == set(ds.step.values.tolist())
    assert set(reads.values()) == {1}
