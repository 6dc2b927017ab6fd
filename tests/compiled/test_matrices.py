"""Eigenvalues of symmetric matrices."""

from fractions import Fraction

import numpy as np

from xcg.compiled import matrices


def test_principal_values_are_exact_to_rounding():
    """Their error is the step of Newton's method on the characteristic polynomial, in fractions."""
    tensor = np.random.default_rng(7).normal(size=(300, 3, 3))
    tensor = tensor + tensor.transpose(0, 2, 1)
    values = np.empty((300, 3))
    matrices.principal(tensor, values, np.empty((300, 3, 3)))
    for matrix, found in zip(tensor.tolist(), values.tolist(), strict=True):
        (a, d, e), (_, b, f), (_, _, c) = [[Fraction(entry) for entry in row] for row in matrix]
        trace = a + b + c
        minors = a * b - d * d + a * c - e * e + b * c - f * f
        determinant = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
        for value in map(Fraction, found):
            polynomial = ((value - trace) * value + minors) * value - determinant
            slope = (3 * value - 2 * trace) * value + minors
            assert abs(polynomial / slope) < 1e-15 * max(map(abs, found))
