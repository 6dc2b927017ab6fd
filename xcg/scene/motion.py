"""Motion of grains from one frame to another: by id, and relative to the periodic box, which may deform with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xcg.scene.complete import minimum_image, periods, rows_of
from xcg.scene.schema import Frame, SceneError


@dataclass(frozen=True)
class BoxMotion:
    """The displacement ``shift + gradient r`` that a box imposes on what it holds: zero along axes that are open.

    What is known of the shape of a box in both frames is here.

    Attributes
    ----------
    gradient : array (3, 3)
        Change of the periods over the periods.
    shift : array (3,)
        Displacement that belongs to the origin of coordinates (m).
    period : array (3,)
        Periods of the later frame (m), infinity along open axes.
    """

    gradient: NDArray
    shift: NDArray
    period: NDArray

    @classmethod
    def between(
        cls, first: NDArray | None, later: NDArray | None, periodic: str, sources: tuple[str, str]
    ) -> BoxMotion:
        """Compare the boxes (3, 2) of two frames."""
        before, after = (periods(box, periodic, name) for box, name in zip((first, later), sources, strict=True))
        stretch, lower, moved = np.zeros((3, 3))
        wraps = np.isfinite(before)
        if first is not None and later is not None:
            stretch[wraps] = after[wraps] / before[wraps] - 1.0
            lower[wraps] = first[wraps, 0]
            # an edge that is a period further on is the same edge
            moved[wraps] = minimum_image((later - first)[None, wraps, 0], after[wraps])[0]
        gradient, shift = np.diag(stretch), moved - stretch * lower
        return cls(gradient, shift, after)

    def relative(self, position: NDArray, later: NDArray) -> NDArray:
        """Displacements (n, 3) of grains less that of the box where they were, in the image that moved least."""
        return minimum_image(later - position - self.shift - position @ self.gradient.T, self.period)


def partners(first: Frame, later: Frame, sources: tuple[str, str]) -> NDArray:
    """Row in a later frame of each grain of the first, -1 for those that are not there any more.

    Raises
    ------
    SceneError
        If the first frame holds grains, and the later one none of them.
    """
    rows = rows_of(later["particle_id"], first["particle_id"])
    if len(rows) and (rows < 0).all():
        msg = (
            f"{sources[0]} and {sources[1]} have no particle id in common: grains are followed by ids that stay the "
            "same from step to step; choose a smaller lag, or open the files with names= for the column of such ids"
        )
        raise SceneError(msg)
    return rows
