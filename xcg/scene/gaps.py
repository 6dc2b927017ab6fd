"""Contacts with forces across gaps between spheres, as of wrong ids: a warning with the likely cause."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.scene.frame import indices_of
from xcg.scene.schema import Frame
from xcg.scene.spheres import Pairs, SphereContacts

_MOST = 0.01  # share of the contacts looked at that may have gaps
_GAP = 0.1  # of R_i + R_j; smaller ones are of rounding, or of positions that are a step old
_WIDE = 1.0  # of R_i + R_j; no bridge or bond is so long
_PUSHING = 0.9  # share of the forces across gaps that push, unless they are bonds or bridges
_FEW = 10  # gaps that push by chance; distances that are alike by chance
_FEW_WIDE = 3
_MAJORITY = 0.5  # share of the contacts from which fewer gaps count
_TOUCHING = 0.02  # of R_i + R_j; a smaller gap is closed
_CLOSED = 0.9  # share of the contacts that other ids close
_FEW_WALLS = 6  # numbers of walls
_DIGITS = 6  # decimals of positions that are looked at
_AS_DEEP = 0.25  # overlaps as large as gaps, over the gaps: rounding makes both
_ALIKE = 0.1  # scatter of distances over R_i + R_j, where sizes have another unit
_FAR = 1.5  # least distance over R_i + R_j there
_SAME_VOLUME = 1e-2  # of volumes of spheres


def are_single_spheres(particles: Frame, shape: str) -> bool:
    """Return whether particles are discs, or spheres by their volumes, too, and not glued to bodies."""
    if "body_id" in particles:
        return False
    if shape == "disc":
        return True
    some = slice(None, None, max(1, len(particles["diameter"]) // 256))
    volume = particles.get("volume")
    if volume is None:
        return True
    spheres = np.pi / 6 * particles["diameter"][some] ** 3
    return bool((np.abs(volume[some] - spheres) <= _SAME_VOLUME * spheres).all())


def warn_of_gaps(contacts: SphereContacts) -> None:
    """Warn if forces between single spheres act across gaps that are neither bridges nor bonds.

    A sample of large steps is checked.
    """
    pairs = contacts.sample
    if not len(pairs.indices):
        return
    gap = -pairs.overlap
    force = contacts.contacts["contact_force"][pairs.indices]
    wide = gap > _WIDE * pairs.touching
    across = gap > _GAP * pairs.touching
    pushing = np.einsum("nk,nk->n", force, pairs.branch) > 0
    enough = _FEW
    if (pushing & across).sum() < _PUSHING * across.sum():
        across = wide
    if wide.sum() >= _FEW_WIDE:
        enough = _FEW_WIDE
    count = int(across.sum())
    if count <= max(1, _MOST * len(gap)) or (count < enough and count < _MAJORITY * len(gap)):
        return
    worst = int(np.argmax(np.where(across, gap / pairs.touching, 0.0)))
    warn_once(
        "gaps",
        f"{contacts.source}: {count} of {len(gap)} contacts looked at have a force across a "
        f"gap ({contacts.named(pairs.indices[worst])}: {gap[worst]:.3g}, "
        f"{gap[worst] / pairs.touching[worst]:.2g} of R_i + R_j), so that contact stress may have the "
        f"wrong sign: {_cause(contacts, pairs, across)}",
    )


def _cause(contacts: SphereContacts, pairs: Pairs, across: NDArray) -> str:
    """Return the likely cause of gaps, and what to do about it."""
    for shift in (-1, 1):
        if _closed_by(contacts, shift):
            high = "high" if shift < 0 else "low"
            return (
                f"with ids that are {shift:+d} the spheres touch, so the ids of contacts are one too {high} "
                "(0, 1, ... beside 1, 2, ...): pass contacts whose ids are "
                f"{'lowered' if shift < 0 else 'raised'} by 1 (xcg.scene_from_table), or particle_id= that "
                "begins as theirs do"
            )
    distances = 1.0 - pairs.overlap / pairs.touching
    factor = float(np.median(distances))
    are_alike = (np.abs(distances / factor - 1) <= _ALIKE).mean() >= _CLOSED
    if factor > _FAR and are_alike and len(distances) >= _FEW:
        return (
            f"centres are {factor:.3g} times R_i + R_j apart, nearly all of them: sizes have another unit than "
            "positions, or are half as large (radii that were read as diameters); give both in one unit"
        )
    decimals = _decimals(contacts.particles["position"])
    deep = (pairs.overlap > _GAP * pairs.touching).sum()
    is_rounding = deep >= _AS_DEEP * across.sum()
    if is_rounding and decimals is not None and (pairs.overlap[across] >= -4 * 0.1**decimals).all():
        return (
            f"positions have {decimals} decimals, and gaps are as large as their rounding: write positions "
            "with more digits"
        )
    indices = pairs.indices[across]
    partners = np.unique(contacts.contacts["contact_j"][indices])
    if len(indices) >= _FEW_WIDE and len(partners) <= min(_FEW_WALLS, len(indices) - 1):
        listed = ", ".join(map(str, partners.tolist()))
        return (
            f"all of them are with contact_j = {listed}: walls with numbers of their own, most likely; give "
            "walls negative numbers in contact_j (and contact_point_x, ...), as a column of types tells them "
            "from grains, or drop their rows"
        )
    return (
        "ids are of other grains or of walls, contacts are of another step, or periodic= lacks an axis. "
        "Map the right columns to contact_i and contact_j by names="
    )


def _closed_by(contacts: SphereContacts, shift: int) -> bool:
    """Return whether nearly all spheres touch if the ids of all contacts are shifted."""
    indices = contacts.sampled_indices
    ids = contacts.particles["particle_id"]
    ends = []
    for name in ("contact_i", "contact_j"):
        numbers = contacts.contacts[name][indices]
        ends.append(np.where(numbers < 0, -1, indices_of(ids, numbers + shift)))
    index_i, index_j = ends
    exist = (index_i >= 0) & (index_j >= 0)
    if exist.sum() < 2 or exist.mean() < _CLOSED:
        return False
    index_i, index_j = index_i[exist], index_j[exist]
    position = contacts.particles["position"]
    branch = contacts.lattice.shortest(position[index_i] - position[index_j])
    radius = contacts.particles["diameter"] / 2
    gap = np.linalg.norm(branch, axis=1) / (radius[index_i] + radius[index_j]) - 1
    return bool((gap <= _TOUCHING).mean() >= _CLOSED)


def _decimals(position: NDArray) -> int | None:
    """Return the number of decimals of all positions, None beyond six."""
    some = position[:: max(1, len(position) // 256)]
    for decimals in range(_DIGITS + 1):
        scaled = some * 10.0**decimals
        if np.allclose(scaled, np.round(scaled), rtol=0, atol=1e-6):
            return decimals
    return None
