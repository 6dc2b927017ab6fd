"""Radical Voronoi cells: the region, cut by the planes between a particle and those near to it.

A cell is a convex polyhedron of vertices on three planes each; where more planes meet, several
vertices lie at one place. The plane of a particle j at d from particle i cuts off the vertices v
(relative to i) with ``v d > (d^2 + R_i^2 - R_j^2) / 2``. All of them are next to each other, and
each edge that leaves them gets a vertex on the new plane.

Particle j cuts the cell only if it is closer to one of the vertices than ``sqrt(v^2 - R_i^2 +
R_j^2)``. Those that may are looked for in a tree of boxes, the nearest box first, as a cell that is
small already leaves out most of the others. Periodic images are those of the whole tree.

Lengths are of the order of one: in units of the mean cell's edge.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inner, leaf

# of a face that counts: rounding makes smaller ones where more than four cells meet
LEAST_AREA = 1e-6
COINCIDENT = 1e-20  # square of the distance of two particles that have no plane between them
# Vertices less than this above a plane are not cut off, as a share of squared lengths. If those
# above it are not all next to each other, due to rounding, more are left, a few times.
TOLERANCE = 1e-13
ATTEMPTS = 8
_DEPTH = 128  # of the tree's boxes, more than there can be


class Tree(NamedTuple):
    """Particles sorted by halves: box k of the tree holds those of boxes 2 k + 1 and 2 k + 2.

    Attributes
    ----------
    particles : (n, 4)
        x, y, z from the corner of the region, and radius.
    low, high : (boxes, 3)
        Ends of the particles' coordinates in each box.
    largest : (boxes,)
        Largest radius in each box.
    vectors : (3, 3)
        Edges of the region.
    widths : (3,)
        Distance between its faces; infinite along open axes.
    half : (3,)
        Most that a cell reaches along periodic axes.
    is_open : (3,)
        Which axes are not periodic.
    """

    particles: NDArray
    low: NDArray
    high: NDArray
    largest: NDArray
    vectors: NDArray
    widths: NDArray
    half: NDArray
    is_open: NDArray


class Cell(NamedTuple):
    """Memory for one cell.

    Attributes
    ----------
    vertex : (3, m)
        x, y and z of the vertices, from the particle.
    above : (m,)
        Height of each above a plane, times the plane's d.
    planes : (m, 3)
        The planes of each vertex, counterclockwise from outside.
    beside : (m, 3)
        The vertex at the other end of the edge between its planes k and k + 1.
    gone : (m,)
        Vertices that are cut off.
    crossing : (3 p, 3)
        Of each edge that is cut, its two planes and the vertex that stays.
    new : (3, 3 p)
        Its new vertex.
    follows : (p,)
        Which of these edges begins with a plane.
    plane : (p, 4)
        d and ``(d^2 + R_i^2 - R_j^2) / 2`` of each plane.
    owner : (p,)
        Particle j of each plane; -1 to -6 for the low and the high end of each axis, -7 for an
        image of i.
    area : (p, 3)
        Area vector of each face.
    stack : (depth,)
        Boxes of the tree that are still to be looked at.
    """

    vertex: NDArray
    above: NDArray
    planes: NDArray
    beside: NDArray
    gone: NDArray
    crossing: NDArray
    new: NDArray
    follows: NDArray
    plane: NDArray
    owner: NDArray
    area: NDArray
    stack: NDArray

    @classmethod
    def of(cls, planes: int) -> "Cell":
        """Return memory for a cell that up to this many planes cut."""
        m = 2 * planes
        return cls(
            np.empty((3, m)),
            np.empty(m),
            np.empty((m, 3), "int64"),
            np.empty((m, 3), "int64"),
            np.empty(m, "int64"),
            np.empty((3 * planes, 3), "int64"),
            np.empty((3, 3 * planes)),
            np.empty(planes, "int64"),
            np.empty((planes, 4)),
            np.empty(planes, "int64"),
            np.empty((planes, 3)),
            np.empty(_DEPTH, "int64"),
        )


class Results(NamedTuple):
    """Results of all particles, in the order of the tree.

    Attributes
    ----------
    volume, area : (n,)
        Volume and surface of the cell; the volume is NaN if another particle is at the same place.
    neighbours : (n,)
        Number of faces to other particles.
    at_ends : (n, 6)
        Whether the cell has a face to the low and the high end of each open axis.
    """

    volume: NDArray
    area: NDArray
    neighbours: NDArray
    at_ends: NDArray


@inner
def _begin(i, tree, cell):
    """Begin the cell of a particle with six planes: the ends of open axes, and those that no cell reaches beyond."""
    for axis in range(3):
        low = -tree.half[axis]
        high = tree.half[axis]
        if tree.is_open[axis]:
            low = -tree.particles[i, axis]
            high = low + tree.vectors[axis, axis]
        for side in range(2):
            n = 2 * axis + side
            cell.plane[n] = 0.0
            cell.plane[n, axis] = 2.0 * side - 1.0
            cell.plane[n, 3] = high if side else -low
            cell.owner[n] = -1 - n
    for t in range(8):  # bit k of a corner of the box: whether it is at the high end of axis k
        turned = False
        for axis in range(3):
            side = (t >> axis) & 1
            n = 2 * axis + side
            cell.vertex[axis, t] = (2 * side - 1) * cell.plane[n, 3]
            turned ^= side == 1
            cell.planes[t, axis] = n
        if turned:
            cell.planes[t, 1], cell.planes[t, 2] = cell.planes[t, 2], cell.planes[t, 1]
        for k in range(3):
            shared = cell.planes[t, k] // 2 + cell.planes[t, (k + 1) % 3] // 2
            cell.beside[t, k] = t ^ (1 << (3 - shared))


@inner
def _joined(cell, vertex, first, second, to):
    """Set the vertex beside another one, on the edge between two of its planes."""
    for k in range(3):
        if cell.planes[vertex, k] == first and cell.planes[vertex, (k + 1) % 3] == second:
            cell.beside[vertex, k] = to


@inner
def _crossings(count, limit, cell):
    """List the vertices above a limit, and the edges from them to others; return how many of both.

    The edges are in no order. Their number is -1 unless each begins with the plane that another one
    ends with, all in one ring.
    """
    above = cell.above
    gone = 0
    for t in range(count):
        if above[t] > limit:
            cell.gone[gone] = t
            gone += 1
    edges = 0
    for n in range(gone):
        t = cell.gone[n]
        for k in range(3):
            stays = cell.beside[t, k]
            if above[stays] <= limit:
                share = above[t] / (above[t] - min(above[stays], 0.0))
                for axis in range(3):
                    start = cell.vertex[axis, t]
                    cell.new[axis, edges] = start + share * (cell.vertex[axis, stays] - start)
                cell.crossing[edges, 0] = cell.planes[t, k]
                cell.crossing[edges, 1] = cell.planes[t, (k + 1) % 3]
                cell.crossing[edges, 2] = stays
                edges += 1
    for n in range(edges):
        cell.follows[cell.crossing[n, 1]] = -1
    for n in range(edges):
        cell.follows[cell.crossing[n, 0]] = n
    after = 0
    for n in range(edges):
        after = cell.follows[cell.crossing[after, 1]]
        if after < 0 or (after == 0) != (n == edges - 1):
            return gone, -1
    return gone, edges


@inner
def _cut(count, plane, limit, cell):
    """Cut off the vertices above a plane; return how many vertices there are then, none of a cell that is cut off."""
    gone, edges = _crossings(count, limit, cell)
    attempt = 1
    while edges < 0 and attempt < ATTEMPTS:
        limit *= 8.0
        gone, edges = _crossings(count, limit, cell)
        attempt += 1
    if gone == count:
        return 0
    if edges <= 0:
        return count
    # new vertices take the slots of those that are gone, and then the next
    for n in range(edges):
        slot = count + n - gone
        if n < gone:
            slot = cell.gone[n]
        first = cell.crossing[n, 0]
        second = cell.crossing[n, 1]
        stays = cell.crossing[n, 2]
        after = cell.follows[second]
        beside = count + after - gone
        if after < gone:
            beside = cell.gone[after]
        for axis in range(3):
            cell.vertex[axis, slot] = cell.new[axis, n]
        cell.planes[slot, 0] = first
        cell.planes[slot, 1] = second
        cell.planes[slot, 2] = plane
        cell.beside[slot, 0] = stays
        cell.beside[slot, 1] = beside
        cell.beside[beside, 2] = slot
        _joined(cell, stays, second, first, slot)
    # the last vertices fill the slots that are left
    last = count - 1
    for n in range(gone - 1, edges - 1, -1):
        slot = cell.gone[n]
        for axis in range(3):
            cell.vertex[axis, slot] = cell.vertex[axis, last]
            cell.planes[slot, axis] = cell.planes[last, axis]
            cell.beside[slot, axis] = cell.beside[last, axis]
        if slot != last:
            for k in range(3):
                first = cell.planes[slot, k]
                second = cell.planes[slot, (k + 1) % 3]
                _joined(cell, cell.beside[slot, k], second, first, slot)
        last -= 1
    return count + edges - gone


@inner
def _farthest(count, cell):
    """Return the square of the distance of the farthest vertex."""
    square = 0.0
    x, y, z = cell.vertex[0], cell.vertex[1], cell.vertex[2]
    for t in range(count):
        square = max(square, x[t] * x[t] + y[t] * y[t] + z[t] * z[t])
    return square


@inner
def _may_cut(i, box, shift, count, farthest, tree, cell):
    """Return whether particles of a box of the tree may cut the cell of particle i."""
    more = tree.largest[box] ** 2 - tree.particles[i, 3] ** 2
    gap2 = 0.0
    for k in range(3):
        x = tree.particles[i, k] - shift[k]
        gap = max(tree.low[box, k] - x, x - tree.high[box, k], 0.0)
        gap2 += gap * gap
    if gap2 == 0.0:
        return True
    if gap2 - max(more, 0.0) >= 2.0 * math.sqrt(farthest * gap2):
        return False
    for t in range(count):
        gap2 = 0.0
        square = more
        for k in range(3):
            v = cell.vertex[k, t]
            x = tree.particles[i, k] - shift[k] + v
            gap = max(tree.low[box, k] - x, x - tree.high[box, k], 0.0)
            gap2 += gap * gap
            square += v * v
        if gap2 < square:
            return True
    return False


@inner
def _cut_by_some(i, first, last, shift, count, planes, tree, cell):
    """Cut the cell of a particle by the planes of others; return the numbers of vertices and planes.

    There are -1 vertices if the memory does not suffice, -2 if a particle is at the same position.
    """
    x, y, z = cell.vertex[0], cell.vertex[1], cell.vertex[2]
    above = cell.above
    particles = tree.particles
    radius2 = particles[i, 3] ** 2
    farthest = _farthest(count, cell)
    for j in range(first, last):
        dx = particles[j, 0] - particles[i, 0] + shift[0]
        dy = particles[j, 1] - particles[i, 1] + shift[1]
        dz = particles[j, 2] - particles[i, 2] + shift[2]
        d2 = dx * dx + dy * dy + dz * dz
        if d2 < COINCIDENT:
            if i == j:
                continue
            return -2, planes
        height = 0.5 * (d2 + radius2 - particles[j, 3] ** 2)
        if height > 0.0 and height * height >= farthest * d2:
            continue
        limit = TOLERANCE * (d2 + farthest)
        gone = 0
        for t in range(count):
            above[t] = x[t] * dx + y[t] * dy + z[t] * dz - height
            gone += above[t] > limit
        if gone == 0:
            continue
        if planes == cell.owner.size or count + 2 > above.size:
            return -1, planes
        cell.plane[planes, 0] = dx
        cell.plane[planes, 1] = dy
        cell.plane[planes, 2] = dz
        cell.plane[planes, 3] = height
        cell.owner[planes] = -7 if i == j else j
        count = _cut(count, planes, limit, cell)
        planes += 1
        if count == 0:
            return 0, planes
        farthest = _farthest(count, cell)
    return count, planes


@inner
def _cut_by_image(i, shift, count, planes, tree, cell):
    """Cut the cell of a particle by an image of all others, see `_cut_by_some`."""
    stack = cell.stack
    leaves = (tree.largest.size + 1) // 2
    stack[0] = 0
    top = 1
    while top:
        top -= 1
        box = stack[top]
        farthest = _farthest(count, cell)
        if not _may_cut(i, box, shift, count, farthest, tree, cell):
            continue
        if box < leaves - 1:
            # along the axis of their greatest distance the particle is nearer to one of the two
            near = 2 * box + 1
            away = 0.0
            for k in range(3):
                apart = tree.low[near + 1, k] + tree.high[near + 1, k]
                apart -= tree.low[near, k] + tree.high[near, k]
                middle = tree.low[near + 1, k] + tree.high[near, k]
                away += apart * (2.0 * (tree.particles[i, k] - shift[k]) - middle)
            near += away > 0.0
            stack[top] = 4 * box + 3 - near
            stack[top + 1] = near
            top += 2
            continue
        n = tree.particles.shape[0]
        first = n * (box + 1 - leaves) // leaves
        last = n * (box + 2 - leaves) // leaves
        count, planes = _cut_by_some(i, first, last, shift, count, planes, tree, cell)
        if count <= 0:
            break
    return count, planes


@inner
def _cut_by_all(i, tree, cell):
    """Cut the cell of a particle by all others, ring by ring of images, see `_cut_by_some`."""
    _begin(i, tree, cell)
    count = 8
    planes = 6
    a, b, c = tree.vectors[0], tree.vectors[1], tree.vectors[2]
    more = max(tree.largest[0] ** 2 - tree.particles[i, 3] ** 2, 0.0)
    ring = 0
    while True:
        square = _farthest(count, cell)
        reach = math.sqrt(square) + math.sqrt(square + more)
        nx = 0 if tree.is_open[0] else min(ring, math.floor(reach / tree.widths[0]) + 1)
        ny = 0 if tree.is_open[1] else min(ring, math.floor(reach / tree.widths[1]) + 1)
        nz = 0 if tree.is_open[2] else min(ring, math.floor(reach / tree.widths[2]) + 1)
        if max(nx, ny, nz) < ring:
            return count, planes
        for kx in range(-nx, nx + 1):
            for ky in range(-ny, ny + 1):
                for kz in range(-nz, nz + 1):
                    if max(abs(kx), abs(ky), abs(kz)) < ring:
                        continue
                    shift = (
                        kx * a[0] + ky * b[0] + kz * c[0],
                        kx * a[1] + ky * b[1] + kz * c[1],
                        kx * a[2] + ky * b[2] + kz * c[2],
                    )
                    count, planes = _cut_by_image(i, shift, count, planes, tree, cell)
                    if count <= 0:
                        return count, planes
        ring += 1


@inner
def _set_areas(count, planes, cell):
    """Set the area vectors of all faces: half the sum of the products of vertices that follow each other."""
    x, y, z = cell.vertex[0], cell.vertex[1], cell.vertex[2]
    cell.area[:planes] = 0.0
    for t in range(count):
        for k in range(3):
            area = cell.area[cell.planes[t, k]]
            s = cell.beside[t, k]
            area[0] += 0.5 * (y[t] * z[s] - z[t] * y[s])
            area[1] += 0.5 * (z[t] * x[s] - x[t] * z[s])
            area[2] += 0.5 * (x[t] * y[s] - y[t] * x[s])


@leaf
def add_cells(first, last, tree, cell, results, faces):
    """Compute the cells of particles, in the order of the tree.

    Parameters
    ----------
    first, last : int
        The particles.
    tree : Tree
        All particles.
    cell : Cell
        Memory, written.
    results : Results
        Those of the particles are set.
    faces : (capacity, 5)
        Of each face to another particle: the two particles, and the area vector from the first to
        the second. None are kept if the capacity is 0.

    Returns
    -------
    last, found : int
        The particle that the memory did not suffice for, else `last`; number of faces.
    """
    found = 0
    for i in range(first, last):
        count, planes = _cut_by_all(i, tree, cell)
        if count == -1 or 0 < faces.shape[0] < found + planes:
            return i, found
        results.volume[i] = 0.0
        if count == -2:
            results.volume[i] = np.nan
        count = max(count, 0)
        _set_areas(count, planes, cell)
        volume = 0.0
        surface = 0.0
        for n in range(planes):
            x, y, z = cell.plane[n, 0], cell.plane[n, 1], cell.plane[n, 2]
            ax, ay, az = cell.area[n, 0], cell.area[n, 1], cell.area[n, 2]
            volume += cell.plane[n, 3] * (ax * x + ay * y + az * z) / (x * x + y * y + z * z)
            area = math.sqrt(ax * ax + ay * ay + az * az)
            surface += area
            owner = cell.owner[n]
            if area > LEAST_AREA and owner >= 0:
                results.neighbours[i] += 1
                if faces.shape[0]:
                    faces[found, 0] = i
                    faces[found, 1] = owner
                    faces[found, 2] = ax
                    faces[found, 3] = ay
                    faces[found, 4] = az
                    found += 1
            elif area > LEAST_AREA and owner > -7 and tree.is_open[(-1 - owner) // 2]:
                results.at_ends[i, -1 - owner] = True
        results.volume[i] += volume / 3.0
        results.area[i] = surface
    return last, found
