"""Names and order of files as codes write them: steps and times are right, or an error names the files."""

from __future__ import annotations

import gzip
import itertools

import numpy as np
import pytest

import xcg
from tests.dumps import dump_text, pairs_text, write
from tests.lammps_forms import COLUMNS, binary_step, rows_of
from tests.readers.engines.test_vtk import write_spheres
from xcg.common.messages import SceneError, SceneWarning

GRAINS = "id type x y z vx vy vz radius mass"


def write_tables(folder, names, column="id"):
    """Write a table for each name, whose only grain lies at the place of the name in the list."""
    for place, name in enumerate(names):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(f"{column},x,y,z,radius\n1,{place},0,0,0.1\n")


def dump_of_ids(ids, step=0, **options):
    """One step of grains whose x is their id, as a dump."""
    return dump_text([f"{i} 1 {i} 1 1 0 0 0 0.5 1" for i in ids], GRAINS, step=step, **options)


# --- numbers in names ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["t_0.05.csv", "t_0.1.csv", "t_0.15.csv", "t_0.2.csv"], [0.05, 0.1, 0.15, 0.2]),
        (["t_5e-05.csv", "t_0.0001.csv", "t_1e-3.csv"], [5e-5, 1e-4, 1e-3]),
        (["t=0.5.csv", "t=1.csv", "t=1.5.csv", "t=10.csv"], [0.5, 1, 1.5, 10]),
        (["0.5.csv", "1.0.csv", "10.5.csv"], [0.5, 1, 10.5]),
        (["mu0.5_t0.1_v2.csv", "mu0.5_t0.15_v2.csv", "mu0.5_t0.2_v2.csv"], [0.1, 0.15, 0.2]),
        (["p.0.05.csv", "p.0.1.csv", "p.0.15.csv"], [0.05, 0.1, 0.15]),
        (["0.05/p.csv", "0.1/p.csv", "0.15/p.csv"], [0.05, 0.1, 0.15]),
        (["t=0.05s.csv", "t=0.1s.csv", "t=0.15s.csv"], [0.05, 0.1, 0.15]),
    ],
)
def test_decimals_in_names_are_times_in_their_order(tmp_path, names, times):
    write_tables(tmp_path, names)
    scene = xcg.open_scene(f"{tmp_path}/**/*.csv", density=1)
    np.testing.assert_array_equal(scene.time, times)
    np.testing.assert_array_equal(scene.position[:, 0, 0], np.arange(len(names)))
    assert scene.time.attrs["units"] == "s"


@pytest.mark.parametrize(
    ("names", "steps"),
    [
        (["run2_0001_v3.csv", "run2_0002_v3.csv", "run2_0010_v3.csv"], [1, 2, 10]),
        (["mu0.5_9.csv", "mu0.5_10.csv"], [9, 10]),
        (["r2.9000.csv", "r2.10000.csv"], [9000, 10000]),
        (["frame_1_step_100.csv", "frame_2_step_200.csv"], [100, 200]),
        (["100/p_7.csv", "200/p_7.csv"], [100, 200]),
        (["2024-01-05_p-9ms.csv", "2024-01-05_p-10ms.csv"], [9, 10]),
    ],
)
def test_the_number_that_varies_is_the_step(tmp_path, names, steps):
    write_tables(tmp_path, names)
    scene = xcg.open_scene(f"{tmp_path}/**/*.csv", density=1)
    np.testing.assert_array_equal(scene.step, steps)
    np.testing.assert_array_equal(scene.position[:, 0, 0], np.arange(len(names)))
    assert scene.time.attrs["units"] == "1"  # numbers are no times


def test_times_of_the_caller_follow_the_order_of_decimals(tmp_path):
    write_tables(tmp_path, ["t_0.05.csv", "t_0.1.csv", "t_0.15.csv"])
    scene = xcg.open_scene(f"{tmp_path}/t_*.csv", density=1, times=[1, 2, 3])
    np.testing.assert_array_equal(scene.position[:, 0, 0], [0, 1, 2])


