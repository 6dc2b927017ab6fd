"""Loops over rows and pairs of rows: sums by index, vectors between rows, peeling of a network, transposition."""

import numpy as np

from xcg.kernels._jit import jit, leaf


@jit
def add_rows(row, sign, values, out):
    """Add sign x values (n, k) to the rows of out (m, k) that `row` (n,) names; negative rows are left out."""
    for n in range(row.size):
        if row[n] >= 0:
            for c in range(values.shape[1]):
                out[row[n], c] += sign * values[n, c]


@jit
def pick_rows(values, row, origin, scale, out, first):
    """Write (values[row] - origin) x scale, of values (m, k), to the columns of out (n, first + k) from `first` on."""
    for n in range(row.size):
        for c in range(values.shape[1]):
            out[n, first + c] = (values[row[n], c] - origin[c]) * scale


@jit
def order_by(rank, row_i, row_j, order):
    """Order pairs by the rank of their first row, or of the second where that is negative, in one way only.

    Parameters
    ----------
    rank : (m,)
        Place of each row.
    row_i, row_j : (n,)
        Rows; pairs with two negative ones come last.
    order : (n,)
        Written.
    """
    start = np.zeros(rank.size + 2, np.int64)
    for n in range(row_i.size):
        row = row_i[n] if row_i[n] >= 0 else row_j[n]
        start[(rank[row] if row >= 0 else rank.size) + 1] += 1
    for k in range(start.size - 1):
        start[k + 1] += start[k]
    for n in range(row_i.size):
        row = row_i[n] if row_i[n] >= 0 else row_j[n]
        k = rank[row] if row >= 0 else rank.size
        order[start[k]] = n
        start[k] += 1


@jit
def unit_branches(row_i, branch_i, branch_j, out):
    """Write the unit vectors (n, 3) from j to i along the branch of i, or that of j where i is no row."""
    for n in range(row_i.size):
        sign = 1.0
        x, y, z = branch_i[n, 0], branch_i[n, 1], branch_i[n, 2]
        if row_i[n] < 0:
            sign, x, y, z = -1.0, branch_j[n, 0], branch_j[n, 1], branch_j[n, 2]
        length = np.sqrt(x * x + y * y + z * z)
        per_length = sign / length if length > 0.0 else 0.0
        out[n, 0], out[n, 1], out[n, 2] = x * per_length, y * per_length, z * per_length


@jit
def peel(row_i, row_j, weight, least, degree, kept):
    """Take out rows of fewer than `least` partners, and again those that then have fewer, until none is left.

    Parameters
    ----------
    row_i, row_j : (n,)
        Pairs; negative where a partner is no row.
    weight : (n,)
        1 for pairs that count, 0 for repeated ones.
    least : int
        Partners that a row needs to stay.
    degree : (m,)
        Number of partners of each row; lowered here.
    kept : (m,)
        Whether each row stays (true on entry), set here.
    """
    again = True
    while again:
        again = False
        for i in range(kept.size):
            if kept[i] and degree[i] < least:
                kept[i] = False
                again = True
        # partners of rows that are out no longer count; what is left over is summed anew, without lists of partners
        degree[:] = 0.0
        for n in range(row_i.size):
            i, j = row_i[n], row_j[n]
            here_i, here_j = i >= 0 and kept[i], j >= 0 and kept[j]
            if here_i and (here_j or j < 0):
                degree[i] += weight[n]
            if here_j and (here_i or i < 0):
                degree[j] += weight[n]


@jit
def add_dyads(row, sign, a, b, out):
    """Add sign a b, (n, 3) each, to the rows of out (m, 3, 3) that `row` (n,) names; negative rows are left out."""
    for n in range(row.size):
        if row[n] >= 0:
            for i in range(3):
                for j in range(3):
                    out[row[n], i, j] += sign * a[n, i] * b[n, j]


