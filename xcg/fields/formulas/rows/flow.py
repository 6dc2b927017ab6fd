"""Density, sizes of grains, velocity, its gradient, and the fluctuations about it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import gradient_fit
from xcg.fields.formulas import floors
from xcg.fields.formulas.algebra import (
    absolute,
    at_least_zero,
    deviator,
    dot,
    double_dot,
    mean_of,
    outer,
    rate_magnitude,
    ratio,
    restricted,
    times,
    trace,
    trace_fit,
    transposed,
    where_positive,
    zero_if_unknown,
)
from xcg.fields.formulas.field import ABOUT_MEAN_VELOCITY, Field, Options, mean_of_sums, sum_of

LINEAR = ("count", "mass", "momentum", "offset", "shear", "spread")
SQUARES = ("square", "square_offset", "square_spread")
FITS = ("least_squares", "paper")
OF_MIXTURE = ("fluctuation_stress", "fluctuation_density_by_pair", "density")


def _inner(a: NDArray) -> NDArray:
    """Return an array (phase, node, ...) as (..., phase, node): as loops take it, and as moments lie in memory."""
    return np.ascontiguousarray(a.transpose(*range(2, a.ndim), 0, 1))


def _outer(a: NDArray) -> NDArray:
    return a.transpose(a.ndim - 2, a.ndim - 1, *range(a.ndim - 2))


def _fit(f: Any, s: Any, o: Options, *, about_node: bool = False) -> SimpleNamespace:
    """Least squares through the grains about their centre of mass, or about the node: G = B M^+."""
    nodes = s.mass.shape
    spread = _inner(s.spread)[np.triu_indices(3)]
    rows = (s.count, s.mass, s.momentum, s.offset, s.shear)
    sums = np.concatenate([*(_inner(a).reshape(-1, *nodes) for a in rows), spread]).reshape(
        gradient_fit.SUMS, -1
    )
    fit = gradient_fit.fit_gradient
    if sums.dtype == object:
        fit = trace_fit
    results = fit(sums, active=o.active, about_node=about_node).reshape(-1, *nodes)
    parts = np.split(
        results,
        (gradient_fit.EXPLAINED, gradient_fit.DETERMINED, gradient_fit.MEAN, gradient_fit.INVERSE),
    )
    gradient, explained, determined, mean, inverse = parts
    return SimpleNamespace(
        gradient=_outer(gradient.reshape(3, 3, *nodes)),
        explained=_outer(explained[gradient_fit.SYMMETRIC]),
        determined=_outer(determined),
        mean=_outer(mean),
        inverse=_outer(inverse[gradient_fit.SYMMETRIC]),
    )


def with_averaged_axes(gradient: Field, kind: str) -> Field:
    """Return a row of the velocity gradient with its derivatives along averaged axes: "box", or "unknown"."""
    along_seen = gradient.compute
    if kind == "unknown":
        return replace(gradient, compute=lambda f, s, o: along_seen(f, s, o) + np.nan)
    moments = tuple(dict.fromkeys([*gradient.moments, "mass", "box_gradient"]))
    return replace(
        gradient,
        compute=lambda f, s, o: along_seen(f, s, o) + mean_of(s.box_gradient, s.mass),
        moments=moments,
    )


def _finite_difference(f: Any, s: Any, o: Options) -> NDArray:
    """Central differences of V between nodes, of second order also at the ends; NaN beside empty nodes.

    It needs all nodes at once.
    """
    flat = f._drift + s.reference
    v = flat.reshape(len(flat), *o.shape, 3)
    out = np.zeros((*v.shape, 3))
    for k in range(3):
        along = np.moveaxis(v, 1 + k, 0)  # a view, as is `slope`
        slope = np.moveaxis(out[..., k], 1 + k, 0)
        if not o.active[k]:
            continue
        if o.spacing[k] and o.wrapped[k] and len(along) > 2:
            slope[...] = (np.roll(along, -1, axis=0) - np.roll(along, 1, axis=0)) / (
                2 * o.spacing[k]
            )
        elif o.spacing[k] and len(along) > 2:
            slope[...] = np.gradient(along, o.spacing[k], axis=0, edge_order=2)
        else:
            slope[...] = np.nan
    return out.reshape(*flat.shape, 3)


def _fluctuation_stress(f: Any, s: Any, o: Options) -> NDArray:
    """Sum of m Psi v'' v'' with v'' = u - b - G (x - x_bar), b, G, x_bar the bulk's: expanded in the phase's moments.

    Of the grains that G was fitted to it is what the fit leaves of the kinetic stress, as G M = B.
    """
    least_squares = o.gradient in FITS
    if least_squares and len(s.mass) == 1:
        return f.kinetic_stress - f._fit.explained
    g = f._fit.gradient[:1]  # zero along directions that the grains do not span
    unknown = [f._fit.explained[:1, :, 0, 0]]
    if not least_squares:
        g = zero_if_unknown(f.velocity_gradient[:1])
        unknown += [f.velocity_gradient[:1, :, i, j] for i in range(3) for j in range(3)]
    zero = sum(x - x for x in unknown)  # or NaN
    # v'' = u - c - G x, and G x, G x x and u G x summed over the grains
    c = zero_if_unknown(f._drift[:1]) - times(g, f._fit.mean[:1, ..., None])[..., 0]
    gx = times(g, s.offset[..., None])[..., 0]
    gxx = times(g, s.spread)
    ugx = times(s.shear, transposed(g))
    gxgx = times(gxx, transposed(g))
    rest = gx - s.momentum
    out = np.empty((3, 3, *s.mass.shape), s.mass.dtype)
    for i in range(3):
        for j in range(i, 3):
            total = s.kinetic[..., i, j] + s.mass * c[..., i] * c[..., j] + gxgx[..., i, j]
            total = (
                total
                + c[..., i] * rest[..., j]
                - ugx[..., i, j]
                + c[..., j] * rest[..., i]
                - ugx[..., j, i]
            )
            out[i, j] = out[j, i] = total + zero
    return _outer(out)


def _kinetic_stress(f: Any, s: Any, o: Options) -> NDArray:
    """Sum of m Psi (u - b)(u - b) = sum m Psi u u - b p - (p - b sum m Psi) b, with b the mean velocity of the bulk."""
    b = zero_if_unknown(f._drift[:1])
    out = np.empty((3, 3, *s.mass.shape), s.mass.dtype)
    for i in range(3):
        rest = s.momentum[..., i] - b[..., i] * s.mass  # nothing but for phases
        for j in range(i, 3):
            total = s.kinetic[..., i, j] - b[..., i] * s.momentum[..., j]
            out[i, j] = out[j, i] = total - rest * b[..., j]
    return _outer(out)


def _momentum_flux(f: Any, s: Any, o: Options) -> NDArray:
    """Return S m Psi v v from S m Psi, S m Psi u and S m Psi u u; v = u + b, b the node's reference."""
    b = s.reference
    moved = s.momentum + s.mass[..., None] * b
    return s.kinetic + outer(b, s.momentum) + outer(moved, b)


