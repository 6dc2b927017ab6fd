"""The registry of fields: one row each, with its dimensions, units, formula, the moments it needs, and the algebra.

A row's function takes ``f`` (the fields it needs), ``s`` (the moments it needs, see `xcg.fields.moments`) and ``o``
(`Options`). All arrays are (phase, node, ...), with phase 0 the bulk; fluctuations of every phase are about the
velocity of the bulk, so that partial fields add up.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import fit
from xcg.fields.trace import at_least_zero, trace_fit, where_positive, zero_if_unknown

Function = Callable[[Any, Any, "Options"], Any]


@dataclass(frozen=True)
class Options:
    """Choices that the algebra depends on.

    Attributes
    ----------
    plane : tuple of int
        The axes of the scene: (0, 1, 2), or two of them.
    active : tuple of bool
        The axes along which grains differ at a node (resolved or fixed ones).
    shape : tuple of int
        Nodes along x, y, z, for finite differences.
    spacing : tuple of float
        Distance of nodes along x, y, z (m), for finite differences; 0 along axes that are not resolved.
    wrapped : tuple of bool
        The axes along which the last node is a neighbour of the first.
    gradient : str
        "least_squares", "kernel", "finite_difference" or "paper".
    pressure_axes : tuple of int, optional
        The normal stresses whose mean is the pressure; those of the scene by default.
    shear_axes : tuple of int, optional
        The axes that magnitudes of stress and shear rate are restricted to; the scene's by default.
    deviatoric : str
        Which magnitudes are those of deviators: of "stress", "rate", "both" or "neither".
    size : str
        The diameter in the inertial number: "d43", "d32", or "d50", "dmax" of the whole scene.
    diameter : float
        d50 or dmax of the scene (m), where `size` names one of them.
    fluid_viscosity : float, optional
        Viscosity of the fluid between the grains (Pa s).
    by_pair : bool, optional
        Whether contact stress is also divided by the phase of the partner.
    temperature : str
        "unbiased", or "biased": per density, whatever the fit takes.
    own : tuple
        Fields that are not those of xcg, each with a `name`, its `row`, and `moments` by name: of the scene's own
        variables, see `xcg.fields.variables.OwnField`, and those that users registered, see `Registered`. What computes
        a plan in another process finds them here.
    """

    plane: tuple[int, ...] = (0, 1, 2)
    active: tuple[bool, bool, bool] = (True, True, True)
    shape: tuple[int, int, int] = (1, 1, 1)
    spacing: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wrapped: tuple[bool, bool, bool] = (False, False, False)
    gradient: str = "least_squares"
    pressure_axes: tuple[int, ...] | None = None
    shear_axes: tuple[int, ...] | None = None
    deviatoric: str = "stress"
    size: str = "d43"
    diameter: float = float("nan")
    fluid_viscosity: float | None = None
    by_pair: bool | None = None
    temperature: str = "unbiased"
    own: tuple[Any, ...] = ()

    @property
    def dimension(self) -> int:
        """Number of dimensions D of the scene."""
        return len(self.plane)


@dataclass(frozen=True)
class Field:
    """One field.

    Attributes
    ----------
    rank : int
        0 scalar, 1 vector (``component``), 2 tensor (``component``, ``direction``).
    powers : tuple of int
        Powers of (length, mass, time) of its unit.
    long_name, formula : str
        For the attributes and the table of the documentation.
    compute : callable
        ``compute(f, s, o)``.
    fields, moments : tuple of str
        What it needs.
    additive : bool
        Whether it is a sum: the partial fields of the phases add up to the bulk, and averages over nodes or steps are
        means.
    weight : str
        The additive field that weighs its averages, where it is a ratio: the one in the denominator. A field that is
        neither additive nor weighted is computed anew from averages of the fields it needs.
    harmonic : bool
        Whether it is its inverse that is averaged with `weight`, as the weight is the numerator.
    listed : bool
        False for steps of the algebra that are not fields of their own.
    default : bool
        Whether it is computed where no field is asked for by name.
    option : str
        An attribute of `Options` that has to be given for it.
    paired : bool
        Whether it has the dimension ``other_phase``.
    units : str, optional
        Its unit, where powers of length, mass and time do not make it; empty where it is not known.
    source : str
        The variable of the scene that it is made of, where it is not one that all scenes have.
    """

    rank: int
    powers: tuple[int, int, int]
    long_name: str
    formula: str
    compute: Function
    fields: tuple[str, ...] = ()
    moments: tuple[str, ...] = ()
    additive: bool = False
    weight: str = ""
    harmonic: bool = False
    listed: bool = True
    default: bool = True
    option: str = ""
    paired: bool = False
    units: str | None = None
    source: str = ""


# --- small algebra ---------------------------------------------------------------------------------------


def ratio(a: NDArray, b: NDArray) -> NDArray:
    """Return a / b with NaN where b is not positive; b lacks the last axes of a."""
    return a / where_positive(b).reshape(b.shape + (1,) * (a.ndim - b.ndim))


def outer(a: NDArray, b: NDArray) -> NDArray:
    """Return a_i b_j."""
    return a[..., :, None] * b[..., None, :]


def trace(tensor: NDArray, axes: Sequence[int]) -> NDArray:
    """Trace over some axes."""
    return sum((tensor[..., k, k] for k in axes), start=np.zeros(tensor.shape[:-2]))


def mean_normal(tensor: NDArray, axes: Sequence[int]) -> NDArray:
    """Return the mean of the normal components along some axes."""
    return trace(tensor, axes) / len(axes)


def restricted(tensor: NDArray, axes: Sequence[int] | None) -> NDArray:
    """Return the components between some axes, the others set to zero; the whole tensor for None."""
    if axes is None:
        return tensor
    inside = np.isin(np.arange(3), axes)
    return np.where(inside[:, None] & inside, tensor, 0.0)


def deviator(tensor: NDArray, axes: Sequence[int]) -> NDArray:
    """Return X - tr(X) / D I, with trace, D and I those of some axes."""
    out = tensor.copy(order="K")
    mean = mean_normal(tensor, axes)
    for k in axes:
        out[..., k, k] -= mean
    return out


def stress_magnitude(tensor: NDArray) -> NDArray:
    """Return sqrt(X:X / 2)."""
    return np.sqrt(contraction(tensor) / 2)


def rate_magnitude(tensor: NDArray) -> NDArray:
    """Return sqrt(2 X:X), the shear rate in simple shear."""
    return np.sqrt(2 * contraction(tensor))


def contraction(tensor: NDArray) -> NDArray:
    """Return X:X over all components."""
    # term by term: the order in which numpy sums over axes depends on the number of nodes, and with it the last bit
    return sum((tensor[..., i, j] ** 2 for i in range(3) for j in range(3)), start=np.zeros(tensor.shape[:-2]))


def _times(a: NDArray, b: NDArray) -> NDArray:
    """Return a_ik b_kj, term by term: see `contraction`."""
    first, second, third = (a[..., :, k, None] * b[..., None, k, :] for k in range(3))
    return first + second + third


def _transposed(tensor: NDArray) -> NDArray:
    return np.swapaxes(tensor, -1, -2)


# --- velocity, its gradient, fluctuations ----------------------------------------------------------------


def _drift(f: Any, s: Any, o: Options) -> NDArray:
    """V - U: the velocity relative to the node's reference, NaN where there are no grains."""
    return ratio(s.momentum, s.mass)


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
    sums = np.concatenate([*(_inner(a).reshape(-1, *nodes) for a in rows), spread]).reshape(fit.SUMS, -1)
    way = trace_fit if sums.dtype == object else fit.fit_gradient
    found = way(sums, active=o.active, about_node=about_node).reshape(-1, *nodes)
    parts = np.split(found, (fit.EXPLAINED, fit.DETERMINED, fit.MEAN, fit.INVERSE))
    gradient, explained, determined, mean, inverse = parts
    return SimpleNamespace(
        gradient=_outer(gradient.reshape(3, 3, *nodes)), explained=_outer(explained[fit.SYMMETRIC]),
        determined=_outer(determined), mean=_outer(mean), inverse=_outer(inverse[fit.SYMMETRIC]),
    )  # fmt: skip


