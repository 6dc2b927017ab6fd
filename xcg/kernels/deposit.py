"""Sums over points: every grain adds its columns, smeared by the kernel, to the nodes that it reaches.

Lengths are in units of the cutoff and relative to the first node. A node's record holds the *flow* columns first,
then columns of constants. Flow columns are relative to the node: offsets x = r_i - r, and velocities u = v_i - U with
U the velocity of the first grain that reached the node. Nothing large is ever subtracted from something equally
large, however fast the frame or far the origin.

For each grain the nodes within its support are listed, their weights computed in one vectorised loop, and their
records updated.
"""

import math

import numpy as np

from xcg.kernels._jit import jit
from xcg.kernels.nodes import LANES, images, node_range
from xcg.kernels.weights import fill_values

COUNT = 0
MASS = 1
MOMENTUM = 2  # m u: x y z
KINETIC = 5  # m u u: xx xy xz yy yz zz
OFFSET = 11  # m x: x y z
SHEAR = 14  # m u_i x_j: row by row
SPREAD = 23  # m x x: xx xy xz yy yz zz

# how many flow columns each level of detail takes
NONE, VELOCITY, FLUCTUATION, LINEAR = 0, 5, 11, 29


@jit
def deposit(
    position, velocity, mass, constants, phase, level, shape, slab, steps, active, period,
    kind, spread, table, norm, by_gradient, moments, reference,
):  # fmt: skip
    """Add grains to the nodes within their support.

    Parameters
    ----------
    position : (n, 3)
        Centres, relative to the first node, in cutoffs.
    velocity : (n, 3)
        Velocities; not read at level NONE.
    mass : (n,)
        Masses; not read at level NONE.
    constants : (n, q)
        Columns that are the same for all nodes; q is a multiple of four, as they are added four at a time.
    phase : (n,)
        Which group each grain belongs to.
    level : int
        NONE, VELOCITY, FLUCTUATION or LINEAR: how many flow columns are wanted.
    shape : (3,)
        Number of nodes along x, y, z.
    slab : (2,)
        Only nodes with slab[0] <= ix < slab[1] are touched, so that slabs can be filled at the same time.
    steps, active, period : (3,)
        Spacing (cutoffs), whether distance along an axis counts, period (cutoffs; infinity where there is none).
    kind, spread, table, norm
        The kernel, see `xcg.smoothing.Weights`.
    by_gradient : bool
        Weigh by derivative / distance instead of the value.
    moments : (phases, nodes, level + q)
        Sums, added to.
    reference : (nodes, 3)
        Reference velocity of each node, NaN where no grain has reached it; set here.
    """
    ny, nz = shape[1], shape[2]
    low = (slab[0] * steps[0], 0.0, 0.0)
    high = ((slab[1] - 1) * steps[0], (ny - 1) * steps[1], (nz - 1) * steps[2])
    reach = (1.0 if active[0] else 0.0, 1.0 if active[1] else 0.0, 1.0 if active[2] else 0.0)
    most = 1
    for k in range(3):
        most *= min(shape[k], int(2.0 * reach[k] / steps[k]) + 2)
    most += LANES
    node, q2, w, offset = np.empty(most, np.int64), np.empty(most), np.empty(most), np.empty((most, 3))
    for i in range(position.shape[0]):
        p = phase[i]
        x0 = position[i, 0] if active[0] else 0.0
        y0 = position[i, 1] if active[1] else 0.0
        z0 = position[i, 2] if active[2] else 0.0
        first_x, last_x = images(x0, -reach[0], reach[0], low[0], high[0], period[0])
        first_y, last_y = images(y0, -reach[1], reach[1], low[1], high[1], period[1])
        first_z, last_z = images(z0, -reach[2], reach[2], low[2], high[2], period[2])
        for image_x in range(first_x, last_x + 1):
            x = x0 + image_x * period[0] if image_x else x0
            ix0, ix1 = node_range(x - reach[0], x + reach[0], steps[0], slab[0], slab[1])
            for image_y in range(first_y, last_y + 1):
                y = y0 + image_y * period[1] if image_y else y0
                iy0, iy1 = node_range(y - reach[1], y + reach[1], steps[1], 0, ny)
                for image_z in range(first_z, last_z + 1):
                    z = z0 + image_z * period[2] if image_z else z0
                    hits = 0
                    for ix in range(ix0, ix1):
                        x_off = x - ix * steps[0]
                        for iy in range(iy0, iy1):
                            y_off = y - iy * steps[1]
                            row2 = x_off * x_off + y_off * y_off
                            if row2 >= 1.0:
                                continue
                            half = math.sqrt(1.0 - row2) * reach[2]
                            iz0, iz1 = node_range(z - half, z + half, steps[2], 0, nz)
                            first = (ix * ny + iy) * nz
                            for iz in range(iz0, iz1, LANES):
                                z_off = z - iz * steps[2]
                                for lane in range(LANES):
                                    q2[hits + lane] = row2 + (z_off - lane * steps[2]) ** 2
                                for lane in range(LANES):
                                    node[hits + lane] = first + iz + lane
                                for lane in range(LANES):
                                    offset[hits + lane, 0] = x_off
                                    offset[hits + lane, 1] = y_off
                                    offset[hits + lane, 2] = z_off - lane * steps[2]
                                hits += min(LANES, iz1 - iz)
                    fill_values(kind, spread, table, norm, by_gradient, q2, hits, w)
                    if level > 0:
                        _add_flow(p, mass[i], velocity[i], node, hits, w, offset, level, moments, reference)
                    for k in range(hits):
                        n, v = node[k], w[k]
                        for c in range(0, constants.shape[1], 4):
                            first = level + c
                            sum0 = moments[p, n, first] + v * constants[i, c]
                            sum1 = moments[p, n, first + 1] + v * constants[i, c + 1]
                            sum2 = moments[p, n, first + 2] + v * constants[i, c + 2]
                            sum3 = moments[p, n, first + 3] + v * constants[i, c + 3]
                            moments[p, n, first], moments[p, n, first + 1] = sum0, sum1
                            moments[p, n, first + 2], moments[p, n, first + 3] = sum2, sum3


