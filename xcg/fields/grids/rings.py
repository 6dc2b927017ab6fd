"""Nodes of a cylinder: radii, angles and heights, or averages over the angle by a rule that meets an error.

Sums at the angles of an average are turned into (r, theta, z), brought together and averaged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.checks import is_finite
from xcg.compiled import THREADS
from xcg.compiled import points as loops
from xcg.compiled.rings import ROOM, ring_squares
from xcg.fields.grids.grid import MAX_NODES, nodes_along
from xcg.fields.grids.points import PointBlock
from xcg.fields.sums.deposit import BlockSums
from xcg.fields.sums.kernels import Kernel
from xcg.fields.sums.moments import MOMENTS
from xcg.fields.sums.nodes import BLOCK_NODES, Grid
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
        """Return whether any node has several angles."""
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
    """Return a reference (m, 3) for all angles of each node, NaN where nothing reaches, and offsets (3, a)."""
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
    """Shift flow columns from u to u + d, in place; d is (3, angles)."""
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
    """Replace the per-angle sums of squared weights by the sums of the fit over the whole ring."""
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


NAMES = {"r": "r", "t": "theta", "z": "z"}  # letters of `axes`, and what else they are called
_FULL = 2.0 * math.pi
_FEWEST = 8  # angles of a ring: vectors and tensors turn once and twice on it
_PANEL = 8  # Gauss-Legendre points of a panel of a part of a circle
_FINEST = 128  # angles a radius of the support: where the error of a kernel that jumps is not met
_BLOCKS = 4  # parts a thread


def make_rings(
    axes: str, at: Mapping[str, Any], bounds: Mapping[str, Sequence[float]],
    spacing: float | Mapping[str, float], *, plane: str, kernel: Kernel, seen_all: int, error: float,
    automatic: Mapping[str, tuple[float, float]], period: Mapping[str, float],
) -> Grid:  # fmt: skip
    """Lay the nodes of a cylinder.

    Parameters
    ----------
    axes, at, bounds, spacing
        As in `xcg.coarse_grain`, for r, theta and z.
    plane : str
        The axes that the scene has.
    kernel : Kernel
        The one with the smallest support.
    seen_all : int
        Dimensions that the kernel has.
    error : float
        What averages over theta may differ by.
    automatic, period : mapping
        Bounds and period of r and z where none are given.

    Raises
    ------
    ValueError
        If an argument is wrong.
    """
    letters = "rtz" if "z" in plane else "rt"
    known = [NAMES[a] for a in letters]
    if set(axes) - set(letters) or len(set(axes)) < len(axes):
        raise ValueError(
            f"axes={axes!r}: in a cylindrical frame of this scene expected letters of {letters!r} (t is theta)"
        )
    resolved = [NAMES[a] for a in letters if a in axes]
    for name, given in (("at", at), ("bounds", bounds)):
        if wrong := [a for a in given if a not in known]:
            raise ValueError(f"{name} names {wrong}: the axes of this frame are {', '.join(known)}")
    if any(np.ndim(x) for x in at.values()):
        raise ValueError("at= has arrays, which name points: give these in the axes of the scene or of xcg.Rotated")
    fixed = {a: float(at[a]) for a in known if a in at}
    if both := [a for a in resolved if a in fixed]:
        raise ValueError(f"axes={axes!r} and at={dict(at)!r} both name {both}: an axis is either resolved or fixed")
    if "r" not in resolved and "r" not in fixed:
        raise ValueError(
            "a cylindrical frame takes r: resolve it (axes='r', 'rz', 'rtz', ...) or fix it (at={'r': ...})"
        )
    if loose := [a for a in bounds if a not in resolved and (a != "theta" or a in fixed)]:
        raise ValueError(
            f"bounds are given for {loose}, which are not resolved: add them to axes=, or leave their bounds out"
        )
    if not all(is_finite(x) for x in fixed.values()) or fixed.get("r", 0.0) < 0.0:
        raise ValueError(f"at={dict(at)!r}: expected finite coordinates, and none below zero for r")
    steps = dict(spacing) if isinstance(spacing, Mapping) else {"r": spacing, "z": spacing}
    nodes: dict[str, NDArray] = {}
    limits: dict[str, Sequence[float]] = dict(bounds)
    if "r" in resolved:
        if "r" not in limits and "r" in automatic and steps.get("r"):
            limits["r"] = 0.0, math.ceil(automatic["r"][1] / steps["r"]) * steps["r"]
        nodes["r"], _ = nodes_along("r", steps.get("r"), resolved, limits, automatic, {}, kernel.cutoff)
        if nodes["r"][0] < 0.0:
            raise ValueError(f"bounds['r']={tuple(bounds['r'])!r}: expected radii, none below zero")
    radii = nodes.get("r", np.array([fixed.get("r", 0.0)]))
    low, high = map(float, bounds.get("theta", (0.0, _FULL)))
    if not 0.0 < high - low <= _FULL * (1 + 1e-12):
        raise ValueError(
            f"bounds['theta']=({low!r}, {high!r}): expected two angles (rad), not further apart than a circle"
        )
    if "theta" in resolved:
        widest = max(float(radii.max()), kernel.cutoff)
        along = steps.get("theta", steps["r"] / widest if "r" in steps else None)
        around, once = {"theta": (0.0, _FULL)}, {"theta": _FULL}
        nodes["theta"], _ = nodes_along("theta", along, resolved, bounds, around, once, kernel.cutoff / widest)
    if "z" in resolved:
        nodes["z"], _ = nodes_along("z", steps.get("z"), resolved, bounds, automatic, period, kernel.cutoff)
    averaged = "z" if "z" in plane and "z" not in resolved and "z" not in fixed else ""
    seen = seen_all - len(averaged)
    heights = nodes.get("z", np.array([fixed.get("z", 0.0)]))
    reached = 0.0
    if "theta" in nodes or "theta" in fixed:
        angles = nodes.get("theta", np.array([fixed.get("theta", 0.0)]))
        rules = [[(np.array([x]), np.ones(1)) for x in angles] for _ in radii]
    else:
        step, reached = angular_step(kernel, seen, error)
        whole = high - low > _FULL * (1 - 1e-12)
        rules = [[_circle(r, step) if whole else _part(r, step, low, high)] for r in radii]
    count = sum(len(share) for rule in rules for _, share in rule) * len(heights)
    if count > MAX_NODES:
        raise ValueError(
            f"averages over theta would take {count} places, more than {MAX_NODES}: choose a larger spacing or error"
        )
    origin = np.array([0.0, 0.0, heights[len(heights) // 2]])
    top = float(radii.max())
    lower, upper = np.array([-top, -top, heights.min()]), np.array([top, top, heights.max()])
    parts = tuple(_blocks(radii, rules, heights, origin, kernel.cutoff, seen_all, count))
    on_axis = np.flatnonzero(
        np.repeat(radii == 0.0, len(rules[0]) * len(heights))
    )  # where r and theta have no direction
    mean = f", averages over {count} places" if any(part.is_mean for part in parts) else ""
    text = {
        "nodes": (" x ".join(f"{len(x)} {a}" for a, x in nodes.items()) or "one") + mean,
        "fixed": ", ".join(f"{a} = {x:g}" for a, x in fixed.items()) or "none",
    }
    coords = {a: xr.Variable(a, x) for a, x in nodes.items()} | {a: xr.Variable((), x) for a, x in fixed.items()}
    return Grid(
        tuple(nodes), tuple(map(len, nodes.values())), coords, "xyz" if "z" in coords else "xy", averaged, origin,
        lower, upper, text, parts=parts, undirected=on_axis, attrs={"theta_error": reached},
    )  # fmt: skip


def angular_step(kernel: Kernel, seen: int, error: float) -> tuple[float, float]:
    """Distance of neighbours on a ring (m) for which sums over them meet an error, and the error that they do meet.

    The error of the trapezoidal rule on a line through the support, at any distance from its middle and with its nodes
    anywhere, is at most this share of the integral over the line through the middle.
    """
    offset, shift = np.linspace(0.0, 0.98, 41), (np.arange(32) + 0.5) / 32

    def sums(step: float, starts: NDArray) -> NDArray:
        number = np.arange(-math.ceil(1.0 / step) - 1, math.ceil(1.0 / step) + 2)
        along = (number + starts[:, None]) * step
        length = np.sqrt(offset[:, None, None] ** 2 + along**2) * kernel.cutoff
        return step * kernel.value(length, seen).sum(axis=-1)

    exact = sums(1.0 / 2000, np.zeros(1))
    step, found = 1.0, np.inf
    while True:
        found = float(np.abs(sums(step, shift) - exact).max() / exact[0, 0])
        if found <= error or step <= 1.0 / _FINEST:
            return step * kernel.cutoff, found
        step *= 0.93


def _circle(radius: float, step: float) -> tuple[NDArray, NDArray]:
    """Angles around a circle and their shares: trapezoids, which converge fast for what is smooth."""
    count = max(_FEWEST, math.ceil(_FULL * radius / step))
    return _FULL * np.arange(count) / count, np.full(count, 1.0 / count)


def _part(radius: float, step: float, low: float, high: float) -> tuple[NDArray, NDArray]:
    """Angles of a part of a circle and their shares: panels of Gauss-Legendre points, as a part has ends."""
    x, w = np.polynomial.legendre.leggauss(_PANEL)
    most = min(step * _PANEL * 2.0 / math.pi / max(radius, 1e-300), 0.5 * math.pi)
    panels = math.ceil((high - low) / most)
    edges = np.linspace(low, high, panels + 1)
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    return (middle[:, None] + half[:, None] * x).ravel(), np.tile(w / (2.0 * panels), panels)


def _blocks(
    radii: NDArray, rules: Sequence[Sequence[tuple[NDArray, NDArray]]], heights: NDArray, origin: NDArray,
    cutoff: float, dimension: int, count: int,
) -> Iterator[RingBlock]:  # fmt: skip
    """Divide the nodes, in their order, into blocks of not too many places."""
    many = len(rules[0])
    size = np.array([[len(angles) for angles, _ in rule] for rule in rules])
    places = np.repeat(size.ravel(), len(heights))
    ends = np.concatenate([[0], np.cumsum(places)])
    most = max(1, min(BLOCK_NODES, count // (_BLOCKS * THREADS) + 1))
    cuts = np.unique(np.searchsorted(ends, np.arange(0, count + most, most)).clip(0, len(places)))
    for first, last in pairwise(cuts.tolist()):
        rows = np.arange(first, last)
        ring, height = rows // len(heights), heights[rows % len(heights)]
        radius = radii[ring // many]
        chosen = [rules[k // many][k % many] for k in ring.tolist()]
        start = ends[first : last + 1] - ends[first]
        angle, share = (np.concatenate(parts) for parts in zip(*chosen, strict=True))
        r, z = np.repeat(radius, np.diff(start)), np.repeat(height, np.diff(start))
        place = (np.array([r * np.cos(angle), r * np.sin(angle), z]) - origin[:, None]) / cutoff
        inner = PointBlock.of(np.arange(len(angle), dtype="uint64"), place, cutoff)
        rings = np.stack([radius, height], axis=1)
        yield RingBlock(rows.astype("uint64"), inner, rings, start, angle, share, dimension)
