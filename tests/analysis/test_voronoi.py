"""Radical Voronoi cells: they fill the box, and are those of half spaces."""

import warnings
from itertools import product

import numpy as np
import pytest
import xarray as xr
from scipy.spatial import ConvexHull, HalfspaceIntersection

import xcg
from tests import raise_if_dask_computes


def _scene(seed=1, periodic="xyz", ends="xyz", count=60, **options):
    """Random spheres of two sizes in a box of a centimetre, without large overlaps."""
    r = np.random.default_rng(seed)
    length = 1e-2
    cells = np.array(list(product(range(4), repeat=3)))[r.permutation(64)[:count]]
    position = (cells + 0.5 + r.uniform(-0.25, 0.25, (count, 3))) * length / 4
    diameter = length / 8 * np.where(r.uniform(size=count) < 0.3, 1.0, 1 / 3)
    box = dict.fromkeys(ends, (0.0, length))
    return xcg.scene_from_arrays(
        position, diameter=diameter, density=2500.0, box=box, periodic=periodic, **options
    )


def _volume_of_half_spaces(ds, k):
    """Volume of cell k: nearer to its particle than to each image of all, within the open ends."""
    place = ds.position[0].to_numpy()
    radius = ds.diameter[0].to_numpy() / 2
    length = 1e-2
    vectors = length * np.eye(3) if "lattice" not in ds else ds.lattice[0].to_numpy()
    numbers = [(-1, 0, 1) if a in ds.attrs["periodic"] else (0,) for a in "xyz"]
    rows = []
    for shift in product(*numbers):
        for j, image in enumerate(place + np.array(shift) @ vectors):
            if j == k and not any(shift):
                continue
            away = (image - place[k]) / length
            size = (radius[j] ** 2 - radius[k] ** 2) / length**2
            rows.append([*(2 * away), size - away @ away])
    for axis, name in enumerate("xyz"):
        if name not in ds.attrs["periodic"]:
            x = place[k, axis] / length
            rows += [[*np.eye(3)[axis], x - 1], [*-np.eye(3)[axis], -x]]
    cell = HalfspaceIntersection(np.array(rows), np.zeros(3))
    return ConvexHull(cell.intersections).volume * length**3


@pytest.mark.parametrize(
    "options",
    [{}, {"periodic": "xy"}, {"periodic": ""}, {"lattice": {"xy": 3e-3, "yz": -2e-3}}],
    ids=["periodic", "walls", "open", "tilted"],
)
def test_sizes_one_to_three_are_half_spaces_and_fill_the_box(options):
    ds = _scene(**options)
    v = xcg.voronoi(ds)
    np.testing.assert_allclose(v.voronoi_volume.sum(), 1e-6, rtol=1e-12)
    for k in range(0, 60, 7):
        expected = _volume_of_half_spaces(ds, k)
        np.testing.assert_allclose(v.voronoi_volume[0, k], expected, rtol=1e-10)
    np.testing.assert_allclose(v.voronoi_fraction * v.voronoi_volume, ds.volume, rtol=1e-13)


def test_face_centred_cubic_has_twelve_neighbours_and_kepler_s_fraction():
    ds = xcg.datasets.face_centred_cubic(3, diameter=1e-3)
    v = xcg.voronoi(ds, faces=True)
    np.testing.assert_allclose(v.voronoi_fraction, np.pi / np.sqrt(18), rtol=1e-12)
    assert (v.voronoi_neighbours == 12).all()
    # rhombic dodecahedron of a sphere of radius one: 12 rhombi of sqrt(2) / 2
    np.testing.assert_allclose(v.voronoi_area, 6 * np.sqrt(2) * 1e-6 / 2, rtol=1e-9)
    assert v.sizes["face"] == 6 * ds.sizes["particle"]


