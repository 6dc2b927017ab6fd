"""Sums over points: every grain adds its columns, smeared by the kernel, to the nodes that it reaches.

Lengths are in units of the cutoff and relative to the first node. A node's record holds the *flow*
columns first, then columns of constants. Kinematic columns are relative to the node: offsets x = r_i -
r, and velocities u = v_i - U with U the velocity of the first grain that reached the node. Nothing
large is ever subtracted from something equally large, however fast the frame or far the origin.

For each grain the nodes within its support are listed, their weights computed in one vectorised
loop, and their records updated, four neighbouring columns in one instruction.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xcg.compiled._jit import inner, leaf
from xcg.compiled.arrays import along_active, image_of
from xcg.compiled.cells import points_in_ball
from xcg.compiled.reach import (
    BATCH,
    NO_BRANCH,
    NODE,
    OTHER,
    Q2,
    WEIGHT,
    Lists,
    X,
    Y,
    Z,
    batch_reaches,
    images_in_reach,
    nodes_in_ball,
)
from xcg.compiled.simd import add4
from xcg.compiled.smoothing import fill_values

MASS = 0
MOMENTUM = 1  # m u: x y z
COUNT = 4
KINETIC = 5  # m u u: xx xy xz yy yz zz
SQUARE = 11  # (m Psi)^2, as below
CUBE = 12  # m |u|^2 u: x y z, at level CUBIC alone
OFFSET = 12  # m x: x, then every fourth column
SHEAR = 13  # m u_i x_j: i = x y z for j = x, then every fourth column on
SPREAD = 24  # m x x: xx xy xz yy yz zz
SQUARE_OFFSET = 30  # (m Psi)^2 x: x y z
SQUARE_SPREAD = 33  # (m Psi)^2 x x: xx xy xz yy yz zz

SQUARES = (SQUARE, *range(SQUARE_OFFSET, SQUARE_SPREAD + 6))

# what a grain's record holds
POSITION = 0
SPEED = 3
WEIGHED = 6
GROUP = 7
GRAIN = 8

# how many kinematic columns each level of detail takes; some are spare, so that all start at a multiple
# of four
NONE = 0
VELOCITY = 8
FLUCTUATION = 12
CUBIC = 16
LINEAR = 32
SQUARED = 40
_COLUMNS = tuple(np.uint64(k) for k in range(SQUARED))


class Grains(NamedTuple):
    """Grains, or other points, that are added.

    Attributes
    ----------
    order : (k,)
        Rows of the grains, one after the other.
    batches : (r, 2, 3)
        Bounds of each batch of them, in cutoffs from the first node, see `batches_of`: those out of
        reach are passed over.
    position : (n, 3)
        Centres.
    velocity, mass : (n, 3), (n,)
        Velocities and masses; of no account at level NONE.
    constants : (n, q)
        Columns that are the same for all nodes; q is a multiple of four, as they are added four at
        a time.
    phase : (n,)
        Which group each grain belongs to.
    origin, cutoff : tuple, float
        Position of the first node, and radius of the support, in the unit of `position`. All other
        lengths are in cutoffs.
    """

    order: NDArray
    batches: NDArray
    position: NDArray
    velocity: NDArray
    mass: NDArray
    constants: NDArray
    phase: NDArray
    origin: tuple[float, float, float]
    cutoff: float


class Scratch(NamedTuple):
    """Memory of the loop: lists of nodes, and of each grain PLACE and SPEED, three each, WEIGHED, GROUP and constants.

    `records` are (BATCH, GRAIN + q or more).
    """

    lists: Lists
    records: NDArray


@leaf
def deposit(grains, nodes, kernel, level, meet, by_gradient, scratch, moments, reference):
    """Add grains to the nodes within their support.

    Parameters
    ----------
    grains : Grains
        The grains.
    nodes : BlockNodes
        A block of nodes.
    kernel : KernelCode
        The smoothing function.
    level : int
        NONE, VELOCITY, FLUCTUATION, CUBIC, LINEAR or SQUARED: how many kinematic columns are wanted.
    meet : (m, 3) or None
        Translations (cutoffs) from an image of a grain to all others that may reach the same node.
        They share what their velocities are beyond that of the flow: in the squares of weights they
        count as one grain. None leaves code out when the loop is compiled, here and below.
    by_gradient : True or None
        Weigh by derivative / distance instead of the value.
    scratch : Scratch
        Written.
    moments : (phases, nodes of the block, level + q)
        Sums, added to.
    reference : (nodes of the block, 3)
        Reference velocity of each node, NaN where no grain has reached it; set here.
    """
    begin = nodes.begin
    end = nodes.end
    active = nodes.active
    period = nodes.period
    kind = kernel.kind
    table = kernel.table
    norm = kernel.norm
    lists, records = scratch
    values, numbers = lists
    q2 = values[Q2]
    weight = values[WEIGHT]
    columns = grains.constants.shape[1]
    for batch in range(grains.batches.shape[0]):
        if not batch_reaches(grains.batches, batch, begin, end, active, period):
            continue
        listed = grains.order[batch * BATCH : (batch + 1) * BATCH]
        _list_grains(listed, grains, records)
        for i in range(listed.size):
            p = np.uint64(records[i, GROUP])
            x0, y0, z0 = along_active(
                records[i, POSITION], records[i, POSITION + 1], records[i, POSITION + 2], active
            )
            start = (x0, y0, z0)
            first_x, last_x = images_in_reach(0, start, NO_BRANCH, nodes)
            first_y, last_y = images_in_reach(1, start, NO_BRANCH, nodes)
            first_z, last_z = images_in_reach(2, start, NO_BRANCH, nodes)
            if first_x > last_x or first_y > last_y or first_z > last_z:
                continue
            for image_x in range(first_x, last_x + 1):
                x = image_of(x0, image_x, period[0])
                for image_y in range(first_y, last_y + 1):
                    y = image_of(y0, image_y, period[1])
                    for image_z in range(first_z, last_z + 1):
                        z = image_of(z0, image_z, period[2])
                        hits = nodes_in_ball(x, y, z, nodes.rows, lists)
                        hits += points_in_ball(x, y, z, nodes.cells, lists)
                        fill_values(kind, table, norm, by_gradient, q2, hits, weight)
                        if level > 0:
                            _add_flow(p, records, i, lists, hits, level, moments, reference)
                        if level == CUBIC:
                            _add_cubes(p, records, i, lists, hits, moments, reference)
                        if meet is not None:
                            mass = records[i, WEIGHED]
                            _add_images(p, mass, lists, hits, level, meet, kernel, moments)
                        for d in range(0, columns, 4):
                            first = GRAIN + d
                            four = (
                                records[i, first],
                                records[i, first + 1],
                                records[i, first + 2],
                                records[i, first + 3],
                            )
                            for k in range(hits):
                                add4(moments, p, numbers[NODE, k], level + d, weight[k], four)


@inner
def _list_grains(indices, grains, records):
    """Gather the rows of some grains, spread over memory, all requested at once."""
    per_cutoff = 1.0 / grains.cutoff
    origin = grains.origin
    position = grains.position
    velocity = grains.velocity
    constants = grains.constants
    for i in range(indices.size):
        n = indices[i]
        for k in range(3):
            records[i, POSITION + k] = (position[n, k] - origin[k]) * per_cutoff
            records[i, SPEED + k] = velocity[n, k]
        records[i, WEIGHED] = grains.mass[n]
        records[i, GROUP] = grains.phase[n]
        for k in range(constants.shape[1]):
            records[i, GRAIN + k] = constants[n, k]


@inner
def _add_flow(p, records, i, lists, hits, level, moments, reference):
    """Add one grain to the kinematic columns of the nodes that it reaches."""
    mass = records[i, WEIGHED]
    vx = records[i, SPEED]
    vy = records[i, SPEED + 1]
    vz = records[i, SPEED + 2]
    values, numbers = lists
    for k in range(hits):
        n = np.uint64(numbers[NODE, k])
        x = values[X, k]
        y = values[Y, k]
        z = values[Z, k]
        if math.isnan(reference[n, 0]):
            reference[n, 0], reference[n, 1], reference[n, 2] = vx, vy, vz
        ux = vx - reference[n, 0]
        uy = vy - reference[n, 1]
        uz = vz - reference[n, 2]
        w = values[WEIGHT, k] * mass
        wx, wy, wz = w * ux, w * uy, w * uz
        add4(moments, p, n, MASS, 1.0, (w, wx, wy, wz))
        add4(moments, p, n, COUNT, 1.0, (1.0, wx * ux, wx * uy, wx * uz))
        if level >= FLUCTUATION:
            add4(moments, p, n, KINETIC + 3, 1.0, (wy * uy, wy * uz, wz * uz, w * w))
        if level >= LINEAR:
            add4(moments, p, n, OFFSET, x, (w, wx, wy, wz))
            add4(moments, p, n, OFFSET + 4, y, (w, wx, wy, wz))
            add4(moments, p, n, OFFSET + 8, z, (w, wx, wy, wz))
            wx, wy, wz = w * x, w * y, w * z
            add4(moments, p, n, SPREAD, 1.0, (wx * x, wx * y, wx * z, wy * y))
            add4(moments, p, n, SPREAD + 4, 1.0, (wy * z, wz * z, w * wx, w * wy))
            if level >= SQUARED:
                add4(moments, p, n, SQUARE_OFFSET + 2, w, (wz, wx * x, wx * y, wx * z))
                add4(moments, p, n, SQUARE_SPREAD + 3, w, (wy * y, wy * z, wz * z, 0.0))


@inner
def _add_cubes(p, records, i, lists, hits, moments, reference):
    """Add m |u|^2 u of one grain to the nodes that it reaches."""
    mass = records[i, WEIGHED]
    vx = records[i, SPEED]
    vy = records[i, SPEED + 1]
    vz = records[i, SPEED + 2]
    values, numbers = lists
    for k in range(hits):
        n = np.uint64(numbers[NODE, k])
        ux = vx - reference[n, 0]
        uy = vy - reference[n, 1]
        uz = vz - reference[n, 2]
        weight = values[WEIGHT, k] * mass * (ux * ux + uy * uy + uz * uz)
        add4(moments, p, n, CUBE, weight, (ux, uy, uz, 0.0))


@inner
def _add_images(p, mass, lists, hits, level, meet, kernel, moments):
    """Add the products of the weight of one image of a grain, at the nodes that it reaches, and of all its others."""
    kind = kernel.kind
    table = kernel.table
    norm = kernel.norm
    values, numbers = lists
    q2 = values[Q2]
    other = values[OTHER]
    for image in range(meet.shape[0]):
        move_x = meet[image, 0]
        move_y = meet[image, 1]
        move_z = meet[image, 2]
        for k in range(hits):
            x = values[X, k] + move_x
            y = values[Y, k] + move_y
            z = values[Z, k] + move_z
            q2[k] = min(1.0, x * x + y * y + z * z)
        fill_values(kind, table, norm, None, q2, hits, other)
        for k in range(hits):
            if q2[k] >= 1.0:
                continue
            n = np.uint64(numbers[NODE, k])
            w = mass * values[WEIGHT, k] * (mass * other[k])
            moments[p, n, _COLUMNS[SQUARE]] += w
            if level >= SQUARED:
                x, y, z = values[X, k], values[Y, k], values[Z, k]
                to_x = w * (x + move_x)
                to_y = w * (y + move_y)
                to_z = w * (z + move_z)
                add4(moments, p, n, SQUARE_OFFSET, 1.0, (to_x, to_y, to_z, x * to_x))
                add4(
                    moments, p, n, SQUARE_SPREAD + 1, 1.0, (x * to_y, x * to_z, y * to_y, y * to_z)
                )
                moments[p, n, _COLUMNS[SQUARE_SPREAD + 5]] += z * to_z
