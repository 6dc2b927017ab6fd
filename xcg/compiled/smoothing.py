"""Radial smoothing functions of a unit cutoff: value and gradient.

A kernel in k dimensions that is seen in m of them has codimension n = k - m: it is integrated over
n axes. With P(q) the profile (q = r / cutoff, zero for q >= 1),

    n = 0   P(q)
    n = 1   L1(q) = integral of P over a line at distance q
    n = 2   L2(q) = integral of P over a plane at distance q

and the same three hold for kernels of any k. Integrals along segments are in `xcg.compiled.lines`.

Lucy and Heaviside have formulas, and all other kernels, Gaussians among them, a table of
polynomials. A kind is the code of a kernel + its codimension. The kind of Lucy's kernel itself, in
codimension 0, is `LUCY_FULL`, the value None: the compiler knows None by its type, and leaves all
other kernels out of the loops that most scenes take, which then compile in half the time. In the
same way the table of kernels with formulas is `PLAIN`, the value None. (The compiler leaves out what
follows a test for None only where it gets None: so functions for tables begin with that
test.)
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, jit, leaf
from xcg.compiled.polynomials import AT_ONCE, lucy_line_slope, lucy_line_value, lucy_plane_value
from xcg.compiled.reach import padded

# codes of the kernels
LUCY = 0
HEAVISIDE = 3
TABLE = 6
LUCY_FULL = None
PLAIN = None  # in place of a table


class KernelCode(NamedTuple):
    """A kernel as loops take it, seen in some of its dimensions.

    Attributes
    ----------
    kind : int or None
        Code + codimension, or `LUCY_FULL`.
    table : (4, intervals, PIECE), or None
        Polynomials of a `TABLE`, see `tabulated`, its `SHELLS`, and the one that is `EVEN`; `PLAIN`
        for other kinds.
    norm : float
        Factor to the values.
    """

    kind: int | None
    table: NDArray | None
    norm: float


PIECE = 8  # coefficients of a piece of a table: a line of cache
# Of a table: shells of the value, or in codimension 1 those that its marginal takes
# (`xcg.compiled.polynomials`). Without any, lines are left to quadrature.
SHELLS = 2
# Of a table of codimension 0: number of coefficients of a polynomial of y = 2 q^2 - 1, and these,
# the highest power first, where the profile is such a polynomial to rounding; else 0.
EVEN = 3

# --- value and gradient ----------------------------------------------------------------------------------


@leaf
def value(kind, table, q2):
    """Value at squared distance q2 < 1 (cutoff 1, not normalised)."""
    if kind is LUCY_FULL:
        q = math.sqrt(q2)
        p = 1.0 - q
        return p * p * p * (1.0 + 3.0 * q)
    if table is PLAIN:
        return _plain_value(kind, q2)
    return tabulated(kind, table, 0, q2)


@inlined
def _plain_value(kind, q2):
    if kind == LUCY + 1:
        return lucy_line_value(q2)
    if kind == LUCY + 2:
        return 2.0 * math.pi * lucy_plane_value(q2)
    if kind == HEAVISIDE:
        return 1.0
    if kind == HEAVISIDE + 1:
        return 2.0 * math.sqrt(1.0 - q2)
    return math.pi * (1.0 - q2)  # HEAVISIDE + 2


@leaf
def gradient(kind, table, q2):
    """Return the derivative of the value by q, divided by q; the gradient is this times the vector r / c.

    Jumps at the cutoff are left out: zero for a Heaviside of codimension 0, the smooth part for a
    Gaussian.
    """
    if kind is LUCY_FULL:
        p = 1.0 - math.sqrt(q2)
        return -12.0 * p * p
    if table is PLAIN:
        return _plain_gradient(kind, q2)
    return tabulated(kind, table, 1, q2)


@inlined
def _plain_gradient(kind, q2):
    if kind == LUCY + 1:
        return lucy_line_slope(q2)
    if kind == LUCY + 2:
        return -2.0 * math.pi * value(LUCY_FULL, PLAIN, q2)
    if kind == HEAVISIDE:
        return 0.0
    if kind == HEAVISIDE + 1:
        return -2.0 / math.sqrt(1.0 - q2)
    return -2.0 * math.pi  # HEAVISIDE + 2


@inlined
def tabulated(kind, table, row, q2):
    """Value (row 0), or derivative divided by q (row 1). In codimension 1 both end like the chord, sqrt(1 - q^2)."""
    factor = interpolate(table, row, q2)
    if kind == TABLE + 1:
        factor *= math.sqrt(1.0 - q2)
    return factor


@inlined
def interpolate(table, row, q2):
    """Polynomials on equal intervals of q, highest power first; table (4, intervals, PIECE)."""
    if table is PLAIN:
        return 0.0
    x = math.sqrt(q2) * table.shape[1]
    k = np.uint64(min(x, table.shape[1] - 1.0))
    y = 2.0 * (x - k) - 1.0
    total = table[row, k, np.uint64(0)]
    for power in range(np.uint64(1), np.uint64(PIECE)):
        total = total * y + table[row, k, power]
    return total


# --- many nodes at once ----------------------------------------------------------------------------------


@inner
def fill_values(kind, table, norm, by_gradient, q2, count, out):
    """Write norm x value, or norm x gradient, at `count` squared distances, in loops that vectorise.

    At the rim rounding may leave a squared distance above 1, where the roots of chords are not
    numbers.
    """
    if by_gradient is not None:
        for k in range(count):
            out[k] = norm * gradient(kind, table, min(q2[k], 1.0))
    elif kind is LUCY_FULL:
        for k in range(padded(count)):
            q = math.sqrt(q2[k])
            p = 1.0 - q
            out[k] = norm * (p * p * p * (1.0 + 3.0 * q))
    elif kind == LUCY + 1:
        for k in range(padded(count)):
            out[k] = norm * lucy_line_value(min(q2[k], 1.0))
    elif kind == HEAVISIDE:
        for k in range(padded(count)):
            out[k] = norm
    elif kind == TABLE and _is_even(table):
        _fill_even(table, norm, q2, count, out)
    else:
        for k in range(count):
            out[k] = norm * value(kind, table, min(q2[k], 1.0))


@inlined
def _is_even(table):
    """Return whether a profile is one polynomial of the squared distance."""
    if table is PLAIN:
        return False
    return table[EVEN, 0, 0] > 0.0


@inner
def _fill_even(table, norm, q2, count, out):
    """Write norm x the polynomial of y = 2 q^2 - 1, which has no cancelling terms and no branch."""
    if table is PLAIN:
        return
    for k in range(padded(count)):
        out[k] = 0.0
    for last in range(AT_ONCE, int(table[EVEN, 0, 0]) + 1, AT_ONCE):
        a = norm * table[EVEN, (last - 3) // PIECE, (last - 3) % PIECE]
        b = norm * table[EVEN, (last - 2) // PIECE, (last - 2) % PIECE]
        c = norm * table[EVEN, (last - 1) // PIECE, (last - 1) % PIECE]
        d = norm * table[EVEN, last // PIECE, last % PIECE]
        for k in range(padded(count)):
            y = 2.0 * min(q2[k], 1.0) - 1.0
            out[k] = (((out[k] * y + a) * y + b) * y + c) * y + d


@inner
def _at(kind, table, r2):
    """Value at any squared distance, zero from 1 on; Lucy's in the precision of `r2` and without a branch."""
    if kind is LUCY_FULL:
        q = np.sqrt(min(np.float32(1.0), max(np.float32(0.0), r2)))
        p = np.float32(1.0) - q
        return p * p * p * (np.float32(1.0) + np.float32(3.0) * q)
    if r2 < 1.0:
        return value(kind, table, max(0.0, r2))
    return 0.0


