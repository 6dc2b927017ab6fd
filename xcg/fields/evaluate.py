"""Evaluation of a plan: the sums of each step, block by block, the fields that follow from them, and their labels."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.compiled import program as loops
from xcg.compiled._jit import for_each
from xcg.compiled.simd import EIGHT
from xcg.fields import passes
from xcg.fields.advice import ComputedStep
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Field, Options
from xcg.fields.formulas.tracing import Program, program_for
from xcg.fields.passes import StepArrays
from xcg.fields.plan import Plan
from xcg.fields.ring_means import average_over_rings, reference_of_rings
from xcg.fields.segments import along_branches
from xcg.fields.sums.moments import Moment
from xcg.fields.sums.nodes import Block
from xcg.fields.support import numbers_of_floors
from xcg.scene.facts import SETUP, setup_of
from xcg.scene.frame import check_finite
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, ROTATION, VARIABLES, Frame, Variable, units_in
from xcg.steps.analysis import FrameAnalysis
from xcg.steps.labels import ABOUT, annotated, phases_of

_PAGE = 4096 // 8  # numbers in a page of memory


def _take_memory(numbers: NDArray) -> None:
    """Write to every page, so that the system gives the memory now, which is quick just after other memory was freed.

    See docs/measurements.md.
    """
    numbers[::_PAGE] = 0.0


# Threads share a step of more visits of nodes by grains and contacts than this; for fewer they cost
# more than they gain. What is done once for each grain or contact, or for each node, takes as long
# as `_ONCE` visits.
WORTH_SHARING = 1_500_000
_ONCE = 30


_CARTESIAN: dict[str, dict[str, str]] = {
    a: {"long_name": f"position along {a}", "axis": a.upper()} for a in COMPONENTS
}
_CYLINDRICAL: dict[str, dict[str, str]] = {
    "r": {"long_name": "distance from the axis"},
    "theta": {"units": "rad", "long_name": "angle about the axis"},
    "z": {"long_name": "position along the axis", "axis": "Z"},
}


@dataclass(frozen=True, eq=False)
class CoarseGraining(FrameAnalysis):
    """Fields of a plan, as an analysis of each step."""

    name = "coarse_grain"

    plan: Plan

    def reads(self, scene: Scene) -> tuple[str, ...]:
        """Return the variables of the plan."""
        return self.plan.variables

    def rows(self, scene: Scene) -> dict[str, Variable]:
        """Return dimensions and units of the fields."""
        return self.plan.outputs

    def coords(self, scene: Scene) -> dict[str, xr.Variable]:
        """Return the nodes, phases and axes, and the options that averages depend on."""
        plan = self.plan
        options = plan.options
        length = units_in("m", plan.setup.unit_system)
        coords: dict[str, xr.Variable] = {}
        # titles of plots name coordinates in this order, and xarray cuts them after 50 characters
        if len(plan.widths) == 1:
            coords["width"] = annotated((), plan.widths[0], length, "width of the kernel")
        axes = _CYLINDRICAL if scene.cylindrical else _CARTESIAN
        for name, coord in plan.nodes.coords.items():
            attrs: dict[str, Any] = {}
            if name in axes:
                attrs = {"units": length} | axes[name]
            coords[name] = xr.Variable(coord.dims, coord, attrs | coord.attrs)
        for k in np.flatnonzero(options.wrapped):
            period = scene.lasting_periods[k]
            coords[COMPONENTS[k]].attrs["period"] = period  # also of a part of the nodes
        if plan.by:
            coords["phase"] = phases_of(plan.by, plan.groups)
        fields = plan.definitions.values()
        for dim in ("component", "direction")[: max(field.rank for field in fields)]:
            coords[dim] = xr.Variable(dim, list(axes))
        if any(field.paired for field in fields):
            others = [*map(str, plan.groups), "wall"]
            coords["other_phase"] = xr.Variable("other_phase", others)
        facts = {name: scene.ds.attrs[name] for name in ABOUT if name in scene.ds.attrs}
        coords[SETUP] = setup_of(facts | plan.attrs)
        return coords

    def attrs(self, scene: Scene) -> dict[str, Any]:
        """Return the options of the plan."""
        return self.plan.attrs

    def frame(self, frame: Frame, lattice: Lattice, source: str) -> dict[str, NDArray]:
        """Compute the fields of one step (axes, phase, ...)."""
        plan = self.plan
        nodes = plan.nodes
        threads = self.threads
        count = len(frame["particle_id"]) + len(frame.get("contact_i", ()))
        if count * (plan.reached + _ONCE) + nodes.count * _ONCE <= WORTH_SHARING:
            threads = 1
        fields = {name: np.empty(plan.shapes[name]) for name in plan.fields}
        for_each([a.reshape(-1) for a in fields.values() if a.size > _PAGE], _take_memory, threads)
        at_nodes: dict[str, NDArray] = {}  # (nodes, phase, ...)
        for name, values in fields.items():
            at_nodes[name] = values.reshape(-1, plan.phases, *values.shape[len(plan.dims) :])
        scale = scale_of(plan, lattice, source)
        algebra = _Algebra(Sums(plan, frame, lattice, scale, source, threads), at_nodes, lattice)
        if plan.options.gradient == "finite_difference":  # of all nodes at once
            blocks = nodes.blocks(nodes.count, 1)
        else:
            blocks = nodes.blocks(plan.block_nodes, threads)
        reached = for_each(blocks, algebra.fill, threads)
        if nodes.undirected.size:
            _leave_out_directions(plan, at_nodes)
        ComputedStep(plan, frame, lattice, source, at_nodes, sum(reached), scale).warn()
        return fields

    def after(self, result: xr.Dataset, ds: xr.Dataset) -> xr.Dataset:
        """Name the formula, source and floor of each field, and what the scene lacks for it."""
        plan = self.plan
        system = plan.setup.unit_system
        floors: dict[str, float] = {}
        if plan.support is not None:
            floors = numbers_of_floors(plan, plan.support)
        optional = {n for moment in plan.moments.values() for n in moment.optional}
        absent = [n for n in ROTATION if n in optional and n not in plan.variables]
        for name, field in plan.definitions.items():
            attrs: dict[str, Any] = about(field, system)
            if absent:
                attrs |= _comment_on_rotation(name, plan.options, absent)
            if name in floors:
                attrs["floor_of_one_step"] = floors[name]
            result.variables[name].attrs = attrs
        return result.set_coords([n for n in plan.fields if n not in plan.requested])


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
        arrays = StepArrays(frame, plan, lattice, scale, source)
        # variables of scenes were checked with their frame
        of_moments = {name for moment in plan.moments.values() for name in moment.variables}
        for name in of_moments - VARIABLES.keys():
            check_finite(name, arrays.frame, source)
        kinds: dict[str, dict[str, Moment]] = {kind: {} for kind in _PASSES}
        for name, moment in plan.moments.items():
            kinds[moment.over][name] = moment
        needed = [kind for kind, moments in kinds.items() if moments]
        prepared = for_each(needed, lambda kind: _PASSES[kind](arrays, kinds[kind]), threads)
        self.plan = plan
        self.passes: list[passes.Pass] = list(chain.from_iterable(prepared))
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


# What prepares the passes of moments, by what these go over. The thread that calls begins with the
# last: contacts take more memory than grains.
_PASSES: dict[str, Callable[[StepArrays, Mapping[str, Moment]], list[passes.Pass]]] = {
    "grains": passes.grains,
    "vectors": passes.vectors,
    "contacts": passes.at_contacts,
    "pairs": passes.between_phases,
    "branches": along_branches,
    "slopes": passes.slopes,
    "walls": passes.at_walls,
}


class _Algebra:
    """Algebra from the sums of a step to its fields: a program, and NumPy for formulas that it does not hold.

    Parameters
    ----------
    sums : Sums
        Sums of the step.
    out : mapping
        Fields (nodes, phases, ...) by name, each in one piece of memory, which are filled.
    lattice : Lattice
        Box of the step, which may change.
    """

    def __init__(self, sums: Sums, out: Mapping[str, NDArray], lattice: Lattice) -> None:
        plan = sums.plan
        self.sums = sums
        self.out = out
        self.options = plan.options
        self.untraced = plan.fields
        self.program = program_for(plan.fields, plan.options, len(plan.groups))
        if self.program:
            held = self.program.widths
            self.filled_by_program = loops.as_tuple([out[name] for name in held])
            self.untraced = tuple(name for name in plan.fields if name not in held)
            self._connect(self.program)
        if self.untraced:
            wrapped = plan.nodes.fills(lattice.axis_periods)
            self.options = replace(plan.options, wrapped=wrapped)

    def _connect(self, program: Program) -> None:
        """Assign rows of the loop's scratch to constants, factors and columns of sums, and find the inputs there."""
        self.widths = [3]  # of each array of sums; the first one is the reference velocity
        first_array = [0]
        for run in self.sums.passes:
            first_array.append(len(self.widths))
            self.widths += [run.columns] * run.groups
        factors: dict[float, int] = {}
        sources = []  # array and column of each input, and the row of its factor
        for moment, group, column in program.inputs:
            number, columns, factor = self.sums.table[moment]
            row = factors.setdefault(float(factor[group]), len(program.scratch) + len(factors))
            sources.append((first_array[number] + group, int(columns.min()) + column, row))
        of_factors = np.repeat(np.reshape([*factors], (-1, 1)), loops.TILE, axis=1)
        self.constants = np.concatenate([program.scratch, of_factors])
        whole_lines = [width + -width % EIGHT for width in self.widths]
        *first_rows, self.row_count = np.cumsum([len(self.constants), *whole_lines]).tolist()
        inputs = [(first_rows[array] + column, row) for array, column, row in sources]
        self.inputs = np.array(inputs, "uint64").reshape(-1, 2)
        self.columns = np.column_stack([self.widths, first_rows]).astype("uint64")
        self.fits = True if (program.instructions[:, 0] == loops.FIT).any() else None

    def fill(self, block: Block) -> int:
        """Compute the fields at the nodes of a block; return how many of them have a reference velocity."""
        filled = self.sums.over(block)
        indices = block.indices
        if self.program:
            order = block.order  # so that memory is written line by line
            scratch = loops.room_for(self.row_count)
            scratch[: len(self.constants)] = self.constants
            loops.run(
                self.program.instructions,
                loops.as_tuple([array for groups in filled for array in groups]),
                self.columns,
                self.inputs,
                self.filled_by_program,
                self.program.stores,
                self.program.target,
                indices if order is None else indices[order],
                order,
                self.fits,
                np.empty((loops.TILE + EIGHT) * max(self.widths)),
                scratch,
            )
        if self.untraced:
            moments = self.sums.moments(filled)
            evaluated = registry.evaluate(self.untraced, moments, self.options)
            for name, values in evaluated.items():
                self.out[name][indices] = values.swapaxes(0, 1)
        return int(np.count_nonzero(~np.isnan(filled[0][0, :, 0])))


