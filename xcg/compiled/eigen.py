"""Eigenvalues and eigenvectors of symmetric 3x3 matrices."""

import math

import numpy as np

from xcg.compiled._jit import jit, leaf


@leaf
def diagonalise(matrix, vectors):
    """Cyclic Jacobi rotations: eigenvalues on the diagonal of `matrix`, eigenvectors in the columns of `vectors`."""
    vectors[:] = 0.0
    for k in range(3):
        vectors[k, k] = 1.0
    for _ in range(12):
        off = matrix[0, 1] ** 2 + matrix[0, 2] ** 2 + matrix[1, 2] ** 2
        if off <= 1e-40 * (matrix[0, 0] ** 2 + matrix[1, 1] ** 2 + matrix[2, 2] ** 2):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if matrix[p, q] == 0.0:
                    continue
                ratio = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
                t = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(ratio * ratio + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    a, b = matrix[k, p], matrix[k, q]
                    matrix[k, p], matrix[k, q] = c * a - s * b, s * a + c * b
                for k in range(3):
                    a, b = matrix[p, k], matrix[q, k]
                    matrix[p, k], matrix[q, k] = c * a - s * b, s * a + c * b
                for k in range(3):
                    a, b = vectors[k, p], vectors[k, q]
                    vectors[k, p], vectors[k, q] = c * a - s * b, s * a + c * b


@leaf
def descending(diagonal):
    """Places of the diagonal entries of a 3x3 matrix from the largest to the smallest; all three, NaN or not."""
    first = 0
    for k in range(1, 3):
        if diagonal[k, k] > diagonal[first, first]:
            first = k
    one = 1 if first == 0 else 0
    other = 3 - first - one
    return (first, one, other) if diagonal[other, other] <= diagonal[one, one] else (first, other, one)


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
    matrix, columns = np.zeros((3, 3)), np.zeros((3, 3))
    for n in range(tensor.shape[0]):
        for i in range(3):
            for j in range(3):
                matrix[i, j] = 0.5 * (tensor[n, i, j] + tensor[n, j, i])
        diagonalise(matrix, columns)
        order = descending(matrix)
        for k in range(3):
            values[n, k] = matrix[order[k], order[k]]
            for i in range(3):
                vectors[n, k, i] = columns[i, order[k]]
