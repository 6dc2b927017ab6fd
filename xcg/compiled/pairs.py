"""Pairs of near spheres: particles sorted by cell into levels of size, and the search through the levels.

Every level has its own cells, at least as wide as its largest particle's reach. Particles are kept
as records (x, y, z, radius), sorted by level and cell, so that the cells along z that a particle
can reach are one run of records. A particle looks for partners in its own level and in levels of
larger particles, never of smaller ones: forward cells in its own level (each pair once), all near
cells in the others.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import jit
from xcg.compiled.arrays import image_of, nearest_image, sort_by_key
from xcg.compiled.radial_distribution import count_pair


class Levels(NamedTuple):
    """Levels of size, from small particles to large, and their cells.

    Attributes
    ----------
    lower, inverse : (levels, 3)
        Corner of the cells (m), and the inverse of their edges (m-1).
    cells : (levels, 3)
        Number of cells along each axis; one where the period is too short for three.
    first_cell : (levels + 1,)
        Number of the first cell of each level, all levels counted through, and number of cells.
    largest : (levels,)
        Largest radius of each level (m).
    period : (3,)
        Period of each axis (m), infinite without one.
    fold : (levels, 3)
        The period along axes where a level has one cell, so that each distance is wrapped by
        itself; else infinity.
    skin : float
        Pairs closer than the sum of their radii and this are found (m).
    slack : float
        Rounding of coordinates, added to reaches (m).
    """

    lower: NDArray
    inverse: NDArray
    cells: NDArray
    first_cell: NDArray
    largest: NDArray
    period: NDArray
    fold: NDArray
    skin: float
    slack: float


class Records(NamedTuple):
    """Particles sorted by level and cell.

    Attributes
    ----------
    values : (n, 4)
        x, y, z and radius of each (m).
    of_level : (levels + 1,)
        First record of each level, and number of records.
    of_cell : (all cells + 1,)
        First record of each cell, and number of records.
    """

    values: NDArray
    of_level: NDArray
    of_cell: NDArray


@jit
def cell_of(x, lower, inverse, count):
    """Cell that holds x along one axis; the first and the last take all that lies outside."""
    c = math.floor((x - lower) * inverse)
    if c < 0:
        return 0
    if c >= count:
        return count - 1
    return int(c)


@jit
def locate(position, level, corner, levels, wrapped, cell):
    """Wrap particles into the periodic box, and find the cell of each.

    Parameters
    ----------
    position : (n, 3)
        Centres.
    level : (n,)
        Level of each particle.
    corner : (3,)
        Lower edge of the box.
    levels : Levels
        The levels.
    wrapped : (n, 3)
        Centres inside the box, set here.
    cell : (n,)
        Number of each particle's cell, set here.
    """
    period = levels.period
    lower = levels.lower
    inverse = levels.inverse
    cells = levels.cells
    for i in range(position.shape[0]):
        number = 0
        k = level[i]
        for a in range(3):
            x = position[i, a]
            if not math.isinf(period[a]) and not (corner[a] <= x < corner[a] + period[a]):
                x -= period[a] * math.floor((x - corner[a]) / period[a])
            wrapped[i, a] = x
            number = number * cells[k, a] + cell_of(x, lower[k, a], inverse[k, a], cells[k, a])
        cell[i] = levels.first_cell[k] + number


@jit
def write_records(order, wrapped, radius, records):
    """Write x, y, z and radius of particles to records (n, 4), in an order (n,) by cell."""
    for n in range(order.size):
        i = order[n]
        records[n, 0] = wrapped[i, 0]
        records[n, 1] = wrapped[i, 1]
        records[n, 2] = wrapped[i, 2]
        records[n, 3] = radius[i]


@jit
def _reached(x, reach, lower, inverse, count, period):
    """First and last cell that [x - reach, x + reach] meets; beyond 0 ... count - 1 these are periodic images."""
    if count == 1:
        return 0, 0
    first = math.floor((x - reach - lower) * inverse)
    last = math.floor((x + reach - lower) * inverse)
    if math.isinf(period):
        return max(0, min(first, count - 1)), max(0, min(last, count - 1))
    return int(first), int(last)


@jit
def _image(c, count):
    """Return the number of periods between a cell and the box."""
    if c < 0:
        return -1
    if c >= count:
        return 1
    return 0


@jit
def find(first, last, levels, records, most, left, right, histogram):
    """Pairs of the records `first` to `last` with partners in their own and larger levels.

    Parameters
    ----------
    first, last : int
        Records whose partners are looked for.
    levels : Levels
        The levels.
    records : Records
        The particles.
    most : int
        The search ends once more pairs than this are found.
    left, right : (capacity,)
        Buffers for pairs of records.
    histogram : Histogram or None
        If given, pairs are counted there instead of kept.

    Returns
    -------
    left, right : (capacity,)
        The buffers, or larger ones where they did not suffice.
    found, tested : int
        Number of pairs found, and of pairs whose distance was computed.
    """
    lower, inverse, cells, first_cell, largest, period, fold, skin, slack = levels
    values, of_level, of_cell = records
    found = 0
    tested = 0
    own = 0
    for i in range(first, last):
        while i >= of_level[own + 1]:
            own += 1
        xi = values[i, 0]
        yi = values[i, 1]
        zi = values[i, 2]
        ri = values[i, 3]
        for k in range(own, largest.size):
            folds = not (
                math.isinf(fold[k, 0]) and math.isinf(fold[k, 1]) and math.isinf(fold[k, 2])
            )
            nx, ny, nz = cells[k, 0], cells[k, 1], cells[k, 2]
            reach = ri + largest[k] + skin + slack
            x0, x1 = _reached(xi, reach, lower[k, 0], inverse[k, 0], nx, period[0])
            y0, y1 = _reached(yi, reach, lower[k, 1], inverse[k, 1], ny, period[1])
            z0, z1 = _reached(zi, reach, lower[k, 2], inverse[k, 2], nz, period[2])
            same = k == own
            ix, iy = 0, 0
            if same:
                ix = cell_of(xi, lower[k, 0], inverse[k, 0], nx)
                iy = cell_of(yi, lower[k, 1], inverse[k, 1], ny)
                x0 = ix
            for cx in range(x0, x1 + 1):
                image_x = _image(cx, nx)
                shift_x = image_of(0.0, image_x, period[0])
                plane = first_cell[k] + (cx - image_x * nx) * ny * nz
                own_plane = same and cx == ix
                for cy in range(iy if own_plane else y0, y1 + 1):
                    image_y = _image(cy, ny)
                    shift_y = image_of(0.0, image_y, period[1])
                    column = plane + (cy - image_y * ny) * nz
                    after = i + 1 if own_plane and cy == iy else 0
                    for image_z in range(_image(z0, nz), _image(z1, nz) + 1):
                        begin = max(after, of_cell[column + max(z0 - image_z * nz, 0)])
                        end = of_cell[column + min(z1 - image_z * nz, nz - 1) + 1]
                        shift_z = image_of(0.0, image_z, period[2])
                        tested += max(end - begin, 0)
                        if found > most:
                            return left, right, found, tested
                        if histogram is None and found + end - begin > left.size:
                            left = _grown(left, found + end - begin)
                            right = _grown(right, found + end - begin)
                        for j in range(begin, end):
                            dx = values[j, 0] - xi + shift_x
                            dy = values[j, 1] - yi + shift_y
                            dz = values[j, 2] - zi + shift_z
                            if folds:
                                dx = nearest_image(dx, fold[k, 0])
                                dy = nearest_image(dy, fold[k, 1])
                                dz = nearest_image(dz, fold[k, 2])
                            touch = values[j, 3] + ri + skin
                            square = dx * dx + dy * dy + dz * dz
                            if histogram is None:
                                left[found] = i
                                right[found] = j
                                found += square < touch * touch
                            elif square < touch * touch:
                                distance = math.sqrt(square) / touch
                                count_pair(i, j, (dx, dy, dz), distance, histogram)
    return left, right, found, tested


@jit
def _grown(buffer, least):
    """Longer copy of a buffer."""
    longer = np.empty(max(least, 2 * buffer.size), buffer.dtype)
    longer[: buffer.size] = buffer
    return longer


@jit
def order_pairs(left, right, original):
    """Turn pairs of records into pairs of particles, the lower index left; `original` (n,) is that of each record."""
    for n in range(left.size):
        i, j = original[left[n]], original[right[n]]
        left[n] = min(i, j)
        right[n] = max(i, j)


@jit
def sort_pairs(low, high, particles, first, last, pairs):
    """Write the pairs whose lower index is of a range to where they belong among all, sorted by both indices.

    Two counting sorts, linear in particles + pairs.

    Parameters
    ----------
    low, high : (m,)
        Lower and higher index of all pairs.
    particles : int
        Number of particles.
    first, last : int
        The range of lower indices.
    pairs : (m, 2)
        Entries of the range are set here.
    """
    before = 0
    count = 0
    for n in range(low.size):
        before += low[n] < first
        count += first <= low[n] < last
    own_low = np.empty(count, low.dtype)
    own_high = np.empty(count, low.dtype)
    order = np.empty(count, np.int64)
    count = 0
    for n in range(low.size):
        if first <= low[n] < last:
            own_low[count] = low[n] - first
            own_high[count] = high[n]
            count += 1
    sort_by_key(own_high, np.zeros(particles + 1, np.int64), order)
    low_by_high = np.empty(count, low.dtype)
    high_by_high = np.empty(count, low.dtype)
    for n in range(count):
        low_by_high[n] = own_low[order[n]]
        high_by_high[n] = own_high[order[n]]
    sort_by_key(low_by_high, np.zeros(last - first + 1, np.int64), order)
    for n in range(count):
        pairs[before + n, 0] = low_by_high[order[n]] + first
        pairs[before + n, 1] = high_by_high[order[n]]
