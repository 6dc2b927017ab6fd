"""Velocity gradients of the best linear fit: small symmetric systems, rank-aware."""

import numpy as np

from xcg.kernels._jit import jit
from xcg.kernels.eigen import diagonalise


@jit
def fit_gradient(mass, drift, offset, shear, spread, active, about_node, gradient, determined, rank, mean):
    """Velocity gradient of the best linear fit at each node: G = B M^+, row by row.

    Parameters
    ----------
    mass : (n,)
        Sum of m Psi.
    drift, offset : (3, n)
        Mean velocity u_bar, and sum of m Psi x.
    shear, spread : (3, 3, n)
        Sums of m Psi u x and m Psi x x, u and x relative to the same point.
    active : (3,)
        Axes along which grains have offsets at all.
    about_node : bool
        Fit about x = 0 instead of the centre of mass.
    gradient : (3, 3, n)
        Written: G with B = sum m Psi (u - u_bar) x' and M = sum m Psi x' x', where x' = x - x_bar; zero along
        directions that the grains do not span.
    determined : (3, n)
        Written: whether the derivative along each axis follows from the grains; true along axes that are not active.
    rank : (n,)
        Written: number of directions that the grains span.
    mean : (3, n)
        Written: x_bar, zero where there are no grains.
    """
    matrix, vectors, inverse, b = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    for n in range(mass.size):
        if not mass[n] > 0.0:
            gradient[:, :, n], determined[:, n], rank[n], mean[:, n] = 0.0, False, 0, 0.0
            continue
        # centring one grain, or several in one place, leaves the rounding of what is subtracted, a few 1e-16
        rounding = 1e-13 * (spread[0, 0, n] + spread[1, 1, n] + spread[2, 2, n])
        for j in range(3):
            mean[j, n] = 0.0 if about_node else offset[j, n] / mass[n]
        for i in range(3):
            for j in range(3):
                matrix[i, j] = spread[i, j, n] - mean[i, n] * offset[j, n]
                b[i, j] = shear[i, j, n] - drift[i, n] * offset[j, n]
        matrix[1, 0], matrix[2, 0], matrix[2, 1] = matrix[0, 1], matrix[0, 2], matrix[1, 2]
        rank[n] = _pseudo_inverse(matrix, vectors, inverse, rounding)
        for j in range(3):
            determined[j, n] = True
            if active[j] and rank[n] < 3:
                # (M M^+)_jj is the part of the axis that the grains span
                projection = 0.0
                for k in range(3):
                    projection += vectors[j, k] * vectors[j, k] * (matrix[k, k] > 0.0)
                determined[j, n] = projection > 1.0 - 1e-6
            for i in range(3):
                gradient[i, j, n] = b[i, 0] * inverse[0, j] + b[i, 1] * inverse[1, j] + b[i, 2] * inverse[2, j]


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
