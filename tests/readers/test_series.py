from __future__ import annotations

import os
import pickle
import subprocess
import sys
import warnings
from pathlib import Path

import dask
import numpy as np
import pytest
import xarray as xr

from tests import real_data
from tests.dumps import ATOMS, BOX, ROWS, dump_text, pairs_text, write, write_series
from xcg.common.messages import SceneError, SceneWarning
from xcg.readers.engine import Engine, StepRef
from xcg.readers.open import open_scene
from xcg.readers.paths import expand_paths


@pytest.fixture
def series(tmp_path):
    """Three steps in files of their own, with times 0, 1, 2."""
    return write_series(tmp_path, before="ITEM: TIME\n{time}\n")


# --- paths -----------------------------------------------------------------------------------------------


def test_files_are_in_natural_order(tmp_path):
    names = ["p9.dump", "p10.dump", "p100.dump"]
    for name in names:
        write(tmp_path / name, "")
    assert [Path(path).name for path in expand_paths(tmp_path / "p*.dump", "particles")] == names


def test_lists_keep_their_order(tmp_path):
    for name in ("b1", "b2", "a[1].dump"):
        write(tmp_path / name, "")
    given = [tmp_path / "b2", str(tmp_path / "b*"), tmp_path / "a[1].dump"]
    found = expand_paths(given, "particles")
    assert [Path(path).name for path in found] == ["b2", "b1", "a[1].dump"]


@pytest.mark.parametrize(
    ("path", "match"),
    [
        (
            "particle.*.dump",
            r"contacts='.*particle\.\*\.dump': no file matches .* 2 files, .*'particles.10.dump'",
        ),
        (
            "particles.11.dump",
            "no such file; the folder .* holds 2 files, among them 'particles.10.dump'",
        ),
        ("nowhere/*.dump", "the folder '.*nowhere' does not exist"),
        ("empty/*.dump", "the folder '.*empty' holds no files"),
        ("**/nothing", "no file matches this pattern"),
        ("empty", "is a folder; give the files in it"),
        ("saved.zarr", "saved.zarr' is a Zarr folder, opened alone"),
    ],
)
def test_missing_paths_raise(tmp_path, path, match):
    (tmp_path / "empty").mkdir()
    (tmp_path / "saved.zarr").mkdir()
    for name in ("particles.10.dump", "contacts.10.dump"):
        write(tmp_path / name, "")
    with pytest.raises(FileNotFoundError, match=match):
        expand_paths(str(tmp_path / path), "contacts")
    with pytest.raises(FileNotFoundError, match="at least one file"):
        expand_paths([], "contacts")


# --- the scene -------------------------------------------------------------------------------------------


def test_a_series_is_opened_as_a_lazy_scene(series):
    particles, contacts = series
    scene = open_scene(particles, contacts=contacts)
    assert dict(scene.sizes) == {"time": 3, "particle": 3, "contact": 1, "component": 3, "bound": 2}
    assert all(scene[name].chunks[0] == (3,) for name in scene.data_vars if name != "box")
    assert scene["box"].chunks is None
    scene = scene.compute()
    np.testing.assert_array_equal(scene.time, [0, 1, 2])
    np.testing.assert_array_equal(scene.step, [0, 10, 20])
    np.testing.assert_array_equal(scene.particle_id, [[1, 2, 3]] * 3)  # sorted, not as in the file
    np.testing.assert_array_equal(scene.position[2, 2], [3, 3, 0.5])
    np.testing.assert_allclose(scene.volume, np.pi / 6)
    np.testing.assert_allclose(scene.density, 6 / np.pi)
    np.testing.assert_array_equal(scene.contact_force[1, 0], [-9, 1, 0])
    np.testing.assert_allclose(scene.contact_point[0, 0], [1.45, 1, 1.25])
    assert scene.attrs["periodic"] == "xy"
    assert scene.attrs["d43"] == 1
    assert all({"units", "long_name"} <= set(scene[name].attrs) for name in scene.data_vars)


def test_contacts_are_the_second_argument(series):
    particles, contacts = series
    xr.testing.assert_identical(
        open_scene(particles, contacts), open_scene(particles, contacts=contacts)
    )


def test_types_of_the_graph_equal_those_of_the_arrays(series):
    scene = open_scene(
        series[0], contacts=series[1], frozen=2, names={"vx": "colour", "vy": None, "vz": None}
    )
    computed = scene.compute()
    for name, values in scene.data_vars.items():
        assert values.dtype == computed[name].dtype
        assert values.shape == computed[name].shape
        assert values.dtype == ("int64" if name in INTEGERS else "float64")


