"""Sums of rows by index."""

from xcg.kernels._jit import jit


@jit
def add_rows(row, values, out):
    """Add values (n, k) to the rows of out (m, k) that `row` (n,) names; negative rows are left out."""
    for n in range(row.size):
        if row[n] >= 0:
            for c in range(values.shape[1]):
                out[row[n], c] += values[n, c]