@pytest.mark.parametrize("shift", [0.0, 1e-15, 1e-13, 1e-11, 1e-9, 1e-7])
@pytest.mark.parametrize(
    ("neighbours", "offsets"),
    [
        (6, [[0.0, 0.0, 0.0]]),
        (14, [[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]]),
        (12, [[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]]),
    ],
    ids=["cubic", "body-centred", "face-centred"],
)
def test_lattices_fill_the_box_however_little_they_are_disturbed(neighbours, offsets, shift):
    """Up to eight cells meet at a point."""
    lattice = np.array(list(product(range(6), repeat=3)), float)
    position = np.concatenate([lattice + offset for offset in offsets])
    position += 0.2 + shift * np.random.default_rng(1).normal(size=position.shape)
    box = dict.fromkeys("xyz", (0.0, 6.0))
    ds = xcg.scene_from_arrays(position, diameter=0.5, density=1.0, box=box, periodic="xyz")
    v = ds.cg.voronoi()
    np.testing.assert_allclose(v.voronoi_volume, 1 / len(offsets), rtol=50 * shift + 1e-12)
    np.testing.assert_allclose(v.voronoi_volume.sum(), 216, rtol=1e-11)
    assert (v.voronoi_neighbours == neighbours).all()


def test_a_large_sphere_has_a_face_to_each_small_one_around():
    """Many more faces than memory is set aside for; faces of both sides are the same."""
    r = np.random.default_rng(5)
    away = r.normal(size=(900, 3))
    around = 5 + 3 * away / np.linalg.norm(away, axis=1, keepdims=True)
    ds = xcg.scene_from_arrays(
        np.concatenate([[[5.0, 5.0, 5.0]], around]),
        diameter=np.array([5.9] + [0.1] * 900),
        density=1.0,
        box=dict.fromkeys("xyz", (0.0, 10.0)),
        periodic="",
    )
    v = ds.cg.voronoi(faces=True).isel(time=0)
    np.testing.assert_allclose(v.voronoi_volume.sum(), 1000, rtol=1e-12)
    assert int(v.voronoi_neighbours[0]) == 900
    ends = np.concatenate([v.face_i, v.face_j])
    np.testing.assert_array_equal(np.bincount(ends), v.voronoi_neighbours)
    # the planes between touch a sphere around the centre, and their faces enclose it
    distance = (9 + 2.95**2 - 0.05**2) / 6
    area = v.face_area.where(v.face_i == 0).sum()
    assert 1 < float(area) / (4 * np.pi * distance**2) < 1.01
    np.testing.assert_allclose(v.voronoi_volume[0], area * distance / 3, rtol=1e-12)


def test_cells_reach_over_a_gap_of_hundred_diameters():
    """Between two beds the planes are halfway: cells fill the box, and end at its faces and there alone."""
    r = np.random.default_rng(6)
    bed = np.array(list(product(range(8), range(8), range(3)))) + r.uniform(0.3, 0.7, (192, 3))
    ds = xcg.scene_from_arrays(
        np.concatenate([bed, bed * [1, 1, -1] + [0, 0, 106]]),
        diameter=0.9,
        density=1.0,
        box={"x": (0, 8), "y": (0, 8), "z": (0, 106)},
        periodic="xy",
    )
    v = ds.cg.voronoi().isel(time=0)
    half = v.voronoi_volume.to_numpy().reshape(2, 192)
    np.testing.assert_allclose(half.sum(axis=1), 8 * 8 * 53, rtol=1e-12)
    np.testing.assert_allclose(half[0], half[1], rtol=1e-11)


def test_threads_do_not_change_the_cells(monkeypatch):
    ds = xcg.datasets.random_scene(300, seed=2)
    alone = ds.cg.voronoi(faces=True)
    monkeypatch.setattr("xcg.analysis.voronoi.threads_for", lambda count, threads: 3)
    xr.testing.assert_identical(ds.cg.voronoi(faces=True), alone)


