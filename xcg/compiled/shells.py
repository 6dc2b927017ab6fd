"""Line integrals of kernels that are polynomials of the distance, each within a radius of its own.

A *shell* is a polynomial ``sum_n a_n q^n`` for q below a radius, and zero beyond; a kernel is the sum of its shells.
With r^2 = h^2 + t^2, integrals ``I_n`` of r^n over 0 < s < t along a line at distance h follow from each other,

    (n + 1) I_n = t r^n + n h^2 I_(n-2),    I_(-1) = asinh(t / h),

so that their sum is ``t E(r) + h^2 e_1 asinh(t / h)``. The coefficients e_n of the polynomial E depend on h alone:

    (n + 1) e_n = a_n + (n + 2) h^2 e_(n+2).

Between two ends of a line, t0 and t1, the difference is taken term by term, ``(t1 - t0) E(r1) + t0 (E(r1) - E(r0))``,
the last by the divided difference of E: short segments lose no digits.
"""

import math

import numpy as np

from xcg.compiled._jit import inner, leaf
from xcg.compiled.elementary import add_logarithms
from xcg.compiled.reach import padded

# What stands in `shells` (rows, shells), column by column: radius, zero where there is no shell, number of powers,
# a multiple of AT_ONCE, and the coefficient a_n / (n + 1) of each power.
RADIUS, POWERS, FIRST = 0, 1, 2
AT_ONCE = 4
# rows of scratch
_H2, _R0, _R1, _LEVER, _APART, _EVEN, _ODD, _END, _SLOPE = (np.uint64(k) for k in range(9))
SCRATCH = 9
_TINY = 1e-290  # keeps quotients finite where both ends are at the node


@leaf
def fill_shells(shells, per_length, length, along, q2, count, out, ratio, bits, exponent, rows):
    """Write the mean of the shells over segments, seen from `count` nodes, in loops that vectorise.

    Arguments as in `xcg.compiled.lines.fill_segments`.
    """
    room = padded(count)
    for k in range(room):
        out[k] = 0.0
    for j in range(shells.shape[1]):
        radius2 = shells[RADIUS, j] * shells[RADIUS, j]
        if radius2 == 0.0:
            break
        for k in range(room):
            h2 = min(radius2, max(0.0, q2[k] - along[k] * along[k]))  # lines farther away miss the shell as well
            half = math.sqrt(radius2 - h2)
            begin = max(-along[k], -half)
            end = max(begin, min(length - along[k], half))
            r0, r1, apart = math.sqrt(h2 + begin * begin), math.sqrt(h2 + end * end), end - begin
            both = r0 + r1
            rows[_H2, k], rows[_R0, k], rows[_R1, k] = h2, r0, r1
            rows[_LEVER, k], rows[_APART, k] = begin * (begin + end) / (both + _TINY), per_length * apart
            rows[_EVEN, k], rows[_ODD, k], rows[_END, k], rows[_SLOPE, k] = 0.0, 0.0, 0.0, 0.0
            ratio[k] = (both + apart + _TINY) / (max(0.0, both - apart) + _TINY)
        for n in range(int(shells[POWERS, j]) - AT_ONCE, -1, -AT_ONCE):
            a0, a1, a2, a3 = (
                shells[FIRST + n, j],
                shells[FIRST + n + 1, j],
                shells[FIRST + n + 2, j],
                shells[FIRST + n + 3, j],
            )
            p0, p1, p2, p3 = (n + 2.0) / (n + 1.0), (n + 3.0) / (n + 2.0), (n + 4.0) / (n + 3.0), (n + 5.0) / (n + 4.0)
            for k in range(room):
                h2, r0, r1, end = rows[_H2, k], rows[_R0, k], rows[_R1, k], rows[_END, k]
                e3 = a3 + p3 * h2 * rows[_ODD, k]
                e2 = a2 + p2 * h2 * rows[_EVEN, k]
                e1, e0 = a1 + p1 * h2 * e3, a0 + p0 * h2 * e2
                slope = rows[_SLOPE, k] * r0 + end
                end = end * r1 + e3
                slope = slope * r0 + end
                end = end * r1 + e2
                slope = slope * r0 + end
                end = end * r1 + e1
                rows[_SLOPE, k] = slope * r0 + end
                rows[_END, k] = end * r1 + e0
                rows[_EVEN, k], rows[_ODD, k] = e0, e1
        for k in range(room):
            out[k] += rows[_APART, k] * (rows[_END, k] + rows[_LEVER, k] * rows[_SLOPE, k])
            rows[_ODD, k] *= per_length * rows[_H2, k]
        add_logarithms(ratio, bits, exponent, rows[_ODD], room, out)


