"""Sums over segments: every contact adds force times branch, smeared along the branch, to the nodes it reaches.

Lengths are in units of the cutoff and relative to the first node. The weight of a node is the mean of the kernel
over the segment, ``S = int_0^1 Psi(r - start + u a) du`` with the segment running from `start` to ``start - a``. It
comes from the closed form, or from the fewest Gauss-Legendre points that meet the asked accuracy for a branch of
that length.
"""

import math

import numpy as np

from xcg.kernels._jit import jit
from xcg.kernels.deposit import images, node_range
from xcg.kernels.weights import segment, value

MAX_ORDER = 6
GAUSS_POINTS = np.zeros((MAX_ORDER + 1, MAX_ORDER))
GAUSS_WEIGHTS = np.zeros((MAX_ORDER + 1, MAX_ORDER))
for _order in range(1, MAX_ORDER + 1):
    _x, _w = np.polynomial.legendre.leggauss(_order)
    GAUSS_POINTS[_order, :_order], GAUSS_WEIGHTS[_order, :_order] = 0.5 + 0.5 * _x, 0.5 * _w

# Below this length (in cutoffs) the closed form loses more digits in its difference than four points leave out.
SHORT = 1e-4
SHORT_ORDER = 4


@jit
def _mean(dx, dy, dz, bx, by, bz, length, order, kind, spread, table):
    """Mean of the kernel over the segment from 0 to b, seen from d; `order` 0 is the closed form."""
    if order == 0:
        along = (dx * bx + dy * by + dz * bz) / length
        px, py, pz = dx - along * bx / length, dy - along * by / length, dz - along * bz / length
        h2 = px * px + py * py + pz * pz
        if h2 >= 1.0:
            return 0.0
        return segment(kind, spread, table, h2, -along, length - along) / length
    total = 0.0
    for g in range(order):
        u = GAUSS_POINTS[order, g]
        x, y, z = dx - u * bx, dy - u * by, dz - u * bz
        q2 = x * x + y * y + z * z
        if q2 < 1.0:
            total += GAUSS_WEIGHTS[order, g] * value(kind, spread, table, q2)
    return total


@jit
def choose_order(length, limits):
    """Fewest points whose error bound holds up to this length; 0, the closed form, where none does."""
    if length < SHORT:
        return SHORT_ORDER
    for order in range(1, limits.size + 1):
        if length <= limits[order - 1]:
            return order
    return 0