def _comment_on_rotation(name: str, options: Options, absent: Sequence[str]) -> dict[str, str]:
    """Return the attribute of a field that takes absent variables where the scene has them."""
    definitions = registry.fields_of((name,), options)
    moments = registry.moments_of(definitions.values(), options)
    optional = {variable for moment in moments.values() for variable in moment.optional}
    lacking = [variable for variable in absent if variable in optional]
    if not lacking:
        return {}
    return {"comment": f"without rotation, as the scene holds no {' and no '.join(lacking)}"}


def scale_of(plan: Plan, lattice: Lattice, source: str) -> float:
    """1 / (extents of the averaged axes x thickness of the layer) for one step."""
    extent = dict(plan.extent)
    if isinstance(plan.depth, str):
        extent[plan.depth] = None
    lengths = [length for length in extent.values() if length is not None]
    of_box = [extent.get(a, 0.0) is None for a in COMPONENTS]
    if any(of_box):
        lengths.append(lattice.extent(np.array(of_box)))
        if not (np.isfinite(lengths[-1]) and lengths[-1] > 0):
            lattice.seen(plan.nodes.active, source)  # which may say more
            raise SceneError(_of_infinite_box(source, of_box))
    if isinstance(plan.depth, float):
        lengths.append(plan.depth)
    return 1.0 / math.prod(lengths)


