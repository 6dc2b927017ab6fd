from __future__ import annotations

import gzip

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import real_data
from tests.dumps import ATOMS, PAIR_ROWS, PAIRS, ROWS, dump_text, pairs_text, write
from xcg.common.messages import SceneError, SceneWarning
from xcg.readers.engine import ReadOptions
from xcg.readers.engines import lammps as lammps_engine
from xcg.readers.engines.lammps import Lammps
from xcg.readers.files.table import parse_table
from xcg.readers.open import open_scene

lammps = Lammps()

DEFAULTS = ReadOptions()


def particles(tmp_path, text, name="p.dump", options=DEFAULTS):
    (ref,) = lammps.index_particles([str(write(tmp_path / name, text))], options)
    return ref, lammps.read_particles(ref, options)


def contacts(tmp_path, text, options=DEFAULTS):
    (ref,) = lammps.index_contacts([str(write(tmp_path / "c.dump", text))], options)
    frame = lammps.read_contacts(ref, options)
    assert set(frame) == set(lammps.contact_variables(ref, options))
    return frame


# --- headers ---------------------------------------------------------------------------------------------


def test_a_frame_is_read(tmp_path):
    ref, frame = particles(tmp_path, dump_text(step=7).replace("ITEM: UNITS\nsi\n", ""))
    assert (ref.rows, ref.step, ref.time, ref.units, ref.periodic) == (3, 7, None, None, "xy")
    assert ref.box == ((0, 10), (0, 10), (-1, 9))
    np.testing.assert_array_equal(frame["particle_id"], [3, 1, 2])
    np.testing.assert_array_equal(frame["species"], [2, 1, 1])
    np.testing.assert_array_equal(frame["position"][2], [1.9, 1, 1.5])
    np.testing.assert_array_equal(frame["velocity"][1], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(frame["diameter"], 1)
    assert "radius" not in frame


@pytest.mark.parametrize(
    "before",
    ["ITEM: UNITS\nlj\nITEM: TIME\n2.5\n", "ITEM: TIME\n2.5\nITEM: UNITS\nlj\n"],
    ids=["units first", "time first"],
)
def test_items_come_in_any_order(tmp_path, before):
    ref, frame = particles(tmp_path, dump_text(before=before))
    assert (ref.units, ref.time) == ("lj", 2.5)
    assert len(frame["position"]) == 3


@pytest.mark.parametrize("name", ["p.dump", "p.dump.gz"])
def test_line_ends_of_windows_are_read(tmp_path, name):
    path = tmp_path / name
    text = dump_text(before="ITEM: UNITS\nsi\n").replace("\n", "\r\n").encode()
    path.write_bytes(gzip.compress(text) if name.endswith("gz") else text)
    (ref,) = lammps.index_particles([str(path)], DEFAULTS)
    frame = lammps.read_particles(ref, DEFAULTS)
    assert ref.units == "si"
    np.testing.assert_array_equal(frame["position"][0], [3, 3, 0.5])


@pytest.mark.parametrize("name", ["all.dump", "all.dump.gz"])
def test_many_steps_in_one_file_are_read(tmp_path, name):
    header = "ITEM: UNITS\nsi\n"  # LAMMPS writes it once a file
    texts = [
        dump_text(
            [f"1 1 {k} 0 0 0 0 0 0.5 1"] * (k > 0) + ["2 1 5 5 5 0 0 0 0.5 1"] * (k > 1),
            step=10 * k,
        )
        for k in range(4)
    ]
    path = write(tmp_path / name, [header, *texts])
    refs = lammps.index_particles([str(path)], DEFAULTS)
    assert [ref.rows for ref in refs] == [0, 1, 2, 2]
    assert [ref.step for ref in refs] == [0, 10, 20, 30]
    assert {ref.units for ref in refs} == {"si"}
    frames = [lammps.read_particles(ref, DEFAULTS) for ref in reversed(refs)][::-1]
    assert [frame["position"][:1, 0].tolist() for frame in frames] == [[], [1], [2], [3]]


def test_steps_are_found_across_blocks(tmp_path, monkeypatch):
    from xcg.readers.files import text

    path = str(write(tmp_path / "all.dump", [dump_text(step=k) for k in range(5)]))
    whole = lammps.index_particles([path], DEFAULTS)
    for size in (7, 11, 64):
        monkeypatch.setattr(text, "_FIRST_BLOCK", size)
        monkeypatch.setattr(text, "_BLOCK", size)
        assert lammps.index_particles([path], DEFAULTS) == whole


def test_single_steps_are_not_read_through(tmp_path, monkeypatch):
    row = "1 1 1 1 1 0.1 0.2 0.3 0.5 1"
    alone = str(write(tmp_path / "p.00700.dump.gz", dump_text([row] * 9, step=700)))
    many = str(write(tmp_path / "p.0.dump", [dump_text([row] * 9, step=k) for k in (0, 1)]))
    read = []
    monkeypatch.setattr(
        lammps_engine.Scanner, "until", lambda self, marker: iter(read.append(marker) or ())
    )
    (ref,) = lammps.index_particles([alone], DEFAULTS)
    assert not read
    assert ref.length == 9 * len(row + " \n")
    with pytest.raises(SceneError):  # with the scan out of order, the second step is not found
        lammps.index_particles([many], DEFAULTS)
    assert read


def test_times_follow_from_step_numbers(tmp_path):
    path = str(write(tmp_path / "p.dump", dump_text(step=50)))
    (ref,) = lammps.index_particles([path], ReadOptions(extra={"timestep": 0.02}))
    assert ref.time == pytest.approx(1.0)
    with pytest.raises(ValueError, match="timestep='fast'"):
        lammps.index_particles([path], ReadOptions(extra={"timestep": "fast"}))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (
            dump_text(box="ITEM: BOX BOUNDS xy xz yz pp pp pp\n0 1 0\n0 1\n0 1 0\n"),
            "three numbers, the bounds and a tilt",
        ),
        (
            dump_text(box="ITEM: BOX BOUNDS abc origin pp pp pp\n1 0 0 0\n0 1 0 0\n0 0 1 0\n"),
            "triclinic",
        ),
        (
            dump_text(box="ITEM: BOX BOUNDS pp pp pp\n0 1\n0 one\n0 1\n"),
            "three lines of two numbers",
        ),
        (dump_text().replace("ITEM: NUMBER OF ATOMS\n3\n", ""), "does not say how many rows"),
        (
            dump_text(count="many"),
            "'many' follows 'ITEM: NUMBER OF ATOMS', expected a whole number",
        ),
        (dump_text(columns=""), "names no columns"),
        (dump_text(columns="type x y z"), r"no id of the particle .*type x y z.*'particle_id'"),
        (dump_text(columns="id x z vy"), "no y of the position"),
        (dump_text(columns="id x y z vx vy"), "no z of the velocity"),
        (pairs_text(), "is this a file for contacts="),
        ("ITEM: TIMESTEP\n0\nITEM: DIMENSION\n3\n", "a grid .* holds no particles"),
        ("ITEM: TIMESTEP\n0\nITEM: NUMB", "header of step 0 is cut off|NUMB"),
        ("1 2 3\n", "expected a line that begins with 'ITEM:'"),
        ("", "the file is empty"),
    ],
)
def test_bad_headers_raise(tmp_path, text, match):
    path = write(tmp_path / "p.dump", text)
    with pytest.raises(SceneError, match=match) as error:
        lammps.index_particles([str(path)], DEFAULTS)
    assert "p.dump" in str(error.value)


