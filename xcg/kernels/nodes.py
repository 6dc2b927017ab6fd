"""Which nodes a grain or a branch reaches: periodic images, rows of nodes, spatial order.

Lengths are in units of the cutoff and relative to the first node. A node's index is ``(ix ny + iy) nz + iz``
within the box of nodes that is being filled.

Nodes are listed row by row along z, in loops that the compiler turns into vector instructions: how far each row is
reached, for all rows at once, and then the nodes of a row, four or eight at a time. What a row writes beyond its end is
overwritten by the next. Indices are unsigned, as signed ones are looked at for counting from the end.
"""

import math

import numpy as np

from xcg.kernels._jit import jit

PAD = 16  # loops over lists run to a multiple of this: what is left over would be done one by one
PENCIL = 8  # cells across: the nodes that a layer of a pencil adds to fit in a core's cache
RUN = 256  # grains or branches, neighbours in space, that are passed over together
_1, _2, _3, _4, _5, _6, _7, _8 = (np.uint64(k) for k in range(1, 9))

# Cells of the spatial order, however far apart the grains are.
MOST_CELLS = 1 << 20


@jit
def images(x, low, high, first, last, period):
    """First and last periodic image of an interval [x + low, x + high] that meets the nodes in [first, last]."""
    if x + high - period < first and x + low + period > last:  # nearly all: no more than the interval itself
        return 0, 0 if x + high >= first and x + low <= last else -1
    return math.ceil((first - x - high) / period), math.floor((last - x - low) / period)


@jit
def node_range(low, high, step, begin, end):
    """First and one past the last of the nodes begin, ... end - 1 that lie within [low, high]."""
    return max(begin, math.ceil(low / step)), min(end, math.floor(high / step) + 1)


@jit
def padded(count):
    """Return the next multiple of `PAD`; lists about up to n nodes are made as long as ``padded(n) + PAD``."""
    return (count + PAD - 1) // PAD * PAD


@jit
def list_ball(x, y, z, steps, low, high, rows, node, q2, x_off, y_off, z_off):
    """List the nodes closer than 1 to a point.

    Parameters
    ----------
    x, y, z : float
        The point.
    steps : tuple
        Spacing of the nodes.
    low, high : tuple of int
        Only nodes low <= (ix, iy, iz) < high, whose indices are counted within this box.
    rows : (4, n)
        Scratch, one number a row of nodes.
    node : (n,)
        Indices, written.
    q2, x_off, y_off, z_off : (n,)
        Squared distance, and the point minus the node, written.

    Returns
    -------
    int
        Number of nodes listed.
    """
    dx_row, dy_row, first_row, last_row = rows[0], rows[1], rows[2], rows[3]
    x0, x1 = node_range(x - 1.0, x + 1.0, steps[0], low[0], high[0])
    y0, y1 = node_range(y - 1.0, y + 1.0, steps[1], low[1], high[1])
    count = 0
    for ix in range(x0, x1):
        for iy in range(y0, y1):
            dx_row[count], dy_row[count] = x - ix * steps[0], y - iy * steps[1]
            count += 1
    lowest, highest, per_step = float(low[2]), float(high[2] - 1), 1.0 / steps[2]
    for k in range(padded(count)):
        rest = 1.0 - dx_row[k] * dx_row[k] - dy_row[k] * dy_row[k]
        half = math.sqrt(max(0.0, rest))
        first_row[k] = max(lowest, np.ceil((z - half) * per_step))
        last_row[k] = min(highest, np.floor((z + half) * per_step) if rest > 0.0 else -1.0)
    ny, nz = high[1] - low[1], high[2] - low[2]
    step, hits, k = steps[2], 0, 0
    for ix in range(x0, x1):
        for iy in range(y0, y1):
            begin = int(first_row[k])
            left = int(last_row[k]) + 1 - begin
            dx, dy = dx_row[k], dy_row[k]
            row2 = dx * dx + dy * dy
            k += 1
            iz = float(begin)  # offsets come from the index alone, so that they do not depend on where a row begins
            n, h = np.uint64(((ix - low[0]) * ny + iy - low[1]) * nz + begin - low[2]), np.uint64(hits)
            while True:
                d0, d1, d2, d3 = z - iz * step, z - (iz + 1.0) * step, z - (iz + 2.0) * step, z - (iz + 3.0) * step
                z_off[h], z_off[h + _1], z_off[h + _2], z_off[h + _3] = d0, d1, d2, d3
                d0, d1, d2, d3 = row2 + d0 * d0, row2 + d1 * d1, row2 + d2 * d2, row2 + d3 * d3
                q2[h], q2[h + _1], q2[h + _2], q2[h + _3] = d0, d1, d2, d3
                x_off[h], x_off[h + _1], x_off[h + _2], x_off[h + _3] = dx, dx, dx, dx
                y_off[h], y_off[h + _1], y_off[h + _2], y_off[h + _3] = dy, dy, dy, dy
                node[h], node[h + _1], node[h + _2], node[h + _3] = n, n + _1, n + _2, n + _3
                hits += max(0, min(4, left))
                left -= 4
                if left <= 0:
                    break
                iz, n, h = iz + 4.0, n + _4, np.uint64(hits)
    return hits


