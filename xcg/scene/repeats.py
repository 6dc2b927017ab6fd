"""Contacts that are listed more than once: copies, and rows from both sides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_once
from xcg.scene.frame import indices_of
from xcg.scene.lattice import Lattice, unit_vectors
from xcg.scene.schema import Frame, Sides

# Rows of one pair are copies where their forces, and their points, differ by no more than this
# share of the force, and of the distance from the centre: rounding in files of six digits.
_ROUNDED = 1e-4
# Rows from both sides with the same force are an error up to this distance, over the distance from
# the centre.
_SAME_POINT = 0.05
_MOST_CONTACTS_A_PAIR = 64  # of equal force, that are compared with each other
# Rows from both sides are one contact where their forces differ from opposite ones by no more than
# this share of the larger, or of a hundredth of the mean force of such rows, and their points by
# this share of the smaller distance from the centre: the lever arm, which bodies of any shape have.
_OPPOSITE = 0.25
_SMALL_FORCE = 0.01
_ONE_POINT = 0.15
# variables whose sign depends on the side
_OF_SIDE = ("contact_force", "contact_normal")


def without_repeats(
    contacts: Frame, number: NDArray, particles: Frame, lattice: Lattice, sides: Sides, source: str
) -> Frame:
    """Merge contacts that are listed more than once.

    Copies, (i, j, f) twice or from both sides as (j, i, -f), are one contact where forces agree to
    1e-4, and points to 1e-4 of the distance from the centre. Rows from both sides whose forces are
    opposite to a quarter of the larger, and whose points are no more than 0.15 of their smaller
    distance from the centre apart, are one contact unless `sides` is "separate": with the mean of both forces,
    points, normals and overlaps for "mean", or as the row that comes first for "first". Other
    variables come from the first row. A warning states how many, and how far they differ, where
    forces do by more than 1e-4. Other contacts of one pair, which differ in force or point, all
    stay.

    Parameters
    ----------
    contacts : Frame
        Contacts of one step, completed.
    number
        Rows of the file, for messages.

    Raises
    ------
    SceneError
        If a contact is listed from both sides with the same force.
    """
    indices, pair = repeated_pairs(contacts["contact_i"], contacts["contact_j"])
    if not indices.size:
        return contacts
    repeats = _Repeats.of(contacts, indices, pair, particles, lattice)
    copied, has_both_sides = _copies(repeats, number, source)
    dropped = repeats.indices[copied]
    if sides != "separate":
        merged = _mirrored(repeats.kept(~copied), ~has_both_sides[~copied])
        if merged.unlike.size:
            _warn_of_unlike(contacts, merged.unlike, source)
        if (merged.mismatch > _ROUNDED).any():
            _warn_of_mirrored(merged.mismatch, sides, source)
        if sides == "mean" and merged.first.size:
            contacts = _with_means(contacts, merged.first, merged.second, lattice)
        dropped = np.concatenate([dropped, merged.second])
    if not dropped.size:
        return contacts
    return {name: np.delete(values, dropped, axis=0) for name, values in contacts.items()}


def repeated_pairs(i: NDArray, j: NDArray) -> tuple[NDArray, NDArray]:
    """Return the indices of contacts whose pair has several, pair after pair, and a number for the pair of each.

    The order of i and j makes no difference. Spheres touch once: one sort shows that no pair
    repeats.
    """
    if not len(i):
        return np.empty(0, int), np.empty(0, int)
    low, high = np.minimum(i, j), np.maximum(i, j)
    lows = int(low.max()) - int(low.min()) + 1
    highs = int(high.max()) - int(high.min()) + 1
    if lows * highs < 2**62:
        key = low
        # in place, as there may be many; overflow is harmless, as keys still differ
        key *= highs
        key += high
        del high
        sorted_keys = np.sort(key)  # far quicker than their order
        if (sorted_keys[1:] != sorted_keys[:-1]).all():
            return np.empty(0, int), np.empty(0, int)
        order = np.argsort(key, kind="stable")
        same = key[order[1:]] == key[order[:-1]]
    else:
        order = np.lexsort((high, low))
        same = (low[order[1:]] == low[order[:-1]]) & (high[order[1:]] == high[order[:-1]])
    inside = np.append(same, False) | np.insert(same, 0, False)
    return order[inside], np.insert(np.cumsum(~same), 0, 0)[inside]


@dataclass(frozen=True, eq=False)
class _Repeats:
    """Contacts (n,) of pairs that have several.

    Rows of a pair follow each other, sorted by the size of the force, so that rows of one contact
    are near each other.

    Attributes
    ----------
    indices, pair : array (n,)
        See `repeated_pairs`.
    mirrored : array (n,)
        Whether the first partner has the larger id.
    force, point : array (n, 3)
        Force (N) and contact point (m).
    size : array (n,)
        Size of the force (N).
    radius : array (n,)
        Distance of the point from the centre of a particle (m), by which distances of points are
        judged.
    lattice : Lattice
        Periodic images.
    """

    indices: NDArray
    pair: NDArray
    mirrored: NDArray
    force: NDArray
    point: NDArray
    size: NDArray
    radius: NDArray
    lattice: Lattice

    @classmethod
    def of(
        cls, contacts: Frame, indices: NDArray, pair: NDArray, particles: Frame, lattice: Lattice
    ) -> _Repeats:
        """Sort the rows of each pair by the size of their force."""
        size = np.linalg.norm(contacts["contact_force"][indices], axis=1)
        order = np.lexsort((size, pair))
        indices = indices[order]
        particle = indices_of(particles["particle_id"], contacts["contact_i"][indices])
        partner = indices_of(particles["particle_id"], contacts["contact_j"][indices])
        particle = np.where(particle >= 0, particle, partner)
        point = contacts["contact_point"][indices]
        centre = point.copy()
        centre[particle >= 0] = particles["position"][particle[particle >= 0]]
        return cls(
            indices=indices,
            pair=pair[order],
            mirrored=contacts["contact_i"][indices] > contacts["contact_j"][indices],
            force=contacts["contact_force"][indices],
            point=point,
            size=size[order],
            radius=np.linalg.norm(lattice.shortest(point - centre), axis=1),
            lattice=lattice,
        )

    def kept(self, chosen: NDArray) -> _Repeats:
        """Return the contacts that a mask (n,) selects."""
        names = [field.name for field in fields(self) if field.name != "lattice"]
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    def of_one_pair(self) -> Iterator[tuple[int, NDArray]]:
        """Yield distances in the list, and whether the rows so far apart are of one pair (n - distance,)."""
        for distance in range(1, min(len(self.indices), _MOST_CONTACTS_A_PAIR)):
            same = self.pair[distance:] == self.pair[:-distance]
            if not same.any():
                return
            yield distance, same

    def gap(self, one: NDArray, other: NDArray) -> NDArray:
        """Return the distance of the points of some contacts (k,) and others (k,)."""
        away = self.lattice.shortest(self.point[one] - self.point[other])
        return np.linalg.norm(away, axis=1)


def _copies(repeats: _Repeats, number: NDArray, source: str) -> tuple[NDArray, NDArray]:
    """Return a mask of the rows that repeat a contact (n,): the same force, from either side, at the same point.

    A second mask (n,) marks the rows that are repeated from the other side; `number` are rows of
    the file.

    Raises
    ------
    SceneError
        If a contact is listed from both sides with the same force.
    """
    copied = np.zeros(len(repeats.indices), bool)
    has_both_sides = np.zeros(len(repeats.indices), bool)
    force = repeats.force
    size = repeats.size
    radius = repeats.radius
    for distance, near in repeats.of_one_pair():
        near &= ~copied[distance:]
        near &= size[distance:] - size[:-distance] <= _ROUNDED * size[distance:]
        one = np.flatnonzero(near)
        if not one.size:
            break
        other = one + distance
        gap = repeats.gap(one, other)
        near = gap <= _SAME_POINT * radius[other]
        one = one[near]
        other = other[near]
        gap = gap[near]
        at_one_point = gap <= _ROUNDED * radius[other]
        turned = repeats.mirrored[one] != repeats.mirrored[other]
        rounding = _ROUNDED * size[other]
        same = np.linalg.norm(force[one] - force[other], axis=1) <= rounding
        opposite = np.linalg.norm(force[one] + force[other], axis=1) <= rounding
        copied[other[at_one_point & np.where(turned, opposite, same)]] = True
        has_both_sides[one[at_one_point & turned & opposite]] = True
        wrong = np.flatnonzero(turned & same & ~opposite)
        if wrong.size:
            first = one[wrong[0]]
            second = other[wrong[0]]
            raise SceneError(
                f"{source}: contact rows {number[repeats.indices[first]]} and "
                f"{number[repeats.indices[second]]} list one contact from both sides with the same force, "
                f"{force[first]}, so that both sides cancel; contact_force is that on contact_i: turn "
                "the sign of one of them, or list each contact once"
            )
    return copied, has_both_sides


@dataclass(frozen=True, eq=False)
class _Mirrored:
    """Rows that list one contact from both sides.

    Attributes
    ----------
    first, second : array (m,)
        Both rows, the one that comes first in the file first.
    mismatch : array (m,)
        Difference of both forces, over the larger.
    unlike : array (k, 2)
        Rows at one point whose forces differ by more, and that are no contact with a third one.
    """

    first: NDArray
    second: NDArray
    mismatch: NDArray
    unlike: NDArray


def _mirrored(repeats: _Repeats, free: NDArray) -> _Mirrored:
    """Find rows that list one contact from both sides, among contacts without copies.

    `free` (n,) marks the rows whose other side may be among them.
    """
    force = repeats.force
    size = repeats.size
    radius = repeats.radius
    least = 0.0
    if size.size:
        least = _SMALL_FORCE * size.mean()
    free = free.copy()
    pairs = [np.empty((2, 0), int)]
    mismatches = [np.empty(0)]
    beside = [np.empty((0, 2), int)]
    for distance, of_pair in repeats.of_one_pair():
        turned = repeats.mirrored[distance:] != repeats.mirrored[:-distance]
        candidates = np.flatnonzero(of_pair & turned)
        # rows that follow each other share one: every other of them at a time
        for parity in (0, 1):
            some = candidates[(candidates // distance) % 2 == parity]
            some = some[free[some] & free[some + distance]]
            other = some + distance
            mismatch = np.linalg.norm(force[some] + force[other], axis=1)
            larger = np.maximum(np.maximum(size[some], size[other]), least)
            near = repeats.gap(some, other) <= _ONE_POINT * np.minimum(radius[some], radius[other])
            same = near & (mismatch <= _OPPOSITE * larger)
            beside.append(np.stack([some, other], axis=1)[near & ~same])
            free[some[same]] = False
            free[other[same]] = False
            pairs.append(
                np.sort([repeats.indices[some[same]], repeats.indices[other[same]]], axis=0)
            )
            zero = np.zeros(same.sum())
            mismatches.append(
                np.divide(mismatch[same], larger[same], out=zero, where=larger[same] > 0)
            )
    first, second = np.concatenate(pairs, axis=1)
    unlike = np.concatenate(beside)
    unlike = repeats.indices[unlike[free[unlike].all(axis=1)]]
    return _Mirrored(first, second, np.concatenate(mismatches), unlike)


def _warn_of_mirrored(mismatch: NDArray, sides: Sides, source: str) -> None:
    taken = "as the row that comes first"
    others = "sides='separate' takes both rows as contacts of their own"
    if sides == "mean":
        taken = "with the mean of both sides"
        others += ", sides='first' the first"
    warn_once(
        "sides of contacts",
        f"{source}: {mismatch.size} contacts are listed from both sides with forces that differ by "
        f"{mismatch.mean():.2g} of the larger on average, {mismatch.max():.2g} at most: each is taken "
        f"once, {taken}; {others}",
    )


def _warn_of_unlike(contacts: Frame, unlike: NDArray, source: str) -> None:
    index, other = unlike[0]
    i, j = contacts["contact_i"][index], contacts["contact_j"][index]
    warn_once(
        "unlike sides of contacts",
        f"{source}: {len(unlike)} contacts are listed from both sides with forces that differ by more than "
        f"{_OPPOSITE:g} of the larger, such as {contacts['contact_force'][index]} on particle {i} and "
        f"{contacts['contact_force'][other]} on particle {j}: both rows count, so that stress and coordination may be "
        "twice as large; list each contact once, or pass sides='separate' if these are contacts of their own",
    )


def _with_means(contacts: Frame, first: NDArray, second: NDArray, lattice: Lattice) -> Frame:
    """Return contacts whose `first` rows hold the means of both sides."""
    merged = dict(contacts)
    for name in (*_OF_SIDE, "contact_point", "overlap"):
        if name not in merged:
            continue
        values = merged[name] = merged[name].copy()
        of_second = values[second]
        if name in _OF_SIDE:
            of_second = -of_second
        change = of_second - values[first]
        if name == "contact_point":
            change = lattice.shortest(change)
        values[first] += 0.5 * change
    if "contact_normal" in merged:
        merged["contact_normal"][first] = unit_vectors(merged["contact_normal"][first])
    return merged
