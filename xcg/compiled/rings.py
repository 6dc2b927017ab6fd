"""Nodes of a cylinder as averages over the angles of rings: sums at the angles, and of squared weights."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import points
from xcg.compiled._jit import inner, leaf
from xcg.compiled.smoothing import fill_values

ROOM = 8  # numbers beyond the last that `fill_values` may write
_MASS = points.MASS
_FLUCTUATION = points.FLUCTUATION
_CUBIC = points.CUBIC
_LINEAR = points.LINEAR


class Rings(NamedTuple):
    """Angles of the rings of a block.

    Attributes
    ----------
    place : (m, 2)
        Radius and height of each ring (m); radii rise.
    start : (m + 1,)
        First angle of each ring.
    angle, cosine, sine, share : (a,)
        Angles, which rise on each ring, and their shares of its average.
    where : (a,)
        Index of each angle in arrays that are sorted in space.
    """

    place: NDArray
    start: NDArray
    angle: NDArray
    cosine: NDArray
    sine: NDArray
    share: NDArray
    where: NDArray


class Flow(NamedTuple):
    """Columns of the moments that depend on the velocity which they are relative to: arrays of their shapes."""

    momentum: NDArray
    kinetic: NDArray
    cubes: NDArray
    offset: NDArray
    shear: NDArray


@leaf
def ring_references(velocity, rings, turns, mean, difference):
    """Average a velocity over the angles of each ring, where it is not NaN.

    Parameters
    ----------
    velocity : array (a, 3)
        Velocities, sorted in space.
    rings : Rings
    turns : bool
        Whether their components are turned into (r, theta, z).
    mean, difference : array (m, 3), (a, 3)
        Filled with the averages, NaN where there is nothing, and with what each angle's differs by,
        or zero.
    """
    for n in range(mean.shape[0]):
        total = x = y = z = 0.0
        for k in range(rings.start[n], rings.start[n + 1]):
            index = rings.where[k]
            share = rings.share[k]
            first = velocity[index, 0]
            second = velocity[index, 1]
            if turns:
                c = rings.cosine[k]
                s = rings.sine[k]
                first, second = c * first + s * second, c * second - s * first
            difference[k, 0] = first
            difference[k, 1] = second
            difference[k, 2] = velocity[index, 2]
            if math.isfinite(first):
                total += share
                x += share * first
                y += share * second
                z += share * velocity[index, 2]
        mean[n, 0] = x / total
        mean[n, 1] = y / total
        mean[n, 2] = z / total
        for k in range(rings.start[n], rings.start[n + 1]):
            if math.isfinite(difference[k, 0]):
                for c in range(3):
                    difference[k, c] -= mean[n, c]
            else:
                difference[k] = 0.0


@inner
def _turn(record, columns, rank, c, s, tensor):
    """Turn a tensor of a record into (r, theta, z)."""
    count = 3**rank
    for k in range(count):
        tensor[k] = record[columns[k]]
    apart = 1
    for _ in range(rank):
        for k in range(count):
            if k // apart % 3 == 0:
                x, y = tensor[k], tensor[k + apart]
                tensor[k] = c * x + s * y
                tensor[k + apart] = c * y - s * x
        apart *= 3
    for k in range(count):
        record[columns[k]] = tensor[k]


@inner
def _shift(record, flow, level, d):
    """Shift the moments of a record from velocities u to u + d."""
    mass = record[_MASS]
    momentum = flow.momentum
    kinetic = flow.kinetic
    if level == _CUBIC:
        trace = along = square = 0.0
        for i in range(3):
            trace += record[kinetic[i, i]]
            along += record[momentum[i]] * d[i]
            square += d[i] * d[i]
        for i in range(3):
            across = 0.0
            for j in range(3):
                across += record[kinetic[i, j]] * d[j]
            record[flow.cubes[i]] += (
                trace * d[i]
                + 2.0 * across
                + 2.0 * along * d[i]
                + square * record[momentum[i]]
                + square * mass * d[i]
            )
    if level >= _FLUCTUATION:
        for i in range(3):
            for j in range(i, 3):
                p = record[momentum[i]]
                q = record[momentum[j]]
                record[kinetic[i, j]] += p * d[j] + d[i] * q + mass * d[i] * d[j]
    if level >= _LINEAR:
        for i in range(3):
            for j in range(3):
                record[flow.shear[i, j]] += d[i] * record[flow.offset[j]]
    for i in range(3):
        record[momentum[i]] += mass * d[i]


@leaf
def ring_means(sums, rings, difference, tensors, level, flow, record, tensor, out):
    """Average the sums at the angles of each ring, turned into (r, theta, z) and relative to one velocity.

    Parameters
    ----------
    sums : array (groups, a, columns)
        Sorted in space.
    rings : Rings
    difference : array (a, 3)
        Velocity that each angle's sums are relative to, less that of the ring.
    tensors : tuple of arrays (t,), (t, 27)
        Rank of each tensor, and its columns.
    level : int
        How many columns are kinematic columns.
    flow : Flow
    record, tensor : array (columns,), (27,)
        Memory.
    out : array (groups, m, columns)
        Averages are added.
    """
    rank, columns = tensors
    for g in range(sums.shape[0]):
        for n in range(out.shape[1]):
            for k in range(rings.start[n], rings.start[n + 1]):
                found = sums[g, rings.where[k]]
                for c in range(record.size):
                    record[c] = found[c]
                for t in range(rank.size):
                    _turn(record, columns[t], rank[t], rings.cosine[k], rings.sine[k], tensor)
                if level:
                    _shift(record, flow, level, difference[k])
                for c in range(record.size):
                    out[g, n, c] += rings.share[k] * record[c]


@leaf
def ring_squares(grains, kernel, cutoff, rings, tilts, dimension, scratch, sums, out):
    """Add the squares of the weights of grains in the fits of rings to `out`.

    A grain's velocity has the same error at each angle of a ring, seen in the axes R_k that are
    there. With w_k the weight at an angle and phi = (1, x) in these axes, a fit over the ring takes
    ``Q = m^2 |sum_k w_k R_k phi|^2 / D`` of it, the square over the components of R.

    Parameters
    ----------
    grains : tuple of arrays (n, 3), (n,), (n,)
        Positions relative to the axis, weights and groups.
    kernel : KernelCode
    cutoff : float
        Radius of the support (m).
    rings : Rings
    tilts : bool
        Whether heights count.
    dimension : int
        D, 3 or 2.
    scratch, sums : array (5, a + ROOM), array (4, 3)
        Memory.
    out : array (groups, m, 10)
        1, x, and xx, xy, xz, yy, yz, zz in radii of the support.
    """
    kind, table, norm = kernel
    position, mass, group = grains
    per_cutoff = 1.0 / cutoff
    q2 = scratch[0]
    weight = scratch[1]
    part_of = scratch[2]
    cosine = scratch[3]
    sine = scratch[4]
    for i in range(mass.size):
        x, y = position[i, 0], position[i, 1]
        radius = math.sqrt(x * x + y * y)
        azimuth = math.atan2(y, x)
        along = math.cos(azimuth)
        across = math.sin(azimuth)
        for n in range(np.searchsorted(rings.place[:, 0], radius - cutoff), rings.place.shape[0]):
            r = rings.place[n, 0]
            if r - radius >= cutoff:
                break
            dz = 0.0
            if tilts:
                dz = position[i, 2] - rings.place[n, 1]
            if abs(dz) >= cutoff:
                continue
            below = 2.0 * r * radius
            half = math.pi
            above = r * r + radius * radius + dz * dz - cutoff * cutoff
            if above >= below:
                continue
            if above > -below:
                half = math.acos(above / below)
            first, last = rings.start[n], rings.start[n + 1]
            hits = 0
            for turn in range(-2, 3):
                middle = azimuth + turn * 2.0 * math.pi
                low, high = middle - half, middle + half
                if high < rings.angle[first] or low > rings.angle[last - 1]:
                    continue
                k = first + np.searchsorted(rings.angle[first:last], low)
                # at the far side both ends of the range are one point
                while k < last and (
                    rings.angle[k] < high or (half < math.pi and rings.angle[k] <= high)
                ):
                    # cos(angle - azimuth), sin(azimuth - angle)
                    c = rings.cosine[k] * along + rings.sine[k] * across
                    s = rings.cosine[k] * across - rings.sine[k] * along
                    px = (radius * c - r) * per_cutoff
                    py = radius * s * per_cutoff
                    pz = dz * per_cutoff
                    length2 = px * px + py * py + pz * pz
                    if length2 < 1.0:
                        q2[hits] = length2
                        cosine[hits] = c
                        sine[hits] = s
                        part_of[hits] = rings.share[k]
                        hits += 1
                    k += 1
            if hits == 0:
                continue
            fill_values(kind, table, norm, None, q2, hits, weight)
            for a in range(4):
                sums[a, 0], sums[a, 1], sums[a, 2] = 0.0, 0.0, 0.0
            for k in range(hits):
                c = cosine[k]
                s = sine[k]
                w = weight[k] * part_of[k]
                px = (radius * c - r) * per_cutoff
                py = radius * s * per_cutoff
                pz = dz * per_cutoff
                parts = (w, w * px, w * py, w * pz)
                for a in range(4):
                    sums[a, 0] += parts[a] * c
                    sums[a, 1] += parts[a] * s
                    sums[a, 2] += parts[a]
            g = group[i]
            column = 0
            m2 = mass[i] * mass[i] / dimension
            for a in range(4):
                for b in range(a, 4):
                    found = 2.0 * (sums[a, 0] * sums[b, 0] + sums[a, 1] * sums[b, 1])
                    if dimension == 3:
                        found += sums[a, 2] * sums[b, 2]
                    out[g, n, column] += m2 * found
                    column += 1
