"""Boxes that change over time: what looks across a periodic edge takes the period of each step."""

import dask
import numpy as np
import pytest
import xarray as xr

import xcg

EDGES = (10.0, 8.0, 9.1)


def steps_of(edges=EDGES, **options):
    """One random scene a box, each in its own period along all axes, with contacts across the edges."""
    steps = [xcg.datasets.random_scene(150, seed=t, edge=edge) for t, edge in enumerate(edges)]
    names = ["velocity", "diameter", "contact_i", "contact_j", "contact_force", "contact_point"]
    key = {"contact": "contact_i", "particle": "particle_id"}
    rows = {n: [s[n].values[0][s[key[s[n].dims[1]]].values[0] >= 0] for s in steps] for n in names}
    given = (
        {"density": 2500.0, "box": [[[0, edge]] * 3 for edge in edges], "periodic": "xyz"}
        | rows
        | options
    )
    return xcg.scene_from_arrays([s.position.values[0] for s in steps], **given), steps


@pytest.mark.parametrize("lazy", [False, True])
def test_mesh_of_a_selection_equals_that_of_its_first_step(lazy):
    ds, alone = steps_of()
    ds = ds.chunk(time=1) if lazy else ds
    for t in (1, 2):
        part = ds.isel(time=[t])
        for one in (part, part.cg.measure(), ds.isel(time=slice(t, None, 3 - t))):
            f = one.cg.coarse_grain("density", axes="xz", width=1.0)
            assert bool(f.density.chunks) is lazy
            expected = alone[t].cg.coarse_grain("density", axes="xz", width=1.0)
            np.testing.assert_array_equal(f.x, expected.x)
            np.testing.assert_array_equal(f.z, expected.z)
            np.testing.assert_allclose(f.density[0], expected.density[0], rtol=1e-12)


@pytest.mark.parametrize("lazy", [False, True])
def test_axes_that_keep_their_period_have_neighbours_across_its_edges(lazy):
    """One axis of three is stretched: differences along the others go on across the edges."""
    ds = xcg.datasets.random_scene(150, seed=1, edge=6.0)
    box = np.array([[[0.0, 6.0], [0.0, 6.0], [0.0, 6.0 + t]] for t in range(3)])
    ds = xr.concat([ds] * 3, "time").assign(
        box=(("time", "component", "bound"), box), time=[0.0, 1.0, 2.0]
    )
    ds = ds.drop_attrs(deep=False).assign_attrs(
        {k: v for k, v in ds.attrs.items() if not k.startswith("box_")}
    )
    ds = ds.chunk({"time": 1}).assign(box=ds.box) if lazy else ds
    f = ds.cg.coarse_grain(
        ["velocity", "velocity_gradient"], axes="xz", width=1.2, gradient="finite_difference"
    )
    assert f.attrs["wrapped_axes"] == "x"
    v = f.velocity
    step = float(f.x[1] - f.x[0])
    want = (v.isel(x=1) - v.isel(x=-1)) / (2 * step)
    np.testing.assert_allclose(f.velocity_gradient.isel(x=0).sel(direction="x"), want, rtol=1e-9)


def test_a_box_that_stays_is_not_read_for_the_mesh():
    ds, _ = steps_of(edges=(10.0, 10.0))
    assert ds.attrs["box_upper"].tolist() == [10.0] * 3

    def refuse(dsk, keys, **kwargs):
        pytest.fail("computed while the graph was built")

    with dask.config.set(scheduler=refuse):
        ds.chunk(time=1).isel(time=[1]).cg.coarse_grain("density", width=1.0)


@pytest.mark.parametrize("t", range(3))
def test_finite_differences_at_the_edge_of_a_box_that_changed(t):
    """Nodes that fill the period of the first step, against the slope of V on a mesh that goes on beyond them."""
    ds, _ = steps_of(edges=(10.0, 8.0, 6.0))
    options = {"axes": "x", "width": 2.0, "spacing": 0.05}
    f = ds.cg.coarse_grain("velocity_gradient", gradient="finite_difference", **options).isel(
        time=t
    )
    beyond = ds.cg.coarse_grain("velocity", **options, bounds={"x": (-0.1, 10.1)}).velocity.isel(
        time=t
    )
    slope = np.gradient(beyond.values, 0.05, axis=0)[2 : 2 + f.sizes["x"]]
    scale = np.abs(slope).max()
    np.testing.assert_allclose(f.velocity_gradient.sel(direction="x"), slope, atol=2e-3 * scale)


