"""Rows of the algebra: each operation on two rows, to the bit."""

import math

import numba
import numpy as np
import pytest

from xcg.compiled import program

# of the first row, and of both
OPERATIONS = {
    program.ADD: np.add,
    program.SUBTRACT: np.subtract,
    program.MULTIPLY: np.multiply,
    program.DIVIDE: np.divide,
    program.SQUARE_ROOT: lambda a, _: np.sqrt(a),
    program.WHERE_POSITIVE: lambda a, _: np.where(a > 0.0, a, math.nan),
    program.AT_LEAST_ZERO: lambda a, _: np.where(a < 0.0, 0.0, a),
    program.ZERO_IF_UNKNOWN: lambda a, _: np.where(np.isnan(a), 0.0, a),
}
combine = program._combine


@numba.njit(error_model="numpy")
def call(operation, rows, to, a, b):
    combine(operation, rows, to, a, b)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("operation", OPERATIONS)
@pytest.mark.parametrize("places", [(3, 1, 2), (1, 1, 2), (2, 1, 2), (1, 1, 1)], ids=str)
def test_operations_on_rows_equal_those_of_numpy(operation, places):
    """Also where the result takes the place of an operand."""
    rng = np.random.default_rng(0)
    rows = rng.choice(
        [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 1e-300, 1e300], (4, program.TILE)
    )
    rows[:, ::2] = rng.normal(size=(4, program.TILE // 2))
    to, a, b = places
    expected = rows.copy()
    expected[to] = OPERATIONS[operation](rows[a], rows[b])
    call(np.uint64(operation), rows, *map(np.uint64, places))
    np.testing.assert_array_equal(rows, expected)
    known = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(rows)[known], np.signbit(expected)[known])
