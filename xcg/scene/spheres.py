"""Contacts compared with the spheres of their particles: gaps, overlaps, contact points, coincident centres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.scene.lattice import Lattice
from xcg.scene.schema import Frame

_ROUNDING = 1e-6  # of R_i + R_j; spheres with a smaller gap touch
SAME_BRANCH = 0.25  # of its length; a branch that is off by more is another vector, or a step old
_SAMPLE = 256  # contacts that are compared; more would slow down the reading of small steps
_SIX_DIGITS = 1e-5  # error of distances from positions of six digits, over the largest coordinate
_MOST = 0.9  # share of the compared contacts that a verdict needs
_SAME_OVERLAP = 0.25  # relative difference of two columns of overlaps, by their medians
_UNEQUAL = 1e-3  # difference of radii, over their sum, from which the middle is another point
_SOFT = 0.2  # largest overlap or gap, over R_i + R_j, of spheres that are taken to touch
_UNITS = (1e3, 1e-3)  # of mm over m, and of m over mm
# distance from the surfaces, over the smaller radius, of points that are no contact points
_ELSEWHERE = 0.4
_MIDDLE = 0.25  # distance to the middle, over the distance from there to the surfaces


def are_spheres(particles: Frame) -> bool:
    """Return whether particles are spheres of known size, and not of another known shape."""
    return "diameter" in particles and "half_axis_x" not in particles


def nearest_branches(
    apart: NDArray, data_branch: NDArray | None, lattice: Lattice
) -> NDArray | None:
    """Return the images of vectors (n, 3) nearest to the branches in the data, or None.

    None if the data hold no branches, or vectors that are not those between the positions.
    """
    if data_branch is None:
        return None
    branch = lattice.shortest(apart, data_branch)
    off = np.linalg.norm(branch - data_branch, axis=1)
    if not (off <= SAME_BRANCH * np.linalg.norm(data_branch, axis=1)).all():
        return None
    return branch


def warn_of_coincident(i: NDArray, j: NDArray, source: str) -> None:
    """Warn of contacts (n,) between particles, given by their ids, at the same position."""
    if len(i):
        warn_once(
            "coincident centres",
            f"{source}: {len(i)} contacts join particles at the same position (contact_i={i[0]}, "
            f"contact_j={j[0]}): their normal is undefined and taken as zero, and a contact point "
            "that follows from radii is the common centre. Drop particles that are listed twice",
        )


def _lengths(vectors: NDArray) -> NDArray:
    """Lengths (n,) of vectors (n, 3), faster than np.linalg.norm for few vectors."""
    return np.sqrt(np.einsum("nk,nk->n", vectors, vectors))


@dataclass(frozen=True, eq=False)
class Pairs:
    """Contacts of two spheres.

    Attributes
    ----------
    indices : array (n,)
        Indices of the contacts.
    radius_i, radius_j : array (n,)
        Radii of both spheres (m).
    branch : array (n, 3)
        Vectors from j to i (m), in the images of the contact.
    side_sum : array (n, 3) or None
        Vectors from the contact point to i and to j, added up (m); None without contact points.
    """

    indices: NDArray
    radius_i: NDArray
    radius_j: NDArray
    branch: NDArray
    side_sum: NDArray | None

    @cached_property
    def touching(self) -> NDArray:
        """Distance of the centres where the spheres touch (n,)."""
        return self.radius_i + self.radius_j

    @cached_property
    def overlap(self) -> NDArray:
        """Overlaps (n,), negative across a gap."""
        return self.touching - _lengths(self.branch)


@dataclass(frozen=True, eq=False)
class SphereContacts:
    """Contacts of one step between spheres of known size.

    Attributes
    ----------
    contacts : Frame
        Contacts in the scene's units.
    number : array (n,)
        Rows of the file, for messages.
    particles : Frame
        Particles of the same step, with diameters.
    index_i, index_j : array (n,)
        Indices of both partners among the particles, negative for partners that are not there.
    data_branch : array (n, 3) or None
        Branches in the data (m), which select the images.
    source : str
        File and step, for messages.
    """

    contacts: Frame
    number: NDArray
    particles: Frame
    index_i: NDArray
    index_j: NDArray
    data_branch: NDArray | None
    lattice: Lattice
    source: str

    def without_contact(self) -> NDArray:
        """Return the indices of pairs that have no force and do not touch. Warn of them.

        Lists of neighbours hold such pairs. Spheres that touch without a force are contacts, and
        so are spheres that a force joins across a gap, such as a capillary bridge.
        """
        force = self.contacts["contact_force"]
        indices = np.flatnonzero(force[:, 0] == 0.0)  # by one component first, as there are few
        indices = indices[(force[indices] == 0.0).all(axis=1)]
        if not indices.size:
            return indices
        pairs = self.pairs(indices)
        apart = np.flatnonzero(pairs.overlap < -_ROUNDING * pairs.touching)
        indices = pairs.indices[apart]
        if indices.size:
            warn_once(
                "pairs without contact",
                f"{self.source}: {indices.size} of {len(force)} rows of contacts have no force, and a "
                f"gap between their spheres ({self.named(indices[0])}: {-pairs.overlap[apart[0]]:.3g}), "
                "as pairs in a list of neighbours have: they are no contacts and are dropped. LAMMPS "
                "leaves them out where compute pair/local and property/local say 'cutoff radius'",
            )
        return indices

    def checked_overlaps(self, column: str) -> NDArray:
        """Return the overlaps (n,); if they are not overlaps, warn and compute them from the spheres.

        Parameters
        ----------
        column : str
            Name of the overlaps in the file, for the message.
        """
        overlap = self.contacts["overlap"]
        indices = self.sample.indices
        expected = self.sample.overlap
        if indices.size:
            plausible = self._agree(indices, expected)
        else:
            indices = self._walls_among(self.sampled_indices)
            if not indices.size:
                return overlap
            expected = self._depths(indices)
            # codes put the point at R (which tells no overlap), R - overlap / 2 or R - overlap
            plausible = bool(np.median(expected) <= self._rounding(indices))
            plausible |= any(self._agree(indices, k * expected) for k in (1.0, 2.0))
        if plausible:
            return overlap
        worst = np.argmax(np.abs(overlap[indices] - expected))
        warn_once(
            f"overlaps from {column}",
            f"{self.source}: {column!r} is not the overlap ({self.named(indices[worst])}: "
            f"{overlap[indices[worst]]:.3g}, but radii and positions give {expected[worst]:.3g}): "
            "overlaps are computed from radii and positions instead. Name the column by what it "
            f"is, such as names={{{column!r}: 'contact_area'}}, or drop it by None",
        )
        every = np.arange(len(overlap))
        pairs = self.pairs(every)
        walls = self._walls_among(every)
        computed = overlap.copy()
        computed[pairs.indices] = pairs.overlap
        if walls.size:
            computed[walls] = self._depths(walls)
        return computed

    def points_are_middles(self) -> bool:
        """Return whether points lie midway between centres of unequal spheres. Warn if they do."""
        pairs = self.sample
        unequal = np.abs(pairs.radius_i - pairs.radius_j)
        tested = unequal > _UNEQUAL * pairs.touching
        if pairs.side_sum is None or not tested.any():
            return False
        from_middle = np.linalg.norm(pairs.side_sum, axis=1) / 2
        # the surfaces are |R_i - R_j| / 2 from the middle
        at_middle = from_middle <= _MIDDLE * unequal / 2
        near = np.abs(pairs.overlap) <= _SOFT * pairs.touching
        if (at_middle & near)[tested].mean() < _MOST:
            return False
        warn_once(
            "points in the middle",
            f"{self.source}: contact points lie midway between the centres of spheres of unequal "
            f"sizes ({self.named(pairs.indices[tested][0])}), off both surfaces, as those of MercuryDPM "
            "before 2016: they are moved to where the spheres touch, R_i - overlap / 2 from the "
            "centre of i",
        )
        return True

    def warn_of_points_elsewhere(self) -> None:
        """Warn if points lie far from the surfaces of both spheres, which touch."""
        pairs = self.sample
        if pairs.side_sum is None or not len(pairs.indices):
            return
        off_i = np.abs(_lengths(pairs.side_sum + pairs.branch) / 2 - pairs.radius_i)
        off_j = np.abs(_lengths(pairs.side_sum - pairs.branch) / 2 - pairs.radius_j)
        off = np.minimum(off_i, off_j) / np.minimum(pairs.radius_i, pairs.radius_j)
        near = np.abs(pairs.overlap) <= _SOFT * pairs.touching
        elsewhere = (off > _ELSEWHERE) & near
        few = not elsewhere.any() or elsewhere.sum() < _MOST * near.sum()
        if few and self.unit_of_points is None:
            return
        worst = np.argmax(np.where(near, off, 0.0))
        way_out = "Map the right columns to contact_point, or"
        if self.unit_of_points is not None:
            way_out = (
                f"Divided by {self.unit_of_points:g} they lie on them, so that they have another unit than "
                "positions, most likely: give both in one unit, or"
            )
        warn_once(
            "points elsewhere",
            f"{self.source}: contact points lie off the surfaces of both spheres "
            f"({self.named(pairs.indices[worst])}: by {off[worst]:.2g} of the smaller radius). {way_out} drop "
            "the columns of points by names={'column': None}: points then follow from radii",
        )

    @cached_property
    def unit_of_points(self) -> float | None:
        """1000 or 0.001 if points lie on the surfaces once they are divided by that, else None."""
        indices = self.sample.indices
        if "contact_point" not in self.contacts or not len(indices):
            return None
        i = self.index_i[indices]
        centre, radius = self.particles["position"][i], self.particles["diameter"][i] / 2
        for unit in (1.0, *_UNITS):
            side = self.lattice.shortest(centre - self.contacts["contact_point"][indices] / unit)
            if (np.abs(_lengths(side) - radius) <= _SOFT * radius).mean() >= _MOST:
                return None if unit == 1.0 else unit
        return None

    def warn_of_coincident_centres(self) -> None:
        """Warn if centres of a pair coincide; a sample of large steps is checked."""
        indices = self.sample.indices
        position = self.particles["position"]
        apart = position[self.index_i[indices]] - position[self.index_j[indices]]
        same = indices[~self.lattice.shortest(apart).any(axis=1)]
        contacts = self.contacts
        warn_of_coincident(contacts["contact_i"][same], contacts["contact_j"][same], self.source)

    @cached_property
    def sampled_indices(self) -> NDArray:
        """Indices spread over all contacts."""
        count = len(self.index_i)
        return np.arange(0, count, max(1, count // _SAMPLE))

    @cached_property
    def sample(self) -> Pairs:
        """Pairs among contacts spread over all."""
        return self.pairs(self.sampled_indices)

    def pairs(self, indices: NDArray) -> Pairs:
        """Return the pairs among some contacts whose partners are both in the scene.

        Images are those nearest to the branches in the data, else to the contact points, else the
        shortest.
        """
        indices = indices[(self.index_i[indices] >= 0) & (self.index_j[indices] >= 0)]
        i, j = self.index_i[indices], self.index_j[indices]
        centre_i = self.particles["position"][i]
        centre_j = self.particles["position"][j]
        data_branch = None if self.data_branch is None else self.data_branch[indices]
        branch = nearest_branches(centre_i - centre_j, data_branch, self.lattice)
        side_sum = None
        if "contact_point" in self.contacts:
            point = self.contacts["contact_point"][indices]
            side_i = self.lattice.shortest(centre_i - point)
            side_j = self.lattice.shortest(centre_j - point)
            side_sum = side_i + side_j
            branch = side_i - side_j if branch is None else branch
        if branch is None:
            branch = self.lattice.shortest(centre_i - centre_j)
        diameter = self.particles["diameter"]
        return Pairs(indices, diameter[i] / 2, diameter[j] / 2, branch, side_sum)

    def _walls_among(self, indices: NDArray) -> NDArray:
        """Return the contacts at which a sphere touches a wall at a given point."""
        if "contact_point" not in self.contacts:
            return indices[:0]
        return indices[(self.index_i[indices] >= 0) & (self.contacts["contact_j"][indices] < 0)]

    def _depths(self, indices: NDArray) -> NDArray:
        """Depths (n,) of contact points with walls below the surface of the sphere."""
        i = self.index_i[indices]
        point = self.contacts["contact_point"][indices]
        to_point = self.lattice.shortest(self.particles["position"][i] - point)
        return self.particles["diameter"][i] / 2 - np.linalg.norm(to_point, axis=1)

    def _rounding(self, indices: NDArray) -> float:
        """Error of distances between positions of six digits (m)."""
        return _SIX_DIGITS * float(np.abs(self.particles["position"][self.index_i[indices]]).max())

    def _agree(self, indices: NDArray, expected: NDArray) -> bool:
        """Return whether the overlaps of some contacts are as expected (n,).

        True if grains are too far apart for spheres in contact, so that nothing is expected.
        Medians forgive single contacts, and positions that are a time step older than the contacts.
        """
        rounding = self._rounding(indices)
        if (expected >= -rounding).mean() < _MOST:
            return True
        off = abs(np.median(self.contacts["overlap"][indices] - expected))
        size = np.median(np.abs(expected))
        return bool(off <= _SAME_OVERLAP * size + rounding / np.sqrt(len(indices)))

    def named(self, index: int) -> str:
        """Return the row and ids of a contact, for messages."""
        i = self.contacts["contact_i"][index]
        j = self.contacts["contact_j"][index]
        return f"contact row {self.number[index]}, contact_i={i}, contact_j={j}"