INTEGERS = ("particle_id", "species", "frozen", "contact_i", "contact_j")


def test_steps_of_different_length_are_padded(tmp_path):
    for step, rows in enumerate((ROWS[1:2], ROWS, [])):
        write(tmp_path / f"p.{step}.dump", dump_text(rows, step=step))
        write(
            tmp_path / f"c.{step}.dump",
            pairs_text(["1 2 1 0 0 0 0 0"] * (len(rows) - 2), step=step),
        )
    for chunks in (1, 2, -1):
        scene = open_scene(tmp_path / "p.*", contacts=tmp_path / "c.*", chunks=chunks).compute()
        np.testing.assert_array_equal(scene.particle_id, [[1, -1, -1], [1, 2, 3], [-1, -1, -1]])
        np.testing.assert_array_equal(scene.contact_i, [[-1], [1], [-1]])
        assert np.isnan(scene.position[0, 1:]).all()
        assert np.isnan(scene.contact_force[[0, 2]]).all()


def test_extent_covers_the_first_and_the_last_step(tmp_path):
    for step, x in enumerate((1, 9, 5)):
        write(tmp_path / f"p.{step}.dump", dump_text([f"1 1 {x} 1 1 0 0 0 0.5 1"], step=step))
    attrs = open_scene(tmp_path / "p.*").attrs
    assert (attrs["particle_lower"][0], attrs["particle_upper"][0]) == (1, 5)


# --- laziness --------------------------------------------------------------------------------------------


def test_opening_reads_the_first_and_the_last_particles_only(series, reads):
    with dask.config.set(
        scheduler=lambda *args, **kwargs: pytest.fail("computed while the graph was built")
    ):
        open_scene(series[0], contacts=series[1])
    assert reads == {("particles", 0): 1, ("particles", 20): 1}


def test_each_body_is_parsed_once_for_all_variables(series, reads):
    scene = open_scene(series[0], contacts=series[1])
    scene.compute(scheduler="sync")
    assert set(reads.values()) == {1}
    assert len(reads) == 6


def test_particles_do_not_touch_contacts(series, reads):
    scene = open_scene(series[0], contacts=series[1], chunks=2)
    scene.density.isel(time=slice(0, 2)).compute(scheduler="sync")
    assert reads == {("particles", 0): 1, ("particles", 10): 1, ("particles", 20): 1}
    scene.density.isel(time=slice(0, 2)).compute(scheduler="sync")
    assert reads == {("particles", 0): 2, ("particles", 10): 2, ("particles", 20): 1}


def test_contacts_of_one_step_touch_that_step_only(series, reads):
    scene = open_scene(series[0], contacts=series[1], chunks=1)
    reads.clear()
    scene.contact_force.isel(time=1).compute(scheduler="sync")
    assert reads == {("particles", 10): 1, ("contacts", 10): 1}


@pytest.mark.parametrize(("chunks", "expected"), [
    (1, (1, 1, 1)), (2, (2, 1)), (7, (3,)), (-1, (3,)), ({}, (1, 1, 1)), ({"time": 2, "particle": -1}, (2, 1)),
    ({"time": -1}, (3,)), ({"time": (1, 2)}, (1, 2)), ((2, 1), (2, 1)), ("auto", (3,)), ({"time": "auto"}, (3,)),
    ({"time": None}, (1, 1, 1)),
])  # fmt: skip
def test_chunks_are_as_requested(series, chunks, expected):
    scene = open_scene(series[0], contacts=series[1], chunks=chunks)
    assert scene.contact_point.chunks == (expected, (1,), (3,))
    xr.testing.assert_identical(
        scene.compute(), open_scene(series[0], contacts=series[1]).compute()
    )


@pytest.mark.parametrize("chunks", [0, -2, 1.5])
def test_wrong_chunks_raise(series, chunks):
    with pytest.raises(SceneError, match=f"chunks={chunks}"):
        open_scene(series[0], chunks=chunks)


@pytest.mark.parametrize(
    "chunks", ["often", True, {"particle": 2}, {"time": 0}, (1, 1), (4, -1), [[3]], {"time": {}}]
)
def test_chunks_that_xarray_would_refuse(series, chunks):
    with pytest.raises(SceneError, match=r"chunks=.*: expected"):
        open_scene(series[0], chunks=chunks)