def about(
    sums: tuple[NDArray, NDArray, NDArray], a: NDArray, b: NDArray
) -> tuple[NDArray, NDArray]:
    """Return the sums of w (x - a) and of w (x - a)(x - b), from the sums of w, w x and w x x."""
    weight, first, second = sums
    moved = first - weight[..., None] * a
    return moved, second - outer(a, first) - outer(moved, b)


def _taken_by_mean(f: Any, s: Any, o: Options) -> NDArray:
    """Return the density whose fluctuations the mean velocity of the bulk takes, in each phase: see `_taken_by_fit`."""
    mass = where_positive(s.mass[:1])
    return zero_if_unknown(2 * s.square / mass - s.mass * s.square[:1] / (mass * mass))


def _taken_by_fit(f: Any, s: Any, o: Options) -> NDArray:
    """Return the mass density lost to the degrees of freedom of the fit, rho - rho_T, by phase.

    The fit gives grain i the velocity ``sum_j H_ij v_j`` with ``H_ij = w_j (1 / rho + y_i A x_j)``,
    w = m Psi, x and y relative to x_bar and to the point of the fit, A = M^+. Of independent
    fluctuations it takes, from the grains i of a phase, ``sum_i w_i (2 H_ii - sum_j H_ij^2)``: for
    the bulk ``tr(M^-1 sum w^2 phi phi)``, phi = (1, x).
    """
    point = f._fit.mean[:1]
    inverse = f._fit.inverse[:1]
    centre = zero_if_unknown(mean_of(s.offset[:1], s.mass[:1]))
    squares = s.square, s.square_offset, s.square_spread
    shift, bulk = about(tuple(a[:1] for a in squares), centre, centre)
    if len(s.mass) == 1:
        return _taken_by_mean(f, s, o) + double_dot(inverse, bulk)
    _, own = about(squares, centre, point)
    first, second = about((s.mass, s.offset, s.spread), point, point)
    across = times(inverse, shift[..., None])[..., 0]
    mean = zero_if_unknown(2 * dot(across, first) / where_positive(s.mass[:1]))
    shared = double_dot(times(times(inverse, bulk), inverse), second)
    return _taken_by_mean(f, s, o) + (2 * double_dot(inverse, own) - mean - shared)


