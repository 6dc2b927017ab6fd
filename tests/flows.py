"""Flows whose fields are known: random grains that follow a given profile along z, with independent fluctuations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import xcg

LENGTH = 12.0  # of the box along z, in diameters
NODES = {
    "axes": "z",
    "bounds": {"z": (0.25, LENGTH - 0.25)},
    "spacing": 0.5,
}  # of profiles, beside walls and jumps


@dataclass(frozen=True)
class Flow:
    """A scene of independent frames, and the value of one of its fields along z."""

    scene: xr.Dataset
    field: str
    truth: Callable[[NDArray], NDArray]

    def value(self, f: xr.Dataset) -> xr.DataArray:
        """Return the part of the field that has a value."""
        found = f[self.field]
        if "direction" in found.dims:
            return found.sel(component="z", direction="z", drop=True)
        return found.sel(component="x", drop=True) if "component" in found.dims else found

    def errors(self, f: xr.Dataset) -> tuple[float, float]:
        """Return the bias of the mean and the scatter of one frame, as root mean squares over the nodes."""
        value = self.value(f)
        scatter = float(value.var("time", ddof=1).mean())
        bias = (
            float(((value.mean("time") - self.truth(f.z)) ** 2).mean()) - scatter / f.sizes["time"]
        )
        return max(bias, 0.0) ** 0.5, scatter**0.5


def _grains(
    frames: int,
    seed: int,
    temperature: float,
    speed: Callable[[NDArray], NDArray],
    periodic: str,
    side: float = 6.0,
    **box: Any,
) -> xr.Dataset:
    """Random grains at a volume fraction of 0.4, placed anew in each frame, in a box of side x side x 12 diameters."""
    rng = np.random.default_rng(seed)
    count = round(9.17 * side**2)
    position = rng.uniform(0, [side, side, LENGTH], (frames, count, 3))
    velocity = np.sqrt(temperature) * rng.normal(size=position.shape)
    velocity[..., 0] += speed(position[..., 2])
    return xcg.scene_from_arrays(
        position, velocity=velocity, diameter=np.ones((frames, count)), density=1.0, time=np.arange(frames),
        box={"x": (0, side), "y": (0, side), "z": (0, LENGTH)}, periodic=periodic, **box,
    )  # fmt: skip


def sine(frames: int, seed: int = 1, temperature: float = 0.25, side: float = 6.0) -> Flow:
    """Periodic shear, V_x = sin(2 pi z / L)."""

    def truth(z: NDArray) -> NDArray:
        return np.sin(2 * np.pi * z / LENGTH)

    return Flow(_grains(frames, seed, temperature, truth, "xyz", side), "velocity", truth)


def shear(frames: int, seed: int = 1, temperature: float = 0.25) -> Flow:
    """Linear shear between two walls, V_x = z / L."""

    def truth(z: NDArray) -> NDArray:
        return z / LENGTH

    return Flow(_grains(frames, seed, temperature, truth, "xy"), "velocity", truth)


def lees_edwards(frames: int, seed: int = 1, temperature: float = 0.25) -> Flow:
    """Linear shear in a sheared periodic box, V_x = z / L: images above the box are faster by 1."""

    def truth(z: NDArray) -> NDArray:
        return z / LENGTH

    shear = {"lattice": {"xz": np.arange(frames) % 6.0}, "shear_rate": {"xz": 1 / LENGTH}}
    return Flow(_grains(frames, seed, temperature, truth, "xyz", **shear), "velocity", truth)


def channel(frames: int, seed: int = 1, temperature: float = 0.25) -> Flow:
    """Poiseuille's profile between two walls at rest, V_x = 4 (z / L) (1 - z / L)."""

    def truth(z: NDArray) -> NDArray:
        return 4 * (z / LENGTH) * (1 - z / LENGTH)

    return Flow(_grains(frames, seed, temperature, truth, "xy"), "velocity", truth)


def band(frames: int, seed: int = 1, temperature: float = 0.25, thickness: float = 1.5) -> Flow:
    """Two periodic shear bands, V_x = tanh(...), of a given thickness (diameters)."""

    def truth(z: NDArray) -> NDArray:
        return np.tanh(LENGTH / (2 * np.pi) * np.sin(2 * np.pi * z / LENGTH) / thickness)

    return Flow(_grains(frames, seed, temperature, truth, "xyz"), "velocity", truth)


def layer(frames: int, seed: int = 1) -> Flow:
    """A dense layer and a thin one, half of the periodic box each: number density 1 and 0.25."""
    rng = np.random.default_rng(seed)
    side = 6.0
    half = LENGTH / 2
    count = round(1.25 * side**2 * half)
    position = rng.uniform(0, [side, side, half], (frames, count, 3))
    position[..., 2] += half * (rng.uniform(size=(frames, count)) < 0.2)
    scene = xcg.scene_from_arrays(
        position, velocity=rng.normal(size=position.shape), diameter=np.ones((frames, count)), density=6 / np.pi,
        time=np.arange(frames), box={"x": (0, side), "y": (0, side), "z": (0, LENGTH)}, periodic="xyz",
    )  # fmt: skip
    return Flow(scene, "density", lambda z: np.where(z < half, 1.0, 0.25))


def column(frames: int, seed: int = 1, columns: int = 30) -> Flow:
    """Columns of touching grains under gravity: sigma_zz = (columns / A) times the weight above, mass = g = 1.

    The lowest grain of each column lies up to a diameter above z = 0, on a support that carries it by a contact.
    """
    rng = np.random.default_rng(seed)
    side, high = 6.0, 24
    base = rng.uniform(0, [side, side, 1.0], (frames, columns, 3))
    position = base[:, :, None, :] + np.arange(high)[:, None] * [0, 0, 1.0]
    above = np.arange(
        high, 0, -1.0
    )  # weight carried by the lower contact of each grain, mass = g = 1
    row = np.arange(columns * high).reshape(columns, high)
    pairs = np.concatenate(
        [
            np.stack([row[:, 1:].ravel(), row[:, :-1].ravel()]),
            np.stack([row[:, 0], 0 * row[:, 0] - 1]),
        ],
        1,
    )
    force = np.concatenate([np.tile(above[1:], columns), np.full(columns, above[0])])
    point = position - [0, 0, 0.5]
    places = np.concatenate([point[:, :, 1:].reshape(frames, -1, 3), point[:, :, 0]], axis=1)
    scene = xcg.scene_from_arrays(
        position.reshape(frames, -1, 3), velocity=np.zeros((frames, columns * high, 3)),
        diameter=np.ones((frames, columns * high)), density=6 / np.pi, time=np.arange(frames),
        contact_i=np.tile(pairs[0], (frames, 1)), contact_j=np.tile(pairs[1], (frames, 1)),
        contact_force=np.tile(np.outer(force, [0, 0, 1.0]), (frames, 1, 1)), contact_point=places,
        box={"x": (0, side), "y": (0, side), "z": (0, high + 2.0)}, periodic="xy",
    )  # fmt: skip
    weight = columns / side**2
    return Flow(scene, "contact_stress", lambda z: weight * np.clip(high - z, 0, high))


FLOWS = {
    "sine": sine, "linear shear": shear, "sheared box": lees_edwards, "channel": channel, "band": band, "layer": layer,
}  # fmt: skip
