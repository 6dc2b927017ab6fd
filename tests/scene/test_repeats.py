"""Contacts that are listed twice, or from both sides, count once; different contacts of one pair all count."""

import warnings

import numpy as np
import pytest

import xcg
from tests import dumps
from xcg import SceneError, SceneWarning
from xcg.scene.repeats import repeated_pairs

BOX = {"box": [[0, 5.0]] * 3, "periodic": "xyz"}
CONTACTS = ("contact_i", "contact_j", "contact_force", "contact_point")


def rows_of(scene):
    there = scene.contact_i.values[0] >= 0
    return {name: scene[name].values[0][there] for name in CONTACTS}


def rebuilt(scene, contacts, *, points=True):
    given = dict(contacts)
    if not points:
        given.pop("contact_point")
    return xcg.scene_from_arrays(
        scene.position.values, velocity=scene.velocity.values, diameter=scene.diameter.values, density=2500.0,
        **{name: values[None] for name, values in given.items()}, **BOX,
    )  # fmt: skip


def mirrored(contacts, scale=1.0, shift=0.0):
    return {
        "contact_i": contacts["contact_j"],
        "contact_j": contacts["contact_i"],
        "contact_force": -contacts["contact_force"] * scale,
        "contact_point": contacts["contact_point"] + shift,
    }


def both(one, other, seed=None):
    joined = {name: np.concatenate([one[name], other[name]]) for name in CONTACTS}
    order = (
        slice(None)
        if seed is None
        else np.random.default_rng(seed).permutation(len(joined["contact_i"]))
    )
    return {name: values[order] for name, values in joined.items()}


@pytest.fixture(scope="module")
def scene():
    return xcg.datasets.random_scene(60, seed=3)


TWICE = {
    "copied": lambda c: both(c, c),
    "from both sides": lambda c: both(c, mirrored(c)),
    "in any order": lambda c: both(c, mirrored(c), seed=1),
    "three times": lambda c: both(both(c, mirrored(c)), c, seed=2),
    "printed with six digits": lambda c: both(c, mirrored(c, scale=1 + 1e-5, shift=1e-5)),
    "across the edge": lambda c: both(c, mirrored(c, shift=[5.0, 0.0, -5.0])),
    "partly": lambda c: both(c, {name: values[::3] for name, values in mirrored(c).items()}),
}


@pytest.mark.parametrize("points", [True, False])
@pytest.mark.parametrize("how", TWICE)
def test_contacts_listed_twice_count_once(scene, how, points):
    once = rebuilt(scene, rows_of(scene), points=points)
    twice = rebuilt(scene, TWICE[how](rows_of(scene)), points=points)
    assert twice.sizes["contact"] == once.sizes["contact"]
    mesh = {"axes": "z", "width": 0.8}
    # brute force: the mean stress is the sum of f a over the volume
    branch = once.position.values[0][once.contact_i[0]] - once.position.values[0][once.contact_j[0]]
    branch -= 5 * np.rint(branch / 5)
    love = np.einsum("ca,cb->ab", once.contact_force.values[0], branch) / 125
    stress = twice.cg.coarse_grain("contact_stress", axes="", width=0.8).contact_stress.values[0]
    np.testing.assert_allclose(stress, love, rtol=2e-5 if "digits" in how else 1e-12, atol=1e-7)
    fields = ["contact_stress", "fabric", "coordination_number"]
    f = twice.cg.coarse_grain(fields, **mesh)
    expected = once.cg.coarse_grain(fields, **mesh)
    for name in fields:
        np.testing.assert_allclose(f[name], expected[name], rtol=1e-4, atol=1e-6)


