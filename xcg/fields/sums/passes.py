"""Passes over one frame: what they sum at the nodes, and the sums that they give, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from xcg.compiled.arrays import transpose_columns
from xcg.compiled.points import NONE, SQUARES
from xcg.compiled.smoothing import CellKernel, KernelCode
from xcg.fields.sums.moments import MOMENTS, Moment
from xcg.fields.sums.nodes import Grid, NodeBlock, triple
from xcg.scene.lattice import Lattice

AnyKernel: TypeAlias = KernelCode | CellKernel
# adds one pass to the sums (groups, nodes, columns) at the nodes of a block; the last array is the reference velocity
Fill: TypeAlias = Callable[[NodeBlock, NDArray, NDArray], None]


@dataclass(eq=False)
class DepositSpec:
    """What the deposits need besides a frame: which sums, where, how smeared.

    Attributes
    ----------
    moments : tuple of str
        Names in `MOMENTS` or `own`.
    grid : Grid
    weights : KernelCode, or CellKernel for averages over cells
        The kernel of the first cutoff as seen in the grid's axes.
    cutoffs : tuple of float
        Radius of the support (m) of each group, or one for all.
    limits : array
        Longest branch (cutoffs) for 2, 4, ... Gauss-Legendre points; empty for closed forms.
    coarse : bool
        Whether single precision is enough for the weights of quadrature.
    by : str or None
        Integer particle variable that divides the grains into phases.
    groups : tuple of int
        Its values, one phase each.
    own : mapping
        Moments of the caller's own variables.

    Other attributes follow from these: `phases`, the number of groups or 1; `by_phase`, the cutoff of each (m);
    `distinct`, each cutoff once, rising; `origin`, the place that loops take others relative to (m); `rows`, the
    moments by name; `of_grains`, those of the main pass over grains, and `level`, the flow columns of that pass.
    """

    moments: tuple[str, ...]
    grid: Grid
    weights: AnyKernel
    cutoffs: tuple[float, ...]
    limits: NDArray
    coarse: bool = False
    by: str | None = None
    groups: tuple[int, ...] = ()
    own: Mapping[str, Moment] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.phases = max(1, len(self.groups))
        self.others = self.phases + 1  # groups of partners, the last one for walls
        self.by_phase = np.resize(self.cutoffs, self.phases)
        self.distinct = sorted(set(self.cutoffs))
        self.origin = triple(self.grid.origin)
        self.rows = {name: self.own.get(name) or MOMENTS[name] for name in self.moments}
        elsewhere = {name for name, row in self.rows.items() if row.at_contacts or row.along_branches}
        here = {name: row for name, row in self.rows.items() if name not in elsewhere}
        self.of_grains = {name: row for name, row in here.items() if bool(row.level) != bool(row.column)}
        self.level = max((row.level for row in self.of_grains.values()), default=NONE)

    def __reduce__(self) -> tuple[Any, ...]:  # moments travel by their names, as functions of theirs do not pickle
        return type(self), tuple(getattr(self, one.name) for one in fields(self))

    def takes(self, variable: str) -> bool:
        """Return whether any moment takes a variable."""
        return any(variable in (*row.variables, *row.optional) for row in self.rows.values())


@dataclass(frozen=True, eq=False)
class Squared:
    """Grains of one cutoff the squares of whose weights are summed.

    Attributes
    ----------
    rows : array (n,)
        Which of the places they are.
    position, mass, phase : array (m, 3), (m,), (m,)
        Places, weights and groups of all.
    lattice : Lattice
        Periodic images beyond these places.
    groups : array
        Groups of this cutoff.
    cutoff, weights, active
        The kernel, and the axes that it is seen in.
    """

    rows: NDArray
    position: NDArray
    mass: NDArray
    phase: NDArray
    lattice: Lattice
    groups: NDArray
    cutoff: float
    weights: AnyKernel
    active: NDArray


@dataclass(frozen=True, eq=False)
class Layout:
    """What a pass sums at a node: what the columns of its array (groups, nodes, columns) are.

    Attributes
    ----------
    groups, columns : int
    moments : mapping
        Columns that each moment is made of (those of a symmetric tensor name six of them nine times), with a factor, or
        one for each group.
    level : int
        How many columns are flow columns; they are the first ones.
    apart : bool
        Whether it has a reference of its own.
    vector : bool
        Whether the numbers in the place of velocity are the components of a vector.
    """

    groups: int
    columns: int
    moments: Mapping[str, tuple[NDArray, float | NDArray]]
    level: int = NONE
    apart: bool = False
    vector: bool = True

    @cached_property
    def squares(self) -> bool:
        """Whether any moment is one of squares of weights."""
        kept = {column for column in SQUARES if column < self.level}
        return not all(kept.isdisjoint(columns.ravel().tolist()) for columns, _ in self.moments.values())

    @cached_property
    def _rows(self) -> tuple[NDArray, NDArray]:
        """Column (r,) and factor (r, groups) of each component of the moments, one after the other."""
        columns = np.concatenate([columns.ravel() for columns, _ in self.moments.values()])
        factors = [np.broadcast_to(factor, (columns.size, self.groups)) for columns, factor in self.moments.values()]
        return columns.astype("uint64"), np.concatenate(factors)

    def turned(self, records: NDArray) -> Iterator[tuple[str, NDArray]]:
        """Moments (components, groups, nodes) from the sums (groups, nodes, columns)."""
        column, factor = self._rows
        out, first = np.empty((column.size, *records.shape[:2])), 0
        transpose_columns(records, column, factor, out)
        for name, (columns, _) in self.moments.items():
            yield name, out[first : first + columns.size].reshape(*columns.shape, *out.shape[1:])
            first += columns.size


@dataclass(frozen=True, eq=False)
class Pass:
    """One pass over grains or segments, prepared: each `fill` is a loop for one cutoff, which adds to its array.

    `squared` are the grains whose weights are squared in it.
    """

    layout: Layout
    fill: Sequence[Fill]
    squared: Sequence[Squared] = ()
