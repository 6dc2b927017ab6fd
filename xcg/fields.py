"""The registry of fields: one row each, with its dimensions, units, formula, the sums it needs, and the algebra.

A row's function takes ``f`` (the fields it needs), ``s`` (the sums it needs, see `xcg.moments`) and ``o``
(`Options`). All arrays are (phase, x, y, z, ...), with phase 0 the bulk; fluctuations of every phase are about the
velocity of the bulk, so that partial fields add up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.kernels.fit import fit_gradient

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
    gradient : str
        "least_squares" or "kernel".
    """

    plane: tuple[int, ...] = (0, 1, 2)
    active: tuple[bool, bool, bool] = (True, True, True)
    gradient: str = "least_squares"

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
    fields, sums : tuple of str
        What it needs.
    additive : bool
        Whether the partial fields of the phases add up to the bulk.
    listed : bool
        False for steps of the algebra that are not fields of their own.
    """

    rank: int
    powers: tuple[int, int, int]
    long_name: str
    formula: str
    compute: Function
    fields: tuple[str, ...] = ()
    sums: tuple[str, ...] = ()
    additive: bool = False
    listed: bool = True


# --- small algebra ---------------------------------------------------------------------------------------


def ratio(a: NDArray, b: NDArray) -> NDArray:
    """Return a / b with NaN where b is not positive; b lacks the last axes of a."""
    b = b.reshape(b.shape + (1,) * (a.ndim - b.ndim))
    shape = np.broadcast_shapes(a.shape, b.shape)
    return np.divide(a, b, out=np.full(shape, np.nan), where=np.broadcast_to(b, shape) > 0)


def outer(a: NDArray, b: NDArray) -> NDArray:
    """Return a_i b_j."""
    return a[..., :, None] * b[..., None, :]


def trace(tensor: NDArray, o: Options) -> NDArray:
    """Trace over the axes of the scene."""
    return sum((tensor[..., k, k] for k in o.plane), start=np.zeros(tensor.shape[:-2]))


def deviator(tensor: NDArray, o: Options) -> NDArray:
    """Return X - tr(X) / D I, with I the identity of the scene's axes."""
    out = tensor.copy()
    mean = trace(tensor, o) / o.dimension
    for k in o.plane:
        out[..., k, k] -= mean
    return out


def contraction(tensor: NDArray) -> NDArray:
    """Return X:X over all components."""
    return np.einsum("...ij,...ij->...", tensor, tensor)


def _transposed(tensor: NDArray) -> NDArray:
    return np.swapaxes(tensor, -1, -2)


# --- velocity, its gradient, fluctuations ----------------------------------------------------------------


def _drift(f: Any, s: Any, o: Options) -> NDArray:
    """V - U: the velocity relative to the node's reference, NaN where there are no grains."""
    return ratio(s.momentum, s.mass)


def _fit(f: Any, s: Any, o: Options) -> SimpleNamespace:
    """Least squares through the grains about their centre of mass: G = B M^+."""
    mean = ratio(s.offset, s.mass)
    shear = s.shear - outer(f._drift, s.offset)
    spread = s.spread - outer(mean, s.offset)
    nodes = int(np.prod(s.mass.shape))
    # centring one grain, or several in one place, leaves the rounding of what is subtracted, a few 1e-16
    rounding = 1e-13 * np.einsum("...kk->...", s.spread)
    upper = np.stack([spread[..., i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))], axis=-1)
    gradient, determined, rank = np.zeros((nodes, 3, 3)), np.zeros((nodes, 3), bool), np.zeros(nodes, "int64")
    fit_gradient(
        np.nan_to_num(shear, nan=0.0).reshape(nodes, 3, 3), np.nan_to_num(upper, nan=0.0).reshape(nodes, 6),
        rounding.reshape(nodes), np.asarray(o.active), gradient, determined, rank,
    )  # fmt: skip
    shape = s.mass.shape
    determined = determined.reshape(*shape, 1, 3) & (s.mass > 0)[..., None, None]
    return SimpleNamespace(
        gradient=gradient.reshape(*shape, 3, 3), determined=determined, rank=rank.reshape(shape), mean=mean
    )


def _kernel_gradient(f: Any, s: Any, o: Options) -> NDArray:
    return ratio(s.momentum_slope - outer(f._drift, s.mass_slope), s.mass)


def _fluctuation_stress(f: Any, s: Any, o: Options) -> NDArray:
    """Sum of m Psi v'' v'' with v'' = u - b - G x, all about the bulk: expanded in the moments of each phase."""
    least_squares = o.gradient == "least_squares"  # along directions that the grains do not span, its G is zero
    g = (f._fit.gradient if least_squares else np.nan_to_num(f.velocity_gradient, nan=0.0))[:1]
    mean = np.nan_to_num(f._fit.mean[:1], nan=0.0)
    b = np.nan_to_num(f._drift[:1], nan=0.0) - np.einsum("...ij,...j->...i", g, mean)
    gx = np.einsum("...ij,...j->...i", g, s.offset)
    mixed = outer(b, gx - s.momentum) - np.einsum("...ik,...jk->...ij", s.shear, g)
    total = s.kinetic + s.mass[..., None, None] * outer(b, b) + mixed + _transposed(mixed)
    total += np.einsum("...ik,...kl,...jl->...ij", g, s.spread, g)
    # a fit through rank + 1 grains leaves nothing over: their fluctuation is unknown, not zero
    unknown = s.count[:1] <= f._fit.rank[:1] + 1
    return np.where(unknown[..., None, None], np.nan, total)


