"""Contacts of one step: normals, walls, and the order of the two particles."""

import numpy as np
import pytest

import xcg
from xcg.scene.contacts import Contacts
from xcg.scene.lattice import Lattice


def off_line(seed, **options):
    """A random scene with walls whose contact points lie off the line of centres, as those of other shapes do."""
    ds = xcg.datasets.random_scene(150, seed=seed, polydispersity=3.0, **options)
    rng = np.random.default_rng(seed)
    aside = 0.2 * rng.normal(size=ds.contact_point.shape) * [axis in ds.attrs["plane"] for axis in "xyz"]
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


@pytest.mark.parametrize("options", [{"periodic": "xy"}, {"periodic": "x", "dimension": 2}], ids=["3D", "2D"])
def test_the_order_of_the_two_particles_does_not_matter(options):
    ds = off_line(3, **options)
    other = turned_about(ds, 4)
    everything = (
        lambda s: s.cg.coarse_grain(["fabric", "contact_stress", "coordination_number"], spacing=0.5),
        lambda s: s.cg.microstructure(bounds={"left": {"x": (0.0, 2.0)}}),
        lambda s: s.cg.particle_stress(symmetric=False)[["stress"]],
        lambda s: s.cg.force_chains(60.0)[["chain_id", "links", "chain_particles", "chain_stress"]],
    )
    for compute in everything:
        one, two = compute(ds), compute(other)
        for name in one.data_vars:
            size = float(np.abs(one[name]).max())
            np.testing.assert_allclose(two[name], one[name], rtol=1e-9, atol=1e-12 * size, err_msg=name)


@pytest.mark.parametrize("periodic", ["", "xyz"])
def test_normals_are_along_the_centres_and_at_walls_towards_the_contact_point(periodic):
    ds = off_line(5, periodic=periodic).isel(time=0)
    x, c = ds.position.values, ds.contact_point.values
    period = 5.0 if periodic else np.inf
    normal = []
    for i, j, point in zip(ds.contact_i.values, ds.contact_j.values, c, strict=True):
        towards = x[i] - (x[j] if j >= 0 else point)
        towards = towards - (period * np.rint(towards / period) if periodic else 0.0)
        normal.append(towards / np.linalg.norm(towards))
    frame = {name: ds[name].values for name in ("particle_id", "position", "contact_i", "contact_j", "contact_point")}
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