def test_different_contacts_of_a_pair_all_count():
    corner = np.array([[1.0, 0.2, 0.2], [1.0, -0.2, 0.2], [1.0, 0.2, -0.2], [1.0, -0.2, -0.2]])
    bodies = {"position": [[0.5, 0, 0], [1.5, 0, 0]], "diameter": [1.0, 1.0], "density": 1.0}
    force = np.array([[-1.0, 0, 0]] * 4)  # equal in all corners of two cubes
    ids = {"contact_i": [0] * 4, "contact_j": [1] * 4}
    ds = xcg.scene_from_arrays(**bodies, **ids, contact_force=force, contact_point=corner)
    assert ds.sizes["contact"] == 4
    mirrored_too = {
        "contact_i": [0] * 4 + [1] * 4,
        "contact_j": [1] * 4 + [0] * 4,
        "contact_point": [*corner, *corner],
    }
    ds = xcg.scene_from_arrays(**bodies, **mirrored_too, contact_force=[*force, *-force])
    assert ds.sizes["contact"] == 4
    np.testing.assert_allclose(np.sort(ds.contact_point[0], axis=0), np.sort(corner, axis=0))
    # at one point, but not of one size: the normal and the tangential part in rows of their own
    two = {"contact_i": [0, 0], "contact_j": [1, 1]}
    parts = [[-1.0, 0, 0], [0, 0.2, 0]]
    ds = xcg.scene_from_arrays(**bodies, **two, contact_force=parts, contact_point=corner[[0, 0]])
    assert ds.sizes["contact"] == 2
    # on both sides of a small box
    sides = [[1.0, 0, 0], [0.0, 0, 0]]
    parts = [[-1.0, 0, 0], [1.0, 0, 0]]
    box = {"box": {"x": (0, 2)}, "periodic": "x"}
    ds = xcg.scene_from_arrays(**bodies, **two, **box, contact_force=parts, contact_point=sides)
    assert ds.sizes["contact"] == 2


def test_both_sides_with_the_same_force_raise():
    bodies = {"position": [[0.0, 0, 0], [0.9, 0, 0]], "diameter": [1.0, 1.0], "density": 1.0}
    with pytest.raises(
        SceneError,
        match="contact rows 0 and 1 list one contact from both sides with the same force",
    ):
        xcg.scene_from_arrays(
            **bodies, contact_i=[0, 1], contact_j=[1, 0], contact_force=[[-1.0, 0, 0]] * 2
        )


def test_walls_and_unknown_partners_are_kept():
    bodies = {"position": [[0.0, 0, 0.5], [3.0, 0, 0.5]], "diameter": [1.0, 1.0], "density": 1.0}
    wall = {
        "contact_i": [0, 0, 0, 1, 7],
        "contact_j": [-1, -1, -2, -1, 8],
        "contact_force": [[0, 0, 1.0]] * 5,
    }
    point = [[0.0, 0, 0], [0, 0, 1e-5], [0, 0, 0], [3.0, 0, 0], [0, 0, 0]]
    ds = xcg.scene_from_arrays(**bodies, **wall, contact_point=point, allow_unknown=True)
    assert ds.contact_i.values.tolist() == [[0, 0, 1, 7]]
    assert ds.contact_j.values.tolist() == [[-1, -2, -1, 8]]


@pytest.mark.parametrize("span", [50, 2**20, 2**40])
def test_repeated_pairs_equal_those_of_a_loop(span):
    rng = np.random.default_rng(0)
    ids = np.concatenate([[0, span], rng.integers(0, span, 8)]) - 7
    i, j = rng.choice(ids, (2, 60))
    rows, number = repeated_pairs(i, j)
    found = {frozenset(rows[number == k].tolist()) for k in np.unique(number)}
    by_pair: dict = {}
    for row, pair in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
        by_pair.setdefault(frozenset(pair), []).append(row)
    assert found == {frozenset(same) for same in by_pair.values() if len(same) > 1}


@pytest.mark.parametrize("apart", [1, 2**20, 2**40])
def test_one_repeated_pair_among_many_is_found(apart):
    i, j = (ids.ravel() for ids in np.meshgrid(np.arange(-3, 30), np.arange(40, 80)))
    order = np.random.default_rng(0).permutation(i.size)
    i = i[order] * apart
    j = j[order] * apart
    assert not repeated_pairs(i, j)[0].size
    rows, number = repeated_pairs(np.append(i, j[77]), np.append(j, i[77]))
    assert rows.tolist() == [77, i.size]
    assert number[0] == number[1]