# --- bodies ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rows", "match"),
    [
        (ROWS[:2], r"p.dump \(step 4\): 2 rows, but the header says 3: row 2 is missing"),
        ([], "0 rows, but the header says 3"),
        ([*ROWS, ROWS[0]], "more rows than the 3 that the header says"),
        ([ROWS[0], "1 1 1 1 1 0.1 0.2", ROWS[2]], "row 1 has 7 values, expected 10"),
        ([*ROWS[:2], "2 1 1.9"], "row 2 has 3 values, expected 10 .*cut off"),
        ([ROWS[0], ROWS[1] + " 9", ROWS[2]], "row 1 has 11 values, expected 10"),
        ([ROWS[0] + " 9", *ROWS[1:]], "row 0 has 11 values, expected 10"),
        ([ROWS[0], ROWS[1] + " 9", ROWS[2][:-2]], "row 1 has 11 values"),
        (
            [*ROWS[:2], "2 1 1.9 oops 1.5 0 0 0 0.5 1"],
            "row 2 has 'oops' in column 'y', expected a number",
        ),
        ([*ROWS[:2], "2 1 1.9 nan 1.5 0 0 0 0.5 1"], "row 2 has 'nan' in column 'y'"),
    ],
)
def test_bad_bodies_raise(tmp_path, rows, match):
    text = dump_text(rows, step=4, count=3)
    with pytest.raises(SceneError, match=match):
        particles(tmp_path, text)


