"""Line integrals of kernels that are polynomials of the distance: shells in general, Lucy's kernel by its own forms.

A *shell* is a polynomial ``sum_n a_n q^n`` for q below a radius, and zero beyond; a kernel is the
sum of its shells. With r^2 = h^2 + t^2, integrals ``I_n`` of r^n over 0 < s < t along a line at
distance h follow from each other,

    (n + 1) I_n = t r^n + n h^2 I_(n-2),    I_(-1) = asinh(t / h),

so that their sum is ``t E(r) + h^2 e_1 asinh(t / h)``. The coefficients e_n of the polynomial E
depend on h alone:

    (n + 1) e_n = a_n + (n + 2) h^2 e_(n+2).

Between two ends of a line, t0 and t1, the difference is taken term by term, ``(t1 - t0) E(r1) + t0
(E(r1) - E(r0))``, the last by the divided difference of E: short segments lose no digits.

Lucy's kernel is ``P = 1 - 6 q^2 + 8 q^3 - 3 q^4 = (1 - q)^3 (1 + 3 q)``, q being the distance over
the cutoff; L1 and L2 are its integrals over a line and a plane at distance q, as in
`xcg.compiled.smoothing`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, leaf
from xcg.compiled.elementary import angle, logarithm
from xcg.compiled.reach import padded

# What stands in `shells` (rows, shells), column by column: radius, zero where there is no shell,
# number of powers, a multiple of AT_ONCE, and the coefficient a_n / (n + 1) of each power.
RADIUS = 0
POWERS = 1
FIRST = 2
AT_ONCE = 4
# rows of scratch
_H2, _R0, _R1, _LEVER, _APART, _EVEN, _ODD, _END, _SLOPE, _RATIO = (np.uint64(k) for k in range(10))
_SCRATCH = 10
# keeps quotients finite where both ends are at the node, and logarithms on the segment, where their
# factor is zero
TINY = 1e-290


def closed_for(room: int) -> NDArray:
    """Make scratch of closed forms for lists of this length."""
    return np.zeros((_SCRATCH, room))


@leaf
def fill_shells(shells, length, along, q2, count, out, rows):
    """Write the mean of the shells over segments, seen from `count` nodes, in loops that vectorise.

    Arguments as in `xcg.compiled.lines.fill_segments`.
    """
    room = padded(count)
    per_length = 1.0 / length
    for k in range(room):
        out[k] = 0.0
    for j in range(shells.shape[1]):
        radius2 = shells[RADIUS, j] * shells[RADIUS, j]
        if radius2 == 0.0:
            break
        for k in range(room):
            # lines farther away miss the shell as well
            h2 = min(radius2, max(0.0, q2[k] - along[k] * along[k]))
            half = math.sqrt(radius2 - h2)
            begin = max(-along[k], -half)
            end = max(begin, min(length - along[k], half))
            r0 = math.sqrt(h2 + begin * begin)
            r1 = math.sqrt(h2 + end * end)
            apart = end - begin
            both = r0 + r1
            rows[_H2, k] = h2
            rows[_R0, k] = r0
            rows[_R1, k] = r1
            rows[_LEVER, k] = begin * (begin + end) / (both + TINY)
            rows[_APART, k] = per_length * apart
            rows[_EVEN, k] = 0.0
            rows[_ODD, k] = 0.0
            rows[_END, k] = 0.0
            rows[_SLOPE, k] = 0.0
            rows[_RATIO, k] = (both + apart + TINY) / (max(0.0, both - apart) + TINY)
        for n in range(int(shells[POWERS, j]) - AT_ONCE, -1, -AT_ONCE):
            a0 = shells[FIRST + n, j]
            a1 = shells[FIRST + n + 1, j]
            a2 = shells[FIRST + n + 2, j]
            a3 = shells[FIRST + n + 3, j]
            p0 = (n + 2.0) / (n + 1.0)
            p1 = (n + 3.0) / (n + 2.0)
            p2 = (n + 4.0) / (n + 3.0)
            p3 = (n + 5.0) / (n + 4.0)
            for k in range(room):
                h2 = rows[_H2, k]
                r0 = rows[_R0, k]
                r1 = rows[_R1, k]
                end = rows[_END, k]
                e3 = a3 + p3 * h2 * rows[_ODD, k]
                e2 = a2 + p2 * h2 * rows[_EVEN, k]
                e1 = a1 + p1 * h2 * e3
                e0 = a0 + p0 * h2 * e2
                slope = rows[_SLOPE, k] * r0 + end
                end = end * r1 + e3
                slope = slope * r0 + end
                end = end * r1 + e2
                slope = slope * r0 + end
                end = end * r1 + e1
                rows[_SLOPE, k] = slope * r0 + end
                rows[_END, k] = end * r1 + e0
                rows[_EVEN, k] = e0
                rows[_ODD, k] = e1
        for k in range(room):
            out[k] += rows[_APART, k] * (rows[_END, k] + rows[_LEVER, k] * rows[_SLOPE, k])
            out[k] += rows[_ODD, k] * (per_length * rows[_H2, k]) * logarithm(rows[_RATIO, k])


@leaf
def along_shells(shells, h2, t0, t1):
    """Integral of the shells along a line at distance h from t0 to t1 (t0 < t1)."""
    total = 0.0
    for j in range(shells.shape[1]):
        half2 = shells[RADIUS, j] * shells[RADIUS, j] - h2
        if half2 <= 0.0:
            continue
        begin = max(t0, -math.sqrt(half2))
        end = min(t1, math.sqrt(half2))
        if end <= begin:
            continue
        r0 = math.sqrt(h2 + begin * begin)
        r1 = math.sqrt(h2 + end * end)
        even = 0.0
        odd = 0.0
        value = 0.0
        slope = 0.0
        for n in range(int(shells[POWERS, j]) - 2, -1, -2):
            odd = shells[FIRST + n + 1, j] + (n + 3.0) / (n + 2.0) * h2 * odd
            slope = slope * r0 + value
            value = value * r1 + odd
            even = shells[FIRST + n, j] + (n + 2.0) / (n + 1.0) * h2 * even
            slope = slope * r0 + value
            value = value * r1 + even
        both = r0 + r1
        apart = end - begin
        total += apart * (value + begin * (begin + end) / (both + TINY) * slope)
        total += h2 * odd * math.log((both + apart + TINY) / (max(0.0, both - apart) + TINY))
    return total


@leaf
def along_marginal(shells, h2, t0, t1):
    """Integral of a marginal along a line at distance h from t0 to t1 (t0 < t1), of the kernel seen in a plane.

    The shells describe ``w(q) = int_q^1 P(r) r dr``, P being the kernel.
    """
    total = 0.0
    for j in range(shells.shape[1]):
        half2 = shells[RADIUS, j] * shells[RADIUS, j] - h2
        if half2 > 0.0:
            begin = max(t0, -math.sqrt(half2))
            end = min(t1, math.sqrt(half2))
            if begin < end:
                total += _marginal_to(shells, j, h2, end) - _marginal_to(shells, j, h2, begin)
    return total


@inner
def _marginal_to(shells, j, h2, t):
    """Integral of the marginal of one shell over 0 < s < t, an odd function of t.

    In polar coordinates about the foot of the perpendicular, integrating by parts over the radius
    leaves ``pi w(h) - 2 t int_0^u w(r) / (z^2 + t^2) dz`` for t > 0, with r^2 = h^2 + t^2 + z^2 and
    u the half chord of the disc at t. Powers of r follow from each other: ``r^m / (z^2 + t^2) =
    r^(m-2) + h^2 r^(m-2) / (z^2 + t^2)``, which leaves integrals I_n at distance a, a^2 = h^2 +
    t^2, and two angles, of even and of odd powers of r. The even and odd parts of w(h) are their
    factors: ``pi w(h)`` is taken into the angles, and small t lose no digits.
    """
    radius = shells[RADIUS, j]
    a2 = h2 + t * t
    u = math.sqrt(max(0.0, radius * radius - a2))
    h = math.sqrt(h2)
    even = 0.0
    odd = 0.0
    even_line = 0.0
    odd_line = 0.0
    line = 0.0
    for m in range(int(shells[POWERS, j]) - 2, 0, -2):
        odd = (m + 2.0) * shells[FIRST + m + 1, j] + h2 * odd
        odd_line = (odd + (m + 1.0) * a2 * odd_line) / m
        line = line * radius + odd_line
        even = (m + 1.0) * shells[FIRST + m, j] + h2 * even
        even_line = (even + m * a2 * even_line) / (m - 1.0)
        line = line * radius + even_line
    odd = 2.0 * shells[FIRST + 1, j] + h2 * odd
    even = shells[FIRST, j] + h2 * even
    log = math.log((u + radius) / math.sqrt(a2 + TINY))
    angles = even * math.atan2(t, u) + h * odd * math.atan2(t * radius, h * u)
    return 2.0 * (angles - t * (u * line + (a2 * odd_line + odd) * log))


# --- Lucy ------------------------------------------------------------------------------------------------


@inner
def _log_term(h2, t):
    """Inverse hyperbolic sine of t / h, and zero on the line itself, where its factor h^2 or h^4 vanishes."""
    if h2 < 1e-280:
        return 0.0
    return math.log((t + math.sqrt(h2 + t * t)) / math.sqrt(h2))


@inner
def lucy_line(h2, t):
    """Integral of P(sqrt(h^2 + s^2)) over 0 < s < t, for h^2 + t^2 <= 1."""
    t2 = t * t
    r = math.sqrt(h2 + t2)
    cubic = t * r * (2.0 * r * r + 3.0 * h2) + 3.0 * h2 * h2 * _log_term(h2, t)
    return t * (1.0 - 6.0 * h2 - 2.0 * t2 - 3.0 * h2 * h2 - 2.0 * h2 * t2 - 0.6 * t2 * t2) + cubic


# Beyond this squared distance the closed form of L1 cancels to its rounding; polynomials keep every
# digit of the small weights at the rim, where a node may see nothing else.
_RIM = 0.5


@inlined
def lucy_line_value(q2):
    """Return L1(q), without a branch; at the rim from a polynomial of L1 / (1 - q^2)^(7/2), to 3e-16 of its value."""
    half2 = 1.0 - q2
    half = math.sqrt(half2)
    log = logarithm((1.0 + half) / (math.sqrt(q2) + TINY))
    inside = half * (0.8 - q2 * (3.6 + 3.2 * q2)) + 6.0 * q2 * q2 * log
    y = 4.0 * half2 - 1.0
    p = 2.070335508099409e-11
    p = p * y + 7.19281159484676e-11
    p = p * y + 1.6980602229725772e-10
    p = p * y + 6.284414052805163e-10
    p = p * y + 2.4887163089881033e-09
    p = p * y + 9.350113481936472e-09
    p = p * y + 3.567485802688477e-08
    p = p * y + 1.3969295885147904e-07
    p = p * y + 5.612408402661366e-07
    p = p * y + 2.325600266085683e-06
    p = p * y + 1.0013059511943137e-05
    p = p * y + 4.525499062401864e-05
    p = p * y + 0.00021790407156544388
    p = p * y + 0.0011435240757293162
    p = p * y + 0.006791441216499997
    p = p * y + 0.04894019870127622
    p = p * y + 0.5002543523116934
    return inside if q2 < _RIM else half * (half2 * half2 * half2) * p


@inlined
def lucy_line_slope(q2):
    """Return the derivative of L1(q) divided by q, in the same way; its polynomial is over (1 - q^2)^(5/2)."""
    half2 = 1.0 - q2
    half = math.sqrt(half2)
    log = logarithm((1.0 + half) / (math.sqrt(q2) + TINY))
    inside = 24.0 * q2 * log - 8.0 * half * (1.0 + 2.0 * q2)
    y = 4.0 * half2 - 1.0
    p = -3.2193918319006287e-10
    p = p * y - 1.0496296642764505e-09
    p = p * y - 2.0767055321861855e-09
    p = p * y - 7.1928086984167446e-09
    p = p * y - 2.7463709745350404e-08
    p = p * y - 9.486718788259395e-08
    p = p * y - 3.2924944952225264e-07
    p = p * y - 1.1678413373689652e-06
    p = p * y - 4.206580685173073e-06
    p = p * y - 1.5423480899564868e-05
    p = p * y - 5.781726238699415e-05
    p = p * y - 0.00022280642517882518
    p = p * y - 0.0008894915810691085
    p = p * y - 0.003721110992139264
    p = p * y - 0.016609045555479623
    p = p * y - 0.0815669978353437
    p = p * y - 0.46762755317751037
    p = p * y - 3.5996608635844094
    return inside if q2 < _RIM else half * (half2 * half2) * p


@inner
def lucy_plane_value(q2):
    """L2(q) / 2 pi = integral of P(r) r over q < r < 1."""
    q = math.sqrt(q2)
    # its square is what the compiler makes of the fourth power, and Python does not
    square = (1.0 - q) * (1.0 - q)
    return square * square * (0.1 + 0.4 * q + 0.5 * q2)


@inner
def lucy_plane(h2, t):
    """Integral of L1(sqrt(h^2 + s^2)) over 0 < s < t, for h^2 + t^2 <= 1.

    In polar coordinates about the foot of the perpendicular, integrating by parts over the radius
    leaves pi w(h) - 2 t int_0^u w(r) / (z^2 + t^2) dz with w = L2 / 2 pi and u the half chord of
    the disc at t.
    """
    a2 = h2 + t * t
    if t <= 0.0:
        return 0.0
    u2 = max(0.0, 1.0 - a2)
    u = math.sqrt(u2)
    h = math.sqrt(h2)
    t2 = t * t
    h4 = h2 * h2
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
def fill_lucy_lines(length, along, q2, count, out):
    """As `lucy_line` at both ends of the clipped segment, in a loop that vectorises.

    The two logarithms are one: for ends at distances r0, r1 from the node and l from each other,
    asinh(t1 / h) - asinh(t0 / h) = log((r0 + r1 + l) / (r0 + r1 - l)).
    """
    per_length = 1.0 / length
    for k in range(padded(count)):
        a, b, h2 = clipped(q2[k], along[k], length)
        a2, b2 = a * a, b * b
        r0, r1 = math.sqrt(h2 + a2), math.sqrt(h2 + b2)
        h4 = h2 * h2
        # P with r^2 = h^2 + t^2, even powers first
        c0 = 1.0 - 6.0 * h2 - 3.0 * h4
        c2 = -2.0 - 2.0 * h2
        even = b * (c0 + b2 * (c2 - 0.6 * b2)) - a * (c0 + a2 * (c2 - 0.6 * a2))
        odd = b * r1 * (2.0 * b2 + 5.0 * h2) - a * r0 * (2.0 * a2 + 5.0 * h2)
        both = r0 + r1
        apart = b - a
        log = logarithm((both + apart + TINY) / (max(0.0, both - apart) + TINY))
        out[k] = per_length * (even + odd) + 3.0 * per_length * h4 * log


@inlined
def _plane_end(h2, t):
    """Half chord at an end of a segment, its squared distance from the node, and the parts of `lucy_plane` there.

    These are the part without logarithm, times t, and the factor of log((1 + u) / distance).
    """
    t2 = t * t
    h4 = h2 * h2
    r2 = h2 + t2
    u2 = max(0.0, 1.0 - r2)
    u = math.sqrt(u2)
    part = -0.5 + 3.0 * h2 + 1.5 * h4 + (1.5 + 1.5 * h2) * (u2 / 3.0 + t2)
    part += 0.5 * (u2 * (0.2 * u2 + 2.0 / 3.0 * t2) + t2 * t2) - 0.4 - 0.6 * r2 - 0.8 * h2
    return u, r2, t * u * part, 1.6 * t * (r2 * (0.375 * r2 + 0.5 * h2) + h4)


@inner
def fill_lucy_planes(length, along, q2, count, out):
    """As `lucy_plane` at both ends of the clipped segment, in a loop that vectorises.

    The angles at both ends are one, of the product of the first and the mirror image of the second.
    """
    per_length = 1.0 / length
    for k in range(padded(count)):
        a, b, h2 = clipped(q2[k], along[k], length)
        ua, ra2, part_a, factor_a = _plane_end(h2, a)
        ub, rb2, part_b, factor_b = _plane_end(h2, b)
        h = math.sqrt(h2)
        even = 0.1 + h2 * (-0.5 + h2 * (1.5 + 0.5 * h2))
        turn = max(0.0, b * ua - a * ub)
        both = ua * ub
        total = even * angle(turn, both + a * b) - 1.6 * h2 * h2 * h * angle(
            h * turn, h2 * both + a * b
        )
        out[k] = 2.0 * per_length * (total - (part_b - part_a))
        # logarithms of squares, which take no roots of distances
        out[k] -= per_length * factor_a * logarithm((1.0 + ua) * (1.0 + ua) / (ra2 + TINY))
        out[k] += per_length * factor_b * logarithm((1.0 + ub) * (1.0 + ub) / (rb2 + TINY))