def _kinetic_stress(f: Any, s: Any, o: Options) -> NDArray:
    b = np.nan_to_num(f._drift[:1], nan=0.0)
    mixed = outer(b, s.momentum)
    return s.kinetic + s.mass[..., None, None] * outer(b, b) - mixed - _transposed(mixed)


def _temperature(f: Any, s: Any, o: Options) -> NDArray:
    return ratio(np.maximum(trace(f.fluctuation_stress, o), 0.0), o.dimension * s.mass)


def _shear_rate(f: Any, s: Any, o: Options) -> NDArray:
    return np.sqrt(2 * contraction(f.shear_rate_tensor))


# --- rheology --------------------------------------------------------------------------------------------


def _inertial_number(f: Any, s: Any, o: Options) -> NDArray:
    root = np.sqrt(np.where(f.pressure > 0, f.pressure, np.nan))
    return f.shear_rate * f.d43 * np.sqrt(f.particle_density) / root


_STRESS = (-1, 1, -2)
_NONE = (0, 0, 0)
_LINEAR = ("count", "mass", "momentum", "offset", "shear", "spread")

FIELDS: dict[str, Field] = {
    "sample_count": Field(
        0, _NONE, "number of particles that reach the node", "sum_i [Psi_i > 0]",
        lambda f, s, o: s.count, sums=("count",), additive=True,
    ),
    "volume_fraction": Field(
        0, _NONE, "volume fraction", "phi = sum V_i Psi", lambda f, s, o: s.volume, sums=("volume",), additive=True
    ),
    "density": Field(
        0, (-3, 1, 0), "mass density of the mixture", "rho = sum m_i Psi",
        lambda f, s, o: s.mass, sums=("mass",), additive=True,
    ),
    "particle_density": Field(
        0, (-3, 1, 0), "density of the particles' material", "rho_p = rho / phi",
        lambda f, s, o: ratio(f.density, f.volume_fraction), fields=("density", "volume_fraction"),
    ),
    "number_density": Field(
        0, (-3, 0, 0), "number density", "n = sum Psi", lambda f, s, o: s.number, sums=("number",), additive=True
    ),
    "momentum_density": Field(
        1, (-2, 1, -1), "momentum density", "p = sum m_i v_i Psi",
        lambda f, s, o: s.momentum + s.mass[..., None] * s.reference, sums=("mass", "momentum"), additive=True,
    ),
    "velocity": Field(
        1, (1, 0, -1), "velocity", "V = p / rho",
        lambda f, s, o: f._drift + s.reference, fields=("_drift",), sums=("mass", "momentum"),
    ),
    "velocity_gradient": Field(
        2, (0, 0, -1), "velocity gradient, dV_component / dx_direction",
        "G = [sum m Psi (v_i - V)(r_i - r_bar)] M^-1, M = sum m Psi (r_i - r_bar)(r_i - r_bar)",
        lambda f, s, o: np.where(f._fit.determined, f._fit.gradient, np.nan), fields=("_fit",),
    ),
    "shear_rate_tensor": Field(
        2, (0, 0, -1), "shear rate tensor", "Gamma = (G + G^T) / 2",
        lambda f, s, o: (f.velocity_gradient + _transposed(f.velocity_gradient)) / 2, fields=("velocity_gradient",),
    ),
    "shear_rate": Field(
        0, (0, 0, -1), "shear rate", "|Gamma| = sqrt(2 Gamma:Gamma)", _shear_rate, fields=("shear_rate_tensor",)
    ),
    "kinetic_stress": Field(
        2, _STRESS, "kinetic stress", "sigma^k = sum m_i (v_i - V)(v_i - V) Psi",
        _kinetic_stress, fields=("_drift",), sums=("mass", "momentum", "kinetic"), additive=True,
    ),
    "contact_stress": Field(
        2, _STRESS, "contact stress", "sigma^c = sum_c f_ij a_ij int_0^1 Psi(r - r_i + s a_ij) ds, both sides",
        lambda f, s, o: s.contact, sums=("contact",), additive=True,
    ),
    "stress": Field(
        2, _STRESS, "stress, compression positive", "sigma = sigma^c + sigma^k",
        lambda f, s, o: f.contact_stress + f.kinetic_stress, fields=("contact_stress", "kinetic_stress"), additive=True,
    ),
    "pressure": Field(
        0, _STRESS, "pressure", "p = tr(sigma) / D",
        lambda f, s, o: trace(f.stress, o) / o.dimension, fields=("stress",), additive=True,
    ),
    "deviatoric_stress": Field(
        2, _STRESS, "deviatoric stress", "dev sigma = sigma - p I",
        lambda f, s, o: deviator(f.stress, o), fields=("stress",), additive=True,
    ),
    "shear_stress": Field(
        0, _STRESS, "magnitude of the deviatoric stress", "|dev sigma| = sqrt(dev sigma : dev sigma / 2)",
        lambda f, s, o: np.sqrt(contraction(f.deviatoric_stress) / 2), fields=("deviatoric_stress",),
    ),
    "fluctuation_stress": Field(
        2, _STRESS, "kinetic stress about the velocity at the particles",
        "sum m_i v'_i v'_i Psi, v'_i = v_i - V - G (r_i - r_bar)",
        _fluctuation_stress, fields=("_fit", "_drift", "velocity_gradient"), sums=(*_LINEAR, "kinetic"), additive=True,
    ),
    "granular_temperature": Field(
        0, (2, 0, -2), "granular temperature", "T = tr(sum m_i v'_i v'_i Psi) / (D rho)",
        _temperature, fields=("fluctuation_stress",), sums=("mass",),
    ),
    "fabric": Field(
        2, _NONE, "fabric", "F = sum V_i Psi sum_c n n", lambda f, s, o: s.fabric, sums=("fabric",), additive=True
    ),
    "coordination_number": Field(
        0, _NONE, "coordination number", "Z = sum z_i Psi / n",
        lambda f, s, o: ratio(s.partners, s.number), sums=("partners", "number"),
    ),
    "d32": Field(
        0, (1, 0, 0), "surface-weighted mean diameter", "d32 = sum d_i^3 Psi / sum d_i^2 Psi",
        lambda f, s, o: ratio(s.size3, s.size2), sums=("size2", "size3"),
    ),
    "d43": Field(
        0, (1, 0, 0), "volume-weighted mean diameter", "d43 = sum d_i^4 Psi / sum d_i^3 Psi",
        lambda f, s, o: ratio(s.size4, s.size3), sums=("size3", "size4"),
    ),
    "friction_coefficient": Field(
        0, _NONE, "friction coefficient", "mu = |dev sigma| / p, where p > 0",
        lambda f, s, o: ratio(f.shear_stress, f.pressure), fields=("shear_stress", "pressure"),
    ),
    "inertial_number": Field(
        0, _NONE, "inertial number", "I = |Gamma| d43 / sqrt(p / rho_p), where p > 0",
        _inertial_number, fields=("shear_rate", "pressure", "particle_density", "d43"),
    ),
    "wall_traction": Field(
        1, (-2, 1, -2), "traction of walls on the grains", "t = sum_w f_iw Psi(r - c_iw)",
        lambda f, s, o: s.traction, sums=("traction",), additive=True,
    ),
    "contact_force_density": Field(
        1, (-2, 1, -2), "density of the contact forces on the grains", "sum_i Psi sum_c f_ij",
        lambda f, s, o: s.force, sums=("force",), additive=True,
    ),
    # steps of the algebra
    "_drift": Field(1, (1, 0, -1), "", "V - U", _drift, sums=("mass", "momentum"), listed=False),
    "_fit": Field(2, (0, 0, -1), "", "B M^+", _fit, fields=("_drift",), sums=_LINEAR, listed=False),
}  # fmt: skip

