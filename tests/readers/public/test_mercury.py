"""MercuryDPM: dimensions and boundaries of the restart file."""

from __future__ import annotations

import numpy as np
import pytest

import xcg
from tests.dumps import write
from xcg.common.messages import SceneError, SceneWarning
from xcg.readers.open import open_scene

HEAD = """MercuryDPM 1.0 name run revision 1 repository none
timeStep 0.001 time {time} ntimeSteps 1 timeMax 4
systemDimensions {system} particleDimensions {particles} gravity 0 0 0 backgroundDrag 0
"""
BODY = """Species 1
LinearViscoelasticSpecies id 0 density 2000 stiffness 1 dissipation 0
Walls 0
Boundaries {count}
{boundaries}
Particles 0
"""
FLAT = "3 {time} 0 0 1 1\n.2 .2 0 0 .1 0 3 0\n.5 .3 0 0 .2 0 0 0\n.7 .7 0 0 .1 0 0 0\n"
ROW = "{} 0 0 0 .1 0 0 0 0 0 0 0\n"
DEEP = "3 {time} 0 0 0 1 1 1\n" + "".join(map(ROW.format, (".5 .05 .5", ".7 .87 .5", ".2 .5 .3")))
PAIR = "# {time} 0\n# 0 0 0 1 1 1\n# .1 .1 0 0 0 0\n{time} 0 1 .5 -.04 .5 .02 0 7 0 0 1 0 0 0 0\n"
LEES_EDWARDS = "LeesEdwardsBoundary id 0 left 0 right 1 down 0 up 1 shift {shift} vel {velocity}"


def restart(*boundaries, time=0.0, system=3, particles=3):
    head = HEAD.format(time=time, system=system, particles=particles)
    return head + BODY.format(count=len(boundaries), boundaries="\n".join(boundaries))


def write_run(folder, restart_text, data=DEEP, times=(0.0,)):
    write(folder / "run.restart", restart_text)
    write(folder / "run.data", [data.format(time=time) for time in times])
    write(folder / "run.fstat", [PAIR.format(time=time) for time in times])
    return folder / "run.data"


def stress_times_volume(data):
    """Return the mean contact stress; the box has the volume 1."""
    scene = open_scene(data, contacts=data.with_suffix(".fstat")).compute()
    fields = xcg.coarse_grain(scene, "contact_stress", axes="", width=0.2)
    return fields.contact_stress.values.reshape(3, 3)


@pytest.mark.parametrize("data", [FLAT, DEEP])
def test_discs_have_masses_of_unit_depth(tmp_path, data):
    scene = open_scene(write_run(tmp_path, restart(system=2, particles=2), data)).compute()
    radius = scene.diameter / 2
    np.testing.assert_allclose(scene.mass, 2000 * np.pi * radius**2)
    np.testing.assert_allclose(scene.volume, np.pi * radius**2)
    np.testing.assert_allclose(scene.moment_of_inertia, scene.mass * radius**2 / 2)
    assert scene.attrs["dimension"] == 2


def test_spheres_in_two_dimensions_have_masses_of_spheres(tmp_path):
    scene = open_scene(write_run(tmp_path, restart(system=2, particles=3), FLAT)).compute()
    np.testing.assert_allclose(scene.mass, 2000 * np.pi / 6 * scene.diameter**3)
    assert scene.attrs["dimension"] == 2


def test_discs_scale_with_the_unit_of_length(tmp_path):
    data = write_run(tmp_path, restart(system=2, particles=2), FLAT)
    scene = open_scene(data, units={"length": 1e-3}).compute()
    np.testing.assert_allclose(scene.mass[0, 0], 2000 * np.pi * 0.1**2)
    np.testing.assert_allclose(scene.volume[0, 0], np.pi * 1e-4**2 * 1e-3)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_eight_columns_are_two_dimensions(tmp_path, rows):
    lines = FLAT.format(time=0).splitlines(keepends=True)[1 : rows + 1]
    data = write_run(
        tmp_path, restart(system=2, particles=3), f"{rows} 0 0 0 1 1\n" + "".join(lines)
    )
    assert open_scene(data).attrs["dimension"] == 2


def test_spin_in_two_dimensions_has_the_opposite_sign(tmp_path):
    scene = open_scene(write_run(tmp_path, restart(system=2, particles=2), FLAT)).compute()
    np.testing.assert_array_equal(scene.angular_velocity[0, 0], [0, 0, -3])


