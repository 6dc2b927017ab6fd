"""Memory holds the steps that are being worked on, not the series."""

from __future__ import annotations

import gc
import tracemalloc

import dask
import numpy as np
import pytest

import xcg
from tests.benchmarks import series
from xcg.fields import segments
from xcg.scene.complete import complete_particles
from xcg.scene.frame import indices_of, stack
from xcg.scene.schema import Setup

FEW, MANY = 4, 32


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    # memory follows the chunk, which is several of such small steps where none is given
    return xcg.open_scene(
        **series.write_vtp_series(tmp_path_factory.mktemp("files"), 2000, MANY), chunks=1
    )


def peak(work) -> int:
    """Most bytes that were in use beyond those at the start."""
    gc.collect()
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "suffix",
    # one path through the steps, which NetCDF shows as well
    [".nc", *(pytest.param(suffix, marks=pytest.mark.slow) for suffix in (".zarr", ".vtkhdf"))],
)
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
    monkeypatch.setattr(
        "xcg.writers.formats._TOGETHER", step
    )  # else short steps share files, and wait for one another
    with dask.config.set(scheduler="threads", num_workers=2):
        save(2)  # whatever is compiled and imported once
        few, many = peak(lambda: save(FEW)), peak(lambda: save(MANY))
    assert few > step  # the measurement sees the arrays
    assert many < few + 4 * step, (
        f"{(many - few) / step:.1f} more steps in memory for {MANY - FEW} more in the series"
    )


def test_a_graph_holds_no_data(scene):
    """What is built before anything is computed is small: it travels to a scheduler as a whole."""
    import cloudpickle

    f = scene.cg.coarse_grain(["density", "stress"])
    assert len(cloudpickle.dumps(f.__dask_graph__())) < 10_000 * MANY


@pytest.fixture(scope="module")
def packing():
    return xcg.datasets.dense_packing(20_000)


@pytest.mark.parametrize("shuffled", [False, True], ids=["sorted", "shuffled"])
def test_a_scene_is_built_in_little_more_memory_than_it_takes(packing, shuffled, monkeypatch):
    monkeypatch.setattr(
        "xcg.scene.contact_points._BLOCK", 256
    )  # contact points are derived in blocks
    names = [
        "particle_id",
        "position",
        "velocity",
        "diameter",
        "species",
        "contact_i",
        "contact_j",
        "contact_force",
    ]
    given = {name: packing[name].to_numpy()[0] for name in names}
    if shuffled:
        rows = np.random.default_rng(0).permutation(packing.sizes["particle"])
        given |= {name: given[name][rows] for name in names if not name.startswith("contact")}
    given |= {"box": packing.box.to_numpy()[0], "periodic": "xyz", "density": 2500.0}
    built = xcg.scene_from_arrays(**given)  # imports what is imported once
    # threads of a cluster that other tests have started add to one of them
    most = min(peak(lambda: xcg.scene_from_arrays(**given)) for _ in range(3))
    assert most < 1.3 * built.nbytes
    assert not any(np.shares_memory(built[name].to_numpy(), given[name]) for name in names)


def test_a_frame_is_completed_in_little_more_memory_than_it_takes():
    """No array is held twice while it is put in order: `complete_particles` takes them out of the frame."""
    rng = np.random.default_rng(0)
    count = 40_000
    frames = []

    def work():
        frame = {
            "particle_id": rng.permutation(count).astype(float),
            "position": rng.random((count, 3)),
            "velocity": rng.random((count, 3)),
            "diameter": rng.uniform(0.9, 1.1, count),
            "mass": rng.uniform(0.9, 1.1, count),
        }
        frames.append(complete_particles(frame, Setup.make(), "scene"))
        assert frame == {}

    most = peak(work)
    assert most < 1.45 * sum(array.nbytes for array in frames[0].values())


def test_passes_of_a_step_take_little_beside_their_records(packing):
    def work():
        packing.cg.coarse_grain(width=4.0, spacing=4.0)

    work()  # whatever is compiled and imported once
    records = 80 * packing.sizes["contact"] + 8 * 12 * packing.sizes["particle"]
    assert peak(work) < 1.6 * records


def test_steps_of_many_contacts_do_not_keep_their_segments(packing, monkeypatch):
    """Of the eighty bytes that a segment takes; its share in the bounds of a run is one."""
    monkeypatch.setattr(segments, "_TOGETHER", 4)

    def work():
        packing.cg.coarse_grain("contact_stress", width=4.0, spacing=4.0)

    work()
    kept = peak(work)
    monkeypatch.setattr(segments, "MOST_LISTED_ONCE", 0)
    work()
    saved = (kept - peak(work)) / packing.sizes["contact"]
    assert saved > 70


def test_sorted_arrays_are_not_copied():
    ids = np.arange(5)
    wanted = np.array([3, 0, 4])
    assert indices_of(ids, wanted) is wanted
    assert indices_of(ids, np.array([3, -2, 5])).tolist() == [3, -1, -1]
    frame = {"particle_id": ids, "position": np.zeros((5, 3))}
    one = stack([frame], list(frame), 5)
    padded = stack([frame], list(frame), 6)
    assert np.shares_memory(one["position"], frame["position"])
    assert padded["particle_id"].tolist() == [[0, 1, 2, 3, 4, -1]]
