"""Tilted and sheared boxes: the same scene written in another box gives the same; images move as the shear says."""

from __future__ import annotations

import math
import warnings
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import xcg
from tests.brute_force import BruteKernel
from xcg import SceneError, SceneWarning
from xcg.scene.lattice import Lattice

# random grains overlap, which their images in other periods hide
pytestmark = pytest.mark.filterwarnings("ignore:the box is periodic along")

NUMBERS = np.array(list(product(range(-4, 5), repeat=3)))
BOX = {"x": (0.0, 5.0), "y": (-1.0, 3.0), "z": (0.5, 6.5)}
LOW = np.array([0.0, -1.0, 0.5])
LENGTHS = np.array([5.0, 4.0, 6.0])


def cell_of(tilt=(0.0, 0.0, 0.0), lengths=LENGTHS):
    xy, xz, yz = tilt
    return np.array([[lengths[0], 0, 0], [xy, lengths[1], 0], [xz, yz, lengths[2]]])


def lattice_of(cell, periodic="xyz", velocity=None):
    box = {"box": np.stack([LOW, LOW + np.diag(cell)], axis=1), "lattice": np.asarray(cell, float)}
    return Lattice.of(box | ({} if velocity is None else {"lattice_velocity": velocity}), periodic)


def tilted_packing(seed, cell, count=60, moving=True):
    """Random grains in a tilted box, with contacts of all that overlap, across its edges too."""
    rng = np.random.default_rng(seed)
    position = LOW + rng.random((count, 3)) @ cell
    diameter = rng.uniform(1.2, 1.8, count)
    lattice = lattice_of(cell)
    rows = []
    for i, j in zip(*np.triu_indices(count, 1), strict=True):
        branches = position[i] - position[j] + NUMBERS @ cell
        for branch in branches[np.linalg.norm(branches, axis=1) < (diameter[i] + diameter[j]) / 2]:
            length = np.linalg.norm(branch)
            share = (length + (diameter[i] - diameter[j]) / 2) / (2 * length)
            rows.append((i, j, branch, position[i] - share * branch))
    i, j, branch, point = (np.array(column) for column in zip(*rows, strict=True))
    force = branch * rng.uniform(0.5, 1.5, (len(i), 1)) + 0.1 * rng.standard_normal((len(i), 3))
    assert len(lattice.shortest(branch))
    velocity = rng.standard_normal((count, 3)) if moving else np.zeros((count, 3))
    return {
        "position": position, "velocity": velocity, "diameter": diameter, "density": 1.0,
        "species": rng.integers(1, 3, count), "contact_i": i, "contact_j": j, "contact_force": force,
        "contact_point": point, "periodic": "xyz",
    }  # fmt: skip


def assert_equal(one, other, tolerance=1e-10):
    assert set(one.data_vars) == set(other.data_vars)
    for name in one.data_vars:
        scale = float(np.abs(other[name]).max())
        np.testing.assert_allclose(
            one[name], other[name], rtol=0, atol=tolerance * max(scale, 1e-30), err_msg=str(name)
        )


# --- vectors ---------------------------------------------------------------------------------------------

numbers = st.floats(-30.0, 30.0)
tilts = st.tuples(numbers, numbers, numbers)
turns = st.tuples(*[st.floats(-math.pi, math.pi)] * 3)


def turned(angles):
    matrix = np.eye(3)
    for axis, angle in enumerate(angles):
        turn = np.eye(3)
        rest = [k for k in range(3) if k != axis]
        turn[np.ix_(rest, rest)] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        matrix = matrix @ turn
    return matrix


@settings(deadline=None, max_examples=100)
@given(tilt=tilts, angles=turns, seed=st.integers(0, 1000))
def test_the_shortest_image_is_the_shortest_of_all(tilt, angles, seed):
    cell = cell_of(tilt) @ turned(angles)
    vectors = np.random.default_rng(seed).uniform(-20, 20, (20, 3))
    lattice = lattice_of(cell)
    found = lattice.shortest(vectors)
    turns = (found - vectors) @ np.linalg.inv(cell)
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)  # an image
    images = found[:, None] + NUMBERS @ lattice.basis  # any that is shorter would be among these
    assert (
        np.linalg.norm(found, axis=1) <= np.linalg.norm(images, axis=2).min(axis=1) + 1e-9
    ).all()
    np.testing.assert_allclose(abs(np.linalg.det(lattice.basis)), LENGTHS.prod(), rtol=1e-9)
    to = lattice.shortest(vectors, vectors[::-1]) - vectors[::-1]
    np.testing.assert_allclose(to, lattice.shortest(vectors - vectors[::-1]), atol=1e-9)