def test_two_dimensions_without_a_restart_file_are_spheres_with_a_warning(tmp_path):
    data = write(tmp_path / "alone.data", FLAT.format(time=0))
    with pytest.warns(SceneWarning, match="discs or spheres.*restart=.*shape='disc'"):
        open_scene(data)
    scene = open_scene(data, shape="disc", thickness=1, density=2000).compute()
    np.testing.assert_allclose(scene.mass[0, 0], 2000 * np.pi * 0.1**2)


@pytest.mark.parametrize("shift", [0.2, -0.8, 60.2])
def test_lees_edwards_images_are_shifted_and_move(tmp_path, shift):
    """The branch is from (0.7, 0.87) to (0.5 + 0.2, 1.05): 7 * 0.18 = 1.26."""
    data = write_run(tmp_path, restart(LEES_EDWARDS.format(shift=shift, velocity=1)))
    stress = stress_times_volume(data)
    np.testing.assert_allclose(stress[1], [0, 1.26, 0], atol=1e-12)
    np.testing.assert_allclose(stress[[0, 2]], 0, atol=1e-12)
    scene = open_scene(data)
    np.testing.assert_allclose(scene.lattice_velocity[0, 1], [1, 0, 0])


def test_lees_edwards_boxes_may_have_two_dimensions(tmp_path):
    text = restart(LEES_EDWARDS.format(shift=0.2, velocity=3), system=2, particles=2)
    scene = open_scene(write_run(tmp_path, text, FLAT)).compute()
    np.testing.assert_allclose(scene.lattice[0, :2], [[1, 0, 0], [0.2, 1, 0]])
    np.testing.assert_allclose(scene.lattice_velocity[0, 1], [3, 0, 0])


def test_lees_edwards_shifts_of_other_times_follow_from_the_velocity(tmp_path):
    text = restart(LEES_EDWARDS.format(shift=5.3, velocity=2), time=1.0)
    data = write_run(tmp_path, text, times=(0.9, 1.0))
    with pytest.warns(SceneWarning, match=r"shift 5.3 at time 1; .* time 0.9, .*lattice="):
        scene = open_scene(data)
    np.testing.assert_allclose(scene.lattice[:, 1, 0], [0.1, 0.3])
    np.testing.assert_allclose(scene.lattice_velocity[:, 1, 0], 2)
    told = open_scene(data, lattice={"xy": [0.4, 0.5]}, shear_rate={"xy": 2})
    np.testing.assert_allclose(told.lattice[:, 1, 0], [0.4, 0.5])


def test_lees_edwards_shifts_without_a_time_are_refused_for_several_steps(tmp_path):
    text = restart(LEES_EDWARDS.format(shift=0.3, velocity=2)).replace(" time 0.0", "")
    data = write_run(tmp_path, text, times=(0.9, 1.0))
    with pytest.raises(SceneError, match="at a time that is not stated; give lattice="):
        open_scene(data)


def test_oblique_periods_are_lattice_vectors(tmp_path):
    line = "PeriodicBoundary id 0 normal 0 1 0 scaleFactor 1 distanceLeft 0 distanceRight 1 shift"
    along_x = line.replace("normal 0 1 0", "normal 1 0 0") + " 1 0 0"
    data = write_run(tmp_path, restart(line + " 0.2 1 0", along_x))
    np.testing.assert_allclose(stress_times_volume(data)[1], [0, 1.26, 0], atol=1e-12)


MASER = (
    "SubcriticalMaserBoundary id 0 normal 1 0 0 distanceLeft 0 distanceRight 1 shift 1 0 0 "
    "maserIsActivated {} numberOfMaserSpecies 0"
)
CONTROL = (
    "StressStrainControlBoundary id 0 stressGoal 1 0 0 0 1 0 0 0 1 strainRate 0 {rate} 0 0 0 0 0 0 "
    "0 pGainFactor 1 0 0 0 1 0 0 0 1 iGainFactor 0 0 0 0 0 0 0 0 0 isStrainRateControlled 1 "
    "integratedShift {shift}"
)


@pytest.mark.parametrize(
    ("boundary", "periodic"),
    [
        (MASER.format(0), "x"),
        (MASER.format(0).replace("Subcritical", "ConstantMassFlow"), "x"),
        (CONTROL.format(rate=0, shift=0), "xyz"),
        ("CubeInsertionBoundary id 0 maxFailed 1 posMin 0 0 0 posMax 1 1 1 velMin 0 0 0", ""),
        ("CubeDeletionBoundary id 0 normal 1 0 0 scaleFactor 1 distance 1", ""),
        ("FluxBoundary id 0 normal 1 0 0 scaleFactor 1 distance 1", ""),
    ],
)
def test_boundaries_are_read(tmp_path, boundary, periodic):
    assert open_scene(write_run(tmp_path, restart(boundary))).attrs["periodic"] == periodic


