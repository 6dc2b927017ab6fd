"""The accessible fraction averaged along axes: closed forms of areas and chords, and brute force over points."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.stats.qmc import Sobol

import xcg
from xcg.compiled.geometry import MOST_CROSSINGS
from xcg.fields.accessible import fraction_at
from xcg.fields.grids import sections
from xcg.fields.grids.sections import AveragedFraction, Span, open_ends

KERNELS = [
    xcg.Lucy(0.75, dimension=3),
    xcg.Gaussian(0.5, dimension=3),
    xcg.Heaviside(1.5, dimension=3),
]
LUCY = KERNELS[0]
CUTOFF = 1.5
PROFILE, MAP = 2e-4, 1e-3  # the errors that docs/walls.md states
Z = np.linspace(-2.0, 7.0, 46)
SIDE = xcg.Cylinder((0.1, 0, 0), (0, 0, 1), 2.5)
FLOOR = xcg.Plane((0, 0, 0), (0, 0, 1))
LID = xcg.Plane((0, 0, 5), (0, 0, -1))
WHOLE = Span(-4.0, 4.0, 8.0)


def along_z(walls, kernel=LUCY, z=Z):
    nodes = np.stack([0 * z, 0 * z, z], axis=1)
    average = AveragedFraction(nodes, walls, kernel, [2], {0: WHOLE, 1: WHOLE})
    return average.values(lambda _: None)


def smeared(share, kernel, z=Z, kinks=()):
    """Integrate the kernel's marginal on a line times a share, by Gauss's rule between kinks."""
    x, w = leggauss(40)
    out = np.zeros(len(z))
    for n, middle in enumerate(z):
        inner = [kink for kink in kinks if abs(kink - middle) < kernel.cutoff]
        edges = np.sort([middle - kernel.cutoff, middle, middle + kernel.cutoff, *inner])
        for low, high in pairwise(edges):
            place = low + (high - low) * (x + 1) / 2
            value = kernel.value(place - middle, seen=1) * share(place)
            out[n] += (w * value).sum() * (high - low) / 2
    return out


def surface(corners, faces):
    """Surface of flat faces, each a list of corners, in triangles from its first corner."""
    rows = [[face[0], *pair] for face in faces for pair in pairwise(face[1:])]
    return xcg.Surface(np.array(corners, float), np.array(rows))


def tube(sides, radius, low, high, *, lids):
    """Prism with normals to the inside."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    corners = [[*place, z] for z in (low, high) for place in ring]
    faces = [[k, sides + k, sides + (k + 1) % sides, (k + 1) % sides] for k in range(sides)]
    if lids:
        faces += [[*range(sides)], [*range(2 * sides - 1, sides - 1, -1)]]
    return surface(corners, faces)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda k: k.name)
def test_a_silo_is_the_area_of_a_circle_times_the_fraction_beside_its_floor(kernel):
    points = np.stack([0 * Z, 0 * Z, Z], axis=1)
    beside = fraction_at(points, [FLOOR], kernel) + fraction_at(points, [LID], kernel) - 1
    expected = np.pi * 2.5**2 / 64 * beside
    np.testing.assert_allclose(along_z([SIDE, FLOOR, LID], kernel), expected, atol=PROFILE)


