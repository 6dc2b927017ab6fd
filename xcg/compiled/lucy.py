"""Lucy's kernel: marginals and integrals along lines.

P = 1 - 6 q^2 + 8 q^3 - 3 q^4 = (1 - q)^3 (1 + 3 q), q being the distance over the cutoff. L1 and L2 are its integrals
over a line and a plane at distance q, as in `xcg.compiled.smoothing`.
"""

import math

import numpy as np

from xcg.compiled._jit import inlined, inner
from xcg.compiled.elementary import add_logarithms, angle
from xcg.compiled.reach import padded

TINY = 1e-290  # keeps the logarithm finite on the segment itself, where its factor h^4 is zero


@inner
def _log_term(h2, t):
    """Inverse hyperbolic sine of t / h, and zero on the line itself, where its factor h^2 or h^4 vanishes."""
    return 0.0 if h2 < 1e-280 else math.log((t + math.sqrt(h2 + t * t)) / math.sqrt(h2))


@inner
def lucy_line(h2, t):
    """Integral of P(sqrt(h^2 + s^2)) over 0 < s < t, for h^2 + t^2 <= 1."""
    t2 = t * t
    r = math.sqrt(h2 + t2)
    cubic = t * r * (2.0 * r * r + 3.0 * h2) + 3.0 * h2 * h2 * _log_term(h2, t)
    return t * (1.0 - 6.0 * h2 - 2.0 * t2 - 3.0 * h2 * h2 - 2.0 * h2 * t2 - 0.6 * t2 * t2) + cubic


# Beyond this squared distance the closed form of L1 cancels to its rounding; the quadrature keeps every digit of
# the small weights at the rim, where a node may see nothing else.
_RIM = 0.5
_RIM_NODES, _RIM_WEIGHTS = np.polynomial.legendre.leggauss(12)


@inner
def lucy_line_value(q2, by_gradient):
    """L1(q), or its derivative divided by q."""
    half2 = 1.0 - q2
    half = math.sqrt(half2)
    if q2 < _RIM:
        if by_gradient:
            return -24.0 * (half * (q2 + half2 / 3.0) - q2 * _log_term(q2, half))
        return 2.0 * lucy_line(q2, half)
    total = 0.0
    for g in range(_RIM_NODES.size):
        t = 0.5 * (1.0 + _RIM_NODES[g])
        rest = half2 * (1.0 - t * t)  # 1 - r^2
        r = math.sqrt(1.0 - rest)
        p = rest / (1.0 + r)
        total += _RIM_WEIGHTS[g] * (-12.0 * p * p if by_gradient else p * p * p * (1.0 + 3.0 * r))
    return half * total


@inner
def lucy_plane_value(q2):
    """L2(q) / 2 pi = integral of P(r) r over q < r < 1."""
    q = math.sqrt(q2)
    square = (1.0 - q) * (1.0 - q)  # its square is what the compiler makes of the fourth power, and Python does not
    return square * square * (0.1 + 0.4 * q + 0.5 * q2)


@inner
def lucy_plane(h2, t):
    """Integral of L1(sqrt(h^2 + s^2)) over 0 < s < t, for h^2 + t^2 <= 1.

    In polar coordinates about the foot of the perpendicular, integrating by parts over the radius leaves
    pi w(h) - 2 t int_0^u w(r) / (u^2 + t^2) du with w = L2 / 2 pi and u the half chord of the disc at t.
    """
    a2 = h2 + t * t
    if t <= 0.0:
        return 0.0
    u2 = max(0.0, 1.0 - a2)
    u = math.sqrt(u2)
    h = math.sqrt(h2)
    t2, h4 = t * t, h2 * h2
    even0 = 0.1 + h2 * (-0.5 + h2 * (1.5 + 0.5 * h2))
    even = (-0.5 + 3.0 * h2 + 1.5 * h4) * u
    even += 1.5 * (1.0 + h2) * u * (u2 / 3.0 + t2)
    even += 0.5 * u * (u2 * u2 / 5.0 + 2.0 / 3.0 * t2 * u2 + t2 * t2)
    log = math.log((1.0 + u) / math.sqrt(a2))
    odd = 0.25 * u + 0.375 * a2 * (u + a2 * log) + 0.5 * h2 * (u + a2 * log) + h4 * log
    angles = even0 * math.atan2(u, t) - 1.6 * h4 * h * math.atan2(h * u, t)
    return math.pi * lucy_plane_value(h2) - 2.0 * (angles + t * (even - 1.6 * odd))


