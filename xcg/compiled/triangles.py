"""Loops over the triangles of a surface: the nearest one, and where rays cross."""

from xcg.compiled._jit import inner, leaf

MOST_CROSSINGS = 16  # of one ray; further ones are left out
_TIE = 1e-9


@inner
def _place(point, corner, place):
    """Write the point of a triangle (3, 3) nearest to a point into `place`; after Ericson (2005), 5.1.5."""
    d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        ab, ac = corner[1, k] - corner[0, k], corner[2, k] - corner[0, k]
        d1 += ab * (point[k] - corner[0, k])
        d2 += ac * (point[k] - corner[0, k])
        d3 += ab * (point[k] - corner[1, k])
        d4 += ac * (point[k] - corner[1, k])
        d5 += ab * (point[k] - corner[2, k])
        d6 += ac * (point[k] - corner[2, k])
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
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
        place[k] = corner[0, k] + v * (corner[1, k] - corner[0, k]) + w * (corner[2, k] - corner[0, k])


@leaf
def nearest(points, corners, normals, centre, radius, place, distance, triangle):
    """Find the nearest triangle to each point, and the signed distance from it.

    Of triangles that are equally near, which meet at an edge or a corner, the one that faces the point most decides its
    side.

    Parameters
    ----------
    points : (n, 3)
        Points.
    corners, normals, centre, radius : (m, 3, 3), (m, 3), (m, 3), (m,)
        Triangles: corners, unit normals, centres, and distance of the farthest corner from the centre.
    place : (3,)
        Scratch.
    distance, triangle : (n,)
        Distance, positive on the side of the normal, and number of the triangle; set here.
    """
    for n in range(len(points)):
        least, facing, best = 1e300, 0.0, 0
        for t in range(len(corners)):
            away = 0.0
            for k in range(3):
                away += (points[n, k] - centre[t, k]) ** 2
            if away**0.5 - radius[t] > least * (1.0 + _TIE):
                continue
            _place(points[n], corners[t], place)
            square, across = 0.0, 0.0
            for k in range(3):
                square += (points[n, k] - place[k]) ** 2
                across += (points[n, k] - place[k]) * normals[t, k]
            away = square**0.5
            if away < least * (1.0 - _TIE) or (away <= least * (1.0 + _TIE) and abs(across) > abs(facing)):
                least, facing, best = min(least, away), across, t
        distance[n] = least if facing >= 0.0 else -least
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
            e0, e1, e2 = (corners[t, 1, 0] - corners[t, 0, 0], corners[t, 1, 1] - corners[t, 0, 1],
                          corners[t, 1, 2] - corners[t, 0, 2])  # fmt: skip
            f0, f1, f2 = (corners[t, 2, 0] - corners[t, 0, 0], corners[t, 2, 1] - corners[t, 0, 1],
                          corners[t, 2, 2] - corners[t, 0, 2])  # fmt: skip
            x0, x1, x2 = (points[n, 0] - corners[t, 0, 0], points[n, 1] - corners[t, 0, 1],
                          points[n, 2] - corners[t, 0, 2])  # fmt: skip
            q0, q1, q2 = x1 * e2 - x2 * e1, x2 * e0 - x0 * e2, x0 * e1 - x1 * e0
            for m in range(directions.shape[1]):
                d0, d1, d2 = directions[n, m, 0], directions[n, m, 1], directions[n, m, 2]
                p0, p1, p2 = d1 * f2 - d2 * f1, d2 * f0 - d0 * f2, d0 * f1 - d1 * f0
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
