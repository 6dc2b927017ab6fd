"""Stress in whole, pressure, and the numbers of rheology."""

from __future__ import annotations

from dataclasses import replace
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


def _inertial_number(f: Any, s: Any, o: Options) -> NDArray:
    root = np.sqrt(where_positive(f.pressure))
    return f.shear_rate * f._size * np.sqrt(f.particle_density) / root


ROWS: dict[str, Field] = {
    "stress": Field(
        rank=2,
        units="Pa",
        long_name="stress, compression positive",
        formula="sigma = sigma^c + sigma^k",
        compute=lambda f, s, o: f.contact_stress + f.kinetic_stress,
        fields=("contact_stress", "kinetic_stress"),
        additive=True,
        averages=ABOUT_MEAN_VELOCITY,
    ),
    "pressure": Field(
        units="Pa",
        long_name="pressure",
        formula="p = tr(sigma) / D",
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
        compute=_shear_stress,
        fields=("stress", "deviatoric_stress"),
    ),
    "friction_coefficient": Field(
        long_name="friction coefficient",
        formula="mu = |dev sigma| / p, where p > 0",
        compute=lambda f, s, o: ratio(f.shear_stress, f.pressure),
        fields=("shear_stress", "pressure"),
        floor=floors.friction,
        usual=0.3,
    ),
    "inertial_number": Field(
        long_name="inertial number",
        formula="I = |dev Gamma| d / sqrt(p / rho_p), d = d43 by default, where p > 0",
        compute=_inertial_number,
        fields=("shear_rate", "pressure", "particle_density", "_size"),
        floor=floors.inertial_number,
        usual=0.1,
    ),
    "fluidity": Field(
        units="s^-1",
        long_name="granular fluidity",
        formula="g = |dev Gamma| / mu, where p > 0",
        compute=lambda f, s, o: ratio(f.shear_rate, f.friction_coefficient),
        fields=("shear_rate", "friction_coefficient"),
        default=False,
    ),
    "viscous_number": Field(
        long_name="viscous number",
        formula="J = eta_f |dev Gamma| / p, where p > 0",
        compute=lambda f, s, o: ratio(o.fluid_viscosity * f.shear_rate, f.pressure),
        fields=("shear_rate", "pressure"),
        option="fluid_viscosity",
    ),
    "relative_viscosity": Field(
        long_name="viscosity of the grains alone relative to that of the fluid",
        formula="eta_s = mu / J = |dev sigma| / (eta_f |dev Gamma|)",
        compute=lambda f, s, o: ratio(f.friction_coefficient, f.viscous_number),
        fields=("friction_coefficient", "viscous_number"),
        option="fluid_viscosity",
    ),
    "granular_viscosity": Field(
        units="Pa s",
        long_name="granular viscosity",
        formula="eta = |dev sigma| / |dev Gamma|",
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