@settings(deadline=None, max_examples=50)
@given(
    tilt=tilts,
    angles=turns,
    seed=st.integers(0, 1000),
    periodic=st.sampled_from(["x", "xy", "xyz", "yz"]),
)
def test_all_images_in_a_region_are_found(tilt, angles, seed, periodic):
    rng = np.random.default_rng(seed)
    turn = turned(angles)
    velocity = rng.standard_normal((3, 3))
    lattice = lattice_of(cell_of(tilt) @ turn, periodic, velocity)
    position = rng.uniform(-8, 8, (15, 3))
    low = np.array([-3.0, -6.0, -2.0])
    high = np.array([4.0, 3.0, 5.0])
    row, shift, drift = lattice.images(position, low, high)
    found = sorted(
        zip(row.tolist(), map(tuple, np.round(position[row] + shift, 6).tolist()), strict=True)
    )
    expected = []
    # enough of the shortest vectors to lead everywhere from everywhere
    reach = [
        range(-n, n + 1)
        for n in np.ceil(40 * np.linalg.norm(np.linalg.pinv(lattice.basis), axis=0)).astype(int)
    ]
    for n in product(*reach):
        image = position + np.array(n) @ lattice.basis
        for k in np.flatnonzero(((low <= image) & (image <= high)).all(axis=1)):
            expected.append((int(k), tuple(np.round(image[k], 6).tolist())))
    assert found == sorted(expected)
    np.testing.assert_allclose(drift, lattice.drift(shift), atol=1e-9)


def test_vectors_of_any_basis_of_a_lattice_are_as_short():
    cell = cell_of((0.4, -0.3, 0.2))
    other = np.array([[1, 0, 0], [7, 1, 0], [-3, 12, 1]]) @ cell
    one = lattice_of(cell)
    two = lattice_of(other, "xyz")
    np.testing.assert_allclose(
        np.linalg.norm(one.basis, axis=1), np.linalg.norm(two.basis, axis=1), rtol=1e-12
    )


# --- the same scene in another box -----------------------------------------------------------------------

TILTS = [(1.3, -0.7, 2.1), (2.5, 2.5, 3.0), (-4.9, 0.0, 0.0)]


@pytest.mark.parametrize("tilt", TILTS)
@pytest.mark.parametrize("axes", ["xyz", "yz", "z"])
def test_fields_equal_those_of_another_basis_and_other_images(tilt, axes):
    cell = cell_of(tilt)
    given = tilted_packing(1, cell)
    rng = np.random.default_rng(2)
    bases = np.array([[1, 0, 0], [3, 1, 0], [-2, -1, 1]])
    again = given | {
        "position": given["position"] + rng.integers(-3, 4, (60, 3)) @ cell,
        "contact_point": given["contact_point"]
        + rng.integers(-3, 4, (len(given["contact_i"]), 3)) @ cell,
    }
    one = xcg.scene_from_arrays(**given, box=BOX, lattice=cell)
    two = xcg.scene_from_arrays(**again, box=BOX, lattice=bases @ cell)
    options = {
        "axes": axes,
        "width": 1.2,
        "spacing": 0.8,
        "by": "species",
        "bounds": {a: BOX[a] for a in axes},
    }
    assert_equal(one.cg.coarse_grain(**options), two.cg.coarse_grain(**options), 1e-9)


