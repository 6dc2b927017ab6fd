"""Sums of squared weights of a grain over all angles of a ring of nodes."""

import math

from xcg.compiled._jit import inner, leaf
from xcg.compiled.smoothing import fill_values

ROOM = 8  # numbers beyond the last that `fill_values` may write


@inner
def _first_from(angle, first, last, low):
    """First of the angles first <= k < last, which rise, that is not below a limit."""
    while first < last:
        middle = (first + last) // 2
        if angle[middle] < low:
            first = middle + 1
        else:
            last = middle
    return first


@leaf
def ring_squares(grains, kernel, cutoff, rings, start, angle, share, tilts, dimension, scratch, sums, out):
    """Add the squares of the weights of grains in the fits of rings to `out`.

    A grain's velocity has the same error at each angle of a ring, seen in the axes R_k that are there. With w_k the
    weight at an angle and phi = (1, x) in these axes, a fit over the ring takes ``Q = m^2 |sum_k w_k R_k phi|^2 / D``
    of it, the square over the components of R.

    Parameters
    ----------
    grains : tuple of arrays (n, 3), (n,), (n,)
        Places relative to the axis, weights and groups.
    kernel : KernelCode
    cutoff : float
        Radius of the support (m).
    rings : array (m, 2)
        Radius and height of each ring (m).
    start : array (m + 1,)
        Where the angles of each ring begin in `angle` and `share`, which rise on each ring.
    angle, share : array (a,)
        Angles and their shares of the ring.
    tilts : bool
        Whether heights count.
    dimension : int
        D, 3 or 2.
    scratch, sums : array (5, a + ROOM), array (4, 3)
        Memory.
    out : array (groups, m, 10)
        1, x, and xx, xy, xz, yy, yz, zz in radii of the support.
    """
    kind, spread, table, norm = kernel
    position, mass, group = grains
    per_cutoff, q2, weight, part_of = 1.0 / cutoff, scratch[0], scratch[1], scratch[2]
    cosine, sine = scratch[3], scratch[4]
    for i in range(mass.size):
        x, y = position[i, 0], position[i, 1]
        radius, azimuth = math.sqrt(x * x + y * y), math.atan2(y, x)
        for n in range(rings.shape[0]):
            r = rings[n, 0]
            dz = position[i, 2] - rings[n, 1] if tilts else 0.0
            if abs(radius - r) >= cutoff or abs(dz) >= cutoff:
                continue
            below, half = 2.0 * r * radius, math.pi
            above = r * r + radius * radius + dz * dz - cutoff * cutoff
            if above >= below:
                continue
            if above > -below:
                half = math.acos(above / below)
            first, last = start[n], start[n + 1]
            hits = 0
            for turn in range(-2, 3):
                middle = azimuth + turn * 2.0 * math.pi
                low, high = middle - half, middle + half
                k = _first_from(angle, first, last, low)
                # at the far side both ends of the range are one place
                while k < last and (angle[k] < high or (half < math.pi and angle[k] <= high)):
                    c, s = math.cos(angle[k] - azimuth), math.sin(azimuth - angle[k])
                    px, py, pz = (radius * c - r) * per_cutoff, radius * s * per_cutoff, dz * per_cutoff
                    length2 = px * px + py * py + pz * pz
                    if length2 < 1.0:
                        q2[hits], cosine[hits], sine[hits] = length2, c, s
                        part_of[hits] = share[k]
                        hits += 1
                    k += 1
            if hits == 0:
                continue
            fill_values(kind, spread, table, norm, None, q2, hits, weight)
            for a in range(4):
                sums[a, 0], sums[a, 1], sums[a, 2] = 0.0, 0.0, 0.0
            for k in range(hits):
                c, s, w = cosine[k], sine[k], weight[k] * part_of[k]
                px, py, pz = (radius * c - r) * per_cutoff, radius * s * per_cutoff, dz * per_cutoff
                for a in range(4):
                    part = w if a == 0 else (w * px if a == 1 else (w * py if a == 2 else w * pz))
                    sums[a, 0] += part * c
                    sums[a, 1] += part * s
                    sums[a, 2] += part
            g, column, m2 = group[i], 0, mass[i] * mass[i] / dimension
            for a in range(4):
                for b in range(a, 4):
                    found = 2.0 * (sums[a, 0] * sums[b, 0] + sums[a, 1] * sums[b, 1])
                    if dimension == 3:
                        found += sums[a, 2] * sums[b, 2]
                    out[g, n, column] += m2 * found
                    column += 1
