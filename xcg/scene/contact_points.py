"""Points where spheres touch, of contacts that come without."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_once
from xcg.compiled.contacts import share_of_i, touching_points
from xcg.scene.lattice import Lattice
from xcg.scene.spheres import SAME_BRANCH, SphereContacts, nearest_branches, warn_of_coincident

REPEAT = "repeat the box once or more along that axis, or simulate a larger one"
_HAIR = 1e-9  # rounding of positions, as a share of the distances between them
_BLOCK = 1 << 14  # contacts whose points are derived together, in the cache of the processor


def touching_points_of(spheres: SphereContacts, derived: NDArray) -> NDArray:
    """Contact points (n, 3), derived from the spheres for `derived` contacts (n,); by blocks that stay in the cache."""
    points = np.empty((len(spheres.index_i), 3))
    if "contact_point" in spheres.contacts:
        points[:] = spheres.contacts["contact_point"]
    wanted = np.flatnonzero(derived)
    for first in range(0, len(wanted), _BLOCK):
        indices = wanted[first : first + _BLOCK]
        of_block = _plain_points(spheres, indices)
        if of_block is None:
            of_block = _points(spheres, indices)
        if of_block is None:
            warn_once(
                "branches of contacts",
                f"{spheres.source}: branches of contacts are not the vectors from j to i between the positions, or "
                "cross an edge that is not periodic, and the shortest are taken; drop them with names={'dx': None, "
                "...} if they are something else",
            )
            return touching_points_of(replace(spheres, data_branch=None), derived)
        points[indices] = of_block
    return points


def _plain_points(spheres: SphereContacts, indices: NDArray) -> NDArray | None:
    """Points where spheres touch in a box with edges along the axes; None if a pair is left to `_points`.

    A loop finds them in less than a tenth of the time. It knows neither tilted boxes nor partners
    that are not in the scene, and has no messages: `_points` has all these.
    """
    particles = spheres.particles
    lattice = spheres.lattice
    if lattice.reduced is not None or "diameter" not in particles:
        return None
    points = np.empty((len(indices), 3))
    period, _ = lattice.for_loops
    plain = touching_points(
        spheres.index_i[indices],
        spheres.index_j[indices],
        particles["position"],
        particles["diameter"],
        None if spheres.data_branch is None else spheres.data_branch[indices],
        SAME_BRANCH,
        period,
        _HAIR,
        points,
    )
    return points if plain == len(indices) else None


def _points(spheres: SphereContacts, indices: NDArray) -> NDArray | None:
    """Points where spheres touch; for a partner that is not in the scene, from the given middle.

    None where branches that the data hold are not those between the positions.
    """
    contacts = spheres.contacts
    particles = spheres.particles
    lattice = spheres.lattice
    index_i = spheres.index_i[indices]
    index_j = spheres.index_j[indices]

    def named(k: int) -> str:
        i = contacts["contact_i"][indices[k]]
        j = contacts["contact_j"][indices[k]]
        return f"{spheres.source}: contact row {spheres.number[indices[k]]} (i={i}, j={j})"

    alone = (index_i < 0) | (index_j < 0)
    if alone.any() and not {"contact_point", "overlap"} <= set(contacts):
        raise SceneError(
            f"{named(int(np.flatnonzero(alone)[0]))} has no contact point, and none follows without both spheres; "
            "give 'contact_point' for contacts with walls"
        )
    if "diameter" not in particles:
        raise SceneError(
            f"{spheres.source}: contact points follow from diameters, but the particles have none; give one of the two"
        )
    position = particles["position"]
    radius = particles["diameter"] / 2
    both = np.flatnonzero(~alone)
    only = np.flatnonzero(alone & (np.maximum(index_i, index_j) >= 0))
    i = index_i[both]
    j = index_j[both]
    data_branch = None if spheres.data_branch is None else spheres.data_branch[indices[both]]

    def refuse(wrong: NDArray, what: str) -> None:
        if wrong.size:
            raise SceneError(f"{named(both[wrong[0]])} {what}")

    centre = position[i]
    branch = _branches(centre - position[j], radius[i] + radius[j], data_branch, lattice, refuse)
    if branch is None:
        return None
    same = indices[both[(branch == 0.0).all(axis=1)]]
    warn_of_coincident(contacts["contact_i"][same], contacts["contact_j"][same], spheres.source)
    between = contact_points(centre, branch, radius[i], radius[j])
    for side in (centre - between, centre - between - branch):
        refuse(
            np.flatnonzero(lattice.is_halfway(side, _HAIR)),
            f"is half a period away from a centre, where both of its sides are one point; {REPEAT}",
        )
    points = np.empty((len(indices), 3))
    if "contact_point" in contacts:
        points = contacts["contact_point"][indices]
    points[both] = between
    if only.size:
        k = np.maximum(index_i, index_j)[only]
        branch = 2 * lattice.shortest(position[k] - points[only])
        overlap = contacts["overlap"][indices[only]]
        other = np.linalg.norm(branch, axis=1) + overlap - radius[k]
        points[only] = contact_points(position[k], branch, radius[k], other)
    return points


def _branches(
    apart: NDArray,
    touching: NDArray,
    data_branch: NDArray | None,
    lattice: Lattice,
    refuse: Callable[[NDArray, str], None],
) -> NDArray | None:
    """Images of vectors (n, 3) from j to i that touch at `touching` (n,): nearest to those in the data, or shortest.

    None where these are not near to those in the data.
    """
    if data_branch is not None:
        return nearest_branches(apart, data_branch, lattice)
    branch = lattice.shortest(apart)
    doubtful, _ = lattice.within(
        branch, np.maximum(np.linalg.norm(branch, axis=1), touching) * (1 + _HAIR)
    )
    refuse(
        doubtful[1:][doubtful[1:] == doubtful[:-1]],
        "may be on either side, as the box is so small that the two touch twice; give 'contact_point', or the vector "
        "from j to i as 'contact_branch' (files: names={'dx': 'contact_branch_x', ...})",
    )
    return branch


def contact_points(
    position_i: NDArray, branch: NDArray, radius_i: NDArray, radius_j: NDArray
) -> NDArray:
    """Points on the branches r_i - r_j of spheres, ``R_i - overlap / 2`` from the centre of i."""
    length = np.linalg.norm(branch, axis=1)
    share = share_of_i(np.where(length > 0, length, 1.0), radius_i, radius_j)
    return position_i - share[:, None] * branch
