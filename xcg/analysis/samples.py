"""Samples: the particles of one group at one time, with their contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from xcg.analysis.mixing import Mixture
from xcg.analysis.network import Clusters
from xcg.scene.contacts import Contacts

# Partners that hold a sphere in place without friction: one more than the dimensions.
NOT_A_RATTLER = {3: 4, 2: 3}
_ROUNDING = 1e-9  # of a force, below which its tangential part is none

OF_PARTICLES = {"position", "velocity", "diameter", "volume", "mass"}


@dataclass(frozen=True, eq=False)
class ContactSides:
    """Contacts of a frame, and what its particles have of them, which all its groups share.

    Attributes
    ----------
    contacts : Contacts
        All contacts of the frame.
    backbone : array (n,)
        Whether partners hold the particle in place (it is not a rattler).
    tangential_force : array (c,)
        Tangential forces (N), zero below rounding.
    virial : array (n, 3, 3)
        Sum of f a over the sides of each particle.
    """

    contacts: Contacts
    backbone: NDArray
    tangential_force: NDArray
    virial: NDArray

    @classmethod
    def of(cls, contacts: Contacts, dimension: int, *, iterative: bool) -> Self:
        """Sum over the contacts of each particle; rattlers are left out again and again if `iterative`."""
        least = NOT_A_RATTLER[dimension]
        total = np.linalg.norm(contacts.force, axis=1)
        tangential = np.linalg.norm(contacts.tangential_force, axis=1)
        tangential[~(tangential > _ROUNDING * total)] = 0.0
        virial_i = contacts.force[:, :, None] * contacts.branch_i[:, None, :]
        virial_j = -contacts.force[:, :, None] * contacts.branch_j[:, None, :]
        backbone = contacts.partners >= least
        if iterative:
            backbone = contacts.k_core(least)
        return cls(contacts, backbone, tangential, contacts.sum_over_particles(virial_i, virial_j))


class _Arrays:
    """Arrays of a sample, without those that the scene lacks.

    Attributes
    ----------
    position, velocity, diameter, volume, mass : array (n, ...)
        The particles of the group.
    partners, backbone : array (n,)
        Number of contact partners, and whether they hold the particle in place.
    virial : array (3, 3)
        Sum of f a over the particles' sides of their contacts.
    weight, normal : array (c, ...)
        The contacts of the group; a contact weighs half for each of its particles in the group, 1
        at a wall.
    pushing, normal_force, tangential_force : array (c,)
        Weights of the contacts that have a positive normal force, and their forces.
    clusters : Clusters
        Which grains of the group contacts between them connect.
    """

    position: NDArray
    velocity: NDArray
    diameter: NDArray
    volume: NDArray
    mass: NDArray
    partners: NDArray
    backbone: NDArray
    virial: NDArray
    weight: NDArray
    normal: NDArray
    pushing: NDArray
    normal_force: NDArray
    tangential_force: NDArray
    clusters: Clusters


@dataclass(eq=False, repr=False)
class Sample(_Arrays):
    """Particles and contacts of one group at one time.

    Attributes
    ----------
    count : int
        Number of particles.
    region_volume : float
        Volume of the region (m3), NaN where it is not known.
    plane : list of int
        Axes of the scene.
    is_endless : array (3,)
        Whether the region is a whole period along an axis, so that heights have no meaning.
    min_contacts, max_connectivity, force_bins
        Options of `microstructure`.
    which : int
        The group: 0 the bulk, 1, 2, ... the phases.
    mixture : Mixture or None
        All grains of the region by phase.
    """

    count: int
    region_volume: float
    plane: list[int]
    is_endless: NDArray
    min_contacts: int
    max_connectivity: int
    force_bins: NDArray
    which: int = 0
    mixture: Mixture | None = None

    def add_contacts(self, sides: ContactSides, member: NDArray) -> None:
        """Add the contacts of the particles that a mask (n,) of the frame selects.

        A contact counts half for each of its particles in the group, and whole for a particle at a
        wall.
        """
        contacts = sides.contacts
        is_member = np.append(member, False)  # row -1 is a missing partner
        members = is_member[contacts.i].astype(float) + is_member[contacts.j]
        particles = (contacts.i >= 0).astype(int) + (contacts.j >= 0)
        weight = members / np.maximum(particles, 1)
        counted = weight > 0
        self.weight = weight[counted]
        self.normal = contacts.normal[counted]
        pushing = counted & (contacts.normal_force > 0)
        self.pushing = weight[pushing]
        self.normal_force = contacts.normal_force[pushing]
        self.tangential_force = sides.tangential_force[pushing]
        self.clusters = Clusters(contacts, member)
        self.partners = contacts.partners[member]
        self.backbone = sides.backbone[member]
        self.virial = sides.virial[member].sum(axis=0)
