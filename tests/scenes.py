"""Scenes that many tests share: spheres anywhere, series of random scenes, gases, and results that were saved."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

import xcg

_VARIABLES = [
    "velocity",
    "diameter",
    "species",
    "contact_i",
    "contact_j",
    "contact_force",
    "contact_point",
]


def spheres(position: ArrayLike, diameter: ArrayLike = 1.0, **options: Any) -> xr.Dataset:
    """Return spheres at places (particle, 3) or (time, particle, 3), of density 1 if no other is given."""
    position = np.asarray(position, float)
    diameter = np.broadcast_to(diameter, position.shape[:-1])
    return xcg.scene_from_arrays(position, diameter=diameter, **({"density": 1.0} | options))


def random_steps(
    count: int, *, first: int = 40, more: int = 1, density: float = 2500.0
) -> xr.Dataset:
    """Return random scenes of different grains and contacts, as steps of one scene.

    The steps have ``first``, ``first + more``, ... particles.
    """
    steps = [xcg.datasets.random_scene(first + more * t, seed=t) for t in range(count)]
    rows: dict[str, Any] = {}
    for name in _VARIABLES:
        rows[name] = []
        for step in steps:
            key = "contact_i" if step[name].dims[1] == "contact" else "particle_id"
            rows[name].append(step[name].values[0][step[key].values[0] >= 0])
    return xcg.scene_from_arrays(
        [step.position.values[0] for step in steps],
        density=density,
        box=[[0, 5.0]] * 3,
        periodic="xyz",
        time=np.arange(count) * 0.1,
        **rows,
    )


def gas(
    steps: int, count: int, periodic: str, dimension: int = 3, seed: int = 5, **options: Any
) -> xr.Dataset:
    """Return small spheres of three species at random places of a box of 5 x 6 x 7."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0, [5, 6, 7], (steps, count, 3))
    if dimension == 2:
        position[..., 2] = 0.0
    return xcg.scene_from_arrays(
        position,
        diameter=rng.uniform(0.1, 0.3, (steps, count)),
        species=rng.integers(1, 4, (steps, count)),
        density=1.0,
        box=[(0.0, 5.0), (0.0, 6.0), (0.0, 7.0)],
        periodic=periodic,
        dimension=dimension,
        time=np.arange(steps) * 1.0,
        **options,
    )


@numba.njit
def _sweeps(
    position: NDArray, edge: float, step: float, sweeps: int, rng: np.random.Generator
) -> None:
    """Move hard spheres of diameter 1 at random in a periodic cube, in place (Metropolis)."""
    count = len(position)
    trial = np.empty(3)
    for _ in range(sweeps * count):
        i = rng.integers(0, count)
        for a in range(3):
            trial[a] = (position[i, a] + step * (2 * rng.random() - 1)) % edge
        overlaps = False
        for j in range(count):
            square = 0.0
            for a in range(3):
                d = trial[a] - position[j, a]
                d -= edge * np.rint(d / edge)
                square += d * d
            if j != i and square < 1.0:
                overlaps = True
                break
        if not overlaps:
            position[i] = trial


@cache
def hard_spheres(fraction: float = 0.3, steps: int = 100, cells: int = 4) -> xr.Dataset:
    """Return steps of an equilibrium fluid of 4 cells^3 hard spheres of diameter 1, from a crystal."""
    crystal = xcg.datasets.face_centred_cubic(cells)
    count = crystal.sizes["particle"]
    edge = (count * np.pi / 6 / fraction) ** (1 / 3)
    position = crystal.position.to_numpy()[0] * (edge / (cells * np.sqrt(2)))
    rng = np.random.default_rng(1)
    _sweeps(position, edge, 0.25, 400, rng)
    frames = []
    for _ in range(steps):
        _sweeps(position, edge, 0.25, 15, rng)
        frames.append(position.copy())
    return xcg.scene_from_arrays(
        np.array(frames),
        diameter=np.ones((steps, count)),
        density=1.0,
        species=np.broadcast_to(1 + np.arange(count) % 2, (steps, count)),
        box=[(0, edge)] * 3,
        periodic="xyz",
        time=np.arange(steps) * 1.0,
    )


def reopen(path: Path) -> xr.Dataset:
    """Return a file or store of results or scenes, lazily."""
    return xr.open_zarr(path) if path.suffix == ".zarr" else xr.open_dataset(path, chunks={})