def test_unusual_numbers_are_read(tmp_path):
    row = "1 1 4.2e-315 -1E+2 +0.25 1e-400 -0 .5 0.5 1.e0"
    _, frame = particles(tmp_path, dump_text([row]))
    np.testing.assert_array_equal(frame["position"], [[4.2e-315, -100, 0.25]])
    np.testing.assert_array_equal(frame["velocity"], [[0, 0, 0.5]])


def test_columns_that_are_not_read_may_hold_any_text(tmp_path):
    rows = [f"{row} Fe nan" for row in ROWS]
    _, frame = particles(tmp_path, dump_text(rows, ATOMS + " element c_t"))
    assert len(frame["position"]) == 3


def test_columns_in_another_order_are_read(tmp_path):
    _, expected = particles(tmp_path, dump_text())
    order = [9, 4, 0, 8, 2, 1, 3, 7, 6, 5]
    rows = [" ".join(row.split()[k] for k in order) for row in ROWS]
    _, frame = particles(tmp_path, dump_text(rows, " ".join(ATOMS.split()[k] for k in order)))
    for name in expected:
        np.testing.assert_array_equal(frame[name], expected[name])


@pytest.mark.parametrize(
    ("columns", "row", "expected"),
    [
        ("id xs ys zs", "1 0.5 0.25 0.1", [5, 2.5, 0]),
        ("id xsu ysu zsu", "1 1.5 -0.25 0.1", [15, -2.5, 0]),
        ("id xu yu zu", "1 12 -3 4", [12, -3, 4]),
        ("id xu yu zu x y z", "1 12 -3 4 2 7 4", [2, 7, 4]),
        ("id x y zs", "1 2 7 0.5", [2, 7, 4]),
        ("id x y", "1 2 7", [2, 7, 0]),
    ],
)
def test_all_coordinate_styles_are_read(tmp_path, columns, row, expected):
    _, frame = particles(tmp_path, dump_text([row], columns))
    np.testing.assert_allclose(frame["position"], [expected], atol=1e-15)


def test_scaled_coordinates_need_a_box(tmp_path):
    with pytest.raises(SceneError, match="fractions of a box, and the header has no 'BOX BOUNDS'"):
        particles(tmp_path, dump_text(["1 0.5 0.25 0.1"], "id xs ys zs", box=""))


