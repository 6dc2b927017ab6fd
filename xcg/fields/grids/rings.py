"""Nodes of a cylinder: radii, angles and heights, or averages over the angle by a rule that meets an error."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.compiled._jit import THREADS
from xcg.compiled.rings import Rings
from xcg.fields.grids.grid import (
    MAX_NODES,
    Bounds,
    check_axes,
    check_places,
    nodes_along,
)
from xcg.fields.grids.points import PointBlock
from xcg.fields.sums.kernels import Kernel
from xcg.fields.sums.nodes import BLOCK_NODES, Nodes


def ring_points(nodes: Nodes, *, whole: bool) -> tuple[NDArray, NDArray, NDArray]:
    """Return the points that the nodes of a cylinder average over.

    Parameters
    ----------
    nodes : Nodes
        Nodes laid by `make_rings`.
    whole : bool
        Return all angles of each node, or the first alone, for what is the same at all of them.

    Returns
    -------
    points : array (n, 3)
        Points (m), one node after the other.
    shares : array (n,)
        Their shares of the average at their node.
    first : array (nodes,)
        First point of each node.
    """
    points: list[NDArray] = []
    shares: list[NDArray] = []
    indices: list[NDArray] = []
    for part in nodes.parts or ():
        rings = part.rings
        assert rings is not None
        counts = np.ones(len(rings.place), int)
        rows = rings.start[:-1]
        share = np.ones(len(rows))
        if whole:
            counts = np.diff(rings.start)
            rows = np.arange(len(rings.angle))
            share = rings.share
        radius, height = np.repeat(rings.place, counts, axis=0).T
        points.append(np.stack([radius * rings.cosine[rows], radius * rings.sine[rows], height], 1))
        shares.append(share)
        indices.append(np.repeat(part.indices.astype(int), counts))
    order = np.argsort(np.concatenate(indices), kind="stable")
    _, first = np.unique(np.concatenate(indices)[order], return_index=True)
    return np.concatenate(points)[order], np.concatenate(shares)[order], first


NAMES = {"r": "r", "t": "theta", "z": "z"}  # letters of `axes`, and what else they are called
_FULL = 2.0 * math.pi
_FEWEST = 8  # angles of a ring: vectors and tensors turn once and twice on it
_PANEL = 8  # Gauss-Legendre points of a panel of a part of a circle
_FINEST = 128  # angles a radius of the support: where the error of a kernel that jumps is not met
_BLOCKS = 4  # parts a thread


def make_rings(
    axes: str,
    at: Mapping[str, Any],
    bounds: Bounds,
    spacing: float | Mapping[str, float],
    *,
    plane: str,
    kernel: Kernel,
    error: float,
    automatic: Bounds,
    period: Mapping[str, float],
) -> Nodes:
    """Lay the nodes of a cylinder.

    Parameters
    ----------
    axes, at, bounds, spacing
        As in `xcg.coarse_grain`, for r, theta and z.
    plane : str
        The axes that the scene has.
    kernel : Kernel
        The one with the smallest support.
    error : float
        What averages over theta may differ by.
    automatic, period : mapping
        Bounds and period of r and z where none are given.

    Raises
    ------
    ValueError
        If an argument is wrong.
    """
    letters = letters_of(plane)
    check_axes(letters, axes=axes)
    dimension = len(plane)
    axes_of_scene = [NAMES[letter] for letter in letters]
    resolved = [NAMES[letter] for letter in letters if letter in axes]
    fixed = _fixed_places(at, bounds, resolved, axes_of_scene)
    spacings: Mapping[str, Any] = {"r": spacing, "z": spacing}
    if isinstance(spacing, Mapping):
        spacings = spacing
    nodes: dict[str, NDArray] = {}
    if "r" in resolved:
        nodes["r"] = _radii(spacings.get("r"), resolved, bounds, automatic, kernel.cutoff)
    radii = nodes.get("r", np.array([fixed.get("r", 0.0)]))
    low, high = _part_of_circle(bounds)
    if "theta" in resolved:
        nodes["theta"] = _angles(spacings, resolved, bounds, float(radii.max()), kernel.cutoff)
    if "z" in resolved:
        nodes["z"], _ = nodes_along(
            "z", spacings.get("z"), resolved, bounds, automatic, period, kernel.cutoff
        )
    heights = nodes.get("z", np.array([fixed.get("z", 0.0)]))
    # by the loops' kernel; theta by its rule
    averaged = "".join(a for a in axes_of_scene[2:] if a not in resolved and a not in fixed)
    error_met = 0.0
    if "theta" in nodes or "theta" in fixed:
        angles = nodes.get("theta", np.array([fixed.get("theta", 0.0)]))
        rules = [[(np.array([angle]), np.ones(1)) for angle in angles] for _ in radii]
    else:
        distance, error_met = spacing_of_angles(kernel, dimension - len(averaged), error)
        rules = [[_average(radius, distance, low, high)] for radius in radii]
    count = sum(len(share) for rule in rules for _, share in rule) * len(heights)
    if count > MAX_NODES:
        raise ValueError(
            f"averages over theta would take {count} places, more than {MAX_NODES}: "
            "choose a larger spacing or error"
        )
    origin = np.array([0.0, 0.0, heights[len(heights) // 2]])
    widest = float(radii.max())
    lower = np.array([-widest, -widest, heights.min()])
    upper = np.array([widest, widest, heights.max()])
    parts = tuple(_blocks(radii, rules, heights, origin, kernel.cutoff, count))
    # on the axis r and theta have no direction
    on_axis = np.flatnonzero(np.repeat(radii == 0.0, len(rules[0]) * len(heights)))
    coords = {a: xr.Variable(a, x) for a, x in nodes.items()}
    coords |= {a: xr.Variable((), x) for a, x in fixed.items()}
    seen = "".join(a for a in "xyz" if a in {"x", "y", *coords})
    return Nodes(
        tuple(nodes),
        tuple(map(len, nodes.values())),
        coords,
        seen,
        averaged,
        origin,
        lower,
        upper,
        parts=parts,
        undirected=on_axis,
        attrs={"theta_error": error_met},
    )


def letters_of(plane: str) -> str:
    """Return the letters of the axes of a cylindrical frame: theta is "t"."""
    if "z" in plane:
        return "rtz"
    return "rt"


def _fixed_places(
    at: Mapping[str, Any],
    bounds: Bounds,
    resolved: Sequence[str],
    axes_of_scene: Sequence[str],
) -> dict[str, float]:
    """Return the places along axes that are not resolved. Raise ValueError unless they fit."""
    if any(np.ndim(coordinate) for coordinate in at.values()):
        raise ValueError(
            "at= has arrays, which name points: give these in the axes of the scene or of "
            "xcg.Rotated"
        )
    # a part of the circle may be averaged
    checked = {axis: ends for axis, ends in bounds.items() if axis != "theta" or axis in at}
    check_places(resolved, at, checked, axes_of_scene)
    fixed = {axis: float(at[axis]) for axis in axes_of_scene if axis in at}
    if "r" not in resolved and "r" not in fixed:
        raise ValueError(
            "a cylindrical frame takes r: resolve it (axes='r', 'rz', ...) or fix it "
            "(at={'r': ...})"
        )
    if fixed.get("r", 0.0) < 0.0:
        raise ValueError(f"at={dict(at)!r}: expected no radius below zero")
    return fixed


def _radii(
    spacing: float | None,
    resolved: Sequence[str],
    bounds: Bounds,
    automatic: Bounds,
    cutoff: float,
) -> NDArray:
    """Return the radii of the nodes; without bounds a whole number of spacings from the axis."""
    limits = dict(bounds)
    if "r" not in bounds and "r" in automatic and spacing:
        _, end = automatic["r"]
        limits["r"] = (0.0, math.ceil(end / spacing) * spacing)
    radii, _ = nodes_along("r", spacing, resolved, limits, automatic, {}, cutoff)
    if radii[0] < 0.0:
        raise ValueError(f"bounds['r']={tuple(bounds['r'])!r}: expected radii, none below zero")
    return radii


def _angles(
    spacings: Mapping[str, Any],
    resolved: Sequence[str],
    bounds: Bounds,
    radius: float,
    cutoff: float,
) -> NDArray:
    """Return the angles of the nodes; by default as far from each other at the largest radius as the radii are."""
    widest = max(radius, cutoff)
    spacing = spacings.get("theta")
    if spacing is None and "r" in spacings:
        spacing = spacings["r"] / widest
    circle = {"theta": (0.0, _FULL)}
    turn = {"theta": _FULL}
    angles, _ = nodes_along("theta", spacing, resolved, bounds, circle, turn, cutoff / widest)
    return angles


def _part_of_circle(bounds: Bounds) -> tuple[float, float]:
    """Return the bounds of theta. Raise ValueError unless they are at most a circle apart."""
    low, high = map(float, bounds.get("theta", (0.0, _FULL)))
    if not 0.0 < high - low <= _FULL * (1 + 1e-12):
        raise ValueError(
            f"bounds['theta']=({low!r}, {high!r}): expected two angles (rad), at most a circle "
            "apart"
        )
    return low, high


def spacing_of_angles(kernel: Kernel, seen: int, error: float) -> tuple[float, float]:
    """Distance of neighbours on a ring (m) for which sums over them meet an error, and the error that they do meet.

    The error of the trapezoidal rule on a line through the support, at any distance from its middle
    and with its nodes anywhere, is at most this share of the integral over the line through the
    middle.
    """
    offset = np.linspace(0.0, 0.98, 41)
    shift = (np.arange(32) + 0.5) / 32

    def sums(spacing: float, starts: NDArray) -> NDArray:
        number = np.arange(-math.ceil(1.0 / spacing) - 1, math.ceil(1.0 / spacing) + 2)
        along = (number + starts[:, None]) * spacing
        length = np.sqrt(offset[:, None, None] ** 2 + along**2) * kernel.cutoff
        return spacing * kernel.value(length, seen).sum(axis=-1)

    exact = sums(1.0 / 2000, np.zeros(1))
    spacing = 1.0
    while True:
        error_met = float(np.abs(sums(spacing, shift) - exact).max() / exact[0, 0])
        if error_met <= error or spacing <= 1.0 / _FINEST:
            return spacing * kernel.cutoff, error_met
        spacing *= 0.93


def _average(radius: float, spacing: float, low: float, high: float) -> tuple[NDArray, NDArray]:
    """Angles of an average over a circle or a part of it, and their shares.

    Around a circle trapezoids converge fast for what is smooth; a part has ends, and takes panels
    of Gauss-Legendre points.
    """
    if high - low > _FULL * (1 - 1e-12):
        count = max(_FEWEST, math.ceil(_FULL * radius / spacing))
        return _FULL * np.arange(count) / count, np.full(count, 1.0 / count)
    x, w = np.polynomial.legendre.leggauss(_PANEL)
    most = min(spacing * _PANEL * 2.0 / math.pi / max(radius, 1e-300), 0.5 * math.pi)
    panels = math.ceil((high - low) / most)
    edges = np.linspace(low, high, panels + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    half = 0.5 * np.diff(edges)
    angles = (middle[:, None] + half[:, None] * x).ravel()
    return angles, np.tile(w / (2.0 * panels), panels)


def _blocks(
    radii: NDArray,
    rules: Sequence[Sequence[tuple[NDArray, NDArray]]],
    heights: NDArray,
    origin: NDArray,
    cutoff: float,
    count: int,
) -> Iterator[PointBlock]:
    """Divide the nodes into blocks of not too many places: slabs, and shells of these where there are few heights."""
    of_rings = [rule for of_radius in rules for rule in of_radius]
    rings_of_radius = len(rules[0])
    size = np.array([len(angles) for angles, _ in of_rings])
    parts = math.ceil(count / min(BLOCK_NODES, count // (_BLOCKS * THREADS) + 1))
    slabs = np.array_split(np.arange(len(heights)), min(parts, len(heights)))
    ends = np.concatenate([[0], np.cumsum(size)])
    shells = math.ceil(parts / len(slabs))
    cuts = np.unique(np.searchsorted(ends, np.linspace(0, ends[-1], shells + 1)))
    for (first, last), slab in product(pairwise(cuts.tolist()), slabs):
        ring = np.repeat(np.arange(first, last), len(slab))
        row = np.tile(slab, last - first)
        rows = ring * len(heights) + row
        height = heights[row]
        radius = radii[ring // rings_of_radius]
        start = np.concatenate([[0], np.cumsum(size[ring])])
        angle = np.concatenate([of_rings[k][0] for k in ring.tolist()])
        share = np.concatenate([of_rings[k][1] for k in ring.tolist()])
        r = np.repeat(radius, np.diff(start))
        z = np.repeat(height, np.diff(start))
        points = (np.array([r * np.cos(angle), r * np.sin(angle), z]) - origin[:, None]) / cutoff
        block = PointBlock.of(np.arange(len(angle), dtype="uint64"), points, cutoff)
        where = np.empty(len(angle), dtype=int)
        where[block.indices] = np.arange(len(angle))
        place = np.stack([radius, height], axis=1)
        rings = Rings(place, start, angle, np.cos(angle), np.sin(angle), share, where)
        yield replace(block, indices=rows.astype("uint64"), order=None, rings=rings)
