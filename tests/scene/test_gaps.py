"""Contacts with forces across gaps between spheres."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pytest

import xcg
from xcg.common.messages import SceneWarning

_SPACING = 0.98  # of spheres with a diameter of 1


def _lattice(first: int = 0, periodic: bool = False):
    """Spheres on a cubic lattice of 4 x 4 x 4, numbered at random, and the contacts of neighbours that push."""
    places = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    order = np.random.default_rng(5).permutation(len(places))
    ids = first + order
    grains = pd.DataFrame(_SPACING * places, columns=["x", "y", "z"]).assign(id=ids, radius=0.5)
    rows = []
    for axis in range(3):
        for row, place in enumerate(places):
            if place[axis] == 3 and not periodic:
                continue
            other = place.copy()
            other[axis] = (other[axis] + 1) % 4
            partner = int(np.flatnonzero((places == other).all(axis=1))[0])
            force = np.zeros(3)
            force[axis] = -7.0
            rows.append((ids[row], ids[partner], *force))
    return grains, pd.DataFrame(rows, columns=["id1", "id2", "fx", "fy", "fz"])


def _open(grains, contacts, **options):
    return xcg.scene_from_table(grains, contacts, density=1.0, **options)


@pytest.mark.parametrize("first", [0, 1, 10])
@pytest.mark.parametrize("shift", [-1, 1])
def test_ids_off_by_one_are_named(first, shift):
    grains, contacts = _lattice(first)
    shifted = contacts.assign(id1=contacts.id1 + shift, id2=contacts.id2 + shift)
    known = shifted[shifted.id1.isin(grains.id) & shifted.id2.isin(grains.id)]
    direction = "high" if shift > 0 else "low"
    with pytest.warns(SceneWarning, match=f"across a gap .* one too {direction}"):
        _open(grains, known)


def test_walls_with_numbers_of_their_own_are_named():
    grains, contacts = _lattice(1)
    floor = grains[grains.z == 0].id
    walls = pd.DataFrame({"id1": floor, "id2": 60, "fx": 0.0, "fy": 0.0, "fz": 7.0})
    walls = walls[walls.id1 != 60]
    with pytest.warns(SceneWarning, match="contact_j = 60: walls with numbers"):
        _open(grains, pd.concat([contacts, walls]))


def test_positions_of_few_digits_are_named():
    grains, contacts = _lattice()
    # 0.14 apart, and 0.1 or 0.2 with one decimal
    places = {axis: (0.14 / _SPACING * grains[axis]).round(1) for axis in "xyz"}
    cut = grains.assign(**places, radius=0.07)
    with pytest.warns(SceneWarning, match="positions have 1 decimals"):
        _open(cut, contacts)


@pytest.mark.parametrize("factor", [0.5, 1e-3])
def test_sizes_in_another_unit_than_positions_are_named(factor):
    grains, contacts = _lattice()
    sizes = grains.assign(radius=factor * grains.radius)
    with pytest.warns(SceneWarning, match=f"{_SPACING / factor:.3g} times R_i .* another unit"):
        _open(sizes, contacts)


@pytest.mark.parametrize(
    ("pairs", "cause"), [(2, "other grains"), (9, "other grains"), (10, "another unit")]
)
def test_a_unit_is_blamed_for_ten_contacts_or_more(pairs, cause):
    x = 10.0 * np.arange(pairs)
    grains = pd.DataFrame({"x": np.r_[x, x + 3.0], "y": 0.0, "z": 0.0, "radius": 0.5})
    grains = grains.assign(id=10 * np.arange(2 * pairs))
    contacts = pd.DataFrame({"id1": grains.id[:pairs], "id2": grains.id[pairs:].to_numpy()})
    with pytest.warns(SceneWarning, match=f"across a gap .* {cause}"):
        _open(grains, contacts.assign(fx=-7.0, fy=0.0, fz=0.0))


@pytest.mark.parametrize(
    ("rows", "cause"), [(2, "ids are of other grains"), (3, "walls with numbers")]
)
def test_a_wall_is_blamed_for_three_contacts_or_more(rows, cause):
    grains = pd.DataFrame({"id": 10 * np.arange(rows + 1), "y": 0.0, "z": 0.0, "radius": 0.5})
    grains = grains.assign(x=[0.0, *(-1.0) ** np.arange(rows) * (5.0 + np.arange(rows))])
    contacts = pd.DataFrame({"id1": grains.id[1:], "id2": 0, "fx": 7 * np.sign(grains.x[1:])})
    with pytest.warns(SceneWarning, match=f"across a gap .*{cause}"):
        _open(grains, contacts.assign(fy=0.0, fz=0.0))


def test_whole_numbers_of_places_are_no_rounding():
    grains, contacts = _lattice()
    places = grains.assign(**{axis: grains[axis] / _SPACING for axis in "xyz"}, radius=0.51)
    mixed = np.random.default_rng(1).permutation(grains.id)
    with pytest.warns(SceneWarning, match="ids are of other grains"):
        _open(places.assign(id=mixed), contacts)


def test_a_missing_periodic_axis_is_named():
    grains, contacts = _lattice(periodic=True)
    box = [[0, 4 * _SPACING]] * 3
    with pytest.warns(SceneWarning, match="periodic= lacks an axis"):
        _open(grains, contacts, box=box, periodic="xy")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _open(grains, contacts, box=box, periodic="xyz")


def test_a_hundredth_of_the_contacts_is_no_verdict():
    grains, contacts = _lattice()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _open(grains, pd.concat([contacts, contacts.iloc[:1].assign(id2=60)]))


@pytest.mark.parametrize(
    ("pairs", "apart", "gap", "is_named"),
    [
        (100, 9, 0.2, False), (100, 10, 0.2, True), (100, 2, 1.5, False), (100, 3, 1.5, True),
        (2000, 15, 0.2, False), (2000, 80, 0.2, True),
    ],
)  # fmt: skip
def test_few_gaps_are_no_verdict(pairs, apart, gap, is_named):
    x = 10.0 * np.arange(pairs)
    distance = np.where(np.arange(pairs) < apart, 1.0 + gap, _SPACING)
    grains = pd.DataFrame({"x": np.r_[x, x + distance], "y": 0.0, "z": 0.0, "radius": 0.5})
    grains = grains.assign(id=np.arange(2 * pairs))
    contacts = pd.DataFrame({"id1": grains.id[:pairs], "id2": grains.id[:pairs] + pairs})
    contacts = contacts.assign(fx=-7.0, fy=0.0, fz=0.0)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        _open(grains, contacts)
    assert any("across a gap" in str(warning.message) for warning in said) == is_named


@pytest.mark.parametrize("force", [1.0, -1.0])
def test_bridges_and_bonds_may_have_gaps(force):
    grains, contacts = _lattice()
    grains = grains.assign(radius=0.4)  # gaps of 0.2 of R_i + R_j
    pull = contacts.assign(**{axis: -contacts[axis] for axis in ("fx", "fy", "fz")})
    mixed = pull.copy()
    mixed.loc[::4, ["fx", "fy", "fz"]] *= force  # of bonds, some push
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _open(grains, mixed)


def test_glued_spheres_and_other_shapes_are_not_judged():
    grains, contacts = _lattice()
    far = grains.assign(radius=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _open(far.assign(body_id=np.arange(64) // 2), contacts)
        _open(far.assign(volume=0.002), contacts)