def test_many_rows_of_one_pair_are_bounded_work():
    count = 20_000
    bodies = {"position": [[0.0, 0, 0], [0.9, 0, 0]], "diameter": [1.0, 1.0], "density": 1.0}
    ids = {"contact_i": np.zeros(count, int), "contact_j": np.ones(count, int)}
    ds = xcg.scene_from_arrays(**bodies, **ids, contact_force=np.ones((count, 3)))
    assert ds.sizes["contact"] == 1


def test_dumps_that_list_both_sides_count_once(tmp_path):
    particles = dumps.write(tmp_path / "p.0.dump", dumps.dump_text())
    once = dumps.write(tmp_path / "once.0.dump", dumps.pairs_text())
    twice = dumps.write(
        tmp_path / "twice.0.dump", dumps.pairs_text(["1 2 -9 0 0 0 1 0", "2 1 9 0 0 0 -1 0"])
    )
    copied = dumps.write(tmp_path / "copied.0.dump", dumps.pairs_text(["1 2 -9 0 0 0 1 0"] * 2))
    usual = (
        xcg.open_scene(particles, contacts=once)
        .cg.coarse_grain("contact_stress", axes="x", width=1.0)
        .compute()
    )
    assert abs(usual.contact_stress).max() > 0.01
    for contacts in (twice, copied):
        f = xcg.open_scene(particles, contacts=contacts).cg.coarse_grain(
            "contact_stress", axes="x", width=1.0
        )
        np.testing.assert_array_equal(f.contact_stress, usual.contact_stress)


def test_copied_rows_of_fstat_files_count_once(tmp_path):
    grains = [f"{x} 0 0 0 0 0 0.5 0 0 0 0 0 0 0" for x in (0.5, 1.4)]
    (tmp_path / "a.data").write_text("\n".join(["2 0 -1 -1 -1 3 3 3", *grains, ""]))
    row, mirror = (
        "0 0 1 0.95 0 0 0.1 0 5 0 -1 0 0 0 0 0\n",
        "0 1 0 0.95 0 0 0.1 0 5 0 1 0 0 0 0 0\n",
    )
    stresses = []
    for k, rows in enumerate([[row], [row, row], [row, mirror, row, mirror]]):
        contacts = tmp_path / f"{k}.fstat"
        contacts.write_text("# 0 0\n# head\n# head\n" + "".join(rows))
        ds = xcg.open_scene(tmp_path / "a.data", contacts=contacts, engine="mercury", density=1.0)
        stresses.append(ds.cg.particle_stress().stress.to_numpy())
    assert stresses[0][0, 0, 0, 0] > 0
    np.testing.assert_array_equal(stresses[1], stresses[0])
    np.testing.assert_array_equal(stresses[2], stresses[0])


# --- contacts listed from both sides ---------------------------------------------------------------------

EPS = [0.0, 1e-6, 1e-5, 1e-4, 3e-4, 1e-2, 0.1, 0.2]  # at most a quarter of the larger force


@pytest.fixture(scope="module", params=[3, 2])
def packing(request):
    return xcg.datasets.random_scene(80, seed=7, dimension=request.param)


def listed(packing):
    there = packing.contact_i.values[0] >= 0
    there &= packing.contact_j.values[0] >= 0
    return {name: packing[name].values[0][there] for name in CONTACTS}


def with_contacts(packing, contacts, **options):
    options = {
        "dimension": int(packing.attrs["dimension"]),
        "thickness": packing.attrs.get("thickness"),
    } | options
    edges = np.stack([packing.attrs["box_lower"], packing.attrs["box_upper"]], axis=1)
    return xcg.scene_from_arrays(
        packing.position.values[0], velocity=packing.velocity.values[0], diameter=packing.diameter.values[0],
        density=2500.0,
        box=edges, periodic=packing.attrs["periodic"], **options, **contacts,
    )  # fmt: skip


def from_both_sides(contacts, eps, rng):
    """List each contact again from the other side, its force off by up to a share `eps` in a direction of its own."""
    force = contacts["contact_force"]
    push = rng.normal(size=force.shape)
    push *= np.linalg.norm(force, axis=1, keepdims=True) / np.linalg.norm(
        push, axis=1, keepdims=True
    )
    other = {
        "contact_i": contacts["contact_j"],
        "contact_j": contacts["contact_i"],
        "contact_force": -force + eps * push,
        "contact_point": contacts["contact_point"],
    }
    order = rng.permutation(2 * len(force))
    return {
        name: np.concatenate([contacts[name], other[name]])[order] for name in CONTACTS
    }, 0.5 * (force - other["contact_force"])


