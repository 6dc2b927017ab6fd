"""Sums of rows by index, and vectors between rows."""

import numpy as np

from xcg.kernels._jit import jit


@jit
def add_rows(row, values, out):
    """Add values (n, k) to the rows of out (m, k) that `row` (n,) names; negative rows are left out."""
    for n in range(row.size):
        if row[n] >= 0:
            for c in range(values.shape[1]):
                out[row[n], c] += values[n, c]


@jit
def add_dyads(row, sign, a, b, out):
    """Add sign a b, (n, 3) each, to the rows of out (m, 3, 3) that `row` (n,) names; negative rows are left out."""
    for n in range(row.size):
        if row[n] >= 0:
            for i in range(3):
                for j in range(3):
                    out[row[n], i, j] += sign * a[n, i] * b[n, j]


@jit
def nearest_image(position, row, point, period, out):
    """Write the shortest image of position[row] - point to out (n, 3), zero for negative rows.

    `period` (3,) holds infinity along axes that are not periodic.
    """
    for n in range(row.size):
        for k in range(3):
            out[n, k] = 0.0
            if row[n] >= 0:
                d = position[row[n], k] - point[n, k]
                if np.isfinite(period[k]):
                    d -= period[k] * np.rint(d / period[k])
                out[n, k] = d