@pytest.mark.parametrize(
    ("boundary", "match", "answer"),
    [
        ("AngledPeriodicBoundary id 0 normal_left 1 0 0", "'AngledPeriodic.*wrong branch", {}),
        ("CircularPeriodicBoundary id 0 innerRadius 1", "'CircularPeriodic.*periodic=", {}),
        ("MyBoundary id 0", "'MyBoundary' is not read", {"periodic": "x"}),
        (MASER.format(1), "'SubcriticalMaser.* 0 to 1 .*open", {"periodic": "x"}),
        (
            "TimeDependentPeriodicBoundary id 0 normal 0 1 0 distanceLeft 0 distanceRight 1",
            "'TimeDependentPeriodic.*lattice=",
            {"lattice": {"xy": 0.2}, "shear_rate": {}},
        ),
        (
            CONTROL.format(rate=0.1, shift=0.2),
            "'StressStrainControl.*shifted by 0.2 .*lattice=",
            {"lattice": {"xy": 0.2}, "shear_rate": {"xy": 0.1}},
        ),
    ],
)
def test_boundaries_that_are_not_read_are_named(tmp_path, boundary, match, answer):
    data = write_run(tmp_path, restart(boundary))
    with pytest.warns(SceneWarning, match=match):
        open_scene(data)
    if answer:
        open_scene(data, **answer)


@pytest.mark.parametrize("end", [".data", ".fstat"])
def test_other_files_are_no_restart_files(tmp_path, end):
    data = write_run(tmp_path, restart())
    path = data.with_suffix(end)
    with pytest.raises(SceneError, match=rf"run{end}: not a restart file .*name that of this run"):
        open_scene(data, restart=path)


def test_a_damaged_restart_file_beside_the_data_is_named(tmp_path):
    data = write_run(tmp_path, "")
    with pytest.raises(SceneError, match=r"run\.restart: not a restart file"):
        open_scene(data)


OLD = """restart_version {version}
name old
xmin 0 xmax 1 ymin 0 ymax 1 zmin 0 zmax 1
dt 0.0001 t 3000 tmax 3000 save_count 500000
dim 3 gravity 0 0 -1
options_fstat 1 options_data 1 options_ene 1 options_restart 2
Species 1
k 200000 disp 25 kt 57142.857 dispt 25 mu 0.5 rho 1.5 dim_particle 3
Walls 1
numFiniteWalls 0 normal 0 0 -1 position 1.7
{periods}
Particles 0
"""


@pytest.mark.parametrize(
    ("version", "periods"),
    [
        (2, "WallsPeriodic 1\nnormal 1 0 0 pos_left 0 pos_right 1 shift 1 0 0"),
        (
            3,
            "Boundaries 1\nPeriodicBoundary normal 1 0 0 position_left 0 position_right 1 shift 1 0 0",
        ),
    ],
)
def test_old_restart_files_are_read(tmp_path, version, periods):
    scene = open_scene(write_run(tmp_path, OLD.format(version=version, periods=periods)))
    assert scene.attrs["periodic"] == "x"
    np.testing.assert_allclose(scene.density, 1.5)
    np.testing.assert_array_equal(scene.attrs["gravity"], [0, 0, -1])


def test_numbered_restart_files_belong_to_numbered_data(tmp_path):
    for number, shift in enumerate((0.1, 0.4)):
        text = restart(LEES_EDWARDS.format(shift=shift, velocity=3), time=number / 10)
        write(tmp_path / f"run.restart.{number}", text)
        write(tmp_path / f"run.data.{number}", DEEP.format(time=number / 10))
    scene = open_scene(tmp_path / "run.data.*")
    np.testing.assert_allclose(scene.lattice[:, 1, 0], [0.1, 0.4])


@pytest.mark.parametrize("name", ["run.restart", "run.restart.12"])
def test_a_restart_file_alone_is_refused_with_what_to_open(tmp_path, name):
    path = write(tmp_path / name, restart())
    data = name.replace("restart", "data")
    with pytest.raises(SceneError, match=rf"restart file .* open '.*{data}', with contacts="):
        open_scene(path)
