"""Sums over grains, contacts and walls at the nodes: from a frame to the passes that make them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import points as loops
from xcg.compiled._jit import for_each
from xcg.compiled.reach import BATCH, batches_of
from xcg.fields.sums.moments import CUTOFF_POWERS, MOMENTS, Moment
from xcg.fields.sums.nodes import Mesh, NodeBlock
from xcg.fields.sums.segments import along_branches
from xcg.fields.sums.step import AnyKernel, DepositSpec, Images, Layout, Pass, Squared, StepRows
from xcg.scene.frame import check_finite
from xcg.scene.lattice import Lattice
from xcg.scene.schema import VARIABLES, Frame


def grains(step: StepRows) -> list[Pass]:
    """Flow columns come first, then columns of constants that differ between grains, then the number of grains."""
    spec, at, single, rest = step.spec, step.grains, dict[str, NDArray](), dict[str, Moment]()
    moments, same, first = (
        dict[str, tuple[NDArray, float | NDArray]](),
        dict[str, float](),
        spec.level,
    )
    for name, row in spec.of_grains.items():
        if row.level:
            power = CUTOFF_POWERS.get(name, 0)
            moments[name] = (row.first + row.columns, spec.by_phase**power if power else 1.0)
            continue
        if row.width == 1:
            single[name] = values = step.column(row, at)
            # a column that is the same for all grains, as those of one size are, is a multiple of their number; most
            # differ in their ends
            if len(values) and values[0, 0] == values[-1, 0] and (values == values[0]).all():
                same[name] = float(single.pop(name)[0, 0])
                continue
        moments[name], rest[name] = (first + row.columns, 1.0), row
        first += row.width
    number = first + MOMENTS["number"].columns
    moments |= {name: (number, value) for name, value in same.items()}
    layout = Layout(
        spec.phases, -(-(first + bool(same)) // 4) * 4, moments, spec.level
    )  # the loop adds four at a time
    # what is wide is made when it is written beside the others
    columns = (
        single.pop(name) if name in single else step.column(row, at) for name, row in rest.items()
    )
    ones = [np.ones((len(at.position), 1))] if same else []
    return [_pass(step, layout, at, *step.flow, step.phase[at.row], chain(columns, ones))]


def slopes(step: StepRows) -> list[Pass]:
    """Flow columns weighted by grad Psi."""
    spec = step.spec
    moments = {
        name: (MOMENTS[flow].first + MOMENTS[flow].columns, -1 / spec.by_phase)
        for name, flow in (("mass_slope", "offset"), ("momentum_slope", "shear"))
    }
    layout = Layout(spec.phases, loops.LINEAR, moments, loops.LINEAR)
    return [
        _pass(step, layout, step.grains, *step.flow, step.phase[step.grains.row], by_gradient=True)
    ]


def relative(step: StepRows) -> list[Pass]:
    """Prepare a pass for each vector that takes the place of velocity, so that it is kept relative to each node."""
    passes = []
    for name, row in step.spec.rows.items():
        if not (row.level and row.column):
            continue
        if row.at_contacts:
            images, phase, share, contact = step.contact_points
            values = step.column(row, images, contact)
            values[:, 0] *= share
        else:
            images, phase = step.grains, step.phase[step.grains.row]
            values = step.column(row, images)
        weight, numbers = np.ascontiguousarray(values[:, 0]), np.ascontiguousarray(values[:, 1:])
        moments = {name: (row.first + row.columns, 1.0)}
        layout = Layout(
            step.spec.phases, row.level, moments, row.level, apart=True, vector=row.vector
        )
        passes.append(_pass(step, layout, images, numbers, weight, phase))
    return passes


def at_contacts(step: StepRows) -> list[Pass]:
    """Columns of constants at the contact points."""
    rows = {name: row for name, row in step.spec.rows.items() if row.at_contacts and not row.level}
    images, phase, share, contact = step.contact_points
    columns = [step.column(row, images, contact) * share[:, None] for row in rows.values()]
    return [_constants(step, rows, images, phase, columns)]


def between_phases(step: StepRows) -> list[Pass]:
    """Sum the forces of other phases and of walls on the grains of each phase, at the contact points."""
    c = step.contacts
    phase, others = (
        np.append(step.phase, step.spec.phases),
        step.spec.others,
    )  # row -1 is that of a wall
    sides = []
    for row, partner, sign in ((c.i, c.j, 1.0), (c.j, c.i, -1.0)):
        # inside a phase both sides add up to nothing
        at = np.flatnonzero((row >= 0) & (phase[row] != phase[partner]))
        sides.append(
            (c.point[at], phase[row[at]] * others + phase[partner[at]], sign * c.force[at])
        )
    point, pair, force = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    images, moment = step.images(point), {"pair_force": MOMENTS["pair_force"]}
    return [_constants(step, moment, images, pair[images.row], [force[images.row]], others)]


def at_walls(step: StepRows) -> list[Pass]:
    """Sum the forces of walls, at the contact points."""
    at, point, force = step.contacts.at_walls
    images, moment = step.images(point), {"traction": MOMENTS["traction"]}
    return [_constants(step, moment, images, step.phase[at][images.row], [force[images.row]])]


def _constants(
    step: StepRows,
    rows: Mapping[str, Moment],
    images: Images,
    phase: NDArray,
    columns: Sequence[NDArray],
    others: int = 1,
) -> Pass:
    """Prepare places with columns of constants alone, moment after moment."""
    firsts = np.cumsum([0, *(row.width for row in rows.values())]).tolist()
    moments = {
        name: (first + row.columns, 1.0)
        for first, (name, row) in zip(firsts, rows.items(), strict=False)
    }
    layout, count = (
        Layout(step.spec.phases * others, -(-firsts[-1] // 4) * 4, moments),
        len(images.position),
    )
    return _pass(
        step, layout, images, np.zeros((count, 3)), np.zeros(count), phase, columns, others
    )


def _pass(
    step: StepRows,
    layout: Layout,
    images: Images,
    velocity: NDArray,
    mass: NDArray,
    phase: NDArray,
    constants: Iterable[NDArray] = (),
    others: int = 1,
    *,
    by_gradient: bool | None = None,
) -> Pass:
    """Prepare grains, or other points, with their flow columns and columns of constants.

    With `others`, `phase` is the number of a pair of phases, the first times `others` plus the second.
    """
    spec, position, level = step.spec, images.position, layout.level
    columns, first = np.zeros((len(position), layout.columns - level)), 0
    for values in constants:
        columns[:, first : first + values.shape[1]] = values
        first += values.shape[1]
        del values  # before the next are made
    beyond = step.lattice if step.lattice.vectors is None else Lattice(np.full(3, np.inf))
    fill, squared = [], []
    kept = {column for column in loops.SQUARES if column < level}
    squares = any(
        not kept.isdisjoint(columns.ravel().tolist()) for columns, _ in layout.moments.values()
    )
    for cutoff in spec.distinct if len(position) or squares else ():
        rows, groups = images.order, None
        if len(spec.distinct) > 1:
            groups = np.repeat(spec.by_phase == cutoff, others)
            rows = rows[groups[phase[rows]]]
        meet = step.translations(cutoff) if squares else None
        batches = (batches_of(position, rows) - spec.origin) / cutoff
        grains = loops.Grains(
            rows, batches, position, velocity, mass, columns, phase, spec.origin, cutoff
        )
        mesh, weights = step.meshes[cutoff], step.kernels[cutoff]
        fill.append(partial(_fill, grains, mesh, weights, (level, meet, by_gradient)))
        if squares:
            of = np.arange(layout.groups) if groups is None else np.flatnonzero(groups)
            squared.append(Squared(grains, beyond, of, weights, spec.grid))
    return Pass(layout, fill, squared)


def _fill(
    grains: loops.Grains,
    mesh: Mesh,
    weights: AnyKernel,
    flags: tuple[int, NDArray | None, bool | None],
    block: NodeBlock,
    sums: NDArray,
    reference: NDArray,
) -> None:
    nodes = block.nodes(mesh.origin, mesh.cutoff, mesh.active, mesh.period)
    records = np.empty((BATCH, sums.shape[2] + loops.GRAIN))
    scratch = loops.Scratch(block.lists(nodes, mesh.reach.tolist()), records)
    loops.deposit(grains, nodes, weights, *flags, scratch, sums, reference)


@dataclass(frozen=True, eq=False)
class BlockSums:
    """Sums at the nodes of one block, each pass (groups, nodes, columns), and what they refer to.

    `velocity` (nodes, 3) is what the main pass refers to, `references` what each does; NaN where nothing reaches.
    """

    of: Sums
    filled: Sequence[NDArray]
    velocity: NDArray
    references: Sequence[NDArray]

    @property
    def moments(self) -> dict[str, NDArray]:
        """Moments at the nodes: arrays (phase, node, ...).

        Phase 0 is the bulk, the sum over groups. Nodes run fastest in memory, so that algebra on small tensors is a
        loop over nodes.
        """
        reference = np.where(np.isnan(self.velocity), 0.0, self.velocity)
        found = {"reference": np.ascontiguousarray(reference.T).T}
        nodes, phases = len(reference), self.of.spec.phases
        turned = (
            run.layout.turned(sums) for run, sums in zip(self.of.passes, self.filled, strict=True)
        )
        for name, part in chain.from_iterable(turned):
            if part.shape[-2] > phases:  # by phase of the partner
                part = np.moveaxis(part.reshape(*part.shape[:-2], phases, -1, nodes), -2, 0)
            if self.of.spec.by is not None:
                bulk = sum(
                    part[..., [k], :] for k in range(phases)
                )  # in this order whatever the number of nodes
                part = np.concatenate([bulk, part], axis=-2)
            found[name] = part.transpose(part.ndim - 2, part.ndim - 1, *range(part.ndim - 2))
        return found


@dataclass(frozen=True, eq=False)
class Sums:
    """The sums of one frame, prepared: computed for one block of nodes after the other, in any order or at once.

    A node's sums have one order whatever the block, so that their bits are the same.
    """

    spec: DepositSpec
    passes: Sequence[Pass]

    def over(self, block: Any) -> BlockSums:
        """Compute the sums at the nodes of a `Block`: they are filled, or averages of its `inner` nodes that are."""
        nodes: NodeBlock = block.inner or block
        velocity = np.full((nodes.count, 3), np.nan)
        filled, references = [], []
        for run in self.passes:
            references.append(np.full_like(velocity, np.nan) if run.layout.apart else velocity)
            filled.append(np.zeros((run.layout.groups, nodes.count, run.layout.columns)))
            for fill in run.fill:
                fill(nodes, filled[-1], references[-1])
        found = BlockSums(self, filled, velocity, references)
        return block.averages(found) if block.inner else found


def sums_of_frame(
    frame: Frame, spec: DepositSpec, lattice: Lattice, scale: float, source: str, threads: int
) -> Sums:
    """Prepare the sums of one frame.

    Parameters
    ----------
    frame : Frame
        One step of a scene.
    spec : DepositSpec
        Requested sums.
    lattice : Lattice
        Periodic images.
    scale : float
        1 / extent of the averaged axes (and thickness of a layer).
    source : str
        Names the step in messages.
    threads : int
        Threads that prepare passes.
    """
    step = StepRows(frame, spec, lattice, scale, source)
    rows = spec.rows
    for name in {name for row in rows.values() for name in row.variables} - VARIABLES.keys():
        check_finite(name, step.frame, source)  # variables of scenes were checked with their frame
    ways = [  # the calling thread begins with the last: contacts take more memory than grains
        (grains, spec.of_grains),
        (relative, {name for name, row in rows.items() if row.level and row.column}),
        (at_contacts, {name for name, row in rows.items() if row.at_contacts and not row.level}),
        (between_phases, rows.keys() & {"pair_force"}),
        (along_branches, {name for name, row in rows.items() if row.along_branches}),
        (slopes, rows.keys() & {"mass_slope", "momentum_slope"}),
        (at_walls, rows.keys() & {"traction"}),
    ]
    prepared = for_each([way for way, moments in ways if moments], lambda way: way(step), threads)
    return Sums(spec, [one for passes in prepared for one in passes])
