"""The same calls under a cluster of processes: equal bits, nothing that cannot travel, one thread a task."""

from __future__ import annotations

import pickle
import runpy

import dask
import h5py
import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ROOT
from tests.analyses import CALLS, moving_spheres
from tests.benchmarks import series
from tests.scenes import random_steps, reopen
from tests.writers.test_save import assert_same_bits
from xcg.steps.faults import SkippedStep

distributed = pytest.importorskip("distributed")
STEPS = 5


@pytest.fixture(scope="module")
def client(cluster):
    with distributed.Client(cluster) as client:
        yield client


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A lazy scene of files."""
    return xcg.open_scene(
        **series.write_vtp_series(tmp_path_factory.mktemp("files"), 60, STEPS, base=3)
    )


def here(ds: xr.Dataset) -> xr.Dataset:
    return ds.compute(scheduler="synchronous")


def test_fields_under_a_cluster_have_equal_bits(client, scene):
    assert dask.base.get_scheduler() == client.get
    assert_same_bits(here(scene), scene.compute())
    for options in (
        {},
        {"axes": "z", "by": "species"},
        {"axes": "xz", "kernel": "gaussian", "rtol": 1e-3},
    ):
        f = scene.cg.coarse_grain(**options)
        assert_same_bits(here(f), f.compute())


@pytest.mark.filterwarnings("ignore:.*granular_temperature is NaN")
@pytest.mark.parametrize("name", CALLS)
def test_analyses_have_equal_bits_in_memory_and_under_a_cluster(client, name):
    call = CALLS[name]
    ds = moving_spheres(name)
    expected = call(ds)  # first, so that loops are compiled here, and not in each of the workers
    assert_same_bits(call(ds.chunk(time=1)).compute(), expected)


def test_kernels_of_users_reach_workers(client):
    ds = random_steps(2).chunk(time=1)
    f = ds.cg.coarse_grain(["density"], kernel=xcg.Lucy(cutoff=2.0))
    assert_same_bits(here(f), f.compute())


def test_fields_of_users_reach_workers(client):
    xcg.register_field(
        "twist", lambda f, s, o: np.linalg.eigvalsh(f.stress)[..., 0] ** 3, fields="stress"
    )
    f = random_steps(2).chunk(time=1).cg.coarse_grain(["stress", "twist"], width=0.8)
    assert_same_bits(here(f), f.compute())


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".vtkhdf"])
def test_results_are_saved_under_a_cluster(client, scene, tmp_path, suffix):
    f = scene.cg.coarse_grain(["density", "stress"], by="species")
    one = xcg.save(f, tmp_path / f"one{suffix}")
    with dask.config.set(scheduler="synchronous"):
        other = xcg.save(f, tmp_path / f"other{suffix}")
    if suffix != ".vtkhdf":
        assert_same_bits(here(f), here(reopen(one)))
        return
    with h5py.File(one) as a, h5py.File(other) as b:
        arrays = a["VTKHDF/PointData"]
        assert len(arrays) == 6
        for name in arrays:
            np.testing.assert_array_equal(arrays[name], b["VTKHDF/PointData"][name])
            assert np.nanmax(np.abs(arrays[name][-1])) > 0


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_scenes_are_saved_under_a_cluster(client, scene, tmp_path, suffix):
    assert_same_bits(here(scene), here(reopen(xcg.save(scene, tmp_path / f"scene{suffix}"))))


@pytest.mark.parametrize("suffix", [".nc", ".vtkhdf", ".pvd"])
def test_saving_under_a_cluster_reports_progress(client, scene, tmp_path, capsys, suffix):
    f = scene.cg.coarse_grain("density", axes="xz").chunk(time=1)
    f.cg.save(tmp_path / f"f{suffix}", progress=True)
    lines = [line.split(" steps")[0] for line in capsys.readouterr().err.splitlines()]
    assert lines == [f"{k} of {STEPS}" for k in range(1, STEPS + 1)]


def test_computing_under_a_cluster_reports_progress(client, scene, capsys):
    f = scene.cg.coarse_grain("density", axes="z")
    computed = f.persist()
    distributed.progress(computed, notebook=False)
    assert "100% Completed" in capsys.readouterr().out
    assert_same_bits(here(f), computed.compute())


def test_xarray_writes_results_to_zarr(client, scene, tmp_path):
    f = scene.cg.coarse_grain(["density"])
    f.to_zarr(tmp_path / "f.zarr", zarr_format=2)
    assert_same_bits(here(f), here(reopen(tmp_path / "f.zarr")))


def _refuse_pools():
    import xcg.compiled._jit

    def refuse(*_):
        message = "a task started threads of its own"
        raise AssertionError(message)

    xcg.compiled._jit.ThreadPoolExecutor = refuse


def test_tasks_take_one_thread(client, scene):
    """A task starts no threads: with several tasks at a time, they would fight for the processors."""
    client.run(_refuse_pools)
    for result in (scene.cg.coarse_grain(), scene.cg.find_contacts(), scene.cg.microstructure()):
        result.compute()


def test_scene_errors_of_workers_reach_the_client(client, tmp_path):
    """An exception of a task keeps its type and message on its way from the worker."""
    ds = xcg.open_scene(**series.write_vtp_series(tmp_path, 60, 3))
    path = tmp_path / "P_00001.vtp"
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(xcg.SceneError, match=r"P_00001\.vtp"):
        ds.cg.coarse_grain(["density"]).compute()


def test_warnings_of_workers_reach_the_client(client):
    ds = xcg.datasets.simple_cubic(3)
    ds = ds.assign(box=np.nan * ds.box).chunk(time=1)
    f = ds.cg.coarse_grain("density", axes="z", on_error="skip")
    with pytest.warns(SkippedStep, match="no finite extent"):
        f.compute()


def test_the_script_of_an_own_analysis_says_that_all_ways_agree(cluster, monkeypatch, capsys):
    connect = distributed.Client
    monkeypatch.setattr(distributed, "Client", lambda **_: connect(cluster))
    runpy.run_path(str(ROOT / "examples" / "own_analysis.py"), run_name="__main__")
    assert capsys.readouterr().out.count("same = True") == 2


def test_a_step_takes_few_tasks(scene):
    """The scheduler's cost is a task's: reading, contacts, computing, and one for each result."""
    f = scene.cg.coarse_grain(["density", "stress", "velocity"])
    (optimized,) = dask.optimize(f)
    assert len(dict(optimized.__dask_graph__())) <= STEPS * (3 + len(f))


@pytest.mark.parametrize("on_error", ["raise", "skip"])
def test_shared_arrays_are_once_in_the_graph(scene, on_error):
    """Points of a result are in the graph once, not in each task."""
    count = 20_000
    line = xr.DataArray(np.linspace(0.0, 1.0, count), dims="point")
    f = scene.cg.coarse_grain("density", at={"x": line, "y": line, "z": line}, on_error=on_error)
    graph = dict(f.density.data.__dask_graph__())
    large = [key for key, task in graph.items() if len(pickle.dumps(task)) > 8 * count]
    assert len(large) == 1, large