# other ways to a field, by option
KERNEL_GRADIENT = Field(
    2, (0, 0, -1), "velocity gradient, dV_component / dx_direction", "G = (grad p - V grad rho) / rho",
    _kernel_gradient, fields=("_drift",), sums=("mass", "momentum", "mass_slope", "momentum_slope"),
)  # fmt: skip
GRADIENTS = {"least_squares": FIELDS["velocity_gradient"], "kernel": KERNEL_GRADIENT}


def row(name: str, gradient: str) -> Field:
    """Return the row of a field, as computed with a way to the velocity gradient."""
    return GRADIENTS[gradient] if name == "velocity_gradient" else FIELDS[name]


def listed() -> list[str]:
    """Names of all fields that can be asked for."""
    return [name for name, field in FIELDS.items() if field.listed]


def order_of(fields: Iterable[str], gradient: str) -> list[str]:
    """All rows needed for some fields, each after what it needs."""
    order: list[str] = []

    def visit(name: str) -> None:
        if name not in order:
            for needed in row(name, gradient).fields:
                visit(needed)
            order.append(name)

    for name in fields:
        visit(name)
    return order


def sums_of(fields: Iterable[str], gradient: str) -> tuple[str, ...]:
    """All sums needed for some fields."""
    found = dict.fromkeys(s for name in order_of(fields, gradient) for s in row(name, gradient).sums)
    return tuple(found)


def evaluate(fields: Sequence[str], sums: Mapping[str, NDArray], options: Options) -> dict[str, NDArray]:
    """Compute fields from sums; arrays (phase, x, y, z, ...)."""
    s, f = SimpleNamespace(**sums), SimpleNamespace()
    for name in order_of(fields, options.gradient):
        setattr(f, name, row(name, options.gradient).compute(f, s, options))
    return {name: getattr(f, name) for name in fields}