@pytest.mark.parametrize("direction", [(0, 1, 0), (1, 0, 0), (1, -2, 0)])
def test_a_horizontal_drum_is_its_chord_smeared_along_the_height(direction):
    drum = xcg.Cylinder((0, 0, 2.5), direction, 2.0)
    ends = np.linalg.norm(direction) / np.abs(direction).max()

    def share(z):
        chord = 2 * np.sqrt(np.maximum(0.0, 4.0 - (z - 2.5) ** 2))
        return chord * ends * 8 / 64

    z = np.linspace(0.2, 4.8, 21)
    expected = smeared(share, LUCY, z, (0.5, 4.5))
    box = {0: Span(-8.0, 8.0, 16.0), 1: Span(-8.0, 8.0, 16.0)}
    nodes = np.stack([0 * z, 0 * z, z], axis=1)
    found = AveragedFraction(nodes, [drum], LUCY, [2], box).values(lambda _: None)
    np.testing.assert_allclose(found, expected / 2, atol=PROFILE)


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4])
def test_four_planes_are_the_area_of_their_rectangle(angle):
    c = np.cos(angle)
    s = np.sin(angle)
    walls = [
        xcg.Plane((sign * 2 * c, sign * 2 * s, 0), (-sign * c, -sign * s, 0)) for sign in (1, -1)
    ]
    walls += [
        xcg.Plane((-sign * 1.5 * s, sign * 1.5 * c, 0), (sign * s, -sign * c, 0))
        for sign in (1, -1)
    ]
    np.testing.assert_allclose(along_z(walls), 4.0 * 3.0 / 64, atol=PROFILE)


@pytest.mark.parametrize("slope", [0.2, 1.0])
def test_a_tilted_plane_is_a_ramp_smeared_along_the_height(slope):
    tilted = xcg.Plane((0, 0, 2), (-slope, 0, 1))
    expected = smeared(
        lambda z: np.clip((z - 2) / slope / 8 + 0.5, 0, 1), LUCY, Z, (2 - 4 * slope, 2 + 4 * slope)
    )
    np.testing.assert_allclose(along_z([tilted]), expected, atol=PROFILE)


def test_a_pipe_in_a_silo_leaves_a_ring():
    pipe = xcg.Cylinder((-0.5, 0.2, 0), (0, 0, 1), 0.8, inside=False)
    expected = np.pi * (2.5**2 - 0.8**2) / 64
    np.testing.assert_allclose(along_z([SIDE, pipe]), expected, atol=PROFILE)


@pytest.mark.parametrize("lids", [True, False])
@pytest.mark.parametrize("sides", [5, 96])
def test_a_tube_of_triangles_is_the_area_of_its_polygon(sides, lids):
    """Without lids it goes on beyond its rims."""
    wall = tube(sides, 2.5, 0.0, 5.0, lids=lids)
    area = sides / 2 * np.sin(2 * np.pi / sides) * 2.5**2
    points = np.stack([0 * Z, 0 * Z, Z], axis=1)
    beside = fraction_at(points, [FLOOR], LUCY) + fraction_at(points, [LID], LUCY) - 1
    expected = area / 64 * (beside if lids else 1.0)
    np.testing.assert_allclose(along_z([wall]), expected, atol=PROFILE)


@pytest.mark.parametrize("inside", [True, False])
def test_a_pyramid_is_its_square_section_smeared_along_the_height(inside):
    corners = [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0], [0, 0, 5]]
    faces = [[0, 1, 2, 3], [0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]]
    wall = surface(corners, faces if inside else [face[::-1] for face in faces])

    def share(z):
        inner = np.where((z > 0) & (z < 5), 16 * (1 - z / 5) ** 2, 0.0) / 64
        return inner if inside else 1 - inner

    expected = smeared(share, LUCY, Z, (0.0, 5.0))
    np.testing.assert_allclose(along_z([wall]), expected, atol=PROFILE)