@pytest.mark.parametrize("gradient", ["least_squares", "kernel", "finite_difference"])
@pytest.mark.parametrize("width", [1.2, 2.1])  # the second reaches over more than a box
def test_a_box_tilted_by_whole_periods_is_the_box_without_tilt(width, gradient):
    cell = np.diag(LENGTHS)
    given = tilted_packing(3, cell)
    one = xcg.scene_from_arrays(**given, box=BOX)
    two = xcg.scene_from_arrays(**given, box=BOX, lattice={"xy": 15.0, "xz": -5.0, "yz": 8.0})
    assert "lattice" not in one
    assert "lattice" in two
    for axes in ("xyz", "xz", "y"):
        options = {"axes": axes, "width": width, "spacing": 1.0, "gradient": gradient}
        assert_equal(one.cg.coarse_grain(**options), two.cg.coarse_grain(**options), 1e-9)


def test_sums_over_images_one_by_one():
    cell = cell_of(TILTS[0])
    given = tilted_packing(4, cell)
    ds = xcg.scene_from_arrays(**given, box=BOX, lattice=cell)
    f = ds.cg.coarse_grain(
        ["density", "momentum_density", "contact_stress"], width=0.8, spacing=2.0, rtol=0
    )
    kernel = BruteKernel("lucy", 0.8)
    for node in np.ndindex(f.density.shape[1:]):
        r = np.array([f[a].values[k] for a, k in zip("xyz", node, strict=True)])
        apart = r - given["position"][:, None] - NUMBERS @ cell
        distance = np.linalg.norm(apart, axis=2)
        weight = np.where(distance < kernel.c, kernel(np.minimum(distance, kernel.c)), 0.0)
        weight = (ds.mass.values[0][:, None] * weight).sum(axis=1)
        np.testing.assert_allclose(f.density.values[0][node], weight.sum(), rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(
            f.momentum_density.values[0][node], weight @ given["velocity"], atol=1e-12
        )


def test_the_integral_of_stress_is_the_virial_and_of_density_the_mass():
    cell = cell_of(TILTS[1])
    given = tilted_packing(5, cell)
    ds = xcg.scene_from_arrays(**given, box=BOX, lattice=cell)
    f = ds.cg.coarse_grain(["density", "contact_stress", "fabric"], width=0.9, spacing=0.25)
    lattice = lattice_of(cell)
    i = given["contact_i"]
    j = given["contact_j"]
    branch = lattice.shortest(given["position"][i] - given["contact_point"]) - lattice.shortest(
        given["position"][j] - given["contact_point"]
    )
    virial = np.einsum("ci,cj->ij", given["contact_force"], branch) / LENGTHS.prod()
    np.testing.assert_allclose(
        f.contact_stress.mean(("time", *"xyz")), virial, rtol=0, atol=1e-4 * np.abs(virial).max()
    )
    np.testing.assert_allclose(f.density.mean(), ds.mass.sum() / LENGTHS.prod(), rtol=1e-5)
    whole = ds.cg.coarse_grain(["density", "contact_stress"], axes="", width=0.9)
    np.testing.assert_allclose(whole.contact_stress[0], virial, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(whole.density, ds.mass.sum() / LENGTHS.prod(), rtol=1e-12)


def test_averages_undefined_by_shifted_images_raise():
    given = tilted_packing(6, cell_of((1.3, 0.0, 0.0)))
    ds = xcg.scene_from_arrays(**given, box=BOX, lattice={"xy": 1.3})
    with pytest.raises(SceneError, match=r"along y are shifted along x, .*axes='xy'"):
        ds.cg.coarse_grain("density", axes="x", width=1.0)
    ds.cg.coarse_grain("density", axes="xy", width=1.0)


# --- shear -----------------------------------------------------------------------------------------------

RATE = 0.3


def sheared(tilt, rate=RATE, noise=0.0, seed=7, count=400):
    rng = np.random.default_rng(seed)
    position = LOW + rng.random((count, 3)) @ cell_of((tilt, 0, 0))
    velocity = np.zeros((count, 3))
    velocity[:, 0] = RATE * (position[:, 1] - LOW[1])
    velocity += noise * rng.standard_normal((count, 3))
    scene = {
        "position": position,
        "velocity": velocity,
        "diameter": np.full(count, 0.5),
        "density": 1.0,
    }
    shear = {} if rate is None else {"xy": rate}
    return xcg.scene_from_arrays(
        **scene, box=BOX, periodic="xyz", lattice={"xy": tilt}, shear_rate=shear
    )


@pytest.mark.parametrize("tilt", [0.0, 1.7, -2.5])
@pytest.mark.parametrize("axes", ["xyz", "xy", "y"])
def test_homogeneous_shear_has_one_gradient_and_no_temperature_up_to_the_edges(tilt, axes):
    fields = ["velocity", "velocity_gradient", "granular_temperature"]
    options = {"axes": axes, "width": 0.7, "spacing": 0.5}
    f = sheared(tilt).cg.coarse_grain(fields, **options)
    G = np.zeros((3, 3))
    G[0, 1] = RATE
    G = G[np.ix_(range(3), ["xyz".index(a) for a in "xyz"])]
    found = f.velocity_gradient.values.reshape(-1, 3, 3)
    np.testing.assert_allclose(found, np.broadcast_to(G, found.shape), rtol=0, atol=1e-11)
    temperature = f.granular_temperature.values
    assert np.nanmax(np.abs(temperature)) < 1e-14
    assert np.isfinite(temperature).all() or axes == "xyz"
    # images that do not move spoil both next to the edges
    wrong = sheared(tilt, None).cg.coarse_grain(fields, **options)
    edge = wrong.isel(y=0)
    assert (
        np.abs(edge.velocity_gradient.sel(component="x", direction="y") - RATE).max() > 0.5 * RATE
    )
    assert np.nanmax(edge.granular_temperature) > 0.01 * (RATE * LENGTHS[1]) ** 2


def test_an_average_across_the_shear_is_that_in_the_middle_of_the_box():
    ds = sheared(0.0)
    f = ds.cg.coarse_grain("velocity", axes="z", width=1.0)
    position = ds.position.values[0]
    velocity = ds.velocity.values[0, :, 0]
    in_middle = velocity - RATE * (position[:, 1] - LOW[1] - LENGTHS[1] / 2)
    np.testing.assert_allclose(f.velocity.sel(component="x"), in_middle.mean(), rtol=1e-9)
    assert np.ptp(in_middle) < 1e-12


def test_shear_leaves_temperatures_as_they_are():
    still = sheared(1.0, noise=0.05)
    options = {"axes": "yz", "width": 0.8, "spacing": 0.5}
    one = still.cg.coarse_grain("granular_temperature", **options).granular_temperature
    peculiar = still.velocity.values.copy()
    peculiar[0, :, 0] -= RATE * (still.position.values[0, :, 1] - LOW[1])
    calm = still.drop_vars("lattice_velocity").assign(velocity=(still.velocity.dims, peculiar))
    two = calm.cg.coarse_grain("granular_temperature", **options).granular_temperature
    np.testing.assert_allclose(one, two, rtol=1e-9)


def test_rates_follow_from_the_tilt_of_steps_and_flips_do_not_count():
    time = np.arange(8) * 0.5
    tilt = np.array([2.0, 2.4, -2.2, -1.8, -1.4, -1.0, -0.6, -0.2])  # flipped once, by the period 5
    position = np.broadcast_to(LOW + 1.0, (8, 1, 3))
    ds = xcg.scene_from_arrays(
        position, time=time, box=BOX, periodic="xyz", lattice={"xy": tilt}, diameter=np.ones((8, 1))
    )
    expected = np.zeros((8, 3, 3))
    expected[:, 1, 0] = 0.8
    np.testing.assert_allclose(ds.lattice_velocity, expected, atol=1e-12)
    both = {
        "xy": tilt,
        "xz": np.linspace(0, 0.7, 8),
        "yz": np.array([1.8, 1.9, -2.0, -1.9, -1.8, -1.7, -1.6, -1.5]),
    }
    both["xz"][2:] -= tilt[2:]  # c is flipped by b
    ds = xcg.scene_from_arrays(
        position, time=time, box=BOX, periodic="xyz", lattice=both, diameter=np.ones((8, 1))
    )
    expected[:2, 2, :2], expected[2:, 2, :2] = [0.2, 0.2], [0.2 - 0.8, 0.2]
    np.testing.assert_allclose(ds.lattice_velocity, expected, atol=1e-12)
    still = xcg.scene_from_arrays(
        position,
        time=time,
        box=BOX,
        periodic="xyz",
        lattice={"xy": tilt},
        shear_rate={},
        diameter=np.ones((8, 1)),
    )
    assert "lattice_velocity" not in still
    with pytest.warns(SceneWarning, match="give shear_rate="):
        xcg.scene_from_arrays(
            position[:3], time=time[:3], box=BOX, periodic="xyz", lattice={"xy": [0.0, 2.4, 4.8]}
        )
    with pytest.warns(SceneWarning, match="times of the steps are not known"):
        xcg.scene_from_arrays(
            position[:3], box=BOX, periodic="xyz", lattice={"xy": [0.0, 0.4, 0.8]}
        )


@pytest.mark.parametrize("nodes", [{"spacing": 1.5}, {"axes": "z"}, {"axes": ""}])
def test_a_compressed_box_holds_the_flow_of_its_images(nodes):
    rate = np.array([-0.1, 0.0, -0.2])
    place = np.random.default_rng(4).uniform(0, 6.0, (400, 3))
    time = np.array([0.0, 1.0])
    length = 6.0 * (1 + rate * time[:, None])
    position = place * length[:, None] / 6.0
    scene = {
        "position": position,
        "velocity": np.broadcast_to(place * rate, position.shape),
        "diameter": np.ones((2, 400)),
        "density": 1.0,
        "time": time,
        "box": np.stack([0 * length, length], axis=-1),
        "periodic": "xyz",
        "units": "reduced",
    }
    names = ["velocity_gradient", "granular_temperature"]
    relative = (6.0 / length * rate).T
    ds = xcg.scene_from_arrays(
        **scene, shear_rate=dict(zip(("xx", "yy", "zz"), relative, strict=True))
    )
    f = ds.cg.coarse_grain(names, for_averages=False, **nodes)
    expected = relative.T[:, :, None] * np.eye(3)
    of_nodes = f.velocity_gradient.transpose("time", "component", "direction", ...).to_numpy()
    of_nodes = of_nodes.reshape(2, 3, 3, -1)
    known = np.isfinite(of_nodes)
    np.testing.assert_allclose(
        np.where(known, of_nodes - expected[..., None], 0.0), 0.0, atol=1e-12
    )
    assert known.mean() > 0.9
    assert float(f.granular_temperature.max()) < 1e-15
    with pytest.warns(SceneWarning, match="move with the box.*along x and z.*'xx': -0.1.*'zz'"):
        xcg.scene_from_arrays(**scene).cg.coarse_grain(names, **nodes)
    scene["velocity"] = np.random.default_rng(5).normal(size=position.shape)
    with warnings.catch_warnings():  # of grains that do not follow it, as after remap x
        warnings.filterwarnings("error", message=".*move with the box")
        xcg.scene_from_arrays(**scene).cg.coarse_grain(names, **nodes)


def test_averages_of_a_sheared_layer_do_not_warn():
    rng = np.random.default_rng(6)
    position = np.pad(rng.uniform(0, 6.0, (60, 2)), ((0, 0), (0, 1)))
    ds = xcg.scene_from_arrays(
        position, velocity=0.2 * position[:, [1, 0, 2]] * [1, 0, 0], diameter=np.ones(60),
        density=1.0, box={"x": (0, 6), "y": (0, 6)}, periodic="xy", lattice={"xy": 0.0},
        shear_rate={"xy": 0.2}, dimension=2, thickness=1.0, units="reduced",
    )  # fmt: skip
    f = ds.cg.coarse_grain(["velocity_gradient"], axes="y")
    shear = f.velocity_gradient.sel(component="x", direction="y")
    np.testing.assert_allclose(shear, 0.2, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"lattice": {"yy": 1.0}}, "lattice names .*yy"),
        ({"lattice": {"xy": [1.0, 2.0]}}, "one for each of 1 steps"),
        ({"lattice": np.eye(3)}, "expected that as its component along 'x'"),
        ({"lattice": np.ones((2, 2))}, "expected the vectors a, b, c"),
        ({"shear_rate": {"xy": 1.0}}, "give the tilt at each step"),
        ({"lattice": {"xy": 1.0}, "box": None}, "give the edges without the tilt"),
        ({"lattice": {"xy": np.nan}}, "expected a finite number"),
    ],
)
def test_wrong_lattices_raise(options, match):
    with pytest.raises(SceneError, match=match):
        xcg.scene_from_arrays([[1.0, 1.0, 1.0]], **{"box": BOX, "periodic": "xyz"} | options)


