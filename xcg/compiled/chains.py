"""Force chains: links between particles, depth-first search through them, and what a chain looks like.

Particles are nodes of a graph in compressed rows: the contacts of particle p are
``contact[start[p]:start[p + 1]]``, in the order of the contacts. The searches keep their own stack,
so that a chain may be as long as memory allows.
"""

import math

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import jit
from xcg.compiled.arrays import sort_by_key
from xcg.compiled.contacts import AHEAD
from xcg.compiled.matrices import dot, principal
from xcg.compiled.simd import prefetch

UNSEEN, TOO_SHORT = -1, -2
# A straight chain has no plane: its second extent is below this share of the first (variances, so
# 1e-5 in length).
_STRAIGHT = 1e-10
# A branch with a smaller cosine to the direction of travel lies at right angles to it, neither
# ahead nor behind.
_SIDEWAYS = 1e-9


@jit
def aligned_contacts(i, j, branch, direction, qualifies, cosine, aligned):
    """Mark contacts whose branch lies within an angle of the directions of both particles, either way round.

    Parameters
    ----------
    i, j : (m,)
        Rows of the particles; negative for walls.
    branch : (m, 3)
        From the centre of j to that of i.
    direction : (n, 3)
        Unit vectors.
    qualifies : (n,)
        Which particles may be part of a chain.
    cosine : float
        Of the largest angle.
    aligned : (m,)
        Set here.
    """
    for c in range(i.size):
        later = min(c + AHEAD, i.size - 1)
        prefetch(direction, i[later])
        prefetch(direction, j[later])
        p, q = i[c], j[c]
        aligned[c] = False
        if p < 0 or q < 0 or not (qualifies[p] and qualifies[q]):
            continue
        b = branch[c]
        limit = cosine * math.sqrt(dot(b, b))
        aligned[c] = abs(dot(b, direction[p])) >= limit and abs(dot(b, direction[q])) >= limit


