"""A running LAMMPS as a scene: with an object of the same interface, and with LAMMPS itself where it is installed."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

import xcg
from tests import ROOT

CONTACTS = {"ids": "patom1 patom2", "pl": "dx dy dz fx fy fz p1 p2 p3"}


class Lammps:
    """Two grains that touch across the edge x = 0, and one at a wall, as LAMMPS' Python module hands them out."""

    POSITION = np.array([[0.4, 1.0, 1.0], [9.5, 1.0, 1.0], [5.0, 5.0, 0.48]])
    FORCE = np.array([10.0, 0.0, 0.0])
    SHEAR = np.array([0.0, 2.0, -1.0])
    PUSH = np.array([0.0, 0.5, 30.0])

    def __init__(
        self,
        units="si",
        tilt=0.0,
        world=None,
        atoms=None,
        style="gran/hooke/history",
        running=False,
    ):
        self.units, self.tilt, self.style, self.is_running = units, tilt, style, running
        self.world = world
        self.commands, self.ready = [], {}
        self.fixes = {
            "floor": np.array([[0.0] * 8, [0.0] * 8, [1.0, *self.PUSH, 5.0, 5.0, 0.0, 0.5]])
        }
        self.atoms = {
            "id": np.array([7, 3, 12, 7, 3], "int32"),  # ghosts follow
            "type": np.array([1, 1, 2, 1, 1], "int32"),
            "x": np.vstack([self.POSITION, self.POSITION[:2] + np.array([[10.0, 0, 0], [-10.0, 0, 0]])]),
            "v": np.arange(15.0).reshape(5, 3), "omega": -np.arange(15.0).reshape(5, 3),
            "radius": np.full(5, 0.5), "rmass": np.full(5, 2.0),
        }  # fmt: skip
        self.atoms = self.atoms if atoms is None else {name: self.atoms[name] for name in atoms}
        self.numpy = SimpleNamespace(
            extract_atom=self.atoms.get,
            extract_compute=self.extract_compute,
            extract_fix=self.extract_fix,
        )

    def command(self, line):
        self.commands.append(line)
        words = line.split()
        if words[0] == "compute":
            assert words[2] == "all"
            assert words[-2:] == ["cutoff", "radius"]
            self.ready[words[1]] = words[4:-2]
        elif words[0] == "uncompute":
            del self.ready[words[1]]

    def extract_compute(self, name, style, kind):
        assert (style, kind) == (2, 2)
        assert not self.commands or self.commands[-1] == "run 0 post no"
        branch = self.POSITION[0] - self.POSITION[1] + [10.0, 0, 0]
        partners = {"patom1": 7, "patom2": 3}
        vectors = {"d?": branch, "f?": self.FORCE}
        row = partners | {
            template.replace("?", axis): value
            for template, vector in vectors.items()
            for axis, value in zip("xyz", vector, strict=True)
        }
        row |= dict(zip(("p1", "p2", "p3"), self.SHEAR, strict=True))
        return np.array([[row[word] for word in self.ready[name]]])

    def extract_fix(self, name, style, kind):
        assert (style, kind) == (1, 2)
        return self.fixes[name]

    def extract_global(self, name):
        return {"nlocal": 3, "ntimestep": 4000, "units": self.units, "pair_style": self.style}[name]

    def extract_setting(self, name):
        return {"dimension": 3, "world_size": 1 if self.world is None else 2}[name]

    def extract_box(self):
        return [0.0, 0.0, 0.0], [10.0, 10.0, 20.0], self.tilt, 0.0, 0.0, [1, 1, 0], 0

    def get_thermo(self, word):
        return {"time": 0.25}[word]

    def get_mpi_comm(self):
        return self.world or None

    def has_id(self, kind, name):
        return name in {"compute": self.ready, "fix": self.fixes}[kind]