def test_scaled_coordinates_in_a_tilted_box_need_those_that_the_tilt_couples(tmp_path):
    tilted = "ITEM: BOX BOUNDS xy xz yz pp pp pp\n0 1.5 0.5\n0 1 0\n0 1 0\n"
    with pytest.raises(
        SceneError, match="x follows from xs and ys, and ys is missing; dump xs ys zs, or x y z"
    ):
        particles(tmp_path, dump_text(["1 0.5 0.8 0.5"], "id xs y zs", box=tilted))
    for columns, y in (("id xs ys zs", 0.8), ("id xs ys z", 0.8), ("id x ys zs", 0.8)):
        _, frame = particles(tmp_path, dump_text([f"1 0.5 {y} 0.5"], columns, box=tilted))
        x = 0.5 + 0.5 * y if "xs" in columns else 0.5
        np.testing.assert_allclose(frame["position"], [[x, y, 0.5]], rtol=1e-15)


def test_diameters_come_from_diameter_or_radius(tmp_path):
    _, frame = particles(
        tmp_path, dump_text(["1 0 0 0 0.333333 0.166667"], "id x y z diameter radius")
    )
    np.testing.assert_array_equal(frame["diameter"], 0.333333)
    with pytest.raises(
        SceneError, match="diameter 3 of row 0 is not 2 times radius 1; drop one of the two"
    ):
        particles(tmp_path, dump_text(["1 0 0 0 3 1"], "id x y z diameter radius"))
    mapped = ReadOptions({"c_r": "radius"})
    text = dump_text(["1 0 0 0 3 1"], "id x y z diameter c_r")
    _, frame = particles(tmp_path, text, options=mapped)
    np.testing.assert_array_equal(frame["diameter"], 2)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 3), max_size=20))
def test_numbers_keep_their_bits(rows):
    body = "".join(f" {a!r}\t{b!r}  {c:.17g} \n" for a, b, c in rows).encode()
    table = parse_table(body, ("a", "b", "c"), ("c", "a"), len(rows), "numbers")
    expected = np.array(rows).reshape(-1, 3)
    np.testing.assert_allclose(table["a"], expected[:, 0], rtol=1e-15)
    np.testing.assert_allclose(table["c"], expected[:, 2], rtol=1e-15)


# --- names -----------------------------------------------------------------------------------------------


def test_names_map_columns(tmp_path):
    names = {"c_nc": "coordination_number", "f_1[1]": "temperature", "type": None, "mol": "body_id"}
    text = dump_text(["1 2 0 0 0 4 3.5 8"], "id type x y z c_nc f_1[1] mol")
    _, frame = particles(tmp_path, text, options=ReadOptions(names))
    assert set(frame) == {
        "particle_id",
        "position",
        "coordination_number",
        "temperature",
        "body_id",
    }
    np.testing.assert_array_equal(frame["temperature"], 3.5)
    with pytest.raises(SceneError, match="did you mean 'velocity_"):
        particles(tmp_path, text, options=ReadOptions({"c_nc": "velocityx"}))


@pytest.mark.parametrize(
    ("columns", "row", "names", "expected"),
    [
        (PAIRS, PAIR_ROWS[0], {}, [-9, 1, 0]),
        ("id2 id1 fx fy fz", "2 1 1 2 3", {}, [1, 2, 3]),
        ("id1 id2 fx fy fz fnx fny fnz ftx fty ftz", "1 2 7 7 7 1 1 1 2 2 2", {}, [7, 7, 7]),
        (
            "c_1[1] c_1[2] c_2[1] c_2[2] c_2[3]",
            "1 2 1 2 3",
            {"c_1[1]": "contact_i", "c_1[2]": "contact_j"}
            | {f"c_2[{k}]": f"contact_force_{axis}" for k, axis in enumerate("xyz", 1)},
            [1, 2, 3],
        ),
        (
            "id1 id2 fx fy fz ftx fty ftz",
            "1 2 1 1 1 2 2 2",
            {f"f{axis}": f"normal_force_{axis}" for axis in "xyz"},
            [3, 3, 3],
        ),
        (
            "id1 id2 fx fy fz ftx fty ftz",
            "1 2 1 1 1 2 2 2",
            {f"ft{axis}": None for axis in "xyz"},
            [1, 1, 1],
        ),
    ],
)
def test_contact_forces_are_read(tmp_path, columns, row, names, expected):
    frame = contacts(tmp_path, pairs_text([row], columns), ReadOptions(names))
    np.testing.assert_array_equal(frame["contact_force"], [expected])
    assert (frame["contact_i"], frame["contact_j"]) == (1, 2)


