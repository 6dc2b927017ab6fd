from __future__ import annotations

import warnings

import numpy as np
import pytest

from tests import real_data
from tests.dumps import write
from xcg.common.messages import SceneError, SceneWarning
from xcg.readers.engines.mercury import Mercury
from xcg.readers.engines.mercury_restart import restart_beside
from xcg.readers.open import open_scene

mercury = Mercury()

DATA = "{n} {t} 0 0 0 4 4 2\n"
ROWS = [
    "1 1 0.45 0 0 0 0.5 0 0 0 0 0 0 0",
    "1.9 1 1 0.1 0.2 0.3 0.5 0 0 0 1 2 3 1",
    "1 3 1 0 0 0 0.25 0 0 0 0 0 0 0",
]
FSTAT = "# {t} 1\n# 0 0 0 4 4 2\n# 0.25 0.5 0 0 0 0\n"
PAIR = "{t} 0 1 1.45 1 0.7 0.1 0 5 2 -1 0 0 0 1 0"
MIRROR = "{t} 1 0 1.45 1 0.7 0.1 0 5 2 1 0 0 0 -1 0"
THIRD = "{t} 0 2 1 1.5 0.6 0.1 0 5 2 0 -0.96422 -0.26516 0 1 0"
WALL = "{t} 0 -5 1 1 0 0.05 0 3 1 -0 -0 -1 1 0 0"
RESTART = """MercuryDPM 1.0 name run revision 0 repository none
xMin 0 xMax 4 yMin 0 yMax 4 zMin 0 zMax 2
systemDimensions 3 particleDimensions 3 gravity 1 0 -9.81 backgroundDrag 0
Species 2
LinearViscoelasticSpecies id 0 density 2000 stiffness 1 dissipation 0
LinearViscoelasticSpecies id 1 density 3000 stiffness 1 dissipation 0
LinearViscoelasticMixedSpecies idMixed 0 index 0 stiffness 1000.0 dissipation 0
Walls 0
Boundaries 1
PeriodicBoundary normal 0 1 0 distanceLeft 0 distanceRight 4 shift 0 4 0
Particles 3
gravity is not read from here
"""


def data_text(times=(0.0,), rows=ROWS):
    return "".join(
        DATA.format(n=len(rows), t=t) + "".join(f"{row}\n" for row in rows) for t in times
    )


def fstat_text(times=(0.0,), rows=(PAIR, MIRROR, WALL)):
    return "".join(
        FSTAT.format(t=t) + "".join(row.format(t=t) + "\n" for row in rows) for t in times
    )


@pytest.fixture
def run(tmp_path):
    """Write a run of three steps with its restart file."""
    write(tmp_path / "run.data", data_text((0, 0.5, 1)))
    write(tmp_path / "run.fstat", fstat_text((0, 0.5, 1)))
    write(tmp_path / "run.restart", RESTART)
    return tmp_path


