"""Bodies glued from spheres."""

import numpy as np
import pytest
import xarray as xr

import xcg


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
    assert (x[1, 0] - 9.95) % 10 == pytest.approx(
        0, abs=1e-12
    )  # (1 x 10.1 + 3 x 9.9) / 4, around the edge
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
    options = {
        "axes": "x",
        "width": 0.5,
        "spacing": 0.05,
        "extent": {"y": 10, "z": 10},
        "bounds": {"x": (0, 9.95)},
    }
    both = [s.cg.coarse_grain(["density", "momentum_density", "contact_stress", "boundary_force_density"], **options)
            for s in (ds, bodies)]  # fmt: skip
    for name in ("density", "momentum_density", "boundary_force_density"):
        totals = [f[name].sum("x").values for f in both]
        np.testing.assert_allclose(totals[1], totals[0], rtol=1e-6, atol=1e-12)
    # virial of bodies: force between them times the vector between their centres, and the wall's
    total = both[1].contact_stress.isel(time=0).sum("x").values * 0.05 * 100
    expected = np.outer([-2.0, 1, 0], [-0.05 - 1.2, 0, 0]) + np.outer([0, 0, 4.0], [0, 0, 0.3])
    np.testing.assert_allclose(total, expected, atol=1e-6)
    named = ds.cg.coarse_grain("density", by_body="body_id", **options)
    assert "by_body='body_id'" in named.attrs["history"]
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
    message = rf"^group_bodies, step 0: spheres 12 and 13 are of one body \(3\) and differ in {name} \(0, 1\)"
    with pytest.raises(xcg.SceneError, match=message):
        ds.cg.group_bodies()


def test_sizes_of_bodies_of_a_lazy_scene_are_measured_or_given():
    lazy = dimers(box=[[0, 10.0], [-np.inf, np.inf], [-np.inf, np.inf]]).chunk(time=1)
    options = {"axes": "y", "extent": {"z": 9.0}, "by_body": "body_id"}
    for given, lacking in (
        ({}, "needs the attribute 'd43'"),
        ({"width": 1.0}, "axis 'y' has no bounds"),
    ):
        with pytest.raises(
            ValueError,
            match=rf"{lacking}.*group_bodies\(\.\.\.\)\.cg\.measure\(\) in place of by_body=",
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


def test_partners_that_are_missing_are_no_wall_with_a_name():
    ds = xcg.datasets.simple_cubic(3)
    less = ds.isel(particle=ds.particle_id[0].values != 5)
    b = less.assign(body_id=less.particle_id).cg.group_bodies()
    partners = b.contact_j.values[b.contact_j.values < 0]
    assert partners.size
    assert (partners < -1000).all()
