"""Means of the kernel over the cells of a mesh: the share of a grain in the volume around a node.

A cell is a box about its node. The mean of the kernel over it, ``(1 / V) int Psi(x - o) do``, is a kernel of its own,
so that sums with it work as for any kernel, counts and squares of weights included.

Along the last of the axes that have an extent the integral is the closed form of a line. Along the others it is by
Gauss-Legendre points within the part of the cell that the support reaches: over the angle along the chord, which takes
the root at its end out of the integrand, and on either side of the grain's centre, where the kernel may have a cusp.
Kernels that are not smooth at radii within the support, their *rims*, take points between each two of them. Weights of
these points are positive.

Lengths are in units of the cutoff and relative to the first node.
"""

import math
from typing import NamedTuple

from xcg.compiled._jit import inner
from xcg.compiled.arrays import gauss_rules
from xcg.compiled.lines import segment
from xcg.compiled.reach import OF_Y, OF_Y2, OF_Z, OF_Z2, Rows
from xcg.compiled.smoothing import value

# Gauss-Legendre points for a part of no length, and more for one from rim to rim: errors are in docs/evaluation.md
FEWEST, PER_RIM = 3, 5
_POINTS, _WEIGHTS = gauss_rules(*range(1, FEWEST + PER_RIM + 1))


class Volumes(NamedTuple):
    """Nodes of a mesh and the cells around them.

    Attributes
    ----------
    rows : Rows
        The nodes.
    half : tuple of float
        Half of the cell's extent along each axis; 0 along axes that are not resolved.
    order : tuple of int
        The axes, those without an extent first.
    """

    rows: Rows
    half: tuple[float, float, float]
    order: tuple[int, int, int]


@inner
def _list_points(place, half, inner2, outer2, apart, values, at, weight):
    """Write points, and weights, of the integral over an interval about a place, between two squared distances from 0.

    The number of points rises with the length, over the root of how far apart two rims are, as there is less to follow
    between close ones. An interval without an extent is one point. Returns the number of points.
    """
    if half == 0.0:
        values[at, 0], values[weight, 0] = place, 1.0
        return 1 if inner2 <= place * place < outer2 else 0
    nearest, radius, count = math.sqrt(inner2), math.sqrt(outer2), 0
    lowest, highest = max(place - half, -radius), min(place + half, radius)
    for low, high in ((lowest, min(highest, -nearest)), (max(lowest, nearest), highest)):
        if low < high:
            many = FEWEST + math.ceil(PER_RIM * min(1.0, (high - low) / math.sqrt(apart)))
            first = math.asin(low / radius)
            turn = math.asin(high / radius) - first
            for k in range(many):
                angle = first + turn * _POINTS[many, k]
                values[at, count] = radius * math.sin(angle)
                values[weight, count] = _WEIGHTS[many, k] * turn * radius * math.cos(angle)
                count += 1
    return count


@inner
def _integrals_along(q2, place, half, step, node, many, kind, spread, table, factor, out, first):
    """Add to `many` nodes along an axis, from one on, the integral of the kernel over the extent of each."""
    for k in range(many):
        middle = place - (node + k) * step  # the same bits whichever block the nodes are in
        if half > 0.0:
            out[first + k] += factor * segment(kind, spread, table, q2, middle - half, middle + half)
        elif q2 + middle * middle < 1.0:
            out[first + k] += factor * value(kind, spread, table, q2 + middle * middle)


@inner
def _add_columns(
    da, half_a, db, half_b, dc, half_c, step, node, many, kind, spread, table, rims, norm, values, out, at
):
    """Add the integral of the kernel over the cells of `many` nodes of a row along the last axis."""
    nearest = 0.0
    for farthest in rims:
        apart = farthest - nearest
        for i in range(_list_points(da, half_a, nearest * nearest, farthest * farthest, apart, values, OF_Y, OF_Y2)):
            across2, inner, inner2 = values[OF_Y, i] * values[OF_Y, i], 0.0, 0.0
            for rim in rims:
                outer2 = rim * rim - across2
                if outer2 > 0.0:
                    for j in range(_list_points(db, half_b, inner2, outer2, rim - inner, values, OF_Z, OF_Z2)):
                        q2 = across2 + values[OF_Z, j] * values[OF_Z, j]
                        here = norm * values[OF_Y2, i] * values[OF_Z2, j]
                        if q2 < 1.0:
                            _integrals_along(q2, dc, half_c, step, node, many, kind, spread, table, here, out, at)
                    inner2 = outer2
                inner = rim
        nearest = farthest


@inner
def integrate_row(da, db, dc, node, many, share, volumes, kernel, values, out, first):
    """Add a share of the mean of the kernel over the cells of `many` nodes of a row along the last axis.

    A point minus the first of them, number `node` along that axis, is (da, db, dc - node x step), in the order of the
    axes. Where cells cover the whole support along an axis, the marginal takes the place of points there.
    """
    kind, spread, table, norm, rims, once, twice, _ = kernel
    norm *= share
    (a, b, c), half = volumes.order, volumes.half
    half_a, half_b, half_c, step, covered = half[a], half[b], half[c], volumes.rows.steps[c], 0
    for k in range(3):
        if half[k] > 0.0:
            norm /= 2.0 * half[k]
    if abs(da) + 1.0 <= half_a:
        da, half_a, covered = 0.0, 0.0, 1
    if abs(db) + 1.0 <= half_b:
        db, half_b, covered = 0.0, 0.0, covered + 1
    cells = da, half_a, db, half_b, dc, half_c, step, node, many
    if covered == 0:
        _add_columns(*cells, kind, spread, table, rims, norm, values, out, first)
    elif covered == 1:
        _add_columns(*cells, once.kind, spread, once.table, rims, norm, values, out, first)
    else:
        _add_columns(*cells, twice.kind, spread, twice.table, rims, norm, values, out, first)