def _of_infinite_box(source: str, averaged: Sequence[bool]) -> str:
    """Return the message about a step whose box has no length along averaged axes."""
    axes = [repr(a) for a, is_averaged in zip(COMPONENTS, averaged, strict=True) if is_averaged]
    return (
        f"{source}: fields are averaged along {' and '.join(axes)}, and the box of this step is not finite there; give "
        "the length that the integral is divided by (extent=)"
    )


def _leave_out_directions(plan: Plan, fields: Mapping[str, NDArray]) -> None:
    """Set vectors and tensors to NaN where axes have no direction, but for what is along z alone."""
    for name, values in fields.items():
        rank = plan.definitions[name].rank
        if rank:
            along: Any = (plan.nodes.undirected, ..., *(2,) * rank)
            of_axis = values[along]
            values[plan.nodes.undirected] = np.nan
            values[along] = of_axis


def about(field: Field, system: str) -> dict[str, str]:
    """Return the attributes of a field in a result."""
    averages = field.averages
    if not (averages or field.additive):  # the mean of its values is something else
        rule = "computed anew from averaged sums"
        if field.weight:
            rule = f"weighted by {field.weight}"
        averages = (
            f"{rule} (f.cg.time_average(), f.cg.profile()); f.mean() is the mean of single values"
        )
    attrs = {
        "units": field.units,
        "long_name": field.long_name,
        "formula": field.formula,
        "source": field.source,
        "references": field.references,
        "averages": averages,
    }
    if field.source:  # a variable of the scene: it has any unit, and averages need its weight
        attrs["weight"] = field.weight
    else:
        attrs["units"] = units_in(field.units, system)
    return {key: text for key, text in attrs.items() if text}
