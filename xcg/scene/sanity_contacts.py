"""Warnings about implausible contacts: attractive ones, distant contact points, ends that are not the particles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.scene.frame import indices_of
from xcg.scene.lattice import Lattice
from xcg.scene.sanity_sample import FEW, sample_of
from xcg.scene.schema import Frame

_FAR = 3.0  # diameters from a centre to a contact point; rods 18 times as long as wide reach as far
_MOST = 0.9  # share of contacts that pull
_CENTRAL = 1e-2  # sine of the angle between forces and branches, from positions of six digits
_OFF = 0.1  # largest distance of the ends in a file from the centres, in branches


def check_contacts(
    frame: Frame, index_i: NDArray, index_j: NDArray, lattice: Lattice, source: str
) -> None:
    """Warn of contact points far from the centres of their grains, and of contacts that pull nearly throughout.

    Parameters
    ----------
    frame : Frame
        Particles and contacts of one step.
    index_i, index_j : array (contacts,)
        Indices of the partners among the particles, negative where they are not there.
    lattice : Lattice
        Periodic images.
    source : str
        Names the step.
    """
    if not len(frame["position"]) or not len(index_i):
        return
    some = sample_of(len(index_i))
    index_i = index_i[some]
    index_j = index_j[some]
    point = frame["contact_point"][some]
    side_i = _side(frame["position"], index_i, point, lattice)
    side_j = _side(frame["position"], index_j, point, lattice)
    if "diameter" in frame:
        larger = np.maximum(_diameter(frame, index_i), _diameter(frame, index_j))
        away = np.maximum(np.linalg.norm(side_i, axis=1), np.linalg.norm(side_j, axis=1))
        distance = np.divide(away, larger, out=np.zeros_like(away), where=larger > 0.0)
        far = np.flatnonzero(distance > _FAR)
        if far.size:
            _warn_of_far(frame, some, far, distance, source)
            return
    if "contact_force" in frame:
        side_i[index_i < 0] = -side_j[index_i < 0]
        _check_tension(np.einsum("nk,nk->n", frame["contact_force"][some], side_i), source)


def _side(position: NDArray, index: NDArray, point: NDArray, lattice: Lattice) -> NDArray:
    """Return the vectors (n, 3) from contact points to a particle of each contact, zero where it is not there."""
    side = lattice.shortest(position[index] - point)
    side[index < 0] = 0.0
    return side


def _diameter(frame: Frame, index: NDArray) -> NDArray:
    """Return the diameters (n,) of particles, zero where they are not there."""
    return np.where(index < 0, 0.0, frame["diameter"][index])


def _warn_of_far(frame: Frame, some: slice, far: NDArray, distance: NDArray, source: str) -> None:
    """Warn of contact points at a `distance` (n,) in diameters from a centre."""
    first = far[0]
    i = frame["contact_i"][some][first]
    j = frame["contact_j"][some][first]
    warn_once(
        "far contacts",
        f"{source}: {far.size} of {len(distance)} contacts looked at lie more than {_FAR:g} diameters from the "
        f"centre of a particle of theirs ({distance[first]:.3g} diameters for contact_i={i}, contact_j={j}): "
        "they are of another step or box, ids are mixed up, positions were changed without contact_point, or "
        "periodic= lacks an axis",
    )


def _check_tension(along: NDArray, source: str) -> None:
    """Warn if nearly all forces on a particle point to the contact, by their component `along` (n,) away from it."""
    pulling = int((along < 0.0).sum())
    pushing = int((along > 0.0).sum())
    if pulling + pushing >= FEW and pulling > _MOST * (pulling + pushing):
        warn_once(
            "tension",
            f"{source}: {pulling} of {pulling + pushing} contacts looked at pull their particles together, so that "
            "pressure is negative nearly everywhere: contact_force is the force on contact_i, and where the data have "
            "that on the other, exchange the two (names=), or change the sign",
        )


def is_central(contacts: Frame, particles: Frame, lattice: Lattice) -> bool:
    """Return whether all forces between particles lie along the line of their centres; False for few contacts."""
    pairs, centres = _sampled_pairs(contacts, particles)
    branch = lattice.shortest(centres)
    force = contacts["contact_force"][pairs]
    across = np.linalg.norm(np.cross(branch, force), axis=1)
    most = _CENTRAL * np.linalg.norm(branch, axis=1) * np.linalg.norm(force, axis=1)
    return len(force) >= FEW and bool((across <= most).all())


def _sampled_pairs(contacts: Frame, particles: Frame) -> tuple[NDArray, NDArray]:
    """Return contacts between two particles among a sample, and the vectors (n, 3) from j to i of their centres."""
    count = len(contacts["contact_i"])
    some = np.arange(*sample_of(count).indices(count))
    ids = particles["particle_id"]
    index_i = indices_of(ids, np.asarray(contacts["contact_i"][some], "int64"))
    index_j = indices_of(ids, np.asarray(contacts["contact_j"][some], "int64"))
    is_pair = (index_i >= 0) & (index_j >= 0)
    position = particles["position"]
    return some[is_pair], position[index_i[is_pair]] - position[index_j[is_pair]]


def check_ends(raw: Frame, particles: Frame, lattice: Lattice, source: str) -> None:
    """Warn if the ends that a file of contacts holds are not the positions of the particles.

    Parameters
    ----------
    raw : Frame
        Contacts with ``wrapped_branch``, from j to i by the ends in the file (m), of any image.
    particles : Frame
        The particles of the same step.
    lattice : Lattice
        Periodic images.
    source : str
        Names the step.
    """
    pairs, centres = _sampled_pairs(raw, particles)
    ends = lattice.shortest(raw["wrapped_branch"][pairs])
    away = np.linalg.norm(lattice.shortest(ends - centres), axis=1)
    off = np.flatnonzero(away > _OFF * np.linalg.norm(ends, axis=1))
    if off.size:
        first = off[0]
        i = int(raw["contact_i"][pairs[first]])
        j = int(raw["contact_j"][pairs[first]])
        warn_once(
            "ends",
            f"{source}: the ends of {off.size} of {len(pairs)} contacts looked at are not the positions of their "
            f"particles (contact_i={i}, contact_j={j}: {ends[first]} from end to end, "
            f"{lattice.shortest(centres)[first]} from centre to centre): particles and contacts are of different "
            "steps or runs, columns are not in the order expected, or the box is another",
        )