@pytest.mark.parametrize(
    ("names", "match"),
    [
        (["r1_1.csv", "r1_2.csv", "r2_1.csv", "r2_2.csv"], "several numbers .*1 to 2 and 1 to 2"),
        (["o.0.1.csv", "o.0.15.csv", "o.0.2.csv"], "'0.1' .* may be a decimal or two numbers"),
        (["t0p05.csv", "t0p1.csv"], "not padded to one length"),
        (["t_0,05.csv", "t_0,1.csv"], "not padded to one length"),
        (["2024.01.05.csv", "2024.01.06.csv", "2024.02.01.csv"], "several numbers"),
        (["p_1.csv", "p_2.csv", "final.csv"], "'final' holds 0 numbers"),
        (["t_0.5ms.csv", "t_1.5ms.csv"], r"times in the names have a unit \(0.5ms\)"),
        (["0.5 us/p.csv", "1.5 us/p.csv"], r"times in the names have a unit \(0.5 us\)"),
        (["t=1s.csv", "t=500ms.csv"], r"times in the names have a unit \(500ms\)"),
        (["t_-0.5.csv", "t_-0.25.csv", "t_0.0.csv"], "'-0.5' in the names may be negative"),
        (["p_-10.csv", "p_-5.csv"], "'-10' in the names may be negative"),
    ],
)
def test_names_that_do_not_tell_the_steps_raise_until_times_are_given(tmp_path, names, match):
    write_tables(tmp_path, names)
    paths = [tmp_path / name for name in names]
    with pytest.raises(SceneError, match=f"particles: .*{match}.* give times="):
        xcg.open_scene(paths, density=1)
    scene = xcg.open_scene(paths, density=1, times=np.arange(len(names)))
    np.testing.assert_array_equal(scene.position[:, 0, 0], np.arange(len(names)))


def test_particles_and_contacts_are_paired_by_decimals(tmp_path):
    write_tables(tmp_path, ["p_0.05.csv", "p_0.1.csv", "p_0.15.csv"])
    for force, time in enumerate(("0.05", "0.1", "0.15")):
        text = f"id1,id2,fx,fy,fz,contact_point_x,contact_point_y,contact_point_z\n1,-2,{force},0,0,0,0,0\n"
        (tmp_path / f"c_{time}.csv").write_text(text)
    scene = xcg.open_scene(f"{tmp_path}/p_*.csv", contacts=f"{tmp_path}/c_*.csv", density=1)
    np.testing.assert_array_equal(scene.contact_force[:, 0, 0], [0, 1, 2])


def test_names_of_vtk_files_are_read_alike(tmp_path):
    for time in ("0.05", "0.1", "0.15"):
        write_spheres(tmp_path / f"v2_t{time}.vtu", id=[1, 2, 3], radii=[float(time)] * 3)
    scene = xcg.open_scene(f"{tmp_path}/*.vtu", density=1)
    np.testing.assert_array_equal(scene.time, [0.05, 0.1, 0.15])
    np.testing.assert_array_equal(scene.diameter[:, 0], [0.1, 0.2, 0.3])


# --- pieces of one step ----------------------------------------------------------------------------------


def write_text_pieces(folder):
    for rank, step in itertools.product(range(3), (0, 1000)):
        ids = [[1, 4], [3], []][rank]
        write(folder / f"piece.{rank}.{step}.gz", dump_of_ids(ids, step))


def write_binary_pieces(folder):
    rows = rows_of(4)
    rows[:, 0], rows[:, 2] = [1, 4, 3, 2], [1, 4, 3, 2]
    for rank, step in itertools.product(range(2), (0, 1000)):
        own = rows[[0, 1, 2][rank::2]]
        (folder / f"piece.{step}.{rank}.bin").write_bytes(binary_step(own, COLUMNS, step=step))


def write_pieces_of_many_steps(folder):
    for rank, ids in enumerate([[1], [4, 3]]):
        write(folder / f"piece.{rank}", [dump_of_ids(ids, step) for step in (0, 1000)])


def write_table_pieces(folder):
    for rank, step in itertools.product(range(2), (0, 1000)):
        rows = "".join(f"{i},{i},1,1,0.5\n" for i in [[1, 4], [3]][rank])
        (folder / f"piece_{step}_{rank}.csv").write_text("id,x,y,z,radius\n" + rows)


