"""Loops over contacts: sums by particle, vectors between particles, the k-core of a network."""

import math

from xcg.compiled._jit import inlined, inner, leaf
from xcg.compiled.arrays import image_near, nearest_image, nearest_of
from xcg.compiled.simd import prefetch

AHEAD = 16  # the particles of the contact so many ahead are prefetched


@leaf
def add_rows(index, sign, values, out):
    """Add sign x values (n, k) to the rows `index` (n,) of out (m, k); negative indices are left out."""
    for n in range(index.size):
        prefetch(out, index[min(n + AHEAD, index.size - 1)])
        if index[n] >= 0:
            for c in range(values.shape[1]):
                out[index[n], c] += sign * values[n, c]


@leaf
def k_core(index_i, index_j, weight, least, degree, kept):
    """Find the k-core: take out particles of fewer than `least` partners until all that stay have as many.

    Parameters
    ----------
    index_i, index_j : (n,)
        Pairs; negative where a partner is not in the scene.
    weight : (n,)
        1 for pairs that count, 0 for repeated ones.
    least : int
        Partners that a particle needs to stay.
    degree : (m,)
        Number of partners of each particle; lowered here.
    kept : (m,)
        Whether each particle stays (true on entry), set here.
    """
    again = True
    while again:
        again = False
        for i in range(kept.size):
            if kept[i] and degree[i] < least:
                kept[i] = False
                again = True
        # the degrees of particles that stay are counted again from the pairs: that takes no lists of
        # partners
        degree[:] = 0.0
        for n in range(index_i.size):
            i, j = index_i[n], index_j[n]
            here_i, here_j = i >= 0 and kept[i], j >= 0 and kept[j]
            if here_i and (here_j or j < 0):
                degree[i] += weight[n]
            if here_j and (here_i or i < 0):
                degree[j] += weight[n]


@inner
def _root(node, parent, moved):
    """Make the root of its cluster the parent of a node, and return it; the way is halved until it is one link."""
    while parent[parent[node]] != parent[node]:
        below = node
        while parent[below] != below:
            above = parent[below]
            for k in range(moved.shape[1]):
                moved[below, k] += moved[above, k]  # zero where the node above is a root
            parent[below] = parent[above]
            below = parent[below]
    return parent[node]


@leaf
def join_clusters(index_i, index_j, crossed, parent, moved, winds):
    """Join particles that contacts connect into clusters, by union and find, with the periods between their images.

    A contact between two particles of one cluster closes a loop. A loop that ends in another image of
    where it begins winds around the box (Newman & Ziff 2001).

    Parameters
    ----------
    index_i, index_j : (n,)
        Particles that contacts connect; pairs with a negative index are left out.
    crossed : (n, k)
        Periods between particle j and the image of it that touches i.
    parent : (m,)
        The indices themselves on entry; the root of each particle's cluster.
    moved : (m, k)
        Zero on entry; periods between the images of a particle and its root that are connected.
    winds : (m, k)
        False on entry; along which periods the clusters of these roots wind.
    """
    for n in range(index_i.size):
        if index_i[n] < 0 or index_j[n] < 0:
            continue
        i, j = index_i[n], index_j[n]
        one = _root(i, parent, moved)
        other = _root(j, parent, moved)
        for k in range(crossed.shape[1]):
            left_open = moved[i, k] - moved[j, k] - crossed[n, k]
            if one == other:
                winds[one, k] |= left_open != 0
            else:
                moved[other, k] = left_open
                winds[one, k] |= winds[other, k]
        parent[other] = one
    for node in range(parent.size):
        _root(node, parent, moved)


@leaf
def add_dyads(index, sign, a, b, first, out):
    """Add sign a b, (n, 3) each, to the particles `index` (n,), of which out (m, 3, 3) holds those from `first` on.

    Particles outside `out` are skipped: threads that share them need not wait for each other.
    """
    for n in range(index.size):
        prefetch(out, index[min(n + AHEAD, index.size - 1)] - first)
        m = index[n] - first
        if index[n] >= 0 and 0 <= m < out.shape[0]:
            for i in range(3):
                for j in range(3):
                    out[m, i, j] += sign * a[n, i] * b[n, j]


@leaf
def scale_tensors(tensor, divisor):
    """Divide the symmetric part of tensors (n, 3, 3) by numbers (n,), in place."""
    for n in range(tensor.shape[0]):
        for i in range(3):
            for j in range(3):
                tensor[n, i, j] /= divisor[n]
        for i in range(2):
            for j in range(i + 1, 3):
                tensor[n, i, j] = tensor[n, j, i] = 0.5 * (tensor[n, i, j] + tensor[n, j, i])


@leaf
def blank_zero_tensors(tensor, out):
    """Write NaN to those tensors of `out` (n, 3, 3) whose twins in `tensor` are zero."""
    for n in range(tensor.shape[0]):
        largest = 0.0
        for i in range(3):
            for j in range(3):
                largest = max(largest, abs(tensor[n, i, j]))
        if largest == 0.0:
            out[n] = math.nan


