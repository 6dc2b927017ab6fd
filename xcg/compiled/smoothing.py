"""Radial smoothing functions of a unit cutoff: value, gradient and integral along a segment.

A kernel in k dimensions that is seen in m of them has codimension n = k - m: it is integrated over n axes. With
P(q) the profile (q = r / cutoff, zero for q >= 1),

    n = 0   P(q)
    n = 1   L1(q) = integral of P over a line at distance q
    n = 2   L2(q) = integral of P over a plane at distance q

and the same three hold for kernels of any k. A segment at distance h from a point, running from t0 to t1 along
its own line, contributes the integral of the value at sqrt(h^2 + t^2) over t.

Powers of q integrate to polynomials and logarithms: for Lucy see `_lucy_line` and `_lucy_plane`.

A kind is one of these, the code of a kernel + its codimension. The kind of Lucy's kernel itself, in codimension 0, is
`LUCY_FULL`, which is None: the compiler tells None from a number by its type, and leaves all other kernels out of the
loops that most scenes take, which then compile in half the time. In the same way the table of most kernels is `PLAIN`,
which is None: nothing is compiled for them of a Gaussian whose value at the cutoff is taken off, which has any array
for a table, nor of registered kernels, whose spread is `TABULATED`, also None. (The compiler leaves out what follows a
test for None only where an argument is None: so functions for tables begin with a test of their own.)
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, jit, leaf
from xcg.compiled.arrays import gauss_rules
from xcg.compiled.elementary import add_logarithms, erf, erfcx, exp, expm1
from xcg.compiled.reach import padded
from xcg.compiled.shells import RADIUS, along_marginal, along_shells, fill_shells

# codes of the kernels
LUCY, GAUSSIAN, HEAVISIDE, TABLE = 0, 3, 6, 9
LUCY_FULL = None
PLAIN = None  # in place of a table
TABULATED = None  # in place of a spread


class KernelCode(NamedTuple):
    """A kernel as loops take it, seen in some of its dimensions.

    Attributes
    ----------
    kind : int or None
        Code + codimension, or `LUCY_FULL`.
    spread : float or None
        Width over cutoff, which a Gaussian needs; `TABULATED` for a `TABLE`.
    table : (3, intervals, PIECE), or None
        Polynomials of a `TABLE`, see `_tabulated`, and its `SHELLS`; any array for a shifted Gaussian; `PLAIN` for
        other kinds.
    norm : float
        Factor to the values.
    """

    kind: int | None
    spread: float | None
    table: NDArray | None
    norm: float


class CellKernel(NamedTuple):
    """A kernel as loops over cells take it: as `KernelCode`, and integrated over one and over two more axes.

    The last two are any kernels where so many axes are not left. `rims` are the radii over the cutoff, rising, at
    which it is not smooth; the last is that of its support.
    """

    kind: int | None
    spread: float | None
    table: NDArray | None
    norm: float
    rims: NDArray
    once: KernelCode
    twice: KernelCode


PIECE = 8  # coefficients of a piece of a table: a line of cache
# Of a table: shells of the value, or in codimension 1 those that its marginal takes (`xcg.compiled.shells`). Without
# any, lines are left to quadrature.
SHELLS = 2
_POWERS = tuple(np.uint64(k) for k in range(PIECE))
_FEW, _MANY = 24, 48  # points of a line integral on one side of a node, for short branches and others
_LINE_POINTS, _LINE_WEIGHTS = gauss_rules(_FEW, _MANY)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
_SQRT2 = math.sqrt(2.0)
_SQRT_PI_2 = math.sqrt(math.pi / 2)
_TINY = 1e-290  # keeps the logarithm finite on the segment itself, where its factor h^4 is zero

# --- Lucy: P = 1 - 6 q^2 + 8 q^3 - 3 q^4 = (1 - q)^3 (1 + 3 q) -------------------------------------------


@inner
def _log_term(h2, t):
    """Inverse hyperbolic sine of t / h, and zero on the line itself, where its factor h^2 or h^4 vanishes."""
    return 0.0 if h2 < 1e-280 else math.log((t + math.sqrt(h2 + t * t)) / math.sqrt(h2))


@inner
def _lucy_line(h2, t):
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
def _lucy_line_value(q2, by_gradient):
    """L1(q), or its derivative divided by q."""
    half2 = 1.0 - q2
    half = math.sqrt(half2)
    if q2 < _RIM:
        if by_gradient:
            return -24.0 * (half * (q2 + half2 / 3.0) - q2 * _log_term(q2, half))
        return 2.0 * _lucy_line(q2, half)
    total = 0.0
    for g in range(_RIM_NODES.size):
        t = 0.5 * (1.0 + _RIM_NODES[g])
        rest = half2 * (1.0 - t * t)  # 1 - r^2
        r = math.sqrt(1.0 - rest)
        p = rest / (1.0 + r)
        total += _RIM_WEIGHTS[g] * (-12.0 * p * p if by_gradient else p * p * p * (1.0 + 3.0 * r))
    return half * total


@inner
def _lucy_plane_value(q2):
    """L2(q) / 2 pi = integral of P(r) r over q < r < 1."""
    q = math.sqrt(q2)
    square = (1.0 - q) * (1.0 - q)  # its square is what the compiler makes of the fourth power, and Python does not
    return square * square * (0.1 + 0.4 * q + 0.5 * q2)


@inner
def _lucy_plane(h2, t):
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
    return math.pi * _lucy_plane_value(h2) - 2.0 * (angles + t * (even - 1.6 * odd))


# --- the shifted Gaussian: P = exp(-q^2 / 2 s^2) - exp(-1 / 2 s^2), with s the spread ------------------------

_SERIES = 25  # terms that reach rounding for arguments up to 1


@inlined
def _above_edge(per_s2, q2):
    """P of the spread s, with per_s2 = 1 / s^2: a product, as a difference has no digits close to the rim."""
    return -exp(-0.5 * per_s2 * q2) * expm1(-0.5 * per_s2 * (1.0 - q2))


@inlined
def _along_line(per_s2, q2):
    """Integral of the Gaussian, without its value at the cutoff taken off, over a line at squared distance q2."""
    half = math.sqrt(0.5 * per_s2 * max(0.0, 1.0 - q2))
    return 2.0 * _SQRT_PI_2 / math.sqrt(per_s2) * erf(half) * exp(-0.5 * per_s2 * q2)


@inner
def _shifted_value(kind, spread, q2):
    """L1 or L2, each with its last digits up to the rim: series take the place of differences that cancel there."""
    s2 = spread * spread
    y = 0.5 * (1.0 - q2) / s2
    edge = exp(-0.5 / s2)
    if kind == GAUSSIAN + 1:
        x = math.sqrt(y)
        total = _SQRT_PI_2 * exp(-0.5 * q2 / s2) * erf(x) - _SQRT2 * x * edge
        if y < 1.0:  # sqrt(pi) exp(x^2) erf(x) = 2 x sum (2 x^2)^n / (2 n + 1)!!, less its first term
            term, total = _SQRT2 * x * edge, 0.0
            for n in range(1, _SERIES):
                term *= 2.0 * y / (2.0 * n + 1.0)
                total += term
        return 2.0 * spread * total
    total = exp(-0.5 * q2 / s2) - edge * (1.0 + y)
    if y < 1.0:  # the series of exp, less its first two terms
        term, total = edge * y, 0.0
        for n in range(2, _SERIES):
            term *= y / n
            total += term
    return 2.0 * math.pi * s2 * total


@inner
def _shifted_gradient(kind, spread, q2):
    """As `gradient`: exact up to the rim, where the value ends at zero and its slope jumps in codimension 0."""
    per_s2 = 1.0 / (spread * spread)
    if kind == GAUSSIAN + 2:
        return -2.0 * math.pi * _above_edge(per_s2, q2)
    return -per_s2 * (exp(-0.5 * per_s2 * q2) if kind == GAUSSIAN else _along_line(per_s2, q2))


# --- value and gradient ----------------------------------------------------------------------------------


@leaf
def value(kind, spread, table, q2):
    """Value at squared distance q2 < 1 (cutoff 1, not normalised); `spread` is w / c of the Gaussian."""
    if kind is LUCY_FULL:
        q = math.sqrt(q2)
        p = 1.0 - q
        return p * p * p * (1.0 + 3.0 * q)
    if spread is TABULATED:
        return _tabulated(kind, table, 0, q2)
    if table is not PLAIN:
        if kind == GAUSSIAN:
            return _above_edge(1.0 / (spread * spread), q2)
        return _shifted_value(kind, spread, q2)
    per_s2 = 1.0 / (spread * spread)
    if kind == LUCY + 1:
        return _lucy_line_value(q2, False)
    if kind == LUCY + 2:
        return 2.0 * math.pi * _lucy_plane_value(q2)
    if kind == GAUSSIAN:
        return exp(-0.5 * per_s2 * q2)
    if kind == GAUSSIAN + 1:
        return _along_line(per_s2, q2)
    if kind == GAUSSIAN + 2:
        return 2.0 * math.pi * spread * spread * _above_edge(per_s2, q2)
    if kind == HEAVISIDE:
        return 1.0
    if kind == HEAVISIDE + 1:
        return 2.0 * math.sqrt(1.0 - q2)
    return math.pi * (1.0 - q2)  # HEAVISIDE + 2


@leaf
def gradient(kind, spread, table, q2):
    """Return the derivative of the value by q, divided by q; the gradient is this times the vector r / c.

    Jumps at the cutoff are left out: zero for a Heaviside of codimension 0, the smooth part for a Gaussian.
    """
    if kind is LUCY_FULL:
        p = 1.0 - math.sqrt(q2)
        return -12.0 * p * p
    if spread is TABULATED:
        return _tabulated(kind, table, 1, q2)
    if table is not PLAIN:
        return _shifted_gradient(kind, spread, q2)
    if kind == LUCY + 1:
        return _lucy_line_value(q2, True)
    if kind == LUCY + 2:
        return -2.0 * math.pi * value(LUCY_FULL, spread, table, q2)
    if kind in (GAUSSIAN, GAUSSIAN + 1):
        return -value(kind, spread, table, q2) / (spread * spread)
    if kind == GAUSSIAN + 2:
        return -2.0 * math.pi * exp(-0.5 * q2 / (spread * spread))
    if kind == HEAVISIDE:
        return 0.0
    if kind == HEAVISIDE + 1:
        return -2.0 / math.sqrt(1.0 - q2)
    return -2.0 * math.pi  # HEAVISIDE + 2


@inlined
def _tabulated(kind, table, row, q2):
    """Value (row 0), or derivative divided by q (row 1). In codimension 1 both end like the chord, sqrt(1 - q^2)."""
    found = _interpolate(table, row, q2)
    return math.sqrt(1.0 - q2) * found if kind == TABLE + 1 else found


@inlined
def _interpolate(table, row, q2):
    """Polynomials on equal intervals of q, highest power first; table (3, intervals, PIECE)."""
    if table is PLAIN:
        return 0.0
    x = math.sqrt(q2) * table.shape[1]
    k = np.uint64(min(x, table.shape[1] - 1.0))
    y = 2.0 * (x - k) - 1.0
    total = table[row, k, _POWERS[0]]
    total = total * y + table[row, k, _POWERS[1]]
    total = total * y + table[row, k, _POWERS[2]]
    total = total * y + table[row, k, _POWERS[3]]
    total = total * y + table[row, k, _POWERS[4]]
    total = total * y + table[row, k, _POWERS[5]]
    total = total * y + table[row, k, _POWERS[6]]
    return total * y + table[row, k, _POWERS[7]]


# --- integral along a segment ----------------------------------------------------------------------------


@inlined
def has_shells(table):
    """Whether lines through the kernel of a table have the closed form of shells."""
    return table[SHELLS, RADIUS, 0] > 0.0


@inner
def _antiderivative(kind, spread, table, h2, t):
    """Integral of the value over 0 < s < t along a line at distance h, for 0 <= t <= sqrt(1 - h^2)."""
    if kind is LUCY_FULL:
        return _lucy_line(h2, t)
    if kind == LUCY + 1:
        return _lucy_plane(h2, t)
    if kind == LUCY + 2:  # seen in one dimension, where every line runs through the point: h = 0
        t2 = t * t
        return 2.0 * math.pi * t * (0.1 + t2 * (-1.0 / 6.0 + t2 * (0.3 - 4.0 / 15.0 * t + t2 / 14.0)))
    if kind == HEAVISIDE + 1:
        half2 = 1.0 - h2
        return t * math.sqrt(max(0.0, half2 - t * t)) + half2 * math.atan2(t, math.sqrt(max(0.0, half2 - t * t)))
    bell, flat, cube = _parts_of_line(kind, spread, table)
    if bell > 0.0:
        bell *= spread * _SQRT_PI_2 * erf(t / (_SQRT2 * spread)) * exp(-0.5 * h2 / (spread * spread))
    return bell + flat * t + cube * t * t * t


@inlined
def _parts_of_line(kind, spread, table):
    """Factors of the Gaussian, of 1 and of 3 t^2 in the value along a line at distance t from its foot.

    For a Gaussian or Heaviside of codimension 0, or of codimension 2, which is seen in one dimension, where every line
    runs through the point.
    """
    s2 = spread * spread
    edge = exp(-0.5 / s2)
    if kind == GAUSSIAN:
        return 1.0, 0.0 if table is PLAIN else -edge, 0.0
    if kind == GAUSSIAN + 2:
        disc = 0.0 if table is PLAIN else math.pi * edge
        return 2.0 * math.pi * s2, -2.0 * math.pi * s2 * edge - disc, disc / 3.0
    if kind == HEAVISIDE:
        return 0.0, 1.0, 0.0
    return 0.0, math.pi, -math.pi / 3.0  # HEAVISIDE + 2


@inner
def _quadrature(kind, spread, table, h2, t0, t1):
    """Gauss-Legendre over the angle along the chord, which takes the root at its end out of the integrand."""
    half = math.sqrt(1.0 - h2)
    a0, a1 = math.asin(max(-1.0, t0 / half)), math.asin(min(1.0, t1 / half))
    total = 0.0
    for lower, upper in ((a0, min(a1, 0.0)), (max(a0, 0.0), a1)):
        if upper > lower:
            mean, span = 0.5 * (upper + lower), 0.5 * (upper - lower)
            for g in range(_NODES.size):
                angle = mean + span * _NODES[g]
                t = half * math.sin(angle)
                q2 = min(h2 + t * t, 1.0)
                total += span * _WEIGHTS[g] * half * math.cos(angle) * value(kind, spread, table, q2)
    return total


@inner
def _tabulated_segment(kind, table, h2, t0, t1):
    if table is PLAIN:
        return 0.0
    if not has_shells(table):
        return _quadrature(kind, TABULATED, table, h2, t0, t1)
    if kind == TABLE + 1:
        return along_marginal(table[SHELLS], h2, t0, t1)
    return along_shells(table[SHELLS], h2, t0, t1)


@leaf
def segment(kind, spread, table, h2, t0, t1):
    """Integral of the value along a line at distance h from t0 to t1 (h^2 < 1, t0 < t1), exact to rounding."""
    half = math.sqrt(1.0 - h2)
    t0, t1 = max(t0, -half), min(t1, half)
    if t1 <= t0:
        return 0.0
    if spread is TABULATED:
        return _tabulated_segment(kind, table, h2, t0, t1)
    if kind is not LUCY_FULL and kind == GAUSSIAN + 1:
        return _quadrature(kind, spread, table, h2, t0, t1)
    lower = _antiderivative(kind, spread, table, h2, abs(t0))
    upper = _antiderivative(kind, spread, table, h2, abs(t1))
    return (upper if t1 >= 0.0 else -upper) - (lower if t0 >= 0.0 else -lower)


# --- many nodes at once ----------------------------------------------------------------------------------


@inner
def fill_values(kind, spread, table, norm, by_gradient, q2, count, out):
    """Write norm x value, or gradient unless that is None, at `count` squared distances, in loops that vectorise.

    At the rim rounding may leave a squared distance above 1, where the roots of chords are not numbers.
    """
    if by_gradient is not None:
        for k in range(count):
            out[k] = norm * gradient(kind, spread, table, min(q2[k], 1.0))
    elif kind is LUCY_FULL:
        for k in range(padded(count)):
            q = math.sqrt(q2[k])
            p = 1.0 - q
            out[k] = norm * (p * p * p * (1.0 + 3.0 * q))
    elif spread is TABULATED:
        for k in range(count):
            out[k] = norm * _tabulated(kind, table, 0, min(q2[k], 1.0))
    elif kind == GAUSSIAN:
        per_s2 = 1.0 / (spread * spread)
        for k in range(padded(count)):
            out[k] = norm * (exp(-0.5 * per_s2 * q2[k]) if table is PLAIN else _above_edge(per_s2, q2[k]))
    elif kind == HEAVISIDE:
        for k in range(padded(count)):
            out[k] = norm
    else:
        for k in range(count):
            out[k] = norm * value(kind, spread, table, min(q2[k], 1.0))


@inner
def _at(kind, spread, table, r2):
    """Value at any squared distance, zero from 1 on; Lucy's in the precision of `r2` and without a branch."""
    if kind is LUCY_FULL:
        q = np.sqrt(min(np.float32(1.0), max(np.float32(0.0), r2)))
        p = np.float32(1.0) - q
        return p * p * p * (np.float32(1.0) + np.float32(3.0) * q)
    return value(kind, spread, table, max(0.0, r2)) if r2 < 1.0 else 0.0


