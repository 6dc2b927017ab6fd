"""Automatic meshes that a few escaped particles make too large: refused before memory is taken, or warned of."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import warn_user
from xcg.fields.grids.grid import MeshTooLargeError, RegularGrid
from xcg.fields.plan import Plan
from xcg.scene.description import Description
from xcg.scene.schema import COMPONENTS, PADDING

_MANY = 1000  # nodes a particle, of a mesh that was laid around the particles
_LARGE = 1_000_000  # nodes, of such a mesh, below which nothing is said
_MIDDLE = 0.98  # share of the particles that the others are compared with


def make_plan_of_size(ds: xr.Dataset, scene: Description, make: Callable[[], Plan]) -> Plan:
    """Make a plan; where its mesh is too large, name the particles that are far from the others.

    Raises
    ------
    ValueError
        If the mesh that was laid around the particles has too many nodes, or one chunk of its fields does not fit into
        the memory at hand.
    """
    try:
        plan = make()
    except MeshTooLargeError as error:
        raise ValueError(f"{error}; {_about_strays(ds, scene)}") from None
    grid = plan.deposit.grid
    if not isinstance(grid, RegularGrid) or not grid.fitted or grid.count < _LARGE:
        return plan
    bytes_a_step = 8 * sum(math.prod(shape) for shape in plan.shapes.values())
    needed, free = bytes_a_step * _steps_at_once(ds), memory_at_hand()
    shown = " x ".join(map(str, grid.sizes))
    if free is not None and needed > free:
        raise ValueError(
            f"the automatic mesh has {shown} nodes, and its fields take {needed / 1e9:.3g} GB at once where "
            f"{free / 1e9:.3g} GB are free: {_about_strays(ds, scene)}"
        )
    particles = max(1, ds.sizes["particle"])
    if grid.count > _MANY * particles:
        warn_user(
            f"the automatic mesh has {shown} nodes, {grid.count / particles:.3g} for each particle: "
            f"{_about_strays(ds, scene, grid)}"
        )
    return plan


def memory_at_hand() -> int | None:
    """Return the memory that is free (bytes), None where the system does not tell."""
    info = Path("/proc/meminfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # Windows, macOS
        return None


def _steps_at_once(ds: xr.Dataset) -> int:
    """Return how many steps of fields are in memory at once: all, or those of the longest chunk of a lazy scene."""
    chunks = ds["position"].chunksizes.get("time")
    return max(chunks) if chunks else max(1, ds.sizes.get("time", 1))


def _about_strays(ds: xr.Dataset, scene: Description, grid: RegularGrid | None = None) -> str:
    """Name the particle that is farthest from the others, or the extent where positions are not in memory."""
    way_out = "give bounds=, or leave particles out with ds.where"
    position = ds["position"].transpose("time", "particle", "component").variable
    if not isinstance(position._data, np.ndarray):
        if scene.corners is None:
            return way_out
        ends = zip(COMPONENTS, *scene.corners, strict=True)
        extent = ", ".join(f"{a} from {low:.4g} to {high:.4g}" for a, low, high in ends)
        return f"particles lie at {extent}, perhaps as some escaped; {way_out}"
    ids = ds["particle_id"].transpose("time", "particle").to_numpy()
    held = np.argwhere(ids != PADDING)
    place = position.values[tuple(held.T)]
    low, high = np.quantile(place, [(1 - _MIDDLE) / 2, (1 + _MIDDLE) / 2], axis=0)
    room = np.maximum(high - low, np.spacing(np.abs(place).max()))
    beyond = np.maximum(low - place, place - high) / room
    strays = (beyond > 1.0).any(axis=1)
    if not strays.any():
        return way_out
    t, row = held[int(beyond.max(axis=1).argmax())]
    x, y, z = position.values[t, row].tolist()
    text = f"particle {ids[t, row]} at ({x:.4g}, {y:.4g}, {z:.4g}) is far from the others"
    if grid is not None:
        count = len({*ids[tuple(held[strays].T)].tolist()})
        such = "it" if count == 1 else f"{count} such particles"
        text += f"; without {such} the mesh would have about {_nodes_around(place[~strays], grid):.3g} nodes"
    return f"{text}; {way_out}"


def _nodes_around(place: NDArray, grid: RegularGrid) -> float:
    """Nodes of a mesh around some particles, with the spacing and the margins of another."""
    count = 1.0
    for a, nodes in grid.nodes.items():
        k = COMPONENTS.index(a)
        count *= np.ptp(place[:, k]) / grid.spacing[a] + 4 if a in grid.fitted else len(nodes)
    return count
