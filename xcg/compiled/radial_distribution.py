"""Histogram of the distances of near pairs, made inside the search through the cells of `pairs`."""

import math

from xcg.compiled._jit import jit
from xcg.compiled.arrays import nearest_image
from xcg.compiled.pairs import _image, _reached, cell_of


@jit
def count_pairs(
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
    group,
    whose,
    is_original,
    across,
    counts,
):
    """Count the pairs of the records `first` to `last` by groups, angle and distance.

    Parameters
    ----------
    first, last, ..., slack
        See `xcg.compiled.pairs.find`, which visits the same pairs.
    group : (n,)
        Group of each record.
    whose, is_original : (n,) or None
        Row of the particle that each record is an image of, and whether it is the particle itself;
        None without records of images.
    across : (2,) or None
        Components of the records between which angles are measured; None without angles.
    counts : (groups, groups, angles, bins)
        Numbers that pairs are added to: by the groups of their records, by angles from 0 to pi, and
        by distances from 0 to the sum of both radii and the skin.
    """
    angles, bins = counts.shape[2], counts.shape[3]
    angle, own = 0, 0
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
                            if square >= touch * touch:
                                continue
                            if is_original is not None and not (is_original[i] and is_original[j]):
                                # the pair is also found at the image of the other particle: it
                                # counts where the original has the lower row
                                low, high = (i, j) if is_original[i] else (j, i)
                                if not is_original[low] or whose[low] > whose[high]:
                                    continue
                            if across is not None:
                                d = (dx, dy, dz)
                                turn = math.atan2(d[across[1]], d[across[0]]) / math.pi
                                angle = int((turn - math.floor(turn)) * angles) % angles
                            shell = min(int(math.sqrt(square) / touch * bins), bins - 1)
                            counts[group[i], group[j], angle, shell] += 1
