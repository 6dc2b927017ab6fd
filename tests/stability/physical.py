"""Physical limits, one function a case: the true error of a field, and the error that xcg states for it.

Both are root mean squares relative to the size of the field. The same functions serve tests and `docs/stability.md`.
"""

from dataclasses import dataclass

import numpy as np

import xcg
from tests import flows
from tests.flows import NODES


@dataclass(frozen=True)
class Limit:
    what: str
    fails: str
    says: str
    true: float
    stated: float
    ratio: tuple[float, float]  # of the stated over the true error


def _rms(x):
    return float(np.sqrt((np.asarray(x) ** 2).mean()))


def width_below_the_noise():
    """Single frames of a sinusoidal shear at 0.4 d; all three components of the velocity."""
    flow = flows.sine(60)
    f = flow.scene.cg.coarse_grain("velocity", errors=True, width=0.4, **NODES)
    x = f.velocity.sel(component="x") - flow.truth(f.z)
    return Limit(
        "width so narrow that noise leads (sine, 0.4 d, one frame)", "fields follow single particles",
        "`velocity_error`", _rms(x) / 0.5**0.5, _rms(f.velocity_error.sel(component="x")) / 0.5**0.5, (0.8, 1.25),
    )  # fmt: skip


def width_above_a_band():
    """A shear band of 0.5 d under a kernel of 1.5 d, without fluctuations."""
    flow = flows.band(60, temperature=0.0, thickness=0.5)
    s = flow.scene.cg.width_sweep([1.5, 1.5 * 2**0.5], "velocity", **NODES)
    f = s.isel(width=0).sel(component="x").mean("time")
    size = _rms(f.velocity)
    marked = s.velocity_too_wide.isel(width=0)
    inside = (
        marked.sel(z=slice(4.5, 7.5)).any("z").all() and not marked.sel(z=slice(2.5, 3.5)).any()
    )
    return Limit(
        "width above the thickness of a shear band (0.5 d under 1.5 d)", "the band is as wide as the kernel",
        "`velocity_bias`, too small, and `velocity_too_wide` around the band alone",
        _rms(f.velocity - flow.truth(f.z)) / size, _rms(f.velocity_bias) / size if inside else 0.0, (0.2, 1.0),
    )  # fmt: skip


def beside_a_wall():
    """The node at 0.25 d from the wall of a linear shear, without fluctuations."""
    flow = flows.shear(200, temperature=0.0)
    s = flow.scene.cg.width_sweep([0.75, 0.75 * 2**0.5], "velocity", **NODES)
    f = s.isel(width=0, z=0).sel(component="x").mean("time")
    size = _rms(flow.truth(s.z))
    return Limit(
        "beside a wall (linear shear, 0.25 d from the wall)", "all particles lie on one side of the node",
        "`velocity_bias`, too small: it grows as w there, not as w^2",
        abs(float(f.velocity) - flow.truth(0.25)) / size, abs(float(f.velocity_bias)) / size, (0.3, 1.2),
    )  # fmt: skip


def thin_gas():
    """Temperature of 25 particles at a width that sees five of them as equals: unknown, or with a large error."""
    rng = np.random.default_rng(1)
    side = 5.0
    draws = 200
    position = np.broadcast_to(rng.uniform(0, side, (25, 3)), (draws, 25, 3))
    ds = xcg.scene_from_arrays(
        position, velocity=rng.normal(size=position.shape), diameter=np.full((draws, 25), 0.5), density=1.0,
        box=dict.fromkeys("xyz", (0.0, side)), periodic="xyz",
    )  # fmt: skip
    f = ds.cg.coarse_grain(["granular_temperature", "effective_count"], errors=True, width=1.5)
    known = f.granular_temperature.notnull() & (f.effective_count > 4)
    return Limit(
        "gas too thin for the fit of its velocity (5 particles at a node)", "the fit leaves hardly any fluctuation",
        "NaN where too little is left; elsewhere `granular_temperature_error`",
        _rms((f.granular_temperature - 1).where(known).values[known.values]),
        _rms(f.granular_temperature_error.where(known).values[known.values]), (0.7, 1.4),
    )  # fmt: skip


def correlated_velocities():
    """Packing in which all particles of a cell of 2 d move alike: each cell counts once, not eight times."""
    rng = np.random.default_rng(1)
    side = 8.0
    frames = 60
    position = rng.uniform(0, side, (frames, 512, 3))
    cells = (position // 2).astype(int)
    drawn = rng.normal(size=(frames, 4, 4, 4, 3))
    velocity = drawn[np.arange(frames)[:, None], cells[..., 0], cells[..., 1], cells[..., 2]]
    ds = xcg.scene_from_arrays(
        position, velocity=velocity, diameter=np.ones((frames, 512)), density=1.0, time=np.arange(frames),
        box=dict.fromkeys("xyz", (0.0, side)), periodic="xyz",
    )  # fmt: skip
    f = ds.cg.coarse_grain(["velocity"], errors=True, for_averages=True, axes="z", width=1.0)
    mean = f.cg.time_average()
    alone = _rms(f.velocity_error)
    both = _rms(mean.velocity_error) * frames**0.5
    return Limit(
        "velocities of neighbours are correlated (clusters of 8)", "fewer particles are independent than are seen",
        f"`velocity_error` of one frame is {_rms(f.velocity) / alone:.1f} times too small; `time_average` takes the "
        "scatter of the frames", _rms(f.velocity), both, (0.8, 1.25),
    )  # fmt: skip


LIMITS = [width_below_the_noise, width_above_a_band, beside_a_wall, thin_gas, correlated_velocities]
