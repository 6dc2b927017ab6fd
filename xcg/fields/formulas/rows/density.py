"""Density, volume fraction and sizes of grains."""

from __future__ import annotations

from xcg.fields.formulas.algebra import mean_of
from xcg.fields.formulas.field import NONE, Field

ROWS: dict[str, Field] = {
    "sample_count": Field(
        0, NONE, "number of particles that reach the node", "sum_i [Psi_i > 0]",
        lambda f, s, o: s.count, moments=("count",), additive=True,
    ),
    "volume_fraction": Field(
        0, NONE, "volume fraction", "phi = sum V_i Psi", lambda f, s, o: s.volume, moments=("volume",), additive=True
    ),
    "void_fraction": Field(
        0, NONE, "void fraction", "epsilon = 1 - phi",
        lambda f, s, o: 1.0 - f.volume_fraction, fields=("volume_fraction",), default=False,
    ),
    "density": Field(
        0, (-3, 1, 0), "mass density of the mixture", "rho = sum m_i Psi",
        lambda f, s, o: s.mass, moments=("mass",), additive=True,
    ),
    "particle_density": Field(
        0, (-3, 1, 0), "density of the particles' material", "rho_p = rho / phi",
        lambda f, s, o: mean_of(f.density, f.volume_fraction), fields=("density", "volume_fraction"),
        weight="volume_fraction",
    ),
    "centre_offset": Field(
        1, (1, 0, 0), "centre of mass of the grains at the node, from the node",
        "r_bar - r = sum m_i (r_i - r) Psi / rho",
        lambda f, s, o: mean_of(s.offset, s.mass), moments=("offset", "mass"), weight="density", default=False,
    ),
    "number_density": Field(
        0, (-3, 0, 0), "number density", "n = sum Psi", lambda f, s, o: s.number, moments=("number",), additive=True
    ),
    "d32": Field(
        0, (1, 0, 0), "surface-weighted mean diameter", "d32 = sum d_i^3 Psi / sum d_i^2 Psi",
        lambda f, s, o: mean_of(s.size3, s.size2), moments=("size2", "size3"), weight="volume_fraction", harmonic=True,
    ),
    "d43": Field(
        0, (1, 0, 0), "volume-weighted mean diameter", "d43 = sum d_i^4 Psi / sum d_i^3 Psi",
        lambda f, s, o: mean_of(s.size4, s.size3), moments=("size3", "size4"), weight="volume_fraction",
    ),
}  # fmt: skip