def test_faces_are_those_of_both_cells():
    """The area vectors of a closed cell add up to zero, and radical planes are at known distances."""
    ds = _scene(seed=4)
    v = xcg.voronoi(ds, faces=True).isel(time=0)
    ids = ds.particle_id[0].to_numpy()
    i, j = (np.searchsorted(ids, v[name]) for name in ("face_i", "face_j"))
    vector = (v.face_area * v.face_normal).to_numpy()
    total = np.zeros((60, 3))
    np.add.at(total, i, vector)
    np.add.at(total, j, -vector)
    assert np.abs(total).max() < 1e-11 * float(v.voronoi_area.max())
    area = np.bincount(i, v.face_area, 60) + np.bincount(j, v.face_area, 60)
    np.testing.assert_allclose(v.voronoi_area, area, rtol=1e-9)
    number = np.bincount(i, minlength=60) + np.bincount(j, minlength=60)
    np.testing.assert_array_equal(v.voronoi_neighbours, number)


def test_normals_point_from_the_first_particle_to_the_second():
    """Also where a small particle lies outside of its own cell, inside of a large one."""
    r = np.random.default_rng(3)
    ds = xcg.scene_from_arrays(
        r.uniform(0, 5, (150, 3)),
        diameter=np.where(np.arange(150) < 75, 0.1, 2.0),
        density=1.0,
        box=dict.fromkeys("xyz", (0, 5)),
    )
    v = xcg.voronoi(ds, faces=True).isel(time=0)
    place = ds.position[0].to_numpy()
    radius = ds.diameter[0].to_numpy() / 2
    i, j = (v[name].to_numpy() for name in ("face_i", "face_j"))
    away = place[j] - place[i]
    distance = np.linalg.norm(away, axis=1)
    large = v.face_area.to_numpy() > 1e-3
    np.testing.assert_allclose(v.face_normal[large], (away / distance[:, None])[large], atol=1e-9)
    # the radical plane is behind the centre of one of the two
    assert ((radius[j] ** 2 - radius[i] ** 2 > distance**2) & large).any()


def test_a_layer_has_cells_of_its_thickness():
    r = np.random.default_rng(2)
    position = np.array(list(product(range(5), range(5)))) + r.uniform(0.3, 0.7, (25, 2))
    ds = xcg.scene_from_arrays(
        np.column_stack([position, np.zeros(25)]),
        diameter=r.uniform(0.3, 0.6, 25),
        density=1.0,
        dimension=2,
        thickness=0.6,
        box={"x": (0, 5), "y": (0, 5)},
        periodic="xy",
    )
    v = xcg.voronoi(ds)
    np.testing.assert_allclose(v.voronoi_volume.sum(), 25 * 0.6, rtol=1e-12)
    assert float(v.voronoi_neighbours.mean()) == 6  # Euler: of a periodic plane


def test_results_are_variables_of_particles_with_fields():
    ds = _scene()
    cells = xcg.voronoi(ds)
    ds = ds.assign(voronoi_volume=cells.voronoi_volume)
    f = ds.cg.coarse_grain([xcg.Mean("voronoi_volume", "number")], axes="", at={})
    # the mean cell is the box over the number of particles
    np.testing.assert_allclose(f.voronoi_volume.squeeze(), 1e-6 / 60, rtol=1e-12)


def test_lazy_results_are_those_in_memory():
    ds = xr.concat([_scene(seed) for seed in (1, 2, 3)], "time", data_vars="all")
    eager = ds.cg.voronoi(faces=True)
    with raise_if_dask_computes():
        lazy = ds.chunk(time=1).cg.voronoi(faces=True)
    lazy = lazy.compute()
    xr.testing.assert_equal(lazy.isel(face=slice(0, eager.sizes["face"])), eager)
    assert (lazy.face_i.isel(face=slice(eager.sizes["face"], None)) == -1).all()


@pytest.mark.parametrize("name", ["diameter", "box"])
def test_faces_of_a_scene_that_is_lazy_in_part_are_those_in_memory(name):
    ds = xr.concat([_scene(seed) for seed in (1, 2, 3)], "time", data_vars="all")
    eager = ds.cg.voronoi(faces=True)
    lazy = ds.assign({name: ds[name].chunk(time=1)}).cg.voronoi(faces=True).compute()
    xr.testing.assert_equal(lazy.isel(face=slice(0, eager.sizes["face"])), eager)