def _kernel_gradient(f: Any, s: Any, o: Options) -> NDArray:
    return ratio(s.momentum_slope - outer(f._drift, s.mass_slope), s.mass)


def _finite_difference(f: Any, s: Any, o: Options) -> NDArray:
    """Central differences of V between nodes, of second order also at the ends; NaN beside empty nodes.

    It needs all nodes at once, see `whole_grid`.
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
            slope[...] = (np.roll(along, -1, axis=0) - np.roll(along, 1, axis=0)) / (2 * o.spacing[k])
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
    # along directions that the grains do not span, the G of a fit is zero
    g = f._fit.gradient[:1] if least_squares else zero_if_unknown(f.velocity_gradient[:1])
    unknown = [f._fit.explained[:1, :, 0, 0]]
    if not least_squares:
        unknown += [f.velocity_gradient[:1, :, i, j] for i in range(3) for j in range(3)]
    zero = sum(x - x for x in unknown)  # or NaN
    # v'' = u - c - G x, and G x, G x x and u G x summed over the grains
    c = zero_if_unknown(f._drift[:1]) - _times(g, f._fit.mean[:1, ..., None])[..., 0]
    gx, gxx = _times(g, s.offset[..., None])[..., 0], _times(g, s.spread)
    ugx, gxgx = _times(s.shear, _transposed(g)), _times(gxx, _transposed(g))
    rest, out = gx - s.momentum, np.empty((3, 3, *s.mass.shape), s.mass.dtype)
    for i in range(3):
        for j in range(i, 3):
            total = s.kinetic[..., i, j] + s.mass * c[..., i] * c[..., j] + gxgx[..., i, j]
            total = total + c[..., i] * rest[..., j] - ugx[..., i, j] + c[..., j] * rest[..., i] - ugx[..., j, i]
            out[i, j] = out[j, i] = total + zero
    return _outer(out)


def _kinetic_stress(f: Any, s: Any, o: Options) -> NDArray:
    """Sum of m Psi (u - b)(u - b) = sum m Psi u u - b p - (p - b sum m Psi) b, with b the mean velocity of the bulk."""
    b, out = zero_if_unknown(f._drift[:1]), np.empty((3, 3, *s.mass.shape), s.mass.dtype)
    for i in range(3):
        rest = s.momentum[..., i] - b[..., i] * s.mass  # nothing but for phases
        for j in range(i, 3):
            total = s.kinetic[..., i, j] - b[..., i] * s.momentum[..., j]
            total -= rest * b[..., j]
            out[i, j], out[j, i] = total, total
    return _outer(out)


def _about(sums: tuple[NDArray, NDArray, NDArray], a: NDArray, b: NDArray) -> tuple[NDArray, NDArray]:
    """Return the sums of w (x - a) and of w (x - a)(x - b), from those of w, w x and w x x."""
    weight, first, second = sums
    moved = first - weight[..., None] * a
    return moved, second - outer(a, first) - outer(moved, b)


def _taken_by_mean(f: Any, s: Any, o: Options) -> NDArray:
    """Return the density whose fluctuations the mean velocity of the bulk takes, in each phase: see `_taken_by_fit`."""
    mass = where_positive(s.mass[:1])
    return zero_if_unknown(2 * s.square / mass - s.mass * s.square[:1] / (mass * mass))


def _taken_by_fit(f: Any, s: Any, o: Options) -> NDArray:
    """Return the density whose fluctuations the fit takes, in each phase.

    The fit gives grain i the velocity ``sum_j H_ij v_j`` with ``H_ij = w_j (1 / rho + y_i A x_j)``, w = m Psi, x and y
    relative to x_bar and to the point of the fit, A = M^+. Of independent fluctuations it takes, from the grains i of
    a phase, ``sum_i w_i (2 H_ii - sum_j H_ij^2)``: for the bulk ``tr(M^-1 sum w^2 phi phi)``, phi = (1, x).
    """
    point, inverse = f._fit.mean[:1], f._fit.inverse[:1]
    centre = zero_if_unknown(ratio(s.offset[:1], s.mass[:1]))
    squares = s.square, s.square_offset, s.square_spread
    shift, bulk = _about(tuple(a[:1] for a in squares), centre, centre)
    if len(s.mass) == 1:
        return _taken_by_mean(f, s, o) + _double(inverse, bulk)
    _, own = _about(squares, centre, point)
    first, second = _about((s.mass, s.offset, s.spread), point, point)
    across = _times(inverse, shift[..., None])[..., 0]
    mean = zero_if_unknown(2 * _dot(across, first) / where_positive(s.mass[:1]))
    shared = _double(_times(_times(inverse, bulk), inverse), second)
    return _taken_by_mean(f, s, o) + (2 * _double(inverse, own) - mean - shared)


def _dot(a: NDArray, b: NDArray) -> NDArray:
    return sum((a[..., k] * b[..., k] for k in range(3)), start=np.zeros(b.shape[:-1]))


def _double(a: NDArray, b: NDArray) -> NDArray:
    """Return a_ij b_ij, term by term: see `contraction`."""
    return sum((a[..., i, j] * b[..., i, j] for i in range(3) for j in range(3)), start=np.zeros(b.shape[:-2]))


def _fluctuation_density(f: Any, s: Any, o: Options) -> NDArray:
    return at_least_zero(s.mass - f._taken)


def _free(f: Any, s: Any, o: Options) -> NDArray:
    """Return the density that a temperature divides by, NaN where it is less than half of that of a mean grain."""
    enough = where_positive(f.fluctuation_density - 0.5 * ratio(s.mass, s.count))
    return f.fluctuation_density + (enough - enough)


def _temperature(f: Any, s: Any, o: Options) -> NDArray:
    return ratio(at_least_zero(trace(f.fluctuation_stress, o.plane)), o.dimension * f._free)


def _temperature_along(f: Any, s: Any, o: Options) -> NDArray:
    return ratio(at_least_zero(np.diagonal(f.fluctuation_stress, axis1=-2, axis2=-1)), f._free)


def _shear_rate(f: Any, s: Any, o: Options) -> NDArray:
    rate = restricted(f.shear_rate_tensor, o.shear_axes)
    return rate_magnitude(deviator(rate, o.shear_axes or o.plane) if o.deviatoric in ("rate", "both") else rate)


# --- rheology --------------------------------------------------------------------------------------------


def _shear_stress(f: Any, s: Any, o: Options) -> NDArray:
    whole = o.deviatoric not in ("stress", "both")
    return stress_magnitude(restricted(f.stress, o.shear_axes) if whole else f.deviatoric_stress)


def _inertial_number(f: Any, s: Any, o: Options) -> NDArray:
    root = np.sqrt(where_positive(f.pressure))
    return f.shear_rate * f._size * np.sqrt(f.particle_density) / root


def _viscous_number(f: Any, s: Any, o: Options) -> NDArray:
    return ratio(o.fluid_viscosity * f.shear_rate, f.pressure)


_STRESS = (-1, 1, -2)
_NONE = (0, 0, 0)
_LINEAR = ("count", "mass", "momentum", "offset", "shear", "spread")
_SQUARES = ("square", "square_offset", "square_spread")

_ROWS: dict[str, Field] = {
    "sample_count": Field(
        0, _NONE, "number of particles that reach the node", "sum_i [Psi_i > 0]",
        lambda f, s, o: s.count, moments=("count",), additive=True,
    ),
    "volume_fraction": Field(
        0, _NONE, "volume fraction", "phi = sum V_i Psi", lambda f, s, o: s.volume, moments=("volume",), additive=True
    ),
    "density": Field(
        0, (-3, 1, 0), "mass density of the mixture", "rho = sum m_i Psi",
        lambda f, s, o: s.mass, moments=("mass",), additive=True,
    ),
    "particle_density": Field(
        0, (-3, 1, 0), "density of the particles' material", "rho_p = rho / phi",
        lambda f, s, o: ratio(f.density, f.volume_fraction), fields=("density", "volume_fraction"),
        weight="volume_fraction",
    ),
    "number_density": Field(
        0, (-3, 0, 0), "number density", "n = sum Psi", lambda f, s, o: s.number, moments=("number",), additive=True
    ),
    "momentum_density": Field(
        1, (-2, 1, -1), "momentum density", "p = sum m_i v_i Psi",
        lambda f, s, o: s.momentum + s.mass[..., None] * s.reference, moments=("mass", "momentum"), additive=True,
    ),
    "velocity": Field(
        1, (1, 0, -1), "velocity", "V = p / rho",
        lambda f, s, o: f._drift + s.reference, fields=("_drift",), moments=("mass", "momentum"), weight="density",
    ),
    "velocity_gradient": Field(
        2, (0, 0, -1), "velocity gradient, dV_component / dx_direction",
        "G = [sum m Psi (v_i - V)(r_i - r_bar)] M^-1, M = sum m Psi (r_i - r_bar)(r_i - r_bar)",
        lambda f, s, o: f._fit.gradient * f._fit.determined[..., None, :], fields=("_fit",), weight="density",
    ),
    "shear_rate_tensor": Field(
        2, (0, 0, -1), "shear rate tensor", "Gamma = (G + G^T) / 2",
        lambda f, s, o: (f.velocity_gradient + _transposed(f.velocity_gradient)) / 2, fields=("velocity_gradient",),
        weight="density",
    ),
    "shear_rate": Field(
        0, (0, 0, -1), "shear rate", "|Gamma| = sqrt(2 Gamma:Gamma)", _shear_rate, fields=("shear_rate_tensor",)
    ),
    "kinetic_stress": Field(
        2, _STRESS, "kinetic stress", "sigma^k = sum m_i (v_i - V)(v_i - V) Psi",
        _kinetic_stress, fields=("_drift",), moments=("mass", "momentum", "kinetic"), additive=True,
    ),
    "contact_stress": Field(
        2, _STRESS, "contact stress", "sigma^c = sum_c f_ij a_ij int_0^1 Psi(r - r_i + s a_ij) ds, both sides",
        lambda f, s, o: s.contact, moments=("contact",), additive=True,
    ),
    "contact_stress_by_pair": Field(
        2, _STRESS, "contact stress of each phase from contacts with another, or with walls",
        "sigma^c of the phase's sides of its contacts with grains of other_phase",
        lambda f, s, o: s.pair_contact, moments=("pair_contact",), additive=True, option="by_pair", paired=True,
    ),
    "stress": Field(
        2, _STRESS, "stress, compression positive", "sigma = sigma^c + sigma^k",
        lambda f, s, o: f.contact_stress + f.kinetic_stress, fields=("contact_stress", "kinetic_stress"), additive=True,
    ),
    "pressure": Field(
        0, _STRESS, "pressure", "p = tr(sigma) / D",
        lambda f, s, o: mean_normal(f.stress, o.pressure_axes or o.plane), fields=("stress",), additive=True,
    ),
    "deviatoric_stress": Field(
        2, _STRESS, "deviatoric stress", "dev sigma = sigma - tr(sigma) / D I",
        lambda f, s, o: deviator(restricted(f.stress, o.shear_axes), o.shear_axes or o.plane),
        fields=("stress",), additive=True,
    ),
    "shear_stress": Field(
        0, _STRESS, "magnitude of the deviatoric stress", "|dev sigma| = sqrt(dev sigma : dev sigma / 2)",
        _shear_stress, fields=("stress", "deviatoric_stress"),
    ),
    "fluctuation_stress": Field(
        2, _STRESS, "kinetic stress about the velocity at the particles",
        "sum m_i v'_i v'_i Psi, v'_i = v_i - V - G (r_i - r_bar)",
        _fluctuation_stress, fields=("_fit", "_drift", "velocity_gradient", "kinetic_stress"),
        moments=(*_LINEAR, "kinetic"), additive=True,
    ),
    "fluctuation_density": Field(
        0, (-3, 1, 0), "density of what fluctuates: that of the mixture less what V and G take",
        "rho_T = rho - tr(P^-1 sum (m_i Psi)^2 p_i p_i), P = sum m_i Psi p_i p_i, p_i = (1, r_i - r_bar)",
        _fluctuation_density, fields=("_taken",), moments=("mass",), additive=True,
    ),
    "granular_temperature": Field(
        0, (2, 0, -2), "granular temperature", "T = tr(sum m_i v'_i v'_i Psi) / (D rho_T)",
        _temperature, fields=("fluctuation_stress", "_free"), weight="fluctuation_density",
    ),
    "directional_temperature": Field(
        1, (2, 0, -2), "granular temperature of the fluctuations along each axis",
        "T_k = sum m_i v'_ik v'_ik Psi / rho_T", _temperature_along, fields=("fluctuation_stress", "_free"),
        weight="fluctuation_density",
    ),
    "effective_count": Field(
        0, _NONE, "effective number of particles, which errors of one step follow from",
        "N_eff = (sum m_i Psi)^2 / sum (m_i Psi)^2",
        lambda f, s, o: ratio(s.mass * s.mass, s.square), moments=("mass", "square"), weight="density",
    ),
    "fabric": Field(
        2, _NONE, "fabric", "F = sum V_i Psi sum_c n n", lambda f, s, o: s.fabric, moments=("fabric",), additive=True
    ),
    "coordination_number": Field(
        0, _NONE, "coordination number", "Z = sum z_i Psi / n",
        lambda f, s, o: ratio(s.partners, s.number), moments=("partners", "number"), weight="number_density",
    ),
    "d32": Field(
        0, (1, 0, 0), "surface-weighted mean diameter", "d32 = sum d_i^3 Psi / sum d_i^2 Psi",
        lambda f, s, o: ratio(s.size3, s.size2), moments=("size2", "size3"), weight="volume_fraction", harmonic=True,
    ),
    "d43": Field(
        0, (1, 0, 0), "volume-weighted mean diameter", "d43 = sum d_i^4 Psi / sum d_i^3 Psi",
        lambda f, s, o: ratio(s.size4, s.size3), moments=("size3", "size4"), weight="volume_fraction",
    ),
    "friction_coefficient": Field(
        0, _NONE, "friction coefficient", "mu = |dev sigma| / p, where p > 0",
        lambda f, s, o: ratio(f.shear_stress, f.pressure), fields=("shear_stress", "pressure"),
    ),
    "inertial_number": Field(
        0, _NONE, "inertial number", "I = |Gamma| d / sqrt(p / rho_p), d = d43 by default, where p > 0",
        _inertial_number, fields=("shear_rate", "pressure", "particle_density", "_size"),
    ),
    "viscous_number": Field(
        0, _NONE, "viscous number", "J = eta_f |Gamma| / p, where p > 0",
        _viscous_number, fields=("shear_rate", "pressure"), option="fluid_viscosity",
    ),
    "effective_viscosity": Field(
        0, _NONE, "effective viscosity relative to that of the fluid", "eta_s = mu / J = |dev sigma| / (eta_f |Gamma|)",
        lambda f, s, o: ratio(f.friction_coefficient, f.viscous_number),
        fields=("friction_coefficient", "viscous_number"), option="fluid_viscosity",
    ),
    "wall_traction": Field(
        1, (-2, 1, -2), "traction of walls on the grains", "t = sum_w f_iw Psi(r - c_iw)",
        lambda f, s, o: s.traction, moments=("traction",), additive=True,
    ),
    "contact_force_density": Field(
        1, (-2, 1, -2), "density of the contact forces on the grains", "sum_i Psi sum_c f_ij",
        lambda f, s, o: s.force, moments=("force",), additive=True,
    ),
    "contact_number_density": Field(
        0, (-3, 0, 0), "number density of contacts", "n_c = sum_c Psi(r - c)",
        lambda f, s, o: s.contacts, moments=("contacts",), additive=True, default=False,
    ),
    # steps of the algebra
    "_drift": Field(1, (1, 0, -1), "", "V - U", _drift, moments=("mass", "momentum"), listed=False),
    "_fit": Field(2, (0, 0, -1), "", "B M^+", _fit, fields=("_drift",), moments=_LINEAR, listed=False),
    "_taken": Field(
        0, (-3, 1, 0), "", "rho - rho_T", _taken_by_fit, fields=("_fit",), moments=(*_LINEAR, *_SQUARES), listed=False
    ),
    "_free": Field(
        0, (-3, 1, 0), "", "rho_T, where known", _free, fields=("fluctuation_density",), moments=("count", "mass"),
        listed=False,
    ),
    "_size": Field(0, (1, 0, 0), "", "d43", lambda f, s, o: f.d43, fields=("d43",), listed=False),
}  # fmt: skip
_REGISTERED: dict[str, Field] = {}  # by users, see `xcg.register_field`
# All rows by name, read-only.
FIELDS: Mapping[str, Field] = MappingProxyType(ChainMap(_REGISTERED, _ROWS))

FITS = ("least_squares", "paper")
DEVIATORIC = ("stress", "rate", "both", "neither")


def _size_of_scene(name: str) -> Field:
    return Field(0, (1, 0, 0), "", name, lambda f, s, o: np.asarray(o.diameter), listed=False)


# other ways to a field: the option that chooses, and the row for each of its values that is not the default
WAYS: dict[str, tuple[str, dict[str, Field]]] = {
    "velocity_gradient": ("gradient", {
        "kernel": replace(
            _ROWS["velocity_gradient"], formula="G = (grad p - V grad rho) / rho", compute=_kernel_gradient,
            fields=("_drift",), moments=("mass", "momentum", "mass_slope", "momentum_slope"),
        ),
        "finite_difference": replace(
            _ROWS["velocity_gradient"], formula="G = [V(r + h) - V(r - h)] / 2 h, h the spacing of the nodes",
            compute=_finite_difference, fields=("_drift",), moments=("mass", "momentum"),
        ),
        "paper": replace(
            _ROWS["velocity_gradient"],
            formula="G = [sum m Psi (v_i - V)(r_i - r)] M^-1, M = sum m Psi (r_i - r)(r_i - r)",
        ),
    }),
    "_fit": ("gradient", {
        "paper": replace(_ROWS["_fit"], compute=partial(_fit, about_node=True)),
    }),
    "fluctuation_stress": ("gradient", {
        "paper": replace(
            _ROWS["fluctuation_stress"], formula="sum m_i v'_i v'_i Psi, v'_i = v_i - V - G (r_i - r)"
        ),
    }),
    "_taken": ("gradient", dict.fromkeys(
        ("kernel", "finite_difference"),
        replace(_ROWS["_taken"], compute=_taken_by_mean, fields=(), moments=("mass", "square")),
    )),
    "fluctuation_density": ("temperature", {
        "biased": replace(
            _ROWS["fluctuation_density"], formula="rho_T = rho", compute=lambda f, s, o: s.mass, fields=()
        ),
    }),
    "_size": ("size", {
        "d32": replace(_ROWS["_size"], formula="d32", compute=lambda f, s, o: f.d32, fields=("d32",)),
        "d50": _size_of_scene("d50"),
        "dmax": _size_of_scene("dmax"),
    }),
}  # fmt: skip
GRADIENTS = ("least_squares", *WAYS["velocity_gradient"][1])
INERTIAL_SIZES = ("d43", *WAYS["_size"][1])
TEMPERATURES = ("unbiased", *WAYS["fluctuation_density"][1])


def row(name: str, options: Options) -> Field:
    """Return the row of a field, as computed with some options."""
    for own in options.own:
        if own.name == name:
            return own.row
    option, ways = WAYS.get(name, ("gradient", {}))
    return ways.get(getattr(options, option), FIELDS[name])


def whole_grid(options: Options) -> bool:
    """Tell whether the algebra needs all nodes at once, not block by block."""
    return options.gradient == "finite_difference"


def given_options(options: Options) -> dict[str, Any]:
    """Return the options that are set only if somebody gave them, as attributes of a result."""
    found: dict[str, Any] = {}
    if options.shear_axes is not None:
        found["shear_dims"] = "".join("xyz"[k] for k in options.shear_axes)
    if options.fluid_viscosity is not None:
        found["fluid_viscosity"] = options.fluid_viscosity
    if np.isfinite(options.diameter):
        found["size_diameter"] = options.diameter
    return found


def options_of(attrs: Mapping[Any, Any]) -> Options:
    """Return the choices that a result was computed with, from its attributes."""

    def axes(name: str) -> tuple[int, ...] | None:
        return tuple("xyz".index(a) for a in attrs[name]) if name in attrs else None

    viscosity = attrs.get("fluid_viscosity")
    return Options(
        plane=axes("plane") or (0, 1, 2),
        gradient=str(attrs.get("gradient", "least_squares")),
        pressure_axes=axes("pressure_dims"),
        shear_axes=axes("shear_dims"),
        deviatoric=str(attrs.get("deviatoric", "stress")),
        size=str(attrs.get("size", "d43")),
        temperature=str(attrs.get("temperature", "biased")),
        diameter=float(attrs.get("size_diameter", np.nan)),
        fluid_viscosity=None if viscosity is None else float(viscosity),
    )


def listed(*, registered: bool = True) -> list[str]:
    """Names of all fields that can be asked for, with or without those that users registered."""
    return [name for name, field in (FIELDS if registered else _ROWS).items() if field.listed]


@dataclass(frozen=True)
class Registered:
    """A field that a user registered, as `Options.own` holds it."""

    name: str
    row: Field
    moments: ClassVar[Mapping[str, Any]] = MappingProxyType({})


def add(name: str, field: Field) -> None:
    """Put the row of a user's field beside the others; in place of a former one of its name."""
    _REGISTERED[name] = field


