"""Contacts found from positions: those that LAMMPS lists, laziness, forces, what is left out."""

import gzip

import dask
import numpy as np
import pytest
import xarray as xr

import xcg
from tests import real_data
from tests.scenes import random_steps

FOUND = ("contact_i", "contact_j", "contact_point", "contact_normal", "overlap")


def bare(ds):
    """A scene without its contacts."""
    return ds.drop_dims("contact", errors="ignore")


# --- what LAMMPS lists -----------------------------------------------------------------------------------


def listed(path):
    """Distances and normal forces by pair of ids, straight from a local dump."""
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt") as file:
        lines = file.read().splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("ITEM: CONTACTS "))
    columns = lines[head].split()[2:]
    rows = np.array([line.split() for line in lines[head + 1 :]], float)
    ids = np.sort(rows[:, [columns.index("id1"), columns.index("id2")]].astype(int), axis=1)
    force = np.linalg.norm(rows[:, [columns.index(f"fn{a}") for a in "xyz"]], axis=1)
    return dict(
        zip(
            map(tuple, ids.tolist()),
            zip(rows[:, columns.index("dist")], force, strict=True),
            strict=True,
        )
    )


def found_in(ds):
    """Overlaps and normal forces by pair of ids of the first step."""
    ids = np.sort(np.column_stack([ds.contact_i[0], ds.contact_j[0]]), axis=1)
    force = np.linalg.norm(ds.contact_force[0], axis=1)
    overlap = ds.overlap.values[0]
    return dict(zip(map(tuple, ids.tolist()), zip(overlap, force, strict=True), strict=True))


FRAMES = [
    ("lammps_chute", "00030000.dump.gz", 2, {"k_n": 2e3}),
    *[("lammps_biaxial2d", f"{k:08d}.dump.gz", 2, {"k_n": 1e5}) for k in (50_000, 100_000)],
]


@pytest.mark.parametrize("levels", [None, 1])
@pytest.mark.parametrize(
    ("name", "file", "frozen", "stiffness"), FRAMES, ids=[f"{n}-{f[:8]}" for n, f, *_ in FRAMES]
)
def test_contacts_are_those_that_lammps_lists(name, file, frozen, stiffness, levels):
    folder = real_data(name)
    ds = xcg.open_scene(folder / f"particles.{file}", frozen=frozen).load()
    ours = found_in(ds.cg.find_contacts(levels=levels, **stiffness))
    theirs = listed(folder / f"contacts.{file}")
    both = sorted(theirs)
    assert set(ours) == set(theirs)
    # damping is in LAMMPS' normal force as well
    estimated, true = np.array([(ours[pair][1], theirs[pair][1]) for pair in both]).T
    assert np.median(np.abs(estimated - true)) < 0.1 * np.median(true)


# --- forces and geometry ---------------------------------------------------------------------------------


def test_contact_of_two_spheres_has_their_geometry_and_force():
    position = [[0.0, 0, 0], [0.0, 1.4, 0]]
    diameter = [2.0, 1.0]
    ds = xcg.scene_from_arrays(position, diameter=diameter, density=1.0)
    c = ds.cg.find_contacts(k_n=10.0)
    assert (c.contact_i.item(), c.contact_j.item()) == (0, 1)
    assert c.overlap.item() == pytest.approx(0.1)
    np.testing.assert_allclose(c.contact_normal.values[0, 0], [0, -1, 0])
    np.testing.assert_allclose(c.contact_point.values[0, 0], [0, 0.95, 0])
    np.testing.assert_allclose(c.contact_force.values[0, 0], [0, -1.0, 0])
    assert "linear spring, k_n = 10" in c.contact_force.attrs["estimated"]
    assert c.contact_force.attrs["units"] == "N"
    # E* = 3 / (2 (1 - 1/4)) = 2, R* = 1/3
    hertz = ds.cg.find_contacts(E=3.0, nu=0.5)
    expected = 4 / 3 * 2 * np.sqrt(1 / 3) * 0.1**1.5
    np.testing.assert_allclose(hertz.contact_force.values[0, 0], [0, -expected, 0])
    assert "contact_force" not in ds.cg.find_contacts()
    assert "find_contacts(skin=0.0, k_n=10.0)" in c.attrs["history"]


def test_a_gap_within_the_skin_carries_no_force():
    ds = xcg.scene_from_arrays([[0.0, 0, 0], [1.05, 0, 0]], diameter=[1.0, 1.0], density=1.0)
    c = ds.cg.find_contacts(skin=0.1, E=1e9, nu=0.3)
    assert c.overlap.item() == pytest.approx(-0.05)
    assert (c.contact_force.values == 0).all()


def test_stress_of_contacts_found_from_positions():
    """A compressed cubic lattice: 3 bonds a particle, sigma = k_n overlap / spacing^2."""
    ds = xcg.datasets.simple_cubic(5, density=1000.0)
    squeezed = (
        bare(ds)
        .assign(position=ds.position * 0.98, box=ds.box * 0.98)
        .assign_attrs(box_upper=0.98 * 5 + np.zeros(3))
    )
    f = squeezed.cg.find_contacts(k_n=1e4).cg.coarse_grain(
        "contact_stress", axes="", at={}, width=1.0
    )
    np.testing.assert_allclose(
        f.contact_stress.values[0], 1e4 * 0.02 / 0.98 * np.eye(3) / 0.98, rtol=1e-9, atol=1e-9
    )