def test_a_run_is_read(run):
    scene = open_scene(run / "run.data", contacts=run / "run.fstat").compute()
    assert dict(scene.sizes) == {"time": 3, "particle": 3, "contact": 2, "component": 3, "bound": 2}
    np.testing.assert_array_equal(scene.time, [0, 0.5, 1])
    np.testing.assert_array_equal(scene.particle_id[0], [0, 1, 2])
    np.testing.assert_array_equal(scene.diameter[0], [1, 1, 0.5])
    np.testing.assert_array_equal(scene.velocity[0, 1], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(scene.density[0], [2000, 3000, 2000])
    np.testing.assert_allclose(scene.mass[0, 1], 3000 * np.pi / 6)
    np.testing.assert_array_equal(scene.attrs["gravity"], [1, 0, -9.81])
    assert scene.attrs["periodic"] == "y"
    np.testing.assert_array_equal(scene.box[0], [[0, 4], [0, 4], [0, 2]])


def test_contact_forces_are_read(run):
    scene = open_scene(run / "run.data", contacts=run / "run.fstat").isel(time=0).compute()
    np.testing.assert_array_equal(scene.contact_i, [0, 0])
    np.testing.assert_array_equal(scene.contact_j, [1, -5])
    np.testing.assert_array_equal(scene.contact_force, [[-5, 2, 0], [-1, 0, 3]])
    np.testing.assert_array_equal(scene.contact_normal, [[-1, 0, 0], [0, 0, 1]])
    np.testing.assert_array_equal(scene.contact_point, [[1.45, 1, 0.7], [1, 1, 0]])
    np.testing.assert_array_equal(scene.overlap, [0.1, 0.05])


@pytest.mark.parametrize(
    ("rows", "pairs"),
    [
        ((PAIR, WALL), [(0, 1), (0, -5)]),
        ((MIRROR, PAIR), [(0, 1)]),
        ((MIRROR,), [(1, 0)]),
        ((MIRROR, THIRD), [(1, 0), (0, 2)]),
        ((), []),
    ],
)
def test_pairs_listed_twice_or_once_count_once(run, rows, pairs):
    write(run / "run.fstat", fstat_text((0, 0.5, 1), rows))
    scene = open_scene(run / "run.data", contacts=run / "run.fstat").isel(time=1).compute()
    assert list(zip(scene.contact_i.values, scene.contact_j.values, strict=True)) == pairs
    if rows == (MIRROR,):
        np.testing.assert_array_equal(scene.contact_force, [[5, -2, 0]])


def test_many_files_make_one_series(tmp_path):
    for k, time in enumerate((0, 0.5, 1)):
        write(tmp_path / f"run.data.{k}", data_text((time,)))
        write(tmp_path / f"run.fstat.{k}", fstat_text((time,)))
    scene = open_scene(tmp_path / "run.data.*", contacts=tmp_path / "run.fstat.*", engine="mercury")
    np.testing.assert_array_equal(scene.step, [0, 1, 2])
    assert "mass" not in scene
    assert "gravity" not in scene.attrs


def test_restart_can_be_named(run):
    write(run / "other.restart", RESTART.replace("density 2000", "density 1"))
    scene = open_scene(run / "run.data", restart=run / "other.restart")
    assert float(scene.density[0, 0]) == 1
    with pytest.raises(FileNotFoundError, match=r"absent\.restart"):
        open_scene(run / "run.data", restart=run / "absent.restart")


@pytest.mark.parametrize(
    "boundary",
    [
        "normal 0 1 0 scaleFactor 1 distanceLeft 0.25 distanceRight 3.5 shift 0 3.25 0",
        "normal 0 1 1e-17 position_left 0.25 position_right 3.5 shift 0 3.25 0",
        "normal 0 -1 0 distance_left -3.5 distance_right -0.25",
        "normal 0 2 0 distanceLeft 0.5 distanceRight 7",
    ],
)
def test_periods_are_those_of_periodic_boundaries(run, boundary):
    old = "normal 0 1 0 distanceLeft 0 distanceRight 4 shift 0 4 0"
    write(run / "run.restart", RESTART.replace(old, boundary))
    scene = open_scene(run / "run.data")
    assert scene.attrs["periodic"] == "y"
    np.testing.assert_array_equal(scene.box, [[[0, 4], [0.25, 3.5], [0, 2]]] * 3)
    # moved boundaries: the restart file has the last ones only
    write(run / "run.data", data_text((0, 0.5)) + data_text((1,)).replace("4 4 2", "4 3.5 2"))
    np.testing.assert_array_equal(
        open_scene(run / "run.data").box[:, 1], [[0, 4], [0, 4], [0, 3.5]]
    )


def test_contacts_across_a_periodic_boundary_have_branches_over_its_edges(run):
    """Spheres with R = 0.25 at y = 0.5 and 3.3 overlap by 0.05 across a period of 3.25."""
    write(
        run / "run.restart",
        RESTART.replace("Left 0 distanceRight 4 shift 0 4 0", "Left 0.25 distanceRight 3.5"),
    )
    write(
        run / "run.data", data_text(rows=[f"2 {y} 1 0 0 0 0.25 0 0 0 0 0 0 0" for y in (0.5, 3.3)])
    )
    write(run / "run.fstat", fstat_text(rows=["{t} 0 1 2 0.275 1 0.05 0 5 0 0 1 0 1 0 0"]))
    scene = open_scene(run / "run.data", contacts=run / "run.fstat").compute()
    stress = (
        scene.cg.coarse_grain("contact_stress", axes="y", width=0.2)
        .contact_stress.mean("y")
        .values.reshape(3, 3)
    )
    np.testing.assert_allclose(abs(stress[1, 1]), 5 * 0.45 / (4 * 3.25 * 2), rtol=1e-3)


def test_a_run_in_two_dimensions_is_read(tmp_path):
    rows = ["1 1 0.1 0.2 0.5 0 3 0", "2 1.5 0 0 0.5 0 0 1", "1 2 0 0 0.5 0 0 0"]
    text = "3 0.5 0 0 4 4\n" + "".join(f"{row}\n" for row in rows)
    scene = open_scene(write(tmp_path / "flat.data", text), density=2.0, shape="sphere").compute()
    assert (scene.attrs["dimension"], scene.attrs["plane"]) == (2, "xy")
    np.testing.assert_array_equal(scene.position[0, 1], [2, 1.5, 0])
    np.testing.assert_array_equal(scene.velocity[0, 0], [0.1, 0.2, 0])
    np.testing.assert_array_equal(scene.species[0], [0, 1, 0])
    np.testing.assert_array_equal(scene.box[0], [[0, 4], [0, 4], [-np.inf, np.inf]])


def test_names_map_columns(run):
    scene = open_scene(run / "run.data", names={"omx": "spin_x", "species": None})
    np.testing.assert_array_equal(scene.spin_x[0], [0, 1, 0])
    assert "species" not in scene


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"run.data": data_text() + "1 2 3\n"}, "expected a header 'N t xmin"),
        (
            {"run.data": data_text((0, 0.5, 1))[:-20]},
            r"run.data \(step 2\): row 2 has \d+ values, expected 14",
        ),
        ({"run.data": data_text((0, 0.5, 1)).replace("1.9", "what")}, "'what' in column 'x'"),
        (
            {"run.fstat": fstat_text().replace("# 0.0", "# now", 1)},
            "three lines with '#' and the time",
        ),
        ({"run.fstat": fstat_text()[:-9]}, "run.fstat .*row 2 has 12 values, expected 16"),
        ({"run.restart": RESTART.replace("id 1 ", "id 7 ")}, "species 1 is not in .*run.restart"),
        (
            {"run.restart": RESTART.replace("gravity 1 0 -9.81", "gravity 1 0")},
            "three numbers after 'gravity'",
        ),
        (
            {"run.restart": RESTART.replace("normal 0 1 0", "normal 0.7071 0.7071 0")},
            "not along x, y or z",
        ),
        (
            {"run.restart": RESTART.replace("shift 0 4 0", "shift 1 5 0")},
            "not as long as its period 4",
        ),
        (
            {"run.restart": RESTART.replace("distanceRight 4 ", "")},
            "a number after 'distanceRight'",
        ),
    ],
)
def test_damaged_files_raise(run, change, match):
    for name, text in change.items():
        write(run / name, text)
    with pytest.raises(SceneError, match=match):
        open_scene(run / "run.data", contacts=run / "run.fstat", engine="mercury")


