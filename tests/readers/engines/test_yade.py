"""Text of YADE: signs of forces, unwrapped positions, cells, and files that tell no time."""

import numpy as np
import pytest

import xcg
from tests.dumps import write

CELL = "10 0 0 0 10 0 0 0 10"
GRAINS = "# time {time} step {step} cell {cell}\n# id x y z r mass vx vy vz wx wy wz fx fy fz\n"
ROWS = "0 11.5 1 1 0.5 1 0.1 0.2 0.3 0 0 1 9 9 9\n1 2.4 1 1 0.5 1 0 0 0 0 0 0 0 0 0\n"
PAIRS = (
    "# id1 id2 cellDist(3) c(3) n(3) delta fn(3) fs(3)\n0 1 1 0 0 11.95 1 1 1 0 0 0.1 5 0 0 0 2 0\n"
)


def texts(tmp_path, steps=(0, 10), cell=CELL, pairs=PAIRS):
    for step in steps:
        write(
            tmp_path / f"grains_{step}.txt",
            GRAINS.format(time=step / 10, step=step, cell=cell) + ROWS,
        )
        write(tmp_path / f"pairs_{step}.txt", pairs)
    return {"particles": str(tmp_path / "grains_*.txt"), "contacts": str(tmp_path / "pairs_*.txt")}


def test_forces_on_the_second_body_change_sign(tmp_path):
    ds = xcg.open_scene(**texts(tmp_path)).load()
    assert ds.attrs["engine"] == "yade"
    assert ds.attrs["periodic"] == "xyz"
    np.testing.assert_array_equal(ds.box[0], [[0, 10]] * 3)
    np.testing.assert_array_equal(ds.time, [0, 1])
    np.testing.assert_array_equal([ds.contact_i[0, 0], ds.contact_j[0, 0]], [1, 0])
    np.testing.assert_array_equal(ds.contact_force[0, 0], [5, 2, 0])
    np.testing.assert_array_equal(
        ds.contact_normal[0, 0], [1, 0, 0]
    )  # from j to i, as from id1 to id2
    np.testing.assert_array_equal(ds.diameter[0], [1, 1])
    np.testing.assert_array_equal(ds.angular_velocity[0, 0], [0, 0, 1])


def test_a_sheared_cell_is_read(tmp_path):
    """Columns of the matrix are the vectors."""
    ds = xcg.open_scene(**texts(tmp_path, cell="10 2 0 0 10 0 0 0 10"), shear_rate={})
    np.testing.assert_array_equal(ds.lattice[0], [[10, 0, 0], [2, 10, 0], [0, 0, 10]])


def test_names_without_numbers_are_paired_in_their_order(tmp_path):
    pairs = PAIRS.replace("11.95", "1.45")
    for name in ("a", "b"):
        write(
            tmp_path / f"grains_{name}.txt",
            "#format id_x_y_z_r_matId\n0\t1\t1\t1\t0.5\t3\n1\t1.9\t1\t1\t0.5\t3\n",
        )
        write(
            tmp_path / f"pairs_{name}.txt", pairs.replace(" 5 0 0 ", f" {5 + (name == 'b')} 0 0 ")
        )
    ds = xcg.open_scene(
        str(tmp_path / "grains_*.txt"), contacts=str(tmp_path / "pairs_*.txt"), density=2500, periodic="x",
        box={"x": (0, 10)},
    )  # fmt: skip
    np.testing.assert_array_equal(ds.contact_force[:, 0, 0], [5, 6])
    np.testing.assert_array_equal(ds.species[0], [3, 3])


def test_walls_may_be_the_first_or_second_body(tmp_path):
    """Whichever side the wall is on, the force is that on the grain."""
    for pair, sign in (("7 1", 1), ("1 7", -1)):
        given = texts(
            tmp_path, pairs=PAIRS.replace("0 1 1 0 0", f"{pair} 0 0 0").replace("11.95", "1.95")
        )
        with pytest.raises(xcg.SceneError, match="allow_unknown"):
            xcg.open_scene(**given).load()
        ds = xcg.open_scene(**given, allow_unknown=True).load()
        traction = ds.cg.coarse_grain("boundary_force_density", axes="").boundary_force_density[0]
        np.testing.assert_allclose(traction, sign * np.array([5, 2, 0]) / 1000, rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("cell 10 0", "cell 10 x", "nine numbers"),
        ("cell 10 0", "cell 0 0", "no positive component along x"),
        ("time 0.0", "time inf", "expected '# time"),
        ("# id x", "# id id", "names each column once"),
        ("\n1 2.4", "\n# 2\n1 2.4", "a comment between rows"),
        ("1 2.4 1 1 0.5", "1 2.4 1 0.5", "row 1 has 14 values, expected 15"),
        ("11.5", "1l.5", "'1l.5' in column 'x'"),
    ],
)
def test_damaged_files_raise(tmp_path, old, new, message):
    text = GRAINS.format(time=0.0, step=0, cell=CELL) + ROWS
    assert old in text
    path = write(tmp_path / "grains_0.txt", text.replace(old, new, 1))
    with pytest.raises(xcg.SceneError, match=message) as error:
        xcg.open_scene(path, engine="yade").load()
    assert "grains_0.txt" in str(error.value)


@pytest.mark.parametrize("time", ["", "# time 0.5\n"])
@pytest.mark.filterwarnings("error")
def test_one_force_below_a_comment_is_that_on_the_first_body(tmp_path, time):
    """As in any table; YADE keeps normal and shear forces, which act on the second."""
    grains = f"{time}# id x y z radius\n1 1 1 1 0.5\n2 1.9 1 1 0.5\n"
    write(tmp_path / "g.txt", grains)
    write(tmp_path / "c.txt", f"{time}# id1 id2 fx fy fz\n1 2 -3 0 0\n")
    options = {"contacts": tmp_path / "c.txt", "density": 1.0}
    ds = xcg.open_scene(tmp_path / "g.txt", **options)
    assert [ds.contact_i.item(), ds.contact_force[0, 0, 0].item()] == [1, -3]
    write(tmp_path / "g.txt", grains.replace("radius", "r"))
    write(tmp_path / "c.txt", f"{time}# id1 id2 fn(3) fs(3)\n1 2 3 0 0 0 0 0\n")
    ds = xcg.open_scene(tmp_path / "g.txt", **options)
    assert ds.attrs["engine"] == "yade"
    assert [ds.contact_i.item(), ds.contact_force[0, 0, 0].item()] == [2, 3]