def _left_by_pair(f: Any, s: Any, o: Options) -> NDArray:
    """Return c_ab = sum_i w_i sum_j (delta_ij - H_ij)^2 of grains i of phase a and j of b, H as in `_taken_by_fit`.

    It is ``delta_ab (rho_a - 2 sum_i w_i H_ii) + sum_i w_i sum_j H_ij^2``: with the sums of w y and
    w y y over phase a, and those of w^2, w^2 x and w^2 x x over phase b.
    """
    mass = where_positive(s.mass[:1])
    own = 2 * s.square / mass
    shared = [s.mass / mass * (s.square[k] / mass) for k in range(1, len(s.mass))]
    if o.gradient in FITS:
        point = f._fit.mean[:1]
        inverse = f._fit.inverse[:1]
        centre = zero_if_unknown(mean_of(s.offset[:1], s.mass[:1]))
        squares = s.square, s.square_offset, s.square_spread
        shift, spread = about(squares, centre, centre)
        own = own + 2 * double_dot(inverse, about(squares, centre, point)[1])
        first, second = about((s.mass, s.offset, s.spread), point, point)
        for k in range(1, len(s.mass)):
            across = times(inverse, shift[k : k + 1, ..., None])[..., 0]
            of_slopes = double_dot(times(times(inverse, spread[k : k + 1]), inverse), second)
            shared[k - 1] = shared[k - 1] + (2 * dot(across, first) / mass + of_slopes)
    left = [zero_if_unknown(column) for column in shared]
    alone = zero_if_unknown(s.mass - own)
    for k, column in enumerate(left, start=1):
        column[k] = column[k] + alone[k]
        column[0] = sum(column[2:], start=column[1])
    walls = s.mass - s.mass
    return np.stack([*left, walls], axis=-1)


# Share of a phase's density that must be left of it for its temperature to be known.
_LEAST_LEFT = 1e-3


def _is_positive(x: NDArray) -> NDArray:
    """Return 1 where x is positive, 0 elsewhere."""
    return zero_if_unknown(x / where_positive(x))


def solved(f: Any, residual: NDArray) -> NDArray:
    """Solve ``residual_a = sum_b c_ab T_b`` by elimination, for residuals (phase, node, k).

    0 for phases without grains; NaN for all where one has too little left.
    """
    count = len(residual) - 1
    density = f.density
    absent = [1.0 - _is_positive(density[k]) for k in range(1, count + 1)]
    rows = [
        [f.fluctuation_density_by_pair[a, ..., b] for b in range(count)]
        for a in range(1, count + 1)
    ]
    values = [residual[k] for k in range(1, count + 1)]
    for k in range(count):
        pivot = rows[k][k] + absent[k]
        enough = where_positive(pivot - _LEAST_LEFT * density[k + 1])
        rows[k][k] = pivot + (enough - enough)
        for m in range(k + 1, count):
            factor = rows[m][k] / rows[k][k]
            rows[m] = [x - factor * y for x, y in zip(rows[m], rows[k], strict=True)]
            values[m] = values[m] - factor[..., None] * values[k]
    solution: list[NDArray] = []
    for k in reversed(range(count)):
        rest = values[k]
        for m, temperature in enumerate(reversed(solution), start=k + 1):
            rest = rest - rows[k][m][..., None] * temperature
        solution.append(rest / rows[k][k][..., None])
    solution.reverse()
    weighted = [density[k + 1][..., None] * value for k, value in enumerate(solution)]
    bulk = sum(weighted[1:], start=weighted[0]) / where_positive(density[0])[..., None]
    return np.stack([bulk, *solution])


