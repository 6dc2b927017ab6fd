"""Exact volumes that spheres, or discs, share with the cells of a mesh along x, y and z.

With U(a, b, c) the volume of the unit ball beyond three planes, x > a, y > b and z > c, a box takes the sum of U at its
eight corners with the signs of inclusion and exclusion. U is the integral over z of the circle's part beyond two lines,
in closed form (below), so that shares are right to rounding of the whole ball.
"""

import math

import numpy as np

from xcg.compiled._jit import inner, leaf

_BALL = 4.0 * math.pi / 3.0


@inner
def _primitive(z, a, root):
    """Integral over z of (1 - z^2) asin(a / sqrt(1 - z^2)) / 2 + a sqrt(1 - a^2 - z^2) / 2, for 0 <= a.

    All angles are taken from one `root` of 1 - a^2 - z^2: its error then has no effect to first order.
    """
    return (
        0.5 * (z - z * z * z / 3.0) * math.atan2(a, root) + a * z * root / 3.0
        + (a / 3.0 + a * (1.0 - a * a) / 6.0) * math.atan2(z, root) - math.atan2(a * z, root) / 3.0
    )  # fmt: skip


@inner
def _in_octant(a, b, c):
    """U(a, b, c) for planes that are not below the centre."""
    end = 1.0 - a * a - b * b
    if end <= c * c:
        return 0.0
    z = math.sqrt(end)
    volume = 0.25 * math.pi * (z - z * z * z / 3.0 - c + c * c * c / 3.0) + a * b * (z - c)
    rest = (z - c) * (z + c)  # of 1 - a^2 - b^2 - c^2
    volume -= _primitive(z, a, b) - _primitive(c, a, math.sqrt(rest + b * b))
    return max(0.0, volume - _primitive(z, b, a) + _primitive(c, b, math.sqrt(rest + a * a)))


@inner
def _beyond_one(c):
    return math.pi / 3.0 * (1.0 - c) * (1.0 - c) * (2.0 + c)


@inner
def _beyond_two(b, c):
    """Volume of the unit ball with y > b and z > c, both from -1 to 1."""
    volume, sign = 0.0, 1.0
    if b < 0.0:
        volume, sign, b = _beyond_one(c), -1.0, -b
    if c < 0.0:
        return volume + sign * (_beyond_one(b) - 2.0 * _in_octant(0.0, b, -c))
    return volume + sign * 2.0 * _in_octant(0.0, b, c)


@inner
def ball_beyond(a, b, c):
    """Volume of the unit ball with x > a, y > b and z > c."""
    a, b, c = min(1.0, max(-1.0, a)), min(1.0, max(-1.0, b)), min(1.0, max(-1.0, c))
    volume, sign = 0.0, 1.0
    if a < 0.0:
        volume, sign, a = _beyond_two(b, c), -1.0, -a
    if b < 0.0:
        volume, sign, b = volume + sign * _beyond_two(a, c), -sign, -b
    if c < 0.0:
        return volume + sign * (_beyond_two(a, b) - _in_octant(a, b, -c))
    return volume + sign * _in_octant(a, b, c)


@inner
def _disc_in_quarter(a, b):
    if a * a + b * b >= 1.0:
        return 0.0
    return (
        0.5 * (0.5 * math.pi - math.asin(a) - math.asin(b))
        - 0.5 * a * math.sqrt(1.0 - a * a) - 0.5 * b * math.sqrt(1.0 - b * b) + a * b
    )  # fmt: skip


@inner
def disc_beyond(a, b):
    """Area of the unit disc with x > a and y > b."""
    a, b = min(1.0, max(-1.0, a)), min(1.0, max(-1.0, b))
    area, sign = 0.0, 1.0
    if a < 0.0:
        side = abs(b)
        half = math.acos(side) - side * math.sqrt(1.0 - side * side)  # of the segment beyond b
        area, sign, a = half if b >= 0.0 else math.pi - half, -1.0, -a
    if b < 0.0:
        half = math.acos(a) - a * math.sqrt(1.0 - a * a)
        return area + sign * (half - _disc_in_quarter(a, -b))
    return area + sign * _disc_in_quarter(a, b)


