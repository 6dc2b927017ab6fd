"""From what is asked for to what will be done: a plan of one call, which travels to the tasks that carry it out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from xcg.common.checks import is_finite
from xcg.common.messages import SceneError
from xcg.compiled.points import LINEAR
from xcg.compiled.segments import RULES
from xcg.fields.choices import choose_fields, options_of, variables_of, with_friction
from xcg.fields.formulas import registry
from xcg.fields.formulas.averages import needed_for_averages
from xcg.fields.formulas.field import Options
from xcg.fields.formulas.variables import check_turns, own_moments
from xcg.fields.layout import (
    averaged_gradient,
    check_differentiable,
    extents_of,
    kernels_of,
    nodes_of,
    warn_of_cuts,
    warn_of_unknown_gradient,
    warn_of_width,
)
from xcg.fields.request import Request
from xcg.fields.sums.kernels import Kernel
from xcg.fields.sums.nodes import BLOCK_NODES, FINE, nodes_in_cache
from xcg.fields.sums.passes import DepositSpec
from xcg.fields.sums.quadrature import SINGLE, gauss_limits
from xcg.scene.description import Description
from xcg.scene.lattice import Lattice
from xcg.scene.schema import COMPONENTS, ROTATION, Setup


@dataclass(frozen=True, eq=False)
class Plan:
    """What one call of `coarse_grain` will do; printing it explains it.

    Attributes
    ----------
    fields : tuple of str
        What is computed: what was asked for, and what averages of it need where they are to be taken.
    asked : tuple of str
        What was asked for.
    variables : tuple of str
        What is read from the scene.
    deposit : DepositSpec
        Sums, nodes and kernel.
    options : Options
        Choices of the algebra.
    kernel : Kernel
        The widest, where each group has its own.
    extent : dict
        Length of each averaged axis (m); None takes the box of each step.
    depth : float or str or None
        Thickness of a one-layer scene (m), or the axis whose box extent it is.
    setup : Setup
        What holds for the whole scene.
    rtol : float
        Promise for the contact stress.
    """

    fields: tuple[str, ...]
    asked: tuple[str, ...]
    variables: tuple[str, ...]
    deposit: DepositSpec
    options: Options
    kernel: Kernel
    extent: Mapping[str, float | None]
    depth: float | str | None
    setup: Setup
    rtol: float

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the nodes, and phase where there are several."""
        return (*self.deposit.grid.dims, *(("phase",) if self.deposit.by else ()))

    @property
    def phases(self) -> int:
        """Number of phases in the result, the bulk included."""
        return 1 + len(self.deposit.groups)

    @property
    def widths(self) -> list[float]:
        """Width of each group (m), or one for all."""
        return [self.kernel.spread * cutoff for cutoff in self.deposit.cutoffs]

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of one step of each field."""
        return {name: self._shape(name) for name in self.fields}

    @cached_property
    def rows(self) -> dict[str, tuple[int, ...]]:
        """Shape of one step of each field as (nodes, phases, ...)."""
        nodes, dims = (self.deposit.grid.count, self.phases if self.deposit.by else 1), len(self.dims)
        return {name: (*nodes, *shape[dims:]) for name, shape in self.shapes.items()}

    def _shape(self, name: str) -> tuple[int, ...]:
        phases = (self.phases,) if self.deposit.by else ()
        row = registry.row(name, self.options)
        return (*self.deposit.grid.sizes, *phases, *((self.phases,) if row.paired else ()), *(3,) * row.rank)

    def left_out(self, name: str) -> list[str]:
        """Name the variables of rotation that a field would take and that the scene does not hold."""
        if not self._absent:
            return []
        absent = {v for moment in registry.moments_of([name], self.options) for v in self._absent.get(moment, ())}
        return [v for v in ROTATION if v in absent]

    @cached_property
    def _absent(self) -> dict[str, set[str]]:
        """Variables of rotation that the scene does not hold, by the moments that would take them."""
        absent = set(ROTATION) - set(self.variables)
        found = {moment: absent & set(row.optional) for moment, row in self.deposit.rows.items()}
        return {moment: variables for moment, variables in found.items() if variables}

    @cached_property
    def reached(self) -> float:
        """Nodes in the box around the support of a grain."""
        grid, reach = self.deposit.grid, 2.0 * max(self.deposit.cutoffs)
        return float(np.clip(reach / grid.steps, 1.0, grid.shape)[grid.active].prod())

    @cached_property
    def block_nodes(self) -> int:
        """Nodes that are computed at one time."""
        return BLOCK_NODES if self.reached <= FINE else min(BLOCK_NODES, nodes_in_cache(self._numbers))

    @property
    def _numbers(self) -> int:
        """How many numbers are summed at a node."""
        return max(1, self.phases - 1) * sum(sum(columns) for columns in self._columns.values())

    @cached_property
    def _columns(self) -> dict[str, list[int]]:
        """Columns of each pass, by what it goes over."""
        moments = self.deposit.rows.values()
        constants = [m for m in moments if m.column and not m.level and not m.along_branches]
        grains = self.deposit.level + sum(math.prod(m.shape) for m in constants if not m.at_contacts)
        points = sum(math.prod(m.shape) for m in constants if m.at_contacts)
        return {
            "particles": [grains] if grains else [],
            "slopes": [LINEAR] if any(name.endswith("_slope") for name in self.deposit.moments) else [],
            "contacts": [9 for m in moments if m.along_branches],
            "contact points": [points] if points else [],
            "means": [m.level for m in moments if m.column and m.level],
        }

    def __str__(self) -> str:
        grid, moments = self.deposit.grid, self.deposit.rows
        passes = {over: len(columns) for over, columns in self._columns.items()}
        outputs = sum(map(math.prod, self.shapes.values()))
        sums = min(grid.count, self.block_nodes) * self._numbers
        own = f"; widths by group {[float(f'{w:.4g}') for w in self.widths]}" if len(self.widths) > 1 else ""
        rules = "closed form"
        if len(self.deposit.limits):
            steps = ", ".join(f"{k} to {x:.3g} c" for k, x in zip(RULES, self.deposit.limits, strict=False))
            rules = f"Gauss points by branch length ({steps}), closed form beyond"
            rules += ", weights in single precision" if self.deposit.coarse else ""
        lines = {
            "fields": ", ".join(self.fields),
            "read": ", ".join(self.variables),
            **grid.describe(),
            "averaged": ", ".join(f"{a} ({self.extent[a] or 'box'})" for a in grid.averaged) or "none",
            "kernel": f"{self.kernel!r}, seen in {len(grid.seen)} of {self.kernel.dimension} dimensions{own}",
            "sums": ", ".join(f"{m} ({row.formula})" for m, row in moments.items()),
            "passes": f"{passes['particles']} over particles, {passes['slopes']} with grad Psi, "
            f"{passes['contacts']} over contacts"
            + (f", {passes['contact points']} over contact points" if passes["contact points"] else "")
            + (f", {passes['means']} relative to means" if passes["means"] else ""),
            "contacts": f"{rules} (rtol = {self.rtol:g})" if passes["contacts"] else "not read for stress",
            "memory": f"{8 * sums / 1e6:.3g} MB of sums a thread and {8 * outputs / 1e6:.3g} MB of fields a step",
        }
        return "\n".join(f"{key:9s} {text}" for key, text in lines.items())


def scale_of(plan: Plan, lattice: Lattice, source: str) -> float:
    """1 / (extents of the averaged axes x thickness of the layer) for one step."""
    given = {**plan.extent, **({plan.depth: None} if isinstance(plan.depth, str) else {})}
    lengths = [length for length in given.values() if length is not None]
    of_box = [a in given and given[a] is None for a in COMPONENTS]
    if any(of_box):
        lengths.append(lattice.extent(np.array(of_box)))
        if not (np.isfinite(lengths[-1]) and lengths[-1] > 0):
            lattice.seen(plan.deposit.grid.active, source)  # which may say more
            axes = " and ".join(repr(a) for a, averaged in zip(COMPONENTS, of_box, strict=True) if averaged)
            raise SceneError(
                f"{source}: fields are averaged along {axes}, and the box of this step is not finite there; give the "
                "length that the integral is divided by (extent=)"
            )
    if isinstance(plan.depth, float):
        lengths.append(plan.depth)
    return 1.0 / math.prod(lengths)


def make_plan(scene: Description, request: Request) -> Plan:
    """Plan what a request takes, of grains and fields of xcg.

    Raises
    ------
    SceneError
        If the scene lacks variables that the fields need.
    ValueError
        If an argument is wrong.
    """
    scene.require((), "coarse_grain")
    rtol, by = request.rtol, request.by
    if not (is_finite(rtol) and rtol >= 0):
        raise ValueError(f"rtol={rtol!r}: expected 0 (closed form) or a positive number such as 1e-3")
    names, asked, options = _fields_and_options(scene, request)
    warn_of_unknown_gradient(asked, options)
    variables = _held_variables(scene, names, options)
    kernels = kernels_of(scene, request)
    widest = max(kernels, key=lambda k: k.cutoff)
    narrowest, sizes = min(k.width for k in kernels), scene.sizes
    if isinstance(request.width, Mapping):
        warn_of_width(narrowest, sizes.get("dmin"), "the smallest grains")
    elif not warn_of_width(narrowest, sizes.get("d43"), "the grains"):
        warn_of_width(narrowest, sizes.get("dmax"), "the largest grains")
    grid = nodes_of(scene, request, kernels)
    warn_of_cuts(grid, scene, widest.cutoff)
    moments = registry.moments_of(names, options)
    if request.gradient == "kernel" and {"mass_slope", "momentum_slope"} & set(moments):
        check_differentiable(widest, len(grid.seen))
    limits = gauss_limits(widest, len(grid.seen), rtol)
    own = own_moments(options.own) | with_friction(options.friction)
    deposit = DepositSpec(
        moments=moments,
        grid=grid,
        weights=(kernels[0].over_cells if grid.half.any() else kernels[0].weights)(len(grid.seen)),
        cutoffs=tuple(k.cutoff for k in kernels),
        limits=limits,
        coarse=limits.size > 0 and rtol >= SINGLE,
        by=by,
        groups=() if by is None else scene.groups(by, request.groups),
        own={name: row for name, row in own.items() if name in moments},
    )
    x, y, z = (grid.spacing.get(a, 0.0) for a in COMPONENTS)
    options = replace(
        options, active=tuple(grid.active.tolist()), shape=grid.shape, spacing=(x, y, z),
        wrapped=grid.fills(np.array(scene.lasting_periods)),
    )  # fmt: skip
    read = variables | ({by} if by else set()) | ({"frozen"} & scene.names)
    return Plan(
        fields=names, asked=asked, variables=tuple(n for n in scene.columns if n in read), deposit=deposit,
        options=options, kernel=widest, extent=extents_of(grid, request.extent or {}, scene),
        depth=scene.layer_depth, setup=scene.setup, rtol=rtol,
    )  # fmt: skip


def _fields_and_options(scene: Description, request: Request) -> tuple[tuple[str, ...], tuple[str, ...], Options]:
    """Fields that are computed, those of them that were asked for, and the choices of their algebra."""
    if request.by_pair and request.by is None:
        raise ValueError(
            "by_pair=True divides contact stress by pairs of phases: say which with by=, for example by='species'"
        )
    if request.groups is not None and request.by is None:
        raise ValueError(
            f"groups={request.groups!r} are the values of an integer variable of the particles: say which with by="
        )
    options = replace(options_of(scene, request), averaged_gradient=averaged_gradient(scene, request))
    names, own = choose_fields(request.fields, scene, options)
    if scene.cylindrical:
        check_turns(own)
    options = replace(options, own=(*own, *registry.registered_for(names, replace(options, own=own))))
    if request.by_pair:
        names = tuple(dict.fromkeys([*names, "contact_stress_by_pair"]))
    asked = names
    if request.for_averages or request.per is not None:
        names = (*names, *needed_for_averages(names, options))
    return names, asked, options


def _held_variables(scene: Description, names: tuple[str, ...], options: Options) -> frozenset[str]:
    """Return the variables that some fields take. Raise SceneError unless the scene holds all of them."""
    held = scene.names
    variables = variables_of(names, held, options)
    lacking = [] if variables <= held else [name for name in names if not variables_of((name,), held, options) <= held]
    scene.require(sorted(variables), f"coarse_grain of {', '.join(lacking)}")
    return variables
