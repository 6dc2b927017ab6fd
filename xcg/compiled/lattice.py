"""The nearest of all periodic images of a vector, in boxes whose edges are not along x, y and z."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inner, leaf


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
    least, best = to_x * to_x + to_y * to_y + to_z * to_z, -1
    for k in range(around.shape[0]):
        image_x, image_y, image_z = to_x + around[k, 0], to_y + around[k, 1], to_z + around[k, 2]
        length2 = image_x * image_x + image_y * image_y + image_z * image_z
        if length2 < least:
            least, best = length2, k
    if best < 0:
        return to_x, to_y, to_z
    return to_x + around[best, 0], to_y + around[best, 1], to_z + around[best, 2]


@leaf
def nearest_images(vector, lattice, out):
    """Write the shortest image of each vector (n, 3), see `nearest_of`."""
    for n in range(vector.shape[0]):
        out[n, 0], out[n, 1], out[n, 2] = nearest_of(vector[n, 0], vector[n, 1], vector[n, 2], lattice)
