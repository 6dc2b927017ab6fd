"""Boxes that files give by three vectors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from xcg.common.messages import SceneError
from xcg.scene.schema import COMPONENTS

_ROUNDING = 1e-12  # of the longest edge


def box_of_cell(cell: ArrayLike, origin: ArrayLike, periodic: str, source: str) -> dict[str, Any]:
    """Return `box`, `lattice` and `periodic` of a `StepRef`.

    Parameters
    ----------
    cell : array (3, 3)
        The vectors a, b, c, row by row; zeros along an axis that is not periodic and has no edges.
    origin : array (3,)
        The corner that the vectors start from.
    periodic : str
        The periodic axes.
    source : str
        File and step, for messages.

    Raises
    ------
    SceneError
        If a number is not finite, or a vector does not point along its axis.
    """
    vectors = np.asarray(cell, float)
    corner = np.asarray(origin, float)
    lengths = np.diagonal(vectors)
    if not (np.isfinite(vectors).all() and np.isfinite(corner).all()):
        raise SceneError(
            f"{source}: the box has the vectors {vectors.tolist()} and the origin "
            f"{corner.tolist()}, expected finite numbers"
        )
    for axis, vector, length in zip(COMPONENTS, vectors, lengths, strict=True):
        without = axis not in periodic and not vector.any()
        if length <= 0 and not without:
            raise SceneError(
                f"{source}: the vector {vector.tolist()} of the box has no positive component along "
                f"{axis}; turn the axes in the file so that its vectors point along x, y and z"
            )
    open_axes = lengths == 0
    low = np.where(open_axes, -np.inf, corner)
    high = np.where(open_axes, np.inf, corner + lengths)
    edges = tuple(zip(low.tolist(), high.tolist(), strict=True))
    lattice = None
    tilts = vectors - np.diag(lengths)
    if np.abs(tilts).max() > _ROUNDING * lengths.max():
        lattice = vectors.tolist()
    return {"box": edges, "lattice": lattice, "periodic": periodic}