@leaf
def add_unit_squares(index_i, index_j, along, out):
    """Add n n of each contact to both its particles in out (m, 6): xx xy xz yy yz zz; negative indices are left out.

    The unit vector n is that of `along` (n, 3); zero where that is zero.
    """
    for n in range(index_i.size):
        later = min(n + AHEAD, index_i.size - 1)
        prefetch(out, index_i[later])
        prefetch(out, index_j[later])
        x, y, z = along[n, 0], along[n, 1], along[n, 2]
        length2 = x * x + y * y + z * z
        per_length2 = 1.0 / length2 if length2 > 0.0 else 0.0
        for m in (index_i[n], index_j[n]):
            if m >= 0:
                out[m, 0] += x * x * per_length2
                out[m, 1] += x * y * per_length2
                out[m, 2] += x * z * per_length2
                out[m, 3] += y * y * per_length2
                out[m, 4] += y * z * per_length2
                out[m, 5] += z * z * per_length2


@leaf
def side(position, index, point, n, period, lattice):
    """Vector from contact point n to the centre of a particle, zero where its index is negative.

    Images follow from a `lattice`, or without it from periods along the axes.
    """
    if index < 0:
        return 0.0, 0.0, 0.0
    x = position[index, 0] - point[n, 0]
    y = position[index, 1] - point[n, 1]
    z = position[index, 2] - point[n, 2]
    if lattice is not None:
        return nearest_of(x, y, z, lattice)
    return nearest_image(x, period[0]), nearest_image(y, period[1]), nearest_image(z, period[2])


@leaf
def sides(index, position, point, period, lattice, out):
    """Write the vectors (n, 3) from contact points to the centres of particles, see `side`."""
    for n in range(index.size):
        prefetch(position, index[min(n + AHEAD, index.size - 1)])
        out[n, 0], out[n, 1], out[n, 2] = side(position, index[n], point, n, period, lattice)


@leaf
def between(index_i, index_j, position, point, period, lattice, out):
    """Write the vectors (n, 3) from j to i through the contact points: the side of i less that of j, see `side`."""
    for n in range(index_i.size):
        later = min(n + AHEAD, index_i.size - 1)
        prefetch(position, index_i[later])
        prefetch(position, index_j[later])
        ax, ay, az = side(position, index_i[n], point, n, period, lattice)
        bx, by, bz = side(position, index_j[n], point, n, period, lattice)
        out[n, 0], out[n, 1], out[n, 2] = ax - bx, ay - by, az - bz


def share_of_i(length, radius_i, radius_j):
    """Share of branches r_i - r_j from the centre of i to where spheres touch, ``R_i - overlap / 2`` of the length.

    Of numbers in loops, and of arrays in NumPy; a length is not zero.
    """
    return (length + radius_i - radius_j) / (2 * length)


_share_of_i = inlined(share_of_i)


@leaf
def touching_points(index_i, index_j, position, diameter, data_branch, same, period, hair, out):
    """Write the points (n, 3) where spheres touch, up to the first pair that needs a closer look; return its number.

    Such a pair lacks a sphere; or its centres coincide; or it touches in other images as well; or
    it has a side that is half a period long, to a share `hair` of that. With the branches
    (n, 3) of the data, images are those nearest to them, and a pair needs a closer look if its
    branch is off by more than a share `same` of its length.
    """
    for n in range(index_i.size):
        later = min(n + AHEAD, index_i.size - 1)
        prefetch(position, index_i[later])
        prefetch(position, index_j[later])
        i, j = index_i[n], index_j[n]
        if i < 0 or j < 0:
            return n
        near_x, near_y, near_z = 0.0, 0.0, 0.0
        if data_branch is not None:
            near_x, near_y, near_z = data_branch[n, 0], data_branch[n, 1], data_branch[n, 2]
        x = image_near(position[i, 0] - position[j, 0], near_x, period[0])
        y = image_near(position[i, 1] - position[j, 1], near_y, period[1])
        z = image_near(position[i, 2] - position[j, 2], near_z, period[2])
        length = _length(x, y, z)
        radius_i = diameter[i] / 2
        radius_j = diameter[j] / 2
        if length == 0.0:
            return n
        if data_branch is None:
            reach = max(length, radius_i + radius_j) * (1 + hair)
            if (
                period[0] - abs(x) < reach
                or period[1] - abs(y) < reach
                or period[2] - abs(z) < reach
            ):
                return n
        elif not _length(x - near_x, y - near_y, z - near_z) <= same * _length(
            near_x, near_y, near_z
        ):
            return n
        share = _share_of_i(length, radius_i, radius_j)
        for k, along in enumerate((x, y, z)):
            out[n, k] = position[i, k] - share * along
            side = position[i, k] - out[n, k]
            half = 0.5 * (1 - hair) * period[k]
            if abs(side) >= half or abs(side - along) >= half:
                return n
    return index_i.size


@inner
def _length(x, y, z):
    return math.sqrt(x * x + y * y + z * z)