# --- contacts and what is made of them -------------------------------------------------------------------


@pytest.mark.parametrize("tilt", TILTS)
def test_all_contacts_across_tilted_edges_are_found(tilt):
    cell = cell_of(tilt)
    given = tilted_packing(8, cell)
    known = {k: given[k] for k in ("position", "diameter", "density", "periodic")}
    known["position"] = known["position"] + np.random.default_rng(1).integers(-2, 3, (60, 3)) @ cell
    ds = xcg.scene_from_arrays(**known, box=BOX, lattice=cell).cg.find_contacts()
    table = ds.isel(time=0)
    found = sorted(
        zip(
            table.contact_i.values,
            table.contact_j.values,
            np.round(table.overlap.values, 9),
            strict=True,
        )
    )
    i = given["contact_i"]
    j = given["contact_j"]
    centre = given["position"][i] - given["contact_point"]
    overlap = given["diameter"][i] - 2 * np.linalg.norm(lattice_of(cell).shortest(centre), axis=1)
    assert found == sorted(zip(i, j, np.round(overlap, 9), strict=True))
    pairs = xcg.find_pairs(known["position"], given["diameter"] / 2, BOX, "xyz", lattice=cell)
    assert {*map(tuple, pairs.tolist())} == {(a, b) for a, b, _ in found}


