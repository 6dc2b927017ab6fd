"""Sums over grains and contacts at the nodes: from a frame to the moments that fields are algebra on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xcg.contacts import Contacts
from xcg.grid import Grid
from xcg.kernels import deposit as kernel
from xcg.kernels.nodes import runs_of, spatial_order, to_cutoffs
from xcg.kernels.rows import turn
from xcg.kernels.segments import deposit_segments
from xcg.schema import COMPONENTS, Frame, SceneError
from xcg.smoothing import Weights
from xcg.threads import for_each, shares

CONTACT_VARIABLES = ("position", "contact_i", "contact_j", "contact_point", "contact_normal")


@dataclass(frozen=True)
class Moment:
    """One sum: ``sum_i q_i Psi(r - r_i)`` over grains, or over contacts.

    Attributes
    ----------
    variables : tuple of str
        Scene variables that it needs besides positions.
    formula : str
        What is summed.
    shape : tuple of int
        Components of the result at a node.
    level : int
        Flow columns that the point deposit must keep for it; 0 where it is a column of constants or of contacts.
    first : int
        Its first flow column.
    column : callable, optional
        ``column(frame, contacts) -> (n, ...)`` for a column of constants.
    contacts : bool
        Whether contacts are needed, in whole.
    """

    variables: tuple[str, ...]
    formula: str
    shape: tuple[int, ...] = ()
    level: int = kernel.NONE
    first: int = 0
    column: Callable[[Frame, Contacts | None], NDArray] | None = None
    contacts: bool = False


def _power(exponent: int) -> Callable[[Frame, Contacts | None], NDArray]:
    return lambda frame, _: frame["diameter"] ** exponent


def _partners(frame: Frame, contacts: Contacts | None) -> NDArray:
    if "coordination_number" in frame:
        return frame["coordination_number"]
    assert contacts is not None
    return contacts.partners


def _fabric(frame: Frame, contacts: Contacts | None) -> NDArray:
    assert contacts is not None
    return (frame["volume"][:, None, None] * contacts.normals)[:, *_UPPER]


def _forces(frame: Frame, contacts: Contacts | None) -> NDArray:
    assert contacts is not None
    return contacts.forces


_MV = ("mass", "velocity")
_FORCE = ("contact_force",)
MOMENTS: dict[str, Moment] = {
    # flow columns, relative to the node: x = r_i - r, u = v_i - U
    "count": Moment((), "1, where Psi > 0", (), kernel.VELOCITY, kernel.COUNT),
    "mass": Moment(("mass",), "m", (), kernel.VELOCITY, kernel.MASS),
    "momentum": Moment(_MV, "m u", (3,), kernel.VELOCITY, kernel.MOMENTUM),
    "kinetic": Moment(_MV, "m u u", (3, 3), kernel.FLUCTUATION, kernel.KINETIC),
    "offset": Moment(("mass",), "m x", (3,), kernel.LINEAR, kernel.OFFSET),
    "shear": Moment(_MV, "m u x", (3, 3), kernel.LINEAR, kernel.SHEAR),
    "spread": Moment(("mass",), "m x x", (3, 3), kernel.LINEAR, kernel.SPREAD),
    # columns of constants
    "number": Moment((), "1", column=lambda frame, _: np.ones(len(frame["position"]))),
    "volume": Moment(("volume",), "V", column=lambda frame, _: frame["volume"]),
    "size2": Moment(("diameter",), "d^2", column=_power(2)),
    "size3": Moment(("diameter",), "d^3", column=_power(3)),
    "size4": Moment(("diameter",), "d^4", column=_power(4)),
    "partners": Moment((), "z", column=_partners, contacts=True),
    "fabric": Moment(("volume",), "V sum_c n n", (3, 3), column=_fabric, contacts=True),
    "force": Moment(_FORCE, "sum_c f", (3,), column=_forces, contacts=True),
    # weighted by grad Psi
    "mass_slope": Moment(("mass",), "m, with grad Psi", (3,)),
    "momentum_slope": Moment(_MV, "m u, with grad Psi", (3, 3)),
    # along branches, and at walls
    "contact": Moment(_FORCE, "f a, along the branch", (3, 3), contacts=True),
    "pair_contact": Moment(_FORCE, "f a, along the branch, by phase of the partner", (3, 3), contacts=True),
    "traction": Moment(_FORCE, "f, at the wall", (3,), contacts=True),
}

_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_UPPER = np.triu_indices(3)
# powers of the cutoff in the flow columns, which the deposit computes with lengths in cutoffs
_CUTOFF_POWERS = {"offset": 1, "shear": 1, "spread": 2}


@dataclass(frozen=True)
class Recipe:
    """What the deposits need besides a frame: which sums, where, how smeared.

    Attributes
    ----------
    moments : tuple of str
        Names in `MOMENTS`.
    grid : Grid
    weights : Weights
        The kernel of the first cutoff as seen in the grid's axes.
    cutoffs : tuple of float
        Radius of the support (m) of each group, or one for all.
    limits : array
        Longest branch (cutoffs) for each Gauss-Legendre order; empty for closed forms.
    coarse : bool
        Whether single precision is enough for the weights of quadrature.
    by : str or None
        Integer particle variable that divides the grains into phases.
    groups : tuple of int
        Its values, one phase each.
    """

    moments: tuple[str, ...]
    grid: Grid
    weights: Weights
    cutoffs: tuple[float, ...]
    limits: NDArray
    coarse: bool = False
    by: str | None = None
    groups: tuple[int, ...] = ()

    @property
    def level(self) -> int:
        """Flow columns that the sums take."""
        return max((MOMENTS[name].level for name in self.moments), default=kernel.NONE)


def phase_of(frame: Frame, by: str | None, groups: Sequence[int], where: str) -> NDArray:
    """Which of the groups each particle belongs to; refuses particles of none."""
    count = len(frame["position"])
    if by is None:
        return np.zeros(count, "int64")
    values, known = frame[by], np.asarray(groups)
    row = np.minimum(np.searchsorted(known, values), len(known) - 1)
    strange = np.flatnonzero(known[row] != values)
    if strange.size:
        msg = (
            f"{where}: particle {frame['particle_id'][strange[0]]} has {by}={values[strange[0]]}, which is not among "
            f"the groups {list(groups)}; pass groups= with every value that occurs"
        )
        raise SceneError(msg)
    return row


def without_frozen(frame: Frame) -> Frame:
    """Drop frozen grains; contacts with them become contacts with a wall, as their partner is not there."""
    if "frozen" not in frame:
        return frame
    free = frame["frozen"] != 1
    particles = {name: values[free] for name, values in frame.items() if not name.startswith(("contact", "overlap"))}
    return {**frame, **particles}


_Index = tuple[int, int, int]

# Beyond this many cutoffs from the mesh coordinates cannot be told apart, and cells cannot be counted.
_FAR = 2.0**50
_MOST_IMAGES = 1000


def _tuple(values: Sequence[Any] | NDArray) -> tuple[Any, Any, Any]:
    x, y, z = np.asarray(values).tolist()
    return x, y, z


class _Deposit:
    """The deposits onto one grid, with lengths in cutoffs; results are (phases, nodes, columns)."""

    def __init__(self, recipe: Recipe, period: NDArray, scale: float, where: str, threads: int) -> None:
        self.recipe, self.scale, self.where, self.threads = recipe, scale, where, threads
        self.phases = max(1, len(recipe.groups))
        self.cutoffs = np.broadcast_to(recipe.cutoffs, self.phases)
        self.shape, self.active = recipe.grid.shape, recipe.grid.active
        self.nodes = math.prod(self.shape)
        self.period = np.where(self.active, period, np.inf)

    def _onto(self, cutoff: float) -> tuple[Any, ...]:
        """Mesh and kernel, in cutoffs."""
        kind, spread, table, norm = self.recipe.weights
        norm *= (self.recipe.cutoffs[0] / cutoff) ** int(self.active.sum())
        mesh = (_tuple(self.recipe.grid.steps / cutoff), _tuple(self.active), _tuple(self.period / cutoff))
        return *mesh, kind, spread, table, norm * self.scale

    def _by_cutoff(
        self, position: NDArray, phase: NDArray, branch: NDArray | None = None
    ) -> Iterator[tuple[float, NDArray, NDArray]]:
        """Yield each cutoff, the rows that have it, and their positions in cutoffs.

        Rows come in an order in space, so that neighbours add to the same nodes while these are in cache.
        """
        own = len(set(self.cutoffs)) > 1
        for cutoff in np.unique(self.cutoffs).tolist():
            rows = np.flatnonzero(self.cutoffs[phase] == cutoff) if own else np.arange(len(position))
            local, there = np.empty((len(rows), 3)), np.empty((len(rows), 3))
            reach = np.full(3, 2.0)
            if branch is not None:
                reach += to_cutoffs(branch, rows, np.zeros(3), cutoff, local)
            self._check(to_cutoffs(position, rows, self.recipe.grid.origin, cutoff, local) + reach, reach, cutoff)
            order = spatial_order(local, self.active)
            to_cutoffs(local, order, np.zeros(3), 1.0, there)
            yield cutoff, rows[order], there

    def _over_slabs(self, fill: Callable[[_Index, _Index], None]) -> None:
        """Fill the nodes slab by slab, each by one thread: across x where it has nodes enough, as rows run along z.

        Every node sums its grains in the same order whatever the number of threads, so that the bits are the same.
        """
        axis = int(np.argmax(np.minimum(self.shape, 8 * self.threads)))

        def fill_slab(part: slice) -> None:
            low, high = [0, 0, 0], list(self.shape)
            low[axis], high[axis] = part.start, part.stop
            fill(_tuple(low), _tuple(high))

        for_each(shares(self.shape[axis], self.threads), fill_slab, self.threads)

    def _check(self, farthest: NDArray, reach: NDArray, unit: float) -> None:
        """Refuse places that the kernels cannot number; damaged files hold them."""
        for k in np.flatnonzero(self.active):
            name = COMPONENTS[k]
            if not farthest[k] < _FAR:
                msg = (
                    f"{self.where}: a particle or contact reaches {farthest[k] * unit:.3g} m from the mesh along "
                    f"'{name}', where coordinates have no digits left; the file is damaged, or its units are others"
                )
                raise SceneError(msg)
            if not reach[k] * unit < _MOST_IMAGES * self.period[k]:
                msg = (
                    f"{self.where}: the period {self.period[k]:.3g} m along '{name}' is less than a "
                    f"{_MOST_IMAGES}th of the reach of a particle or contact ({reach[k] * unit:.3g} m); the box or a "
                    "contact in the file is damaged, or the kernel is too wide"
                )
                raise SceneError(msg)

    def points(
        self, position: NDArray, velocity: NDArray, mass: NDArray, constants: NDArray, phase: NDArray, level: int,
        reference: NDArray, *, by_gradient: bool = False,
    ) -> NDArray:  # fmt: skip
        constants = np.pad(constants, ((0, 0), (0, -constants.shape[1] % 4)))
        sums = np.zeros((self.phases, self.nodes, level + constants.shape[1]))
        still = bool((velocity == velocity[:1]).all())  # nothing moves: columns with u are zero without adding them
        for cutoff, rows, local in self._by_cutoff(position, phase):
            runs = runs_of(local, np.broadcast_to(0.0, local.shape))
            grains = (local, velocity[rows], mass[rows], constants[rows], phase[rows], level, still, self.shape, runs)
            onto = (*self._onto(cutoff), by_gradient, sums, reference)
            self._over_slabs(lambda *box, grains=grains, onto=onto: kernel.deposit(*grains, *box, *onto))
        return sums

    def segments(
        self, start: NDArray, branch: NDArray, force: NDArray, phase: NDArray, into: NDArray, groups: int
    ) -> NDArray:
        """Deposit segments that have the cutoff of `phase` into the sums `into`, of which there are `groups`."""
        sums = np.zeros((groups, self.nodes, 9))
        for cutoff, rows, local in self._by_cutoff(start, phase, branch):
            a, f = np.empty((len(rows), 3)), np.empty((len(rows), 3))
            to_cutoffs(branch, rows, np.zeros(3), cutoff, a)
            to_cutoffs(force, rows, np.zeros(3), 1 / cutoff, f)
            sides = (local, a, f, into[rows], self.recipe.limits, self.recipe.coarse, self.shape, runs_of(local, a))
            onto = (*self._onto(cutoff), sums)
            self._over_slabs(lambda *box, sides=sides, onto=onto: deposit_segments(*sides, *box, *onto))
        return sums


@dataclass(frozen=True)
class Sums:
    """The sums of one frame at all nodes, as the deposits leave them.

    Attributes
    ----------
    recipe : Recipe
    columns : dict
        For each moment its array (phases, nodes, columns), the columns of that array that it is made of (those of a
        symmetric tensor name six of them nine times), and a factor, or one for each phase.
    reference : array (nodes, 3)
        Velocity that ``momentum``, ``kinetic`` and ``shear`` are relative to.
    """

    recipe: Recipe
    columns: Mapping[str, tuple[NDArray, NDArray, float | NDArray]]
    reference: NDArray

    def at(self, nodes: slice) -> dict[str, NDArray]:
        """Return the moments at some nodes: arrays (phase, node, ...) with phase 0 the bulk, the sum over groups.

        Nodes run fastest in memory, so that algebra on small tensors is a loop over nodes.
        """
        found, turned = {}, dict[int, NDArray]()
        for name, (array, columns, factor) in self.columns.items():
            if id(array) not in turned:
                records = array[:, nodes]
                turned[id(array)] = np.empty((records.shape[-1], *records.shape[:2]))
                turn(records, turned[id(array)])
            part = turned[id(array)][columns]
            if not (isinstance(factor, float) and factor == 1.0):
                part = part * np.reshape(factor, (-1, 1))
            if self.recipe.by is not None:
                part = np.concatenate([part.sum(axis=-2, keepdims=True), part], axis=-2)
            found[name] = part.transpose(part.ndim - 2, part.ndim - 1, *range(part.ndim - 2))
        found["reference"] = np.ascontiguousarray(np.nan_to_num(self.reference[nodes], nan=0.0).T).T
        return found


def sums_of_frame(frame: Frame, recipe: Recipe, period: NDArray, scale: float, where: str, threads: int = 1) -> Sums:
    """Compute the sums of one frame at all nodes.

    Parameters
    ----------
    frame : Frame
        One step of a scene.
    recipe : Recipe
        What is wanted.
    period : array (3,)
        Length of the periodic axes (m), infinity along the others.
    scale : float
        1 / extent of the averaged axes (and thickness of a layer).
    where : str
        Names the step in messages.
    threads : int
        Threads that share the nodes; the bits of the result do not depend on it.
    """
    frame = without_frozen(frame)
    position = np.ascontiguousarray(frame["position"])
    count = len(position)
    phase = phase_of(frame, recipe.by, recipe.groups, where)
    wanted = {name: MOMENTS[name] for name in recipe.moments}
    contacts = Contacts.of(frame, period) if "contact_i" in frame else None
    to = _Deposit(recipe, period, scale, where, threads)

    constants = {
        name: row.column(frame, contacts).reshape(count, _columns_of(name).max() + 1)
        for name, row in wanted.items()
        if row.column
    }
    # a column that is the same for all grains, as those of one size are, is a multiple of their number
    same = {name: float(q[0, 0]) for name, q in constants.items() if count and q.shape[1] == 1 and (q == q[0]).all()}
    constants = {name: q for name, q in constants.items() if name not in same}
    if same:
        constants["number"] = np.ones((count, 1))
    stacked = np.concatenate(list(constants.values()), axis=1) if constants else np.zeros((count, 0))
    velocity = np.ascontiguousarray(frame.get("velocity", np.zeros((count, 3))))
    mass = frame.get("mass", np.ones(count))
    reference = np.full((to.nodes, 3), np.nan)
    columns: dict[str, tuple[NDArray, NDArray, float | NDArray]] = {}

    level = recipe.level
    if level or constants:
        records = to.points(position, velocity, mass, stacked, phase, level, reference)
        for name, row in wanted.items():
            if row.level:
                power = _CUTOFF_POWERS.get(name, 0)
                columns[name] = (records, row.first + _columns_of(name), to.cutoffs**power if power else 1.0)
        first = level
        for name, values in constants.items():
            columns[name] = (records, first + _columns_of(name), 1.0)
            first += values.shape[1]
        for name, value in same.items():
            columns[name] = (*columns["number"][:2], value)
    if {"mass_slope", "momentum_slope"} & set(wanted):
        none = np.zeros((count, 0))
        slopes = to.points(position, velocity, mass, none, phase, kernel.LINEAR, reference, by_gradient=True)
        for name, flow in (("mass_slope", "offset"), ("momentum_slope", "shear")):
            columns[name] = (slopes, MOMENTS[flow].first + _columns_of(flow), -1 / to.cutoffs)
    if {"contact", "pair_contact"} & set(wanted):
        assert contacts is not None
        start, branch, push, owner, other = contacts.segments(position, phase)
    if "contact" in wanted:
        columns["contact"] = (to.segments(start, branch, push, owner, owner, to.phases), _all_columns((3, 3)), 1.0)
    if "pair_contact" in wanted:
        others = to.phases + 1  # the last one for walls
        pair = owner * others + np.where(other < 0, to.phases, other)
        by_pair = to.segments(start, branch, push, owner, pair, to.phases * others)
        by_pair = np.moveaxis(by_pair.reshape(to.phases, others, to.nodes, 9), 1, 2)
        by_pair = by_pair.reshape(to.phases, to.nodes, others * 9)
        columns["pair_contact"] = (by_pair, _all_columns((others, 3, 3)), 1.0)
    if "traction" in wanted:
        assert contacts is not None
        at, point, force = contacts.at_walls
        none = np.zeros((len(at), 3))
        traction = to.points(point, none, none[:, 0], force, phase[at], kernel.NONE, reference)
        columns["traction"] = (traction, _all_columns((3,)), 1.0)
    return Sums(recipe, columns, reference)


def _all_columns(shape: tuple[int, ...]) -> NDArray:
    return np.arange(math.prod(shape)).reshape(shape)


def _columns_of(name: str) -> NDArray:
    """Columns that make up a moment, counted from its first; symmetric tensors are kept as six."""
    if name in ("kinetic", "spread", "fabric"):
        return _SYMMETRIC
    if name in ("offset", "shear"):  # m x and m u x of one direction stand together
        directions = np.arange(0, 12, 4)
        return directions if name == "offset" else np.arange(3)[:, None] + directions
    return _all_columns(MOMENTS[name].shape)
