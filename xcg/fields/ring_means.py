"""Averages over the rings of a cylinder: sums at the angles are turned into (r, theta, z) and brought together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import points as loops
from xcg.compiled.rings import ROOM, Flow, Rings, ring_means, ring_references, ring_squares
from xcg.fields.passes import Pass, Squared
from xcg.fields.sums.moments import MOMENTS

_TO_TURN = (  # moments in kinematic columns that are vectors and tensors, and the level from which they are there
    (loops.VELOCITY, "momentum"),
    (loops.FLUCTUATION, "kinetic"),
    (loops.LINEAR, "offset"),
    (loops.LINEAR, "shear"),
    (loops.LINEAR, "spread"),
    (loops.SQUARED, "square_offset"),
    (loops.SQUARED, "square_spread"),
)
_VECTORS = [*(name for _, name in _TO_TURN), "cubes"]
_FLOW = {name: MOMENTS[name].first + MOMENTS[name].columns for name in _VECTORS}
_SHIFTED = Flow(**{name: _FLOW[name] for name in Flow._fields})


def average_over_rings(run: Pass, rings: Rings, sums: NDArray, velocities: NDArray) -> NDArray:
    """Return averages (groups, nodes, columns) of the sums of a pass.

    Numbers relative to a velocity are brought to one velocity first, in the axes of the cylinder
    the same at all angles of a node.

    Parameters
    ----------
    sums, velocities : array (groups, angles, columns), (angles, 3)
        Sums at the angles, and what they are relative to.
    """
    groups, _, columns = sums.shape
    reference, difference = reference_of_rings(rings, velocities, turns=run.vector)
    averaged = np.zeros((groups, len(reference), columns))
    record = np.empty(columns)
    tensor = np.empty(27)
    tensors = _tensors(run)
    ring_means(sums, rings, difference, tensors, run.level, _SHIFTED, record, tensor, averaged)
    if len(rings.angle) > len(reference):
        for squared in run.squared:
            _square(run, squared, rings, averaged)
    return averaged


def reference_of_rings(
    rings: Rings, velocities: NDArray, *, turns: bool = True
) -> tuple[NDArray, NDArray]:
    """Return one velocity (nodes, 3) for all angles of each ring, and the offsets (angles, 3) from it.

    NaN where nothing reaches. `turns` says whether it is a vector, which has other components at
    each angle.
    """
    mean = np.empty((len(rings.place), 3))
    difference = np.empty_like(velocities)
    ring_references(velocities, rings, turns, mean, difference)
    return mean, difference


def _square(run: Pass, squared: Squared, rings: Rings, averaged: NDArray) -> None:
    """Replace the per-angle sums of squared weights by the sums of the fit over the whole ring."""
    nodes = squared.smoothing.nodes
    seen_z = "z" in nodes.active_axes
    dimension = len(nodes.active_axes + nodes.averaged)
    row, position = squared.images
    cutoff = squared.smoothing.cutoff
    low = rings.place.min(axis=0)
    high = rings.place.max(axis=0)
    middle = 0.5 * (low + high)
    reach = 0.5 * (high - low) + cutoff
    radius = np.hypot(position[:, 0], position[:, 1])
    near = np.abs(radius - middle[0]) < reach[0]
    if seen_z:
        near &= np.abs(position[:, 2] - middle[1]) < reach[1]
    row = row[near]
    grains = position[near], squared.grains.mass[row], squared.grains.phase[row]
    out = np.zeros((run.groups, len(rings.place), 10))
    scratch = np.zeros((5, int(np.diff(rings.start).max()) + ROOM))
    weights = squared.smoothing.weights
    vectors = np.zeros((4, 3))
    ring_squares(grains, weights, cutoff, rings, seen_z, dimension, scratch, vectors, out)
    columns = loops.SQUARES[:1]
    if run.level >= loops.SQUARED:
        columns = loops.SQUARES
    for k, column in enumerate(columns):
        averaged[squared.groups, :, column] = out[squared.groups, :, k]


def _tensors(run: Pass) -> tuple[NDArray, NDArray]:
    """Rank (t,) and columns (t, 27) of all vectors and tensors of a pass."""
    parts = [_FLOW[name] for level, name in _TO_TURN if run.level >= level and run.vector]
    if run.level == loops.CUBIC:
        parts.append(_FLOW["cubes"])
    parts += [own for own, _ in run.moments.values() if own.ndim and own.min() >= run.level]
    ranks = np.array([part.ndim for part in parts], dtype=int)
    columns = np.array([np.resize(part, 27) for part in parts], dtype=int)
    return ranks, columns.reshape(-1, 27)