@jit
def list_tube(x, y, z, bx, by, bz, per_length, steps, low, high, rows, node, q2, along):
    """List the nodes closer than 1 to the segment from a point to that point plus b, in the precision of `rows`.

    Along the row of nodes at (dx, dy) from the start, the end u of the reach is where ``u bz + sqrt(1 - |d - u b|^2)``,
    seen along z, is largest for 0 <= u <= 1.

    Parameters
    ----------
    x, y, z, bx, by, bz : float
        Start of the segment, and its end relative to it.
    per_length : float
        1 / its length, or 0.
    steps, low, high, rows, node, q2
        As in `list_ball`; q2 is the squared distance to the start.
    along : (n,)
        Foot of the node on the segment's line, from the start, written.

    Returns
    -------
    int
        Number of nodes listed.
    """
    row2, row_dot, first_row, last_row = rows[0], rows[1], rows[2], rows[3]
    x0, x1 = node_range(x + min(0.0, bx) - 1.0, x + max(0.0, bx) + 1.0, steps[0], low[0], high[0])
    y0, y1 = node_range(y + min(0.0, by) - 1.0, y + max(0.0, by) + 1.0, steps[1], low[1], high[1])
    count = 0
    for ix in range(x0, x1):
        dx = ix * steps[0] - x
        for iy in range(y0, y1):
            dy = iy * steps[1] - y
            row2[count], row_dot[count] = dx * dx + dy * dy, dx * bx + dy * by
            count += 1
    across2 = bx * bx + by * by
    # how far u moves from the nearest point of the line for each unit of half chord
    tilt = 0.0
    if bz != 0.0:
        tilt = bz / math.sqrt(across2 * (across2 + bz * bz)) if across2 > 1e-30 else math.copysign(1e30, bz)
    real = rows.dtype.type
    zero, one, two = real(0.0), real(1.0), real(2.0)
    # along z nodes are counted from the last one below the start, so that few digits are enough, and the same
    # wherever a row begins
    base = math.floor(z / steps[2])
    z, per_step, step = real(z - base * steps[2]), real(1.0 / steps[2]), real(steps[2])
    lowest, highest = real(low[2] - base), real(high[2] - 1 - base)
    outside = lowest - one
    c2, per_c2, tilt, rise = real(across2), real(1.0 / across2 if across2 > 0.0 else 0.0), real(tilt), real(bz)
    for k in range(padded(count)):
        dot = row_dot[k]
        u = dot * per_c2
        move = np.sqrt(max(zero, one - (row2[k] - dot * u))) * tilt
        upper, lower = min(one, max(zero, u + move)), min(one, max(zero, u - move))
        rest_upper = one - (row2[k] + upper * (upper * c2 - two * dot))
        rest_lower = one - (row2[k] + lower * (lower * c2 - two * dot))
        top = np.floor((z + upper * rise + np.sqrt(max(zero, rest_upper))) * per_step)
        first_row[k] = max(lowest, np.ceil((z + lower * rise - np.sqrt(max(zero, rest_lower))) * per_step))
        last_row[k] = min(highest, top if rest_upper > zero else outside)
    ez, per_length = real(bz * per_length), real(per_length)
    f1, f2, f3, f4, f5, f6, f7, f8 = (
        one, two, real(3.0), real(4.0), real(5.0), real(6.0), real(7.0), real(8.0)
    )  # fmt: skip
    ny, nz = high[1] - low[1], high[2] - low[2]
    hits, k = 0, 0
    for ix in range(x0, x1):
        for iy in range(y0, y1):
            iz = first_row[k]
            left = int(last_row[k] - iz) + 1
            foot, square = row_dot[k] * per_length, row2[k]
            k += 1
            n = np.uint64(((ix - low[0]) * ny + iy - low[1]) * nz + int(iz) + base - low[2])
            h = np.uint64(hits)
            while True:
                h1, h2, h3, h4, h5, h6, h7 = h + _1, h + _2, h + _3, h + _4, h + _5, h + _6, h + _7
                d0, d1, d2, d3 = iz * step - z, (iz + f1) * step - z, (iz + f2) * step - z, (iz + f3) * step - z
                d4, d5 = (iz + f4) * step - z, (iz + f5) * step - z
                d6, d7 = (iz + f6) * step - z, (iz + f7) * step - z
                a0, a1, a2, a3 = foot + d0 * ez, foot + d1 * ez, foot + d2 * ez, foot + d3 * ez
                a4, a5, a6, a7 = foot + d4 * ez, foot + d5 * ez, foot + d6 * ez, foot + d7 * ez
                along[h], along[h1], along[h2], along[h3] = a0, a1, a2, a3
                along[h4], along[h5], along[h6], along[h7] = a4, a5, a6, a7
                q2[h], q2[h1], q2[h2], q2[h3] = square + d0 * d0, square + d1 * d1, square + d2 * d2, square + d3 * d3
                q2[h4], q2[h5], q2[h6], q2[h7] = square + d4 * d4, square + d5 * d5, square + d6 * d6, square + d7 * d7
                node[h], node[h1], node[h2], node[h3] = n, n + _1, n + _2, n + _3
                node[h4], node[h5], node[h6], node[h7] = n + _4, n + _5, n + _6, n + _7
                hits += max(0, min(8, left))
                left -= 8
                if left <= 0:
                    break
                iz, n, h = iz + f8, n + _8, np.uint64(hits)
    return hits


