"""Periodic boxes under two diameters, where grains touch on both sides: against the same grains in a repeated box."""

import itertools

import numpy as np
import pandas as pd
import pytest

import xcg
from tests.dumps import dump_text, pairs_text, write
from tests.scenes import spheres

EDGE = 1.45


def random_grains(seed=0, count=4):
    """Positions, diameters and velocities in the small box."""
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(0, EDGE, (count, 3)),
        rng.uniform(0.9, 1.3, count),
        rng.normal(size=(count, 3)),
    )


def repeated(copies, seed=0, **options):
    """Grains in a small box, or in one that holds `copies` of it along each axis."""
    position, diameter, velocity = random_grains(seed)
    shifts = EDGE * np.array(list(itertools.product(range(copies), repeat=3)))
    return spheres(
        (shifts[:, None] + position).reshape(-1, 3),
        np.tile(diameter, len(shifts)),
        velocity=np.tile(velocity, (len(shifts), 1)),
        box=[[0, copies * EDGE]] * 3,
        periodic="xyz",
        **options,
    )


def by_hand(position, diameter):
    """All contacts (i, j, branch) of a small box, image by image; i < j."""
    for i, j in itertools.combinations(range(len(position)), 2):
        for n in itertools.product((-2, -1, 0, 1, 2), repeat=3):
            branch = position[i] - position[j] + EDGE * np.array(n)
            if np.linalg.norm(branch) < (diameter[i] + diameter[j]) / 2:
                yield i, j, branch


def rounded(row):
    """Row to sort by: branches are known to rounding."""
    return tuple(np.round(row, 9))


@pytest.mark.parametrize("lazy", [False, True])
@pytest.mark.parametrize("seed", [0, 1])
def test_found_contacts_and_all_that_follows_as_in_a_larger_box(seed, lazy):
    small, large = (repeated(copies, seed) for copies in (1, 3))
    if lazy:
        small = small.chunk(time=1)
    small = small.cg.find_contacts(k_n=1.0, max_contacts=60 if lazy else None)
    large = large.cg.find_contacts(k_n=1.0)
    expected = sorted(
        ((i, j, *branch) for i, j, branch in by_hand(*random_grains(seed)[:2])), key=rounded
    )
    i, j = (
        small[name].values[0][small.contact_i.values[0] >= 0] for name in ("contact_i", "contact_j")
    )
    diameter = small.diameter.values[0]
    overlap = small.overlap.values[0][: len(i)]
    branch = ((diameter[i] + diameter[j]) / 2 - overlap)[:, None] * small.contact_normal.values[0][
        : len(i)
    ]
    np.testing.assert_allclose(
        sorted(zip(i, j, *branch.T, strict=True), key=rounded), expected, rtol=1e-12
    )
    assert len(expected) > len({row[:2] for row in expected})  # some touch on several sides
    assert (large.contact_i.values >= 0).sum() == 27 * len(expected)

    fields = [
        "contact_stress",
        "fabric",
        "coordination_number",
        "contact_force_density",
        "kinetic_stress",
    ]
    options = {"bounds": dict.fromkeys("xyz", (0.0, 1.0)), "spacing": 0.5, "width": 0.4}
    both = [ds.cg.coarse_grain(fields, **options) for ds in (small, large)]
    own = [ds.cg.particle_stress().stress.values[0, :3] for ds in (small, large)]
    scale = np.abs(own[1]).max()
    for name in fields:
        np.testing.assert_allclose(both[0][name], both[1][name], rtol=1e-9, atol=1e-11 * scale)
    np.testing.assert_allclose(own[0], own[1], rtol=1e-9, atol=1e-11 * scale)
    names = ["stress", "fabric", "coordination_number", "mean_normal_force", "non_rattler_fraction"]
    m = [ds.cg.microstructure(names) for ds in (small, large)]
    for name in names:
        np.testing.assert_allclose(m[0][name], m[1][name], rtol=1e-9, atol=1e-11 * scale)


def dumps(tmp_path, columns="id1 id2 dx dy dz fnx fny fnz", sign=1.0):
    """A dump of the small box with a force along each branch, and the scene's stress by hand."""
    position, diameter, _ = random_grains()
    atoms = [
        f"{k + 1} 1 {x} {y} {z} {d / 2} 1"
        for k, ((x, y, z), d) in enumerate(zip(position, diameter, strict=True))
    ]
    rows = []
    stress = np.zeros((3, 3))
    for k, (i, j, branch) in enumerate(by_hand(position, diameter)):
        force = (1 + 0.1 * k) * branch
        stress += np.outer(force, branch) / EDGE**3
        if k % 2:  # either may come first
            i, j, branch, force = j, i, -branch, -force
        given = {f"d{a}": sign * x for a, x in zip("xyz", branch, strict=True)}
        given |= {f"fn{a}": x for a, x in zip("xyz", force, strict=True)} | {
            "id1": i + 1,
            "id2": j + 1,
        }
        rows.append(
            " ".join(
                repr(float(given[c])) if c not in ("id1", "id2") else str(given[c])
                for c in columns.split()
            )
        )
    box = "ITEM: BOX BOUNDS pp pp pp\n" + f"0 {EDGE}\n" * 3
    particles = write(tmp_path / "p.dump", dump_text(atoms, "id type x y z radius mass", box=box))
    return particles, write(tmp_path / "c.dump", pairs_text(rows, columns, box=box)), stress