def check(ds):
    assert ds.particle_id.values.tolist() == [[3, 7, 12]]
    assert ds.position.values[0, 1].tolist() == [0.4, 1.0, 1.0]
    assert ds.velocity.values[0, 1].tolist() == [0.0, 1.0, 2.0]
    assert ds.angular_velocity.values[0, 2].tolist() == [-6.0, -7.0, -8.0]
    assert ds.diameter.values.tolist() == [[1.0, 1.0, 1.0]]
    assert ds.mass.values.tolist() == [[2.0, 2.0, 2.0]]
    assert ds.species.values.tolist() == [[1, 1, 2]]
    assert (ds.time.item(), ds.step.item()) == (0.25, 4000)
    assert ds.box.values[0].tolist() == [[0, 10], [0, 10], [0, 20]]
    assert ds.attrs["periodic"] == "xy"


def test_one_step_of_a_running_simulation():
    lmp = Lammps()
    ds = xcg.scene_from_lammps(lmp, walls="floor", gravity=(0, 0, -9.81))
    check(ds)
    assert ds.contact_i.values.tolist() == [[7, 12]]
    assert ds.contact_j.values.tolist() == [[3, -2]]
    np.testing.assert_array_equal(ds.contact_force[0], [lmp.FORCE + lmp.SHEAR, lmp.PUSH])
    np.testing.assert_allclose(
        ds.contact_point[0], [[-0.05, 1.0, 1.0], [5.0, 5.0, 0.0]], atol=1e-15
    )
    assert ds.attrs["unit_system"] == "SI"
    assert ds.attrs["wall_names"] == "floor"
    assert ds.attrs["gravity"].tolist() == [0, 0, -9.81]
    assert lmp.commands == [
        "compute xcg_ids all property/local patom1 patom2 cutoff radius",
        "compute xcg_pair all pair/local dx dy dz fx fy fz p1 p2 p3 cutoff radius",
        "run 0 post no",
        "uncompute xcg_ids",
        "uncompute xcg_pair",
    ]
    assert lmp.ready == {}
    lmp.atoms["x"][:] = 0.0  # LAMMPS moves on, the scene does not
    check(ds)


def test_computes_of_ones_own_within_a_run():
    lmp = Lammps(running=True)
    lmp.ready = {name: words.split() for name, words in CONTACTS.items()}
    ds = xcg.scene_from_lammps(lmp, contacts=CONTACTS, walls={"base": "floor"}, frozen=2)
    check(ds)
    assert lmp.commands == []
    assert ds.frozen.values.tolist() == [[0, 0, 1]]
    assert ds.attrs["wall_names"] == "base"
    np.testing.assert_array_equal(ds.contact_force[0, 0], lmp.FORCE + lmp.SHEAR)


def test_without_contacts_and_other_units():
    lmp = Lammps(units="micro")
    ds = xcg.scene_from_lammps(lmp, contacts=False)
    assert lmp.commands == []
    assert "contact_i" not in ds
    np.testing.assert_allclose(ds.diameter, 1e-6)
    np.testing.assert_allclose(ds.time, 0.25e-6)
    assert (
        xcg.scene_from_lammps(Lammps(units="lj"), contacts=False).attrs["unit_system"] == "reduced"
    )
    si = xcg.scene_from_lammps(Lammps(units="real"), contacts=False, units={"length": 1e-10})
    np.testing.assert_allclose(si.diameter, 1e-10)


def test_pair_styles_without_friction():
    lmp = Lammps(style="lj/cut")
    ds = xcg.scene_from_lammps(lmp)
    assert "pair/local dx dy dz fx fy fz cutoff radius" in lmp.commands[1]
    np.testing.assert_array_equal(ds.contact_force[0, 0], lmp.FORCE)


def test_atoms_of_several_processes_are_gathered():
    """Two of them, of which the other has the same atoms with other ids: each array is gathered."""
    shift = iter(range(100))
    world = SimpleNamespace(
        allgather=lambda values: [values, values[:0]] if next(shift) >= 0 else None
    )
    check(xcg.scene_from_lammps(Lammps(world=world)))
    with pytest.raises(xcg.SceneError, match="pip install mpi4py"):
        xcg.scene_from_lammps(Lammps(world=False))


