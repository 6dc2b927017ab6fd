"""Memory holds the steps that are being worked on, not the series."""

from __future__ import annotations

import gc
import tracemalloc

import dask
import pytest

import xcg
from tests.benchmarks import series

FEW, MANY = 4, 32


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    # memory follows the chunk, which is several of such small steps where none is given
    return xcg.open_scene(**series.write_vtp_series(tmp_path_factory.mktemp("files"), 2000, MANY), chunks=1)


def peak(work) -> int:
    """Most bytes that were in use beyond those at the start."""
    gc.collect()
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".vtkhdf"])
@pytest.mark.parametrize("what", ["fields", "scene"])
def test_memory_does_not_grow_with_the_series(scene, tmp_path, suffix, what, monkeypatch):
    if what == "scene" and suffix == ".vtkhdf":
        pytest.skip("scenes are no images")

    def save(steps):
        ds = scene.isel(time=slice(0, steps))
        if what == "fields":
            ds = ds.cg.coarse_grain(["density", "stress"], spacing=1.0)
        xcg.save(ds, tmp_path / f"{steps}{suffix}")

    step = scene.nbytes / MANY
    monkeypatch.setattr("xcg.writers.zarr._SHARD", step)  # else short steps share files, and wait for one another
    with dask.config.set(scheduler="threads", num_workers=2):
        save(2)  # whatever is compiled and imported once
        few, many = peak(lambda: save(FEW)), peak(lambda: save(MANY))
    assert few > step  # the measurement sees the arrays
    assert many < few + 4 * step, f"{(many - few) / step:.1f} more steps in memory for {MANY - FEW} more in the series"


def test_a_graph_holds_no_data(scene):
    """What is built before anything is computed is small: it travels to a scheduler as a whole."""
    import cloudpickle

    f = scene.cg.coarse_grain(["density", "stress"])
    assert len(cloudpickle.dumps(f.__dask_graph__())) < 10_000 * MANY
