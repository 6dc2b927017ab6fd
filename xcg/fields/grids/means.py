"""Nodes that are averages over several places: their sums are turned at each place, brought together and averaged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import points as loops
from xcg.compiled.rings import ROOM, ring_squares
from xcg.fields.grids.points import PointBlock
from xcg.fields.sums.deposit import BlockSums
from xcg.fields.sums.moments import MOMENTS
from xcg.fields.sums.step import Layout, Squared

_TO_TURN = (  # flow columns that are vectors and tensors, and the level from which they are there
    (loops.VELOCITY, "momentum"),
    (loops.FLUCTUATION, "kinetic"),
    (loops.LINEAR, "offset"),
    (loops.LINEAR, "shear"),
    (loops.LINEAR, "spread"),
    (loops.SQUARED, "square_offset"),
    (loops.SQUARED, "square_spread"),
)
_FLOW = {name: MOMENTS[name].first + MOMENTS[name].columns for name in (*(n for _, n in _TO_TURN), "cubes")}


@dataclass(frozen=True, eq=False)
class RingBlock:
    """Nodes of a cylinder, each the average over angles at its radius and height, which are evaluated together.

    Attributes
    ----------
    places : array (m,)
        Where the nodes are among all nodes, unsigned.
    inner : PointBlock
        All angles of all nodes, one node after the other before they were sorted in space.
    rings : array (m, 2)
        Radius and height of each node (m).
    start : array (m + 1,)
        First angle of each node.
    angle, share : array (a,)
        Angles, and their shares of the average.
    dimension : int
        That of the scene.
    """

    places: NDArray
    inner: PointBlock
    rings: NDArray
    start: NDArray
    angle: NDArray
    share: NDArray
    dimension: int
    order = None

    def averages(self, found: BlockSums) -> BlockSums:
        """Return sums at the nodes: averages of those at all their angles."""
        return mean_sums(found, self)

    @property
    def is_mean(self) -> bool:
        """Whether any node has several angles."""
        return len(self.angle) > len(self.places)

    def mean(self, values: NDArray) -> NDArray:
        """Averages (..., m) of values (..., a)."""
        if not self.is_mean:
            return values
        return np.add.reduceat(values * self.share, self.start[:-1], axis=-1)


def mean_sums(found: BlockSums, block: RingBlock) -> BlockSums:
    """Average the sums at all angles of a block, turned into (r, theta, z) before.

    Numbers relative to a velocity are brought to one velocity first, in these axes the same at all angles of a node.
    """
    cosine, sine = np.cos(block.angle), np.sin(block.angle)
    common: dict[int, tuple[NDArray, NDArray]] = {}
    filled, references = [], []
    for run, sums, given in zip(found.of.passes, found.filled, found.references, strict=True):
        columns = np.empty(sums.shape[::-1][:1] + sums.shape[:2])
        columns[:, :, block.inner.places] = sums.transpose(2, 0, 1)
        layout = run.layout
        if id(given) not in common:
            common[id(given)] = _common(given, block, cosine, sine, vector=layout.vector)
        reference, difference = common[id(given)]
        _turn(layout, columns, cosine, sine)
        if layout.level:
            _shift(layout.level, columns, difference)
        averaged = np.ascontiguousarray(block.mean(columns).transpose(1, 2, 0))
        for squared in run.squared if block.is_mean else ():
            _square(layout, squared, block, averaged)
        filled.append(averaged)
        references.append(reference)
    velocity, _ = common.get(id(found.velocity)) or _common(found.velocity, block, cosine, sine, vector=True)
    return BlockSums(found.of, filled, velocity, references)


def _common(
    given: NDArray, block: RingBlock, cosine: NDArray, sine: NDArray, *, vector: bool
) -> tuple[NDArray, NDArray]:
    """One reference (m, 3) for all angles of each node, NaN where nothing reaches, and how others differ (3, a)."""
    turned = np.empty(given.shape[::-1])
    turned[:, block.inner.places] = given.T
    if vector:
        turned = np.stack(_turned(turned[0], turned[1], turned[2], cosine, sine))
    here = np.isfinite(turned[0])
    with np.errstate(invalid="ignore"):
        mean = block.mean(np.where(here, turned, 0.0)) / block.mean(here.astype(float))
    difference = np.where(here, turned - np.repeat(mean, np.diff(block.start), axis=1), 0.0)
    return np.ascontiguousarray(mean.T), difference


def _turned(x: NDArray, y: NDArray, z: NDArray, cosine: NDArray, sine: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    return cosine * x + sine * y, cosine * y - sine * x, z


def _turn(layout: Layout, columns: NDArray, cosine: NDArray, sine: NDArray) -> None:
    """Turn all vectors and tensors of a pass into (r, theta, z), in place; columns are (columns, groups, angles)."""
    parts = [_FLOW[name] for level, name in _TO_TURN if layout.level >= level and layout.vector]
    if layout.level == loops.CUBIC:
        parts.append(_FLOW["cubes"])
    elif layout.level >= loops.LINEAR:
        parts = [part for part in parts if part is not _FLOW["cubes"]]
    parts += [own for own, _ in layout.moments.values() if own.ndim and own.min() >= layout.level]
    for part in parts:
        tensor = columns[part]
        for axis in range(part.ndim):
            first = np.moveaxis(tensor, axis, 0)
            tensor = np.moveaxis(np.stack(_turned(first[0], first[1], first[2], cosine, sine)), 0, axis)
        columns[part] = tensor


def _shift(level: int, columns: NDArray, d: NDArray) -> None:
    """Take flow columns from u to u + d, in place; d is (3, angles)."""
    d = d[:, None]
    mass, momentum = columns[loops.MASS], columns[_FLOW["momentum"]]
    if level >= loops.FLUCTUATION:
        kinetic = columns[_FLOW["kinetic"]]
        if level == loops.CUBIC:
            along = (momentum * d).sum(axis=0)
            square = (d * d).sum(axis=0)
            columns[_FLOW["cubes"]] += (
                np.trace(kinetic) * d + 2.0 * (kinetic * d).sum(axis=1) + 2.0 * along * d + square * momentum
                + square * mass * d
            )  # fmt: skip
        columns[_FLOW["kinetic"]] = kinetic + momentum[:, None] * d + d[:, None] * momentum + mass * d[:, None] * d
    if level >= loops.LINEAR:
        columns[_FLOW["shear"]] += d[:, None] * columns[_FLOW["offset"]]
    columns[_FLOW["momentum"]] = momentum + mass * d


def _square(layout: Layout, squared: Squared, block: RingBlock, averaged: NDArray) -> None:
    """Put what fits over whole rings take of each grain in the place of what those at single angles take."""
    seen_z = bool(squared.active[2])
    low, high = block.rings.min(axis=0) - squared.cutoff, block.rings.max(axis=0) + squared.cutoff
    row, position = squared.rows, squared.position[squared.rows]
    if len(squared.lattice.basis):
        most = np.array([high[0], high[0], high[1] if seen_z else np.inf])
        least = np.array([-high[0], -high[0], low[1] if seen_z else -np.inf])
        image, shift, _ = squared.lattice.images(position, least, most)
        row, position = row[image], position[image] + shift
    radius = np.hypot(position[:, 0], position[:, 1])
    near = (radius > low[0]) & (radius < high[0])
    if seen_z:
        near &= (position[:, 2] > low[1]) & (position[:, 2] < high[1])
    row = row[near]
    grains = position[near], squared.mass[row], squared.phase[row]
    out = np.zeros((layout.groups, len(block.places), 10))
    scratch = np.zeros((5, int(np.diff(block.start).max()) + ROOM))
    ring_squares(
        grains, squared.weights, squared.cutoff, block.rings, block.start, block.angle, block.share, seen_z,
        block.dimension, scratch, np.zeros((4, 3)), out,
    )  # fmt: skip
    columns = [loops.SQUARE]
    if layout.level >= loops.SQUARED:
        columns += [*range(loops.SQUARE_OFFSET, loops.SQUARE_OFFSET + 3)]
        columns += [*range(loops.SQUARE_SPREAD, loops.SQUARE_SPREAD + 6)]
    groups = squared.groups
    for k, column in enumerate(columns):
        averaged[groups, :, column] = out[groups, :, k]