def test_a_funnel_without_lids_is_open_above_its_cone_and_through_its_outlet():
    """Four faces from a wide square at z = 3 down to a narrow one at z = 0."""
    corners = [
        [s * x, s * y, z]
        for s, z in ((1, 0), (4, 3))
        for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    faces = [[k, 4 + k, 4 + (k + 1) % 4, (k + 1) % 4] for k in range(4)]
    expected = smeared(lambda z: np.clip(2 + 2 * z, 2, 8) ** 2 / 64, LUCY, Z, (0.0, 3.0))
    np.testing.assert_allclose(along_z([surface(corners, faces)]), expected, atol=PROFILE)


def test_rays_cross_more_triangles_than_those_from_a_node():
    """Shelves, each a closed box across the whole section."""
    gaps = np.arange(12)
    assert 2 * len(gaps) > MOST_CROSSINGS
    corners = []
    faces = []
    for gap in gaps:
        first = len(corners)
        corners += [
            [x, y, gap + z] for z in (0.0, 0.4) for x, y in ((-5, -5), (5, -5), (5, 5), (-5, 5))
        ]
        sides = [[k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k] for k in range(4)]
        faces += [[first + k for k in face] for face in ([3, 2, 1, 0], [4, 5, 6, 7], *sides)]
    z = np.array([3.0, 4.5, 5.7])
    shelves = smeared(lambda z: np.where(z % 1 < 0.4, 0.0, 1.0), LUCY, z, [*gaps, *(gaps + 0.4)])
    np.testing.assert_allclose(along_z([surface(corners, faces)], z=z), shelves, atol=PROFILE)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda k: k.name)
@pytest.mark.parametrize("order", ["xz", "zx"])
def test_a_map_of_a_cylinder_is_its_chord_smeared_across(kernel, order):
    x = np.linspace(-4.1, 4.2, 30)
    nodes = np.stack([x, 0 * x, 0 * x + 3.0], axis=1)
    seen = ["xyz".index(a) for a in order]
    average = AveragedFraction(nodes, [SIDE], kernel, seen, {1: WHOLE})

    def share(place):
        return 2 * np.sqrt(np.maximum(0.0, 2.5**2 - (place - 0.1) ** 2)) / 8

    expected = smeared(share, kernel, x, (-2.4, 2.6))
    np.testing.assert_allclose(average.values(lambda _: None), expected, atol=MAP)


@pytest.mark.parametrize("normal", [(1, 0, 0), (0, 0, 1), (1, 0, 2)])
def test_a_map_beside_a_plane_is_the_fraction_of_the_marginal(normal):
    """Walls that vary along the averaged axis elsewhere leave the fraction beside a plane."""
    far = xcg.Plane((0, -3, 0), (0, 1, 0))
    plane = xcg.Plane((0.3, 0, 0.2), normal)
    rng = np.random.default_rng(1)
    nodes = rng.uniform(-2, 2, (40, 3))
    average = AveragedFraction(nodes, [plane, far], LUCY, [0, 2], {1: WHOLE})
    expected = fraction_at(nodes, [plane], LUCY) * 7 / 8
    np.testing.assert_allclose(average.values(lambda _: None), expected, atol=MAP)


@pytest.mark.parametrize("seen", [[2], [0], [0, 2], [1, 2]])
def test_any_walls_equal_brute_force(seen):
    walls = [
        tube(7, 3.0, -3.0, 3.0, lids=True),
        xcg.Cylinder((0.3, 0, 0), (0.2, 0.5, 1), 1.0, inside=False),
        xcg.Plane((0, 0, -2), (0.3, -0.2, 1)),
    ]
    averaged = {k: WHOLE for k in range(3) if k not in seen}
    nodes = np.random.default_rng(2).uniform(-3.5, 3.5, (6, 3))
    found = AveragedFraction(nodes, walls, LUCY, seen, averaged).values(lambda _: None)
    sample = Sobol(3, seed=3).random_base2(16)
    for node, fraction in zip(nodes, found, strict=True):
        points = -4.0 + 8.0 * sample
        reach = node[seen] + CUTOFF * (2.0 * sample[:, seen] - 1.0)
        points[:, seen] = reach
        weight = LUCY.value(np.linalg.norm(reach - node[seen], axis=1), seen=len(seen))
        is_open = np.all([wall.distance(points) > 0 for wall in walls], axis=0)
        assert fraction == pytest.approx((weight * is_open).sum() / weight.sum(), abs=3e-3)


