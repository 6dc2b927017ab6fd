"""Sums over grains, contacts and walls at the nodes: from a frame to passes of loops, and from these to moments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import points as loops
from xcg.compiled._jit import for_each
from xcg.compiled.reach import BATCH, batches_of
from xcg.fields.passes import Columns, Images, Pass, Squared, StepArrays
from xcg.fields.plan import Plan
from xcg.fields.ring_means import average_over_rings, reference_of_rings
from xcg.fields.segments import along_branches
from xcg.fields.sums.moments import CUTOFF_POWERS, MOMENTS, Moment
from xcg.fields.sums.nodes import DIAMETER, Block, Smoothing, lists_of
from xcg.scene.frame import check_finite
from xcg.scene.lattice import Lattice
from xcg.scene.schema import VARIABLES, Frame


class Sums:
    """Sums of one step, prepared: filled for one block of nodes after the other, in any order or at once.

    A node's sums have one order whatever the block, so that their bits are the same.

    Parameters
    ----------
    plan : Plan
        Requested sums.
    frame : Frame
        One step of a scene.
    lattice : Lattice
        Periodic images.
    scale : float
        1 / extent of the averaged axes (and thickness of a layer).
    source : str
        Names the step in messages.
    threads : int
        Threads that prepare passes.

    Attributes
    ----------
    table : dict
        Where each moment is: which of the arrays of `over`, its columns, and a factor
        for each group.
    """

    def __init__(
        self, plan: Plan, frame: Frame, lattice: Lattice, scale: float, source: str, threads: int
    ) -> None:
        step = StepArrays(frame, plan, lattice, scale, source)
        # variables of scenes were checked with their frame
        of_moments = {name for moment in plan.moments.values() for name in moment.variables}
        for name in of_moments - VARIABLES.keys():
            check_finite(name, step.frame, source)
        kinds: dict[str, dict[str, Moment]] = {kind: {} for kind in _PASSES}
        for name, moment in plan.moments.items():
            kinds[moment.over][name] = moment
        needed = [kind for kind, moments in kinds.items() if moments]
        prepared = for_each(needed, lambda kind: _PASSES[kind](step, kinds[kind]), threads)
        self.plan = plan
        self.passes: list[Pass] = list(chain.from_iterable(prepared))
        self.table: dict[str, tuple[int, NDArray, NDArray]] = {}
        self.table["reference"] = (0, np.arange(3), np.ones(1))
        for number, run in enumerate(self.passes, 1):
            for name, (columns, factor) in run.moments.items():
                self.table[name] = (number, columns, np.broadcast_to(factor, run.groups))

    def over(self, block: Block) -> list[NDArray]:
        """Return the sums at the nodes of a block, an array (groups, nodes, columns) for each pass.

        The first array is the velocity (1, nodes, 3) that the kinematic columns of grains refer to,
        NaN where nothing reaches. Nodes of rings have the averages over the angles.
        """
        velocity = np.full((block.count, 3), np.nan)
        filled: list[NDArray] = []
        references: list[NDArray] = []
        for run in self.passes:
            reference = velocity
            if run.apart:
                reference = np.full_like(velocity, np.nan)
            sums = np.zeros((run.groups, block.count, run.columns))
            for fill in run.fills:
                fill(block, sums, reference)
            filled.append(sums)
            references.append(reference)
        if block.rings is not None:
            for k, run in enumerate(self.passes):
                filled[k] = average_over_rings(run, block.rings, filled[k], references[k])
            velocity, _ = reference_of_rings(block.rings, velocity)
        return [velocity[None], *filled]

    def moments(self, filled: Sequence[NDArray]) -> dict[str, NDArray]:
        """Return moments, arrays (phase, node, ...), from the sums at the nodes of a block.

        Phase 0 is the bulk, the sum over groups. Nodes run fastest in memory, so that algebra on
        small tensors is a loop over nodes.
        """
        groups = self.plan.group_count
        moments: dict[str, NDArray] = {}
        for name, (number, columns, factor) in self.table.items():
            values = filled[number].transpose(2, 0, 1)
            if name == "reference":
                reference = np.where(np.isnan(values[:, 0]), 0.0, values[:, 0])
                moments[name] = np.ascontiguousarray(reference).T
                continue
            part = values[columns] * factor[:, None]
            if part.shape[-2] > groups:  # by phase of the partner
                split = part.reshape(*part.shape[:-2], groups, -1, part.shape[-1])
                part = np.moveaxis(split, -2, 0)
            if self.plan.by is not None:
                # in this order whatever the number of nodes
                bulk = sum(part[..., [k], :] for k in range(groups))
                part = np.concatenate([bulk, part], axis=-2)
            inner = range(part.ndim - 2)
            moments[name] = part.transpose(part.ndim - 2, part.ndim - 1, *inner)
        return moments


def grains(step: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Prepare the pass over grains.

    Kinematic columns come first, then columns of constants that differ between grains, then the number
    of grains.
    """
    images = step.grains
    level = max(moment.level for moment in moments.values())
    table: dict[str, Columns] = {}
    constants: list[Moment | NDArray] = []
    same: dict[str, float] = {}
    width = 0
    for name, moment in moments.items():
        if moment.level:
            factor: float | NDArray = 1.0
            if name in CUTOFF_POWERS:
                factor = step.plan.cutoff_of_group ** CUTOFF_POWERS[name]
            table[name] = (moment.first + moment.columns, factor)
            continue
        columns: Moment | NDArray = moment  # what is wide is made when it is written
        if moment.width == 1:
            columns = step.column(moment, images)
            if _is_constant(columns):
                same[name] = float(columns[0, 0])
                continue
        table[name] = (level + width + moment.columns, 1.0)
        constants.append(columns)
        width += moment.width
    if same:
        number = MOMENTS["number"]
        for name, value in same.items():
            table[name] = (level + width + number.columns, value)
        constants.append(number)
        width += number.width
    run = Pass(step.plan.group_count, level + _in_fours(width), table, level)
    _add_points(step, run, images, step.phase[images.row], flow=step.flow, constants=constants)
    return [run]


