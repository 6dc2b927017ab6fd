"""Density, volume fraction and sizes of grains."""

from __future__ import annotations

from xcg.fields.formulas.algebra import mean_of
from xcg.fields.formulas.field import Field

ROWS: dict[str, Field] = {
    "sample_count": Field(
        long_name="number of particles that reach the node", formula="sum_i [Psi_i > 0]",
        compute=lambda f, s, o: s.count, moments=("count",), additive=True,
    ),
    "volume_fraction": Field(
        long_name="volume fraction", formula="phi = sum V_i Psi", compute=lambda f, s, o: s.volume, moments=("volume",),
        additive=True,
    ),
    "void_fraction": Field(
        long_name="void fraction", formula="epsilon = 1 - phi", compute=lambda f, s, o: 1.0 - f.volume_fraction,
        fields=("volume_fraction",), default=False,
    ),
    "density": Field(
        units="kg m^-3", long_name="mass density of the mixture", formula="rho = sum m_i Psi",
        compute=lambda f, s, o: s.mass, moments=("mass",), additive=True,
    ),
    "particle_density": Field(
        units="kg m^-3", long_name="density of the particles' material", formula="rho_p = rho / phi",
        compute=lambda f, s, o: mean_of(f.density, f.volume_fraction), fields=("density", "volume_fraction"),
        weight="volume_fraction",
    ),
    "centre_offset": Field(
        rank=1, units="m", long_name="centre of mass of the grains at the node, from the node",
        formula="r_bar - r = sum m_i (r_i - r) Psi / rho", compute=lambda f, s, o: mean_of(s.offset, s.mass),
        moments=("offset", "mass"), weight="density", default=False,
    ),
    "number_density": Field(
        units="m^-3", long_name="number density", formula="n = sum Psi", compute=lambda f, s, o: s.number,
        moments=("number",), additive=True,
    ),
    "d32": Field(
        units="m", long_name="surface-weighted mean diameter", formula="d32 = sum d_i^3 Psi / sum d_i^2 Psi",
        compute=lambda f, s, o: mean_of(s.size3, s.size2), moments=("size2", "size3"), weight="volume_fraction",
        harmonic=True,
    ),
    "d43": Field(
        units="m", long_name="volume-weighted mean diameter", formula="d43 = sum d_i^4 Psi / sum d_i^3 Psi",
        compute=lambda f, s, o: mean_of(s.size4, s.size3), moments=("size3", "size4"), weight="volume_fraction",
    ),
}  # fmt: skip