def rows_of_contacts(
    i: NDArray, j: NDArray, chosen: NDArray, count: int
) -> tuple[NDArray, NDArray]:
    """Compressed rows of the graph whose edges are the chosen contacts: start (count + 1,), contact (2 edges,)."""
    edges = np.flatnonzero(chosen)
    ends, start = np.column_stack([i[edges], j[edges]]).ravel(), np.zeros(count + 2, np.int64)
    order = np.empty(ends.size, np.int64)
    sort_by_key(ends, start[1:], order)  # leaves where each row ends, and the next begins
    return start[:-1], edges[order // 2]


@jit
def _far_end(i, j, c, p):
    """Partner of particle p in contact c, and the sign that turns its branch onto it."""
    if i[c] == p:
        return j[c], -1.0
    return i[c], 1.0


@jit
def _step(p, q, sign, branch, onward, place, parent):
    """Go from p to q: place q beside p, and turn its direction onward."""
    parent[q] = p
    turn = 1.0 if sign * dot(branch, onward[q]) >= 0.0 else -1.0
    for k in range(3):
        place[q, k] = place[p, k] + sign * branch[k]
        onward[q, k] *= turn


@jit
def _close(chain, link, start, contact, members, begin, end, count, min_length):
    """Keep a chain that is long enough; else forget it. Return how many chains and members there are."""
    if end - begin >= min_length:
        return count + 1, end
    for m in range(begin, end):
        p = members[m]
        chain[p] = TOO_SHORT
        for e in range(start[p], start[p + 1]):
            link[contact[e]] = UNSEEN
    return count, begin


@jit
def branching_chains(
    i,
    j,
    branch,
    start,
    contact,
    seeds,
    one_sided,
    min_length,
    chain,
    parent,
    members,
    first,
    onward,
    place,
    link,
):
    """Depth-first search from each seed, through branches and back together.

    Parameters
    ----------
    i, j : (m,)
        Rows of the particles of each contact.
    branch : (m, 3)
        From the centre of j to that of i.
    start, contact
        The graph of aligned contacts, in compressed rows.
    seeds : (s,)
        Where to begin, in this order.
    one_sided : bool
        Go on only where the branch points along the direction of travel; from the seed, both ways.
    min_length : int
        Chains of fewer particles are forgotten, and their particles not tried again.
    chain, parent : (n,)
        Chain of each particle and where it was reached from, UNSEEN at first; set here.
    members : (n,)
        Particles chain by chain in the order that they were reached; set here.
    first : (n + 1,)
        Where each chain begins among the members; set here.
    onward : (n, 3)
        Directions, turned onward here.
    place : (n, 3)
        Positions; positions of a chain are made continuous across periodic boundaries here.
    link : (m,)
        Chain that each contact is a link of, UNSEEN at first; set here.

    Returns
    -------
    int
        Number of chains.
    """
    stack = np.empty(chain.size, np.int64)
    cursor = np.empty(chain.size, np.int64)
    count, filled = 0, 0
    for seed in seeds:
        if chain[seed] != UNSEEN:
            continue
        begin = filled
        chain[seed] = count
        members[filled] = seed
        filled += 1
        for way in range(2 if one_sided else 1):
            stack[0], depth = seed, 1
            cursor[seed] = start[seed]
            while depth > 0:
                p = stack[depth - 1]
                e = cursor[p]
                if e == start[p + 1]:
                    depth -= 1
                    continue
                cursor[p] += 1
                c = contact[e]
                q, sign = _far_end(i, j, c, p)
                if one_sided:
                    ahead = sign * dot(branch[c], onward[p])
                    ahead = -ahead if p == seed and way == 1 else ahead
                    if ahead < -_SIDEWAYS * math.sqrt(dot(branch[c], branch[c])):
                        continue
                if chain[q] == UNSEEN:
                    chain[q] = count
                    _step(p, q, sign, branch[c], onward, place, parent)
                    members[filled] = q
                    filled += 1
                    stack[depth] = q
                    depth += 1
                    cursor[q] = start[q]
                if chain[q] == count:
                    link[c] = count
        first[count] = begin
        count, filled = _close(
            chain, link, start, contact, members, begin, filled, count, min_length
        )
    first[count] = filled
    return count


@jit
def _nearest_link(p, i, j, branch, start, contact, chain, onward, either_way):
    """Find the link of p to a particle of no chain that is nearest to its direction of travel, or to its line.

    Returns the contact, UNSEEN if none lies ahead, and the cosine.
    """
    best, best_cosine = UNSEEN, 0.0
    for e in range(start[p], start[p + 1]):
        c = contact[e]
        q, sign = _far_end(i, j, c, p)
        cosine = sign * dot(branch[c], onward[p]) / math.sqrt(dot(branch[c], branch[c]))
        ahead = abs(cosine) if either_way else cosine
        if chain[q] == UNSEEN and ahead > _SIDEWAYS and ahead > abs(best_cosine):
            best, best_cosine = c, cosine
    return best, best_cosine


@jit
def linear_chains(
    i,
    j,
    branch,
    start,
    contact,
    seeds,
    min_length,
    chain,
    parent,
    members,
    first,
    onward,
    place,
    link,
):
    """Search without branches: from each seed both ways, each time to the contact nearest to the direction of travel.

    A seed's direction is a line: the first way is the one of the link nearest to it, so that the
    sign in which an eigenvector comes makes no difference. Parameters as in `branching_chains`.
    """
    count, filled = 0, 0
    for seed in seeds:
        if chain[seed] != UNSEEN:
            continue
        begin = filled
        chain[seed] = count
        members[filled] = seed
        filled += 1
        _, cosine = _nearest_link(seed, i, j, branch, start, contact, chain, onward, True)
        onward[seed] *= -1.0 if cosine < 0.0 else 1.0
        for way in (1.0, -1.0):
            p = seed
            onward[seed] *= way
            while True:
                best, _ = _nearest_link(p, i, j, branch, start, contact, chain, onward, False)
                if best == UNSEEN:
                    break
                q, sign = _far_end(i, j, best, p)
                chain[q] = count
                link[best] = count
                _step(p, q, sign, branch[best], onward, place, parent)
                members[filled] = q
                filled += 1
                p = q
        onward[seed] *= -1.0
        first[count] = begin
        count, filled = _close(
            chain, link, start, contact, members, begin, filled, count, min_length
        )
    first[count] = filled
    return count


@jit
def count_links(i, j, start, contact, link, links):
    """Count the links of each particle; of several contacts with one partner only the first stays a link.

    Parameters
    ----------
    link : (m,)
        Chain of each contact, UNSEEN for none; changed here.
    links : (n,)
        Set here.
    """
    seen = np.full(links.size, UNSEEN)
    for p in range(links.size):
        links[p] = 0
        for e in range(start[p], start[p + 1]):
            c = contact[e]
            if link[c] == UNSEEN:
                continue
            q, _ = _far_end(i, j, c, p)
            if seen[q] == p:
                link[c] = UNSEEN
                continue
            seen[q] = p
            links[p] += 1


@jit
def describe_chains(
    members, first, place, stress, links, lengths, edges, branches, mean, orientation, normal
):
    """Size, mean stress and shape of each chain.

    Parameters
    ----------
    members, first
        Particles chain by chain.
    place : (n, 3)
        Positions, continuous along each chain.
    stress : (n,)
        What is averaged.
    links : (n,)
        Links of each particle.
    lengths, edges, branches : (k,)
        Particles, links, and particles with more than two links; set here.
    mean : (k,)
        Mean stress; set here.
    orientation, normal : (k, 3)
        Axes of the largest and smallest extent, the largest component positive; the normal of a
        straight chain is NaN. Set here.
    """
    count = lengths.size
    spread, extent, axes = np.zeros((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3, 3))
    centre = np.zeros(3)
    for k in range(count):
        size = first[k + 1] - first[k]
        lengths[k], edges[k], branches[k], mean[k] = size, 0, 0, 0.0
        centre[:] = 0.0
        for p in members[first[k] : first[k + 1]]:
            edges[k] += links[p]
            branches[k] += links[p] > 2
            mean[k] += stress[p] / size
            for a in range(3):
                centre[a] += (place[p, a] - place[members[first[k]], a]) / size
        edges[k] //= 2
        for p in members[first[k] : first[k + 1]]:
            for a in range(3):
                for b in range(3):
                    spread[k, a, b] += (place[p, a] - place[members[first[k]], a] - centre[a]) * (
                        place[p, b] - place[members[first[k]], b] - centre[b]
                    )
    principal(spread, extent, axes)
    for k in range(count):
        _fold(axes[k, 0], orientation[k])
        _fold(axes[k, 2], normal[k])
        if extent[k, 1] <= _STRAIGHT * extent[k, 0]:
            normal[k] = math.nan


@jit
def _fold(axis, out):
    """Copy an axis, turned so that its largest component is positive."""
    largest = 0
    for a in range(1, 3):
        if abs(axis[a]) > abs(axis[largest]):
            largest = a
    sign = 1.0 if axis[largest] >= 0.0 else -1.0
    for a in range(3):
        out[a] = sign * axis[a]
