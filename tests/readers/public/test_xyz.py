"""Plain and extended XYZ, as ASE, OVITO, LAMMPS and scripts write them."""

import gzip
import re

import numpy as np
import pytest

import xcg

EXTENDED = (
    'Lattice="2 0 0 {tilt} 3 0 0 0 4" Origin="-1 0 0" '
    "Properties=species:S:1:pos:R:3:{velo}:R:3:radius:R:1:id:I:1 {time} {pbc}"
)


def frame(comment, rows):
    return "\n".join([str(len(rows)), comment, *rows, ""])


def write_extended(path, time="Time=0.5", pbc='pbc="T T F"', tilt=0, velo="velo"):
    comments = [EXTENDED.format(time=time, pbc=pbc, tilt=tilt, velo=velo)]
    comments.append(re.sub(r"= ?0\.5", "=1.5", comments[0]))
    rows = ["Si 0.1 0.2 0.3 1 2 3 0.05 7", "Al 0.5 0.6 0.7 4 5 6 0.1 3"]
    path.write_text(frame(comments[0], rows) + frame(comments[1], [*rows, "B 1 1 1 0 0 0 0.2 9"]))
    return path


def test_frames_hold_what_their_comments_name(tmp_path):
    path = write_extended(tmp_path / "run.xyz")
    with pytest.warns(xcg.SceneWarning, match="1: 'Al', 2: 'B', 3: 'Si'"):
        ds = xcg.open_scene(path, density=1.0).load()
    assert ds.engine == "xyz"
    assert ds.time.values.tolist() == [0.5, 1.5]
    assert ds.particle_id.values.tolist() == [[3, 7, -1], [3, 7, 9]]
    np.testing.assert_array_equal(ds.position[0, :2], [[0.5, 0.6, 0.7], [0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(ds.velocity[0, :2], [[4, 5, 6], [1, 2, 3]])
    np.testing.assert_array_equal(ds.diameter[1], [0.2, 0.1, 0.4])
    assert ds.species.values.tolist() == [[1, 3, -1], [1, 3, 2]]
    np.testing.assert_array_equal(ds.box[0], [[-1, 1], [0, 3], [0, 4]])
    assert ds.periodic == "xy"


@pytest.mark.parametrize(
    ("options", "periodic"),
    [
        ({"pbc": ""}, "xyz"),  # the default of the format
        ({"pbc": 'pbc="F F F"'}, ""),
        ({"pbc": "pbc=[True, False, true]"}, "xz"),
        ({"velo": "vel"}, "xy"),
        ({"velo": "velocities"}, "xy"),
        ({"time": "time=0.5"}, "xy"),
        ({"time": "t = 0.5"}, "xy"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*species are words")
def test_spellings_of_keys_and_columns_mean_the_same(tmp_path, options, periodic):
    ds = xcg.open_scene(write_extended(tmp_path / "run.extxyz", **options), density=1.0)
    assert ds.periodic == periodic
    assert ds.time.values.tolist() == [0.5, 1.5]
    np.testing.assert_array_equal(ds.velocity[0, 1], [1, 2, 3])


@pytest.mark.filterwarnings("ignore:.*species are words")
def test_a_tilted_lattice_is_that_of_the_scene(tmp_path):
    ds = xcg.open_scene(write_extended(tmp_path / "run.xyz", tilt=0.5), density=1.0)
    np.testing.assert_array_equal(ds.lattice[0], [[2, 0, 0], [0.5, 3, 0], [0, 0, 4]])


def test_temperatures_are_no_times(tmp_path):
    (tmp_path / "a.xyz").write_text(frame("Properties=id:I:1:pos:R:3 T=300 step=7", ["1 0 0 0"]))
    ds = xcg.open_scene(tmp_path / "a.xyz")
    assert ds.time.values.tolist() == [7]
    assert ds.time.attrs["units"] == "1"


def test_species_are_numbered_over_all_files(tmp_path):
    for k, species in enumerate("BA"):
        comment = "Properties=species:S:1:pos:R:3:id:I:1"
        (tmp_path / f"{k}.xyz").write_text(frame(comment, [f"{species} 0 0 0 1"]))
    with pytest.warns(xcg.SceneWarning, match="1: 'A', 2: 'B'"):
        ds = xcg.open_scene(str(tmp_path / "*.xyz"))
    assert ds.species.values.tolist() == [[2], [1]]


@pytest.mark.parametrize(
    ("comment", "options", "times"),
    [
        ("Atoms. Timestep: {}", {}, [100, 200]),  # LAMMPS
        ("Atoms. Timestep: {}", {"timestep": 1e-3}, [0.1, 0.2]),
        ("time = {} energy = 3", {}, [100, 200]),
        ("i = {}, E = -1.5", {}, [100, 200]),  # CP2K
        ("t= {}", {}, [100, 200]),
    ],
)
@pytest.mark.filterwarnings("ignore:.*no column of particle ids")
def test_plain_files_hold_species_and_positions(tmp_path, comment, options, times):
    rows = ["1 0.1 0.2 0.3", "2 0.5 0.6 0.7"]
    text = "".join(frame(comment.format(k), rows) for k in (100, 200))
    (tmp_path / "a.xyz.gz").write_bytes(gzip.compress(text.encode()))
    ds = xcg.open_scene(tmp_path / "a.xyz.gz", **options)
    np.testing.assert_allclose(ds.time, times, rtol=1e-15)
    np.testing.assert_array_equal(ds.position[1], [[0.1, 0.2, 0.3], [0.5, 0.6, 0.7]])
    assert ds.species.values.tolist() == [[1, 2]] * 2


def test_columns_without_names_are_named_by_the_caller(tmp_path):
    path = tmp_path / "a.xyz"
    path.write_text(frame("", ["A 0.1 0.2 0.3 0.05 7", "A 0.5 0.6 0.7 0.1 3"]))
    with pytest.warns(xcg.SceneWarning, match="column_5 column_6 of plain XYZ have no names"):
        xcg.open_scene(path, names={"species": None})
    ds = xcg.open_scene(path, names={"column_5": "radius", "column_6": "particle_id"})
    assert ds.diameter.values.tolist() == [[0.2, 0.1]]
    assert ds.particle_id.values.tolist() == [[3, 7]]


def test_a_first_column_of_real_numbers_is_no_species(tmp_path):
    path = tmp_path / "a.xyz"
    path.write_text(frame("", ["0.1 0.2 0.3 0.05", "0.5 0.6 0.7 0.1"]))
    with pytest.raises(xcg.SceneError, match="4 columns of plain XYZ have no names"):
        xcg.open_scene(path)
    words = ("position_x", "position_y", "position_z", "radius")
    names = {f"column_{k}": word for k, word in enumerate(words, 1)}
    ds = xcg.open_scene(path, names=names)
    np.testing.assert_array_equal(ds.position[0], [[0.1, 0.2, 0.3], [0.5, 0.6, 0.7]])


def test_real_numbers_among_species_are_refused(tmp_path):
    path = tmp_path / "a.xyz"
    path.write_text(frame("", ["0 0.2 0.3 0.05", "0.5 0.6 0.7 0.1"]))
    with pytest.raises(xcg.SceneError, match=r"the species '0\.5' is a real number"):
        xcg.open_scene(path)
    names = {"species": "position_x", "x": "position_y", "y": "position_z", "z": "radius"}
    ds = xcg.open_scene(path, names=names)
    np.testing.assert_array_equal(ds.position[0], [[0, 0.2, 0.3], [0.5, 0.6, 0.7]])
    assert ds.diameter.values.tolist() == [[0.1, 0.2]]


def test_more_species_than_any_file_has_are_refused(tmp_path):
    path = tmp_path / "a.xyz"
    path.write_text(frame("", [f"{k} {k} 0 0" for k in range(2000)]))
    with pytest.raises(xcg.SceneError, match="more than 1000 species"):
        xcg.open_scene(path)
    assert xcg.open_scene(path, names={"species": "particle_id"}).sizes["particle"] == 2000


def test_species_that_are_all_different_are_pointed_out(tmp_path):
    path = tmp_path / "a.xyz"
    path.write_text(frame("", [f"{k} {k} 0 0" for k in range(5)]))
    with pytest.warns(xcg.SceneWarning, match="names={'species': 'particle_id'}"):
        xcg.open_scene(path)
    assert xcg.open_scene(path, names={"species": "particle_id"}).particle_id.max() == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3\n\nA 0 0 0\n", "1 rows from byte 3, but the frame promises 3"),
        ("1" * 5000 + "\n\nA 0 0 0\n", "expected the number of rows of a frame"),
        ("x\n\n", "expected the number of rows of a frame, found 'x'"),
        ('1\nLattice="1 2" pbc="T T T"\nA 0 0 0\n', "Lattice='1 2', expected 9 numbers"),
        ('1\nLattice="0 1 0 1 0 0 0 0 1"\nA 0 0 0\n', "no positive component along x"),
        ('1\nLattice="1 0 0 0 1 0 0 0 1" pbc="T T"\nA 0 0 0\n', "expected three of T and F"),
        ("1\nProperties=pos:R:x\n0 0 0\n", "expected names that differ, types"),
        ("1\nProperties=species:S:1:pos:R:3\nA 0 0\n", "row 0 has 3 values, expected 4"),
        ("1\nProperties=pos:R:3\n0 nothing 0\n", "has 'nothing' in column 'pos_y'"),
    ],
)
def test_damaged_files_raise(tmp_path, text, message):
    (tmp_path / "a.xyz").write_text(text)
    with pytest.raises(xcg.SceneError, match=rf"a\.xyz.*{message}"):
        xcg.open_scene(tmp_path / "a.xyz", engine="xyz")


@pytest.mark.filterwarnings("ignore:.*species are words")
def test_contacts_are_refused(tmp_path):
    path = write_extended(tmp_path / "a.xyz")
    with pytest.raises(xcg.SceneError, match="XYZ holds particles only"):
        xcg.open_scene(path, contacts=path)


@pytest.mark.filterwarnings("ignore:.*species are words")
def test_momenta_of_ase_are_named(tmp_path):
    path = write_extended(tmp_path / "a.xyz", velo="momenta")
    with pytest.warns(xcg.SceneWarning, match="'momenta_x' .velocity.*divide them by the masses"):
        assert "velocity" not in xcg.open_scene(path, density=1.0)


@pytest.mark.filterwarnings("ignore:.*species are words")
def test_a_bad_number_in_the_last_row_is_not_taken_for_a_line_of_text(tmp_path):
    whole = "2\ncomment\nA 0 0 0\nB 1 0 0\n"
    (tmp_path / "a.xyz").write_text(whole.replace("B 1", "B nan"))
    with pytest.raises(xcg.SceneError, match=r"row 1 has 'nan' in column 'x', expected a number$"):
        xcg.open_scene(tmp_path / "a.xyz", density=1.0).load()
    (tmp_path / "a.xyz").write_text(whole + whole[:-9])
    with pytest.raises(
        xcg.SceneError, match=r"1 whole steps before it are kept with on_error='skip'$"
    ):
        xcg.open_scene(tmp_path / "a.xyz", density=1.0)
