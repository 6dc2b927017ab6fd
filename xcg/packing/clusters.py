"""Clusters of grains that contacts connect, and whether they reach through the box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from xcg.compiled.contacts import join_clusters
from xcg.scene.contacts import Contacts


@dataclass(frozen=True, eq=False)
class Clusters:
    """Clusters of some grains of a frame: grains that contacts between them connect, single ones included.

    Attributes
    ----------
    contacts : Contacts
        Contacts of the frame.
    member : array (particles,)
        Whether each grain is one of them.
    """

    contacts: Contacts
    member: NDArray

    @cached_property
    def _joined(self) -> tuple[NDArray, NDArray]:
        """Root of the cluster of each grain (particles,), and along which lattice vectors that winds (particles, k)."""
        contacts, known = self.contacts, np.append(self.member, False)  # row -1 is that of a wall
        lattice, count = contacts.lattice, len(self.member)
        row_i, row_j = (np.where(known[row], row, -1) for row in (contacts.i, contacts.j))
        # in numbers of the vectors of the axes, which reduced ones of tilted boxes are sums of
        crossed = np.rint(contacts.crossed @ lattice.basis @ np.linalg.pinv(lattice.given)).astype("int64")
        root, moved = np.arange(count), np.zeros((count, crossed.shape[1]), "int64")
        winds = np.zeros(moved.shape, bool)
        join_clusters(row_i, row_j, crossed, root, moved, winds)
        return root, winds

    @property
    def size(self) -> NDArray:
        """Number of grains of each cluster; (clusters,)."""
        return np.unique(self._joined[0][self.member], return_counts=True)[1]

    @property
    def spans(self) -> NDArray:
        """Whether any cluster reaches through the box along x, y, z; (3,).

        Along a periodic axis a cluster does so if it winds around the box; along the others if it touches walls on both
        sides, those whose contacts' normals have their largest component along this axis.
        """
        (root, winds), contacts = self._joined, self.contacts
        through = np.zeros((len(root), 3), bool)
        periodic = np.isfinite(contacts.lattice.lengths)
        through[:, periodic] = winds
        sides = np.zeros((len(root), 3, 2), bool)
        for row, other, sign in ((contacts.i, contacts.j, 1.0), (contacts.j, contacts.i, -1.0)):
            known = np.flatnonzero((row >= 0) & (other < 0))
            known = known[self.member[row[known]]]
            normal = sign * contacts.normal[known]
            axis = np.abs(normal).argmax(axis=1)
            sides[root[row[known]], axis, (normal[range(len(known)), axis] < 0).astype(int)] = True
        through[:, ~periodic] = np.asarray(sides.all(axis=2))[:, ~periodic]
        return np.asarray(through[root[self.member]].any(axis=0))
