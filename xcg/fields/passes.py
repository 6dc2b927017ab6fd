"""Single step as its passes take it: rows and their images, nodes and kernels; and passes over points."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from xcg.common.messages import warn_once
from xcg.compiled import points as loops
from xcg.compiled.cells import lists_of
from xcg.compiled.reach import BATCH, batches_of, spatial_order
from xcg.fields.plan import Plan
from xcg.fields.sums.moments import (
    CUTOFF_POWERS,
    MOMENTS,
    WALL_VELOCITY,
    Moment,
    velocities_of_walls,
)
from xcg.fields.sums.nodes import DIAMETER, Block, Smoothing, triple
from xcg.scene.contacts import Contacts
from xcg.scene.frame import entries_of, phase_of, without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.schema import Frame

# columns of the components of a moment (a symmetric tensor names six of them nine times), and a
# factor, or one for each group
Columns: TypeAlias = tuple[NDArray, float | NDArray]
# adds one pass to the sums (groups, nodes, columns) at the nodes of a block; the last array is the
# reference velocity
Fill: TypeAlias = Callable[[Block, NDArray, NDArray], None]


@dataclass(frozen=True, eq=False)
class Squared:
    """Grains of one cutoff whose squared weights are summed.

    Attributes
    ----------
    grains : Grains
        Places, weights and groups, and which of the places they are.
    lattice : Lattice
        Periodic images beyond these places.
    groups : array
        Groups of this cutoff.
    smoothing : Smoothing
        The kernel of this cutoff.
    """

    grains: loops.Grains
    lattice: Lattice
    groups: NDArray
    smoothing: Smoothing

    @cached_property
    def images(self) -> tuple[NDArray, NDArray]:
        """Rows (k,) and places (k, 3) of the grains, with their periodic images within reach of the nodes."""
        rows = self.grains.order
        position = self.grains.position[rows]
        if not len(self.lattice.basis):
            return rows, position
        row, shift, _ = self.lattice.images(
            position, *self.smoothing.nodes.around(self.grains.cutoff)
        )
        return rows[row], position[row] + shift


@dataclass(frozen=True, eq=False)
class Pass:
    """Prepared pass over grains, points or segments, whose sums are an array (groups, nodes, columns).

    Attributes
    ----------
    groups, columns : int
    moments : mapping
        Columns of each moment, and factors.
    level : int
        How many columns are kinematic columns; they are the first ones.
    apart : bool
        Whether it has a reference of its own.
    vector : bool
        Whether the numbers in the place of velocity are the components of a vector.
    fills : list of Fill
        Loops that add to the sums, for one cutoff each.
    squared : list of Squared
        Grains whose weights are squared.
    """

    groups: int
    columns: int
    moments: Mapping[str, Columns]
    level: int = loops.NONE
    apart: bool = False
    vector: bool = True
    fills: list[Fill] = field(default_factory=list)
    squared: list[Squared] = field(default_factory=list)


_HIDDEN_SHEAR = (
    "the box is sheared across an axis that is averaged, and {names} take velocities at contacts as they are written, "
    "so that they depend on how grains are wrapped; resolve that axis"
)
_AT_ONE_PLACE = "taken_up"  # relative velocities, which are those of the images that touch


@dataclass(frozen=True, eq=False)
class Images:
    """Positions of rows of the data.

    Periodic images along axes are found node by node. In boxes that are tilted, or whose images
    move, each image is a place of its own.

    Attributes
    ----------
    position : array (m, 3)
    order : array (m,)
        Their order in space.
    row : array (m,) or slice
        Row of each; all where each row is one place.
    drift : array (m, 3) or None
        How fast each moves relative to the row's velocity (m/s); None where none does.
    """

    position: NDArray
    order: NDArray
    row: NDArray | slice
    drift: NDArray | None = None


class StepArrays:
    """Single frame, the plan, and arrays that several passes share.

    Attributes
    ----------
    frame : Frame
        Variables of the step, without frozen grains.
    plan : Plan
    position, velocity, phase : array (n, 3), (n, 3), (n,)
    contacts : Contacts, optional
    lattice : Lattice
        Periodic images, as seen along the axes of the nodes.
    origin : tuple of float
        The place that loops take others relative to (m).
    smoothings : dict
        The kernel by cutoff (m), which rises, times `scale`, which divides by the extent of averaged axes.
    grains : Images
    flow : tuple of array (m, 3) and (m,)
        Velocity and mass of these.

    Raises
    ------
    SceneError
        If the box is too small, or has no images as seen along some axes.
    """

    def __init__(
        self, frame: Frame, plan: Plan, lattice: Lattice, scale: float, source: str
    ) -> None:
        self.frame = without_frozen(frame)
        if not len(self.frame["position"]):
            # nor contacts of theirs
            frame = self.frame = entries_of(self.frame, slice(0))
        self.plan = plan
        self.source = source
        self.position = self.frame["position"]
        self.phase = phase_of(self.frame, plan.by, plan.groups, source)
        self.contacts = cast(Contacts, None)  # no moment takes them
        if "contact_i" in self.frame:
            self._take_contacts(frame, lattice)
        self.origin = triple(plan.nodes.origin)
        self.lattice = lattice.seen(plan.nodes.active, source)
        self.smoothings = self._smoothings(scale)
        self.velocity = self.frame.get("velocity", np.zeros_like(self.position))
        self.of_grains = self.frame
        if lattice.rates is not None:
            self._take_off_shear(lattice)
        self.grains = self.images(self.position)
        row = self.grains.row
        velocity = self.velocity[row]
        if self.grains.drift is not None:
            velocity = velocity + self.grains.drift
        mass = self.frame.get("mass", np.ones(len(self.position)))
        self.flow = (np.ascontiguousarray(velocity), np.ascontiguousarray(mass[row]))

    def _smoothings(self, scale: float) -> dict[float, Smoothing]:
        """Return the kernel of each cutoff, whose weights are multiplied by `scale`; cutoffs rise."""
        plan = self.plan
        is_paired = any(name.startswith("square") for name in plan.moments)
        smoothings = {}
        for cutoff in sorted({*plan.cutoffs}):
            share = (plan.cutoffs[0] / cutoff) ** len(plan.nodes.active_axes)
            weights = plan.weights._replace(norm=plan.weights.norm * share * scale)
            smoothing = Smoothing(plan.nodes, self.lattice.period, cutoff, weights)
            smoothing.check_reach(DIAMETER, self.source, paired=is_paired)
            smoothings[cutoff] = smoothing
        return smoothings

    def _take_contacts(self, frame: Frame, lattice: Lattice) -> None:
        """Find the contacts of the step, and the velocities of walls that are frozen grains of its `frame`."""
        self.contacts = Contacts.of(self.frame, lattice, self.source)
        moving = any(WALL_VELOCITY in moment.optional for moment in self.plan.moments.values())
        if moving and "frozen" in frame:
            self.frame[WALL_VELOCITY] = velocities_of_walls(frame, self.contacts, self.source)

    def _take_off_shear(self, lattice: Lattice) -> None:
        """Make velocities relative to the motion that a sheared box imposes along averaged axes.

        They are those in the middle of the box, for every image of a grain, as images along these
        axes are one.
        """
        gradient = lattice.gradient_along(~self.plan.nodes.active)
        if gradient is None:
            return
        moments = self.plan.moments.items()
        of_velocity = {n for n, moment in moments if "velocity" in moment.variables}
        of_contacts = [n for n, moment in moments if moment.contacts]
        names = [n for n in of_contacts if n in of_velocity - {_AT_ONE_PLACE}]
        if names:
            text = _HIDDEN_SHEAR.format(names=", ".join(names))
            warn_once("hidden shear", f"{self.source}: {text}")
        self.velocity = self.velocity - (self.position - lattice.middle) @ gradient.T
        of_box = np.broadcast_to(gradient, (len(self.position), 3, 3))
        self.of_grains = {**self.frame, "velocity": self.velocity, "box_gradient": of_box}

    def images(self, position: NDArray) -> Images:
        """Return the positions of rows, with all images near the mesh where a box is tilted."""
        if self.lattice.vectors is None:
            return Images(position, self.in_space(position), slice(None))
        row, shift, drift = self.near_mesh(position, max(self.smoothings))
        position = position[row] + shift
        images = Images(position, self.in_space(position), row)
        if drift.any():
            images = replace(images, drift=drift)
        return images

    def near_mesh(self, position: NDArray, reach: float) -> tuple[NDArray, NDArray, NDArray]:
        """Images of positions no further than `reach` (m) from the nodes, see `Lattice.images`."""
        return self.lattice.images(position, *self.plan.nodes.around(reach), self.source)

    def translations(self, cutoff: float) -> NDArray | None:
        """Return translations (m, 3), in cutoffs, between images of a grain that reach one node; None where none do."""
        translations = self.lattice.scaled(cutoff).translations(2.0, self.source)
        if not len(translations):
            return None
        return translations

    def column(self, moment: Moment, at: Images, contact: NDArray | None = None) -> NDArray:
        """Columns (n, q) of a moment: its values at the grains, or of the contacts that stand at places."""
        assert moment.column is not None
        which = at.row
        if contact is not None:
            which = contact
        frame = self.of_grains
        if moment.contacts:
            frame = self.frame
        values = moment.column(frame, self.contacts)[which]
        values = values.reshape(len(at.position), math.prod(values.shape[1:]))
        if at.drift is not None and "velocity" in moment.variables:
            # images that move alike take one call, as a grain's value may be a sum over its
            # contacts
            for drift, here in alike(at.drift):
                moved = frame | {"velocity": frame["velocity"] + drift}
                of_images = moment.column(moved, self.contacts)[which]
                values[here] = of_images[here].reshape(-1, values.shape[1])
        return values

    @cached_property
    def contact_points(self) -> tuple[Images, NDArray, NDArray, NDArray]:
        """Return the place of each contact, its phase, its share in the contact, and its row; (n,).

        A contact between two phases is half one's and half the other's, so that phases add up to
        the bulk.
        """
        c = self.contacts
        first = np.flatnonzero(c.first_index >= 0)
        mixed = (c.i >= 0) & (c.j >= 0) & (self.phase[c.i] != self.phase[c.j])
        contact = np.concatenate([first, np.flatnonzero(mixed)])
        phase = np.concatenate([self.phase[c.first_index[first]], self.phase[c.j[mixed]]])
        images = self.images(c.point[contact])
        share = np.where(mixed[contact], 0.5, 1.0)
        return images, phase[images.row], share[images.row], contact[images.row]

    def in_space(self, position: NDArray) -> NDArray:
        """Order in space, so that neighbours add to the same nodes while these are in cache."""
        if not len(position):
            return np.zeros(0, "int32")  # as of others, so that nothing is compiled for it
        # axis=0 is slow
        lower = [float(np.min(x)) for x in position.T]
        upper = [float(np.max(x)) for x in position.T]
        farthest = np.abs(np.array([lower, upper]) - self.origin).max(axis=0)
        for cutoff, smoothing in self.smoothings.items():
            smoothing.check_far(farthest / cutoff + 2.0, self.source)
        smallest = min(self.smoothings)
        return spatial_order(position, smallest, lower, upper, self.plan.nodes.active.tolist())


def alike(drifts: NDArray) -> Iterator[tuple[NDArray, NDArray]]:
    """Yield each distinct row of drifts (n, 3), and a mask (n,) of where it stands."""
    for drift in np.unique(drifts, axis=0):
        yield drift, (drifts == drift).all(axis=1)


# --- passes over grains and other points -----------------------------------------------------------


def grains(arrays: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Prepare the pass over grains.

    Kinematic columns come first, then columns of constants that differ between grains, then the number
    of grains.
    """
    images = arrays.grains
    level = max(moment.level for moment in moments.values())
    table: dict[str, Columns] = {}
    constants: list[Moment | NDArray] = []
    same: dict[str, float] = {}
    width = 0
    for name, moment in moments.items():
        if moment.level:
            factor: float | NDArray = 1.0
            if name in CUTOFF_POWERS:
                factor = arrays.plan.cutoff_of_group ** CUTOFF_POWERS[name]
            table[name] = (moment.first + moment.columns, factor)
            continue
        columns: Moment | NDArray = moment  # what is wide is made when it is written
        if moment.width == 1:
            columns = arrays.column(moment, images)
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
    phase = arrays.phase[images.row]
    return [_over_points(arrays, table, images, phase, level, arrays.flow, constants)]


