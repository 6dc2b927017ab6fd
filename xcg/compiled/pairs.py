"""Pairs of near spheres: particles sorted by cell into levels of size, and the search through the levels.

Every level has its own cells, at least as wide as its largest particle's reach. Particles are kept
as records (x, y, z, radius), sorted by level and cell, so that the cells along z that a particle
can reach are one run of records. A particle looks for partners in its own level and in levels of
larger particles, never of smaller ones: forward cells in its own level (each pair once), all near
cells in the others.

A level is a row of three arrays:

lower, inverse : (levels, 3)
    Corner of the cells (m), and the inverse of their edges (m-1).
cells : (levels, 3)
    Number of cells along each axis; one where the period is too short for three.
"""

import math

import numpy as np

from xcg.compiled._jit import jit
from xcg.compiled.arrays import nearest_image, sort_by_key
from xcg.compiled.radial_distribution import count_pair


@jit
def cell_of(x, lower, inverse, count):
    """Cell that holds x along one axis; the first and the last take all that lies outside."""
    c = math.floor((x - lower) * inverse)
    return 0 if c < 0 else (count - 1 if c >= count else int(c))


@jit
def locate(position, level, corner, period, lower, inverse, cells, first_cell, wrapped, cell):
    """Wrap particles into the periodic box, and find the cell of each.

    Parameters
    ----------
    position : (n, 3)
        Centres.
    level : (n,)
        Level of each particle.
    corner, period : (3,)
        Lower edge of the box, and its period; infinite without one.
    lower, inverse, cells : (levels, 3)
        The levels.
    first_cell : (levels,)
        Number of the first cell of each level, all levels counted through.
    wrapped : (n, 3)
        Centres inside the box, set here.
    cell : (n,)
        Number of each particle's cell, set here.
    """
    for i in range(position.shape[0]):
        number = 0
        k = level[i]
        for a in range(3):
            x = position[i, a]
            if not math.isinf(period[a]) and not (corner[a] <= x < corner[a] + period[a]):
                x -= period[a] * math.floor((x - corner[a]) / period[a])
            wrapped[i, a] = x
            number = number * cells[k, a] + cell_of(x, lower[k, a], inverse[k, a], cells[k, a])
        cell[i] = first_cell[k] + number


@jit
def write_records(order, wrapped, radius, records):
    """Write x, y, z and radius of particles to records (n, 4), in an order (n,) by cell."""
    for n in range(order.size):
        i = order[n]
        records[n, 0], records[n, 1], records[n, 2] = wrapped[i, 0], wrapped[i, 1], wrapped[i, 2]
        records[n, 3] = radius[i]


@jit
def _reached(x, reach, lower, inverse, count, period):
    """First and last cell that [x - reach, x + reach] meets; beyond 0 ... count - 1 these are periodic images."""
    if count == 1:
        return 0, 0
    first, last = (
        math.floor((x - reach - lower) * inverse),
        math.floor((x + reach - lower) * inverse),
    )
    if math.isinf(period):
        return max(0, min(first, count - 1)), max(0, min(last, count - 1))
    return int(first), int(last)


@jit
def _image(c, count):
    """Return the number of periods between a cell and the box."""
    return -1 if c < 0 else (1 if c >= count else 0)