def _of_mixture(f: Any, residual: NDArray) -> NDArray:
    """Return the temperatures of all phases and of the bulk, the mean by mass; NaN where negative or without grains."""
    values = solved(f, residual)
    scale = sum((absolute(value) for value in values), start=np.zeros(values.shape[1:]))
    is_negative = _is_positive(at_least_zero(-values) - 1e-9 * scale)
    here = where_positive(_is_positive(f.density))[..., None]
    return at_least_zero(values) * where_positive(1.0 - is_negative) * here


def _temperature_of_mixture(f: Any, s: Any, o: Options) -> NDArray:
    residual = trace(f.fluctuation_stress, o.plane) / o.dimension
    return _of_mixture(f, residual[..., None])[..., 0]


def _temperature_of_mixture_along(f: Any, s: Any, o: Options) -> NDArray:
    return _of_mixture(f, np.diagonal(f.fluctuation_stress, axis1=-2, axis2=-1))


def _free(f: Any, s: Any, o: Options) -> NDArray:
    """Return rho_T, or NaN where less than half a mean particle's weight is left after the fit."""
    enough = where_positive(f.fluctuation_density - 0.5 * ratio(s.mass, s.count))
    return f.fluctuation_density + (enough - enough)


def _temperature(f: Any, s: Any, o: Options) -> NDArray:
    return ratio(at_least_zero(trace(f.fluctuation_stress, o.plane)), o.dimension * f._free)


def _temperature_along(f: Any, s: Any, o: Options) -> NDArray:
    return ratio(at_least_zero(np.diagonal(f.fluctuation_stress, axis1=-2, axis2=-1)), f._free)


def rate_of_magnitude(f: Any, o: Options) -> NDArray:
    """Return the part of the shear rate tensor whose magnitude is the shear rate."""
    rate = restricted(f.shear_rate_tensor, o.shear_axes)
    if o.deviatoric in ("rate", "both"):
        rate = deviator(rate, o.shear_axes or o.plane)
    return rate


