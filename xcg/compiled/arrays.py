"""What several loops need: rules of Gauss-Legendre, sorting by counting, transposing, bounds, the nearest image."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inner, leaf


@lru_cache
def gauss_rules(*orders: int) -> tuple[NDArray, NDArray]:
    """Points and weights of Gauss-Legendre rules on [0, 1]: those of n points fill the first n places of row n."""
    points = np.zeros((max(orders) + 1, max(orders)))
    weights = np.zeros_like(points)
    for n in orders:
        x, w = np.polynomial.legendre.leggauss(n)
        points[n, :n], weights[n, :n] = 0.5 + 0.5 * x, 0.5 * w
    return points, weights


@leaf
def counting_sort_places(key, start, place):
    """Write the place (n,) of each thing among all by its key (n,), a whole number; things of one key keep their order.

    `start` (keys + 1,) is zeros before; afterwards ``start[k]`` is one past the last place of key k.
    """
    for n in range(key.size):
        start[key[n] + 1] += 1
    for k in range(start.size - 1):
        start[k + 1] += start[k]
    for n in range(key.size):
        k = key[n]
        place[n] = start[k]
        start[k] += 1


def short_integers(most: int) -> str:
    """Return the type of whole numbers up to `most`: of four bytes if they are enough."""
    return "int32" if most < 2**31 else "int64"


def counting_sort(key: NDArray, keys: int) -> NDArray:
    """Return which thing comes first, second, ... (n,) by its key (n,), a whole number below `keys`, in its type.

    Things of one key keep their order.
    """
    order = np.empty_like(key)
    _counting_sort_order(key, np.zeros(keys + 1, order.dtype), order)
    return order


@leaf
def _counting_sort_order(key, start, order):
    for n in range(key.size):
        start[key[n] + 1] += 1
    for k in range(start.size - 1):
        start[k + 1] += start[k]
    for n in range(key.size):
        order[start[key[n]]] = n
        start[key[n]] += 1


@leaf
def transpose_columns(records, column, factor, out):
    """Write columns of records (p, n, c), times a factor for each p, nodes last: each record is read once, in order.

    ``out[r, p, n] = factor[r, p] * records[p, n, column[r]]`` for r = 0, ... column.size - 1.
    """
    for p in range(records.shape[0]):
        for n in range(records.shape[1]):
            for r in range(column.size):
                out[r, p, n] = factor[r, p] * records[p, n, column[r]]


@leaf
def all_finite(numbers):
    """Whether all numbers (n,) are finite."""
    finite = True
    for n in range(numbers.size):
        finite &= abs(numbers[n]) < np.inf
    return finite


@leaf
def bounds_of(position):
    """Lowest and highest coordinates, (3,) each, of points (n, 3), NaN where any is; infinity, -infinity of none."""
    inf = np.inf
    x0, y0, z0, x1, y1, z1 = inf, inf, inf, -inf, -inf, -inf
    for n in range(position.shape[0]):
        x, y, z = position[n, 0], position[n, 1], position[n, 2]
        x0, y0, z0 = np.minimum(x, x0), np.minimum(y, y0), np.minimum(z, z0)
        x1, y1, z1 = np.maximum(x, x1), np.maximum(y, y1), np.maximum(z, z1)
    return (x0, y0, z0), (x1, y1, z1)


@leaf
def nearest_image(d, period):
    """Nearest image of a distance along one axis; the period is infinite along axes that are not periodic."""
    return image_near(d, 0.0, period)


@inner
def image_near(d, to, period):
    """Image of a distance along one axis that is nearest to another distance, see `nearest_image`."""
    if abs(d - to) < 0.49 * period:  # most are: no division
        return d
    return d - period * np.rint((d - to) / period) if np.isfinite(period) else d