def write_vtk_pieces(folder):
    for rank, step in itertools.product(range(2), (0, 1000)):
        ids = [[1, 4], [3]][rank]
        x = np.outer(ids, [1.0, 0, 0])
        write_spheres(folder / f"piece.{step}.{rank}.vtu", x, id=ids, radii=[0.5] * len(ids))


@pytest.mark.parametrize(
    "write_pieces",
    [
        write_text_pieces,
        write_binary_pieces,
        write_pieces_of_many_steps,
        write_table_pieces,
        write_vtk_pieces,
    ],
)
@pytest.mark.parametrize("chunks", [None, 1])
def test_pieces_of_a_step_are_one_step(tmp_path, write_pieces, chunks):
    write_pieces(tmp_path)
    scene = xcg.open_scene(f"{tmp_path}/piece*", units="SI", chunks=chunks)
    np.testing.assert_array_equal(scene.step, [0, 1000])
    np.testing.assert_array_equal(scene.particle_id, [[1, 3, 4]] * 2)
    np.testing.assert_array_equal(scene.position[..., 0], [[1, 3, 4]] * 2)


def test_contacts_and_walls_come_from_all_pieces(tmp_path):
    wall = " ".join(f"f_w[{k}]" for k in range(1, 9))
    for rank, ids in enumerate([[1, 3], [2, 4]]):
        rows = [f"{i} 1 {i} 1 1 0 0 0 0.5 1 1 0 0 {i} {i} 1 0.5 0.5" for i in ids]
        write(tmp_path / f"p.{rank}.7", dump_text(rows, f"{GRAINS} {wall}", step=7))
        write(tmp_path / f"c.{rank}.7", pairs_text([f"{rank + 1} {rank + 2} 1 0 0 0 0 0"], step=7))
    scene = xcg.open_scene(f"{tmp_path}/p.*", contacts=f"{tmp_path}/c.*", walls={"floor": "f_w[*]"})
    ends = np.stack([scene.contact_i[0], scene.contact_j[0]], axis=1)
    assert {tuple(pair) for pair in ends} == {(1, 2), (2, 3), (1, -2), (2, -2), (3, -2), (4, -2)}
    assert float(scene.contact_force[0, :, 2].sum()) == 1 + 2 + 3 + 4


def test_a_piece_that_is_missing_is_an_error(tmp_path):
    write_text_pieces(tmp_path)
    (tmp_path / "piece.1.1000.gz").unlink()
    match = r"piece\.0\.1000\.gz \(step 1000\) is in 2 of the files, and other steps are in 3"
    with pytest.raises(SceneError, match=match):
        xcg.open_scene(f"{tmp_path}/piece*")
    with pytest.warns(SceneWarning, match=match):
        assert xcg.open_scene(f"{tmp_path}/piece*", on_error="skip").step.values == [0]


def test_a_piece_that_changed_after_opening_is_noticed(tmp_path):
    write_text_pieces(tmp_path)
    scene = xcg.open_scene(f"{tmp_path}/piece*")
    write(tmp_path / "piece.1.1000.gz", dump_of_ids([3, 5], 1000))
    with pytest.raises(SceneError, match=r"piece\.1\.1000\.gz .* after the scene was opened"):
        scene.compute()


def test_pieces_without_ids_are_an_error(tmp_path):
    write_tables(tmp_path, ["p_100_0.csv", "p_100_1.csv", "p_200_0.csv", "p_200_1.csv"], "charge")
    with pytest.raises(SceneError, match="have the same time or step number, and hold no ids"):
        xcg.open_scene(f"{tmp_path}/*.csv", density=1)


def test_pieces_of_other_boxes_are_an_error(tmp_path):
    write(tmp_path / "p.0.5", dump_of_ids([1], 5))
    write(
        tmp_path / "p.1.5", dump_of_ids([2], 5, box="ITEM: BOX BOUNDS pp pp ff\n0 9\n0 10\n-1 9\n")
    )
    with pytest.raises(SceneError, match=r"has pieces of different boxes, as in .*p\.1\.5"):
        xcg.open_scene(f"{tmp_path}/p.*")


# --- the order of steps ----------------------------------------------------------------------------------


