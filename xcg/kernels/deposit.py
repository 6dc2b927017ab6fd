"""Sums over points: every grain adds its columns, smeared by the kernel, to the nodes that it reaches.

Lengths are in units of the cutoff and relative to the first node. A node's record in `moments` holds the *flow*
columns first, then columns of constants. Flow columns are relative to the node: offsets x = r_i - r, and velocities
u = v_i - U with U the velocity of the first grain that reached the node. Nothing large is ever subtracted from
something equally large, however fast the frame or far the origin.
"""

import math

import numpy as np

from xcg.kernels._jit import jit
from xcg.kernels.eigen import diagonalise
from xcg.kernels.weights import gradient, value

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
def images(x, reach_low, reach_high, last, period):
    """First and last periodic image of an interval [x + low, x + high] that meets the nodes in [0, last]."""
    if math.isinf(period):
        return 0, 0
    return math.ceil(-(x + reach_high) / period), math.floor((last - x - reach_low) / period)


@jit
def node_range(low, high, step, count):
    """First and one past the last node within [low, high]; one node takes any interval that holds it."""
    return max(0, math.ceil(low / step)), min(count, math.floor(high / step) + 1)


@jit
def deposit(
    position, velocity, mass, constants, phase, level, steps, active, period,
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
        Columns that are the same for all nodes.
    phase : (n,)
        Which group each grain belongs to.
    level : int
        NONE, VELOCITY, FLUCTUATION or LINEAR: how many flow columns are wanted.
    steps, active, period : (3,)
        Spacing (cutoffs), whether distance along an axis counts, period (cutoffs; infinity where there is none).
    kind, spread, table, norm
        The kernel, see `xcg.smoothing.Weights`.
    by_gradient : bool
        Weigh by derivative / distance instead of the value.
    moments : (phases, nx, ny, nz, level + q)
        Sums, added to.
    reference : (nx, ny, nz, 3)
        Reference velocity of each node, NaN where no grain has reached it; set here.
    """
    nx, ny, nz = moments.shape[1], moments.shape[2], moments.shape[3]
    last = ((nx - 1) * steps[0], (ny - 1) * steps[1], (nz - 1) * steps[2])
    reach = (1.0 if active[0] else 0.0, 1.0 if active[1] else 0.0, 1.0 if active[2] else 0.0)
    columns = constants.shape[1]
    for i in range(position.shape[0]):
        p = phase[i]
        x0 = position[i, 0] if active[0] else 0.0
        y0 = position[i, 1] if active[1] else 0.0
        z0 = position[i, 2] if active[2] else 0.0
        first_x, last_x = images(x0, -reach[0], reach[0], last[0], period[0])
        first_y, last_y = images(y0, -reach[1], reach[1], last[1], period[1])
        first_z, last_z = images(z0, -reach[2], reach[2], last[2], period[2])
        for image_x in range(first_x, last_x + 1):
            x = x0 + image_x * period[0] if image_x else x0
            ix0, ix1 = node_range(x - reach[0], x + reach[0], steps[0], nx)
            for image_y in range(first_y, last_y + 1):
                y = y0 + image_y * period[1] if image_y else y0
                iy0, iy1 = node_range(y - reach[1], y + reach[1], steps[1], ny)
                for image_z in range(first_z, last_z + 1):
                    z = z0 + image_z * period[2] if image_z else z0
                    for ix in range(ix0, ix1):
                        dx = x - ix * steps[0]
                        for iy in range(iy0, iy1):
                            dy = y - iy * steps[1]
                            row2 = dx * dx + dy * dy
                            if row2 >= 1.0:
                                continue
                            half = math.sqrt(1.0 - row2) * reach[2]
                            iz0, iz1 = node_range(z - half, z + half, steps[2], nz)
                            for iz in range(iz0, iz1):
                                dz = z - iz * steps[2]
                                q2 = row2 + dz * dz
                                if q2 >= 1.0:
                                    continue
                                if by_gradient:
                                    w = norm * gradient(kind, spread, table, q2)
                                else:
                                    w = norm * value(kind, spread, table, q2)
                                if level > 0:
                                    _add_flow(
                                        w * mass[i], velocity[i], dx, dy, dz, level, moments[p, ix, iy, iz],
                                        reference[ix, iy, iz],
                                    )  # fmt: skip
                                for c in range(columns):
                                    moments[p, ix, iy, iz, level + c] += w * constants[i, c]


@jit
def _add_flow(w, velocity, dx, dy, dz, level, node, reference):
    """Add one grain of weight w = m Psi at offset (dx, dy, dz) to the flow columns of one node."""
    if math.isnan(reference[0]):
        reference[0], reference[1], reference[2] = velocity[0], velocity[1], velocity[2]
    ux, uy, uz = velocity[0] - reference[0], velocity[1] - reference[1], velocity[2] - reference[2]
    wx, wy, wz = w * ux, w * uy, w * uz
    node[0] += 1.0
    node[1] += w
    node[2] += wx
    node[3] += wy
    node[4] += wz
    if level >= 11:
        node[5] += wx * ux
        node[6] += wx * uy
        node[7] += wx * uz
        node[8] += wy * uy
        node[9] += wy * uz
        node[10] += wz * uz
    if level >= 29:
        node[11] += w * dx
        node[12] += w * dy
        node[13] += w * dz
        node[14] += wx * dx
        node[15] += wx * dy
        node[16] += wx * dz
        node[17] += wy * dx
        node[18] += wy * dy
        node[19] += wy * dz
        node[20] += wz * dx
        node[21] += wz * dy
        node[22] += wz * dz
        node[23] += w * dx * dx
        node[24] += w * dx * dy
        node[25] += w * dx * dz
        node[26] += w * dy * dy
        node[27] += w * dy * dz
        node[28] += w * dz * dz


@jit
def solve_gradient(shear, spread, active, gradient_out, determined, rank):
    """Velocity gradient of the best linear fit at each node: G = B M^+, row by row.

    Parameters
    ----------
    shear : (n, 3, 3)
        B = sum m Psi (v_i - V)(r_i - r_bar).
    spread : (n, 6)
        M = sum m Psi (r_i - r_bar)(r_i - r_bar): xx xy xz yy yz zz.
    active : (3,)
        Axes along which grains have offsets at all.
    gradient_out : (n, 3, 3)
        G, zero along directions that the grains do not span.
    determined : (n, 3)
        Whether the derivative along each axis follows from the grains; true along axes that are not active.
    rank : (n,)
        Number of directions that the grains span.
    """
    matrix, vectors, inverse = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    for n in range(shear.shape[0]):
        xx, xy, xz, yy, yz, zz = spread[n]
        matrix[0, 0], matrix[1, 1], matrix[2, 2] = xx, yy, zz
        matrix[0, 1] = matrix[1, 0] = xy
        matrix[0, 2] = matrix[2, 0] = xz
        matrix[1, 2] = matrix[2, 1] = yz
        rank[n] = _pseudo_inverse(matrix, vectors, inverse)
        for j in range(3):
            determined[n, j] = True
            if active[j] and rank[n] < 3:
                # (M M^+)_jj is the part of the axis that the grains span
                projection = 0.0
                for k in range(3):
                    projection += vectors[j, k] * vectors[j, k] * (matrix[k, k] > 0.0)
                determined[n, j] = projection > 1.0 - 1e-6
            for i in range(3):
                gradient_out[n, i, j] = (
                    shear[n, i, 0] * inverse[0, j] + shear[n, i, 1] * inverse[1, j] + shear[n, i, 2] * inverse[2, j]
                )


# Eigenvalues below this share of the largest count as zero: grains that lie in a plane to single precision give
# 1e-11 from rounding alone, while a layer as thin as 1e-4 of the support still gives 1e-8.
_RANK_THRESHOLD = 1e-9
# Above this share of the largest possible determinant the explicit inverse is exact to a few hundred ulp.
_WELL_CONDITIONED = 1e-3


@jit
def _pseudo_inverse(matrix, vectors, inverse):
    """Pseudo-inverse of a symmetric 3x3 matrix and its rank; where it is singular, diagonalises `matrix` in place."""
    trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    inverse[:] = 0.0
    if not trace > 0.0:
        matrix[:] = 0.0
        return 0
    c00 = matrix[1, 1] * matrix[2, 2] - matrix[1, 2] * matrix[1, 2]
    c01 = matrix[0, 2] * matrix[1, 2] - matrix[0, 1] * matrix[2, 2]
    c02 = matrix[0, 1] * matrix[1, 2] - matrix[0, 2] * matrix[1, 1]
    determinant = matrix[0, 0] * c00 + matrix[0, 1] * c01 + matrix[0, 2] * c02
    if determinant > _WELL_CONDITIONED * (trace / 3.0) ** 3:
        inverse[0, 0] = c00 / determinant
        inverse[1, 1] = (matrix[0, 0] * matrix[2, 2] - matrix[0, 2] * matrix[0, 2]) / determinant
        inverse[2, 2] = (matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[0, 1]) / determinant
        inverse[0, 1] = inverse[1, 0] = c01 / determinant
        inverse[0, 2] = inverse[2, 0] = c02 / determinant
        inverse[1, 2] = inverse[2, 1] = (matrix[0, 1] * matrix[0, 2] - matrix[0, 0] * matrix[1, 2]) / determinant
        return 3
    diagonalise(matrix, vectors)
    largest = max(matrix[0, 0], matrix[1, 1], matrix[2, 2])
    rank = 0
    for k in range(3):
        if matrix[k, k] > _RANK_THRESHOLD * largest:
            rank += 1
            for i in range(3):
                for j in range(3):
                    inverse[i, j] += vectors[i, k] * vectors[j, k] / matrix[k, k]
        else:
            matrix[k, k] = 0.0
    return rank
