"""What contacts give: stress, traction of walls, fabric."""

from __future__ import annotations

from xcg.fields.formulas.algebra import mean_of
from xcg.fields.formulas.field import Field

ROWS: dict[str, Field] = {
    "contact_stress": Field(
        rank=2, units="Pa", long_name="contact stress",
        formula="sigma^c = sum_c f_ij a_ij int_0^1 Psi(r - r_i + s a_ij) ds, both sides",
        compute=lambda f, s, o: s.contact, moments=("contact",), additive=True,
    ),
    "contact_stress_by_pair": Field(
        rank=2, units="Pa", long_name="contact stress of each phase from contacts with another, or with walls",
        formula="sigma^c of the phase's sides of its contacts with grains of other_phase",
        compute=lambda f, s, o: s.pair_contact, moments=("pair_contact",), additive=True, default=False, option="by",
        paired=True,
    ),
    "wall_traction": Field(
        rank=1, units="Pa m^-1", long_name="traction of walls on the grains", formula="t = sum_w f_iw Psi(r - c_iw)",
        compute=lambda f, s, o: s.traction, moments=("traction",), additive=True,
    ),
    "contact_force_density": Field(
        rank=1, units="Pa m^-1", long_name="density of the contact forces on the grains",
        formula="sum_i Psi sum_c f_ij", compute=lambda f, s, o: s.force, moments=("force",), additive=True,
    ),
    "fabric": Field(
        rank=2, long_name="fabric", formula="F = sum V_i Psi sum_c n n", compute=lambda f, s, o: s.fabric,
        moments=("fabric",), additive=True,
    ),
    "coordination_number": Field(
        long_name="coordination number", formula="Z = sum z_i Psi / n",
        compute=lambda f, s, o: mean_of(s.partners, s.number), moments=("partners", "number"), weight="number_density",
    ),
    "contact_number_density": Field(
        units="m^-3", long_name="number density of contacts", formula="n_c = sum_c Psi(r - c)",
        compute=lambda f, s, o: s.contacts, moments=("contacts",), additive=True, default=False,
    ),
}  # fmt: skip