def write_runs(folder, first, second, one_file):
    """Write the steps of two runs; grain 1 of the second is at 2, and there alone is grain 5."""
    steps = [dump_of_ids([1, 3], step) for step in first] + [
        dump_of_ids([1, 5], step) for step in second
    ]
    if one_file:
        return write(folder / "all.dump", steps)
    for name, numbers in (("a", first), ("b", second)):
        for step in numbers:
            write(folder / f"{name}.{step}.dump", steps.pop(0))
    return f"{folder}/*.dump"


@pytest.mark.parametrize("one_file", [True, False])
@pytest.mark.parametrize(
    ("first", "second"),
    [
        ((0, 100, 200), (0, 50, 100)),
        ((0, 100, 200), (0, 100, 200)),
        ((0, 100, 200), (150, 250, 350)),
        ((100, 200, 300), (0, 150)),
    ],
)
def test_steps_that_go_back_raise_until_times_are_given(tmp_path, one_file, first, second):
    path = write_runs(tmp_path, first, second, one_file)
    match = "follows step" if one_file else "steps of two runs would be mixed"
    with pytest.raises(SceneError, match=f"particles: .*{match}.*open the runs one by one.*times="):
        xcg.open_scene(path)
    count = len(first) + len(second)
    scene = xcg.open_scene(path, times=np.arange(count))
    np.testing.assert_array_equal(scene.step, [*first, *second])
    np.testing.assert_array_equal(scene.particle_id[:, 1], [3] * len(first) + [5] * len(second))


def test_a_restart_replaces_the_steps_it_computed_again(tmp_path):
    path = write_runs(tmp_path, (0, 100, 200), (100, 200, 300), one_file=False)
    with pytest.warns(SceneWarning, match="step 100.* is left out, as .*; so are 1 further"):
        scene = xcg.open_scene(path)
    np.testing.assert_array_equal(scene.step, [0, 100, 200, 300])
    np.testing.assert_array_equal(scene.particle_id[:, 1], [3, 5, 5, 5])


def test_the_last_step_may_be_written_again_where_a_run_goes_on(tmp_path):
    path = write_runs(tmp_path, (0, 100), (100, 200), one_file=True)
    with pytest.warns(SceneWarning, match="is left out"):
        np.testing.assert_array_equal(xcg.open_scene(path).particle_id[:, 1], [3, 5, 5])


def test_contacts_that_go_back_take_the_times_of_the_particles(tmp_path):
    steps = (0, 10, 0, 5)
    particles = write(tmp_path / "p.dump", [dump_of_ids([1, 2], step) for step in steps])
    pairs = [
        pairs_text([f"1 2 {place} 0 0 0 0 0"], step=step) for place, step in enumerate(steps, 1)
    ]
    contacts = write(tmp_path / "c.dump", pairs)
    scene = xcg.open_scene(particles, contacts=contacts, times=[0, 1, 2, 3])
    np.testing.assert_array_equal(scene.contact_force[:, 0, 0], [1, 2, 3, 4])


@pytest.mark.parametrize("times", [(0, 0.1, 0.2, 0, 0.05), (0, 0.1, 0.2, 0.05, 0.15)])
def test_runs_in_one_table_are_an_error(tmp_path, times):
    rows = "".join(f"{time},1,0,0,0,0.1\n" for time in times)
    (tmp_path / "runs.csv").write_text("time,id,x,y,z,radius\n" + rows)
    with pytest.raises(SceneError, match=r"runs\.csv.*open the runs one by one"):
        xcg.open_scene(tmp_path / "runs.csv", density=1)


# --- files that are cut off, and tables without names ----------------------------------------------------


