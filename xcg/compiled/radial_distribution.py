"""Histogram of the distances of near pairs, which the search through the cells fills."""

import math
from typing import NamedTuple

from numpy.typing import NDArray

from xcg.compiled._jit import inlined


class Histogram(NamedTuple):
    """Numbers of pairs, and what they are counted by.

    Attributes
    ----------
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

    group: NDArray
    whose: NDArray | None
    is_original: NDArray | None
    across: NDArray | None
    counts: NDArray


@inlined
def _counts_elsewhere(i, j, whose, is_original):
    """Return whether a pair of records counts at another image of its particles."""
    if is_original is None:
        return False
    if is_original[i] and is_original[j]:
        return False
    # the pair is also found at the image of the other particle: it counts where the original has
    # the lower row
    low = i
    high = j
    if not is_original[i]:
        low = j
        high = i
    return not is_original[low] or whose[low] > whose[high]


@inlined
def _bin_of_angle(away, across, angles):
    """Bin of the angle of a vector between two of its components."""
    if across is None:
        return 0
    turn = math.atan2(away[across[1]], away[across[0]]) / math.pi
    return int((turn - math.floor(turn)) * angles) % angles


@inlined
def count_pair(i, j, away, distance, histogram):
    """Count a pair of records by groups, angle and distance.

    Parameters
    ----------
    i, j : int
        The records.
    away : tuple of float
        Vector from the one to the other.
    distance : float
        Its length, as a share of the longest that counts.
    histogram : Histogram
        Counts are added.
    """
    if _counts_elsewhere(i, j, histogram.whose, histogram.is_original):
        return
    group = histogram.group
    counts = histogram.counts
    angle = _bin_of_angle(away, histogram.across, counts.shape[2])
    bins = counts.shape[3]
    counts[group[i], group[j], angle, min(int(distance * bins), bins - 1)] += 1
