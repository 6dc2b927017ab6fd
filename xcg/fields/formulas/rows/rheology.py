"""Stress in whole, pressure, and the numbers of rheology.

Sources: stress, Goldhirsch (2010), Granul. Matter 12, 239, and Weinhart et al. (2012), Granul. Matter
14, 289; of mixtures, Tunuguntla, Thornton & Weinhart (2016), Comput. Part. Mech. 3, 349; averages of
contacts over regions of a shear cell, Lätzel, Luding & Herrmann (2000), Granul. Matter 2, 123;
fluctuations about the velocity at the grain, Artoni & Richard (2015), Phys. Rev. E 91, 032202, and
Ray & Khakhar (2023), Granul. Matter 25, 46. Pressure, deviatoric and shear stress, friction
coefficient: Jop, Forterre & Pouliquen (2006), Nature 441, 727. Inertial number: GDR MiDi (2004),
Eur. Phys. J. E 14, 341, and da Cruz et al. (2005), Phys. Rev. E 72, 021309. Fluidity: Kamrin & Koval
(2012), Phys. Rev. Lett. 108, 178301. Viscous number and relative viscosity: Boyer, Guazzelli &
Pouliquen (2011), Phys. Rev. Lett. 107, 188301. Granular viscosity: Jop et al. (2006). Normal stress
differences, and angles between the axes of stress, strain rate and fabric: Weinhart, Hartkamp,
Thornton & Luding (2013), Phys. Fluids 25, 070605. Lode angle: Lode (1926), Z. Physik 36, 913.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas import floors
from xcg.fields.formulas.algebra import (
    deviator,
    mean_normal,
    ratio,
    restricted,
    stress_magnitude,
    where_positive,
)
from xcg.fields.formulas.field import ABOUT_MEAN_VELOCITY, Field, Options


def _shear_stress(f: Any, s: Any, o: Options) -> NDArray:
    if o.deviatoric in ("stress", "both"):
        return stress_magnitude(f.deviatoric_stress)
    return stress_magnitude(restricted(f.stress, o.shear_axes))


def _normal_stress_difference(first: int, f: Any, s: Any, o: Options) -> NDArray:
    """Return sigma_gg - sigma_ff (first = 0) or sigma_vv - sigma_gg (1), NaN where an axis is missing.

    The flow f is along the first of `shear_axes`, its gradient g along the second, by default along
    the first and last axis of the scene; the vorticity v is along the third.
    """
    axes = o.shear_axes or (o.plane[0], o.plane[-1])
    if len(axes) != 2 or len(o.plane) < 2 + first:
        return np.nan * f.stress[..., 0, 0]
    order = (*axes, 3 - sum(axes))
    low, high = order[first], order[first + 1]
    return f.stress[..., high, high] - f.stress[..., low, low]


_TIE = 1e-9  # what is rounding of a difference of principal values, relative to the largest


def _principal(tensor: NDArray, axes: Sequence[int]) -> tuple[NDArray, NDArray]:
    """Return principal values (..., n) of the symmetric part, rising, and axes (..., n, n) in columns.

    Values are NaN where the tensor is unknown.
    """
    inside = tensor[..., axes, :][..., axes]
    inside = (inside + np.swapaxes(inside, -1, -2)) / 2
    finite = np.isfinite(inside).all(axis=(-2, -1))[..., None]
    values, vectors = np.linalg.eigh(np.where(finite[..., None], inside, 0.0))
    return np.where(finite, values, np.nan), vectors


def _lode_angle(f: Any, s: Any, o: Options) -> NDArray:
    if len(o.plane) < 3:
        return np.nan * f.stress[..., 0, 0]
    minor, middle, major = np.moveaxis(_principal(f.stress, o.plane)[0], -1, 0)
    is_shear = major - minor > _TIE * np.maximum(abs(major), abs(minor))
    angle = np.arctan2(np.sqrt(3) * (middle - minor), (major - middle) + (major - minor))
    return np.where(is_shear, angle, np.nan)


def _angle_of_major_axes(a: NDArray, b: NDArray, o: Options) -> NDArray:
    """Return the angle between the axes of the largest principal values of two tensors.

    It is within 0 and pi / 2, and NaN where a tensor has no major axis: its two largest values are equal.
    """
    axes = o.shear_axes or o.plane
    if len(axes) < 2:
        return np.nan * a[..., 0, 0]
    major, is_unique = [], []
    for tensor in (a, b):
        values, vectors = _principal(tensor, axes)
        major.append(vectors[..., -1])
        is_unique.append(values[..., -1] - values[..., -2] > _TIE * abs(values).max(axis=-1))
    cosine = (major[0] * major[1]).sum(axis=-1, keepdims=True)
    # arccos of the cosine would lose half of the digits of small angles
    sine = np.linalg.norm(major[0] - cosine * major[1], axis=-1)
    return np.where(is_unique[0] & is_unique[1], np.arctan2(sine, abs(cosine[..., 0])), np.nan)


def _inertial_number(f: Any, s: Any, o: Options) -> NDArray:
    root = np.sqrt(where_positive(f.pressure))
    return f.shear_rate * f._size * np.sqrt(f.particle_density) / root


ROWS: dict[str, Field] = {
    "stress": Field(
        rank=2,
        units="Pa",
        long_name="stress, compression positive",
        formula="sigma = sigma^c + sigma^k",
        references="Goldhirsch 2010; Weinhart et al. 2012",
        compute=lambda f, s, o: f.contact_stress + f.kinetic_stress,
        fields=("contact_stress", "kinetic_stress"),
        additive=True,
        averages=ABOUT_MEAN_VELOCITY,
    ),
    "pressure": Field(
        units="Pa",
        long_name="pressure",
        formula="p = tr(sigma) / D",
        references="Weinhart et al. 2012",
        compute=lambda f, s, o: mean_normal(f.stress, o.pressure_axes or o.plane),
        fields=("stress",),
        additive=True,
        averages=ABOUT_MEAN_VELOCITY,
    ),
    "deviatoric_stress": Field(
        rank=2,
        units="Pa",
        long_name="deviatoric stress",
        formula="dev sigma = sigma - tr(sigma) / D I",
        references="Jop et al. 2006",
        compute=lambda f, s, o: deviator(
            restricted(f.stress, o.shear_axes), o.shear_axes or o.plane
        ),
        fields=("stress",),
        additive=True,
        averages=ABOUT_MEAN_VELOCITY,
    ),
    "shear_stress": Field(
        units="Pa",
        long_name="magnitude of the deviatoric stress",
        formula="|dev sigma| = sqrt(dev sigma : dev sigma / 2)",
        references="Jop et al. 2006",
        compute=_shear_stress,
        fields=("stress", "deviatoric_stress"),
        is_norm=True,
    ),
    "first_normal_stress_difference": Field(
        units="Pa",
        long_name="first normal stress difference",
        formula="N1 = sigma_gg - sigma_ff, compression positive, flow f along the first of shear_dims and its "
        "gradient g along the second, by default the first and the last axis of the scene",
        references="Srivastava et al. 2021",
        compute=partial(_normal_stress_difference, 0),
        fields=("stress",),
        additive=True,
        default=False,
    ),
    "second_normal_stress_difference": Field(
        units="Pa",
        long_name="second normal stress difference",
        formula="N2 = sigma_vv - sigma_gg, compression positive, v normal to flow f and gradient g",
        references="Srivastava et al. 2021",
        compute=partial(_normal_stress_difference, 1),
        fields=("stress",),
        additive=True,
        default=False,
    ),
    "lode_angle": Field(
        long_name="Lode angle of the stress, in radians: 0 in triaxial compression, pi / 3 in extension",
        formula="tan theta_L = sqrt(3) (sigma_2 - sigma_3) / (2 sigma_1 - sigma_2 - sigma_3), principal stresses "
        "sigma_1 >= sigma_2 >= sigma_3, compression positive; NaN where they are equal, and in 2D",
        references="Lode 1926",
        compute=_lode_angle,
        fields=("stress",),
        floor=floors.lode_angle,
        usual=floors.USUAL_ANGLE,
        floor_units="rad",
        default=False,
        is_angle=True,
    ),
    "stress_strain_rate_angle": Field(
        long_name="angle between the axes of largest stress and of fastest compression, in radians",
        formula="angle of the major axes of sigma and -Gamma, at most a right one, in shear_dims if set; "
        "NaN without such axes",
        references="Lätzel et al. 2000",
        compute=lambda f, s, o: _angle_of_major_axes(f.stress, -f.shear_rate_tensor, o),
        fields=("stress", "shear_rate_tensor"),
        floor=floors.stress_strain_rate_angle,
        usual=floors.USUAL_ANGLE,
        floor_units="rad",
        default=False,
        is_angle=True,
    ),
    "stress_fabric_angle": Field(
        long_name="angle between the axes of largest stress and of most contacts, in radians",
        formula="angle of the major axes of sigma and <n n>, at most a right one, in shear_dims if set; "
        "NaN without such axes",
        references="Lätzel et al. 2000",
        compute=lambda f, s, o: _angle_of_major_axes(f.stress, f.contact_fabric, o),
        fields=("stress", "contact_fabric"),
        floor=floors.stress_fabric_angle,
        usual=floors.USUAL_ANGLE,
        floor_units="rad",
        default=False,
        is_angle=True,
    ),
    "friction_coefficient": Field(
        long_name="friction coefficient",
        formula="mu = |dev sigma| / p, where p > 0",
        references="Jop et al. 2006",
        compute=lambda f, s, o: ratio(f.shear_stress, f.pressure),
        fields=("shear_stress", "pressure"),
        floor=floors.friction,
        usual=floors.USUAL_FRICTION,
        is_norm=True,
    ),
    "inertial_number": Field(
        long_name="inertial number",
        formula="I = |dev Gamma| d / sqrt(p / rho_p), d = d43 by default, where p > 0",
        references="GDR MiDi 2004",
        compute=_inertial_number,
        fields=("shear_rate", "pressure", "particle_density", "_size"),
        floor=floors.inertial_number,
        usual=floors.USUAL_INERTIAL_NUMBER,
        is_norm=True,
    ),
    "fluidity": Field(
        units="s^-1",
        long_name="granular fluidity",
        formula="g = |dev Gamma| / mu, where p > 0",
        references="Kamrin & Koval 2012",
        compute=lambda f, s, o: ratio(f.shear_rate, f.friction_coefficient),
        fields=("shear_rate", "friction_coefficient"),
        default=False,
    ),
    "viscous_number": Field(
        long_name="viscous number",
        formula="J = eta_f |dev Gamma| / p, where p > 0",
        references="Boyer et al. 2011",
        compute=lambda f, s, o: ratio(o.fluid_viscosity * f.shear_rate, f.pressure),
        fields=("shear_rate", "pressure"),
        option="fluid_viscosity",
        is_norm=True,
    ),
    "relative_viscosity": Field(
        long_name="viscosity of the grains alone relative to that of the fluid",
        formula="eta_s = mu / J = |dev sigma| / (eta_f |dev Gamma|)",
        references="Boyer et al. 2011",
        compute=lambda f, s, o: ratio(f.friction_coefficient, f.viscous_number),
        fields=("friction_coefficient", "viscous_number"),
        option="fluid_viscosity",
    ),
    "granular_viscosity": Field(
        units="Pa s",
        long_name="granular viscosity",
        formula="eta = |dev sigma| / |dev Gamma|",
        references="Jop et al. 2006",
        compute=lambda f, s, o: ratio(f.shear_stress, f.shear_rate),
        fields=("shear_stress", "shear_rate"),
        default=False,
    ),
    "_size": Field(units="m", formula="d43", compute=lambda f, s, o: f.d43, fields=("d43",)),
}


def _size_of_scene(name: str) -> Field:
    return Field(
        units="m",
        formula=name,
        compute=lambda f, s, o: np.asarray(o.diameter or np.nan),
    )


# other ways to a field, as in `xcg.fields.formulas.rows.flow`
WAYS: dict[str, tuple[str, dict[str, Field]]] = {
    "_size": (
        "size",
        {
            "d32": replace(
                ROWS["_size"], formula="d32", compute=lambda f, s, o: f.d32, fields=("d32",)
            ),
            "d50": _size_of_scene("d50"),
            "dmax": _size_of_scene("dmax"),
        },
    ),
}