@jit
def _add_flow(p, mass, velocity, node, hits, weight, offset, level, moments, reference):
    """Add one grain to the flow columns of the nodes that it reaches."""
    for k in range(hits):
        n = node[k]
        if math.isnan(reference[n, 0]):
            reference[n, 0], reference[n, 1], reference[n, 2] = velocity[0], velocity[1], velocity[2]
        ux, uy, uz = velocity[0] - reference[n, 0], velocity[1] - reference[n, 1], velocity[2] - reference[n, 2]
        w = weight[k] * mass
        wx, wy, wz = w * ux, w * uy, w * uz
        moments[p, n, 0] += 1.0
        moments[p, n, 1] += w
        moments[p, n, 2] += wx
        moments[p, n, 3] += wy
        moments[p, n, 4] += wz
        if level >= 11:
            moments[p, n, 5] += wx * ux
            moments[p, n, 6] += wx * uy
            moments[p, n, 7] += wx * uz
            moments[p, n, 8] += wy * uy
            moments[p, n, 9] += wy * uz
            moments[p, n, 10] += wz * uz
        if level >= 29:
            x, y, z = offset[k, 0], offset[k, 1], offset[k, 2]
            moments[p, n, 11] += w * x
            moments[p, n, 12] += w * y
            moments[p, n, 13] += w * z
            moments[p, n, 14] += wx * x
            moments[p, n, 15] += wx * y
            moments[p, n, 16] += wx * z
            moments[p, n, 17] += wy * x
            moments[p, n, 18] += wy * y
            moments[p, n, 19] += wy * z
            moments[p, n, 20] += wz * x
            moments[p, n, 21] += wz * y
            moments[p, n, 22] += wz * z
            moments[p, n, 23] += w * x * x
            moments[p, n, 24] += w * x * y
            moments[p, n, 25] += w * x * z
            moments[p, n, 26] += w * y * y
            moments[p, n, 27] += w * y * z
            moments[p, n, 28] += w * z * z
