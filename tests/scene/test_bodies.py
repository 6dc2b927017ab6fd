"""Bodies glued from spheres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ROOT, dumps
from xcg.scene.bodies import walls_of


def dimers(**options):
    """Two bodies of two spheres, one across the periodic edge, and a sphere of its own."""
    position = np.array([[0.1, 5, 5], [9.9, 5, 5], [1.0, 5, 5], [1.4, 5, 5], [5.0, 5, 5]])
    given = {
        "particle_id": [10, 11, 12, 13, 14], "body_id": [7, 7, 3, 3, -1], "diameter": np.full(5, 0.6),
        "mass": np.array([1.0, 3.0, 2.0, 2.0, 5.0]),
        "velocity": np.array([[1.0, 0, 0], [0, 0, 0], [0, 2.0, 0], [0, 4.0, 0], [0, 0, 1.0]]),
        "contact_i": [10, 12, 10, 14], "contact_j": [11, 13, 12, -1],
        "contact_force": np.array([[9.0, 9, 9], [9.0, 9, 9], [-2.0, 1.0, 0], [0, 0, 4.0]]),
        "contact_point": np.array([[0.0, 5, 5], [1.2, 5, 5], [0.5, 5, 5], [5.0, 5, 4.7]]),
        "box": [[0, 10.0]] * 3, "periodic": "x",
    }  # fmt: skip
    return xcg.scene_from_arrays(position, **(given | options))


@pytest.mark.parametrize("lazy", [False, True])
def test_bodies_have_mass_centre_velocity_and_contacts(lazy):
    ds = dimers()
    b = (ds.chunk(time=1, particle=2) if lazy else ds).cg.group_bodies("body_id")
    assert (b.mass.chunks is not None) == lazy
    b = b.compute().isel(time=0)
    assert b.particle_id.values.tolist() == [3, 7, 22, -1, -1]
    assert b.mass.values[:3].tolist() == [4.0, 4.0, 5.0]
    x = b.position.values[:3]
    assert (x[1, 0] - 9.95) % 10 == pytest.approx(0, abs=1e-12)  # (1 x 10.1 + 3 x 9.9) / 4, around the edge
    np.testing.assert_allclose(x[[0, 2]], [[1.2, 5, 5], [5, 5, 5]])
    np.testing.assert_allclose(b.velocity.values[:3], [[0, 3, 0], [0.25, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(b.volume.values[:3], np.pi / 6 * 0.6**3 * np.array([2, 2, 1]))
    np.testing.assert_allclose(b.diameter.values[:3] ** 3, 0.6**3 * np.array([2, 2, 1]))
    assert b.contact_i.values.tolist() == [7, 22, -1, -1]
    assert b.contact_j.values.tolist() == [3, -1, -1, -1]
    np.testing.assert_allclose(b.contact_force.values[:2], [[-2, 1, 0], [0, 0, 4]])


def test_sums_of_bodies_equal_those_of_their_spheres():
    ds = dimers()
    bodies = ds.cg.group_bodies()
    options = {"axes": "x", "width": 0.5, "spacing": 0.05, "extent": {"y": 10, "z": 10}, "bounds": {"x": (0, 9.95)}}
    both = [s.cg.coarse_grain(["density", "momentum_density", "contact_stress", "wall_traction"], **options)
            for s in (ds, bodies)]  # fmt: skip
    for name in ("density", "momentum_density", "wall_traction"):
        totals = [f[name].sum("x").values for f in both]
        np.testing.assert_allclose(totals[1], totals[0], rtol=1e-6, atol=1e-12)
    # virial of bodies: force between them times the vector between their centres, and the wall's
    total = both[1].contact_stress.isel(time=0).sum("x").values * 0.05 * 100
    expected = np.outer([-2.0, 1, 0], [-0.05 - 1.2, 0, 0]) + np.outer([0, 0, 4.0], [0, 0, 0.3])
    np.testing.assert_allclose(total, expected, atol=1e-6)
    named = ds.cg.coarse_grain("density", by_body="body_id", **options)
    np.testing.assert_array_equal(named.density, both[1].density)
    assert "group_bodies('body_id')" in named.attrs["history"]
    assert bodies.attrs["dmax"] == pytest.approx(0.6 * np.cbrt(2))


def test_bodies_need_ids_and_masses():
    ds = dimers()
    with pytest.raises(xcg.SceneError, match="expected an integer variable"):
        ds.cg.group_bodies("mass")
    with pytest.raises(xcg.SceneError, match="clump"):
        ds.cg.group_bodies("clump")
    spheres = ds.assign(body_id=xr.full_like(ds.body_id, -1)).cg.group_bodies()
    np.testing.assert_array_equal(spheres.position, ds.position)


def test_bodies_keep_their_species_and_frozen_state():
    given = {"species": [1, 1, 2, 2, 3], "frozen": [1, 1, 0, 0, 0]}
    b = dimers(**given).cg.group_bodies().isel(time=0)
    assert b.particle_id.values[:3].tolist() == [3, 7, 22]
    assert b.species.values[:3].tolist() == [2, 1, 3]
    assert b.frozen.values[:3].tolist() == [0, 1, 0]


@pytest.mark.parametrize("name", ["species", "frozen"])
def test_spheres_of_a_body_must_agree(name):
    ds = dimers(**{name: [1, 1, 0, 1, 0]})
    message = (
        rf"^group_bodies, frame 0 of its chunk: spheres 12 and 13 are of one body \(3\) and differ in {name} \(0, 1\)"
    )
    with pytest.raises(xcg.SceneError, match=message):
        ds.cg.group_bodies()


def test_sizes_of_bodies_of_a_lazy_scene_are_measured_or_given():
    lazy = dimers(box=[[0, 10.0], [-np.inf, np.inf], [-np.inf, np.inf]]).chunk(time=1)
    options = {"axes": "y", "extent": {"z": 9.0}, "by_body": "body_id"}
    for given, lacking in (({}, "needs the attribute 'd43'"), ({"width": 1.0}, "axis 'y' has no bounds")):
        with pytest.raises(
            ValueError, match=rf"{lacking}.*group_bodies\(\.\.\.\)\.cg\.measure\(\) in place of by_body="
        ):
            lazy.cg.coarse_grain("density", **given, **options)
    whole = lazy.compute().cg.coarse_grain("density", **options)
    measured = lazy.cg.group_bodies().cg.measure()
    del options["by_body"]
    xr.testing.assert_equal(measured.cg.coarse_grain("density", **options).compute(), whole)


def test_molecule_0_of_lammps_is_none(tmp_path):
    """Spheres of no molecule are bodies of their own, not one large one."""
    path = tmp_path / "p.dump"
    rows = ["1 0 1 1 1 1 1", "2 5 3 3 3 1 1", "3 5 4 3 3 1 1", "4 0 8 8 8 1 1"]
    box = "ITEM: BOX BOUNDS ff ff ff\n0 10\n0 10\n0 10\n"
    head = f"ITEM: UNITS\nsi\nITEM: TIME\n0\nITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n4\n{box}"
    path.write_text(head + "ITEM: ATOMS id mol x y z radius mass\n" + "\n".join(rows) + "\n")
    ds = xcg.open_scene(path)
    assert ds.body_id.values[0].tolist() == [-1, 5, 5, -1]
    assert ds.cg.group_bodies().compute().mass.values[0].tolist()[:3] == [2.0, 1.0, 1.0]


# --- walls that touch ---


DATA = ROOT / "examples" / "data" / "lammps_silo"
WALLS = {"side": "f_side[*]", "floor": "f_floor[*]"}
# what `compute reduce` says of the two fixes in the last line of the log: contacts, and the force on the grains (N)
SUMS = np.loadtxt(DATA / "sums.txt").reshape(2, 4)
GRAVITY = 9.81
MESH = 1e-5 * 30  # what sums over nodes leave of the magnitudes of all forces (N)


@pytest.fixture(scope="module")
def silo() -> xr.Dataset:
    """Grains at rest in a cylinder, with contacts between them, with its side and with its floor."""
    return xcg.open_scene(
        DATA / "particles.dump.gz", contacts=DATA / "contacts.dump.gz", walls=WALLS, gravity=(0, 0, -GRAVITY)
    ).compute()


def integral(field: xr.DataArray) -> np.ndarray:
    """Sum over the mesh."""
    axes = [a for a in "xyz" if a in field.dims]
    return (field.sum(axes) * np.prod([float(field[a][1] - field[a][0]) for a in axes])).to_numpy()[0]


def test_walls_of_lammps_are_partners_with_names(silo):
    assert walls_of(silo) == {"side": -2, "floor": -3}
    for number, (count, *force) in zip((-2, -3), SUMS, strict=True):
        here = (silo.contact_j == number) & (silo.contact_i >= 0)
        assert int(here.sum()) == count
        np.testing.assert_allclose(silo.contact_force.where(here).sum("contact")[0], force, atol=1e-7)
    point, side = silo.contact_point[0], (silo.contact_j == -2)[0].to_numpy()
    np.testing.assert_allclose(np.hypot(*point[side, :2].T), 0.025, rtol=1e-6)


def test_forces_of_grains_at_rest_are_balanced(silo):
    """Pairs, walls and weight add up to nothing, so that the force is that on the grain, whatever a manual says."""
    particles, rows = silo.isel(time=0), silo.contact_i[0] >= 0
    force = np.zeros((particles.sizes["particle"], 3))
    i, j, f = (particles[name][rows].to_numpy() for name in ("contact_i", "contact_j", "contact_force"))
    np.add.at(force, i - 1, f)
    np.add.at(force, j[j > 0] - 1, -f[j > 0])
    force[:, 2] -= GRAVITY * particles.mass
    supported = np.abs(force).max(axis=1) < 0.5 * GRAVITY * float(particles.mass.min())
    assert supported.mean() > 0.95  # the others rattle
    assert np.abs(force[supported]).max() < 1e-2 * GRAVITY * float(particles.mass.mean())


def test_wall_traction_adds_up_to_the_sums_of_lammps(silo):
    total = integral(silo.cg.coarse_grain("wall_traction", spacing=0.002).wall_traction)
    np.testing.assert_allclose(total, SUMS[:, 1:].sum(axis=0), atol=MESH)
    line = {"fields": "wall_traction", "axes": "z", "extent": {"x": 1.0, "y": 1.0}, "spacing": 5e-4}
    line["bounds"] = {"z": (-0.01, 0.24)}  # the default mesh ends a support below the lowest centre, not wall
    parts = [silo.cg.select_walls(wall).cg.coarse_grain(**line).wall_traction for wall in ("side", -3)]
    for part, (_, *force) in zip(parts, SUMS, strict=True):
        np.testing.assert_allclose(integral(part), force, atol=MESH)
    np.testing.assert_allclose(parts[0] + parts[1], silo.cg.coarse_grain(**line).wall_traction, atol=1e-9)


def test_walls_stay_lazy_and_keep_their_names(tmp_path):
    lazy = xcg.open_scene(DATA / "particles.dump.gz", walls=WALLS)
    assert lazy.contact_i.chunks is not None
    floor = lazy.cg.select_walls("floor")
    assert floor.contact_i.chunks is not None
    assert int((floor.contact_i >= 0).sum()) == SUMS[1, 0]
    floor.cg.save(tmp_path / "scene.nc")
    with xr.open_dataset(tmp_path / "scene.nc") as again:
        assert walls_of(again) == {"side": -2, "floor": -3}
        assert int((again.cg.select_walls(["floor"]).contact_i >= 0).sum()) == SUMS[1, 0]


ARRAY = " ".join(f"f_w[{k}]" for k in range(1, 9))
TOUCHING, APART = " 1 0 0 9 3 3 0 0.5", " 0 0 0 0 0 0 0 0"


def particles_with_walls(folder: Path, columns: str = ARRAY) -> Path:
    rows = [row + end for row, end in zip(dumps.ROWS, (TOUCHING, APART, APART), strict=True)]
    return dumps.write(folder / "p.dump", dumps.dump_text(rows, f"{dumps.ATOMS} {columns}"))


def test_grains_with_zero_force_do_not_touch(tmp_path):
    six = [f"f_w[{k}]" for k in range(2, 8)]
    for walls in ({"floor": "f_w[*]"}, {"floor": six}):  # the last leaves two columns, which are told
        ds = xcg.open_scene(particles_with_walls(tmp_path), walls=walls).compute()
        rows = ds.contact_i[0] >= 0
        np.testing.assert_array_equal(ds.contact_i[0][rows], [3])
        np.testing.assert_array_equal(ds.contact_j[0][rows], [-2])
        np.testing.assert_array_equal(ds.contact_force[0][rows], [[0, 0, 9]])
        np.testing.assert_array_equal(ds.contact_point[0][rows], [[3, 3, 0]])
    assert "f_w[2]" not in ds.attrs["ignored_columns"]


def test_walls_and_pairs_are_read_together(tmp_path):
    pairs = dumps.write(tmp_path / "c.dump", dumps.pairs_text())
    ds = xcg.open_scene(particles_with_walls(tmp_path), contacts=pairs, walls={"floor": "f_w[*]"}).compute()
    assert sorted(ds.contact_j[0][ds.contact_i[0] >= 0].to_numpy()) == [-2, 2]


def test_unused_columns_of_walls_warn(tmp_path):
    path = particles_with_walls(tmp_path)
    with pytest.warns(xcg.SceneWarning, match=r"f_w\[1\] to f_w\[8\] look like .* walls=\{'side': 'f_w\[\*\]'\}"):
        xcg.open_scene(path)


@pytest.mark.parametrize(
    ("walls", "message"),
    [
        ({"floor": "f_v[*]"}, r"p\.dump .*no f_v\[2\] f_v\[3\]"),
        ({"floor": "f_w[1]"}, r"names of six columns"),
        ({"floor": ["f_w[2]"]}, r"names of six columns"),
        ({"the floor": "f_w[*]"}, "'the floor' is no name"),
    ],
)
def test_wrong_columns_raise(tmp_path, walls, message):
    with pytest.raises(xcg.SceneError, match=message):
        xcg.open_scene(particles_with_walls(tmp_path), walls=walls, names={f"f_w[{k}]": None for k in range(1, 9)})


@pytest.mark.parametrize(
    ("walls", "message"),
    [
        ("flor", "did you mean 'floor'"),
        (3, "negative numbers"),
        ([], "none is given"),
        (["side", 1.5], "1.5 is no wall"),
    ],
)
def test_unknown_walls_raise(silo, walls, message):
    with pytest.raises(ValueError, match=message):
        silo.cg.select_walls(walls)


def test_walls_without_names_have_numbers():
    ds = xcg.datasets.random_scene(60, seed=2)
    assert int((xcg.select_walls(ds, -1).contact_i >= 0).sum()) == int(((ds.contact_j < 0) & (ds.contact_i >= 0)).sum())
    with pytest.raises(ValueError, match="no wall of this scene has a name"):
        xcg.select_walls(ds, "floor")
