"""Eigenvalues and eigenvectors of 3x3 matrices, symmetric or not."""

import math

import numpy as np

from xcg.compiled._jit import inlined, inner, jit
from xcg.compiled.simd import TILE

# Parts of a pair of complex eigenvalues below this share of the matrix are rounding of a real pair.
_IMAGINARY = 1e-14
# A matrix is diagonal where squares off the diagonal are below this share of those on it; a handful of sweeps.
_DIAGONAL, _MOST_SWEEPS = 1e-40, 12
_MOST_STEPS = 100  # of Newton's method; a handful, but where all eigenvalues are nearly zero


# --- symmetric: Jacobi's rotations, of one matrix ---


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


# --- symmetric: of as many matrices at a time as there are numbers in an instruction ---


@inner
def _unfinished(matrix, turns):
    """Mark the matrices (3, 3, TILE) that are not diagonal yet; return whether any is left."""
    some = False
    for n in range(TILE):
        off = matrix[0, 1, n] ** 2 + matrix[0, 2, n] ** 2 + matrix[1, 2, n] ** 2
        turns[n] = not off <= _DIAGONAL * (matrix[0, 0, n] ** 2 + matrix[1, 1, n] ** 2 + matrix[2, 2, n] ** 2)
        some |= turns[n]
    return some


@inner
def _rotate(matrix, vectors, p, q, turns, cosine, sine):
    """Turn the axes p and q of the marked matrices (3, 3, TILE) so that their entries p, q vanish."""
    for n in range(TILE):
        c, s = _turn(matrix[p, p, n], matrix[q, q, n], matrix[p, q, n])
        turn = turns[n] & (matrix[p, q, n] != 0.0)
        cosine[n], sine[n] = (c, s) if turn else (1.0, 0.0)
    for k in range(3):
        for n in range(TILE):
            a, b = matrix[k, p, n], matrix[k, q, n]
            matrix[k, p, n], matrix[k, q, n] = cosine[n] * a - sine[n] * b, sine[n] * a + cosine[n] * b
    for k in range(3):
        for n in range(TILE):
            a, b = matrix[p, k, n], matrix[q, k, n]
            matrix[p, k, n], matrix[q, k, n] = cosine[n] * a - sine[n] * b, sine[n] * a + cosine[n] * b
    for k in range(3):
        for n in range(TILE):
            a, b = vectors[k, p, n], vectors[k, q, n]
            vectors[k, p, n], vectors[k, q, n] = cosine[n] * a - sine[n] * b, sine[n] * a + cosine[n] * b


@inner
def _descending(matrix, n):
    """Places of the diagonal entries of matrix n from the largest to the smallest; all three, NaN or not."""
    first = 0
    for k in range(1, 3):
        if matrix[k, k, n] > matrix[first, first, n]:
            first = k
    one = 1 if first == 0 else 0
    other = 3 - first - one
    return (first, one, other) if matrix[other, other, n] <= matrix[one, one, n] else (first, other, one)


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
    matrix, axes, turns = np.zeros((3, 3, TILE)), np.empty((3, 3, TILE)), np.empty(TILE, np.bool_)
    cosine, sine = np.empty(TILE), np.empty(TILE)
    for first in range(0, tensor.shape[0], TILE):
        many = min(TILE, tensor.shape[0] - first)  # what is left in the last tile is finished already
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
            order = _descending(matrix, n)
            for k in range(3):
                values[first + n, k] = matrix[order[k], order[k], n]
                for i in range(3):
                    vectors[first + n, k, i] = axes[i, order[k], n]


# --- not symmetric: one real eigenvalue that is apart from the others, and then those of a 2x2 matrix ---


@inner
def _root_apart(linear, constant):
    """Find the largest root of ``x^3 + linear x = constant >= 0``: the others are at least as far from it as zero is.

    Newton's method comes down to it from above, where the polynomial is convex.
    """
    if -4.0 * linear**3 >= 27.0 * constant**2:  # three real roots
        root = math.sqrt(max(0.0, -4.0 / 3.0 * linear))
    else:
        root = constant ** (1.0 / 3.0) + math.sqrt(max(0.0, -linear))
    for _ in range(_MOST_STEPS):
        lower = root - ((root * root + linear) * root - constant) / (3.0 * root * root + linear)
        if not lower < root:
            break
        root = lower
    return root