def test_computes_are_removed_after_an_error():
    lmp = Lammps()
    with pytest.raises(xcg.SceneError, match="LAMMPS has no fix 'ceiling'"):
        xcg.scene_from_lammps(lmp, walls="ceiling")
    assert lmp.ready == {}


@pytest.mark.parametrize(
    ("lmp", "arguments", "message"),
    [
        ({"running": True}, {}, "cannot define computes within a run"),
        ({"units": "real"}, {}, "LAMMPS has the unit system 'real'"),
        ({"atoms": ["id", "type", "x", "v"]}, {}, "the atoms of LAMMPS have no radius"),
        ({}, {"contacts": {"no": "patom1 patom2"}}, "LAMMPS has no compute 'no'"),
        ({}, {"contacts": {"ids": "patom1"}}, "compute 'ids' has 2 columns, 1 are named"),
        (
            {},
            {"contacts": {"ids": "patom1 patom2"}},
            r"lacks \['dx', 'dy', 'dz', 'fx', 'fy', 'fz'\]",
        ),
    ],
)
def test_simulations_without_needed_data_raise(lmp, arguments, message):
    stub = Lammps(**lmp)
    stub.ready = {} if not arguments else {"ids": ["patom1", "patom2"]}
    with pytest.raises(xcg.SceneError, match=message):
        xcg.scene_from_lammps(stub, **arguments)


# --- LAMMPS itself ---------------------------------------------------------------------------------------

SCRIPT = """
units si
atom_style sphere
boundary p p f
newton off
comm_modify vel yes
region b block 0 0.006 0 0.006 0 0.02 units box
create_box 2 b
region pour block 0 0.006 0 0.006 0.001 0.01 units box
create_atoms 1 random 250 1887 pour overlap 0.001 maxtry 2000
set group all type/fraction 2 0.4 12
set type 1 diameter 0.001 density 2500
set type 2 diameter 0.0008 density 2500
pair_style gran/hooke/history 100 NULL 0.5 NULL 0.5 1
pair_coeff * *
timestep 1e-5
neighbor 0.0003 bin
fix 1 all nve/sphere
fix g all gravity 9.81 vector 0.3 0 -1
fix floor all wall/gran hooke/history 100 NULL 0.5 NULL 0.5 1 zplane 0.0 NULL contacts
run 6000
"""
DUMPS = """
compute ids all property/local patom1 patom2 cutoff radius
compute pl all pair/local dx dy dz fx fy fz p1 p2 p3 cutoff radius
dump dp all custom 1 {folder}/particles.dump id type x y z vx vy vz radius mass f_floor[*]
dump_modify dp units yes time yes format float %.17g
dump dc all local 1 {folder}/contacts.dump c_ids[*] c_pl[*]
dump_modify dc units yes time yes format float %.17g label CONTACTS
run 0
"""
NAMES = {
    "c_ids[1]": "contact_i", "c_ids[2]": "contact_j",
    **{f"c_pl[{k + 1}]": f"contact_branch_{a}" for k, a in enumerate("xyz")},
    **{f"c_pl[{k + 4}]": f"normal_force_{a}" for k, a in enumerate("xyz")},
    **{f"c_pl[{k + 7}]": f"tangential_force_{a}" for k, a in enumerate("xyz")},
}  # fmt: skip


@pytest.fixture(scope="module")
def lammps():
    module = pytest.importorskip("lammps", exc_type=ImportError)
    try:
        lmp = module.lammps(cmdargs=["-log", "none", "-screen", "none"])
    except OSError as error:
        pytest.skip(f"LAMMPS cannot be loaded: {error}")
    lmp.commands_string(SCRIPT)
    yield lmp
    lmp.close()


