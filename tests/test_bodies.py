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
def test_mass_centre_velocity_and_contacts_of_bodies(lazy):
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


def test_sums_of_bodies_are_those_of_their_spheres():
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