def test_automatic_chunks_follow_files_and_memory(tmp_path):
    class Steps(Engine):
        length = 3_000_000

        def index_particles(self, paths, options):
            return [StepRef(paths[0], rows=100, step=k, length=self.length) for k in range(10)]

        def read_particles(self, ref, options):
            return {"position": np.eye(3)}

    path = write(tmp_path / "p.txt", "")
    for length, sizes in (
        (3_000_000, (5, 5)),  # four steps have 10 MB of files, which makes two equal tasks
        (1_500_000, (10,)),  # seven steps have 10 MB: two tasks have more
        (100, (10,)),
    ):
        engine = type("Sized", (Steps,), {"length": length})
        assert open_scene(path, engine=engine).chunks["time"] == sizes
    step = 100 * (3 + 1) * 8  # position and id
    with dask.config.set({"array.chunk-size": f"{3 * step + 1}B"}):
        assert open_scene(path, engine=Steps, chunks="auto").chunks["time"] == (3, 3, 3, 1)
    with dask.config.set({"array.chunk-size": "1B"}):
        assert open_scene(path, engine=Steps, chunks="auto").chunks["time"] == (1,) * 10


def test_task_names_depend_on_contents(series, tmp_path):
    first = open_scene(series[0], contacts=series[1])
    assert open_scene(series[0], contacts=series[1]).position.data.name == first.position.data.name
    other = open_scene(series[0], contacts=series[1], frozen=2)
    assert other.position.data.name != first.position.data.name
    write(tmp_path / "p.10.dump", (tmp_path / "p.10.dump").read_text().replace("1.9", "1.8"))
    assert open_scene(series[0], contacts=series[1]).position.data.name != first.position.data.name


def test_work_on_chunks_is_merged_with_the_picking(series):
    """Or each step of each variable costs two tasks before dask finds out, which xarray's writers feel."""
    particles, contacts = series
    ds = open_scene(particles, contacts=contacts)
    with dask.config.set({"optimization.fuse.active": False}):
        for array in (ds.position.data, ds.cg.coarse_grain("density", axes="z").density.data):
            (found,) = dask.optimize(array.map_blocks(np.sqrt))
            assert not [key for key in found.dask.to_dict() if key[0] == array.name]
            np.testing.assert_array_equal(found.compute(), np.sqrt(array.compute()))


def test_the_graph_pickles(series, computing):
    scene = open_scene(series[0], contacts=series[1], frozen=[2])
    expected = scene.compute()
    xr.testing.assert_identical(pickle.loads(pickle.dumps(scene)).compute(), expected)
    xr.testing.assert_identical(scene.compute(**computing("processes")), expected)


def test_files_that_changed_are_noticed(series, tmp_path):
    scene = open_scene(series[0], contacts=series[1], chunks=1)
    write(tmp_path / "p.10.dump", dump_text(step=10))
    with pytest.raises(
        SceneError, match=r"p\.10\.dump \(step 10\): the file has \d+ bytes, but had \d+"
    ):
        scene.position.compute()
    (tmp_path / "c.20.dump").unlink()
    with pytest.raises(SceneError, match=r"c\.20\.dump \(step 20\): the file is gone"):
        scene.contact_i.isel(time=2).compute()


def test_a_changed_file_of_equal_size_is_noticed(tmp_path):
    path = write(tmp_path / "p.0.dump", dump_text(step=0))
    scene = open_scene(path)
    size = path.stat().st_size
    modified = path.stat().st_mtime_ns
    write(path, dump_text(step=5, box="ITEM: BOX BOUNDS pp pp ff\n0 11\n0 10\n-1 9\n"))
    os.utime(path, ns=(modified + 1, modified + 1))
    assert path.stat().st_size == size
    with pytest.raises(SceneError, match=r"p\.0\.dump \(step 0\): the file was written again"):
        scene.position.compute()
    assert open_scene(path).step.item() == 5


def test_bodies_are_checked_when_they_are_read(tmp_path, series):
    write(
        tmp_path / "c.10.dump", pairs_text(["1 7 1 0 0 0 0 0"], step=10, before="ITEM: TIME\n1.0\n")
    )
    scene = open_scene(series[0], contacts=series[1])
    with pytest.raises(SceneError, match=r"c\.10\.dump \(step 10\): contact row 0 has contact_j=7"):
        scene.contact_i.compute()


