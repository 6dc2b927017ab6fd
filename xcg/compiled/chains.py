"""Force chains: links between particles, depth-first search through them, and what a chain looks like.

Particles are nodes of a graph in compressed rows: the contacts of particle p are
``contact[start[p]:start[p + 1]]``, in the order of the contacts. The searches keep their own stack,
so that a chain may be as long as memory allows.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import jit
from xcg.compiled.arrays import sort_by_key
from xcg.compiled.contacts import AHEAD
from xcg.compiled.matrices import dot, principal
from xcg.compiled.simd import prefetch

UNSEEN = -1
TOO_SHORT = -2
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
        p = i[c]
        q = j[c]
        aligned[c] = False
        if p < 0 or q < 0 or not (qualifies[p] and qualifies[q]):
            continue
        b = branch[c]
        limit = cosine * math.sqrt(dot(b, b))
        aligned[c] = abs(dot(b, direction[p])) >= limit and abs(dot(b, direction[q])) >= limit


class Graph(NamedTuple):
    """Contacts that may be links, by particle.

    Attributes
    ----------
    i, j : (m,)
        Rows of the particles of each contact.
    branch : (m, 3)
        From the centre of j to that of i.
    start, contact : (n + 1,), (2 edges,)
        Aligned contacts in compressed rows.
    """

    i: NDArray
    j: NDArray
    branch: NDArray
    start: NDArray
    contact: NDArray


class Chains(NamedTuple):
    """Chains of a search; all but `onward` and `unwrapped` are set by it.

    Attributes
    ----------
    chain, parent : (n,)
        Chain of each particle and where it was reached from, UNSEEN at first.
    members : (n,)
        Particles chain by chain in the order that they were reached.
    first : (n + 1,)
        Where each chain begins among the members.
    onward : (n, 3)
        Directions, turned onward.
    unwrapped : (n, 3)
        Positions, made continuous along each chain across periodic boundaries.
    link : (m,)
        Chain that each contact is a link of, UNSEEN at first.
    """

    chain: NDArray
    parent: NDArray
    members: NDArray
    first: NDArray
    onward: NDArray
    unwrapped: NDArray
    link: NDArray


def graph_of(i: NDArray, j: NDArray, branch: NDArray, chosen: NDArray, count: int) -> Graph:
    """Return the graph of `count` particles whose edges are the chosen contacts."""
    edges = np.flatnonzero(chosen)
    ends = np.column_stack([i[edges], j[edges]]).ravel()
    start = np.zeros(count + 2, np.int64)
    order = np.empty(ends.size, np.int64)
    sort_by_key(ends, start[1:], order)  # leaves where each row ends, and the next begins
    return Graph(i, j, branch, start[:-1], edges[order // 2])


@jit
def _far_end(graph, c, p):
    """Partner of particle p in contact c, and the sign that turns its branch onto it."""
    if graph.i[c] == p:
        return graph.j[c], -1.0
    return graph.i[c], 1.0


@jit
def _extend(p, q, sign, branch, chains):
    """Extend a chain from p to q: unwrap the position of q beside p, and turn its direction onward."""
    chains.parent[q] = p
    ahead = sign * dot(branch, chains.onward[q])
    for k in range(3):
        chains.unwrapped[q, k] = chains.unwrapped[p, k] + sign * branch[k]
        if ahead < 0.0:
            chains.onward[q, k] *= -1.0


@jit
def _close(graph, chains, begin, end, count, min_length):
    """Keep a chain that is long enough; else forget it. Return how many chains and members there are."""
    if end - begin >= min_length:
        return count + 1, end
    for m in range(begin, end):
        p = chains.members[m]
        chains.chain[p] = TOO_SHORT
        for e in range(graph.start[p], graph.start[p + 1]):
            chains.link[graph.contact[e]] = UNSEEN
    return count, begin


@jit
def branching_chains(graph, seeds, one_sided, min_length, chains):
    """Depth-first search from each seed, through branches and back together.

    Parameters
    ----------
    graph : Graph
        The contacts.
    seeds : (s,)
        Where to begin, in this order.
    one_sided : bool
        Go on only where the branch points along the direction of travel; from the seed, both ways.
    min_length : int
        Chains of fewer particles are forgotten, and their particles not tried again.
    chains : Chains
        Set here.

    Returns
    -------
    int
        Number of chains.
    """
    start = graph.start
    chain = chains.chain
    members = chains.members
    stack = np.empty(chain.size, np.int64)
    cursor = np.empty(chain.size, np.int64)
    ways = 1
    if one_sided:
        ways = 2
    count = 0
    filled = 0
    for seed in seeds:
        if chain[seed] != UNSEEN:
            continue
        begin = filled
        chain[seed] = count
        members[filled] = seed
        filled += 1
        for way in range(ways):
            stack[0] = seed
            depth = 1
            cursor[seed] = start[seed]
            while depth > 0:
                p = stack[depth - 1]
                e = cursor[p]
                if e == start[p + 1]:
                    depth -= 1
                    continue
                cursor[p] += 1
                c = graph.contact[e]
                q, sign = _far_end(graph, c, p)
                branch = graph.branch[c]
                if one_sided:
                    ahead = sign * dot(branch, chains.onward[p])
                    if p == seed and way == 1:
                        ahead = -ahead
                    if ahead < -_SIDEWAYS * math.sqrt(dot(branch, branch)):
                        continue
                if chain[q] == UNSEEN:
                    chain[q] = count
                    _extend(p, q, sign, branch, chains)
                    members[filled] = q
                    filled += 1
                    stack[depth] = q
                    depth += 1
                    cursor[q] = start[q]
                if chain[q] == count:
                    chains.link[c] = count
        chains.first[count] = begin
        count, filled = _close(graph, chains, begin, filled, count, min_length)
    chains.first[count] = filled
    return count


@jit
def _nearest_link(p, graph, chains, either_way):
    """Find the link of p to a particle of no chain that is nearest to its direction of travel, or to its line.

    Returns the contact, UNSEEN if none lies ahead, and the cosine.
    """
    best = UNSEEN
    best_cosine = 0.0
    for e in range(graph.start[p], graph.start[p + 1]):
        c = graph.contact[e]
        q, sign = _far_end(graph, c, p)
        branch = graph.branch[c]
        cosine = sign * dot(branch, chains.onward[p]) / math.sqrt(dot(branch, branch))
        ahead = cosine
        if either_way:
            ahead = abs(cosine)
        if chains.chain[q] == UNSEEN and ahead > _SIDEWAYS and ahead > abs(best_cosine):
            best = c
            best_cosine = cosine
    return best, best_cosine


@jit
def linear_chains(graph, seeds, min_length, chains):
    """Search without branches: from each seed both ways, each time to the contact nearest to the direction of travel.

    A seed's direction is a line: the first way is the one of the link nearest to it, so that the
    sign in which an eigenvector comes makes no difference. Parameters as in `branching_chains`.
    """
    chain = chains.chain
    members = chains.members
    onward = chains.onward
    count = 0
    filled = 0
    for seed in seeds:
        if chain[seed] != UNSEEN:
            continue
        begin = filled
        chain[seed] = count
        members[filled] = seed
        filled += 1
        _, cosine = _nearest_link(seed, graph, chains, True)
        if cosine < 0.0:
            onward[seed] *= -1.0
        for way in (1.0, -1.0):
            p = seed
            onward[seed] *= way
            while True:
                best, _ = _nearest_link(p, graph, chains, False)
                if best == UNSEEN:
                    break
                q, sign = _far_end(graph, best, p)
                chain[q] = count
                chains.link[best] = count
                _extend(p, q, sign, graph.branch[best], chains)
                members[filled] = q
                filled += 1
                p = q
        onward[seed] *= -1.0
        chains.first[count] = begin
        count, filled = _close(graph, chains, begin, filled, count, min_length)
    chains.first[count] = filled
    return count


@jit
def count_links(graph, link, links):
    """Count the links of each particle; of several contacts with one partner only the first stays a link.

    Parameters
    ----------
    graph : Graph
        The contacts.
    link : (m,)
        Chain of each contact, UNSEEN for none; changed here.
    links : (n,)
        Set here.
    """
    counted_from = np.full(links.size, UNSEEN)
    for p in range(links.size):
        links[p] = 0
        for e in range(graph.start[p], graph.start[p + 1]):
            c = graph.contact[e]
            if link[c] == UNSEEN:
                continue
            q, _ = _far_end(graph, c, p)
            if counted_from[q] == p:
                link[c] = UNSEEN
                continue
            counted_from[q] = p
            links[p] += 1


class Shapes(NamedTuple):
    """Size, mean stress and shape of chains.

    Attributes
    ----------
    lengths, edges, branches : (k,)
        Particles, links, and particles with more than two links.
    mean : (k,)
        Mean stress.
    orientation, normal : (k, 3)
        Axes of the largest and smallest extent, the largest component positive; the normal of a
        straight chain is NaN.
    """

    lengths: NDArray
    edges: NDArray
    branches: NDArray
    mean: NDArray
    orientation: NDArray
    normal: NDArray


@jit
def describe_chains(chains, stress, links, shapes):
    """Size, mean stress and shape of each chain.

    Parameters
    ----------
    chains : Chains
        As from a search.
    stress : (n,)
        What is averaged.
    links : (n,)
        Links of each particle.
    shapes : Shapes
        Set here.
    """
    unwrapped = chains.unwrapped
    lengths, edges, branches, mean, orientation, normal = shapes
    count = lengths.size
    spread = np.zeros((count, 3, 3))
    extent = np.empty((count, 3))
    axes = np.empty((count, 3, 3))
    centre = np.zeros(3)
    for k in range(count):
        particles = chains.members[chains.first[k] : chains.first[k + 1]]
        size = particles.size
        seed = particles[0]
        lengths[k] = size
        edges[k] = 0
        branches[k] = 0
        mean[k] = 0.0
        centre[:] = 0.0
        for p in particles:
            edges[k] += links[p]
            branches[k] += links[p] > 2
            mean[k] += stress[p] / size
            for a in range(3):
                centre[a] += (unwrapped[p, a] - unwrapped[seed, a]) / size
        edges[k] //= 2
        for p in particles:
            for a in range(3):
                for b in range(3):
                    away_a = unwrapped[p, a] - unwrapped[seed, a] - centre[a]
                    away_b = unwrapped[p, b] - unwrapped[seed, b] - centre[b]
                    spread[k, a, b] += away_a * away_b
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