def test_frozen_pairs_and_glued_pairs_are_left_out():
    position = [[0.0, 0, 0], [0.9, 0, 0], [1.8, 0, 0], [2.7, 0, 0]]
    ds = xcg.scene_from_arrays(
        position, diameter=np.ones(4), density=1.0, frozen=[1, 1, 0, 0], body_id=[0, 1, 2, 2]
    )
    c = ds.cg.find_contacts()
    assert c.contact_i.values.tolist() == [[1]]
    assert c.contact_j.values.tolist() == [[2]]


def test_coincident_centres_have_no_normal():
    ds = xcg.scene_from_arrays(np.zeros((2, 3)), diameter=np.ones(2), density=1.0)
    with pytest.warns(xcg.SceneWarning, match="1 contacts join particles at the same position"):
        c = ds.cg.find_contacts(k_n=1.0)
    assert c.overlap.item() == 1.0
    assert (c.contact_normal.values == 0).all()
    assert (c.contact_point.values == 0).all()


def test_contacts_of_the_scene_are_replaced():
    ds = xcg.datasets.face_centred_cubic(3)
    c = ds.cg.find_contacts(skin=1e-9)
    assert c.sizes["contact"] == 6 * c.sizes["particle"]
    assert "contact_force" not in c
    assert set(FOUND) <= set(c.data_vars)


# --- lazy ------------------------------------------------------------------------------------------------


def test_nothing_computes_while_the_graph_is_built():
    ds = random_steps(3).chunk(time=1)

    def refuse(dsk, keys, **kwargs):
        pytest.fail("computed while the graph was built")

    with dask.config.set(scheduler=refuse):
        c = ds.cg.find_contacts(k_n=1.0)
        f = c.cg.coarse_grain("contact_stress", width=0.8)
    assert c.sizes["contact"] == 7 * ds.sizes["particle"]
    assert isinstance(f.contact_stress.data, dask.array.Array)


@pytest.mark.parametrize("scheduler", ["synchronous", "threads", "processes"])
def test_lazy_equals_eager_under_every_scheduler(scheduler, computing):
    ds = random_steps(5)
    eager = ds.cg.find_contacts(k_n=1.0)
    for chunk in (1, 2):
        lazy = ds.chunk(time=chunk).cg.find_contacts(k_n=1.0, max_contacts=eager.sizes["contact"])
        assert lazy.overlap.chunks[0] == ds.chunk(time=chunk).position.chunks[0]
        computed = lazy.compute(**computing(scheduler))
        xr.testing.assert_equal(computed, eager)


def test_padding_of_the_bound_changes_nothing():
    ds = random_steps(2)
    eager = ds.cg.find_contacts(k_n=1.0)
    lazy = ds.chunk(time=1).cg.find_contacts(k_n=1.0).compute()
    rest = lazy.isel(contact=slice(eager.sizes["contact"], None))
    xr.testing.assert_equal(lazy.isel(contact=slice(0, eager.sizes["contact"])), eager)
    assert (rest.contact_i == -1).all()
    assert rest.overlap.isnull().all()


def test_too_many_contacts_raise_and_suggest_a_bound():
    crowd = xcg.scene_from_arrays(
        np.random.default_rng(1).uniform(0, 0.1, (20, 3)), diameter=np.ones(20), density=1.0
    )
    assert crowd.cg.find_contacts().sizes["contact"] == 190
    with pytest.raises(
        xcg.SceneError, match=r"step 0: 190 contacts .* than the 140 rows.*max_contacts=190"
    ):
        crowd.chunk(time=1).cg.find_contacts().compute()
    assert crowd.chunk(time=1).cg.find_contacts(max_contacts=190).compute().sizes["contact"] == 190
    with pytest.raises(xcg.SceneError, match="max_contacts=190"):
        crowd.cg.find_contacts(max_contacts=10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"skin": float("nan")}, "skin=nan"),
        ({"levels": -1}, "levels=-1"),
        ({"max_contacts": 1.5}, "max_contacts=1.5"),
        ({"k_n": -1.0}, "k_n=-1.0"),
        ({"E": 1e9}, "nu=None"),
        ({"k_n": 1.0, "E": 1e9, "nu": 0.2}, "or none of them"),
        ({"E": 1e9, "nu": 0.7}, "nu=0.7"),
    ],
)
def test_wrong_arguments_raise(options, message):
    with pytest.raises(ValueError, match=message):
        xcg.datasets.random_scene(5).cg.find_contacts(**options)


def test_scenes_without_diameters_or_particles():
    ds = xcg.datasets.random_scene(5)
    with pytest.raises(xcg.SceneError, match="diameter"):
        ds.drop_vars("diameter").cg.find_contacts()
    assert xcg.datasets.random_scene(0).cg.find_contacts().sizes["contact"] == 0


def test_results_say_that_forces_are_estimated():
    found = xcg.datasets.simple_cubic(3).assign_attrs(sides="first").cg.find_contacts(k_n=1.0)
    assert "sides" not in found.attrs
    f = found.cg.coarse_grain("contact_stress", axes="z")
    assert f.attrs["estimated_forces"].startswith("normal force from the overlap of spheres")
    assert "forces:" in repr(f.cg)


def test_a_lazy_box_makes_contacts_lazy():
    ds = random_steps(2)
    eager = ds.cg.find_contacts(k_n=1.0)
    lazy = ds.assign(box=ds.box.chunk(time=1)).cg.find_contacts(k_n=1.0).compute()
    count = eager.sizes["contact"]
    xr.testing.assert_equal(lazy.contact_i.isel(contact=slice(0, count)), eager.contact_i)
