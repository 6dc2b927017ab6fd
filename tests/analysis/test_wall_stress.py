"""Traction on walls: closed forms, sums of forces, what LAMMPS says."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xcg
from tests.analysis.test_flow_rate import layer
from tests.scene.test_contacts import DATA, GRAVITY, SUMS, WALLS
from xcg.fields.grids.walls import Wall

DIAMETER = 1.0
FLOOR = xcg.Plane((0, 0, 0), (0, 0, 1))


def touching(point, force, *, depth=0.5, **more):
    """Grains that touch a wall at some points, with some forces on them."""
    point = np.asarray(point, float)
    centre = np.asarray(more.pop("centre", point + np.array([0, 0, depth])), float)
    number = np.full(len(point), -1)
    diameter = np.full(len(point), DIAMETER)
    return xcg.scene_from_arrays(
        centre, diameter=diameter, density=1.0, contact_i=np.arange(len(point)), contact_j=number,
        contact_force=np.asarray(force, float), contact_point=point, **more,
    )  # fmt: skip


def sums(f):
    """Traction times area, normal, along the surface and as a vector, summed over the cells."""
    cells = list(f.area.dims)
    return [
        (f[name] * f.area).sum(cells).to_numpy()
        for name in ("normal_traction", "shear_traction", "traction")
    ]


def plate(count=12):
    """Grains above the centres of the cells of a periodic floor."""
    x = np.arange(count) + 0.5
    return np.stack([*(a.ravel() for a in np.meshgrid(x, x)), np.zeros(count**2)], axis=1)


def test_uniform_pressure_and_shear_on_a_plane():
    point = plate()
    force = np.tile([3.0, -2.0, 7.0], (len(point), 1))  # of the wall on the grains, one a unit area
    ds = touching(point, force, box=[[0, 12], [0, 12], [0, 2]], periodic="xy")
    f = ds.cg.wall_stress(FLOOR, 0.8, spacing=1.0)
    np.testing.assert_allclose(f.normal_traction, 7.0, rtol=1e-12)
    np.testing.assert_allclose(f.shear_traction.sel(along="x"), -3.0, rtol=1e-12)
    np.testing.assert_allclose(f.shear_traction.sel(along="y"), 2.0, rtol=1e-12)
    np.testing.assert_allclose(f.traction.sel(component="z"), -7.0, rtol=1e-12)
    turned = touching(
        point + np.array([0, 0, 1e-3]), force, box=[[0, 12], [0, 12], [0, 2]], periodic="xy"
    )
    np.testing.assert_allclose(
        turned.cg.wall_stress(FLOOR, 0.8, spacing=1.0).normal_traction, 7.0, rtol=1e-12
    )


@pytest.mark.parametrize(("within", "taken"), [(None, 4), (0.3, 3), (0.1, 1)])
def test_contacts_farther_than_within_are_left_out(within, taken):
    """On both sides of the wall; by default up to the width, 0.5."""
    point = np.array([[2.0, 2, 0], [2, 3, 0.29], [3, 2, -0.29], [3, 3, 0.45], [4, 4, 0.55]])
    force = np.arange(15.0).reshape(5, 3)
    f = touching(point, force).cg.wall_stress(FLOOR, 0.5, within=within)
    assert f.wall_contacts.item() == taken
    np.testing.assert_allclose(f.wall_force[0], -force[:taken].sum(axis=0))


def test_a_wall_larger_than_the_grains_says_where_its_cells_end():
    ds = xcg.datasets.random_scene(100, walls=True, periodic="y")
    x = ds.position[0, :, 0]
    radius = ds.diameter[0] / 2
    low = float((x - radius).min())
    high = float((x + radius).max())
    floor = xcg.Plane((0, 0, 0), (0, 0, 1))
    f = ds.cg.wall_stress(floor, within=1e-3)
    size = f.x[1] - f.x[0]
    dmax = float(ds.diameter.max()) / 2  # the cells reach as far as the largest grain would
    assert float(f.x[0] - size / 2) <= low < float(f.x[0] - size / 2) + dmax
    assert float(f.x[-1] + size / 2) - dmax < high <= float(f.x[-1] + size / 2)
    assert f"x from {float(f.x[0] - size / 2):.4g}" in f.attrs["comment"]
    assert "y from" not in f.attrs["comment"]
    wider = xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((-3, 8), (0, 5)))
    g = ds.cg.wall_stress(wider, within=1e-3)
    assert "comment" not in g.attrs
    np.testing.assert_allclose(g.wall_force, f.wall_force)
    assert not g.normal_traction.sel(x=slice(None, low - 2 * f.attrs["cutoff"])).any()


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 2, 0), (1, 1, 0.5)])
def test_hydrostatic_pressure_in_a_cylinder(direction):
    """Pressure that falls along the axis and a friction that holds: both come back but for the ends."""
    silo = xcg.Cylinder((1, 2, 3), direction, 5.0, low=0.0, high=20.0)
    cells = silo.cells(np.zeros(3), np.ones(3), 0.5)
    axis = np.array(direction) / np.linalg.norm(direction)
    along = (cells.centre - [1, 2, 3]) @ axis
    inwards = silo.normals_at(cells.centre)
    pressure = 4.0 * (20 - along)
    friction = 0.3 * along
    force = (pressure[:, None] * inwards + friction[:, None] * axis) * cells.area[:, None]
    ds = touching(cells.centre, force, centre=cells.centre + 0.5 * inwards)
    f = ds.cg.wall_stress(silo, 1.0, spacing=0.5)
    inner = f.isel(time=0).sel(z=slice(4.5, 15.5))  # an end is felt two supports away
    law = 4.0 * (20 - inner.z)
    np.testing.assert_allclose(
        inner.normal_traction, law.broadcast_like(inner.normal_traction), rtol=1e-10
    )
    np.testing.assert_allclose(
        inner.shear_traction.sel(along="z").mean("theta"), -0.3 * inner.z, rtol=1e-10
    )
    np.testing.assert_allclose(inner.shear_traction.sel(along="theta"), 0.0, atol=1e-10)
    turn = 1 - (inner.traction * -inwards.reshape(f.centre.shape)[:, 9:31]).sum("component") / law
    assert (
        0 < float(turn.mean()) < (1.0 / 5.0) ** 2
    )  # cos of what the normal turns by within the support


def box_surface(low=0.0, high=6.0) -> xcg.Surface:
    """A closed cube, seen from the inside."""
    corners = np.array(list(np.ndindex(2, 2, 2)), float) * (high - low) + low
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    rows = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    surface = xcg.Surface(corners, rows)
    inside = surface.distance(np.full((1, 3), (low + high) / 2))[0] > 0
    return surface if inside else xcg.Surface(corners, rows, flip=True)


SURFACES: dict[str, Wall] = {
    "plane": FLOOR,
    "tilted plane": xcg.Plane((3, 3, 0), (0.3, 0.1, 1)),
    "cylinder": xcg.Cylinder((3, 3, 0), (0, 0, 1), 3.0),
    "triangles": box_surface(),
}


@pytest.mark.filterwarnings("ignore:all .* grains have")  # they touch the wall
@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("width", [0.1, 0.9])
def test_traction_times_area_is_the_sum_of_the_forces(name, width):
    """For any forces anywhere near, however cells and support compare."""
    rng = np.random.default_rng(5)
    wall = SURFACES[name]
    place = rng.uniform(0, 6, (300, 3))
    point = place - wall.distance(place)[:, None] * wall.normals_at(place)
    np.testing.assert_allclose(wall.distance(point), 0, atol=1e-9)
    force = rng.normal(size=(2, 300, 3))
    ds = xcg.scene_from_arrays(
        np.stack([point + 0.4 * wall.normals_at(point)] * 2), diameter=np.full((2, 300), DIAMETER), density=1.0,
        contact_i=np.tile(np.arange(300), (2, 1)), contact_j=np.full((2, 300), -1), contact_force=force,
        contact_point=np.stack([point] * 2),
    )  # fmt: skip
    f = ds.cg.wall_stress(wall, width, spacing=0.5)
    taken = f.wall_contacts.to_numpy()
    assert (taken > 100).all()
    if name == "triangles":
        assert (taken == 300).all()
        np.testing.assert_allclose(f.wall_force, -force.sum(axis=1), atol=1e-11)
    normal, _, vector = sums(f)
    np.testing.assert_allclose(vector, f.wall_force, atol=1e-11)
    if "plane" in name:  # on a flat wall the three say the same
        np.testing.assert_allclose(
            (f.traction**2).sum(), (f.normal_traction**2).sum() + (f.shear_traction**2).sum()
        )
        np.testing.assert_allclose(
            normal, -(f.wall_force.to_numpy() @ wall.normals_at(point[:1])[0]), atol=1e-11
        )
    lazy = ds.chunk(time=1).cg.wall_stress(wall, width, spacing=0.5)
    assert lazy.traction.chunks is not None
    np.testing.assert_array_equal(lazy.traction.to_numpy(), f.traction.to_numpy())


@pytest.mark.filterwarnings("ignore:all .* grains have")  # they touch the wall
@pytest.mark.filterwarnings("ignore:time_average. normal_traction changes")  # it does
def test_averages_over_time_are_means_of_the_steps():
    plates = [
        touching(plate(), np.tile([0.5 * k, 0, k + 1], (144, 1)), time=[float(k)]) for k in range(8)
    ]
    scene = xr.concat(
        plates, "time", data_vars="all", coords="minimal", compat="override", join="override"
    )
    f = scene.cg.wall_stress(xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((0, 12), (0, 12))), width=1.0)
    mean = f.cg.time_average()
    for name in f.data_vars:
        np.testing.assert_allclose(mean[name], f[name].mean("time"), rtol=1e-12, err_msg=name)
        assert f"{name}_error" in mean
    assert (mean.normal_traction_error > 0).all()
    damaged = scene.assign(contact_force=scene.contact_force.where(scene.time != 2.0))
    with pytest.warns(xcg.SkippedStep):
        f_damaged = damaged.cg.wall_stress(
            xcg.Plane((0, 0, 0), (0, 0, 1)), width=1.0, on_error="skip"
        ).compute()
    assert f_damaged.wall_contacts.values.tolist() == [144, 144, -1, *[144] * 5]
    assert np.isnan(f_damaged.cg.time_average().wall_contacts)
    np.testing.assert_allclose(
        f.cg.profile("x").normal_traction, f.normal_traction.mean("y"), rtol=1e-12
    )


def test_kernels_with_negative_parts_lose_no_force_between_coarse_cells():
    xcg.register_kernel("negative parts", lambda q: (1 - q**2) ** 4 * (1 - 3 * q**2), smoothness=3)
    place = np.random.default_rng(5).uniform(0, 6, (300, 3)) * [1, 1, 0]
    ds = touching(place, np.ones((300, 3)), box=[[0, 6], [0, 6], [0, 2]], periodic="xy")
    for kernel in ("lucy", "negative parts"):
        f = ds.cg.wall_stress(FLOOR, 0.9, spacing=2.0, kernel=kernel)
        np.testing.assert_allclose(sums(f)[2], f.wall_force, rtol=1e-11)


def test_walls_of_the_silo_carry_its_weight():
    ds = xcg.open_scene(DATA / "particles.dump.gz", walls=WALLS).compute()
    side = ds.cg.wall_stress(
        xcg.Cylinder((0, 0, 0), (0, 0, 1), 0.025, low=0, high=0.24), walls="side"
    )
    floor = ds.cg.wall_stress(FLOOR, walls="floor", within=1e-6)
    for f, (count, *force) in zip((side, floor), SUMS, strict=True):
        assert f.wall_contacts.item() == count
        np.testing.assert_allclose(sums(f)[2][0], -np.array(force), atol=1e-6)
    weight = GRAVITY * float(ds.mass.sum())
    np.testing.assert_allclose(-sums(side)[1][0, 1] - sums(floor)[2][0, 2], weight, rtol=1e-4)
    np.testing.assert_allclose(sums(floor)[0][0], SUMS[1, 3], rtol=1e-6)
    deep = side.normal_traction.mean("theta")[0]
    density = 2500 * GRAVITY * 0.6
    assert (
        float(deep.sel(z=slice(0.02, 0.08)).mean()) < 0.6 * density * 0.17
    )  # Janssen: less than the weight above


def test_contacts_of_another_wall_warn_and_name_the_way_out():
    """Those of the side within the width from the floor add a tenth to the force on the floor."""
    ds = xcg.open_scene(DATA / "particles.dump.gz", walls=WALLS).compute()
    with pytest.warns(
        xcg.SceneWarning, match=r"13 of the 67 contacts taken .* name the wall, walls="
    ):
        both = ds.cg.wall_stress(FLOOR)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        floor = ds.cg.wall_stress(FLOOR, walls="floor")
        near = ds.cg.wall_stress(FLOOR, within=1e-4)
    assert both.wall_force[0, 2] < 1.1 * floor.wall_force[0, 2] < 0
    np.testing.assert_allclose(near.wall_force, floor.wall_force)


def test_a_rough_wall_is_no_other_wall():
    rng = np.random.default_rng(3)
    point = rng.uniform(0, 6, (60, 3)) * [1, 1, 0.08]
    arm = rng.normal(size=point.shape)
    arm[:, 2] = abs(arm[:, 2])
    centre = point + 0.5 * arm / np.linalg.norm(arm, axis=1)[:, None]
    ds = touching(point, np.ones((60, 3)), centre=centre)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", ".*another wall")
        assert ds.cg.wall_stress(FLOOR, 0.9).wall_contacts.item() == 60


def test_contacts_across_a_periodic_edge_count_on_both_sides():
    ds = touching([[0.05, 3, 0]], [[0, 0, 1.0]], box=[[0, 6], [0, 6], [0, 2]], periodic="xy")
    p = ds.cg.wall_stress(FLOOR, 0.8, spacing=0.5).normal_traction[0]
    np.testing.assert_allclose((p * 0.25).sum(), 1.0)
    assert float(p.sel(x=5.75, y=2.75)) > 0.1
    shifted = touching([[3.05, 3, 0]], [[0, 0, 1.0]], box=[[0, 6], [0, 6], [0, 2]], periodic="xy")
    q = shifted.cg.wall_stress(FLOOR, 0.8, spacing=0.5).normal_traction[0]
    np.testing.assert_allclose(q.roll(x=-6), p, atol=1e-14)


def test_a_part_of_a_plane_carries_the_force_above_it():
    ds = touching([[1, 1, 0], [4, 1, 0], [1, 1, 3]], [[0, 0, 1.0]] * 3)
    part = xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((0, 2), (0, 2)))
    f = ds.cg.wall_stress(part, 0.5)
    assert f.wall_contacts.item() == 1
    np.testing.assert_allclose(sums(f)[0], 1.0)
    with pytest.warns(xcg.SceneWarning, match=r"no contact with a wall is within .* of Plane"):
        ds.cg.wall_stress(xcg.Plane((0, 0, -9), (0, 0, 1)), 0.5)


def test_distances_from_triangles_equal_those_of_brute_force():
    rng = np.random.default_rng(1)
    surface = box_surface()
    points = rng.uniform(-2, 8, (200, 3))
    inside = ((points > 0) & (points < 6)).all(axis=1)
    outside = np.linalg.norm(np.maximum(0, np.maximum(-points, points - 6)), axis=1)
    depth = np.minimum(points, 6 - points).min(axis=1)
    np.testing.assert_allclose(
        surface.distance(points), np.where(inside, depth, -outside), atol=1e-12
    )


def test_surfaces_are_read_from_files(tmp_path):
    path = tmp_path / "floor.stl"
    facet = (
        "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex {}\nvertex {}\nendloop\nendfacet\n"
    )
    path.write_text(
        "solid\n" + facet.format("6 0 0", "6 6 0") + facet.format("6 6 0", "0 6 0") + "endsolid\n"
    )
    surface = xcg.Surface(path)
    np.testing.assert_allclose(surface.area, [18, 18])
    np.testing.assert_allclose(surface.normals, [[0, 0, 1]] * 2)
    np.testing.assert_allclose(
        xcg.Surface(str(path), flip=True, scale=1e-3).distance(np.ones((1, 3)) * 1e-3), -1e-3
    )
    ds = touching([[1, 2, 0.0]], [[0, 0, 5.0]])
    f = ds.cg.wall_stress(surface, 0.5)
    np.testing.assert_allclose(sums(f)[0], 5.0)
    (tmp_path / "empty.stl").write_text("solid\nendsolid\n")
    with pytest.raises(ValueError, match="holds no triangle"):
        xcg.Surface(tmp_path / "empty.stl")
    with pytest.raises(FileNotFoundError, match=r"none\.stl"):
        xcg.Surface(tmp_path / "none.stl")
    with pytest.raises(ValueError, match=r"expected a surface in \.stl"):
        xcg.Surface(Path("floor.dxf"))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: xcg.Plane((0, 0), (0, 0, 1)), "point="),
        (lambda: xcg.Plane((0, 0, 0), (0, 0, 0)), "not all zero"),
        (lambda: xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((1, 0), (0, 1))), r"bounds\[0\]"),
        (lambda: xcg.Plane((0, 0, 0), (0, 0, 1), bounds=3), "two pairs"),
        (lambda: xcg.Cylinder((0, 0, 0), (0, 0, 1), -1.0), "radius=-1"),
        (lambda: xcg.Cylinder((0, 0, 0), (0, 0, 1), 1.0, low=2, high=1), "first < last"),
        (lambda: xcg.Cylinder((0, 0, 0), (0, 0, 1), 1.0, high=np.nan), "high=nan"),
        (lambda: xcg.Cylinder((0, 0, 0), "w", 1.0), "axis='w': expected 'x', 'y', 'z'"),
        (lambda: xcg.Surface(np.zeros((3, 3)), [[0, 1, 2]]), "no area"),
        (lambda: xcg.Surface(np.eye(3), [[0, 1, 3]]), "there are 3"),
        (lambda: xcg.Surface(np.eye(3), [[0.0, 1, 2]]), "whole numbers"),
        (lambda: xcg.Surface(np.eye(3)), "expected triangles"),
        (lambda: xcg.Surface(np.eye(3), [[0, 1, 2]], scale=0), "scale=0"),
    ],
)
def test_wrong_walls_raise(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"surface": "floor"}, "expected an xcg.Plane"),
        ({"spacing": 0}, "spacing=0"),
        ({"within": -1}, "within=-1"),
        ({"walls": "floor"}, "no wall of this scene has a name"),
        ({"width": "2 d99"}, "d99"),
    ],
)
def test_wrong_arguments_of_wall_stress_raise(options, message):
    ds = touching([[1, 1, 0]], [[0, 0, 1.0]])
    with pytest.raises(ValueError, match=message):
        ds.cg.wall_stress(**{"surface": FLOOR, **options})


def test_a_scene_without_contacts_raises():
    ds = xcg.datasets.random_scene(20, seed=1)
    with pytest.raises(xcg.SceneError, match="wall_stress needs"):
        ds.drop_vars("contact_force").cg.wall_stress(FLOOR)


CORNERS = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [5.0, 5.0, 0.0], [0.0, 5.0, 0.0]])


@pytest.mark.parametrize("scale", [1000.0, 1e-3])
def test_triangles_in_another_unit_are_refused(scale):
    """Before memory ends: of the larger ones, flow_rate would take 25 million parts."""
    ds = xcg.datasets.random_scene(200, walls=True, periodic="xy")
    rows = [[0, 1, 2], [0, 2, 3]]
    ds.cg.wall_stress(xcg.Surface(CORNERS, rows), width=0.5)
    ds.cg.flow_rate(xcg.Surface(CORNERS + np.array([0, 0, 2]), rows), width=0.5)
    wrong = xcg.Surface(scale * CORNERS, rows)
    for use in (ds.cg.wall_stress, ds.cg.flow_rate):
        with pytest.raises(ValueError, match=r"in another unit of length.*scale=0\.001"):
            use(wrong, width=0.5)


@pytest.mark.parametrize(
    "wall",
    [
        xcg.Cylinder((0.0, 0.0, 0.0), "z", 5000.0, low=0.0, high=10000.0),
        xcg.Plane((0, 0, 0), (0, 0, 1), bounds=((0, 5000.0), (0, 5000.0))),
        xcg.Cylinder((0.0, 0.0, 0.0), "z", 1e9),
    ],
)
def test_a_wall_in_another_unit_is_refused_before_memory_ends(wall):
    ds = xcg.datasets.random_scene(200, walls=True, periodic="xy")
    with pytest.raises(ValueError, match="in another unit of length than the scene"):
        ds.cg.wall_stress(wall, width=0.5)


@pytest.mark.parametrize(("more", "depth"), [
    ({"thickness": 1.0}, 1.0), ({"thickness": 0.1}, 0.1), ({"box": {"z": (-0.1, 0.4)}}, 0.5), ({}, 0.2),
])  # fmt: skip
def test_the_traction_on_the_wall_of_a_layer_is_per_its_thickness(more, depth):
    """20 N on 5 m, without thickness and box by the largest diameter; the same all across the layer."""
    f = layer(**more).cg.wall_stress(xcg.Plane((0, 0, 0), (0, 1, 0)), 0.5)
    np.testing.assert_allclose(f.normal_traction, 4.0 / depth, rtol=1e-9)
