"""Contacts that are listed from both sides, with forces that are not quite opposite, count once."""

import warnings

import numpy as np
import pytest

import xcg
from xcg import SceneError, SceneWarning

NAMES = ("contact_i", "contact_j", "contact_force", "contact_point")
EPS = [0.0, 1e-6, 1e-5, 1e-4, 3e-4, 1e-2, 0.1, 0.2]  # at most a quarter of the larger force


@pytest.fixture(scope="module", params=[3, 2])
def scene(request):
    return xcg.datasets.random_scene(80, seed=7, dimension=request.param)


def listed(scene):
    there = scene.contact_i.values[0] >= 0
    there &= scene.contact_j.values[0] >= 0
    return {name: scene[name].values[0][there] for name in NAMES}


def rebuild(scene, contacts, **options):
    options = {"dimension": int(scene.attrs["dimension"]), "thickness": scene.attrs.get("thickness")} | options
    edges = np.stack([scene.attrs["box_lower"], scene.attrs["box_upper"]], axis=1)
    return xcg.scene_from_arrays(
        scene.position.values[0], velocity=scene.velocity.values[0], diameter=scene.diameter.values[0], density=2500.0,
        box=edges, periodic=scene.attrs["periodic"], **options, **contacts,
    )  # fmt: skip


def from_both_sides(contacts, eps, rng):
    """List each contact again from the other side, its force off by up to a share `eps` in a direction of its own."""
    force = contacts["contact_force"]
    push = rng.normal(size=force.shape)
    push *= np.linalg.norm(force, axis=1, keepdims=True) / np.linalg.norm(push, axis=1, keepdims=True)
    other = {
        "contact_i": contacts["contact_j"],
        "contact_j": contacts["contact_i"],
        "contact_force": -force + eps * push,
        "contact_point": contacts["contact_point"],
    }
    order = rng.permutation(2 * len(force))
    return {name: np.concatenate([contacts[name], other[name]])[order] for name in NAMES}, 0.5 * (
        force - other["contact_force"]
    )


def sums(scene):
    f = scene.cg.coarse_grain(["contact_stress", "contact_number_density", "coordination_number"], axes="")
    return {name: f[name].values for name in f.data_vars}


@pytest.mark.parametrize("eps", EPS)
def test_stress_and_counts_are_those_of_the_mean_of_both_sides(scene, eps):
    contacts, rng = listed(scene), np.random.default_rng(1)
    both, mean = from_both_sides(contacts, eps, rng)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        found = rebuild(scene, both)
        once = rebuild(scene, {**contacts, "contact_force": mean})
        a, b = sums(found), sums(once)
    rounding = 1e-4 if eps <= 1e-4 else 1e-12  # up to which one of the rows is taken as it is
    for name in a:
        np.testing.assert_allclose(a[name], b[name], rtol=0.0, atol=2 * rounding * abs(b[name]).max())


@pytest.mark.parametrize("eps", [0.4, 0.5, 1.0])
def test_rows_with_forces_that_are_far_from_opposite_stay_two(scene, eps):
    contacts = listed(scene)
    both, _ = from_both_sides(contacts, eps, np.random.default_rng(2))
    with pytest.warns(SceneWarning, match=r"contacts are listed from both sides with forces that differ by more"):
        found = rebuild(scene, both)
    assert (found.contact_i.values >= 0).sum() == 2 * len(contacts["contact_i"])
    rebuild(scene, both, sides="separate")  # without a warning


def test_unlike_sides_name_both_forces():
    force = np.array([[2.0, 0, 0], [-3.0, 0, 0]])
    with pytest.warns(
        SceneWarning, match=r"1 contacts .* \[2\. 0\. 0\.\] on particle 0 and \[-3\. +0\. +0\.\] on particle 1"
    ):
        xcg.scene_from_arrays(
            [[0.0, 0, 0], [1, 0, 0]], diameter=[1.0, 1.0], density=1.0, contact_i=[0, 1], contact_j=[1, 0],
            contact_force=force,
        )  # fmt: skip


def test_the_warning_has_the_number_and_the_mismatch(scene):
    contacts = listed(scene)
    both, _ = from_both_sides(contacts, 0.0, np.random.default_rng(3))
    mirrored = both["contact_i"] > both["contact_j"]
    rows = np.flatnonzero(mirrored)[:4]
    both["contact_force"][rows] *= np.array([1.01, 1.03, 1.05, 1.07])[:, None]
    with pytest.warns(SceneWarning, match=r"4 contacts are listed from both sides .* 0\.038 .* 0\.065 at most"):
        rebuild(scene, both)


