"""Scenes that cannot be warn, once and with the likely cause; loose, layered and mixed ones are silent."""

import re
import warnings

import numpy as np
import pandas as pd
import pytest

import xcg
from tests import dumps
from xcg.scene.lattice import Lattice
from xcg.scene.sanity import check_motion

# corner of the box: one at 0 would hide lengths taken for edges
CORNER = np.array([200.0, -70.0, 30.0])
SCALED = {"density": 1.0, "units": "reduced"}


@pytest.fixture(scope="module")
def chute():
    ds = xcg.datasets.open("chute").isel(time=0).load()
    edges = np.stack([ds.attrs["box_lower"], ds.attrs["box_upper"]], axis=1)
    return ds.position.values + CORNER, ds.diameter.values, edges + CORNER[:, None]


@pytest.fixture(scope="module")
def layer():
    ds = xcg.datasets.open("biaxial").isel(time=0).load()
    return ds.position.values, ds.diameter.values


def said(*args, **options):
    """Return the messages of the warnings of a scene."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        xcg.scene_from_arrays(*args, **options)
    return [str(warning.message) for warning in caught]


# --- sizes and positions ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "cause"),
    [
        (0.5, "radii were given as diameters"), (2.0, "diameters were given as radii"),
        (0.1, "different units"), (0.01, "different units"), (0.001, "different units"),
        (0.05, "different units"), (10.0, "units"), (1000.0, "units"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("packing", ["chute", "layer"])
def test_sizes_that_are_off_by_a_factor_warn(packing, factor, cause, request):
    position, diameter, *_ = request.getfixturevalue(packing)
    options = SCALED | ({"dimension": 2} if packing == "layer" else {})
    (message,) = said(position, diameter=factor * diameter, **options)
    assert cause in message
    assert not said(position, diameter=diameter, **options)


def test_the_factor_of_mixed_sizes_is_that_of_their_sums():
    """Grains of 1 to 100 in contact: nearest centres are at the sum of two radii, whatever these are."""
    rng = np.random.default_rng(0)
    diameter = 10.0 ** rng.uniform(0, 2, 400)
    contact = 0.5 * (diameter[1:] + diameter[:-1]) * rng.uniform(0.99, 1.0, 399)
    chain = np.column_stack([np.concatenate([[0.0], np.cumsum(contact)]), *np.zeros((2, 400))])
    chain[::2, 1] += 1e-3
    chain[::3, 2] += 1e-3
    assert not said(chain, diameter=diameter, **SCALED)
    (message,) = said(chain, diameter=diameter / 2, **SCALED)
    assert "radii were given as diameters" in message


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("ratio", [1.0, 2.0, 100.0])
@pytest.mark.parametrize("fraction", [1e-5, 1e-3, 0.01, 0.1, 0.4])
def test_random_gases_do_not_warn(dimension, ratio, fraction):
    rng = np.random.default_rng(1)
    diameter = rng.uniform(1.0, ratio, 1500)
    share = {2: np.pi / 4, 3: np.pi / 6}[dimension]
    edge = (share * (diameter**dimension).sum() / fraction) ** (1 / dimension)
    position = rng.uniform(0, edge, (1500, 3))
    box = {"x": (0, edge), "y": (0, edge), "z": (0, edge)}
    if dimension == 2:
        position[:, 2] = 0.0
        del box["z"]
    plane = "xyz"[:dimension]
    assert not said(
        position, diameter=diameter, box=box, periodic=plane, dimension=dimension, **SCALED
    )


def test_lattices_and_two_layers_do_not_warn(chute):
    position, diameter, _ = chute
    sites = np.stack(np.meshgrid(*[np.arange(8.0)] * 3), axis=-1).reshape(-1, 3)
    for distance in (1.0, 2.0, 10.0, 100.0):
        assert not said(distance * sites, diameter=np.ones(512), **SCALED)
    above = np.concatenate([position, position + np.array([0, 0, 60.0])])
    assert not said(above, diameter=np.tile(diameter, 2), **SCALED)


K = np.arange(8.0)
CUBIC = np.stack(np.meshgrid(K, K, K), axis=-1).reshape(-1, 3)
SQUARE = np.stack(np.meshgrid(*[np.arange(20.0)] * 2, [0.0]), axis=-1).reshape(-1, 3)
HEXAGONAL = SQUARE * [1.0, np.sqrt(0.75), 1.0] + 0.5 * (SQUARE[:, [1]] % 2) * [1.0, 0.0, 0.0]
FACES = np.concatenate([CUBIC, *(CUBIC + 0.5 * (1 - np.eye(3)[k]) for k in range(3))])
LATTICES = {  # with a distance of 1 between neighbours
    "cubic": CUBIC,
    "body-centred": np.concatenate([CUBIC, CUBIC + 0.5]) / np.sqrt(0.75),
    "face-centred": FACES * np.sqrt(2),
    "square": SQUARE,
    "hexagonal": HEXAGONAL,
}


@pytest.mark.parametrize("name", LATTICES)
@pytest.mark.parametrize("jitter", [0.003, 0.02, 0.05])
def test_loose_lattices_with_scatter_do_not_warn(name, jitter):
    """Grains that a simulation starts from, at distances near which radii as diameters would be."""
    sites = LATTICES[name]
    plane = np.array([1.0, 1.0, np.ptp(sites[:, 2]) > 0])
    scatter = jitter * np.random.default_rng(6).uniform(-1, 1, sites.shape) * plane
    for distance in (1.9, 1.97, 2.04, 10.0):
        options = SCALED | {"dimension": int(plane.sum())}
        place = distance * (sites + scatter)
        assert not said(place, diameter=np.ones(len(sites)), **options)


@pytest.mark.parametrize("sample", ["plane_shear", "shear_cell_0.1", "hopper_6", "suspension"])
def test_radii_as_diameters_warn_in_other_samples(sample):
    """The most ordered and the loosest packings of the samples."""
    ds = xcg.datasets.open(sample).isel(time=0).load()
    options = SCALED | {"dimension": ds.attrs["dimension"], "plane": ds.attrs.get("plane")}
    (message,) = said(ds.position.values, diameter=0.5 * ds.diameter.values, **options)
    assert "radii were given as diameters" in message


@pytest.mark.parametrize("apart", [0.3, 0.5, 0.7])
def test_rods_of_spheres_that_overlap_do_not_warn(apart):
    rng = np.random.default_rng(2)
    middle = np.stack(np.meshgrid(*[np.arange(0.0, 12.0, 2.5)] * 3), axis=-1).reshape(-1, 3)
    axis = rng.normal(size=middle.shape)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    spheres = np.concatenate([middle + k * apart * axis for k in (-1, 0, 1)])
    assert not said(spheres, diameter=np.ones(len(spheres)), **SCALED)


# --- the box ---------------------------------------------------------------------------------------------


def test_many_grains_in_one_place_end_the_search_for_a_region():
    """Such as grains that wait at the origin to be inserted: no region around them holds few."""
    place = np.random.default_rng(0).uniform(0, 60, (20_000, 3))
    place[9_500:10_500] = place[10_000]
    ds = xcg.scene_from_arrays(place, diameter=np.ones(20_000))
    assert ds.sizes["particle"] == 20_000


@pytest.mark.parametrize("order", [[1, 2, 0], [2, 0, 1], [0, 2, 1]])
def test_axes_in_another_order_than_the_box_warn(order, chute):
    position, diameter, box = chute
    flat = position * [1.0, 1.0, 0.2]  # 20 x 10 x 4
    box = np.array([box[0], box[1], CORNER[2] * 0.2 + [0.0, 5.0]])
    small = 0.5 * diameter
    (message,) = said(flat[:, order], diameter=small, box=box, **SCALED)
    assert "components are taken in the order" in message
    named = message.partition("in the order ")[2].partition(":")[0].split(", ")
    back = flat[:, order][:, ["xyz".index(axis) for axis in named]]
    assert (back.min(axis=0) > box[:, 0] - 1).all()
    assert (back.max(axis=0) < box[:, 1] + 1).all()
    assert not said(flat, diameter=small, box=box, **SCALED)


def test_grains_outside_the_box_warn(chute):
    position, diameter, box = chute
    for moved in (position + np.array([0, 0, 500.0]), position * [1, 1, 10.0]):
        (message,) = said(moved, diameter=diameter, box=box, **SCALED)
        assert "outside the box along 'z'" in message
    wrapped = position + np.array([500.0, 0, 0])  # another image
    assert not said(wrapped, diameter=diameter, box=box, periodic="xy", **SCALED)
    escaped = position.copy()
    escaped[:5, 2] = -1e4  # some fall through the bottom
    assert not said(escaped, diameter=diameter, box=box, periodic="xy", **SCALED)


def test_a_box_in_another_unit_warns(chute):
    position, diameter, box = chute
    (message,) = said(position, diameter=diameter, box=box / 1000, periodic="xyz", **SCALED)
    assert "times the volume of the box" in message
    (message,) = said(position, diameter=diameter, box=box / 1000, **SCALED)
    assert "outside the box along 'x'" in message


@pytest.mark.parametrize("share", [0.9, 0.6, 0.3])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_period_shorter_than_the_packing_warns(share, axis, chute):
    position, diameter, box = chute
    short = box.copy()
    short[axis, 1] = box[axis, 0] + share * (box[axis, 1] - box[axis, 0])
    (message,) = said(position, diameter=diameter, box=short, periodic="xy", **SCALED)
    assert "are moved inside" in message
    assert (
        f"along {'xyz'[axis]!r} with a length of {short[axis, 1] - short[axis, 0]:.4g}" in message
    )
    assert not said(position, diameter=diameter, box=box, periodic="xy", **SCALED)


def test_positions_that_were_not_wrapped_do_not_warn(chute):
    position, diameter, box = chute
    period = np.diff(box, axis=1)[:, 0] * [1, 1, 0]
    images = np.random.default_rng(7).integers(-3, 4, position.shape)
    for moved in (position + period * images, position + 0.4 * period):
        assert not said(moved, diameter=diameter, box=box, periodic="xy", **SCALED)


def test_a_layer_taken_as_a_volume_warns(layer):
    position, diameter = layer
    (message,) = said(position, diameter=diameter, **SCALED)
    assert "z = 0" in message
    assert "give dimension=2 " in message
    (message,) = said(position[:, [0, 2, 1]], diameter=diameter, **SCALED)
    assert "dimension=2, plane='xz'" in message
    assert not said(position, diameter=diameter, dimension=2, **SCALED)
    (message,) = said(position[:, [0, 2, 1]], diameter=diameter, dimension=2, **SCALED)
    assert "give plane='xz'" in message
    assert not said(position[:, [0, 2, 1]], diameter=diameter, dimension=2, plane="xz", **SCALED)
    # a box as thick as the grains is meant as their layer
    assert not said(position, diameter=diameter, box={"z": (-0.6, 0.6)}, **SCALED)


def test_a_volume_taken_as_a_layer_warns(chute, tmp_path):
    position, diameter, box = chute
    (message,) = said(position, diameter=diameter, box=box, dimension=2, periodic="xy", **SCALED)
    assert "leave dimension=2 out" in message
    table = pd.DataFrame(position, columns=["x", "y", "z"]).assign(diameter=diameter)
    table.to_csv(tmp_path / "p.csv", index=False)
    with pytest.warns(xcg.SceneWarning, match="leave dimension=2 out"):
        xcg.open_scene(tmp_path / "p.csv", dimension=2, **SCALED)
    # a thickness that spans the grains is meant
    thickness = float(np.ptp(position[:, 2]))
    assert not said(position, diameter=diameter, dimension=2, thickness=thickness, **SCALED)
    uneven = position * [1, 1, 0] + [0, 0, 1] * diameter[:, None] / 2  # spheres that lie on a floor
    assert not any(
        "one layer" in text for text in said(uneven, diameter=diameter, dimension=2, **SCALED)
    )


# --- masses, times, headers ------------------------------------------------------------------------------


@pytest.mark.parametrize(("density", "warns"), [(2.5, True), (2500.0, False), (2.5e6, True)])
def test_densities_of_no_solid_warn_in_si(density, warns, chute):
    position, diameter, _ = chute
    found = said(1e-3 * position, diameter=1e-3 * diameter, density=density)
    assert len(found) == warns
    assert not warns or f"density of the grains is {density:.4g} kg m-3" in found[0]
    assert not said(position, diameter=diameter, density=density, units="reduced")


def motion(factor, *, wraps=False):
    """Grains of a shear flow in two steps, whose displacements are `factor` velocities times 0.01."""
    rng = np.random.default_rng(3)
    position = rng.uniform(0, 10, (300, 3))
    velocity = np.zeros((300, 3))
    velocity[:, 0] = position[:, 2] + rng.normal(0, 0.5, 300)
    after = position + 0.01 * factor * velocity
    if wraps:
        after[:, 0] %= 10.0
    frame = {"particle_id": np.arange(300), "velocity": velocity}
    return frame | {"position": position}, frame | {"position": after}


@pytest.mark.parametrize("factor", [0.001, 0.1, 10.0, 1000.0])
def test_displacements_unlike_velocities_warn(factor):
    first, second = motion(factor)
    with pytest.warns(xcg.SceneWarning, match=re.escape(f"move {factor:.3g} times their velocity")):
        check_motion(first, second, 0.01, Lattice.of({}, ""))


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_displacements_like_velocities_do_not_warn(factor):
    check_motion(*motion(factor), 0.01, Lattice.of({}, ""))


def test_motion_through_a_period_does_not_warn():
    """Whole periods are lost from positions, so that they seem to move less."""
    box = {"box": np.array([[0.0, 10.0]] * 3)}
    first, _ = motion(1.0)
    first["velocity"][:] = [11.0, 0.0, 0.0]
    moved = first | {"position": (first["position"] + np.array([11.0, 0, 0])) % 10.0}
    check_motion(first, moved, 1.0, Lattice.of(box, "xyz"))
    # and a bounded motion, as of a gas between walls
    rng = np.random.default_rng(4)
    first["velocity"] = rng.normal(size=(300, 3))
    mixed = first | {
        "position": rng.uniform(0, 10, (300, 3)),
        "velocity": rng.normal(size=(300, 3)),
    }
    check_motion(first, mixed, 100.0, Lattice.of({}, ""))


def test_a_timestep_of_the_interval_of_dumps_warns(tmp_path):
    rng = np.random.default_rng(5)
    start = rng.uniform(0.2, 0.8, (40, 3))
    velocity = rng.normal(size=(40, 3))
    for number in (0, 100, 200):
        place = start + 1e-5 * number * velocity
        rows = [
            f"{k + 1} {' '.join(f'{v:.8g}' for v in (*place[k], *velocity[k]))} 0.001"
            for k in range(40)
        ]
        text = dumps.dump_text(rows, columns="id x y z vx vy vz radius", step=number)
        dumps.write(tmp_path / f"p.{number}.dump", text)
    files = str(tmp_path / "p.*.dump")
    options = {"units": "si", "density": 2500.0}
    with pytest.warns(xcg.SceneWarning, match="timestep= is the time of one step"):
        xcg.open_scene(files, timestep=1e-3, **options)
    xcg.open_scene(files, timestep=1e-5, **options)


def test_periodic_axes_against_the_header_warn():
    folder = xcg.datasets._FOLDERS[1] / "lammps_chute"
    path = folder / "particles.00050000.dump.gz"
    with pytest.warns(xcg.SceneWarning, match="periodic='xyz', but the header .* names 'xy'"):
        xcg.open_scene(path, periodic="xyz")
    xcg.open_scene(path, periodic="y")  # fewer may be meant


@pytest.mark.parametrize("prefix", ["half", "whole"])
@pytest.mark.parametrize("columns", [{"volume": 2.0944}, {"mass": 2094.4, "density": 1000.0}])
def test_volumes_that_are_not_those_of_the_axes_are_named(prefix, columns):
    factor = {"half": 1.0, "whole": 2.0}[prefix]
    names = {
        f"{prefix}_axis_{a}": factor * length
        for a, length in zip("xyz", (0.5, 1.0, 1.0), strict=True)
    }
    table = pd.DataFrame({"id": [1], "x": [0.0], "y": [0.0], "z": [0.0]}).assign(**columns)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        xcg.scene_from_table(table.assign(**names))
    other = {"half": "whole", "whole": "half"}[prefix]
    mistaken = {name.replace(prefix, other): length for name, length in names.items()}
    with pytest.warns(
        xcg.SceneWarning, match=f"times those of the half-axes .* names=.*'{prefix}_axis_x'"
    ):
        xcg.scene_from_table(table.assign(**mistaken))


@pytest.mark.parametrize("periodic", ["", "xy"])
def test_a_box_in_a_smaller_unit_than_positions_is_named(periodic):
    ds = xcg.datasets.random_scene(100, seed=1)
    position = ds.position.values[0]
    diameter = ds.diameter.values[0]
    given = {"diameter": diameter, "density": 2500.0, "periodic": periodic}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        xcg.scene_from_arrays(
            position, box=[[0, 60], [0, 60], [0, 1e4]], **given
        )  # a tall, wide one
    with pytest.warns(
        xcg.SceneWarning, match="times or more as long as the extent .* units of box"
    ):
        xcg.scene_from_arrays(position, box=[[0, 5000]] * 3, **given)


def test_grains_with_an_axis_may_have_larger_volumes_than_spheres_of_their_width():
    rng = np.random.default_rng(1)
    director = rng.normal(size=(30, 3))
    director /= np.linalg.norm(director, axis=1, keepdims=True)
    rods = {
        "position": rng.uniform(0, 20, (30, 3)),
        "director": director,
        "density": 1000.0,
        "units": "reduced",
    }
    volume = np.pi / 4 * 0.2**2 * 2.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        xcg.scene_from_arrays(**rods, diameter=np.full(30, 0.2), volume=np.full(30, volume))
    with pytest.warns(xcg.SceneWarning, match="radii in place of diameters"):
        xcg.scene_from_arrays(
            **rods, diameter=np.full(30, 0.1), volume=np.full(30, np.pi / 6 * 0.2**3)
        )