@pytest.mark.filterwarnings("ignore:.*only normal forces")
def test_branches_in_a_dump_choose_the_images(tmp_path):
    particles, contacts, stress = dumps(tmp_path)
    ds = xcg.open_scene(particles, contacts=contacts)
    found = ds.cg.coarse_grain("contact_stress", axes="", at={}, width=0.5).contact_stress.values[0]
    np.testing.assert_allclose(found, stress, rtol=1e-9, atol=1e-12)
    alone = ds.cg.particle_stress()
    total = (alone.stress * ds.volume).sum("particle").values[0] / EDGE**3
    np.testing.assert_allclose(total, (stress + stress.T) / 2, rtol=1e-9, atol=1e-12)
    assert "contact_branch" not in ds


@pytest.mark.filterwarnings("ignore:.*only normal forces")
def test_ambiguous_images_raise(tmp_path):
    particles, contacts, _ = dumps(tmp_path, "id1 id2 fnx fny fnz")
    with pytest.raises(
        xcg.SceneError, match=r"may be on either side.*names=\{'dx': 'contact_branch_x'"
    ):
        xcg.open_scene(particles, contacts=contacts).contact_point.compute()
    particles, contacts, _ = dumps(tmp_path, sign=-1.0)
    ds = xcg.open_scene(particles, contacts=contacts)
    with (
        pytest.warns(xcg.SceneWarning, match="not the vectors from j to i"),
        pytest.raises(xcg.SceneError, match="either"),
    ):
        ds.contact_point.compute()


def test_grains_that_touch_themselves_raise():
    one = {"diameter": [1.1], "density": 1.0, "box": [[0, 1.0], [0, 5], [0, 5]], "periodic": "xy"}
    ds = xcg.scene_from_arrays([[0.5, 0.5, 0.5]], particle_id=[7], **one)
    with pytest.raises(
        xcg.SceneError, match=r"particle 7 of diameter 1.1 touches its own image.*along 'x' is 1"
    ):
        ds.cg.find_contacts()
    assert ds.assign(frozen=ds.particle_id * 0 + 1).cg.find_contacts().sizes["contact"] == 0
    assert ds.assign(diameter=ds.diameter * 0.9).cg.find_contacts().sizes["contact"] == 0
    with pytest.raises(xcg.SceneError, match="touches its own image"):
        ds.assign(diameter=ds.diameter * 0.9).cg.find_contacts(skin=0.02)
    pair = one | {"diameter": [1.1, 0.3]}
    with pytest.raises(xcg.SceneError, match="half a period away from a centre"):
        xcg.scene_from_arrays(
            [[0.5, 0.5, 0.5], [1.15, 0.5, 0.5]], contact_i=[0], contact_j=[1], contact_force=[[1.0, 0, 0]],
            contact_branch=[[-0.65, 0, 0]], **pair,
        )  # fmt: skip
    with pytest.raises(ValueError, match="take more cells"):
        xcg.datasets.simple_cubic(1)


def test_lattices_of_few_cells_have_their_closed_form_stress():
    for ds in (xcg.datasets.simple_cubic(2), xcg.datasets.face_centred_cubic(1)):
        stress = ds.cg.microstructure("stress").stress[0]
        expected = 1.0 if ds.sizes["particle"] == 8 else 2 * np.sqrt(2)
        np.testing.assert_allclose(stress, expected * np.eye(3), atol=1e-12)
        partners = ds.cg.microstructure("coordination_number").coordination_number.item()
        assert partners == (6 if ds.sizes["particle"] == 8 else 12)


def test_spheres_without_a_body_touch_each_other():
    ds = xcg.scene_from_arrays(
        [[0.0, 0, 0], [0.9, 0, 0]], diameter=np.ones(2), density=1.0, body_id=[-1, -1]
    )
    assert ds.cg.find_contacts().sizes["contact"] == 1


@pytest.mark.parametrize("name", ["particle_id", "species"])
@pytest.mark.parametrize("value", [2.0**53, -(2.0**53), 1e20, 0.5, np.nan, np.inf])
def test_whole_numbers_that_floats_do_not_hold_raise(name, value):
    x = [[0.0, 0, 0], [2.0, 0, 0]]
    with pytest.raises(
        xcg.SceneError, match=f"'{name}' must hold whole numbers below 2.53, but row 1 is "
    ):
        xcg.scene_from_arrays(x, **{name: [3.0, value]})
    large = 2**53 + 1
    assert xcg.scene_from_arrays(x, **{name: [3, large]})[name][0, 1] == large
    with pytest.raises(
        xcg.SceneError, match="but row 0 is 9007199254740992"
    ):  # which 2^53 + 1 became
        xcg.scene_from_table(
            pd.DataFrame({"id": [large], "x": 0.0, "y": 0.0, "z": 0.0, "radius": 1.0}), density=1.0
        )


def test_contacts_without_forces_name_the_argument():
    x = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    with pytest.raises(
        xcg.SceneError,
        match="contacts lack contact_force; pass contact_force=, or map columns by names=",
    ):
        xcg.scene_from_arrays(x, contact_i=[0], contact_j=[1], contact_point=x[:1])