def test_runs_are_recognised(run):
    assert mercury.recognises(str(run / "run.data"))
    assert mercury.recognises(str(run / "run.fstat"))
    assert mercury.recognises(str(run / "run.restart"))
    assert not mercury.recognises(str(write(run / "table.data", "x y z\n1 2 3\n")))


def test_a_real_run_is_read():
    """Pairs: contact points on the branch, normals along it; walls: all six, normals into the box."""
    folder = real_data("mercury_synthetic")
    scene = open_scene(folder / "syn200.data", contacts=folder / "syn200.fstat").compute()
    np.testing.assert_array_equal(scene.time, [0, 0.01])
    np.testing.assert_allclose(scene.density, 2.0)
    np.testing.assert_array_equal(scene.attrs["gravity"], [0, 0, -1])
    for t in range(2):
        step = scene.isel(time=t)
        rows = np.loadtxt(folder / "syn200.fstat", comments="#")
        rows = rows[rows[:, 0] == step.time.values]
        pairs = rows[(rows[:, 2] > rows[:, 1])]
        walls = rows[rows[:, 2] < 0]
        valid = step.contact_i.values >= 0
        assert valid.sum() == len(pairs) + len(walls)
        i, j, normal, point, force = (
            step[name].values[valid]
            for name in (
                "contact_i",
                "contact_j",
                "contact_normal",
                "contact_point",
                "contact_force",
            )
        )
        position = step.position.values
        radius = step.diameter.values / 2
        pair = j >= 0
        branch = position[i[pair]] - position[j[pair]]
        length = np.linalg.norm(branch, axis=1)
        np.testing.assert_allclose(normal[pair], branch / length[:, None], atol=1e-12)
        overlap = step.overlap.values[valid]
        np.testing.assert_allclose(
            overlap[pair], radius[i[pair]] + radius[j[pair]] - length, atol=1e-12
        )
        towards = np.sum((position[i] - point) * normal, axis=1)
        np.testing.assert_allclose(towards, radius[i] - overlap / 2, atol=1e-9)
        np.testing.assert_allclose(np.sum(force * normal, axis=1)[pair], pairs[:, 8], rtol=1e-9)
        assert set(j[~pair]) <= set(range(-6, 0))


def test_unit_gravity_is_scaled(run):
    scene = open_scene(run / "run.data", units={"length": 1e-3, "time": 1e-3})
    np.testing.assert_allclose(scene.attrs["gravity"], np.array([1, 0, -9.81]) * 1e3)
    np.testing.assert_allclose(scene.time, [0, 5e-4, 1e-3])


def test_a_missing_restart_file_is_none():
    assert restart_beside("nowhere/run.data") is None


def test_rows_are_no_ids_where_particles_are_removed(tmp_path):
    text = data_text((0, 0.5)) + data_text((1,), ROWS[1:])
    write(tmp_path / "run.data", text)
    write(tmp_path / "run.fstat", fstat_text((0, 0.5)) + fstat_text((1,), ()))
    write(tmp_path / "run.restart", RESTART)
    message = r"run\.data \(step 2\) has 2 particles, the step before it 3: .*Split the file"
    with pytest.warns(SceneWarning, match=message):
        ds = open_scene(tmp_path / "run.data", tmp_path / "run.fstat")
    assert (ds.load().contact_i >= 0).sum("contact").values.tolist() == [2, 2, 0]
    with pytest.raises(SceneError, match="ids"):
        ds.cg.derive("velocity")
    with pytest.raises(SceneError, match="ids"):
        ds.cg.mean_squared_displacement()
    # particles that enter are appended
    write(tmp_path / "run.data", data_text((0,), ROWS[:2]) + data_text((0.5, 1)))
    with warnings.catch_warnings(action="error"):
        open_scene(tmp_path / "run.data").cg.derive("velocity")