def test_unknown_ids_can_be_walls(tmp_path):
    write(tmp_path / "p.dump", dump_text())
    text = pairs_text(["1 7 1 0 0 4 5 6"], "id1 id2 fx fy fz cx cy cz")
    names = {f"c{axis}": f"contact_point_{axis}" for axis in "xyz"}
    contacts = write(tmp_path / "c.dump", text)
    scene = open_scene(tmp_path / "p.dump", contacts=contacts, names=names, allow_unknown=True)
    np.testing.assert_array_equal(scene.contact_j.compute(), [[7]])


# --- pairing ---------------------------------------------------------------------------------------------


def test_contacts_that_start_later(series, tmp_path):
    particles, contacts = series
    (tmp_path / "c.0.dump").unlink()
    with pytest.raises(
        SceneError, match=r"1 of 3 steps of the particles \(.*p\.0\.dump.*missing='skip'"
    ):
        open_scene(particles, contacts=contacts)
    with pytest.warns(
        SceneWarning, match=r"1 of 3 steps have no contacts and are left out: .*p\.0\.dump"
    ):
        scene = open_scene(particles, contacts=contacts, missing="skip")
    np.testing.assert_array_equal(scene.time, [1, 2])
    np.testing.assert_array_equal(scene.contact_i.compute(), [[1], [1]])
    with pytest.raises(
        ValueError, match="missing='ignore': expected one of 'raise', 'skip', 'empty'"
    ):
        open_scene(particles, missing="ignore")


def test_contacts_without_particles(series, tmp_path):
    (tmp_path / "p.10.dump").unlink()
    with pytest.warns(SceneWarning, match=r"1 steps of contacts have no particles .*c\.10\.dump"):
        scene = open_scene(series[0], contacts=series[1])
    np.testing.assert_array_equal(scene.step, [0, 20])


def test_time_pairs_before_the_step_number(tmp_path):
    for step, (time, wrong) in enumerate(((0.0, 1.0), (1.0, 2.0), (2.0, 3.0))):
        write(tmp_path / f"p.{step}.dump", dump_text(step=step, before=f"ITEM: TIME\n{time}\n"))
        text = pairs_text([f"1 2 {wrong} 0 0 0 0 0"], step=step, before=f"ITEM: TIME\n{wrong}\n")
        write(tmp_path / f"c.{step}.dump", text)
    with pytest.warns(SceneWarning) as record:
        scene = open_scene(tmp_path / "p.*", contacts=tmp_path / "c.*", missing="skip")
    assert len(record) == 2
    assert all(Path(warning.filename) == Path(__file__) for warning in record)
    np.testing.assert_array_equal(scene.contact_force[:, 0, 0].compute(), scene.time)
    np.testing.assert_array_equal(scene.time, [1, 2])


@pytest.mark.parametrize(
    ("times", "near"),
    [((0.0, 1.0, 11.0), 1e-3), ((0.0, 10.0, 10.5), 0.5e-3), ((7.0,), 7e-6)],
    ids=str,
)
def test_times_pair_within_a_thousandth_of_the_shortest_interval(tmp_path, times, near):
    """For a single step it is a millionth of the time."""
    for share, paired in ((0.9, True), (-0.9, True), (1.1, False), (-1.1, False)):
        for step, time in enumerate(times):
            off = share * near if step == len(times) - 1 else 0.0
            write(tmp_path / f"p.{step}.dump", dump_text(step=step, before=f"ITEM: TIME\n{time}\n"))
            text = pairs_text(
                ["1 2 5 0 0 0 0 0"], step=step, before=f"ITEM: TIME\n{time + off:.12g}\n"
            )
            write(tmp_path / f"c.{step}.dump", text)
        if paired:
            scene = open_scene(tmp_path / "p.*", contacts=tmp_path / "c.*")
            assert (scene.contact_force[:, 0, 0] == 5).all()
        else:
            with pytest.raises(
                SceneError, match=f"no step with the same time for 1 of {len(times)} steps"
            ):
                open_scene(tmp_path / "p.*", contacts=tmp_path / "c.*")


def test_contacts_without_matching_steps_raise(series, tmp_path):
    other = write(tmp_path / "other.dump", pairs_text(step=99, before="ITEM: TIME\n9.9\n"))
    with pytest.raises(SceneError, match="no step with the same time for 3 of 3 steps"):
        open_scene(series[0], contacts=other, missing="skip")