@pytest.mark.parametrize("lazy", [False, True])
def test_a_body_across_the_edge_of_a_box_that_shrinks(lazy):
    position = [[[0.1, 5, 5], [edge - 0.1, 5, 5]] for edge in (10.0, 8.0)]
    ds = xcg.scene_from_arrays(
        position, diameter=np.ones((2, 2)), density=1.0, clump=np.zeros((2, 2), int), periodic="x",
        box=[[[0, edge], [0, 10], [0, 10]] for edge in (10.0, 8.0)],
    )  # fmt: skip
    bodies = (ds.chunk(time=1) if lazy else ds).cg.group_bodies("clump").compute()
    np.testing.assert_allclose(bodies.position.values[:, 0], [[0, 5, 5]] * 2, atol=1e-12)


def slices_by_hand(ds, t, method, edge, nodes, width, planes):
    """Velocity and number of grains of each slice, image by image."""
    x = ds.position.values[t][:, 0]
    v = ds.velocity.values[t]
    d = ds.diameter.values[t]
    m = ds.mass.values[t]
    for node in nodes:
        total = 0.0
        momentum = np.zeros(3)
        seen = set()
        for grain in range(len(x)):
            for n in range(-5, 6):
                off = x[grain] + n * edge - node
                weight = m[grain] * (-width / 2 <= off < width / 2)
                if method == "planes":
                    cuts = (
                        (1 - abs(k) / (planes + 1), off - k * width / (2 * planes))
                        for k in range(-planes, planes + 1)
                    )
                    weight = sum(
                        share * np.pi * max((d[grain] / 2) ** 2 - h**2, 0.0) for share, h in cuts
                    )
                if weight > 0:
                    seen.add(grain)
                    total = total + weight
                    momentum = momentum + weight * v[grain]
        yield momentum / total, len(seen)


@pytest.mark.parametrize("method", ["planes", "bins"])
def test_slices_count_every_image_in_the_box_of_each_step(method):
    """Bounds beyond the box, a box that changes, grains written many periods away."""
    ds, alone = steps_of(edges=(5.0, 4.0))
    options = {"axis": "x", "method": method, "width": 0.8, "bounds": (-1.0, 7.0)}
    s = ds.cg.slice_temperature(**options)
    for t, edge in enumerate((5.0, 4.0)):
        by_hand = slices_by_hand(ds, t, method, edge, s.x.values, 0.8, 5)
        for k, (velocity, count) in enumerate(by_hand):
            np.testing.assert_allclose(s.velocity[t, k], velocity, rtol=1e-9, atol=1e-12)
            assert s.sample_count[t, k] == count
        far = np.random.default_rng(t).integers(-9, 9, (150, 3)) * edge
        away = alone[t].assign(position=alone[t].position + far).cg.measure()
        for scene in (alone[t], away):
            one = scene.cg.slice_temperature(**options)
            for name in s.data_vars:
                np.testing.assert_allclose(one[name][0], s[name][t], rtol=1e-6, atol=1e-9)
        default = [
            scene.cg.slice_temperature("x", method=method, width=0.8) for scene in (alone[t], away)
        ]
        assert default[1].sizes["x"] == default[0].sizes["x"]
        assert default[1].sample_count.sum() == default[0].sample_count.sum()


def test_regions_across_an_edge_against_a_loop_over_images():
    ds, alone = steps_of(edges=(10.0, 8.0))
    bounds = {
        "across": {"x": (7.0, 11.5), "y": (-1.0, 2.0)},
        "far": {"z": (-33.0, -27.5)},
        "inside": {"y": (1.0, 2.0)},
    }
    far = (
        np.random.default_rng(0).integers(-5, 6, (2, 150, 3)) * np.array([10.0, 8.0])[:, None, None]
    )
    for scene in (ds, ds.assign(position=ds.position + far)):
        m = scene.cg.microstructure(["volume_fraction", "particle_count"], bounds=bounds)
        for t, edge in enumerate((10.0, 8.0)):
            x = alone[t].position.values[0]
            volume = alone[t].volume.values[0]
            for name, region in bounds.items():
                count = 0
                filled = 0.0
                size = edge**3
                for low, high in region.values():
                    size *= (high - low) / edge
                for centre, own in zip(x, volume, strict=True):
                    images = 1
                    for axis, (low, high) in region.items():
                        at = centre["xyz".index(axis)] + edge * np.arange(-20, 21)
                        images *= ((low <= at) & (at < high)).sum()
                    count = count + images
                    filled = filled + images * own
                found = m.sel(region=name).isel(time=t)
                assert found.particle_count == count
                np.testing.assert_allclose(found.volume_fraction, filled / size, rtol=1e-12)