def sums(packing):
    f = packing.cg.coarse_grain(
        ["contact_stress", "contact_number_density", "coordination_number"], axes=""
    )
    return {name: f[name].values for name in f.data_vars}


@pytest.mark.parametrize("eps", EPS)
def test_stress_and_counts_equal_those_of_the_mean_of_both_sides(packing, eps):
    contacts = listed(packing)
    rng = np.random.default_rng(1)
    both, mean = from_both_sides(contacts, eps, rng)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        found = with_contacts(packing, both)
        once = with_contacts(packing, {**contacts, "contact_force": mean})
        a = sums(found)
        b = sums(once)
    rounding = 1e-4 if eps <= 1e-4 else 1e-12  # up to which one of the rows is taken as it is
    for name in a:
        np.testing.assert_allclose(
            a[name], b[name], rtol=0.0, atol=2 * rounding * abs(b[name]).max()
        )


@pytest.mark.parametrize("eps", [0.4, 0.5, 1.0])
def test_rows_with_forces_that_are_far_from_opposite_stay_two(packing, eps):
    contacts = listed(packing)
    both, _ = from_both_sides(contacts, eps, np.random.default_rng(2))
    with pytest.warns(
        SceneWarning, match=r"contacts are listed from both sides with forces that differ by more"
    ):
        found = with_contacts(packing, both)
    assert (found.contact_i.values >= 0).sum() == 2 * len(contacts["contact_i"])
    with_contacts(packing, both, sides="separate")  # without a warning


def test_messages_about_unlike_sides_name_both_forces():
    force = np.array([[2.0, 0, 0], [-3.0, 0, 0]])
    with pytest.warns(
        SceneWarning,
        match=r"1 contacts .* \[2\. 0\. 0\.\] on particle 0 and \[-3\. +0\. +0\.\] on particle 1",
    ):
        xcg.scene_from_arrays(
            [[0.0, 0, 0], [1, 0, 0]], diameter=[1.0, 1.0], density=1.0, contact_i=[0, 1], contact_j=[1, 0],
            contact_force=force,
        )  # fmt: skip


def test_the_warning_has_the_number_and_the_mismatch(packing):
    contacts = listed(packing)
    both, _ = from_both_sides(contacts, 0.0, np.random.default_rng(3))
    mirrored = both["contact_i"] > both["contact_j"]
    rows = np.flatnonzero(mirrored)[:4]
    both["contact_force"][rows] *= np.array([1.01, 1.03, 1.05, 1.07])[:, None]
    with pytest.warns(
        SceneWarning, match=r"4 contacts are listed from both sides .* 0\.038 .* 0\.065 at most"
    ):
        with_contacts(packing, both)


@pytest.mark.parametrize(("sides", "count"), [("mean", 1), ("first", 1), ("separate", 2)])
def test_the_argument_sides_decides(sides, count):
    given = {
        "contact_i": [0, 1], "contact_j": [1, 0], "contact_force": [[-10.0, 1.0, 0], [11.0, -1.2, 0]],
        "contact_point": [[0.5, 0.0, 0.0], [0.52, 0.0, 0.0]],
    }  # fmt: skip
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        ds = xcg.scene_from_arrays(
            [[0.0, 0, 0], [1, 0, 0]], diameter=[1.0, 1.0], density=1.0, sides=sides, **given
        )
    assert len(told) == (sides != "separate")
    assert ds.sizes["contact"] == count
    expected = {
        "mean": [-10.5, 1.1, 0.0],
        "first": [-10.0, 1.0, 0.0],
        "separate": [-10.0, 1.0, 0.0],
    }[sides]
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
    i = np.arange(n)
    j = np.arange(1, n + 1)
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
    np.testing.assert_allclose(
        sorted(ds.contact_force.values[0, :, 0]), [-10.2 * 1.025, -10.0 * 1.025], rtol=1e-12
    )
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
        ds = xcg.scene_from_arrays(
            [[0.0, 0, 0], [1, 0, 0]], diameter=[1.0, 1.0], density=1.0, **given
        )
    assert ds.sizes["contact"] == 2
    np.testing.assert_allclose(np.abs(ds.contact_force.values[0, :, 0]), 10.25, rtol=1e-14)


