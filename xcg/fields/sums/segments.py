"""Passes over segments: branches of contacts, with the force, or what is in its place, that each carries."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from xcg.compiled.segments import BRANCH, FORCE, GROUP, ContactRows, closed_for, deposit_segments
from xcg.fields.sums import branches
from xcg.fields.sums.blocks import NodeBlock
from xcg.fields.sums.branches import Branches
from xcg.fields.sums.moments import Moment
from xcg.fields.sums.passes import AnyKernel, Fill, Layout, Pass
from xcg.fields.sums.reach import Mesh
from xcg.fields.sums.step import StepRows, alike
from xcg.scene.schema import Frame


def along_branches(step: StepRows) -> list[Pass]:
    """Sum what contacts carry, along their branches."""
    assert step.contacts is not None
    order = step.in_space(step.position) if step.grains.row is not None else step.grains.order
    contacts = step.contacts.in_order_of(order)
    return [_branches(step, name, row, contacts) for name, row in step.spec.rows.items() if row.along_branches]


def _branches(step: StepRows, name: str, row: Moment, contacts: NDArray) -> Pass:
    """Branches of the contacts, in an order in space, each with its force or what is in its place."""
    spec, around = step.spec, step.surroundings
    others, carried = spec.others if row.paired else 0, _carried(step, row, step.frame)
    fill: list[Fill] = []
    for cutoff in spec.distinct:
        mesh = around.meshes[cutoff]
        for second in (False, True):
            segments, longest, more = _segments(step, row, *carried, contacts, second, others, cutoff)
            reach = mesh.reach + longest[:3]
            mesh.check_reach(reach, step.source)
            for real, closed, rest in _rules(step, longest[3], cutoff):
                way = segments, mesh, around.kernels[cutoff]
                fill.append(partial(_fill_segments, *way, reach.tolist(), real, closed, rest))
            if not more:
                break
    groups = spec.phases * max(others, 1)
    return Pass(Layout(groups, 9, {name: (row.columns, 1.0)}), fill)


def _carried(step: StepRows, row: Moment, frame: Frame) -> tuple[NDArray, NDArray | None]:
    """Vectors (n, 3) that the sides of i and of j carry; None where those of j are the opposite."""
    assert step.contacts is not None
    if row.column is None:
        return step.contacts.force, None
    on_i, on_j = row.column(frame, step.contacts)
    return on_i, on_j


def _segments(
    step: StepRows, moment: Moment, on_i: NDArray, on_j: NDArray | None, contacts: NDArray, second: bool, others: int,
    cutoff: float,
) -> tuple[Branches, NDArray, bool]:  # fmt: skip
    """Segments of the first or second particles of contacts, the longest, and whether there are second ones."""
    c = step.contacts
    assert c is not None
    mesh, tilted, limits = step.surroundings.meshes[cutoff], step.lattice.vectors is not None, step.spec.limits
    rows = ContactRows(c.i, c.j, c.point, on_i, step.position, step.phase, *c.periods)
    listing = rows, on_j, second, others, step.spec.by_phase, cutoff, step.spec.origin
    if len(contacts) > branches.MOST_LISTED_ONCE and not tilted:
        bounds, longest, more = branches.measure(listing, contacts)
        if not mesh.too_long(longest[:3]):
            mesh.check_far(longest[:3], step.source)
            return branches.ListedAnew(listing, contacts, bounds, limits), longest, more
    segments, longest, more = branches.list_some(listing, contacts)
    mesh.check_far(longest[:3], step.source)
    shift = np.zeros(3)
    if tilted:
        used = np.flatnonzero(segments[:, GROUP] >= 0.0)
        start = segments[used, :BRANCH] * cutoff + step.spec.origin
        image, shift, drifts = step.near_mesh(start, (1.0 + longest[3]) * cutoff)
        segments, contacts = segments[used[image]], contacts[used[image]]
        segments[:, :BRANCH] += shift / cutoff
        for drift, here in alike(drifts) if "velocity" in moment.variables and drifts.any() else ():
            on_i, on_j = _carried(step, moment, step.moving(drift))
            moving, _, _ = branches.list_some((rows._replace(on_i=on_i), on_j, *listing[2:]), contacts[here])
            segments[here, FORCE:GROUP] = moving[:, FORCE:GROUP]
    if mesh.too_long(longest[:3]):
        partner = (c.i if second else np.where(c.i >= 0, c.j, c.i))[contacts]
        ends = [points + shift for points in (c.point[contacts], step.position[partner])]
        longest = mesh.cut(segments, np.array(ends), step.source)
    return branches.ListedOnce.of(segments, limits), longest, more


def _rules(step: StepRows, longest: float, cutoff: float) -> list[tuple[str, bool, bool]]:
    """Ways to the weights of segments: numbers, whether in closed form as well, and whether in that alone."""
    if (
        step.spec.grid.half.any()
        or not step.spec.coarse
        or not step.surroundings.meshes[cutoff].fits_single(step.spec.limits.max())
    ):
        return [("float64", True, False)]
    by_points = ("float32", False, False)
    return [by_points] if longest <= step.spec.limits.max() else [by_points, ("float64", True, True)]


def _fill_segments(
    segments: Branches, mesh: Mesh, weights: AnyKernel, reach: Sequence[float], real: str, closed: bool, rest: bool,
    block: NodeBlock, sums: NDArray, _: NDArray,
) -> None:  # fmt: skip
    nodes = mesh.nodes_of(block)
    lists = block.lists(nodes, reach, real)
    scratch = closed_for(lists.values.shape[1]) if closed else None
    for some in segments.near(nodes):
        deposit_segments(some, nodes, weights, lists, scratch, rest, sums)
