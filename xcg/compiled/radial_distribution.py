"""Histogram of the distances of near pairs, which the search through the cells fills."""

import math

from xcg.compiled._jit import inlined


@inlined
def count_pair(i, j, dx, dy, dz, distance, group, whose, is_original, across, counts):
    """Count a pair of records by groups, angle and distance.

    Parameters
    ----------
    i, j : int
        The records.
    dx, dy, dz : float
        Vector from the one to the other.
    distance : float
        Its length, as a share of the longest that counts.
    group : (n,)
        Group of each record.
    whose, is_original : (n,) or None
        Row of the particle that each record is an image of, and whether it is the particle itself;
        None without records of images.
    across : (2,) or None
        Components of the records between which angles are measured; None without angles.
    counts : (groups, groups, angles, bins)
        Numbers that pairs are added to: by the groups of their records, by angles from 0 to pi, and
        by distances.
    """
    if is_original is not None and not (is_original[i] and is_original[j]):
        # the pair is also found at the image of the other particle: it counts where the original
        # has the lower row
        low, high = (i, j) if is_original[i] else (j, i)
        if not is_original[low] or whose[low] > whose[high]:
            return
    angles, bins = counts.shape[2], counts.shape[3]
    angle = 0
    if across is not None:
        d = (dx, dy, dz)
        turn = math.atan2(d[across[1]], d[across[0]]) / math.pi
        angle = int((turn - math.floor(turn)) * angles) % angles
    counts[group[i], group[j], angle, min(int(distance * bins), bins - 1)] += 1
