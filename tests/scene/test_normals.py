"""Normals of contacts in the data, compared with the lines of centres of spheres."""

from __future__ import annotations

import numpy as np
import pytest

import xcg
from xcg.common.messages import SceneError, SceneWarning
from xcg.scene.contacts import Contacts
from xcg.scene.frame import frame_of
from xcg.scene.lattice import Lattice

_FORCE = np.array([0.5, 0.0, -7.0])  # on the lower of two spheres, one above the other


def _scene(normal, **options):
    position = np.array([[0, 0, 0], [0, 0, 0.98], [0, 0, 1.96]])
    return xcg.scene_from_arrays(
        position,
        diameter=[1.0, 1.0, 1.0],
        density=1.0,
        contact_i=[0, 1],
        contact_j=[1, 2],
        contact_force=[_FORCE, _FORCE],
        contact_normal=np.broadcast_to(np.asarray(normal, float), (2, 3)).copy(),
        **options,
    )


def _normal_force(scene):
    contacts = Contacts.of(
        frame_of({k: v.values for k, v in scene.data_vars.items()}, 0), Lattice.of({}, "")
    )
    return contacts.normal_force


def test_unit_normals_are_taken_as_they_are():
    tilted = np.array([np.sin(0.05), 0.0, -np.cos(0.05)])  # 3 degrees, as of a rough surface
    np.testing.assert_array_equal(_scene(tilted).contact_normal[0], [tilted, tilted])


@pytest.mark.parametrize("length", [0.5, 2.0, 1.01])
def test_normals_of_another_length_are_scaled(length):
    with pytest.warns(SceneWarning, match=f"another length than 1 .*: {length:g}"):
        scene = _scene([0, 0, -length])
    np.testing.assert_allclose(_normal_force(scene), 7.0)


def test_normals_of_zero_follow_from_positions():
    with pytest.warns(SceneWarning, match="2 of 2 contacts is zero"):
        scene = _scene([0, 0, 0])
    np.testing.assert_allclose(_normal_force(scene), 7.0)


def test_opposite_normals_are_turned():
    with pytest.warns(SceneWarning, match="from contact_i to contact_j"):
        scene = _scene([0, 0, 1])
    np.testing.assert_allclose(_normal_force(scene), 7.0)


@pytest.mark.parametrize("normal", [[1, 0, 0], [0.1, 0, -1], [0, 0.3, 1]])
def test_normals_across_the_line_of_centres_are_refused(normal):
    unit = np.asarray(normal) / np.linalg.norm(normal)
    with pytest.raises(SceneError, match=r"2 of 2 .* row 0, .*drop its columns"):
        _scene(unit)


def test_normals_that_are_no_numbers_are_refused():
    with pytest.raises(SceneError, match="'contact_normal' is not finite in row 0"):
        _scene([np.nan, 0, -1])


def test_normals_of_other_shapes_are_not_compared():
    scene = _scene([1, 0, 0], volume=[0.4, 0.4, 0.4])
    np.testing.assert_array_equal(scene.contact_normal[0, 0], [1, 0, 0])


def test_normals_follow_the_image_that_touches():
    normal = [[0, 0, 1]]
    scene = xcg.scene_from_arrays(
        [[0, 0, 0.01], [0, 0, 4.99]],
        diameter=1.0,
        density=1.0,
        box=[[0, 5]] * 3,
        periodic="z",
        contact_i=[0],
        contact_j=[1],
        contact_force=[[0, 0, 7.0]],
        contact_normal=normal,
    )
    np.testing.assert_array_equal(scene.contact_normal[0], normal)
