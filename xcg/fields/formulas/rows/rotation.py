"""Rotation of grains: spin, its fluctuations, and the torques and couple stress that contacts give."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas.algebra import at_least_zero, mean_of, outer, ratio, where_positive, zero_if_unknown
from xcg.fields.formulas.field import Field, Options

# of the moment "rotation": I, I o and I o o (xx xy xz yy yz zz) with o relative to the node, and (I Psi)^2
WEIGHT, _FIRST, _SECOND, SQUARE = 0, slice(1, 4), ((4, 5, 6), (5, 7, 8), (6, 8, 9)), 10


def _vorticity(f: Any, s: Any, o: Options) -> NDArray:
    g = f.velocity_gradient
    return np.stack([g[..., (k + 2) % 3, (k + 1) % 3] - g[..., (k + 1) % 3, (k + 2) % 3] for k in range(3)], axis=-1)


def _fluctuation(f: Any, s: Any, o: Options) -> NDArray:
    """Sum of I Psi (o - b)(o - b), with b the mean of the bulk, expanded as the kinetic stress is."""
    weight, first = s.rotation[..., WEIGHT], s.rotation[..., _FIRST]
    second = np.stack([np.stack([s.rotation[..., k] for k in row], axis=-1) for row in _SECOND], axis=-2)
    b = zero_if_unknown(mean_of(first[:1], weight[:1]))
    return second - outer(b, first) - outer(first - b * weight[..., None], b)


def _fluctuation_inertia(f: Any, s: Any, o: Options) -> NDArray:
    """Return the inertia of what fluctuates: less what the mean of the bulk takes from independent spins."""
    weight, square = s.rotation[..., WEIGHT], s.rotation[..., SQUARE]
    whole = where_positive(weight[:1])
    taken = zero_if_unknown(2 * square / whole - weight * square[:1] / (whole * whole))
    return at_least_zero(weight - taken)


def _temperature(f: Any, s: Any, o: Options) -> NDArray:
    """Traces run over the axes that grains turn about: in a one-layer scene, that across the plane."""
    axes = [k for k in range(3) if k not in o.plane] if o.dimension == 2 else [0, 1, 2]
    total = sum((f.spin_fluctuation[..., k, k] for k in axes), start=np.zeros(f.density.shape))
    # as of velocities: unknown where the mean leaves less than half of a mean grain
    enough = where_positive(f.fluctuation_inertia - 0.5 * ratio(f.inertia_density, f.sample_count))
    free = f.fluctuation_inertia + (enough - enough)
    return ratio(at_least_zero(total) * f.inertia_density / free, len(axes) * f.density)


ROWS: dict[str, Field] = {
    "vorticity": Field(
        rank=1, units="s^-1", long_name="vorticity, twice the rate at which the flow turns",
        formula="curl V, of the velocity gradient G", compute=_vorticity, fields=("velocity_gradient",),
        weight="density", default=False,
    ),
    "inertia_density": Field(
        units="kg m^-1", long_name="density of the moments of inertia", formula="sum I_i Psi",
        compute=lambda f, s, o: s.inertia, moments=("inertia",), additive=True, default=False,
    ),
    "spin_density": Field(
        rank=1, units="kg m^-1 s^-1", long_name="density of the spin", formula="sum I_i omega_i Psi",
        compute=lambda f, s, o: s.spin, moments=("spin",), additive=True, default=False,
    ),
    "spin": Field(
        rank=1, units="s^-1", long_name="mean angular velocity of the grains",
        formula="omega = sum I_i omega_i Psi / sum I_i Psi", compute=lambda f, s, o: mean_of(s.spin, s.inertia),
        moments=("spin", "inertia"), weight="inertia_density", default=False,
    ),
    "spin_flux": Field(
        rank=2, units="kg s^-2", long_name="flux of spin that moving grains carry", formula="sum I_i omega_i v_i Psi",
        compute=lambda f, s, o: s.spin_flux, moments=("spin_flux",), additive=True, default=False,
    ),
    "spin_fluctuation": Field(
        rank=2, units="Pa", long_name="fluctuations of the angular velocity, twice their energy",
        formula="sum I_i omega'_i omega'_i Psi, omega' = omega_i - omega", compute=_fluctuation, moments=("rotation",),
        additive=True, default=False,
    ),
    "fluctuation_inertia": Field(
        units="kg m^-1", long_name="inertia of what fluctuates: all less what the mean takes",
        formula="I_T = sum I_i Psi - sum (I_i Psi)^2 / sum I_i Psi", compute=_fluctuation_inertia,
        moments=("rotation",), additive=True, default=False,
    ),
    "rotational_temperature": Field(
        units="m^2 s^-2", long_name="rotational temperature",
        formula="tr(sum I_i omega'_i omega'_i Psi) / (D_r rho) sum I_i Psi / I_T, D_r = 3, or 1 in a plane",
        compute=_temperature,
        fields=("spin_fluctuation", "fluctuation_inertia", "inertia_density", "density", "sample_count"), default=False,
    ),
    "torque_density": Field(
        rank=1, units="Pa", long_name="density of the torques of contact forces on the grains",
        formula="sum_i Psi sum_c b x f, b = c - r_i", compute=lambda f, s, o: s.torque, moments=("torque",),
        additive=True, default=False,
    ),
    "contact_couple_density": Field(
        rank=1, units="Pa",
        long_name="couple of contact forces at the contact points: antisymmetric part of the contact stress",
        formula="sum_c (b_i - b_j) x f_ij Psi(r - c)", compute=lambda f, s, o: s.contact_couple,
        moments=("contact_couple",), additive=True, default=False,
    ),
    "couple_stress": Field(
        rank=2, units="kg s^-2", long_name="couple stress: flux of spin through contacts",
        formula="sum_c (b x f) a int_0^1 Psi(r - r_i + s a) ds, both sides, a = r_i - c = -b",
        compute=lambda f, s, o: s.couple, moments=("couple",), additive=True, default=False,
    ),
}  # fmt: skip