def test_step_numbers_pair_without_times(tmp_path):
    particles, contacts = write_series(tmp_path)
    scene = open_scene(particles, contacts=contacts)
    np.testing.assert_array_equal(scene.time, [0, 10, 20])
    assert scene.time.attrs["units"] == "1"
    assert "number of the time step" in scene.time.attrs["long_name"]
    with pytest.raises(SceneError, match="no step with the same step number"):
        open_scene(particles, contacts=str(tmp_path / "c.?.dump"))


def test_steps_written_twice_count_once(series, tmp_path):
    write(tmp_path / "p.21.dump", (tmp_path / "p.20.dump").read_text())
    write(tmp_path / "c.21.dump", (tmp_path / "c.20.dump").read_text())
    with pytest.warns(SceneWarning) as record:
        scene = open_scene(series[0], contacts=series[1])
    assert [str(warning.message).split(":")[0] for warning in record] == ["particles", "contacts"]
    assert "p.20.dump (step 20) is left out, as" in str(record[0].message)
    np.testing.assert_array_equal(scene.time, [0, 1, 2])


def test_files_in_any_order_are_sorted_by_time(series):
    files = [series[0].replace("*", str(step)) for step in (20, 0, 10)]
    np.testing.assert_array_equal(open_scene(files).time, [0, 1, 2])


def test_times_of_the_caller_are_taken(series):
    scene = open_scene(series[0], contacts=series[1], times=[5, 6, 8])
    np.testing.assert_array_equal(scene.time, [5, 6, 8])
    np.testing.assert_array_equal(scene.contact_i.compute(), [[1]] * 3)
    with pytest.raises(SceneError, match=r"times has shape \(2,\): expected 3 finite numbers"):
        open_scene(series[0], times=[5, 6])
    with pytest.warns(SceneWarning, match="has its time or step number"):
        assert open_scene(series[0], times=[5, 5, 8]).sizes["time"] == 2


# --- what must not change along a series -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (
            dump_text([f"{row} 1" for row in ROWS], ATOMS + " q", step=30),
            "column 'q' is in the second only",
        ),
        (
            dump_text(columns=ATOMS.replace("mass", "density"), step=30),
            "column 'mass' is in the first only; column 'density' is in the second only",
        ),
        (
            dump_text(step=30, box=BOX.replace("pp ff", "ff ff")),
            "periodic: 'xy' became 'x' .*periodic=",
        ),
        (dump_text(step=30, box=""), "the box is in the first only"),
        (dump_text(step=30, before="ITEM: UNITS\nlj\n"), "units: 'si' became 'lj'"),
        (dump_text(step=30, before="ITEM: TIME\n3\n"), "the time is in the second only"),
    ],
)
def test_headers_that_change_raise(tmp_path, text, match):
    particles, _ = write_series(tmp_path)
    write(tmp_path / "p.30.dump", text)
    with pytest.raises(SceneError, match=match) as error:
        open_scene(particles)
    assert "p.0.dump" in str(error.value)
    assert "p.30.dump" in str(error.value)


def test_the_caller_overrides_headers_that_change(tmp_path):
    particles, _ = write_series(tmp_path)
    write(tmp_path / "p.30.dump", dump_text(step=30, box=BOX.replace("pp ff", "ff ff")))
    assert open_scene(particles, periodic="x").attrs["periodic"] == "x"


def test_another_order_of_columns_is_no_change(tmp_path):
    particles, _ = write_series(tmp_path)
    rows = [" ".join([*row.split()[1:], row.split()[0]]) for row in ROWS]
    columns = " ".join([*ATOMS.split()[1:], "id"])
    write(tmp_path / "p.30.dump", dump_text(rows, columns, step=30))
    scene = open_scene(particles).compute()
    np.testing.assert_array_equal(scene.position[3], scene.position[0])


