"""Velocity gradients of the best linear fit: small symmetric systems, rank-aware."""

import numpy as np

from xcg.kernels._jit import jit
from xcg.kernels.eigen import diagonalise


@jit
def fit_gradient(shear, spread, rounding, active, gradient_out, determined, rank):
    """Velocity gradient of the best linear fit at each node: G = B M^+, row by row.

    Parameters
    ----------
    shear : (n, 3, 3)
        B = sum m Psi (v_i - V)(r_i - r_bar).
    spread : (n, 6)
        M = sum m Psi (r_i - r_bar)(r_i - r_bar): xx xy xz yy yz zz.
    rounding : (n,)
        What of M may be rounding of the sums that it is the difference of.
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
        rank[n] = _pseudo_inverse(matrix, vectors, inverse, rounding[n])
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
def _pseudo_inverse(matrix, vectors, inverse, rounding):
    """Pseudo-inverse of a symmetric 3x3 matrix and its rank; where it is singular, diagonalises `matrix` in place."""
    trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    inverse[:] = 0.0
    if not trace > rounding:
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
        if matrix[k, k] > max(_RANK_THRESHOLD * largest, rounding):
            rank += 1
            for i in range(3):
                for j in range(3):
                    inverse[i, j] += vectors[i, k] * vectors[j, k] / matrix[k, k]
        else:
            matrix[k, k] = 0.0
    return rank