@jit
def find(
    first,
    last,
    records,
    first_record,
    first_cell,
    starts,
    lower,
    inverse,
    cells,
    largest,
    period,
    fold,
    skin,
    slack,
    most,
    left,
    right,
    group,
    whose,
    is_original,
    across,
    counts,
):
    """Pairs of the records `first` to `last` with partners in their own and larger levels.

    Parameters
    ----------
    first, last : int
        Records whose partners are looked for.
    records : (n, 4)
        x, y, z, radius, sorted by level and cell.
    first_record : (levels + 1,)
        First record of each level.
    first_cell : (levels,)
        See `locate`.
    starts : (all cells + 1,)
        First record of each cell.
    lower, inverse, cells : (levels, 3)
        The levels, from small particles to large.
    largest : (levels,)
        Largest radius of each level.
    period : (3,)
        Period of each axis, infinite without one.
    fold : (levels, 3)
        The period along axes where a level has one cell, so that each distance is wrapped by
        itself; else infinity.
    skin : float
        Pairs closer than the sum of their radii and this are found.
    slack : float
        Rounding of coordinates, added to reaches.
    most : int
        The search ends once more pairs than this are found.
    left, right : (capacity,)
        Buffers for pairs of records.
    group, whose, is_original, across, counts : array or None
        See `xcg.compiled.radial_distribution.count_pair`. If `counts` is not None, pairs are
        counted there instead of kept.

    Returns
    -------
    left, right : (capacity,)
        The buffers, or larger ones where they did not suffice.
    found, tested : int
        Number of pairs found, and of pairs whose distance was computed.
    """
    found, tested = 0, 0
    own = 0
    for i in range(first, last):
        while i >= first_record[own + 1]:
            own += 1
        xi, yi, zi, ri = records[i, 0], records[i, 1], records[i, 2], records[i, 3]
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
                shift_x = image_x * period[0] if image_x else 0.0
                plane = first_cell[k] + (cx - image_x * nx) * ny * nz
                own_plane = same and cx == ix
                for cy in range(iy if own_plane else y0, y1 + 1):
                    image_y = _image(cy, ny)
                    shift_y = image_y * period[1] if image_y else 0.0
                    column = plane + (cy - image_y * ny) * nz
                    after = i + 1 if own_plane and cy == iy else 0
                    for image_z in range(_image(z0, nz), _image(z1, nz) + 1):
                        begin = max(after, starts[column + max(z0 - image_z * nz, 0)])
                        end = starts[column + min(z1 - image_z * nz, nz - 1) + 1]
                        shift_z = image_z * period[2] if image_z else 0.0
                        tested += max(end - begin, 0)
                        if found > most:
                            return left, right, found, tested
                        if counts is None and found + end - begin > left.size:
                            left, right = (
                                _grown(left, found + end - begin),
                                _grown(right, found + end - begin),
                            )
                        for j in range(begin, end):
                            dx = records[j, 0] - xi + shift_x
                            dy = records[j, 1] - yi + shift_y
                            dz = records[j, 2] - zi + shift_z
                            if folds:
                                dx = nearest_image(dx, fold[k, 0])
                                dy = nearest_image(dy, fold[k, 1])
                                dz = nearest_image(dz, fold[k, 2])
                            touch = records[j, 3] + ri + skin
                            square = dx * dx + dy * dy + dz * dz
                            if counts is None:
                                left[found] = i
                                right[found] = j
                                found += square < touch * touch
                            elif square < touch * touch:
                                count_pair(
                                    i,
                                    j,
                                    dx,
                                    dy,
                                    dz,
                                    math.sqrt(square) / touch,
                                    group,
                                    whose,
                                    is_original,
                                    across,
                                    counts,
                                )
    return left, right, found, tested


@jit
def _grown(buffer, least):
    """Longer copy of a buffer."""
    longer = np.empty(max(least, 2 * buffer.size), buffer.dtype)
    longer[: buffer.size] = buffer
    return longer


@jit
def rows_of_pairs(left, right, row):
    """Turn pairs of records into pairs of rows, the lower row `left`, in place; `row` (n,) is that of each record."""
    for n in range(left.size):
        i, j = row[left[n]], row[right[n]]
        left[n], right[n] = min(i, j), max(i, j)


@jit
def sort_pairs(low, high, rows, first, last, pairs):
    """Write the pairs whose lower row is of a range to their places among all that are sorted, by both rows.

    Two counting sorts, linear in rows + pairs.

    Parameters
    ----------
    low, high : (m,)
        Lower and higher row of all pairs.
    rows : int
        Number of rows.
    first, last : int
        The range of lower rows.
    pairs : (m, 2)
        Entries of the range are set here.
    """
    before, count = 0, 0
    for n in range(low.size):
        before += low[n] < first
        count += first <= low[n] < last
    own_low, own_high, order = (
        np.empty(count, low.dtype),
        np.empty(count, low.dtype),
        np.empty(count, np.int64),
    )
    count = 0
    for n in range(low.size):
        if first <= low[n] < last:
            own_low[count], own_high[count] = low[n] - first, high[n]
            count += 1
    sort_by_key(own_high, np.zeros(rows + 1, np.int64), order)
    low_by_high, high_by_high = np.empty(count, low.dtype), np.empty(count, low.dtype)
    for n in range(count):
        low_by_high[n], high_by_high[n] = own_low[order[n]], own_high[order[n]]
    sort_by_key(low_by_high, np.zeros(last - first + 1, np.int64), order)
    for n in range(count):
        pairs[before + n, 0], pairs[before + n, 1] = (
            low_by_high[order[n]] + first,
            high_by_high[order[n]],
        )