@jit
def deposit_segments(
    start, branch, force, phase, limits, steps, active, period, kind, spread, table, norm, moments,
):  # fmt: skip
    """Add force x branch of each segment to the nodes that its tube of radius 1 reaches.

    Parameters
    ----------
    start : (n, 3)
        Centre of the particle, relative to the first node, in cutoffs.
    branch : (n, 3)
        From the end of the segment to its start, in cutoffs.
    force : (n, 3)
        Force on the particle, times the cutoff, so that force x branch is in the caller's units.
    phase : (n,)
        Which group each segment belongs to.
    limits : (k,)
        Longest branch (cutoffs) for which 1, 2, ... k points are accurate enough; empty for the closed form.
    steps, active, period, kind, spread, table, norm
        As in `deposit`.
    moments : (phases, nx, ny, nz, 9)
        Sums, added to: force component by branch component, row by row.
    """
    nx, ny, nz = moments.shape[1], moments.shape[2], moments.shape[3]
    last = ((nx - 1) * steps[0], (ny - 1) * steps[1], (nz - 1) * steps[2])
    reach = (1.0 if active[0] else 0.0, 1.0 if active[1] else 0.0, 1.0 if active[2] else 0.0)
    product = np.zeros(9)
    for i in range(start.shape[0]):
        p = phase[i]
        x0 = start[i, 0] if active[0] else 0.0
        y0 = start[i, 1] if active[1] else 0.0
        z0 = start[i, 2] if active[2] else 0.0
        bx = -branch[i, 0] if active[0] else 0.0
        by = -branch[i, 1] if active[1] else 0.0
        bz = -branch[i, 2] if active[2] else 0.0
        length = math.sqrt(bx * bx + by * by + bz * bz)
        order = choose_order(length, limits)
        for j in range(3):
            for k in range(3):
                product[3 * j + k] = norm * force[i, j] * branch[i, k]
        low_x, high_x = min(0.0, bx) - reach[0], max(0.0, bx) + reach[0]
        low_y, high_y = min(0.0, by) - reach[1], max(0.0, by) + reach[1]
        low_z, high_z = min(0.0, bz) - reach[2], max(0.0, bz) + reach[2]
        across2 = bx * bx + by * by
        first_x, last_x = images(x0, low_x, high_x, last[0], period[0])
        first_y, last_y = images(y0, low_y, high_y, last[1], period[1])
        first_z, last_z = images(z0, low_z, high_z, last[2], period[2])
        for image_x in range(first_x, last_x + 1):
            x = x0 + image_x * period[0] if image_x else x0
            ix0, ix1 = node_range(x + low_x, x + high_x, steps[0], nx)
            for image_y in range(first_y, last_y + 1):
                y = y0 + image_y * period[1] if image_y else y0
                iy0, iy1 = node_range(y + low_y, y + high_y, steps[1], ny)
                for image_z in range(first_z, last_z + 1):
                    z = z0 + image_z * period[2] if image_z else z0
                    for ix in range(ix0, ix1):
                        dx = ix * steps[0] - x
                        for iy in range(iy0, iy1):
                            dy = iy * steps[1] - y
                            # nearest point of the segment as seen along z: rows farther than 1 are not reached
                            u = 0.0
                            if across2 > 0.0:
                                u = min(1.0, max(0.0, (dx * bx + dy * by) / across2))
                            row2 = (dx - u * bx) ** 2 + (dy - u * by) ** 2
                            if row2 >= 1.0:
                                continue
                            half = math.sqrt(1.0 - row2) * reach[2]
                            iz0, iz1 = node_range(z + min(0.0, bz) - half, z + max(0.0, bz) + half, steps[2], nz)
                            for iz in range(iz0, iz1):
                                dz = iz * steps[2] - z
                                w = _mean(dx, dy, dz, bx, by, bz, length, order, kind, spread, table)
                                if w != 0.0:
                                    for c in range(9):
                                        moments[p, ix, iy, iz, c] += w * product[c]


@jit
def mean_along(points, end, order, kind, spread, table):
    """Mean of the kernel over the segment from 0 to `end` (m,), seen from points (n, m), all in cutoffs."""
    out = np.zeros(points.shape[0])
    b = np.zeros(3)
    b[: end.size] = end
    length = math.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
    d = np.zeros(3)
    rule = SHORT_ORDER if length < SHORT and order == 0 else order
    for i in range(points.shape[0]):
        d[: end.size] = points[i]
        out[i] = _mean(d[0], d[1], d[2], b[0], b[1], b[2], length, rule, kind, spread, table)
    return out


@jit
def largest_error(length, order, rows, kind, spread, table):
    """Largest error of a rule over node positions about a segment, relative to the segment's largest value.

    Scans `rows` distances from the segment's line and 4 `rows` places along it (one row, h = 0, sees one dimension).
    """
    worst, largest = 0.0, 0.0
    columns = 4 * max(rows, 32)
    for i in range(rows):
        h = i / rows
        for j in range(columns + 1):
            along = -1.0 + (length + 2.0) * j / columns
            exact = _mean(along, h, 0.0, length, 0.0, 0.0, length, 0, kind, spread, table)
            rule = _mean(along, h, 0.0, length, 0.0, 0.0, length, order, kind, spread, table)
            worst, largest = max(worst, abs(rule - exact)), max(largest, exact)
    return worst / largest