@pytest.mark.filterwarnings("ignore:the box is periodic along")  # the grains are not of this box
def test_a_file_that_is_cut_off_says_which_steps_are_kept(tmp_path):
    rng = np.random.default_rng(0)
    texts = [dump_of_ids(rng.permutation(20000), step) for step in range(0, 600, 100)]
    packed = gzip.compress("".join(texts).encode())
    (tmp_path / "run.dump.gz").write_bytes(packed[: len(packed) * 3 // 5])
    kept = r"cut off .*; 3 whole steps before it \(step 0 to 200\) are kept"
    with pytest.raises(SceneError, match=f"{kept} with on_error='skip'"):
        xcg.open_scene(tmp_path / "run.dump.gz")
    with pytest.warns(SceneWarning, match=f"{kept}$"):
        scene = xcg.open_scene(tmp_path / "run.dump.gz", on_error="skip")
    np.testing.assert_array_equal(scene.step, [0, 100, 200])


ROWS = [(1, 0.5, 0.0, 0.25, 7, 0.1), (2, 1.5, 0.0, 0.75, 8, 0.2)]


@pytest.mark.parametrize(
    ("name", "separator", "before"),
    [
        ("grains.csv", ",", ""),
        ("grains.csv", "; ", ""),
        ("grains.txt", " ", "# by a script\n"),
        ("grains", "\t", "# id x y z c radius\n"),
        ("grains.dat.gz", "  ", ""),
    ],
)
def test_columns_without_names_are_named_in_their_order(tmp_path, name, separator, before):
    text = before + "".join(separator.join(map(str, row)) + "\n" for row in ROWS)
    path = write(tmp_path / name, text)
    scene = xcg.open_scene(path, density=1, names=["id", "x", "y", "z", "charge", "radius"])
    np.testing.assert_array_equal(scene.particle_id[0], [1, 2])
    np.testing.assert_array_equal(scene.position[0], [row[1:4] for row in ROWS])
    np.testing.assert_array_equal(scene.charge[0], [7, 8])
    np.testing.assert_array_equal(scene.diameter[0], [0.2, 0.4])
    skipped = xcg.open_scene(
        path,
        density=1,
        names=["particle_id", "position_x", "position_y", "position_z", None, "radius"],
    )
    assert "charge" not in skipped
    np.testing.assert_array_equal(skipped.position, scene.position)


def test_contacts_without_names_have_a_list_of_their_own(tmp_path):
    write(tmp_path / "p.txt", "0 1 0 0 0 0.5\n0 2 1 0 0 0.5\n1 1 0 0 0 0.5\n1 2 1 0 0 0.5\n")
    write(tmp_path / "c.txt", "0 1 2 5 0 0\n1 1 2 6 0 0\n")
    names = {
        "particles": ["time", "id", "x", "y", "z", "radius"],
        "contacts": ["time", "id1", "id2", "fx", "fy", "fz"],
    }
    scene = xcg.open_scene(tmp_path / "p.txt", contacts=tmp_path / "c.txt", names=names, density=1)
    np.testing.assert_array_equal(scene.time, [0, 1])
    np.testing.assert_array_equal(scene.contact_force[:, 0, 0], [5, 6])


@pytest.mark.parametrize(
    ("names", "match"),
    [
        (None, r"name the 6 columns in their order, such as names=\['id', "),
        (["id", "x", "y", "z"], r"names= lists 4 columns .* the first row has 6 values"),
        (["id", "x", "x", "z", "c", "radius"], "'x' stands there 2 times"),
        ({"particles": ["id"], "contact": ["x"]}, "lists of all columns in their order"),
    ],
)
def test_lists_of_names_that_do_not_fit_are_an_error(tmp_path, names, match):
    path = write(tmp_path / "p.csv", "".join(",".join(map(str, row)) + "\n" for row in ROWS))
    with pytest.raises(SceneError, match=match):
        xcg.open_scene(path, names=names, density=1)


def test_a_title_above_rows_without_names_is_shown(tmp_path):
    path = write(tmp_path / "p.txt", "my run\n1 0 0 0 0.1\n")
    with pytest.raises(SceneError, match=r"first row has 2 values \(my run\).* begin with '#'"):
        xcg.open_scene(path, names=["id", "x", "y", "z", "radius"], density=1)


def test_a_list_of_names_is_for_tables_without_names(tmp_path):
    write_tables(tmp_path, ["p.csv"])
    with pytest.raises(SceneError, match=r"the first line names them .*leave the list out"):
        xcg.open_scene(tmp_path / "p.csv", names=["id", "x", "y", "z", "radius"], density=1)
    write(tmp_path / "p.dump", dump_of_ids([1]))
    with pytest.raises(SceneError, match="'lammps' reads the names of columns from the files"):
        xcg.open_scene(tmp_path / "p.dump", names=["id", "x"], engine="lammps")
