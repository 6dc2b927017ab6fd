"""A contact that is listed twice counts once; different contacts of one pair all count."""

import numpy as np
import pytest

import xcg
from tests import dumps
from xcg import SceneError
from xcg.scene.sanity import repeated_pairs

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
    order = slice(None) if seed is None else np.random.default_rng(seed).permutation(len(joined["contact_i"]))
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
    f, expected = twice.cg.coarse_grain(fields, **mesh), once.cg.coarse_grain(fields, **mesh)
    for name in fields:
        np.testing.assert_allclose(f[name], expected[name], rtol=1e-4, atol=1e-6)


def test_different_contacts_of_a_pair_all_count():
    corner = np.array([[1.0, 0.2, 0.2], [1.0, -0.2, 0.2], [1.0, 0.2, -0.2], [1.0, -0.2, -0.2]])
    bodies = {"position": [[0.5, 0, 0], [1.5, 0, 0]], "diameter": [1.0, 1.0], "density": 1.0}
    force = np.array([[-1.0, 0, 0]] * 4)  # equal in all corners of two cubes
    ids = {"contact_i": [0] * 4, "contact_j": [1] * 4}
    ds = xcg.scene_from_arrays(**bodies, **ids, contact_force=force, contact_point=corner)
    assert ds.sizes["contact"] == 4
    mirrored_too = {"contact_i": [0] * 4 + [1] * 4, "contact_j": [1] * 4 + [0] * 4, "contact_point": [*corner, *corner]}
    ds = xcg.scene_from_arrays(**bodies, **mirrored_too, contact_force=[*force, *-force])
    assert ds.sizes["contact"] == 4
    np.testing.assert_allclose(np.sort(ds.contact_point[0], axis=0), np.sort(corner, axis=0))
    # at one point, but not of one size: the normal and the tangential part in rows of their own
    two = {"contact_i": [0, 0], "contact_j": [1, 1]}
    parts = [[-1.0, 0, 0], [0, 0.2, 0]]
    ds = xcg.scene_from_arrays(**bodies, **two, contact_force=parts, contact_point=corner[[0, 0]])
    assert ds.sizes["contact"] == 2
    # on both sides of a small box
    sides, parts = [[1.0, 0, 0], [0.0, 0, 0]], [[-1.0, 0, 0], [1.0, 0, 0]]
    box = {"box": {"x": (0, 2)}, "periodic": "x"}
    ds = xcg.scene_from_arrays(**bodies, **two, **box, contact_force=parts, contact_point=sides)
    assert ds.sizes["contact"] == 2


def test_both_sides_with_the_same_force_are_refused():
    bodies = {"position": [[0.0, 0, 0], [0.9, 0, 0]], "diameter": [1.0, 1.0], "density": 1.0}
    with pytest.raises(SceneError, match="contact rows 0 and 1 list one contact from both sides with the same force"):
        xcg.scene_from_arrays(**bodies, contact_i=[0, 1], contact_j=[1, 0], contact_force=[[-1.0, 0, 0]] * 2)


def test_walls_and_partners_that_are_not_there():
    bodies = {"position": [[0.0, 0, 0.5], [3.0, 0, 0.5]], "diameter": [1.0, 1.0], "density": 1.0}
    wall = {"contact_i": [0, 0, 0, 1, 7], "contact_j": [-1, -1, -2, -1, 8], "contact_force": [[0, 0, 1.0]] * 5}
    point = [[0.0, 0, 0], [0, 0, 0.01], [0, 0, 0], [3.0, 0, 0], [0, 0, 0]]
    ds = xcg.scene_from_arrays(**bodies, **wall, contact_point=point, allow_unknown=True)
    assert ds.contact_i.values.tolist() == [[0, 0, 1, 7]]
    assert ds.contact_j.values.tolist() == [[-1, -2, -1, 8]]


@pytest.mark.parametrize("span", [50, 2**20, 2**40])
def test_repeated_pairs_are_those_of_a_loop(span):
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
    i, j = i[order] * apart, j[order] * apart
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


def test_dumps_that_list_both_sides(tmp_path):
    particles = dumps.write(tmp_path / "p.0.dump", dumps.dump_text())
    once = dumps.write(tmp_path / "once.0.dump", dumps.pairs_text())
    twice = dumps.write(tmp_path / "twice.0.dump", dumps.pairs_text(["1 2 -9 0 0 0 1 0", "2 1 9 0 0 0 -1 0"]))
    copied = dumps.write(tmp_path / "copied.0.dump", dumps.pairs_text(["1 2 -9 0 0 0 1 0"] * 2))
    usual = xcg.open_scene(particles, contacts=once).cg.coarse_grain("contact_stress", axes="x", width=1.0).compute()
    assert abs(usual.contact_stress).max() > 0.01
    for contacts in (twice, copied):
        f = xcg.open_scene(particles, contacts=contacts).cg.coarse_grain("contact_stress", axes="x", width=1.0)
        np.testing.assert_array_equal(f.contact_stress, usual.contact_stress)


def test_fstat_files_with_copied_rows(tmp_path):
    grains = [f"{x} 0 0 0 0 0 0.5 0 0 0 0 0 0 0" for x in (0.5, 1.4)]
    (tmp_path / "a.data").write_text("\n".join(["2 0 -1 -1 -1 3 3 3", *grains, ""]))
    row, mirror = "0 0 1 0.95 0 0 0.1 0 5 0 -1 0 0 0 0 0\n", "0 1 0 0.95 0 0 0.1 0 5 0 1 0 0 0 0 0\n"
    stresses = []
    for k, rows in enumerate([[row], [row, row], [row, mirror, row, mirror]]):
        contacts = tmp_path / f"{k}.fstat"
        contacts.write_text("# 0 0\n# head\n# head\n" + "".join(rows))
        ds = xcg.open_scene(tmp_path / "a.data", contacts=contacts, engine="mercury", density=1.0)
        stresses.append(ds.cg.particle_stress().stress.to_numpy())
    assert stresses[0][0, 0, 0, 0] > 0
    np.testing.assert_array_equal(stresses[1], stresses[0])
    np.testing.assert_array_equal(stresses[2], stresses[0])