def _in_fours(width: int) -> int:
    """Return the next multiple of four: the loop adds four columns at a time."""
    return width + -width % 4


def _is_constant(values: NDArray) -> bool:
    """Return whether a column (n, 1) is the same for all grains, a multiple of their number."""
    if not len(values) or values[0, 0] != values[-1, 0]:  # most differ in their ends
        return False
    return bool((values == values[0]).all())


def slopes(step: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Prepare the pass over grains that weighs kinematic columns by grad Psi."""
    table: dict[str, Columns] = {}
    for name, flow in (("mass_slope", "offset"), ("momentum_slope", "shear")):
        columns = MOMENTS[flow].first + MOMENTS[flow].columns
        table[name] = (columns, -1 / step.plan.cutoff_of_group)
    images = step.grains
    run = Pass(step.plan.group_count, loops.LINEAR, table, loops.LINEAR)
    _add_points(step, run, images, step.phase[images.row], flow=step.flow, by_gradient=True)
    return [run]


def vectors(step: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Prepare a pass for each vector that takes the place of velocity, so that it is kept relative to each node."""
    passes = []
    for name, moment in moments.items():
        if moment.contacts:
            images, phase, share, contact = step.contact_points
            values = step.column(moment, images, contact)
            values[:, 0] *= share
        else:
            images = step.grains
            phase = step.phase[images.row]
            values = step.column(moment, images)
        flow = np.ascontiguousarray(values[:, 1:]), np.ascontiguousarray(values[:, 0])
        table: dict[str, Columns] = {name: (moment.first + moment.columns, 1.0)}
        level = moment.level
        groups = step.plan.group_count
        run = Pass(groups, level, table, level, apart=True, vector=moment.vector)
        _add_points(step, run, images, phase, flow=flow)
        passes.append(run)
    return passes


def at_contacts(step: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Prepare the pass over contact points, with columns of constants alone."""
    images, phase, share, contact = step.contact_points
    table: dict[str, Columns] = {}
    columns: list[Moment | NDArray] = []
    width = 0
    for name, moment in moments.items():
        columns.append(step.column(moment, images, contact) * share[:, None])
        table[name] = (width + moment.columns, 1.0)
        width += moment.width
    run = Pass(step.plan.group_count, _in_fours(width), table)
    _add_points(step, run, images, phase, constants=columns)
    return [run]


def between_phases(step: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Sum the forces of other phases and of walls on the grains of each phase, at the contact points."""
    contacts = step.contacts
    others = step.plan.other_count
    phase = np.append(step.phase, step.plan.group_count)  # row -1 is that of a wall
    points: list[NDArray] = []
    pairs: list[NDArray] = []
    forces: list[NDArray] = []
    sides = [(contacts.i, contacts.j, 1.0), (contacts.j, contacts.i, -1.0)]
    for row, partner, sign in sides:
        # inside a phase both sides add up to nothing
        at = np.flatnonzero((row >= 0) & (phase[row] != phase[partner]))
        points.append(contacts.point[at])
        pairs.append(phase[row[at]] * others + phase[partner[at]])
        forces.append(sign * contacts.force[at])
    images = step.images(np.concatenate(points))
    pair = np.concatenate(pairs)[images.row]
    force = np.concatenate(forces)[images.row]
    return [_of_force(step, images, pair, force, moments, others)]


def at_walls(step: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Sum the forces of walls, at the contact points."""
    row, point, force = step.contacts.at_walls
    images = step.images(point)
    phase = step.phase[row][images.row]
    return [_of_force(step, images, phase, force[images.row], moments)]


def _of_force(
    step: StepArrays,
    images: Images,
    phase: NDArray,
    force: NDArray,
    moments: Mapping[str, Moment],
    others: int = 1,
) -> Pass:
    """Prepare a pass over points with a force each."""
    table: dict[str, Columns] = {name: (moment.columns, 1.0) for name, moment in moments.items()}
    run = Pass(step.plan.group_count * others, _in_fours(3), table)
    _add_points(step, run, images, phase, constants=[force], others=others)
    return run


# What prepares the passes of moments, by what these go over. The thread that calls begins with the
# last: contacts take more memory than grains.
_PASSES: dict[str, Callable[[StepArrays, Mapping[str, Moment]], list[Pass]]] = {
    "grains": grains,
    "vectors": vectors,
    "contacts": at_contacts,
    "pairs": between_phases,
    "branches": along_branches,
    "slopes": slopes,
    "walls": at_walls,
}


def _add_points(
    step: StepArrays,
    run: Pass,
    images: Images,
    phase: NDArray,
    *,
    flow: tuple[NDArray, NDArray] | None = None,
    constants: list[Moment | NDArray] | None = None,
    others: int = 1,
    by_gradient: bool | None = None,
) -> None:
    """Add the loops over grains, or other points, with kinematic columns and columns of constants.

    `flow` are velocities and masses, or numbers and weights in their places. `constants` are columns,
    or moments whose columns are made here; the list is emptied, as memory holds one of them beside
    what is written. With `others`, `phase` is the number of a pair of phases, the first times
    `others` plus the second.
    """
    plan = step.plan
    position = images.position
    count = len(position)
    level = run.level
    written = np.zeros((count, run.columns - level))
    first = 0
    while constants:
        columns = constants.pop(0)
        if isinstance(columns, Moment):
            columns = step.column(columns, images)
        written[:, first : first + columns.shape[1]] = columns
        first += columns.shape[1]
        del columns  # before the next are made
    velocity, mass = flow or (np.zeros((count, 3)), np.zeros(count))
    of_squares = [column for column in loops.SQUARES if column < level]
    has_squares = any(np.isin(columns, of_squares).any() for columns, _ in run.moments.values())
    if not count and not has_squares:
        return
    origin = step.origin
    for cutoff, smoothing in step.smoothings.items():
        rows = images.order
        of_cutoff = np.repeat(plan.cutoff_of_group == cutoff, others)
        if not of_cutoff.all():
            rows = rows[of_cutoff[phase[rows]]]
        batches = (batches_of(position, rows) - origin) / cutoff
        points = loops.Grains(
            rows, batches, position, velocity, mass, written, phase, origin, cutoff
        )
        translations = None
        if has_squares:
            translations = step.translations(cutoff)
            _add_squared(step, run, points, np.flatnonzero(of_cutoff), smoothing)
        flags = level, translations, by_gradient
        run.fills.append(partial(_fill, points, smoothing, flags))


def _add_squared(
    step: StepArrays, run: Pass, points: loops.Grains, groups: NDArray, smoothing: Smoothing
) -> None:
    """Add the grains of the groups of one cutoff to those whose weights are squared."""
    beyond = step.lattice
    if beyond.vectors is not None:  # images are places of their own
        beyond = Lattice(np.full(3, np.inf))
    run.squared.append(Squared(points, beyond, groups, smoothing))


def _fill(
    points: loops.Grains,
    smoothing: Smoothing,
    flags: tuple[int, NDArray | None, bool | None],  # level, translations, by_gradient
    block: Block,
    sums: NDArray,
    reference: NDArray,
) -> None:
    """Add points to the sums at the nodes of a block."""
    nodes = block.nodes(smoothing)
    records = np.empty((BATCH, sums.shape[2] + loops.GRAIN))
    scratch = loops.Scratch(lists_of(nodes, DIAMETER.tolist()), records)
    loops.deposit(points, nodes, smoothing.weights, *flags, scratch, sums, reference)
