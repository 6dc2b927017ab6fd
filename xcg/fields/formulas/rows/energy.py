"""Rotation and energy: spin, torques and couple stress; kinetic energy, its fluxes, and the powers that exchange it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas.algebra import (
    at_least_zero,
    dot,
    double_dot,
    mean_of,
    outer,
    ratio,
    times,
    trace,
    where_positive,
    zero_if_unknown,
)
from xcg.fields.formulas.field import Field, Options, mean_of_sums, sum_of

# of the moment "rotation": I, I o and I o o (xx xy xz yy yz zz) with o relative to the node, and (I
# Psi)^2
WEIGHT = 0
_FIRST = slice(1, 4)
_SECOND = ((4, 5, 6), (5, 7, 8), (6, 8, 9))
SQUARE = 10

_OF_STEPS = "means of the values of steps or nodes, each about its own velocity"


def _vorticity(f: Any, s: Any, o: Options) -> NDArray:
    g = f.velocity_gradient
    return np.stack(
        [g[..., (k + 2) % 3, (k + 1) % 3] - g[..., (k + 1) % 3, (k + 2) % 3] for k in range(3)],
        axis=-1,
    )


def _fluctuation(f: Any, s: Any, o: Options) -> NDArray:
    """Sum of I Psi (o - b)(o - b), with b the mean of the bulk, expanded as the kinetic stress is."""
    weight = s.rotation[..., WEIGHT]
    first = s.rotation[..., _FIRST]
    second = np.stack(
        [np.stack([s.rotation[..., k] for k in row], axis=-1) for row in _SECOND], axis=-2
    )
    b = zero_if_unknown(mean_of(first[:1], weight[:1]))
    return second - outer(b, first) - outer(first - b * weight[..., None], b)


def _fluctuation_inertia(f: Any, s: Any, o: Options) -> NDArray:
    """Return the inertia of what fluctuates: less what the mean of the bulk takes from independent spins."""
    weight = s.rotation[..., WEIGHT]
    square = s.rotation[..., SQUARE]
    whole = where_positive(weight[:1])
    taken = zero_if_unknown(2 * square / whole - weight * square[:1] / (whole * whole))
    return at_least_zero(weight - taken)


def _temperature(f: Any, s: Any, o: Options) -> NDArray:
    """Traces run over the axes that grains turn about: in a one-layer scene, that across the plane."""
    axes = [0, 1, 2]
    if o.dimension == 2:
        axes = [k for k in axes if k not in o.plane]
    # as of velocities: unknown where the mean leaves less than half of a mean grain
    enough = where_positive(f.fluctuation_inertia - 0.5 * ratio(f.inertia_density, f.sample_count))
    free = f.fluctuation_inertia + (enough - enough)
    return ratio(
        at_least_zero(trace(f.spin_fluctuation, axes)) * f.inertia_density / free,
        len(axes) * f.density,
    )


def _bulk(f: Any, s: Any) -> NDArray:
    """V of the bulk, zero where there are no grains."""
    return zero_if_unknown(f._drift[:1] + s.reference)


def _mean_energy(f: Any, s: Any, o: Options) -> NDArray:
    """Return V.p - rho V^2 / 2: of the bulk rho V^2 / 2, and phases add up to it."""
    v = _bulk(f, s)
    momentum = s.momentum + s.mass[..., None] * s.reference
    return dot(v, momentum) - 0.5 * s.mass * dot(v, v)


def _kinetic_heat_flux(f: Any, s: Any, o: Options) -> NDArray:
    """Sum of (m v'^2 + I omega^2) / 2 v' Psi, v' = u - b, expanded in the moments relative to the node.

    sum m v'^2 v' = sum m u^2 u - 2 (sum m u u).b - b sum m u^2 + b^2 sum m u + (2 b.sum m u - b^2
    sum m) b
    """
    b = zero_if_unknown(f._drift[:1])
    square = dot(b, b)
    first = s.momentum
    around = times(s.kinetic, b[..., None])[..., 0]
    cubes = (
        s.cubes
        - 2 * around
        - b * trace(s.kinetic, (0, 1, 2))[..., None]
        + square[..., None] * first
    )
    cubes = cubes + (2 * dot(b, first) - square * s.mass)[..., None] * b
    return (
        0.5 * cubes + s.rotational_energy_flux - _bulk(f, s) * s.some_rotational_energy[..., None]
    )


def _contact_heat_flux(f: Any, s: Any, o: Options) -> NDArray:
    """Return q_c - V.sigma^c: the sum of f.(u - V) a."""
    v = _bulk(f, s)
    return f.contact_energy_flux - times(v[..., None, :], f.contact_stress)[..., 0, :]


_ROWS: dict[str, Field] = {
    "vorticity": Field(
        rank=1,
        units="s^-1",
        long_name="vorticity, twice the rate at which the flow turns",
        formula="curl V, of the velocity gradient G",
        compute=_vorticity,
        fields=("velocity_gradient",),
        weight="density",
    ),
    "inertia_density": sum_of(
        "inertia",
        units="kg m^-1",
        long_name="density of the moments of inertia",
        formula="sum I_i Psi",
    ),
    "spin_density": sum_of(
        "spin",
        rank=1,
        units="kg m^-1 s^-1",
        long_name="density of the spin",
        formula="sum I_i omega_i Psi",
    ),
    "spin": mean_of_sums(
        "spin",
        "inertia",
        rank=1,
        units="s^-1",
        long_name="mean angular velocity of the grains",
        formula="omega = sum I_i omega_i Psi / sum I_i Psi",
        weight="inertia_density",
    ),
    "spin_flux": sum_of(
        "spin_flux",
        rank=2,
        units="kg s^-2",
        long_name="flux of spin that moving grains carry",
        formula="sum I_i omega_i v_i Psi",
    ),
    "spin_fluctuation": Field(
        rank=2,
        units="Pa",
        long_name="fluctuations of the angular velocity, twice their energy",
        formula="sum I_i omega'_i omega'_i Psi, omega' = omega_i - omega",
        compute=_fluctuation,
        moments=("rotation",),
        additive=True,
    ),
    "fluctuation_inertia": Field(
        units="kg m^-1",
        long_name="inertia density less the degree of freedom of the mean spin",
        formula="I_T = sum I_i Psi - sum (I_i Psi)^2 / sum I_i Psi",
        compute=_fluctuation_inertia,
        moments=("rotation",),
        additive=True,
    ),
    "rotational_temperature": Field(
        units="m^2 s^-2",
        long_name="rotational temperature",
        formula="tr(sum I_i omega'_i omega'_i Psi) / (D_r rho) sum I_i Psi / I_T, D_r = 3, or 1 in a plane",
        compute=_temperature,
        fields=(
            "spin_fluctuation",
            "fluctuation_inertia",
            "inertia_density",
            "density",
            "sample_count",
        ),
    ),
    "torque_density": sum_of(
        "torque",
        rank=1,
        units="Pa",
        long_name="density of the torques of contact forces on the grains",
        formula="sum_i Psi sum_c b x f, b = c - r_i",
    ),
    "contact_couple_density": sum_of(
        "contact_couple",
        rank=1,
        units="Pa",
        long_name="couple of contact forces at the contact points, in the mean that of the contact stress",
        formula="sum_c (b_i - b_j) x f_ij Psi(r - c)",
    ),
    "couple_stress": sum_of(
        "couple",
        rank=2,
        units="kg s^-2",
        long_name="couple stress: flux of spin through contacts",
        formula="sum_c (b x f) a int_0^1 Psi(r - r_i + s a) ds, both sides, a = r_i - c = -b",
    ),
    "kinetic_energy": sum_of(
        "energy",
        units="Pa",
        long_name="density of the kinetic energy",
        formula="e = sum (m_i v_i^2 + I_i omega_i^2) / 2 Psi",
    ),
    "mean_kinetic_energy": Field(
        units="Pa",
        long_name="density of the kinetic energy of the mean flow",
        formula="rho V^2 / 2",
        compute=_mean_energy,
        fields=("_drift",),
        moments=("mass", "momentum"),
        additive=True,
        covariance=lambda f, s, o: -0.5 * trace(f.covariance, (0, 1, 2)),
    ),
    "fluctuating_kinetic_energy": Field(
        units="Pa",
        long_name="density of the kinetic energy of fluctuations about V of the node, rotation of the flow included",
        formula="tr(sigma^k) / 2",
        compute=lambda f, s, o: 0.5 * trace(f.kinetic_stress, (0, 1, 2)),
        fields=("kinetic_stress",),
        additive=True,
    ),
    "rotational_kinetic_energy": sum_of(
        "rotational_energy",
        units="Pa",
        long_name="density of the kinetic energy of rotation",
        formula="sum I_i omega_i^2 / 2 Psi",
    ),
    "kinetic_energy_flux": sum_of(
        "energy_flux",
        rank=1,
        units="W m^-2",
        long_name="flux of kinetic energy that moving grains carry",
        formula="sum (m_i v_i^2 + I_i omega_i^2) / 2 v_i Psi",
    ),
    "contact_energy_flux": sum_of(
        "side_power",
        rank=1,
        units="W m^-2",
        long_name="flux of energy through contacts",
        formula="q_c = sum_c (f.u) a int_0^1 Psi(r - r_i + s a) ds, both sides, "
        "u = v_i + omega_i x b, a = -b = r_i - c",
    ),
    "kinetic_heat_flux": Field(
        rank=1,
        units="W m^-2",
        long_name="flux of the energy of fluctuations that moving grains carry",
        formula="sum (m_i v'_i^2 + I_i omega_i^2) / 2 v'_i Psi, v' = v_i - V",
        compute=_kinetic_heat_flux,
        fields=("_drift",),
        moments=(
            "mass",
            "momentum",
            "kinetic",
            "cubes",
            "some_rotational_energy",
            "rotational_energy_flux",
        ),
        additive=True,
        averages=_OF_STEPS,
    ),
    "contact_heat_flux": Field(
        rank=1,
        units="W m^-2",
        long_name="flux of energy through contacts relative to the mean flow",
        formula="q_c - V.sigma^c, which is q_c with u - V in place of u",
        compute=_contact_heat_flux,
        fields=("contact_energy_flux", "contact_stress", "_drift"),
        additive=True,
        averages=_OF_STEPS,
    ),
    "heat_flux": Field(
        rank=1,
        units="W m^-2",
        long_name="flux of the energy of fluctuations, by moving grains and through contacts",
        formula="q = kinetic_heat_flux + contact_heat_flux",
        compute=lambda f, s, o: f.kinetic_heat_flux + f.contact_heat_flux,
        fields=("kinetic_heat_flux", "contact_heat_flux"),
        additive=True,
        averages=_OF_STEPS,
    ),
    "stress_power": Field(
        units="W m^-3",
        long_name="power of the stress on the mean flow: what fluctuations gain",
        formula="-sigma : G, G of the bulk in whole",
        compute=lambda f, s, o: -double_dot(f.velocity_gradient[:1], f.stress),
        fields=("stress", "velocity_gradient"),
        additive=True,
        averages=_OF_STEPS,
    ),
    "contact_power": sum_of(
        "power",
        units="W m^-3",
        long_name="power of contact forces on the grains",
        formula="sum_i Psi sum_c f.u = sum_i Psi (F.v_i + T.omega_i)",
    ),
    "dissipation_rate": sum_of(
        "taken_up",
        units="W m^-3",
        long_name="power dissipated in contacts, or stored while they are loaded",
        formula="Gamma = -sum_c f_ij.(u_i - u_j) Psi(r - c)",
    ),
    "wall_power": sum_of(
        "wall_power",
        units="W m^-3",
        long_name="power of moving walls on the grains",
        formula="sum_w f_iw.u_w Psi(r - c_iw), u_w of the wall",
    ),
}
ROWS = {name: replace(row, default=False) for name, row in _ROWS.items()}