def test_normal_forces_alone_are_taken_with_a_warning(tmp_path):
    pairs = write(tmp_path / "c.dump", pairs_text(["1 2 1 2 3"], "id1 id2 fnx fny fnz"))
    with pytest.warns(SceneWarning, match="only normal forces .*'tangential_force_x'"):
        ds = open_scene(write(tmp_path / "p.dump", dump_text()), pairs)
    np.testing.assert_array_equal(ds.contact_force[0], [[1, 2, 3]])


def test_optional_columns_of_contacts_are_read(tmp_path):
    names = {f"c{axis}": f"contact_point_{axis}" for axis in "xyz"}
    text = pairs_text(["1 2 1 2 3 0.1 4 5 6"], "id1 id2 fx fy fz delta cx cy cz")
    frame = contacts(tmp_path, text, ReadOptions(names))
    np.testing.assert_array_equal(frame["contact_point"], [[4, 5, 6]])
    np.testing.assert_array_equal(frame["overlap"], [0.1])


@pytest.mark.parametrize(
    ("columns", "names", "match"),
    [
        ("id1 fx fy fz", {}, "no ids of both partners among the columns id1 fx fy fz.*'contact_j'"),
        ("id1 id2 dist", {}, "no contact force .*'contact_force_x'"),
        ("id1 id2 fx fy az", {}, "no z of the contact force"),
        ("id1 id2 fx fy fz ftx fty ftz", {}, "whole contact force or its normal part"),
        ("id1 id2 c_1[1]", {"c_1[1]": "contact_forcex"}, "did you mean 'contact_force_x'"),
        ("id1 id2 fx fy fz", {"fx": "contact_force_z"}, "no x of the contact force"),
    ],
)
def test_wrong_contact_columns_raise(tmp_path, columns, names, match):
    with pytest.raises(SceneError, match=match):
        contacts(tmp_path, pairs_text(["1 " * len(columns.split())], columns), ReadOptions(names))


def test_ids_cut_to_six_digits_raise(tmp_path):
    rows = [f"{1.23457e6 + 10 * k:g} 2 1 2 3" for k in range(20)]
    with pytest.raises(SceneError, match=r"written with six digits.*%\.10g"):
        contacts(tmp_path, pairs_text(rows, "id1 id2 fx fy fz"))


def test_steps_without_contacts_are_read(tmp_path):
    frame = contacts(tmp_path, pairs_text([]))
    assert frame["contact_force"].shape == (0, 3)


# --- recognising -----------------------------------------------------------------------------------------


def test_dumps_are_recognised(tmp_path):
    assert lammps.recognises(
        str(write(tmp_path / "a.dump.gz", dump_text(before="ITEM: TIME\n1\n")))
    )
    assert lammps.recognises(str(write(tmp_path / "b.dump", pairs_text())))
    assert not lammps.recognises(str(write(tmp_path / "c.txt", "x y z\n")))
    (tmp_path / "d.bin").write_bytes(b"ITEM:\0\1\2")
    assert not lammps.recognises(str(tmp_path / "d.bin"))
    numbered = " ".join(f"c_3[{k}]" for k in range(1, 14))
    assert not lammps.recognises(str(write(tmp_path / "e.txt", pairs_text([], numbered))))


# --- real output -----------------------------------------------------------------------------------------