@leaf
def add_shares(position, radius, values, group, lower, step, count, period, discs, corner, out):
    """Add values of grains to the cells that they overlap, in proportion to the volume that they share.

    Parameters
    ----------
    position, radius, values, group : (n, 3), (n,), (n, k), (n,)
        Grains; `group` says which of the sums each belongs to.
    lower, step, count : (3,)
        Lowest edge, size and number of the cells. An axis with a step of infinity is not divided.
    period : (3,)
        Period, infinity along axes that are not periodic.
    discs : int
        The axis of the discs, whose shares follow from areas; -1 for spheres.
    corner : (m,)
        Scratch: as many numbers as a grain reaches corners of cells.
    out : (groups, nx, ny, nz, k)
        Sums, which are added to.
    """
    full = math.pi if discs >= 0 else _BALL
    for n in range(position.shape[0]):
        r = radius[n]
        ix0, ix1 = _images(position[n, 0], r, lower[0], step[0], count[0], period[0])
        iy0, iy1 = _images(position[n, 1], r, lower[1], step[1], count[1], period[1])
        iz0, iz1 = _images(position[n, 2], r, lower[2], step[2], count[2], period[2])
        for ix in range(ix0, ix1 + 1):
            x = position[n, 0] + (ix * period[0] if ix else 0.0)
            x0, x1 = _cells(x, r, lower[0], step[0], count[0])
            for iy in range(iy0, iy1 + 1):
                y = position[n, 1] + (iy * period[1] if iy else 0.0)
                y0, y1 = _cells(y, r, lower[1], step[1], count[1])
                for iz in range(iz0, iz1 + 1):
                    z = position[n, 2] + (iz * period[2] if iz else 0.0)
                    z0, z1 = _cells(z, r, lower[2], step[2], count[2])
                    ny, nz = y1 - y0 + 2, z1 - z0 + 2
                    for i in range(x0, x1 + 2):
                        a = _face(i, x, r, lower[0], step[0])
                        for j in range(y0, y1 + 2):
                            b = _face(j, y, r, lower[1], step[1])
                            for k in range(z0, z1 + 2):
                                c = _face(k, z, r, lower[2], step[2])
                                if discs == 2:
                                    beyond = disc_beyond(a, b) if c <= 0.0 else 0.0
                                elif discs == 1:
                                    beyond = disc_beyond(a, c) if b <= 0.0 else 0.0
                                elif discs == 0:
                                    beyond = disc_beyond(b, c) if a <= 0.0 else 0.0
                                else:
                                    beyond = ball_beyond(a, b, c)
                                corner[((i - x0) * ny + j - y0) * nz + k - z0] = beyond
                    for i in range(x1 - x0 + 1):
                        for j in range(y1 - y0 + 1):
                            for k in range(z1 - z0 + 1):
                                at, over = (i * ny + j) * nz + k, ((i + 1) * ny + j) * nz + k
                                share = max(0.0, (
                                    (corner[at] - corner[at + 1]) - (corner[at + nz] - corner[at + nz + 1])
                                    - (corner[over] - corner[over + 1]) + (corner[over + nz] - corner[over + nz + 1])
                                ) / full)  # fmt: skip
                                for q in range(values.shape[1]):
                                    out[group[n], x0 + i, y0 + j, z0 + k, q] += share * values[n, q]


@inner
def _images(x, r, lower, step, count, period):
    """First and last periodic image that reaches the cells of an axis."""
    if not (period < np.inf and step < np.inf):
        return 0, 0
    upper = lower + step * count
    return math.ceil((lower - r - x) / period), math.floor((upper + r - x) / period)


@inner
def _cells(x, r, lower, step, count):
    """First and last cell of an axis that a grain may overlap; last below first for none."""
    if not step < np.inf:
        return 0, 0
    return max(0, math.floor((x - r - lower) / step)), min(count - 1, math.floor((x + r - lower) / step))


@inner
def _face(k, x, r, lower, step):
    """Place of the lower face of a cell relative to a grain, in its radii; of an axis that is not divided its ends."""
    if not step < np.inf:
        return -1.0 if k == 0 else 1.0
    return (lower + k * step - x) / r