def test_averages_over_all_axes_are_the_accessible_volume():
    average = AveragedFraction(
        np.zeros((1, 3)),
        [SIDE, FLOOR, LID],
        LUCY,
        [],
        {0: WHOLE, 1: WHOLE, 2: Span(0.0, 5.0, 10.0)},
    )
    np.testing.assert_allclose(
        average.values(lambda _: None), np.pi * 2.5**2 * 5 / (64 * 10), atol=PROFILE
    )


def test_a_map_in_slabs_equals_that_in_one_piece(monkeypatch):
    x, z = np.meshgrid(np.linspace(-6, 6, 13), np.linspace(-1, 2, 4), indexing="ij")
    nodes = np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1)
    walls = [xcg.Cylinder((0, 0, 0), (1, 0, 0), 2.5), xcg.Plane((-5, 0, 0), (1, 0, 0))]
    whole = AveragedFraction(nodes, walls, LUCY, [0, 2], {1: WHOLE})
    assert len(whole._slabs) == 1
    monkeypatch.setattr(sections, "_MOST_CELLS", 2**13)
    slabs = AveragedFraction(nodes, walls, LUCY, [0, 2], {1: WHOLE})
    assert len(slabs._slabs) == 3
    finished = []
    np.testing.assert_allclose(
        slabs.values(finished.append), whole.values(lambda _: None), atol=MAP
    )
    assert sum(finished) == slabs.ray_count


def test_ends_of_open_parts_are_where_the_side_of_a_wall_changes():
    walls = [SIDE, FLOOR, xcg.Plane((0, 0, 4), (0.4, 0, -1)), tube(6, 2.0, 1.0, 3.0, lids=True)]
    starts = np.random.default_rng(4).uniform(-3, 3, (50, 3)) * [1, 1, 0] + [0, 0, -1.0]
    place, change = open_ends(starts, walls, 2, 7.0)
    distance = (np.arange(7000) + 0.5) / 1000
    for start, ends, steps in zip(starts, place, change, strict=True):
        points = start + distance[:, None] * [0, 0, 1]
        is_open = np.all([wall.distance(points) > 0 for wall in walls], axis=0)
        found = ((ends <= distance[:, None]) * steps).sum(axis=1)
        assert np.count_nonzero(found != is_open) <= 2


@pytest.mark.parametrize("kind", ["plane", "cylinder", "triangles"])
def test_walls_in_other_axes_are_as_far_from_the_same_points(kind):
    wall = {
        "plane": xcg.Plane((1, 2, 3), (1, -1, 0.5)),
        "cylinder": xcg.Cylinder((1, 2, 3), (0.2, 1, 0), 1.5, inside=False),
        "triangles": tube(5, 2.0, 0.0, 3.0, lids=True),
    }[kind]
    frame = xcg.Rotated(z=(1, 1, 0.5), x=(0, 1, -1), origin=(0.5, 0, -1))
    points = np.random.default_rng(5).uniform(-3, 3, (60, 3))
    turned = wall.in_axes(frame.axes, np.array(frame.origin))
    inner = (points - frame.origin) @ frame.axes.T
    np.testing.assert_allclose(turned.distance(inner), wall.distance(points), atol=1e-12)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_cylinder_and_a_cylindrical_frame_have_one_axis(axis):
    direction = np.eye(3)["xyz".index(axis)]
    points = np.random.default_rng(6).uniform(-3, 3, (20, 3))
    wall = xcg.Cylinder(point=(1, 2, 3), axis=axis, radius=1.5)
    frame = xcg.Cylindrical(axis=axis, origin=(1, 2, 3)).rotated
    across = ((points - frame.origin) @ frame.axes.T)[:, :2]
    np.testing.assert_allclose(wall.distance(points), 1.5 - np.hypot(*across.T), atol=1e-12)
    same = xcg.Cylinder((1, 2, 3), tuple(3 * direction), 1.5)
    np.testing.assert_array_equal(wall.distance(points), same.distance(points))
