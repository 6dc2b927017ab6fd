"""Contacts and phases: stress, force of walls, fabric and its anisotropy, and how phases act on each other.

With n the normal of a contact, l its branch along n (from centre to centre, at a wall to the
contact point), f its force and f_t the tangential part, <> the mean over contacts at the node, dev
the deviator, k = 15/2 (4 in a plane),

    Phi = <n n>,  X_b = <l n n> / <l>,  X_n = <f.n n n> / <f.n>,  X_t = <f_t n> / <f.n>.

The density of contacts by direction is then (1 + a_c : n n) / 4 pi with a_c = k dev Phi, in the
lowest harmonics; branch lengths and normal forces vary as 1 + a_b : n n and 1 + a_n : n n with a_b
= k dev (X_b - Phi) and a_n = k dev (X_n - Phi), and tangential forces as a_t . n - (n . a_t . n) n
with a_t = 5 dev X_t (4 in a plane), to first order in the anisotropies.

Sources: Rothenburg & Bathurst (1989), Geotechnique 39, 601 (plane); Ouadfel & Rothenburg (2001),
Mech. Mater. 33, 201, and Guo & Zhao (2013), Comput. Geotech. 47, 1 (space); anisotropies from these
sums: Azema, Radjai & Saussine (2009), Mech. Mater. 41, 729. Strong contacts: Radjai et al. (1998),
Phys. Rev. Lett. 80, 61. Density of the boundary's force: Weinhart, Thornton, Luding & Bokhove
(2012), Granul. Matter 14, 289. Constraints over degrees of freedom: Kruyt (2010), C. R. Mecanique 338,
596; partners from which grains bear load: Thornton (2000), Geotechnique 50, 43. Phases: Weinhart,
Luding & Thornton (2013), AIP Conf. Proc. 1542; Gray & Thornton (2005), Proc. R. Soc. A 461.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.fields.formulas import floors
from xcg.fields.formulas.algebra import (
    contraction,
    deviator,
    mean_of,
    ratio,
    restricted,
    transposed,
    zero_if_unknown,
)
from xcg.fields.formulas.field import (
    ABOUT_MEAN_VELOCITY,
    Field,
    Options,
    mean_of_sums,
    sum_of,
)


def _anisotropy(tensor: NDArray, factor: tuple[float, float], o: Options) -> NDArray:
    """Return sqrt(3/2 a:a), or sqrt(a:a / 2) in a plane, of a = factor x dev(symmetric tensor)."""
    symmetric = (tensor + transposed(tensor)) / 2
    a = factor[o.dimension - 2] * deviator(restricted(symmetric, o.plane), o.plane)
    return np.sqrt({2: 0.5, 3: 1.5}[o.dimension] * contraction(a))


# factors in two and in three dimensions
_NORMAL = (4.0, 7.5)
_TANGENTIAL = (4.0, 5.0)


def _fabric_stress(f: Any, s: Any, o: Options) -> NDArray:
    size = f.normal_force_density * ratio(f.branch_length_density, f.contact_number_density)
    tensors = f.normal_force_fabric + f.branch_fabric - f.contact_fabric + f.tangential_force_fabric
    return size[..., None, None] * tensors


def _redundancy(f: Any, s: Any, o: Options) -> NDArray:
    d = o.dimension
    constraints = o.dimension * s.load_bearing_contacts
    if o.sliding:
        constraints = constraints - (d - 1) * s.load_bearing_sliding
    return ratio(constraints, d * (d + 1) / 2 * s.load_bearing)


def _segregation_flux(f: Any, s: Any, o: Options) -> NDArray:
    """Return p_a - rho_a V with both velocities relative to the node's reference."""
    return s.momentum - s.mass[..., None] * zero_if_unknown(f._drift[:1])


