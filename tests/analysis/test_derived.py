"""Velocities from positions: constant acceleration, periodic boxes that shear, particles that come and go, tables."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import xcg


def motion(steps=6, count=20, dt=0.1, seed=1):
    rng = np.random.default_rng(seed)
    start, speed, pull = (rng.normal(size=(count, 3)) for _ in range(3))
    t = dt * np.arange(steps)[:, None, None]
    return start + speed * t + 0.5 * pull * t**2, speed + pull * t, dt * np.arange(steps)


@pytest.mark.parametrize("chunk", [None, 1, 4])
def test_velocities_are_exact_for_constant_acceleration(chunk):
    position, velocity, time = motion()
    ds = xcg.scene_from_arrays(position, time=time, diameter=np.ones(20))
    ds = ds.cg.derive("velocity") if chunk is None else ds.chunk(time=chunk).cg.derive("velocity")
    assert (ds.velocity.chunks is not None) == (chunk is not None)
    np.testing.assert_allclose(ds.velocity[1:-1], velocity[1:-1], atol=1e-12)
    np.testing.assert_allclose(ds.velocity[0], (position[1] - position[0]) / 0.1, atol=1e-12)
    np.testing.assert_allclose(ds.velocity[-1], (position[-1] - position[-2]) / 0.1, atol=1e-12)
    assert ds.velocity.attrs["units"] == "m s^-1"


def test_uneven_steps_are_divided_by_their_time():
    time = np.array([0.0, 0.1, 0.4])
    ds = xcg.scene_from_arrays(
        time[:, None, None] * [[[2.0, 0, 0]]], time=time, diameter=[1.0]
    ).cg.derive("velocity")
    np.testing.assert_allclose(ds.velocity[:, 0, 0], 2.0)


def test_missing_velocities_and_what_to_do():
    ds = xcg.datasets.random_scene(100, seed=1).drop_vars("velocity")
    for fields, instead in (("velocity", False), (["density", "pressure"], True)):
        with pytest.raises(xcg.SceneError, match=r"or call ds\.cg\.derive\('velocity'\)") as raised:
            ds.cg.coarse_grain(fields)
        assert ("or ask for contact_stress" in str(raised.value)) == instead
    assert "contact_stress" in ds.cg.coarse_grain("contact_stress", axes="z")


def test_velocities_across_edges_and_in_a_sheared_box():
    rng = np.random.default_rng(2)
    time = 0.1 * np.arange(5)
    rate = 0.7
    start = rng.uniform(0, 4, (30, 3))
    position = np.stack([start + [[0.3, 0.0, 0.2]] * np.array(t) for t in time])
    position[..., 0] += rate * time[:, None] * start[:, 1]
    tilt = rate * 4 * time
    wrapped = position.copy()
    wrapped[..., 2] %= 4
    beyond = np.floor(wrapped[..., 0] / 4)
    wrapped[..., 0] -= 4 * beyond
    ds = xcg.scene_from_arrays(wrapped, time=time, diameter=np.ones(30), periodic="xyz",
                               box=dict.fromkeys("xyz", (0.0, 4.0)), lattice={"xy": tilt})  # fmt: skip
    v = ds.cg.derive("velocity").velocity
    np.testing.assert_allclose(
        v[..., 0], np.broadcast_to(0.3 + rate * start[:, 1], (5, 30)), atol=1e-12
    )
    np.testing.assert_allclose(v[..., 2], 0.2, atol=1e-12)


def test_velocities_of_particles_that_come_and_go():
    position, _, time = motion(steps=4, count=3)
    ids = [[1, 2, 3], [3, 1], [2, 1, 3], [1, 3, 9]]
    rows = [[k - 1 for k in step] for step in ids]
    rows[3] = [0, 2, 1]
    ds = xcg.scene_from_arrays([position[t][r] for t, r in enumerate(rows)], particle_id=ids, time=time,
                               diameter=[np.ones(len(r)) for r in rows])  # fmt: skip
    v = ds.cg.derive("velocity")
    of = {int(k): v.velocity.values[2, row] for row, k in enumerate(v.particle_id.values[2])}
    np.testing.assert_allclose(of[1], (position[3, 0] - position[1, 0]) / 0.2)
    assert np.isnan(of[2]).all()  # in no neighbouring step
    at = {
        int(k): v.velocity.values[1, row] for row, k in enumerate(v.particle_id.values[1]) if k >= 0
    }
    np.testing.assert_allclose(at[3], (position[2, 2] - position[0, 2]) / 0.2)


def test_tables_of_trackpy_are_read():
    """Positions by frame and particle, with gaps; no velocities, radii or third coordinate."""
    table = pd.DataFrame({
        "y": [5.0, 1.0, 5.0, 1.0, 1.0, 5.0], "x": [10.0, 2.0, 13.0, 2.5, 3.0, 19.0],
        "mass": [800.0, 900.0, 810.0, 905.0, 880.0, 790.0], "size": 2.1, "ecc": 0.1, "signal": 30.0, "raw_mass": 1e3,
        "ep": 0.05, "frame": [0, 0, 1, 1, 2, 3], "particle": [7, 3, 7, 3, 3, 7],
    })  # fmt: skip
    names = {"frame": "time", "particle": "particle_id", "mass": None}
    ds = xcg.scene_from_table(
        table[["x", "y", "frame", "particle", "mass"]].assign(z=0.0, diameter=3.0), names=names, dimension=2,
        thickness=1.0, density=1.0,
    ).cg.derive("velocity")  # fmt: skip
    seven = ds.velocity.where(ds.particle_id == 7).sel(component="x").max("particle")
    np.testing.assert_allclose(seven[:2], 3.0)
    assert np.isnan(seven[3])  # a gap before it
    grains = ds.where(ds.velocity.notnull().all("component"))
    f = grains.isel(time=[0, 1]).cg.coarse_grain(
        "velocity", axes="", extent={"x": 20.0, "y": 8.0}, width=2.0
    )
    np.testing.assert_allclose(f.velocity.sel(component="x"), (3.0 + 0.5) / 2)


def test_single_steps_and_falling_times_raise():
    with pytest.raises(xcg.SceneError, match="two steps or more"):
        xcg.scene_from_arrays([[0.0, 0, 0]], diameter=[1.0]).cg.derive("velocity")
    ds = xcg.scene_from_arrays(np.zeros((2, 1, 3)), time=[0.0, 1.0], diameter=[1.0])
    with pytest.raises(xcg.SceneError, match="rise"):
        ds.isel(time=[1, 0]).cg.derive("velocity")
    assert isinstance(ds.cg.derive("velocity"), xr.Dataset)


def pegs_tables():
    """Three discs in two frames: contacts listed from both sides in the first, once and with a wall in the second."""
    grains = pd.DataFrame({
        "frame": [1, 1, 1, 2, 2, 2], "id": [7, 3, 9] * 2, "x": [0.0, 2.0, 2.0, 0.0, 2.0, 2.0],
        "y": [0.0, 0.0, 2.0] * 2, "r": 1.0,
    })  # fmt: skip
    rows = [(1, 7, 3, 0.1, 1.0), (1, 3, 7, 0.1, 1.0), (1, 3, 9, -0.3, 2.0), (1, 9, 3, -0.3, 2.0), (2, 7, 3, 0.0, 4.0),
            (2, 7, -1, 0.5, 5.0)]  # fmt: skip
    return grains, pd.DataFrame(
        rows, columns=["frame", "id1", "id2", "tangential_force", "normal_force"]
    )


def test_tables_of_pegs2_are_read():
    """Adjacency lists of magnitudes become vectors on i; both sides are one contact; walls are dropped."""
    grains, contacts = pegs_tables()
    names = {"frame": "step", "r": "radius"}
    layer = {"dimension": 2, "thickness": 1.0, "density": 1.0}
    with pytest.warns(xcg.SceneWarning, match="1 rows name a wall"):
        ds = xcg.scene_from_table(grains.assign(z=0.0), contacts=contacts, names=names, **layer)
    force = {
        (int(i), int(j)): f
        for i, j, f in zip(
            ds.contact_i.values[0], ds.contact_j.values[0], ds.contact_force.values[0], strict=True
        )
    }
    for (i, j), expected in {(7, 3): (-1.0, -0.1), (3, 9): (-0.3, -2.0)}.items():
        found = force[i, j] if (i, j) in force else -force[j, i]
        np.testing.assert_allclose(found, (*expected, 0.0), atol=1e-15)
    assert len(force) == 2
    stress = ds.cg.coarse_grain(
        "contact_stress", axes="", extent={"x": 16.0, "y": 16.0}, width=1.0
    ).contact_stress
    assert stress.values[1, 0, 0] == pytest.approx(
        4.0 * 2.0 / 256.0, rel=1e-9
    )  # force, branch, volume
    with pytest.raises(xcg.SceneError, match="no particle has id 8"):
        xcg.scene_from_table(
            grains.assign(z=0.0), contacts=contacts[:4].replace(9, 8), names=names, **layer
        )


def test_names_and_texts_of_forces_as_magnitudes():
    grains = {"x": [0.0, 1.0], "y": 0.0, "z": 0.0, "diameter": 1.0, "id": [1, 2]}
    layer = {"dimension": 2, "thickness": 1.0, "density": 1.0}
    row = {"id1": [2], "id2": [1], "N": 0.3, "overlap": 0.1}
    ds = xcg.scene_from_table(
        grains, contacts=row, names={"N": "normal_force", "overlap": None}, **layer
    )
    np.testing.assert_allclose(ds.contact_force.values[0], [[0.3, 0.0, 0.0]])
    assert "overlap" not in ds
    for wrong in ({"N": "a"}, {"id1": ["a"]}, {"T": "a"}):
        with pytest.raises(
            xcg.SceneError, match=r"contacts: column .* holds other things than numbers"
        ):
            xcg.scene_from_table(
                grains,
                contacts=row | wrong,
                names={"N": "normal_force", "T": "tangential_force"},
                **layer,
            )


def test_photoelastic_forces_across_a_periodic_edge_have_the_direction_of_the_nearest_image():
    grains = {"id": [1, 2], "x": [0.2, 3.3], "y": [1.0, 1.0], "z": 0.0, "diameter": 1.0}
    touching = {"id1": [1], "id2": [2], "normal_force": [2.0], "tangential_force": [0.5]}
    box = {"x": (0.0, 4.0), "y": (0.0, 4.0), "z": (-0.5, 0.5)}
    layer = {"dimension": 2, "thickness": 1.0, "density": 1.0}
    discs = xcg.scene_from_table(grains, contacts=touching, box=box, periodic="xy", **layer)
    force = discs.contact_force.isel(time=0).dropna("contact").values
    np.testing.assert_allclose(
        force, [[2.0, 0.5, 0.0]], atol=1e-12
    )  # 1 lies to the right of the image of 2
    tilted = {"x": [0.2, 0.9], "y": [0.1, 3.4]}  # the image of 2 below lies at (-0.1, -0.6)
    sheared = xcg.scene_from_table(
        grains | tilted, contacts=touching, box=box, periodic="xy", lattice={"xy": 1.0}, **layer
    )
    found = sheared.contact_force.isel(time=0).dropna("contact").values
    n = np.array([0.3, 0.7]) / np.hypot(0.3, 0.7)
    np.testing.assert_allclose(
        found, [[2 * n[0] - 0.5 * n[1], 2 * n[1] + 0.5 * n[0], 0.0]], atol=1e-12
    )
    open_box = xcg.scene_from_table(grains | {"x": [0.2, -0.7]}, contacts=touching, **layer)
    np.testing.assert_allclose(
        open_box.contact_force.isel(time=0).dropna("contact").values, force, atol=1e-12
    )


def test_large_moves_across_a_period_warn():
    position = np.array([[[0.0, 1.0, 1.0]], [[1.3, 1.0, 1.0]], [[2.6, 1.0, 1.0]]])
    ds = xcg.scene_from_arrays(
        position, diameter=[0.1], time=[0.0, 1.0, 2.0], box=[[0, 4]] * 3, periodic="x"
    )
    with pytest.warns(xcg.SceneWarning, match=r"by up to 0\.33 of the period along 'x'"):
        ds.cg.derive("velocity")
