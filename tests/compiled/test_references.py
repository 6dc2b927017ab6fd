"""The loops over points and segments against their references in NumPy, at every node of a mesh."""

from typing import get_args

import numpy as np
import pytest

import xcg
from xcg.compiled.arrays import gauss_rules
from xcg.compiled.points import (
    CUBE,
    CUBIC,
    GRAIN,
    SQUARED,
    Grains,
    Scratch,
    deposit,
)
from xcg.compiled.polynomials import closed_for
from xcg.compiled.reach import BATCH, BlockNodes, Rows, batches_of, lists_for
from xcg.compiled.segments import (
    SEGMENT,
    Segments,
    bounds_of_segments,
    deposit_segments,
)
from xcg.fields.sums.kernels import KernelName, kernel_of

xcg.register_kernel(
    "reference spline", lambda q: (1 - q) ** 4 * (1 + 4 * q), ratio=2.0, smoothness=2
)
KERNELS = [*get_args(KernelName), "reference spline"]
AXES = ["xyz", "xz", "y"]


def reference_deposit(place, velocity, mass, constants, node, value):
    """Sum grains (n, ...) at one node (3,) as `deposit` does at many: kinematic columns up to SQUARED, and constants.

    Lengths are in cutoffs, averaged axes are zero, and `value` is the kernel at distances (n,)
    below 1.
    """
    seen = ((place - node) ** 2).sum(axis=1) < 1.0
    x = (place - node)[seen]
    u = (velocity - velocity[seen][:1])[seen]
    six = np.triu_indices(3)
    weight = value(np.sqrt((x * x).sum(axis=1)))
    w = weight * mass[seen]
    kinetic = np.einsum("n,ni,nj", w, u, u)[six]
    spread = np.einsum("n,ni,nj", w, x, x)[six]
    linear = np.einsum("n,nj,ni->ji", w, x, np.column_stack([np.ones(len(u)), u]))
    squared = (w * w) @ x, np.einsum("n,ni,nj", w * w, x, x)[six]
    flow = [
        [w.sum()],
        w @ u,
        [seen.sum()],
        kinetic,
        [w @ w],
        linear.ravel(),
        spread,
        *squared,
        [0.0],
    ]
    return np.concatenate(flow), weight @ constants[seen]


def reference_deposit_segments(start, branch, force, node, active, value):
    """Sum segments (n, 3) at one node (3,) as `deposit_segments` does at many: force x branch, (3, 3).

    Lengths are in cutoffs; `active` (3,) are the axes that are seen, and `value` is the kernel at
    distances below 1.
    """
    total = np.zeros((3, 3))
    x, weights = (rule[48] for rule in gauss_rules(48))
    for begin, along, carried in zip(start, branch, force, strict=True):
        away = (begin - node)[active]
        length = np.linalg.norm(along[active])
        foot = away @ along[active] / length
        h2 = away @ away - foot * foot
        half = np.sqrt(max(0.0, 1.0 - h2))
        first, last = (
            np.arcsin(np.clip([-foot, length - foot] / half, -1.0, 1.0)) if half else (0.0, 0.0)
        )
        # angles on either side of the foot
        for low, high in (
            (first, min(last, 0.0)),
            (max(first, 0.0), last),
        ):
            if low < high:
                q = np.sqrt(h2 + (half * np.sin(low + (high - low) * x)) ** 2)
                mean = (
                    (high - low)
                    / length
                    * half
                    * weights
                    @ (value(q) * np.cos(low + (high - low) * x))
                )
                total += mean * np.outer(carried, along)
    return total


def mesh(axes):
    """Nodes 0.4 cutoffs apart as loops take them, their places (n, 3), and the axes that count."""
    active = np.array([a in axes for a in "xyz"])
    shape = tuple(np.where(active, (4, 3, 5), 1).tolist())
    steps = tuple(np.where(active, 0.4, 1.0).tolist())
    rows = Rows((0, 0, 0), shape, steps, tuple(1.0 / step for step in steps))
    end = tuple((count - 1) * step for count, step in zip(shape, steps, strict=True))
    nodes = BlockNodes((0.0, 0.0, 0.0), end, tuple(active.tolist()), (np.inf,) * 3, rows=rows)
    places = 0.4 * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    return nodes, places, active


def seen_kernel(name, axes):
    """A kernel as loops take it, and as a function of distances, with a cutoff of 1."""
    kernel = kernel_of(name, 1.0, {}, 3)
    kernel = type(kernel)(cutoff=1.0, dimension=3)
    return kernel.weights(len(axes)), lambda q: kernel.value(q, seen=len(axes))


@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("name", KERNELS)
def test_deposit_of_points_equals_its_reference(name, axes):
    rng = np.random.default_rng(1)
    nodes, places, active = mesh(axes)
    weights, value = seen_kernel(name, axes)
    position = rng.uniform(-0.5, 2.0, (9, 3)) * active
    velocity = rng.normal(size=(9, 3)) + 1e3
    mass = rng.uniform(1, 2, 9)
    constants = rng.normal(size=(9, 4))
    order = np.arange(9, dtype="int32")  # as of small scenes, for which the loop is compiled anyway
    batches = batches_of(position, order)
    phase = np.zeros(9, "int64")
    grains = Grains(
        order, batches, position, velocity, mass, constants, phase, (0.0, 0.0, 0.0), 1.0
    )
    scratch = Scratch(lists_for(nodes.rows, nodes.active, [2.0] * 3), np.empty((BATCH, GRAIN + 4)))
    for level in (SQUARED, CUBIC):
        sums = np.zeros((1, len(places), level + 4))
        reference = np.full((len(places), 3), np.nan)
        deposit(grains, nodes, weights, level, None, None, scratch, sums, reference)
        for node, found, first in zip(places, sums[0], reference, strict=True):
            flow, summed = reference_deposit(position, velocity, mass, constants, node, value)
            if level == CUBIC:  # in the place of the columns of LINEAR
                flow = flow[:CUBIC].copy()
                seen = ((position - node) ** 2).sum(axis=1) < 1.0
                u = (velocity - first)[seen]
                w = mass[seen] * value(np.linalg.norm((position - node)[seen], axis=1))
                flow[CUBE : CUBE + 3], flow[CUBE + 3] = (w * (u * u).sum(axis=1)) @ u, 0.0
            np.testing.assert_allclose(found, [*flow, *summed], rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("name", KERNELS)
def test_deposit_of_segments_equals_its_reference(name, axes):
    rng = np.random.default_rng(2)
    nodes, places, active = mesh(axes)
    weights, value = seen_kernel(name, axes)
    start = rng.uniform(0.0, 1.5, (5, 3))
    branch = rng.normal(size=(5, 3))
    force = rng.normal(size=(5, 3))
    records = np.column_stack([start, branch, force, np.zeros(5)])
    assert records.shape[1] == SEGMENT
    segments = Segments(records, np.zeros(0), bounds_of_segments(records))
    reach = 2.0 + np.abs(branch).max(axis=0)
    lists = lists_for(nodes.rows, nodes.active, reach.tolist())
    sums = np.zeros((1, len(places), 9))
    deposit_segments(
        segments, nodes, weights, lists, closed_for(lists.values.shape[1]), False, sums
    )
    expected = [
        reference_deposit_segments(start, branch, force, node, active, value) for node in places
    ]
    expected = np.reshape(expected, (-1, 9))
    np.testing.assert_allclose(sums[0], expected, atol=1e-9 * np.abs(expected).max())