def resultant(scene, t):
    """Sum of contact forces on each particle at step t, from both sides of every contact."""
    step = scene.isel(time=t)
    valid = step.contact_i.values >= 0
    i, j, force = (step[name].values[valid] for name in ("contact_i", "contact_j", "contact_force"))
    ids = step.particle_id.values
    total = np.zeros((len(ids), 3))
    np.add.at(total, np.searchsorted(ids, i), force)
    paired = j >= 0
    np.add.at(total, np.searchsorted(ids, j[paired]), -force[paired])
    return total, np.linalg.norm(force, axis=1).mean()


@pytest.mark.parametrize(
    ("name", "steps", "options", "tolerance"),
    [
        (
            "lammps_chute",
            (0, 2),
            {"gravity": (np.sin(np.radians(24)), 0, -np.cos(np.radians(24)))},
            5e-3,
        ),
        ("lammps_biaxial2d", (0, 1), {"periodic": "x"}, 1e-4),
    ],
)
@pytest.mark.filterwarnings(
    "ignore:.*cross an edge that is not periodic"
)  # step 0 of one is periodic along y, too
def test_contact_forces_make_the_force_on_each_particle(name, steps, options, tolerance):
    folder = real_data(name)
    forces = {f"f{axis}": f"total_force_{axis}" for axis in "xyz"}
    scene = open_scene(
        folder / "particles.*", contacts=folder / "contacts.*", names=forces, **options
    ).compute()
    for t in steps:
        total, scale = resultant(scene, t)
        step = scene.isel(time=t)
        dumped = np.stack([step[target].values for target in forces.values()], axis=1)
        weight = step.mass.values[:, None] * np.array(options.get("gravity", (0, 0, 0)))
        free = step.species.values == 1 if name == "lammps_chute" else np.full(len(total), True)
        assert np.sqrt(np.mean((total + weight - dumped)[free] ** 2)) < tolerance * scale


def test_contact_points_lie_between_the_centres():
    folder = real_data("lammps_chute")
    scene = open_scene(folder / "particles.*", contacts=folder / "contacts.*")
    step = scene.isel(time=0).compute()
    valid = step.contact_i.values >= 0
    i = np.searchsorted(step.particle_id.values, step.contact_i.values[valid])
    arm = step.contact_point.values[valid] - step.position.values[i]
    length = np.linalg.norm(arm, axis=1)
    assert length.max() <= 0.5
    assert length.min() > 0.45
    normal = np.sum(arm * step.contact_force.values[valid], axis=1)
    assert (normal < 0).mean() > 0.95  # repulsive: the force on i points away from the contact


def test_two_dimensional_scene_is_detected():
    folder = real_data("lammps_biaxial2d")
    scene = open_scene(
        folder / "particles.00050000.dump.gz", contacts=folder / "contacts.00050000.dump.gz"
    )
    assert (scene.attrs["dimension"], scene.attrs["plane"], scene.attrs["periodic"]) == (
        2,
        "xy",
        "x",
    )


def test_velocities_that_lack_x_are_no_velocities(tmp_path):
    for row, columns in (("1 0 0 0 1 1", "id x y z vy vz"), ("1 0 0 0 1", "id x y z vz")):
        with pytest.raises(SceneError, match="no x of the velocity"):
            particles(tmp_path, dump_text([row], columns))
    flat = dump_text(["1 0 0 1 2"], "id x y vx vy")
    np.testing.assert_array_equal(particles(tmp_path, flat)[1]["velocity"], [[1, 2, 0]])


def test_two_columns_for_one_variable_raise(tmp_path):
    text = dump_text(["1 0 0 0 5 6"], "id x y z a b")
    for slot in ("velocity_x", "mass", "temperature"):
        with pytest.raises(SceneError, match=f"names maps 'a' and 'b' to '{slot}'"):
            particles(tmp_path, text, options=ReadOptions({"a": slot, "b": slot}))
    assert particles(tmp_path, text, options=ReadOptions({"a": "mass", "b": None}))[1]["mass"] == [
        5
    ]
