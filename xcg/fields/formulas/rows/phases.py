"""Phases on each other: forces between them, how they part, and how much of each there is.

Sources: Weinhart, Luding & Thornton (2013), AIP Conf. Proc. 1542; Gray & Thornton (2005), Proc. R. Soc. A 461.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xcg.fields.formulas.algebra import mean_of, zero_if_unknown
from xcg.fields.formulas.field import Field, Options


def _segregation_flux(f: Any, s: Any, o: Options) -> NDArray:
    """Return p_a - rho_a V with both velocities relative to the node's reference."""
    return s.momentum - s.mass[..., None] * zero_if_unknown(f._drift[:1])


ROWS: dict[str, Field] = {
    "interphase_force": Field(
        rank=1, units="Pa m^-1", long_name="density of the contact forces of another phase, or of walls, on each phase",
        formula="sum_c f_ij Psi(r - c), i in the phase and j in other_phase", compute=lambda f, s, o: s.pair_force,
        moments=("pair_force",), additive=True, default=False, option="by", paired=True,
    ),
    "segregation_flux": Field(
        rank=1, units="kg m^-2 s^-1", long_name="flux of a phase's mass relative to the bulk",
        formula="rho_a (V_a - V)", compute=_segregation_flux, fields=("_drift",), moments=("mass", "momentum"),
        additive=True, default=False, option="by",
    ),
    "concentration": Field(
        long_name="share of a phase in the volume of the grains", formula="c_a = phi_a / phi",
        compute=lambda f, s, o: mean_of(f.volume_fraction, f.volume_fraction[:1]), fields=("volume_fraction",),
        weight="volume_fraction", by_bulk=True, default=False, option="by",
    ),
}  # fmt: skip