@pytest.mark.parametrize(("sides", "count"), [("mean", 1), ("first", 1), ("separate", 2)])
def test_sides_decides(sides, count):
    given = {
        "contact_i": [0, 1], "contact_j": [1, 0], "contact_force": [[-10.0, 1.0, 0], [11.0, -1.2, 0]],
        "contact_point": [[0.5, 0.0, 0.0], [0.52, 0.0, 0.0]],
    }  # fmt: skip
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        ds = xcg.scene_from_arrays([[0.0, 0, 0], [1, 0, 0]], diameter=[1.0, 1.0], density=1.0, sides=sides, **given)
    assert len(told) == (sides != "separate")
    assert ds.sizes["contact"] == count
    expected = {"mean": [-10.5, 1.1, 0.0], "first": [-10.0, 1.0, 0.0], "separate": [-10.0, 1.0, 0.0]}[sides]
    np.testing.assert_allclose(ds.contact_force.values[0, 0], expected, rtol=1e-14)
    assert np.isclose(ds.contact_point.values[0, 0, 0], 0.51 if sides == "mean" else 0.5)
    words = {"mean": "the mean of both", "first": "the first row", "separate": "are two"}
    assert words[sides] in str(ds.cg)


def test_mean_across_a_periodic_edge():
    """Points on both sides of the edge are one place."""
    ds = xcg.scene_from_arrays(
        [[0.1, 1, 1], [3.2, 1, 1]], diameter=[1.0, 1.0], density=1.0, box=[[0, 4.0]] * 3, periodic="xyz",
        contact_i=[0, 1], contact_j=[1, 0], contact_force=[[10.0, 0, 0], [-10.0, 0, 0]],
        contact_point=[[-0.36, 1, 1], [3.66, 1, 1]],
    )  # fmt: skip
    assert ds.sizes["contact"] == 1


