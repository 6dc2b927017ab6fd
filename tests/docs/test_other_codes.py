"""The recipes of the page on other codes: what it tells to write is written, and its calls open it."""

import re
from types import SimpleNamespace

import h5py
import numpy as np
import pandas as pd
import pytest

import xcg
from tests import ROOT
from xcg import datasets

PAGE = (ROOT / "docs" / "other_codes.md").read_text()


def blocks(heading, mark="run"):
    """Blocks of code of a section, those with a mark."""
    section = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)[1]
    return re.findall(rf"<!-- {mark} -->\n```python\n(.*?)```", section, re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scene_of_page(code, **names):
    scope = {"xcg": xcg, **names}
    exec(code, scope)
    return scope["ds"].load()


class Sphere:
    radius = 0.5


def test_recipe_for_yade_opens(folder):
    """The script, in a stand-in of YADE with two grains, a wall and a periodic cell."""
    states = [
        SimpleNamespace(pos=(k, 0.0, 0.0), vel=(0.1, 0, 0), angVel=(0, 0, k), mass=2.0)
        for k in range(2)
    ]
    bodies = [SimpleNamespace(id=k, shape=Sphere(), state=s) for k, s in enumerate(states)]
    bodies.append(SimpleNamespace(id=2, shape=object(), state=None))

    def touching(one, two, x):
        geom = SimpleNamespace(contactPoint=(x, 0, 0), normal=(1, 0, 0), penetrationDepth=0.0)
        phys = SimpleNamespace(normalForce=(3, 0, 0), shearForce=(0, 4, 0))
        return SimpleNamespace(isReal=True, id1=one, id2=two, geom=geom, phys=phys)

    cell = SimpleNamespace(hSize=np.diag([10.0, 11.0, 12.0]))
    omega = SimpleNamespace(
        periodic=True,
        cell=cell,
        time=0.5,
        iter=20,
        bodies=bodies,
        interactions=[touching(0, 1, 0.5), touching(2, 0, -0.5)],
    )
    (script,) = blocks("YADE", "a script of YADE")
    scope = {"O": omega, "Sphere": Sphere}
    exec(script, scope)
    scope["save"](str(folder))
    ds = scene_of_page(blocks("YADE")[0])
    assert (ds.time.item(), ds.step.item()) == (0.5, 20)
    np.testing.assert_array_equal(ds.box[0, :, 1], [10, 11, 12])
    np.testing.assert_array_equal(ds.contact_i[0], [1, 0])
    np.testing.assert_array_equal(ds.contact_force[0], [[3, 4, 0]] * 2)
    np.testing.assert_array_equal(ds.mass[0], [2, 2])
    np.testing.assert_array_equal(ds.angular_velocity[0, :, 2], [0, 1])
    assert np.isfinite(ds.cg.coarse_grain("stress", axes="").stress).all()


def test_recipe_for_tables_opens(folder):
    scene = datasets.random_scene(20, seed=1)
    x = scene.position.values[0].T
    v = scene.velocity.values[0].T
    grains = dict(zip("xyz", x, strict=True)) | dict(zip(("vx", "vy", "vz"), v, strict=True))
    grains |= {
        "id": scene.particle_id.values[0],
        "radius": scene.diameter.values[0] / 2,
        "charge": x[0],
    }
    force = dict(zip(("fx", "fy", "fz"), scene.contact_force.values[0].T, strict=True))
    point = {f"contact_point_{a}": scene.contact_point.values[0, :, k] for k, a in enumerate("xyz")}
    contacts = {
        "id1": scene.contact_i.values[0],
        "id2": scene.contact_j.values[0],
        **force,
        **point,
    }
    for name, table in (("grains", grains), ("contacts", contacts)):
        both = pd.concat([pd.DataFrame(table).assign(time=time) for time in (0.0, 0.5)])
        both.to_csv(f"{name}.csv", index=False)
    first, second = blocks("Tables")[0].splitlines()
    ds = scene_of_page(first)
    np.testing.assert_array_equal(ds.contact_force[1], scene.contact_force[0])
    np.testing.assert_array_equal(scene_of_page(second).charge[0], x[0])
    later = scene_of_page(blocks("Tables")[1])
    assert later.time.values.tolist() == [0.5]
    for name in later.data_vars:
        np.testing.assert_array_equal(later[name][0], ds[name][1])


def test_recipe_for_hdf5_opens(folder):
    names = {"Particles/Position": np.array([[0.0, 0, 0], [0.9, 0, 0]]), "Particles/Velocity": np.ones((2, 3)),
             "Particles/Ids": [3, 4], "Particles/Radius": [0.5, 0.5], "Contacts/Id1": [3], "Contacts/Id2": [4],
             "Contacts/NormalForce": [[-5.0, 0, 0]], "Contacts/TangentialForce": [[0, 1.0, 0]],
             "Contacts/Position": [[0.45, 0, 0]]}  # fmt: skip
    with h5py.File("run.h5", "w") as file:
        for time in (0.5, 1.25):
            for name, values in names.items():
                file[f"Step{time}/{name}"] = values
    ds = scene_of_page(blocks("HDF5")[0])
    np.testing.assert_array_equal(ds.time, [0.5, 1.25])
    np.testing.assert_array_equal(ds.contact_force[1, 0], [-5, 1, 0])
    np.testing.assert_array_equal(ds.diameter[0], [1, 1])
