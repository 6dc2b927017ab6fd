"""Steps in which no grain recurs: pieces of one step, or a column that is taken for times."""

from __future__ import annotations

import re
from ast import literal_eval

import numpy as np
import pandas as pd
import pytest

import xcg
from tests.dumps import dump_text, write
from tests.readers.engines.test_vtk import write_spheres
from xcg.common.messages import SceneWarning

NONE_RECURS = "^no particle of .* is in "
GRAINS = "id type x y z radius"


def write_table(path, ids, separator=","):
    path.parent.mkdir(exist_ok=True)
    rows = [[i, float(i), 0.0, 0.0, 0.1] for i in ids]
    pd.DataFrame(rows, columns=["id", "x", "y", "z", "radius"]).to_csv(
        path, index=False, sep=separator
    )


def write_text(path, ids):
    write_table(path, ids, separator=" ")


def write_vtk(path, ids):
    write_spheres(path, np.outer(ids, [1.0, 0, 0]), id=ids, radii=[0.1] * len(ids))


def scene_and_warning(*arguments, **options):
    with pytest.warns(SceneWarning, match=NONE_RECURS) as caught:
        scene = xcg.open_scene(*arguments, density=1, **options)
    (message,) = [str(w.message) for w in caught if re.match(NONE_RECURS, str(w.message))]
    return scene, message


@pytest.mark.parametrize(
    ("name", "write_piece"),
    [
        ("out.00100.{:05}.csv", write_table),
        ("out.00100.{}.vtu", write_vtk),
        ("dump.100.{}.txt", write_text),
        ("snap.2000.{:03}.csv", write_table),
        ("rank_{}/step_100.csv", write_table),
        ("processor{}/p_100.csv", write_table),
    ],
)
@pytest.mark.parametrize("count", [2, 3, 12])
def test_the_call_of_the_warning_joins_pieces(tmp_path, name, write_piece, count):
    pieces = np.arange(3 * count).reshape(count, 3)
    for rank, ids in enumerate(pieces):
        write_piece(tmp_path / name.format(rank), ids)
    pattern = f"{tmp_path}/{re.sub('{.*}', '*', name)}"
    scene, message = scene_and_warning(pattern)
    assert scene.sizes["time"] == count
    call = re.search(r"times=(\[[0, ]*\])(?: \* (\d+))?;", message)
    times = literal_eval(call[1]) * int(call[2] or 1)
    whole = xcg.open_scene(pattern, density=1, times=times)
    assert whole.sizes["time"] == 1
    np.testing.assert_array_equal(whole.particle_id[0], pieces.ravel())
    np.testing.assert_array_equal(whole.position[0, :, 0], pieces.ravel())


def test_pieces_without_numbers_in_their_names_are_named(tmp_path):
    write_table(tmp_path / "left.csv", [1, 2])
    write_table(tmp_path / "right.csv", [3, 4])
    _, message = scene_and_warning([f"{tmp_path}/left.csv", f"{tmp_path}/right.csv"])
    assert "times=[0, 0]" in message


def test_an_empty_piece_is_passed_over(tmp_path):
    for rank, ids in enumerate([[], [1, 2], [3], []]):
        write_table(tmp_path / f"out.7.{rank}.csv", ids)
    with pytest.warns(SceneWarning) as caught:
        xcg.open_scene(f"{tmp_path}/out.7.*.csv", density=1)
    assert any(re.match(r"no particle of .*7\.1\.csv", str(w.message)) for w in caught)


TYPES = "id,x,y,z,radius,{}\n1,0,0,0,.5,1\n2,1,0,0,.5,1\n3,2,0,0,.5,2\n4,3,0,0,.5,2\n"


@pytest.mark.parametrize("column", ["t", "frame"])
def test_a_column_that_is_no_time_is_named(tmp_path, column):
    path = write(tmp_path / "t.csv", TYPES.format(column))
    scene, message = scene_and_warning(path)
    assert scene.sizes["time"] == 2
    names = literal_eval(re.search(r"names=(\{.*?\})", message)[1])
    assert names == {column: None}
    whole = xcg.open_scene(path, density=1, names=names)
    np.testing.assert_array_equal(whole.particle_id, [[1, 2, 3, 4]])
    # the caller says what it is
    assert xcg.open_scene(path, density=1, names={column: "time"}).sizes["time"] == 2


def test_a_column_of_a_file_without_names_is_named(tmp_path):
    path = write(tmp_path / "t.csv", TYPES.format("t").partition("\n")[2])
    names = ["id", "x", "y", "z", "radius", "t"]
    _, message = scene_and_warning(path, names=names)
    assert "None in its place" in message
    assert xcg.open_scene(path, density=1, names=[*names[:-1], None]).sizes["particle"] == 4


def test_a_column_of_a_table_in_memory_is_named():
    table = pd.DataFrame({"id": [1, 2, 3], "x": [0.0, 1, 2], "y": 0.0, "z": 0.0, "radius": 0.5})
    table["t"] = [1, 2, 3]
    with pytest.warns(SceneWarning, match=r"no particle of step 1 is in step 3 or step 2.*'t'"):
        xcg.scene_from_table(table, density=1)
    assert xcg.scene_from_table(table, density=1, names={"t": None}).sizes["time"] == 1
    assert xcg.scene_from_table(table, density=1, names={"t": "time"}).sizes["time"] == 3


@pytest.mark.filterwarnings("always")
def test_steps_of_a_table_without_ids_are_not_compared(recwarn):
    table = pd.DataFrame({"x": [0.0, 1], "y": 0.0, "z": 0.0, "radius": 0.5, "t": [1, 2]})
    xcg.scene_from_table(table, density=1)
    (message,) = [str(w.message) for w in recwarn]
    assert "no column of particle ids" in message


@pytest.mark.parametrize(
    "steps",
    [
        [[1, 2], [2, 3], [3, 4], [5, 6]],  # grains that stream through: the second step has some
        [[1, 2], [3, 4], [1, 4]],  # the last has some
        [[1], [1, 2], [1, 2, 3]],  # growing
        [[], [1, 2], []],
    ],
)
@pytest.mark.filterwarnings("ignore:.*neither the first nor the last step holds particles")
def test_series_in_which_grains_recur_are_silent(tmp_path, steps):
    for step, ids in enumerate(steps):
        write_table(tmp_path / f"p_{step}.csv", ids)
    assert xcg.open_scene(f"{tmp_path}/p_*.csv", density=1).sizes["time"] == len(steps)


def test_steps_that_files_number_are_steps(tmp_path):
    """A dump of a region holds other grains at each step, and says which step it is."""
    for step in (0, 100):
        rows = [f"{step + i} 1 {i} 1 1 0.5" for i in (1, 2)]
        write(tmp_path / f"dump.{step}", dump_text(rows, GRAINS, step=step))
    assert xcg.open_scene(f"{tmp_path}/dump.*", units="si", density=1).sizes["time"] == 2