def test_bounds_are_the_ends_of_open_axes():
    ds = _scene(periodic="xy", ends="xy")
    with pytest.raises(xcg.SceneError, match="cells need ends along z"):
        ds.cg.voronoi()
    v = ds.cg.voronoi(bounds={"z": (0, 0.03)})
    np.testing.assert_allclose(v.voronoi_volume.sum(), 3e-6, rtol=1e-12)
    with pytest.raises(xcg.SceneError, match=r"are outside of the ends of the cells, such as id"):
        ds.cg.voronoi(bounds={"z": (0, 0.005)})
    with pytest.raises(ValueError, match=r"'x' is not an axis with ends; expected one of \['z'\]"):
        ds.cg.voronoi(bounds={"x": (0, 1)})
    with pytest.raises(ValueError, match=r"bounds=\[0, 1\]: expected ends of axes"):
        ds.cg.voronoi(bounds=[0, 1])


def test_one_particle_has_the_box():
    v = xcg.voronoi(_scene(count=1))
    np.testing.assert_allclose(v.voronoi_volume[0, 0], 1e-6, rtol=1e-12)
    assert int(v.voronoi_neighbours[0, 0]) == 0


def test_coinciding_centres_are_named():
    ds = _scene()
    ds["position"][0, 1] = ds.position[0, 0]
    with pytest.raises(xcg.SceneError, match=r"no Voronoi cells of 2 particles, such as id 0, as"):
        xcg.voronoi(ds)


def test_a_tilted_box_that_is_open_is_refused():
    ds = _scene(periodic="xy", lattice={"xy": 3e-3})
    with pytest.raises(xcg.SceneError, match="it is open along z"):
        xcg.voronoi(ds)


def test_cells_of_a_cylinder_in_a_box_are_said_to_reach_beyond_it():
    """And those of the same grains in a box that they fill are not."""
    ds = xcg.datasets.random_scene(2000, seed=3)
    with warnings.catch_warnings():
        warnings.simplefilter("error", xcg.SceneWarning)
        ds.cg.voronoi()
    centre = ds.position.isel(time=0).mean("particle")
    away = ds.position - centre
    inside = (away.sel(component="x") ** 2 + away.sel(component="y") ** 2) ** 0.5 < 0.4 * float(
        np.ptp(ds.position.sel(component="x").to_numpy())
    )
    cylinder = ds.assign(inside=inside.astype(int)).cg.select("inside == 1")
    with pytest.warns(xcg.SceneWarning, match="no box.*voronoi_at_edge == 0.*bounds="):
        cylinder.assign_attrs(periodic="").drop_vars("setup", errors="ignore").cg.voronoi()


def test_cells_under_a_free_surface_are_marked():
    """A bed in a box twice as high: silent, and without its cells at edges as packed as without them."""
    ds = xcg.datasets.random_scene(2000, seed=3)
    low, high = (float(ds.position.sel(component="z").reduce(f)) for f in (np.min, np.max))
    bed = ds.assign_attrs(periodic="xy").drop_vars("setup", errors="ignore")
    with warnings.catch_warnings():
        warnings.simplefilter("error", xcg.SceneWarning)
        v = bed.cg.voronoi(bounds={"z": (low, 2 * high - low)})
        whole = ds.cg.voronoi()
    at_edge = v.voronoi_at_edge == 1
    assert not whole.voronoi_at_edge.any()
    assert 100 < at_edge.sum() < 700
    # a cell ends at the floor or the top where it is the nearest: none in the middle of the bed
    middle = abs(bed.position.sel(component="z") - (low + high) / 2) < 0.25 * (high - low)
    assert not (at_edge & middle).any()
    cells = v.voronoi_volume.where(at_edge)
    assert (v.voronoi_fraction * cells).sum() / cells.sum() < 0.3
    inside = v.voronoi_fraction.where(~at_edge)
    np.testing.assert_allclose(
        inside.mean(), whole.voronoi_fraction.where(~at_edge).mean(), rtol=0.05
    )
