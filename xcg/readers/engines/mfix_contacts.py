"""Contacts of MFiX that stand twice: copies, mirrored rows of spheres, and both sides of superquadrics.

Three kinds of rows were found in its output, checked against the positions of the particles and the
``Collision_force`` on each.

- **Spheres** stand once, except across a cyclic boundary, where most pairs stand twice, with ids
  swapped. Their normal forces are each other's negative to the last bit. In a fifth of these pairs
  the tangential forces are not (by up to half of the force): MFiX keeps two histories of sliding,
  and each row is what it applied to its own ``ID1``. Hence rows are matched by ids and normal
  force, and the pair gets the mean of the two forces, which leaves the stress as MFiX had it.
- **Superquadrics** (SuperDEM) stand once for each of their two sides. Most of these rows are the
  same, ids in the same order, except for the side that they describe. Across a cyclic boundary ids
  are swapped, forces differ by some per cent besides their sign, and points stand one period apart.
  Such bodies are convex: rows of one pair of ids whose points agree, but for the period, are one
  contact.
- **Copies** of a row occur in some files, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xcg.scene.frame import entries_of
from xcg.scene.lattice import minimum_image
from xcg.scene.schema import COMPONENTS, Frame

EXACT = 2**24  # ids are Float32: whole numbers are exact below
_ROUNDING = 16 * float(np.finfo("f4").eps)
# Points of one contact agree to this share of the distance from its point to a centre: to rounding
# in MFiX's output.
_SAME_POINT = 0.5


def of_superquadrics(middle: NDArray, point: NDArray, length: NDArray) -> NDArray:
    """Return a mask of the contacts of superquadrics, from what MFiX writes for each row.

    For a superquadric, the points of the mesh are midway between a centre and
    ``FORCE_CHAIN_CONTACT_POINT``, and ``FORCE_CHAIN_LENGTH`` is the distance of these two. For
    spheres of radii R1, R2 and overlap h, they are midway between the centres, ``|R1 - R2 + 2 h| /
    2`` from ``FORCE_CHAIN_CONTACT_POINT``, and the length is the distance of the centres, ``R1 + R2
    - h``.

    Parameters
    ----------
    middle, point : array (n, 3)
        Points of the mesh, and ``FORCE_CHAIN_CONTACT_POINT`` (m).
    length : array (n,)
        ``FORCE_CHAIN_LENGTH`` (m).
    """
    apart = 2 * np.linalg.norm(point - middle, axis=1)
    rounding = _ROUNDING * max(np.abs(middle).max(initial=0.0), np.abs(point).max(initial=0.0))
    return np.abs(apart - length) <= 1e-3 * length + rounding


def distances_of_twins(
    contacts: Frame, mark: NDArray, points: NDArray, superquadric: NDArray
) -> NDArray:
    """Distances (m, 3) along each axis between the points of the two rows of contacts that stand twice.

    Parameters as in `each_contact_once`, and which rows are contacts of superquadrics (n,).
    """
    i = contacts["contact_i"]
    j = contacts["contact_j"]
    pair = [np.minimum(i, j), np.maximum(i, j)]
    swapped = i > j
    shared = _of_shared_pairs(i, j)  # few, of all that would be sorted
    is_superquadric = superquadric[shared]
    twins = _twins(shared[is_superquadric], pair)
    mirrored = _twins(shared[~is_superquadric], [*pair, *_without_sign(mark, swapped)])
    first, second = swapped[mirrored].T
    first, second = np.concatenate([twins, mirrored[first != second]]).T
    return np.abs(points[first] - points[second])


def _twins(indices: NDArray, keys: Sequence[NDArray]) -> NDArray:
    """Return the two rows (m, 2) of all that stand twice, by equal keys."""
    order, run = _runs([key[indices] for key in keys])
    return indices[order[np.bincount(run, minlength=1)[run] == 2]].reshape(-1, 2)


def periods_of(apart: NDArray, points: NDArray) -> dict[str, float]:
    """Periods by axis, from the distances between both points of contacts that stand twice.

    Parameters
    ----------
    apart : array (m, 3)
        From `distances_of_twins`: a period along the axes across whose edges a contact stands, else
        nearly zero.
    points : array (n, 3)
        Points of all contacts.
    """
    periods = {}
    for k, axis in enumerate(COMPONENTS):
        far = apart[apart[:, k] > 0.5 * apart[:, k].max(initial=0.0), k]
        # both rows are one contact, so that distances are a period to single precision, or nothing
        if len(far) and np.ptp(far) < 1e-3 * far.max() and far.max() > 1e-3 * np.ptp(points[:, k]):
            periods[axis] = float(np.median(far))
    return periods


def each_contact_once(contacts: Frame, mark: NDArray, points: NDArray) -> Frame:
    """Drop exact copies of rows and join mirrored ones.

    A mirrored row has the same pair of ids swapped and `mark` negated, exactly: both rows come from
    the same overlap and relative velocity, so that their Float32 values agree to the last bit. A
    pair may touch at several points (concave grains); these have different marks, or else are
    distinguished by their order in space, which the shift by a period between mirrored rows leaves
    as it is.

    Parameters
    ----------
    contacts : Frame
        Arrays by scene name, at least ``contact_i``, ``contact_j`` (n,) and ``contact_force`` (n,
        3).
    mark : array (n, 3) or (n,)
        What the two rows share: a vector that changes sign (normal force), or a scalar (overlap).
    points : array (n, 3)
        Contact points.

    Returns
    -------
    Frame
        One row a contact, in the given order. Of mirrored rows the one with the lower id first is
        kept, with the mean of the two forces: ``(F - F_mirrored) / 2``.
    """
    i = contacts["contact_i"]
    j = contacts["contact_j"]
    force = contacts["contact_force"]
    shared = _of_shared_pairs(i, j)  # most pairs stand once: no need to sort them further
    if not len(shared):
        return contacts
    low = np.minimum(i, j)
    high = np.maximum(i, j)
    swapped = i > j
    marks = _without_sign(mark, swapped)

    order, run = _runs([key[shared] for key in (i, j, *marks, *force.T, *points.T)])
    first = np.diff(run, prepend=-1) > 0
    copies = shared[order[~first]]
    shared = shared[order[first]]

    contact_keys = [key[shared] for key in (low, high, *marks)]
    order, _ = _runs([*contact_keys, swapped[shared], *points[shared].T])
    indices = shared[order]
    contact = _runs_along([key[order] for key in contact_keys])
    side = _runs_along([contact, swapped[indices]])
    # Within a contact, rows that are not swapped come first; the n-th swapped row mirrors the n-th
    # of them.
    rank = np.arange(len(indices)) - np.searchsorted(side, side)
    mirrored = swapped[indices] & (rank < np.bincount(contact, ~swapped[indices])[contact])
    kept = indices[(np.searchsorted(contact, contact) + rank)[mirrored]]
    gone = indices[mirrored]

    joined = force.copy()
    joined[kept] = (force[kept] - force[gone]) / 2
    keep = np.ones(len(i), bool)
    keep[copies] = keep[gone] = False
    return entries_of(contacts | {"contact_force": joined}, keep)


def both_sides_once(
    contacts: Frame, points: NDArray, length: NDArray, periods: dict[str, float]
) -> Frame:
    """Join the rows of superquadrics that are sides of one contact.

    Parameters
    ----------
    contacts : Frame
        Arrays by scene name, at least ``contact_i``, ``contact_j`` (n,) and ``contact_force`` (n,
        3).
    points : array (n, 3)
        Contact points (m).
    length : array (n,)
        Distance from the contact point to a centre (m).
    periods : dict
        Known periods by axis (m).

    Returns
    -------
    Frame
        One row a contact: of its rows the first, with the mean of their points, of their overlaps,
        and of their forces, turned to act on the same particle.
    """
    i = contacts["contact_i"]
    j = contacts["contact_j"]
    shared = _of_shared_pairs(i, j)
    if not len(shared):
        return contacts
    period = np.array([periods.get(axis, np.inf) for axis in COMPONENTS])
    pair = np.unique(
        np.stack([np.minimum(i, j), np.maximum(i, j)])[:, shared], axis=1, return_inverse=True
    )[1].ravel()
    # row that each row is joined to: the first of its pair at the same point
    first = np.arange(len(i))
    while len(shared):
        _, leader, position_in_pair = np.unique(pair, return_index=True, return_inverse=True)
        to = shared[leader][position_in_pair]
        away = np.linalg.norm(minimum_image(points[shared] - points[to], period), axis=1)
        same = (away <= _SAME_POINT * length[to]) | (shared == to)
        first[shared[same]] = to[same]
        shared = shared[~same]
        pair = pair[~same]

    joined = contacts | {
        "contact_force": np.where(i == i[first], 1.0, -1.0)[:, None] * contacts["contact_force"]
    }
    if "contact_point" in contacts:
        point = contacts["contact_point"]
        joined["contact_point"] = point[first] + minimum_image(point - point[first], period)
    for name in {"contact_force", "contact_point", "overlap"} & set(joined):
        joined[name] = _means(joined[name], first)
    keep = first == np.arange(len(i))
    return entries_of(joined, keep)


def _means(values: NDArray, group: NDArray) -> NDArray:
    """Mean of the rows of each group, in the row that the group is named by; other rows are undefined."""
    total = np.zeros_like(values)
    np.add.at(total, group, values)
    count = np.maximum(np.bincount(group, minlength=len(values)), 1)
    return (total.T / count).T


def _without_sign(mark: NDArray, swapped: NDArray) -> list[NDArray]:
    """Keys that both rows of a contact share: vectors are turned to act on the particle of the lower id."""
    if mark.ndim == 1:
        return [mark]
    return list((mark * np.where(swapped, -1.0, 1.0)[:, None]).T)


def _of_shared_pairs(i: NDArray, j: NDArray) -> NDArray:
    """Rows whose pair of ids occurs in other rows, too."""
    low = np.minimum(i, j)
    high = np.maximum(i, j)
    largest = max(np.abs(low).max(initial=0), np.abs(high).max(initial=0))
    if not largest < EXACT:  # NaN is not
        order, pair = _runs([low, high])
        return np.sort(order[np.bincount(pair, minlength=1)[pair] > 1])
    key = low * (2.0 * EXACT) + high  # exact in a double
    ordered = np.sort(key)
    twice = ordered[1:][ordered[1:] == ordered[:-1]]
    near = np.searchsorted(twice, key)
    return np.flatnonzero(np.append(twice, np.nan)[near] == key)


def _runs_along(keys: Sequence[NDArray]) -> NDArray:
    """Count the runs of equal keys along sorted rows, as in 0, 0, 1, 2, 2, 2."""
    new = np.zeros(len(keys[0]), bool)
    for key in keys:
        new[1:] |= key[1:] != key[:-1]
    return np.cumsum(new)


def _runs(keys: Sequence[NDArray]) -> tuple[NDArray, NDArray]:
    """Order that sorts rows by keys (the first one first), and the number of each sorted row's run."""
    order = np.lexsort(tuple(reversed(keys)))
    return order, _runs_along([key[order] for key in keys])