def test_microstructure_and_chains_equal_those_of_another_basis():
    cell = cell_of(TILTS[0])
    given = tilted_packing(9, cell)
    again = given | {
        "position": given["position"] + np.random.default_rng(2).integers(-2, 3, (60, 3)) @ cell
    }
    one = xcg.scene_from_arrays(**given, box=BOX, lattice=cell)
    two = xcg.scene_from_arrays(
        **again, box=BOX, lattice=np.array([[1, 0, 0], [1, 1, 0], [0, -1, 1]]) @ cell
    )
    regions = {"low": {"z": (0.5, 3.0)}, "over": {"z": (5.0, 8.0), "y": (2.0, 4.0)}}
    assert_equal(
        one.cg.microstructure(bounds=regions["low"]), two.cg.microstructure(bounds=regions["low"])
    )
    counts = one.cg.microstructure(["volume_fraction"], bounds=regions)
    assert np.isfinite(counts.volume_fraction).all()
    chains = [ds.cg.force_chains(60, region=xcg.Sphere((0.0, 0.0, 0.0), 2.5)) for ds in (one, two)]
    np.testing.assert_array_equal(chains[0].chain_id, chains[1].chain_id)
    for ds, fc in zip((one, two), chains, strict=True):
        assert (fc.lattice == ds.lattice).all()
    slices = [
        ds.cg.slice_temperature("z", width=1.5, method=m)
        for ds in (one, two)
        for m in ("bins", "planes")
    ]
    assert_equal(slices[0], slices[2])
    assert_equal(slices[1], slices[3])


