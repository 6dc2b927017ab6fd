"""Symmetric matrices 3x3: eigenvalues and eigenvectors."""

import math

import numpy as np

from xcg.compiled._jit import inlined, inner, jit
from xcg.compiled.simd import TILE

# A matrix is diagonal where squares off the diagonal are below this share of those on it.
_DIAGONAL = 1e-40
_MOST_SWEEPS = 12  # a handful are taken


@inner
def dot(a, b):
    """Scalar product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


# --- Jacobi's rotations, of one matrix ---


@inlined
def _turn(pp, qq, pq):
    """Cosine and sine of the turn of axes p and q after which their entry `pq`, not zero, vanishes."""
    ratio = (qq - pp) / (2.0 * pq)
    t = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(ratio * ratio + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    return c, t * c


@inner
def _rotated(pp, qq, pq, rp, rq, p, q):
    """Entries pp, qq, rp and rq of a matrix, and its axes p and q (3,), turned so that the entry pq vanishes."""
    if pq == 0.0:
        return pp, qq, rp, rq, p, q
    c, s = _turn(pp, qq, pq)
    t = s / c
    turned_p = c * p[0] - s * q[0], c * p[1] - s * q[1], c * p[2] - s * q[2]
    turned_q = s * p[0] + c * q[0], s * p[1] + c * q[1], s * p[2] + c * q[2]
    return pp - t * pq, qq + t * pq, c * rp - s * rq, s * rp + c * rq, turned_p, turned_q


@inner
def principal_of_one(xx, xy, xz, yy, yz, zz):
    """Eigenvalues of a symmetric matrix, in any order, and the unit eigenvector (3,) of each."""
    a, b, c = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    for _ in range(_MOST_SWEEPS):
        if not xy * xy + xz * xz + yz * yz > _DIAGONAL * (xx * xx + yy * yy + zz * zz):
            break
        xx, yy, xz, yz, a, b = _rotated(xx, yy, xy, xz, yz, a, b)
        xx, zz, xy, yz, a, c = _rotated(xx, zz, xz, 0.0, yz, a, c)
        yy, zz, xy, xz, b, c = _rotated(yy, zz, yz, xy, 0.0, b, c)
        yz = 0.0
    return (xx, yy, zz), (a, b, c)


# --- of as many matrices at a time as there are numbers in an instruction ---


@inner
def _unfinished(matrix, turns):
    """Mark the matrices (3, 3, TILE) that are not diagonal yet; return whether any is left."""
    some = False
    for n in range(TILE):
        off = matrix[0, 1, n] ** 2 + matrix[0, 2, n] ** 2 + matrix[1, 2, n] ** 2
        on = matrix[0, 0, n] ** 2 + matrix[1, 1, n] ** 2 + matrix[2, 2, n] ** 2
        turns[n] = not off <= _DIAGONAL * on
        some |= turns[n]
    return some


@inlined
def _turn_rows(first, second, cosine, sine):
    """Turn pairs of numbers (TILE,) by angles."""
    for n in range(TILE):
        a, b = first[n], second[n]
        first[n] = cosine[n] * a - sine[n] * b
        second[n] = sine[n] * a + cosine[n] * b


@inner
def _rotate(matrix, vectors, p, q, turns, cosine, sine):
    """Turn the axes p and q of the marked matrices (3, 3, TILE) so that their entries p, q vanish."""
    for n in range(TILE):
        c, s = _turn(matrix[p, p, n], matrix[q, q, n], matrix[p, q, n])
        turn = turns[n] & (matrix[p, q, n] != 0.0)
        cosine[n], sine[n] = (c, s) if turn else (1.0, 0.0)
    for k in range(3):
        _turn_rows(matrix[k, p], matrix[k, q], cosine, sine)
        _turn_rows(vectors[k, p], vectors[k, q], cosine, sine)
    for k in range(3):
        _turn_rows(matrix[p, k], matrix[q, k], cosine, sine)


@inner
def _descending(matrix, n):
    """Return the indices of the diagonal entries of matrix n, the largest first; all three, NaN or not."""
    first = 0
    for k in range(1, 3):
        if matrix[k, k, n] > matrix[first, first, n]:
            first = k
    second = int(first == 0)
    third = 3 - first - second
    if matrix[third, third, n] <= matrix[second, second, n]:
        return first, second, third
    return first, third, second


@inlined
def _quotient(tensor, axis):
    """Rayleigh quotient of a matrix (3, 3) and an axis (3,): without the rounding of all turns."""
    upper = 0.0
    lower = 0.0
    for i in range(3):
        lower += axis[i] * axis[i]
        for j in range(3):
            upper += axis[i] * tensor[i, j] * axis[j]
    return upper / lower


@jit
def principal(tensor, values, vectors):
    """Eigenvalues, largest first, and eigenvectors of symmetric matrices.

    Parameters
    ----------
    tensor : (n, 3, 3)
        Matrices; of each, the symmetric part counts.
    values : (n, 3)
        Eigenvalues, descending; set here.
    vectors : (n, 3, 3)
        Unit eigenvectors, one a row, in the same order; set here.
    """
    matrix = np.zeros((3, 3, TILE))
    axes = np.empty((3, 3, TILE))
    turns = np.empty(TILE, np.bool_)
    cosine = np.empty(TILE)
    sine = np.empty(TILE)
    for first in range(0, tensor.shape[0], TILE):
        # what is left in the last tile is finished already
        many = min(TILE, tensor.shape[0] - first)
        for n in range(many):
            for i in range(3):
                for j in range(3):
                    matrix[i, j, n] = 0.5 * (tensor[first + n, i, j] + tensor[first + n, j, i])
        axes[:] = 0.0
        for k in range(3):
            axes[k, k] = 1.0
        for _ in range(_MOST_SWEEPS):
            if not _unfinished(matrix, turns):
                break
            for p in range(2):
                for q in range(p + 1, 3):
                    _rotate(matrix, axes, p, q, turns, cosine, sine)
        for n in range(many):
            for k in range(3):
                matrix[k, k, n] = _quotient(tensor[first + n], axes[:, k, n])
            order = _descending(matrix, n)
            for k in range(3):
                values[first + n, k] = matrix[order[k], order[k], n]
                for i in range(3):
                    vectors[first + n, k, i] = axes[i, order[k], n]
