"""Passes over points: grains, contact points and walls, with what each gives to the nodes that it reaches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import points as kernel
from xcg.compiled.reach import BATCH, batches_of
from xcg.fields.sums.blocks import NodeBlock
from xcg.fields.sums.moments import CUTOFF_POWERS, MOMENTS
from xcg.fields.sums.passes import AnyKernel, Pass, Squared
from xcg.fields.sums.reach import Mesh
from xcg.fields.sums.step import Images, Step
from xcg.scene.lattice import Lattice


def grains(step: Step) -> list[Pass]:
    """Flow columns and columns of constants."""
    wanted = step.spec.of_grains
    constants = {name: step.column(row, step.grains) for name, row in wanted.items() if row.column}
    count = len(step.grains.position)
    # a column that is the same for all grains, as those of one size are, is a multiple of their number
    same = {name: float(q[0, 0]) for name, q in constants.items() if count and q.shape[1] == 1 and (q == q[0]).all()}
    constants = {name: q for name, q in constants.items() if name not in same}
    if same:
        constants["number"] = np.ones((count, 1))
    level, moments = step.spec.level, dict[str, tuple[NDArray, float | NDArray]]()
    for name, row in wanted.items():
        if row.level:
            power = CUTOFF_POWERS.get(name, 0)
            moments[name] = (row.first + row.columns, step.cutoffs**power if power else 1.0)
    first = level
    for name, values in constants.items():
        moments[name] = (first + (wanted.get(name) or MOMENTS[name]).columns, 1.0)
        first += values.shape[1]
    for name, value in same.items():
        moments[name] = (moments["number"][0], value)
    columns = list(constants.values())
    return [_points(step, moments, step.grains, *step.flow, columns, level, step.grains.of(step.phase))]


def slopes(step: Step) -> list[Pass]:
    """Flow columns weighted by grad Psi."""
    moments = {
        name: (MOMENTS[flow].first + MOMENTS[flow].columns, -1 / step.cutoffs)
        for name, flow in (("mass_slope", "offset"), ("momentum_slope", "shear"))
    }
    phase = step.grains.of(step.phase)
    return [_points(step, moments, step.grains, *step.flow, [], kernel.LINEAR, phase, by_gradient=True)]


def relative(step: Step) -> list[Pass]:
    """Numbers in the place of velocity, so that they are kept relative to each node: a pass for each three."""
    passes = []
    for name, row in step.spec.rows.items():
        if not (row.level and row.column):
            continue
        if row.at_contacts:
            images, phase, share, contact = step.contact_points
            values = step.column(row, images, contact)
            values[:, 0] *= share
        else:
            images, phase = step.grains, step.grains.of(step.phase)
            values = step.column(row, images)
        weight, numbers = np.ascontiguousarray(values[:, 0]), np.ascontiguousarray(values[:, 1:])
        moments = {name: (row.first + row.columns, 1.0)}
        passes.append(
            _points(step, moments, images, numbers, weight, [], row.level, phase, apart=True, vector=row.vector)
        )
    return passes


def at_contacts(step: Step) -> list[Pass]:
    """Columns of constants at the contact points."""
    rows = {name: row for name, row in step.spec.rows.items() if row.at_contacts and not row.level}
    images, phase, share, contact = step.contact_points
    moments, columns, first = {}, [], 0
    for name, row in rows.items():
        columns.append(step.column(row, images, contact) * share[:, None])
        moments[name] = (first + row.columns, 1.0)
        first += columns[-1].shape[1]
    none = np.zeros((len(share), 3))
    return [_points(step, moments, images, none, share, columns, kernel.NONE, phase)]


def between_phases(step: Step) -> list[Pass]:
    """Sum the forces of other phases and of walls on the grains of each phase, at the contact points."""
    c = step.contacts
    assert c is not None
    phase = np.append(step.phase, step.phases)  # row -1 is that of a wall
    sides = []
    for row, partner, sign in ((c.i, c.j, 1.0), (c.j, c.i, -1.0)):
        # inside a phase both sides add up to nothing
        at = np.flatnonzero((row >= 0) & (phase[row] != phase[partner]))
        sides.append((c.point[at], phase[row[at]] * step.others + phase[partner[at]], sign * c.force[at]))
    point, pair, force = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    moments = {"pair_force": (MOMENTS["pair_force"].columns, 1.0)}
    images = step.images(point)
    none, force, pair = np.zeros((len(images.position), 3)), images.of(force), images.of(pair)
    return [_points(step, moments, images, none, none[:, 0], [force], kernel.NONE, pair, others=step.others)]


def at_walls(step: Step) -> list[Pass]:
    """Sum the forces of walls, at the contact points."""
    assert step.contacts is not None
    at, point, force = step.contacts.at_walls
    moments = {"traction": (MOMENTS["traction"].columns, 1.0)}
    images = step.images(point)
    none = np.zeros((len(images.position), 3))
    phase = images.of(step.phase[at])
    return [_points(step, moments, images, none, none[:, 0], [images.of(force)], kernel.NONE, phase)]


def _points(
    step: Step, moments: Mapping[str, tuple[NDArray, float | NDArray]], images: Images, velocity: NDArray,
    mass: NDArray, constants: Sequence[NDArray], level: int, phase: NDArray,
    *, by_gradient: bool | None = None, apart: bool = False, others: int = 1,
    vector: bool = True,
) -> Pass:  # fmt: skip
    """Prepare grains, or other points, with their flow columns up to `level` and columns of constants.

    With `others`, `phase` is the number of a pair of phases, the first times `others` plus the second.
    """
    position, order = images.position, images.order
    columns = _side_by_side(constants, len(position))
    # where nothing moves, columns with u are zero without adding them
    still = True if level and (velocity == velocity[:1]).all() else None
    kept = {column for column in kernel.SQUARES if column < level}
    squares = not all(kept.isdisjoint(columns.ravel().tolist()) for columns, _ in moments.values())
    cubes = True if level == kernel.CUBIC else None
    fill, squared, cutoffs = [], [], np.repeat(step.cutoffs, others)
    beyond = step.lattice if images.row is None else Lattice(np.full(3, np.inf))
    for cutoff in step.distinct if len(position) or squares else ():
        rows = order if (cutoffs == cutoff).all() else order[cutoffs[phase[order]] == cutoff]
        mesh, meet = step.mesh(cutoff), None
        if squares:
            both_seen = 2.0 + 2.0 * float(np.linalg.norm(mesh.half))
            meet = step.lattice.scaled(cutoff).translations(both_seen, step.source)
            meet = meet if len(meet) else None
        batches = (batches_of(position, rows) - step.origin) / cutoff
        flow = (velocity, mass, columns, phase)
        grains = kernel.Grains(rows, batches, position, *flow, step.origin, cutoff)
        flags = (level, still, meet, by_gradient, cubes)
        fill.append(partial(_fill_points, grains, mesh, step.kernel(cutoff), flags))
        if squares:
            groups, weights = np.flatnonzero(cutoffs == cutoff), step.kernel(cutoff)
            squared.append(Squared(rows, position, mass, phase, beyond, groups, cutoff, weights, step.active))
    count, width = step.phases * others, level + columns.shape[1]
    return Pass(count, width, fill, moments, apart, level, vector, squared)


def _side_by_side(parts: Sequence[NDArray], count: int) -> NDArray:
    """Columns (count, ...) side by side, and zeros up to a multiple of four, as the loop adds four at a time."""
    width = sum(values.shape[1] for values in parts)
    out, first = np.zeros((count, width + -width % 4)), 0
    for values in parts:
        out[:, first : first + values.shape[1]] = values
        first += values.shape[1]
    return out


def _fill_points(
    grains: kernel.Grains, mesh: Mesh, weights: AnyKernel, flags: tuple[int, *tuple[bool | NDArray | None, ...]],
    block: NodeBlock, sums: NDArray, reference: NDArray,
) -> None:  # fmt: skip
    taken = mesh.nodes_of(block)
    records = np.empty((BATCH, sums.shape[2] + kernel.GRAIN))
    kernel.deposit(grains, *taken, weights, *flags, records, block.lists(taken, mesh.reach.tolist()), sums, reference)