def test_displacements_are_relative_to_a_box_that_is_sheared_and_flips():
    rng = np.random.default_rng(11)
    share = rng.random((300, 3))  # 2.3, 2.7 - 5, 3.1 - 5
    tilts = [2.3, -2.3, -1.9]
    time = [0.0, 0.5, 1.0]
    cells = [cell_of((tilt, 0.4, 0.0)) for tilt in (2.3, 2.7, 3.1)]
    position = [LOW + share @ cell + rng.integers(-1, 2, (300, 3)) @ cell for cell in cells]
    ds = xcg.scene_from_arrays(
        position, time=time, box=BOX, periodic="xyz", lattice={"xy": tilts, "xz": 0.4}, diameter=np.ones((3, 300)),
        density=1.0,
    )  # fmt: skip
    f = ds.cg.displacement(["displacement_gradient", "d2min"], axes="xyz", width=1.0, spacing=1.5)
    expected = np.zeros((3, 3))
    expected[0, 1] = 0.4 / LENGTHS[1]
    found = f.displacement_gradient.values.reshape(-1, 3, 3)
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=0, atol=1e-12)
    assert np.nanmax(np.abs(f.d2min)) < 1e-24


def test_slices_of_sheared_boxes_take_the_velocity_of_the_image():
    for method in ("planes", "bins"):
        f = sheared(1.7).cg.slice_temperature("y", width=0.5, method=method, bounds=(-3.0, 1.0))
        expected = RATE * (f.y.values - LOW[1])
        assert np.abs(f.velocity.sel(component="x").values[0] - expected).max() < 0.3 * RATE


