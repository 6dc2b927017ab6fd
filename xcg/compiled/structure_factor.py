"""Sums of plane waves over particles."""

import math

import numpy as np

from xcg.compiled._jit import jit

LANES = 8  # particles side by side in vector instructions


@jit
def sum_waves(angle, numbers, sums):
    """Add up ``exp(i numbers . angle)`` over particles.

    Parameters
    ----------
    angle : (n, dimension)
        2 pi times the coordinates of each particle in the lattice.
    numbers : (m, dimension)
        Whole numbers of each wave.
    sums : (m, 2)
        Real and imaginary parts, set here. Their bits do not depend on the other waves.
    """
    count, dimension = angle.shape
    waves = numbers.shape[0]
    most = 0
    for m in range(waves):
        for d in range(dimension):
            most = max(most, abs(numbers[m, d]))
    # an axis that a layer does not have is a factor of one
    cosine = np.ones((3, 2 * most + 1, LANES))
    sine = np.zeros((3, 2 * most + 1, LANES))
    real = np.zeros((waves, LANES))
    imaginary = np.zeros((waves, LANES))
    for first in range(0, count, LANES):
        for lane in range(LANES):
            n = first + lane
            for d in range(dimension):
                for h in range(most + 1):
                    re = 0.0
                    im = 0.0
                    if n < count:
                        re = math.cos(h * angle[n, d])
                        im = math.sin(h * angle[n, d])
                    cosine[d, most + h, lane] = re
                    sine[d, most + h, lane] = im
                    cosine[d, most - h, lane] = re
                    sine[d, most - h, lane] = -im
        for m in range(waves):
            a = numbers[m, 0] + most
            b = numbers[m, 1] + most
            c = most
            if dimension == 3:
                c += numbers[m, 2]
            for lane in range(LANES):
                re = cosine[0, a, lane] * cosine[1, b, lane] - sine[0, a, lane] * sine[1, b, lane]
                im = cosine[0, a, lane] * sine[1, b, lane] + sine[0, a, lane] * cosine[1, b, lane]
                real[m, lane] += re * cosine[2, c, lane] - im * sine[2, c, lane]
                imaginary[m, lane] += re * sine[2, c, lane] + im * cosine[2, c, lane]
    for m in range(waves):
        sums[m, 0], sums[m, 1] = real[m].sum(), imaginary[m].sum()