@leaf
def fill_gauss(kind, table, points, weights, length, along, q2, count, out):
    """Write the mean of the value over segments, by a rule of Gauss-Legendre, seen from `count` nodes.

    A node lies at squared distance q2 from the start of its segment, and its foot at `along` from
    there. The precision is that of the arrays. Points lie in pairs of one weight about the middle.
    """
    real = out.dtype.type
    two = out.dtype.type(2.0)
    last = points.size - 1
    room = count
    if kind is LUCY_FULL:
        room = padded(count)
    if points.size == 4:  # what most contacts take: all roots take turns in one loop
        u0 = real(points[0] * length)
        u1 = real(points[1] * length)
        u2 = real(points[2] * length)
        u3 = real(points[3] * length)
        w = real(weights[0])
        w1 = real(weights[1])
        for k in range(room):
            r2 = q2[k]
            t = along[k]
            a, b = r2 + u0 * (u0 - two * t), r2 + u3 * (u3 - two * t)
            c = r2 + u1 * (u1 - two * t)
            d = r2 + u2 * (u2 - two * t)
            outer = _at(kind, table, a) + _at(kind, table, b)
            out[k] = w * outer + w1 * (_at(kind, table, c) + _at(kind, table, d))
    else:
        for k in range(room):
            out[k] = real(0.0)
        for g in range((points.size + 1) // 2):
            u = real(points[g] * length)
            v = real(points[last - g] * length)
            weight = weights[g]
            if g == last - g:  # the middle one is its own partner
                weight *= 0.5
            w = real(weight)
            for k in range(room):
                a = q2[k] + u * (u - two * along[k])
                b = q2[k] + v * (v - two * along[k])
                out[k] += w * (_at(kind, table, a) + _at(kind, table, b))


# --- arrays of points ------------------------------------------------------------------------------------


@leaf
def _fill_sample(kind, table, q, derivative, out):
    for i in range(q.size):
        out[i] = 0.0
        if q[i] < 1.0:
            if derivative is None:
                out[i] = value(kind, table, q[i] * q[i])
            else:
                out[i] = q[i] * gradient(kind, table, q[i] * q[i])


def sample(kind: int | None, table: NDArray | None, q: NDArray, *, derivative: bool) -> NDArray:
    """Values, or derivatives with respect to q, at distances q (n,); zero at and beyond the cutoff."""
    out = np.empty(q.size)
    # None leaves code out
    _fill_sample(kind, table, q, True if derivative else None, out)
    return out


@jit
def weighted_means(kind, table, values, point, radius):
    """Means of values (m, k) of cells, weighted by the kernel about points (n, 2).

    Points are in cells, with the first centre at zero; `radius` is the cutoff in cells. Cells of
    only one row have one axis, and points are at zero on the other.
    """
    out = np.zeros(len(point))
    for n in range(len(point)):
        x, y = point[n, 0], point[n, 1]
        total = 0.0
        for i in range(
            max(0, math.ceil(x - radius)), min(values.shape[0] - 1, math.floor(x + radius)) + 1
        ):
            half = math.sqrt(max(0.0, radius * radius - (i - x) * (i - x)))
            for j in range(
                max(0, math.ceil(y - half)), min(values.shape[1] - 1, math.floor(y + half)) + 1
            ):
                q2 = ((i - x) * (i - x) + (j - y) * (j - y)) / (radius * radius)
                if q2 < 1.0:
                    weight = value(kind, table, q2)
                    total += weight
                    out[n] += weight * values[i, j]
        out[n] /= total
    return out
