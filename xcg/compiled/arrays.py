"""Functions shared by loops: rules of Gauss-Legendre, sorting, rounding, periodic images."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, leaf


@lru_cache
def gauss_rules(*orders: int) -> tuple[NDArray, NDArray]:
    """Points and weights of Gauss-Legendre rules on [0, 1]: the rule of n points fills the first n columns of row n."""
    points = np.zeros((max(orders) + 1, max(orders)))
    weights = np.zeros_like(points)
    for n in orders:
        x, w = np.polynomial.legendre.leggauss(n)
        points[n, :n] = 0.5 + 0.5 * x
        weights[n, :n] = 0.5 * w
    points.flags.writeable = weights.flags.writeable = (
        False  # as loops know those that are constants of a module
    )
    return points, weights


@leaf
def sort_by_key(key, start, order):
    """Write which thing comes first, second, ... (n,) by its key (n,), a whole number; things of one key stay in order.

    `start` (keys + 1,) is zeros before; afterwards ``start[k]`` is one past the last index of key
    k.
    """
    for n in range(key.size):
        start[key[n] + 1] += 1
    for k in range(start.size - 1):
        start[k + 1] += start[k]
    for n in range(key.size):
        order[start[key[n]]] = n
        start[key[n]] += 1


def short_integers(most: int) -> str:
    """Return the type of whole numbers up to `most`: of four bytes if they are enough."""
    return "int32" if most < 2**31 else "int64"


def counting_sort(key: NDArray, keys: int) -> NDArray:
    """Return the order of things (n,) by their keys (n,) below `keys`, see `sort_by_key`, in the type of the keys."""
    order = np.empty_like(key)
    sort_by_key(key, np.zeros(keys + 1, order.dtype), order)
    return order


@leaf
def nearest_image(d, period):
    """Nearest image of a distance along one axis; the period is infinite along axes that are not periodic."""
    return image_near(d, 0.0, period)


@inlined
def image_of(x, number, period):
    """Coordinate of a periodic image; the period may be infinite where the number is 0."""
    if number == 0:
        return x
    return x + number * period


@inlined
def along_active(x, y, z, active):
    """Components of a vector along the axes that count, and zero along the others."""
    if not active[0]:
        x = 0.0
    if not active[1]:
        y = 0.0
    if not active[2]:
        z = 0.0
    return x, y, z


@inner
def image_near(d, to, period):
    """Image of a distance along one axis that is nearest to another distance, see `nearest_image`."""
    if abs(d - to) < 0.49 * period:  # most are: no division
        return d
    if not np.isfinite(period):
        return d
    return d - period * np.rint((d - to) / period)


class Reduced(NamedTuple):
    """A lattice by its shortest vectors.

    Attributes
    ----------
    vectors : (k, 3)
        Minkowski-reduced basis.
    dual : (k, 3)
        Its reciprocal: ``dual @ (n @ vectors)`` is n.
    around : (m, 3)
        All sums of these vectors with factors -1, 0 and 1, but for zero.
    """

    vectors: NDArray
    dual: NDArray
    around: NDArray


@inner
def nearest_of(x, y, z, lattice):
    """Shortest image of a vector: that of the rounded coordinates, or one around it, as the basis is reduced."""
    vectors, dual, around = lattice
    to_x, to_y, to_z = x, y, z
    for k in range(vectors.shape[0]):
        number = np.rint(dual[k, 0] * x + dual[k, 1] * y + dual[k, 2] * z)
        to_x -= number * vectors[k, 0]
        to_y -= number * vectors[k, 1]
        to_z -= number * vectors[k, 2]
    least = to_x * to_x + to_y * to_y + to_z * to_z
    best = -1
    for k in range(around.shape[0]):
        image_x = to_x + around[k, 0]
        image_y = to_y + around[k, 1]
        image_z = to_z + around[k, 2]
        length2 = image_x * image_x + image_y * image_y + image_z * image_z
        if length2 < least:
            least = length2
            best = k
    if best < 0:
        return to_x, to_y, to_z
    return to_x + around[best, 0], to_y + around[best, 1], to_z + around[best, 2]


@leaf
def nearest_images(vector, lattice, out):
    """Write the shortest image of each vector (n, 3), see `nearest_of`."""
    for n in range(vector.shape[0]):
        out[n, 0], out[n, 1], out[n, 2] = nearest_of(
            vector[n, 0], vector[n, 1], vector[n, 2], lattice
        )


@leaf
def round_bits(bits, drop, special):
    """Round floating-point numbers, given as integers (n,), to nearest even without their last `drop` bits.

    Numbers whose bits `special` are all set are infinite or NaN and stay as they are.
    """
    one = bits.dtype.type(1)
    half = (one << (drop - one)) - one
    mask = ~((one << drop) - one)
    for n in range(bits.size):
        x = bits[n]
        if x & special != special:
            bits[n] = (x + half + ((x >> drop) & one)) & mask
