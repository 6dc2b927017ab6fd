"""Sums over segments: every contact adds force times branch, smeared along the branch, to the nodes it reaches.

Lengths are in units of the cutoff and relative to the first node. The weight of a node is the mean of the kernel
over the segment, ``S = int_0^1 Psi(r - start + u a) du`` with the segment running from `start` to ``start - a``. It
comes from the closed form, or from the fewest Gauss-Legendre points that meet the asked accuracy for a branch of
that length.
"""

import math

import numpy as np

from xcg.kernels._jit import jit
from xcg.kernels.nodes import LANES, images, node_range
from xcg.kernels.weights import fill_gauss, fill_segments

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
    start, branch, force, phase, limits, shape, slab, steps, active, period, kind, spread, table, norm, moments,
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
    shape, slab, steps, active, period, kind, spread, table, norm
        As in `deposit`.
    moments : (phases, nodes, 9)
        Sums, added to: force component by branch component, row by row.
    """
    ny, nz = shape[1], shape[2]
    low = (slab[0] * steps[0], 0.0, 0.0)
    high = ((slab[1] - 1) * steps[0], (ny - 1) * steps[1], (nz - 1) * steps[2])
    reach = (1.0 if active[0] else 0.0, 1.0 if active[1] else 0.0, 1.0 if active[2] else 0.0)
    product = np.zeros(9)
    most = 256
    node, along, q2, w = np.empty(most, np.int64), np.empty(most), np.empty(most), np.empty(most)
    ratio = np.empty(most)
    bits, exponent = ratio.view(np.int64), np.empty(most, np.int64)
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
        inverse = 1.0 / length if length > 0.0 else 0.0
        ex, ey, ez = bx * inverse, by * inverse, bz * inverse
        for j in range(3):
            for k in range(3):
                product[3 * j + k] = force[i, j] * branch[i, k]
        low_x, high_x = min(0.0, bx) - reach[0], max(0.0, bx) + reach[0]
        low_y, high_y = min(0.0, by) - reach[1], max(0.0, by) + reach[1]
        low_z, high_z = min(0.0, bz) - reach[2], max(0.0, bz) + reach[2]
        # no more than there are: along an axis with one node the spacing means nothing
        box = min(shape[0], int((high_x - low_x) / steps[0]) + 2)
        box *= min(shape[1], int((high_y - low_y) / steps[1]) + 2)
        box = box * min(shape[2], int((high_z - low_z) / steps[2]) + 2) + LANES
        if box > most:
            most = 2 * box
            node, along, q2, w = np.empty(most, np.int64), np.empty(most), np.empty(most), np.empty(most)
            ratio = np.empty(most)
            bits, exponent = ratio.view(np.int64), np.empty(most, np.int64)
        across2 = bx * bx + by * by
        first_x, last_x = images(x0, low_x, high_x, low[0], high[0], period[0])
        first_y, last_y = images(y0, low_y, high_y, low[1], high[1], period[1])
        first_z, last_z = images(z0, low_z, high_z, low[2], high[2], period[2])
        for image_x in range(first_x, last_x + 1):
            x = x0 + image_x * period[0] if image_x else x0
            ix0, ix1 = node_range(x + low_x, x + high_x, steps[0], slab[0], slab[1])
            for image_y in range(first_y, last_y + 1):
                y = y0 + image_y * period[1] if image_y else y0
                iy0, iy1 = node_range(y + low_y, y + high_y, steps[1], 0, ny)
                for image_z in range(first_z, last_z + 1):
                    z = z0 + image_z * period[2] if image_z else z0
                    hits = 0
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
                            iz0, iz1 = node_range(z + min(0.0, bz) - half, z + max(0.0, bz) + half, steps[2], 0, nz)
                            first = (ix * ny + iy) * nz
                            row_along, row_q2 = dx * ex + dy * ey, dx * dx + dy * dy
                            for iz in range(iz0, iz1, LANES):
                                dz = iz * steps[2] - z
                                for lane in range(LANES):
                                    along[hits + lane] = row_along + (dz + lane * steps[2]) * ez
                                for lane in range(LANES):
                                    q2[hits + lane] = row_q2 + (dz + lane * steps[2]) ** 2
                                for lane in range(LANES):
                                    node[hits + lane] = first + iz + lane
                                hits += min(LANES, iz1 - iz)
                    if order:
                        fill_gauss(
                            kind, spread, table, norm, GAUSS_POINTS, GAUSS_WEIGHTS, order, length, along, q2, hits, w
                        )
                    else:
                        fill_segments(kind, spread, table, norm, length, along, q2, hits, w, ratio, bits, exponent)
                    for k in range(hits):
                        n, v = node[k], w[k]
                        moments[p, n, 0] += v * product[0]
                        moments[p, n, 1] += v * product[1]
                        moments[p, n, 2] += v * product[2]
                        moments[p, n, 3] += v * product[3]
                        moments[p, n, 4] += v * product[4]
                        moments[p, n, 5] += v * product[5]
                        moments[p, n, 6] += v * product[6]
                        moments[p, n, 7] += v * product[7]
                        moments[p, n, 8] += v * product[8]


@jit
def _means(length, order, along, q2, kind, spread, table):
    """Mean of the kernel over one segment, seen from many nodes; `q2` is overwritten."""
    out, ratio, exponent = np.zeros(along.size), np.empty(along.size), np.empty(along.size, np.int64)
    if order:
        fill_gauss(kind, spread, table, 1.0, GAUSS_POINTS, GAUSS_WEIGHTS, order, length, along, q2, along.size, out)
    else:
        fill_segments(
            kind, spread, table, 1.0, length, along, q2, along.size, out, ratio, ratio.view(np.int64), exponent
        )
    return out


@jit
def mean_along(points, end, order, kind, spread, table):
    """Mean of the kernel over the segment from 0 to `end` (m,), seen from points (n, m), all in cutoffs."""
    length = math.sqrt((end * end).sum())
    along, q2 = np.zeros(points.shape[0]), np.zeros(points.shape[0])
    for i in range(points.shape[0]):
        for k in range(end.size):
            q2[i] += points[i, k] ** 2
            along[i] += points[i, k] * end[k] / length if length > 0.0 else 0.0
    rule = SHORT_ORDER if length < SHORT and order == 0 else order
    return _means(length, rule, along, q2, kind, spread, table)


@jit
def largest_error(length, order, rows, kind, spread, table):
    """Largest error of a rule over node positions about a segment, relative to the segment's largest value.

    Scans `rows` distances from the segment's line and 4 `rows` places along it (one row, h = 0, sees one dimension).
    """
    columns = 4 * max(rows, 32)
    along, q2 = np.empty(rows * (columns + 1)), np.empty(rows * (columns + 1))
    for i in range(rows):
        for j in range(columns + 1):
            t = -1.0 + (length + 2.0) * j / columns
            along[i * (columns + 1) + j] = t
            q2[i * (columns + 1) + j] = t * t + (i / rows) ** 2
    exact = _means(length, 0, along, q2.copy(), kind, spread, table)
    rule = _means(length, order, along, q2, kind, spread, table)
    return np.abs(rule - exact).max() / exact.max()