@leaf
def fill_gauss(kind, spread, table, points, weights, order, length, along, q2, count, out):
    """Write the mean of the value over segments, by Gauss-Legendre, seen from `count` nodes.

    A node lies at squared distance q2 from the start of its segment, and its foot at `along` from there. The
    precision is that of the arrays. Points lie in pairs of one weight about the middle.
    """
    real, two, last = out.dtype.type, out.dtype.type(2.0), order - 1
    room = padded(count) if kind is LUCY_FULL else count
    if order == 4:  # what most contacts take: all roots take turns in one loop
        u0, u1 = real(points[4, 0] * length), real(points[4, 1] * length)
        u2, u3 = real(points[4, 2] * length), real(points[4, 3] * length)
        w, w1 = real(weights[4, 0]), real(weights[4, 1])
        for k in range(room):
            r2, t = q2[k], along[k]
            a, b = r2 + u0 * (u0 - two * t), r2 + u3 * (u3 - two * t)
            c, d = r2 + u1 * (u1 - two * t), r2 + u2 * (u2 - two * t)
            outer = _at(kind, spread, table, a) + _at(kind, spread, table, b)
            out[k] = w * outer + w1 * (_at(kind, spread, table, c) + _at(kind, spread, table, d))
    else:
        for k in range(room):
            out[k] = real(0.0)
        for g in range((order + 1) // 2):
            u, v = real(points[order, g] * length), real(points[order, last - g] * length)
            w = real(weights[order, g] * (0.5 if g == last - g else 1.0))  # the middle one is its own partner
            for k in range(room):
                a, b = q2[k] + u * (u - two * along[k]), q2[k] + v * (v - two * along[k])
                out[k] += w * (_at(kind, spread, table, a) + _at(kind, spread, table, b))


@leaf
def fill_segments(kind, spread, table, length, along, q2, count, out, ratio, bits, exponent, rows):
    """Write the mean of the value over segments, in closed form, seen from `count` nodes.

    `ratio` and `bits` are scratch, the same memory as floats and as integers, `exponent` (integers), and `rows`, see
    `xcg.compiled.shells`.
    """
    if kind is LUCY_FULL:
        _fill_lucy_lines(1.0 / length, length, along, q2, count, out, ratio, bits, exponent)
    elif spread is TABULATED:
        _fill_tabulated(kind, table, length, along, q2, count, out, ratio, bits, exponent, rows)
    elif kind == GAUSSIAN + 1:
        _fill_quadrature(kind, spread, table, 1.0 / length, length, along, q2, count, out, ratio)
    elif kind >= GAUSSIAN and kind != HEAVISIDE + 1:
        _fill_chords(kind, spread, table, 1.0 / length, length, along, q2, count, out)
    else:
        _fill_one_by_one(kind, spread, table, length, along, q2, count, out)


@inner
def _fill_tabulated(kind, table, length, along, q2, count, out, ratio, bits, exponent, rows):
    if table is PLAIN:
        return
    if not has_shells(table):
        _fill_quadrature(kind, TABULATED, table, 1.0 / length, length, along, q2, count, out, ratio)
    elif kind == TABLE + 1:
        _fill_one_by_one(kind, TABULATED, table, length, along, q2, count, out)
    else:
        fill_shells(table[SHELLS], 1.0 / length, length, along, q2, count, out, ratio, bits, exponent, rows)


@inner
def _fill_one_by_one(kind, spread, table, length, along, q2, count, out):
    for k in range(count):
        h2 = max(0.0, q2[k] - along[k] * along[k])
        out[k] = 0.0
        if h2 < 1.0:
            out[k] = segment(kind, spread, table, h2, -along[k], length - along[k]) / length


@inner
def _fill_chords(kind, spread, table, per_length, length, along, q2, count, out):
    """As `_antiderivative` at both ends of the clipped segment, for kinds of `_parts_of_line`.

    Differences of error functions are those of their complements, which keep their digits far out.
    """
    bell, flat, cube = _parts_of_line(kind, spread, table)
    per_2s2 = 0.5 / (spread * spread)
    root, bell = math.sqrt(per_2s2), bell * spread * _SQRT_PI_2
    for k in range(padded(count)):
        a, b, _ = _clipped(q2[k], along[k], length)
        out[k] = per_length * (flat * (b - a) + cube * (b * b * b - a * a * a))
    if bell > 0.0:
        bell *= per_length
        for k in range(padded(count)):
            a, b, h2 = _clipped(q2[k], along[k], length)
            a, b = -min(b, -a), max(b, -a)  # mirrored where more of it lies before the foot: now b >= 0
            from_a = exp(-per_2s2 * (h2 + a * a)) * erfcx(root * abs(a))
            from_b = exp(-per_2s2 * (h2 + b * b)) * erfcx(root * b)
            if a < 0.0:
                from_a = 2.0 * exp(-per_2s2 * h2) - from_a
            out[k] += bell * (from_a - from_b)


@inner
def _fill_quadrature(kind, spread, table, per_length, length, along, q2, count, out, last):
    """As `_quadrature`, over t = h' 2 v / (1 + v^2) with h' half of the chord, node by node in loops that vectorise.

    `along` and `q2` are overwritten, and `last` is scratch. Points crowd about the foot of the node, where a kernel may
    have a cusp, on either side of it; a Gaussian on a short branch takes one side from end to end.
    """
    if spread is TABULATED:
        short, first, end = length <= 0.7, 1, 3
    else:
        short = length <= min(0.7, 2.1 * spread)
        first, end = (0, 1) if short else (1, 3)
        per_s2 = 1.0 / (spread * spread)
        edge = 0.0 if table is PLAIN else 2.0 * exp(-0.5 * per_s2)
    order = _FEW if short else _MANY
    for k in range(padded(count)):
        a, b, h2 = _clipped(q2[k], along[k], length)
        half2 = max(0.0, 1.0 - h2)
        half = math.sqrt(half2)
        a, b = min(a, half), min(b, half)
        along[k] = a / (half + math.sqrt(max(0.0, half2 - a * a)) + _TINY)
        last[k] = b / (half + math.sqrt(max(0.0, half2 - b * b)) + _TINY)
        q2[k], out[k] = h2, 0.0
    for side in range(first, end):
        for g in range(order):
            x, weight = _LINE_POINTS[order, g], 2.0 * per_length * _LINE_WEIGHTS[order, g]
            if side:
                x, weight = x * x, 2.0 * x * weight
            if spread is TABULATED:
                for k in range(count):
                    r2, half, share = _crossing(along[k], last[k], q2[k], x, side)
                    out[k] += weight * share * (half if kind == TABLE + 1 else 1.0) * _interpolate(table, 0, r2)
            else:
                for k in range(padded(count)):
                    r2, half, share = _crossing(along[k], last[k], q2[k], x, side)
                    out[k] += weight * share * (_along_line(per_s2, r2) - edge * half)


@inlined
def _crossing(first, last, h2, x, side):
    """Where a line is at a share x of its way: squared distance, half of the chord across there, and its weight.

    The way is from end to end, or, of what lies before (side 1) or behind the foot (side 2), away from the foot.
    """
    if side == 1:
        first, last = max(0.0, first), max(0.0, last)
    elif side == 2:
        first, last = max(0.0, -last), max(0.0, -first)
    half, v = math.sqrt(max(0.0, 1.0 - h2)), first + x * (last - first)
    turn = 1.0 / (1.0 + v * v)
    t, across = 2.0 * half * v * turn, half * (1.0 - v * v) * turn
    return min(1.0, h2 + t * t), across, (last - first) * across * turn


@inlined
def _clipped(q2, along, length):
    """Where a segment begins and ends within the support, from the foot of a node, and the foot's squared distance."""
    h2 = max(0.0, q2 - along * along)
    half = math.sqrt(max(0.0, 1.0 - h2))
    begin = max(-along, -half)
    return begin, max(begin, min(length - along, half)), h2


@inner
def _fill_lucy_lines(per_length, length, along, q2, count, out, ratio, bits, exponent):
    """As `_lucy_line` at both ends of the clipped segment, in loops that vectorise.

    The two logarithms are one: for ends at distances r0, r1 from the node and l from each other, asinh(t1 / h) -
    asinh(t0 / h) = log((r0 + r1 + l) / (r0 + r1 - l)).
    """
    room = padded(count)
    for k in range(room):
        a, b, h2 = _clipped(q2[k], along[k], length)
        a2, b2 = a * a, b * b
        r0, r1 = math.sqrt(h2 + a2), math.sqrt(h2 + b2)
        h4 = h2 * h2
        # P with r^2 = h^2 + t^2, even powers first
        c0, c2 = 1.0 - 6.0 * h2 - 3.0 * h4, -2.0 - 2.0 * h2
        even = b * (c0 + b2 * (c2 - 0.6 * b2)) - a * (c0 + a2 * (c2 - 0.6 * a2))
        odd = b * r1 * (2.0 * b2 + 5.0 * h2) - a * r0 * (2.0 * a2 + 5.0 * h2)
        out[k] = per_length * (even + odd)
        both, apart = r0 + r1, b - a
        ratio[k] = (both + apart + _TINY) / (max(0.0, both - apart) + _TINY)
        q2[k] = 3.0 * per_length * h4
    add_logarithms(ratio, bits, exponent, q2, room, out)


# --- arrays of points ------------------------------------------------------------------------------------


@jit
def sample(kind, spread, table, q, derivative):
    """Values, or derivatives with respect to q, at distances q (n,); zero at and beyond the cutoff."""
    out = np.zeros(q.size)
    for i in range(q.size):
        if q[i] < 1.0:
            if derivative:
                out[i] = q[i] * gradient(kind, spread, table, q[i] * q[i])
            else:
                out[i] = value(kind, spread, table, q[i] * q[i])
    return out