def registered_for(fields: Iterable[str], options: Options) -> tuple[Registered, ...]:
    """Return what users registered of all that some fields need."""
    return tuple(Registered(name, _REGISTERED[name]) for name in order_of(fields, options) if name in _REGISTERED)


def order_of(fields: Iterable[str], options: Options) -> list[str]:
    """All rows needed for some fields, each after what it needs."""
    order: list[str] = []

    def visit(name: str) -> None:
        if name not in order:
            for needed in row(name, options).fields:
                visit(needed)
            order.append(name)

    for name in fields:
        visit(name)
    return order


def moments_of(fields: Iterable[str], options: Options) -> tuple[str, ...]:
    """All moments needed for some fields."""
    found = dict.fromkeys(s for name in order_of(fields, options) for s in row(name, options).moments)
    return tuple(found)


def evaluate(fields: Sequence[str], moments: Mapping[str, NDArray], options: Options) -> dict[str, NDArray]:
    """Compute fields from moments with NumPy; arrays (phase, node, ...)."""
    s, f = SimpleNamespace(**moments), SimpleNamespace()
    with np.errstate(all="ignore"):  # as the program: nodes without grains divide 0 by 0
        for name in order_of(fields, options):
            setattr(f, name, row(name, options).compute(f, s, options))
    return {name: getattr(f, name) for name in fields}
