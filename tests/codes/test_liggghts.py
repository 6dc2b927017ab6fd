"""LIGGGHTS itself, where it is installed: scenes from its files against the numbers that it prints."""

import shutil
import subprocess

import numpy as np
import pytest

import xcg

# spheres at rest on a floor; dumped as by the tutorials, and as text with all digits
SCRIPT = """
atom_style granular
atom_modify map array
boundary p p f
newton off
communicate single vel yes
units si
region box block 0 0.04 0 0.04 0 0.06 units box
create_box 2 box
neighbor 0.002 bin
neigh_modify delay 0
fix young all property/global youngsModulus peratomtype 5e6 5e6
fix poisson all property/global poissonsRatio peratomtype 0.45 0.45
fix bounce all property/global coefficientRestitution peratomtypepair 2 0.3 0.3 0.3 0.3
fix friction all property/global coefficientFriction peratomtypepair 2 0.5 0.5 0.5 0.5
pair_style gran model hertz tangential history
pair_coeff * *
timestep 1e-5
fix weight all gravity 9.81 vector 0 0 -1
fix floor all wall/gran model hertz tangential history primitive type 1 zplane 0
fix large all particletemplate/sphere 15485863 atom_type 1 density constant 2500 radius constant 0.003
fix small all particletemplate/sphere 15485867 atom_type 2 density constant 2500 radius constant 0.002
fix sizes all particledistribution/discrete 32452843 2 large 0.6 small 0.4
fix pour all insert/pack seed 32452867 distributiontemplate sizes maxattempt 200 &
  insert_every once overlapcheck yes all_in yes vel constant 0 0 -0.4 region box volumefraction_region 0.35
fix move all nve/sphere
compute press all pressure thermo_temp pair
compute pair all pair/gran/local pos id force delta
fix slow all viscous 0.05
run 70000
compute touching all contact/atom
thermo_style custom step atoms c_press[1] c_press[2] c_press[3] c_press[4] c_press[5] c_press[6]
thermo_modify format float %.17g
dump text all custom 1000 grains_*.liggghts id type x y z ix iy iz vx vy vz fx fy fz radius mass density c_touching
dump_modify text format "%d %d %.17g %.17g %.17g %d %d %d %.17g %.17g %.17g %.17g %.17g %.17g %.17g %.17g %.17g %.0f"
dump tutorial all custom/vtk 1000 grains_*.vtk id type type x y z ix iy iz vx vy vz fx fy fz omegax omegay omegaz radius
dump pairs all local 1000 pair_*.txt c_pair[1] c_pair[2] c_pair[3] c_pair[4] c_pair[5] &
  c_pair[6] c_pair[7] c_pair[8] c_pair[9] c_pair[10] c_pair[11] c_pair[12] c_pair[13]
thermo 1000
dump_modify pairs format "%.17g %.17g %.17g %.17g %.17g %.17g %.0f %.0f %.0f %.17g %.17g %.17g %.17g"
run 4000
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of the output and the lines that LIGGGHTS prints."""
    if shutil.which("liggghts") is None:
        pytest.skip("needs LIGGGHTS: apt install liggghts")
    folder = tmp_path_factory.mktemp("liggghts")
    (folder / "in.rest").write_text(SCRIPT)
    command = ["liggghts", "-in", "in.rest"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return folder, done.stdout.splitlines()


def open_text(folder):
    return xcg.open_scene(
        folder / "grains_*.liggghts",
        contacts=folder / "pair_*.txt",
        names={"c_touching": "touching"},
        timestep=1e-5,
    )


def test_coordination_numbers_are_those_of_compute_contact_atom(run):
    ds = open_text(run[0]).isel(time=-1).load()
    rows = np.concatenate([ds.contact_i, ds.contact_j])
    touching = np.bincount(rows[rows > 0], minlength=ds.sizes["particle"] + 1)[1:]
    assert touching.mean() > 3
    np.testing.assert_array_equal(touching, ds.touching)


def test_stress_is_that_of_compute_pressure(run):
    """Forces in dumps are computed again with the velocities of full steps: equal at rest."""
    ds = open_text(run[0]).isel(time=-1).load()
    lines = [line.split() for line in run[1] if line.split()[:1] == [str(ds.step.item())]]
    expected = np.array(lines[-1][2:], float)  # xx, yy, zz, xy, xz, yz
    stress = ds.cg.coarse_grain("contact_stress", axes="", width=0.01).contact_stress.values
    found = stress[[0, 1, 2, 1, 2, 2], [0, 1, 2, 0, 0, 1]]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * expected.max())


def test_dumps_of_the_tutorials_open_without_names(run):
    with pytest.warns(xcg.SceneWarning, match="hold no grains and are skipped.*boundingBox"):
        ds = xcg.open_scene(run[0] / "grains_*.vtk", density=2500.0, timestep=1e-5)
    text = open_text(run[0])
    np.testing.assert_array_equal(ds.step, text.step)
    for name in ("position", "velocity", "diameter", "species"):  # six digits
        np.testing.assert_allclose(ds[name], text[name], rtol=1e-5, atol=1e-6, err_msg=name)