@jit
def runs_of(start, branch):
    """Lowest and highest corner (runs, 2, 3) of each run of `RUN` segments from start to ``start - branch``, (n, 3)."""
    count = start.shape[0]
    bounds = np.empty(((count + RUN - 1) // RUN, 2, 3))
    for run in range(bounds.shape[0]):
        for k in range(3):
            low, high = np.inf, -np.inf
            for i in range(run * RUN, min(count, (run + 1) * RUN)):
                end = start[i, k] - branch[i, k]
                low, high = min(low, start[i, k], end), max(high, start[i, k], end)
            bounds[run, 0, k], bounds[run, 1, k] = low, high
    return bounds


@jit
def run_reaches(bounds, begin, end, active, period):
    """Whether anything of a run, or one of its images, comes closer than 1 to the nodes from `begin` to `end`."""
    for k in range(3):
        if active[k]:
            first, last = images(0.0, bounds[0, k] - 1.0, bounds[1, k] + 1.0, begin[k], end[k], period[k])
            if first > last:
                return False
    return True


@jit
def bounds_of(position):
    """Lowest and highest position (n, 3) along each axis, (2, 3); NaN if any is."""
    bounds = np.zeros((2, 3))
    for n in range(position.shape[0]):
        for k in range(3):
            x = position[n, k]
            if n == 0 or math.isnan(x) or x < bounds[0, k]:
                bounds[0, k] = x
            if n == 0 or math.isnan(x) or x > bounds[1, k]:
                bounds[1, k] = x
    return bounds


@jit
def spatial_order(position, size, lower, upper, active, cell, order):
    """Order points (n, 3) by cells of a size (larger where points are few), in pencils along x.

    `lower` and `upper` are their bounds, `order` (n,) is written, `cell` (n,) is scratch. Points of one pencil add to
    few nodes at a time, which stay in cache. The order is stable, so that sums have one order only.
    """
    count = position.shape[0]
    extent, sizes, cells = np.zeros(3), np.full(3, size), np.ones(3, np.int64)
    for k in range(3):
        if active[k]:
            extent[k] = upper[k] - lower[k]
    most = max(MOST_CELLS, 4.0 * count)
    while True:
        total, longest = 1.0, 0
        for k in range(3):
            total *= extent[k] / sizes[k] + PENCIL
            longest = k if extent[k] / sizes[k] > extent[longest] / sizes[longest] else longest
        if total <= most:
            break
        sizes[longest] *= 2.0  # a few grains are far astray
    for k in range(3):
        cells[k] = int(extent[k] / sizes[k]) + 1
    pencils_y, pencils_z = (cells[1] - 1) // PENCIL + 1, (cells[2] - 1) // PENCIL + 1
    start = np.zeros(pencils_y * pencils_z * cells[0] * PENCIL * PENCIL + 1, np.int64)
    for i in range(count):
        x = int((position[i, 0] - lower[0]) / sizes[0]) if active[0] else 0
        y = int((position[i, 1] - lower[1]) / sizes[1]) if active[1] else 0
        z = int((position[i, 2] - lower[2]) / sizes[2]) if active[2] else 0
        pencil = y // PENCIL * pencils_z + z // PENCIL
        cell[i] = ((pencil * cells[0] + x) * PENCIL + y % PENCIL) * PENCIL + z % PENCIL
        start[cell[i] + 1] += 1
    for c in range(start.size - 1):
        start[c + 1] += start[c]
    for i in range(count):
        order[start[cell[i]]] = i
        start[cell[i]] += 1
