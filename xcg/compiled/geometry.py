"""Exact geometry: volumes that spheres or discs share with cells, the nearest triangle, and where rays cross triangles.

With U(a, b, c) the volume of the unit ball beyond three planes, x > a, y > b and z > c, a box takes
the sum of U at its eight corners with the signs of inclusion and exclusion. U is the integral over
z of the circle's part beyond two lines, in closed form (below), so that shares are right to
rounding of the whole ball.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inner, leaf
from xcg.compiled.arrays import image_of
from xcg.compiled.reach import periodic_images

_BALL = 4.0 * math.pi / 3.0
MOST_CROSSINGS = 16  # of one ray; further ones are left out
_TIE = 1e-9


# --- spheres and discs in the cells of a mesh along x, y and z -------------------------------------------


@inner
def _primitive(z, a, root):
    """Integral over z of (1 - z^2) asin(a / sqrt(1 - z^2)) / 2 + a sqrt(1 - a^2 - z^2) / 2, for 0 <= a.

    All angles are taken from one `root` of 1 - a^2 - z^2: its error then has no effect to first
    order.
    """
    return (
        0.5 * (z - z * z * z / 3.0) * math.atan2(a, root)
        + a * z * root / 3.0
        + (a / 3.0 + a * (1.0 - a * a) / 6.0) * math.atan2(z, root)
        - math.atan2(a * z, root) / 3.0
    )


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
    volume = 0.0
    sign = 1.0
    if b < 0.0:
        volume = _beyond_one(c)
        sign = -1.0
        b = -b
    if c < 0.0:
        return volume + sign * (_beyond_one(b) - 2.0 * _in_octant(0.0, b, -c))
    return volume + sign * 2.0 * _in_octant(0.0, b, c)


@inner
def ball_beyond(a, b, c):
    """Volume of the unit ball with x > a, y > b and z > c."""
    a = min(1.0, max(-1.0, a))
    b = min(1.0, max(-1.0, b))
    c = min(1.0, max(-1.0, c))
    volume = 0.0
    sign = 1.0
    if a < 0.0:
        volume = _beyond_two(b, c)
        sign = -1.0
        a = -a
    if b < 0.0:
        volume += sign * _beyond_two(a, c)
        sign = -sign
        b = -b
    if c < 0.0:
        return volume + sign * (_beyond_two(a, b) - _in_octant(a, b, -c))
    return volume + sign * _in_octant(a, b, c)


@inner
def _disc_in_quarter(a, b):
    if a * a + b * b >= 1.0:
        return 0.0
    return (
        0.5 * (0.5 * math.pi - math.asin(a) - math.asin(b))
        - 0.5 * a * math.sqrt(1.0 - a * a)
        - 0.5 * b * math.sqrt(1.0 - b * b)
        + a * b
    )


@inner
def disc_beyond(a, b):
    """Area of the unit disc with x > a and y > b."""
    a, b = min(1.0, max(-1.0, a)), min(1.0, max(-1.0, b))
    area = 0.0
    sign = 1.0
    if a < 0.0:
        side = abs(b)
        area = math.acos(side) - side * math.sqrt(1.0 - side * side)  # of the segment beyond b
        if b < 0.0:
            area = math.pi - area
        sign = -1.0
        a = -a
    if b < 0.0:
        half = math.acos(a) - a * math.sqrt(1.0 - a * a)
        return area + sign * (half - _disc_in_quarter(a, -b))
    return area + sign * _disc_in_quarter(a, b)


@inner
def _beyond(a, b, c, discs):
    """Part of the unit ball, or of the unit disc across the axis `discs`, with x > a, y > b and z > c."""
    if discs < 0:
        return ball_beyond(a, b, c)
    planes = (a, b, c)
    if planes[discs] > 0.0:
        return 0.0
    if discs == 0:
        return disc_beyond(b, c)
    if discs == 1:
        return disc_beyond(a, c)
    return disc_beyond(a, b)


class Cells(NamedTuple):
    """Cells of a mesh along x, y and z.

    Attributes
    ----------
    lower, size, shape : (3,)
        Lowest edge, size and number of the cells. An axis with cells of infinite size is not divided.
    period : (3,)
        Period, infinity along axes that are not periodic.
    """

    lower: NDArray
    size: NDArray
    shape: NDArray
    period: NDArray


@leaf
def add_shares(position, radius, values, group, cells, discs, corner, out):
    """Add values of grains to the cells that they overlap, in proportion to the volume that they share.

    Parameters
    ----------
    position, radius, values, group : (n, 3), (n,), (n, k), (n,)
        Grains; `group` says which of the sums each belongs to.
    cells : Cells
        The cells.
    discs : int
        The axis of the discs, whose shares follow from areas; -1 for spheres.
    corner : (m,)
        Scratch: as many numbers as a grain reaches corners of cells.
    out : (groups, nx, ny, nz, k)
        Sums, which are added to.
    """
    lower, size, shape, period = cells
    full = _BALL
    if discs >= 0:
        full = math.pi
    for n in range(position.shape[0]):
        r = radius[n]
        ix0, ix1 = _images(position[n, 0], r, lower[0], size[0], shape[0], period[0])
        iy0, iy1 = _images(position[n, 1], r, lower[1], size[1], shape[1], period[1])
        iz0, iz1 = _images(position[n, 2], r, lower[2], size[2], shape[2], period[2])
        for ix in range(ix0, ix1 + 1):
            x = image_of(position[n, 0], ix, period[0])
            x0, x1 = _cells(x, r, lower[0], size[0], shape[0])
            for iy in range(iy0, iy1 + 1):
                y = image_of(position[n, 1], iy, period[1])
                y0, y1 = _cells(y, r, lower[1], size[1], shape[1])
                for iz in range(iz0, iz1 + 1):
                    z = image_of(position[n, 2], iz, period[2])
                    z0, z1 = _cells(z, r, lower[2], size[2], shape[2])
                    ny, nz = y1 - y0 + 2, z1 - z0 + 2
                    for i in range(x0, x1 + 2):
                        a = _face(i, x, r, lower[0], size[0])
                        for j in range(y0, y1 + 2):
                            b = _face(j, y, r, lower[1], size[1])
                            for k in range(z0, z1 + 2):
                                c = _face(k, z, r, lower[2], size[2])
                                index = ((i - x0) * ny + j - y0) * nz + k - z0
                                corner[index] = _beyond(a, b, c, discs)
                    for i in range(x1 - x0 + 1):
                        for j in range(y1 - y0 + 1):
                            for k in range(z1 - z0 + 1):
                                at = (i * ny + j) * nz + k
                                over = ((i + 1) * ny + j) * nz + k
                                inside = (
                                    (corner[at] - corner[at + 1])
                                    - (corner[at + nz] - corner[at + nz + 1])
                                    - (corner[over] - corner[over + 1])
                                    + (corner[over + nz] - corner[over + nz + 1])
                                )
                                share = max(0.0, inside / full)
                                for q in range(values.shape[1]):
                                    out[group[n], x0 + i, y0 + j, z0 + k, q] += share * values[n, q]


@inner
def _images(x, r, lower, size, count, period):
    """First and last periodic image that reaches the cells of an axis."""
    if not size < np.inf:
        return 0, 0
    return periodic_images(x, -r, r, lower, lower + size * count, period)


@inner
def _cells(x, r, lower, size, count):
    """First and last cell of an axis that a grain may overlap; last below first for none."""
    if not size < np.inf:
        return 0, 0
    return max(0, math.floor((x - r - lower) / size)), min(
        count - 1, math.floor((x + r - lower) / size)
    )


@inner
def _face(k, x, r, lower, size):
    """Return the lower face of a cell relative to a grain, in its radii; of an axis that is not divided its ends."""
    if not size < np.inf:
        return -1.0 if k == 0 else 1.0
    return (lower + k * size - x) / r


# --- triangles of a surface ------------------------------------------------------------------------------


@inner
def _nearest_point(point, corner, foot):
    """Write the point of a triangle (3, 3) nearest to a point into `foot`; after Ericson (2005), 5.1.5."""
    d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        ab = corner[1, k] - corner[0, k]
        ac = corner[2, k] - corner[0, k]
        d1 += ab * (point[k] - corner[0, k])
        d2 += ac * (point[k] - corner[0, k])
        d3 += ab * (point[k] - corner[1, k])
        d4 += ac * (point[k] - corner[1, k])
        d5 += ab * (point[k] - corner[2, k])
        d6 += ac * (point[k] - corner[2, k])
    va = d3 * d6 - d5 * d4
    vb = d5 * d2 - d1 * d6
    vc = d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, w = d1 / (d1 - d3), 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v, w = vb / (va + vb + vc), vc / (va + vb + vc)
    for k in range(3):
        foot[k] = (
            corner[0, k] + v * (corner[1, k] - corner[0, k]) + w * (corner[2, k] - corner[0, k])
        )


@leaf
def nearest(points, corners, normals, centre, radius, foot, distance, triangle):
    """Find the nearest triangle to each point, and the signed distance from it.

    Of triangles that are equally near, which meet at an edge or a corner, the one that faces the
    point most decides its side.

    Parameters
    ----------
    points : (n, 3)
        Points.
    corners, normals, centre, radius : (m, 3, 3), (m, 3), (m, 3), (m,)
        Triangles: corners, unit normals, centres, and distance of the farthest corner from the
        centre.
    foot : (3,)
        Scratch.
    distance, triangle : (n,)
        Distance, positive on the side of the normal, and number of the triangle; set here.
    """
    for n in range(len(points)):
        least = 1e300
        facing = 0.0
        best = 0
        for t in range(len(corners)):
            away = 0.0
            for k in range(3):
                away += (points[n, k] - centre[t, k]) ** 2
            if away**0.5 - radius[t] > least * (1.0 + _TIE):
                continue
            _nearest_point(points[n], corners[t], foot)
            square = 0.0
            across = 0.0
            for k in range(3):
                square += (points[n, k] - foot[k]) ** 2
                across += (points[n, k] - foot[k]) * normals[t, k]
            away = square**0.5
            if away < least * (1.0 - _TIE) or (
                away <= least * (1.0 + _TIE) and abs(across) > abs(facing)
            ):
                least = min(least, away)
                facing = across
                best = t
        distance[n] = least
        if facing < 0.0:
            distance[n] = -least
        triangle[n] = best


@leaf
def crossings(points, directions, reach, corners, centre, radius, out):
    """Find the distances at which rays cross triangles, up to `reach`; return the largest number on one ray.

    After Moeller & Trumbore (1997).

    Parameters
    ----------
    points, directions : (n, 3), (n, m, 3)
        Starts of the rays, and their unit directions.
    reach : float
        Distance up to which crossings are wanted.
    corners, centre, radius
        As in `nearest`.
    out : (n, m, MOST_CROSSINGS)
        Distances, infinite (on entry) without one.
    """
    most = 0
    for n in range(len(points)):
        for t in range(len(corners)):
            away = 0.0
            for k in range(3):
                away += (points[n, k] - centre[t, k]) ** 2
            if away > (reach + radius[t]) ** 2:
                continue
            e0 = corners[t, 1, 0] - corners[t, 0, 0]
            e1 = corners[t, 1, 1] - corners[t, 0, 1]
            e2 = corners[t, 1, 2] - corners[t, 0, 2]
            f0 = corners[t, 2, 0] - corners[t, 0, 0]
            f1 = corners[t, 2, 1] - corners[t, 0, 1]
            f2 = corners[t, 2, 2] - corners[t, 0, 2]
            x0 = points[n, 0] - corners[t, 0, 0]
            x1 = points[n, 1] - corners[t, 0, 1]
            x2 = points[n, 2] - corners[t, 0, 2]
            q0 = x1 * e2 - x2 * e1
            q1 = x2 * e0 - x0 * e2
            q2 = x0 * e1 - x1 * e0
            for m in range(directions.shape[1]):
                d0 = directions[n, m, 0]
                d1 = directions[n, m, 1]
                d2 = directions[n, m, 2]
                p0 = d1 * f2 - d2 * f1
                p1 = d2 * f0 - d0 * f2
                p2 = d0 * f1 - d1 * f0
                volume = e0 * p0 + e1 * p1 + e2 * p2
                if volume == 0.0:
                    continue
                u = (x0 * p0 + x1 * p1 + x2 * p2) / volume
                v = (d0 * q0 + d1 * q1 + d2 * q2) / volume
                s = (f0 * q0 + f1 * q1 + f2 * q2) / volume
                if u < 0.0 or v < 0.0 or u + v > 1.0 or s <= 0.0 or s > reach:
                    continue
                for k in range(MOST_CROSSINGS):
                    if out[n, m, k] > reach:
                        out[n, m, k] = s
                        most = max(most, k + 1)
                        break
    return most


@leaf
def line_crossings(lines, corners, facing, count, crossings, is_open_below):
    """Find where parallel lines cross triangles.

    Parameters
    ----------
    lines : (n, 2)
        Coordinates of the lines across their direction, with the first in ascending order.
    corners : (m, 3, 3)
        Corners of the triangles: the two coordinates across the lines, then that along them.
    facing : (m,)
        Component of the unit normals along the lines.
    count : (n,)
        Number of crossings of each line, zero on entry; set here.
    crossings : (n, k)
        Coordinates of the crossings along the lines, infinite (on entry) without one; further ones
        are only counted.
    is_open_below : (n,)
        Whether each line is on the side of the normals before its first crossing; set here.
    """
    for t in range(len(corners)):
        ax, ay = corners[t, 0, 0], corners[t, 0, 1]
        bx, by = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay
        cx, cy = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay
        twice = bx * cy - by * cx
        if twice == 0.0:
            continue
        last = ax + max(0.0, bx, cx)
        n = np.searchsorted(lines[:, 0], ax + min(0.0, bx, cx))
        while n < len(lines) and lines[n, 0] <= last:
            x, y = lines[n, 0] - ax, lines[n, 1] - ay
            v = (x * cy - y * cx) / twice
            w = (y * bx - x * by) / twice
            if v >= 0.0 and w >= 0.0 and v + w <= 1.0:
                height = (
                    corners[t, 0, 2]
                    + v * (corners[t, 1, 2] - corners[t, 0, 2])
                    + w * (corners[t, 2, 2] - corners[t, 0, 2])
                )
                if count[n] < crossings.shape[1]:
                    is_first = True
                    for k in range(count[n]):
                        is_first = is_first and height < crossings[n, k]
                    if is_first:
                        is_open_below[n] = facing[t] < 0.0
                    crossings[n, count[n]] = height
                count[n] += 1
            n += 1
