"""Errors of one step: standard deviations of fields whose sums are over independent fluctuations of the grains.

Grains are where they are, and each has a velocity ``v_i = V + G x_i + e_i``, x_i = r_i - r_bar, the
e_i independent with the covariance ``Theta = sum w_i e_i e_i / rho_T``, w_i = m_i Psi. A field that
is a weighted sum of the e_i has the variance ``sum_i a_i^2 Theta``: ``T_k / N_eff`` of V, and ``T_k
S_ll`` of G, ``S = M^-1 (sum w_i^2 x_i x_i) M^-1``. Of squares of the e_i, Isserlis' (Wick's)
theorem gives it. Where neighbours move together, as in dense slow flow, fewer grains are
independent, and errors are larger than these.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas.algebra import (
    at_least_zero,
    contraction,
    double_dot,
    mean_of,
    ratio,
    restricted,
    times,
    trace,
    transposed,
    where_positive,
    zero_if_unknown,
)
from xcg.fields.formulas.field import Field, Function, Options
from xcg.fields.formulas.rows import energy, flow
from xcg.fields.formulas.rows.energy import SQUARE, WEIGHT
from xcg.fields.formulas.rows.flow import SQUARES, about


def _share(f: Any, s: Any, o: Options) -> NDArray:
    """Return 1 / N_eff."""
    mass = where_positive(s.mass)
    return s.square / (mass * mass)


def _slopes(f: Any, s: Any, o: Options) -> NDArray:
    """Return A Q A with G = sum_i w_i v_i (r_i - r_bar) A, Q = sum w_i^2 (r_i - r_bar)(r_i - r_bar)."""
    centre = zero_if_unknown(mean_of(s.offset, s.mass))
    _, squares = about((s.square, s.square_offset, s.square_spread), centre, centre)
    return times(times(f._fit.inverse, squares), f._fit.inverse)


def _root(x: NDArray) -> NDArray:
    return np.sqrt(at_least_zero(x))


def _diagonal(tensor: NDArray) -> NDArray:
    return np.stack([tensor[..., k, k] for k in range(3)], axis=-1)


def _velocity(f: Any, s: Any, o: Options) -> NDArray:
    return _root(_diagonal(f._covariance) * f._share[..., None])


def _gradient(f: Any, s: Any, o: Options) -> NDArray:
    """Error of G_kl: T_k from the velocity's component, S_ll from the places along l."""
    error = _root(_diagonal(f._covariance)[..., :, None] * _diagonal(f._slopes)[..., None, :])
    return error * f._fit.determined[..., None, :]


def _rate(f: Any, s: Any, o: Options) -> NDArray:
    """Errors of (G + G^T) / 2: components of one velocity are correlated by Theta, slopes by A Q A."""
    of_velocity = _diagonal(f._covariance)
    of_slopes = _diagonal(f._slopes)
    of_gradient = of_velocity[..., :, None] * of_slopes[..., None, :]
    both = of_gradient + transposed(of_gradient) + 2 * f._covariance * f._slopes
    return _root(both / 4)


def _vorticity(f: Any, s: Any, o: Options) -> NDArray:
    theta = f._covariance
    slopes = f._slopes
    variances = []
    for i, j in ((1, 2), (2, 0), (0, 1)):
        variances.append(
            theta[..., j, j] * slopes[..., i, i]
            + theta[..., i, i] * slopes[..., j, j]
            - 2 * theta[..., i, j] * slopes[..., i, j]
        )
    return _root(np.stack(variances, axis=-1))


