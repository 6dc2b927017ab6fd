"""Sums over grains and contacts at the nodes: from a frame to the passes that make them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.compiled import points as kernel
from xcg.compiled.reach import BATCH, batches_of, spatial_order
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
from xcg.compiled.threads import for_each
from xcg.fields.sums.blocks import NodeBlock, triple
from xcg.fields.sums.moments import CUTOFF_POWERS, MOMENTS, Moment
from xcg.fields.sums.passes import AnyKernel, DepositSpec, Fill, Pass, Squared, Sums
from xcg.fields.sums.power import WALL_VELOCITY, velocities_of_walls
from xcg.fields.sums.reach import Mesh
from xcg.scene.contacts import Contacts
from xcg.scene.frame import check_finite, phase_of, without_frozen
from xcg.scene.lattice import Lattice
from xcg.scene.schema import Frame
from xcg.scene.warn import warn_once

_HIDDEN_SHEAR = (
    "the box is sheared across an axis that is averaged, along which velocities of images differ; each grain counts "
    "once, with its velocity as it is written, so that results depend on how grains are wrapped; resolve that axis"
)


def _side_by_side(parts: Sequence[NDArray], count: int) -> NDArray:
    """Columns (count, ...) side by side, and zeros up to a multiple of four, as the loop adds four at a time."""
    width = sum(values.shape[1] for values in parts)
    out, first = np.zeros((count, width + -width % 4)), 0
    for values in parts:
        out[:, first : first + values.shape[1]] = values
        first += values.shape[1]
    return out


@dataclass(frozen=True)
class _Images:
    """Where rows of the data stand.

    Periodic images along axes are found node by node. In boxes that are tilted, or whose images move, each image is a
    place of its own.

    Attributes
    ----------
    position : array (m, 3)
    order : array (m,)
        Their order in space.
    row : array (m,) or None
        Row of each; None where that is the place's own number.
    drift : array (m, 3) or None
        How fast each moves relative to the row's velocity (m/s); None where none does.
    """

    position: NDArray
    order: NDArray
    row: NDArray | None = None
    drift: NDArray | None = None

    def of(self, values: NDArray) -> NDArray:
        """Values (m, ...) at the places from those of the rows."""
        return values if self.row is None else values[self.row]


class _Deposit:
    """Prepares the passes over one frame: lengths in cutoffs, rows in an order in space."""

    def __init__(self, frame: Frame, spec: DepositSpec, lattice: Lattice, scale: float, source: str) -> None:
        self.frame = without_frozen(frame)
        self.spec, self.scale, self.source = spec, scale, source
        self.position = np.ascontiguousarray(self.frame["position"])
        self.count = len(self.position)
        self.phase = phase_of(self.frame, spec.by, spec.groups, source)
        self.contacts = Contacts.of(self.frame, lattice, source) if "contact_i" in self.frame else None
        if self.contacts and any(WALL_VELOCITY in row.optional for row in spec.rows.values()) and "frozen" in frame:
            self.frame[WALL_VELOCITY] = velocities_of_walls(frame, self.contacts, source)
        self.velocity = np.ascontiguousarray(self.frame.get("velocity", np.zeros((self.count, 3))))
        self.mass = np.ascontiguousarray(self.frame.get("mass", np.ones(self.count)))
        self.phases = max(1, len(spec.groups))
        self.others = self.phases + 1  # the last one for walls
        self.cutoffs = np.resize(spec.cutoffs, self.phases)
        self.distinct = sorted(set(self.cutoffs.tolist()))
        self.active = spec.grid.active
        self._meshes: dict[float, Mesh] = {}
        self.lattice = lattice.seen(self.active, source)
        if lattice.hides_shear(self.active) and any("velocity" in row.variables for row in spec.rows.values()):
            warn_once("hidden shear", f"{source}: {_HIDDEN_SHEAR}")
        self.origin = triple(self.spec.grid.origin)
        self.grains = self._images(self.position)

    def passes(self, threads: int) -> list[Pass]:
        """All passes that the recipe takes; threads prepare one each."""
        asked = {name for row in self.spec.own.values() for name in row.variables}
        for name in asked:  # variables of scenes were checked with their frame
            check_finite(name, self.frame, self.source)
        wanted = self.spec.rows
        ways = [  # the calling thread begins with the last: contacts take more memory than grains
            (self._grains, self.spec.of_grains),
            (self._relative, {name for name, row in wanted.items() if row.level and row.column}),
            (self._at_contacts, {name for name, row in wanted.items() if row.at_contacts and not row.level}),
            (self._between_phases, wanted.keys() & {"pair_force"}),
            (self._along_branches, {name for name, row in wanted.items() if row.along_branches}),
            (self._slopes, wanted.keys() & {"mass_slope", "momentum_slope"}),
            (self._at_walls, wanted.keys() & {"traction"}),
        ]
        prepared = for_each([way for way, moments in ways if moments], lambda way: way(), threads)
        return [one for passes in prepared for one in passes]

    def _images(self, position: NDArray) -> _Images:
        """Where rows of the data stand: at these positions, and where a box is tilted at all images near the mesh."""
        if self.lattice.vectors is None:
            return _Images(position, self._in_space(position))
        row, shift, drift = self._near_mesh(position, self.cutoffs.max())
        position = position[row] + shift
        return _Images(position, self._in_space(position), row, drift if drift.any() else None)

    def _near_mesh(self, position: NDArray, reach: float) -> tuple[NDArray, NDArray, NDArray]:
        """Images of positions no further than `reach` (m) from the nodes, see `Lattice.images`."""
        first, last = self.spec.grid.lower, self.spec.grid.upper
        low, high = np.where(self.active, first - reach, -np.inf), np.where(self.active, last + reach, np.inf)
        return self.lattice.images(position, low, high, self.source)

    def _column(self, row: Moment, at: _Images, contact: NDArray | None = None) -> NDArray:
        """Columns (n, q) of a moment: its values at the grains, or of the contacts that stand at places."""
        assert row.column is not None
        which = at.row if contact is None else contact
        values = row.column(self.frame, self.contacts)
        values = (values if which is None else values[which]).reshape(len(at.position), math.prod(values.shape[1:]))
        if at.drift is not None and which is not None and "velocity" in row.variables:
            # images that move alike take one call, as a grain's value may be a sum over its contacts
            for drift, here in _alike(at.drift):
                found = row.column(self._moving(drift), self.contacts)
                values[here] = found[which[here]].reshape(-1, values.shape[1])
        return values

    def _moving(self, drift: NDArray) -> Frame:
        """Give all grains another velocity more: the frame as it is in images that drift."""
        return self.frame | {"velocity": self.frame["velocity"] + drift}

    @property
    def _flow(self) -> tuple[NDArray, NDArray]:
        """Velocity (n, 3) and mass (n,) of the grains and their images."""
        velocity = self.grains.of(self.velocity)
        return velocity if self.grains.drift is None else velocity + self.grains.drift, self.grains.of(self.mass)

    def _grains(self) -> list[Pass]:
        """Flow columns and columns of constants."""
        wanted = self.spec.of_grains
        constants = {name: self._column(row, self.grains) for name, row in wanted.items() if row.column}
        count = len(self.grains.position)
        # a column that is the same for all grains, as those of one size are, is a multiple of their number
        same = {
            name: float(q[0, 0]) for name, q in constants.items() if count and q.shape[1] == 1 and (q == q[0]).all()
        }
        constants = {name: q for name, q in constants.items() if name not in same}
        if same:
            constants["number"] = np.ones((count, 1))
        level, moments = self.spec.level, dict[str, tuple[NDArray, float | NDArray]]()
        for name, row in wanted.items():
            if row.level:
                power = CUTOFF_POWERS.get(name, 0)
                moments[name] = (row.first + row.columns, self.cutoffs**power if power else 1.0)
        first = level
        for name, values in constants.items():
            moments[name] = (first + (wanted.get(name) or MOMENTS[name]).columns, 1.0)
            first += values.shape[1]
        for name, value in same.items():
            moments[name] = (moments["number"][0], value)
        columns = list(constants.values())
        return [self._points(moments, self.grains, *self._flow, columns, level, self.grains.of(self.phase))]

    def _slopes(self) -> list[Pass]:
        """Flow columns weighted by grad Psi."""
        moments = {
            name: (MOMENTS[flow].first + MOMENTS[flow].columns, -1 / self.cutoffs)
            for name, flow in (("mass_slope", "offset"), ("momentum_slope", "shear"))
        }
        phase = self.grains.of(self.phase)
        return [self._points(moments, self.grains, *self._flow, [], kernel.LINEAR, phase, by_gradient=True)]

    def _along_branches(self) -> list[Pass]:
        assert self.contacts is not None
        order = self._in_space(self.position) if self.grains.row is not None else self.grains.order
        rank = np.empty_like(order)
        rank[order] = np.arange(self.count)
        place = self.contacts.places(rank)
        return [self._branches(name, row, place) for name, row in self.spec.rows.items() if row.along_branches]

    def _branches(self, name: str, row: Moment, place: NDArray) -> Pass:
        """Branches of the contacts in the order that `place` says, each with its force or what is in its place."""
        others, carried = self.others if row.paired else 0, self._carried(row, self.frame)
        fill: list[Fill] = []
        for cutoff in self.distinct:
            for second in (False, True):
                segments, longest, more = self._segments(row, *carried, place, second, others, cutoff)
                reach = self._mesh(cutoff).reach + longest[:3]
                self._mesh(cutoff).check_reach(reach)
                batches = batches_of(segments)
                batches += np.array([[-1.0], [1.0]]) * longest[:3]
                for real, closed, rest in self._rules(longest[3], cutoff):
                    way = Segments(segments, self.spec.limits, batches), self._mesh(cutoff), self._kernel(cutoff)
                    fill.append(partial(_fill_segments, *way, reach.tolist(), real, closed, rest))
                if not more:
                    break
        return Pass(self.phases * max(others, 1), 9, fill, {name: (row.columns, 1.0)})

    def _carried(self, row: Moment, frame: Frame) -> tuple[NDArray, NDArray | None]:
        """Vectors (n, 3) that the sides of i and of j carry; None where those of j are the opposite."""
        assert self.contacts is not None
        if row.column is None:
            return self.contacts.force, None
        on_i, on_j = row.column(frame, self.contacts)
        return on_i, on_j

    def _segments(
        self, moment: Moment, on_i: NDArray, on_j: NDArray | None, place: NDArray, second: bool, others: int,
        cutoff: float,
    ) -> tuple[NDArray, NDArray, bool]:  # fmt: skip
        """Segments of the first or second particles of the contacts, the longest, and whether there are second ones."""
        c = self.contacts
        assert c is not None
        segments, longest = np.empty((len(place), SEGMENT)), np.empty(4)
        rows = ContactRows(c.i, c.j, c.point, on_i, self.position, self.phase, *c.periods)
        more = list_segments(rows, on_j, second, place, others, self.cutoffs, cutoff, self.origin, segments, longest)
        mesh = self._mesh(cutoff)
        mesh.check_far(longest[:3])
        row: Any = slice(None)
        shift = np.zeros(3)
        if self.lattice.vectors is not None:
            start = segments[:, :BRANCH] * cutoff + self.origin
            row, shift, drifts = self._near_mesh(start, (1.0 + longest[3]) * cutoff)
            segments = segments[row]
            segments[:, :BRANCH] += shift / cutoff
            for drift, here in _alike(drifts) if "velocity" in moment.variables and drifts.any() else ():
                on_i, on_j = self._carried(moment, self._moving(drift))
                moving, _ = np.empty((len(place), SEGMENT)), np.empty(4)
                rows = rows._replace(on_i=on_i)
                list_segments(rows, on_j, second, place, others, self.cutoffs, cutoff, self.origin, moving, _)
                segments[here, FORCE:GROUP] = moving[row[here], FORCE:GROUP]
        if mesh.too_long(longest[:3]):
            contact = np.argsort(place)
            partner = (c.i if second else np.where(c.i >= 0, c.j, c.i))[contact]
            ends = [points[row] + shift for points in (c.point[contact], self.position[partner])]
            longest = mesh.cut(segments, np.array(ends))
        return segments, longest, more

    def _rules(self, longest: float, cutoff: float) -> list[tuple[str, bool, bool]]:
        """Ways to the weights of segments: numbers, whether in closed form as well, and whether in that alone."""
        if (
            self.spec.grid.half.any()
            or not self.spec.coarse
            or not self._mesh(cutoff).fits_single(self.spec.limits.max())
        ):
            return [("float64", True, False)]
        by_points = ("float32", False, False)
        return [by_points] if longest <= self.spec.limits.max() else [by_points, ("float64", True, True)]

    def _at_walls(self) -> list[Pass]:
        assert self.contacts is not None
        at, point, force = self.contacts.at_walls
        moments = {"traction": (MOMENTS["traction"].columns, 1.0)}
        images = self._images(point)
        none = np.zeros((len(images.position), 3))
        phase = images.of(self.phase[at])
        return [self._points(moments, images, none, none[:, 0], [images.of(force)], kernel.NONE, phase)]

    def _between_phases(self) -> list[Pass]:
        """Sum the forces of other phases and of walls on the grains of each phase, at the contact points."""
        c = self.contacts
        assert c is not None
        phase = np.append(self.phase, self.phases)  # row -1 is that of a wall
        sides = []
        for row, partner, sign in ((c.i, c.j, 1.0), (c.j, c.i, -1.0)):
            # inside a phase both sides add up to nothing
            at = np.flatnonzero((row >= 0) & (phase[row] != phase[partner]))
            sides.append((c.point[at], phase[row[at]] * self.others + phase[partner[at]], sign * c.force[at]))
        point, pair, force = (np.concatenate(parts) for parts in zip(*sides, strict=True))
        moments = {"pair_force": (MOMENTS["pair_force"].columns, 1.0)}
        images = self._images(point)
        none, force, pair = np.zeros((len(images.position), 3)), images.of(force), images.of(pair)
        return [self._points(moments, images, none, none[:, 0], [force], kernel.NONE, pair, others=self.others)]

    def _at_contacts(self) -> list[Pass]:
        """Columns of constants at the contact points."""
        rows = {name: row for name, row in self.spec.rows.items() if row.at_contacts and not row.level}
        images, phase, share, contact = self._contact_points
        moments, columns, first = {}, [], 0
        for name, row in rows.items():
            columns.append(self._column(row, images, contact) * share[:, None])
            moments[name] = (first + row.columns, 1.0)
            first += columns[-1].shape[1]
        none = np.zeros((len(share), 3))
        return [self._points(moments, images, none, share, columns, kernel.NONE, phase)]

    def _relative(self) -> list[Pass]:
        """Numbers in the place of velocity, so that they are kept relative to each node: a pass for each three."""
        passes = []
        for name, row in self.spec.rows.items():
            if not (row.level and row.column):
                continue
            if row.at_contacts:
                images, phase, share, contact = self._contact_points
                values = self._column(row, images, contact)
                values[:, 0] *= share
            else:
                images, phase = self.grains, self.grains.of(self.phase)
                values = self._column(row, images)
            weight, numbers = np.ascontiguousarray(values[:, 0]), np.ascontiguousarray(values[:, 1:])
            moments = {name: (row.first + row.columns, 1.0)}
            passes.append(
                self._points(moments, images, numbers, weight, [], row.level, phase, apart=True, vector=row.vector)
            )
        return passes

    @cached_property
    def _contact_points(self) -> tuple[_Images, NDArray, NDArray, NDArray]:
        """Where contacts are, the phase of each place, its share in the contact, and the row of that; (n,).

        A contact between two phases is half one's and half the other's, so that phases add up to the bulk.
        """
        c = self.contacts
        assert c is not None
        first = np.flatnonzero(c.first_row >= 0)
        mixed = (c.i >= 0) & (c.j >= 0) & (self.phase[c.i] != self.phase[c.j])
        contact = np.concatenate([first, np.flatnonzero(mixed)])
        phase = np.concatenate([self.phase[c.first_row[first]], self.phase[c.j[mixed]]])
        images, share = self._images(c.point[contact]), np.where(mixed[contact], 0.5, 1.0)
        return images, images.of(phase), images.of(share), images.of(contact)

    def _kernel(self, cutoff: float) -> AnyKernel:
        """Return the kernel of this cutoff, divided by the extent of averaged axes."""
        norm = self.spec.weights.norm * (self.spec.cutoffs[0] / cutoff) ** int(self.active.sum())
        return self.spec.weights._replace(norm=norm * self.scale)

    def _mesh(self, cutoff: float) -> Mesh:
        """Mesh and its surroundings, in cutoffs."""
        if cutoff not in self._meshes:
            self._meshes[cutoff] = Mesh.of(self.spec.grid, self.lattice.period, cutoff, self.source)
        return self._meshes[cutoff]

    def _in_space(self, position: NDArray) -> NDArray:
        """Order in space, so that neighbours add to the same nodes while these are in cache."""
        if not len(position):
            return np.zeros(0, "int64")
        lower, upper = (np.array([extreme(x) for x in position.T]) for extreme in (np.min, np.max))
        farthest = np.maximum(np.abs(lower - self.origin), np.abs(upper - self.origin))
        for cutoff in (self.cutoffs.min(), self.cutoffs.max()):
            mesh = self._mesh(cutoff)
            mesh.check_far(farthest / cutoff + 2.0)
            mesh.check_reach(mesh.reach, paired=self.spec.level >= kernel.SQUARED)
        return spatial_order(position, self.cutoffs.min(), lower, upper, self.active)

    def _points(
        self, moments: Mapping[str, tuple[NDArray, float | NDArray]], images: _Images, velocity: NDArray,
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
        fill, squared, cutoffs = [], [], np.repeat(self.cutoffs, others)
        beyond = self.lattice if images.row is None else Lattice(np.full(3, np.inf))
        for cutoff in self.distinct if len(position) or squares else ():
            rows = order if (cutoffs == cutoff).all() else order[cutoffs[phase[order]] == cutoff]
            mesh, meet = self._mesh(cutoff), None
            if squares:
                both_seen = 2.0 + 2.0 * float(np.linalg.norm(mesh.half))
                meet = self.lattice.scaled(cutoff).translations(both_seen, self.source)
                meet = meet if len(meet) else None
            batches = (batches_of(position, rows) - self.origin) / cutoff
            flow = (velocity, mass, columns, phase)
            grains = kernel.Grains(rows, batches, position, *flow, self.origin, cutoff)
            flags = (level, still, meet, by_gradient, cubes)
            fill.append(partial(_fill_points, grains, mesh, self._kernel(cutoff), flags))
            if squares:
                groups, weights = np.flatnonzero(cutoffs == cutoff), self._kernel(cutoff)
                squared.append(Squared(rows, position, mass, phase, beyond, groups, cutoff, weights, self.active))
        count, width = self.phases * others, level + columns.shape[1]
        return Pass(count, width, fill, moments, apart, level, vector, squared)


def _alike(drifts: NDArray) -> Iterator[tuple[NDArray, NDArray]]:
    """Each velocity among drifts (n, 3), and which of them are that; (n,)."""
    for drift in np.unique(drifts, axis=0):
        yield drift, (drifts == drift).all(axis=1)


def _fill_points(
    grains: kernel.Grains, mesh: Mesh, weights: AnyKernel, flags: tuple[int, *tuple[bool | NDArray | None, ...]],
    block: NodeBlock, sums: NDArray, reference: NDArray,
) -> None:  # fmt: skip
    taken = mesh.nodes_of(block)
    records = np.empty((BATCH, sums.shape[2] + kernel.GRAIN))
    kernel.deposit(grains, *taken, weights, *flags, records, block.lists(taken, mesh.reach.tolist()), sums, reference)


def _fill_segments(
    segments: Segments, mesh: Mesh, weights: AnyKernel, reach: Sequence[float], real: str, closed: bool, rest: bool,
    block: NodeBlock, sums: NDArray, _: NDArray,
) -> None:  # fmt: skip
    taken = mesh.nodes_of(block)
    lists = block.lists(taken, reach, real)
    scratch = closed_for(lists.values.shape[1]) if closed else None
    deposit_segments(segments, *taken, weights, lists, scratch, rest, sums)


def sums_of_frame(
    frame: Frame, spec: DepositSpec, lattice: Lattice, scale: float, source: str, threads: int = 1
) -> Sums:
    """Prepare the sums of one frame.

    Parameters
    ----------
    frame : Frame
        One step of a scene.
    spec : DepositSpec
        What is wanted.
    lattice : Lattice
        Periodic images.
    scale : float
        1 / extent of the averaged axes (and thickness of a layer).
    source : str
        Names the step in messages.
    threads : int
        Threads that prepare passes.
    """
    return Sums(spec, _Deposit(frame, spec, lattice, scale, source).passes(threads))
