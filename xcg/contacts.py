"""Contacts of one frame: who touches whom, branch vectors, and the segments that carry stress."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xcg.complete import rows_of
from xcg.kernels.rows import add_dyads, add_rows, nearest_image
from xcg.schema import Frame

# Branches closer to one line than this (sine of their angle) share one segment from centre to centre; the
# contact point is then off that line by no more than the rounding of its coordinates.
COLLINEAR = 1e-12
# Contacts are those of spheres where the branches are as spheres have them, to this share of the radius.
SPHERES = 1e-2


@dataclass(frozen=True)
class Contacts:
    """Contacts by row of their particles.

    Attributes
    ----------
    i, j : array (n,)
        Rows of the two particles; -1 for a wall or a partner that is not in the scene.
    force : array (n, 3)
        Force on i (N).
    branch_i, branch_j : array (n, 3)
        From the contact point to the centre, ``r_i - c`` (m), nearest image; zero for a partner that is not there.
    given_normal : array (n, 3) or None
        Unit vector from j to i, where the data hold it.
    point : array (n, 3)
        Contact point (m).
    key_i, key_j : array (n,)
        Identifiers of the partners, walls included.
    count : int
        Number of particles.
    """

    i: NDArray
    j: NDArray
    force: NDArray
    branch_i: NDArray
    branch_j: NDArray
    given_normal: NDArray | None
    point: NDArray
    key_i: NDArray
    key_j: NDArray
    count: int

    @classmethod
    def of(cls, frame: Frame, period: NDArray) -> Contacts:
        """Join the contacts of a frame to the rows of its particles."""
        ids, position = frame["particle_id"], frame["position"]
        key_i, key_j, point = frame["contact_i"], frame["contact_j"], frame["contact_point"]
        row_i, row_j = rows_of(ids, key_i), rows_of(ids, key_j)
        branch_i, branch_j = np.empty_like(point), np.empty_like(point)
        nearest_image(position, row_i, point, period, branch_i)
        nearest_image(position, row_j, point, period, branch_j)
        normal = frame.get("contact_normal")
        return cls(row_i, row_j, frame["contact_force"], branch_i, branch_j, normal, point, key_i, key_j, len(ids))

    def with_overlaps(self, diameter: NDArray, overlap: NDArray) -> Contacts:
        """Return the contacts with branches of spheres as the code had them: ``a = n (R - overlap/2)``.

        Text files hold normals and overlaps with more digits than positions can tell. Contacts whose branches differ
        from that by more than `SPHERES` of a radius are not between spheres, and stay as they are.
        """
        both = np.flatnonzero((self.i >= 0) & (self.j >= 0))
        normal, spheres, branches = self.normal[both], np.ones(len(both), bool), []
        for row, given, sign in ((self.i, self.branch_i, 1.0), (self.j, self.branch_j, -1.0)):
            radius = diameter[row[both]] / 2
            branch = sign * (radius - overlap[both] / 2)[:, None] * normal
            spheres &= np.linalg.norm(branch - given[both], axis=1) <= SPHERES * radius
            branches.append(branch)
        branch_i, branch_j = self.branch_i.copy(), self.branch_j.copy()
        branch_i[both[spheres]], branch_j[both[spheres]] = branches[0][spheres], branches[1][spheres]
        return replace(self, branch_i=branch_i, branch_j=branch_j)

    @cached_property
    def normal(self) -> NDArray:
        """Unit vector from j to i, along the branch where none is given; zero where it is undefined; (n, 3)."""
        if self.given_normal is not None:
            return self.given_normal
        normal = np.where((self.i >= 0)[:, None], self.branch_i, -self.branch_j)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)

    def sum_over_particles(self, on_i: NDArray, on_j: NDArray) -> NDArray:
        """Sum what each contact gives to its two particles; arrays (n, ...) to (particles, ...)."""
        width = math.prod(on_i.shape[1:])
        total = np.zeros((self.count, width))
        for row, values in ((self.i, on_i), (self.j, on_j)):
            add_rows(row, values.reshape(len(row), width), total)
        return total.reshape(self.count, *on_i.shape[1:])

    @cached_property
    def partners(self) -> NDArray:
        """Number of contact partners of each particle, walls included; several contacts with one count once."""
        low, high = np.minimum(self.key_i, self.key_j), np.maximum(self.key_i, self.key_j)
        order = np.lexsort((high, low))
        repeated = (np.diff(low[order]) == 0) & (np.diff(high[order]) == 0)
        first = np.ones(len(low))
        first[order[1:][repeated]] = 0.0
        return self.sum_over_particles(first, first)

    @property
    def normals(self) -> NDArray:
        """Sum over contacts of n n for each particle (particles, 3, 3)."""
        product = self.normal[:, :, None] * self.normal[:, None, :]
        return self.sum_over_particles(product, product)

    @property
    def dyads(self) -> NDArray:
        """Sum over contacts of f a for each particle, force times branch (J); shape (particles, 3, 3)."""
        total = np.zeros((self.count, 3, 3))
        add_dyads(self.i, 1.0, self.force, self.branch_i, total)
        add_dyads(self.j, -1.0, self.force, self.branch_j, total)
        return total

    @property
    def forces(self) -> NDArray:
        """Total contact force on each particle (N); shape (particles, 3)."""
        return self.sum_over_particles(self.force, -self.force)

    @property
    def at_walls(self) -> tuple[NDArray, NDArray, NDArray]:
        """Particle row, contact point (m) and force on the particle (N) of the contacts with walls."""
        wall_j, wall_i = (self.j < 0) & (self.i >= 0), (self.i < 0) & (self.j >= 0)
        return (
            np.concatenate([self.i[wall_j], self.j[wall_i]]),
            np.concatenate([self.point[wall_j], self.point[wall_i]]),
            np.concatenate([self.force[wall_j], -self.force[wall_i]]),
        )

    def segments(self, position: NDArray, phase: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
        """Segments whose force x branch, smeared along them, is the contact stress.

        Each side of a contact runs from its particle's centre to the contact point. Both sides are one segment
        where they lie on one line and in one phase, as for spheres: ``f (a_i - a_j)`` along the whole branch.

        Returns
        -------
        start, branch, force : array (k, 3)
            Centre (m), vector from the segment's end to its start (m), force on that particle (N).
        phase, other : array (k,)
            Phase of that particle and of its partner; -1 for a wall or a partner that is not there.
        """
        i, j, a, b = self.i, self.j, self.branch_i, self.branch_j
        both = (i >= 0) & (j >= 0)
        area = np.linalg.norm(np.cross(a, b), axis=1)
        product = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        opposite = np.einsum("nk,nk->n", a, b) <= 0
        whole = both & opposite & (area <= COLLINEAR * product) & (phase[i] == phase[j])
        only_i, only_j = (i >= 0) & ~whole, (j >= 0) & ~whole
        return (
            np.concatenate([position[i[whole]], position[i[only_i]], position[j[only_j]]]),
            np.concatenate([a[whole] - b[whole], a[only_i], b[only_j]]),
            np.concatenate([self.force[whole], self.force[only_i], -self.force[only_j]]),
            np.concatenate([phase[i[whole]], phase[i[only_i]], phase[j[only_j]]]),
            np.concatenate([phase[j[whole]], *(np.where(k >= 0, phase[k], -1) for k in (j[only_i], i[only_j]))]),
        )