@inlined
def clipped(q2, along, length):
    """Return the ends of a segment within the support, from the foot of a node, and the foot's squared distance."""
    h2 = max(0.0, q2 - along * along)
    half = math.sqrt(max(0.0, 1.0 - h2))
    begin = max(-along, -half)
    return begin, max(begin, min(length - along, half)), h2


@inner
def fill_lucy_lines(per_length, length, along, q2, count, out, ratio, bits, exponent):
    """As `lucy_line` at both ends of the clipped segment, in loops that vectorise.

    The two logarithms are one: for ends at distances r0, r1 from the node and l from each other, asinh(t1 / h) -
    asinh(t0 / h) = log((r0 + r1 + l) / (r0 + r1 - l)).
    """
    room = padded(count)
    for k in range(room):
        a, b, h2 = clipped(q2[k], along[k], length)
        a2, b2 = a * a, b * b
        r0, r1 = math.sqrt(h2 + a2), math.sqrt(h2 + b2)
        h4 = h2 * h2
        # P with r^2 = h^2 + t^2, even powers first
        c0, c2 = 1.0 - 6.0 * h2 - 3.0 * h4, -2.0 - 2.0 * h2
        even = b * (c0 + b2 * (c2 - 0.6 * b2)) - a * (c0 + a2 * (c2 - 0.6 * a2))
        odd = b * r1 * (2.0 * b2 + 5.0 * h2) - a * r0 * (2.0 * a2 + 5.0 * h2)
        out[k] = per_length * (even + odd)
        both, apart = r0 + r1, b - a
        ratio[k] = (both + apart + TINY) / (max(0.0, both - apart) + TINY)
        q2[k] = 3.0 * per_length * h4
    add_logarithms(ratio, bits, exponent, q2, room, out)


@inlined
def _plane_end(h2, t):
    """Half chord at an end of a segment, its distance from the node, and the parts of `lucy_plane` there.

    These are the part without logarithm, times t, and the factor of log((1 + u) / distance).
    """
    t2, h4 = t * t, h2 * h2
    r2 = h2 + t2
    u2 = max(0.0, 1.0 - r2)
    u = math.sqrt(u2)
    part = -0.5 + 3.0 * h2 + 1.5 * h4 + (1.5 + 1.5 * h2) * (u2 / 3.0 + t2)
    part += 0.5 * (u2 * (0.2 * u2 + 2.0 / 3.0 * t2) + t2 * t2) - 0.4 - 0.6 * r2 - 0.8 * h2
    return u, math.sqrt(r2), t * u * part, 1.6 * t * (r2 * (0.375 * r2 + 0.5 * h2) + h4)


@inner
def fill_lucy_planes(per_length, length, along, q2, count, out, ratio, bits, exponent, rows):
    """As `lucy_plane` at both ends of the clipped segment, in loops that vectorise.

    The angles at both ends are one, of the product of the first and the mirror image of the second.
    """
    room = padded(count)
    first, last, ratio_last = rows[0], rows[1], rows[2]
    for k in range(room):
        a, b, h2 = clipped(q2[k], along[k], length)
        ua, ra, part_a, factor_a = _plane_end(h2, a)
        ub, rb, part_b, factor_b = _plane_end(h2, b)
        h, even = math.sqrt(h2), 0.1 + h2 * (-0.5 + h2 * (1.5 + 0.5 * h2))
        turn, both = max(0.0, b * ua - a * ub), ua * ub
        total = even * angle(turn, both + a * b) - 1.6 * h2 * h2 * h * angle(h * turn, h2 * both + a * b)
        out[k] = 2.0 * per_length * (total - (part_b - part_a))
        ratio[k], ratio_last[k] = (1.0 + ua) / (ra + TINY), (1.0 + ub) / (rb + TINY)
        first[k], last[k] = -2.0 * per_length * factor_a, 2.0 * per_length * factor_b
    add_logarithms(ratio, bits, exponent, first, room, out)
    for k in range(room):
        ratio[k] = ratio_last[k]
    add_logarithms(ratio, bits, exponent, last, room, out)
