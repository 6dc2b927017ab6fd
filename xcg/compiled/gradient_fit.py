"""Velocity gradient of the best linear fit, from sums at the nodes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, leaf
from xcg.compiled.arrays import along_active
from xcg.compiled.matrices import dot, principal_of_one

# Above this share of the largest possible determinant the explicit inverse is exact to a few
# hundred ulp.
_WELL_CONDITIONED = 1e-3
# The same for the sum of the principal minors and the inverse within a plane; what is below the
# other two, shares of those of well-spread grains, is nothing but rounding: the grains lie on one
# line, or in one plane.
_WELL_SPREAD = 1e-4
_ONE_LINE = 1e-13
_ONE_PLANE = 1e-11
# Eigenvalues below this share of the largest count as zero: grains that lie in a plane to single
# precision give 1e-11 from rounding alone, while a layer as thin as 1e-4 of the support still gives
# 1e-8.
_RANK_THRESHOLD = 1e-9
_ROUNDING = 1e-13  # what centring one grain, or several in one place, leaves, of what is subtracted: a few 1e-16
# A derivative is determined where the grains span no less of its axis.
_SPANNED = 1.0 - 1e-6
# Rows of the sums at a node that a fit takes, in all `SUMS`, and of what it finds, in all `FOUND`.
COUNT = 0
MASS = 1
MOMENTUM = 2
OFFSET = 5
SHEAR = 8
SPREAD = 17
SUMS = 23
GRADIENT = 0
EXPLAINED = 9
DETERMINED = 15
MEAN = 18
INVERSE = 21
FOUND = 27
SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


def fit_gradient(sums: NDArray, *, active: Sequence[bool], about_node: bool) -> NDArray:
    """Velocity gradient of the best linear fit at each node: G = B M^+, row by row.

    Parameters
    ----------
    sums : (SUMS, n)
        Number of grains, and sums of m Psi, m Psi u (3), m Psi x (3), m Psi u x (9) and m Psi x x
        (xx xy xz yy yz zz), u and x relative to the same velocity and point.
    active : (3,)
        Axes along which grains have offsets at all.
    about_node : bool
        Fit about x = 0 instead of the centre of mass.

    Returns
    -------
    array (FOUND, n)
        G (9) with B = sum m Psi (u - u_bar) x' and M = sum m Psi x' x', where x' = x - x_bar: zero
        along directions that the grains do not span. G B^T (6), the part of sum m Psi (u - u_bar)(u
        - u_bar) that the fit explains: NaN where it goes through all grains, so that the
        fluctuation is unknown. 1 (3) where the derivative along each axis follows from the grains,
        or the axis is not active, else NaN. x_bar (3), zero where no grains are. M^+ (6).
    """
    rows = np.empty((SUMS + FOUND, sums.shape[1]))
    rows[:SUMS] = sums
    flags = np.uint64(flags_of(active, about_node))
    fit_rows(rows, np.uint64(0), np.uint64(SUMS), rows.shape[1], flags)
    return rows[SUMS:]


def flags_of(active: Sequence[bool], about_node: bool) -> int:
    """Return the active axes and the point of the fit as bits of one number."""
    return sum(1 << k for k, on in enumerate((*active, about_node)) if on)


@leaf
def _three(rows, first, n):
    return rows[first, n], rows[first + np.uint64(1), n], rows[first + np.uint64(2), n]


@inner
def _put_three(rows, first, n, values):
    rows[first, n], rows[first + np.uint64(1), n], rows[first + np.uint64(2), n] = values


@inlined
def _one_if(condition):
    """Return 1 where a condition holds, else NaN."""
    return 1.0 if condition else np.nan


@inner
def _moved(shear, u, offsets):
    """Compute a row of B from the sums of m Psi u x of one component."""
    return shear[0] - u * offsets[0], shear[1] - u * offsets[1], shear[2] - u * offsets[2]


@inner
def _inverse_of_rank(xx, xy, xz, yy, yz, zz, rounding):
    """Rank of a symmetric matrix, the part of each axis (3,) that its range spans, and its pseudo-inverse (6,)."""
    rank = 0
    spanned = (0.0, 0.0, 0.0)
    inverse = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    values, axes = principal_of_one(xx, xy, xz, yy, yz, zz)
    least = max(_RANK_THRESHOLD * max(values), rounding)
    for k in range(3):
        if values[k] > least:
            x, y, z = axes[k]
            rank += 1
            scale = 1.0 / values[k]
            spanned = spanned[0] + x * x, spanned[1] + y * y, spanned[2] + z * z
            inverse = (
                inverse[0] + scale * x * x,
                inverse[1] + scale * x * y,
                inverse[2] + scale * x * z,
                inverse[3] + scale * y * y,
                inverse[4] + scale * y * z,
                inverse[5] + scale * z * z,
            )
    return rank, spanned, inverse


@leaf
def fit_rows(rows, first, found, many, flags):
    """Fit at each node, as `fit_gradient` says.

    The pseudo-inverse of M is adj M / det M where grains clearly span all active axes, with adj M
    the matrix of cofactors; M / (tr M)^2 on a line; and (tr M (1 - N) - M) / tr adj M in a plane of
    normal n, where N = n n = adj M / tr adj M. Where they span none of these clearly it follows
    from eigenvectors.

    Parameters
    ----------
    rows : (any, nodes)
        The sums, from row `first` on. What is found is written from row `found` on.
    many : int
        Number of nodes.
    flags : int
        See `flags_of`.
    """
    active = (flags & 1 != 0, flags & 2 != 0, flags & 4 != 0)
    about_node = flags & 8 != 0
    full = int(active[0]) + int(active[1]) + int(active[2])
    # as unsigned numbers: signed ones are looked at for counting from the end
    count = first + np.uint64(COUNT)
    of_mass = first + np.uint64(MASS)
    momentum = first + np.uint64(MOMENTUM)
    offset = first + np.uint64(OFFSET)
    shear = first + np.uint64(SHEAR)
    spread = first + np.uint64(SPREAD)
    gradient = found + np.uint64(GRADIENT)
    explained = found + np.uint64(EXPLAINED)
    determined = found + np.uint64(DETERMINED)
    mean = found + np.uint64(MEAN)
    inverse = found + np.uint64(INVERSE)
    three = np.uint64(3)
    for n in range(many):
        mass = rows[of_mass, n]
        per_mass = 1.0 / mass if mass > 0.0 else 0.0
        offsets = _three(rows, offset, n)
        shift = per_mass
        if about_node:
            shift = 0.0
        x = shift * offsets[0]
        y = shift * offsets[1]
        z = shift * offsets[2]
        _put_three(rows, mean, n, (x, y, z))
        about_xx, about_xy, about_xz = _three(rows, spread, n)
        about_yy, about_yz, about_zz = _three(rows, spread + three, n)
        xx = about_xx - x * offsets[0]
        xy = about_xy - x * offsets[1]
        xz = about_xz - x * offsets[2]
        yy = about_yy - y * offsets[1]
        yz = about_yz - y * offsets[2]
        zz = about_zz - z * offsets[2]
        trace = xx + yy + zz
        rounding = _ROUNDING * (about_xx + about_yy + about_zz)
        # along the other axes all offsets are zero, and any spread gives a gradient of zero
        own = trace / full
        if not active[0]:
            xx = own
        if not active[1]:
            yy = own
        if not active[2]:
            zz = own
        c00 = yy * zz - yz * yz
        c01 = xz * yz - xy * zz
        c02 = xy * yz - xz * yy
        c11 = xx * zz - xz * xz
        c12 = xy * xz - xx * yz
        c22 = xx * yy - xy * xy
        determinant = xx * c00 + xy * c01 + xz * c02
        minors = c00 + c11 + c22
        size = xx + yy + zz
        rank = full
        # the part of each axis that the grains span
        px = 1.0
        py = 1.0
        pz = 1.0
        if not trace > rounding:
            rank = 0
            px, py, pz = 0.0, 0.0, 0.0
            c00 = 0.0
            c01 = 0.0
            c02 = 0.0
            c11 = 0.0
            c12 = 0.0
            c22 = 0.0
        elif determinant > _WELL_CONDITIONED * own * own * own:
            scale = 1.0 / determinant
            c00, c01, c02 = scale * c00, scale * c01, scale * c02
            c11 = scale * c11
            c12 = scale * c12
            c22 = scale * c22
        elif minors <= _ONE_LINE * size * size:
            rank = full - 2
            scale = 1.0 / size
            px, py, pz = scale * xx, scale * yy, scale * zz
            scale = scale * scale
            c00, c01, c02 = scale * xx, scale * xy, scale * xz
            c11 = scale * yy
            c12 = scale * yz
            c22 = scale * zz
        elif minors > _WELL_SPREAD * size * size and abs(determinant) <= _ONE_PLANE * minors * size:
            rank = full - 1
            scale = 1.0 / minors
            px = 1.0 - scale * c00
            py = 1.0 - scale * c11
            pz = 1.0 - scale * c22
            across = -scale * size
            c00 = scale * (size * px - xx)
            c01 = scale * (across * c01 - xy)
            c02 = scale * (across * c02 - xz)
            c11 = scale * (size * py - yy)
            c12 = scale * (across * c12 - yz)
            c22 = scale * (size * pz - zz)
        else:
            xx, yy, zz = along_active(xx, yy, zz, active)
            rank, spanned, pseudo = _inverse_of_rank(xx, xy, xz, yy, yz, zz, rounding)
            px, py, pz = spanned
            c00, c01, c02, c11, c12, c22 = pseudo
        # the spread that stands for offsets of zero has an inverse too, which is not part of M^+
        of_xx, of_yy, of_zz = along_active(c00, c11, c22, active)
        _put_three(rows, inverse, n, (of_xx, c01, c02))
        _put_three(rows, inverse + three, n, (of_yy, c12, of_zz))
        factor_x = _one_if(mass > 0.0 and (px > _SPANNED or not active[0]))
        factor_y = _one_if(mass > 0.0 and (py > _SPANNED or not active[1]))
        factor_z = _one_if(mass > 0.0 and (pz > _SPANNED or not active[2]))
        _put_three(rows, determined, n, (factor_x, factor_y, factor_z))
        b0, b1, b2 = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if mass > 0.0:
            u, v, w = _three(rows, momentum, n)
            b0 = _moved(_three(rows, shear, n), u / mass, offsets)
            b1 = _moved(_three(rows, shear + three, n), v / mass, offsets)
            b2 = _moved(_three(rows, shear + three + three, n), w / mass, offsets)
        c0, c1, c2 = (c00, c01, c02), (c01, c11, c12), (c02, c12, c22)
        g0 = dot(b0, c0), dot(b0, c1), dot(b0, c2)
        g1 = dot(b1, c0), dot(b1, c1), dot(b1, c2)
        g2 = dot(b2, c0), dot(b2, c1), dot(b2, c2)
        _put_three(rows, gradient, n, g0)
        _put_three(rows, gradient + three, n, g1)
        _put_three(rows, gradient + three + three, n, g2)
        # a fit through rank + 1 grains leaves nothing over: their fluctuation is unknown, not zero
        factor = _one_if(rows[count, n] > rank + 1)
        e00 = factor * dot(g0, b0)
        e01 = factor * dot(g0, b1)
        e02 = factor * dot(g0, b2)
        e11 = factor * dot(g1, b1)
        e12 = factor * dot(g1, b2)
        e22 = factor * dot(g2, b2)
        _put_three(rows, explained, n, (e00, e01, e02))
        _put_three(rows, explained + three, n, (e11, e12, e22))