def _shear_rate(f: Any, s: Any, o: Options) -> NDArray:
    """Error of |D| = sqrt(Q), Q = 2 D:D, to second order: var Q = 16 D C D - 8 tr (P C)^2.

    C is the covariance of (dG + dG^T) / 2, and P takes the deviator, as D = dev Gamma does: with M =
    C : 1 = (Theta S + S Theta) / 2, tr (P C)^2 = tr C^2 - 2/n M:M + (Theta:S)^2 / n^2. The second
    term subtracts what the noise of Gamma itself adds to the first, at most three quarters of it.
    """
    rate = flow.rate_of_magnitude(f, o)
    theta = restricted(f._covariance, o.shear_axes)
    slopes = restricted(f._slopes, o.shear_axes)
    first = 4 * double_dot(theta, times(times(rate, slopes), transposed(rate)))
    squares = contraction(theta) * contraction(slopes) + 2 * contraction(times(theta, slopes))
    both = double_dot(theta, slopes)
    second = (squares + both * both) / 2
    if o.deviatoric in ("rate", "both"):
        n = len(o.shear_axes or o.plane)
        product = times(theta, slopes)
        mixed = contraction((product + transposed(product)) / 2)
        second = second - (4 / n * mixed - 2 / (n * n) * both * both)
    rate2 = f.shear_rate * f.shear_rate
    return _root(ratio(first / 4 + at_least_zero(0.75 * first - second), rate2))


def _left(f: Any, s: Any, o: Options) -> NDArray:
    """1 / N_left of the fluctuations that the fit leaves: between rho / (N_eff rho_T), of equal weights, and 1 / N_eff.

    The fit takes most from the grains of the largest weight. Of random packings, the geometric mean
    of both is right to 9 % where N_eff > 4 (docs/width.md).
    """
    return f._share * np.sqrt(ratio(s.mass, f._free))


def _temperature(f: Any, s: Any, o: Options) -> NDArray:
    """Return sqrt(2 Theta:Theta / N_left) / D; the noise of Theta itself is subtracted from its square."""
    squares = contraction(restricted(f._covariance, o.plane)) / (1 + (o.dimension + 1) * f._left)
    return _root(2 * squares * f._left) / o.dimension


def _temperature_along(f: Any, s: Any, o: Options) -> NDArray:
    return _root(2 * f._left / (1 + 2 * f._left))[..., None] * _diagonal(f._covariance)


def _mixture(f: Any, residual: NDArray, dimension: int) -> NDArray:
    """Return the errors of temperatures that solve ``R_a = sum_b c_ab T_b``, for residuals R (phase, node, k).

    Residuals of different phases have independent errors, ``sqrt(2 / D N_left) R_b``.
    """
    count = len(residual) - 1
    zero = f._left - f._left
    unit = [[zero[a] + float(a == b) for b in range(1, count + 1)] for a in range(count + 1)]
    inverse = flow.solved(f, np.stack([np.stack(row, axis=-1) for row in unit]))
    noise = 2 * f._left / (dimension * (1 + 2 * f._left / dimension))
    parts = []
    for b in range(1, count + 1):
        error = residual[b] * np.sqrt(zero_if_unknown(noise[b]))[..., None]
        parts.append(inverse[..., b - 1, None] * error)
    return _root(sum((part * part for part in parts[1:]), start=parts[0] * parts[0]))


def _temperature_of_mixture(f: Any, s: Any, o: Options) -> NDArray:
    residual = trace(f.fluctuation_stress, o.plane) / o.dimension
    return _mixture(f, residual[..., None], o.dimension)[..., 0]


def _temperature_of_mixture_along(f: Any, s: Any, o: Options) -> NDArray:
    return _mixture(f, _diagonal(f.fluctuation_stress), 1)


def _kinetic_stress(f: Any, s: Any, o: Options) -> NDArray:
    """Isserlis' theorem: the variance of x_i x_j is X_ii X_jj + X_ij^2, less that of their steady part, G (r - r_bar).

    The noise of these squares is subtracted; a steady part counts as far as it is more than that.
    """
    share = f._share[..., None, None]
    whole = _squares(f.kinetic_stress)
    steady = _squares(f.kinetic_stress - f._covariance * s.mass[..., None, None])
    without_noise = whole / (1 + share * (1 + np.eye(3)))
    return _root((without_noise - at_least_zero(steady - 4 * share * whole)) * share)


def _squares(tensor: NDArray) -> NDArray:
    along = _diagonal(tensor)
    return along[..., :, None] * along[..., None, :] + tensor * tensor


def _spin(f: Any, s: Any, o: Options) -> NDArray:
    free = where_positive(f.fluctuation_inertia)
    weight = where_positive(s.rotation[..., WEIGHT])
    share = s.rotation[..., SQUARE] / (weight * weight)
    return _root(_diagonal(f.spin_fluctuation) * (share / free)[..., None])


