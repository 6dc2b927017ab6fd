"""Surfaces in a scene: small cells of them, where these end, and attributes of results."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.common.checks import axis_vector
from xcg.fields.grids.frames import axis_of
from xcg.fields.grids.walls import Cylinder, Plane, Surface, SurfaceCells, Wall, check_count
from xcg.fields.sums.kernels import Kernel
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS


def attrs_of(kernel: Kernel, surface: Wall) -> dict[str, Any]:
    """Return kernel and surface as attributes of a result."""
    return {
        "kernel": kernel.name,
        "width": kernel.width,
        "cutoff": kernel.cutoff,
        "surface": repr(surface),
    }


def check_surface(surface: object) -> None:
    """Raise ValueError unless this is a plane, a cylinder or a surface of triangles."""
    if not isinstance(surface, Wall):
        raise ValueError(f"surface={surface!r}: expected an xcg.Plane, xcg.Cylinder or xcg.Surface")


def open_ends(surface: Wall, cells: SurfaceCells, scene: Scene) -> dict[str, tuple[float, float]]:
    """Return the ends of the cells along dimensions for which neither the surface nor a period has any."""
    if isinstance(surface, Cylinder):
        k = axis_of(axis_vector("axis", surface.axis))
        is_periodic = k is not None and COMPONENTS[k] in scene.periods
        if is_periodic or None not in (surface.low, surface.high):
            return {}
        *_, along = cells.coords
        return {along: tuple(cells.bounds[0])}
    if not isinstance(surface, Plane) or surface.bounds is not None:
        return {}
    ends = {}
    for dim, (low, high) in zip(cells.coords, cells.bounds, strict=True):
        if dim not in scene.periods:
            ends[dim] = (low, high)
    return ends


def small_cells(surface: Wall, scene: Scene, spacing: float) -> SurfaceCells:
    """Return small cells of a surface."""
    corners = np.full((2, 3), np.nan)
    if scene.corners is not None:
        corners = np.array(scene.corners)
    for a in scene.periods:
        corners[:, COMPONENTS.index(a)] = scene.edges[a]
    lower, upper = corners
    if isinstance(surface, Surface):
        surface.check_unit(lower, upper, scene.sizes.get("d43", 0.0))
        return SurfaceCells({}, *parts_of_triangles(surface, spacing), COMPONENTS)
    layer = scene.layer
    if layer is None:
        return surface.cells(lower, upper, spacing)
    # fields are the same all across a layer, so that only the part of the surface inside counts
    k, lower[k], upper[k] = layer
    cells = surface.cells(lower, upper, spacing)
    faces = np.where(np.arange(3) == k, corners, lower)
    ends = np.sort(surface.coordinates(faces), axis=0)
    inside = 1.0
    for (first, last), (low, high) in zip(cells.bounds, ends.T, strict=True):
        if np.isclose(high - low, upper[k] - lower[k], atol=0.0):
            inside = max(0.0, min(last, high) - max(first, low)) / (last - first)
    return replace(cells, area=cells.area * inside)


def parts_of_triangles(surface: Surface, spacing: float) -> tuple[NDArray, NDArray]:
    """Centres (n, 3) and areas (n,) of equal parts of triangles, no wider than `spacing`."""
    centres = []
    areas = []
    edges = np.linalg.norm(surface.corners - np.roll(surface.corners, 1, axis=1), axis=2)
    counts = np.maximum(1.0, np.ceil(edges.max(axis=1) / spacing))
    check_count(surface, (counts**2).sum())
    for (a, b, c), count in zip(surface.corners, counts.astype(int).tolist(), strict=True):
        grid = np.indices((count, count)).reshape(2, -1).T
        upright = grid.sum(axis=1) < count
        turned = grid.sum(axis=1) < count - 1
        share = np.concatenate([grid[upright] + 1 / 3, grid[turned] + 2 / 3]) / count
        centres.append(a + share[:, :1] * (b - a) + share[:, 1:] * (c - a))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a)) / count**2
        areas.append(np.full(len(share), area))
    return np.concatenate(centres), np.concatenate(areas)
