"""YADE itself, where it is installed: scenes from its files against the numbers that it prints."""

import os
import re
import shutil
import subprocess

import numpy as np
import pytest

import xcg
from tests import ROOT

# Spheres that fill a tilted periodic cell; `save` is the script in docs/other_codes.md.
SCRIPT = """
import os
from yade import export, pack, utils
O.periodic = True
O.cell.hSize = Matrix3(0.1, 0.02, 0, 0, 0.1, 0, 0, 0.01, 0.1)
cloud = pack.SpherePack()
cloud.makeCloud(Vector3.Zero, (0.1, 0.1, 0.1), 5e-3, 0.2, 300, periodic=True, seed=1)
for name, density in (("a", 2600), ("b", 2000)):
    O.materials.append(FrictMat(young=1e7, poisson=0.3, frictionAngle=0.5, density=density, label=name))
O.bodies.append([sphere(c, r, material="ab"[k % 2]) for k, (c, r) in enumerate(cloud)])
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb()]),
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom()], [Ip2_FrictMat_FrictMat_FrictPhys()], [Law2_ScGeom_FrictPhys_CundallStrack()]
    ),
    PeriTriaxController(
        dynCell=True, mass=0.2, maxUnbalanced=0.01, relStressTol=0.02, goal=(-1e4, -1e4, -1e4), stressMask=7,
        globUpdate=5, maxStrainRate=(10, 10, 10), doneHook="",
    ),
    NewtonIntegrator(damping=0.4),
    VTKRecorder(fileName="rec-", iterPeriod=3000, recorders=["spheres", "velocity", "id", "mass", "materialId"]),
]
O.dt = 0.5 * PWaveTimeStep()
os.makedirs("saved")
exec(open("save.py").read())
exporter = export.VTKExporter("exporter")
for k in range(2):
    O.run(3001 if k == 0 else 2999, True)
    save("saved")
    exporter.exportSpheres(what={"velo": "b.state.vel", "mass": "b.state.mass"})
    for form in ("x_y_z_r", "x_y_z_r_matId", "id_x_y_z_r_matId"):
        export.textExt("%s.%d.txt" % (form, O.iter), format=form, comment="two\\n# lines")
stress = utils.getStress()
numbers = [stress[i, j] for i in range(3) for j in range(3)] + [utils.avgNumInteractions(skipFree=False)]
open("numbers.txt", "w").write(" ".join("%.17g" % number for number in numbers))
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of the output."""
    if shutil.which("yade") is None:
        pytest.skip("needs YADE: apt install yade")
    folder = tmp_path_factory.mktemp("yade")
    page = (ROOT / "docs" / "other_codes.md").read_text()
    save = re.search(r"<!-- a script of YADE -->\n```python\n(.*?)```", page, re.DOTALL)[1]
    (folder / "save.py").write_text(save)
    (folder / "run.py").write_text(SCRIPT)
    # the system's Python runs it, without this environment
    environment = {"HOME": os.environ["HOME"], "PATH": "/usr/bin:/bin"}
    command = ["yade", "-n", "-x", "-j1", "run.py"]
    subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=True)
    return folder


def open_saved(folder):
    return xcg.open_scene(folder / "saved/grains_*.txt", contacts=folder / "saved/contacts_*.txt")


def test_stress_and_coordination_number_are_those_of_yade(run):
    ds = open_saved(run).isel(time=-1).load()
    *stress, coordination = np.loadtxt(run / "numbers.txt")
    found = ds.cg.coarse_grain("contact_stress", axes="", width=0.01).contact_stress.values
    expected = -np.reshape(stress, (3, 3))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    z = ds.cg.microstructure("coordination_number").coordination_number
    assert z.item() == pytest.approx(coordination)


@pytest.mark.filterwarnings(
    "ignore:.*no column of particle ids", "ignore:.*density=2600 is not used"
)
@pytest.mark.parametrize(
    "pattern",
    ["exporter-spheres-*.vtk", "x_y_z_r.*.txt", "x_y_z_r_matId.*.txt", "id_x_y_z_r_matId.*.txt"],
)
def test_what_yade_exports_opens_without_names(run, pattern):
    saved = open_saved(run)
    ds = xcg.open_scene(run / pattern, density=2600.0)
    assert ds.sizes["time"] == saved.sizes["time"] == 2
    np.testing.assert_allclose(ds.diameter, saved.diameter, rtol=1e-5)
    apart = ds.position.values - saved.position.values
    cell = saved.lattice.values  # VTKExporter moves grains into the cell
    apart -= np.rint(apart @ np.linalg.inv(cell)) @ cell
    np.testing.assert_allclose(apart, 0, atol=1e-6)  # six digits


def test_recorded_spheres_open_without_names(run):
    ds = xcg.open_scene(run / "rec-spheres.*.vtu")
    np.testing.assert_array_equal(ds.step, [0, 3000])
    saved = open_saved(run)
    for name in ("particle_id", "diameter", "mass"):
        np.testing.assert_allclose(ds[name][0], saved[name][0], rtol=1e-6)