ROWS: dict[str, Field] = {
    "sample_count": sum_of(
        "count", long_name="number of particles that reach the node", formula="sum_i [Psi_i > 0]"
    ),
    "volume_fraction": sum_of("volume", long_name="volume fraction", formula="phi = sum V_i Psi"),
    "void_fraction": Field(
        long_name="void fraction",
        formula="epsilon = 1 - phi",
        compute=lambda f, s, o: 1.0 - f.volume_fraction,
        fields=("volume_fraction",),
        default=False,
    ),
    "density": sum_of(
        "mass",
        units="kg m^-3",
        long_name="mass density of the mixture",
        formula="rho = sum m_i Psi",
    ),
    "particle_density": Field(
        units="kg m^-3",
        long_name="density of the particles' material",
        formula="rho_p = rho / phi",
        compute=lambda f, s, o: mean_of(f.density, f.volume_fraction),
        fields=("density", "volume_fraction"),
        weight="volume_fraction",
    ),
    "centre_offset": mean_of_sums(
        "offset",
        "mass",
        rank=1,
        units="m",
        long_name="centre of mass of the grains at the node, from the node",
        formula="r_bar - r = sum m_i (r_i - r) Psi / rho",
        weight="density",
        default=False,
    ),
    "number_density": sum_of(
        "number", units="m^-3", long_name="number density", formula="n = sum Psi"
    ),
    "d32": mean_of_sums(
        "size3",
        "size2",
        units="m",
        long_name="surface-weighted mean diameter",
        formula="d32 = sum d_i^3 Psi / sum d_i^2 Psi",
        weight="volume_fraction",
        harmonic=True,
    ),
    "d43": mean_of_sums(
        "size4",
        "size3",
        units="m",
        long_name="volume-weighted mean diameter",
        formula="d43 = sum d_i^4 Psi / sum d_i^3 Psi",
        weight="volume_fraction",
    ),
    "momentum_density": Field(
        rank=1,
        units="kg m^-2 s^-1",
        long_name="momentum density",
        formula="p = sum m_i v_i Psi",
        compute=lambda f, s, o: s.momentum + s.mass[..., None] * s.reference,
        moments=("mass", "momentum"),
        additive=True,
    ),
    "momentum_flux": Field(
        rank=2,
        units="Pa",
        long_name="flux of momentum that moving grains carry",
        formula="sum m_i v_i v_i Psi = rho V V + sigma^k",
        compute=_momentum_flux,
        moments=("mass", "momentum", "kinetic"),
        additive=True,
        default=False,
    ),
    "velocity": Field(
        rank=1,
        units="m s^-1",
        long_name="velocity",
        formula="V = p / rho",
        compute=lambda f, s, o: f._drift + s.reference,
        fields=("_drift",),
        weight="density",
    ),
    "velocity_gradient": Field(
        rank=2,
        units="s^-1",
        long_name="velocity gradient, dV_component / dx_direction",
        formula="G = [sum m Psi (v_i - V)(r_i - r_bar)] M^-1, M = sum m Psi (r_i - r_bar)(r_i - r_bar)",
        compute=lambda f, s, o: f._fit.gradient * f._fit.determined[..., None, :],
        fields=("_fit",),
        weight="density",
    ),
    "shear_rate_tensor": Field(
        rank=2,
        units="s^-1",
        long_name="shear rate tensor",
        formula="Gamma = (G + G^T) / 2",
        compute=lambda f, s, o: (f.velocity_gradient + transposed(f.velocity_gradient)) / 2,
        fields=("velocity_gradient",),
        weight="density",
    ),
    "shear_rate": Field(
        units="s^-1",
        long_name="shear rate",
        formula="|dev Gamma| = sqrt(2 dev Gamma : dev Gamma)",
        compute=lambda f, s, o: rate_magnitude(rate_of_magnitude(f, o)),
        fields=("shear_rate_tensor",),
        floor=floors.shear_rate,
        usual=1.0,
        floor_units=floors.UNIT_OF_RATES,
        is_norm=True,
    ),
    "kinetic_stress": Field(
        rank=2,
        units="Pa",
        long_name="kinetic stress",
        formula="sigma^k = sum m_i (v_i - V)(v_i - V) Psi",
        compute=_kinetic_stress,
        fields=("_drift",),
        moments=("mass", "momentum", "kinetic"),
        additive=True,
        covariance=lambda f, s, o: f.covariance,
        averages=ABOUT_MEAN_VELOCITY,
    ),
    "fluctuation_stress": Field(
        rank=2,
        units="Pa",
        long_name="kinetic stress about the velocity at the particles",
        formula="sum m_i v'_i v'_i Psi, v'_i = v_i - V - G (r_i - r_bar), G in whole",
        compute=_fluctuation_stress,
        fields=("_fit", "_drift", "velocity_gradient", "kinetic_stress"),
        moments=(*LINEAR[1:], "kinetic"),
        additive=True,
    ),
    "fluctuation_density": Field(
        units="kg m^-3",
        long_name="mass density less the degrees of freedom of the fit",
        formula="rho_T = rho - tr(P^-1 sum (m_i Psi)^2 p_i p_i), P = sum m_i Psi p_i p_i, p_i = (1, r_i - r_bar)",
        compute=lambda f, s, o: at_least_zero(s.mass - f._taken),
        fields=("_taken",),
        moments=("mass",),
        additive=True,
    ),
    "granular_temperature": Field(
        units="m^2 s^-2",
        long_name="granular temperature",
        formula="T = tr(sum m_i v'_i v'_i Psi) / (D rho_T)",
        compute=_temperature,
        fields=("fluctuation_stress", "_free"),
        weight="fluctuation_density",
    ),
    "directional_temperature": Field(
        rank=1,
        units="m^2 s^-2",
        long_name="granular temperature of the fluctuations along each axis",
        formula="T_k = sum m_i v'_ik v'_ik Psi / rho_T",
        compute=_temperature_along,
        fields=("fluctuation_stress", "_free"),
        weight="fluctuation_density",
    ),
    "mixture_temperature": Field(
        units="J",
        long_name="granular temperature as an energy, of the bulk that of the mixture",
        formula="m_a T_a = rho_a T_a / n_a, of the bulk sum n_a m_a T_a / n",
        compute=lambda f, s, o: f.granular_temperature * mean_of(f.density, f.number_density),
        fields=("granular_temperature", "density", "number_density"),
        default=False,
    ),
    "fluctuation_density_by_pair": Field(
        units="kg m^-3",
        long_name="mass density whose fluctuations in other_phase the fit leaves to the phase",
        formula="c_ab = sum_i m_i Psi sum_j (delta_ij - H_ij)^2, i in a, j in b, H of the fit",
        compute=_left_by_pair,
        fields=("_fit",),
        moments=("mass", "offset", "spread", *SQUARES),
        additive=True,
        default=False,
        option="by",
        paired=True,
    ),
    "effective_count": Field(
        long_name="effective number of particles, which errors of one step follow from",
        formula="N_eff = (sum m_i Psi)^2 / sum (m_i Psi)^2",
        compute=lambda f, s, o: ratio(s.mass * s.mass, s.square),
        moments=("mass", "square"),
        weight="density",
    ),
    # the velocity relative to the node's reference, NaN where there are no grains
    "_drift": mean_of_sums("momentum", "mass", rank=1, units="m s^-1", formula="V - U"),
    "_fit": Field(rank=2, units="s^-1", formula="B M^+", compute=_fit, moments=LINEAR),
    "_taken": Field(
        units="kg m^-3",
        formula="rho - rho_T",
        compute=_taken_by_fit,
        fields=("_fit",),
        moments=("mass", "offset", "spread", *SQUARES),
    ),
    "_free": Field(
        units="kg m^-3",
        formula="rho_T, where known",
        compute=_free,
        fields=("fluctuation_density",),
        moments=("count", "mass"),
    ),
}
# variants of a field: the option that selects one, and a row for each value that is not the default
WAYS: dict[str, tuple[str, dict[str, Field]]] = {
    "velocity_gradient": (
        "gradient",
        {
            "kernel": replace(
                ROWS["velocity_gradient"],
                formula="G = (grad p - V grad rho) / rho",
                compute=lambda f, s, o: mean_of(
                    s.momentum_slope - outer(f._drift, s.mass_slope), s.mass
                ),
                fields=("_drift",),
                moments=("mass", "mass_slope", "momentum_slope"),
            ),
            "finite_difference": replace(
                ROWS["velocity_gradient"],
                formula="G = [V(r + h) - V(r - h)] / 2 h, h the spacing of the nodes",
                compute=_finite_difference,
                fields=("_drift",),
                moments=(),
            ),
            "paper": replace(
                ROWS["velocity_gradient"],
                formula="G = [sum m Psi (v_i - V)(r_i - r)] M^-1, M = sum m Psi (r_i - r)(r_i - r)",
            ),
        },
    ),
    "_fit": (
        "gradient",
        {
            "paper": replace(ROWS["_fit"], compute=partial(_fit, about_node=True)),
        },
    ),
    "fluctuation_stress": (
        "gradient",
        {
            "paper": replace(
                ROWS["fluctuation_stress"],
                formula="sum m_i v'_i v'_i Psi, v'_i = v_i - V - G (r_i - r)",
                fields=("_fit", "_drift", "kinetic_stress"),
            ),
        },
    ),
    "_taken": (
        "gradient",
        dict.fromkeys(
            ("kernel", "finite_difference"),
            replace(ROWS["_taken"], compute=_taken_by_mean, fields=(), moments=("mass", "square")),
        ),
    ),
    "fluctuation_density_by_pair": (
        "gradient",
        dict.fromkeys(
            ("kernel", "finite_difference"),
            replace(ROWS["fluctuation_density_by_pair"], fields=(), moments=("mass", "square")),
        ),
    ),
    "granular_temperature": (
        "temperature",
        {
            "mixture": replace(
                ROWS["granular_temperature"],
                long_name="granular temperature about the bulk's velocity, of a phase with its diffusion velocity",
                formula="tr(sum m_i v'_i v'_i Psi)_a = D sum_b c_ab T_b, of the bulk sum rho_a T_a / rho",
                compute=_temperature_of_mixture,
                fields=OF_MIXTURE,
                weight="",
                across_phases=True,
            ),
        },
    ),
    "directional_temperature": (
        "temperature",
        {
            "mixture": replace(
                ROWS["directional_temperature"],
                long_name="granular temperature along each axis about the bulk's velocity, of a phase with its "
                "diffusion velocity",
                formula="(sum m_i v'_ik v'_ik Psi)_a = sum_b c_ab T_k,b, of the bulk sum rho_a T_k,a / rho",
                compute=_temperature_of_mixture_along,
                fields=OF_MIXTURE,
                weight="",
                across_phases=True,
            ),
        },
    ),
    "fluctuation_density": (
        "temperature",
        {
            "biased": replace(
                ROWS["fluctuation_density"],
                formula="rho_T = rho",
                compute=lambda f, s, o: s.mass,
                fields=(),
            ),
        },
    ),
}