# --- what holds for the whole scene ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("system", "units", "length", "mass", "time", "name"),
    [
        ("si", None, 1, 1, 1, "SI"),
        ("lj", None, 1, 1, 1, "reduced"),
        ("cgs", None, 1e-2, 1e-3, 1, "SI"),
        ("micro", None, 1e-6, 1e-15, 1e-6, "SI"),
        ("nano", None, 1e-9, 1e-21, 1e-9, "SI"),
        ("lj", {"length": 0.1}, 0.1, 1, 1, "SI"),
        ("real", {"mass": 2.0}, 1, 2, 1, "SI"),
        ("si", "reduced", 1, 1, 1, "reduced"),
    ],
)
def test_units_are_read_from_headers(tmp_path, system, units, length, mass, time, name):
    before = f"ITEM: UNITS\n{system}\nITEM: TIME\n{{time}}\n"
    particles, contacts = write_series(tmp_path, before=before)
    scene = open_scene(particles, contacts=contacts, units=units).compute()
    assert scene.attrs["unit_system"] == name
    assert scene.position.attrs["units"] == ("m" if name == "SI" else "1")
    np.testing.assert_allclose(scene.time, np.array([0, 1, 2]) * time)
    np.testing.assert_allclose(scene.position[0, 0], np.array([1, 1, 1]) * length)
    np.testing.assert_allclose(scene.velocity[0, 0], np.array([0.1, 0.2, 0.3]) * length / time)
    np.testing.assert_allclose(scene.mass, mass)
    np.testing.assert_allclose(
        scene.contact_force[0, 0], np.array([-9, 1, 0]) * mass * length / time**2
    )
    np.testing.assert_allclose(scene.box[0, 0], [0, 10 * length])
    np.testing.assert_allclose(scene.contact_point[0, 0], np.array([1.45, 1, 1.25]) * length)


def test_unknown_and_contradictory_units_raise(tmp_path):
    particles, _ = write_series(tmp_path, before="ITEM: UNITS\nmetal\n")
    with pytest.raises(SceneError, match=r"'metal', whose unit of force.*units="):
        open_scene(particles)
    write(tmp_path / "p.dump", dump_text(before="ITEM: UNITS\nsi\n"))
    write(tmp_path / "c.dump", pairs_text(before="ITEM: UNITS\nlj\n"))
    with pytest.raises(SceneError, match=r"different unit systems .*'si' in .*'lj' in "):
        open_scene(tmp_path / "p.dump", contacts=tmp_path / "c.dump")


def test_box_and_periodicity_of_the_caller(series):
    scene = open_scene(series[0], box={"x": (0, 5)}, periodic="x")
    np.testing.assert_array_equal(scene.box[1], [[0, 5], [-np.inf, np.inf], [-np.inf, np.inf]])
    with pytest.raises(SceneError, match="axis 'y' is periodic, but the box has no finite extent"):
        open_scene(series[0], box={"x": (0, 5)})
    moving = np.array([[[0, 5 + k]] * 3 for k in range(3)])
    np.testing.assert_array_equal(open_scene(series[0], box=moving).box, moving)


def test_files_without_a_box(tmp_path):
    write(tmp_path / "p.dump", dump_text(box=""))
    scene = open_scene(tmp_path / "p.dump")
    assert "box" not in scene
    assert scene.attrs["periodic"] == ""


def test_dimension_is_detected(tmp_path):
    path = write(tmp_path / "p.dump", dump_text(["1 1 5 2", "2 2 5 3", "3 4 5 2"], "id x y z"))
    scene = open_scene(path, periodic="xy", box=[[0, 9]] * 3)
    assert (scene.attrs["dimension"], scene.attrs["plane"], scene.attrs["periodic"]) == (
        2,
        "xz",
        "xy",
    )
    assert open_scene(path).attrs["periodic"] == "x"  # the header's "xy" has y across the plane
    assert open_scene(path, dimension=3).attrs["dimension"] == 3
    assert open_scene(path, plane="yz").attrs["plane"] == "yz"
    assert open_scene(path, dimension=2).attrs["plane"] == "xz"
    two = write(tmp_path / "two.dump", dump_text(["1 1 5 2", "2 2 5 3"], "id x y z"))
    assert open_scene(two).attrs["dimension"] == 3  # too few to tell


def test_a_scene_that_leaves_its_plane_is_not_flat(tmp_path):
    write(tmp_path / "p.0.dump", dump_text(["1 1 5 2", "2 2 5 3", "3 4 5 2"], "id x y z"))
    write(tmp_path / "p.1.dump", dump_text(["1 1 5 2", "2 2 4 3", "3 4 5 2"], "id x y z", step=1))
    assert open_scene(tmp_path / "p.*").attrs["dimension"] == 3


def test_discs_have_volumes_of_cylinders(tmp_path):
    path = write(tmp_path / "p.dump", dump_text(["1 1 5 2", "2 2 6 2", "3 4 5 2"], "id x y radius"))
    scene = open_scene(path, shape="disc", thickness=0.5, density=2)
    np.testing.assert_allclose(scene.mass, np.pi * 4 * 0.5 * 2)