_ROWS: dict[str, Field] = {
    "contact_stress": sum_of(
        "contact",
        rank=2,
        units="Pa",
        long_name="contact stress",
        formula="sigma^c = sum_c f_ij a_ij int_0^1 Psi(r - r_i + s a_ij) ds, both sides",
    ),
    "contact_stress_by_pair": sum_of(
        "pair_contact",
        rank=2,
        units="Pa",
        long_name="contact stress of each phase from contacts with another, or with walls",
        formula="sigma^c of the phase's sides of its contacts with grains of other_phase",
        option="by",
        paired=True,
    ),
    "boundary_force_density": sum_of(
        "traction",
        rank=1,
        units="Pa m^-1",
        long_name="force of walls on the grains per volume",
        formula="t = sum_w f_iw Psi(r - c_iw)",
    ),
    "contact_force_density": sum_of(
        "force",
        rank=1,
        units="Pa m^-1",
        long_name="density of the contact forces on the grains",
        formula="sum_i Psi sum_c f_ij",
    ),
    "fabric": sum_of("fabric", rank=2, long_name="fabric", formula="F = sum V_i Psi sum_c n n"),
    "coordination_number": mean_of_sums(
        "partners",
        "number",
        long_name="coordination number",
        formula="Z = sum z_i Psi / n",
        weight="number_density",
    ),
    "contact_number_density": sum_of(
        "contacts",
        units="m^-3",
        long_name="number density of contacts",
        formula="n_c = sum_c Psi(r - c)",
    ),
    "branch_length_density": sum_of(
        "branch_length",
        units="m^-2",
        long_name="length of branches in a unit of volume",
        formula="sum_c l Psi(r - c)",
    ),
    "normal_force_density": sum_of(
        "normal_force",
        units="Pa m^-1",
        long_name="sum of normal forces in a unit of volume",
        formula="sum_c f.n Psi(r - c)",
    ),
    "contact_fabric": mean_of_sums(
        "normals",
        "contacts",
        rank=2,
        long_name="mean of the contacts' normals",
        formula="Phi = sum_c n n Psi(r - c) / n_c",
        weight="contact_number_density",
    ),
    "branch_fabric": mean_of_sums(
        "branch_normals",
        "branch_length",
        rank=2,
        long_name="normals, weighted by the branch length",
        formula="X_b = sum_c l n n Psi(r - c) / sum_c l Psi(r - c)",
        weight="branch_length_density",
    ),
    "normal_force_fabric": Field(
        rank=2,
        long_name="normals, weighted by the normal force",
        formula="X_n = sum_c f.n n n Psi(r - c) / sum_c f.n Psi(r - c)",
        compute=lambda f, s, o: ratio(s.normal_force_normals, s.normal_force),
        moments=("normal_force_normals", "normal_force"),
        weight="normal_force_density",
    ),
    "tangential_force_fabric": Field(
        rank=2,
        long_name="tangential forces by normal",
        formula="X_t = sum_c f_t n Psi(r - c) / sum_c f.n Psi(r - c)",
        compute=lambda f, s, o: ratio(s.tangential_normals, s.normal_force),
        moments=("tangential_normals", "normal_force"),
        weight="normal_force_density",
    ),
    "contact_anisotropy": Field(
        long_name="anisotropy of the contacts",
        formula="a_c = sqrt(3/2 a:a), a = 15/2 dev Phi, 2D: sqrt(a:a / 2), a = 4 dev Phi",
        compute=lambda f, s, o: _anisotropy(f.contact_fabric, _NORMAL, o),
        fields=("contact_fabric",),
        floor=floors.contact_anisotropy,
        usual=0.1,
        is_norm=True,
    ),
    "branch_anisotropy": Field(
        long_name="anisotropy of the branch lengths",
        formula="a_b, from a = 15/2 dev (X_b - Phi), 2D: 4 dev (X_b - Phi)",
        compute=lambda f, s, o: _anisotropy(f.branch_fabric - f.contact_fabric, _NORMAL, o),
        fields=("branch_fabric", "contact_fabric"),
        floor=floors.branch_anisotropy,
        usual=0.1,
        is_norm=True,
    ),
    "normal_force_anisotropy": Field(
        long_name="anisotropy of the normal forces",
        formula="a_n, from a = 15/2 dev (X_n - Phi), 2D: 4 dev (X_n - Phi)",
        compute=lambda f, s, o: _anisotropy(f.normal_force_fabric - f.contact_fabric, _NORMAL, o),
        fields=("normal_force_fabric", "contact_fabric"),
        floor=floors.force_anisotropy,
        usual=0.1,
        is_norm=True,
    ),
    "tangential_force_anisotropy": Field(
        long_name="anisotropy of the tangential forces",
        formula="a_t, from a = 5 dev X_t, 2D: 4 dev X_t",
        compute=lambda f, s, o: _anisotropy(f.tangential_force_fabric, _TANGENTIAL, o),
        fields=("tangential_force_fabric",),
        floor=floors.tangential_anisotropy,
        usual=0.1,
        is_norm=True,
    ),
    "fabric_stress": Field(
        rank=2,
        units="Pa",
        long_name="stress that the tensors of contacts give back",
        formula="n_c <f.n> <l> (X_n + X_b - Phi + X_t)",
        compute=_fabric_stress,
        fields=(
            "normal_force_density",
            "branch_length_density",
            "contact_number_density",
            "normal_force_fabric",
            "branch_fabric",
            "contact_fabric",
            "tangential_force_fabric",
        ),
    ),
    "strong_contact_stress": sum_of(
        "strong_contact",
        rank=2,
        units="Pa",
        long_name="contact stress of contacts that push more than the mean of the step (under gravity: deep ones)",
        formula="sigma^c of contacts with f.n > <f.n>, the mean over all contacts with f.n > 0",
    ),
    "weak_contact_stress": Field(
        rank=2,
        units="Pa",
        long_name="contact stress of all other contacts",
        formula="sigma^c less that of strong contacts",
        compute=lambda f, s, o: f.contact_stress - f.strong_contact_stress,
        fields=("contact_stress", "strong_contact_stress"),
        additive=True,
    ),
    "load_bearing_number_density": sum_of(
        "load_bearing",
        units="m^-3",
        long_name="number density of load-bearing grains",
        formula="sum Psi over z_i > 1",
    ),
    "mechanical_coordination_number": mean_of_sums(
        "load_bearing_partners",
        "load_bearing",
        long_name="coordination number of load-bearing grains",
        formula="Z_mech = sum z_i Psi / sum Psi over z_i > 1",
        weight="load_bearing_number_density",
    ),
    "redundancy_number": Field(
        long_name="constraints of contacts over degrees of freedom of load-bearing grains",
        formula="sum_c (D - (D - 1) s_c) Psi(r - c) / (D (D + 1) / 2 sum Psi), "
        "s_c = 1 if |f_t| = friction f.n, over z_i > 1",
        compute=_redundancy,
        moments=("load_bearing_contacts", "load_bearing"),
        weight="load_bearing_number_density",
    ),
    "pushing_contact_number_density": sum_of(
        "pushing_contacts",
        units="m^-3",
        long_name="number density of contacts that push",
        formula="sum_c Psi(r - c) over f.n > 0",
    ),
    "sliding_share": mean_of_sums(
        "sliding_contacts",
        "pushing_contacts",
        long_name="share of contacts that slide, of contacts that push",
        formula="sum_c s_c Psi(r - c) / sum_c Psi(r - c) over f.n > 0, s_c = 1 if |f_t| = friction f.n",
        weight="pushing_contact_number_density",
        option="friction",
    ),
    "friction_mobilisation": Field(
        long_name="mean mobilisation of the friction of contacts that push",
        formula="sum_c |f_t| / (friction f.n) Psi(r - c) / sum_c Psi(r - c) over f.n > 0",
        compute=lambda f, s, o: mean_of(s.force_slopes, s.pushing_contacts) / o.friction,
        moments=("force_slopes", "pushing_contacts"),
        weight="pushing_contact_number_density",
        option="friction",
    ),
    "interphase_force": sum_of(
        "pair_force",
        rank=1,
        units="Pa m^-1",
        long_name="density of the contact forces of another phase, or of walls, on each phase",
        formula="sum_c f_ij Psi(r - c), i in the phase and j in other_phase",
        option="by",
        paired=True,
    ),
    "segregation_flux": Field(
        rank=1,
        units="kg m^-2 s^-1",
        long_name="flux of a phase's mass relative to the bulk",
        formula="rho_a (V_a - V)",
        compute=_segregation_flux,
        fields=("_drift",),
        moments=("mass", "momentum"),
        additive=True,
        # rho_a (V_a - U), U the averaged velocity of the bulk
        covariance=lambda f, s, o: f.shift,
        averages=ABOUT_MEAN_VELOCITY,
        option="by",
    ),
    "concentration": Field(
        long_name="share of a phase in the volume of the grains",
        formula="c_a = phi_a / phi",
        compute=lambda f, s, o: mean_of(f.volume_fraction, f.volume_fraction[:1]),
        fields=("volume_fraction",),
        weight="volume_fraction",
        by_bulk=True,
        option="by",
    ),
}
_USUAL = (
    "contact_stress",
    "boundary_force_density",
    "contact_force_density",
    "fabric",
    "coordination_number",
)
ROWS = {name: replace(row, default=name in _USUAL) for name, row in _ROWS.items()}
# other ways to a field, as in `xcg.fields.formulas.rows.flow`
WAYS: dict[str, tuple[str, dict[Any, Field]]] = {
    "redundancy_number": (
        "sliding",
        {
            True: replace(
                ROWS["redundancy_number"],
                moments=("load_bearing_contacts", "load_bearing_sliding", "load_bearing"),
            ),
        },
    ),
}
