"""Motion of grains from one frame to another: by id, and relative to the periodic box, which may deform with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.scene.lattice import Lattice, same_vectors
from xcg.scene.repeats import rows_of
from xcg.scene.schema import Frame


@dataclass(frozen=True, eq=False)
class BoxMotion:
    """The displacement ``shift + gradient r`` that a box imposes on what it holds: zero along axes that are open.

    What is known of the shape of a box in both frames is here.

    Attributes
    ----------
    gradient : array (3, 3)
        Change of the periods over the periods.
    shift : array (3,)
        Displacement that belongs to the origin of coordinates (m).
    lattice : Lattice
        Periodic images of the later frame.
    """

    gradient: NDArray
    shift: NDArray
    lattice: Lattice

    @classmethod
    def between(cls, first: Lattice, later: Lattice) -> BoxMotion:
        """Compare the boxes of two frames."""
        stretch, lower, moved = np.zeros((3, 3))
        wraps = np.isfinite(first.lengths)
        if first.edges is not None and later.edges is not None:
            known = wraps & np.isfinite(first.edges[:, 0]) & np.isfinite(later.edges[:, 0])
            lower[known] = first.edges[known, 0]
            moved[known] = later.edges[known, 0] - first.edges[known, 0]
            # an edge that is a period further on is the same edge
            moved = later.shortest(moved[None])[0]
        if first.vectors is None and later.vectors is None:
            stretch[wraps] = later.period[wraps] / first.period[wraps] - 1.0
            return cls(np.diag(stretch), moved - stretch * lower, later)
        before, after = first.given, later.given
        turned = same_vectors(before, after, np.flatnonzero(wraps)) @ after
        gradient = (np.linalg.pinv(before) @ (turned - before)).T
        return cls(gradient, moved - gradient @ lower, later)

    def relative(self, position: NDArray, later: NDArray) -> NDArray:
        """Displacements (n, 3) of grains less that of the box where they were, in the image that moved least."""
        return self.lattice.shortest(later - position - self.shift - position @ self.gradient.T)


def partners(first: Frame, later: Frame, sources: tuple[str, str]) -> NDArray:
    """Row in a later frame of each grain of the first, -1 for those that are not there any more.

    Raises
    ------
    SceneError
        If the first frame holds grains, and the later one none of them.
    """
    rows = rows_of(later["particle_id"], first["particle_id"])
    if len(rows) and (rows < 0).all():
        raise SceneError(
            f"{sources[0]} and {sources[1]} have no particle id in common: grains are followed by ids that stay the "
            "same from step to step; choose a smaller lag, or open the files with names= for the column of such ids"
        )
    return rows
