"""Sums over segments: every contact adds force times branch, smeared along the branch, to the nodes it reaches.

Any other vector of a contact's sides may take the place of the force.

Lengths are in units of the cutoff and relative to the first node. The weight of a node is the mean
of the kernel over the segment, ``S = int_0^1 Psi(r - start + u a) du`` with the segment running
from `start` to ``start - a``. It comes from the closed form, or from the fewest Gauss-Legendre
points that meet the asked accuracy for a branch of that length.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inlined, inner, leaf
from xcg.compiled.arrays import Reduced, along_active, gauss_rules, image_of
from xcg.compiled.cells import points_around_segment
from xcg.compiled.contacts import side
from xcg.compiled.lines import SHORT, SHORT_ORDER, fill_segments
from xcg.compiled.reach import (
    ALONG,
    NODE,
    Q2,
    WEIGHT,
    batch_reaches,
    images_in_reach,
    no_bounds,
    nodes_around_segment,
)
from xcg.compiled.simd import add4, prefetch
from xcg.compiled.smoothing import fill_gauss

# The rules to choose from, by number of Gauss-Legendre points: an odd number takes as long as the
# next even one.
RULES = (2, 4, 6, 8, 10, 12)
# Branches closer to one line than this (sine of their angle) share one segment from centre to
# centre; the contact point is then off that line by no more than the rounding of its coordinates.
COLLINEAR = 1e-12
# Contacts so many ahead are prefetched, and the particles of those that are nearer.
FAR_AHEAD = 24
AHEAD = 8
# what a segment's record holds
START = 0
BRANCH = 3
FORCE = 6
GROUP = 9
SEGMENT = 10
RUN = 64  # segments, neighbours in space, that are passed over together, or listed together
_LAST = np.uint64(8)


GAUSS_POINTS, GAUSS_WEIGHTS = gauss_rules(*RULES)


@inner
def choose_order(length, limits):
    """Fewest points among `RULES` whose error bound holds up to this length; 0, the closed form, where none does."""
    if length < SHORT:
        return SHORT_ORDER
    for k in range(limits.size):
        if length <= limits[k]:
            return RULES[k]
    return 0


class IndexedContacts(NamedTuple):
    """Contacts by the indices of their particles.

    Attributes
    ----------
    index_i, index_j : (n,)
        Particles of each contact; negative where a partner is not in the scene.
    point : (n, 3)
        Contact point.
    on_i : (n, 3)
        What the side of i carries: the force on i, or another vector.
    on_j : (n, 3) or None
        What the side of j carries; None for the opposite of that of i, as of forces.
    position, phase : (m, 3), (m,)
        Of the particles.
    period : tuple
        Periods of the scene, infinite along other axes.
    lattice : Reduced or None
        Periodic images of boxes with other edges than x, y and z.
    """

    index_i: NDArray
    index_j: NDArray
    point: NDArray
    on_i: NDArray
    on_j: NDArray | None
    position: NDArray
    phase: NDArray
    period: tuple[float, float, float]
    lattice: Reduced | None


class SegmentChoice(NamedTuple):
    """Selection of the segments to list.

    Attributes
    ----------
    contacts : ContactRows
        The contacts.
    second : bool
        Whether the segments of the partners are wanted.
    others : int
        0, or the number of phases of partners, the last one for partners not in the scene: groups
        are then phases by phases of the partner.
    cutoffs : (phases,)
        Cutoff of the sides of each phase.
    cutoff : float
        The one whose segments are listed, and their unit of length.
    origin : tuple
        Of the starts.
    """

    contacts: IndexedContacts
    second: bool
    others: int
    cutoffs: NDArray
    cutoff: float
    origin: tuple[float, float, float]


@leaf
def list_segments(listing, indices, segments, bounds, longest):
    """List one segment for each of some contacts: of its first particle that is there, or `second`, of its partner.

    Without `segments` they are only measured. None leaves code out when the loop is compiled, here
    and below.

    Each side of a contact runs from its particle's centre to the contact point. Both sides are one
    segment, of the first, where they carry opposite vectors, lie on one line, on opposite sides of
    the point, and in one phase.

    Parameters
    ----------
    listing : SegmentChoice
        The contacts, and which of their segments are wanted.
    indices : (k,)
        Which contacts, in the order of the list.
    segments : (k, SEGMENT) or None
        Written: START, BRANCH from the segment's end to its start, and FORCE on the particle (or
        what the side carries in its place) times the cutoff, three each, and GROUP, or -1 as GROUP
        alone without a segment.
    bounds : (runs, 2, 3) or None
        Widened to hold the segments of each run, see `bounds_of_segments`.
    longest : (4,)
        Written: the largest component along x, y, z, and length, of a branch; NaN if any is.

    Returns
    -------
    bool
        Whether any contact has a second segment.
    """
    contacts, second, others, cutoffs, cutoff, origin = listing
    position = contacts.position
    phase = contacts.phase
    per_cutoff = 1.0 / cutoff
    more = False
    last = indices.size - 1
    most = (0.0, 0.0, 0.0, 0.0)
    alone = cutoffs.size == 1  # phases are not looked at where there is one
    for k in range(indices.size):
        far = indices[min(k + FAR_AHEAD, last)]
        if segments is not None:
            prefetch(contacts.on_i, far)
            segments[k, GROUP] = -1.0
        _prefetch(contacts, far, indices[min(k + AHEAD, last)], alone)
        n = np.int64(indices[k])
        i, j, two, ax, ay, az = _side(contacts, n, second, alone)
        more = more or two
        if i < 0 or (second and not two) or (not alone and cutoffs[phase[i]] != cutoff):
            continue
        x, y, z = ax * per_cutoff, ay * per_cutoff, az * per_cutoff
        most = _longer(most, x, y, z)
        if bounds is not None:
            _widen(bounds[k // RUN], 0, (position[i, 0] - origin[0]) * per_cutoff, x)
            _widen(bounds[k // RUN], 1, (position[i, 1] - origin[1]) * per_cutoff, y)
            _widen(bounds[k // RUN], 2, (position[i, 2] - origin[2]) * per_cutoff, z)
        if segments is not None:
            for c in range(3):
                segments[k, START + c] = (position[i, c] - origin[c]) * per_cutoff
            segments[k, BRANCH] = x
            segments[k, BRANCH + 1] = y
            segments[k, BRANCH + 2] = z
            of_j = second or contacts.index_i[n] < 0
            _write_carried(segments, k, contacts.on_i, contacts.on_j, n, of_j, cutoff)
            segments[k, GROUP] = 0.0
            if not alone:
                segments[k, GROUP] = phase[i]
            if others:
                partner = others - 1
                if j >= 0:
                    partner = phase[j]
                segments[k, GROUP] = phase[i] * others + partner
    for k in range(3):
        longest[k] = most[k]
    longest[3] = math.sqrt(most[3])
    if math.isnan(most[3]):
        longest[:] = math.nan
    return more


@inlined
def _prefetch(contacts, far, later, alone):
    """Ask for a contact, and for the particles of another one, which was asked for before."""
    prefetch(contacts.index_i, far)
    prefetch(contacts.index_j, far)
    prefetch(contacts.point, far)
    prefetch(contacts.position, contacts.index_i[later])
    prefetch(contacts.position, contacts.index_j[later])
    if not alone:
        prefetch(contacts.phase, contacts.index_i[later])
        prefetch(contacts.phase, contacts.index_j[later])


@inlined
def _side(contacts, n, second, alone):
    """Particle and partner of a segment of contact n, whether it has two segments, and the branch.

    `alone`: there is one phase.
    """
    index_i, index_j, point, _, on_j, position, phase, wrap, lattice = contacts
    i, j = index_i[n], index_j[n]
    ax, ay, az = side(position, i, point, n, wrap, lattice)
    bx, by, bz = side(position, j, point, n, wrap, lattice)
    two = i >= 0 and j >= 0
    if (
        on_j is None
        and two
        and (alone or phase[i] == phase[j])
        and _on_one_line(ax, ay, az, bx, by, bz)
    ):
        ax = ax - bx
        ay = ay - by
        az = az - bz
        two = False
    if i < 0 or second:
        i, j, ax, ay, az = j, i, bx, by, bz
    return i, j, two, ax, ay, az


@inlined
def _write_carried(segments, k, on_i, on_j, n, of_j, unit):
    """Write what a side of contact n carries, times a unit, to a segment."""
    if on_j is None:
        if of_j:
            unit = -unit
        for c in range(3):
            segments[k, FORCE + c] = unit * on_i[n, c]
        return
    carried = on_i
    if of_j:
        carried = on_j
    for c in range(3):
        segments[k, FORCE + c] = unit * carried[n, c]


@inlined
def _longer(most, x, y, z):
    """Largest components, and squared length, of the branches so far and one more; the last is NaN if any is."""
    length2 = x * x + y * y + z * z
    most2 = most[3]
    if not (length2 <= most2 or math.isnan(most2)):
        most2 = length2
    return max(most[0], abs(x)), max(most[1], abs(y)), max(most[2], abs(z)), most2


@inlined
def _widen(bounds, k, start, branch):
    """Widen bounds (2, 3) along axis k to hold a segment."""
    end = start - branch
    bounds[0, k] = min(start, end, bounds[0, k])
    bounds[1, k] = max(start, end, bounds[1, k])


@inner
def _on_one_line(ax, ay, az, bx, by, bz):
    """Return whether two vectors point opposite ways along one line."""
    cx = ay * bz - az * by
    cy = az * bx - ax * bz
    cz = ax * by - ay * bx
    area2 = cx * cx + cy * cy + cz * cz
    most = (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz)
    return ax * bx + ay * by + az * bz <= 0.0 and area2 <= COLLINEAR * COLLINEAR * most


@leaf
def _bounds_of_segments(records, bounds):
    for n in range(records.shape[0]):
        if records[n, GROUP] >= 0.0:
            for k in range(3):
                _widen(bounds[n // RUN], k, records[n, START + k], records[n, BRANCH + k])


def bounds_of_segments(records: NDArray) -> NDArray:
    """Lowest and highest point, (runs, 2, 3), of each run of `RUN` segments."""
    bounds = no_bounds(len(records), RUN)
    _bounds_of_segments(records, bounds)
    return bounds


class Segments(NamedTuple):
    """Segments that are added.

    Attributes
    ----------
    records : (n, SEGMENT)
        As from `list_segments`; lengths in cutoffs, starts relative to the first node.
    limits : (k,)
        Longest branch for which each of the first k `RULES` is accurate enough; empty for the
        closed form.
    bounds : (r, 2, 3)
        Bounds of each run of segments, see `bounds_of_segments`: those out of reach are passed
        over.
    """

    records: NDArray
    limits: NDArray
    bounds: NDArray


@leaf
def deposit_segments(segments, nodes, kernel, lists, closed, rest, moments):
    """Add force x branch of each segment to the nodes that its tube of radius 1 reaches.

    Parameters
    ----------
    segments : Segments
        The segments.
    nodes : BlockNodes
        A block of nodes.
    kernel : KernelCode
        The smoothing function.
    lists : Lists
        Scratch: in single precision where that is enough for distances and weights; sums are in
        double.
    closed : tuple or None
        Scratch for the closed form, see `xcg.compiled.polynomials.closed_for`; None leaves out segments that need
        it, and code when the loop is compiled.
    rest : bool
        Leave out all other segments.
    moments : (groups, nodes of the block, 9)
        Sums, added to: force component by branch component, row by row.
    """
    begin = nodes.begin
    end = nodes.end
    active = nodes.active
    period = nodes.period
    kind = kernel.kind
    table = kernel.table
    norm = kernel.norm
    values, numbers = lists
    records = segments.records
    along = values[ALONG]
    q2 = values[Q2]
    w = values[WEIGHT]
    here = True
    for i in range(records.shape[0]):
        if i % RUN == 0:
            here = batch_reaches(segments.bounds, i // RUN, begin, end, active, period)
        if not here or records[i, GROUP] < 0.0:
            continue
        x0, y0, z0 = along_active(
            records[i, START], records[i, START + 1], records[i, START + 2], active
        )
        bx, by, bz = along_active(
            -records[i, BRANCH], -records[i, BRANCH + 1], -records[i, BRANCH + 2], active
        )
        start = (x0, y0, z0)
        branch = (bx, by, bz)
        first_x, last_x = images_in_reach(0, start, branch, nodes)
        first_y, last_y = images_in_reach(1, start, branch, nodes)
        first_z, last_z = images_in_reach(2, start, branch, nodes)
        if first_x > last_x or first_y > last_y or first_z > last_z:
            continue
        length = math.sqrt(bx * bx + by * by + bz * bz)
        points = choose_order(length, segments.limits)
        if (points > 0 and rest) or (points == 0 and closed is None):
            continue
        per_length = 1.0 / length if length > 0.0 else 0.0
        for image_x in range(first_x, last_x + 1):
            x = image_of(x0, image_x, period[0])
            for image_y in range(first_y, last_y + 1):
                y = image_of(y0, image_y, period[1])
                for image_z in range(first_z, last_z + 1):
                    z = image_of(z0, image_z, period[2])
                    hits = nodes_around_segment(x, y, z, bx, by, bz, per_length, nodes.rows, lists)
                    hits += points_around_segment(
                        x, y, z, bx, by, bz, per_length, nodes.cells, lists
                    )
                    if points:
                        rule = GAUSS_POINTS[points, :points]
                        shares = GAUSS_WEIGHTS[points, :points]
                        fill_gauss(kind, table, rule, shares, length, along, q2, hits, w)
                    elif closed is not None:
                        fill_segments(kind, table, length, along, q2, hits, w, closed)
                    _add_dyad(moments, records, i, norm, numbers, w, hits)


@inner
def _add_dyad(moments, records, i, norm, numbers, w, hits):
    """Add weight x norm x force x branch of segment i to the nine columns of each node."""
    p = np.uint64(records[i, GROUP])
    f0 = norm * records[i, FORCE]
    f1 = norm * records[i, FORCE + 1]
    f2 = norm * records[i, FORCE + 2]
    a0 = records[i, BRANCH]
    a1 = records[i, BRANCH + 1]
    a2 = records[i, BRANCH + 2]
    for k in range(hits):
        n = np.uint64(numbers[NODE, k])
        v = np.float64(w[k])
        add4(moments, p, n, 0, v, (f0 * a0, f0 * a1, f0 * a2, f1 * a0))
        add4(moments, p, n, 4, v, (f1 * a1, f1 * a2, f2 * a0, f2 * a1))
        moments[p, n, _LAST] += v * (f2 * a2)