def test_regions_wider_than_the_period_raise():
    ds, alone = steps_of(edges=(10.0, 8.0))
    whole = alone[0].cg.microstructure("volume_fraction").volume_fraction.item()
    for low in (0.0, 3.3):
        bounded = alone[0].cg.microstructure("volume_fraction", bounds={"x": (low, low + 10.0)})
        assert bounded.volume_fraction.item() == pytest.approx(whole, rel=1e-12)
    with pytest.raises(
        xcg.SceneError,
        match="step 1: the region reaches from 0 to 9 along 'x', further than the period 8",
    ):
        ds.cg.microstructure("volume_fraction", bounds={"x": (0, 9)})


@pytest.mark.parametrize(
    "times", [[0.0, 2.0, 1.0], [0.0, 1.0, 1.0], [0.0, np.nan, 2.0], [np.nan] * 3]
)
def test_times_that_do_not_rise_raise(times):
    with pytest.raises(xcg.SceneError, match="a scene needs finite times that rise"):
        steps_of(time=times)
    ds = steps_of()[0].assign_coords(time=times)
    with pytest.raises(
        xcg.SceneError, match=r"the strain rate of the box needs finite times .*sortby"
    ):
        ds.cg.microstructure("strain_rate", strain_rate="box")
    with pytest.raises(xcg.SceneError, match="balance needs finite times"):
        ds.cg.balance(axes="x", width=1.0)


def test_balance_does_not_wrap_where_nodes_no_longer_fill_the_box():
    options = {"axes": "x", "width": 1.0, "spacing": 0.25}
    ds, _ = steps_of(edges=(10.0, 8.0))
    ends = ds.cg.balance(**options).force_residual.isel(x=[0, 1, -2, -1])
    assert np.isnan(ends).all()
    same, _ = steps_of(edges=(10.0, 10.0))
    assert same.cg.balance(**options).force_residual.notnull().all()


def test_each_step_has_the_images_of_its_own_box():
    """Steps of equal boxes share what follows from them; a step with another box has its own."""
    ds, _ = steps_of((10.0, 8.0, 10.0))
    options = {"width": 1.0, "bounds": dict.fromkeys("xyz", (0.0, 8.0)), "spacing": 1.6}
    together = ds.cg.coarse_grain(["density", "stress"], **options)
    for t in range(3):
        alone = ds.isel(time=[t]).cg.coarse_grain(["density", "stress"], **options)
        for name in ("density", "stress"):
            np.testing.assert_array_equal(together[name][t], alone[name][0])


# --- images of grains ------------------------------------------------------------------------------------

OWN = np.array([7.3, -1.9, 4.4])  # motion beside that of the box in a step, in periods about 2


def vectors_of(kind, steps=5):
    """Lattice vectors (t, 3, 3) of a box as codes write it."""
    vectors = np.tile(np.diag([3.0, 3.0, 3.0]), (steps, 1, 1))
    t = np.arange(steps)
    if kind == "stretched":
        vectors *= (1 + 0.1 * t)[:, None, None]
    if kind == "tilted":
        vectors[:, 1, 0] = 0.7
    if kind in ("sheared", "flipped"):
        vectors[:, 1, 0] = 0.6 * t
    if kind == "flipped":  # as a tilt beyond half a period
        vectors[:, 1, 0] -= 3.0 * np.rint(vectors[:, 1, 0] / 3.0)
    return vectors


def moving(kind, *, unwrapped=False, **options):
    """Make grains that move with the box and by OWN, in it or unwrapped; return them and their gradients."""
    vectors = vectors_of(kind)
    start = np.random.default_rng(3).uniform(0, 3, (20, 3))
    smooth = vectors_of("sheared" if kind == "flipped" else kind)
    place = start
    places = []
    images = []
    for t, cell in enumerate(vectors):
        if t:
            place = place @ np.linalg.inv(smooth[t - 1]) @ smooth[t] + OWN
        image = np.zeros((20, 3)) if unwrapped else np.floor(place @ np.linalg.inv(cell))
        places.append(place - image @ cell)
        images.append(image)
    given = {
        "image": images,
        "box": [[[0, cell[k, k]] for k in range(3)] for cell in vectors],
        "lattice": vectors,
        "shear_rate": {},
        "periodic": "xyz",
        "time": np.arange(len(vectors)),
        "diameter": np.full((len(vectors), 20), 0.1),
        "density": 1.0,
    }
    return xcg.scene_from_arrays(places, **(given | options))


