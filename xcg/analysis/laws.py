"""Laws of rheology that `fit_law` knows: their formulas, variables, units, and first guesses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# noise may bring what is positive below zero: least share of the largest value, in first guesses
_LEAST = 1e-6


@dataclass(frozen=True)
class Law:
    """A law ``y(x)`` with parameters to be found.

    Attributes
    ----------
    function : callable
        Of `x` and the parameters, then constants by keyword alone.
    formula : str
        For the attributes of a fit.
    x, y : str or None
        Default names of the variables.
    units : tuple of str
        SI units of the parameters.
    guess : callable or None
        First guess of the parameters from arrays x, y.
    """

    function: Callable[..., NDArray]
    formula: str = ""
    x: str | None = None
    y: str | None = None
    units: tuple[str, ...] = ()
    guess: Callable[[NDArray, NDArray], Any] | None = None


def _line(x: NDArray, y: NDArray, weight: NDArray | None = None) -> tuple[float, float]:
    slope, start = np.polyfit(x, y, 1, w=weight)
    return start, slope


def _bend(x: NDArray, y: NDArray) -> tuple[float, float, float]:
    return y[x.argmin()], 1.5 * y.max() - 0.5 * y.min(), float(np.median(x))


def _above_zero(y: NDArray) -> NDArray:
    """Return values with those below a millionth of the largest raised to it."""
    if not y.max() > 0:
        raise ValueError(
            f"fit_law: this law needs values above zero, and the largest is {y.max():g}; select the "
            "points where it holds"
        )
    return np.maximum(y, _LEAST * y.max())


def _decay(x: NDArray, y: NDArray) -> tuple[float, float]:
    # log(g) is a line; its errors are those of g over g
    least = _above_zero(y)
    level, slope = _line(x - x.min(), np.log(least), least)
    return float(np.exp(level)), -1 / slope


def _cooling(x: NDArray, y: NDArray) -> tuple[float, float]:
    # T^(-1/2) is a line; its errors are those of T times T^(-3/2)
    least = _above_zero(y)
    level, slope = _line(x - x.min(), least**-0.5, least**1.5)
    return level**-2, level / slope


LAWS: dict[str, Law] = {
    "mu_of_I": Law(
        lambda x, mu_s, mu_2, I_0: mu_s + (mu_2 - mu_s) * x / (x + I_0),
        "mu = mu_s + (mu_2 - mu_s) / (1 + I_0 / I)",
        "inertial_number",
        "friction_coefficient",
        ("1", "1", "1"),
        _bend,
    ),
    "mu_of_I_line": Law(
        lambda x, mu_s, slope: mu_s + slope * x,
        "mu = mu_s + slope I",
        "inertial_number",
        "friction_coefficient",
        ("1", "1"),
        _line,
    ),
    "phi_of_I": Law(
        lambda x, phi_c, slope: phi_c - slope * x,
        "phi = phi_c - slope I",
        "inertial_number",
        "volume_fraction",
        ("1", "1"),
        lambda x, y: np.array(_line(x, y)) * (1, -1),
    ),
    "fluidity": Law(
        lambda z, g_first, length, *, first: g_first * np.exp(-(z - first) / length),
        "g = g_first exp(-(z - first) / length)",
        "z",
        "fluidity",
        ("s^-1", "m"),
        _decay,
    ),
    "bagnold": Law(
        lambda z, V_s, V_first, h, *, first: (
            V_s - (V_s - V_first) * (np.maximum(h - z, 0) / (h - first)) ** 1.5
        ),
        "V = V_s - (V_s - V_first) ((h - z) / (h - first))^(3/2), where z < h",
        "z",
        "velocity",
        ("m s^-1", "m s^-1", "m"),
        lambda x, y: (y[x.argmax()], y[x.argmin()], x.max() + 0.1 * np.ptp(x)),
    ),
    "haff": Law(
        lambda t, T_first, tau, *, first: T_first / (1 + (t - first) / tau) ** 2,
        "T = T_first / (1 + (t - first) / tau)^2",
        "time",
        "granular_temperature",
        ("m^2 s^-2", "s"),
        _cooling,
    ),
    "beverloo": Law(
        lambda opening, C, k, *, density, diameter, gravity=9.81, exponent=2.5: (
            C * density * np.sqrt(gravity) * np.maximum(opening - k * diameter, 0) ** exponent
        ),
        "Q = C density sqrt(gravity) (opening - k diameter)^exponent",
        "opening",
        "mass_flow_rate",
        ("1", "1"),
        lambda x, y: (0.58, 1.4),
    ),
}
