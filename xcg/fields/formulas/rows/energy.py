"""Energy: kinetic, its fluxes, and the powers that exchange it."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xcg.fields.formulas.algebra import dot, double_dot, times, trace, zero_if_unknown
from xcg.fields.formulas.field import Field, Options


def _bulk(f: Any, s: Any) -> NDArray:
    """V of the bulk, zero where there are no grains."""
    return zero_if_unknown(f._drift[:1] + s.reference)


def _mean_energy(f: Any, s: Any, o: Options) -> NDArray:
    """Return V.p - rho V^2 / 2: of the bulk rho V^2 / 2, and phases add up to it."""
    v, momentum = _bulk(f, s), s.momentum + s.mass[..., None] * s.reference
    return dot(v, momentum) - 0.5 * s.mass * dot(v, v)


def _kinetic_heat_flux(f: Any, s: Any, o: Options) -> NDArray:
    """Sum of (m v'^2 + I omega^2) / 2 v' Psi, v' = u - b, expanded in the moments relative to the node.

    sum m v'^2 v' = sum m u^2 u - 2 (sum m u u).b - b sum m u^2 + b^2 sum m u + (2 b.sum m u - b^2 sum m) b
    """
    b = zero_if_unknown(f._drift[:1])
    square, first = dot(b, b), s.momentum
    around = times(s.kinetic, b[..., None])[..., 0]
    cubes = s.cubes - 2 * around - b * trace(s.kinetic, (0, 1, 2))[..., None] + square[..., None] * first
    cubes = cubes + (2 * dot(b, first) - square * s.mass)[..., None] * b
    return 0.5 * cubes + s.rotational_energy_flux - _bulk(f, s) * s.some_rotational_energy[..., None]


def _contact_heat_flux(f: Any, s: Any, o: Options) -> NDArray:
    """Return q_c - V.sigma^c: the sum of f.(u - V) a."""
    v = _bulk(f, s)
    return f.contact_energy_flux - times(v[..., None, :], f.contact_stress)[..., 0, :]


ROWS: dict[str, Field] = {
    "kinetic_energy": Field(
        units="Pa", long_name="density of the kinetic energy", formula="e = sum (m_i v_i^2 + I_i omega_i^2) / 2 Psi",
        compute=lambda f, s, o: s.energy, moments=("energy",), additive=True, default=False,
    ),
    "mean_kinetic_energy": Field(
        units="Pa", long_name="density of the kinetic energy of the mean flow", formula="rho V^2 / 2",
        compute=_mean_energy, fields=("_drift",), moments=("mass", "momentum"), additive=True, default=False,
    ),
    "fluctuating_kinetic_energy": Field(
        units="Pa", long_name="density of the kinetic energy of fluctuations about V", formula="tr(sigma^k) / 2",
        compute=lambda f, s, o: 0.5 * trace(f.kinetic_stress, (0, 1, 2)), fields=("kinetic_stress",), additive=True,
        default=False,
    ),
    "rotational_kinetic_energy": Field(
        units="Pa", long_name="density of the kinetic energy of rotation", formula="sum I_i omega_i^2 / 2 Psi",
        compute=lambda f, s, o: s.rotational_energy, moments=("rotational_energy",), additive=True, default=False,
    ),
    "kinetic_energy_flux": Field(
        rank=1, units="W m^-2", long_name="flux of kinetic energy that moving grains carry",
        formula="sum (m_i v_i^2 + I_i omega_i^2) / 2 v_i Psi", compute=lambda f, s, o: s.energy_flux,
        moments=("energy_flux",), additive=True, default=False,
    ),
    "contact_energy_flux": Field(
        rank=1, units="W m^-2", long_name="flux of energy through contacts",
        formula="q_c = sum_c (f.u) a int_0^1 Psi(r - r_i + s a) ds, both sides, "
        "u = v_i + omega_i x b, a = -b = r_i - c",
        compute=lambda f, s, o: s.side_power, moments=("side_power",), additive=True, default=False,
    ),
    "kinetic_heat_flux": Field(
        rank=1, units="W m^-2", long_name="flux of the energy of fluctuations that moving grains carry",
        formula="sum (m_i v'_i^2 + I_i omega_i^2) / 2 v'_i Psi, v' = v_i - V", compute=_kinetic_heat_flux,
        fields=("_drift",),
        moments=("mass", "momentum", "kinetic", "cubes", "some_rotational_energy", "rotational_energy_flux"),
        additive=True, default=False,
    ),
    "contact_heat_flux": Field(
        rank=1, units="W m^-2", long_name="flux of energy through contacts relative to the mean flow",
        formula="q_c - V.sigma^c, which is q_c with u - V in place of u", compute=_contact_heat_flux,
        fields=("contact_energy_flux", "contact_stress", "_drift"), additive=True, default=False,
    ),
    "heat_flux": Field(
        rank=1, units="W m^-2", long_name="flux of the energy of fluctuations, by moving grains and through contacts",
        formula="q = kinetic_heat_flux + contact_heat_flux",
        compute=lambda f, s, o: f.kinetic_heat_flux + f.contact_heat_flux,
        fields=("kinetic_heat_flux", "contact_heat_flux"), additive=True, default=False,
    ),
    "stress_power": Field(
        units="W m^-3", long_name="power of the stress on the mean flow: what fluctuations gain",
        formula="-sigma : G, G of the bulk", compute=lambda f, s, o: -double_dot(f.velocity_gradient[:1], f.stress),
        fields=("stress", "velocity_gradient"), additive=True, default=False,
    ),
    "contact_power": Field(
        units="W m^-3", long_name="power of contact forces on the grains",
        formula="sum_i Psi sum_c f.u = sum_i Psi (F.v_i + T.omega_i)", compute=lambda f, s, o: s.power,
        moments=("power",), additive=True, default=False,
    ),
    "dissipation_rate": Field(
        units="W m^-3", long_name="power that contacts take up: dissipated, or stored while they are loaded",
        formula="Gamma = -sum_c f_ij.(u_i - u_j) Psi(r - c)", compute=lambda f, s, o: s.taken_up, moments=("taken_up",),
        additive=True, default=False,
    ),
    "wall_power": Field(
        units="W m^-3", long_name="power of moving walls on the grains",
        formula="sum_w f_iw.u_w Psi(r - c_iw), u_w of the wall", compute=lambda f, s, o: s.wall_power,
        moments=("wall_power",), additive=True, default=False,
    ),
}  # fmt: skip
