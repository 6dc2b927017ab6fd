"""Ensembles of steps that differ in velocities alone, and errors predicted from one step against their scatter."""

from __future__ import annotations

import numpy as np
import xarray as xr

import xcg

DRAWS, LENGTH = 200, 6.0
OF_MOTION = [
    "velocity", "velocity_gradient", "shear_rate_tensor", "shear_rate", "vorticity", "granular_temperature",
    "directional_temperature", "kinetic_stress", "spin",
]  # fmt: skip
OF_VARIABLES = [
    "charge",
    xcg.Mean("push", "number"),
    xcg.Mean("charge", "volume", name="charge_by_volume"),
]


def ensemble(
    count, *, spread=1.0, shear=1.0, temperature=(1.0, 1.0, 1.0), layer=False, draws=DRAWS, seed=1
):
    """Grains that stay where they are, in steps that differ in their velocities, spins, charges and pushes alone."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0, LENGTH, (count, 3)) * ([1, 1, 0] if layer else [1, 1, 1])
    diameter = rng.uniform(1 / spread, spread, count)
    across = 1 if layer else 2
    velocity = rng.normal(size=(draws, count, 3)) * np.sqrt(temperature)
    velocity[..., 0] += shear * position[:, across]
    every = {name: np.broadcast_to(a, (draws, *a.shape)) for name, a in (
        ("position", position), ("diameter", diameter), ("species", 1 + (diameter > np.median(diameter))),
    )}  # fmt: skip
    more = {"dimension": 2, "thickness": 1.0} if layer else {}
    return xcg.scene_from_arrays(
        **every, velocity=velocity, angular_velocity=rng.normal(size=(draws, count, 3)), density=1.0,
        charge=5 + rng.normal(size=(draws, count)), push=rng.normal(size=(draws, count, 3)),
        box=dict.fromkeys("xyz", (0.0, LENGTH)), periodic="x" if shear else "xyz"[: 2 if layer else 3], **more,
    )  # fmt: skip


def predicted_over_measured(f, name, least=4.0):
    """Root mean square of the errors over that of the scatter of the steps, where enough grains are seen."""
    scatter = f[name].std("time", ddof=1)
    error = np.sqrt((f[f"{name}_error"] ** 2).mean("time"))
    there = (
        (f["effective_count"].mean("time") > least)
        & scatter.notnull()
        & error.notnull()
        & (scatter > 1e-9)
    )
    nodes = [d for d in scatter.dims if d not in ("phase", "component", "direction")]
    ratio = np.sqrt((error**2).where(there).mean(nodes) / (scatter**2).where(there).mean(nodes))
    return ratio.values[np.isfinite(ratio.values)]


CASES = {
    "gas": ({"count": 41, "shear": 0.0}, {"width": 2.0}),
    "dense": ({"count": 226, "spread": 1.3, "shear": 0.0}, {"width": 1.0}),
    "dense, narrow": ({"count": 226, "spread": 1.3, "shear": 0.0}, {"width": 0.75}),
    "sheared": ({"count": 226, "shear": 1.0}, {"width": 1.5}),
    "mixture": ({"count": 330, "spread": 1.4, "shear": 0.0}, {"width": 1.2, "by": "species"}),
    "anisotropic plane": (
        {"count": 226, "temperature": (1, 2, 0.5)}, {"width": 1.0, "axes": "xz", "at": {"y": 3.0}, "spacing": 0.5},
    ),
    "profile": ({"count": 226, "shear": 0.5}, {"width": 0.8, "axes": "z"}),
    "points": (
        {"count": 226, "shear": 0.0},
        {"width": 1.2, "at": {a: xr.DataArray(np.linspace(0, 5, 40), dims="s") for a in "xyz"}},
    ),
    "layer": ({"count": 46, "layer": True, "shear": 0.0}, {"width": 1.0}),
}  # fmt: skip
