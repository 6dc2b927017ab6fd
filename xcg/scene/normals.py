"""Normals of contacts in the data, compared with the branches of spheres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError, warn_once
from xcg.scene.lattice import unit_vectors
from xcg.scene.spheres import SphereContacts

_LENGTH = 1e-3  # difference of the length of a unit vector from 1
_ANGLE = np.cos(np.radians(5.0))  # between a normal and the branch
_MOST = 0.01  # share of the contacts looked at whose normals may have another direction
_SAMPLE = 4096  # contacts whose normals are looked at


def checked_normals(contacts: SphereContacts) -> NDArray:
    """Return the unit normals (n, 3) from j to i of single spheres, scaled or turned with a warning.

    Raises
    ------
    SceneError
        If normals of spheres have other directions than their branches.
    """
    normal = _of_unit_length(contacts)
    every = np.arange(0, len(normal), max(1, len(normal) // _SAMPLE))
    pairs = contacts.pairs(every)
    length = np.linalg.norm(pairs.branch, axis=1)
    indices = pairs.indices[length > 0]
    unit = pairs.branch[length > 0] / length[length > 0, None]
    cosine = np.einsum("nk,nk->n", unit, normal[indices])
    is_set = normal[indices].any(axis=1)
    across = np.flatnonzero((np.abs(cosine) < _ANGLE) & is_set)
    if across.size > max(1, _MOST * len(indices)):
        first = indices[across[0]]
        raise SceneError(
            f"{contacts.source}: 'contact_normal' of {across.size} of {len(indices)} contacts looked at is not "
            f"along the line of centres ({contacts.named(first)}: {normal[first]}, but the centres give "
            f"{unit[across[0]]}): drop its columns, names={{'column': None}}, and normals follow from "
            "positions"
        )
    opposite = (cosine < -_ANGLE).sum()
    if opposite <= _MOST * len(indices):
        return normal
    warn_once(
        "opposite normals",
        f"{contacts.source}: 'contact_normal' of {opposite} of {len(indices)} contacts looked at points from "
        f"contact_i to contact_j ({contacts.named(indices[np.argmin(cosine)])}), and is turned: normals point "
        "from j to i. To take them from positions, drop their columns by names={'column': None}",
    )
    pairs = contacts.pairs(np.arange(len(normal)))
    turned = normal.copy()
    turned[pairs.indices] *= np.where(
        np.einsum("nk,nk->n", pairs.branch, normal[pairs.indices]) < 0, -1.0, 1.0
    )[:, None]
    return turned


def _of_unit_length(contacts: SphereContacts) -> NDArray:
    """Return the normals divided by their lengths, with a warning if these are not 1.

    Zero normals are replaced by the directions of the branches.
    """
    normal = contacts.contacts["contact_normal"]
    length = np.sqrt(np.einsum("nk,nk->n", normal, normal))
    pairs = contacts.pairs(np.flatnonzero(length == 0))
    if pairs.indices.size:
        warn_once(
            "normals of zero",
            f"{contacts.source}: 'contact_normal' of {pairs.indices.size} of {len(length)} contacts is zero "
            f"({contacts.named(pairs.indices[0])}), and is taken from positions",
        )
        normal = normal.copy()
        normal[pairs.indices] = unit_vectors(pairs.branch)
    wrong = np.flatnonzero((np.abs(length - 1) > _LENGTH) & (length > 0))
    if not wrong.size:
        return normal
    first = wrong[0]
    warn_once(
        "length of normals",
        f"{contacts.source}: 'contact_normal' of {wrong.size} of {len(length)} contacts has another length "
        f"than 1 ({contacts.named(first)}: {length[first]:.4g}), and is divided by it. If the columns are a "
        "branch or a force, map them to that by names=",
    )
    scaled = normal.copy()
    scaled[wrong] /= length[wrong, None]
    return scaled