@leaf
def along_shells(shells, h2, t0, t1):
    """Integral of the shells along a line at distance h from t0 to t1 (t0 < t1)."""
    total = 0.0
    for j in range(shells.shape[1]):
        half2 = shells[RADIUS, j] * shells[RADIUS, j] - h2
        if half2 <= 0.0:
            continue
        begin, end = max(t0, -math.sqrt(half2)), min(t1, math.sqrt(half2))
        if end <= begin:
            continue
        r0, r1 = math.sqrt(h2 + begin * begin), math.sqrt(h2 + end * end)
        even, odd, value, slope = 0.0, 0.0, 0.0, 0.0
        for n in range(int(shells[POWERS, j]) - 2, -1, -2):
            odd = shells[FIRST + n + 1, j] + (n + 3.0) / (n + 2.0) * h2 * odd
            slope = slope * r0 + value
            value = value * r1 + odd
            even = shells[FIRST + n, j] + (n + 2.0) / (n + 1.0) * h2 * even
            slope = slope * r0 + value
            value = value * r1 + even
        both, apart = r0 + r1, end - begin
        total += apart * (value + begin * (begin + end) / (both + _TINY) * slope)
        total += h2 * odd * math.log((both + apart + _TINY) / (max(0.0, both - apart) + _TINY))
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
            begin, end = max(t0, -math.sqrt(half2)), min(t1, math.sqrt(half2))
            if begin < end:
                total += _marginal_to(shells, j, h2, end) - _marginal_to(shells, j, h2, begin)
    return total


@inner
def _marginal_to(shells, j, h2, t):
    """Integral of the marginal of one shell over 0 < s < t, an odd function of t.

    In polar coordinates about the foot of the perpendicular, integrating by parts over the radius leaves
    ``pi w(h) - 2 t int_0^u w(r) / (z^2 + t^2) dz`` for t > 0, with r^2 = h^2 + t^2 + z^2 and u the half chord of the
    disc at t. Powers of r follow from each other: ``r^m / (z^2 + t^2) = r^(m-2) + h^2 r^(m-2) / (z^2 + t^2)``, which
    leaves integrals I_n at distance a, a^2 = h^2 + t^2, and two angles, of even and of odd powers of r. The even and
    odd parts of w(h) are their factors: ``pi w(h)`` is taken into the angles, and small t lose no digits.
    """
    radius, a2 = shells[RADIUS, j], h2 + t * t
    u, h = math.sqrt(max(0.0, radius * radius - a2)), math.sqrt(h2)
    even, odd, even_line, odd_line, line = 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(int(shells[POWERS, j]) - 2, 0, -2):
        odd = (m + 2.0) * shells[FIRST + m + 1, j] + h2 * odd
        odd_line = (odd + (m + 1.0) * a2 * odd_line) / m
        line = line * radius + odd_line
        even = (m + 1.0) * shells[FIRST + m, j] + h2 * even
        even_line = (even + m * a2 * even_line) / (m - 1.0)
        line = line * radius + even_line
    odd = 2.0 * shells[FIRST + 1, j] + h2 * odd
    even = shells[FIRST, j] + h2 * even
    log = math.log((u + radius) / math.sqrt(a2 + _TINY))
    angles = even * math.atan2(t, u) + h * odd * math.atan2(t * radius, h * u)
    return 2.0 * (angles - t * (u * line + (a2 * odd_line + odd) * log))
