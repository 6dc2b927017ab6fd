"""Single steps of real DEM output, by name, each with a width and points inside the material.

Used by the tests of identities and by ``docs/residuals.py``; nothing here is a test.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import xarray as xr
from hypothesis import strategies as st
from numpy.typing import NDArray

import xcg
from tests import real_data

TILT = np.radians(24)


@dataclass(frozen=True)
class Case:
    """One step of a scene, in memory, and how to look at it.

    Attributes
    ----------
    name : str
        Name of the scene.
    ds : xarray.Dataset
        The step.
    width : float
        Half-width of the Lucy kernel (m): 0.75 d43.
    points : array (n, 3)
        Where identities are evaluated (m): within half a width of contact points, one at a contact across a periodic
        edge and one at a contact with a wall where there are any. Zero along axes that the scene does not have.
    """

    name: str
    ds: xr.Dataset
    width: float
    points: NDArray

    @classmethod
    def of(cls, name: str, ds: xr.Dataset, count: int = 5, width: float | None = None) -> Case:
        ds = ds.compute()
        width = width or 0.75 * ds.attrs["d43"]
        return cls(name, ds, width, places(ds, width, count))


def places(ds: xr.Dataset, width: float, count: int, seed: int = 0) -> NDArray:
    """Points near contacts: one across a periodic edge and one at a wall, if there are such, the others at random."""
    rng = np.random.default_rng(seed)
    plane = [("xyz").index(a) for a in ds.attrs["plane"]]
    valid = ds["contact_i"].values[0] >= 0
    i = ds["contact_i"].values[0][valid]
    j = ds["contact_j"].values[0][valid]
    centre = ds["contact_point"].values[0][valid]
    row = np.clip(np.searchsorted(ds["particle_id"].values[0], i), 0, ds.sizes["particle"] - 1)
    partner = np.clip(np.searchsorted(ds["particle_id"].values[0], j), 0, ds.sizes["particle"] - 1)
    position = ds["position"].values[0]
    far = (np.linalg.norm(position[row] - position[partner], axis=1) > 3 * ds.attrs["dmax"]) & (
        j >= 0
    )
    frozen = ds["frozen"].values[0][partner] == 1 if "frozen" in ds else np.zeros(len(i), bool)
    chosen = [
        rng.choice(found) for mask in (far, (j < 0) | frozen) if len(found := np.flatnonzero(mask))
    ]
    chosen += rng.permutation(len(i))[: count - len(chosen)].tolist()
    points = np.zeros((len(chosen), 3))
    points[:, plane] = (centre[chosen] + rng.uniform(-0.3, 0.3, (len(chosen), 3)) * width)[:, plane]
    return points


# --- how each folder is opened ---------------------------------------------------------------------------


def _lammps_chute(folder: Path) -> xr.Dataset:
    return xcg.open_scene(
        folder / "particles.00030000.dump.gz",
        contacts=folder / "contacts.00030000.dump.gz",
        frozen=2,
        gravity=(np.sin(TILT), 0.0, -np.cos(TILT)),
    )


def _lammps_biaxial2d(folder: Path) -> xr.Dataset:
    return xcg.open_scene(
        folder / "particles.00100000.dump.gz", contacts=folder / "contacts.00100000.dump.gz"
    )


def _mfix_chute(folder: Path) -> xr.Dataset:
    return xcg.open_scene(
        folder / "P_FB1_0004.vtp",
        contacts=folder / "FC_0004.vtp",
        periodic="xz",
        box={"x": (0.0, 0.04), "z": (0.0, 0.02)},
        density=2500.0,
    )


def _liggghts_box(folder: Path) -> xr.Dataset:
    return xcg.open_scene(
        folder / "compress50000.liggghts.gz",
        contacts=folder / "pair50000.txt.gz",
        walls=folder / "wall_pair50000.txt.gz",
        density=2500.0,
        gravity=(0.0, 0.0, -9.81),
    )


def _mercury_synthetic(folder: Path) -> xr.Dataset:
    ds = xcg.open_scene(folder / "syn200.data", contacts=folder / "syn200.fstat", engine="mercury")
    return ds.isel(time=[0])


OPEN: dict[str, Callable[..., xr.Dataset]] = {
    "lammps_chute": _lammps_chute,
    "lammps_biaxial2d": _lammps_biaxial2d,
    "mfix_chute": _mfix_chute,
    "liggghts_box": _liggghts_box,
    "mercury_synthetic": _mercury_synthetic,
}


@lru_cache
def load(name: str) -> Case:
    """Return a scene by name."""
    return Case.of(name, OPEN[name](real_data(name)))


# --- scenes that need no data ----------------------------------------------------------------------------


def synthetic(
    seed: int, particles: int, periodic: str, dimension: int, polydispersity: float
) -> Case:
    """Random grains: no physics, but contacts across edges, walls, and any periodicity."""
    periodic = "".join(a for a in periodic if a != "z" or dimension == 3)
    ds = xcg.datasets.random_scene(
        particles, seed=seed, periodic=periodic, dimension=dimension, polydispersity=polydispersity
    )
    return Case.of(f"random_{dimension}d", ds, count=3)


SYNTHETIC: st.SearchStrategy[Case] = st.builds(
    synthetic,
    seed=st.integers(0, 100_000),
    particles=st.integers(20, 60),
    periodic=st.sampled_from(["", "x", "yz", "xyz"]),
    dimension=st.sampled_from([2, 3]),
    polydispersity=st.floats(1.0, 8.0),
)