_SLOPES = ("_covariance", "_slopes")
_ERRORS: dict[str, tuple[Function, tuple[str, ...], str]] = {
    "velocity": (_velocity, ("_covariance", "_share"), "sqrt(T_k / N_eff)"),
    "velocity_gradient": (_gradient, (*_SLOPES, "_fit"), "sqrt(T_k S_ll)"),
    "shear_rate_tensor": (_rate, _SLOPES, "sqrt(T_k S_ll + T_l S_kk + 2 Theta_kl S_kl) / 2"),
    "shear_rate": (
        _shear_rate,
        (*_SLOPES, "shear_rate_tensor", "shear_rate"),
        "standard deviation of |dev Gamma|",
    ),
    "vorticity": (_vorticity, _SLOPES, "that of G_kl - G_lk"),
    "granular_temperature": (
        _temperature,
        ("_covariance", "_left"),
        "sqrt(2 Theta:Theta / N_left) / D",
    ),
    "directional_temperature": (
        _temperature_along,
        ("_covariance", "_left"),
        "sqrt(2 / N_left) T_k",
    ),
    "kinetic_stress": (
        _kinetic_stress,
        ("kinetic_stress", "_covariance", "_share"),
        "sqrt((s_kk s_ll + s_kl^2) / N_eff)",
    ),
    "spin": (
        _spin,
        ("spin_fluctuation", "fluctuation_inertia"),
        "sqrt(T_k / N_eff), of omega weighted by I",
    ),
}
_SOURCES = flow.ROWS | energy.ROWS
# errors of fits in the axes x, y and z alone
OF_FITS = {f"{name}_error" for name, (_, fields, _) in _ERRORS.items() if "_slopes" in fields}
OF_PLACES = OF_FITS | {"kinetic_stress_error"}  # and of what differs about a cylinder's axis
_MOMENTS = {"spin": ("rotation",), "kinetic_stress": ("mass",)}


def _error_of(name: str) -> Field:
    """Row of the error of a field, in its unit."""
    compute, fields, formula = _ERRORS[name]
    of = _SOURCES[name]
    return Field(
        rank=of.rank,
        units=of.units,
        long_name=f"standard error in one step of {of.long_name}",
        formula=formula,
        compute=compute,
        fields=fields,
        moments=_MOMENTS.get(name, ()),
        default=False,
    )


ROWS: dict[str, Field] = {
    **{f"{name}_error": _error_of(name) for name in _ERRORS},
    "_share": Field(
        formula="1 / N_eff = sum w^2 / (sum w)^2, w = m_i Psi",
        compute=_share,
        moments=("mass", "square"),
    ),
    "_covariance": Field(  # of the components of one grain's fluctuation
        rank=2,
        units="m^2 s^-2",
        formula="Theta = sum m_i v'_i v'_i Psi / rho_T",
        compute=lambda f, s, o: ratio(f.fluctuation_stress, f._free),
        fields=("fluctuation_stress", "_free"),
    ),
    "_slopes": Field(
        rank=2,
        units="m^-2",
        formula="S = A Q A, A = M^+, Q = sum w^2 (r_i - r_bar)(r_i - r_bar)",
        compute=_slopes,
        fields=("_fit",),
        moments=("mass", "offset", *SQUARES),
    ),
    "_left": Field(
        formula="1 / N_left = sqrt(rho / rho_T) / N_eff",
        compute=_left,
        fields=("_share", "_free"),
        moments=("mass",),
    ),
}
# other ways to a field, as in `xcg.fields.formulas.rows.flow`
WAYS: dict[str, tuple[str, dict[str, Field]]] = {
    f"{name}_error": (
        "temperature",
        {
            "mixture": replace(
                ROWS[f"{name}_error"],
                formula="sqrt(sum_b (c^-1)_ab^2 2 R_b^2 / (D N_left,b)), R_b = sum_c c_bc T_c",
                compute=compute,
                fields=(*flow.OF_MIXTURE, "_left"),
            )
        },
    )
    for name, compute in (
        ("granular_temperature", _temperature_of_mixture),
        ("directional_temperature", _temperature_of_mixture_along),
    )
}