def test_bodies_across_a_sheared_edge_have_the_velocity_of_one_place():
    ds = sheared(1.7)
    y = ds.position[0, :, 1].values
    low = int(np.argmin(y))
    high = int(np.argmax(y))
    lattice = lattice_of(cell_of((1.7, 0, 0)))
    body = np.full(len(y), -1)
    body[[low, high]] = 3
    # put the second sphere beside the first, then write it by its image
    position = ds.position.values[0].copy()
    velocity = ds.velocity.values[0].copy()
    position[high] = position[low] + [0.1, -0.4, 0.0] + lattice_of(cell_of((1.7, 0, 0))).cell[1]
    velocity[high] = [RATE * (position[high, 1] - LOW[1]), 0, 0]
    assert np.isfinite(lattice.shortest(position)).all()
    one = ds.assign(
        position=(ds.position.dims, position[None]), velocity=(ds.velocity.dims, velocity[None])
    )
    bodies = (
        one.assign(body_id=(("time", "particle"), body[None]))
        .cg.group_bodies("body_id")
        .isel(time=0)
    )
    at = int(np.flatnonzero(bodies.particle_id.values == 3)[0])
    np.testing.assert_allclose(
        bodies.velocity[at, 0], RATE * (bodies.position[at, 1] - LOW[1]), atol=1e-12
    )


@pytest.mark.parametrize("periodic", ["xyz", "xz", ""])
@pytest.mark.parametrize("length", [3.9, 4.0, 4.1, 9.0])
def test_images_of_straight_boxes_nearer_than_a_length(periodic, length):
    lattice = lattice_of(cell_of(), periodic)
    numbers = NUMBERS * [axis in periodic for axis in "xyz"]
    moves = np.unique(numbers[numbers.any(axis=1)] * LENGTHS, axis=0)
    expected = moves[(moves**2).sum(axis=1) < length**2]
    assert sorted(map(tuple, lattice.translations(length))) == sorted(map(tuple, expected))


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (1.0, 0.5, -0.3)])
@pytest.mark.parametrize("reach", [1.0, 3.0, 9.0])
def test_images_of_vectors_within_a_reach_are_those_of_brute_force(tilt, reach):
    lattice = lattice_of(cell_of(tilt))
    rng = np.random.default_rng(3)
    vector = lattice.shortest(rng.uniform(-9.0, 9.0, (60, 3)))
    reaches = rng.uniform(0.0, reach, len(vector))
    rows, images = lattice.within(vector, reaches)
    for n, (own, far) in enumerate(zip(vector, reaches, strict=True)):
        everywhere = own + NUMBERS @ lattice.periodic_vectors
        length = np.linalg.norm(everywhere, axis=1)
        is_near = (length < far) | ~NUMBERS.any(axis=1)
        expected = sorted(map(tuple, everywhere[is_near].round(9)))
        assert sorted(map(tuple, images[rows == n].round(9))) == expected
    np.testing.assert_array_equal(rows, np.sort(rows))


@pytest.mark.parametrize(
    ("tilt", "axes", "said"),
    [
        ({"xy": 1.0}, "xz", "along y are shifted along x,"),
        ({"xy": 1.0}, "x", "along y are shifted along x,"),
    ],
)
def test_the_axes_of_a_tilt_are_named(tilt, axes, said):
    ds = xcg.scene_from_arrays(
        np.ones((1, 3)), diameter=[1.0], density=1.0, velocity=np.zeros((1, 3)), box=[[0, 5]] * 3, periodic="xyz",
        lattice=tilt, shear_rate={},
    )  # fmt: skip
    with pytest.raises(xcg.SceneError, match=said):
        ds.cg.coarse_grain("density", axes=axes, width=1.0)
