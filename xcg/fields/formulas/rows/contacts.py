"""What contacts give: stress, traction of walls, fabric."""

from __future__ import annotations

from xcg.fields.formulas.algebra import mean_of
from xcg.fields.formulas.field import NONE, STRESS, Field

ROWS: dict[str, Field] = {
    "contact_stress": Field(
        2, STRESS, "contact stress", "sigma^c = sum_c f_ij a_ij int_0^1 Psi(r - r_i + s a_ij) ds, both sides",
        lambda f, s, o: s.contact, moments=("contact",), additive=True,
    ),
    "contact_stress_by_pair": Field(
        2, STRESS, "contact stress of each phase from contacts with another, or with walls",
        "sigma^c of the phase's sides of its contacts with grains of other_phase",
        lambda f, s, o: s.pair_contact, moments=("pair_contact",), additive=True, default=False, option="by",
        paired=True,
    ),
    "wall_traction": Field(
        1, (-2, 1, -2), "traction of walls on the grains", "t = sum_w f_iw Psi(r - c_iw)",
        lambda f, s, o: s.traction, moments=("traction",), additive=True,
    ),
    "contact_force_density": Field(
        1, (-2, 1, -2), "density of the contact forces on the grains", "sum_i Psi sum_c f_ij",
        lambda f, s, o: s.force, moments=("force",), additive=True,
    ),
    "fabric": Field(
        2, NONE, "fabric", "F = sum V_i Psi sum_c n n", lambda f, s, o: s.fabric, moments=("fabric",), additive=True
    ),
    "coordination_number": Field(
        0, NONE, "coordination number", "Z = sum z_i Psi / n",
        lambda f, s, o: mean_of(s.partners, s.number), moments=("partners", "number"), weight="number_density",
    ),
    "contact_number_density": Field(
        0, (-3, 0, 0), "number density of contacts", "n_c = sum_c Psi(r - c)",
        lambda f, s, o: s.contacts, moments=("contacts",), additive=True, default=False,
    ),
}  # fmt: skip
