"""Contacts of one step: normals, the order of the two particles, and walls by number and name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xcg
from tests import ROOT, dumps
from xcg.scene.contacts import Contacts, walls_of
from xcg.scene.lattice import Lattice


def off_line(seed, **options):
    """A random scene with walls whose contact points lie off the line of centres, as those of other shapes do."""
    ds = xcg.datasets.random_scene(150, seed=seed, polydispersity=3.0, **options)
    rng = np.random.default_rng(seed)
    aside = (
        0.2
        * rng.normal(size=ds.contact_point.shape)
        * [axis in ds.attrs["plane"] for axis in "xyz"]
    )
    return ds.assign(contact_point=ds.contact_point + aside)


def turned_about(ds, seed):
    """The same contacts, some of them as (j, i, -f); walls stay the second."""
    some = (np.random.default_rng(seed).random(ds.contact_i.shape) < 0.5) & (ds.contact_j >= 0)
    assert 0.2 < float(some.mean()) < 0.8
    return ds.assign(
        contact_i=ds.contact_i.where(~some, ds.contact_j),
        contact_j=ds.contact_j.where(~some, ds.contact_i),
        contact_force=ds.contact_force.where(~some, -ds.contact_force),
    )


@pytest.mark.parametrize(
    "options", [{"periodic": "xy"}, {"periodic": "x", "dimension": 2}], ids=["3D", "2D"]
)
def test_the_order_of_the_two_particles_does_not_matter(options):
    ds = off_line(3, **options)
    other = turned_about(ds, 4)
    everything = (
        lambda s: s.cg.coarse_grain(
            ["fabric", "contact_stress", "coordination_number"], spacing=0.5
        ),
        lambda s: s.cg.microstructure(bounds={"left": {"x": (0.0, 2.0)}}),
        lambda s: s.cg.particle_stress()[["stress"]],
        lambda s: s.cg.force_chains(60.0)[["chain_id", "links", "chain_particles", "chain_stress"]],
    )
    for compute in everything:
        one = compute(ds)
        two = compute(other)
        for name in one.data_vars:
            size = float(np.abs(one[name]).max())
            np.testing.assert_allclose(
                two[name], one[name], rtol=1e-9, atol=1e-12 * size, err_msg=name
            )


@pytest.mark.parametrize("periodic", ["", "xyz"])
def test_normals_are_along_the_centres_and_at_walls_towards_the_contact_point(periodic):
    ds = off_line(5, periodic=periodic).isel(time=0)
    x = ds.position.values
    c = ds.contact_point.values
    period = 5.0 if periodic else np.inf
    normal = []
    for i, j, point in zip(ds.contact_i.values, ds.contact_j.values, c, strict=True):
        towards = x[i] - (x[j] if j >= 0 else point)
        towards = towards - (period * np.rint(towards / period) if periodic else 0.0)
        normal.append(towards / np.linalg.norm(towards))
    frame = {
        name: ds[name].values
        for name in ("particle_id", "position", "contact_i", "contact_j", "contact_point")
    }
    contacts = Contacts.of(frame, Lattice(np.full(3, period)))
    np.testing.assert_allclose(contacts.normal, normal, rtol=0, atol=1e-12)
    fabric = np.zeros((150, 3, 3))
    for i, j, n in zip(ds.contact_i.values, ds.contact_j.values, normal, strict=True):
        for row in (i, j):
            if row >= 0:
                fabric[row] += np.outer(n, n)
    upper = fabric[:, *np.triu_indices(3)]
    np.testing.assert_allclose(contacts.normals, upper, rtol=1e-12, atol=1e-12)


def test_walls_may_come_first_or_second_and_particles_may_be_the_first():
    frame = {
        "particle_id": np.array([4, 7]), "position": np.array([[0.0, 0, 0], [5, 0, 0]]),
        "contact_i": np.array([4, -2, -2, 7]), "contact_j": np.array([-2, 4, 7, -2]),
        "contact_force": np.arange(12.0).reshape(4, 3), "contact_point": np.arange(12.0).reshape(4, 3) / 10,
    }  # fmt: skip
    row, point, force = Contacts.of(frame, Lattice(np.full(3, np.inf))).at_walls
    assert row.tolist() == [0, 1, 0, 1]
    np.testing.assert_array_equal(point, frame["contact_point"][[0, 3, 1, 2]])
    sign = np.array([[1], [1], [-1], [-1]])  # the force given is that on the first of the two
    np.testing.assert_array_equal(force, sign * frame["contact_force"][[0, 3, 1, 2]])


# --- walls -----------------------------------------------------------------------------------------------


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
        DATA / "particles.dump.gz",
        contacts=DATA / "contacts.dump.gz",
        walls=WALLS,
        gravity=(0, 0, -GRAVITY),
    ).compute()


def integral(field: xr.DataArray) -> np.ndarray:
    """Sum over the mesh."""
    axes = [a for a in "xyz" if a in field.dims]
    return (field.sum(axes) * np.prod([float(field[a][1] - field[a][0]) for a in axes])).to_numpy()[
        0
    ]


def test_walls_of_lammps_are_partners_with_names(silo):
    assert walls_of(silo) == {"side": -2, "floor": -3}
    for number, (count, *force) in zip((-2, -3), SUMS, strict=True):
        here = (silo.contact_j == number) & (silo.contact_i >= 0)
        assert int(here.sum()) == count
        np.testing.assert_allclose(
            silo.contact_force.where(here).sum("contact")[0], force, atol=1e-7
        )
    point = silo.contact_point[0]
    side = (silo.contact_j == -2)[0].to_numpy()
    np.testing.assert_allclose(np.hypot(*point[side, :2].T), 0.025, rtol=1e-6)


def test_forces_of_grains_at_rest_are_balanced(silo):
    """Pairs, walls and weight add up to nothing, so that the force is that on the grain, whatever a manual says."""
    particles = silo.isel(time=0)
    rows = silo.contact_i[0] >= 0
    force = np.zeros((particles.sizes["particle"], 3))
    i, j, f = (
        particles[name][rows].to_numpy() for name in ("contact_i", "contact_j", "contact_force")
    )
    np.add.at(force, i - 1, f)
    np.add.at(force, j[j > 0] - 1, -f[j > 0])
    force[:, 2] -= GRAVITY * particles.mass
    supported = np.abs(force).max(axis=1) < 0.5 * GRAVITY * float(particles.mass.min())
    assert supported.mean() > 0.95  # the others rattle
    assert np.abs(force[supported]).max() < 1e-2 * GRAVITY * float(particles.mass.mean())


def test_boundary_force_density_adds_up_to_the_sums_of_lammps(silo):
    total = integral(
        silo.cg.coarse_grain("boundary_force_density", spacing=0.002).boundary_force_density
    )
    np.testing.assert_allclose(total, SUMS[:, 1:].sum(axis=0), atol=MESH)
    line = {
        "fields": "boundary_force_density",
        "axes": "z",
        "extent": {"x": 1.0, "y": 1.0},
        "spacing": 5e-4,
    }
    line["bounds"] = {
        "z": (-0.01, 0.24)
    }  # the default mesh ends a support below the lowest centre, not wall
    parts = [
        silo.cg.select_walls(wall).cg.coarse_grain(**line).boundary_force_density
        for wall in ("side", -3)
    ]
    for part, (_, *force) in zip(parts, SUMS, strict=True):
        np.testing.assert_allclose(integral(part), force, atol=MESH)
    np.testing.assert_allclose(
        parts[0] + parts[1], silo.cg.coarse_grain(**line).boundary_force_density, atol=1e-9
    )


def test_walls_stay_lazy_and_keep_their_names(tmp_path):
    lazy = xcg.open_scene(DATA / "particles.dump.gz", walls=WALLS, chunks=1)
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
    for walls in (
        {"floor": "f_w[*]"},
        {"floor": six},
    ):  # the last leaves two columns, which are told
        ds = xcg.open_scene(particles_with_walls(tmp_path), walls=walls).compute()
        rows = ds.contact_i[0] >= 0
        np.testing.assert_array_equal(ds.contact_i[0][rows], [3])
        np.testing.assert_array_equal(ds.contact_j[0][rows], [-2])
        np.testing.assert_array_equal(ds.contact_force[0][rows], [[0, 0, 9]])
        np.testing.assert_array_equal(ds.contact_point[0][rows], [[3, 3, 0]])
    assert "f_w[2]" not in ds.attrs["not_read"]


def test_walls_and_pairs_are_read_together(tmp_path):
    pairs = dumps.write(tmp_path / "c.dump", dumps.pairs_text())
    ds = xcg.open_scene(
        particles_with_walls(tmp_path), contacts=pairs, walls={"floor": "f_w[*]"}
    ).compute()
    assert sorted(ds.contact_j[0][ds.contact_i[0] >= 0].to_numpy()) == [-2, 2]


def test_unused_columns_of_walls_warn(tmp_path):
    path = particles_with_walls(tmp_path)
    with pytest.warns(
        xcg.SceneWarning, match=r"f_w\[1\] to f_w\[8\] look like .* walls=\{'side': 'f_w\[\*\]'\}"
    ):
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
        xcg.open_scene(
            particles_with_walls(tmp_path),
            walls=walls,
            names={f"f_w[{k}]": None for k in range(1, 9)},
        )


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
    assert int((xcg.select_walls(ds, -1).contact_i >= 0).sum()) == int(
        ((ds.contact_j < 0) & (ds.contact_i >= 0)).sum()
    )
    with pytest.raises(ValueError, match="no wall of this scene has a name"):
        xcg.select_walls(ds, "floor")
