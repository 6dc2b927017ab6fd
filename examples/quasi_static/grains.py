"""Sizes and first places of the grains: polydisperse clouds, and a face-centred cubic array."""

import numpy as np
from numpy.typing import NDArray


def diameters(count: int, ratio: float, d50: float, seed: int) -> NDArray:
    """Draw diameters with equal volume for each interval of log d (series A), largest first.

    Equal volume a log interval is a number density of d^-4, whose cumulative is inverted at stratified points. Half of
    the volume is then below sqrt(dmin dmax) = `d50`.
    """
    low = d50 / np.sqrt(ratio)
    high = d50 * np.sqrt(ratio)
    share = (np.arange(count) + np.random.default_rng(seed).random(count)) / count
    return np.sort((low**-3 - share * (low**-3 - high**-3)) ** (-1 / 3))[::-1]


def cloud(d: NDArray, fraction: float, aspect: float, seed: int) -> tuple[NDArray, NDArray]:
    """Place grains one by one, largest first, where they touch nobody (positions, lengths of the periodic box)."""
    rng = np.random.default_rng(seed)
    side = (np.pi / 6 * (d**3).sum() / fraction / aspect) ** (1 / 3)
    box = np.array([side, side, aspect * side])
    x = np.empty((len(d), 3))
    for n in range(len(d)):
        limit = (0.5 * (d[:n] + d[n])) ** 2
        while True:
            x[n] = rng.random(3) * box
            gap = x[:n] - x[n]
            gap -= box * np.rint(gap / box)
            if ((gap**2).sum(axis=1) > limit).all():
                break
    return x, box


def face_centred_cubic(cells: int, d: float, squeeze: float) -> tuple[NDArray, NDArray]:
    """Array of uniform spheres with axes along <100>, overlapping by `squeeze` d (positions, lengths of the box)."""
    edge = np.sqrt(2) * d * (1 - squeeze)
    corner = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(
        -1, 1, 3
    )
    basis = np.array([[0, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0.5]])
    return ((corner + basis).reshape(-1, 3) + 0.25) * edge, np.full(3, cells * edge)
