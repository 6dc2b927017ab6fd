"""Regions of a scene: boxes of bounds by axis, and the images of grains inside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS

Bounds = Mapping[str, Sequence[float]]


def ends_of(bounds: Bounds, lattice: Lattice) -> Bounds:
    """Return lower and upper end of a region along each axis (m): its bounds, or the box; NaN for neither."""
    edges = lattice.edges
    if edges is None:
        edges = np.full((3, 2), np.nan)
    return {**dict(zip(COMPONENTS, edges, strict=True)), **bounds}


def images_in(
    bounds: Bounds, position: NDArray, lattice: Lattice, source: str
) -> tuple[NDArray, NDArray]:
    """Return positions (n, 3) as images in a region, and which of them are inside (n,).

    Along periodic axes, images begin at the bounds, or else at the box.
    """
    first = lattice.corner.copy()
    for k, axis in enumerate(COMPONENTS):
        if axis in bounds:
            first[k], high = bounds[axis]
            period = lattice.lengths[k]
            if high - first[k] > period * (1 + 1e-9):
                raise SceneError(
                    f"{source}: the region reaches from {first[k]:g} to {high:g} along {axis!r}, "
                    f"further than the period {period:g}, and would hold grains twice; take "
                    f"narrower bounds, or none along {axis!r} for the whole period"
                )
    # into the box first: grains there keep their rounding if the bounds are in the box, too
    position = lattice.wrapped(position, lattice.corner, source)
    position = lattice.wrapped(position, first, source)
    inside = np.ones(len(position), bool)
    for k, axis in enumerate(COMPONENTS):
        if axis in bounds:
            inside &= (bounds[axis][0] <= position[:, k]) & (position[:, k] < bounds[axis][1])
    return position, inside