def test_the_mean_of_points_on_both_sides_of_a_periodic_edge():
    given = {
        "contact_i": [0, 1], "contact_j": [1, 0], "contact_force": [[10.0, 0, 0], [-12.0, 0, 0]],
        "contact_point": [[0.02, 1, 1], [3.98, 1, 1]],
    }  # fmt: skip
    with pytest.warns(SceneWarning, match="1 contacts? "):
        ds = xcg.scene_from_arrays(
            [[0.5, 1, 1], [3.6, 1, 1]],
            diameter=[1.0, 1.0],
            density=1.0,
            box=[[0, 4.0]] * 3,
            periodic="xyz",
            **given,
        )
    assert ds.sizes["contact"] == 1
    assert abs((float(ds.contact_point[0, 0, 0]) + 2) % 4 - 2) < 1e-12
    np.testing.assert_allclose(ds.contact_force.values[0, 0], [11.0, 0, 0])


def test_a_quarter_of_the_larger_force_is_the_limit_and_saved_scenes_keep_the_choice(
    tmp_path, packing
):
    """Forces longer by a share eps differ by eps / (1 + eps) of the larger: 0.23 at 0.3, 0.29 at 0.4."""
    contacts = listed(packing)
    for eps, count in ((0.3, 1), (0.4, 2)):
        other = {
            "contact_i": contacts["contact_j"], "contact_j": contacts["contact_i"],
            "contact_force": -(1 + eps) * contacts["contact_force"], "contact_point": contacts["contact_point"],
        }  # fmt: skip
        both = {name: np.concatenate([contacts[name], other[name]]) for name in CONTACTS}
        with pytest.warns(SceneWarning, match="listed from both sides"):
            ds = with_contacts(packing, both)
        assert (ds.contact_i.values >= 0).sum() == count * len(contacts["contact_i"])
    ds = with_contacts(packing, both, sides="separate")
    again = xcg.open_scene(xcg.save(ds, tmp_path / "packing.nc"))
    assert again.attrs["sides"] == "separate"
    assert "are two" in str(again.cg)


def test_unknown_sides_raise():
    with pytest.raises(
        SceneError, match="sides='both': expected one of 'mean', 'first', 'separate'"
    ):
        xcg.scene_from_arrays([[0.0, 0, 0]], diameter=[1.0], density=1.0, sides="both")


def test_open_scene_takes_sides(tmp_path, packing):
    contacts = listed(packing)
    both, mean = from_both_sides(contacts, 0.01, np.random.default_rng(5))
    grains = np.column_stack(
        [packing.particle_id.values[0], packing.position.values[0], packing.diameter.values[0]]
    )
    np.savetxt(
        tmp_path / "grains.csv",
        grains,
        delimiter=",",
        header="id,x,y,z,diameter",
        comments="",
        fmt="%.17g",
    )
    table = np.column_stack([both[name] for name in CONTACTS])
    header = "contact_i,contact_j,fx,fy,fz,contact_point_x,contact_point_y,contact_point_z"
    np.savetxt(
        tmp_path / "contacts.csv", table, delimiter=",", header=header, comments="", fmt="%.17g"
    )
    edges = np.stack([packing.attrs["box_lower"], packing.attrs["box_upper"]], axis=1)
    options = {
        "density": 2500.0,
        "box": edges,
        "periodic": packing.attrs["periodic"],
        "times": [0.0],
        "dimension": int(packing.attrs["dimension"]),
    }
    for sides, count in (("mean", 1), ("separate", 2)):
        ds = xcg.open_scene(
            str(tmp_path / "grains.csv"),
            contacts=str(tmp_path / "contacts.csv"),
            sides=sides,
            **options,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SceneWarning)
            found = ds.contact_i.values
        assert (found >= 0).sum() == count * len(mean)
