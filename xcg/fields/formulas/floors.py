"""Floors: values that norms, eigenvalues and angles have in a step of few grains where the true value is zero.

Of N independent directions n the deviator of <n n> has the mean square (1 - 1 / D) / N, and its
components (5 in space, 2 in a plane) are normally distributed for large N. Grains of a gas carry
m v v in place of n n. Forces are taken to be exponentially distributed, <f^2> = 2 <f>^2.

Contacts of one grain are not independent, as its neighbours exclude each other: of Z contacts of a
grain the fabric is smaller by 1 - Z / 14 (1 - Z / 6.7 in a plane), and the stress, with forces that
differ, by the root of that. The factors are those of relaxed packings of soft spheres and discs at
widths from 0.5 to 2 d43 (tests/fields/formulas/test_floors.py), where the floors are right to 40 %.
"""

from __future__ import annotations

import math

from xcg.fields.formulas.field import Support

CONSIDERABLE_FLOOR = 0.2  # share of the usual value of a field
UNIT_OF_RATES = "sqrt(T) / d43"
USUAL_FRICTION = 0.3
USUAL_INERTIAL_NUMBER = 0.1
USUAL_ANISOTROPY = 0.1
USUAL_ANGLE = 0.5  # rad

# mean over root mean square of the norm of 2 and of 5 normal components, and the largest modulus of
# an eigenvalue of a random deviator over its norm
_NORM = {2: 0.886, 3: 0.951}
_EIGENVALUE = {2: math.sqrt(0.5), 3: 0.767}
_CROWDED = {2: 6.7, 3: 14.0}  # contacts of a grain that would leave no fabric
_LEAST = 0.2  # of the factor, as the number of contacts may be a bound
_SHAKEN = 0.2  # velocity fluctuation over sqrt(p / rho_p) in dense shear at I = 0.1, da Cruz et al. (2005)


def _deviator(number: float, dimension: int) -> float:
    """Return the mean norm of the deviator of <n n>, of so many independent directions."""
    return _NORM[dimension] * math.sqrt((1 - 1 / dimension) / number)


def _order(support: Support) -> float:
    """Return the part of the fabric that is left as neighbours exclude each other."""
    return max(_LEAST, 1 - support.partners / _CROWDED[support.dimension])


def friction(support: Support) -> float:
    """Return mu of isotropic contacts in a dense state, or of the velocities of a gas; at most that of one."""
    d = support.dimension
    largest = d * math.sqrt((1 - 1 / d) / 2)
    if support.is_dense:
        spread = math.sqrt(2 * _order(support))
        value = d * spread * _deviator(support.contacts, d) / math.sqrt(2)
    else:
        # of m v v with normal velocities: |dev|^2 = (D + 2)(D - 1) T^2, p = T
        value = _NORM[d] * math.sqrt((d + 2) * (d - 1) / 2 / support.grains)
    return min(largest, value)


def contact_anisotropy(support: Support) -> float:
    """Return a_c of isotropic contacts."""
    d = support.dimension
    size = {2: 4.0 * math.sqrt(0.5), 3: 7.5 * math.sqrt(1.5)}[d]
    return size * _order(support) * _deviator(support.contacts, d)


def force_anisotropy(support: Support) -> float:
    """Return a_n of isotropic contacts."""
    return contact_anisotropy(support) / math.sqrt(_order(support))


def branch_anisotropy(support: Support) -> float:
    """Return a_b of isotropic contacts; NaN where the spread of the branch lengths is not known."""
    return support.branch_spread * force_anisotropy(support)


def tangential_anisotropy(support: Support) -> float:
    """Return a_t of isotropic contacts; NaN where the tangential forces are not known.

    Of unit vectors t across n the symmetric part of t n has the square 1/2.
    """
    d = support.dimension
    size = {2: 4.0 * math.sqrt(0.5), 3: 5.0 * math.sqrt(1.5)}[d]
    return size * _NORM[d] * support.tangential / math.sqrt(2 * support.contacts)


# mean angle of the major axis of a tensor over the norm of its noise, relative to the norm of its
# deviator, where noise is small; and the mean of axes at random
_TURN = {2: 0.32, 3: 0.45}
_AT_RANDOM = {2: math.pi / 4, 3: 1.0}
_LODE = 0.59  # as _TURN, of the Lode angle


def _limited(angle: float, largest: float) -> float:
    """Return an angle that grows with noise as a smooth function up to the largest one."""
    return largest * 2 / math.pi * math.atan(angle * math.pi / 2 / largest)


def _turned(noise: float, dimension: int) -> float:
    """Return by how much noise turns the major axis of a tensor, relative to its deviator."""
    return _limited(_TURN[dimension] * noise, _AT_RANDOM[dimension])


def lode_angle(support: Support) -> float:
    """Return the Lode angle of triaxial compression with the usual mu."""
    return _limited(_LODE * friction(support) / USUAL_FRICTION, math.pi / 6)


def stress_fabric_angle(support: Support) -> float:
    """Return the angle of stress and fabric along one axis, with the usual mu and anisotropy of contacts.

    Contacts turn the fabric by their noise; where this is larger than the stress without it, they
    turn both, but for the noise of the forces, of the same square.
    """
    d = support.dimension
    of_contacts = friction(support) / math.sqrt(2)
    of_fabric = contact_anisotropy(support) / USUAL_ANISOTROPY
    of_others = math.hypot(USUAL_FRICTION, of_contacts) / of_contacts
    return min(_turned(of_fabric, d), _turned(of_others, d))


def stress_strain_rate_angle(support: Support) -> float:
    """Return the angle of stress and strain rate along one axis, with the usual mu and shear rate."""
    of_rate = shear_rate(support)
    if support.is_dense:
        of_rate = inertial_number(support) / USUAL_INERTIAL_NUMBER
    return _turned(math.hypot(friction(support) / USUAL_FRICTION, of_rate), support.dimension)


def order(support: Support) -> float:
    """Return the nematic order of directors at random."""
    d = support.dimension
    size = d / (d - 1) * _EIGENVALUE[d]
    return min(1.0, size * _deviator(support.grains, d))


def shear_rate(support: Support) -> float:
    """Return |dev Gamma| of independent velocities without shear, in sqrt(T) / d43."""
    return _NORM[support.dimension] * support.slope


def inertial_number(support: Support) -> float:
    """Return I without shear: of a gas, or of dense grains that fluctuate at most as in shear at I = 0.1."""
    if support.is_dense:
        return min(_SHAKEN, support.shaken) * shear_rate(support)
    return shear_rate(support) / math.sqrt(support.volume_fraction)