@pytest.mark.parametrize("unwrapped", [False, True])
@pytest.mark.parametrize("kind", ["constant", "tilted", "stretched", "sheared", "flipped"])
def test_images_follow_grains_beside_the_motion_of_their_box(kind, unwrapped):
    ds = moving(kind, unwrapped=unwrapped)
    msd = ds.cg.mean_squared_displacement(1, remove_drift=False).mean_squared_displacement
    np.testing.assert_allclose(msd, [OWN @ OWN], rtol=1e-9)
    if kind in ("constant", "tilted"):
        velocity = ds.cg.derive("velocity").velocity
        np.testing.assert_allclose(velocity, np.broadcast_to(OWN, velocity.shape), rtol=1e-9)


def test_wrapped_and_unwrapped_positions_have_equal_fields():
    scenes = [moving("sheared", unwrapped=unwrapped) for unwrapped in (False, True)]
    names = ["displacement", "displacement_gradient", "d2min"]
    wrapped, unwrapped = (ds.cg.displacement(names, axes="xyz", width=1.0) for ds in scenes)
    for name in names:
        np.testing.assert_allclose(wrapped[name], unwrapped[name], rtol=1e-6, atol=1e-9)
    wrapped, unwrapped = (ds.cg.coarse_grain("density", axes="xyz", width=1.0) for ds in scenes)
    np.testing.assert_allclose(wrapped.density, unwrapped.density, rtol=1e-9)


def test_unwrapped_positions_tell_images():
    ds = moving("sheared")
    cells = ds.lattice.values[:, None]
    unwrapped = ds.position.values + (ds.image.values[:, :, None] @ cells)[:, :, 0]
    again = moving("sheared", image=None, unwrapped_position=unwrapped)
    np.testing.assert_array_equal(again.image, ds.image)
    assert "unwrapped_position" not in again


@pytest.mark.parametrize("lazy", [False, True])
def test_selections_and_saved_scenes_keep_images(tmp_path, lazy):
    ds = moving("constant")
    ds = ds.chunk(time=1) if lazy else ds
    ds.cg.save(tmp_path / "s.nc")
    ds.cg.save(tmp_path / "s.zarr")
    parts = [ds.isel(time=slice(0, 3)), ds.isel(time=slice(3, None))]
    selections = [
        ds.isel(time=slice(1, 4)),
        ds.isel(particle=slice(3, 9)),
        ds.where(ds.position.sel(component="x") > -1),
        ds.sel(component=["z", "x", "y"]),
        xr.concat(parts, "time"),
        xcg.open_scene(tmp_path / "s.nc"),
        xcg.open_scene(tmp_path / "s.zarr"),
    ]
    for part in selections:
        velocity = part.cg.derive("velocity").velocity.transpose("time", "particle", "component")
        velocity = velocity.sel(component=["x", "y", "z"])
        np.testing.assert_allclose(velocity, np.broadcast_to(OWN, velocity.shape), rtol=1e-9)


FRAMES = {
    "by 30 degrees": {"x": (3**0.5, 1, 0), "z": (0, 0, 1)},
    "by 90 degrees": {"x": (0, 1, 0), "z": (0, 0, 1)},
    "upside down": {"x": (1, 0, 0), "z": (0, 0, -1)},
    "cyclic": {"x": (0, 1, 0), "z": (1, 0, 0)},
}


@pytest.mark.parametrize("kind", ["constant", "tilted"])
@pytest.mark.parametrize("turn", FRAMES)
def test_displacements_across_periods_turn_with_the_frame(kind, turn):
    frame = xcg.Rotated(**FRAMES[turn])
    at = dict.fromkeys("xyz", 0.5)
    f = moving(kind).cg.displacement("displacement", frame=frame, axes="", at=at, width=2.0)
    found = f.displacement.values.reshape(-1, 3)
    expected = np.broadcast_to(frame.axes @ OWN, found.shape)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
