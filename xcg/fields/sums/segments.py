"""Passes over segments: branches of contacts, with the force, or what is in its place, that each carries."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.compiled.reach import batches_of
from xcg.compiled.segments import (
    BRANCH,
    FORCE,
    GROUP,
    SEGMENT,
    ContactRows,
    Segments,
    closed_for,
    deposit_segments,
    list_segments,
)
from xcg.fields.sums.blocks import NodeBlock
from xcg.fields.sums.moments import Moment
from xcg.fields.sums.passes import AnyKernel, Fill, Layout, Pass
from xcg.fields.sums.reach import Mesh
from xcg.fields.sums.step import Step, alike
from xcg.scene.schema import Frame


def along_branches(step: Step) -> list[Pass]:
    """Sum what contacts carry, along their branches."""
    assert step.contacts is not None
    order = step.in_space(step.position) if step.grains.row is not None else step.grains.order
    rank = np.empty_like(order)
    rank[order] = np.arange(step.count)
    place = step.contacts.places(rank)
    return [_branches(step, name, row, place) for name, row in step.spec.rows.items() if row.along_branches]


def _branches(step: Step, name: str, row: Moment, place: NDArray) -> Pass:
    """Branches of the contacts in the order that `place` says, each with its force or what is in its place."""
    spec, around = step.spec, step.surroundings
    others, carried = spec.others if row.paired else 0, _carried(step, row, step.frame)
    fill: list[Fill] = []
    for cutoff in spec.distinct:
        mesh = around.meshes[cutoff]
        for second in (False, True):
            segments, longest, more = _segments(step, row, *carried, place, second, others, cutoff)
            reach = mesh.reach + longest[:3]
            mesh.check_reach(reach, step.source)
            batches = batches_of(segments)
            batches += np.array([[-1.0], [1.0]]) * longest[:3]
            for real, closed, rest in _rules(step, longest[3], cutoff):
                way = Segments(segments, spec.limits, batches), mesh, around.kernels[cutoff]
                fill.append(partial(_fill_segments, *way, reach.tolist(), real, closed, rest))
            if not more:
                break
    groups = spec.phases * max(others, 1)
    new = partial(Layout, groups, 9, {name: (row.columns, 1.0)})
    return Pass(spec.layouts.or_new(("branches", name), new), fill)


def _carried(step: Step, row: Moment, frame: Frame) -> tuple[NDArray, NDArray | None]:
    """Vectors (n, 3) that the sides of i and of j carry; None where those of j are the opposite."""
    assert step.contacts is not None
    if row.column is None:
        return step.contacts.force, None
    on_i, on_j = row.column(frame, step.contacts)
    return on_i, on_j


def _segments(
    step: Step, moment: Moment, on_i: NDArray, on_j: NDArray | None, place: NDArray, second: bool, others: int,
    cutoff: float,
) -> tuple[NDArray, NDArray, bool]:  # fmt: skip
    """Segments of the first or second particles of the contacts, the longest, and whether there are second ones."""
    c = step.contacts
    assert c is not None
    segments, longest = np.empty((len(place), SEGMENT)), np.empty(4)
    rows = ContactRows(c.i, c.j, c.point, on_i, step.position, step.phase, *c.periods)
    more = list_segments(
        rows, on_j, second, place, others, step.spec.by_phase, cutoff, step.spec.origin, segments, longest
    )
    mesh = step.surroundings.meshes[cutoff]
    mesh.check_far(longest[:3], step.source)
    row: Any = slice(None)
    shift = np.zeros(3)
    if step.lattice.vectors is not None:
        start = segments[:, :BRANCH] * cutoff + step.spec.origin
        row, shift, drifts = step.near_mesh(start, (1.0 + longest[3]) * cutoff)
        segments = segments[row]
        segments[:, :BRANCH] += shift / cutoff
        for drift, here in alike(drifts) if "velocity" in moment.variables and drifts.any() else ():
            on_i, on_j = _carried(step, moment, step.moving(drift))
            moving, _ = np.empty((len(place), SEGMENT)), np.empty(4)
            rows = rows._replace(on_i=on_i)
            list_segments(rows, on_j, second, place, others, step.spec.by_phase, cutoff, step.spec.origin, moving, _)
            segments[here, FORCE:GROUP] = moving[row[here], FORCE:GROUP]
    if mesh.too_long(longest[:3]):
        contact = np.argsort(place)
        partner = (c.i if second else np.where(c.i >= 0, c.j, c.i))[contact]
        ends = [points[row] + shift for points in (c.point[contact], step.position[partner])]
        longest = mesh.cut(segments, np.array(ends), step.source)
    return segments, longest, more


def _rules(step: Step, longest: float, cutoff: float) -> list[tuple[str, bool, bool]]:
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
    segments: Segments, mesh: Mesh, weights: AnyKernel, reach: Sequence[float], real: str, closed: bool, rest: bool,
    block: NodeBlock, sums: NDArray, _: NDArray,
) -> None:  # fmt: skip
    taken = mesh.nodes_of(block)
    lists = block.lists(taken, reach, real)
    scratch = closed_for(lists.values.shape[1]) if closed else None
    deposit_segments(segments, *taken, weights, lists, scratch, rest, sums)
