"""Evaluation of a plan: the fields of each step, and their labels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xcg.common.messages import SceneError
from xcg.compiled._jit import for_each
from xcg.fields.advice import ComputedStep
from xcg.fields.deposit import Sums
from xcg.fields.formulas import registry
from xcg.fields.formulas.field import Field, Options
from xcg.fields.formulas.tracing import program_for
from xcg.fields.grids.grid import check_mesh
from xcg.fields.plan import Plan
from xcg.fields.sums.nodes import Block
from xcg.fields.support import numbers_of_floors
from xcg.scene.facts import SETUP, setup_of
from xcg.scene.lattice import Lattice
from xcg.scene.scene import Scene
from xcg.scene.schema import COMPONENTS, ROTATION, Frame, Variable, units_in
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
        check_mesh(frame["position"], nodes, max(plan.cutoffs), lattice.open_axes, source)
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


class _Algebra:
    """Algebra from the sums of a step to its fields: a program, and NumPy for formulas that it does not hold.

    Parameters
    ----------
    sums : Sums
        Sums of the step.
    out : mapping
        Fields (nodes, phases, ...) by name, which are filled.
    lattice : Lattice
        Box of the step, which may change.
    """

    def __init__(self, sums: Sums, out: Mapping[str, NDArray], lattice: Lattice) -> None:
        plan = sums.plan
        self.sums = sums
        self.out = out
        self.options = plan.options
        self.program = program_for(plan.fields, plan.options, len(plan.groups))
        self.untraced = plan.fields
        if self.program:
            held = self.program.widths
            self.untraced = tuple(name for name in plan.fields if name not in held)
        if self.untraced:
            wrapped = plan.nodes.fills(lattice.axis_periods)
            self.options = replace(plan.options, wrapped=wrapped)

    def fill(self, block: Block) -> int:
        """Compute the fields at the nodes of a block; return how many of them grains reach."""
        filled = self.sums.over(block)
        indices = block.indices
        if self.program:
            self.program.run(self.sums.table, filled, indices, self.out, block.order)
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
