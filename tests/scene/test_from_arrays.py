"""Values that do not change are given once for all steps."""

from ast import literal_eval

import numpy as np
import pytest

import xcg
from xcg import SceneError

RNG = np.random.default_rng(0)
R = RNG.uniform(0, 4, (5, 3))
D = RNG.uniform(0.5, 1.0, 5)


def test_values_given_once_equal_values_for_each_step():
    own = RNG.uniform(size=(5, 3))
    once = xcg.scene_from_arrays(
        [R, R + 0.1], diameter=D, density=2500.0, species=[1, 1, 2, 2, 1], spin=own
    )
    each = xcg.scene_from_arrays(
        [R, R + 0.1],
        diameter=[D, D],
        density=2500.0,
        species=[[1, 1, 2, 2, 1]] * 2,
        spin=[own, own],
    )
    assert once.identical(each)


def test_ids_given_once_hold_for_all_steps():
    ids = [9, 7, 5, 3, 1]
    ds = xcg.scene_from_arrays([R, R + 0.1], particle_id=ids, diameter=D, density=2500.0)
    assert ds.particle_id.values.tolist() == [sorted(ids)] * 2
    np.testing.assert_array_equal(ds.diameter.values, [D[::-1]] * 2)


def test_ids_that_differ_between_steps_raise():
    ids = [[1, 2, 3, 4, 5], [1, 2, 3, 5, 4]]
    with pytest.raises(
        SceneError,
        match=r"'diameter' is given once for 2 steps, and the ids of step 1 are not those of",
    ):
        xcg.scene_from_arrays([R, R + 0.1], particle_id=ids, diameter=D, density=2500.0)


def test_steps_of_different_length_raise():
    with pytest.raises(
        SceneError,
        match=r"'diameter' is given once for 2 steps, and the steps have \[4, 5\] particles",
    ):
        xcg.scene_from_arrays([R, R[:4]], diameter=D, density=2500.0)


def test_contacts_must_be_given_for_each_step():
    contacts = {
        "contact_i": [0],
        "contact_j": [1],
        "contact_force": [[1.0, 0, 0]],
        "contact_point": [[0.0, 0, 0]],
    }
    with pytest.raises(SceneError, match="different numbers of steps"):
        xcg.scene_from_arrays([R, R + 0.1], diameter=D, density=2500.0, **contacts)


def test_padding_beside_a_variable_of_another_length_raises():
    with pytest.raises(xcg.SceneError, match="has shape"):
        xcg.scene_from_arrays(np.zeros((2, 3)), diameter=[1.0, 1.0], density=1.0, particle_id=[-1])


def test_rows_are_no_ids_where_a_particle_is_removed():
    places = np.array([[0.1, 0.5, 0.5], [0.3, 0.5, 0.5], [0.5, 0.5, 0.5]])
    sizes = [np.full(3, 0.1), np.full(2, 0.1)]
    removed = [places, places[1:] + np.array([0.01, 0.0, 0.0])]
    options = {"density": 1.0, "time": [0.0, 0.01]}
    ds = xcg.scene_from_arrays(removed, diameter=sizes, **options)
    with pytest.raises(xcg.SceneError, match=r"give particle_id= to xcg\.scene_from_arrays"):
        ds.cg.derive("velocity")
    ids = [[0, 1, 2], [1, 2]]
    ds = xcg.scene_from_arrays(removed, diameter=sizes, particle_id=ids, **options)
    np.testing.assert_allclose(ds.cg.derive("velocity").velocity[0, 1:, 0], 1.0)
    added = [places[:2], places + np.array([0.01, 0.0, 0.0])]
    ds = xcg.scene_from_arrays(added, diameter=sizes[::-1], **options)
    np.testing.assert_allclose(ds.cg.derive("velocity").velocity[0, :2, 0], 1.0)


@pytest.mark.parametrize(
    ("units", "gravity", "warns"),
    [
        ({"length": 1e-3}, (0, 0, -9810.0), True),
        ({"length": 1e-3}, (0, 0, -9.81), False),
        ({"length": 1e-3}, (0, 0, -981.0), False),  # of a centrifuge
        ({"length": 1e-3}, (6936.7, 0, -6936.7), True),  # of a slope
        ("cgs", (0, -981.0, 0), True),
        ({"length": 1e-3, "time": 1e-3}, (0, 0, -0.00981), True),
        ({"mass": 1e-3}, (0, 0, -9.81), False),
        ("reduced", (0, 0, -9.81), False),
        (None, (0, 0, -9.81), False),
    ],
)
def test_gravity_in_the_units_of_the_data_warns(units, gravity, warns, recwarn):
    xcg.scene_from_arrays(R, diameter=D, density=2500.0, units=units, gravity=gravity)
    about_gravity = [str(w.message) for w in recwarn if "gravity" in str(w.message)]
    assert len(about_gravity) == warns
    if warns:
        length = float(np.linalg.norm(literal_eval(about_gravity[0].split("give gravity=")[1])))
        assert length == pytest.approx(9.81, rel=1e-4)
