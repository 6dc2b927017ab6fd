"""Sums over grains, contacts and walls at the nodes: from a frame to the passes that make them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import points as loops
from xcg.compiled._jit import for_each
from xcg.compiled.reach import BATCH, batches_of
from xcg.fields.sums.moments import CUTOFF_POWERS, MOMENTS, Moment
from xcg.fields.sums.nodes import DIAMETER, Block, Smoothing, lists_of
from xcg.fields.sums.ring_means import average_over_rings, reference_of_rings
from xcg.fields.sums.segments import along_branches
from xcg.fields.sums.step import DepositSpec, Images, Layout, Pass, Squared, StepRows
from xcg.scene.frame import check_finite
from xcg.scene.lattice import Lattice
from xcg.scene.schema import VARIABLES, Frame


def grains(step: StepRows) -> list[Pass]:
    """Prepare the pass over grains.

    Kinematic columns come first, then columns of constants that differ between grains, then the number
    of grains.
    """
    spec = step.spec
    images = step.grains
    moments: dict[str, tuple[NDArray, float | NDArray]] = {}
    differing: dict[str, Moment] = {}
    made: dict[str, NDArray] = {}
    same: dict[str, float] = {}
    width = spec.level
    for name, row in spec.of_grains.items():
        if row.level:
            factor: float | NDArray = 1.0
            if name in CUTOFF_POWERS:
                factor = spec.by_phase ** CUTOFF_POWERS[name]
            moments[name] = (row.first + row.columns, factor)
            continue
        if row.width == 1:
            values = step.column(row, images)
            if _is_constant(values):
                same[name] = float(values[0, 0])
                continue
            made[name] = values
        moments[name] = (width + row.columns, 1.0)
        differing[name] = row
        width += row.width
    if same:
        number = width + MOMENTS["number"].columns
        moments |= {name: (number, value) for name, value in same.items()}
        width += 1

    def columns() -> Iterator[NDArray]:
        """Yield columns of constants; what is wide is made when it is written beside the others."""
        for name, row in differing.items():
            if name in made:
                yield made.pop(name)
            else:
                yield step.column(row, images)
        if same:
            yield np.ones((len(images.position), 1))

    layout = Layout(spec.phases, _in_fours(width), moments, spec.level)
    return [_pass(step, layout, images, *step.flow, step.phase[images.row], columns())]


def _is_constant(values: NDArray) -> bool:
    """Return whether a column (n, 1) is the same for all grains, a multiple of their number."""
    if not len(values) or values[0, 0] != values[-1, 0]:  # most differ in their ends
        return False
    return bool((values == values[0]).all())


def _in_fours(width: int) -> int:
    """Return the next multiple of four: the loop adds four columns at a time."""
    return width + -width % 4


def slopes(step: StepRows) -> list[Pass]:
    """Kinematic columns weighted by grad Psi."""
    spec = step.spec
    images = step.grains
    moments = {}
    for name, flow in (("mass_slope", "offset"), ("momentum_slope", "shear")):
        columns = MOMENTS[flow].first + MOMENTS[flow].columns
        moments[name] = (columns, -1 / spec.by_phase)
    layout = Layout(spec.phases, loops.LINEAR, moments, loops.LINEAR)
    phase = step.phase[images.row]
    return [_pass(step, layout, images, *step.flow, phase, by_gradient=True)]


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
            images = step.grains
            phase = step.phase[images.row]
            values = step.column(row, images)
        weight = np.ascontiguousarray(values[:, 0])
        numbers = np.ascontiguousarray(values[:, 1:])
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
    contacts = step.contacts
    others = step.spec.others
    phase = np.append(step.phase, step.spec.phases)  # row -1 is that of a wall
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
    moment = {"pair_force": MOMENTS["pair_force"]}
    return [_constants(step, moment, images, pair, [force], others)]


def at_walls(step: StepRows) -> list[Pass]:
    """Sum the forces of walls, at the contact points."""
    row, point, force = step.contacts.at_walls
    images = step.images(point)
    phase = step.phase[row][images.row]
    moment = {"traction": MOMENTS["traction"]}
    return [_constants(step, moment, images, phase, [force[images.row]])]


def _constants(
    step: StepRows,
    rows: Mapping[str, Moment],
    images: Images,
    phase: NDArray,
    columns: Sequence[NDArray],
    others: int = 1,
) -> Pass:
    """Prepare places with columns of constants alone, moment after moment."""
    moments = {}
    width = 0
    for name, row in rows.items():
        moments[name] = (width + row.columns, 1.0)
        width += row.width
    layout = Layout(step.spec.phases * others, _in_fours(width), moments)
    count = len(images.position)
    at_rest = np.zeros((count, 3))
    without_mass = np.zeros(count)
    return _pass(step, layout, images, at_rest, without_mass, phase, columns, others)


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
    """Prepare grains, or other points, with their kinematic columns and columns of constants.

    With `others`, `phase` is the number of a pair of phases, the first times `others` plus the
    second.
    """
    spec = step.spec
    position = images.position
    level = layout.level
    columns = np.zeros((len(position), layout.columns - level))
    first = 0
    for values in constants:
        columns[:, first : first + values.shape[1]] = values
        first += values.shape[1]
        del values  # before the next are made
    beyond = step.lattice
    if step.lattice.vectors is not None:  # images are places of their own
        beyond = Lattice(np.full(3, np.inf))
    of_squares = {column for column in loops.SQUARES if column < level}
    of_moments = [numbers.ravel().tolist() for numbers, _ in layout.moments.values()]
    squares = any(not of_squares.isdisjoint(numbers) for numbers in of_moments)
    fill: list[partial[None]] = []
    squared: list[Squared] = []
    if not len(position) and not squares:
        return Pass(layout, fill, squared)
    for cutoff in spec.distinct:
        rows = images.order
        groups = np.arange(layout.groups)
        if len(spec.distinct) > 1:
            of_cutoff = np.repeat(spec.by_phase == cutoff, others)
            groups = np.flatnonzero(of_cutoff)
            rows = rows[of_cutoff[phase[rows]]]
        batches = (batches_of(position, rows) - spec.origin) / cutoff
        grains = loops.Grains(
            rows, batches, position, velocity, mass, columns, phase, spec.origin, cutoff
        )
        smoothing = step.smoothings[cutoff]
        translations = None
        if squares:
            translations = step.translations(cutoff)
        fill.append(partial(_fill, grains, smoothing, (level, translations, by_gradient)))
        if squares:
            squared.append(Squared(grains, beyond, groups, smoothing))
    return Pass(layout, fill, squared)


def _fill(
    grains: loops.Grains,
    smoothing: Smoothing,
    flags: tuple[int, NDArray | None, bool | None],  # level, translations, by_gradient
    block: Block,
    sums: NDArray,
    reference: NDArray,
) -> None:
    nodes = block.nodes(smoothing)
    records = np.empty((BATCH, sums.shape[2] + loops.GRAIN))
    scratch = loops.Scratch(lists_of(nodes, DIAMETER.tolist()), records)
    loops.deposit(grains, nodes, smoothing.weights, *flags, scratch, sums, reference)


@dataclass(frozen=True, eq=False)
class BlockSums:
    """Sums at the nodes of one block, each pass (groups, nodes, columns).

    `velocity` (nodes, 3) is what the main pass refers to; NaN where nothing reaches.
    """

    of: Sums
    filled: Sequence[NDArray]
    velocity: NDArray

    @property
    def moments(self) -> dict[str, NDArray]:
        """Moments at the nodes: arrays (phase, node, ...).

        Phase 0 is the bulk, the sum over groups. Nodes run fastest in memory, so that algebra on
        small tensors is a loop over nodes.
        """
        reference = np.where(np.isnan(self.velocity), 0.0, self.velocity)
        moments = {"reference": np.ascontiguousarray(reference.T).T}
        nodes = len(reference)
        phases = self.of.spec.phases
        for run, sums in zip(self.of.passes, self.filled, strict=True):
            for name, part in run.layout.turned(sums):
                if part.shape[-2] > phases:  # by phase of the partner
                    part = np.moveaxis(part.reshape(*part.shape[:-2], phases, -1, nodes), -2, 0)
                if self.of.spec.by is not None:
                    # in this order whatever the number of nodes
                    bulk = sum(part[..., [k], :] for k in range(phases))
                    part = np.concatenate([bulk, part], axis=-2)
                inner = range(part.ndim - 2)
                moments[name] = part.transpose(part.ndim - 2, part.ndim - 1, *inner)
        return moments


@dataclass(frozen=True, eq=False)
class Sums:
    """The sums of one frame, prepared: computed for one block of nodes after the other, in any order or at once.

    A node's sums have one order whatever the block, so that their bits are the same.
    """

    spec: DepositSpec
    passes: Sequence[Pass]

    def over(self, block: Block) -> BlockSums:
        """Compute the sums at the nodes of a block; of rings, their averages over the angles."""
        velocity = np.full((block.count, 3), np.nan)
        filled: list[NDArray] = []
        references: list[NDArray] = []
        for run in self.passes:
            reference = velocity
            if run.layout.apart:
                reference = np.full_like(velocity, np.nan)
            sums = np.zeros((run.layout.groups, block.count, run.layout.columns))
            for fill in run.fill:
                fill(block, sums, reference)
            filled.append(sums)
            references.append(reference)
        if block.rings is not None:
            for k, run in enumerate(self.passes):
                filled[k] = average_over_rings(run, block.rings, filled[k], references[k])
            velocity, _ = reference_of_rings(block.rings, velocity)
        return BlockSums(self, filled, velocity)


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
    moments = spec.rows.values()
    names = spec.rows.keys()
    # variables of scenes were checked with their frame
    of_scene = {name for row in moments for name in row.variables} - VARIABLES.keys()
    for name in of_scene:
        check_finite(name, step.frame, source)
    # the calling thread begins with the last: contacts take more memory than grains
    needed = {
        grains: bool(spec.of_grains),
        relative: any(row.level and row.column for row in moments),
        at_contacts: any(row.at_contacts and not row.level for row in moments),
        between_phases: "pair_force" in names,
        along_branches: any(row.along_branches for row in moments),
        slopes: "mass_slope" in names or "momentum_slope" in names,
        at_walls: "traction" in names,
    }
    prepare = [make for make, is_needed in needed.items() if is_needed]
    prepared = for_each(prepare, lambda make: make(step), threads)
    return Sums(spec, list(chain.from_iterable(prepared)))
