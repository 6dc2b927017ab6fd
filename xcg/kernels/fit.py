"""Velocity gradients of the best linear fit: small symmetric systems, rank-aware."""

import numpy as np

from xcg.kernels._jit import leaf
from xcg.kernels.eigen import diagonalise

# Above this share of the largest possible determinant the explicit inverse is exact to a few hundred ulp.
_WELL_CONDITIONED = 1e-3


@leaf
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@leaf
def fit_gradient(
    count, mass, drift, offset, shear, spread, active, about_node, scratch, gradient, explained, determined, mean
):  # fmt: skip
    """Velocity gradient of the best linear fit at each node: G = B M^+, row by row.

    Parameters
    ----------
    count, mass : (n,)
        Number of grains, and sum of m Psi.
    drift, offset : (3, n)
        Mean velocity u_bar, and sum of m Psi x.
    shear, spread : (3, 3, n)
        Sums of m Psi u x and m Psi x x, u and x relative to the same point.
    active : (3,)
        Axes along which grains have offsets at all.
    about_node : bool
        Fit about x = 0 instead of the centre of mass.
    scratch : (3, 3, 3)
    gradient : (3, 3, n)
        Written: G with B = sum m Psi (u - u_bar) x' and M = sum m Psi x' x', where x' = x - x_bar; zero along
        directions that the grains do not span.
    explained : (3, 3, n)
        Written: G B^T, the part of sum m Psi (u - u_bar)(u - u_bar) that the fit leaves nothing of; NaN where it goes
        through all grains, so that what is left is unknown.
    determined : (3, n)
        Written: whether the derivative along each axis follows from the grains; true along axes that are not active.
    mean : (3, n)
        Written: x_bar, zero where there are no grains.
    """
    matrix, vectors, inverse = scratch[0], scratch[1], scratch[2]
    for n in range(mass.size):
        # without grains all sums are zero, and so are matrix, rank and gradient
        per_mass = 1.0 / mass[n] if mass[n] > 0.0 else 0.0
        offsets = offset[0, n], offset[1, n], offset[2, n]
        shift = 0.0 if about_node else per_mass
        x, y, z = shift * offsets[0], shift * offsets[1], shift * offsets[2]
        mean[0, n], mean[1, n], mean[2, n] = x, y, z
        xx, xy, xz = (
            spread[0, 0, n] - x * offsets[0],
            spread[0, 1, n] - x * offsets[1],
            spread[0, 2, n] - x * offsets[2],
        )
        yy, yz, zz = (
            spread[1, 1, n] - y * offsets[1],
            spread[1, 2, n] - y * offsets[2],
            spread[2, 2, n] - z * offsets[2],
        )
        c00, c01, c02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        determinant, trace = xx * c00 + xy * c01 + xz * c02, xx + yy + zz
        # centring one grain, or several in one place, leaves the rounding of what is subtracted, a few 1e-16
        rounding = 1e-13 * (spread[0, 0, n] + spread[1, 1, n] + spread[2, 2, n])
        if trace > rounding and determinant > _WELL_CONDITIONED * (trace / 3.0) ** 3:
            rank, scale = 3, 1.0 / determinant
            c00, c01, c02 = scale * c00, scale * c01, scale * c02
            c11, c12, c22 = scale * (xx * zz - xz * xz), scale * (xy * xz - xx * yz), scale * (xx * yy - xy * xy)
            determined[0, n], determined[1, n], determined[2, n] = True, True, True
        else:
            matrix[0, 0], matrix[0, 1], matrix[0, 2] = xx, xy, xz
            matrix[1, 0], matrix[1, 1], matrix[1, 2] = xy, yy, yz
            matrix[2, 0], matrix[2, 1], matrix[2, 2] = xz, yz, zz
            rank = _pseudo_inverse(matrix, vectors, inverse, rounding)
            c00, c01, c02 = inverse[0, 0], inverse[0, 1], inverse[0, 2]
            c11, c12, c22 = inverse[1, 1], inverse[1, 2], inverse[2, 2]
            for j in range(3):
                # (M M^+)_jj is the part of the axis that the grains span
                projection = 0.0
                for k in range(3):
                    projection += vectors[j, k] * vectors[j, k] * (matrix[k, k] > 0.0)
                determined[j, n] = mass[n] > 0.0 and (not active[j] or projection > 1.0 - 1e-6)
        u, v, w = drift[0, n], drift[1, n], drift[2, n]
        u, v, w = (u, v, w) if mass[n] > 0.0 else (0.0, 0.0, 0.0)
        b0 = shear[0, 0, n] - u * offsets[0], shear[0, 1, n] - u * offsets[1], shear[0, 2, n] - u * offsets[2]
        b1 = shear[1, 0, n] - v * offsets[0], shear[1, 1, n] - v * offsets[1], shear[1, 2, n] - v * offsets[2]
        b2 = shear[2, 0, n] - w * offsets[0], shear[2, 1, n] - w * offsets[1], shear[2, 2, n] - w * offsets[2]
        c0, c1, c2 = (c00, c01, c02), (c01, c11, c12), (c02, c12, c22)
        g0 = _dot(b0, c0), _dot(b0, c1), _dot(b0, c2)
        g1 = _dot(b1, c0), _dot(b1, c1), _dot(b1, c2)
        g2 = _dot(b2, c0), _dot(b2, c1), _dot(b2, c2)
        gradient[0, 0, n], gradient[0, 1, n], gradient[0, 2, n] = g0
        gradient[1, 0, n], gradient[1, 1, n], gradient[1, 2, n] = g1
        gradient[2, 0, n], gradient[2, 1, n], gradient[2, 2, n] = g2
        # a fit through rank + 1 grains leaves nothing over: their fluctuation is unknown, not zero
        known = 1.0 if count[n] > rank + 1 else np.nan
        explained[0, 0, n], explained[1, 1, n] = known * _dot(g0, b0), known * _dot(g1, b1)
        explained[2, 2, n] = known * _dot(g2, b2)
        explained[0, 1, n] = explained[1, 0, n] = known * _dot(g0, b1)
        explained[0, 2, n] = explained[2, 0, n] = known * _dot(g0, b2)
        explained[1, 2, n] = explained[2, 1, n] = known * _dot(g1, b2)


# Eigenvalues below this share of the largest count as zero: grains that lie in a plane to single precision give
# 1e-11 from rounding alone, while a layer as thin as 1e-4 of the support still gives 1e-8.
_RANK_THRESHOLD = 1e-9


@leaf
def _pseudo_inverse(matrix, vectors, inverse, rounding):
    """Pseudo-inverse of a symmetric 3x3 matrix and its rank; `matrix` is made diagonal, with zeros for what is none."""
    trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    inverse[:] = 0.0
    if not trace > rounding:
        matrix[:] = 0.0
        return 0
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