def test_equal_to_the_scene_from_dumps(lammps, tmp_path):
    live = xcg.scene_from_lammps(lammps, walls="floor")
    again = xcg.scene_from_lammps(lammps, walls="floor")
    assert live.sizes["contact"] > 100
    assert (live.contact_j < -1).sum() > 10
    lammps.commands_string(DUMPS.format(folder=tmp_path))
    own = xcg.scene_from_lammps(lammps, contacts=CONTACTS, walls="floor")
    lammps.commands_string("undump dp\nundump dc\nuncompute ids\nuncompute pl")
    dumps = xcg.open_scene(
        tmp_path / "particles.dump",
        contacts=tmp_path / "contacts.dump",
        names=NAMES,
        walls={"floor": "f_floor[*]"},
    ).load()
    order = np.lexsort((live.contact_j[0], live.contact_i[0]))
    for scene in (dumps, again, own):
        same = np.lexsort((scene.contact_j[0], scene.contact_i[0]))
        for name in set(dumps.data_vars) & set(live.data_vars):
            a = live[name].values[0]
            b = scene[name].values[0]
            if "contact" in live[name].dims:  # of walls, files tell a bound for their number only
                a = a[order]
                b = b[same][-len(order) :]
            np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-15 * np.abs(b).max(), err_msg=name)
        for name in ("periodic", "unit_system", "dimension", "wall_names", "d43"):
            assert (
                live.attrs[name] == pytest.approx(scene.attrs[name])
                if name == "d43"
                else scene.attrs[name]
            )
        assert live.time.item() == pytest.approx(scene.time.item())
    assert set(dumps.data_vars) <= set(live.data_vars)
    fields = ["density", "velocity", "stress", "boundary_force_density"]
    f, g = (
        ds.cg.coarse_grain(fields, axes="z", bounds={"z": (0, 0.01)}, spacing=0.001)
        for ds in (live, dumps)
    )
    for name in fields:
        np.testing.assert_allclose(
            f[name], g[name], rtol=1e-10, atol=1e-12 * float(np.abs(g[name]).max())
        )


def test_the_dumps_of_the_documentation(lammps, tmp_path):
    """The commands that the page for users of LAMMPS tells, and the call that opens what they write."""
    page = (ROOT / "docs" / "lammps.md").read_text()
    commands = re.search(r"```text\n(.*?)```", page, re.DOTALL)[1]
    lammps.commands_string(re.sub(r"(\w+\.\*\.dump)\.gz", rf"{tmp_path}/\1", commands))
    lammps.command("run 1000 post no")
    live = xcg.scene_from_lammps(lammps)
    lammps.commands_string("undump p\nundump c\nuncompute ids\nuncompute pl")
    ds = (
        xcg.open_scene(tmp_path / "particles.*.dump", contacts=tmp_path / "contacts.*.dump")
        .isel(time=-1)
        .load()
    )
    assert ds.step.item() == live.step.item()
    assert ds.time.item() == pytest.approx(live.time.item())
    assert (ds.contact_i > 0).sum() == live.sizes["contact"] > 100
    f, g = (s.cg.coarse_grain("contact_stress", axes="", width=0.001) for s in (live, ds))
    np.testing.assert_allclose(
        f.contact_stress[0], g.contact_stress, rtol=1e-3, atol=1e-4 * np.abs(f.contact_stress).max()
    )


def test_the_binary_dump_of_the_documentation(lammps, tmp_path):
    page = (ROOT / "docs" / "lammps.md").read_text()
    commands = re.findall(r"```text\n(.*?)```", page, re.DOTALL)[1].splitlines()[:2]
    lammps.commands_string("\n".join(commands).replace("particles", f"{tmp_path}/particles"))
    lammps.command("run 0 post no")
    live = xcg.scene_from_lammps(lammps, contacts=False)
    lammps.command("undump b")
    ds = xcg.open_scene(tmp_path / "particles.*.bin").isel(time=-1)
    for name in ("position", "velocity", "diameter", "mass"):
        np.testing.assert_array_equal(ds[name], live[name][0])


def test_fields_are_recorded_while_it_runs(lammps, tmp_path):
    with xcg.record(
        tmp_path / "live.nc", ["density"], axes="z", width=0.001, bounds={"z": (0, 0.01)}
    ) as live:
        for _ in range(3):
            lammps.command("run 100 post no")
            live.append(xcg.scene_from_lammps(lammps, walls="floor"))
        assert live.steps == 3
