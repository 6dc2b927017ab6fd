"""Nodes of a cylinder: radii, angles and heights, or averages over the angle by a rule that meets an error."""

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
from xcg.fields.grids.grid import MAX_NODES, nodes_along
from xcg.fields.grids.means import RingBlock
from xcg.fields.grids.points import PointBlock
from xcg.fields.sums.kernels import Kernel
from xcg.fields.sums.nodes import BLOCK_NODES, Apart

NAMES = {"r": "r", "t": "theta", "z": "z"}  # letters of `axes`, and what else they are called
_FULL = 2.0 * math.pi
_FEWEST = 8  # angles of a ring: vectors and tensors turn once and twice on it
_PANEL = 8  # Gauss-Legendre points of a panel of a part of a circle
_FINEST = 128  # angles a radius of the support: where the error of a kernel that jumps is not met
_BLOCKS = 4  # parts a thread


@dataclass(frozen=True, eq=False)
class Rings(Apart):
    """Nodes of a cylinder whose axis is z.

    Attributes
    ----------
    nodes : mapping
        Coordinates along the resolved axes r, theta and z (m, rad).
    at : mapping
        Coordinates of fixed ones.
    averaged : str
        "z" where that is averaged, else nothing.
    origin, lower, upper : array (3,)
        A point amid the nodes, and the bounds of all (m).
    parts : tuple of RingBlock
        The nodes with all their angles.
    on_axis : array
        Those nodes that are on the axis, where r and theta have no direction.
    error : float
        What averages over theta differ by at most, as a share of the most that one grain adds.
    """

    nodes: Mapping[str, NDArray]
    at: Mapping[str, float]
    averaged: str
    origin: NDArray
    lower: NDArray
    upper: NDArray
    parts: tuple[RingBlock, ...]
    on_axis: NDArray
    error: float

    @property
    def undirected(self) -> NDArray:
        """Nodes on the axis."""
        return self.on_axis

    @property
    def attrs(self) -> dict[str, float]:
        """How exact averages over theta are."""
        return {"theta_error": self.error}

    @property
    def cuts(self) -> dict[str, tuple[float, float]]:
        """No cut across x, y or z."""
        return {}

    @property
    def dims(self) -> tuple[str, ...]:
        """Resolved axes."""
        return tuple(self.nodes)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of nodes along each."""
        return tuple(map(len, self.nodes.values()))

    @property
    def seen(self) -> str:
        """Axes along which distance counts."""
        return "xy" if self.averaged or not ({"z"} & ({*self.nodes} | {*self.at})) else "xyz"

    @property
    def coords(self) -> dict[str, xr.Variable]:
        """Coordinates of results."""
        found = {a: xr.Variable(a, x) for a, x in self.nodes.items()}
        return found | {a: xr.Variable((), x) for a, x in self.at.items()}

    def blocks(self, size: int, threads: int) -> tuple[RingBlock, ...]:
        """Return the nodes as they were divided when the plan was made."""
        return self.parts

    def describe(self) -> dict[str, str]:
        """Say where the nodes are, and how many angles are averaged."""
        angles = sum(part.inner.count for part in self.parts)
        mean = f", averages over {angles} places" if any(part.is_mean for part in self.parts) else ""
        return {
            "nodes": (" x ".join(f"{len(x)} {a}" for a, x in self.nodes.items()) or "one") + mean,
            "fixed": ", ".join(f"{a} = {x:g}" for a, x in self.at.items()) or "none",
        }


def make_rings(
    axes: str, at: Mapping[str, Any], bounds: Mapping[str, Sequence[float]],
    spacing: float | Mapping[str, float], *, plane: str, kernel: Kernel, seen_all: int, error: float,
    automatic: Mapping[str, tuple[float, float]], period: Mapping[str, float],
) -> Rings:  # fmt: skip
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
    on_axis = np.flatnonzero(np.repeat(radii == 0.0, len(rules[0]) * len(heights)))
    return Rings(nodes, fixed, averaged, origin, lower, upper, parts, on_axis, reached)


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