def test_sizes_from_volumes(tmp_path):
    rows = ["1 1 5 2 0.3", "2 2 6 2 0.6", "3 4 5 2 1.2"]
    path = write(tmp_path / "p.dump", dump_text(rows, "id x y mass v"))
    volumes = np.array([0.3, 0.6, 1.2])
    disc = open_scene(path, shape="disc", thickness=0.5, names={"v": "volume"}).compute()
    np.testing.assert_allclose(disc.diameter.values[0] ** 2 * np.pi / 4 * 0.5, volumes, rtol=1e-14)
    sphere = open_scene(path, names={"v": "volume"}).compute()
    np.testing.assert_allclose(sphere.diameter.values[0] ** 3 * np.pi / 6, volumes, rtol=1e-14)


@pytest.mark.parametrize("column", ["mass", "density"])
def test_variables_of_files_take_precedence_over_density(tmp_path, column):
    path = write(
        tmp_path / "p.dump",
        dump_text(["1 1 5 2 7", "2 2 6 2 7", "3 4 5 2 7"], f"id x y radius {column}"),
    )
    with pytest.warns(SceneWarning, match="density=2 is not used"):
        with_it = open_scene(path, density=2.0).compute()
    without = open_scene(path).compute()
    for name in ("mass", "density"):
        np.testing.assert_array_equal(with_it[name], without[name])
    np.testing.assert_array_equal(with_it[column], 7.0)


def test_frozen_species_are_marked(series):
    scene = open_scene(series[0], frozen=2)
    np.testing.assert_array_equal(scene.frozen.compute()[0], [0, 0, 1])
    np.testing.assert_array_equal(open_scene(series[0], frozen=(1, 2)).frozen.compute(), 1)
    with pytest.raises(SceneError, match="frozen=7: no particle is of species 7; there are 1, 2"):
        open_scene(series[0], frozen=7)
    with pytest.raises(SceneError, match=r"no particle is of species 2; there are none"):
        open_scene(series[0], frozen=2, names={"type": None})


# --- the engine ------------------------------------------------------------------------------------------


def test_wrong_arguments_raise(series, tmp_path):
    with pytest.raises(
        SceneError,
        match=r"unknown engine 'lamps'; did you mean 'lammps'\? Expected one of lammps, ",
    ):
        open_scene(series[0], engine="lamps")
    with pytest.raises(
        SceneError, match="no argument 'periodc' for the engine 'lammps'; did you mean 'periodic'"
    ):
        open_scene(series[0], periodc="x")
    with pytest.raises(SceneError, match="no argument 'restart' for the engine 'lammps'"):
        open_scene(series[0], restart="x")
    path = write(tmp_path / "q.dump", dump_text(["1 1 5 2 3"], "id x y z c_nc"))
    with pytest.raises(
        SceneError,
        match=r"names=\{'c_cn': ...\}: unknown column 'c_cn'; did you mean 'c_nc'\? Columns are ",
    ):
        open_scene(path, names={"c_cn": "coordination_number"})
    with pytest.raises(
        SceneError, match=r"no engine recognises .*x\.txt; name one with engine=: lammps, lig"
    ):
        open_scene(write(tmp_path / "x.txt", "hello\n"))
    with pytest.raises(SceneError, match=r"x\.txt: the file is empty; write it again"):
        open_scene(write(tmp_path / "x.txt", ""))


def test_vtk_is_imported_only_when_needed():
    code = "import sys, xcg; sys.exit(any(name.startswith('vtk') for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- real output -----------------------------------------------------------------------------------------


def test_the_chute_opens_without_warnings():
    folder = real_data("lammps_chute")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = open_scene(
            folder / "particles.*.dump.gz", contacts=folder / "contacts.*.dump.gz", frozen=2
        )
    assert scene.sizes["time"] == 3
    assert scene.sizes["particle"] == 4398
    assert (scene.attrs["unit_system"], scene.attrs["periodic"]) == ("reduced", "xy")
    np.testing.assert_array_equal(scene.time, [30.0, 40.0, 50.0])
    assert int(scene.frozen.isel(time=0).sum()) == 215
    np.testing.assert_array_equal((scene.contact_i >= 0).sum("contact")[:1], 6240)
    assert float(abs(scene.velocity.where(scene.frozen == 1)).max()) == 0