@inner
def _null_vector(matrix, shift, vector):
    """Write the unit vector that a matrix less `shift` x identity maps to zero: the longest product of two rows."""
    most = 0.0
    for i in range(2):
        for j in range(i + 1, 3):
            ax, ay, az = matrix[i, 0] - shift * (i == 0), matrix[i, 1] - shift * (i == 1), matrix[i, 2]
            bx, by, bz = matrix[j, 0], matrix[j, 1] - shift * (j == 1), matrix[j, 2] - shift * (j == 2)
            x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            length2 = x * x + y * y + z * z
            if length2 > most:
                most = length2
                vector[0], vector[1], vector[2] = x, y, z
    if most == 0.0:  # zero, or a dyad of vectors at right angles, which maps its own columns to zero
        vector[0], vector[1], vector[2] = 1.0, 0.0, 0.0
        for k in range(3):
            if matrix[0, k] != 0.0 or matrix[1, k] != 0.0 or matrix[2, k] != 0.0:
                vector[0], vector[1], vector[2] = matrix[0, k], matrix[1, k], matrix[2, k]
        most = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
    for k in range(3):
        vector[k] /= math.sqrt(most)


@inner
def _reflect(vector, matrix, reflection, product):
    """Turn a matrix by the reflection that leads from the first axis to a unit vector, or to its opposite."""
    vector[0] += math.copysign(1.0, vector[0])
    factor = 2.0 / (vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    for i in range(3):
        for j in range(3):
            reflection[i, j] = 1.0 * (i == j) - factor * vector[i] * vector[j]
    for a, b, out in ((matrix, reflection, product), (reflection, product, matrix)):
        for i in range(3):
            for j in range(3):
                out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@jit
def principal_of_any(tensor, values, vectors):
    """Real eigenvalues, largest first, and right eigenvectors of matrices that need not be symmetric.

    A matrix without its mean diagonal has a real eigenvalue that is at least as far from the others as from zero. Its
    eigenvector is well defined; in axes that begin with it, the rest is a 2x2 matrix.

    Parameters
    ----------
    tensor : (n, 3, 3)
        Matrices.
    values : (n, 3)
        Eigenvalues, descending, NaN in place of the complex ones; set here.
    vectors : (n, 3, 3)
        Unit eigenvectors, one a row, in the same order; set here.
    """
    matrix, reflection, product, vector = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for n in range(tensor.shape[0]):
        size = 0.0
        for i in range(3):
            for j in range(3):
                size = max(size, abs(tensor[n, i, j]))
        per_size = 1.0 / size if size > 0.0 else 0.0
        mean = (tensor[n, 0, 0] + tensor[n, 1, 1] + tensor[n, 2, 2]) * per_size / 3.0
        for i in range(3):
            for j in range(3):
                matrix[i, j] = tensor[n, i, j] * per_size - mean * (i == j)
        (a, b, c), (d, e, f), (g, h, k) = matrix
        linear = a * e - b * d + a * k - c * g + e * k - f * h
        determinant = a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g)
        _null_vector(matrix, math.copysign(_root_apart(linear, abs(determinant)), determinant), vector)
        _reflect(vector, matrix, reflection, product)
        _write_pairs(matrix, reflection, mean, size, values[n], vectors[n])


@inner
def _write_pairs(matrix, reflection, mean, size, values, vectors):
    """Write eigenvalues and eigenvectors of a matrix whose first axis is an eigenvector, turned back and scaled."""
    apart, middle, half = matrix[0, 0], 0.5 * (matrix[1, 1] + matrix[2, 2]), 0.5 * (matrix[1, 1] - matrix[2, 2])
    above, below = matrix[1, 2], matrix[2, 1]
    square = half * half + above * below
    root = math.sqrt(max(0.0, square)) if square >= -(_IMAGINARY**2) else math.nan
    place = 0 if not apart < middle + root else (1 if apart >= middle - root else 2)
    sign = 1.0
    for k in range(3):
        if k == place:
            value, x, y, z = apart, 1.0, 0.0, 0.0
        else:
            value = middle + sign * root
            if half * sign > 0.0 or (half == 0.0 and abs(below) >= abs(above)):
                y, z = half + sign * root, below
            else:
                y, z = above, sign * root - half
            if y == 0.0 and z == 0.0:  # a multiple of the identity
                y, z = (1.0, 0.0) if sign > 0.0 else (0.0, 1.0)
            x = matrix[0, 1] * y + matrix[0, 2] * z
            if x != 0.0:  # else it is at right angles to the first
                y, z = (value - apart) * y, (value - apart) * z
            sign = -sign
        length = math.sqrt(x * x + y * y + z * z)
        values[k] = (value + mean) * size
        for i in range(3):
            vectors[k, i] = (reflection[i, 0] * x + reflection[i, 1] * y + reflection[i, 2] * z) / length