def test_forces_near_zero_do_not_make_contacts_of_their_own():
    """A hundredth of the mean force is the scale of what is nearly zero."""
    n = 20
    x = np.arange(n + 1.0)
    i, j = np.arange(n), np.arange(1, n + 1)
    force = np.zeros((n, 3))
    force[:, 0] = -10.0
    force[::5, 0] = [1e-9, -2e-9, 0.0, 1e-4]
    back = -force
    back[::5] = [[3e-9, 0, 0], [1e-9, 0, 0], [0, 0, 0], [-3e-3, 0, 0]]
    point = np.column_stack([x[:-1] + 0.5, np.zeros(n), np.zeros(n)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        ds = xcg.scene_from_arrays(
            np.column_stack([x, 0 * x, 0 * x]), diameter=np.ones(n + 1), density=1.0, contact_i=[*i, *j],
            contact_j=[*j, *i], contact_force=np.concatenate([force, back]), contact_point=np.tile(point, (2, 1)),
        )  # fmt: skip
    assert ds.sizes["contact"] == n


def test_two_contacts_of_a_pair_listed_from_both_sides_stay_two():
    """As of two clumps that touch at two places."""
    points = np.array([[0.5, 0.3, 0], [0.5, -0.3, 0]])
    force = np.array([[-10.0, 0, 0], [-10.2, 0, 0]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        ds = xcg.scene_from_arrays(
            [[0.0, 0, 0], [1, 0, 0]], diameter=[1.0, 1.0], density=1.0, contact_i=[0, 0, 1, 1], contact_j=[1, 1, 0, 0],
            contact_force=np.concatenate([force, -1.05 * force]), contact_point=np.concatenate([points, points]),
        )  # fmt: skip
    assert ds.sizes["contact"] == 2
    np.testing.assert_allclose(sorted(ds.contact_force.values[0, :, 0]), [-10.2 * 1.025, -10.0 * 1.025], rtol=1e-12)
    assert len(np.unique(ds.contact_point.values[0, :, 1])) == 2


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 1, 2, 0]])
def test_two_contacts_whose_sides_alternate_by_the_size_of_the_force(order):
    """9.5 from i and 11 from j at one place, 10.5 from i and 10 from j at another."""
    given = {
        "contact_i": np.array([0, 1, 0, 1]), "contact_j": np.array([1, 0, 1, 0]),
        "contact_force": np.array([[-9.5, 0, 0], [10.0, 0, 0], [-10.5, 0, 0], [11.0, 0, 0]]),
        "contact_point": np.array([[0.5, 0.3, 0], [0.5, -0.3, 0], [0.5, -0.3, 0], [0.5, 0.3, 0]]),
    }  # fmt: skip
    given = {name: values[order] for name, values in given.items()}
    with pytest.warns(SceneWarning, match="2 contacts are listed from both sides"):
        ds = xcg.scene_from_arrays([[0.0, 0, 0], [1, 0, 0]], diameter=[1.0, 1.0], density=1.0, **given)
    assert ds.sizes["contact"] == 2
    np.testing.assert_allclose(np.abs(ds.contact_force.values[0, :, 0]), 10.25, rtol=1e-14)


def test_the_mean_of_points_on_both_sides_of_a_periodic_edge():
    given = {
        "contact_i": [0, 1], "contact_j": [1, 0], "contact_force": [[10.0, 0, 0], [-12.0, 0, 0]],
        "contact_point": [[0.02, 1, 1], [3.98, 1, 1]],
    }  # fmt: skip
    with pytest.warns(SceneWarning, match="1 contacts? "):
        ds = xcg.scene_from_arrays(
            [[0.5, 1, 1], [3.6, 1, 1]], diameter=[1.0, 1.0], density=1.0, box=[[0, 4.0]] * 3, periodic="xyz", **given
        )
    assert ds.sizes["contact"] == 1
    assert abs((float(ds.contact_point[0, 0, 0]) + 2) % 4 - 2) < 1e-12
    np.testing.assert_allclose(ds.contact_force.values[0, 0], [11.0, 0, 0])


def test_a_quarter_of_the_larger_force_is_the_limit_and_saved_scenes_keep_the_choice(tmp_path, scene):
    """Forces longer by a share eps differ by eps / (1 + eps) of the larger: 0.23 at 0.3, 0.29 at 0.4."""
    contacts = listed(scene)
    for eps, count in ((0.3, 1), (0.4, 2)):
        other = {
            "contact_i": contacts["contact_j"], "contact_j": contacts["contact_i"],
            "contact_force": -(1 + eps) * contacts["contact_force"], "contact_point": contacts["contact_point"],
        }  # fmt: skip
        both = {name: np.concatenate([contacts[name], other[name]]) for name in NAMES}
        with pytest.warns(SceneWarning, match="listed from both sides"):
            ds = rebuild(scene, both)
        assert (ds.contact_i.values >= 0).sum() == count * len(contacts["contact_i"])
    ds = rebuild(scene, both, sides="separate")
    again = xcg.open_scene(xcg.save(ds, tmp_path / "scene.nc"))
    assert again.attrs["sides"] == "separate"
    assert "are two" in str(again.cg)


def test_what_is_not_known_is_refused():
    with pytest.raises(SceneError, match="sides='both': expected one of 'mean', 'first', 'separate'"):
        xcg.scene_from_arrays([[0.0, 0, 0]], diameter=[1.0], density=1.0, sides="both")


def test_files_take_the_choice_too(tmp_path, scene):
    contacts = listed(scene)
    both, mean = from_both_sides(contacts, 0.01, np.random.default_rng(5))
    grains = np.column_stack([scene.particle_id.values[0], scene.position.values[0], scene.diameter.values[0]])
    np.savetxt(tmp_path / "grains.csv", grains, delimiter=",", header="id,x,y,z,diameter", comments="", fmt="%.17g")
    table = np.column_stack([both[name] for name in NAMES])
    header = "contact_i,contact_j,fx,fy,fz,contact_point_x,contact_point_y,contact_point_z"
    np.savetxt(tmp_path / "contacts.csv", table, delimiter=",", header=header, comments="", fmt="%.17g")
    edges = np.stack([scene.attrs["box_lower"], scene.attrs["box_upper"]], axis=1)
    options = {
        "density": 2500.0,
        "box": edges,
        "periodic": scene.attrs["periodic"],
        "times": [0.0],
        "dimension": int(scene.attrs["dimension"]),
    }
    for sides, count in (("mean", 1), ("separate", 2)):
        ds = xcg.open_scene(
            str(tmp_path / "grains.csv"), contacts=str(tmp_path / "contacts.csv"), sides=sides, **options
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SceneWarning)
            found = ds.contact_i.values
        assert (found >= 0).sum() == count * len(mean)