@jit
def add_unit_squares(row_i, row_j, along_i, along_j, out):
    """Add n n of each contact to both its rows of out (m, 6): xx xy xz yy yz zz; negative rows are left out.

    The unit vector n is that of `along_i` (n, 3), or of `along_j` where `row_i` is negative; zero where that is zero.
    """
    for n in range(row_i.size):
        x, y, z = along_i[n, 0], along_i[n, 1], along_i[n, 2]
        if row_i[n] < 0:
            x, y, z = along_j[n, 0], along_j[n, 1], along_j[n, 2]
        length2 = x * x + y * y + z * z
        per_length2 = 1.0 / length2 if length2 > 0.0 else 0.0
        for m in (row_i[n], row_j[n]):
            if m >= 0:
                out[m, 0] += x * x * per_length2
                out[m, 1] += x * y * per_length2
                out[m, 2] += x * z * per_length2
                out[m, 3] += y * y * per_length2
                out[m, 4] += y * z * per_length2
                out[m, 5] += z * z * per_length2


@jit
def nearest_image(position, row, point, period, out):
    """Write the shortest image of position[row] - point to out (n, 3), zero for negative rows.

    `period` (3,) holds infinity along axes that are not periodic.
    """
    for n in range(row.size):
        for k in range(3):
            out[n, k] = 0.0
            if row[n] >= 0:
                d = position[row[n], k] - point[n, k]
                if np.isfinite(period[k]):
                    d -= period[k] * np.rint(d / period[k])
                out[n, k] = d


@jit
def list_segments(
    order, row_i, row_j, branch_i, branch_j, force, position, phase, tolerance, cutoffs, cutoff, origin,
    start, branch, force_out, phase_out, other,
):  # fmt: skip
    """List the segments of one cutoff that contact stress is smeared along, with lengths in cutoffs.

    Each side of a contact runs from its particle's centre to the contact point. Both are one segment where they lie
    on one line, on opposite sides of the point, and in one phase.

    Parameters
    ----------
    order : (n,)
        Of the contacts.
    row_i, row_j : (n,)
        Particles of each contact; negative where a partner is no row.
    branch_i, branch_j : (n, 3)
        From the contact point to the centres.
    force : (n, 3)
        Force on i.
    position : (m, 3)
    phase : (m,)
    tolerance : float
        Sine of the angle up to which two branches lie on one line.
    cutoffs : (phases,)
        Of the sides of each phase.
    cutoff : float
        The one whose segments are listed.
    origin : (3,)
        Of the positions that are written.
    start, branch, force_out : (2 n, 3)
        Written: centre, vector from the segment's end to its start, and force on that particle times the cutoff.
    phase_out, other : (2 n,)
        Written: phase of that particle and of its partner, -1 where that is no row.

    Returns
    -------
    int
        Number of segments.
    """
    count, per_cutoff = 0, 1.0 / cutoff
    for n in order:
        i, j = row_i[n], row_j[n]
        ax, ay, az = branch_i[n, 0], branch_i[n, 1], branch_i[n, 2]
        bx, by, bz = branch_j[n, 0], branch_j[n, 1], branch_j[n, 2]
        own, partner = phase[i] if i >= 0 else -1, phase[j] if j >= 0 else -1
        if i >= 0 and j >= 0 and own == partner and ax * bx + ay * by + az * bz <= 0.0:
            cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            area2 = cx * cx + cy * cy + cz * cz
            if area2 <= tolerance**2 * (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz):
                ax, ay, az, j = ax - bx, ay - by, az - bz, -1
        if i >= 0 and cutoffs[own] == cutoff:
            branch[count, 0], branch[count, 1], branch[count, 2] = ax * per_cutoff, ay * per_cutoff, az * per_cutoff
            for k in range(3):
                start[count, k] = (position[i, k] - origin[k]) * per_cutoff
                force_out[count, k] = force[n, k] * cutoff
            phase_out[count], other[count] = own, partner
            count += 1
        if j >= 0 and cutoffs[partner] == cutoff:
            branch[count, 0], branch[count, 1], branch[count, 2] = bx * per_cutoff, by * per_cutoff, bz * per_cutoff
            for k in range(3):
                start[count, k] = (position[j, k] - origin[k]) * per_cutoff
                force_out[count, k] = -force[n, k] * cutoff
            phase_out[count], other[count] = partner, own
            count += 1
    return count


@leaf
def turn(records, column, factor, out):
    """Write columns of records (p, n, c), times a factor for each p, nodes last: each record is read once, in order.

    ``out[r, p, n] = factor[r, p] * records[p, n, column[r]]`` for r = 0, ... column.size - 1.
    """
    for p in range(records.shape[0]):
        for n in range(records.shape[1]):
            for r in range(column.size):
                out[r, p, n] = factor[r, p] * records[p, n, column[r]]