def _is_constant(values: NDArray) -> bool:
    """Return whether a column (n, 1) is the same for all grains, a multiple of their number."""
    if not len(values) or values[0, 0] != values[-1, 0]:  # most differ in their ends
        return False
    return bool((values == values[0]).all())


def slopes(arrays: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Prepare the pass over grains that weighs kinematic columns by grad Psi."""
    table: dict[str, Columns] = {}
    for name, flow in (("mass_slope", "offset"), ("momentum_slope", "shear")):
        columns = MOMENTS[flow].first + MOMENTS[flow].columns
        table[name] = (columns, -1 / arrays.plan.cutoff_of_group)
    images = arrays.grains
    phase = arrays.phase[images.row]
    level = loops.LINEAR
    return [_over_points(arrays, table, images, phase, level, arrays.flow, by_gradient=True)]


def vectors(arrays: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Prepare a pass for each vector that takes the place of velocity, so that it is kept relative to each node."""
    passes = []
    for name, moment in moments.items():
        if moment.contacts:
            images, phase, share, contact = arrays.contact_points
            values = arrays.column(moment, images, contact)
            values[:, 0] *= share
        else:
            images = arrays.grains
            phase = arrays.phase[images.row]
            values = arrays.column(moment, images)
        flow = np.ascontiguousarray(values[:, 1:]), np.ascontiguousarray(values[:, 0])
        table: dict[str, Columns] = {name: (moment.first + moment.columns, 1.0)}
        run = _over_points(arrays, table, images, phase, moment.level, flow)
        passes.append(replace(run, apart=True, vector=moment.vector))
    return passes


def at_contacts(arrays: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Prepare the pass over contact points, with columns of constants alone."""
    images, phase, share, contact = arrays.contact_points
    table: dict[str, Columns] = {}
    columns: list[Moment | NDArray] = []
    width = 0
    for name, moment in moments.items():
        columns.append(arrays.column(moment, images, contact) * share[:, None])
        table[name] = (width + moment.columns, 1.0)
        width += moment.width
    return [_over_points(arrays, table, images, phase, constants=columns)]


def between_phases(arrays: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Sum the forces of other phases and of walls on the grains of each phase, at the contact points."""
    contacts = arrays.contacts
    others = arrays.plan.other_count
    phase = np.append(arrays.phase, arrays.plan.group_count)  # row -1 is that of a wall
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
    images = arrays.images(np.concatenate(points))
    pair = np.concatenate(pairs)[images.row]
    force = np.concatenate(forces)[images.row]
    return [_of_force(arrays, images, pair, force, moments, others)]


def at_walls(arrays: StepArrays, moments: Mapping[str, Moment]) -> list[Pass]:
    """Sum the forces of walls, at the contact points."""
    row, point, force = arrays.contacts.at_walls
    images = arrays.images(point)
    phase = arrays.phase[row][images.row]
    return [_of_force(arrays, images, phase, force[images.row], moments)]


def _of_force(
    arrays: StepArrays,
    images: Images,
    phase: NDArray,
    force: NDArray,
    moments: Mapping[str, Moment],
    others: int = 1,
) -> Pass:
    """Prepare a pass over points with a force each."""
    table: dict[str, Columns] = {name: (moment.columns, 1.0) for name, moment in moments.items()}
    return _over_points(arrays, table, images, phase, constants=[force], others=others)


def _over_points(
    arrays: StepArrays,
    table: Mapping[str, Columns],
    images: Images,
    phase: NDArray,
    level: int = loops.NONE,
    flow: tuple[NDArray, NDArray] | None = None,
    constants: list[Moment | NDArray] | None = None,
    *,
    others: int = 1,
    by_gradient: bool | None = None,
) -> Pass:
    """Prepare the pass over grains, or other points, with kinematic columns and columns of constants.

    `flow` are velocities and masses, or numbers and weights in their places. `constants` are
    columns, or moments whose columns are made here; the list is emptied, as memory holds one of them
    beside what is written. With `others`, `phase` is the number of a pair of phases, the first
    times `others` plus the second.
    """
    plan = arrays.plan
    position = images.position
    count = len(position)
    written = _side_by_side(arrays, images, constants or [])
    run = Pass(plan.group_count * others, level + written.shape[1], table, level)
    velocity, mass = flow or (np.zeros((count, 3)), np.zeros(count))
    of_squares = [column for column in loops.SQUARES if column < level]
    has_squares = any(np.isin(columns, of_squares).any() for columns, _ in table.values())
    if not count and not has_squares:
        return run
    origin = arrays.origin
    for cutoff, smoothing in arrays.smoothings.items():
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
            translations = arrays.translations(cutoff)
            _add_squared(arrays, run, points, np.flatnonzero(of_cutoff), smoothing)
        flags = level, translations, by_gradient
        run.fills.append(partial(_fill, points, smoothing, flags))
    return run


def _side_by_side(arrays: StepArrays, images: Images, constants: list[Moment | NDArray]) -> NDArray:
    """Write columns of constants side by side, filled up to four, as the loop adds so many at a time."""
    width = sum(c.width if isinstance(c, Moment) else c.shape[1] for c in constants)
    written = np.zeros((len(images.position), width + -width % 4))
    first = 0
    while constants:
        columns = constants.pop(0)
        if isinstance(columns, Moment):
            columns = arrays.column(columns, images)
        written[:, first : first + columns.shape[1]] = columns
        first += columns.shape[1]
        del columns  # before the next are made
    return written


def _add_squared(
    arrays: StepArrays, run: Pass, points: loops.Grains, groups: NDArray, smoothing: Smoothing
) -> None:
    """Add the grains of the groups of one cutoff to those whose weights are squared."""
    beyond = arrays.lattice
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
