"""Velocity gradients of the best linear fit: small symmetric systems, rank-aware."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xcg.kernels._jit import leaf

# Above this share of the largest possible determinant the explicit inverse is exact to a few hundred ulp.
_WELL_CONDITIONED = 1e-3
# The same for the sum of the principal minors and the inverse within a plane; what is below the other two, shares of
# those of well-spread grains, is nothing but rounding: the grains lie on one line, or in one plane.
_WELL_SPREAD = 1e-4
_ONE_LINE, _ONE_PLANE = 1e-13, 1e-11
# Eigenvalues below this share of the largest count as zero: grains that lie in a plane to single precision give
# 1e-11 from rounding alone, while a layer as thin as 1e-4 of the support still gives 1e-8.
_RANK_THRESHOLD = 1e-9
# Centring one grain, or several in one place, leaves the rounding of what is subtracted, a few 1e-16 of it.
_ROUNDING = 1e-13
# A derivative is determined where the grains span no less of its axis.
_SPANNED = 1.0 - 1e-6


def fit_gradient(
    count: NDArray, mass: NDArray, drift: NDArray, offset: NDArray, shear: NDArray, spread: NDArray, *,
    active: Sequence[bool], about_node: bool,
) -> tuple[NDArray, NDArray, NDArray, NDArray]:  # fmt: skip
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

    Returns
    -------
    gradient : (3, 3, n)
        G with B = sum m Psi (u - u_bar) x' and M = sum m Psi x' x', where x' = x - x_bar; zero along directions that
        the grains do not span.
    explained : (3, 3, n)
        G B^T, the part of sum m Psi (u - u_bar)(u - u_bar) that the fit leaves nothing of; NaN where it goes through
        all grains, so that what is left is unknown.
    determined : (3, n)
        Whether the derivative along each axis follows from the grains; true along axes that are not active.
    mean : (3, n)
        x_bar, zero where there are no grains.
    """
    sums = (count, mass, drift, offset, shear, spread)
    out = np.empty_like(shear), np.empty_like(shear), np.empty(offset.shape, bool), np.empty_like(offset)
    few = np.empty(mass.size, "int64")
    few = few[: _fit(*sums, *active, sum(active), about_node, *out, few)]
    if few.size:
        fitted = _fit_few(*(a[..., few] for a in sums), active=active, about_node=about_node)
        for whole, part in zip(out, fitted, strict=True):
            whole[..., few] = part
    return out


@leaf
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@leaf
def _fit(
    count, mass, drift, offset, shear, spread, active_x, active_y, active_z, full, about_node, gradient, explained,
    determined, mean, few,
):  # fmt: skip
    """Fit where grains clearly span all active axes, `full` of them, a plane, a line or nothing.

    The pseudo-inverse of M is adj M / det M, with adj M the matrix of cofactors; M / (tr M)^2 on a line; and
    (tr M (1 - N) - M) / tr adj M in a plane of normal n, where N = n n = adj M / tr adj M. The other nodes are listed;
    returns how many.
    """
    left = 0
    for n in range(mass.size):
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
        trace = xx + yy + zz
        rounding = _ROUNDING * (spread[0, 0, n] + spread[1, 1, n] + spread[2, 2, n])
        # along the other axes all offsets are zero, and any spread gives a gradient of zero
        own = trace / full
        xx, yy, zz = xx if active_x else own, yy if active_y else own, zz if active_z else own
        c00, c01, c02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        c11, c12, c22 = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        determinant, minors, size = xx * c00 + xy * c01 + xz * c02, c00 + c11 + c22, xx + yy + zz
        rank, px, py, pz = full, 1.0, 1.0, 1.0  # the part of each axis that the grains span
        if not trace > rounding:
            rank, px, py, pz = 0, 0.0, 0.0, 0.0
            c00, c01, c02, c11, c12, c22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        elif determinant > _WELL_CONDITIONED * own * own * own:
            scale = 1.0 / determinant
            c00, c01, c02 = scale * c00, scale * c01, scale * c02
            c11, c12, c22 = scale * c11, scale * c12, scale * c22
        elif minors <= _ONE_LINE * size * size:
            rank, scale = full - 2, 1.0 / size
            px, py, pz = scale * xx, scale * yy, scale * zz
            scale = scale * scale
            c00, c01, c02 = scale * xx, scale * xy, scale * xz
            c11, c12, c22 = scale * yy, scale * yz, scale * zz
        elif minors > _WELL_SPREAD * size * size and abs(determinant) <= _ONE_PLANE * minors * size:
            rank, scale = full - 1, 1.0 / minors
            px, py, pz = 1.0 - scale * c00, 1.0 - scale * c11, 1.0 - scale * c22
            across = -scale * size
            c00, c01, c02 = scale * (size * px - xx), scale * (across * c01 - xy), scale * (across * c02 - xz)
            c11, c12, c22 = scale * (size * py - yy), scale * (across * c12 - yz), scale * (size * pz - zz)
        else:
            few[left] = n
            left += 1
            continue
        determined[0, n] = mass[n] > 0.0 and (not active_x or px > _SPANNED)
        determined[1, n] = mass[n] > 0.0 and (not active_y or py > _SPANNED)
        determined[2, n] = mass[n] > 0.0 and (not active_z or pz > _SPANNED)
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
    return left


def _fit_few(
    count: NDArray, mass: NDArray, drift: NDArray, offset: NDArray, shear: NDArray, spread: NDArray, *,
    active: Sequence[bool], about_node: bool,
) -> tuple[NDArray, NDArray, NDArray, NDArray]:  # fmt: skip
    """Fit by eigenvectors, where grains lie close to a plane or a line."""
    there = mass > 0.0
    mean = np.divide(offset, mass, out=np.zeros_like(offset), where=there & (not about_node))
    matrix = np.moveaxis(spread - mean[:, None] * offset, -1, 0)
    damaged = ~np.isfinite(matrix).all(axis=(1, 2))
    values, vectors = np.linalg.eigh(np.where(damaged[:, None, None], 0.0, matrix))
    rounding = _ROUNDING * np.trace(spread)
    least = np.where(values.sum(axis=1) > rounding, np.maximum(_RANK_THRESHOLD * values[:, 2], rounding), np.inf)
    spanned = values > least[:, None]
    scaled = vectors * np.divide(1.0, values, out=np.zeros_like(values), where=spanned)[:, None]
    # (M M^+)_jj is the part of the axis that the grains span
    projection = (vectors**2 * spanned[:, None]).sum(axis=2).T
    determined = there & (~np.reshape(active, (3, 1)) | (projection > _SPANNED))
    moved = np.moveaxis(shear - np.where(there, drift, 0.0)[:, None] * offset, -1, 0)
    gradient = moved @ (scaled @ vectors.swapaxes(1, 2))
    explained = gradient @ moved.swapaxes(1, 2)
    explained[count <= spanned.sum(axis=1) + 1] = np.nan
    return np.moveaxis(gradient, 0, -1), np.moveaxis(explained, 0, -1), determined, mean
